# SPDX-License-Identifier: GPL-3.0-or-later
"""Faults while Blender goes on: undo, other files, the add-on switched off. See tests/faults.toml."""

import threading
import time

import addon_utils
import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.run import live, remembered
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch as run_batch
from bl_ext.user_default.dynamic_morph_targets.run.bake import job
from bl_ext.user_default.dynamic_morph_targets.write.bake import writer
from builders import evaluated_points, fingerprint
from installed import MODULE
from pressed import Pressed
from robustness import OPS, coarse
from test_undo_and_files import handlers

SOON = 2.0  # seconds in which a bake ends that is not wanted any more


@pytest.fixture
def at_frame(stand_in):
    """at_frame(act): to be given to Pressed; calls act(batch) once, while it is computed, and then lets that go on."""

    def at_frame(act):
        going_on = stand_in.waits["Arm"] = threading.Event()

        def look(batch):
            if batch.message.startswith("Frame") and not going_on.is_set():
                act(batch)
                going_on.set()

        return look

    return at_frame


# Undo --------------------------------------------------------------------------------------------------------------


@pytest.mark.fault("G01")
@pytest.mark.parametrize("keys", [["undo"], ["undo", "redo"], ["undo", "undo", "redo"]])
def test_undo_and_redo_while_a_bake_computes(soft_arm, at_frame, keys):
    """They replace every object in memory: the bake goes onto the one that is there then, and is one step."""
    for x in (1.0, 2.0):
        bpy.ops.ed.undo_push(message=f"before {x}")
        soft_arm.location.x = x
    bpy.ops.ed.undo_push(message="moved")

    def undo(_batch):
        for key in keys:
            getattr(bpy.ops.ed, key)()

    pressed = Pressed(soft_arm, before_tick=at_frame(undo))
    obj = bpy.data.objects["Arm"]
    assert pressed.result == {"FINISHED"} and len(obj.dynamorph.bake.keys) == 3
    writer.free(obj)
    assert obj.data.shape_keys.key_blocks.keys() == ["Basis", "flexed", "smile"]


# Other files -------------------------------------------------------------------------------------------------------


@pytest.mark.fault("G02")
@pytest.mark.parametrize("other", ["new", "another", "the same again"])
def test_another_file_while_a_bake_computes(soft_arm, stand_in, tmp_path, other):
    for name in ("another", "shot"):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / f"{name}.blend"))
    before = fingerprint(soft_arm)
    stand_in.waits["Arm"] = threading.Event()  # it is canceled before it may go on
    seconds = []

    def load(batch):
        if not batch.message.startswith("Frame"):
            return
        began = time.monotonic()
        if other == "new":
            bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
        else:
            path = tmp_path / "another.blend" if other == "another" else bpy.data.filepath
            bpy.ops.wm.open_mainfile(filepath=str(path))
        seconds.append(time.monotonic() - began)

    assert Pressed(soft_arm, before_tick=load).result is None
    assert len(seconds) == 1 and seconds[0] < SOON
    if other == "new":
        assert not bpy.data.objects and not bpy.data.actions
    else:
        assert fingerprint(bpy.data.objects["Arm"]) == before


@pytest.mark.fault("G02")
def test_another_file_while_live_plays(soft_arm, tmp_path):
    """The file that is opened again has no frozen skin, and plays on."""
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    coarse(soft_arm)
    OPS.build()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    OPS.live()
    bpy.context.scene.frame_set(5)
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    bpy.context.scene.frame_set(6)
    assert not remembered.live.sessions
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "shot.blend"))
    obj = bpy.data.objects["Arm"]
    assert obj.data.shape_keys.key_blocks.keys() == ["Basis", "flexed", "smile"]
    OPS.live()
    for frame in (2, 3, 4):
        bpy.context.scene.frame_set(frame)
    assert live.problem(obj) == "" and np.isfinite(evaluated_points(obj)).all()


# The add-on switched off -------------------------------------------------------------------------------------------


@pytest.mark.fault("G05", "G06")
def test_switched_off_and_on_during_a_bake_twenty_times(soft_arm, stand_in, apart):
    before, installed = fingerprint(soft_arm), handlers()
    for _ in range(20):
        stand_in.waits["Arm"] = threading.Event()
        batch = run_batch
        remembered.work.running = batch.Batch([job.Job(soft_arm, goal="BAKE")], "BAKE")
        steps = remembered.work.running.steps()
        while not remembered.work.running.message.startswith("Frame"):
            next(steps)
        began = time.monotonic()
        addon_utils.disable(MODULE)
        assert time.monotonic() - began < SOON
        assert handlers() == [] and remembered.work.running is None
        addon_utils.enable(MODULE)
        assert handlers() == installed
    assert fingerprint(soft_arm) == before
    stand_in.waits.clear()
    assert OPS.bake() == {"FINISHED"}
