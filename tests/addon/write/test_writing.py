# SPDX-License-Identifier: GPL-3.0-or-later
"""When and where the results of jobs are written into Blender, and that all of them are written or none."""

import threading
from dataclasses import replace
from functools import partial

import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.run.bake.batch import Batch, run_all
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene import events
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from bl_ext.user_default.dynamic_morph_targets.write import storage
from bl_ext.user_default.dynamic_morph_targets.write.bake import writer
from bl_ext.user_default.dynamic_morph_targets.write.display import live_key
from builders import fingerprint, make_arm, make_soft


@pytest.fixture
def leg(scene, soft_arm):
    """A second soft skin."""
    return make_soft(make_arm(scene, "Leg"))


def baking(*objects, folder=None, goal="BAKE"):
    """The batch that bakes them all."""
    jobs = [Job(obj, goal, folder=folder) for obj in objects]
    return Batch(jobs, "BAKE_ALL")


def when_computed(batch, stand_in, change):
    """Run the work, and change something when the last job computes."""
    last, changed = batch.jobs[-1], threading.Event()
    stand_in.waits[last.name] = changed
    try:
        for _ in batch.steps():
            if not changed.is_set() and last.progress.message.startswith("Frame"):
                change()
                changed.set()
    finally:
        batch.stop()
    assert changed.is_set()


def refuse(obj):
    """Make the object refuse bakes from now on."""
    obj.data.shape_keys.animation_data_create().use_nla = False


def state(*objects):
    return [(fingerprint(obj), obj.dynamorph.model.content_id, obj.dynamorph.bake.summary) for obj in objects]


# All or nothing ------------------------------------------------------------------------------------------------------


def test_none_is_written_when_one_is_refused(soft_arm, leg, stand_in, apart):
    leg.data.shape_keys.animation_data_create()
    before = state(soft_arm, leg)
    with pytest.raises(errors.WriteError, match="NLA is turned off for the shape keys of 'Leg'"):
        when_computed(baking(soft_arm, leg), stand_in, lambda: refuse(leg))
    assert state(soft_arm, leg) == before


def test_no_model_is_stored_with_a_bake_that_is_refused(soft_arm, stand_in, apart):
    with pytest.raises(errors.WriteError, match="NLA is turned off"):
        when_computed(baking(soft_arm), stand_in, lambda: refuse(soft_arm))
    assert soft_arm.dynamorph.model.content_id == ""


@pytest.mark.parametrize("step", ["scaled_keys", "add_curve", "key_displacement", "mute_targets"])
@pytest.mark.parametrize("first", ["first", "again"])
def test_none_is_written_when_the_second_write_fails(soft_arm, leg, stand_in, monkeypatch, step, first):
    written = getattr(writer, step)
    if first == "again":
        run_all(baking(soft_arm, leg))
    before = state(soft_arm, leg)

    def fails_for_the_leg(given, *args):
        owner = given.id_data  # the object, its shape keys, or the Action of the bake
        if owner in (leg, leg.data.shape_keys) or " Leg" in owner.name:
            raise MemoryError
        return written(given, *args)

    def spoils_those_of_the_leg(baked, *args):
        """The last one has a point too few, which Blender refuses when the others are there."""
        calls.append(baked)
        *others, last = written(baked, *args)
        return [*others, last if len(calls) == 1 else replace(last, points=last.points[1:])]

    calls = []

    with monkeypatch.context() as patch:
        patch.setattr(writer, step, spoils_those_of_the_leg if step == "scaled_keys" else fails_for_the_leg)
        with pytest.raises((MemoryError, RuntimeError)):
            run_all(baking(soft_arm, leg))
    assert state(soft_arm, leg) == before


def test_a_point_cache_that_nothing_plays_is_removed(soft_arm, leg, stand_in, apart, tmp_path):
    for obj in (soft_arm, leg):
        obj.dynamorph.output.format = "PC2"
    with pytest.raises(errors.WriteError):
        when_computed(baking(soft_arm, leg, folder=tmp_path), stand_in, lambda: refuse(leg))
    assert not list(tmp_path.rglob("*.pc2"))


def test_point_caches_go_where_the_blend_was_saved_meanwhile(soft_arm, stand_in, apart, tmp_path):
    """Or they would be left behind when its folder moves."""
    folders = [tmp_path / name for name in "AB"]
    for folder in folders:
        folder.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(folders[0] / "shot.blend"))
    soft_arm.dynamorph.output.format = "PC2"
    save = partial(bpy.ops.wm.save_as_mainfile, filepath=str(folders[1] / "shot.blend"))
    when_computed(baking(soft_arm), stand_in, save)
    (cache,) = tmp_path.rglob("*.pc2")
    assert cache.parent == folders[1] / "dynamorph_caches"
    assert bpy.path.abspath(soft_arm.modifiers[0].filepath) == str(cache)


@pytest.mark.fault("F11")
def test_a_folder_that_takes_no_model_is_seen_before_anything_is_written(
    soft_arm, leg, stand_in, tmp_path, monkeypatch
):
    monkeypatch.setattr(storage, "PACK_LIMIT", 100)
    good, bad = tmp_path / "good", tmp_path / "bad"
    bad.mkdir()
    (bad / "dynamorph_models").write_text("no folder")
    before, job = state(soft_arm, leg), Job
    jobs = [job(soft_arm, "BAKE", folder=good), job(leg, "BAKE", folder=bad)]
    with pytest.raises(OSError):
        run_all(Batch(jobs, "BAKE_ALL"))
    assert state(soft_arm, leg) == before and not list(tmp_path.rglob("*.dynamorph"))


def test_a_bake_takes_the_place_of_live_on_all_meshes(soft_arm, stand_in):
    live_key.add(soft_arm, ["flexed"])
    run_all(baking(soft_arm))
    names = soft_arm.data.shape_keys.key_blocks.keys()
    assert "Dynamorph Live" not in names and "Dynamorph Mode 01" in names
    writer.free(soft_arm)
    assert not soft_arm.data.shape_keys.key_blocks["flexed"].mute


# While Blender renders -----------------------------------------------------------------------------------------------


@pytest.mark.fault("G04")
@pytest.mark.parametrize("goal", ["BUILD", "BAKE"])
def test_nothing_is_written_while_blender_renders(soft_arm, stand_in, monkeypatch, goal):
    batch, before, messages = baking(soft_arm, goal=goal), state(soft_arm), []
    list(batch.read())
    list(batch.compute())
    monkeypatch.setattr(events, "render_runs", lambda: len(messages) < 3)
    for _ in batch.write():
        assert state(soft_arm) == before
        messages.append(batch.message)
    assert messages == ["Waiting for the render to end"] * 3
    assert soft_arm.dynamorph.model.content_id and soft_arm.dynamorph.bake.exists == (goal == "BAKE")


# Another scene in the window -----------------------------------------------------------------------------------------


@pytest.fixture
def other(scene):
    """A scene whose frames and units have other lengths."""
    other = bpy.data.scenes.new("Other")
    other.render.frame_map_new, other.render.fps, other.frame_end = 200, 60, 5
    other.unit_settings.system, other.unit_settings.scale_length = "METRIC", 0.01
    return other


def times(obj) -> list[float]:
    """The first and the last time of the bake's curves."""
    return [round(time, 3) for time in obj.dynamorph.bake.action.frame_range]


@pytest.mark.fault("G08")
@pytest.mark.parametrize("when", ["read", "sampled", "computed"])
def test_a_job_stays_in_the_scene_that_it_began_in(scene, soft_arm, other, stand_in, when):
    batch = baking(soft_arm)
    if when != "read":
        list(batch.read())
    if when == "computed":
        list(batch.compute())
    bpy.context.window.scene = other
    if when == "read":
        list(batch.read())
    if when != "computed":
        list(batch.compute())
    list(batch.write())
    assert bpy.context.scene == other
    settings = batch.jobs[0].input.settings
    assert (settings.frame_start, settings.frame_end, settings.fps) == (1, 20, 24.0)
    assert times(soft_arm) == [1.0, 20.0]
    bpy.context.window.scene = scene
    assert staleness.outdated(soft_arm) == []


@pytest.mark.fault("G03")
def test_the_scene_of_a_job_is_deleted(scene, soft_arm, other, stand_in):
    batch = baking(soft_arm)
    list(batch.read())
    list(batch.compute())
    other.collection.objects.link(soft_arm)
    bpy.context.window.scene = other
    bpy.data.scenes.remove(scene)
    with pytest.raises(errors.SceneError, match="Scene 'Scene' was deleted"):
        list(batch.write())
    assert not soft_arm.dynamorph.bake.exists and soft_arm.dynamorph.model.content_id == ""


# Threads -------------------------------------------------------------------------------------------------------------
