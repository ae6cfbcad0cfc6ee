# SPDX-License-Identifier: GPL-3.0-or-later
"""Plain data that the modules exchange. NumPy only, never bpy.

`extract` fills these from a Blender scene, `build` and `simulate` consume them, `write` writes the result back.
Spaces: *local* is the mesh object's own space (in which shape keys are stored), *bind* is local space with the object's
scale applied, so its lengths are meters, *world* is Blender's world space in meters (`skin.unit_scale`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cached_property
from itertools import count
from typing import Any, NamedTuple

import numpy as np

from . import firmness, max_distance
from .geometry import inverse
from .settings import Material, ModelSettings

REGION = "Dynamorph Region "  # how the names of automatic regions' vertex groups begin


@dataclass(frozen=True)
class Skeleton:
    """The armature at rest: B bones, parents before children.

    names (B,), parents (B,) index or -1, rest (B, 4, 4) = bone.matrix_local, armature space.
    """

    names: tuple[str, ...]
    parents: np.ndarray
    rest: np.ndarray

    @cached_property
    def rest_inverse(self) -> np.ndarray:
        """Inverse rest matrices (B, 4, 4)."""
        return inverse(self.rest)

    @cached_property
    def below(self) -> np.ndarray:
        """Whether (B, B) the second bone is the first or one of its descendants."""
        below, count = np.eye(len(self.names), dtype=bool), 0
        children = np.flatnonzero(self.parents >= 0)
        while below.sum() > count:  # parents may come after their children, see `references.as_moved`
            count = below.sum()
            for bone in children[::-1]:
                below[self.parents[bone]] |= below[bone]
        return below

    def local_transforms(self, pose: np.ndarray, bones: list[int] | None = None) -> np.ndarray:
        """Each bone's transform relative to its evaluated parent, with the rest transform removed: the identity in the
        rest pose.

        pose (..., B, 4, 4): evaluated pose_bone.matrix, armature space. bones: indices of those that are needed, by
        default all; the others get the identity. Returns (..., B, 4, 4). The evaluated matrices include constraints and
        IK.
        """
        asked = np.arange(len(self.rest)) if bones is None else np.array(bones, int)
        unposed = np.broadcast_to(self.rest[asked], (*pose.shape[:-3], len(asked), 4, 4)).copy()
        child = self.parents[asked] >= 0
        parent = self.parents[asked[child]]
        unposed[..., child, :, :] = pose[..., parent, :, :] @ (self.rest_inverse[parent] @ self.rest[asked[child]])
        local = np.broadcast_to(np.eye(4), pose.shape).copy()
        local[..., asked, :, :] = inverse(unposed) @ pose[..., asked, :, :]
        return local

    def pose(self, local: np.ndarray) -> np.ndarray:
        """The inverse of `local_transforms`: armature-space pose matrices (..., B, 4, 4) of local transforms."""
        pose = np.empty_like(local)
        for b, parent in enumerate(self.parents):
            unposed = self.rest[b] if parent < 0 else pose[..., parent, :, :] @ self.rest_inverse[parent] @ self.rest[b]
            pose[..., b, :, :] = unposed @ local[..., b, :, :]
        return pose


@dataclass(frozen=True)
class Target:
    """One dynamic morph target.

    name: the shape key's name (or "Neutral"). shape (V, 3): displacement of the vertices, local space, zero for the
    neutral. bones: names of the bones whose rotations place it in pose space. local (B, 4, 4): the captured pose of
    the whole skeleton as `Skeleton.local_transforms`; rig_world (4, 4): where the armature stood then.
    fade_out_angle: joint angle from its pose, radians, at which the target has faded out; 0 for never. motion_amount:
    how much of the tissue's motion shows in its pose, 0 to 1. frequency: undamped, Hz, from which a build computes its
    stiffness, 0 where the material says it. channel: name of a number that places it too, '' without one; reached_at:
    its value in the target's pose. It is 0 in the poses of all others.
    """

    name: str
    shape: np.ndarray
    bones: tuple[str, ...]
    local: np.ndarray
    rig_world: np.ndarray
    material: Material
    fade_out_angle: float = 0.0
    motion_amount: float = 1.0
    frequency: float = 0.0
    channel: str = ""
    reached_at: float = 0.0


@dataclass(frozen=True)
class TargetSet:
    """Targets whose weights sum to one; the first is the neutral one. docs/theory.md, Targets.

    region_weights (V,): of this set at each vertex; those of all sets sum to one.
    """

    name: str
    targets: tuple[Target, ...]
    region_weights: np.ndarray

    @property
    def names(self) -> tuple[str, ...]:
        """Of its targets, as authored: '' of the neutral one."""
        return "", *(target.name for target in self.targets[1:])


def region_label(group: str) -> str:
    """What an artist calls the region of a vertex group."""
    return f"Region {group.removeprefix(REGION)}"


def target_labels(target_sets: Sequence[TargetSet]) -> list[str]:
    """What an artist calls the targets of all sets (J,): by name, and each region's neutral target with its region."""
    body, *regions = target_sets
    labels = [target.name for target in body.targets]
    for region in regions:
        neutral = f"{body.targets[0].name} ({region_label(region.name)})"
        labels += [neutral, *(target.name for target in region.targets[1:])]
    return labels


class OwnCage(NamedTuple):
    """The artist's cage: points (C, 3) bind space, triangles (D, 3); name: of its object."""

    name: str
    points: np.ndarray
    triangles: np.ndarray


@dataclass(frozen=True)
class Character:
    """One soft skin: as authored, and by `target_sets` as its method simulates it.

    vertices (V, 3) local space, triangles (T, 3); to_bind (3, 3): bind = to_bind @ local; weights (V, B + 1): skin
    weights as Blender normalizes them, last column 1 for vertices that no bone moves; bone_segments (D, 2, 3): heads
    and tails of the deforming bones, bind space. probed: Blender skins it in a way that is not linear in the bones, so
    the nodes' transforms are read from it (`RigSamples.nodes`), and the weights say only where a bone's tissue is.
    cage_index (V,): the cage that each vertex is in: 0 the body's, k >= 1 one of its own, -1 none, so that the bones
    alone move it. cage: the artist's own, if there is one. rigidity (V,): 1 where the skin belongs to something hard (a
    head, a helmet that touches soft skin), 0 elsewhere; the cage is held there. firmness (V,): weights of the Firmness
    map, see core/firmness; max_distance (V,): those of the Max Distance map, see core/max_distance; excluded (V,): 0.5
    or more where colliders pass through the skin.

    The arrays cover the vertices of all meshes in its cage: first those of the soft skin's own mesh (`own_vertices`),
    then those of `attachments`. coincident (V,): the first vertex at the same place as each, which moves alike.
    """

    name: str
    vertices: np.ndarray
    triangles: np.ndarray
    to_bind: np.ndarray
    weights: np.ndarray
    bone_segments: np.ndarray
    skeleton: Skeleton
    authored_sets: tuple[TargetSet, ...]
    settings: ModelSettings = field(default_factory=ModelSettings)
    probed: bool = False
    cage: OwnCage | None = None
    cage_index: np.ndarray = None  # type: ignore[assignment]  # None until __post_init__
    rigidity: np.ndarray = None  # type: ignore[assignment]  # None until __post_init__
    firmness: np.ndarray = None  # type: ignore[assignment]  # None until __post_init__
    max_distance: np.ndarray = None  # type: ignore[assignment]  # None until __post_init__
    excluded: np.ndarray = None  # type: ignore[assignment]  # None until __post_init__
    coincident: np.ndarray = None  # type: ignore[assignment]  # None until __post_init__
    attachments: tuple[Attachment, ...] = ()

    def __post_init__(self) -> None:
        if self.cage_index is None:
            object.__setattr__(self, "cage_index", np.zeros(len(self.vertices), np.int32))
        if self.rigidity is None:
            object.__setattr__(self, "rigidity", np.zeros(len(self.vertices)))
        if self.firmness is None:
            object.__setattr__(self, "firmness", np.full(len(self.vertices), firmness.NEUTRAL))
        if self.max_distance is None:
            object.__setattr__(self, "max_distance", np.full(len(self.vertices), max_distance.NEUTRAL))
        if self.excluded is None:
            object.__setattr__(self, "excluded", np.zeros(len(self.vertices)))
        if self.coincident is None:
            object.__setattr__(self, "coincident", np.arange(len(self.vertices)))

    @property
    def own_vertices(self) -> slice:
        """The vertices of the soft skin's own mesh."""
        return slice(0, self.attachments[0].members.start if self.attachments else len(self.vertices))

    @property
    def bind_points(self) -> np.ndarray:
        """The vertices (V, 3) in bind space, meters."""
        return self.vertices @ self.to_bind.T

    @property
    def soft_triangles(self) -> np.ndarray:
        """Those triangles (T, 3) whose corners are all carried by a cage."""
        return self.triangles[(self.cage_index[self.triangles] >= 0).all(axis=1)]

    @cached_property
    def target_sets(self) -> tuple[TargetSet, ...]:
        """What is simulated: of the method Single, the neutral target alone."""
        if self.settings.method != "SINGLE":
            return self.authored_sets
        neutral = self.authored_sets[0].targets[0]
        return (TargetSet(self.name, (neutral,), np.ones(len(self.vertices))),)

    @property
    def targets(self) -> list[Target]:
        """All simulated targets, set after set: the order of every (..., J) array."""
        return _in_order(self.target_sets)

    @property
    def target_names(self) -> list[str]:
        """Of `targets` (J,), as authored: '' of each set's neutral one."""
        return [name for target_set in self.target_sets for name in target_set.names]

    @property
    def target_count(self) -> int:
        """How many simulated targets the panel's list has: there the neutral one, which each set has, counts once."""
        return len(self.targets) - len(self.target_sets) + 1

    @property
    def set_of_target(self) -> np.ndarray:
        """The number (J,) of the set that each of `targets` is in."""
        sizes = [len(target_set.targets) for target_set in self.target_sets]
        return np.repeat(np.arange(len(sizes), dtype=np.int32), sizes)

    @property
    def authored_targets(self) -> list[Target]:
        """All targets, set after set, whichever the method simulates."""
        return _in_order(self.authored_sets)

    def material(self, target: int) -> Material:
        """With which a target is simulated, index into `targets`: of the method Shape, the neutral target's."""
        return self.targets[0 if self.settings.method == "SHAPE" else target].material

    def with_settings(self, **changes: Any) -> Character:
        """The same character with other settings."""
        return replace(self, settings=replace(self.settings, **changes))

    def with_targets(self, change: Callable[[int, Target], Target]) -> Character:
        """The same character with the targets change(index, target), index into `authored_targets`."""
        index = count()
        sets = (
            replace(target_set, targets=tuple(change(next(index), target) for target in target_set.targets))
            for target_set in self.authored_sets
        )
        return replace(self, authored_sets=tuple(sets))


def _in_order(target_sets: Sequence[TargetSet]) -> list[Target]:
    return [target for target_set in target_sets for target in target_set.targets]


@dataclass(frozen=True)
class SurfaceMap:
    """The nearest points of a triangle mesh to P points.

    corners (P, 3): vertices of the triangle each lies on; weights (P, 3): its barycentric coordinates there;
    distances (P,): to it.
    """

    corners: np.ndarray
    weights: np.ndarray
    distances: np.ndarray

    def carry(self, values: np.ndarray) -> np.ndarray:
        """Values (V, ...) of the mesh's vertices, interpolated at the points: (P, ...)."""
        return np.einsum("pc,pc...->p...", self.weights, values[self.corners])


@dataclass(frozen=True)
class Attachment:
    """Another mesh, of P vertices, that moves with a character's soft tissue: clothes, for example.

    session_uid: of its object. points (P, 3): its vertices at rest, local space; from_body (3, 3) maps displacements
    in the character's local space to the mesh's own; members: its vertices among those of the character.
    """

    name: str
    session_uid: int
    points: np.ndarray
    from_body: np.ndarray
    members: slice


def same(one: Any, other: Any) -> bool:
    """Whether plain values are equal: records, sequences and arrays by their contents."""
    if one is other:
        return True
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    if is_dataclass(one):
        return all(same(getattr(one, field.name), getattr(other, field.name)) for field in fields(one))
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return one == other
