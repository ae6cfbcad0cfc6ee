# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons and jobs, with an engine that answers at once."""

import sys
import threading
import time
import types

import addon_utils
import bpy
import pytest
from builders import MODULE, activate, fingerprint, hand_made_bake, part, rig_of


def refused(operator, words, **arguments):
    """The operator must report an error with these words, which Python sees as RuntimeError."""
    with pytest.raises(RuntimeError, match=words):
        operator(**arguments)


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
    assert bpy.ops.dynamorph.free_bake() == {"FINISHED"}
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
    refused(bpy.ops.dynamorph.add_soft_skin, "has a soft skin already")
    refused(bpy.ops.dynamorph.add_target, "'flexed' is a target already", key="flexed")
    refused(bpy.ops.dynamorph.add_target, "neutral target", key="Basis")
    refused(bpy.ops.dynamorph.add_target, "no shape key 'nope'", key="nope")
    part("sinks").write_modal_keys(soft_arm, hand_made_bake(soft_arm))
    refused(bpy.ops.dynamorph.add_target, "belongs to the bake", key="Dynamorph Mode 01")


def test_buttons_say_why_they_are_grey(scene, arm):
    assert not bpy.ops.dynamorph.bake.poll() and bpy.ops.dynamorph.add_soft_skin.poll()
    activate(rig_of(arm))
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
    assert soft_arm.dynamorph.targets[1].bone_names() == ("upper",)


# The model ---------------------------------------------------------------------------------------------------------


def test_bake_builds_only_when_something_changed(soft_arm, stand_in):
    bpy.ops.dynamorph.bake()
    soft_arm.dynamorph.targets[1].stiffness = 5e5
    bpy.ops.dynamorph.bake()
    assert stand_in.built == 1
    soft_arm.data.shape_keys.key_blocks["flexed"].points[0].co.x += 0.1
    jobs = part("jobs")
    jobs.show_stale(soft_arm)
    assert soft_arm.dynamorph.model.stale == "shape of 'flexed' changed"
    job = jobs.Job(soft_arm, goal="BAKE")
    jobs.run(job)
    assert stand_in.built == 2 and job.reasons == ["shape of 'flexed' changed"]
    assert soft_arm.dynamorph.model.stale == ""
    soft_arm.dynamorph.model.modes = 9
    assert soft_arm.dynamorph.model.stale


def test_model_survives_save_and_load(soft_arm, stand_in, tmp_path):
    bpy.ops.dynamorph.build()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "arm.blend"))
    bpy.ops.dynamorph.bake()
    assert stand_in.built == 1


def test_a_second_build_replaces_the_first(soft_arm, stand_in):
    jobs, extract = part("jobs"), part("extract")
    for size in (800, 1600):
        stand_in.bytes = size
        bpy.ops.dynamorph.build()
        jobs._load.cache_clear()
        assert jobs.stale_reasons(soft_arm, extract.character(soft_arm)) == []


def test_large_models_go_beside_the_blend(soft_arm, stand_in, tmp_path, monkeypatch):
    jobs = part("jobs")
    monkeypatch.setattr(jobs, "PACK_LIMIT", 100)
    refused(bpy.ops.dynamorph.build, "save the .blend first")
    (tmp_path / "one").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "one" / "arm.blend"))
    bpy.ops.dynamorph.build()
    assert jobs.PACKED not in soft_arm
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
    jobs._load.cache_clear()
    reasons = jobs.stale_reasons(bpy.data.objects["Arm"], None)
    assert "is missing" in reasons[0]


@pytest.mark.parametrize("content_id", ["../../etc/passwd", "/etc/passwd", "0" * 31, "x" * 32])
def test_a_model_id_cannot_lead_out_of_its_folder(soft_arm, stand_in, tmp_path, content_id):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    soft_arm.dynamorph.model.content_id = content_id
    with pytest.raises(part("model_file").ModelFileError, match="missing"):
        part("jobs").stored_model(soft_arm)


@pytest.mark.parametrize("damage", [lambda b: b[:-1], lambda b: b"x" + b[1:], lambda b: "text", lambda b: 7])
def test_a_damaged_model_is_built_again(soft_arm, stand_in, damage):
    jobs = part("jobs")
    bpy.ops.dynamorph.build()
    soft_arm[jobs.PACKED] = damage(soft_arm[jobs.PACKED])
    jobs._load.cache_clear()
    job = jobs.Job(soft_arm, goal="BAKE")
    jobs.run(job)
    assert stand_in.built == 2 and len(job.reasons) == 1


# Errors and cancelling change nothing ------------------------------------------------------------------------------


def test_an_error_in_the_engine_changes_nothing(soft_arm, stand_in):
    bpy.ops.dynamorph.bake()
    before = fingerprint(soft_arm)
    stand_in.fail = ValueError("'Arm': the flesh is too soft: raise its stiffness")
    refused(bpy.ops.dynamorph.bake, "raise its stiffness")
    assert fingerprint(soft_arm) == before


def test_a_result_that_is_not_a_number_is_refused(soft_arm, stand_in, monkeypatch):
    bake = stand_in.bake

    def broken(*args):
        result, report = bake(*args)
        result.coordinates[3, 1] = float("nan")
        return result, report

    monkeypatch.setattr(stand_in, "bake", broken)
    refused(bpy.ops.dynamorph.bake, "coordinates are not numbers")
    assert not soft_arm.dynamorph.bake.keys


def test_cancelling_is_fast_and_changes_nothing(soft_arm, stand_in):
    jobs, extract = part("jobs"), part("extract")
    stand_in.patience = 5.0
    before = fingerprint(soft_arm)
    job = jobs.Job(soft_arm, goal="BAKE")
    job.prepare()
    job.start()
    time.sleep(0.2)
    began = time.perf_counter()
    job.cancelled = True
    with pytest.raises(extract.Cancelled):
        job.wait()
    assert time.perf_counter() - began < 1.0
    assert fingerprint(soft_arm) == before


def test_ctrl_c_stops_the_thread(soft_arm, stand_in):
    jobs = part("jobs")
    stand_in.patience = 5.0

    def interrupt(_job):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        jobs.run(jobs.Job(soft_arm, goal="BAKE"), interrupt)
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("dynamorph")]


def test_undo_while_a_job_runs(soft_arm, stand_in):
    """Undo replaces every object in memory; the job finds its own again."""
    jobs = part("jobs")
    bpy.ops.ed.undo_push(message="before")
    soft_arm.location.x = 1.0
    bpy.ops.ed.undo_push(message="moved")
    job = jobs.Job(soft_arm, goal="BAKE")
    job.prepare()
    job.start()
    bpy.ops.ed.undo()
    bpy.data.objects["Arm"].name = "Renamed"
    job.wait()
    job.commit()
    assert bpy.data.objects["Renamed"].dynamorph.bake.keys


def test_object_deleted_or_edited_while_a_job_runs(soft_arm, stand_in):
    jobs, extract = part("jobs"), part("extract")
    job = jobs.Job(soft_arm, goal="BAKE")
    job.prepare()
    job.start()
    job.wait()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.subdivide()
    bpy.ops.object.mode_set(mode="OBJECT")
    with pytest.raises(extract.SceneError, match="'Arm' changed while the job ran"):
        job.commit()
    bpy.data.objects.remove(soft_arm)
    with pytest.raises(extract.SceneError, match="deleted"):
        job.commit()


class Window:
    """Stands in for the context of a window: the modal operator needs timers, a cursor and a status line."""

    def __init__(self, obj):
        self.object = obj
        self.window = self.window_manager = self.workspace = self
        self.windows = []
        self.timers = 0
        self.status = None

    def event_timer_add(self, _seconds, window):
        self.timers += 1
        return window

    def event_timer_remove(self, _timer):
        self.timers -= 1

    def status_text_set(self, text):
        self.status = text

    def modal_handler_add(self, _operator):
        pass

    def cursor_set(self, _cursor):
        pass


def modal(obj, events):
    """Plays the bake operator in a window: `events`, then timer ticks to the end. Returns (result, reports)."""
    operators = part("operators")

    class Bake(operators.JobOperator):
        goal = "BAKE"
        reports = []

        def report(self, kind, text):
            self.reports.append((*kind, text))

    operator, window = Bake(), Window(obj)
    result = operators.guarded(operator, operator._begin, window)
    events = iter(events)
    while result == {"RUNNING_MODAL"} or result == {"PASS_THROUGH"}:
        assert part("jobs").running is operator.job and window.timers == 1
        result = operator.modal(window, types.SimpleNamespace(type=next(events, "TIMER"), value="PRESS"))
        time.sleep(0.01)
    assert part("jobs").running is None and window.timers == 0 and window.status is None
    return result, operator.reports


def test_modal_bake(soft_arm, stand_in):
    stand_in.patience = 0.1
    result, reports = modal(soft_arm, ["MOUSEMOVE", "TIMER"])
    assert result == {"FINISHED"} and len(soft_arm.dynamorph.bake.keys) == 3
    assert "20 frames" in reports[-1][1] and "built first: not built yet" in reports[-1][1]


def test_modal_bake_is_cancelled_by_escape(soft_arm, stand_in):
    stand_in.patience = 5.0
    before = fingerprint(soft_arm)
    began = time.perf_counter()
    result, reports = modal(soft_arm, ["TIMER", "ESC"])
    assert result == {"CANCELLED"} and reports == [("WARNING", "Cancelled: nothing was changed")]
    assert time.perf_counter() - began < 1.5
    assert fingerprint(soft_arm) == before


def test_modal_bake_reports_errors(soft_arm, stand_in):
    stand_in.fail = ValueError("'Arm': too soft")
    assert modal(soft_arm, []) == ({"CANCELLED"}, [("ERROR", "'Arm': too soft")])
    soft_arm.modifiers.clear()
    result, reports = modal(soft_arm, [])
    assert result == {"CANCELLED"} and "no Armature modifier" in reports[0][1]


def test_a_bug_in_the_engine_does_not_block_the_buttons(soft_arm, stand_in):
    stand_in.fail = KeyError("bug")
    with pytest.raises(KeyError):
        modal(soft_arm, [])
    assert part("jobs").running is None


def test_disabling_the_addon_stops_the_job(soft_arm, stand_in):
    stand_in.patience = 5.0
    jobs = part("jobs")
    job = jobs.running = jobs.Job(soft_arm, goal="BAKE")
    job.prepare()
    job.start()
    began = time.perf_counter()
    addon_utils.disable(MODULE)
    assert time.perf_counter() - began < 2.0 and not job._thread.is_alive() and jobs.running is None
    addon_utils.enable(MODULE)


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
    part("sinks").free(obj)
    assert fingerprint(obj) == before


def test_the_range_is_checked(scene, soft_arm, stand_in):
    soft_arm.dynamorph.simulation.use_scene_range = False
    soft_arm.dynamorph.simulation.start, soft_arm.dynamorph.simulation.end = 5, 4
    refused(bpy.ops.dynamorph.bake, "last frame 4 comes before the first 5")
    soft_arm.dynamorph.simulation.start, soft_arm.dynamorph.simulation.end = -3, 2
    bpy.ops.dynamorph.bake()
    settings = part("extract").simulation_settings(soft_arm, scene)
    assert (settings.start, settings.end, settings.fps, settings.substeps) == (-3, 2, 24.0, 5)
    assert settings.gravity == pytest.approx((0.0, 0.0, -9.81))
    soft_arm.dynamorph.simulation.gravity = 0.0
    assert part("extract").simulation_settings(soft_arm, scene).gravity == (0.0, 0.0, 0.0)


# A missing engine --------------------------------------------------------------------------------------------------


def test_without_the_engine_the_addon_says_so(soft_arm, monkeypatch):
    jobs = part("jobs")
    monkeypatch.setitem(sys.modules, "dynamorph", None)
    jobs.engine_problem.cache_clear()
    before = fingerprint(soft_arm)
    refused(bpy.ops.dynamorph.bake, "engine cannot be loaded.*Install the Dynamorph extension")
    assert "cannot be loaded" in jobs.engine_problem()
    assert fingerprint(soft_arm) == before
    assert bpy.ops.dynamorph.capture_pose() == {"FINISHED"}
    jobs.engine_problem.cache_clear()
