# SPDX-License-Identifier: GPL-3.0-or-later
"""Skin on skin of one body: two blocks on two bones, one mesh, that run into each other."""

from types import SimpleNamespace

import dynamorph
import numpy as np
import pytest
from scenes import bar
from test_contact import surface

H = 1 / 96
SIDES, HIGH, GAP = 0.3, 0.15, 0.1


def blocks(solver, held=False, gap=GAP, missed=0.0):
    """Block 0 lies below block 1. held: the far side of each is. missed: how far the balls stay below the skin."""
    nodes, tets = bar((6, 6, 3), (SIDES, SIDES, HIGH))
    nodes = nodes - [SIDES / 2, SIDES / 2, HIGH]
    mirrored, count = nodes * [1.0, 1.0, -1.0] + [0.0, 0.0, gap], len(nodes)
    nodes = np.concatenate([nodes, mirrored])
    tets = np.concatenate([tets, (tets + count)[:, [0, 2, 1, 3]]]).astype(np.int32)
    mesh, ones = dynamorph.TetMesh(nodes, tets), np.ones(len(tets))
    weights = np.repeat(np.eye(2), count, axis=0)
    pinned = (np.abs(nodes[:, 2] - gap / 2) > HIGH + gap / 2 - 1e-6) & held
    s = SimpleNamespace(mesh=mesh, nodes=nodes, lower=np.arange(2 * count) < count, pinned=pinned)
    s.body = dynamorph.SoftBody(mesh, ones, ones, ones[:, None], pinned, weights)
    s.model = soft(s.body, nodes, solver)
    s.skin, normals = outside(nodes, tets)
    points = nodes[s.skin]
    s.contact = dynamorph.Contact(s.model, points, dynamorph.embed(mesh, points), weights[s.skin], normals[s.skin],
                     np.full(len(points), HIGH / 2))  # fmt: skip
    centers = np.array([[x, y, z] for z in (-HIGH / 2, gap + HIGH / 2)
                        for x in np.linspace(-0.09, 0.09, 10) for y in np.linspace(-0.09, 0.09, 10)])  # fmt: skip
    of_balls = np.repeat(np.eye(2), 100, axis=0)
    s.balls = centers, np.full(200, HIGH / 2 - missed), dynamorph.embed(mesh, centers), of_balls
    s.parts = np.arange(len(points)), of_balls.argmax(axis=1), weights[s.skin].argmax(axis=1)
    s.own = dynamorph.SelfContact(s.contact, *s.balls, *s.parts)
    s.facing = {side: np.flatnonzero((np.abs(nodes[:, :2]) < 0.06).all(axis=1) & (np.abs(nodes[:, 2] - z) < 1e-6))
                for side, z in (("lower", 0.0), ("upper", gap))}  # fmt: skip
    s.size = s.body.size
    return s


def soft(body, nodes, solver, law=dynamorph.MaterialModel.STABLE_STVK, stiff=1.0):
    """The model of a body whose mesh has these nodes (n, 3)."""
    target = dynamorph.MorphTarget("rest", 0 * nodes, lame_lambda=stiff * 4e4, lame_mu=stiff * 1e4,
                                   density=1000.0, stiffness_damping=0.004)  # fmt: skip
    full = dynamorph.FullModel(body, [target], law, dynamorph.Blending.EVEN)
    if solver == "FULL":
        return full
    tables = dynamorph.reduce(full, dynamorph.make_response_basis(full, 10, 20))
    return dynamorph.ReducedModel(body, [target], tables, dynamorph.Blending.EVEN)


def outside(nodes, tets):
    """The nodes of a mesh that are on its surface, and the normals (n, 3) there."""
    faces, normals = surface(tets), np.zeros_like(nodes)
    across = np.cross(nodes[faces[:, 1]] - nodes[faces[:, 0]], nodes[faces[:, 2]] - nodes[faces[:, 0]])
    np.add.at(normals, faces.ravel(), np.repeat(across, 3, axis=0))
    return np.unique(faces), normals


def posed(down, turn=0.0, scale=1.0):
    """The bones, with block 1 lower by so much and turned by an angle about the vertical, and everything scaled."""
    bones = np.repeat(np.eye(4)[None, :3], 2, axis=0)
    bones[1, :2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    bones[1, 2, 3] = -down
    return scale * bones


def simulated(s, down, own=True, steps=60, friction=0.0, distance=0.0, **pose):
    """Begins at rest; block 1 comes down and stays. Returns the displacement of the nodes, and the reports."""
    touches = {"self_contact": s.own if own else None, "self_friction": friction}
    simulation = dynamorph.Simulation(s.model, H, contact=s.contact, distance=distance, **touches)
    simulation.start(posed(0.0, **pose), posed(0.0, **pose), np.ones(1))
    reports = [
        simulation.advance(posed(down * min(1.0, k / 20), **pose)[None], np.ones((1, 1))) for k in range(1, steps + 1)
    ]
    return s.model.displacement(simulation.coordinates), reports, simulation


@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_two_parts_of_a_body_stop_each_other(solver, friction):
    """A twentieth of the overlap is left at most, as the report says, and each side gives way by half of it."""
    s, overlap = blocks(solver, held=True), 0.02
    moved, reports, _ = simulated(s, GAP + overlap, steps=180, friction=friction)
    assert all(report.converged for report in reports)
    lower, upper = (moved[s.facing[side], 2].mean() for side in ("lower", "upper"))
    left = overlap + lower - upper
    assert abs(left) < 0.05 * overlap
    assert 0.5 * left < reports[-1].penetration < 0.05 * overlap
    # Modes are not symmetric, and friction holds what slid on the way.
    assert lower == pytest.approx(-upper, rel=0.1 if solver == "REDUCED" else 0.02 if friction else 1e-4)
    free, _, _ = simulated(s, GAP + overlap, own=False)
    assert np.abs(free[s.facing["lower"], 2]).max() < 0.1 * overlap


def test_skin_that_the_balls_miss_stops_all_the_same():
    overlap, missed = 0.02, 0.004
    exact, less = (simulated(blocks("FULL", held=True, missed=each), GAP + overlap)[0] for each in (0.0, missed))
    facing = blocks("FULL").facing
    for side in ("lower", "upper"):
        assert less[facing[side], 2].mean() == pytest.approx(exact[facing[side], 2].mean(), abs=0.1 * missed)


@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
def test_what_friction_holds_does_not_creep(solver):
    """Pressed on each other, one turns a little and stays."""
    s = blocks(solver, held=True)
    simulation = dynamorph.Simulation(s.model, H, contact=s.contact, self_contact=s.own)
    simulation.start(posed(0.0), posed(0.0), np.ones(1))
    ways = []
    for k in range(300):  # the material's own creep dies out
        now = posed((GAP + 0.02) * min(1.0, k / 20), turn=0.05 * min(1.0, max(0.0, k / 20 - 1)))
        simulation.advance(now[None], np.ones((1, 1)))
        ways.append(s.model.displacement(simulation.coordinates)[s.facing["upper"], :2])
    creep = np.abs((ways[-1] - ways[-25]).mean(axis=0)).max() / (24 * H)
    assert creep < 2e-5 * s.body.size


@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
def test_what_a_step_is_given_counts_as_what_was_set(solver):
    """Friction and distance of a simulation, or of each step; stiffness of the material, or of each step."""
    s, count = blocks(solver, held=True), 60
    down = [posed((GAP + 0.02) * min(1.0, k / 20), turn=0.05 * min(1.0, max(0.0, k / 20 - 1))) for k in range(count)]
    stiffer = SimpleNamespace(model=soft(s.body, s.nodes, solver, stiff=2.0))
    places = s.nodes[s.skin], dynamorph.embed(s.mesh, s.nodes[s.skin]), np.eye(2)[s.parts[2]]
    stiffer.contact = dynamorph.Contact(stiffer.model, *places, outside(s.nodes, s.mesh.tets)[1][s.skin],
                                        np.full(len(s.skin), HIGH / 2))  # fmt: skip
    stiffer.own = dynamorph.SelfContact(stiffer.contact, *s.balls, *s.parts)

    def moved(body, friction, apart, **each_step):
        simulation = dynamorph.Simulation(body.model, H, contact=body.contact, self_contact=body.own,
                                          self_friction=friction, distance=apart)  # fmt: skip
        first = {name: values[0] for name, values in each_step.items()}
        simulation.start(down[0], down[0], np.ones(1), **first)
        simulation.advance(np.array(down), np.ones((count, 1)), **each_step)
        return body.model.displacement(simulation.coordinates)

    def same(value):
        return np.full(count, value)

    expected = moved(s, 0.8, 0.004)
    off = [np.abs(moved(s, *others) - expected).max() for others in ((0.0, 0.004), (0.8, 0.0))]
    assert min(off) > 1e-4
    np.testing.assert_array_equal(moved(s, 0.0, 0.0, self_friction=same(0.8), distance=same(0.004)), expected)
    twice = moved(stiffer, 0.8, 0.004)
    as_twice = moved(s, 0.8, 0.004, stiffness=np.full((count, 1), 2.0))
    assert np.abs(twice - expected).max() > 1e-3
    assert np.abs(as_twice - twice).max() < 0.05 * np.abs(twice - expected).max()


def test_the_forces_of_both_sides_sum_to_zero():
    """Free blocks that begin within each other fly apart, and their center of mass stays."""
    s = blocks("FULL")
    simulation = dynamorph.Simulation(s.model, H, contact=s.contact, self_contact=s.own)
    down = posed(GAP + 0.02)
    simulation.state = dynamorph.State([np.zeros(s.model.dofs)] * 4, [down.reshape(-1, 12)] * 4)
    simulation.advance(np.repeat(down[None], 30, 0), np.ones((30, 1)))
    mass = s.body.volumes.sum(axis=1)
    pushed = mass[:, None] * s.model.displacement(simulation.coordinates)[s.body.free_nodes]
    lower, upper = (pushed[s.lower[s.body.free_nodes] == side].sum(axis=0) for side in (True, False))
    assert lower[2] < -0.01 * mass.sum() / 2
    assert np.abs(lower + upper).max() < 1e-6 * np.abs(lower).max()


def test_a_body_that_is_scaled_is_as_large_as_it_shows():
    s, overlap = blocks("FULL", held=True), 0.02
    moved, _, _ = simulated(s, GAP + overlap, scale=2.0)
    lower, upper = (moved[s.facing[side], 2].mean() for side in ("lower", "upper"))
    assert abs(overlap + lower - upper) < 0.1 * overlap


def test_a_joint_that_is_folded_flat_is_told_not_forced():
    """By 125 degrees skinning leaves 0.21 of a joint, by 60 three quarters."""
    s = blocks("FULL", held=True)
    s.own = dynamorph.SelfContact(s.contact, *s.balls, *s.parts, [[0, 1]])
    pressed = {}
    for degrees in (60.0, 125.0):
        _, reports, _ = simulated(s, GAP + 0.02, steps=30, turn=np.radians(degrees))
        pressed[degrees] = reports[-1].contacts, reports[-1].too_deep
    assert pressed[60.0][0] > 0 and pressed[60.0][1] == 0.0
    assert pressed[125.0][0] == 0 and pressed[125.0][1] == pytest.approx(0.02, rel=0.2)


def test_skin_that_is_near_but_not_touched_moves_as_without_it():
    """A block turns just above the other one."""
    s = blocks("FULL", held=True)

    def turned(gap, own):
        simulation = dynamorph.Simulation(s.model, H, contact=s.contact, self_contact=own, self_friction=0.0)
        down = GAP - gap * s.size
        simulation.start(posed(down), posed(down), np.ones(1))
        reports = [simulation.advance(posed(down, 0.01 * k)[None], np.ones((1, 1))) for k in range(1, 20)]
        iterations, contacts = (sum(getattr(each, name) for each in reports) for name in ("iterations", "contacts"))
        return simulation.coordinates, iterations, contacts

    free, without, _ = turned(0.003, None)
    moved, near, contacts = turned(0.003, s.own)
    _, touched, pushed = turned(-0.003, s.own)
    assert np.array_equal(moved, free) and near == without and contacts == 0
    assert touched > without and pushed > 0


@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
@pytest.mark.parametrize("gap", [0.008, 0.02, 0.06])
def test_what_is_near_only_through_the_air_is_touched(solver, gap):
    """From a tenth to most of their thickness apart."""
    s, overlap = blocks(solver, held=True, gap=gap), 0.02

    def left(own):
        moved, reports, _ = simulated(s, gap + overlap, own)
        assert all(report.converged for report in reports)
        return overlap + moved[s.facing["lower"], 2].mean() - moved[s.facing["upper"], 2].mean()

    assert abs(left(own=True)) < 0.1 * overlap < 0.8 * left(own=False)


def jointed(gap):
    """Blocks with balls in the gap between them."""
    s = blocks("FULL", held=True, gap=gap)
    lower, upper = np.split(s.balls[0], 2)
    between = np.concatenate([lower, upper, lower + 0.055 * np.eye(3)[2], lower + 0.105 * np.eye(3)[2]])
    of_balls, of_points = np.concatenate([s.parts[1], np.zeros(200, int)]), s.parts[2]
    s.own = dynamorph.SelfContact(s.contact, between, np.full(400, HIGH / 2), dynamorph.embed(s.mesh, between),
                                      np.eye(2)[of_balls], s.parts[0], of_balls, of_points)  # fmt: skip
    return s


def test_what_is_near_through_the_body_at_rest_is_left_alone():
    """A joint: balls fill the gap of less than a fifth of the thickness, and one block is pressed into the other."""
    s = jointed(0.01)
    moved, reports, _ = simulated(s, 0.02)
    assert max(report.contacts for report in reports) == 0
    free, _, _ = simulated(s, 0.02, own=False)
    assert np.array_equal(moved, free)


def test_limbs_that_nearly_touch_at_rest_are_not_pressed_there():
    """Nearer than the usual distance, they are pressed by what they come nearer."""
    s, nearer = blocks("FULL", held=True, gap=0.0005), 0.02
    distance = 2e-3 * s.size
    moved, _, _ = simulated(s, 0.0, distance=distance)
    assert np.abs(moved).max() < 1e-6 * distance
    moved, _, _ = simulated(s, nearer, distance=distance)
    lower, upper = (moved[s.facing[side], 2].mean() for side in ("lower", "upper"))
    assert upper - lower == pytest.approx(nearer, rel=0.1)


def test_it_is_the_same_from_a_kept_state():
    s = blocks("FULL", held=True)
    _, _, simulation = simulated(s, GAP + 0.02, steps=25, friction=0.5)
    other = dynamorph.Simulation(s.model, H, contact=s.contact, self_contact=s.own)
    other.state = simulation.state
    for each in (simulation, other):
        each.advance(np.repeat(posed(GAP + 0.02)[None], 5, 0), np.ones((5, 1)))
    assert np.array_equal(simulation.coordinates, other.coordinates)


def test_where_the_bones_leave_no_room_it_says_so():
    s = blocks("FULL", held=True)
    _, reports, _ = simulated(s, GAP + 0.6 * 2 * HIGH)
    worst = max(reports, key=lambda report: report.too_deep)
    assert worst.too_deep > 0 and worst.too_deep_sample >= 0 and worst.too_deep_collider == -1


def test_what_does_not_fit_is_refused():
    s, other = blocks("FULL"), blocks("FULL")
    with pytest.raises(ValueError, match="its samples are not those"):
        dynamorph.Simulation(s.model, H, contact=s.contact, self_contact=other.own)
    with pytest.raises(ValueError, match="friction"):
        dynamorph.Simulation(s.model, H, contact=s.contact, self_contact=s.own, self_friction=-1.0)
    points, of_balls, of_points = s.parts
    for wrong, why in (
        (([3, 2], of_balls, of_points[:2]), "ascending"),
        ((points, of_balls[:-1], of_points), "of_balls"),
        ((points, of_balls, of_points[:-1]), "of_points"),
        ((points, of_balls, -of_points - 1), "from 0 on"),
    ):
        with pytest.raises(ValueError, match=why):
            dynamorph.SelfContact(s.contact, *s.balls, *wrong)
    with pytest.raises(ValueError, match="radius"):
        dynamorph.SelfContact(s.contact, s.balls[0], -s.balls[1], *s.balls[2:], *s.parts)
