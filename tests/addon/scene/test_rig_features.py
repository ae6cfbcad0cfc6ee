# SPDX-License-Identifier: GPL-3.0-or-later
"""Rigs as artists make them: a bake shows what Blender's own evaluation of the rig shows."""

from math import pi

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene import animation
from bl_ext.user_default.dynamic_morph_targets.scene.check import checks
from builders import activate, assert_shows, make_rig, rig_of, skinning_of
from mathutils import Matrix

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

FRAMES = 12


def bone_of(obj, name):
    return rig_of(obj).pose.bones[name]


def empty(name="Empty", location=(0.0, 0.0, 0.0)):
    made = bpy.data.objects.new(name, None)
    bpy.context.scene.collection.objects.link(made)
    made.location = location
    return made


def keyed(owner, path: str, first, last):
    """Two keyframes, at the ends of the shot."""
    for frame, value in ((1, first), (FRAMES, last)):
        setattr(owner, path, value)
        owner.keyframe_insert(path, frame=frame)


def constraint(owner, kind: str, target, **settings):
    made = owner.constraints.new(kind)
    made.target = target
    for name, value in settings.items():
        setattr(made, name, value)
    return made


def driven(owner, path: str, index: int, expression: str, target=None, kind="TRANSFORMS", **settings):
    """Add a driver with an expression of "v", which `kind` and `settings` read from the target."""
    driver = owner.driver_add(path, index).driver
    driver.type, driver.expression = "SCRIPTED", expression
    if target is None:
        return
    variable = driver.variables.new()
    variable.name, variable.type = "v", kind
    if kind == "SINGLE_PROP":
        variable.targets[0].id_type = target.id_type
    variable.targets[0].id = target
    for name, value in settings.items():
        setattr(variable.targets[0], name, value)


def unkeyed(obj):
    rig_of(obj).animation_data_clear()
    bone_of(obj, "lower").rotation_euler.x = 0.0


# Constraints -------------------------------------------------------------------------------------------------------


def copy_rotation(obj):
    unkeyed(obj)
    leader = make_rig(bpy.context.scene, "Leader")
    keyed(leader.pose.bones["lower"], "rotation_euler", (0, 0, 0), (1.2, 0.2, 0))
    constraint(bone_of(obj, "lower"), "COPY_ROTATION", leader, subtarget="lower")


def inverse_kinematics(obj):
    unkeyed(obj)
    goal = empty(location=(0.0, 0.0, 2.0))
    keyed(goal, "location", (0.0, 0.2, 1.9), (0.0, 1.2, 1.0))
    constraint(bone_of(obj, "lower"), "IK", goal, chain_count=2)


def damped_track(obj):
    unkeyed(obj)
    goal = empty()
    keyed(goal, "location", (0.0, 0.0, 3.0), (0.3, 1.5, 1.5))
    constraint(bone_of(obj, "lower"), "DAMPED_TRACK", goal)


def child_of(obj):
    carrier = empty(location=(0.5, 0.0, 0.0))
    made = constraint(bone_of(obj, "upper"), "CHILD_OF", carrier, set_inverse_pending=False)
    made.inverse_matrix = Matrix.Translation((-0.5, 0.0, 0.0))
    keyed(carrier, "location", (0.5, 0.0, 0.0), (1.0, 0.3, 0.0))
    keyed(carrier, "rotation_euler", (0, 0, 0), (0.1, 0.4, 0.2))


def armature_constraint(obj):
    other = make_rig(bpy.context.scene, "Other")
    made = bone_of(obj, "upper").constraints.new("ARMATURE")
    for bone, weight in (("upper", 0.7), ("lower", 0.3)):
        target = made.targets.new()
        target.target, target.subtarget, target.weight = other, bone, weight
    keyed(other.pose.bones["lower"], "rotation_euler", (0, 0, 0), (0.6, 0.3, 0.0))
    keyed(other, "location", (0, 0, 0), (0.2, 0.1, 0.0))


def stretch_to(obj):
    goal = empty()
    keyed(goal, "location", (0.0, 0.0, 2.0), (0.0, 0.6, 2.2))
    constraint(bone_of(obj, "lower"), "STRETCH_TO", goal, rest_length=1.0)


def spline_ik(obj):
    unkeyed(obj)
    curve = bpy.data.curves.new("Spline", "CURVE")
    spline = curve.splines.new("BEZIER")
    spline.bezier_points.add(2)
    for point, co in zip(spline.bezier_points, ((0, 0, 0), (0, 0.3, 1), (0, 1.0, 1.7)), strict=True):
        point.co, point.handle_left_type, point.handle_right_type = co, "AUTO", "AUTO"
    path = bpy.data.objects.new("Spline", curve)
    bpy.context.scene.collection.objects.link(path)
    keyed(path, "rotation_euler", (0.4, 0, 0), (-0.3, 0.2, 0))
    constraint(bone_of(obj, "lower"), "SPLINE_IK", path, chain_count=2)


def constrained_objects(obj):
    leader = empty()
    keyed(leader, "location", (0, 0, 0), (0.3, 0.4, 0.5))
    keyed(leader, "rotation_euler", (0, 0, 0), (0.3, 0.4, 0.5))
    constraint(rig_of(obj), "COPY_TRANSFORMS", leader)
    constraint(obj, "CHILD_OF", rig_of(obj), set_inverse_pending=False)


# Drivers -----------------------------------------------------------------------------------------------------------


def driven_by_an_object(obj):
    unkeyed(obj)
    leader = empty()
    keyed(leader, "location", (0, 0, 0), (1.3, 0, 0))
    driven(bone_of(obj, "lower"), "rotation_euler", 0, "v", leader, transform_type="LOC_X")


def driven_by_a_property(obj):
    unkeyed(obj)
    rig = rig_of(obj)
    for frame, value in ((1, 0.0), (FRAMES, 1.3)):
        rig["bend"] = value
        rig.keyframe_insert('["bend"]', frame=frame)
    driven(bone_of(obj, "lower"), "rotation_euler", 0, "v", rig, "SINGLE_PROP", data_path='["bend"]')


def driven_by_the_frame(obj):
    unkeyed(obj)
    driven(bone_of(obj, "lower"), "rotation_euler", 0, "0.1 * frame")


# Actions and NLA ---------------------------------------------------------------------------------------------------


def strips(obj, **settings):
    """The rig's action as a strip of the NLA."""
    data = rig_of(obj).animation_data
    action, data.action = data.action, None
    track = data.nla_tracks.new()
    strip = track.strips.new("Bend", 1, action)
    strip.action_slot = action.slots[0]
    for name, value in settings.items():
        setattr(strip, name, value)
    return data, action


def stretched_strip(obj):
    strips(obj, scale=0.5, frame_start=3)


def blended_strips(obj):
    data, action = strips(obj)
    for blend, muted in (("ADD", False), ("REPLACE", True)):
        track = data.nla_tracks.new()
        strip = track.strips.new(blend, 2, action)
        strip.action_slot, strip.blend_type, strip.influence = action.slots[0], blend, 0.4
        strip.use_reverse = True
        track.mute = muted


def action_over_strips(obj):
    data, action = strips(obj)
    data.action = bpy.data.actions.new("Upper")
    data.action_blend_type, data.action_influence = "COMBINE", 0.8
    keyed(bone_of(obj, "upper"), "rotation_euler", (0, 0, 0), (0.2, 0.5, 0.1))


def noisy_curves(obj):
    data = rig_of(obj).animation_data
    for curve in animation.curves(data.action, data.action_slot):
        curve.modifiers.new("NOISE").strength = 0.3


def remapped(obj):
    bpy.context.scene.render.frame_map_old, bpy.context.scene.render.frame_map_new = 100, 60


def before_frame_zero(obj):
    scene = bpy.context.scene
    strips(obj, frame_start=-7.5)
    scene.frame_start, scene.frame_end = -10, -10 + FRAMES


# Transforms --------------------------------------------------------------------------------------------------------


def stretched_rig(obj):
    rig_of(obj).scale = (1.0, 2.0, 0.7)
    obj.scale = (1.3, 1.0, 1.0)


def mirrored_rig(obj):
    rig_of(obj).scale = (-1.0, 1.0, 1.0)


def mirrored_both(obj):
    parent = empty()
    parent.scale = (1.0, -1.5, 1.0)
    for child in (obj, rig_of(obj)):
        child.parent = parent


def sheared(obj):
    parent = empty()
    parent.scale = (1.0, 2.0, 1.0)
    child = empty("Child")
    child.parent, child.rotation_euler = parent, (0.5, 0.3, 0.0)
    rig_of(obj).parent, obj.parent = child, rig_of(obj)


def moving_rig(obj):
    rig = rig_of(obj)
    obj.parent = rig
    keyed(rig, "location", (0, 0, 0), (1.0, 0.5, 0.2))
    keyed(rig, "rotation_euler", (0, 0, 0), (0.3, 0.2, 0.6))
    keyed(rig, "scale", (1, 1, 1), (1.2, 1.2, 1.2))


def on_a_bone(obj):
    """The armature hangs on a bone of another armature, which turns."""
    carrier = make_rig(bpy.context.scene, "Carrier")
    rig = rig_of(obj)
    rig.parent, rig.parent_type, rig.parent_bone = carrier, "BONE", "lower"
    rig.matrix_parent_inverse = Matrix.Translation((0.0, -2.0, 0.3))
    keyed(carrier.pose.bones["upper"], "rotation_euler", (0, 0, 0), (0.4, 0.2, 0.3))
    obj.parent = rig


def scaled_bones(obj):
    keyed(bone_of(obj, "upper"), "scale", (1, 1, 1), (1.2, 0.8, 1.1))


def scale_not_inherited(obj):
    scaled_bones(obj)
    rig_of(obj).data.bones["lower"].inherit_scale = "NONE"


def aligned_scale(obj):
    scaled_bones(obj)
    rig_of(obj).data.bones["lower"].inherit_scale = "ALIGNED"


def rotation_not_inherited(obj):
    keyed(bone_of(obj, "upper"), "rotation_euler", (0, 0, 0), (0.5, 0.2, 0.1))
    rig_of(obj).data.bones["lower"].use_inherit_rotation = False


def mirrored_bone(obj):
    bone_of(obj, "upper").scale.x = -1.0


def with_a_root(obj):
    """A bone that deforms nothing carries the rest."""
    rig = rig_of(obj)
    activate(rig)
    bpy.ops.object.mode_set(mode="EDIT")
    root = rig.data.edit_bones.new("root")
    root.head, root.tail = (0.0, -0.5, -0.5), (0.0, -0.5, 0.0)
    rig.data.edit_bones["upper"].parent = root
    bpy.ops.object.mode_set(mode="OBJECT")
    activate(obj)
    rig.data.bones["root"].use_deform = False
    rig.pose.bones["root"].rotation_mode = "XYZ"
    keyed(rig.pose.bones["root"], "location", (0, 0, 0), (0.2, 0.3, 0.1))
    keyed(rig.pose.bones["root"], "rotation_euler", (0, 0, 0), (0.2, 0.1, 0.3))


# What they have in common -------------------------------------------------------------------------------------------

FEATURES = [
    copy_rotation, inverse_kinematics, damped_track, child_of, armature_constraint, stretch_to, spline_ik,
    constrained_objects, driven_by_an_object, driven_by_a_property, driven_by_the_frame, stretched_strip,
    blended_strips, action_over_strips, noisy_curves, remapped, before_frame_zero, stretched_rig, mirrored_rig,
    mirrored_both, sheared, moving_rig, on_a_bone, scaled_bones, scale_not_inherited, aligned_scale,
    rotation_not_inherited, mirrored_bone, with_a_root,
]  # fmt: skip


@pytest.mark.fault("A08", "R04")
@pytest.mark.parametrize("feature", FEATURES, ids=lambda feature: feature.__name__)
def test_what_is_baked_is_what_blender_evaluates(scene, soft_arm, feature):
    soft_arm.dynamorph.model.cage_nodes, soft_arm.dynamorph.model.modes = 200, 8
    scene.frame_end = FRAMES
    keyed(bone_of(soft_arm, "lower"), "rotation_euler", (0, 0, 0), (pi / 2, 0, 0))
    feature(soft_arm)
    activate(soft_arm)
    scene.frame_set(scene.frame_end)
    bpy.context.view_layer.update()
    soft_arm.dynamorph.active_target_index = 1
    bpy.ops.dynamorph.capture_pose()
    job = Job(soft_arm, goal="BAKE", substeps=3)
    batch.run(job)
    bake = job.outcome.bake
    assert np.isfinite(bake.coordinates).all()
    assert bake.weights[-1] == pytest.approx([0.0, 1.0], abs=1e-5)
    motion = np.tensordot(bake.coordinates - bake.static, bake.modes, 1)
    assert 1e-3 < np.abs(motion).max() < 1.0
    assert_shows(soft_arm, bake)


@pytest.mark.fault("R10")
@pytest.mark.parametrize("kind", ["SINGLE_PROP", "CONTEXT_PROP"])
def test_drivers_that_read_the_scene_are_named(scene, soft_arm, kind):
    """Values that a driver reads from the user's scene do not change in the scene that samples the rig."""
    driven(bone_of(soft_arm, "upper"), "rotation_euler", 1, "v", scene, "SINGLE_PROP", data_path="frame_current")
    if kind == "CONTEXT_PROP":
        rig_of(soft_arm).animation_data.drivers[0].driver.variables[0].type = kind
    texts = [note.text for note in checks.notes(skinning_of(soft_arm))]
    assert any("A driver of 'Arm Rig' reads 'frame_current' of the scene" in text for text in texts)
