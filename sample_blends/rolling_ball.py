# SPDX-License-Identifier: GPL-3.0-or-later
"""Rolling ball: a torso lies on its back, and a ball with Blender's Collision falls on its belly, rolls over it, and
drops off at the other end. Meters; the torso lies along +X from the shoulders to the hips, its belly up.
"""

from __future__ import annotations

import math
from pathlib import Path

import bpy
import numpy as np
from stage import (
    add_ball,
    add_box,
    add_camera,
    add_material,
    add_mesh,
    add_straight_rig,
    add_studio,
    add_touched_skin,
    add_vertex_groups,
    bump,
    capsule,
    paint_for_workbench,
    save_scene,
    set_up_scene,
    smoothstep,
    write_curves,
)  # fmt: skip

LENGTH, RADIUS, ROUND = 0.82, 0.16, 0.13  # of the torso, and of its ends
MAT = 0.12  # height of what it lies on
JOINTS = np.array([0.06, 0.34, 0.58])  # heads of the bones, along the torso
TIP = 0.78
BONES = ("Chest", "Waist", "Hips")
BLEND = 0.16  # length over which two bones share the skin
HEIGHT = MAT + 0.107  # of the bones: it lies a bit in the mat

BALL = 0.105  # radius
START = 0.17, 0.02  # where it falls from: along the torso, above it
SPEED = 0.36  # along the torso, m/s
GRAVITY = 9.81
BELLY, FLOOR, DAMPING = 16.5, 60.0, 0.6  # springs below the ball: radians per second; 3.6 cm deep in the belly at rest
FPS, FRAMES, STEPS = 24, 84, 20  # STEPS: of the fall and the springs, a frame

SKIN, SHORTS, WAISTBAND = (0.78, 0.42, 0.29), (0.05, 0.16, 0.45), (0.86, 0.80, 0.66)
PANELS = ((0.85, 0.12, 0.06), (0.92, 0.90, 0.84), (0.95, 0.62, 0.08))

README = """Rolling ball

A torso of three bones lies on its back. A ball falls on the belly, rolls over it and drops off. The ball has Blender's
Collision; the torso has Quality Full, so that the ball leaves a dent.

Select Torso, press Bake in the Dynamorph tab, then Play.
"""


# --- The torso as arrays ----------------------------------------------------------------------------------------------


def torso_mesh() -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and quads (Q, 4): wide at shoulders and hips, flat below, with a paunch and a navel."""
    vertices, quads = capsule(LENGTH, RADIUS, ROUND, 20, 44)
    x, y, z = vertices.T
    wide = 1.25 + 0.10 * bump(x, 0.12, 0.14) + 0.14 * bump(x, 0.72, 0.14) - 0.05 * bump(x, 0.4, 0.1)
    up = z > 0
    high = np.where(up, 1 + 0.5 * bump(x, 0.46, 0.17) * (z / RADIUS), 0.72 - 0.14 * bump(x, 0.42, 0.12))
    navel = 0.014 * bump(np.hypot(x - 0.52, y), 0.0, 0.022) * up
    return np.column_stack([x, y * wide, z * high - navel]), quads


def skin_weights(vertices: np.ndarray) -> np.ndarray:
    """(V, 3): each bone takes over from the one before it around its head."""
    after = smoothstep((vertices[:, :1] - JOINTS) / BLEND + 0.5)
    after[:, 0] = 1
    return after - np.column_stack([after[:, 1:], np.zeros(len(after))])


def skin_colors(vertices: np.ndarray) -> np.ndarray:
    """(V, 4) linear RGBA: shorts, and lines around the body, so that the eye can follow the skin."""
    x = vertices[:, :1]
    lines = smoothstep((np.cos(x / 0.06 * 2 * math.pi) - 0.75) / 0.2)
    color = (1 - 0.25 * lines) * SKIN
    worn, band = smoothstep((x - 0.62) / 0.012), smoothstep((x - 0.645) / 0.012)
    color = (1 - worn) * color + worn * ((1 - band) * WAISTBAND + band * (1 - 0.3 * lines) * SHORTS)
    return np.column_stack([color, np.ones(len(color))])


# --- The ball's way ---------------------------------------------------------------------------------------------------


def ball_path(vertices: np.ndarray) -> np.ndarray:
    """The ball's middle (F, 3): it keeps its speed along the torso (V, 3), and lies on a damped spring."""
    ridge = vertices[(vertices[:, 2] > 0) & (abs(vertices[:, 1]) < 0.02)]
    ridge = ridge[np.argsort(ridge[:, 0])] + [0, 0, HEIGHT]

    def ground(x: float) -> tuple[float, float]:
        """Where the ball's middle would be without sinking in, and how many radians a second the spring has."""
        fine = np.linspace(x - BALL, x + BALL, 101)
        top = np.interp(fine, ridge[:, 0], ridge[:, 2], MAT, MAT)
        high = (top + np.sqrt(np.clip(BALL**2 - (fine - x) ** 2, 0, None))).max()
        return high, BELLY if high > MAT + BALL + 0.02 else FLOOR

    step = 1 / (FPS * STEPS)
    x, z, up = START[0], START[1] + ground(START[0])[0], 0.0
    path = []
    for k in range(FRAMES * STEPS):
        if k % STEPS == 0:
            path.append((x, 0, z))
        high, spring = ground(x)
        rises = (ground(x + SPEED * step)[0] - high) / step
        push = spring**2 * (high - z) - 2 * DAMPING * spring * (up - rises) if z < high else 0.0
        up += (max(push, 0.0) - GRAVITY) * step
        x, z = x + SPEED * step, z + up * step
    return np.array(path)


# --- The scene --------------------------------------------------------------------------------------------------------


def lay_torso() -> bpy.types.Object:
    """The torso with its rig, on a mat."""
    add_box("Mat", (-0.25, -0.4, 0), (2.2, 0.4, MAT), add_material("Mat", (0.10, 0.30, 0.25), 0.7))
    rig = add_straight_rig(BONES, JOINTS, TIP)
    rig.location.z = HEIGHT
    vertices, quads = torso_mesh()
    torso = add_mesh("Torso", vertices, quads, add_material("Skin", SKIN, 0.4, "Skin", subsurface=0.12))
    colors = torso.data.color_attributes.new("Skin", "BYTE_COLOR", "POINT")
    colors.data.foreach_set("color", skin_colors(vertices).astype(np.float32).ravel())
    torso.parent = rig
    torso.modifiers.new("Armature", "ARMATURE").object = rig
    add_vertex_groups(torso, dict(zip(BONES, skin_weights(vertices).T, strict=True)))
    return torso


def add_beach_ball(path: np.ndarray) -> bpy.types.Object:
    ball = add_ball("Ball", BALL, *(add_material("Panel", color, 0.3) for color in PANELS))
    for polygon in ball.data.polygons:
        polygon.material_index = int((math.atan2(polygon.center.y, polygon.center.x) / math.pi + 1) * 3) % 3
    ball.rotation_mode = "YXZ"  # about Y last: it rolls, with the panels' pole aside
    turned = (path[:, 0] - path[0, 0]) / BALL
    rotation = np.stack([np.full(len(path), 1.2), turned, 0 * turned], 1)
    write_curves(ball, "Roll", {"location": path, "rotation_euler": rotation})
    return ball


def make(path: Path) -> None:
    set_up_scene(README, FRAMES)
    torso = lay_torso()
    ball = add_beach_ball(ball_path(torso_mesh()[0]))
    add_studio((0.4, 0, 0.3))
    add_camera((0.5, -1.9, 1.0), (0.5, 0, 0.30), 62)
    paint_for_workbench()
    add_touched_skin(torso, [ball])
    save_scene(path)
