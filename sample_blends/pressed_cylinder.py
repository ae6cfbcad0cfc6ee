# SPDX-License-Identifier: GPL-3.0-or-later
"""Pressed cylinder: the limb of bulging_cylinder.py, straight, and MakeHuman's hand with Blender's Collision, which
presses it twice and pulls at its skin. Meters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import bmesh
import bpy
import bulging_cylinder
import numpy as np
from herbert_action import quaternions
from herbert_skeleton import about, curve, unit
from makehuman import LICENSE, Human, Rig
from stage import (
    add_camera,
    add_material,
    add_mesh,
    add_touched_skin,
    add_vertex_groups,
    paint_for_workbench,
    save_scene,
    set_up_scene,
    write_curves,
)  # fmt: skip

BODY = {"macrodetails/caucasian-male-young": 1.0}
FINGERS = ("thumb", "index", "middle", "ring", "pinky")
ARM = 0.22  # of the forearm that is there

FRAMES = 72
# Keys (frame, value). The wrist, from the limb's axis: above it, along it. Fingers: degrees a joint.
ABOVE = ((1, 0.22), (12, 0.094), (26, 0.094), (33, 0.13), (42, 0.09), (58, 0.09), (67, 0.24))
ALONG = ((1, 0.30), (44, 0.30), (56, 0.275), (72, 0.275))
CURL = ((1, 8), (12, 14), (26, 24), (33, 12), (42, 24), (58, 24), (67, 8))
BEHIND = 0.08  # the limb's axis
WRIST, THUMB = 28, -22  # degrees: the forearm upward, the thumb's first joint too
SKIN = (0.78, 0.42, 0.29)

README = """Pressed cylinder

The soft limb of the bulging cylinder, straight. A hand with Blender's Collision presses it twice and slides along it.
The limb has Quality Full, so that the fingers leave dents.

Select Limb, press Bake in the Dynamorph tab, then Play.
"""


@dataclass(frozen=True)
class Hand:
    """A left hand with a part of the forearm, the wrist at the origin, fingers along +X and the back up.

    vertices (V, 3), faces (F, 4); weights: bone -> (V,); heads and tails of the bones, parents before children.
    """

    vertices: np.ndarray
    faces: np.ndarray
    weights: dict[str, np.ndarray]
    heads: dict[str, np.ndarray]
    tails: dict[str, np.ndarray]

    @classmethod
    def load(cls) -> Hand:
        human, rig = Human.load(BODY), Rig("game_engine")
        left = {name: bone for name, bone in rig.bones.items() if name.endswith("_l")}
        bones = {name: bone for name, bone in left.items() if name.split("_")[0] in ("hand", "lowerarm", *FINGERS)}
        heads, tails = ({name: human.joint(bone[end]) for name, bone in bones.items()} for end in ("head", "tail"))
        wrist = heads["hand_l"]
        heads["lowerarm_l"], tails["lowerarm_l"] = wrist, heads["lowerarm_l"]  # the hand leads the arm here
        index, pinky = (heads[f"{finger}_01_l"] - wrist for finger in ("index", "pinky"))
        ahead, back = unit(index + pinky), unit(np.cross(index, pinky))
        axes = np.array([ahead, np.cross(back, ahead), back])

        weights = rig.weights(len(human.vertices))
        along = (human.vertices - wrist) @ unit(tails["lowerarm_l"] - wrist)
        kept = (sum(weights[name] for name in bones) > 0.5) & (along < ARM)
        faces = human.faces["body"][kept[human.faces["body"]].all(axis=1)]
        used, corners = np.unique(faces, return_inverse=True)
        return cls(
            (human.vertices[used] - wrist) @ axes.T,
            corners.reshape(-1, 4),
            {name: weights[name][used] for name in bones},
            {name: axes @ (head - wrist) for name, head in heads.items()},
            {name: axes @ (tail - wrist) for name, tail in tails.items()},
        )


def add_hand(hand: Hand) -> bpy.types.Object:
    """The hand with its armature, closed where the arm ends."""
    obj = add_mesh("Hand", hand.vertices, hand.faces, add_material("Hand", SKIN, 0.45, subsurface=0.15))
    shape = bmesh.new()
    shape.from_mesh(obj.data)
    bmesh.ops.holes_fill(shape, edges=[edge for edge in shape.edges if edge.is_boundary], sides=0)
    shape.to_mesh(obj.data)
    shape.free()
    add_vertex_groups(obj, hand.weights)
    rig = bpy.data.objects.new("Hand Rig", bpy.data.armatures.new("Hand Rig"))
    bpy.context.scene.collection.objects.link(rig)
    rig.data.display_type = "STICK"
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    for name in ("hand_l", *(name for name in hand.heads if name != "hand_l")):
        bone = rig.data.edit_bones.new(name)
        bone.head, bone.tail = hand.heads[name], hand.tails[name]
        finger, number = name[:-2].rsplit("_", 1) if name[-3].isdigit() else ("", "01")
        before = f"{finger}_{int(number) - 1:02}_l" if number > "01" else "hand_l"
        bone.parent = rig.data.edit_bones.get(before)
    bpy.ops.object.mode_set(mode="OBJECT")
    obj.parent = rig
    obj.modifiers.new("Armature", "ARMATURE").object = rig
    return obj


def animate(rig: bpy.types.Object) -> None:
    times = np.arange(1, FRAMES + 1)
    above, along, curl = (curve(times, *keys) for keys in (ABOVE, ALONG, CURL))
    rig.rotation_euler.z = -math.pi / 2  # the fingers come over the limb toward the camera
    place = np.stack([along, np.full(FRAMES, BEHIND), bulging_cylinder.HEIGHT + above], 1)
    turns = {}
    for bone in rig.data.bones:
        finger = bone.name.split("_")[0]
        bent = {"lowerarm": WRIST, "thumb": THUMB if "01" in bone.name else 0, "hand": 0}.get(finger, curl)
        rest = np.array(bone.matrix_local.to_3x3())
        turns[f'pose.bones["{bone.name}"].rotation_quaternion'] = quaternions(
            rest.T @ about(1, np.broadcast_to(bent, FRAMES)) @ rest
        )
    write_curves(rig, "Press", {"location": place} | turns)


def make(path: Path) -> None:
    set_up_scene(README, FRAMES, LICENSE)
    limb_rig = bulging_cylinder.add_rig()
    limb = bulging_cylinder.add_limb(limb_rig)
    bulging_cylinder.add_stage(limb_rig)
    add_camera((0.40, -1.25, 0.72), (0.285, 0, 0.375), 74)
    hand = add_hand(Hand.load())
    animate(hand.parent)
    paint_for_workbench()
    add_touched_skin(limb, [hand])
    limb.dynamorph.firmness_group = bulging_cylinder.FIRMNESS
    save_scene(path)
