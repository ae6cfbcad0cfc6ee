# SPDX-License-Identifier: GPL-3.0-or-later
"""Bulging cylinder: a soft limb of four bones, 0.6 m long, carried by a stand. Its elbow is spread over two joints.

Everything is in meters; the limb lies along +X and bends up toward +Z, its *inside*.
"""

from __future__ import annotations

import math
from pathlib import Path

import bpy
import numpy as np
from stage import (
    add_camera,
    add_lathe,
    add_material,
    add_mesh,
    add_shape_keys,
    add_soft_skin,
    add_straight_rig,
    add_studio,
    add_vertex_groups,
    assign,
    bump,
    capsule,
    save_scene,
    set_up_scene,
    smoothstep,
)  # fmt: skip

LENGTH = 0.60
RADIUS = 0.068
FILLET = 0.036  # of the ends
HEIGHT = 0.34  # above the floor
JOINTS = np.array([0.0, 0.14, 0.29, 0.37])  # heads of the bones; the last two make the elbow
ELBOW = (2, 3)
TIP = 0.55
BLEND = 0.12  # length over which a joint's two bones share the skin: about the limb's width, so that it never folds

# (frame, bend of the whole elbow in degrees): each stage is reached and kept; the fall takes a fifth of a second.
BENDS = ((1, 0), (6, 0), (13, -34), (17, -34), (26, 50), (32, 50), (40, 100), (86, 100), (91, 0), (160, 0))
# The same push and the same shake twice: on the flexed limb and on the straight one.
PUSHES = (46, 114)
PUSH = ((0, 0), (4, 1), (10, 1), (11, 0))  # (frames after its start, fraction of the full strength): let go at once
PUSH_STRENGTH = 800  # newtons on a square meter of skin, down
PUSH_CENTER, PUSH_RADIUS = 0.19, 0.13  # along the limb, on its axis: the upper arm, bulged or not
SHAKES = (66, 136)
SHAKE = (0.0, 0.015, -0.015, 0.015, -0.015, 0.0)  # meters up and down, a key every other frame
FRAMES = 160

SKIN_COLOR = np.array([0.03, 0.36, 0.37])
BAND_COLOR = np.array([0.86, 0.40, 0.13])

FIRMNESS = "Firmness"  # vertex group: 0.5 as the targets are, 1 held by the bones
# The sculpted targets as lumps: (side, x, width along x, spread around, height); side +1 is the inside.
SHAPES = {
    "Half bend": ((1, 0.205, 0.066, 0.5, 0.016), (1, 0.47, 0.06, 0.5, 0.004), (-1, 0.33, 0.06, 0.5, 0.005)),
    "Flexed": ((1, 0.190, 0.060, 0.5, 0.038), (1, 0.49, 0.055, 0.5, 0.010), (-1, 0.33, 0.055, 0.5, 0.010)),
    "Back bend": ((1, 0.33, 0.10, 0.6, -0.009), (-1, 0.27, 0.036, 0.5, 0.014), (-1, 0.39, 0.036, 0.5, 0.014)),
}

# Stiffness in Pa and the two Rayleigh dampings of each target; the frame at which its pose is captured.
SOFT_FLESH = {"stiffness": 15e3, "mass_damping": 2.0, "stiffness_damping": 0.005}
TARGETS = {
    "Half bend": (32, {"stiffness": 40e3, "mass_damping": 2.0, "stiffness_damping": 0.0035}),
    "Flexed": (44, {"stiffness": 150e3, "mass_damping": 2.0, "stiffness_damping": 0.0015}),
    "Back bend": (16, {"stiffness": 45e3, "mass_damping": 2.0, "stiffness_damping": 0.003}),
}
MODEL = {
    "basis": "MODES",
    "modes": 13,
    "fit_to_shot": True,
    "cage_nodes": 416,
    "pin_radius": 0.25,
}  # as the thesis: 13 modes, about 918 degrees of freedom

README = """Bulging cylinder

A soft limb with four dynamic morph targets, each captured at a pose of the elbow:
  Neutral    straight, relaxed: very soft
  Half bend  50 degrees: firmer, the muscle begins to gather
  Flexed     100 degrees: hard, bulged by more than plain skinning loses in the bend
  Back bend  -34 degrees: stretched inside, folded outside

A jet of air (a Wind force field) pushes the upper arm down twice with the same force: at frame 46 with the limb flexed,
at frame 114 with the limb straight. The stand is shaken twice in the same way, at frames 66 and 136.
Bake it with Dynamorph, then compare: soft when straight, hard when flexed.
"""


# --- The limb as arrays -----------------------------------------------------------------------------------------------


def profile(x):
    """The radius along the limb: fuller at the upper arm and the forearm, slimmer at the elbow, no ends yet."""
    return RADIUS * (1 + 0.06 * bump(x, 0.19, 0.07) - 0.05 * bump(x, 0.34, 0.05) + 0.04 * bump(x, 0.45, 0.06))


def limb_mesh(across: int = 12, along: int = 50) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and quads (Q, 4) of the limb."""
    vertices, quads = capsule(LENGTH, RADIUS, FILLET, across, along)
    vertices[:, 1:] *= profile(vertices[:, :1]) / RADIUS
    return vertices, quads


def skin_weights(vertices: np.ndarray) -> np.ndarray:
    """(V, 4): each bone takes over from the one below around its head."""
    above = smoothstep((vertices[:, :1] - JOINTS) / BLEND + 0.5)
    above[:, 0] = 1
    return above - np.column_stack([above[:, 1:], np.zeros(len(above))])


def softness(vertices: np.ndarray) -> np.ndarray:
    """(V,): held where the stand grips the limb, soft above."""
    return smoothstep((vertices[:, 0] - 0.055) / 0.06)


def sculpt(vertices: np.ndarray, lumps) -> np.ndarray:
    """The displacements (V, 3) that push the skin outward by smooth lumps, as in SHAPES."""
    radial = vertices * [0, 1, 1]
    reach = np.linalg.norm(radial, axis=1, keepdims=True)
    outward = radial / np.maximum(reach, 1e-9)
    height = sum(
        h * bump(vertices[:, 0], x, width) * np.exp((side * outward[:, 2] - 1) / spread)
        for side, x, width, spread, h in lumps
    )
    return outward * height[:, None] * smoothstep(reach / RADIUS)  # nothing at the middle of the ends


def skin_colors(vertices: np.ndarray) -> np.ndarray:
    """(V, 4) linear RGBA: bands around the limb, so that the eye can follow the skin."""
    band = smoothstep(0.5 + 1.2 * np.cos(vertices[:, :1] / 0.075 * 2 * math.pi))
    color = band * BAND_COLOR + (1 - band) * SKIN_COLOR
    return np.column_stack([color, np.ones(len(color))])


# --- The scene --------------------------------------------------------------------------------------------------------


def add_rig() -> bpy.types.Object:
    rig = add_straight_rig([f"Bone {b + 1}" for b in range(len(JOINTS))], JOINTS, TIP)
    rig.location.z = HEIGHT
    return rig


def animate(rig: bpy.types.Object) -> None:
    for b in ELBOW:
        bone = rig.pose.bones[b]
        for frame, degrees in BENDS:
            bone.rotation_euler.x = math.radians(degrees) / len(ELBOW)
            bone.keyframe_insert("rotation_euler", index=0, frame=frame)
    for start in SHAKES:
        for k, up in enumerate(SHAKE):
            rig.location.z = HEIGHT + up
            rig.keyframe_insert("location", index=2, frame=start + 2 * k)
    rig.animation_data.action.name = "Bend and shake"


def add_push(rig: bpy.types.Object) -> None:
    """The jet of air. The same skin is in its reach, and so the same force acts, whether the limb is bulged or not."""
    bpy.ops.rigidbody.world_add()  # empty: without one, Blender prints an error for every animated field
    bpy.ops.object.effector_add(type="WIND", rotation=(math.pi, 0, 0))
    wind = bpy.context.object
    wind.name = "Push"
    wind.parent = rig
    wind.location.x = PUSH_CENTER
    wind.empty_display_size = 0.1
    wind.field.shape, wind.field.falloff_power = "POINT", 0  # reach is measured from its center
    wind.field.use_max_distance, wind.field.distance_max = True, PUSH_RADIUS
    for start in PUSHES:
        for after, fraction in PUSH:
            wind.field.strength = fraction * PUSH_STRENGTH
            wind.keyframe_insert("field.strength", frame=start + after)
    wind.animation_data.action.name = "Push"


def add_limb(rig: bpy.types.Object) -> bpy.types.Object:
    vertices, quads = limb_mesh()
    limb = add_mesh("Limb", vertices, quads, add_material("Skin", SKIN_COLOR, 0.38, "Skin", subsurface=0.12))
    colors = limb.data.color_attributes.new("Skin", "BYTE_COLOR", "POINT")
    colors.data.foreach_set("color", skin_colors(vertices).astype(np.float32).ravel())
    limb.parent = rig
    modifier = limb.modifiers.new("Armature", "ARMATURE")
    modifier.object = rig
    groups = {bone.name: column for bone, column in zip(rig.data.bones, skin_weights(vertices).T, strict=True)}
    add_vertex_groups(limb, groups | {FIRMNESS: 1 - softness(vertices) / 2})
    add_shape_keys(limb, vertices, {name: sculpt(vertices, lumps) for name, lumps in SHAPES.items()})
    return limb


def add_stage(rig: bpy.types.Object) -> None:
    """The stand whose grip holds the limb, a backdrop and lights."""
    metal = add_material("Stand", (0.06, 0.07, 0.09), 0.35)
    grip = [(0, -0.05), (0.05, -0.05), (0.092, -0.03), (0.096, -0.022), (0.096, 0.040), (0.092, 0.050), (0.084, 0.054),
            (0.074, 0.052), (0.066, 0.045), (0, 0.04)]  # fmt: skip
    grip = add_lathe("Grip", grip, metal)
    grip.rotation_euler.y = math.pi / 2
    grip.parent = rig
    post = [(0, 0), (0.13, 0), (0.13, 0.012), (0.12, 0.02), (0.04, 0.03), (0.028, 0.045), (0.028, 0.60), (0.022, 0.61),
            (0, 0.61)]  # fmt: skip
    add_lathe("Post", post, metal).location.x = -0.055

    add_studio((0.3, 0, 0.3))


def make(path: Path) -> None:
    set_up_scene(README, FRAMES)
    rig = add_rig()
    limb = add_limb(rig)
    add_stage(rig)
    add_camera((0.45, -1.75, 0.62), (0.245, 0, 0.345), 74)
    animate(rig)
    add_push(rig)
    add_soft_skin(limb, SOFT_FLESH, TARGETS)
    assign(limb.dynamorph.model, MODEL)
    limb.dynamorph.firmness_group = FIRMNESS
    save_scene(path)
