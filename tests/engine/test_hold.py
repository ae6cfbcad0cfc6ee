# SPDX-License-Identifier: GPL-3.0-or-later
"""The hold as a continuous energy, and the thickness that it comes from."""

import dynamorph
import numpy as np
import pytest
from scenes import bar
from scipy.spatial import KDTree
from test_physics import BLENDINGS, MATERIAL_MODELS, bones, lame

CELLS, SIZE = (4, 2, 2), (0.4, 0.2, 0.2)


def held_bar(material_model, blending, hold=200.0, sets=1, cells=CELLS, seed=3):
    """A bar that nothing but the hold keeps in place: neutral, and a target of another shape and stiffness."""
    nodes, tets = bar(cells, SIZE)
    regions = np.full((len(tets), sets), 1.0 / sets)
    ones = np.ones(len(tets))
    fields = hold * (1.0 + nodes[tets].mean(axis=1)[:, 0])
    mesh = dynamorph.TetMesh(nodes, tets)
    body = dynamorph.SoftBody(mesh, ones, ones, regions, np.zeros(len(nodes), bool), np.ones((len(nodes), 1)), fields)
    shape = 0.02 * np.sin(5.0 * nodes @ np.random.default_rng(seed).normal(size=(3, 3)))
    targets = [
        dynamorph.MorphTarget(name, d, density=1000.0, set=s, **lame(young, 0.3))
        for s in range(sets)
        for name, d, young in ((f"rest {s}", 0.0 * nodes, 2e4), (f"shaped {s}", shape, 9e4))
    ]
    return dynamorph.FullModel(body, targets, material_model, blending), shape, mesh, fields


@pytest.mark.parametrize("blending", BLENDINGS)
@pytest.mark.parametrize("material_model", MATERIAL_MODELS)
def test_force_and_stiffness_are_derivatives_of_the_energy(material_model, blending):
    model, *_ = held_bar(material_model, blending)
    random, weights = np.random.default_rng(0), np.array([0.3, 0.7])
    q, direction = 0.01 * random.normal(size=(2, model.dofs))
    _, force, stiffness = model.linearize(weights, q)
    step = 1e-5

    def slope(of):
        return (of(q + step * direction) - of(q - step * direction)) / (2.0 * step)

    assert slope(lambda x: model.energy(weights, x)) == pytest.approx(force @ direction, rel=1e-6)
    along = slope(lambda x: model.linearize(weights, x)[1])
    assert along == pytest.approx(stiffness @ direction, abs=1e-6 * np.abs(along).max())


@pytest.mark.parametrize("blending", BLENDINGS)
@pytest.mark.parametrize("material_model", MATERIAL_MODELS)
def test_targets_stay_exact(material_model, blending):
    """Each target's shape has no energy and no force at its own weight."""
    model, shape, *_ = held_bar(material_model, blending)
    for j, d in enumerate((0.0 * shape, shape)):
        weights = np.eye(2)[j]
        energy, force, stiffness = model.linearize(weights, d.ravel())
        scale = np.abs(stiffness).max() * np.abs(shape).max()
        assert abs(energy) < 1e-12 * scale and np.abs(force).max() < 1e-12 * scale


@pytest.mark.parametrize("material_model", MATERIAL_MODELS)
def test_even_blending_is_halfway_in_shape(material_model):
    model, shape, *_ = held_bar(material_model, dynamorph.Blending.EVEN)
    simulation = dynamorph.Simulation(model, 1e-2)
    found, report = simulation.solve_static(bones(), np.array([0.5, 0.5]), np.zeros_like(shape))
    assert report.converged
    assert found == pytest.approx(0.5 * shape.ravel(), abs=1e-6 * np.abs(shape).max())


@pytest.mark.parametrize("blending", BLENDINGS)
@pytest.mark.parametrize("material_model", MATERIAL_MODELS)
def test_the_reduced_model_has_the_same_hold(material_model, blending):
    """In the span of its basis, at any weights, also of overlapping sets; and after materials have changed."""
    sets = 2 if blending == dynamorph.Blending.EVEN else 1
    model, shape, *_ = held_bar(material_model, blending, sets=sets)
    basis = dynamorph.make_basis(model, 8).U
    tables = dynamorph.reduce(model, basis)
    random = np.random.default_rng(1)
    weights = np.tile([0.4, 0.6], sets)
    softer = [
        dynamorph.MorphTarget(f"{j}", (j % 2) * shape, density=1000.0, set=j // 2, **lame(3e3 * (1 + j), 0.45))
        for j in range(2 * sets)
    ]
    again = dynamorph.FullModel(model.body, softer, material_model, blending)
    for full, targets in ((model, model_targets(shape, sets)), (again, softer)):
        reduced = dynamorph.ReducedModel(model.body, targets, tables, blending)
        z = 0.02 * random.normal(size=basis.shape[1])
        energy, force, stiffness = full.linearize(weights, basis @ z)
        small_energy, small_force, small_stiffness = reduced.linearize(weights, z)
        assert small_energy == pytest.approx(energy, rel=2e-6)
        projected = basis.T @ force
        assert small_force == pytest.approx(projected, abs=2e-6 * np.abs(projected).max())
        projected = basis.T @ stiffness @ basis
        assert small_stiffness == pytest.approx(projected, abs=2e-6 * np.abs(projected).max())


def model_targets(shape, sets):
    return [
        dynamorph.MorphTarget(name, d, density=1000.0, set=s, **lame(young, 0.3))
        for s in range(sets)
        for name, d, young in ((f"rest {s}", 0.0 * shape, 2e4), (f"shaped {s}", shape, 9e4))
    ]


def test_the_energy_is_the_integral():
    """Of hold mu / 2 |u|^2 over the body, for a displacement that strains nothing."""
    model, _, mesh, fields = held_bar(dynamorph.MaterialModel.LINEAR, dynamorph.Blending.EVEN)
    shift = np.array([0.01, -0.02, 0.03])
    mu = lame(2e4, 0.3)["lame_mu"]
    expected = 0.5 * mu * (fields * mesh.volumes).sum() * (shift**2).sum()
    assert model.energy(np.array([1.0, 0.0]), np.tile(shift, len(mesh.nodes))) == pytest.approx(expected, rel=1e-12)


def test_the_frequency_of_what_only_the_hold_keeps():
    """Moving as a whole: omega^2 = mu hold / rho where the hold is the same everywhere."""
    nodes, tets = bar(CELLS, SIZE)
    ones, hold = np.ones(len(tets)), np.full(len(tets), 50.0)
    mesh = dynamorph.TetMesh(nodes, tets)
    none = np.zeros(len(nodes), bool)
    body = dynamorph.SoftBody(mesh, ones, ones, ones[:, None], none, np.ones((len(nodes), 1)), hold)
    target = dynamorph.MorphTarget("rest", 0.0 * nodes, density=900.0, **lame(1e5, 0.2))
    model = dynamorph.FullModel(body, [target], dynamorph.MaterialModel.LINEAR, dynamorph.Blending.EVEN)
    omega, _ = model.linear_modes(0, 4)
    assert omega[:3] == pytest.approx(np.sqrt(lame(1e5, 0.2)["lame_mu"] * 50.0 / 900.0), rel=1e-6)


def test_the_static_answer_converges_with_the_mesh():
    """Half the error or less at twice the resolution, of a bar that is held in its left half, under its weight."""
    answers = []
    for k in (1, 2, 4, 8):
        nodes, tets = bar(tuple(k * c for c in (4, 1, 1)), SIZE)
        ones = np.ones(len(tets))
        points = np.einsum("qa,eac->eqc", np.full((4, 4), 0.138) + 0.447 * np.eye(4), nodes[tets])[:, :, 0]
        hold = (4e3 * np.clip((0.25 - points) / 0.1, 0.0, 1.0)).mean(axis=1)
        mesh = dynamorph.TetMesh(nodes, tets)
        none = np.zeros(len(nodes), bool)
        body = dynamorph.SoftBody(mesh, ones, ones, ones[:, None], none, np.ones((len(nodes), 1)), hold)
        target = dynamorph.MorphTarget("rest", 0.0 * nodes, density=1000.0, **lame(5e4, 0.2))
        model = dynamorph.FullModel(body, [target], dynamorph.MaterialModel.LINEAR, dynamorph.Blending.EVEN)
        weight = 1000.0 * 9.81 * body.volumes.sum(axis=1)[:, None] * np.array([0.0, 0.0, -1.0])
        found, _ = dynamorph.Simulation(model, 1e-2).solve_static(bones(), np.ones(1), weight)
        answers.append(found.reshape(-1, 3)[KDTree(nodes).query([0.4, 0.1, 0.1])[1], 2])
    errors = np.abs(np.array(answers[:-1]) - answers[-1]) / abs(answers[-1])
    assert errors[1] < 0.6 * errors[0] and errors[2] < 0.5 * errors[1]


@pytest.mark.parametrize(
    ("count", "value", "text"), [(3, 1.0, "hold: expected"), (None, -1.0, "not negative"), (None, np.nan, "finite")]
)
def test_a_bad_hold_is_refused(count, value, text):
    nodes, tets = bar(CELLS, SIZE)
    hold = np.full(count or len(tets), value)
    ones, none = np.ones(len(tets)), np.zeros(len(nodes), bool)
    mesh = dynamorph.TetMesh(nodes, tets)
    with pytest.raises(ValueError, match=text):
        dynamorph.SoftBody(mesh, ones, ones, ones[:, None], none, np.ones((len(nodes), 1)), hold)


# Thickness ---------------------------------------------------------------------------------------------------------


def capsule(radius=0.5, length=4.0, rings=32, around=32, squash=1.0):
    """A closed surface of revolution about z: a tube with round ends, or flattened along y."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, rings)
    z = radius * np.sin(angle) + np.where(angle > 0, 0.5, -0.5) * length
    r = radius * np.cos(angle)
    turn = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    points = np.stack(
        [np.outer(r, np.cos(turn)), squash * np.outer(r, np.sin(turn)), np.outer(z, np.ones(around))], axis=2
    ).reshape(-1, 3)
    faces = []
    for i in range(rings - 1):
        for j in range(around):
            a, b = i * around + j, i * around + (j + 1) % around
            faces += [[a, b, b + around], [a, b + around, a + around]]
    return points, np.array(faces)


def test_thickness_of_a_capsule():
    """Its radius everywhere, inside and out; and the depth below the skin."""
    points, faces = capsule()
    thickness = dynamorph.Thickness(points, faces)
    at = np.array([[0, 0, 0], [0.3, 0, 1], [0, -0.49, -1.7], [0.8, 0, 0], [0, 0, 2.3]], float)
    radius, depth = thickness.at(at)
    assert radius == pytest.approx(0.5, rel=0.03)
    assert depth == pytest.approx([0.5, 0.2, 0.01, 0.0, 0.2], abs=0.01)


def test_thin_parts_are_thin_beside_thick_ones():
    """A finger on a ball, in one surface soup that overlaps; what is inside does not count."""
    ball, ball_faces = capsule(1.0, 1e-6)
    finger, finger_faces = capsule(0.1, 3.0)
    eye, eye_faces = capsule(0.3, 1e-6)
    points = np.concatenate([ball, finger + np.array([0.0, 0.0, 1.5]), eye])
    faces = np.concatenate([ball_faces, finger_faces + len(ball), eye_faces + len(ball) + len(finger)])
    thickness = dynamorph.Thickness(points, faces)
    radius, _ = thickness.at(np.array([[0.0, 0.0, 0.0], [0.7, 0.0, 0.0], [0.0, 0.0, 2.5], [0.1, 0.0, 2.9]]))
    assert radius == pytest.approx([1.0, 1.0, 0.1, 0.1], rel=0.1)


def test_thickness_is_continuous_and_scales():
    points, faces = capsule(1.0, 1e-6)
    finger, finger_faces = capsule(0.1, 3.0)
    points = np.concatenate([points, finger + np.array([0.0, 0.0, 1.5])])
    faces = np.concatenate([faces, finger_faces + len(points) - len(finger)])
    along = np.column_stack([np.zeros((400, 2)), np.linspace(0.0, 3.0, 400)])
    radius, _ = dynamorph.Thickness(points, faces).at(along)
    assert np.abs(np.diff(radius)).max() < 0.05
    larger, _ = dynamorph.Thickness(30.0 * points, faces).at(30.0 * along)
    assert larger == pytest.approx(30.0 * radius, rel=1e-6)


def test_a_sheet_is_thin():
    """Open, so that it is capped: no ball lies in it, whichever way it faces."""
    side = np.linspace(0.0, 1.0, 12)
    points = np.array([[x, y, 0.2 * np.sin(3.0 * x)] for x in side for y in side])
    quads = [(12 * i + j, 12 * i + j + 1, 12 * i + j + 13, 12 * i + j + 12) for i in range(11) for j in range(11)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    for turned in (faces, faces[:, ::-1]):
        radius, _ = dynamorph.Thickness(points, turned).at(points)
        assert np.median(radius) < 0.12


def test_thickness_in_no_order():
    """The same numbers in every run, on any number of cores."""
    points, faces = capsule(0.4, 2.0, squash=0.6)
    at = np.random.default_rng(0).uniform(-1.0, 1.0, (200, 3))
    found = []
    for cores in (1, 2):
        dynamorph.set_threads(cores)
        found.append(dynamorph.Thickness(points, faces).at(at))
    dynamorph.set_threads(0)
    assert np.array_equal(found[0], found[1])
