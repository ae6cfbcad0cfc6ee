# SPDX-License-Identifier: GPL-3.0-or-later
"""Points of the skin: where a model puts them, what forces on them do, and springs that grab them."""

from __future__ import annotations

import dynamorph
import numpy as np
import pytest
from scenes import bar

NEUTRAL = np.array([1.0, 0.0])
STILL = np.stack([np.eye(3, 4)] * 2)


def bent(angle: float) -> np.ndarray:
    """The bar's two bones (2, 3, 4). The second has turned about y."""
    bones = STILL.copy()
    bones[1, :, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    bones[1, :, 3] = [0.02, 0.0, -0.01]
    return bones


def bar_models(
    material_model=dynamorph.MaterialModel.STABLE_STVK,
) -> tuple[dynamorph.FullModel, dynamorph.ReducedModel]:
    """A bar that is pinned at x = 0, of two targets, unreduced and in modes and responses."""
    nodes, tets = bar((6, 2, 2), (0.3, 0.1, 0.1))
    ones, along = np.ones(len(tets)), nodes[:, 0] / 0.3
    body = dynamorph.SoftBody(
        dynamorph.TetMesh(nodes, tets), ones, ones, ones[:, None], along < 1e-9, np.stack([1 - along, along], 1)
    )
    bulge = nodes * [0.0, 0.3, 0.3] * along[:, None]
    targets = [
        dynamorph.MorphTarget(
            name, shape, density=1000.0, stiffness_damping=0.01, mass_damping=2.0, lame_lambda=1.2e4, lame_mu=8e3
        )
        for name, shape in (("neutral", 0 * nodes), ("bulge", bulge))
    ]
    full = dynamorph.FullModel(body, targets, material_model, dynamorph.Blending.EVEN)
    tables = dynamorph.reduce(full, dynamorph.make_response_basis(full, 8, 20))
    return full, dynamorph.ReducedModel(body, targets, tables, dynamorph.Blending.EVEN)


FULL, REDUCED = bar_models()
POINTS = np.array([[0.29, 0.1, 0.1], [0.21, 0.05, 0.1], [0.1, 0.0, 0.03], [0.01, 0.02, 0.09]])
SKIN_WEIGHTS = np.array([[0.1, 0.9], [0.3, 0.7], [0.7, 0.3], [1.0, 0.0]])
RESIDUAL = np.random.default_rng(1).uniform(-0.01, 0.01, (2, 4, 3))


def skin_of(model):
    nodes, tets = bar((6, 2, 2), (0.3, 0.1, 0.1))
    embedding = dynamorph.embed(dynamorph.TetMesh(nodes, tets), POINTS)
    return dynamorph.Skin(model, POINTS, embedding, SKIN_WEIGHTS, RESIDUAL), embedding


def simulation_of(model, **options):
    made = dynamorph.Simulation(model, 1 / 120, **options)
    made.start(STILL, STILL, NEUTRAL)
    return made


@pytest.mark.parametrize("model", [FULL, REDUCED], ids=["full", "responses"])
def test_points_are_embedded_then_skinned(model):
    """Against the formula in NumPy, and Blender's order: shapes first, then linear blend skinning."""
    skin, embedding = skin_of(model)
    weights, q = np.array([0.3, 0.7]), np.random.default_rng(2).uniform(-0.01, 0.01, model.dofs)
    moved = np.einsum("pk,pkc->pc", embedding.weights, model.displacement(q)[embedding.nodes])
    bind = POINTS + moved + np.tensordot(weights, RESIDUAL, 1)
    matrices = np.tensordot(SKIN_WEIGHTS, bent(0.7), 1)
    expected = np.einsum("pij,pj->pi", matrices[..., :3], bind) + matrices[..., 3]
    assert skin.displacement(weights, q) == pytest.approx(bind - POINTS, abs=1e-15)
    assert skin.positions(bent(0.7), weights, q) == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize("model", [FULL, REDUCED], ids=["full", "responses"])
def test_forces_do_the_same_work_on_points_and_on_coordinates(model):
    skin, _ = skin_of(model)
    random = np.random.default_rng(3)
    forces, step = random.normal(size=(4, 3)), random.normal(size=model.dofs)
    here, there = (skin.positions(bent(0.7), NEUTRAL, q) for q in (np.zeros(model.dofs), step))
    assert (forces * (there - here)).sum() == pytest.approx(skin.pull_back(bent(0.7), forces) @ step, rel=1e-11)


@pytest.mark.parametrize("model", [FULL, REDUCED], ids=["full", "responses"])
def test_a_grabbed_point_is_held_in_the_world_while_its_bone_moves(model):
    """And the harder, the nearer: what is left is the spring's force over its stiffness."""
    left = []
    for stiffness in (300.0, 3e4):
        simulation, (skin, _) = simulation_of(model), skin_of(model)
        goal = skin.positions(STILL, NEUTRAL, simulation.coordinates)[[0]]
        bones = np.array([bent(0.2 * min(1.0, k / 60)) for k in range(1, 241)])
        grabs = dynamorph.Grabs(skin, [0], np.repeat(goal[None], 240, 0), [stiffness])
        report = simulation.advance(bones, np.repeat(NEUTRAL[None], 240, 0), grabs=grabs)
        assert report.converged
        left.append(np.linalg.norm(skin.positions(bones[-1], NEUTRAL, simulation.coordinates)[0] - goal[0]))
        free = skin.positions(bones[-1], NEUTRAL, np.zeros(model.dofs))[0]
        assert left[-1] < 0.5 * np.linalg.norm(free - goal[0])
    assert left[1] < 0.05 * left[0]


def test_ten_thousand_random_drags_stay_finite_and_leave_nothing_behind():
    """Goals that jump anywhere near the bar, with springs from soft to hard, and then nothing that pulls."""
    simulation, random = simulation_of(REDUCED), np.random.default_rng(7)
    rest, still, neutral = (
        simulation.coordinates.copy(),
        np.repeat(STILL[None], 100, 0),
        np.repeat(NEUTRAL[None], 100, 0),
    )
    for _ in range(100):
        goals = random.normal(scale=0.3, size=(100, 2, 3))
        pulls = dynamorph.Grabs(skin_of(REDUCED)[0], [0, 3], goals, 10.0 ** random.uniform(0.0, 5.0, 2))
        simulation.advance(still, neutral, grabs=pulls)
        assert np.isfinite(simulation.coordinates).all()
    for _ in range(15):
        simulation.advance(still, neutral)
    assert np.abs(simulation.coordinates - rest).max() < 1e-6


def test_springs_may_be_as_firm_as_each_step_says():
    """As in calls of one step each, and constant as given once; of no stiffness, as without any."""
    random, (skin, _) = np.random.default_rng(6), skin_of(REDUCED)
    bones, weights = np.repeat(STILL[None], 12, 0), np.repeat(NEUTRAL[None], 12, 0)
    goals, firm = random.normal(scale=0.1, size=(12, 2, 3)), 10.0 ** random.uniform(0.0, 4.0, (12, 2))
    at_once, one_by_one, once, each, none, free = (simulation_of(REDUCED) for _ in range(6))
    at_once.advance(bones, weights, grabs=dynamorph.Grabs(skin, [0, 3], goals, firm))
    for k in range(12):
        grab = dynamorph.Grabs(skin, [0, 3], goals[k : k + 1], firm[k])
        one_by_one.advance(bones[k : k + 1], weights[k : k + 1], grabs=grab)
    assert np.array_equal(at_once.coordinates, one_by_one.coordinates)
    once.advance(bones, weights, grabs=dynamorph.Grabs(skin, [0, 3], goals, firm[0]))
    each.advance(bones, weights, grabs=dynamorph.Grabs(skin, [0, 3], goals, np.repeat(firm[:1], 12, 0)))
    assert np.array_equal(once.coordinates, each.coordinates)
    none.advance(bones, weights, grabs=dynamorph.Grabs(skin, [0, 3], goals, np.zeros((12, 2))))
    free.advance(bones, weights)
    np.testing.assert_allclose(none.coordinates, free.coordinates, atol=1e-15)


@pytest.mark.parametrize("model", [FULL, REDUCED], ids=["full", "responses"])
def test_what_begins_with_a_grip_begins_in_balance_with_it(model):
    """Nothing moves as long as nothing else does, and the spring pulls as hard as the tissue does."""
    simulation, (skin, _) = simulation_of(model), skin_of(model)
    goal = skin.positions(STILL, NEUTRAL, np.zeros(model.dofs))[[0]] + [0.0, 0.0, 0.02]
    held = dynamorph.Grabs(skin, [0], goal[None], [300.0])
    assert simulation.start(STILL, STILL, NEUTRAL, grabs=held).converged
    begun = simulation.coordinates.copy()
    assert np.abs(begun).max() > 1e-4
    bones, weights = np.repeat(STILL[None], 48, 0), np.repeat(NEUTRAL[None], 48, 0)
    simulation.advance(bones, weights, grabs=dynamorph.Grabs(skin, [0], np.repeat(goal[None], 48, 0), [300.0]))
    np.testing.assert_allclose(simulation.coordinates, begun, atol=1e-6 * np.abs(begun).max())


def test_forces_may_differ_from_step_to_step():
    """As in calls of one step each, and the same at all steps as a constant force."""
    push = np.random.default_rng(5).normal(size=(12, len(FULL.displacement(np.zeros(FULL.dofs))), 3))
    bones, weights = np.repeat(STILL[None], 12, 0), np.repeat(NEUTRAL[None], 12, 0)
    at_once, one_by_one, constant, same = (simulation_of(REDUCED) for _ in range(4))
    at_once.advance(bones, weights, push)
    for k in range(12):
        one_by_one.advance(bones[k : k + 1], weights[k : k + 1], push[k])
    assert np.array_equal(at_once.coordinates, one_by_one.coordinates)
    constant.advance(bones, weights, push[0])
    same.advance(bones, weights, np.repeat(push[:1], 12, 0))
    assert np.array_equal(constant.coordinates, same.coordinates)
    assert not np.array_equal(constant.coordinates, at_once.coordinates)


def test_what_cannot_be_grabbed_is_refused():
    goals, (skin, _) = np.zeros((1, 1, 3)), skin_of(REDUCED)
    simulation = simulation_of(REDUCED)
    before = simulation.coordinates
    with pytest.raises(ValueError, match="grabs: expected points from 0 to 3, got 4"):
        simulation.advance(STILL[None], NEUTRAL[None], grabs=dynamorph.Grabs(skin, [4], goals, [1.0]))
    with pytest.raises(ValueError, match=r"grabs: goals: expected shape \(2, any, 3\), got \(1, 1, 3\)"):
        simulation.advance(
            np.repeat(STILL[None], 2, 0), np.repeat(NEUTRAL[None], 2, 0), grabs=dynamorph.Grabs(skin, [0], goals, [1.0])
        )
    for other in (FULL, bar_models()[1]):
        grabs = dynamorph.Grabs(skin_of(other)[0], [0], goals, [1.0])
        with pytest.raises(ValueError, match="grabs: the skin.* belongs to another model"):
            simulation.advance(STILL[None], NEUTRAL[None], grabs=grabs)
    assert np.array_equal(simulation.coordinates, before)
    with pytest.raises(ValueError, match="stiffness: must be finite and not negative"):
        dynamorph.Grabs(skin, [0], goals, [-1.0])
    with pytest.raises(ValueError, match="goals: must be finite"):
        dynamorph.Grabs(skin, [0], np.full((1, 1, 3), np.nan), [1.0])
