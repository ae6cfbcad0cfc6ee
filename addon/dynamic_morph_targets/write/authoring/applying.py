# SPDX-License-Identifier: GPL-3.0-or-later
"""Applies modifiers to a mesh that has shape keys, which Blender refuses."""

from __future__ import annotations

import bmesh
import bpy
import numpy as np

from ...core.errors import SceneError
from ...scene.check import modifier_order


def apply_before_armature(obj: bpy.types.Object) -> None:
    """Put into the mesh of `obj` what its modifiers do before the last Armature that must not be there, and remove
    them. Shape keys keep their names, values, drivers and animation, and each has the shape that it had below the
    modifiers. Raises SceneError, before anything is changed.
    """
    applied = modifier_order.to_apply(obj)
    _check(obj, applied)
    mesh, names = obj.data, [modifier.name for modifier in applied]
    alone = obj.copy()  # of the same mesh, but with these modifiers alone
    for modifier in [*alone.modifiers]:
        if modifier.name in names:
            modifier.show_viewport = True  # what only renders show is in the mesh too
        else:
            alone.modifiers.remove(modifier)
    bpy.context.scene.collection.objects.link(alone)
    try:
        shapes = [_points(alone, number) for number in range(len(mesh.shape_keys.key_blocks) if mesh.shape_keys else 0)]
        _check_alike(obj, names[-1], shapes)
        result = bpy.data.meshes.new_from_object(
            _evaluated(alone, 0), preserve_all_data_layers=True, depsgraph=bpy.context.evaluated_depsgraph_get()
        )
    finally:
        bpy.data.objects.remove(alone)
    _replace_geometry(obj, result)
    for block, points in zip(mesh.shape_keys.key_blocks if mesh.shape_keys else (), shapes, strict=True):
        block.points.foreach_set("co", points.ravel())
    for name in names:
        obj.modifiers.remove(obj.modifiers[name])
    mesh.update()


def _check(obj: bpy.types.Object, applied: list) -> None:
    if obj.library or obj.override_library or not obj.data.is_editable:
        raise SceneError("'{name}' is linked, so its modifiers cannot be applied: make it local", name=obj.name)
    if obj.data.users - obj.data.use_fake_user > 1:
        raise SceneError(
            "Mesh '{mesh}' is shared by other objects, so the modifiers of '{name}' cannot be applied: make it "
            "single-user first",
            mesh=obj.data.name,
            name=obj.name,
        )
    between = next((modifier for modifier in applied if modifier.type == "ARMATURE"), None)
    if between:
        raise SceneError(
            "'{name}': modifier '{modifier}' comes after Armature modifier '{armature}', so it cannot be applied to "
            "the mesh: move it above",
            name=obj.name,
            modifier=applied[-1].name,
            armature=between.name,
        )


def _evaluated(obj: bpy.types.Object, key: int) -> bpy.types.Object:
    """Of the shape of one key."""
    obj.active_shape_key_index, obj.show_only_shape_key = key, True
    bpy.context.view_layer.update()
    return obj.evaluated_get(bpy.context.evaluated_depsgraph_get())


def _points(obj: bpy.types.Object, key: int) -> np.ndarray:
    """(V, 3), local space, of the evaluated shape of a key."""
    mesh = _evaluated(obj, key).data
    points = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", points.ravel())
    return points


def _check_alike(obj: bpy.types.Object, modifier: str, shapes: list[np.ndarray]) -> None:
    """All shape keys must have the same vertices, which they do not where, for example, a Weld merges only some."""
    for block, points in zip(obj.data.shape_keys.key_blocks if shapes else (), shapes, strict=True):
        if len(points) != len(shapes[0]):
            raise SceneError(
                "'{name}': modifier '{modifier}' gives shape key '{key}' {count} vertices and the Basis {expected}, so "
                "it cannot be applied: turn its merging off, or change the key",
                name=obj.name,
                modifier=modifier,
                key=block.name,
                count=len(points),
                expected=len(shapes[0]),
            )


def _replace_geometry(obj: bpy.types.Object, result: bpy.types.Mesh) -> None:
    """Let the mesh of `obj` have the geometry of `result`, which goes. Its keys stay, without shapes of their own."""
    groups, active = [(group.name, group.lock_weight) for group in obj.vertex_groups], obj.vertex_groups.active_index
    geometry = bmesh.new()
    try:
        geometry.from_mesh(result)
        obj.data.clear_geometry()  # and the names of the groups
        geometry.to_mesh(obj.data)
    finally:
        geometry.free()
        bpy.data.meshes.remove(result)
    for name, locked in groups:
        obj.vertex_groups.new(name=name).lock_weight = locked
    obj.vertex_groups.active_index = active
