# SPDX-License-Identifier: GPL-3.0-or-later
"""How much each target counts in pose space, and which poses are far from all of them. Never touches bpy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..character import Skeleton, TargetSet
from . import posing

SLACK = 1.1  # on half the widest gap between neighbors


@dataclass(frozen=True, eq=False)
class TargetWeights:
    """Weights (F, J) of the targets at F poses, and the distance (F, S) in radians to each set's nearest target.

    sets (S,): as in a Character, but without shapes; limits (S,): the distance beyond which a pose is uncovered.
    """

    sets: tuple[TargetSet, ...]
    weights: np.ndarray
    nearest: np.ndarray
    limits: np.ndarray

    @property
    def outside(self) -> np.ndarray:
        """(F, S)."""
        return self.nearest > self.limits

    def by_set(self) -> list[tuple[int, range]]:
        """The sets with more than the neutral target, by index, and the slice of their targets among all."""
        ends = np.cumsum([len(target_set.targets) for target_set in self.sets]).tolist()
        ranges = [range(begin, end) for begin, end in zip([0, *ends], ends, strict=False)]
        return [(s, targets) for s, targets in enumerate(ranges) if len(targets) > 1]

    def worst(self) -> tuple[int, int] | None:
        """Indices (pose, set) of the largest distance relative to its limit; None when every pose is covered."""
        excess = self.nearest / self.limits
        pose, s = np.unravel_index(excess.argmax(), excess.shape)
        return (int(pose), int(s)) if excess[pose, s] > 1.0 else None


class Space:
    """The pose space of one soft skin: the parts of a Character that `posing.pose_space` needs. order (B,): the index
    of the skeleton's bones among those of the armature's pose.
    """

    def __init__(self, name: str, skeleton: Skeleton, target_sets: tuple[TargetSet, ...], order: list[int]):
        self.name, self.skeleton, self.target_sets, self.order = name, skeleton, target_sets, order
        self.targets = [target for target_set in target_sets for target in target_set.targets]
        self.placing, self.channels = posing.placing_bones(self), posing.channels(self.targets)
        self.engine = posing.pose_space(self)
        self.begins = np.cumsum([0, *(len(target_set.targets) for target_set in target_sets)])
        self.limits = self._limits()

    def weights_at(self, pose: np.ndarray, channels: np.ndarray) -> TargetWeights:
        """At evaluated poses (F, B, 4, 4), armature space, and values of the channels (F, C)."""
        with np.errstate(all="ignore"):  # of a bone scaled to zero, which the engine refuses by name
            local = self.skeleton.local_transforms(pose, self.placing)
        nearest = np.minimum.reduceat(self.engine.distances(local, channels), self.begins[:-1], axis=1)
        return TargetWeights(self.target_sets, self.engine.weights(local, channels), nearest, self.limits)

    def _limits(self) -> np.ndarray:
        values = posing.reached(self.targets, self.channels)
        apart = self.engine.distances(np.array([target.local for target in self.targets]), values)
        np.fill_diagonal(apart, np.inf)
        gaps = [
            apart[begin:end, begin:end].min(axis=1).max()
            for begin, end in zip(self.begins[:-1], self.begins[1:], strict=True)
        ]
        return SLACK * np.array(gaps) / 2
