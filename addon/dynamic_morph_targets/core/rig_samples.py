# SPDX-License-Identifier: GPL-3.0-or-later
"""A moving rig as plain data: bones, worlds, nodes and force fields at every step. NumPy only."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .character import Skeleton
from .geometry import inverse, invertible


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
class ForceField:
    """A force field of the scene at S sample times, with Blender's own falloff.

    kind: WIND blows along the object's Z axis, FORCE away from it. plane: distance is from the object's plane, not its
    origin. world (S, 4, 4); strength (S,) newtons on each square metre of skin at rest; nearest, farthest: metres,
    within which it is constant and beyond which it is nothing.
    """

    kind: str
    plane: bool
    power: float
    nearest: float
    farthest: float
    world: np.ndarray
    strength: np.ndarray

    def __getitem__(self, samples: slice) -> ForceField:
        return replace(self, world=self.world[samples], strength=self.strength[samples])

    def pull(self, sample: int, points: np.ndarray) -> np.ndarray:
        """Force on each square metre (V, 3), world space, at points (V, 3) in world space."""
        away = points - self.world[sample, :3, 3]
        axis = self.world[sample, :3, 2]
        if self.plane:
            away = np.outer(away @ axis, axis) / (axis @ axis)
        distance = np.linalg.norm(away, axis=1)
        direction = axis if self.kind == "WIND" else away
        direction = direction / np.maximum(np.linalg.norm(direction, axis=-1, keepdims=True), 1e-12)
        fall = (1.0 + np.maximum(distance - self.nearest, 0.0)) ** -self.power * (distance <= self.farthest)
        return self.strength[sample] * fall[:, None] * direction


@dataclass(frozen=True)
class PosedNodes:
    """n nodes of the cage where Blender's own modifiers put them, at S sample times.

    rest (n, 3) bind space. points (S, 4, n, 3) float32, the object's space: the nodes, and the nodes moved by `reach`
    meters along each axis of bind space.
    """

    rest: np.ndarray
    reach: float
    points: np.ndarray

    def __getitem__(self, samples: slice) -> PosedNodes:
        return replace(self, points=self.points[samples])

    def transforms(self, object_world: np.ndarray) -> np.ndarray:
        """[A | a] (S, n, 3, 4), bind to world space; exact at rest. object_world (S, 4, 4)."""
        out = np.empty((len(self.points), len(self.rest), 3, 4))
        for points, world, frames in zip(self.points, object_world, out, strict=True):
            here, *beside = points @ world[:3, :3].T
            frames[..., 3] = here + world[:3, 3]
            for axis, moved in enumerate(beside):
                frames[..., axis] = (moved - here) / self.reach
                frames[..., 3] -= frames[..., axis] * self.rest[:, axis, None]
        return out


@dataclass(frozen=True)
class RigSamples:
    """The moving rig at S sample times: pose (S, B, 4, 4) armature space, rig_world and object_world (S, 4, 4).

    fields: what pushes the skin then. nodes: the free nodes as Blender poses them, where bones do not say it;
    target_nodes: the same (S = J) in the targets' captured poses, the objects being where they are at the first sample.
    """

    pose: np.ndarray
    rig_world: np.ndarray
    object_world: np.ndarray
    fields: tuple[ForceField, ...] = ()
    nodes: PosedNodes | None = None
    target_nodes: PosedNodes | None = None

    def __len__(self) -> int:
        return len(self.pose)

    def __getitem__(self, samples: slice) -> RigSamples:
        fields = tuple(field[samples] for field in self.fields)
        nodes = self.nodes and self.nodes[samples]
        pose, rig_world, object_world = (part[samples] for part in (self.pose, self.rig_world, self.object_world))
        return RigSamples(pose, rig_world, object_world, fields, nodes, self.target_nodes)

    def concatenate(self, other: RigSamples) -> RigSamples:
        """These samples and others of the same rig, without fields."""
        nodes = self.nodes
        if nodes and other.nodes:
            nodes = replace(nodes, points=np.concatenate([nodes.points, other.nodes.points]))
        return RigSamples(
            np.concatenate([self.pose, other.pose]),
            np.concatenate([self.rig_world, other.rig_world]),
            np.concatenate([self.object_world, other.object_world]),
            nodes=nodes,
            target_nodes=self.target_nodes,
        )

    def moved(self, transforms: np.ndarray) -> RigSamples:
        """The first of these samples, moved rigidly by world transforms (S, 4, 4), without fields."""
        count = len(transforms)
        pose = np.broadcast_to(self.pose[0], (count, *self.pose.shape[1:]))
        nodes = self.nodes
        if nodes:
            nodes = replace(nodes, points=np.broadcast_to(nodes.points[0], (count, *nodes.points.shape[1:])))
        own = transforms @ self.rig_world[0], transforms @ self.object_world[0]
        return RigSamples(pose, *own, nodes=nodes, target_nodes=self.target_nodes)

    @property
    def nbytes(self) -> int:
        """Approximate bytes of what grows with the number of samples."""
        return self.pose.nbytes + (self.nodes.points.nbytes if self.nodes else 0)

    def skin_matrices(self, skeleton: Skeleton, to_bind: np.ndarray) -> np.ndarray:
        """The transforms from bind space to world space, one for each bone and one for the object itself.

        Returns (S, B + 1, 3, 4). The last one moves vertices without weights, which Blender's Armature modifier leaves
        where the object puts them.
        """
        from_bind = np.eye(4)
        from_bind[:3, :3] = inverse(to_bind)
        object_from_bind = self.object_world @ from_bind
        rig_from_bind = inverse(self.rig_world) @ object_from_bind
        out = np.empty((len(self), len(skeleton.rest) + 1, 3, 4))
        out[:, :-1] = (self.rig_world[:, None, :3] @ self.pose @ skeleton.rest_inverse) @ rig_from_bind[:, None]
        out[:, -1] = object_from_bind[:, :3]
        return out
