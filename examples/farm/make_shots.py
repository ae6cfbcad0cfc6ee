# SPDX-License-Identifier: GPL-3.0-or-later
"""Write the shots of `make -C evidence farm-demo`: python make_shots.py FOLDER.

Three shots of the same two characters, limbs of different thickness that bend and are tossed about. They are long, so
that a bake takes a while and a kill hits it in the middle.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2] / "sample_blends"))
import bpy
import bulging_cylinder as limb
import dynamic_morph_targets
from stage import add_mesh, add_shape_keys, add_soft_skin, add_vertex_groups, save_scene, set_up_scene

FRAMES = 3000
SHOTS = {"walk": 26, "run": 16, "wave": 34}  # frames of a bend and its return
CHARACTERS = {"Arm": 1.0, "Leg": 1.3}  # thickness
MODES = 40
BEND = math.radians(100)  # of the whole elbow
TOSS = 0.04  # meters up and down

README = "A shot of Dynamorph's farm demo: two limbs that bend and are tossed about. Bake it with Dynamorph."


def add_character(name: str, thickness: float) -> tuple[bpy.types.Object, bpy.types.Object]:
    """The mesh and its rig; what the model depends on is the same in all shots."""
    rig = limb.add_rig()
    rig.name = f"{name} Rig"
    rig.location.y = 0.5 * list(CHARACTERS).index(name)
    vertices, quads = limb.limb_mesh(across=8, along=32)
    bulges = {"Flexed": limb.sculpt(vertices, limb.SHAPES["Flexed"])}
    thick = [1, thickness, thickness]
    obj = add_mesh(name, vertices * thick, quads)
    obj.parent = rig
    obj.modifiers.new("Armature", "ARMATURE").object = rig
    bones = zip(rig.data.bones.keys(), limb.skin_weights(vertices).T, strict=True)
    add_vertex_groups(obj, dict(bones) | {limb.FIRMNESS: 1 - limb.softness(vertices) / 2})
    add_shape_keys(obj, vertices * thick, {key: shape * thick for key, shape in bulges.items()})
    return obj, rig


def animate(rig: bpy.types.Object, period: int):
    """Bend and return, over and over, with a toss each time."""
    for half in range(2 * FRAMES // period + 1):
        frame, up = 1 + half * period // 2, half % 2
        for b in limb.ELBOW:
            rig.pose.bones[b].rotation_euler.x = BEND * up / len(limb.ELBOW)
            rig.pose.bones[b].keyframe_insert("rotation_euler", index=0, frame=frame)
        rig.location.z = limb.HEIGHT + TOSS * up
        rig.keyframe_insert("location", index=2, frame=frame)


def make(path: Path, period: int):
    set_up_scene(README, FRAMES)
    for name, thickness in CHARACTERS.items():
        obj, rig = add_character(name, thickness)
        animate(rig, period)
        flexed = {"Flexed": (1 + period // 2, {"stiffness": 150e3, "stiffness_damping": 0.0015})}
        add_soft_skin(obj, {"stiffness": 15e3}, flexed)
        obj.dynamorph.firmness_group = limb.FIRMNESS
        obj.dynamorph.model.modes = MODES
    save_scene(path)


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    dynamic_morph_targets.register()
    for name, period in SHOTS.items():
        make(folder / f"{name}.blend", period)
