# SPDX-License-Identifier: GPL-3.0-or-later
"""A posed rig as the engine needs it: transforms of bones or nodes, target weights, and the posed skin. Never touches
bpy.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Protocol

import numpy as np

from ..character import Character, Skeleton, Target, TargetSet, target_labels
from ..engine import dynamorph
from ..errors import SceneError
from ..geometry import determinant, interpolated, inverse, vertex_areas
from ..model.model import Model
from .keyed import KeyedSettings
from .rig_samples import ForceField, RigSamples

FLAT = 1e-9  # determinant of a node's transform below which it counts as collapsed


class WithTargets(Protocol):
    """A character, or so much of one that targets have places in its pose space."""

    @property
    def name(self) -> str: ...
    @property
    def skeleton(self) -> Skeleton: ...
    @property
    def target_sets(self) -> tuple[TargetSet, ...]: ...
    @property
    def targets(self) -> list[Target]: ...


def placing_bones(character: WithTargets) -> list[int]:
    """Indices of the bones whose rotations place targets in pose space; missing bones are left out."""
    names = character.skeleton.names
    placing = {bone for target in character.targets for bone in target.bones}
    return [index for index, name in enumerate(names) if name in placing]


def channels(targets: Sequence[Target]) -> list[str]:
    """The names (C,) of the channels that place targets."""
    return list(dict.fromkeys(target.channel for target in targets if target.channel))


def reached(targets: Sequence[Target], names: Sequence[str]) -> np.ndarray:
    """The values (J, C) of channels in the targets' poses."""
    values = [[target.reached_at if target.channel == name else 0.0 for name in names] for target in targets]
    return np.array(values).reshape(len(targets), len(names))


def channels_of(keyed: KeyedSettings | None, samples: int, targets: Sequence[Target]) -> np.ndarray:
    """The values (S, C) of the channels that place targets; 0 where a track does not have them."""
    read = [keyed and keyed.of("CHANNEL", name) for name in channels(targets)]
    return np.array([np.zeros(samples) if values is None else values for values in read]).reshape(-1, samples).T


def pose_space(character: WithTargets) -> dynamorph.PoseSpace:
    """Raises dynamorph.Error, naming both, when two targets have the same pose; SceneError on a missing bone."""
    names = character.skeleton.names
    sets, labels = [], iter(target_labels(character.target_sets))
    known = channels(character.targets)
    for target_set in character.target_sets:
        named = sorted({bone for target in target_set.targets for bone in target.bones})
        missing = [bone for bone in named if bone not in names]
        if missing:
            raise SceneError(
                "'{name}': bone '{bone}' of target set '{target_set}' is missing",
                name=character.name,
                bone=missing[0],
                target_set=target_set.name,
            )
        sets.append(
            dynamorph.TargetSet(
                [names.index(bone) for bone in named],
                [next(labels) for _ in target_set.targets],
                [target.local for target in target_set.targets],
                [target.fade_out_angle for target in target_set.targets],
                [known.index(name) for name in channels(target_set.targets)],
                [*reached(target_set.targets, known)],
            )
        )
    return dynamorph.PoseSpace(sets)


class Posing:
    """A character's poses. probed: whether `RigSamples.nodes` determines where its nodes are, because the bones do
    not.
    """

    def __init__(self, model: Model, character: Character, probed: bool):
        self._model = model
        self._character = character
        self._probed = probed
        self._space = pose_space(character)

    def posed(self, rig: RigSamples) -> tuple[np.ndarray, np.ndarray]:
        """Transforms as `frames`, and target weights (S, J)."""
        local = self._model.skeleton.local_transforms(rig.pose, placing_bones(self._character))
        values = channels_of(rig.track(KeyedSettings), len(rig), self._character.targets)
        return self.frames(rig), self._space.weights(local, values)

    def frames(self, rig: RigSamples) -> np.ndarray:
        """The transforms for the engine: of the bones (S, B + 1, 3, 4), or of the free nodes (S, n, 3, 4)."""
        model = self._model
        if not self._probed:
            return rig.skin_matrices(model.skeleton, model.to_bind)
        if rig.nodes is None or not np.array_equal(rig.nodes.rest, model.nodes[model.free]):
            raise ValueError(f"'{self._character.name}' was sampled without the nodes of its model: sample it again")
        frames = rig.nodes.transforms(rig.object_world)
        flat = np.abs(determinant(frames[..., :3])) < FLAT
        if flat.any():  # bones scaled to zero, which `rig_samples.keep_collapsed` gives a size
            sample, node = np.nonzero(flat)
            bones = rig.skin_matrices(model.skeleton, model.to_bind)[sample]
            frames[flat] = np.einsum("kb,kbij->kij", model.node_weights[model.free][node], bones)
        return frames

    def target_frames(self, rig: RigSamples) -> np.ndarray:
        """`frames` of the targets' captured poses (J, ...), with the armature as it was then."""
        targets = self._character.targets
        pose = self._model.skeleton.pose(np.array([target.local for target in targets]))
        rig_world = np.array([_resized(target.rig_world, rig.rig_world[0]) for target in targets])
        object_world = rig_world @ inverse(rig.rig_world[0]) @ rig.object_world[0]
        return self.frames(RigSamples(pose, rig_world, object_world, (rig.target_nodes,) if rig.target_nodes else ()))

    def skinned(self, rig: RigSamples) -> np.ndarray:
        """The skin at rest, posed by the rig: (S, V, 3), world space; of a probed skin, the part whose motion is
        known.
        """
        return np.array([self.skin.posed(frame) for frame in self.frames(rig)])[:, self.skin.known]

    @cached_property
    def skin(self) -> Skin:
        return Skin(self._model, self._character)


class Skin:
    """The skin in world space, and the nodes that carry the forces on it."""

    def __init__(self, model: Model, character: Character):
        self.model = model
        self.rest = character.bind_points
        self._weights = character.weights
        self._carriers: np.ndarray | None = None
        self.known: np.ndarray | slice = slice(None)
        if character.probed and len(model.tets):
            # The bones do not say where it is, the free nodes do: each vertex is moved like those that carry it, on
            # average. What only pinned nodes carry is not known, but nothing that acts there has an effect.
            carried = model.embedding_weights.clip(0.0) * model.free[model.embedding_nodes]
            total = carried.sum(axis=1, keepdims=True)
            self.known = total[:, 0] > 0.0
            self._weights = carried / np.where(total > 0.0, total, np.inf)
            self._carriers = (np.cumsum(model.free) - 1)[model.embedding_nodes]
        self.areas = vertex_areas(self.rest, character.triangles)  # m^2

    def posed(self, frames: np.ndarray, displacement: np.ndarray | float = 0.0) -> np.ndarray:
        """The skin (V, 3), displaced by (V, 3) in bind space, at the transforms that the engine gets (B + 1, 3, 4)."""
        if self._carriers is None:
            matrices = np.tensordot(self._weights, frames, 1)
        else:
            matrices = np.einsum("va,vaij->vij", self._weights, frames[self._carriers])
        return np.einsum("vij,vj->vi", matrices[:, :, :3], self.rest + displacement) + matrices[:, :, 3]

    def push(
        self, fields: Sequence[ForceField], sample: int, frames: np.ndarray, displacement: np.ndarray
    ) -> np.ndarray:
        """Newtons on the nodes (n, 3), world space; frames as for `posed`, displacement of the nodes (n, 3)."""
        model = self.model
        moved = interpolated(displacement, model.embedding_nodes, model.embedding_weights)
        points = self.posed(frames, moved)
        return model.on_nodes(self.areas[:, None] * sum(field.pull(sample, points) for field in fields))

    def pushes(self, fields: Sequence[ForceField], frames: np.ndarray, displacement: np.ndarray) -> np.ndarray:
        """`push` at each of the samples (S, n, 3); of a single one, which is constant: (n, 3)."""
        push = np.array([self.push(fields, k, frame, displacement) for k, frame in enumerate(frames)])
        return push[0] if len(push) == 1 else push


def _resized(world: np.ndarray, like: np.ndarray) -> np.ndarray:
    """The position and orientation of a world transform (4, 4) with the scale of another: a scale may have been applied
    since.
    """
    u, _, vt = np.linalg.svd(world[:3, :3])
    _, sizes, axes = np.linalg.svd(like[:3, :3])
    out = world.copy()
    out[:3, :3] = u @ vt @ (axes.T * sizes) @ axes
    return out
