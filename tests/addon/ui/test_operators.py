# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons and jobs, with an engine that answers at once."""

import itertools
import sys
import threading
import types

import addon_utils
import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import engine, errors
from bl_ext.user_default.dynamic_morph_targets.run import remembered
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch as run_batch
from bl_ext.user_default.dynamic_morph_targets.run.bake import job as run_job
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion, run_settings
from bl_ext.user_default.dynamic_morph_targets.scene.remembered import opened
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store
from bl_ext.user_default.dynamic_morph_targets.ui.operators import jobs
from bl_ext.user_default.dynamic_morph_targets.write import storage
from bl_ext.user_default.dynamic_morph_targets.write.bake import writer
from builders import StandInShot, activate, fingerprint, hand_made_bake, make_arm, make_soft, refused, rig_of
from installed import MODULE
from pressed import Pressed


def test_from_mesh_to_bake_and_back(scene, arm, stand_in):
    before = fingerprint(arm)
    assert bpy.ops.dynamorph.add_soft_skin() == {"FINISHED"}
    scene.frame_set(20)
    arm.active_shape_key_index = 1
    assert bpy.ops.dynamorph.add_target() == {"FINISHED"}
    assert arm.dynamorph.active_target.name == "flexed"
    assert arm.dynamorph.active_target.bone_names() == ("lower",)
    scene.frame_set(1)
    arm.active_shape_key_index = before["active"]
    assert bpy.ops.dynamorph.build() == {"FINISHED"}
    assert "10 nodes, 3 modes, 2 targets" in arm.dynamorph.model.summary
    assert bpy.ops.dynamorph.bake() == {"FINISHED"}
    assert stand_in.built == 1 and len(arm.dynamorph.bake.keys) == 3
    assert arm.data.shape_keys.key_blocks["flexed"].mute
    assert bpy.ops.dynamorph.delete_bake() == {"FINISHED"}
    assert fingerprint(arm) == before
    arm.dynamorph.active_target_index = 0
    assert bpy.ops.dynamorph.remove_target() == {"FINISHED"}
    assert not arm.dynamorph.targets and not arm.dynamorph.model.content_id
    assert fingerprint(arm) == before


def test_a_mesh_without_keys_gets_a_basis(arm):
    arm.shape_key_clear()
    bpy.ops.dynamorph.add_soft_skin()
    assert [k.name for k in arm.data.shape_keys.key_blocks] == ["Basis"]


def test_add_target_refusals(soft_arm):
    refused(bpy.ops.dynamorph.add_soft_skin, "is a soft skin already")
    refused(bpy.ops.dynamorph.add_target, "'flexed' is a target already", key="flexed")
    refused(bpy.ops.dynamorph.add_target, "neutral target", key="Basis")
    refused(bpy.ops.dynamorph.add_target, "no shape key 'nope'", key="nope")
    writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    refused(bpy.ops.dynamorph.add_target, "belongs to the bake", key="Dynamorph Mode 01")


def test_buttons_say_why_they_are_gray(scene, arm):
    assert not bpy.ops.dynamorph.bake.poll() and bpy.ops.dynamorph.add_soft_skin.poll()
    activate(rig_of(arm))
    assert bpy.ops.dynamorph.add_soft_skin.poll()  # it goes on the mesh
    arm.modifiers.clear()
    assert not bpy.ops.dynamorph.add_soft_skin.poll()


def test_capture_pose_moves_a_target(scene, soft_arm):
    soft_arm.dynamorph.active_target_index = 1
    rig = rig_of(soft_arm)
    rig.animation_data_clear()
    rig.pose.bones["lower"].rotation_euler.x = 0.0
    rig.pose.bones["upper"].rotation_euler.x = 0.5
    bpy.context.view_layer.update()
    bpy.ops.dynamorph.capture_pose()
    assert soft_arm.dynamorph.targets[1].bone_names() == ("upper",)


def test_default_bones_turn_more_than_5_degrees(scene, soft_arm):
    rig = rig_of(soft_arm)
    rig.animation_data_clear()
    rig.pose.bones["lower"].rotation_euler.x = 0.08
    rig.pose.bones["upper"].rotation_euler.x = 0.09
    bpy.context.view_layer.update()
    soft_arm.dynamorph.active_target_index = 1
    bpy.ops.dynamorph.capture_pose()
    assert soft_arm.dynamorph.targets[1].bone_names() == ("upper",)
    rig.data.bones["upper"].use_deform = False
    bpy.ops.dynamorph.capture_pose()
    assert soft_arm.dynamorph.targets[1].bone_names() == ()


def test_use_selected_bones(soft_arm):
    rig = rig_of(soft_arm)
    activate(rig)
    bpy.ops.object.mode_set(mode="POSE")
    for bone in rig.pose.bones:
        (bone if hasattr(bone, "select") else bone.bone).select = bone.name == "upper"
    soft_arm.dynamorph.active_target_index = 1
    bpy.ops.dynamorph.use_selected_bones()
    assert soft_arm.dynamorph.targets[1].bone_names() == ("lower", "upper")
    bpy.ops.dynamorph.use_selected_bones(extend=False)
    assert soft_arm.dynamorph.targets[1].bone_names() == ("upper",)


# The model ---------------------------------------------------------------------------------------------------------


def test_bake_builds_only_when_something_changed(soft_arm, stand_in):
    bpy.ops.dynamorph.bake()
    soft_arm.dynamorph.targets[1].stiffness = 5e5
    bpy.ops.dynamorph.bake()
    assert stand_in.built == 1
    soft_arm.data.shape_keys.key_blocks["flexed"].points[0].co.x += 0.1
    batch = run_batch
    storage.show_stale(soft_arm)
    assert soft_arm.dynamorph.model.stale == "shape of 'flexed' changed"
    job = run_job.Job(soft_arm, goal="BAKE")
    batch.run(job)
    assert stand_in.built == 2 and job.input.reasons == ["shape of 'flexed' changed"]
    assert soft_arm.dynamorph.model.stale == ""


def test_model_survives_save_and_load(soft_arm, stand_in, tmp_path):
    bpy.ops.dynamorph.build()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "arm.blend"))
    bpy.ops.dynamorph.bake()
    assert stand_in.built == 1


def test_a_second_build_replaces_the_first(soft_arm, stand_in):
    for size in (800, 1600):
        stand_in.bytes = size
        bpy.ops.dynamorph.build()
        opened.models.clear()
        assert model_store.stale_reasons(soft_arm, extract.character(soft_arm)) == []


@pytest.mark.fault("F14", "F15")
def test_large_models_go_beside_the_blend(soft_arm, stand_in, tmp_path, monkeypatch):
    monkeypatch.setattr(storage, "PACK_LIMIT", 100)
    refused(bpy.ops.dynamorph.build, "save the .blend first")
    (tmp_path / "one").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "one" / "arm.blend"))
    bpy.ops.dynamorph.build()
    assert model_store.PACKED not in soft_arm
    files = list((tmp_path / "one" / "dynamorph_models").iterdir())
    assert [file.stem for file in files] == [soft_arm.dynamorph.model.content_id]
    bpy.ops.dynamorph.bake()
    assert stand_in.built == 2  # the refused build and this one
    bpy.ops.wm.save_mainfile()
    (tmp_path / "one").rename(tmp_path / "two")  # file and folder move together
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "two" / "arm.blend"))
    bpy.ops.dynamorph.bake()
    assert stand_in.built == 2
    next((tmp_path / "two" / "dynamorph_models").iterdir()).unlink()
    opened.models.clear()
    reasons = model_store.stale_reasons(bpy.data.objects["Arm"], None)
    assert "is missing" in reasons[0]


@pytest.mark.fault("F09")
@pytest.mark.parametrize("content_id", ["../../etc/passwd", "/etc/passwd", "0" * 31, "x" * 32])
def test_a_model_id_cannot_lead_out_of_its_folder(soft_arm, stand_in, tmp_path, content_id):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    soft_arm.dynamorph.model.content_id = content_id
    with pytest.raises(errors.ModelFileError, match="missing"):
        model_store.stored_model(soft_arm)


@pytest.mark.fault("F01", "F02")
@pytest.mark.parametrize(
    "damage",
    [lambda n: n[:-1], lambda n: [7, *n[1:]], lambda n: [n[0], 7, *n[2:]], lambda n: "text", lambda n: 7, lambda n: {}],
)
def test_a_damaged_model_is_built_again(soft_arm, stand_in, damage):
    batch = run_batch
    bpy.ops.dynamorph.build()
    damaged = damage(list(soft_arm[model_store.PACKED]))
    del soft_arm[model_store.PACKED]
    soft_arm[model_store.PACKED] = damaged
    opened.models.clear()
    job = run_job.Job(soft_arm, goal="BAKE")
    batch.run(job)
    assert stand_in.built == 2 and len(job.input.reasons) == 1


# Errors and canceling change nothing ------------------------------------------------------------------------------


def test_an_error_in_the_engine_changes_nothing(soft_arm, stand_in):
    bpy.ops.dynamorph.bake()
    before = fingerprint(soft_arm)
    stand_in.fail = errors.SceneError("'Arm': the tissue is too soft: raise its stiffness")
    refused(bpy.ops.dynamorph.bake, "raise its stiffness")
    assert fingerprint(soft_arm) == before


def test_a_result_that_is_not_a_number_is_refused(soft_arm, stand_in, monkeypatch):
    bake = StandInShot.bake

    def broken(shot, exact=False):
        result, report = bake(shot)
        result.coordinates[3, 1] = float("nan")
        return result, report

    monkeypatch.setattr(StandInShot, "bake", broken)
    refused(bpy.ops.dynamorph.bake, "coordinates are not numbers")
    assert not soft_arm.dynamorph.bake.keys


def test_canceling_is_fast_and_changes_nothing(soft_arm, stand_in, apart):
    stand_in.waits["Arm"] = threading.Event()
    before = fingerprint(soft_arm)
    job = run_job.Job(soft_arm, goal="BAKE")
    batch = run_batch.Batch([job], "BAKE")
    steps = batch.steps()
    while job.progress.message != "Frame 0":
        next(steps)
    job.progress.canceled = True
    with pytest.raises(errors.Cancelled):
        list(steps)
    batch.stop()
    assert stand_in.looks < 10  # the bake did not run to its end
    assert fingerprint(soft_arm) == before


def test_ctrl_c_stops_the_work(soft_arm, stand_in):
    batch, job = run_batch, run_job
    stand_in.waits["Arm"] = threading.Event()

    def interrupt(_job):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        batch.run(job.Job(soft_arm, goal="BAKE"), interrupt)
    assert not soft_arm.dynamorph.bake.keys


@pytest.mark.fault("G01")
def test_undo_while_a_job_runs(soft_arm, stand_in, apart):
    """Undo replaces every object in memory; the job finds its own again."""
    bpy.ops.ed.undo_push(message="before")
    soft_arm.location.x = 1.0
    bpy.ops.ed.undo_push(message="moved")
    job = run_job.Job(soft_arm, goal="BAKE")
    batch = run_batch.Batch([job], "BAKE")
    list(batch.read())
    computing = batch.compute()
    next(computing, None)
    bpy.ops.ed.undo()
    bpy.data.objects["Arm"].name = "Renamed"
    list(computing)
    list(batch.write())
    assert bpy.data.objects["Renamed"].dynamorph.bake.keys


@pytest.mark.fault("G03")
def test_object_deleted_or_edited_while_a_job_runs(soft_arm, stand_in):
    job = run_job.Job(soft_arm, goal="BAKE")
    batch = run_batch.Batch([job], "BAKE")
    list(batch.read())
    list(batch.compute())
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.subdivide()
    bpy.ops.object.mode_set(mode="OBJECT")
    with pytest.raises(errors.SceneError, match="'Arm' changed while the job ran"):
        list(batch.write())
    bpy.data.objects.remove(soft_arm)
    with pytest.raises(errors.SceneError, match="'Arm' was deleted while the job ran"):
        list(batch.write())


def test_modal_bake(soft_arm, stand_in):
    pressed = Pressed(soft_arm, ["MOUSEMOVE", "TIMER"])
    assert pressed.result == {"FINISHED"} and len(soft_arm.dynamorph.bake.keys) == 3
    assert "20 frames" in pressed.reports[-1][1] and "built first: there was no model" in pressed.reports[-1][1]


def test_work_goes_on_however_long_the_panels_take_to_draw(soft_arm, stand_in, monkeypatch):
    """As without a graphics card."""
    monkeypatch.setattr(jobs, "SHOWN", 0.0)
    pressed = Pressed(soft_arm)
    assert pressed.result == {"FINISHED"} and pressed.turns < 1000


def test_escape_ends_a_bake_at_once_whatever_the_engine_does(soft_arm, stand_in):
    hears = threading.Event()
    stand_in.hears = hears
    before = fingerprint(soft_arm)

    def until_the_engine_computes():
        while not stand_in.playing.is_set():
            yield "TIMER"
        yield "ESC"

    try:
        pressed = Pressed(soft_arm, until_the_engine_computes())
        assert pressed.result == {"CANCELLED"} and pressed.reports == [("WARNING", "Canceled: nothing was changed")]
        stand_in.hears = None
        assert Pressed(soft_arm).result == {"FINISHED"}  # the other one still computes
        assert len(soft_arm.dynamorph.bake.keys) == 3
    finally:
        hears.set()
    writer.free(soft_arm)
    assert fingerprint(soft_arm) == before and not soft_arm.dynamorph.bake.keys


@pytest.fixture
def slow_rig(monkeypatch):
    """A rig that takes 5 ms a sample, by its own clock: a list of the samples that were taken."""
    samples, clock = [], itertools.count(0.0, 0.005)
    advance = rig_motion.RigSampling.advance

    def noted(sampling, *arguments):
        first = sampling.done
        try:
            return advance(sampling, *arguments)
        finally:
            samples.extend(range(first, sampling.done))

    monkeypatch.setattr(rig_motion.RigSampling, "advance", noted)
    monkeypatch.setattr(rig_motion, "time", types.SimpleNamespace(perf_counter=clock.__next__))
    return samples


def test_reading_the_rig_does_not_hold_the_window(soft_arm, stand_in, slow_rig):
    """A turn takes 35 ms: seven samples of 5 ms, and the one in progress."""
    shown = []
    pressed = Pressed(soft_arm, before_tick=lambda batch: shown.append((len(slow_rig), batch.fraction, batch.message)))
    assert pressed.result == {"FINISHED"} and len(slow_rig) >= 96
    taken, fractions, messages = zip(*shown, strict=True)
    assert np.diff(taken).max() <= 8
    assert list(fractions) == sorted(fractions) and any(text.startswith("Reading frame ") for text in messages)


@pytest.mark.fault("G01", "G02")
@pytest.mark.parametrize("ending", ["escape", "undo", "load", "an error"])
def test_reading_the_rig_ends_without_a_trace(soft_arm, stand_in, slow_rig, ending):
    bpy.ops.ed.undo_push(message="before")
    soft_arm.location.x = 1.0
    bpy.ops.ed.undo_push(message="moved")
    before = fingerprint(soft_arm)
    events = ["TIMER"] * 4 + ["ESC"] * (ending == "escape")

    def disturb(batch):
        if not 0.05 < batch.fraction < 0.1:
            return
        if ending == "undo" and not batch.undone:
            bpy.ops.ed.undo()
        if ending == "an error":
            bpy.data.objects["Arm"].modifiers.clear()
        if ending == "load":
            bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)

    pressed = Pressed(soft_arm, events, before_tick=disturb)
    if ending == "load":
        assert pressed.result is None and len(bpy.data.scenes) == 1 and not bpy.data.objects
        return
    assert pressed.result == {"CANCELLED"}
    words = {"escape": "Canceled: nothing", "undo": "undone while 'Arm' was read", "an error": "no Armature modifier"}
    assert words[ending] in pressed.reports[-1][1]
    assert len(bpy.data.scenes) == 1
    assert fingerprint(bpy.data.objects["Arm"]) == before


@pytest.mark.fault("G07")
def test_a_bake_waits_until_edit_mode_is_left(soft_arm, stand_in):
    """Nothing can be written there; a long simulation must not be lost for that."""
    waited, stand_in.waits["Arm"] = [], threading.Event()

    def edit(batch):
        if batch.message.startswith("Frame") and not waited:
            bpy.ops.object.mode_set(mode="EDIT")
            stand_in.waits["Arm"].set()
        if "leave Edit Mode" in batch.message:
            waited.append(batch.message)
        if len(waited) == 3:
            assert not soft_arm.dynamorph.bake.keys
            bpy.ops.object.mode_set(mode="OBJECT")

    pressed = Pressed(soft_arm, before_tick=edit)
    assert pressed.result == {"FINISHED"} and len(waited) == 3 and len(soft_arm.dynamorph.bake.keys) == 3


def test_escape_while_a_bake_waits(soft_arm, stand_in):
    before = fingerprint(soft_arm)
    entered = stand_in.waits["Arm"] = threading.Event()

    def edit(batch):
        if batch.message.startswith("Frame") and not entered.is_set():
            bpy.ops.object.mode_set(mode="EDIT")
            entered.set()
        if "leave Edit Mode" in batch.message:
            batch.cancel()

    assert Pressed(soft_arm, before_tick=edit).result == {"CANCELLED"}
    bpy.ops.object.mode_set(mode="OBJECT")
    assert fingerprint(soft_arm) == before


def test_modal_bake_reports_errors(soft_arm, stand_in):
    stand_in.fail = errors.SceneError("'Arm': too soft")
    pressed = Pressed(soft_arm)
    assert pressed.result == {"CANCELLED"} and pressed.reports == [("ERROR", "'Arm': too soft")]
    soft_arm.modifiers.clear()
    pressed = Pressed(soft_arm)
    assert pressed.result == {"CANCELLED"} and "no Armature modifier" in pressed.reports[0][1]


@pytest.mark.fault("C09")
def test_a_bug_in_the_engine_does_not_block_the_buttons(soft_arm, stand_in):
    stand_in.fail = KeyError("bug")
    pressed = Pressed(soft_arm)
    assert pressed.result == {"CANCELLED"} and "KeyError: 'bug'" in pressed.reports[0][1]
    assert remembered.work.running is None and bpy.ops.dynamorph.bake.poll()


@pytest.mark.fault("G05")
def test_disabling_the_addon_stops_the_job(soft_arm, stand_in, apart):
    stand_in.waits["Arm"] = threading.Event()
    batch = run_batch
    job = run_job.Job(soft_arm, goal="BAKE")
    remembered.work.running = batch.Batch([job], "BAKE")
    steps = remembered.work.running.steps()
    while job.progress.message != "Frame 0":
        next(steps)
    addon_utils.disable(MODULE)
    assert stand_in.looks < 10 and remembered.work.running is None
    addon_utils.enable(MODULE)


# All soft skins of the scene ---------------------------------------------------------------------------------------


@pytest.fixture
def leg(scene, soft_arm):
    """A second soft skin."""
    return make_soft(make_arm(scene, "Leg"))


def test_bake_all(soft_arm, leg, stand_in):
    before = fingerprint(soft_arm), fingerprint(leg)
    assert bpy.ops.dynamorph.bake_all() == {"FINISHED"}
    assert soft_arm.dynamorph.bake.keys and leg.dynamorph.bake.keys
    for obj in (soft_arm, leg):
        writer.free(obj)
    assert (fingerprint(soft_arm), fingerprint(leg)) == before


def test_bake_all_is_one_step(soft_arm, leg, stand_in):
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.dynamorph.bake_all()
    bpy.ops.ed.undo_push(message="baked")
    bpy.ops.ed.undo()
    assert not any(bpy.data.objects[name].dynamorph.bake.keys for name in ("Arm", "Leg"))
    bpy.ops.ed.redo()
    assert all(bpy.data.objects[name].dynamorph.bake.keys for name in ("Arm", "Leg"))


def test_one_progress_bar_for_all(soft_arm, leg, stand_in):
    seen, computing = [], set()
    for name in ("Arm", "Leg"):
        stand_in.waits[name] = threading.Event()

    def look(batch):
        seen.append(batch.fraction)
        if "Frame" in batch.message:
            computing.add(batch.name)
            stand_in.waits[batch.name].set()

    pressed = Pressed(soft_arm, operator="DYNAMORPH_OT_bake_all", before_tick=look)
    assert pressed.result == {"FINISHED"} and computing == {"Arm", "Leg"}
    assert seen == sorted(seen)
    assert ["20 frames" in text for _, text in pressed.reports] == [True, True]


def test_none_is_baked_when_one_cannot_be_or_on_escape(soft_arm, leg, stand_in):
    before = fingerprint(soft_arm), fingerprint(leg)
    shot = stand_in.Shot

    def fails_for_the_leg(model, character, *arguments):
        if character.name == "Leg":
            raise errors.SceneError("'Leg': too soft")
        return shot(model, character, *arguments)

    stand_in.Shot = fails_for_the_leg
    refused(bpy.ops.dynamorph.bake_all, "'Leg': too soft")
    assert (fingerprint(soft_arm), fingerprint(leg)) == before
    stand_in.Shot, stand_in.waits["Leg"] = shot, threading.Event()

    def escape(batch):
        if batch.name == "Leg" and "Frame" in batch.message:
            batch.cancel()

    assert Pressed(soft_arm, operator="DYNAMORPH_OT_bake_all", before_tick=escape).result == {"CANCELLED"}
    assert (fingerprint(soft_arm), fingerprint(leg)) == before
    leg.modifiers.clear()
    built = stand_in.built
    refused(bpy.ops.dynamorph.bake_all, "'Leg' has no Armature modifier")
    assert stand_in.built == built  # seen before any work


def test_bake_all_needs_a_soft_skin(arm):
    assert not bpy.ops.dynamorph.bake_all.poll()


def test_undo_of_a_bake(soft_arm, stand_in):
    bpy.ops.ed.undo_push(message="before")
    before = fingerprint(soft_arm)
    bpy.ops.dynamorph.bake()
    bpy.ops.ed.undo_push(message="baked")
    bpy.ops.ed.undo()
    assert fingerprint(bpy.data.objects["Arm"]) == before
    bpy.ops.ed.redo()
    obj = bpy.data.objects["Arm"]
    assert len(obj.dynamorph.bake.keys) == 3
    writer.free(obj)
    assert fingerprint(obj) == before


def test_the_range_is_checked(scene, soft_arm, stand_in):
    soft_arm.dynamorph.simulation.use_scene_range = False
    soft_arm.dynamorph.simulation.frame_start, soft_arm.dynamorph.simulation.frame_end = 5, 4
    refused(bpy.ops.dynamorph.bake, "last frame 4 comes before the first 5")
    soft_arm.dynamorph.simulation.frame_start, soft_arm.dynamorph.simulation.frame_end = -3, 2
    bpy.ops.dynamorph.bake()
    settings = run_settings.simulation_settings(soft_arm, scene)
    assert (settings.frame_start, settings.frame_end, settings.fps, settings.substeps) == (-3, 2, 24.0, 5)
    assert settings.gravity == pytest.approx((0.0, 0.0, -9.81))
    soft_arm.dynamorph.simulation.gravity = 0.0
    assert run_settings.simulation_settings(soft_arm, scene).gravity == (0.0, 0.0, 0.0)


# A missing engine --------------------------------------------------------------------------------------------------


@pytest.mark.fault("V01")
def test_without_the_engine_the_addon_says_so(soft_arm, monkeypatch):
    monkeypatch.setitem(sys.modules, "dynamorph", None)
    engine.engine_problem.cache_clear()
    before = fingerprint(soft_arm)
    refused(bpy.ops.dynamorph.bake, "engine cannot be loaded.*Install the Dynamorph extension")
    assert "cannot be loaded" in engine.engine_problem()
    assert fingerprint(soft_arm) == before
    assert bpy.ops.dynamorph.capture_pose() == {"FINISHED"}
    engine.engine_problem.cache_clear()
