# SPDX-License-Identifier: GPL-3.0-or-later
"""Grabbed belly: the torso of the rolling ball, whose belly a hand grips, pulls up and aside. Meters."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
import rolling_ball
from dynamic_morph_targets.core.motion.grab import Patch, pinch
from dynamic_morph_targets.write.authoring import grips
from stage import (
    add_ball,
    add_camera,
    add_material,
    add_studio,
    add_touched_skin,
    paint_for_workbench,
    save_scene,
    set_up_scene,
    smoothstep,
    write_curves,
)  # fmt: skip

FRAMES = 72
GRABBED = np.array([0.46, 0.0, 0.5])  # above it is the belly's top
RADIUS = 0.06  # of what the hand takes hold of
# The frames in which the hand takes hold, has arrived, and lets go; and how far it pulls.
PULLS = ((4, 13, 18, (0.02, 0.0, 0.08)), (38, 46, 50, (-0.07, 0.0, 0.04)))
FARTHEST = 0.15  # of the body's size: what the hand pulls goes far
HANDLE = 0.022  # radius of the ball that shows where the hand is
AWAY = np.array([0.0, 0.0, 3.0])  # where it is meanwhile, out of the picture

README = """Grabbed belly

A torso of three bones lies on its back. A hand pulls the belly up and lets it go, then pulls it aside. The hand is a
ball, which grips the skin as Attach to Object does it, while its Strength is 1. The torso has Feel Cartoon and Quality
Full.

Select Torso, press Bake in the Dynamorph tab, then Play.
"""


def path_of_hand(start: np.ndarray) -> np.ndarray:
    """Where the hand is (F, 3), world; AWAY while it holds nothing."""
    frames = np.arange(1, FRAMES + 1)[:, None]
    path = np.broadcast_to(AWAY, (FRAMES, 3)).copy()
    for first, arrived, last, pull in PULLS:
        holds = ((frames >= first) & (frames <= last))[:, 0]
        path[holds] = (start + smoothstep((frames - first) / (arrived - first)) * pull)[holds]
    return path


def hold(torso: bpy.types.Object, handle: bpy.types.Object) -> np.ndarray:
    """Let the hand grip the torso, which stands still, while it pulls; the hand's path."""
    points = np.array([torso.matrix_world @ vertex.co for vertex in torso.data.vertices])
    start = points[np.linalg.norm(points - GRABBED, axis=1).argmin()]
    vertices, share = pinch(points, start, RADIUS, np.ones(len(points), bool))
    patch = Patch(len(points), vertices, np.round(points[vertices] - start, 6), np.round(share, 6), RADIUS)
    strengths = [(1, 0.0)]
    for first, _, last, _ in PULLS:
        strengths += [(first, 1.0), (last + grips.SOON, 0.0)]
    grips.hold_from(torso, grips.add(torso, "Hand", handle, patch), strengths)
    return path_of_hand(start)


def make(path: Path) -> None:
    set_up_scene(README, FRAMES)
    torso = rolling_ball.lay_torso()
    handle = add_ball("Hand", HANDLE, add_material("Hand", (0.95, 0.62, 0.08), 0.3))
    add_studio((0.4, 0, 0.3))
    add_camera((0.45, -1.9, 0.85), (0.42, 0, 0.34), 66)
    paint_for_workbench()
    add_touched_skin(torso, [])
    bpy.ops.dynamorph.apply_feel(feel="CARTOON")
    torso.dynamorph.simulation.max_displacement = FARTHEST
    bpy.context.view_layer.update()
    write_curves(handle, "Hand", {"location": hold(torso, handle)}, cuts=range(1, FRAMES))
    save_scene(path)
