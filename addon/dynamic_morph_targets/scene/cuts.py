# SPDX-License-Identifier: GPL-3.0-or-later
"""Which meshes cut into a body as it stands now, although they do not stop its skin. Reads only.

As in `body_checks`, `known` returns what `look` found last, and asks for another look when something has moved since.
"""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np
from mathutils.bvhtree import BVHTree

from ..core.message import listed
from . import events
from .check.problem import Problem
from .motion.colliders import colliders, of_body
from .read.mesh_data import mesh_triangles
from .references import rig_of
from .remembered import opened
from .skin import shown_objects
from .skinning import meshes_on

LOOKED_AT = 20_000  # triangles of a mesh near the other one, at most; of more, evenly many, which a cut still crosses
SOLID = {"SOLID", "TEXTURED"}  # display of objects that are not helpers


def known(obj: bpy.types.Object) -> Iterator[Problem]:
    """What the last look at the soft skin `obj` found. Reads no mesh: fit for drawing."""
    when, found = opened.cuts.get(obj.session_uid, ((), []))
    if when != _now() and obj.mode == "OBJECT" and not events.is_playing():
        events.emit(events.Event.LOOK_ASKED, look, obj)
    stopping = {other.name for other in colliders(obj)} if found else set()
    left = [name for name in found if name in bpy.data.objects and name not in stopping]
    if left:
        yield Problem(
            "'{name}' cuts '{body}': let it collide" if len(left) == 1 else "{names} cut '{body}': let them collide",
            "COLLIDE",
            name=left[0],
            names=listed(left),
            body=obj.name,
        )


def look(obj: bpy.types.Object) -> None:
    """Find out what cuts the soft skin `obj` now, for `known`."""
    opened.cuts[obj.session_uid] = _now(), [other.name for other in cutting(obj)] if obj.dynamorph.targets else []


def cutting(obj: bpy.types.Object) -> list:
    """The objects whose surfaces go through that of the soft skin `obj` as Blender shows both, and do not stop it."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    box = _box(obj.evaluated_get(depsgraph))
    boxes = ((other, _shared(box, _box(other.evaluated_get(depsgraph)))) for other in _others(obj))
    near = [(other, shared) for other, shared in boxes if (shared[0] <= shared[1]).all()]
    if not near:
        return []
    body = _Surface(obj.evaluated_get(depsgraph))
    return [other for other, shared in near if body.meets(_Surface(other.evaluated_get(depsgraph)), shared)]


def outdate() -> None:
    """Something was moved or edited: another look is needed."""
    opened.edits += 1


def _now() -> tuple:
    return opened.edits, bpy.context.scene.frame_current


def _others(obj: bpy.types.Object) -> list:
    """The meshes that the artist sees beside the soft skin `obj`, without its colliders and what belongs to it."""
    mine, rig = of_body(obj), rig_of(obj)
    used = {getattr(modifier, name, None) for modifier in obj.modifiers for name in ("target", "object")}
    used |= {obj.dynamorph.model.cage_object, *colliders(obj), *(meshes_on(rig) if rig else ())}
    return [
        other
        for other in shown_objects()
        if other.type == "MESH"
        and other.display_type in SOLID
        and other.visible_get()
        and not (other in used or other.parent == obj or mine(other))
    ]


Box = np.ndarray  # (2, 3): its lower and its upper corner, world space


def _box(evaluated: bpy.types.Object) -> Box:
    world = np.array(evaluated.matrix_world)
    corners = np.array(evaluated.bound_box) @ world[:3, :3].T + world[:3, 3]
    return np.array([corners.min(axis=0), corners.max(axis=0)])


def _shared(first: Box, second: Box) -> Box:
    """Where both are; its lower corner is not below the upper one where they are apart."""
    return np.array([np.maximum(first[0], second[0]), np.minimum(first[1], second[1])])


class _Surface:
    """The triangles of an evaluated object, world space."""

    def __init__(self, evaluated: bpy.types.Object):
        mesh = evaluated.to_mesh()
        try:
            points = np.empty((len(mesh.vertices), 3), np.float32)
            mesh.attributes["position"].data.foreach_get("vector", points.ravel())
            triangles = mesh_triangles(mesh)
        finally:
            evaluated.to_mesh_clear()
        world = np.array(evaluated.matrix_world)
        self._corners = (points @ world[:3, :3].T + world[:3, 3]).astype(np.float32)[triangles]
        first, second, third = self._corners.transpose(1, 2, 0).copy()  # (3, T), which is quickly compared
        self._low = np.minimum(np.minimum(first, second), third)
        self._high = np.maximum(np.maximum(first, second), third)

    def meets(self, other: _Surface, box: Box) -> bool:
        """Whether they intersect within a box."""
        mine, others = self._tree(box), other._tree(box)
        return mine is not None and others is not None and bool(mine.overlap(others))

    def _tree(self, box: Box) -> BVHTree | None:
        """Of the triangles that may reach into a box; None without any."""
        low, high = box[:, :, None]
        corners = self._corners[(self._low <= high).all(axis=0) & (self._high >= low).all(axis=0)]
        corners = corners[:: -(-len(corners) // LOOKED_AT) or 1]
        if not len(corners):
            return None
        numbers = np.arange(3 * len(corners)).reshape(-1, 3)
        return BVHTree.FromPolygons(corners.reshape(-1, 3).tolist(), numbers.tolist(), all_triangles=True)
