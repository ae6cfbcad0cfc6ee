# SPDX-License-Identifier: GPL-3.0-or-later
"""Motions without keyframes that shake a rig, and how far reduced motion is from Full Quality in one. Never touches
bpy.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..character import Character
from ..geometry import smooth_step, vertex_areas
from ..model.model import Model
from ..settings import SimulationSettings
from . import baked, simulate
from .player import Player
from .rig_samples import RigSamples

SECONDS = 2.5  # a shake
REST = 0.1  # seconds of it before it moves
STOMP, HOP, TWIST = 0.08, 0.12, math.radians(60)  # how far: body sizes, and an angle


def shake(kind: str, seconds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Height, in body sizes, and angle (S,) at these times after the start."""
    t, none = seconds - REST, np.zeros_like(seconds)
    if kind == "STOMP":
        fallen = np.clip((t - 0.4) / 0.2, 0.0, 1.0)
        return STOMP * np.minimum(smooth_step(t / 0.4), 1.0 - fallen**2), none
    if kind == "TWIST":
        return none, TWIST * (smooth_step(t / 0.25) - smooth_step((t - 1.0) / 0.25))
    airborne = np.where((t > 0.0) & (t < 1.0), t % 0.5 / 0.5, 0.0)
    return HOP * 4.0 * airborne * (1.0 - airborne), none


def transforms(kind: str, still: RigSamples, player: Player, seconds: float = SECONDS) -> np.ndarray:
    """What moves the rig that stands still, at the player's substeps: (S, 4, 4), world space, meters."""
    settings = player.settings
    count = 1 + round(seconds * settings.rate) * settings.substeps
    heights, angles = shake(kind, np.arange(count) * settings.step)
    out = np.tile(np.eye(4), (count, 1, 1))
    out[:, 0, 0] = out[:, 1, 1] = np.cos(angles)
    out[:, 1, 0] = np.sin(angles)
    out[:, 0, 1] = -out[:, 1, 0]
    origin = still.rig_world[0, :3, 3]
    out[:, :3, 3] = origin - out[:, :3, :3] @ origin
    out[:, 2, 3] += heights * player.size
    return out


def expected_error(model: Model, character: Character, still: RigSamples, settings: SimulationSettings) -> float:
    """How far the reduced motion of a hop is from Full Quality, as `baked.motion_distance`. still: the rig's pose."""
    by_solver = [replace(character.settings, solver=solver) for solver in ("REDUCED", "FULL")]
    shots = [simulate.Shot(model.with_settings(each), character, settings) for each in by_solver]
    seconds = (settings.frame_end - settings.frame_start) / settings.fps
    hop = still.moved(transforms("HOP", still, shots[0].player, seconds))
    for shot in shots:
        shot.play(hop)
    reduced, full = (shot.bake(exact=shot is shots[1])[0] for shot in shots)  # exact reduced ones take memory
    areas = vertex_areas(character.bind_points, character.triangles)
    return baked.motion_distance(reduced, full, character.to_bind, areas)
