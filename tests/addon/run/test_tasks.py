# SPDX-License-Identifier: GPL-3.0-or-later
"""Work that is no job, in a window: it shows its progress, and Esc stops it before anything has changed."""

import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors, message
from bl_ext.user_default.dynamic_morph_targets.run import remembered
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.tools import weight_curves
from bl_ext.user_default.dynamic_morph_targets.run.work import task as task_module
from bl_ext.user_default.dynamic_morph_targets.run.work.task import Task, elsewhere
from bl_ext.user_default.dynamic_morph_targets.ui.operators import jobs
from builders import rig_of
from layout import drawn
from pressed import Pressed
from test_targets import channels, drive
from threaded import Threaded

OPS = bpy.ops.dynamorph


@pytest.fixture
def slow(monkeypatch):
    """A window's turn ends after each piece, and none is for the progress bar alone."""
    monkeypatch.setattr(jobs, "SLICE", 0.0)
    monkeypatch.setattr(jobs, "SHOWN", float("inf"))
    monkeypatch.setattr(weight_curves, "SLICE", 0.0)


def test_weights_are_read_a_few_frames_at_a_time(soft_arm, slow):
    seen = []
    pressed = Pressed(
        soft_arm,
        operator="DYNAMORPH_OT_update_target_weights",
        before_tick=lambda task: seen.append((task.fraction, task.message)),
    )
    assert pressed.result == {"FINISHED"}
    assert seen[1:3] == [(0.05, "Reading frame 2"), (0.1, "Reading frame 3")]
    assert len(weight_curves.drawn(soft_arm)[1].weights) == 20


@pytest.mark.parametrize("name", ["update_target_weights", "find_uncovered_pose"])
def test_esc_while_frames_are_read(soft_arm, slow, name):
    remembered.live.poses.clear()
    frame = bpy.context.scene.frame_current
    pressed = Pressed(soft_arm, ["TIMER", "TIMER", "ESC"], f"DYNAMORPH_OT_{name}")
    assert pressed.result == {"CANCELLED"} and pressed.turns == 3
    assert pressed.reports == [("WARNING", "Canceled: nothing was changed")]
    assert weight_curves.drawn(soft_arm) is None and bpy.context.scene.frame_current == frame


def test_undo_while_frames_are_read(soft_arm, slow):
    def undone(task):
        task.undone = task.fraction > 0.0

    pressed = Pressed(soft_arm, operator="DYNAMORPH_OT_find_uncovered_pose", before_tick=undone)
    assert pressed.result == {"CANCELLED"} and "The scene was undone while 'Arm' was read" in pressed.reports[0][1]


def test_a_deleted_object_ends_it(soft_arm, slow):
    def delete(task):
        if task.fraction:
            bpy.data.objects.remove(bpy.data.objects["Arm"])

    pressed = Pressed(soft_arm, operator="DYNAMORPH_OT_update_target_weights", before_tick=delete)
    assert pressed.result == {"CANCELLED"} and "was deleted" in pressed.reports[0][1]


def test_esc_between_two_drivers(arm, slow):
    """Between them the armature is as the artist left it."""
    OPS.add_soft_skin()
    for name in ("flexed", "smile"):
        drive(arm, name, "a", a=("ROT_X", "lower"))
    rig = rig_of(arm)
    before, seen = channels(rig), []
    pressed = Pressed(
        arm,
        ["TIMER", "TIMER", "ESC"],
        "DYNAMORPH_OT_suggest_targets",
        lambda task: seen.append((task.message, channels(rig) == before, len(bpy.data.scenes))),
    )
    assert pressed.result == {"CANCELLED"} and len(arm.dynamorph.targets) == 1
    assert seen[1:] == [("Trying the driver of 'flexed'", True, 1), ("Trying the driver of 'smile'", True, 1)]


def half(report):
    """Work that another process knows too."""
    report(0.5)
    return "done"


@pytest.mark.parametrize("place", ["here", "threaded"])
def test_what_work_reports_and_returns_is_the_task_s(soft_arm, monkeypatch, place):
    if place == "threaded":
        monkeypatch.setattr(task_module, "worker_for", Threaded)
    task = Task(soft_arm, "CHECK_TARGETS", elsewhere(half, "Checking targets", "Arm", reports=True))
    batch.run_all(task)
    assert task.result == "done"


def test_what_work_raises_is_reported(soft_arm):
    def fails():
        raise errors.SceneError("'{name}' is too soft", name="Arm")

    task = Task(soft_arm, "CHECK_TARGETS", elsewhere(fails, "", "Arm"))
    with pytest.raises(errors.SceneError, match="'Arm' is too soft"):
        batch.run_all(task)


@pytest.fixture
def built_arm(soft_arm):
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    soft_arm.dynamorph.model.cage_nodes, soft_arm.dynamorph.model.modes = 200, 8
    OPS.build()
    return soft_arm


def test_targets_are_checked_in_another_process(built_arm):
    pressed = Pressed(built_arm, operator="DYNAMORPH_OT_check_targets")
    assert pressed.result == {"FINISHED"} and len(built_arm.dynamorph.live.checks.split("\n")) == 2
    built_arm.dynamorph.live.checks = ""
    assert Pressed(built_arm, ["ESC"], "DYNAMORPH_OT_check_targets").result == {"CANCELLED"}
    assert built_arm.dynamorph.live.checks == ""


def test_a_bounce_is_fitted_in_another_process(built_arm):
    built_arm.dynamorph.active_target_index = 1
    target = built_arm.dynamorph.targets[1]
    before = target.stiffness
    assert Pressed(built_arm, ["ESC"], "DYNAMORPH_OT_fit_bounce", frequency=9.0).result == {"CANCELLED"}
    assert target.stiffness == before
    assert Pressed(built_arm, operator="DYNAMORPH_OT_fit_bounce", frequency=9.0).result == {"FINISHED"}
    assert target.stiffness != before and target.by_hand


def test_the_first_row_shows_the_progress(soft_arm, monkeypatch):
    task = Task(soft_arm, "SUGGEST_POSE", iter(()))
    task.fraction, task.message = 0.5, message.Message("Reading frame {frame}", frame=7)
    monkeypatch.setattr(remembered.work, "running", task)
    assert drawn(soft_arm)[:2] == ["50%  Reading frame 7", "dynamorph.cancel"]


def test_soft_skins_of_other_scenes_stay_theirs(soft_arm, slow):
    """The frames are read in the scene in which it began."""
    other = bpy.data.scenes.new("Other")

    def switch(_task):
        bpy.context.window.scene = other

    scene = bpy.context.scene
    pressed = Pressed(soft_arm, operator="DYNAMORPH_OT_update_target_weights", before_tick=switch)
    bpy.context.window.scene = scene
    assert pressed.result == {"FINISHED"} and len(weight_curves.drawn(soft_arm)[1].weights) == 20
