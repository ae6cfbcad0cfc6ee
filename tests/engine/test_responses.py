# SPDX-License-Identifier: GPL-3.0-or-later
"""Models with many linear responses beside few tabulated modes, as Python sees them."""

import hashlib

import dynamorph
import numpy as np
import pytest
import test_physics
from test_instruction_sets import available
from test_physics import BLENDINGS, FLEXED, MATERIAL_MODELS, TWO_BONES
from test_threads import run

MODES, RESPONSES = 10, 24


def with_responses(material_model, blending, cells=(8, 2, 2)):
    """The sculpted bar in modes and responses; (model, targets, full model, basis, tables)."""
    body, targets, _ = test_physics.sculpture(cells=cells)
    full = dynamorph.FullModel(body, targets, material_model, blending)
    basis = dynamorph.make_response_basis(full, MODES, RESPONSES)
    tables = dynamorph.reduce(full, basis)
    return dynamorph.ReducedModel(body, targets, tables, blending), targets, full, basis, tables


def tables_like(tables, **changes):
    """The same tables with some of their arrays changed."""
    given = {
        "material_model": tables.material_model,
        "basis": tables.basis,
        "lame_lambda": tables.lame_lambda,
        "lame_mu": tables.lame_mu,
        "responses": tables.responses,
        "response_lambda": tables.response_lambda,
        "response_mu": tables.response_mu,
        "relaxation": tables.relaxation,
    }
    return dynamorph.ReducedTables(**(given | changes))


def moved(model, steps=30):
    """Coordinates after some steps of a swinging rig."""
    rig, weights = test_physics.swing(model, steps)
    simulation = test_physics.simulation_of(model)
    simulation.start(rig[0], rig[1], weights[0])
    assert simulation.advance(rig[1:], weights[1:]).converged
    return simulation.coordinates


@pytest.mark.parametrize("blending", BLENDINGS)
@pytest.mark.parametrize("material_model", MATERIAL_MODELS)
def test_static_solution_at_a_target_is_the_sculpted_shape(material_model, blending):
    model, *_ = with_responses(material_model, blending)
    _, _, shapes = test_physics.sculpture()
    simulation = test_physics.simulation_of(model, tolerance=1e-9)
    random = np.random.default_rng(1)
    for j, shape in enumerate(shapes):
        guess = model.target(j) + random.uniform(-1, 1, model.dofs) * 0.003 * np.sqrt(0.004)
        coordinates, report = simulation.solve_static(FLEXED, np.eye(3)[j], guess=guess)
        assert report.converged and report.iterations > 0
        assert np.abs(model.displacement(coordinates) - shape).max() < 1e-6 * model.body.size


def test_sizes_and_tables_survive_a_round_trip_through_arrays():
    model, targets, full, basis, tables = with_responses(dynamorph.MaterialModel.STVK, dynamorph.Blending.EVEN)
    assert basis.U.shape == (full.dofs, MODES) and basis.W.shape == (full.dofs, RESPONSES)
    assert basis.amplitudes.shape == (MODES,) and np.all(basis.amplitudes > 0)
    assert model.dofs == MODES + RESPONSES
    pairs = MODES * (MODES + 1) // 2
    assert [table.shape for table in tables.response_mu] == 3 * [(RESPONSES * (1 + pairs),)]
    assert [table.shape for table in tables.relaxation] == 3 * [(RESPONSES, MODES)]
    assert not tables.relaxation[0].any() and tables.relaxation[1].any()
    again = dynamorph.ReducedModel(full.body, targets, tables_like(tables), dynamorph.Blending.EVEN)
    assert moved(again).tobytes() == moved(model).tobytes()


def test_responses_follow_the_full_model_more_closely_than_the_modes_alone():
    """In a small swing about the neutral shape, by the root mean square over all steps."""
    model, targets, full, basis, _ = with_responses(dynamorph.MaterialModel.STABLE_STVK, dynamorph.Blending.EVEN)
    modes = dynamorph.ReducedModel(full.body, targets, dynamorph.reduce(full, basis.U), dynamorph.Blending.EVEN)
    angles = 0.01 * np.sin(np.arange(90) * 0.12)
    bend = [np.concatenate([test_physics.bones(), test_physics.bones(rotation_about_y(a))]) for a in angles]
    weights = np.repeat([[1.0, 0.0, 0.0]], len(bend) - 1, axis=0)
    paths = []
    for other in (full, model, modes):
        simulation = test_physics.simulation_of(other)
        simulation.start(bend[0], bend[1], weights[0])
        path = []
        for bones, weight in zip(bend[1:], weights, strict=True):
            simulation.advance(bones[None], weight[None])
            path.append(other.displacement(simulation.coordinates))
        paths.append(np.array(path))
    error, of_modes = (np.linalg.norm(path - paths[0]) / np.linalg.norm(paths[0]) for path in paths[1:])
    assert error < 0.005  # 0.0017 measured, of the modes 0.017
    assert error < 0.2 * of_modes


def rotation_about_y(angle):
    return test_physics.Rotation.from_euler("y", angle)


def test_progress_is_reported_and_false_cancels():
    full, _, _ = test_physics.sculpted(dynamorph.MaterialModel.STVK, dynamorph.Blending.EVEN, False)
    seen = []
    basis = dynamorph.make_response_basis(full, MODES, RESPONSES, progress=lambda done: seen.append(done) or True)
    assert seen[0] == 0 and seen[-1] == 1 and seen == sorted(seen)
    with pytest.raises(dynamorph.Cancelled):
        dynamorph.make_response_basis(full, MODES, RESPONSES, progress=lambda done: False)
    with pytest.raises(dynamorph.Cancelled):
        dynamorph.reduce(full, basis, progress=lambda done: False)


def test_what_does_not_fit_is_refused_by_name():
    _, targets, full, _, tables = with_responses(dynamorph.MaterialModel.STVK, dynamorph.Blending.EVEN)
    short = [table[:-1] for table in tables.response_mu]
    nowhere = tables.responses.copy()
    nowhere[0, 0] = np.nan
    for changes, message in (
        ({"responses": tables.responses[:-3]}, "responses must be finite and have the rows of the basis"),
        ({"responses": nowhere}, "responses must be finite"),
        ({"responses": tables.responses[:, :-1]}, "the responses of 'n' do not fit"),
        ({"response_mu": short}, "the responses of 'n' do not fit"),
        ({"response_lambda": []}, "expected responses for each of 3 targets"),
        ({"relaxation": tables.relaxation[1:]}, "expected responses for each of 3 targets"),
        ({"relaxation": [each.T for each in tables.relaxation]}, "the responses of 'n' do not fit"),
        ({"relaxation": [np.nan * each for each in tables.relaxation]}, "the responses of 'n' do not fit"),
    ):
        with pytest.raises(ValueError, match=message):
            dynamorph.ReducedModel(full.body, targets, tables_like(tables, **changes), dynamorph.Blending.EVEN)
    for modes, message in (
        (2, "2 modes in full detail are too few: the shapes of the targets alone take 2. Ask for 3 or more"),
        (full.dofs // 2 - RESPONSES, f"Ask for fewer than {full.dofs // 2}, or use more nodes"),
    ):
        with pytest.raises(dynamorph.Error, match=message):
            dynamorph.make_response_basis(full, modes, RESPONSES)
    with pytest.raises(ValueError, match="h: expected at least one response, got 0"):
        dynamorph.make_response_basis(full, MODES, 0)


def test_responses_adapt_to_another_stiffness():
    """They stay in the span of all modes, orthonormal in the mass, and decouple as those of a build do."""
    cells, size, material_model = (8, 2, 2), (0.4, 0.1, 0.1), dynamorph.MaterialModel.LINEAR
    body, targets, _ = test_physics.sculpture(cells=cells)
    basis = dynamorph.make_response_basis(
        dynamorph.FullModel(body, targets, material_model, dynamorph.Blending.EVEN), MODES, RESPONSES
    )
    nodes, tets = test_physics.bar(cells, size)
    softer, count, s = 0.25 ** (nodes[tets, 1].mean(axis=1) / size[1]), np.ones(len(tets)), nodes[:, 0] / size[0]
    painted = dynamorph.SoftBody(
        dynamorph.TetMesh(nodes, tets), count, softer, count[:, None], s < 1e-9, np.stack([1 - s, s], axis=1)
    )
    full = dynamorph.FullModel(painted, targets, material_model, dynamorph.Blending.EVEN)
    found = dynamorph.adapt_response_basis(full, basis.U, basis.W)
    mass = np.repeat(body.volumes.sum(axis=1), 3)[:, None]
    stiffness = full.linearize(np.array([1.0, 0.0, 0.0]), np.zeros(full.dofs))[2]
    together = np.hstack([basis.U, basis.W])
    np.testing.assert_array_equal(found.U, basis.U)
    in_span = together @ np.linalg.lstsq(together, found.W, rcond=None)[0]
    np.testing.assert_allclose(in_span, found.W, atol=1e-8 * np.abs(found.W).max())
    np.testing.assert_allclose(found.W.T @ (mass * found.W), np.eye(RESPONSES), atol=1e-8)
    apart = found.W.T @ (stiffness @ found.W)
    np.testing.assert_allclose(apart, np.diag(np.diag(apart)), atol=1e-8 * apart.max())
    coupled = np.abs(found.W.T @ (stiffness @ found.U)).max()
    assert coupled < 1e-8 * apart.max() < 1e-4 * np.abs(basis.W.T @ (stiffness @ basis.U)).max()
    with pytest.raises(ValueError, match=f"U, W: expected {full.dofs} rows each"):
        dynamorph.adapt_response_basis(full, basis.U[3:], basis.W)


def test_a_state_resumes_bit_for_bit():
    model, *_ = with_responses(dynamorph.MaterialModel.STABLE_STVK, dynamorph.Blending.EVEN)
    rig, weights = test_physics.swing(model, 20)
    first = test_physics.simulation_of(model)
    first.start(rig[0], rig[1], weights[0])
    first.advance(rig[1:10], weights[1:10])
    second = test_physics.simulation_of(model)
    second.start(TWO_BONES, TWO_BONES, weights[0])
    second.state = first.state
    for simulation in (first, second):
        simulation.advance(rig[10:], weights[10:])
    assert first.coordinates.tobytes() == second.coordinates.tobytes()


# The same bytes --------------------------------------------------------------------------------------------------


def digest() -> str:
    """Of a basis, its tables and a motion, on a bar that several chunks of work share; for test_threads."""
    model, _, _, basis, tables = with_responses(dynamorph.MaterialModel.STVK, dynamorph.Blending.EVEN, cells=(16, 4, 4))
    found = hashlib.sha256()
    arrays = (basis.U, basis.W, basis.amplitudes, *tables.response_lambda, *tables.response_mu, *tables.relaxation)
    for array in (*arrays, moved(model, 8)):
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def save_motion(path: str) -> None:
    model, *_ = with_responses(dynamorph.MaterialModel.STVK, dynamorph.Blending.EVEN)
    np.save(path, model.displacement(moved(model, 8)))


def test_instruction_sets_move_alike_and_each_makes_the_same_bytes(tmp_path):
    def motion(instruction_set, name):
        file = tmp_path / f"{name}.npy"
        run(f"import test_responses; test_responses.save_motion({str(file)!r})", DYNAMORPH_ISA=instruction_set)
        return np.load(file)

    expected = motion("baseline", "baseline")
    for instruction_set in available():
        found, again = (motion(instruction_set, f"{instruction_set}{k}") for k in range(2))
        assert found.tobytes() == again.tobytes()
        assert np.linalg.norm(found - expected) <= 1e-5 * np.linalg.norm(expected)
