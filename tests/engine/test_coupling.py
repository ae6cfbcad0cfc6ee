# SPDX-License-Identifier: GPL-3.0-or-later
"""Two soft blocks, each a body of its own, that run into each other."""

from types import SimpleNamespace

import dynamorph
import numpy as np
import pytest
from scenes import bar
from test_self_contact import GAP, HIGH, SIDES, H, blocks, outside, simulated, soft
from test_self_contact import posed as posed_limbs


def block(solver, upper, held=False, stiff=1.0, law=dynamorph.MaterialModel.LINEAR, high=HIGH, above=GAP):
    """The lower or the upper one. held: the far side is. high, above: the upper one's height, and where it begins."""
    nodes, tets = bar((6, 6, 3), (SIDES, SIDES, high))
    nodes = nodes - [SIDES / 2, SIDES / 2, high]
    far = -HIGH
    if upper:
        nodes = nodes * [1.0, 1.0, -1.0] + [0.0, 0.0, above]
        tets, far = tets[:, [0, 2, 1, 3]].astype(np.int32), above + high
    held_nodes = (np.abs(nodes[:, 2] - far) < 1e-6) & held
    centers = np.array([[x, y, 0.0] for x in np.linspace(-0.09, 0.09, 10) for y in np.linspace(-0.09, 0.09, 10)])
    centers[:, 2] = above + high / 2 if upper else -HIGH / 2
    s = made_of(nodes, tets, held_nodes, upper, soft_as=(solver, law, stiff), centers=centers, radius=high / 2)
    facing = above if upper else 0.0
    s.facing = np.flatnonzero((np.abs(nodes[:, :2]) < 0.06).all(axis=1) & (np.abs(nodes[:, 2] - facing) < 1e-6))
    return s


def made_of(nodes, tets, held_nodes, upper, soft_as, centers, radius):
    """A body of its own: its model, contact and balls. radius: of these, and the thickness of its tissue."""
    s = SimpleNamespace(mesh=dynamorph.TetMesh(nodes, tets), upper=upper, nodes=nodes)
    ones, count = np.ones(len(tets)), len(centers)
    weights = np.ones((len(nodes), 1))
    s.body = dynamorph.SoftBody(s.mesh, ones, ones, ones[:, None], held_nodes, weights)
    s.model = soft(s.body, nodes, *soft_as)
    skin, normals = outside(nodes, tets)
    points = nodes[skin]
    s.contact = dynamorph.Contact(s.model, points, dynamorph.embed(s.mesh, points), weights[skin], normals[skin],
                                  np.full(len(points), radius))  # fmt: skip
    s.skin = dynamorph.SelfContact(s.contact, centers, np.full(count, radius), dynamorph.embed(s.mesh, centers),
                                   np.ones((count, 1)), np.arange(len(points)), np.zeros(count, int),
                                   np.zeros(len(points), int))  # fmt: skip
    return s


def posed(down=0.0, aside=0.0):
    bones = np.eye(4)[None, :3].copy()
    bones[0, :2, 3], bones[0, 2, 3] = aside, -down
    return bones


def simulation_of(s, now=None, then=None):
    made = dynamorph.Simulation(s.model, H, contact=s.contact)
    now = posed() if now is None else now
    made.start(now, now if then is None else then, np.ones(1))
    return made


def motion(bones):
    return bones[None], np.ones((1, 1)), *[None] * 6


def pressed(lower, upper, down, steps=60, order=1, friction=0.0, aside=0.0, worn=None):
    """The upper block comes down in 20 steps, and to the side in 20 more. worn: how deep it lies in the lower one at
    rest. Returns displacements, and reports.
    """
    bodies = [lower, upper][::order]
    simulations = {id(s): simulation_of(s) for s in bodies}
    garments = [] if worn is None else [(bodies.index(upper), bodies.index(lower), posed(GAP + worn)[0])]
    coupling = dynamorph.Coupling([(simulations[id(s)], s.skin) for s in bodies], friction, garments)
    reports = []
    for k in range(1, steps + 1):
        now = posed(down * min(1.0, k / 20), aside * min(1.0, max(0.0, k / 20 - 1)))
        reports.append(coupling.advance([motion(now if s.upper else posed()) for s in bodies])[::order])
    moved = [s.model.displacement(simulations[id(s)].coordinates) for s in (lower, upper)]
    return moved, reports, simulations


@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
def test_both_bodies_give_way_by_their_compliance(solver):
    """A tenth of the overlap is left at most, and of two blocks, the softer one takes more of it."""
    lower, upper = block(solver, False, held=True, stiff=3.0), block(solver, True, held=True)
    overlap = 0.02
    moved, reports, _ = pressed(lower, upper, GAP + overlap)
    assert all(report.converged for pair in reports for report in pair)
    down, up = -moved[0][lower.facing, 2].mean(), moved[1][upper.facing, 2].mean()
    assert 0.9 * overlap < down + up < 1.1 * overlap
    assert up / down == pytest.approx(3.0, rel=0.05)
    assert reports[-1][0].contacts > 0 and reports[-1][1].contacts > 0


@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
def test_it_does_not_depend_on_the_order(solver):
    lower, upper = block(solver, False, held=True, stiff=3.0), block(solver, True, held=True)
    first, _, _ = pressed(lower, upper, GAP + 0.02, friction=0.5, aside=0.02)
    second, _, _ = pressed(lower, upper, GAP + 0.02, order=-1, friction=0.5, aside=0.02)
    for one, other in zip(first, second, strict=True):
        assert np.abs(one - other).max() < 1e-5 * np.abs(one).max()


@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
def test_what_friction_holds_does_not_creep(solver):
    """The upper block lies on the lower one, is pushed aside, and stays."""
    lower, upper = bodies = [block(solver, side, held=True) for side in (False, True)]
    simulations = [simulation_of(s) for s in bodies]
    coupling = dynamorph.Coupling([(made, s.skin) for made, s in zip(simulations, bodies, strict=True)], 0.5)
    ways = []
    for k in range(300):  # the material's own creep dies out
        now = posed((GAP + 0.02) * min(1.0, k / 20), 0.004 * min(1.0, max(0.0, k / 20 - 1)))
        coupling.advance([motion(posed()), motion(now)])
        ways.append(upper.model.displacement(simulations[1].coordinates)[upper.facing, 0].mean())
    assert ways[-1] < -0.001  # it is held behind
    creep = abs(ways[-1] - ways[-25]) / (24 * H)
    assert creep < 2e-5 * upper.body.size


@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
@pytest.mark.parametrize("bad", [[1e4, 0.0], [1.0, 1e3]], ids=["scaled", "moved"])
def test_a_bad_frame_of_one_does_not_throw_the_other(solver, bad):
    bodies = [block(solver, upper, held=True) for upper in (False, True)]
    simulations = [simulation_of(s) for s in bodies]
    coupling = dynamorph.Coupling([(made, s.skin) for made, s in zip(simulations, bodies, strict=True)], 0.5)
    moved = []
    for k in range(60):
        now = posed((GAP + 0.02) * min(1.0, k / 20))
        if k == 40:
            now = bad[0] * now + bad[1] * np.eye(3, 4, 3)
        coupling.advance([motion(posed()), motion(now)])
        moved.append(np.abs(bodies[0].model.displacement(simulations[0].coordinates)).max())
    assert max(moved[40:]) < 0.1 * bodies[0].body.size  # it swings back, which may hit


def test_two_bodies_are_as_two_parts_of_one():
    """The same blocks as one mesh that touches itself, which is solved by another way through the engine."""
    law, overlap = dynamorph.MaterialModel.STABLE_STVK, 0.02
    lower, upper = (block("FULL", side, held=True, law=law) for side in (False, True))
    moved, _, _ = pressed(lower, upper, GAP + overlap)
    one = blocks("FULL", held=True)
    expected, _, _ = simulated(one, GAP + overlap)
    for part, own in ((expected[one.lower], moved[0]), (expected[~one.lower], moved[1])):
        assert np.abs(own).max() > 0.4 * overlap
        assert (
            np.abs(own - part).max() < 0.02 * overlap
        )  # what belongs to the size of a body is that of both, or of one


def test_the_forces_between_them_sum_to_zero():
    """Free blocks that begin within each other fly apart, and their common center of mass stays."""
    bodies = [block("FULL", False, stiff=2.0), block("FULL", True)]
    simulations, places = [simulation_of(s) for s in bodies], [posed((GAP + 0.02) * s.upper) for s in bodies]
    for s, made, place in zip(bodies, simulations, places, strict=True):
        made.state = dynamorph.State([np.zeros(s.model.dofs)] * 4, [place.reshape(-1, 12)] * 4)
    coupling = dynamorph.Coupling([(made, s.skin) for s, made in zip(bodies, simulations, strict=True)])
    largest = 0.0
    for _ in range(30):
        pair = coupling.advance([motion(place) for place in places])
        forces = np.array([report.body_force for report in pair])
        largest = max(largest, np.abs(forces).max())
        assert np.abs(forces.sum(axis=0)).max() <= 1e-6 * np.abs(forces).max()
    pushed = [s.body.volumes.sum(axis=1) @ s.model.displacement(made.coordinates)[s.body.free_nodes]
              for s, made in zip(bodies, simulations, strict=True)]  # fmt: skip
    assert largest > 10.0 and pushed[0][2] < -0.01 * bodies[0].body.volumes.sum() / 2
    assert np.abs(pushed[0] + pushed[1]).max() < 1e-6 * np.abs(pushed[0]).max()


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
def test_clothes_lie_on_a_body_as_deep_as_at_rest(solver, order):
    """They do not press on it there, and where they go deeper, both give way by what is deeper. Only the points of the
    clothes touch the body: what is inside of clothes is not in them.
    """
    body, clothes, worn, deeper = block(solver, False, held=True), block(solver, True, held=True), 0.01, 0.01
    moved, reports, _ = pressed(body, clothes, GAP + worn, order=order, worn=worn)
    assert max(np.abs(each).max() for each in moved) < 0.03 * worn
    moved, reports, _ = pressed(body, clothes, GAP + worn + deeper, order=order, worn=worn)
    gave_way = moved[1][clothes.facing, 2].mean() - moved[0][body.facing, 2].mean()
    assert gave_way == pytest.approx(deeper, rel=0.2)
    assert reports[-1][0].contacts == 0 < reports[-1][1].contacts
    moved, _, _ = pressed(body, clothes, GAP + worn + deeper, order=order)
    assert moved[1][clothes.facing, 2].mean() - moved[0][body.facing, 2].mean() > 1.7 * gave_way


FOLD, DEEP = 0.12, 0.01  # meters: how far apart and how high folds are


def folded(solver, upper):
    """A block with folds across, or half as broad clothes on it that have the same; both are held on the far side."""
    broad = SIDES / 2 if upper else SIDES
    nodes, tets = bar((24, 4, 3), (SIDES, broad, HIGH))
    nodes = nodes - [SIDES / 2, broad / 2, HIGH]
    if upper:
        nodes, tets = nodes * [1.0, 1.0, -1.0], tets[:, [0, 2, 1, 3]].astype(np.int32)
    held, facing = np.abs(nodes[:, 2]) > HIGH - 1e-6, np.flatnonzero(np.abs(nodes[:, 2]) < 1e-6)
    nodes[:, 2] += DEEP * np.cos(2.0 * np.pi * nodes[:, 0] / FOLD) * (1.0 - np.abs(nodes[:, 2]) / HIGH)
    x, y = np.meshgrid(np.linspace(-0.13, 0.13, 16), np.linspace(-0.4, 0.4, 5) * broad)
    centers = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, HIGH / 2 if upper else -HIGH / 2)])
    s = made_of(nodes, tets, held, upper, (solver, dynamorph.MaterialModel.LINEAR, 1.0), centers, HIGH / 2)
    s.facing = facing
    return s


@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
def test_clothes_that_slide_over_folds_stay_out(solver):
    """By a tenth of the body's size, which is a quarter of the way to the next fold: they climb it, and the skin gives
    way. Then they come to rest, though the skin below is looked for in each step.
    """
    body, clothes = folded(solver, False), folded(solver, True)
    size = np.linalg.norm(np.ptp(body.nodes, axis=0))
    simulations = [simulation_of(each) for each in (body, clothes)]
    bodies = list(zip(simulations, [body.skin, clothes.skin], strict=True))
    coupling = dynamorph.Coupling(bodies, garments=[(1, 0, np.eye(4)[:3])])
    deepest, places = [], []
    for k in range(1, 141):
        aside = 0.1 * size * min(1.0, k / 40)
        coupling.advance([motion(posed()), motion(posed(aside=aside))])
        moved = [
            s.nodes + s.model.displacement(made.coordinates)
            for s, made in zip((body, clothes), simulations, strict=True)
        ]
        skin, cloth = (each[s.facing] for each, s in zip(moved, (body, clothes), strict=True))
        cloth = cloth + np.array([aside, 0.0, 0.0])
        skin = skin[np.abs(skin[:, 1]) < 0.01]
        order = np.argsort(skin[:, 0])
        over = (np.abs(cloth[:, 0]) < 0.35 * SIDES) & (np.abs(cloth[:, 1]) < 0.01)
        height = np.interp(cloth[over, 0], skin[order, 0], skin[order, 2])
        deepest.append((height - cloth[over, 2]).max())
        places.append(np.concatenate(moved))
    assert max(deepest) < (0.002 if solver == "FULL" else 0.005) * size, max(deepest) / size
    jumps = np.linalg.norm(np.diff(places[-20:], 2, axis=0), axis=2)
    assert jumps.max() < 5e-4 * size, jumps.max() / size


def test_clothes_touch_parts_of_the_body_that_are_near_only_through_the_air():
    """They lie on the lower of two limbs, and the upper one, half of its thickness above them at rest, comes down."""
    body, clothes = blocks("FULL", held=True), block("FULL", True, high=0.06, above=0.002)
    overlap, top = 0.01, 0.062
    simulations = [dynamorph.Simulation(body.model, H, contact=body.contact), simulation_of(clothes)]
    simulations[0].start(posed_limbs(0.0), posed_limbs(0.0), np.ones(1))
    bodies = list(zip(simulations, [body.own, clothes.skin], strict=True))
    coupling = dynamorph.Coupling(bodies, garments=[(1, 0, np.eye(4)[:3])])
    for k in range(1, 61):
        down = (GAP - top + overlap) * min(1.0, k / 20)
        coupling.advance([motion(posed_limbs(down)), motion(posed())])
    moved = [s.model.displacement(made.coordinates) for s, made in zip((body, clothes), simulations, strict=True)]
    pressed_top = (np.abs(clothes.nodes[:, :2]) < 0.06).all(axis=1) & (np.abs(clothes.nodes[:, 2] - top) < 1e-6)
    left = overlap + moved[1][pressed_top, 2].mean() - moved[0][body.facing["upper"], 2].mean()
    assert abs(left) < 0.2 * overlap


def test_a_free_body_between_two_others_is_pressed_from_both_sides():
    """It comes to rest where the forces of both are equal."""
    below, between, above = block("FULL", False, held=True), block("FULL", True), block("FULL", True, held=True)
    bodies, overlap = (below, between, above), 0.01
    places = posed(), posed(GAP + overlap), posed(GAP + 2 * overlap - HIGH)
    simulations = [simulation_of(s, place) for s, place in zip(bodies, places, strict=True)]
    coupling = dynamorph.Coupling([(made, s.skin) for s, made in zip(bodies, simulations, strict=True)])
    for _ in range(150):
        reports = coupling.advance([motion(place) for place in places])
        forces = np.array([report.body_force for report in reports])
        assert all(report.converged for report in reports)
        assert np.abs(forces.sum(axis=0)).max() <= 1e-6 * np.abs(forces).max()
    assert forces[0, 2] < 0.0 < forces[2, 2]
    assert forces[2, 2] == pytest.approx(-forces[0, 2], rel=0.05)


def test_bodies_that_do_not_meet_move_as_they_do_alone():
    lower, upper = block("FULL", False, held=True), block("FULL", True, held=True)
    moved, _, simulations = pressed(lower, upper, 0.05, steps=20)
    alone = simulation_of(upper)
    for k in range(1, 21):
        alone.advance(posed(0.05 * (k / 20))[None], np.ones((1, 1)))
    assert np.array_equal(alone.coordinates, simulations[id(upper)].coordinates)
    assert not moved[0].any()


def test_it_goes_on_from_kept_states():
    lower, upper = block("REDUCED", False, held=True), block("REDUCED", True, held=True)
    bodies = lower, upper
    _, _, simulations = pressed(lower, upper, GAP + 0.02, steps=15)
    others = {id(s): simulation_of(s) for s in bodies}
    for s in bodies:
        others[id(s)].state = simulations[id(s)].state
    down = posed(GAP + 0.02)
    for each in (simulations, others):
        coupling = dynamorph.Coupling([(each[id(s)], s.skin) for s in bodies])
        coupling.advance([motion(down if s.upper else posed()) for s in bodies])
    for s in bodies:
        assert np.array_equal(simulations[id(s)].coordinates, others[id(s)].coordinates)


def test_what_does_not_fit_is_refused():
    lower, upper = block("FULL", False), block("FULL", True)
    one, other = simulation_of(lower), simulation_of(upper)
    kind = dynamorph.Coupling
    for bodies, text in (
        ([(one, lower.skin)], "two bodies"),
        ([(one, lower.skin), (one, lower.skin)], "each body must be there once"),
        ([(one, lower.skin), (other, lower.skin)], "that of its simulation's contact"),
    ):
        with pytest.raises(ValueError, match=text):
            kind(bodies)
    slower = dynamorph.Simulation(upper.model, 2 * H, contact=upper.contact)
    with pytest.raises(ValueError, match="time step"):
        kind([(one, lower.skin), (slower, upper.skin)])
    with pytest.raises(ValueError, match="friction"):
        kind([(one, lower.skin), (other, upper.skin)], -1.0)
    for garment in ((0, 0, posed()[0]), (0, 2, posed()[0]), (-1, 0, posed()[0]), (1, 0, np.nan * posed()[0])):
        with pytest.raises(ValueError, match="garments"):
            kind([(one, lower.skin), (other, upper.skin)], garments=[garment])
    coupling, before = kind([(one, lower.skin), (other, upper.skin)]), one.coordinates
    with pytest.raises(ValueError, match="of 2 bodies"):
        coupling.advance([motion(posed())])
    with pytest.raises(ValueError, match="weights"):  # the second one: the first has not moved
        coupling.advance([motion(posed(0.01)), (posed()[None], np.full((1, 1), 2.0), *[None] * 6)])
    assert np.array_equal(one.coordinates, before)
