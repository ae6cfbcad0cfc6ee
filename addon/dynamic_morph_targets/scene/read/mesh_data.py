# SPDX-License-Identifier: GPL-3.0-or-later
"""The mesh of an object as arrays: points, triangles, vertex groups, skin weights.

Skinning is Blender's: shape keys first, then the Armature modifier, weights normalized over the deforming bones.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from typing import Any
from zlib import crc32

import bmesh
import bpy
import numpy as np

from ...core.character import Skeleton
from ...core.errors import SceneError
from ...core.geometry import determinant
from ...core.message import Message
from ...core.painted_map import PaintedMap
from ..references import key_points

MEMBER = 0.5  # smallest weight with which a vertex belongs to an attachment
NO_WEIGHT = 1e-4  # Blender does not move a vertex whose weights sum to less


def rest_points(obj: bpy.types.Object) -> np.ndarray:
    """Points (V, 3) of the mesh without its shape keys, local space. Raises SceneError."""
    points = np.empty((len(obj.data.vertices), 3), np.float32)
    if obj.data.shape_keys:
        points = key_points(obj.data.shape_keys.reference_key)
    elif obj.data.is_editmode:  # which hides the attribute
        raise SceneError("'{name}' is in Edit Mode: leave it first", name=obj.name)
    else:
        obj.data.attributes["position"].data.foreach_get("vector", points.ravel())
    if not np.isfinite(points).all():
        raise SceneError(
            "'{name}' has vertices whose coordinates are not numbers: delete or repair them", name=obj.name
        )
    return points.astype(np.float64)


def shown_points(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
    """World positions (V, 3) of the mesh's own vertices as shown; modifiers that add some put theirs after them.

    Raises SceneError where modifiers take some away.
    """
    evaluated = obj.evaluated_get(depsgraph)
    count = len(obj.data.vertices)
    if len(evaluated.data.vertices) < count:
        raise SceneError(
            "Modifiers take vertices of '{name}' away: turn them off to see or grab its skin", name=obj.name
        )
    points = np.empty((len(evaluated.data.vertices), 3), np.float32)
    evaluated.data.attributes["position"].data.foreach_get("vector", points.ravel())
    world = np.array(evaluated.matrix_world, np.float32)
    return points[:count] @ world[:3, :3].T + world[:3, 3]


def target_shape(obj: bpy.types.Object, key_name: str, groups: VertexGroups | None = None) -> np.ndarray:
    """The displacement by the shape key at value 1: (V, 3), local space. groups: those of `obj`, if they were read
    already.
    """
    block = obj.data.shape_keys.key_blocks[key_name]
    shape = key_points(block).astype(np.float64) - key_points(block.relative_key)
    if block.vertex_group in obj.vertex_groups:  # Blender ignores the name of a group that is gone
        shape *= (groups or VertexGroups(obj)).weights([block.vertex_group])
    return shape


def group_weights(obj: bpy.types.Object, names: Sequence[str], absent: float = 0.0) -> np.ndarray:
    """Weights (V, len(names)) of the vertex groups; `absent` for vertices and groups that are not there."""
    return VertexGroups(obj).weights(names, absent)


class VertexGroups:
    """The vertex groups of an object, read once, when they are first asked for: Blender hands them out vertex by
    vertex. names: of all of them.
    """

    def __init__(self, obj: bpy.types.Object) -> None:
        self._obj, self.names = obj, obj.vertex_groups.keys()

    @cached_property
    def _elements(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Vertex, group and weight of all elements. A mesh would hand them out in twice the time."""
        mesh = bmesh.new()
        try:
            mesh.from_mesh(self._obj.data, face_normals=False, vertex_normals=False)
            layer = mesh.verts.layers.deform.active
            of_vertices = [vertex[layer].items() for vertex in mesh.verts] if layer else []
        finally:
            mesh.free()
        flat = [part for elements in of_vertices for element in elements for part in element]
        groups, weights = np.array(flat, np.float64).reshape(-1, 2).T
        vertices = np.repeat(np.arange(len(of_vertices)), [len(elements) for elements in of_vertices])
        return vertices, groups.astype(np.int64), weights

    def weights(self, names: Sequence[str], absent: float = 0.0) -> np.ndarray:
        """As `group_weights`. Raises SceneError."""
        obj, columns = self._obj, {name: column for column, name in enumerate(dict.fromkeys(names))}
        weights = np.full((len(obj.data.vertices), len(columns)), absent)
        numbers = {
            obj.vertex_groups[name].index: column for name, column in columns.items() if name in obj.vertex_groups
        }
        if numbers:
            vertices, groups, values = self._elements
            column_of = np.full(1 + max(*numbers, groups.max(initial=0)), -1)
            column_of[list(numbers)] = list(numbers.values())
            asked = column_of[groups] >= 0
            weights[vertices[asked], column_of[groups[asked]]] = values[asked]
        bad = np.flatnonzero(~np.isfinite(weights).all(axis=0))
        if len(bad):
            raise SceneError(
                "'{name}': vertex group '{group}' has weights that are not numbers",
                name=obj.name,
                group=list(columns)[bad[0]],
            )
        return weights if len(columns) == len(names) else weights[:, [columns[name] for name in names]]


def modifier_weights(
    obj: bpy.types.Object, modifier: bpy.types.Modifier, skeleton: Skeleton, groups: VertexGroups
) -> np.ndarray:
    """Skin weights (V, B + 1) by one Armature modifier, like `Character.weights`. Raises SceneError."""
    bones = modifier.object.data.bones
    weights = groups.weights(skeleton.names)
    weights[:, [not bones[name].use_deform for name in skeleton.names]] = 0.0
    total = weights.sum(axis=1, keepdims=True)
    moved = total > NO_WEIGHT
    weights = np.where(moved, weights / np.where(moved, total, 1.0), 0.0)
    if modifier.vertex_group in obj.vertex_groups:  # the modifier's own mask blends with the unskinned position
        mask = groups.weights([modifier.vertex_group])
        weights *= 1.0 - mask if modifier.invert_vertex_group else mask
    return np.hstack([weights, 1.0 - weights.sum(axis=1, keepdims=True)])


def masked(obj: bpy.types.Object, groups: VertexGroups) -> np.ndarray:
    """Which vertices (V,) Mask modifiers hide in renders by a vertex group. Raises SceneError."""
    hidden = np.zeros(len(obj.data.vertices), bool)
    for mask in obj.modifiers:
        if mask.type == "MASK" and mask.show_render and mask.mode == "VERTEX_GROUP" and mask.vertex_group:
            kept = groups.weights([mask.vertex_group])[:, 0] > mask.threshold
            hidden |= kept if mask.invert_vertex_group else ~kept
    return hidden


def painted(obj: bpy.types.Object, groups: VertexGroups, of: PaintedMap, group: str) -> np.ndarray:
    """Weights (V,) of a map that is the vertex group `group` on `obj`. Raises SceneError."""
    if group and group not in obj.vertex_groups:
        raise SceneError(
            "'{name}': the vertex group '{group}' of {map} is gone: choose another",
            name=obj.name,
            group=group,
            map=Message(of.label),
        )
    return groups.weights([group], of.neutral)[:, 0].clip(0.0, 1.0)


def cages_of(attachments: Iterable[Any], mesh: bpy.types.Object, groups: VertexGroups, first: int = 1) -> np.ndarray:
    """The cage that each vertex is in, like `Character.cage_index`. Where groups overlap, the first one counts.

    attachments: those that are parts of the object `mesh`, whose `groups` these are; first: number of the first cage of
    its own. Raises SceneError.
    """
    gone = next((each for each in attachments if each.group not in mesh.vertex_groups), None)
    if gone:
        raise SceneError(
            "'{name}': the vertex group '{group}' of an attachment is gone: remove the attachment",
            name=mesh.name,
            group=gone.group,
        )
    cage_index, cages = np.zeros(len(mesh.data.vertices), np.int32), itertools.count(first)
    for attachment, members in members_of(attachments, groups):
        if attachment.attached_by != "WITH_BODY" and members.any():
            cage_index[members] = next(cages) if attachment.attached_by == "OWN_CAGE" else -1
    return cage_index


def members_of(attachments: Iterable[Any], groups: VertexGroups) -> Iterator[tuple[Any, np.ndarray]]:
    """Each attachment with its vertices (V,) bool of a mesh, without those of the attachments before it."""
    taken = None
    for attachment, weights in zip(attachments, groups.weights([each.group for each in attachments]).T, strict=True):
        members = weights >= MEMBER
        members = members if taken is None else members & ~taken
        yield attachment, members
        taken = members if taken is None else taken | members


def bone_segments(bones: Iterable[bpy.types.Bone], to_local: np.ndarray, to_bind: np.ndarray) -> np.ndarray:
    """Heads and tails (D, 2, 3) of bones at rest, bind space."""
    ends = np.array([(*bone.head_local, *bone.tail_local) for bone in bones]).reshape(-1, 2, 3)
    return carried(ends, to_local) @ to_bind.T + 0.0


def carried(points: np.ndarray, to_local: np.ndarray) -> np.ndarray:
    """Points (..., 3) of another object in local space.

    Rounded like the stretch, because the last digits of this transform (4, 4) change when both objects are moved.
    """
    size = np.cbrt(abs(determinant(to_local[:3, :3])))
    units = 10.0 ** np.round(np.log10(np.maximum([size, size * np.abs(points).max()], 1e-300)))
    turn, shift = _rounded(to_local[:3, :3], units[0]), _rounded(to_local[:3, 3], units[1])
    return points @ turn.T + shift


def mesh_triangles(mesh: bpy.types.Mesh) -> np.ndarray:
    """The faces (T, 3), triangulated as Blender draws them."""
    mesh.calc_loop_triangles()
    triangles = np.empty((len(mesh.loop_triangles), 3), np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles.ravel())
    return triangles


def mesh_topology(mesh: bpy.types.Mesh) -> int:
    """Tells the faces of a mesh from those of others, whatever its shape."""
    corners, starts = np.empty(len(mesh.loops), np.int32), np.empty(len(mesh.polygons), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    mesh.polygons.foreach_get("loop_start", starts)
    return crc32(starts.tobytes(), crc32(corners.tobytes()))


def stretch(world: np.ndarray) -> np.ndarray:
    """An object's scale without its rotation: the symmetric factor of the world transform's polar decomposition."""
    values, vectors = np.linalg.eigh(world[:3, :3].T @ world[:3, :3])
    stretch = (vectors * np.sqrt(values)) @ vectors.T
    # Rounded, because the object's rotation would otherwise change the last digits and outdate the model.
    return _rounded(stretch, 10.0 ** np.floor(np.log10(stretch.max())))


def _rounded(values: np.ndarray, unit: float) -> np.ndarray:
    """Rounded to five digits relative to the size of the values: Blender's transforms have about seven."""
    return np.round(values / unit, 5) * unit + 0.0  # no negative zeros
