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
    add_lathe,
    add_material,
    add_mesh,
    add_shape_keys,
    add_soft_skin,
    add_vertex_groups,
    assign,
    bump,
    place,
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
    """A capsule of quads only: vertices (V, 3) and quads (Q, 4).

    The surface of a box of `across` x `across` x `along` cells, mapped to a tube with round ends; so the ends have no
    pole, where smooth shading would show a star.
    """
    faces = []
    for axis, (u, v) in enumerate(((1, 2), (2, 0), (0, 1))):
        size = np.array([across, across, along])
        for side in (0, size[axis]):
            i, j = (g.ravel() for g in np.meshgrid(np.arange(size[u]), np.arange(size[v]), indexing="ij"))
            corners = np.empty((len(i), 4, 3), int)
            corners[..., axis] = side
            corners[..., u] = i[:, None] + [0, 1, 1, 0]
            corners[..., v] = j[:, None] + [0, 0, 1, 1]
            faces.append(corners if side else corners[:, ::-1])
    cells, quads = np.unique(np.concatenate(faces).reshape(-1, 3), axis=0, return_inverse=True)

    u, v = (2.0 * cells[:, :2] / across - 1).T
    ring = np.maximum(abs(u), abs(v))  # 1 on the side, 0 at the middle of an end
    u, v = np.tan(u * math.pi / 4), np.tan(v * math.pi / 4)  # even steps around the circle
    around = np.stack([u, v], 1) / np.maximum(np.hypot(u, v), 1e-12)[:, None]
    # Along an end, from the middle out: a flat disc, then a quarter circle of radius FILLET.
    flat = RADIUS - FILLET
    arc = flat + FILLET * math.pi / 2
    turn = np.clip((ring * arc - flat) / FILLET, 0, math.pi / 2)
    x = FILLET + (LENGTH - 2 * FILLET) * cells[:, 2] / along
    x += np.where(cells[:, 2] == 0, -1, 1) * FILLET * np.cos(turn)
    radius = (np.minimum(ring * arc, flat) + FILLET * np.sin(turn)) * profile(x) / RADIUS
    return np.column_stack([x, radius[:, None] * around]), quads.reshape(-1, 4)


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
    rig = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    bpy.context.scene.collection.objects.link(rig)
    rig.location.z = HEIGHT
    rig.show_in_front = True
    rig.data.display_type = "STICK"
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    parent = None
    for b, (head, tail) in enumerate(zip(JOINTS, [*JOINTS[1:], TIP], strict=True)):
        bone = rig.data.edit_bones.new(f"Bone {b + 1}")
        bone.head, bone.tail = (head, 0, 0), (tail, 0, 0)
        bone.align_roll((0, 0, 1))  # so that turning about the bone's own X bends toward the inside
        bone.parent, bone.use_connect = parent, parent is not None
        parent = bone
    bpy.ops.object.mode_set(mode="OBJECT")
    for bone in rig.pose.bones:
        bone.rotation_mode = "XYZ"
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
    """The stand whose grip holds the limb, a backdrop, lights and a camera."""
    metal = add_material("Stand", (0.06, 0.07, 0.09), 0.35)
    grip = [(0, -0.05), (0.05, -0.05), (0.092, -0.03), (0.096, -0.022), (0.096, 0.040), (0.092, 0.050), (0.084, 0.054),
            (0.074, 0.052), (0.066, 0.045), (0, 0.04)]  # fmt: skip
    grip = add_lathe("Grip", grip, metal)
    grip.rotation_euler.y = math.pi / 2
    grip.parent = rig
    post = [(0, 0), (0.13, 0), (0.13, 0.012), (0.12, 0.02), (0.04, 0.03), (0.028, 0.045), (0.028, 0.60), (0.022, 0.61),
            (0, 0.61)]  # fmt: skip
    add_lathe("Post", post, metal).location.x = -0.055

    sweep = np.linspace(0, math.pi / 2, 13)
    ys = np.concatenate([[-4], 1.1 + 0.7 * np.sin(sweep), [1.8]])
    zs = np.concatenate([[0], 0.7 - 0.7 * np.cos(sweep), [4]])
    vertices = [(x, y, z) for y, z in zip(ys, zs, strict=True) for x in (-5, 5)]
    faces = [(2 * k, 2 * k + 1, 2 * k + 3, 2 * k + 2) for k in range(len(ys) - 1)]
    add_mesh("Backdrop", vertices, faces, add_material("Backdrop", (0.20, 0.22, 0.28), 0.8))

    for name, location, power, size, color in (
        ("Key", (-0.5, -1.4, 1.9), 34, 0.7, (1.0, 0.95, 0.88)),
        ("Fill", (1.8, -1.2, 0.7), 9, 1.2, (0.80, 0.90, 1.0)),
        ("Rim", (0.9, 1.0, 1.4), 26, 0.5, (1.0, 0.97, 0.92)),
    ):
        light = bpy.data.lights.new(name, "AREA")
        light.energy, light.size, light.color = power, size, color
        place(bpy.data.objects.new(name, light), location, (0.3, 0, 0.3))
    camera = bpy.data.cameras.new("Camera")
    camera.lens = 74
    bpy.context.scene.camera = place(bpy.data.objects.new("Camera", camera), (0.45, -1.75, 0.62), (0.245, 0, 0.345))


def make(path: Path) -> None:
    set_up_scene(README, FRAMES)
    rig = add_rig()
    limb = add_limb(rig)
    add_stage(rig)
    animate(rig)
    add_push(rig)
    add_soft_skin(limb, SOFT_FLESH, TARGETS)
    assign(limb.dynamorph.model, MODEL)
    limb.dynamorph.firmness_group = FIRMNESS
    save_scene(path)
