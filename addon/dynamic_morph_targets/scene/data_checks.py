# SPDX-License-Identifier: GPL-3.0-or-later
"""The checks that read points, weights and poses: once, when a soft skin is added or built."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..core.character import Skeleton, Target
from ..core.geometry import turned
from .checks import Problem, active_targets
from .plain import fits, plain, wanted
from .references import key_points

SAME_POSE = np.radians(0.5)  # the engine cannot interpolate between targets that are nearer than this over all bones


def settings(obj) -> Iterator[Problem]:
    """Values that no button sets, as a damaged .blend, or a stranger's, may have them."""
    authored = obj.dynamorph
    groups = authored, authored.model, authored.simulation, authored.collision, authored.output
    whole = [(each, "'{name}': {setting}") for each in groups]
    targets = [(each, "'{name}': {setting} of target '{target}'") for each in authored.targets]
    for group, text in whole + targets:
        for name, value in plain(group).items():
            prop = group.bl_rna.properties[name]
            if not fits(prop, value):
                yield Problem(
                    f"{text} is {{value}}, but must be {{wanted}}: set it again",
                    name=obj.name,
                    setting=prop.name,
                    target=group.name,
                    value="unknown" if value == "" else value,
                    wanted=wanted(prop),
                )


def shapes(obj) -> Iterator[Problem]:
    """Coordinates that are not numbers, in the Basis and the targets' keys."""
    keys = obj.data.shape_keys
    if keys is None:  # only the mesh exists
        return
    for block in (keys.reference_key, *(keys.key_blocks[target.name] for target in active_targets(obj)[1:])):
        bad = np.flatnonzero(~np.isfinite(key_points(block)).all(axis=1))
        if len(bad):
            yield Problem(
                "'{name}': shape key '{key}' has coordinates that are not numbers at vertices {vertices}: delete or "
                "repair them",
                name=obj.name,
                key=block.name,
                vertices=", ".join(map(str, bad[:5])),
            )


def poses(name: str, targets: tuple[Target, ...], skeleton: Skeleton) -> Iterator[Problem]:
    """Targets of one set that the rotations of the targets' bones alone cannot distinguish."""
    for target in targets[1:]:
        if not target.bones:
            yield Problem(
                "'{name}': target '{target}' has no bones: pose the armature away from the neutral target and press "
                "Capture Pose",
                name=name,
                target=target.name,
            )
    named = {bone for target in targets for bone in target.bones}
    used = [bone in named for bone in skeleton.names]
    for i, first in enumerate(targets):
        for second in targets[i + 1 :]:
            if same_pose(first.local[used], second.local[used]):
                yield Problem(
                    "'{name}': targets '{first}' and '{second}' have the same pose in the bones that place targets: "
                    "capture one of them in another pose, choose its bones, or remove it",
                    name=name,
                    first=first.name,
                    second=second.name,
                )


def same_pose(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether targets with these transforms (B, 4, 4) of the bones that place them cannot be distinguished."""
    return bool(np.linalg.norm(turned(first, second)) < SAME_POSE)
