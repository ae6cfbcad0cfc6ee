# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene in which a rig is read stays for as long as it is used, and is found nowhere else."""

import types

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene import events
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion
from bl_ext.user_default.dynamic_morph_targets.scene.read import sampling_scene
from builders import rig_of
from mathutils import Matrix


@pytest.fixture
def begun(soft_arm):
    """A rig that has been read in part."""
    sampling = rig_motion.RigSampling(soft_arm, 1, 5, 2)
    sampling.advance(soft_arm, 0.0)
    assert len(kept()) == 1
    return sampling


def kept():
    return [scene for scene in bpy.data.scenes if scene.name.startswith(sampling_scene.NAME)]


def left():
    return [*kept(), *(each for each in bpy.data.objects if each.name.startswith(sampling_scene.NAME))]


def read_on(sampling, obj) -> np.ndarray:
    while not sampling.advance(obj, 0.0):
        pass
    return sampling.samples().pose


def test_it_is_the_same_one_until_the_end(begun, soft_arm):
    (scene,) = kept()
    uid = scene.session_uid
    begun.advance(soft_arm, 0.0)
    assert [each.session_uid for each in kept()] == [uid]
    read_on(begun, soft_arm)
    assert left() == []


@pytest.mark.fault("G09")
def test_it_is_in_no_file(begun, soft_arm, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"), copy=True)
    with bpy.data.libraries.load(str(tmp_path / "saved.blend")) as (stored, _):
        assert not [name for name in (*stored.scenes, *stored.objects) if name.startswith(sampling_scene.NAME)]
    np.testing.assert_array_equal(read_on(begun, soft_arm), rig_motion.sample_rig(soft_arm, 1, 5, 2).pose)


@pytest.mark.fault("G09")
def test_undo_does_not_bring_it_back(begun, soft_arm):
    name = soft_arm.name
    bpy.ops.ed.undo_push(message="while it is there")
    soft_arm.location.x = 1.0
    bpy.ops.ed.undo_push(message="after it")
    bpy.ops.ed.undo()
    assert left() == []
    obj = bpy.data.objects[name]
    np.testing.assert_array_equal(read_on(begun, obj), rig_motion.sample_rig(obj, 1, 5, 2).pose)


def test_a_file_that_holds_one_loses_it(begun, tmp_path, monkeypatch):
    """As one that Blender saves by itself, without asking add-ons."""
    monkeypatch.setattr(sampling_scene, "remove_kept", lambda: None)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"), copy=True)
    monkeypatch.undo()
    with bpy.data.libraries.load(str(tmp_path / "saved.blend")) as (stored, _):
        assert sampling_scene.NAME in stored.scenes
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    assert left() == []


def test_it_goes_when_nobody_reads(begun):
    assert bpy.app.timers.is_registered(sampling_scene.remove_unused)
    assert sampling_scene.remove_unused() is None
    assert left() == []


@pytest.mark.fault("G09")
def test_nothing_is_removed_while_blender_renders(begun, soft_arm, tmp_path, monkeypatch):
    """It would crash. What is saved then loses the scene when it is opened."""
    rendering = [True]
    monkeypatch.setattr(events, "render_runs", lambda: rendering[0])
    sampling_scene.remove_kept()
    begun.close()
    assert sampling_scene.remove_unused() > 0.0 and len(kept()) == 1
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"), copy=True)
    rendering[0] = False
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    assert left() == []


def test_a_job_that_reads_waits_for_the_render(soft_arm, monkeypatch):
    rendering, messages = [False], []
    monkeypatch.setattr(events, "render_runs", lambda: rendering[0])
    work = batch.Batch([Job(soft_arm, goal="BAKE", stored=False)], "BAKE")
    for number, _ in enumerate(work.read(0.0)):
        rendering[0] = number in (3, 4, 5)
        messages.append(work.message)
    assert messages.count("Waiting for the render to end") == 3 and left() == []


def test_one_that_cannot_be_made_leaves_nothing(soft_arm):
    probe = types.SimpleNamespace(mesh=lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError), sampling_scene.SamplingScene().opened(soft_arm, rig_of(soft_arm), probe):
        pass
    assert left() == []


def test_what_the_artist_deletes_meanwhile_is_deleted(begun, soft_arm):
    rig = rig_of(soft_arm)
    bpy.ops.object.select_all(action="DESELECT")
    rig.select_set(True)
    bpy.ops.object.delete()
    sampling_scene.remove_unused()
    assert "Arm Rig" not in bpy.data.objects or not [each for each in bpy.data.objects if each.type == "ARMATURE"]


def test_a_rig_that_is_in_no_scene_stays(soft_arm):
    """Blender keeps it for the modifier, which does not count as a user."""
    rig = rig_of(soft_arm)
    bpy.context.scene.collection.objects.unlink(rig)
    sampling = rig_motion.RigSampling(soft_arm, 1, 5, 2)
    read_on(sampling, soft_arm)
    assert rig_of(soft_arm) == rig and left() == []


def test_edits_of_the_rig_count(begun, soft_arm):
    """Although Blender evaluates them in another scene."""
    sampling = rig_motion.RigSampling(soft_arm, 1, 3, 1)
    sampling.advance(soft_arm, 0.0)
    limit = rig_of(soft_arm).pose.bones["lower"].constraints.new("LIMIT_ROTATION")
    limit.use_limit_x, limit.min_x, limit.max_x = True, 0.3, 0.3
    limit.owner_space = "LOCAL"
    pose = read_on(sampling, soft_arm)
    np.testing.assert_array_equal(pose[1:], rig_motion.sample_rig(soft_arm, 1, 3, 1).pose[1:])
    assert np.abs(pose[0, 1] - pose[1, 1]).max() > 0.1


# How the mesh object moves -------------------------------------------------------------------------------------------


def hang_on_bone(obj):
    rig = rig_of(obj)
    obj.parent, obj.parent_type, obj.parent_bone = rig, "BONE", "lower"
    obj.matrix_parent_inverse = Matrix.Rotation(0.3, 4, "Y")


def hang_on_moving_empty(obj):
    empty = bpy.data.objects.new("Root", None)
    bpy.context.scene.collection.objects.link(empty)
    for frame, x in ((1, 0.0), (5, 2.0)):
        empty.location.x = x
        empty.keyframe_insert("location", frame=frame)
    obj.parent = empty


def turn_by_quaternion(obj):
    obj.rotation_mode, obj.rotation_quaternion = "QUATERNION", (0.9, 0.1, 0.3, 0.2)
    obj.delta_location, obj.delta_scale = (0.1, 0.2, 0.3), (1.1, 1.2, 1.3)
    obj.delta_rotation_quaternion = (0.8, 0.3, 0.0, 0.1)


def turn_about_an_axis(obj):
    obj.rotation_mode, obj.rotation_axis_angle = "AXIS_ANGLE", (0.7, 0.3, 0.9, 0.1)


def follow(obj):
    obj.constraints.new("COPY_LOCATION").target = rig_of(obj)


def animate(obj):
    for frame, x in ((1, 0.0), (5, 2.0)):
        obj.location.x = x
        obj.keyframe_insert("location", frame=frame)


def drive(obj):
    obj.driver_add("location", 2).driver.expression = "frame / 10"


MOVES = [hang_on_bone, hang_on_moving_empty, turn_by_quaternion, turn_about_an_axis, follow, animate, drive]


@pytest.mark.parametrize("move", MOVES, ids=lambda move: move.__name__)
def test_world_transforms_are_blenders(soft_arm, move):
    soft_arm.location, soft_arm.rotation_euler, soft_arm.scale = (0.1, 0.2, 0.3), (0.3, 0.1, 0.2), (1.2, 0.9, 1.1)
    move(soft_arm)
    read = rig_motion.sample_rig(soft_arm, 1, 5, 1).object_world
    for frame, world in enumerate(read, 1):
        bpy.context.scene.frame_set(frame)
        shown = soft_arm.evaluated_get(bpy.context.evaluated_depsgraph_get())
        np.testing.assert_array_equal(world, np.array(shown.matrix_world)[: world.shape[0]])


def test_curves_of_shape_keys_are_not_evaluated(begun, soft_arm):
    """A bake has hundreds."""
    soft_arm.data.shape_keys.key_blocks[-1].keyframe_insert("value", frame=1)
    begun.advance(soft_arm, 0.0)
    (scene,) = kept()
    names = {each.name for each in scene.view_layers[0].depsgraph.ids}
    assert rig_of(soft_arm).name in names
    assert not names & {soft_arm.data.shape_keys.name, soft_arm.data.shape_keys.animation_data.action.name}


def test_moving_the_mesh_counts(begun, soft_arm):
    soft_arm.location.x += 1.0
    begun.advance(soft_arm, 0.0)
    soft_arm.location.x += 1.0
    read_on(begun, soft_arm)
    moved = begun.samples().object_world[:, 0, 3]
    assert moved[2] - moved[1] == pytest.approx(1.0) and moved[3] - moved[2] == pytest.approx(0.0, abs=1e-6)
