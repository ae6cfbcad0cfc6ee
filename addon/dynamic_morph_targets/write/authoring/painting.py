# SPDX-License-Identifier: GPL-3.0-or-later
"""The maps of a soft skin: painting them, their mirror images, and the bones that hold their skin."""

from __future__ import annotations

import bpy
import numpy as np

from ...core.errors import SceneError
from ...core.painted_map import FIRMNESS, PaintedMap
from ...scene import references, skin
from ...scene.check import checks
from ...scene.read import mesh_data
from ...scene.read.source import Source
from .. import storage
from ..assign import free_name
from ..bake import writer
from . import controls
from .fixes import owned
from .mirror import mirror_partners

STEPS = 1000  # weights that a vertex group distinguishes
BORDER = 4  # edges, over which held skin becomes soft


def is_painting(obj: bpy.types.Object, of: PaintedMap) -> bool:
    """Whether this map of `obj` is being painted."""
    active = obj.vertex_groups.active
    return obj.mode == "WEIGHT_PAINT" and active is not None and active.name == getattr(obj.dynamorph, of.group)


def enter(obj: bpy.types.Object, of: PaintedMap) -> None:
    """Begin to paint a map, with a new vertex group if there is none. Raises SceneError."""
    if not obj.visible_get():
        raise SceneError("'{name}' is hidden: show it to paint on it", name=obj.name)
    if refusal := skin.edited_elsewhere(obj):
        raise SceneError(refusal)
    owned(obj.data)
    active, display = bpy.context.object, bpy.context.window_manager.dynamorph
    if obj.mode != "WEIGHT_PAINT":
        display.posed = active.name if active.mode == "POSE" else ""
        bpy.context.view_layer.objects.active = obj
        obj.select_set(True)
        bpy.ops.object.mode_set(mode="WEIGHT_PAINT", toggle=True)  # remembers the mesh's own mode
    name = map_name(obj, of)
    if name not in obj.vertex_groups:
        write(obj, name, np.full(len(obj.data.vertices), of.neutral))
    choose(obj, of, name)


def leave(obj: bpy.types.Object) -> None:
    """Return to what was going on before, and look whether the model and the bake still fit the maps."""
    display, objects = bpy.context.window_manager.dynamorph, bpy.context.view_layer.objects
    active, objects.active = objects.active, obj  # without Lock Object Modes, the armature may have become active
    bpy.ops.object.mode_set(mode="WEIGHT_PAINT", toggle=True)
    posed, display.posed = objects.get(display.posed), ""
    objects.active = posed or active
    if posed:
        bpy.ops.object.mode_set(mode="POSE")
    look(obj)


def hold_selected_bones(obj: bpy.types.Object) -> None:
    """Paint Firmness with 1 where the selected pose bones move the skin, with a soft border. Raises SceneError."""
    writer.check_not_edited(obj)
    owned(obj.data)
    held = _held_by_bones(obj)
    name = map_name(obj, FIRMNESS)
    weights = mesh_data.group_weights(obj, [name], FIRMNESS.neutral)[:, 0]
    write(obj, name, np.maximum(weights, FIRMNESS.neutral + (1.0 - FIRMNESS.neutral) * held))
    choose(obj, FIRMNESS, name)
    look(obj)


def mirror(obj: bpy.types.Object, of: PaintedMap, to: str) -> int:
    """Copy a map to the character's LEFT or RIGHT, about the mesh's X axis; how many vertices have no mirror image
    and stay as they are. Raises SceneError.
    """
    points = mesh_data.rest_points(obj)
    partners = mirror_partners(points)
    overwritten = (points[:, 0] < 0.0 if to == "RIGHT" else points[:, 0] > 0.0) & (partners >= 0)
    if not overwritten.any():
        raise SceneError("'{name}' is not symmetric about its X axis: paint the other side yourself", name=obj.name)
    name = getattr(obj.dynamorph, of.group)
    weights = mesh_data.group_weights(obj, [name], of.neutral)[:, 0]
    write(obj, name, np.where(overwritten, weights[partners], weights))
    return int(np.count_nonzero(partners < 0))


def map_name(obj: bpy.types.Object, of: PaintedMap) -> str:
    """The vertex group of a map. A new one is named like no bone and no group of the meshes in the cage, because what
    is written there would be skin weights, or the artist's.
    """
    if chosen := getattr(obj.dynamorph, of.group):
        return chosen
    rig = references.rig_of(obj)
    taken = {group.name for mesh in (obj, *skin.attached_meshes(obj)) for group in mesh.vertex_groups}
    taken |= {bone.name for bone in rig.data.bones} if rig else set()
    return free_name(taken, of.label) if of.label in taken else of.label


def choose(obj: bpy.types.Object, of: PaintedMap, name: str) -> None:
    """Make this vertex group the map, and the active one."""
    if getattr(obj.dynamorph, of.group) != name:
        setattr(obj.dynamorph, of.group, name)
    obj.vertex_groups.active_index = obj.vertex_groups[name].index


def write(obj: bpy.types.Object, name: str, weights: np.ndarray) -> None:
    """Write weights (V,), rounded to a thousandth, to the vertex group of this name; it is created if there is none.
    Raises SceneError.
    """
    group = obj.vertex_groups.get(name) or obj.vertex_groups.new(name=name)
    if group.lock_weight:
        raise SceneError("'{name}': vertex group '{group}' is locked: unlock it first", name=obj.name, group=name)
    steps = np.round(weights * STEPS).astype(int)
    for step in np.unique(steps):
        group.add(np.flatnonzero(steps == step).tolist(), step / STEPS, "REPLACE")


def look(obj: bpy.types.Object) -> None:
    if obj.dynamorph.model.content_id:
        storage.show_stale(obj)


def _held_by_bones(obj: bpy.types.Object) -> np.ndarray:
    """How firmly the selected pose bones hold each vertex (V,): 1 where half of its skin weight is theirs, from there
    less and less over BORDER edges. Raises SceneError.
    """
    source = Source.of(checks.skinned(obj))
    rig, bones = source.rig, source.skeleton.names
    chosen = controls.moved_by_selected(obj)
    if not chosen:
        raise SceneError(
            "Select in Pose Mode the bones of '{rig}' that hold the skin of '{name}'", rig=rig.name, name=obj.name
        )
    theirs = source.weights[:, [bones.index(bone) for bone in chosen]].sum(axis=1)
    if not theirs.any():
        raise SceneError(
            "The selected bones of '{rig}' move no skin of '{name}': select others", rig=rig.name, name=obj.name
        )
    edges = np.empty((len(obj.data.edges), 2), np.int32)
    obj.data.edges.foreach_get("vertices", edges.ravel())
    ends, others = np.concatenate([edges, edges[:, ::-1]]).T
    neighbors = np.maximum(np.bincount(ends, minlength=len(theirs)), 1)
    held = np.clip(2.0 * theirs, 0.0, 1.0)
    for _ in range(BORDER):
        held = np.maximum(held, np.bincount(ends, held[others], len(theirs)) / neighbors)
    return held
