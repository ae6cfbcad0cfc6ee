# SPDX-License-Identifier: GPL-3.0-or-later
"""Any triangle soup becomes a closed surface with its faces outward, and says what was wrong."""

import dynamorph
import numpy as np
import pytest
from test_meshing import BODIES, BOX_TRIANGLES, box, is_closed, join, sphere

SOUND = dict.fromkeys(
    ("boundary_loops", "open_edges", "nonmanifold_edges", "flipped_faces", "duplicate_faces", "degenerate_faces",
     "stray_vertices"), 0,
) | {"components": 1}  # fmt: skip


def volume(vertices, triangles):
    a, b, c = vertices[triangles].swapaxes(0, 1)
    return np.einsum("ti,ti", a, np.cross(b, c)) / 6


def net_flow(triangles):
    """How often each edge is run along more in one direction than in the other: nothing where faces enclose."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    sign = np.where(edges[:, 0] < edges[:, 1], 1, -1)
    _, edge = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    return np.abs(np.bincount(edge.ravel(), sign)).max()


def without(mesh, dropped):
    vertices, triangles = mesh
    return vertices, np.delete(triangles, dropped, axis=0)


def strip(turns=0.75, rings=24):
    """A curved hair card, open all around."""
    angle = np.linspace(0, 2 * np.pi * turns, rings)
    low = np.column_stack([np.cos(angle), np.sin(angle), 0.2 * angle])
    high = low + np.array([0, 0, 0.1])
    k = np.arange(rings - 1)
    quads = np.column_stack([k, k + 1, k + rings + 1, k + rings])
    return np.concatenate([low, high]), np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])


def random_soup(seed):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1, 1, (30, 3)), rng.integers(0, 30, (200, 3))


@pytest.mark.parametrize("name", BODIES)
def test_every_soup_is_closed(name):
    vertices, triangles, _ = dynamorph.closed_surface(*BODIES[name])
    assert net_flow(triangles) == 0
    assert volume(vertices, triangles) > 0
    assert set(triangles.ravel()) <= set(range(len(vertices)))


@pytest.mark.parametrize("seed", range(5))
def test_random_soups_are_closed(seed):
    vertices, triangles, defects = dynamorph.closed_surface(*random_soup(seed))
    assert net_flow(triangles) == 0
    assert defects["nonmanifold_edges"] > 0


def test_a_sound_surface_stays_as_it_is():
    vertices, triangles, defects = dynamorph.closed_surface(*box())
    np.testing.assert_allclose(vertices[triangles], box()[0][BOX_TRIANGLES], atol=1e-15)
    assert defects == SOUND


@pytest.mark.fault("M09", "M10")
def test_each_defect_is_counted():
    body = sphere()
    triangles = body[1].copy()
    triangles[100:110] = triangles[100:110, ::-1]
    triangles = np.concatenate([np.delete(triangles, 600, axis=0), triangles[150:153]])
    broken = np.vstack([body[0], [[9, 9, 9]]]), triangles
    defects = dynamorph.closed_surface(*join(broken, box(center=(4, 0, 0))))[2]
    poles = defects.pop("degenerate_faces")
    assert poles > 0
    assert defects == {
        "boundary_loops": 1, "open_edges": 3, "nonmanifold_edges": 0, "flipped_faces": 10, "duplicate_faces": 3,
        "stray_vertices": 1, "components": 2,
    }  # fmt: skip


@pytest.mark.fault("M11")
@pytest.mark.parametrize("turn", [slice(None), slice(0, 400), slice(None, None, 2)])
def test_faces_turn_outward(turn):
    vertices, triangles = sphere()
    mixed = triangles.copy()
    mixed[turn] = mixed[turn, ::-1]
    closed = dynamorph.closed_surface(vertices, mixed)
    assert is_closed(closed[1])
    assert volume(*closed[:2]) == pytest.approx(volume(vertices, triangles))


@pytest.mark.fault("M08")
def test_every_piece_turns_outward_even_inside_another():
    shell, core = sphere(), box()
    vertices, triangles, defects = dynamorph.closed_surface(*join(shell, (core[0], core[1][:, ::-1])))
    assert volume(vertices, triangles) == pytest.approx(volume(*shell) + 1)
    assert defects["flipped_faces"] == 12


@pytest.mark.fault("M05")
def test_holes_are_capped_straight():
    body = sphere()
    middle = body[0][body[1]].mean(axis=1)
    rim = body[1][(middle[:, 2] < 0.9) & (middle[:, 2] > -0.9)]  # a barrel without lids
    vertices, triangles, defects = dynamorph.closed_surface(body[0], rim)
    assert is_closed(triangles)
    assert defects["boundary_loops"] == 2
    assert volume(vertices, triangles) == pytest.approx(volume(*body), rel=0.06)


def test_a_hair_card_stays_thin():
    """Its cap runs to and fro between its sides, not across the curl."""
    card = strip()
    vertices, triangles, defects = dynamorph.closed_surface(*card)
    assert net_flow(triangles) == 0
    assert (defects["boundary_loops"], defects["components"]) == (1, 1)
    middle = vertices[triangles].mean(axis=1)
    assert np.hypot(middle[:, 0], middle[:, 1]).min() > 0.95
    assert abs(volume(vertices, triangles)) < 2e-3


@pytest.mark.fault("M06")
@pytest.mark.parametrize("extra", [[0, 1, 7], [0, 1, 8]], ids=["wall inside", "fin outside"])
def test_faces_too_many_leave_the_body(extra):
    corners = np.vstack([box()[0], [[0, -1, -1]]])
    vertices, triangles, defects = dynamorph.closed_surface(corners, np.vstack([BOX_TRIANGLES, [extra]]))
    assert net_flow(triangles) == 0
    assert defects["nonmanifold_edges"] > 0
    assert volume(vertices, triangles) == pytest.approx(1, rel=0.01)


def test_the_wrap_of_an_open_body_is_not_hollow():
    """Alpha wrapping alone would enter through the holes."""
    closed = sphere()
    open_body = without(closed, np.flatnonzero(np.abs(closed[0][closed[1]].mean(axis=1)[:, 0]) > 0.9))
    volumes = []
    for body in (closed, open_body):
        cage = dynamorph.make_cage_surface(*body, 1000)
        volumes.append(volume(*cage))
    assert volumes[1] == pytest.approx(volumes[0], rel=0.06)
