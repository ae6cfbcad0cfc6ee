# SPDX-License-Identifier: GPL-3.0-or-later
"""Applies modifiers to a mesh that has shape keys, which Blender refuses."""

from __future__ import annotations

import bmesh
import bpy
import numpy as np

from ...core.errors import SceneError
from ...scene.animation import moved_paths
from ...scene.check import modifier_order
from ...scene.read.mesh_data import mesh_topology

MERGING = {"ARRAY", "MIRROR", "SCREW", "WELD"}  # which vertices become one depends on where they are


def apply_before_armature(obj: bpy.types.Object) -> None:
    """Put into the mesh of `obj` what its modifiers do before the last Armature that must not be there, and remove
    them. Shape keys keep their names, values, drivers and animation, and each has the shape that it had below the
    modifiers. Raises SceneError, before anything is changed.
    """
    applied = modifier_order.to_apply(obj)
    _check(obj, applied)
    mesh, names = obj.data, [modifier.name for modifier in applied]
    alone = _with_these(obj, names)
    try:
        shapes = [_shape(alone, number) for number in range(len(mesh.shape_keys.key_blocks) if mesh.shape_keys else 0)]
        _check_alike(obj, applied[-1], shapes)
        result = bpy.data.meshes.new_from_object(
            _evaluated(alone, 0), preserve_all_data_layers=True, depsgraph=bpy.context.evaluated_depsgraph_get()
        )
    finally:
        bpy.data.batch_remove((alone, alone.data))
    _replace_geometry(obj, result)
    for block, (points, _) in zip(mesh.shape_keys.key_blocks if mesh.shape_keys else (), shapes, strict=True):
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
    paths = moved_paths(obj)
    moving = next((each for each in applied if any(path.startswith(each.path_from_id()) for path in paths)), None)
    if moving:
        raise SceneError(
            "'{name}': modifier '{modifier}' is animated, so it cannot be applied: delete its keyframes and drivers "
            "first",
            name=obj.name,
            modifier=moving.name,
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


def _with_these(obj: bpy.types.Object, names: list[str]) -> bpy.types.Object:
    """A copy of `obj`, with a mesh of its own, that shows what these modifiers alone make of each whole key."""
    alone = obj.copy()
    alone.data = obj.data.copy()
    alone.hide_viewport = False
    for modifier in [*alone.modifiers]:
        if modifier.name in names:
            modifier.show_viewport = True  # what only renders show is in the mesh too
        else:
            alone.modifiers.remove(modifier)
    if keys := alone.data.shape_keys:
        keys.animation_data_clear()
        for block in keys.key_blocks:  # a muted one would show as the Basis, and one with a group would get it twice
            block.mute, block.vertex_group = False, ""
    bpy.context.scene.collection.objects.link(alone)
    return alone


def _evaluated(obj: bpy.types.Object, key: int) -> bpy.types.Object:
    """Of the shape of one key."""
    obj.active_shape_key_index, obj.show_only_shape_key = key, True
    bpy.context.view_layer.update()
    return obj.evaluated_get(bpy.context.evaluated_depsgraph_get())


def _shape(obj: bpy.types.Object, key: int) -> tuple[np.ndarray, int]:
    """Points (V, 3), local space, of the evaluated shape of a key, and its topology."""
    mesh = _evaluated(obj, key).data
    points = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", points.ravel())
    return points, mesh_topology(mesh)


def _check_alike(obj: bpy.types.Object, modifier: bpy.types.Modifier, shapes: list[tuple[np.ndarray, int]]) -> None:
    """All shape keys must have the same vertices and faces, which they do not where, for example, a Weld merges only
    some.
    """
    for block, (points, topology) in zip(obj.data.shape_keys.key_blocks if shapes else (), shapes, strict=True):
        if (len(points), topology) == (len(shapes[0][0]), shapes[0][1]):
            continue
        text = (
            "'{name}': modifier '{modifier}' gives shape key '{key}' other vertices or faces than the Basis, so it "
            "cannot be applied: move it below the Armature, or change the key"
        )
        if modifier.type in MERGING:
            text = (
                "'{name}': modifier '{modifier}' merges other vertices of shape key '{key}' than of the Basis, so it "
                "cannot be applied: turn its merging off, or change the key"
            )
        raise SceneError(text, name=obj.name, modifier=modifier.name, key=block.name)


def _replace_geometry(obj: bpy.types.Object, result: bpy.types.Mesh) -> None:
    """Let the mesh of `obj` have the geometry of `result`, which goes. Its keys stay, without shapes of their own."""
    groups, active = [(group.name, group.lock_weight) for group in obj.vertex_groups], obj.vertex_groups.active_index
    colors = {name: getattr(obj.data.attributes, name) for name in ("active_color_name", "default_color_name")}
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
    for name, color in colors.items():
        if color in obj.data.attributes:
            setattr(obj.data.attributes, name, color)
