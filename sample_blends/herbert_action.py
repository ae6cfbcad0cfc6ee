# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion to keys: Herbert's shots one after the other in one action."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import herbert_motion as motion
import numpy as np
from herbert_skeleton import Motion, Skeleton, solve
from mathutils import Matrix
from stage import write_curves

APART = 40.0  # meters from the first shot's place back to the second's


@dataclass(frozen=True)
class Timeline:
    """Frame numbers: the shots' first frames, and the poses of the targets."""

    starts: dict[str, int]
    half_tuck: int
    tuck: int


def animate(rig: bpy.types.Object, bones: Skeleton, shots: dict[str, Motion]) -> Timeline:
    """Key every bone that moves on every frame, one shot after the other in one action."""
    solved = [solve(bones, shot) for shot in shots.values()]
    lengths = [len(shot.times) for shot in shots.values()]
    starts = dict(zip(shots, np.cumsum([1, *lengths[:-1]]).tolist(), strict=True))
    away = [np.zeros(3), np.array([0, APART, 0])]
    pelvis = np.concatenate([place + offset for (_, place), offset in zip(solved, away, strict=True)])
    cut = starts["Wall"] - 1
    corner = starts["Wall"] + round(motion.IMPACT * motion.FPS)

    curves = {}
    root = rig.data.bones["pelvis"]
    local = (pelvis - np.array(root.head_local)) @ np.array(root.matrix_local.to_3x3())
    curves['pose.bones["pelvis"].location'] = local
    for name in solved[0][0]:
        turns = np.concatenate([np.broadcast_to(t[name], (n, 3, 3)) for (t, _), n in zip(solved, lengths, strict=True)])
        rest = np.array(rig.data.bones[name].matrix_local.to_3x3())
        curves[f'pose.bones["{name}"].rotation_quaternion'] = quaternions(rest.T @ turns @ rest)
    write_curves(rig, "Dive and wall", curves, (cut,), (cut, cut + 1, corner))
    spine = shots["Dive"].spine
    half = int(np.argmax((shots["Dive"].times > motion.TAKE_OFF) & (spine > 0.4 * spine.max())))
    return Timeline(starts, 1 + half, 1 + round(np.mean(motion.TUCKED) * motion.FPS))


def quaternions(rotations: np.ndarray) -> np.ndarray:
    """(F, 4) of rotations (F, 3, 3), without jumps of sign."""
    out = np.array([Matrix(rotation.tolist()).to_quaternion() for rotation in rotations])
    signs = np.sign((out[1:] * out[:-1]).sum(axis=1))
    out[1:] *= np.cumprod(np.where(signs < 0, -1, 1))[:, None]
    return out
