# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that stop a soft skin: Blender's Collision on those that are there, and a floor."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from ...core.errors import SceneError
from ...scene.motion import colliders

FLOOR = 10.0  # sides of a floor over the longest side of the body


def add_collision(obj: bpy.types.Object, others: Sequence[bpy.types.Object]) -> list[str]:
    """Let the mesh objects `others` stop the soft skin `obj`, and soft skins among them be stopped by it too, so that
    they press on each other: also clothes in cages of their own and what wears them. Returns their names. Raises
    SceneError, and then nothing is changed.
    """
    belongs = colliders.of_body(obj)
    worn = {each for pair in colliders.garments([obj, *others]) if obj in pair for each in pair}
    for other in others:
        if belongs(other) and other not in worn:
            text = "'{name}' belongs to '{body}', so the two cannot collide: select other objects"
            raise SceneError(text, name=other.name, body=obj.name)
        if not other.is_editable:
            raise SceneError("'{name}' is linked, so the change would be lost: make it local", name=other.name)
    for other in others:
        if other in worn:
            obj.dynamorph.collision.use = other.dynamorph.collision.use = True
            continue
        _let_stop(other, obj)
        if other.dynamorph.targets:
            _let_stop(obj, other)
    bpy.context.view_layer.update()
    return [other.name for other in others]


def _let_stop(other: bpy.types.Object, obj: bpy.types.Object) -> None:
    """Let the mesh object `other` stop the soft skin `obj`."""
    settings = obj.dynamorph.collision
    if not colliders.is_collider(other):
        hidden = next((modifier for modifier in other.modifiers if modifier.type == "COLLISION"), None)
        modifier = hidden or other.modifiers.new("Collision", "COLLISION")
        modifier.show_viewport = True
    if other.collision:
        other.collision.use = True
    if settings.collection and other.name not in settings.collection.all_objects:
        settings.collection.objects.link(other)
    settings.use = True


def add_floor(obj: bpy.types.Object) -> bpy.types.Object:
    """A new plane with Collision that touches the lowest point of the soft skin `obj` as it is shown now. Raises
    SceneError.
    """
    points = _shown_points(obj)
    if not np.isfinite(points).all():
        raise SceneError("'{name}' has points that are not numbers: undo the edit that moved them", name=obj.name)
    low, high = points.min(axis=0), points.max(axis=0)
    half = 0.5 * FLOOR * float((high - low).max())
    mesh = bpy.data.meshes.new("Floor")
    corners = [(-half, -half, 0.0), (half, -half, 0.0), (half, half, 0.0), (-half, half, 0.0)]
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    floor = bpy.data.objects.new("Floor", mesh)
    floor.location = (*(0.5 * (low + high)[:2]), low[2])
    bpy.context.scene.collection.objects.link(floor)
    add_collision(obj, [floor])
    return floor


def _shown_points(obj: bpy.types.Object) -> np.ndarray:
    """The points (V, 3) of the mesh as Blender shows it, world space, Blender units."""
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    world = np.array(evaluated.matrix_world)
    mesh = evaluated.to_mesh()
    points = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", points.ravel())
    evaluated.to_mesh_clear()
    return points @ world[:3, :3].T + world[:3, 3]
