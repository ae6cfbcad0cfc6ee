# SPDX-License-Identifier: GPL-3.0-or-later
"""Copies a soft skin to another mesh on the same armature, such as another resolution of the body, or tight clothes.

Both are compared at rest in the world: shape keys and vertex groups are taken from the nearest point of the source's
Basis. `bpy.ops.object.data_transfer` cannot do this: it carries no shape keys, and it measures from the source as
it is posed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ...core.character import SurfaceMap
from ...core.errors import SceneError
from ...core.geometry import determinant, diagonal, inverse
from ...core.painted_map import MAPS
from ...scene.check import checks
from ...scene.check.problem import refuse
from ...scene.read import mesh_data
from ...scene.read.mesh_data import VertexGroups
from ...scene.read.nearest import nearest
from ...scene.read.worlds import world_now
from ...scene.references import rig_of
from ...scene.skin import own_attachments
from ..bake import writer
from . import regions, setups, targets


@dataclass(frozen=True)
class Copy:
    """What one mesh of V vertices gets from another. shapes: displacements (V, 3) in its local space by the name of
    their shape key; weights (V,), and which vertices (V,) have some, by the name of their vertex group; distance: its
    largest distance from the source's surface, in meters.
    """

    shapes: dict[str, np.ndarray]
    weights: dict[str, tuple[np.ndarray, np.ndarray]]
    distance: float


def check(source: bpy.types.Object, others: Sequence[bpy.types.Object], replace: bool) -> None:
    """Raises SceneError unless the soft skin of `source` can be written to each of `others`."""
    rig = checks.armature_modifier(source).object
    names = [target.name for target in source.dynamorph.targets[1:]]
    keys = source.data.shape_keys
    gone = [name for name in names if keys is None or name not in keys.key_blocks]
    if gone:
        raise SceneError(
            "'{name}': the shape key of target '{target}' is gone: remove the target", name=source.name, target=gone[0]
        )
    for obj in (source, *others):
        checks.check_mesh(obj)
        if checks.armature_modifier(obj).object != rig:
            raise SceneError(
                "'{name}' is moved by another armature: choose '{rig}' in its Armature modifier",
                name=obj.name,
                rig=rig.name,
            )
    for obj in others:
        refuse(checks.shared_mesh(obj))
        if not (obj.is_editable and obj.data.is_editable):
            raise SceneError(
                "'{name}' is linked: make it and its mesh local (Object > Relations > Make Local)", name=obj.name
            )
        if obj.dynamorph.targets and not replace:
            raise SceneError(
                "'{name}' has a soft skin already: turn on Replace Soft Skins, or deselect it", name=obj.name
            )
        basis = obj.data.shape_keys and obj.data.shape_keys.reference_key.name
        if basis in names:
            raise SceneError(
                "'{name}': its Basis is called '{basis}' like a target: rename it", name=obj.name, basis=basis
            )


def copy(source: bpy.types.Object, obj: bpy.types.Object) -> Copy:
    """The shapes and groups of the soft skin `source` for the mesh of `obj`. Reads only; raises SceneError."""
    (from_basis, from_world), (to_basis, to_world) = _at_rest(source), _at_rest(obj)
    triangles = mesh_data.mesh_triangles(source.data)
    found = nearest(_moved(to_basis, to_world), _moved(from_basis, from_world), triangles)
    to_local = (inverse(to_world) @ from_world)[:3, :3]
    groups = mesh_data.VertexGroups(source)
    absent = dict.fromkeys(_own_groups(source), 0.0)
    absent |= {name: each.neutral for each in MAPS if (name := getattr(source.dynamorph, each.group)) in absent}
    return Copy(
        {
            target.name: found.carry(mesh_data.target_shape(source, target.name, groups)) @ to_local.T
            for target in source.dynamorph.targets[1:]
        },
        {name: _carried(found, groups, name, value) for name, value in absent.items()},
        float(found.distances.max()),
    )


def write(obj: bpy.types.Object, made: Copy, overwrite: bool) -> None:
    """Create the shape keys and vertex groups; existing ones with the same name stay as they are unless `overwrite`."""
    writer.ensure_basis(obj)
    for name, shape in made.shapes.items():
        block = obj.data.shape_keys.key_blocks.get(name)
        if block is None:
            targets.new_key(obj, name, shape)
        elif overwrite:
            targets.sculpt_anew(block, shape)
    for name, (weights, members) in made.weights.items():
        if overwrite or name not in obj.vertex_groups:
            group = obj.vertex_groups.get(name) or obj.vertex_groups.new(name=name)
            regions.write_group(group, weights, members)
    obj.data.update_tag()


def _carried(found: SurfaceMap, groups: VertexGroups, name: str, absent: float) -> tuple[np.ndarray, np.ndarray]:
    """The weights (V,) of a group at the other mesh, and its members there; absent: what counts where it has none."""
    weights, members = groups.weights([name], absent)[:, 0], groups.weights([name], -1.0)[:, 0] >= 0.0
    return found.carry(weights), found.carry(members.astype(float)) > 0.0


def size(obj: bpy.types.Object) -> float:
    """Diagonal at rest, in meters. Raises SceneError."""
    return diagonal(_moved(*_at_rest(obj)))


def _at_rest(obj: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Points (V, 3) of the Basis, local space, and the transform (4, 4) to the world now, meters. Raises SceneError."""
    world = world_now(obj)
    if determinant(world[:3, :3]) == 0:
        raise SceneError("'{name}' is scaled to zero: give it a size", name=obj.name)
    return mesh_data.rest_points(obj), world


def _moved(points: np.ndarray, world: np.ndarray) -> np.ndarray:
    return points @ world[:3, :3].T + world[:3, 3]


def _own_groups(source: bpy.types.Object) -> list[str]:
    """Names of the vertex groups that the soft skin uses, without those that tie the mesh to bones."""
    settings = source.dynamorph
    names = [getattr(settings, field) for field in setups.GROUPS] + [target.region for target in settings.targets]
    names += [each.group for each in own_attachments(source)]
    skinned = {bone.name for bone in rig_of(source).data.bones if bone.use_deform}
    return [name for name in dict.fromkeys(names) if name in source.vertex_groups and name not in skinned]
