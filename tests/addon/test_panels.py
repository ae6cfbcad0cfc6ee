# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels draw without error, and only what exists. Their look is tested in a window."""

import types

import bpy
import pytest
from builders import activate, hand_made_bake, part, rig_of
from layout import Layout, drawn, region


@pytest.mark.parametrize("panel", ["DYNAMORPH_PT_sidebar", "DYNAMORPH_PT_object_data"])
def test_through_the_workflow(arm, stand_in, panel):
    assert "dynamorph.add_soft_skin" in drawn(arm, panel) and "dynamorph.bake" not in drawn(arm, panel)
    bpy.ops.dynamorph.add_soft_skin()
    bpy.context.scene.frame_set(20)
    bpy.ops.dynamorph.add_target(key="flexed")
    assert {"Neutral", "flexed", "lower", "stiffness", "dynamorph.build", "dynamorph.bake"} <= set(drawn(arm, panel))
    assert "dynamorph.free_bake" not in drawn(arm, panel)
    bpy.ops.dynamorph.bake()
    texts = drawn(arm, panel)
    assert "dynamorph.free_bake" in texts and arm.dynamorph.model.summary[:40] in " ".join(texts)
    arm.dynamorph.model.modes = 5
    assert "Out of date: Detail (Modes) changed" in " ".join(drawn(arm, panel))


def test_progress_replaces_the_button(soft_arm, stand_in):
    batch, job = part("batch"), part("job").Job(soft_arm, goal="BAKE")
    batch.running, job.message = batch.Batch([job], "BAKE"), "Frame 7"
    try:
        texts = drawn(soft_arm)
        assert "0%  Frame 7" in texts and "dynamorph.cancel" in texts
        assert "dynamorph.bake" not in texts and "dynamorph.build" in texts
        assert not bpy.ops.dynamorph.build.poll()
        job.fraction, batch.running.time_left.seconds = 0.38, 11.4
        assert "38%  0:12 left  Frame 7" in drawn(soft_arm)
    finally:
        batch.running = None


def status() -> list[str]:
    out = []
    part("panels").draw_status(types.SimpleNamespace(layout=Layout(out)), None)
    return out


def test_the_status_bar_says_what_runs(soft_arm, stand_in, monkeypatch):
    """It looks when it draws, so nothing is left behind in a workspace or window that the artist has left."""
    assert status() == []
    job = part("job").Job(soft_arm, goal="BAKE")
    job.fraction, job.message = 0.4, "Frame 7"
    running = part("batch").Batch([job], "BAKE")
    monkeypatch.setattr(part("batch"), "running", running)
    assert status() == ["40%  Frame 7    Esc: cancel"]
    running.time_left.seconds = 72.0
    assert status() == ["40%  1:12 left  Frame 7    Esc: cancel"]
    monkeypatch.setattr(part("batch"), "running", None)
    shake = types.SimpleNamespace(label="Shake Test", seconds_left=1.5)
    monkeypatch.setattr(part("preview"), "preview", shake)
    assert status() == ["Shake Test  0:02 left    Esc: stop"]
    shake.seconds_left = None
    assert status() == ["Shake Test    Esc: stop"]


def test_a_narrow_list_has_room_for_names_only(soft_arm):
    assert "20 kPa" not in drawn(soft_arm) and "20 kPa" in drawn(soft_arm, place=region(400))


def test_many_bones_are_folded_away(soft_arm):
    target = soft_arm.dynamorph.targets[1]
    assert "lower" in drawn(soft_arm, unfolded=False)
    target.set_bones([f"bone {i}" for i in range(12)])
    folded = drawn(soft_arm, unfolded=False)
    assert "12 Bones" in folded and "bone 3" not in folded
    assert "bone 3" in drawn(soft_arm)


def test_a_missing_engine_is_shown(soft_arm, monkeypatch):
    monkeypatch.setattr(part("engine"), "engine_problem", lambda: "The engine cannot be loaded (no wheel). Install it")
    assert "The engine cannot be loaded (no wheel)." in " ".join(drawn(soft_arm))


def test_only_for_meshes(soft_arm):
    panel = bpy.types.DYNAMORPH_PT_sidebar
    assert not panel.poll(types.SimpleNamespace(object=None))
    assert not panel.poll(types.SimpleNamespace(object=bpy.data.objects.new("Empty", None)))


@pytest.mark.parametrize("mode", ["OBJECT", "POSE"])
def test_on_the_rig_for_its_skin(soft_arm, mode):
    rig = rig_of(soft_arm)
    activate(rig)
    bpy.ops.object.mode_set(mode=mode)
    assert {"Arm", "Neutral", "flexed"} <= set(drawn(rig))
    soft_arm.dynamorph.targets.clear()
    assert not bpy.ops.dynamorph.capture_pose.poll()


def test_a_target_without_its_key_is_marked(soft_arm):
    part("bake").write_keys(soft_arm, hand_made_bake(soft_arm))
    soft_arm.shape_key_clear()
    assert "flexed" in drawn(soft_arm)
    part("bake").free(soft_arm)
    assert "dynamorph.free_bake" not in drawn(soft_arm)
