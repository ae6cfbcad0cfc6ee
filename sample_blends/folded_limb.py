# SPDX-License-Identifier: GPL-3.0-or-later
"""Folded limb: the soft limb of the bulging cylinder folds until its two halves meet, and opens again. Meters."""

from __future__ import annotations

import math
from pathlib import Path

import bpy
import bulging_cylinder
from stage import add_camera, add_touched_skin, paint_for_workbench, save_scene, set_up_scene

FRAMES = 84
BENDS = ((1, 0), (5, 0), (20, 166), (36, 166), (50, 0), (84, 0))  # (frame, bend of the whole elbow in degrees)

README = """Folded limb

The soft limb of the bulging cylinder folds until forearm and upper arm meet, and opens again. It has Self Collision, so
that they flatten each other instead of passing through each other, and Quality Full.

Select Limb, press Bake in the Dynamorph tab, then Play.
"""


def animate(rig: bpy.types.Object) -> None:
    for b in bulging_cylinder.ELBOW:
        bone = rig.pose.bones[b]
        for frame, degrees in BENDS:
            bone.rotation_euler.x = math.radians(degrees) / len(bulging_cylinder.ELBOW)
            bone.keyframe_insert("rotation_euler", index=0, frame=frame)
    rig.animation_data.action.name = "Fold"


def make(path: Path) -> None:
    set_up_scene(README, FRAMES)
    rig = bulging_cylinder.add_rig()
    limb = bulging_cylinder.add_limb(rig)
    limb.shape_key_clear()
    bulging_cylinder.add_stage(rig)
    add_camera((0.40, -1.75, 0.62), (0.225, 0, 0.375), 74)
    animate(rig)
    paint_for_workbench()
    add_touched_skin(limb, [])
    limb.dynamorph.collision.use = limb.dynamorph.collision.use_self = True
    limb.dynamorph.simulation.gravity = 0.0  # what moves when the limb is still was pressed
    limb.dynamorph.firmness_group = bulging_cylinder.FIRMNESS
    save_scene(path)
