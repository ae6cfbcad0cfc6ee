# SPDX-License-Identifier: GPL-3.0-or-later
"""The energy of models with responses: the same along all axes, never negative, least where the full model's is."""

from dataclasses import dataclass
from functools import cache

import dynamorph
import numpy as np
import pytest
from scenes import bar
from scipy.spatial.transform import Rotation
from test_physics import BLENDINGS, MATERIAL_MODELS, bones, lame, simulation_of

EVEN, FORCES = dynamorph.Blending.EVEN, dynamorph.Blending.FORCES
STABLE = dynamorph.MaterialModel.STABLE_STVK
MODES, RESPONSES = 12, 40
H = 1 / 120
SIZE = 0.42 * 0.004**0.5  # the norm of coordinates that move the whole bar by its size
AT_REST = np.repeat(bones(), 3, axis=0)
TURN = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
MIRROR = np.diag([1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Character:
    """A body with its targets and their shapes (n, 3), and its full model."""

    body: dynamorph.SoftBody
    targets: list[dynamorph.MorphTarget]
    shapes: list[np.ndarray]
    full: dynamorph.FullModel
    blending: dynamorph.Blending

    def reduced(self, basis) -> dynamorph.ReducedModel:
        return dynamorph.ReducedModel(self.body, self.targets, dynamorph.reduce(self.full, basis), self.blending)


def character(material_model=STABLE, blending=EVEN, sets=1, turn=None, cells=(10, 3, 3)) -> Character:
    """A bar of 0.4 m on three bones with a hold, painted stiffness and three or four targets, all of it turned or
    mirrored by a matrix."""
    random = np.random.default_rng(7)
    nodes, tets = bar(cells, (0.4, 0.1, 0.1))
    count, along = len(tets), nodes[:, 0] / 0.4
    fill, stiffness = random.uniform(0.3, 1, count), np.exp(random.uniform(-0.5, 0.5, count))
    weights = np.stack([np.clip(1 - abs(2 * along - k), 0, 1) for k in range(3)], axis=1)
    bulge = (nodes - [0, 0.05, 0.05]) * [0, 1, 1] * (0.4 * np.sin(np.pi * along))[:, None]
    bend = np.stack([-0.03 * along**2, 0 * along, 0.08 * along**2], axis=1)
    shapes = [0 * nodes, bulge, bend] if sets == 1 else [0 * nodes, bulge, 0 * nodes, bend]
    second = np.clip((nodes[tets].mean(axis=1)[:, 0] / 0.4 - 0.3) / 0.4, 0, 1)
    regions = np.stack([1 - second, second], axis=1) if sets == 2 else np.ones((count, 1))
    if turn is not None:
        nodes, shapes = nodes @ turn.T, [shape @ turn.T for shape in shapes]
        if np.linalg.det(turn) < 0:
            tets = tets[:, [0, 2, 1, 3]]
    materials = [(2e4, 0.3, 900.0), (1.6e5, 0.4, 1100.0), (8e3, 0.2, 1000.0), (5e4, 0.35, 1050.0)]
    targets = [
        dynamorph.MorphTarget(
            f"t{j}", shape, density=rho, mass_damping=0.5 + 0.3 * j,
            stiffness_damping=0.002 * (1 + j), set=j // 2 if sets == 2 else 0, **lame(young, nu),
        )
        for j, (shape, (young, nu, rho)) in enumerate(zip(shapes, materials, strict=False))
    ]  # fmt: skip
    hold = random.uniform(0, 300, count)
    mesh = dynamorph.TetMesh(nodes, tets)
    body = dynamorph.SoftBody(mesh, fill, stiffness, regions, list(along < 1e-9), weights, hold)
    return Character(body, targets, shapes, dynamorph.FullModel(body, targets, material_model, blending), blending)


@cache
def default_bar(material_model=STABLE, blending=EVEN, sets=1):
    """A character, its model with 20 modes and 100 responses, that of the same modes alone, and both side by side."""
    bar = character(material_model, blending, sets)
    basis = dynamorph.make_response_basis(bar.full, 20, 100)
    return bar, bar.reduced(basis), bar.reduced(basis.U), np.hstack([basis.U, basis.W])


def turned(poses, turn):
    """Bone transforms (..., 3, 4) of the turned rig."""
    linear, moved = turn @ poses[..., :3] @ turn.T, poses[..., 3] @ turn.T
    return np.concatenate([linear, moved[..., None]], axis=-1)


def swing(steps, targets):
    """Bones (steps + 1, 3, 3, 4) that turn and shift, and weights (steps + 1, targets) that wander."""
    time = np.arange(steps + 1) * H
    angles = 0.25 * np.stack([0 * time, np.sin(9 * time), np.sin(7 * time)], axis=1)
    rig = np.array([[bones(Rotation.from_rotvec([0.3 * a, a, -0.5 * a]), (0, 0.1 * a, 0.05 * a))[0] for a in each]
                    for each in angles])  # fmt: skip
    k, m = 0.5 + 0.5 * np.sin(5 * time - 1), 0.5 + 0.5 * np.cos(6 * time)
    weights = [1 - k, k * (1 - m), k * m] if targets == 3 else [1 - k, k, 1 - m, m]
    return rig, np.stack(weights, axis=1)


def moved(turn, *options, steps=40):
    """Displacements (steps, n, 3) of the nodes of a body and its rig that are turned, seen as if they were not."""
    bar = character(*options, turn=turn, cells=(6, 2, 2))
    model = bar.reduced(dynamorph.make_response_basis(bar.full, MODES, RESPONSES))
    rig, weights = swing(steps, len(bar.targets))
    rig = turned(rig, turn)
    simulation = simulation_of(model, H, gravity=turn @ [0, 0, -9.81], tolerance=1e-12, max_iterations=100)
    simulation.start(rig[0], rig[1], weights[0])
    path = []
    for k in range(1, steps + 1):
        assert simulation.advance(rig[k : k + 1], weights[k : k + 1]).converged
        path.append(model.displacement(simulation.coordinates) @ turn)
    return np.array(path)


@pytest.mark.parametrize("sets", [1, 2])
@pytest.mark.parametrize("blending", BLENDINGS)
@pytest.mark.parametrize("material_model", MATERIAL_MODELS)
def test_motion_does_not_depend_on_the_axes_of_the_bind_pose(material_model, blending, sets):
    expected = moved(np.eye(3), material_model, blending, sets)
    for turn in (TURN, Rotation.from_euler("z", 90, degrees=True).as_matrix(), MIRROR, MIRROR @ TURN):
        found = moved(turn, material_model, blending, sets)
        assert np.abs(found - expected).max() <= 2e-6 * np.abs(expected).max()


@pytest.mark.parametrize("sets", [1, 2])
@pytest.mark.parametrize("blending", BLENDINGS)
@pytest.mark.parametrize("material_model", MATERIAL_MODELS)
def test_energy_is_never_negative(material_model, blending, sets):
    bar, model, *_ = default_bar(material_model, blending, sets)
    random = np.random.default_rng(3)
    modes = 20
    for _ in range(300):
        some = random.dirichlet([0.3] * (len(bar.targets) // sets), sets).ravel()
        near = sum(weight * model.target(j) for j, weight in enumerate(some))
        scales = 1 / np.sqrt(np.abs(np.diag(model.linearize(some, near)[2])))
        away = random.standard_normal(model.dofs) * scales
        q = near + 10 ** random.uniform(-4, 1) * SIZE * away / np.linalg.norm(away)
        q[modes:] *= random.choice([0.1, 1, 10])
        assert model.energy(some, q) >= 0
        q[modes:] = 0  # and where it is least in the responses
        energy, force, stiffness = model.linearize(some, q)
        q[modes:] = -force[modes:] / np.diag(stiffness)[modes:]
        assert model.energy(some, q) >= -1e-9 * energy


@pytest.mark.parametrize("steps", [1, 2, 5, 10, 20])
@pytest.mark.parametrize("blending", BLENDINGS)
def test_a_target_that_comes_within_a_few_steps_is_where_the_body_comes_to_rest(blending, steps):
    bar, model, *_ = default_bar(STABLE, blending)
    for target in (1, 2):
        simulation = simulation_of(model, H, max_iterations=100)
        simulation.start(AT_REST, AT_REST, np.eye(3)[0])
        part = np.minimum(np.arange(1, 2401) / steps, 1.0)[:, None]
        weights = (1 - part) * np.eye(3)[0] + part * np.eye(3)[target]
        assert simulation.advance(np.repeat(AT_REST[None], 2400, axis=0), weights).converged
        missed = model.displacement(simulation.coordinates) - bar.shapes[target]
        assert np.abs(missed).max() <= 1e-3 * bar.body.size
        assert abs(simulation.elastic_energy) <= 1e-6 * model.energy(np.eye(3)[target], model.target(0))


@pytest.mark.parametrize("material_model", [dynamorph.MaterialModel.STVK, STABLE])
def test_from_afar_the_body_comes_to_rest_at_its_shape_as_with_the_modes_alone(material_model):
    """Where a body is squeezed, modes soften; the condensed energy must have no minimum of its own there."""
    bar, model, modes, _ = default_bar(material_model)
    random = np.random.default_rng(1)
    for target in range(3):
        weights = np.eye(3)[target]
        for distance in (0.05, 0.1, 0.2):  # in the root mean square, of the body's size
            for _ in range(6):
                scales = 1 / np.sqrt(np.diag(modes.linearize(weights, modes.target(target))[2]))
                away = random.standard_normal(20) * scales
                away *= distance * SIZE / np.linalg.norm(away)
                missed = []
                for each in (modes, model):
                    simulation = simulation_of(each, H, max_iterations=200)
                    guess = each.target(target)
                    guess[:20] += away
                    found, _ = simulation.solve_static(AT_REST, weights, guess=guess)
                    missed.append(np.abs(each.displacement(found) - bar.shapes[target]).max())
                if missed[0] <= 1e-3 * bar.body.size:
                    assert missed[1] <= 1e-3 * bar.body.size


@pytest.mark.parametrize("weights", [(0.75, 0.25, 0), (0.5, 0.5, 0), (0.25, 0.75, 0), (0.5, 0, 0.5), (0.25, 0, 0.75),
                                     (0, 0.5, 0.5), (0.3, 0.3, 0.4)])  # fmt: skip
@pytest.mark.parametrize("material_model", MATERIAL_MODELS)
def test_between_targets_blended_forces_rest_where_the_full_model_does(material_model, weights):
    bar, model, *_ = default_bar(material_model, FORCES)
    shapes = []
    for each in (bar.full, model):
        found, report = simulation_of(each, H, tolerance=1e-9).solve_static(AT_REST, weights)
        assert report.converged
        shapes.append(each.displacement(found))
    assert np.abs(shapes[1] - shapes[0]).max() <= 0.002 * bar.body.size  # 0.12 before


def test_at_every_target_the_modes_are_as_stiff_as_with_all_responses_free():
    """Static answers to loads in the modes are those of the full model in the same coordinates."""
    bar, model, _, basis = default_bar()
    for target in range(3):
        weights = np.eye(3)[target]
        stiffness = bar.full.linearize(weights, bar.full.target(target))[2]
        exact = basis.T @ (stiffness @ basis)
        found = model.linearize(weights, model.target(target))[2]
        free = np.array([np.linalg.inv(each)[:20, :20] for each in (exact, found)])
        assert np.linalg.norm(free[1] - free[0]) <= 1e-6 * np.linalg.norm(free[0])
