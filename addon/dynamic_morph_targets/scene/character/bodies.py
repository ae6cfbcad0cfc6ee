# SPDX-License-Identifier: GPL-3.0-or-later
"""Several meshes as one body: the soft skin's own mesh, and those that are With Body or Held, in one cage.

`extract.character` calls this for every soft skin. Reads only.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cached_property
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from ...core.character import Attachment, Character, SurfaceMap, TargetSet
from ...core.errors import SceneError
from ...core.firmness import kept
from ...core.geometry import diagonal, inverse, vertex_areas
from ...core.model import rigid
from ...core.model.body_parts import RiggedSkin, limb_ends
from ...core.painted_map import EXCLUDED, FIRMNESS, MAX_DISTANCE, PaintedMap
from .. import references
from ..read import mesh_data
from ..read.mesh_data import VertexGroups
from ..read.nearest import nearest
from ..read.source import Source
from ..read.worlds import world_now
from ..skin import attachments_of, is_rendered, own_attachments
from ..skinning import Skinning, meshes_on

# Body sizes; within the first distance, other meshes take over the whole sculpt of the skin, beyond the second none.
NEAR, FAR = 0.03, 0.1
COPY = 0.9  # of the points of a mesh


def joined(source: Source, single: Character) -> Character:
    """The character `single` of the soft skin's own mesh, extended by the other meshes of its body. Raises
    SceneError.
    """
    obj = source.obj
    meshes = source.meshes
    ends = np.cumsum([len(single.vertices), *(len(mesh.points) for mesh in meshes)]).tolist()
    slices = [slice(begin, end) for begin, end in zip([0, *ends], ends, strict=False)]
    whole = _Whole(source, single, meshes, slices)
    cage_index, held = _attached(source, single, meshes)
    beside = beside_body(source, [mesh.obj for mesh in meshes])
    bind = whole.vertices @ single.to_bind.T
    others = [points @ single.to_bind.T for points, _ in beside]
    same, *places = np.split(_coincident(bind, others), np.cumsum([len(bind), *map(len, others)])[:-1])
    # What is at the skin with nearly all of its points is a copy of it, from which weights are taken, for example.
    apart = [k for k, at in enumerate(places) if (at < len(bind)).mean() < COPY]
    seams = np.concatenate([same[:0], *(places[k] for k in apart)])
    cage_index, rigidity = _closed_seams(cage_index, held, same, seams, whole.triangles)
    _refuse_hard(obj, whole, cage_index, rigidity, [(others[k], beside[k][1]) for k in apart])
    firmness = whole.painted(FIRMNESS)
    if single.settings.hold_head:
        moved = references.as_moved(single.skeleton, source.rig)
        found = rigid.heads(moved, whole.weights, bind, whole.triangles)
        head = rigid.head_rigidity(moved, whole.weights, bind, whole.triangles, found)
        skin = RiggedSkin(single.skeleton, source.bone_heads, bind, whole.triangles, whole.weights)
        rigidity = np.maximum(rigidity, np.maximum(head, limb_ends(skin)) * kept(firmness))
    joint_bones = dict.fromkeys(bone for each in (source, *meshes) for bone in each.skinning.bones(source.rig))
    attachments = [
        Attachment(
            mesh.obj.name, mesh.obj.session_uid, mesh.points, inverse(mesh.to_body[:3, :3]), members
        )
        for mesh, members in zip(meshes, slices[1:], strict=True)
    ]  # fmt: skip
    return replace(
        single,
        vertices=whole.vertices,
        triangles=whole.triangles,
        weights=whole.weights,
        bone_segments=source.bone_segments(list(joint_bones)),
        authored_sets=whole.target_sets(same),
        probed=single.probed or any(mesh.skinning.beyond_bones for mesh in meshes),
        cage_index=cage_index,
        rigidity=_most(rigidity, same),
        firmness=firmness[same],
        max_distance=whole.painted(MAX_DISTANCE)[same],
        excluded=whole.painted(EXCLUDED)[same],
        coincident=same,
        attachments=tuple(attachments),
    )


class _Whole:
    """All meshes of a body together, and what the others inherit from its own mesh. slices: of the vertices of each
    mesh, the own one first.
    """

    def __init__(self, source: Source, single: Character, meshes: list[Source], slices: list[slice]):
        self.obj, self.single, self.meshes, self.slices = source.obj, single, meshes, slices
        self.vertices = np.concatenate([single.vertices, *(mesh.in_body for mesh in meshes)])
        shifted = (mesh.triangles + s.start for mesh, s in zip(meshes, slices[1:], strict=True))
        self.triangles = np.concatenate([single.triangles, *shifted]).astype(np.int32)
        self.weights = np.concatenate([single.weights, *(mesh.weights for mesh in meshes)])

    @cached_property
    def _near(self) -> tuple[SurfaceMap, np.ndarray]:
        """The own mesh's skin nearest to the other meshes' vertices, and its distances in body sizes."""
        single, bind = self.single, self.vertices @ self.single.to_bind.T
        of_body = (single.cage_index[single.triangles] == 0).all(axis=1)
        count = len(single.vertices)
        found = nearest(bind[count:], bind[:count], single.triangles[of_body] if of_body.any() else single.triangles)
        return found, found.distances / diagonal(bind)

    def _carried(self, values: np.ndarray, beyond: float) -> np.ndarray:
        """Values (V', ...) of the own mesh transferred to all meshes: (V, ...); `beyond` far from its skin."""
        if not self.meshes or not (values != beyond).any():
            shape = (len(self.vertices) - len(values), *values.shape[1:])
            return np.concatenate([values, np.full(shape, beyond)])
        found, away = self._near
        nearness = ((FAR - away) / (FAR - NEAR)).clip(0.0, 1.0).reshape(-1, *[1] * (values.ndim - 1))
        return np.concatenate([values, beyond + nearness * (found.carry(values) - beyond)])

    def painted(self, of: PaintedMap) -> np.ndarray:
        """The weights (V,) of a map. A mesh with a group of that name keeps its own."""
        group, found = getattr(self.obj.dynamorph, of.group), self._carried(getattr(self.single, of.name), of.neutral)
        for mesh, members in zip(self.meshes, self.slices[1:], strict=True):
            if group and group in mesh.obj.vertex_groups:
                found[members] = mesh_data.painted(mesh.obj, mesh.groups, of, group)
        return found

    def target_sets(self, same: np.ndarray) -> tuple[TargetSet, ...]:
        """The target sets of all meshes; same (V,): see `Character.coincident`."""
        body, *regions = self.single.authored_sets
        weights = [self._carried(target_set.region_weights, 0.0)[same] for target_set in regions]
        rest = (1.0 - sum(weights, np.zeros(len(same)))).clip(0.0)
        rest[self.slices[0]] = body.region_weights
        return tuple(
            replace(
                target_set,
                region_weights=own_weights[same],
                targets=tuple(
                    replace(target, shape=self._carried(target.shape, 0.0)[same]) for target in target_set.targets
                ),
            )
            for target_set, own_weights in zip(self.single.authored_sets, [rest, *weights], strict=True)
        )


def _attached(source: Source, single: Character, meshes: list[Source]) -> tuple[np.ndarray, np.ndarray]:
    """The cage of each vertex (V,) of all meshes, like `Character.cage_index`, and which (V,) of them are held. Raises
    SceneError.
    """
    obj = source.obj
    cage_index, held = [single.cage_index.copy()], [_held(own_attachments(obj), source.groups, len(single.vertices))]
    wholly = {each.object for each in obj.dynamorph.attachments if not each.group and each.attached_by == "HELD"}
    for mesh in meshes:
        attachments = attachments_of(obj, mesh.obj)
        next_cage = 1 + max(int(each.max(initial=0)) for each in cage_index)
        cage_index.append(mesh_data.cages_of(attachments, mesh.obj, mesh.groups, next_cage))
        held.append(_held(attachments, mesh.groups, len(mesh.points)) | (mesh.obj in wholly))
    cage_index, held = np.concatenate(cage_index), np.concatenate(held)
    cage_index[held & (cage_index < 0)] = 0
    return cage_index, held & (cage_index == 0)


def _held(attachments: Iterable[Any], groups: VertexGroups, count: int) -> np.ndarray:
    found = np.zeros(count, bool)
    for attachment, members in mesh_data.members_of(attachments, groups):
        if attachment.attached_by == "HELD":
            found |= members
    return found


def _coincident(bind: np.ndarray, others: list[np.ndarray]) -> np.ndarray:
    size = diagonal(bind)
    return rigid.coincident(np.concatenate([bind, *others]), rigid.COINCIDE * size)


def _closed_seams(
    cage_index: np.ndarray, held: np.ndarray, same: np.ndarray, beside: np.ndarray, triangles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Cages and rigidity (V,) without open seams: a point shared with something that only the bones move is also
    moved by them, and the skin around it is held. beside (P,): the first vertex at each point of other rigid meshes.
    """
    still = np.isin(same, np.concatenate([same[cage_index == -1], beside])) & (cage_index >= 0)
    cage_index = np.where(still, -1, cage_index).astype(np.int32)
    rigidity = held.astype(float)
    rigidity[triangles[still[triangles].any(axis=1)]] = 1.0
    return cage_index, rigidity


def _most(values: np.ndarray, same: np.ndarray) -> np.ndarray:
    """The largest of the values (V,) at each place."""
    largest = np.zeros(len(values))
    np.maximum.at(largest, same, values)
    return largest[same]


def _refuse_hard(
    obj: bpy.types.Object,
    whole: _Whole,
    cage_index: np.ndarray,
    rigidity: np.ndarray,
    beside: list[tuple[np.ndarray, np.ndarray]],
) -> None:
    """Refuses a character that was found to be rigid, unless the artist has said what is soft. beside: bind-space
    points and triangles of what only its bones move. Raises SceneError.
    """
    settings = obj.dynamorph
    if settings.firmness_group or any(not each.reason for each in settings.attachments):
        return
    bind, soft = whole.vertices @ whole.single.to_bind.T, (cage_index >= 0) & (rigidity < 1.0)
    labels, volumes = rigid.part_volumes(bind, whole.triangles)
    areas = vertex_areas(bind, whole.triangles)
    share = np.bincount(labels, areas * soft) / np.maximum(np.bincount(labels, areas), 1e-300)
    other = sum(rigid.part_volumes(points, triangles)[1].sum() for points, triangles in beside)
    little = volumes @ share <= rigid.SOFT_SHARE * (volumes.sum() + other)
    if little or rigid.is_machine(whole.single.skeleton, whole.weights, bind, whole.triangles):
        raise SceneError("'{name}': nothing soft found: paint Firmness", name=obj.name)


# What the bones alone move -------------------------------------------------------------------------------------------


def beside_body(source: Source, meshes: Iterable[bpy.types.Object]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Points (P, 3), in the body's local space at rest, and triangles of the meshes that only its bones move, and that
    renders show.

    meshes: the other objects that belong to the body. Raises SceneError.
    """
    obj = source.obj
    soft = {obj, *meshes, *(each.object for each in obj.dynamorph.attachments if each.attached_by == "OWN_CAGE")}
    found, to_body = [], inverse(source.world)
    for other in meshes_on(source.rig):
        if other not in soft and not other.dynamorph.targets and len(other.data.vertices) and is_rendered(other):
            mesh = source.attachment(Skinning.of(other))
            placed = mesh.world if mesh.skinning.modifiers else _rest_world(other, source)
            found.append((mesh_data.carried(mesh.points, to_body @ placed), mesh.triangles))
    return found


def _rest_world(other: bpy.types.Object, source: Source) -> np.ndarray:
    """World transform (4, 4), meters, of an object parented to the armature or its bones while that is at rest."""
    rig = source.rig
    if other == rig:
        return source.rig_world
    basis = np.array(other.matrix_parent_inverse) @ np.array(other.matrix_basis)
    if other.parent is None:
        return world_now(other)
    above = _rest_world(other.parent, source)
    if other.parent == rig and other.parent_type == "BONE" and other.parent_bone in rig.data.bones:
        bone = rig.data.bones[other.parent_bone]
        above = above @ np.array(bone.matrix_local @ Matrix.Translation((0.0, bone.length, 0.0)))
    return above @ basis
