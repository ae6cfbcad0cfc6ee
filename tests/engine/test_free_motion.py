# SPDX-License-Identifier: GPL-3.0-or-later
"""Bodies that something leaves free to move have no modes: the engine says what can move, instead of a spin of
frequency 0.
"""

import re

import dynamorph
import numpy as np
import pytest
from scenes import bar
from scipy.spatial.transform import Rotation

BAR = (6, 2, 2), (0.6, 0.2, 0.2)
NUMBERS = r"\((-?[\d.e-]+), (-?[\d.e-]+), (-?[\d.e-]+)\)"


def model(nodes, tets, pinned, hold=None):
    ones = np.ones(len(tets))
    mesh = dynamorph.TetMesh(nodes, tets)
    body = dynamorph.SoftBody(mesh, ones, ones, ones[:, None], pinned, np.ones((len(nodes), 1)), hold)
    target = dynamorph.MorphTarget("rest", np.zeros_like(nodes), lame_lambda=1e4, lame_mu=1e4, density=1e3)
    return dynamorph.FullModel(body, [target], dynamorph.MaterialModel.STVK, dynamorph.Blending.EVEN)


def refusal(nodes, tets, pinned, hold=None):
    """What linear modes and both kinds of basis say alike."""
    full = model(nodes, tets, pinned, hold)
    calls = (
        lambda: full.linear_modes(0, 4),
        lambda: dynamorph.make_basis(full, 6),
        lambda: dynamorph.make_response_basis(full, 4, 4),
    )
    said = set()
    for call in calls:
        with pytest.raises(dynamorph.Error) as error:
            call()
        said.add(str(error.value))
    (message,) = said
    assert "hold the body" in message or "Use more nodes" in message
    return message


def assert_moves_freely(nodes, tets, pinned):
    """The zero modes that the message is about: the stiffness resists them no more than round-off."""
    full = model(nodes, tets, pinned)
    stiffness = full.linearize(np.ones(1), np.zeros(full.dofs))[2]
    values = np.linalg.eigvalsh(stiffness.toarray())
    assert values[0] < 1e-12 * values[-1]


def assert_held(nodes, tets, pinned, hold=None, modes=4):
    omega, _ = model(nodes, tets, pinned, hold).linear_modes(0, modes)
    assert omega[0] > 1e-2 * omega[-1]


def merged(*parts):
    """Meshes side by side; nodes at the same place become one."""
    nodes = np.concatenate([part[0] for part in parts])
    starts = np.cumsum([0] + [len(part[0]) for part in parts[:-1]])
    tets = np.concatenate([part[1] + start for part, start in zip(parts, starts, strict=True)])
    _, first, number = np.unique(nodes.round(9), axis=0, return_index=True, return_inverse=True)
    return nodes[first], number.ravel()[tets]


def block(x, y, cells=(2, 2, 2)):
    """A cube of unit size at a place of a checkerboard; blocks at a corner of each other share an edge along z."""
    nodes, tets = bar(cells, (1.0, 1.0, 1.0))
    return nodes + np.array([x, y, 0.0]), tets


def inside(nodes, x, y):
    return (np.abs(nodes[:, :2] - [x + 0.5, y + 0.5]) < 0.5 + 1e-9).all(axis=1)


@pytest.fixture(params=[0, 1, 2])
def placed(request):
    """Turns and moves points: first not at all."""
    if not request.param:
        return lambda points: points
    turn = Rotation.random(random_state=request.param)
    return lambda points: turn.apply(points) + np.array([3.0, -2.0, 1.0])


def test_pins_along_the_axis_of_a_bar(placed):
    nodes, tets = bar(*BAR)
    pinned = np.linalg.norm(nodes[:, 1:] - 0.1, axis=1) < 1e-9
    assert pinned.sum() == 7
    message = refusal(placed(nodes), tets, pinned)
    found = re.search(f"can turn about an axis through {NUMBERS} m along {NUMBERS}", message)
    assert message.startswith("This body")
    point, along = np.array(found.groups(), float).reshape(2, 3)
    start, end = placed(np.array([[0.0, 0.1, 0.1], [0.6, 0.1, 0.1]]))
    assert abs(along @ (end - start)) == pytest.approx(0.6, rel=2e-3)
    assert np.linalg.norm(np.cross(point - start, end - start)) / 0.6 < 0.01  # three digits of coordinates
    assert_moves_freely(placed(nodes), tets, pinned)


def test_an_axis_along_x_reads_as_such():
    nodes, tets = bar(*BAR)
    message = refusal(nodes - 0.1, tets, np.linalg.norm(nodes[:, 1:] - 0.1, axis=1) < 1e-9)
    assert "through (-0.1, 0, 0) m along (1, 0, 0)" in message


def test_one_pinned_node(placed):
    nodes, tets = bar(*BAR)
    pinned = np.arange(len(nodes)) == 13
    message = refusal(placed(nodes), tets, pinned)
    point = re.search(f"This body can turn about the point {NUMBERS} m", message).groups()
    np.testing.assert_allclose(np.array(point, float), placed(nodes[13:14])[0], atol=6e-3)
    assert_moves_freely(placed(nodes), tets, pinned)


def test_two_pinned_nodes_leave_an_axis(placed):
    nodes, tets = bar(*BAR)
    pinned = np.isin(np.arange(len(nodes)), (0, len(nodes) - 1))
    assert "turn about an axis" in refusal(placed(nodes), tets, pinned)
    assert_moves_freely(placed(nodes), tets, pinned)


def test_nothing_pinned():
    nodes, tets = bar(*BAR)
    assert refusal(nodes, tets, np.zeros(len(nodes), bool)).startswith("Nothing holds this body")


def test_a_part_that_is_attached_to_nothing():
    nodes, tets = merged(
        bar(*BAR), (bar((1, 1, 1), (0.1, 0.1, 0.1))[0] + [0.0, 0.0, 1.0], bar((1, 1, 1), (1, 1, 1))[1])
    )
    message = refusal(nodes, tets, nodes[:, 0] + nodes[:, 2] < 0.25)
    assert "8 of its 71 nodes, around (0.05, 0.05, 1.05) m, is attached to nothing. " in message


def test_six_loose_bars_with_one_pinned():
    bars = [(bar(*BAR)[0] + [0.0, 0.5 * k, 0.0], bar(*BAR)[1]) for k in range(6)]
    nodes, tets = merged(*bars)
    message = refusal(nodes, tets, (nodes[:, 0] < 1e-9) & (nodes[:, 1] < 0.3))
    assert "63 of its 378 nodes" in message and "is attached to nothing, nor are 4 others" in message
    assert_held(nodes, tets, nodes[:, 0] < 1e-9, modes=12)


def test_a_part_that_hangs_by_an_edge():
    nodes, tets = merged(block(0, 0), block(1, 1))
    pinned = nodes[:, 0] < 1e-9
    message = refusal(nodes, tets, pinned)
    assert "27 of its 51 nodes, around (1.5, 1.5, 0.5) m, can turn about an axis through (1, 1, " in message
    assert "along (0, 0, 1)" in message
    assert_moves_freely(nodes, tets, pinned)
    assert_held(nodes, tets, pinned | (nodes[:, 0] > 2 - 1e-9))


def test_a_part_that_hangs_by_a_corner():
    nodes, tets = bar((2, 2, 2), (1.0, 1.0, 1.0))
    nodes, tets = merged((nodes, tets), (nodes + 1.0, tets))
    pinned = nodes[:, 0] < 1e-9
    assert "can turn about the point (1, 1, 1) m" in refusal(nodes, tets, pinned)
    assert_moves_freely(nodes, tets, pinned)


def test_parts_that_are_hinged_to_one_another_in_a_ring():
    """Four parts with four parallel hinges are a linkage, although each part is attached at two of them."""
    nodes, tets = merged(block(1, 0), block(0, 1), block(2, 1), block(1, 2))
    pinned = inside(nodes, 1, 0) & (nodes[:, 1] < 1e-9)
    assert "can fold: 3 of its parts hang together only by edges" in refusal(nodes, tets, pinned)
    assert_moves_freely(nodes, tets, pinned)


def test_three_parts_with_three_hinges_are_rigid():
    """No part is attached by more than two edges, and yet nothing moves."""
    turns = np.arange(3) * 2 * np.pi / 3
    ring = [np.column_stack([np.cos(turns + t), np.sin(turns + t), np.full(3, z)]) for t, z in ((0.0, 0.0), (0.5, 1.0))]
    tets = np.array([[i, (i + 1) % 3, 3 + i, 3 + (i + 1) % 3] for i in range(3)])
    nodes = np.concatenate(ring)
    inverted = np.linalg.det(nodes[tets[:, 1:]] - nodes[tets[:, :1]]) < 0
    tets[inverted] = tets[inverted][:, [0, 1, 3, 2]]
    assert_held(nodes, tets, np.isin(np.arange(6), tets[0]), modes=2)


@pytest.mark.parametrize("place", [(0, 1, 3), (0, 10, 40), (3, 30, 60)])
def test_any_three_pins_that_are_not_on_a_line_do(place):
    nodes, tets = bar(*BAR)
    assert_held(nodes, tets, np.isin(np.arange(len(nodes)), place) | (nodes[:, 0] > 10), modes=2)


def test_a_line_of_single_precision_is_a_line():
    nodes, tets = bar(*BAR)
    placed = (Rotation.random(random_state=4).apply(nodes) + np.array([3.0, 1.0, 2.0])).astype(np.float32).astype(float)
    assert "turn about an axis" in refusal(placed, tets, np.linalg.norm(nodes[:, 1:] - 0.1, axis=1) < 1e-9)


def test_a_hold_anywhere_is_enough():
    nodes, tets = bar(*BAR)
    none, one = np.zeros(len(nodes), bool), np.zeros(len(tets))
    one[40] = 100.0
    assert_held(nodes, tets, none, one, modes=2)
    two = merged((nodes, tets), (nodes + np.array([0.0, 0.0, 1.0]), tets))
    assert "63 of its 126 nodes" in refusal(*two, np.zeros(126, bool), np.r_[one, 0 * one])


def test_a_free_body_can_still_be_simulated():
    """It falls by g t^2 / 2."""
    nodes, tets = bar(*BAR)
    full = model(nodes, tets, np.zeros(len(nodes), bool))
    h, steps = 1e-3, 50
    simulation = dynamorph.Simulation(full, h, gravity=np.array([0.0, 0.0, -9.81]))
    bones = np.eye(4)[None, :3]
    simulation.start(bones, bones, np.ones(1))
    simulation.state = dynamorph.State([np.zeros(full.dofs)] * 4, simulation.state.bones)
    simulation.advance(np.repeat(bones[None], steps, axis=0), np.ones((steps, 1)))
    fallen = np.reshape(simulation.coordinates, (-1, 3))[:, 2]
    np.testing.assert_allclose(fallen, -9.81 * (h * steps) ** 2 / 2, rtol=0.05)
