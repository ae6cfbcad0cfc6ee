# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials from measurements: known parameters are recovered from synthetic data with noise."""

from dataclasses import astuple, replace
from math import log, pi
from pathlib import Path

import dynamorph
import numpy as np
import pytest
from dynamic_morph_targets.core.character import Character, Skeleton, Target, TargetSet
from dynamic_morph_targets.core.errors import FitError
from dynamic_morph_targets.core.material import fit as material_fit
from dynamic_morph_targets.core.material import oscillation, presets
from dynamic_morph_targets.core.model.build import build
from dynamic_morph_targets.core.settings import Material, ModelSettings
from scenes import PINNED, tube

# Reading an oscillation --------------------------------------------------------------------------------------------


def swing(frequency, decay, seconds, fps=120.0, noise=0.0, seed=0):
    """Times and the motion of a point in space, in the amplitude's units, with noise as a part of the amplitude."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, seconds, 1 / fps)
    along = np.exp(-decay * times) * np.cos(2 * pi * frequency * times + 0.7)
    points = np.array([5.0, -2.0, 1.0]) + along[:, None] * [0.6, 0.0, 0.8]
    return times, points + noise * rng.normal(size=points.shape)


@pytest.mark.parametrize(("frequency", "decay"), [(3.0, 0.5), (3.0, 4.0), (8.0, 10.0), (2.0, 3.0), (12.0, 0.0)])
def test_an_oscillation_is_read_through_noise(frequency, decay):
    """5 % noise: frequency within 2 %, decay within 10 % or 0.1/s, in nine of ten records; the errors are honest."""
    off = []
    for seed in range(20):
        seen = oscillation.oscillation(*swing(frequency, decay, 3.0, noise=0.05, seed=seed))
        off.append((abs(seen.frequency / frequency - 1), abs(seen.decay - decay)))
        assert abs(seen.frequency - frequency) < 5 * seen.frequency_error
        assert abs(seen.decay - decay) < 5 * max(seen.decay_error, 0.02)
    worst = np.quantile(off, 0.9, axis=0)
    assert worst[0] < 0.02 and worst[1] < max(0.1 * decay, 0.1)


def test_a_clean_oscillation_is_read_exactly():
    times, points = swing(3.3, 2.0, 2.0)
    uneven = np.random.default_rng(1).choice(len(times), 80, replace=False)
    uneven.sort()
    for seen in (
        oscillation.oscillation(times, points),
        oscillation.oscillation(times + 100.0, points[:, 2]),
        oscillation.oscillation(times, points[:, :2]),
        oscillation.oscillation(times[uneven], points[uneven]),
    ):
        assert (seen.frequency, seen.decay) == pytest.approx((3.3, 2.0), rel=1e-6)
        assert seen.settle == pytest.approx(log(20) / 2.0)
        assert oscillation.decay_of(seen.settle) == pytest.approx(seen.decay)


def bad_records():
    """(times, positions, words of the message)."""
    times, points = swing(3.0, 1.0, 2.0)
    noise = np.random.default_rng(3).normal(size=points.shape)
    hole = points.copy()
    hole[5, 0] = np.nan
    yield times[:5], points[:5], "at least 10"
    yield times, points[:-1], "expected at least 10 times"
    yield times, hole, "not numbers"
    yield times[::-1], points, "must increase"
    yield times, 0 * points, "does not move"
    yield times, noise, "no oscillation"
    yield times, np.exp(-3 * times), "two periods"
    yield *swing(0.7, 0.1, 2.0), "two periods"
    yield *swing(3.0, 15.0, 2.0, fps=1000.0), "too damped"
    yield *swing(3.0, -1.0, 2.0), "grows"


@pytest.mark.parametrize(("times", "points", "words"), list(bad_records()))
def test_what_is_no_oscillation_is_refused(times, points, words):
    with pytest.raises(FitError, match=words):
        oscillation.oscillation(times, points)


@pytest.mark.parametrize("text", ["t,x\n0,1\n0.5,2\n", "0,1\r\n\r\n.5,2\r\n", "\ufefftime,x\n0, 1\n+0.5, 2"])
def test_columns_are_read(tmp_path, text):
    path = tmp_path / "point.csv"
    path.write_bytes(text.encode())
    np.testing.assert_array_equal(oscillation.read_columns(path, (2, 4)), [[0.0, 1.0], [0.5, 2.0]])


@pytest.mark.parametrize("text", ["", "t,x\n", "1,2,3\n", "1,2\n3\n", "1;2\n", "1,two\n"])
def test_other_files_are_refused(tmp_path, text):
    path = tmp_path / "point.csv"
    path.write_text(text)
    with pytest.raises(FitError, match="'point.csv': expected 2 or 4 numbers"):
        oscillation.read_columns(path, (2, 4))


# A body to fit -----------------------------------------------------------------------------------------------------

TRUE = Material(stiffness=3e4, poisson=0.4, density=1050.0, mass_damping=1.5, stiffness_damping=0.006)
WRONG = Material(stiffness=8e3, poisson=0.4, density=1050.0, mass_damping=4.0, stiffness_damping=0.001)
AT_REST = np.eye(4)[None]


def limb(material_model="STABLE_STVK", solver="REDUCED", regions=False):
    """A flat limb, 20 cm, held at its root: a neutral target and one that bulges and bends; (model, character).

    regions: the second target belongs to the outer half, in a set of its own.
    """
    vertices, faces = tube(rings=9, around=12, radius=0.05, length=0.2)
    vertices = vertices * [0.8, 1.0, 1.0]
    outside = np.clip(vertices[:, 2] / 0.2 - 0.5, 0.0, 0.1) * 10.0
    shape = np.column_stack([1.0 * vertices[:, 2] ** 2, 0.3 * outside * vertices[:, 1], 0.0 * outside])
    triangles = [[face[0], face[i], face[i + 1]] for face in faces for i in range(1, len(face) - 1)]
    neutral = Target("Neutral", 0 * vertices, (), AT_REST, np.eye(4), WRONG)
    bent = Target("bent", shape, ("root",), AT_REST, np.eye(4), WRONG)
    everywhere = np.ones(len(vertices))
    sets = (TargetSet("limb", (neutral, bent), everywhere),)
    if regions:
        sets = (
            TargetSet("limb", (neutral,), everywhere - outside),
            TargetSet("outside", (replace(neutral, name="Neutral outside"), bent), outside),
        )
    character = Character(
        name="Limb",
        vertices=vertices,
        triangles=np.array(triangles, np.int32),
        to_bind=np.eye(3),
        weights=np.tile([1.0, 0.0], (len(vertices), 1)),
        rigidity=np.where(vertices[:, 2] < 0.02, 1.0, 0.0),
        bone_segments=np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.015]]]),
        skeleton=Skeleton(("root",), np.array([-1]), AT_REST),
        authored_sets=sets,
        settings=ModelSettings(
            **PINNED, material_model=material_model, solver=solver, modes=16, cage_nodes=250, pin_radius=0.1
        ),
    )
    return build(character), character


@pytest.fixture(scope="module")
def limbs():
    """Built once each, when first asked for."""
    built = {}

    def get(*key):
        if key not in built:
            built[key] = limb(*key)
        return built[key]

    return get


def made_of(character, material):
    """The character with one material everywhere."""
    sets = tuple(
        replace(s, targets=tuple(replace(t, material=material) for t in s.targets)) for s in character.target_sets
    )
    return replace(character, authored_sets=sets)


TIP = -12  # the vertices of the last ring
BONES = np.tile(np.eye(3, 4), (2, 1, 1))


def tip_patch(character):
    patch = np.zeros(len(character.vertices))
    patch[TIP:] = 1.0
    return patch


def pushed(model, character, target, forces):
    """Mean displacements (k, 3) of the tip's vertices under forces (k, 3) shared out among them, and coordinates."""
    engine = model.engine(character)
    simulation = dynamorph.Simulation(engine, 0.01, tolerance=1e-10, max_iterations=200)
    weights = np.eye(len(character.targets))[target]
    weights[0] = weights.sum() - weights[1:].sum() if len(character.target_sets) == 1 else 1.0
    answers = []
    for force in np.vstack([np.zeros(3), forces]):
        external = np.zeros_like(model.nodes)
        for v in range(len(character.vertices))[TIP:]:
            for node, weight in zip(model.embedding_nodes[v], model.embedding_weights[v], strict=True):
                external[node] += weight * force / -TIP
        coordinates, report = simulation.solve_static(BONES, weights, external)
        assert report.converged
        answers.append(model.surface(engine.displacement(coordinates))[TIP:].mean(axis=0))
    return np.array(answers[1:]) - answers[0], coordinates


def let_go(model, character, target, push, seconds, h=1 / 600):
    """The path of a vertex at the tip (n, 3) after a push is taken away, at its target's pose."""
    engine = model.engine(character)
    _, bent = pushed(model, character, target, [push])
    simulation = dynamorph.Simulation(engine, h)
    weights = np.eye(len(character.targets))[target]
    simulation.start(BONES, BONES, weights)
    simulation.state = dynamorph.State([bent] * 4, simulation.state.bones)
    path = []
    for _ in range(round(seconds / h)):
        assert simulation.advance(BONES[None], weights[None]).converged
        path.append(model.surface(engine.displacement(simulation.coordinates))[TIP])
    return h * np.arange(len(path)), np.array(path)


# The fits ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("target", [0, 1])
@pytest.mark.parametrize(
    ("material_model", "solver"), [("LINEAR", "FULL"), ("STVK", "REDUCED"), ("STABLE_STVK", "REDUCED")]
)
def test_a_material_is_recovered_from_a_tracked_point(limbs, material_model, solver, target):
    """From a wrong material: E within 5 %, the damping ratio within 15 %, through 5 % noise."""
    model, character = limbs(material_model, solver)
    times, path = let_go(model, made_of(character, TRUE), target, [0.1, 0.0, 0.0], 2.5)
    size = np.linalg.norm(path[0] - path[-1])
    path = path + 0.05 * size * np.random.default_rng(7).normal(size=path.shape)
    video = slice(10, None, 10)  # 60 frames a second
    seen = oscillation.oscillation(times[video], path[video])
    fitted = material_fit.fit_oscillation(model, character, target, seen.frequency, seen.decay)
    print(material_model, solver, target, seen, fitted)
    assert fitted.stiffness == pytest.approx(TRUE.stiffness, rel=0.05)
    true_decay = material_fit.bounce(model, made_of(character, TRUE), target).decay
    assert material_fit.bounce(model, made_of(character, fitted), target).decay == pytest.approx(true_decay, rel=0.15)
    shared = material_fit.fit_oscillation(model, character, target, seen.frequency, seen.decay, mass_share=0.0)
    assert shared.mass_damping == 0.0 and shared.stiffness == fitted.stiffness
    assert (fitted.poisson, fitted.density) == (WRONG.poisson, WRONG.density)


def test_bounce_and_fit_are_inverse(limbs):
    model, character = limbs("STABLE_STVK", "REDUCED")
    seen = material_fit.bounce(model, made_of(character, TRUE), 1)
    omega_squared = (2 * pi * seen.frequency) ** 2 + seen.decay**2
    mass_share = TRUE.mass_damping / (2 * seen.decay)
    fitted = material_fit.fit_oscillation(model, character, 1, seen.frequency, seen.decay, mass_share=mass_share)
    assert astuple(fitted) == pytest.approx(astuple(TRUE), rel=1e-6)
    assert seen.decay == pytest.approx((TRUE.mass_damping + TRUE.stiffness_damping * omega_squared) / 2)
    # Heavy tissue swings more slowly: omega ~ sqrt(E / rho).
    heavy = replace(TRUE, density=4 * TRUE.density, mass_damping=0.0, stiffness_damping=0.0)
    light = replace(TRUE, mass_damping=0.0, stiffness_damping=0.0)
    bounces = [material_fit.bounce(model, made_of(character, material), 1) for material in (heavy, light)]
    assert bounces[1].frequency == pytest.approx(2 * bounces[0].frequency)
    assert bounces[0].settle == np.inf
    assert material_fit.bounce(model, made_of(character, replace(TRUE, stiffness_damping=1.0)), 1).frequency == 0.0


def test_a_region_is_fitted_beside_other_flesh(limbs):
    """The target has only the outer half: omega^2 ~ E no longer holds, and the fit succeeds nevertheless."""
    model, character = limbs("STABLE_STVK", "REDUCED", True)
    seen = material_fit.bounce(model, made_of(character, WRONG), 2)
    fitted = material_fit.fit_oscillation(model, character, 2, 0.9 * seen.frequency, seen.decay)
    assert fitted.stiffness < 0.75 * WRONG.stiffness
    sets = character.target_sets
    bent = replace(sets[1].targets[1], material=fitted)
    fitted_character = replace(character, authored_sets=(sets[0], replace(sets[1], targets=(sets[1].targets[0], bent))))
    again = material_fit.bounce(model, fitted_character, 2)
    assert again.frequency == pytest.approx(0.9 * seen.frequency, rel=0.02)  # up to the others' damping
    with pytest.raises(FitError, match="sets the pace"):
        material_fit.fit_oscillation(model, character, 2, 50 * seen.frequency, seen.decay)


@pytest.mark.parametrize("strength", [0.1, 4.0])
@pytest.mark.parametrize("target", [0, 1])
@pytest.mark.parametrize(
    ("material_model", "solver"), [("LINEAR", "FULL"), ("STVK", "REDUCED"), ("STABLE_STVK", "FULL")]
)
def test_stiffness_is_recovered_from_force_and_displacement(limbs, material_model, solver, target, strength):
    """Ten pushes with 5 % noise, small or as far as a third of the limb's length: E within 3 %."""
    model, character = limbs(material_model, solver)
    rng = np.random.default_rng(5)
    forces = strength * rng.normal(size=(10, 3)) * [1.0, 1.0, 0.3]
    moved, _ = pushed(model, made_of(character, TRUE), target, forces)
    noisy = moved + 0.05 * np.sqrt(np.square(moved).mean()) * rng.normal(size=moved.shape)
    fitted = material_fit.fit_force_displacement(model, character, target, forces, noisy, tip_patch(character))
    print(
        material_model, solver, target, strength, np.linalg.norm(moved, axis=1).max(), fitted.stiffness / TRUE.stiffness
    )
    assert fitted.stiffness == pytest.approx(TRUE.stiffness, rel=0.03)
    assert replace(fitted, stiffness=0.0) == replace(WRONG, stiffness=0.0)
    if strength > 1.0:
        with pytest.raises(FitError, match="no stiffness meets"):
            material_fit.fit_force_displacement(model, character, target, forces, 10.0 * moved[:, ::-1])


def test_bad_measurements_are_refused(limbs):
    model, character = limbs("STVK", "REDUCED")
    one = np.array([[0.01, 0.0, 0.0]])

    def fit(forces, displacements, target=0, patch=None):
        material_fit.fit_force_displacement(model, character, target, forces, displacements, patch)

    for arguments, words in (
        ((one + np.inf, one), "not numbers"),
        ((0 * one, one), "zero"),
        ((one, 0 * one), "zero"),
        ((one, -one), "against the forces"),
        ((one, one, 0, 0 * tip_patch(character)), "patch is empty"),
    ):
        with pytest.raises(FitError, match=words):
            fit(*arguments)
    for arguments, words in (  # of whoever calls it, not of who has measured
        ((one, one[:, :2]), "expected \\(k, 3\\)"),
        ((one, one, 7), "target: expected 0 to 1"),
        ((one, one, 0, np.zeros(3)), "patch: expected a weight"),
    ):
        with pytest.raises(ValueError, match=words):
            fit(*arguments)
    for frequency, decay in ((0.0, 1.0), (np.nan, 1.0), (3.0, -1.0)):
        with pytest.raises(FitError, match="above zero"):
            material_fit.fit_oscillation(model, character, 0, frequency, decay)
    with pytest.raises(FitError, match="above zero"):
        oscillation.decay_of(0.0)


# Presets -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", presets.PRESETS)
def test_presets_are_sane_and_sourced(key):
    preset = presets.PRESETS[key]
    material = preset.material
    assert 1e3 < material.stiffness < 2e6 and material.poisson <= 0.4 and 900 <= material.density <= 1200
    zeta = (material.mass_damping / presets.REFERENCE + material.stiffness_damping * presets.REFERENCE) / 2
    assert 0.02 < zeta < 0.25
    assert "Damping" in preset.source and any(word in preset.source for word in ("20", "19", "assumed"))
    assert f"| {preset.label} |" in presets.table()


def test_the_documents_table_is_the_code_s(tmp_path):
    text = (Path(__file__).parents[2] / "docs" / "materials.md").read_text(encoding="utf-8")
    copy = tmp_path / "materials.md"
    copy.write_text(text, encoding="utf-8")
    presets.write_table(copy)
    assert copy.read_text(encoding="utf-8") == text
    copy.write_text("no marks", encoding="utf-8")
    with pytest.raises(ValueError, match="marks"):
        presets.write_table(copy)


def test_presets_are_ordered_as_flesh_is():
    young = {key: preset.material.stiffness for key, preset in presets.PRESETS.items()}
    assert young["FAT"] < young["MUSCLE_RELAXED"] < young["CHEEK"] < young["SKIN"] < young["MUSCLE_FLEXED"]
    assert young["FAT"] == pytest.approx(2.8 * 752, rel=0.01)
