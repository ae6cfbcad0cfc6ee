# SPDX-License-Identifier: GPL-3.0-or-later
"""New soft skins: stiffness from the frequency, the limits of the motion, and what a bake reports."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core.material.feel import FEELS
from bl_ext.user_default.dynamic_morph_targets.core.motion import simulate
from bl_ext.user_default.dynamic_morph_targets.core.result import judge
from bl_ext.user_default.dynamic_morph_targets.core.settings import Material
from bl_ext.user_default.dynamic_morph_targets.io import cache_dir
from bl_ext.user_default.dynamic_morph_targets.run.bake import bake_input
from bl_ext.user_default.dynamic_morph_targets.scene.references import key_points
from builders import activate, rig_of
from robustness import bake

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")


@pytest.fixture
def new_arm(arm):
    """The arm after one click; its rig is shaken hard up and down."""
    activate(arm)
    bpy.ops.dynamorph.add_soft_skin()
    arm.dynamorph.model.cage_nodes, arm.dynamorph.model.modes = 400, 12
    rig = rig_of(arm)
    for frame in range(1, 21):
        rig.location.z = 0.25 * (frame // 3 % 2)
        rig.keyframe_insert("location", frame=frame)
    return arm


def limit(obj, displacement, thickness=0.0):
    simulation = obj.dynamorph.simulation
    simulation.max_displacement, simulation.max_thickness = displacement, thickness


def test_the_build_gives_the_frequency(new_arm):
    """At every scale the Bounce is as requested, whatever stiffness that takes."""
    found = []
    for scale in (1.0, 8.0):
        rig_of(new_arm).scale = (scale,) * 3
        new_arm.scale = (scale,) * 3
        bpy.context.view_layer.update()
        bpy.ops.dynamorph.build()
        neutral = new_arm.dynamorph.targets[0]
        assert neutral.bounce == pytest.approx(3.5, rel=1e-4)
        found.append(neutral.stiffness)
        material = neutral.material()
        omega = 2.0 * np.pi * neutral.reference * np.sqrt(material.stiffness / material.density)
        assert material.stiffness_damping * omega / 2.0 == pytest.approx(0.2, rel=1e-3) and not material.mass_damping
    assert found[1] == pytest.approx(64.0 * found[0], rel=1e-4)  # in the same cage, as 8 is a power of 2


def test_the_frequency_is_that_of_the_body(new_arm):
    """The first mode that moves 2 % of the mass, counted from the engine's own matrices."""
    job = bake(new_arm)
    model, character = job.outcome.model, job.outcome.character
    full = replace(model, settings=replace(model.settings, solver="FULL")).engine(character)
    omega, shapes = full.linear_modes(0, 24)
    mass = np.repeat(full.body.volumes.sum(axis=1), 3) * character.targets[0].material.density
    shares = []
    for axis in range(3):
        pattern = np.tile(np.eye(3)[axis], len(mass) // 3)
        shares.append((shapes.T @ (mass * pattern)) ** 2 / (pattern @ (mass * pattern)))
    first = np.flatnonzero(np.max(shares, axis=0) >= 0.02)[0]
    undamped = new_arm.dynamorph.targets[0].reference * np.sqrt(
        character.targets[0].material.stiffness / character.targets[0].material.density
    )
    assert undamped == pytest.approx(omega[first] / (2.0 * np.pi), rel=1e-3)


def verdict(obj) -> judge.Verdict:
    return judge.parsed(obj.dynamorph.bake.verdict)


@pytest.mark.parametrize("solver", ["REDUCED", "FULL"])
def test_a_bake_keeps_its_limits_and_the_bounce(new_arm, solver):
    new_arm.dynamorph.model.solver, new_arm.dynamorph.model.cage_nodes = solver, 150
    limit(new_arm, 0.0)
    free = bake(new_arm).outcome.verdict
    assert free.held.bone == "" and free.held_back is None
    limit(new_arm, 0.4 * free.displacement)
    job = bake(new_arm)
    found = job.outcome.verdict
    assert found.percentile <= 1.05 * 0.4 * free.displacement
    assert found.held.excess > 1.0 and found.held.bone in job.outcome.model.bone_names
    assert 1 <= found.held.frames[0] <= found.held.frames[1] <= 20 and 0.3 < found.held.reached < 1.5
    assert verdict(new_arm) == found
    neutral = new_arm.dynamorph.targets[0]
    assert neutral.bounce == pytest.approx(3.5, rel=1e-5)


def test_limits_beyond_the_motion_change_nothing(new_arm):
    rig = rig_of(new_arm)
    for frame in range(1, 21):
        rig.location.z = 0.01 * (frame // 3 % 2)
        rig.keyframe_insert("location", frame=frame)
    limit(new_arm, 0.0)
    free = bake(new_arm)
    limit(new_arm, 4.0 * free.outcome.verdict.displacement)
    wide = bake(new_arm)
    assert wide.outcome.verdict.held.excess < 0.5
    np.testing.assert_array_equal(wide.outcome.bake.coordinates, free.outcome.bake.coordinates)


def test_a_shot_in_chunks_and_one_that_resumes_are_limited_alike(new_arm, monkeypatch, tmp_path):
    limit(new_arm, 0.02)
    whole = bake(new_arm)
    assert whole.outcome.verdict.held.excess > 1.0
    monkeypatch.setattr(bake_input, "CHUNK_FRAMES", 6)
    parts = bake(new_arm)
    np.testing.assert_allclose(parts.outcome.bake.coordinates, whole.outcome.bake.coordinates, rtol=1e-4, atol=1e-6)
    monkeypatch.setattr(bake_input, "SHORT_CHUNK_FRAMES", 7)
    kept = cache_dir.CacheDir(tmp_path)
    with monkeypatch.context() as cut_off:
        cut_off.setattr(simulate.Shot, "play", interrupted(simulate.Shot.play, after=2))
        with pytest.raises(KeyboardInterrupt):
            bake(new_arm, cache_dir=kept)
    resumed = bake(new_arm, cache_dir=kept)
    assert len(resumed.input.resumed["coordinates"]) == 15
    np.testing.assert_allclose(resumed.outcome.bake.coordinates, whole.outcome.bake.coordinates, rtol=1e-4, atol=1e-6)


def interrupted(play, after: int):
    """`play`, which ends the process at the next call after so many."""
    calls = []

    def until(shot, rig):
        calls.append(rig)
        if len(calls) > after:
            raise KeyboardInterrupt
        play(shot, rig)

    return until


def test_live_moves_as_a_bake_with_limits_does(new_arm):
    limit(new_arm, 0.02)
    job = bake(new_arm)
    bpy.ops.dynamorph.delete_bake()
    bpy.ops.dynamorph.live()
    farthest = max(np.abs(job.outcome.bake.displacement(k)).max() for k in range(20))
    for k, frame in enumerate(range(1, 21)):
        bpy.context.scene.frame_set(frame)
        keys = new_arm.data.shape_keys
        shown = key_points(keys.key_blocks["Dynamorph Live"]) - key_points(keys.reference_key)
        # The bake leaves out modes that hardly move.
        baked = job.outcome.bake.displacement(k)
        np.testing.assert_allclose(shown, baked, atol=2e-3 * farthest)


def test_targets_follow_the_neutral_unless_set_by_hand(new_arm):
    bpy.context.scene.frame_set(20)
    bpy.ops.dynamorph.add_target(key="flexed")
    bpy.context.scene.frame_set(1)
    bpy.ops.dynamorph.build()
    neutral, flexed = new_arm.dynamorph.targets
    assert flexed.stiffness == pytest.approx(neutral.stiffness)
    flexed.bounce = 9.0
    stiff = flexed.stiffness
    bpy.ops.dynamorph.apply_feel(feel="SUBTLE")
    bake(new_arm)
    assert neutral.bounce == pytest.approx(FEELS["SUBTLE"].frequency, rel=1e-5)
    assert flexed.stiffness == stiff and flexed.by_hand


def test_pins_and_pascals_are_left_alone(new_arm):
    """With a stiffness in pascals and no limit nothing is calibrated."""
    settings = new_arm.dynamorph
    settings.model.hold = "BONES"
    limit(new_arm, 0.0)
    neutral = settings.targets[0]
    neutral.set_material(Material())
    before = neutral.material()
    job = bake(new_arm)
    assert neutral.material() == before and not len(job.outcome.model.hold_strength) and job.outcome.model.pinned.any()


# The verdict -------------------------------------------------------------------------------------------------------


def test_the_verdict_measures_what_was_baked(new_arm):
    """It is compared with the displacements of the bake itself, frame by frame."""
    limit(new_arm, 0.0)
    job = bake(new_arm)
    rest = job.outcome.character.vertices @ job.outcome.character.to_bind.T
    size = np.linalg.norm(np.ptp(rest, axis=0))
    local = np.array([job.outcome.bake.displacement(k) for k in range(len(job.outcome.bake.frames))])
    moved = np.linalg.norm(local @ job.outcome.character.to_bind.T, axis=2) / size
    assert job.outcome.verdict.displacement == pytest.approx(moved.max(), rel=1e-3)
    assert job.outcome.verdict.frame == job.outcome.bake.frames[moved.max(axis=1).argmax()]
    assert moved[moved.max(axis=1).argmax()].argmax() in job.outcome.verdict.vertices
    assert verdict(new_arm) == job.outcome.verdict


def test_wreckage_is_no_success(new_arm):
    """Skin that is turned over or torn is named with a remedy, whatever the limits say."""
    limit(new_arm, 0.0)
    bpy.ops.dynamorph.build()
    new_arm.dynamorph.targets[0].bounce = 0.4
    job = bake(new_arm)
    found = verdict(new_arm)
    assert found == job.outcome.verdict and found.is_wreckage and not found.is_believable
    assert found.is_too_large and found.factor > 1.0
    assert any(text.startswith(found.text) for text in job.warnings)


def test_a_body_turned_inside_out_is_measured_by_volume():
    limits = judge.Limits(0.05, 0.6)
    found = judge.Verdict(limits, displacement=0.01, percentile=0.01, inverted=0.2)
    assert found.is_wreckage and found.excess > 1.0
    assert "pressed inside out" in found.text
    assert judge.Verdict().excess == 0.0 and judge.Verdict(limits).is_believable
