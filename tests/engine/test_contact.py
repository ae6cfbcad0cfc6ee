# SPDX-License-Identifier: GPL-3.0-or-later
"""Contact with colliders against analytic solutions: weight, friction's cone, impact, Hertz, and bad starts."""

from __future__ import annotations

import itertools
import pickle
from types import SimpleNamespace

import dynamorph
import numpy as np
import pytest
from dynamorph import _mesher
from scenes import bar

ONE, STILL = np.ones(1), np.eye(3, 4)[None]
H = 1 / 96
GRAVITY = 9.81


def surface(tets):
    """The faces of one tet alone, outward."""
    faces = {}
    for tet in tets:
        for corners in ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)):
            face = tuple(tet[list(corners)])
            key = tuple(sorted(face))
            if faces.pop(key, None) is None:
                faces[key] = face
    return np.array(list(faces.values()))


def touching(nodes, tets, pinned, young=3e4, poisson=0.4, where=True, thickness=0.075, damping=0.004):
    """A body with all nodes of its skin as samples, or those of the nodes that `where` says."""
    s = SimpleNamespace(nodes=nodes, tets=tets)
    mesh, ones = dynamorph.TetMesh(nodes, tets), np.ones(len(tets))
    s.body = dynamorph.SoftBody(mesh, ones, ones, ones[:, None], pinned, np.ones((len(nodes), 1)))
    lame = {"lame_lambda": young * poisson / ((1 + poisson) * (1 - 2 * poisson)), "lame_mu": young / (2 + 2 * poisson)}
    s.target = dynamorph.MorphTarget("rest", 0 * nodes, density=1000.0, stiffness_damping=damping, **lame)
    s.model = dynamorph.FullModel(s.body, [s.target], dynamorph.MaterialModel.STABLE_STVK, dynamorph.Blending.EVEN)
    faces = surface(tets)
    normals = np.zeros_like(nodes)
    across = np.cross(nodes[faces[:, 1]] - nodes[faces[:, 0]], nodes[faces[:, 2]] - nodes[faces[:, 0]])
    np.add.at(normals, faces.ravel(), np.repeat(across, 3, axis=0))
    points = np.intersect1d(faces, np.flatnonzero(np.broadcast_to(where, len(nodes))))
    s.samples = {
        "rest": nodes[points], "embedding": dynamorph.embed(mesh, nodes[points]), "weights": np.ones((len(points), 1)),
        "normals": normals[points], "thickness": np.full(len(points), thickness),
    }  # fmt: skip
    s.contact = dynamorph.Contact(s.model, **s.samples)
    s.mass, s.size = 1000.0 * mesh.volumes.sum(), s.body.size
    return s


def block(cells=(4, 4, 2), **material):
    """A free block of 0.3 x 0.3 x 0.15 m, its lower face at z = 0."""
    nodes, tets = bar(cells, (0.3, 0.3, 0.15))
    return touching(nodes - [0.15, 0.15, 0.0], tets, np.zeros(len(nodes), bool), **material)


def simulated(made, distance=0.0, **options):
    """Begins at rest in its rest shape, whatever acts on it."""
    options = {"contact": made.contact, "distance": distance} | options
    simulation = dynamorph.Simulation(made.model, options.pop("h", H), **options)
    simulation.state = dynamorph.State([np.zeros(made.model.dofs)] * 4, [STILL.reshape(-1, 12)] * 4)
    return simulation


def placed(*shift):
    return np.hstack([np.eye(3), np.reshape(shift, (3, 1))])


def step(simulation, collider, places, friction=0.5):
    """Steps in which a collider goes from one place to the next."""
    moving = dynamorph.ColliderMotion(collider, np.array(places), friction)
    steps = len(places) - 1
    return simulation.advance(np.repeat(STILL[None], steps, 0), np.ones((steps, 1)), colliders=[moving])


def make_floor():
    return dynamorph.Collider([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], [[0, 1, 2], [0, 2, 3]], True)


@pytest.fixture(scope="module")
def floor():
    return make_floor()


def sphere(level):
    """Points and triangles on a unit sphere: an octahedron's faces, divided."""
    corners = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1.0]])
    triangles = [(k, (k + 1) % 4, 4) for k in range(4)] + [((k + 1) % 4, k, 5) for k in range(4)]
    faces = corners[np.array(triangles)]
    for _ in range(level):
        a, b, c = faces.transpose(1, 0, 2)
        d, e, f = a + b, b + c, c + a
        d, e, f = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (d, e, f))
        faces = np.concatenate([np.stack(corner, 1) for corner in ((a, d, f), (d, b, e), (f, e, c), (d, e, f))])
    points, index = np.unique(faces.reshape(-1, 3).round(12), axis=0, return_inverse=True)
    return points, index.reshape(-1, 3)


def ball(radius, level=3):
    points, triangles = sphere(level)
    return dynamorph.Collider(radius * points, triangles)


def test_a_block_comes_to_rest_on_its_weight(floor):
    """The floor carries the weight to 1e-5; the block is never deeper in it than 0.15 % of its size, and lies still."""
    made = block()
    simulation = simulated(made, gravity=(0, 0, -GRAVITY), tolerance=1e-9)
    kinetic, reports = [], []
    for _ in range(round(3 / H)):
        reports.append(step(simulation, floor, [placed(0, 0, -0.1)] * 2))
        kinetic.append(simulation.kinetic_energy)
    assert all(report.converged for report in reports)
    assert reports[-1].contact_forces[0, 2] == pytest.approx(-made.mass * GRAVITY, rel=1e-5)
    assert max(report.penetration for report in reports) <= 0.0015 * made.size
    assert 0 < reports[-1].penetration <= 0.0011 * made.size
    assert kinetic[-1] <= 1e-7 * max(kinetic)
    assert np.mean([report.iterations for report in reports]) <= 10


def test_without_friction_it_lies_still_to_the_last_digits_and_with_a_distance_it_floats(floor):
    made = block((5, 5, 3))
    simulation = simulated(made, 0.002 * made.size, gravity=(0, 0, -GRAVITY), tolerance=1e-9)
    kinetic, iterations, penetration = [], 0, 0.0
    for _ in range(round(3 / H)):
        report = step(simulation, floor, [placed(0, 0, -0.1)] * 2, 0.0)
        kinetic.append(simulation.kinetic_energy)
        iterations += report.iterations
        penetration = max(penetration, report.penetration)
    assert kinetic[-1] <= 1e-11 * max(kinetic)
    assert iterations <= 7 * len(kinetic)
    assert penetration == 0


@pytest.mark.parametrize("degrees", [20, 24, 28, 35])
def test_a_block_on_an_incline_sticks_or_slides_as_coulomb_says(floor, degrees):
    """With a friction of 0.5 it sticks up to 26.6 degrees; steeper, it slides with g (sin - 0.5 cos)."""
    made, angle = block(damping=0.02), np.radians(degrees)
    simulation = simulated(made, gravity=(GRAVITY * np.sin(angle), 0, -GRAVITY * np.cos(angle)))
    way = []
    for _ in range(round((1 if degrees > 26 else 2) / H)):
        assert step(simulation, floor, [placed(0, 0, 0)] * 2).converged
        way.append(made.model.displacement(simulation.coordinates)[:, 0].mean())
    speed = np.diff(way) / H
    if degrees < 26:
        assert abs(speed[-24:]).max() < 2e-5 * made.size  # it does not creep either
    else:
        slope = np.polyfit(H * np.arange(48), speed[-48:], 1)[0]
        assert slope == pytest.approx(GRAVITY * (np.sin(angle) - 0.5 * np.cos(angle)), rel=0.02)


def test_an_impact_keeps_the_momentum(floor):
    """A block in free flight: what the floor pushes is the change of its momentum, and its energy does not grow."""
    made = block()
    simulation = simulated(made, tolerance=1e-9)
    back = np.tile([0.0, 0.0, 1.0], made.model.dofs // 3)
    simulation.state = dynamorph.State([k * H * back for k in range(4)], simulation.state.bones)  # falls at 1 m/s
    began, push, energy, way = 0.5 * made.mass, 0.0, [], []
    for _ in range(40):
        report = step(simulation, floor, [placed(0, 0, -0.005)] * 2, 0.0)
        push -= H * report.contact_forces[0, 2]
        energy.append(simulation.kinetic_energy + simulation.elastic_energy)
        way.append(made.model.displacement(simulation.coordinates)[:, 2] @ made.body.volumes[:, 0] * 1000.0)
    assert max(energy) <= 1.001 * began
    assert report.contacts == 0
    rebound = (way[-1] - way[-2]) / H
    assert push == pytest.approx(made.mass + rebound, rel=0.02)


def graded(fine, step_size, far, count):
    near = np.arange(0, fine + step_size / 2, step_size)
    return np.concatenate([near, fine + (far - fine) * np.linspace(0, 1, count + 1)[1:] ** 1.5])


def test_a_ball_presses_as_hertz_says():
    """4/3 E / (1 - nu^2) sqrt(R) d^1.5 within 12 %, where the contact is wider than two elements. A step of ten
    seconds is a static answer.
    """
    half, radius = graded(0.1, 0.025, 0.6, 4), 0.3
    axes = [np.concatenate([-half[:0:-1], half])] * 2 + [-graded(0.075, 0.025, 0.6, 5)[::-1]]
    nodes, tets = bar(tuple(len(axis) - 1 for axis in axes), (1.0, 1.0, 1.0))
    numbers = np.round(nodes * [len(axis) - 1 for axis in axes]).astype(int)
    nodes = np.stack([axis[number] for axis, number in zip(axes, numbers.T, strict=True)], axis=1)
    near_top = (nodes[:, 2] > -1e-9) & (np.abs(nodes[:, :2]).max(axis=1) < 0.101)
    made = touching(nodes, tets, nodes[:, 2] < -0.6 + 1e-9, 1e4, 0.3, thickness=0.6, damping=0.0, where=near_top)
    simulation = simulated(made, h=10.0)
    collider, before = ball(radius, 5), radius + 0.001
    for depth in (0.012, 0.02):
        report = step(simulation, collider, [placed(0, 0, before), placed(0, 0, radius - depth)], 0.0)
        before = radius - depth
        hertz = 4 / 3 * 1e4 / (1 - 0.3**2) * radius**0.5 * depth**1.5
        assert report.converged
        assert report.contact_forces[0, 2] == pytest.approx(hertz, rel=0.12)
        assert report.penetration < 0.08 * depth


def make_belly():
    """An ellipsoid around a rigid core, 1 m long, its soft tissue 14 cm thick; its skin is finer around +x."""
    points, triangles = sphere(3)
    angle = np.arccos(np.clip(points[:, 0], -1, 1))
    nearer = 2 * np.arctan(np.tan(angle / 2) / 2.2)
    points[:, 0] = np.cos(nearer)
    points[:, 1:] *= (np.sin(nearer) / np.maximum(np.sin(angle), 1e-9))[:, None]
    axes = np.array([0.25, 0.2, 0.4])
    # The last bits of a cosine differ between machines, and with them the mesh.
    mesh = dynamorph.TetMesh(*_mesher.tetrahedralize(np.round(points * axes, 9), triangles, 1100))
    core = np.linalg.norm(mesh.nodes / axes, axis=1) < 0.45
    return touching(np.array(mesh.nodes), np.array(mesh.tets), core, 8e4, thickness=0.1375, damping=0.018)


@pytest.fixture(scope="module")
def belly():
    return make_belly()


def pressed(depth):
    """Where a ball of 5 cm is when it is so deep in the belly, meters."""
    return placed(0.25 + 0.05 - depth, 0, 0)


@pytest.mark.fault("X01")
def test_a_ball_that_appears_deep_inside_is_let_out(belly):
    """6 % of the size in one step: converged, and after 14 steps no deeper than 0.11 %."""
    collider, simulation = ball(0.05), simulated(belly)
    places = [pressed(0.06 * belly.size)] * 2
    reports = [step(simulation, collider, places) for _ in range(14)]
    assert all(report.converged for report in reports)
    assert reports[-1].penetration <= 0.0011 * belly.size
    assert reports[-1].contact_forces[0, 0] > 0  # out of the body
    assert reports[-1].too_deep == 0


def in_one(parts):
    """A mesh of several."""
    firsts = np.cumsum([0, *(len(points) for points, _ in parts[:-1])])
    triangles = [triangles + first for (_, triangles), first in zip(parts, firsts, strict=True)]
    return np.concatenate([points for points, _ in parts]), np.concatenate(triangles)


def fingers():
    """Three that press from the front, and a thumb against them."""
    points, triangles = sphere(2)
    places = [(0.26, 0, -0.1), (0.265, 0, 0), (0.26, 0, 0.1), (-0.265, 0, 0.02)]
    return [(points * [0.03, 0.12, 0.03] + place, triangles) for place in places]


def balls():
    points, triangles = sphere(3)
    return [(0.06 * points + [side * 0.285, 0.001, 0.002], triangles) for side in (-1, 1)]


@pytest.mark.parametrize("parts", [balls, fingers])
def test_one_collider_on_both_sides_presses_as_its_parts_do(belly, parts):
    """Two fingers in one mesh that pinch, and a hand that grips."""
    moved = []
    for meshes in ([in_one(parts())], parts()):
        simulation = simulated(belly)
        still = [
            dynamorph.ColliderMotion(dynamorph.Collider(*mesh), np.repeat(placed(0, 0, 0)[None], 9, 0), 0.5)
            for mesh in meshes
        ]
        report = simulation.advance(np.repeat(STILL[None], 8, 0), np.ones((8, 1)), colliders=still)
        assert report.converged and report.too_deep == 0
        moved.append(belly.model.displacement(simulation.coordinates))
    assert np.abs(moved[0]).max() > 0.01
    np.testing.assert_allclose(moved[0], moved[1], atol=1e-5)


@pytest.mark.parametrize("depth, thickness", [(0.01, 0.022), (0.03, 0.05), (0.03, 0.022)])
def test_skin_that_stands_on_a_floor_is_as_deep_as_it_was_lowered(floor, depth, thickness):
    """Also its edges, whose normals slant: along those the floor is much farther away."""
    nodes, tets = bar((4, 4, 2), (0.3, 0.3, 0.15))
    made = touching(nodes - [0.15, 0.15, 0.0], tets, nodes[:, 2] > 0.14, thickness=thickness)
    simulation = simulated(made)
    heights = [placed(0, 0, z) for z in np.r_[np.linspace(-0.001, depth, 12), [depth] * 6]]
    found = [step(simulation, floor, pair).too_deep for pair in itertools.pairwise(heights)]
    assert max(found) == pytest.approx(max(depth - 0.7 * thickness, 0.0), abs=1e-9)


@pytest.mark.fault("X04")
def test_where_the_bones_leave_no_room_it_gives_way_and_says_so(belly, floor):
    """Half of the body is under a floor: bounded, converged and reported."""
    simulation = simulated(belly)
    places = [placed(0, 0, z) for z in np.r_[np.linspace(-0.45, 0, 16), [0] * 24]]
    reports = []
    for pair in itertools.pairwise(places):
        reports.append(step(simulation, floor, pair, 0.0))
        assert np.abs(belly.model.displacement(simulation.coordinates)).max() < 0.15 * belly.size
    assert all(report.converged for report in reports)
    assert np.mean([report.iterations for report in reports]) <= 10
    deepest = max(reports, key=lambda report: report.too_deep)
    assert deepest.too_deep > 0.01
    assert deepest.too_deep_collider == 0
    assert belly.samples["rest"][deepest.too_deep_sample, 2] < 0
    assert reports[-1].penetration <= 0.002 * belly.size  # some have less than half of their weight


def test_contact_wins_over_the_largest_distance(belly):
    """Pressed by 2.5 times what a motion limit allows, the skin is not in the ball by more than 0.15 %."""
    mesh, count = dynamorph.TetMesh(belly.nodes, belly.tets), len(belly.nodes)
    limit = dynamorph.MotionLimit(
        belly.model,
        belly.nodes,
        dynamorph.embed(mesh, belly.nodes),
        surface(belly.tets).astype(np.int32),
        np.ones((count, 1)),
        np.full(count, 0.016),
    )
    collider = ball(0.05)
    places = [pressed(depth) for depth in np.r_[np.linspace(-0.001, 0.04, 16), [0.04] * 10]]
    depths = []
    for limited in (False, True):
        simulation = simulated(belly, limit=limit if limited else None)
        reports = [step(simulation, collider, pair) for pair in itertools.pairwise(places)]
        assert all(report.converged for report in reports)
        depths.append(max(report.penetration for report in reports))
    assert reports[-1].farthest > 1.5
    assert max(depths) <= 0.0015 * belly.size


def test_a_state_in_contact_resumes_to_the_last_bit(belly):
    collider = ball(0.05)
    places = [placed(0.27, 0, 0.05 * np.sin(0.1 * k)) for k in range(21)]
    whole, first, second = (simulated(belly, 0.001) for _ in range(3))
    step(whole, collider, places[:11])
    step(whole, collider, places[10:])
    step(first, collider, places[:11])
    assert first.state.contact.size > 0
    second.state = first.state
    step(second, collider, places[10:])
    for name in ("coordinates", "bones", "limit", "contact"):
        np.testing.assert_array_equal(getattr(second.state, name), getattr(whole.state, name))


@pytest.mark.parametrize("near", ["nobody", "out of action", "none"])
def test_a_step_with_nobody_near_is_the_same_to_the_last_bit(belly, near):
    plain, touched = (simulated(belly, gravity=(0, 0, -2)) for _ in range(2))
    bones = np.stack([placed(0.01 * np.sin(k), 0, 0)[None] for k in range(8)])
    plain.advance(bones, np.ones((8, 1)))
    place = placed(0.6 if near == "nobody" else 0.25, 0, 0)
    moving = dynamorph.ColliderMotion(ball(0.1, 2), np.repeat(place[None], 9, 0), 0.5, near != "out of action")
    report = touched.advance(bones, np.ones((8, 1)), colliders=[] if near == "none" else [moving])
    np.testing.assert_array_equal(touched.coordinates, plain.coordinates)
    assert report.contacts == 0


def make_few(belly):
    """The belly with 52 coordinates and 256 patches."""
    tables = dynamorph.reduce(belly.model, dynamorph.make_response_basis(belly.model, 12, 40))
    model = dynamorph.ReducedModel(belly.body, [belly.target], tables, dynamorph.Blending.EVEN)
    rest, centers = belly.samples["rest"], [0]
    away = np.linalg.norm(rest - rest[0], axis=1)
    while len(centers) < 256:  # those farthest from each other
        centers.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(rest - rest[centers[-1]], axis=1))
    basis = np.hstack([tables.basis, tables.responses])
    places = [belly.samples[name] for name in ("rest", "normals", "embedding")]
    return SimpleNamespace(
        model=model, basis=basis, local=dynamorph.LocalResponses(belly.model, basis, *places, centers)
    )


@pytest.fixture(scope="module")
def few(belly):
    return make_few(belly)


def simulated_few(belly, few, local):
    simulation = dynamorph.Simulation(few.model, H, contact=dynamorph.Contact(few.model, **belly.samples, local=local))
    simulation.start(STILL, STILL, ONE)
    return simulation


def test_what_was_found_is_not_found_again(belly, few):
    """Given what another has found, the points give way as those do; given half of it, less firmly."""
    found = dynamorph.Contact(few.model, **belly.samples, local=few.local).found
    forces = []
    for given in (None, found, found * [0.5, 0.5, 1.0]):
        contact = dynamorph.Contact(few.model, **belly.samples, local=few.local, found=given)
        simulation = dynamorph.Simulation(few.model, H, contact=contact)
        simulation.start(STILL, STILL, ONE)
        forces.append(np.linalg.norm(step(simulation, ball(0.05), [pressed(0.0), pressed(0.004)]).contact_forces))
    assert forces[0] == forces[1] > forces[2] > 0.0
    for bad in (found[:-1], found[:, :2], -found, np.full_like(found, np.nan)):
        with pytest.raises(ValueError, match="found"):
            dynamorph.Contact(few.model, **belly.samples, local=few.local, found=bad)


def test_local_responses_make_a_dent(belly, few):
    """Compared with the mesh, near the dent: the modes alone bend the whole body."""
    collider = ball(0.05)
    places = [pressed(depth) for depth in np.r_[np.linspace(-0.001, 0.01, 8), [0.01] * 24]]

    def dent(simulation):
        reports = [step(simulation, collider, pair) for pair in itertools.pairwise(places)]
        assert all(report.converged for report in reports)
        assert reports[-1].penetration <= 0.0011 * belly.size
        moved = simulation.coordinates
        if len(moved) == few.basis.shape[1]:
            moved = few.basis @ moved
        if len(simulation.dents):
            moved = moved + few.local.shapes @ simulation.dents
        return moved.reshape(-1, 3), np.linalg.norm(reports[-1].contact_forces)

    mesh, force = dent(simulated(belly))
    modes, patches = simulated_few(belly, few, None), simulated_few(belly, few, few.local)
    near = np.linalg.norm(mesh, axis=1) > 0.1 * np.linalg.norm(mesh, axis=1).max()
    (alone, _), (local, pressing) = dent(modes), dent(patches)
    assert np.linalg.norm((local - mesh)[near]) < 0.4 * np.linalg.norm(mesh[near])
    assert np.linalg.norm((local - mesh)[near]) < 0.2 * np.linalg.norm((alone - mesh)[near])
    assert pressing < 1.7 * force
    step(patches, collider, [placed(0.6, 0, 0)] * 2)
    assert not patches.dents.any()  # they have no past


@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
def test_how_far_a_search_looks_changes_nothing(belly, few, solver):
    """With a hand that holds nothing it looks four times as far from the skin."""
    model, local = (belly.model, {}) if solver == "FULL" else (few.model, {"local": few.local})
    rest, weights = belly.samples["rest"], belly.samples["weights"]
    skin = dynamorph.Skin(model, rest, belly.samples["embedding"], weights)
    collider, found = ball(0.05), []
    for searches in (False, True):
        contact = dynamorph.Contact(model, **belly.samples, **local)
        simulation = dynamorph.Simulation(model, H, contact=contact, distance=0.001)
        simulation.start(STILL, STILL, ONE)
        places = [pressed(depth) for depth in np.linspace(-0.004, 0.02, 12)]
        for pair in itertools.pairwise(places):
            grabs = dynamorph.Grabs(skin, [0], rest[None, :1], [0.0]) if searches else None
            moving = dynamorph.ColliderMotion(collider, np.array(pair), 0.3)
            simulation.advance(STILL[None], np.ones((1, 1)), colliders=[moving], grabs=grabs)
        found.append((simulation.coordinates, simulation.dents))
    for narrow, wide in zip(*found, strict=True):
        assert len(narrow) == 0 or np.abs(narrow).max() > 0
        np.testing.assert_allclose(wide, narrow, rtol=0, atol=1e-9 * np.abs(narrow).max(initial=1e-300))


def test_patches_are_the_same_at_any_size(belly, few):
    """Where most places are centers, and places lie as near to one of them as to another."""
    rest, tenth = belly.samples["rest"].round(3), len(belly.samples["rest"]) // 10
    core = np.linalg.norm(belly.nodes / [0.25, 0.2, 0.4], axis=1) < 0.45
    for centers in (range(7 * tenth), range(len(rest))):
        both = []
        for scale in (1.0, 0.02):
            made = touching(scale * belly.nodes, belly.tets, core, 8e4 * scale**2)  # of the same frequencies
            places = scale * rest, belly.samples["normals"], belly.samples["embedding"]
            local = dynamorph.LocalResponses(made.model, few.basis, *places, list(centers))
            both.append((local.stiffness, scale**1.5 * local.shapes))
        for whole, small in zip(*both, strict=True):
            np.testing.assert_allclose(small, whole, rtol=0, atol=1e-6 * np.abs(whole).max())


def test_patches_go_to_another_process(few):
    there = pickle.loads(pickle.dumps(few.local))
    np.testing.assert_array_equal(there.shapes, few.local.shapes)
    np.testing.assert_array_equal(there.stiffness, few.local.stiffness)
    good = few.local.__getstate__()
    assert all(np.array_equal(*both) for both in zip(there.__getstate__(), good, strict=True))
    for bad in bad_states(good):
        with pytest.raises(ValueError, match=r"state: |centers: |normals: |stiffness: |farthest|such node"):
            dynamorph.LocalResponses.__new__(dynamorph.LocalResponses).__setstate__(bad)


def bad_states(good):
    """States of patches that are no such state: cut off, and each part of another kind, size or value."""
    yield ()
    yield good[:5]
    for k, part in enumerate(good):
        wrong = ["text", None]
        if isinstance(part, np.ndarray):
            wrong += [part[:-1], np.full(part.shape, np.nan)]
        elif isinstance(part, list):
            wrong += [part[:-1], [-1, *part[1:]], [2**30, *part[1:]]]
        for each in wrong:
            # How many rows of shapes and shear there are, the model knows: Contact compares them.
            if not (isinstance(each, np.ndarray) and k in (4, 7) and len(each) < len(part)):
                yield (*good[:k], each, *good[k + 1 :])


def test_a_state_with_dents_resumes_to_the_last_bit(belly, few):
    collider = ball(0.05)
    places = [pressed(depth) for depth in np.linspace(-0.001, 0.02, 21)]
    whole, first, second = (simulated_few(belly, few, few.local) for _ in range(3))
    step(whole, collider, places[:11])
    step(whole, collider, places[10:])
    step(first, collider, places[:11])
    second.state = first.state
    step(second, collider, places[10:])
    assert second.dents.any()
    np.testing.assert_array_equal(second.dents, whole.dents)
    np.testing.assert_array_equal(second.coordinates, whole.coordinates)
    parts = {name: getattr(whole.state, name) for name in ("coordinates", "bones", "limit", "contact", "dents")}
    for wrong, error in ((np.zeros(3), "dents of 256 patches, got 3"), (np.full(256, np.nan), "not a finite number")):
        with pytest.raises((ValueError, dynamorph.Error), match=error):
            second.state = dynamorph.State(**parts | {"dents": wrong})


def test_what_lies_in_its_dents_hardly_iterates(belly, few):
    """A step begins with the dents of the step before."""
    simulation = simulated_few(belly, few, few.local)
    flat = dynamorph.Collider(0.5 * np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]), [[0, 2, 1], [0, 3, 2]])
    places = [placed(x, 0, 0) for x in np.r_[np.linspace(0.251, 0.235, 20), [0.235] * 100]]
    reports = [step(simulation, flat, pair) for pair in itertools.pairwise(places)]
    assert reports[-1].contacts > 20
    assert reports[-1].iterations <= 3
    parts = {name: getattr(simulation.state, name) for name in ("coordinates", "bones", "limit", "contact")}
    simulation.state = dynamorph.State(**parts)
    assert step(simulation, flat, places[-2:]).iterations > 3


def test_a_reduced_model_is_pushed_out_too(belly, few):
    """Its modes are global: without local responses it cannot make a dent, but they keep its skin outside."""
    simulation = simulated_few(belly, few, None)
    collider = ball(0.05)
    places = [pressed(depth) for depth in np.r_[np.linspace(-0.001, 0.01, 8), [0.01] * 24]]
    reports = [step(simulation, collider, pair) for pair in itertools.pairwise(places)]
    assert all(report.converged for report in reports)
    assert reports[-1].contacts > 0
    assert reports[-1].penetration <= 0.0011 * belly.size
    assert np.mean([report.iterations for report in reports]) <= 10


def test_what_does_not_fit_is_refused(belly, few, floor):
    simulation = simulated(belly)
    moving = dynamorph.ColliderMotion(floor, np.repeat(placed(0, 0, 0)[None], 3, 0))
    with pytest.raises(ValueError, match="expected the motion of 1 steps, got 2"):
        simulation.advance(STILL[None], np.ones((1, 1)), colliders=[moving])
    plain = dynamorph.Simulation(belly.model, H)
    plain.start(STILL, STILL, ONE)
    with pytest.raises(ValueError, match="no samples that can touch them"):
        step(plain, floor, [placed(0, 0, 0)] * 2)
    with pytest.raises(ValueError, match="samples belong to another model"):
        simulated(belly, contact=block().contact)
    with pytest.raises(ValueError, match="contact: it belongs to another model"):
        simulated(belly, contact=dynamorph.Contact(few.model, **belly.samples))
    with pytest.raises(ValueError, match="distance: must be finite"):
        simulated(belly, -1.0)
    with pytest.raises(ValueError, match="not one that a simulation had"):
        past = simulation.state.coordinates, simulation.state.bones
        simulation.state = dynamorph.State(*past, contact=np.array([1.0, 0.0, 2.0]))
    lost = simulated(belly)
    report = step(lost, floor, [placed(0, 0, 0), placed(np.nan, 0, 0)])
    assert report.unusable_colliders == [0] and report.converged


def doubled(triangles, kind):
    """A mesh's triangles with some of them twice."""
    turned = triangles[:, ::-1]
    return {
        "reversed": np.concatenate([triangles, turned]),
        "reversed first": np.concatenate([turned, triangles]),
        "same side": np.concatenate([triangles, triangles]),
        "some": np.concatenate([triangles, turned[::3]]),
    }[kind]


@pytest.mark.parametrize("kind", ["reversed", "reversed first", "same side", "some", "reversed, own vertices"])
def test_faces_that_are_there_twice_press_once(belly, kind):
    """As the collider without them does, also where it is called one-sided, as Blender's are by default."""
    points, triangles = sphere(3)
    twice, corners = points, triangles
    if kind.endswith("own vertices"):
        twice, corners = in_one([(points, triangles), (points, triangles[:, ::-1])])
    else:
        corners = doubled(triangles, kind)
    one_sided = kind != "same side"
    moved, forces = [], []
    for collider in (
        dynamorph.Collider(0.05 * points, triangles),
        dynamorph.Collider(0.05 * twice, corners),
        dynamorph.Collider(0.05 * twice, corners, one_sided),
    ):
        simulation = simulated(belly)
        places = [placed(0.3 - depth, 0.0031, 0.0042) for depth in (-0.001, 0.004, 0.009, 0.014)]
        report = step(simulation, collider, places)
        moved.append(belly.model.displacement(simulation.coordinates))
        forces.append(report.contact_forces)
    for k in (1, 2):
        np.testing.assert_allclose(forces[k], forces[0], rtol=1e-9)
        np.testing.assert_allclose(moved[k], moved[0], atol=1e-9)


@pytest.mark.parametrize("one_sided", [False, True])
def test_an_open_sheet_with_both_sides_modeled_presses_from_both(belly, one_sided):
    corners, faces = np.array([[0, -9, -9], [0, 9, -9], [0, 9, 9], [0, -9, 9.0]]), np.array([[0, 1, 2], [0, 2, 3]])
    for side in (1, -1):
        collider = dynamorph.Collider(side * corners, doubled(faces, "reversed"), one_sided)
        simulation = simulated(belly)
        report = step(
            simulation, collider, [placed(side * (0.25 - depth), 0, 0) for depth in (-0.005, 0.0, 0.005, 0.01)]
        )
        assert side * report.contact_forces[0, 0] > 10
        assert report.penetration < 0.0015 * belly.size


@pytest.fixture(scope="module")
def bed():
    """Its surface at z = 0."""
    corners = np.array(list(itertools.product([-2, 2], [-2, 2], [-1, 0.0])))
    faces = [[0, 2, 6, 4], [1, 5, 7, 3], [0, 4, 5, 1], [2, 3, 7, 6], [0, 1, 3, 2], [4, 6, 7, 5]]
    return dynamorph.Collider(corners, [face[k : k + 2] + face[:1] for face in faces for k in (1, 2)])


def lies(simulation, collider, places, deforming=None):
    """Where it begins on a collider, and how far each of the steps after that moves any coordinate."""
    path = np.array(places if deforming is None else deforming)

    def motion(steps):
        return [dynamorph.ColliderMotion(collider, np.repeat(path, steps + 1, axis=0), 0.5)]

    begun = simulation.start(STILL, STILL, ONE, motion(1))
    moved = [simulation.coordinates]
    for _ in range(8):
        report = simulation.advance(STILL[None], ONE[None], colliders=motion(1))
        moved.append(simulation.coordinates)
    return begun, report, np.abs(np.diff(moved, axis=0)).max()


@pytest.mark.parametrize("deforms", [False, True])
@pytest.mark.parametrize("depth", [0.015, 0.03])
def test_what_begins_in_a_bed_lies_there(belly, bed, depth, deforms):
    """Settled with what it touches, it does not move in the steps that follow, and is not called too deep."""
    simulation = dynamorph.Simulation(belly.model, H, contact=belly.contact, gravity=(0, 0, -GRAVITY))
    low = belly.nodes[:, 2].min() + depth
    corners = np.array(list(itertools.product([-2, 2], [-2, 2], [low - 1, low])))
    begun, report, moved = lies(simulation, bed, [placed(0, 0, low)], [corners] if deforms else None)
    assert begun.converged and begun.contacts > 0 and begun.too_deep == 0
    assert begun.penetration <= 0.0011 * belly.size
    assert moved < 1e-4 * belly.size
    np.testing.assert_allclose(begun.contact_forces, report.contact_forces, rtol=0.02, atol=0.5)


def test_what_begins_with_a_ball_in_it_is_dented(belly):
    simulation = dynamorph.Simulation(belly.model, H, contact=belly.contact)
    begun, report, moved = lies(simulation, ball(0.05), [pressed(0.04 * belly.size)])
    assert begun.converged and begun.contact_forces[0, 0] > 0
    assert moved < 1e-4 * belly.size
    assert report.penetration <= 0.0011 * belly.size


def test_a_reduced_model_begins_with_its_dents(belly, few, bed):
    contact = dynamorph.Contact(few.model, **belly.samples, local=few.local)
    simulation = dynamorph.Simulation(few.model, H, contact=contact)
    begun, report, moved = lies(simulation, bed, [placed(0, 0, belly.nodes[:, 2].min() + 0.02)])
    assert begun.converged and report.converged and simulation.dents.any()
    assert moved < 0.02 * np.abs(simulation.coordinates).max()


def test_with_nothing_near_it_begins_as_without_colliders(belly, bed):
    begun = []
    for colliders in (None, [dynamorph.ColliderMotion(bed, np.repeat(placed(0, 0, -3)[None], 2, 0))]):
        simulation = dynamorph.Simulation(belly.model, H, contact=belly.contact, gravity=(0, 0, -GRAVITY))
        simulation.start(STILL, STILL, ONE, colliders)
        begun.append(simulation.coordinates)
    np.testing.assert_array_equal(*begun)
    with pytest.raises(ValueError, match="colliders: steps: expected 1"):
        simulation.start(STILL, STILL, ONE, [dynamorph.ColliderMotion(bed, np.repeat(placed(0, 0, 0)[None], 3, 0))])
