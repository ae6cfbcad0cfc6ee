# SPDX-License-Identifier: GPL-3.0-or-later
"""The MakeHuman body of ../shared, with dynamic morph targets made of its own driven keys: for tests and benchmarks."""

import math

import bpy
from assets import ASSETS
from mathutils import Quaternion
from pins import with_pins

CHARACTER = ASSETS / "mh_male_53bones.blend"
SOFT, STIFF = 1.2e4, 6.0e4  # Pa: relaxed tissue and flexed muscle
HELD = (
    "head",
    "neck",
    "hand",
    "thumb",
    "index",
    "middle",
    "ring",
    "pinky",
    "foot",
    "ball",
)  # bones without soft tissue
# Driven keys of the file and how far their bone turns when the driver has reached 1, in degrees.
DRIVEN = {
    "thigh_muscle_L": ("calf_l", 90),
    "thigh_muscle_R": ("calf_r", 90),
    "biceps_bulge_L": ("lowerarm_l", -85),
    "biceps_bulge_R": ("lowerarm_r", -85),
}


def open_character(clip: str):
    """The body as a soft skin with a neutral target and one for each key of DRIVEN, playing `clip`."""
    bpy.ops.wm.open_mainfile(filepath=str(CHARACTER))
    return make_soft(clip)


def make_soft(clip: str):
    """The same for the character that is open."""
    body, rig = bpy.data.objects["Body"], bpy.data.objects["Rig"]
    body.data.shape_keys.animation_data.action = None  # the file's "breathing" moves keys that are no targets
    for key in body.data.shape_keys.key_blocks:
        key.value = 0.0
    rig.animation_data.action = None
    bpy.context.view_layer.objects.active = body
    _pose(rig, {})
    bpy.ops.dynamorph.add_soft_skin()
    with_pins(body)
    for key, (bone, degrees) in DRIVEN.items():
        _pose(rig, {bone: degrees})
        bpy.ops.dynamorph.add_target(key=key)
    _pose(rig, {})
    _hold_extremities(body)
    for target in body.dynamorph.targets:
        target.stiffness = STIFF if target.name in DRIVEN else SOFT
    rig.animation_data.action = bpy.data.actions[clip]
    rig.animation_data.action_slot = rig.animation_data.action.slots[0]
    return body


def _hold_extremities(body):
    """A vertex group for Firmness: head, hands and feet are held."""
    firm = body.vertex_groups.new(name="Firmness")
    held = {group.index for group in body.vertex_groups if group.name.split("_")[0] in HELD}
    for vertex in body.data.vertices:
        firm.add([vertex.index], 0.5 + 0.5 * sum(g.weight for g in vertex.groups if g.group in held), "REPLACE")
    body.dynamorph.firmness_group = firm.name


def _pose(rig, turned: dict[str, float]):
    """Only these bones turned, by degrees about the character's left-right axis; a knee and an elbow bend so."""
    for bone in rig.pose.bones:
        bone.matrix_basis.identity()
        if bone.name in turned:
            axis = bone.bone.matrix_local.to_3x3().row[0]  # the world's x axis in the bone's space
            bone.rotation_quaternion = Quaternion(axis, math.radians(turned[bone.name]))
    bpy.context.view_layer.update()
