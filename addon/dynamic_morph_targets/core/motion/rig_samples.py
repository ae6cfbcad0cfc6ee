# SPDX-License-Identifier: GPL-3.0-or-later
"""A moving rig as plain data: bones, worlds, nodes, force fields and colliders at every step. NumPy only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar, Self, TypeVar

import numpy as np

from ..character import Skeleton
from ..geometry import inverse, invertible
from .noise import turbulence


def keep_collapsed(
    samples: RigSamples, skeleton: Skeleton, before: np.ndarray | None = None
) -> tuple[RigSamples, list[str]]:
    """Bones scaled to zero (a common way to hide parts) follow their parents as they last did; returns warnings that
    name them.

    before (B, 4, 4): the pose before the samples, without such bones, if it is known.
    """
    pose = samples.pose if before is None else np.concatenate([before[None], samples.pose])
    good = invertible(pose)
    if good.all():
        return samples, []
    times = np.arange(len(pose))[:, None]
    last = np.maximum.accumulate(np.where(good, times, -1), axis=0)
    kept = np.where(last >= 0, last, good.argmax(axis=0))  # before its first nonzero size, that size is used
    pose = pose.copy()
    collapsed = np.flatnonzero(~good.all(axis=0))
    for b in collapsed:  # parents come first
        parent = skeleton.parents[b]
        joined = skeleton.rest[b] if parent < 0 else pose[:, parent] @ skeleton.rest_inverse[parent] @ skeleton.rest[b]
        local = (inverse(joined) @ pose[:, b])[kept[:, b]] if good[:, b].any() else np.eye(4)
        pose[:, b] = np.where(good[:, b, None, None], pose[:, b], joined @ local)
    names = ", ".join(f"'{skeleton.names[b]}'" for b in collapsed)
    frames = int((~good[-len(samples) :]).any(axis=1).sum())
    warning = f"Bones scaled to zero keep their last size ({frames} of {len(samples)} samples): {names}"
    return replace(samples, pose=pose[-len(samples) :]), [warning]


@dataclass(frozen=True)
class Track:
    """What is known at the same S sample times as a rig, with one rule for each of its arrays in SAMPLED (S, ...)."""

    SAMPLED: ClassVar[tuple[str, ...]]

    def __getitem__(self, samples: slice) -> Self:
        return self._each(lambda array: array[samples])

    def concatenate(self, other: Self) -> Self:
        """These samples, and after them those of the same thing in `other`."""
        joined = {name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in self.SAMPLED}
        return replace(self, **joined)

    def still(self, count: int) -> Self:
        """The first sample, `count` times."""
        return self._each(lambda array: np.broadcast_to(array[0], (count, *array.shape[1:])))

    def _each(self, change: Callable[[np.ndarray], np.ndarray]) -> Self:
        return replace(self, **{name: change(getattr(self, name)) for name in self.SAMPLED})

    @property
    def nbytes(self) -> int:
        """Approximate bytes of what grows with the number of samples, where that is a lot."""
        return 0


@dataclass(frozen=True)
class ForceField(Track):
    """A force field of the scene at S sample times, with Blender's own falloff, as it acts on points at rest.

    kind: WIND blows along the object's Z axis, FORCE away from it, VORTEX about that axis, TURBULENCE in all
    directions. plane: distance is from the object's plane, of a VORTEX from its axis, not from its origin. world
    (S, 4, 4); strength (S,) newtons on each square meter of skin at rest; nearest, farthest: meters, within which it is
    constant and beyond which it is nothing. size: of the largest eddies, meters; unit: meters of a Blender unit;
    in_world: the eddies stay where they are when the object moves.
    """

    SAMPLED = ("world", "strength")
    kind: str
    plane: bool
    power: float
    nearest: float
    farthest: float
    world: np.ndarray
    strength: np.ndarray
    size: float = 1.0
    unit: float = 1.0
    in_world: bool = False

    def pull(self, sample: int, points: np.ndarray) -> np.ndarray:
        """Force on each square meter (V, 3), world space, at points (V, 3) in world space."""
        away = points - self.world[sample, :3, 3]
        axis = _normalized(self.world[sample, :3, 2])
        along = np.outer(away @ axis, axis)
        reach = (away - along if self.kind == "VORTEX" else along) if self.plane else away
        distance = np.linalg.norm(reach, axis=1)
        fall = (1.0 + np.maximum(distance - self.nearest, 0.0)) ** -self.power * (distance <= self.farthest)
        push = (self.strength[sample] * fall)[:, None]
        if self.kind == "WIND":
            return push * axis
        if self.kind == "FORCE":
            return push * _normalized(reach)
        if self.kind == "TURBULENCE":
            return push * turbulence((points if self.in_world else away + self.unit * axis) / self.size)
        turn = np.cross(axis, away)
        if self.plane:  # and inward, as what swirls at the speed `turn` needs it
            turn = push * turn
            return turn + push * np.cross(axis, turn)
        return push * distance[:, None] * _normalized(turn)


def _normalized(vectors: np.ndarray) -> np.ndarray:
    """Of length 1, but those of no length."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


@dataclass(frozen=True)
class PosedNodes(Track):
    """n nodes of the cage where Blender's own modifiers put them, at S sample times.

    rest (n, 3) bind space. points (S, 4, n, 3) float32, the object's space: the nodes, and the nodes moved by `offset`
    meters along each axis of bind space.
    """

    SAMPLED = ("points",)
    rest: np.ndarray
    offset: float
    points: np.ndarray

    def transforms(self, object_world: np.ndarray) -> np.ndarray:
        """[A | a] (S, n, 3, 4), bind to world space; exact at rest. object_world (S, 4, 4)."""
        out = np.empty((len(self.points), len(self.rest), 3, 4))
        for points, world, frames in zip(self.points, object_world, out, strict=True):
            here, *beside = points @ world[:3, :3].T
            frames[..., 3] = here + world[:3, 3]
            for axis, moved in enumerate(beside):
                frames[..., axis] = (moved - here) / self.offset
                frames[..., 3] -= frames[..., axis] * self.rest[:, axis, None]
        return out

    @property
    def nbytes(self) -> int:
        return self.points.nbytes


T = TypeVar("T", bound=Track)


@dataclass(frozen=True)
class RigSamples(Track):
    """The moving rig at S sample times: pose (S, B, 4, 4) armature space, rig_world and object_world (S, 4, 4).

    tracks: what is known at the same times beside the rig, as force fields, colliders, settings that are keyed and,
    where bones do not say it, the free nodes as Blender poses them. target_nodes: the same nodes (S = J) in the
    targets' captured poses, the objects being where they are at the first sample.
    """

    SAMPLED = ("pose", "rig_world", "object_world")
    pose: np.ndarray
    rig_world: np.ndarray
    object_world: np.ndarray
    tracks: tuple[Track, ...] = ()
    target_nodes: PosedNodes | None = None

    def __len__(self) -> int:
        return len(self.pose)

    @property
    def fields(self) -> tuple[ForceField, ...]:
        """What pushes the skin."""
        return tuple(track for track in self.tracks if isinstance(track, ForceField))

    def track(self, kind: type[T]) -> T | None:
        """The only track of a kind; None without one."""
        return next((track for track in self.tracks if isinstance(track, kind)), None)

    @property
    def nodes(self) -> PosedNodes | None:
        """The free nodes as Blender poses them, if bones do not say where they are."""
        return self.track(PosedNodes)

    def __getitem__(self, samples: slice) -> RigSamples:
        return replace(super().__getitem__(samples), tracks=tuple(track[samples] for track in self.tracks))

    def concatenate(self, other: RigSamples) -> RigSamples:
        """These samples, and after them others of the same rig."""
        pairs = zip(self.tracks, other.tracks, strict=True)
        return replace(super().concatenate(other), tracks=tuple(mine.concatenate(theirs) for mine, theirs in pairs))

    def still(self, count: int) -> RigSamples:
        return replace(super().still(count), tracks=tuple(track.still(count) for track in self.tracks))

    def moved(self, transforms: np.ndarray) -> RigSamples:
        """The first of these samples, moved rigidly by world transforms (S, 4, 4). The tracks stay."""
        still = self.still(len(transforms))
        return replace(still, rig_world=transforms @ self.rig_world[0], object_world=transforms @ self.object_world[0])

    @property
    def nbytes(self) -> int:
        """Approximate bytes of what grows with the number of samples."""
        return self.pose.nbytes + sum(track.nbytes for track in self.tracks)

    def skin_matrices(self, skeleton: Skeleton, to_bind: np.ndarray) -> np.ndarray:
        """The transforms from bind space to world space, one for each bone and one for the object itself.

        Returns (S, B + 1, 3, 4). The last one moves vertices without weights, which Blender's Armature modifier leaves
        where the object puts them.
        """
        object_from_bind, rig_from_bind = self.object_from_bind(to_bind), self.rig_from_bind(to_bind)
        out = np.empty((len(self), len(skeleton.rest) + 1, 3, 4))
        out[:, :-1] = (self.rig_world[:, None, :3] @ self.pose @ skeleton.rest_inverse) @ rig_from_bind[:, None]
        out[:, -1] = object_from_bind[:, :3]
        return out

    def object_from_bind(self, to_bind: np.ndarray) -> np.ndarray:
        """The transforms (S, 4, 4) from bind space to where the object puts it in the world."""
        from_bind = np.eye(4)
        from_bind[:3, :3] = inverse(to_bind)
        return self.object_world @ from_bind

    def rig_from_bind(self, to_bind: np.ndarray) -> np.ndarray:
        """The same to the armature's space."""
        return inverse(self.rig_world) @ self.object_from_bind(to_bind)
