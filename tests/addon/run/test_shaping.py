# SPDX-License-Identifier: GPL-3.0-or-later
"""Shape by Physics: a target's shape is what soft tissue does in its pose, for the button and for the command line."""

import json
from math import radians

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors, geometry
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.tools import shaping
from bl_ext.user_default.dynamic_morph_targets.run.work.task import Task
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store
from builders import evaluated_points, refused, rig_of
from mathutils import Euler, Matrix
from test_live import play

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

OPS = bpy.ops.dynamorph
BENT = radians(85)


@pytest.fixture
def bent(soft_arm):
    """The soft arm with its elbow bent, and without a target there."""
    soft_arm.dynamorph.active_target_index = 1
    OPS.remove_target()
    rig = rig_of(soft_arm)
    rig.animation_data_clear()
    rig.pose.bones["lower"].rotation_mode = "XYZ"
    rig.pose.bones["lower"].rotation_euler = (BENT, 0.0, 0.0)
    bpy.context.view_layer.update()
    soft_arm.dynamorph.model.cage_nodes = 300
    return soft_arm


def names(obj):
    return [target.name for target in obj.dynamorph.targets]


def volume(obj):
    """What the skin encloses, as Blender evaluates it."""
    bpy.context.view_layer.update()
    return geometry.signed_volume(evaluated_points(obj), mesh_data.mesh_triangles(obj.data))


def key_points(obj):
    return {block.name: [tuple(point.co) for point in block.data] for block in obj.data.shape_keys.key_blocks}


def test_the_pose_gets_a_target_that_keeps_the_volume(bent):
    rig_of(bent).pose.bones["lower"].rotation_euler.x = 0.0
    rest = volume(bent)
    rig_of(bent).pose.bones["lower"].rotation_euler.x = BENT
    plain = volume(bent)
    assert OPS.shape_by_physics() == {"FINISHED"}
    target = bent.dynamorph.active_target
    assert names(bent) == ["Neutral", target.name]
    assert set(target.bone_names()) == {"lower"}
    assert bent.data.shape_keys.key_blocks[target.name].value == 1.0  # it is shown in its pose
    assert abs(volume(bent) / rest - 1.0) < min(0.02, 0.5 * abs(plain / rest - 1.0))
    assert np.abs(mesh_data.target_shape(bent, target.name)).max() > 0.01


def test_such_a_target_is_built_without_crushed_tetrahedra_played_and_baked(bent):
    OPS.shape_by_physics()
    bent.dynamorph.model.modes = 12
    assert OPS.build() == {"FINISHED"}
    model = model_store.load_model(bent)
    edges = lambda points: points[model.tets[:, 1:]] - points[model.tets[:, :1]]  # noqa: E731
    before = np.linalg.det(edges(model.nodes))
    for displacement in model.displacements:
        assert (np.linalg.det(edges(model.nodes + displacement)) / before).min() >= 0.1
    assert not model.summary.warnings
    rig = rig_of(bent)
    for frame, height in ((1, 0.0), (9, 0.1), (17, 0.0)):
        rig.location.z = height
        rig.keyframe_insert("location", frame=frame)
    OPS.live()
    hop = play(bent, range(1, 20))
    OPS.live()
    shape = hop[0]
    assert np.abs(hop - shape).max() > 1e-3  # it swings about the shape
    assert np.abs(hop - shape).max() < 0.2 * np.ptp(shape)
    bpy.context.scene.frame_end = 12
    assert OPS.bake() == {"FINISHED"}
    assert json.loads(bent.dynamorph.bake.verdict)["inverted"] == 0.0


def test_again_in_that_pose_it_is_the_same_target(bent):
    OPS.shape_by_physics()
    name = bent.dynamorph.active_target.name
    first = mesh_data.target_shape(bent, name)
    block = bent.data.shape_keys.key_blocks[name]
    for point in block.data:
        point.co.z += 0.1
    assert OPS.shape_by_physics() == {"FINISHED"}
    assert names(bent) == ["Neutral", name]
    np.testing.assert_allclose(mesh_data.target_shape(bent, name), first, atol=1e-6)


def test_what_prevents_it_is_said_and_changes_nothing(bent):
    before = key_points(bent), names(bent)
    rig_of(bent).pose.bones["lower"].rotation_euler.x = 0.0
    bpy.context.view_layer.update()
    refused(OPS.shape_by_physics, "pose the armature first")
    rig_of(bent).pose.bones["lower"].rotation_euler.x = BENT
    bent.modifiers[0].use_deform_preserve_volume = True
    bpy.context.view_layer.update()
    refused(OPS.shape_by_physics, "turn off Preserve Volume")
    assert (key_points(bent), names(bent)) == before


def test_neither_scale_nor_place_of_armature_and_object_matter(bent):
    OPS.shape_by_physics()
    expected = mesh_data.target_shape(bent, bent.dynamorph.active_target.name)
    bent.dynamorph.active_target_index = 1
    OPS.remove_target()
    world = Matrix.LocRotScale((3.0, 1.0, -2.0), Euler((0.0, 0.0, 0.0)), (0.5,) * 3)
    worlds = {obj: world @ obj.matrix_world for obj in (rig_of(bent), bent)}
    for obj, moved in worlds.items():
        obj.matrix_world = moved
        bpy.context.view_layer.update()
    bpy.context.view_layer.update()
    OPS.shape_by_physics()
    found = mesh_data.target_shape(bent, bent.dynamorph.active_target.name)
    assert np.abs(found - expected).max() < 0.1 * np.abs(expected).max()


def test_it_can_be_canceled(bent):
    before = key_points(bent), names(bent)
    pose = rig_motion.current_pose(bent)
    work = Task(bent, "SHAPE", shaping.shape(bent.session_uid, pose[1]))
    with pytest.raises(errors.Cancelled):
        for _ in work.steps(0.0):
            work.cancel()
    assert (key_points(bent), names(bent)) == before


def test_it_is_reached_in_steps_from_rest(bent):
    local = rig_motion.current_pose(bent)[1]
    path = shaping.path_to(local)
    angles = [geometry.turned(np.broadcast_to(np.eye(4), step.shape), step).max() for step in path]
    steps = np.diff([0.0, *angles])
    assert steps.max() <= shaping.STEP + 1e-6
    np.testing.assert_allclose(steps, steps[0], atol=1e-5)
    np.testing.assert_array_equal(path[-1], local)


def test_where_the_bones_leave_no_room_it_says_so(bent):
    """The forearm is folded back into the upper arm."""
    rig_of(bent).pose.bones["lower"].rotation_euler.x = radians(175)
    bpy.context.view_layer.update()
    skeleton, local, rig_world = rig_motion.current_pose(bent)
    work = Task(bent, "SHAPE", shaping.shape(bent.session_uid, local))
    batch.run_all(work)
    texts = shaping.write(bent, (skeleton, local, rig_world), "Folded", work.result)
    assert any("the skin" in text for text in texts), texts
    assert np.isfinite(mesh_data.target_shape(bent, "Folded")).all()
