# SPDX-License-Identifier: GPL-3.0-or-later
"""The character of the window test: an arm as a rigger hands it over, before anything of Dynamorph is done to it."""

from __future__ import annotations

import math

import bmesh
import bpy
import numpy as np
import scenes

RINGS, AROUND = 49, 32  # of vertices, and how many in each
LENGTH = 0.3  # of a bone, meters
FIRST, FLEXED, STRETCHED, LAST = (
    10,
    20,
    40,
    72,
)  # frames: begins to flex, is flexed, begins to stretch, end of the scene
TURNED = 60  # frame: the palm is turned up, which no sculpted key is for
BONES = ("upper arm", "forearm")
BALL, BALL_AT = 0.04, 0.16  # radius, place along the upper arm
PRESSES, PRESSED = 8, 0.015  # frame at which it is deepest, how deep
OUTLINE = ((0.0, 0.062), (0.35, 0.052), (0.9, 0.04), (1.15, 0.046), (1.8, 0.03), (2.0, 0.02))  # height in bones, radius


def make_limb():
    """An arm along x with two bones, a sculpted key 'flexed' and an animation; its armature is active, not selected."""
    bpy.data.batch_remove(list(bpy.data.objects))
    tube, faces = scenes.tube(RINGS, AROUND, radius=1.0)
    bulge = scenes.bulge(tube, center=0.55, width=0.25, amount=0.3) * (0.5 + 0.5 * tube[:, :1])  # on the inner side
    radius = np.interp(tube[:, 2], *np.transpose(OUTLINE))[:, None]

    def placed(points):
        along = points[:, [2]] * LENGTH
        return np.hstack([along, points[:, [1]] * radius, points[:, [0]] * radius])

    mesh = bpy.data.meshes.new("Arm")
    mesh.from_pydata(placed(tube).tolist(), [], [face[::-1] for face in faces])
    mesh.shade_smooth()
    arm = bpy.data.objects.new("Arm", mesh)
    bpy.context.scene.collection.objects.link(arm)
    arm.shape_key_add(name="Basis", from_mix=False)
    flexed = arm.shape_key_add(name="flexed", from_mix=False)
    flexed.value = 0.0
    flexed.points.foreach_set("co", placed(tube + bulge).astype(np.float32).ravel())
    for bone, weights in zip(BONES, scenes.two_bone_weights(tube).T, strict=True):
        group = arm.vertex_groups.new(name=bone)
        for index in np.flatnonzero(weights):
            group.add([int(index)], float(weights[index]), "REPLACE")
    arm.modifiers.new("Armature", "ARMATURE").object = make_rig()
    arm.active_shape_key_index = 0
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, LAST
    scene.frame_set(1)


def make_rig():
    armature = bpy.data.armatures.new("Rig")
    rig = bpy.data.objects.new("Rig", armature)
    bpy.context.scene.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    parent = None
    for i, name in enumerate(BONES):
        bone = armature.edit_bones.new(name)
        bone.head, bone.tail, bone.parent = (i * LENGTH, 0, 0), ((i + 1) * LENGTH, 0, 0), parent
        parent = bone
    bpy.ops.object.mode_set(mode="OBJECT")
    forearm = rig.pose.bones["forearm"]
    forearm.rotation_mode = "XYZ"
    for frame, degrees in ((FIRST, 0), (FLEXED, 100), (STRETCHED, 100), (STRETCHED + 10, 0)):
        forearm.rotation_euler.x = math.radians(degrees)
        forearm.keyframe_insert("rotation_euler", frame=frame)
    for frame, degrees in ((STRETCHED + 10, 0), (TURNED, 80), (LAST, 80)):
        forearm.rotation_euler.y = math.radians(degrees)
        forearm.keyframe_insert("rotation_euler", frame=frame)
    armature.display_type = "STICK"
    rig.select_set(False)
    return rig


def make_ball():
    """A ball that is pressed into the upper arm from the side, without Collision yet."""
    mesh, shape = bpy.data.meshes.new("Ball"), bmesh.new()
    bmesh.ops.create_icosphere(shape, subdivisions=4, radius=BALL)
    shape.to_mesh(mesh)
    shape.free()
    ball = bpy.data.objects.new("Ball", mesh)
    bpy.context.scene.collection.objects.link(ball)
    touches = np.interp(BALL_AT / LENGTH, *np.transpose(OUTLINE)) + BALL
    for frame, deep in ((1, -0.03), (PRESSES, PRESSED)):
        ball.location = (BALL_AT, deep - touches, 0.0)
        ball.keyframe_insert("location", frame=frame)


def make_other(arm):
    """A copy of the arm on a rig of its own, which comes down on it from above."""
    other, rig = arm.copy(), arm.modifiers["Armature"].object.copy()
    other.name, other.data, rig.data = "Other Arm", arm.data.copy(), rig.data.copy()
    for obj in (rig, other):
        bpy.context.scene.collection.objects.link(obj)
    other.modifiers["Armature"].object = rig
    rig.animation_data_clear()
    rig.pose.bones["forearm"].rotation_euler = (0.0, 0.0, 0.0)
    other.parent = rig
    thick = 2.0 * float(np.interp(BALL_AT / LENGTH, *np.transpose(OUTLINE)))
    for frame, deep in ((1, -0.01), (PRESSES, PRESSED)):
        rig.location = (0.0, 0.0, thick - deep)
        rig.keyframe_insert("location", frame=frame)
    return other
