# SPDX-License-Identifier: GPL-3.0-or-later
"""Which meshes cut into a body as it stands now, although they do not stop its skin. Reads only.

As in `body_checks`, `known` returns what `look` found last, and asks for another look when something has moved since.
"""

from __future__ import annotations

import itertools
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
MOST_INSTANCES = 20_000  # that are looked at
SOLID = {"SOLID", "TEXTURED"}  # display of objects that are not helpers


def known(obj: bpy.types.Object) -> Iterator[Problem]:
    """What the last look at the soft skin `obj` found. Reads no mesh: fit for drawing."""
    when, found, instances = opened.cuts.get(obj.session_uid, ((), [], []))
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
    for name, instancer in instances:
        if instancer in bpy.data.objects:
            yield Problem(
                "'{name}' cuts '{body}', but is an instance by '{instancer}', and instances stop nothing: make them "
                "real (Object > Apply > Make Instances Real)",
                name=name,
                body=obj.name,
                instancer=instancer,
            )


def look(obj: bpy.types.Object) -> None:
    """Find out what cuts the soft skin `obj` now, for `known`."""
    soft = bool(obj.dynamorph.targets)
    names = [other.name for other in cutting(obj)] if soft else []
    opened.cuts[obj.session_uid] = _now(), names, cutting_instances(obj) if soft else []


def cutting(obj: bpy.types.Object) -> list:
    """The objects whose surfaces go through that of the soft skin `obj` as Blender shows both, and do not stop it."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    box = _box(obj.evaluated_get(depsgraph))
    boxes = ((other, _shared(box, _box(other.evaluated_get(depsgraph)))) for other in _others(obj))
    near = [(other, shared) for other, shared in boxes if (shared[0] <= shared[1]).all()]
    if not near:
        return []
    body = _surface(obj.evaluated_get(depsgraph))
    return [other for other, shared in near if body.meets(_surface(other.evaluated_get(depsgraph)), shared)]


def cutting_instances(obj: bpy.types.Object) -> list[tuple[str, str]]:
    """The names of instanced meshes that do the same, by collections, particles or Geometry Nodes, each once with the
    name of what instances it.
    """
    depsgraph = bpy.context.evaluated_depsgraph_get()
    evaluated, mine = obj.evaluated_get(depsgraph), of_body(obj)
    box, body = _box(evaluated), None
    found: dict[tuple[str, str], None] = {}
    for each in itertools.islice(depsgraph.object_instances, MOST_INSTANCES):  # valid until the next one
        if not each.is_instance or each.object.type != "MESH" or not each.parent or mine(each.parent.original):
            continue
        world, names = np.array(each.matrix_world), (each.object.name, each.parent.name)
        shared = _shared(box, _box(each.object, world))
        if names in found or not (shared[0] <= shared[1]).all():
            continue
        body = body or _surface(evaluated)
        if body.meets(_Surface(each.object.data, world), shared):
            found[names] = None
    return list(found)


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


def _box(evaluated: bpy.types.Object, world: np.ndarray | None = None) -> Box:
    """world (4, 4): of an instance, instead of the object's own."""
    world = np.array(evaluated.matrix_world) if world is None else world
    corners = np.array(evaluated.bound_box) @ world[:3, :3].T + world[:3, 3]
    return np.array([corners.min(axis=0), corners.max(axis=0)])


def _shared(first: Box, second: Box) -> Box:
    """Where both are; its lower corner is not below the upper one where they are apart."""
    return np.array([np.maximum(first[0], second[0]), np.minimum(first[1], second[1])])


def _surface(evaluated: bpy.types.Object) -> _Surface:
    try:
        return _Surface(evaluated.to_mesh(), np.array(evaluated.matrix_world))
    finally:
        evaluated.to_mesh_clear()


class _Surface:
    """The triangles of an evaluated mesh, world space. world (4, 4): its transform."""

    def __init__(self, mesh: bpy.types.Mesh, world: np.ndarray):
        points = np.empty((len(mesh.vertices), 3), np.float32)
        mesh.attributes["position"].data.foreach_get("vector", points.ravel())
        triangles = mesh_triangles(mesh)
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
