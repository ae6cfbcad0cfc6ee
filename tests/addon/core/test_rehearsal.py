# SPDX-License-Identifier: GPL-3.0-or-later
"""New soft skins: stiffness from the frequency, the limits of the motion, and what a bake reports."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core.material import feel
from bl_ext.user_default.dynamic_morph_targets.core.result import judge
from bl_ext.user_default.dynamic_morph_targets.core.result import rehearsal as result_rehearsal
from bl_ext.user_default.dynamic_morph_targets.core.settings import Material
from bl_ext.user_default.dynamic_morph_targets.io import cache_dir
from bl_ext.user_default.dynamic_morph_targets.run import bake_input
from bl_ext.user_default.dynamic_morph_targets.scene import staleness
from builders import activate, rig_of
from layout import drawn
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
    for scale in (1.0, 10.0):
        rig_of(new_arm).scale = (scale,) * 3
        new_arm.scale = (scale,) * 3
        bpy.context.view_layer.update()
        bpy.ops.dynamorph.build()
        neutral = new_arm.dynamorph.targets[0]
        assert neutral.bounce == pytest.approx(3.5, rel=1e-4)
        found.append(neutral.stiffness)
        material = neutral.material()
        reference = neutral.bounce_reference * np.sqrt(material.stiffness / material.density)
        omega = 2.0 * np.pi * reference
        assert material.stiffness_damping * omega / 2.0 == pytest.approx(0.2, rel=1e-3) and not material.mass_damping
    assert found[1] == pytest.approx(100.0 * found[0], rel=2e-2)  # the cage is rebuilt


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
    undamped = new_arm.dynamorph.targets[0].bounce_reference * np.sqrt(
        character.targets[0].material.stiffness / character.targets[0].material.density
    )
    assert undamped == pytest.approx(omega[first] / (2.0 * np.pi), rel=1e-3)


def test_a_rehearsal_keeps_the_skin_within_its_limits(new_arm):
    limit(new_arm, 0.0)
    free = bake(new_arm)
    assert not free.outcome.rehearsed and new_arm.dynamorph.simulation.rehearsed == ""
    farthest = free.outcome.verdict.displacement
    limit(new_arm, 0.6 * farthest)
    job = bake(new_arm)
    neutral = new_arm.dynamorph.targets[0]
    assert job.outcome.verdict.percentile <= 0.6 * farthest < farthest
    assert neutral.frequency > 3.5 and neutral.bounce == pytest.approx(neutral.frequency, rel=1e-3)
    assert neutral.material().stiffness_damping * 2.0 * np.pi * neutral.frequency / 2.0 == pytest.approx(0.2, rel=0.03)
    assert not neutral.by_hand
    assert new_arm.dynamorph.simulation.rehearsed == job.outcome.rehearsed
    assert f"to {neutral.frequency:.3g} Hz" in job.outcome.rehearsed
    assert not staleness.outdated(new_arm)
    again = bake(new_arm)  # it runs once
    assert not again.outcome.rehearsed and neutral.frequency == job.outcome.character.targets[0].frequency
    assert np.array_equal(again.outcome.bake.coordinates, job.outcome.bake.coordinates)


def test_a_rehearsal_that_does_not_get_there_says_so(new_arm, monkeypatch):
    """After its attempts, which take small steps here, it is baked as it is, and nothing claims otherwise."""
    monkeypatch.setattr(result_rehearsal, "FACTOR", (1.01, 1.01))
    limit(new_arm, 1e-3)
    job = bake(new_arm)
    assert new_arm.dynamorph.targets[0].frequency > 3.5
    assert job.outcome.rehearsed.endswith("and the skin still moves too far")
    assert not verdict(new_arm).is_believable


def verdict(obj) -> judge.Verdict:
    return judge.parsed(obj.dynamorph.bake.verdict)


def test_final_quality_takes_over_what_a_rehearsal_found(new_arm):
    """It is not rehearsed itself, and the panel says what to do."""
    limit(new_arm, 0.01)
    new_arm.dynamorph.model.solver, new_arm.dynamorph.model.cage_nodes = "FULL", 150
    said = "bake in Reduced first to keep"
    assert said in " ".join(drawn(new_arm, "DYNAMORPH_PT_physics"))
    job = bake(new_arm)
    assert not job.outcome.rehearsed and new_arm.dynamorph.targets[0].frequency == 3.5
    assert job.outcome.verdict.excess > 1.5 and verdict(new_arm).remedy == "STIFFEN"
    new_arm.dynamorph.model.solver = "REDUCED"
    assert said not in " ".join(drawn(new_arm, "DYNAMORPH_PT_physics"))
    reduced = bake(new_arm)
    assert reduced.outcome.rehearsed and reduced.input.can_rehearse
    new_arm.dynamorph.model.solver = "FULL"
    assert said not in " ".join(drawn(new_arm, "DYNAMORPH_PT_physics"))
    final = bake(new_arm)
    assert final.outcome.character.targets[0].frequency == reduced.outcome.character.targets[0].frequency > 3.5
    assert final.outcome.verdict.displacement < 0.7 * job.outcome.verdict.displacement


@pytest.mark.parametrize("by_hand, remedy", [(False, "REHEARSE"), (True, "STIFFEN")])
def test_the_remedy_is_one_that_helps(new_arm, monkeypatch, by_hand, remedy):
    """A rehearsal changes nothing that was set by hand."""
    monkeypatch.setattr(result_rehearsal, "TRIES", 1)
    limit(new_arm, 1e-3)
    new_arm.dynamorph.targets[0].by_hand = by_hand
    bake(new_arm)
    assert verdict(new_arm).remedy == remedy


def test_the_best_of_a_rehearsal_is_kept(new_arm, monkeypatch):
    """A frequency that overshoots in the first step is lowered again, and what is stored and baked match."""
    monkeypatch.setattr(result_rehearsal, "FACTOR", (8.0, 8.0))
    limit(new_arm, 0.0)
    farthest = bake(new_arm).outcome.verdict.displacement
    limit(new_arm, 0.6 * farthest)
    job = bake(new_arm)
    neutral = new_arm.dynamorph.targets[0]
    assert 3.5 < neutral.frequency < 0.8 * 8.0 * 3.5
    assert 0.5 < job.outcome.verdict.excess <= judge.SLACK
    assert job.outcome.character.targets[0].frequency == neutral.frequency
    assert f"to {neutral.frequency:.3g} Hz" in job.outcome.rehearsed
    again = bake(new_arm)
    assert again.outcome.verdict == job.outcome.verdict and np.array_equal(
        again.outcome.bake.coordinates, job.outcome.bake.coordinates
    )


@pytest.mark.parametrize("power", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("needed", [0.5, 3.6, 6.0, 20.0])
def test_a_rehearsal_finds_the_lowest_frequency(power, needed):
    """It does so however fast the motion decreases with the frequency, and never goes below the requested one."""
    rehearsal = result_rehearsal.Rehearsal(3.5)
    frequency = 3.5
    while frequency:
        rehearsal.learn(frequency, (needed / frequency) ** power)
        frequency = rehearsal.next()
    found = (needed / rehearsal.best) ** power
    assert rehearsal.best >= 3.5 and len(rehearsal.tried) <= 6
    assert found <= judge.SLACK or rehearsal.best == max(rehearsal.tried)
    if rehearsal.best > 3.5 and found <= judge.SLACK:
        assert found > 0.5


def test_a_rehearsal_without_finite_numbers_ends():
    rehearsal = result_rehearsal.Rehearsal(3.5)
    rehearsal.learn(3.5, float("nan"))
    assert rehearsal.next() is None and rehearsal.best == 3.5


def test_a_rehearsal_of_a_long_shot_reads_it_again(new_arm, monkeypatch):
    """The shot is read in chunks whose rig is not kept."""
    limit(new_arm, 0.0)
    farthest = bake(new_arm).outcome.verdict.displacement
    limit(new_arm, 0.6 * farthest)
    whole = bake(new_arm)
    new_arm.dynamorph.simulation.rehearsed = ""
    new_arm.dynamorph.targets[0].set_frequency(3.5, feel.FEELS["NATURAL"].damping)
    monkeypatch.setattr(bake_input, "CHUNK_FRAMES", 6)
    parts = bake(new_arm)
    assert parts.outcome.rehearsed == whole.outcome.rehearsed
    assert parts.outcome.bake.coordinates == pytest.approx(whole.outcome.bake.coordinates, rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("how", ["by hand", "pascals", "part", "patch", "unlimited", "cache"])
def test_what_others_have_to_agree_with_is_not_rehearsed(new_arm, how, tmp_path):
    limit(new_arm, 0.0 if how == "unlimited" else 1e-4)
    settings, options = new_arm.dynamorph, {}
    bpy.ops.dynamorph.build()
    if how == "by hand":
        settings.targets[0].bounce = 3.0
    elif how == "pascals":
        settings.targets[0].stiffness *= 0.9
    elif how == "part":
        options["frames"] = (1, 10)
    elif how == "cache":
        options["cache_dir"] = cache_dir.CacheDir(tmp_path)
    elif how == "patch":
        settings.simulation.use_scene_range, settings.simulation.keep_outside = False, True
        settings.simulation.frame_start, settings.simulation.frame_end = 1, 12
    before = settings.targets[0].material()
    job = bake(new_arm, **options)
    assert settings.targets[0].material() == before
    assert not job.outcome.rehearsed and settings.simulation.rehearsed == ""
    if how != "unlimited":
        assert not verdict(new_arm).is_believable


def test_targets_follow_the_neutral_unless_set_by_hand(new_arm):
    bpy.context.scene.frame_set(20)
    bpy.ops.dynamorph.add_target(key="flexed")
    bpy.context.scene.frame_set(1)
    bpy.ops.dynamorph.build()
    neutral, flexed = new_arm.dynamorph.targets
    assert flexed.stiffness == pytest.approx(neutral.stiffness)
    flexed.bounce = 9.0
    stiff = flexed.stiffness
    limit(new_arm, 1e-3)
    bake(new_arm)
    assert neutral.frequency > 3.5
    assert flexed.stiffness == stiff and flexed.by_hand


def test_pins_and_pascals_are_left_alone(new_arm):
    """With a stiffness in pascals and no limit there is neither calibration nor rehearsal."""
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
    assert found.remedy == "STIFFEN" and found.factor > 1.0
    assert any(text.startswith(found.text) for text in job.warnings)


def test_a_body_turned_inside_out_is_measured_by_volume():
    limits = judge.Limits(0.05, 0.6)
    found = judge.Verdict(limits, displacement=0.01, percentile=0.01, inverted=0.2)
    assert found.is_wreckage and found.excess > judge.SLACK
    assert "pressed inside out" in found.text
    assert judge.Verdict().excess == 0.0 and judge.Verdict(limits).is_believable
