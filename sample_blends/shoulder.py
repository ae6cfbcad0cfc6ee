# SPDX-License-Identifier: GPL-3.0-or-later
"""Shoulder: a quarter of a man's torso with his left arm, like a bust in a museum, on a stand that can turn.

Its elbow folds in two ways, with the arm raised and with the arm lowered, yet only one target has a folded elbow: the
elbow's targets are limited to a region and are a set of their own.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import bpy
import makehuman
import numpy as np
from mathutils import Matrix
from shoulder_mesh import BONES, Bust, make_bust
from shoulder_sculpt import (
    FOLDED,
    HALF,
    LOWERED,
    RAISED,
    REST,
    elbow_region,
    elbow_shapes,
    shoulder_shapes,
    softness,
)
from stage import (
    add_lathe,
    add_material,
    add_mesh,
    add_shape_keys,
    add_soft_skin,
    add_vertex_groups,
    assign,
    place,
    save_scene,
    set_up_scene,
)

FLOOR = 0.68  # height of the scene's floor on the standing man
ROD = np.array([0.085, 0.015])  # x, y of the stand's rod, about which the bust turns

# (frame, pose): each is reached and kept for a while.
POSES = (
    (1, REST), (6, REST),
    (28, RAISED), (38, RAISED),
    (50, replace(RAISED, fold=HALF)), (56, replace(RAISED, fold=HALF)),
    (68, replace(RAISED, fold=FOLDED)), (82, replace(RAISED, fold=FOLDED)),
    (104, RAISED), (108, RAISED),
    (136, LOWERED), (148, LOWERED),
    (170, replace(LOWERED, fold=FOLDED)), (194, replace(LOWERED, fold=FOLDED)),
    (214, LOWERED), (216, LOWERED),
    (232, REST), (260, REST),
)  # fmt: skip
SHAKES = (176, 234)  # the same shake twice: of the folded arm and of the relaxed one
SHAKE = (0.0, 2.0, -2.0, 2.0, -2.0, 0.0)  # degrees that the stand turns, a key every other frame
FRAMES = 260

FIRMNESS, ELBOW = "Firmness", "Elbow"  # vertex groups: 1 held by the bones; the elbow's region weights
SKIN_COLOR, CUT_COLOR = (0.42, 0.19, 0.115), (0.03, 0.028, 0.03)

# Stiffness in Pa and the two Rayleigh dampings of each target; the frame at which its pose is captured.
RELAXED = {"stiffness": 15e3, "mass_damping": 2.0, "stiffness_damping": 0.006}
TARGETS = {
    "Arm raised": (36, {"stiffness": 25e3, "mass_damping": 2.0, "stiffness_damping": 0.005}),
    "Arm lowered": (146, {"stiffness": 22e3, "mass_damping": 2.0, "stiffness_damping": 0.005}),
    "Half fold": (54, {"region": ELBOW, "stiffness": 60e3, "mass_damping": 2.0, "stiffness_damping": 0.004}),
    "Folded": (80, {"region": ELBOW, "stiffness": 150e3, "mass_damping": 2.0, "stiffness_damping": 0.003}),
}
PLACED_BY = {
    "Arm raised": ("clavicle", "upperarm"),
    "Arm lowered": ("clavicle", "upperarm"),
    "Half fold": ("forearm",),
    "Folded": ("forearm",),
}
MODEL = {"basis": "MODES", "modes": 19, "fit_to_shot": True, "cage_nodes": 2080, "pin_radius": 0.18}

README = """Shoulder

A quarter of a torso with its arm, on a stand. Six dynamic morph targets in two sets:
  the body    Neutral, Arm raised (the deltoid gathers), Arm lowered (chest and flank bulge where the arm presses)
  the elbow   Neutral, Half fold, Folded (the biceps hard and bulged, the crook clear of itself)

The targets of the elbow are limited to the vertex group "Elbow" and placed by the forearm alone. So one folded target
serves both ways to fold: with the arm raised (frames 38 to 104) and lowered (148 to 214). Play the scene before you
bake it: plain skinning runs into itself in both. Then bake it with Dynamorph.

The stand is turned to and fro twice in the same way: at frame 176 with the biceps flexed, at frame 234 relaxed.
"""


# --- Rig and motion ---------------------------------------------------------------------------------------------------


def add_rig(bust: Bust) -> bpy.types.Object:
    rig = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    bpy.context.scene.collection.objects.link(rig)
    rig.location.z = -FLOOR
    rig.show_in_front = True
    rig.data.display_type = "STICK"
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    heads = bust.joints | {"chest": np.array([*ROD, bust.joints["chest"][2]])}
    tails = {"chest": heads["chest"] + [0, 0, 0.22], "clavicle": heads["upperarm"], "upperarm": heads["forearm"],
             "forearm": heads["hand_l"]}  # fmt: skip
    parent = None
    for name in BONES:
        bone = rig.data.edit_bones.new(name)
        bone.head, bone.tail = heads[name], tails[name]
        bone.parent = parent
        parent = bone
    bpy.ops.object.mode_set(mode="OBJECT")
    return rig


def animate(rig: bpy.types.Object, bust: Bust) -> None:
    for frame, pose in POSES:
        for name, turn in zip(BONES[1:], pose.turns(bust.joints)[1:], strict=True):
            key_turn(rig.pose.bones[name], turn, frame)
    for start in SHAKES:
        for k, degrees in enumerate(SHAKE):
            key_turn(rig.pose.bones["chest"], np.array(Matrix.Rotation(math.radians(degrees), 3, "Z")), start + 2 * k)
    rig.animation_data.action.name = "Two folds and a shake"


def key_turn(bone: bpy.types.PoseBone, turn: np.ndarray, frame: int) -> None:
    """Key a bone's rotation, given in the axes of the armature."""
    rest = bone.bone.matrix_local.to_3x3()
    bone.rotation_quaternion = (rest.inverted() @ Matrix(turn.tolist()) @ rest).to_quaternion()
    bone.keyframe_insert("rotation_quaternion", frame=frame)


# --- The skin ---------------------------------------------------------------------------------------------------------


def add_skin(rig: bpy.types.Object, bust: Bust) -> bpy.types.Object:
    materials = add_material("Skin", SKIN_COLOR, 0.42, subsurface=0.1), add_material("Cut", CUT_COLOR, 0.55)
    skin = add_mesh("Shoulder", bust.vertices, np.array(bust.faces, object), *materials)  # faces of any size
    skin.data.polygons.foreach_set("material_index", bust.caps.astype(np.int32))
    skin.data.polygons.foreach_set("use_smooth", ~bust.caps)
    skin.parent = rig
    skin.modifiers.new("Armature", "ARMATURE").object = rig
    groups = dict(zip(BONES, bust.weights.T, strict=True))
    add_vertex_groups(skin, groups | {FIRMNESS: 1 - softness(bust) / 2, ELBOW: elbow_region(bust)})
    add_shape_keys(skin, bust.vertices, shoulder_shapes(bust) | elbow_shapes(bust))
    return skin


# --- The scene --------------------------------------------------------------------------------------------------------


def add_stage(bust: Bust) -> None:
    """The stand that carries the bust, a backdrop, lights and a camera."""
    metal = add_material("Stand", (0.05, 0.05, 0.06), 0.3)
    metal.node_tree.nodes["Principled BSDF"].inputs["Metallic"].default_value = 0.6
    top = bust.vertices[np.unique(np.concatenate([f for f, cap in zip(bust.faces, bust.caps, strict=True) if cap])), 2]
    top = top.min() - FLOOR
    stand = [(0, 0), (0.13, 0), (0.13, 0.022), (0.122, 0.03), (0.03, 0.034), (0.016, 0.05), (0.013, 0.07)]
    stand += [(0.013, top - 0.03), (0.045, top - 0.012), (0.05, top - 0.004), (0.05, top - 0.001), (0, top - 0.001)]
    add_lathe("Stand", stand, metal).location = (*ROD, 0)

    sweep = np.linspace(0, math.pi / 2, 13)
    ys = np.concatenate([[-4], 1.1 + 0.7 * np.sin(sweep), [1.8]])
    zs = np.concatenate([[0], 0.7 - 0.7 * np.cos(sweep), [4]])
    vertices = [(x, y, z) for y, z in zip(ys, zs, strict=True) for x in (-5, 5)]
    faces = [(2 * k, 2 * k + 1, 2 * k + 3, 2 * k + 2) for k in range(len(ys) - 1)]
    add_mesh("Backdrop", vertices, faces, add_material("Backdrop", (0.055, 0.065, 0.08), 0.8))

    for name, location, power, size, spread, color in (
        ("Key", (-1.2, -1.8, 1.9), 75, 0.6, 180, (1.0, 0.95, 0.88)),
        ("Fill", (2.2, -1.4, 0.9), 12, 1.4, 180, (0.80, 0.90, 1.0)),
        ("Rim", (1.0, 1.2, 1.6), 26, 0.5, 130, (1.0, 0.97, 0.92)),
    ):
        light = bpy.data.lights.new(name, "AREA")
        light.energy, light.size, light.spread, light.color = power, size, math.radians(spread), color
        place(bpy.data.objects.new(name, light), location, (0.3, 0, 0.6))
    camera = bpy.data.cameras.new("Camera")
    camera.lens = 56
    bpy.context.scene.camera = place(bpy.data.objects.new("Camera", camera), (-0.5, -2.4, 0.95), (0.325, 0, 0.60))


def make(path: Path) -> None:
    set_up_scene(README, FRAMES, makehuman.LICENSE)
    bust = make_bust()
    rig = add_rig(bust)
    skin = add_skin(rig, bust)
    add_stage(bust)
    animate(rig, bust)
    add_soft_skin(skin, RELAXED, TARGETS)
    for target in skin.dynamorph.targets[1:]:
        target.set_bones(PLACED_BY[target.name])
    assign(skin.dynamorph.model, MODEL)
    skin.dynamorph.firmness_group = FIRMNESS
    save_scene(path)
