# SPDX-License-Identifier: GPL-3.0-or-later
"""The objects that stop a soft skin, by Blender's own Collision: which they are, and where they are over a shot."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain

import bpy
import numpy as np

from ...core.errors import SceneError
from ...core.message import Message
from ...core.motion.colliders import ColliderTrack, with_before
from ..animation import moved_paths
from ..check import checks
from ..check.problem import Problem
from ..read.mesh_data import mesh_topology, mesh_triangles
from ..references import armature_modifiers, rig_of
from ..skin import shown_objects, soft_skins

ASSET = "Collider"  # the node group of Blender 5.2
FRICTION = 0.5  # Coulomb's coefficient where the object does not say
CLOTH_FRICTION = 0.1  # Coulomb's coefficient of each unit of Blender's friction of cloth


def is_collider(obj: bpy.types.Object) -> bool:
    """Whether a mesh object has Blender's Collision, on or off, or the Collider modifier of Blender 5.2."""
    return obj.type == "MESH" and any(
        modifier.show_viewport and (modifier.type == "COLLISION" or _is_asset(modifier)) for modifier in obj.modifiers
    )


def colliders(obj: bpy.types.Object) -> list:
    """The objects that may stop the soft skin `obj`, by name; none where its Collision is off."""
    settings = obj.dynamorph.collision
    if not settings.use:
        return []
    among = settings.collection.all_objects if settings.collection else None
    found = (
        other
        for other in shown_objects()
        if is_collider(other) and not other.hide_viewport and (among is None or other.name in among)
    )
    mine = of_body(obj)
    return sorted((other for other in found if not mine(other)), key=lambda other: other.name)


def pressed(obj: bpy.types.Object) -> list:
    """Those of them that are soft bodies which it stops in turn, and those that it lies on or that lie on it: baked
    together, or Live together, they press on each other, and both give way.
    """
    if not _moves(obj) or not obj.dynamorph.collision.use:
        return []
    stopped = [other for other in colliders(obj) if _moves(other) and obj in colliders(other)]
    worn = [other for other in (*_clothes(obj), *_wearers(obj)) if other.dynamorph.collision.use]
    return [*stopped, *(other for other in dict.fromkeys(worn) if other not in stopped)]


def met(obj: bpy.types.Object, together: Sequence[str]) -> list:
    """What stops `obj` in a bake: its colliders, and of what it presses on, these names, which are baked with it."""
    others = [other for other in pressed(obj) if other.name in together]
    return sorted({*colliders(obj), *others}, key=lambda other: other.name)


def garments(objects: Sequence[bpy.types.Object]) -> list[tuple]:
    """(clothes, body) of these soft skins: what is attached to one of them in a cage of its own lies on it. Where each
    is attached to the other, the smaller one does.
    """
    return [(other, obj) for obj in objects for other in _clothes(obj) if other in objects]


def passing_through(obj: bpy.types.Object) -> list:
    """The soft skins that lie on `obj` and are not stopped by it."""
    stopped = pressed(obj)
    return [other for other in _clothes(obj) if other not in stopped] if _moves(obj) else []


def _clothes(obj: bpy.types.Object) -> list:
    rig, shown = rig_of(obj), shown_objects()
    found = (other for other in _in_own_cages(obj) if other in shown and rig_of(other) == rig)
    return [
        other for other in found if _moves(other) and (obj not in _in_own_cages(other) or _order(other) < _order(obj))
    ]


def _in_own_cages(obj: bpy.types.Object) -> list:
    chosen = (each for each in obj.dynamorph.attachments if each.attached_by == "OWN_CAGE" and not each.group)
    return [each.object for each in chosen if each.object]


def _order(obj: bpy.types.Object) -> tuple[float, str]:
    """The size of the mesh as it was modeled, and its name where two have the same."""
    points = np.empty((len(obj.data.vertices), 3), np.float32)
    obj.data.vertices.foreach_get("co", points.ravel())
    sides = np.ptp(points, axis=0) * obj.matrix_world.to_scale() if len(points) else np.zeros(3)
    return float(np.linalg.norm(sides)), obj.name


def _wearers(obj: bpy.types.Object) -> list:
    return [other for other in soft_skins(shown_objects()) if _moves(other) and obj in _clothes(other)]


def pressing(objects: Iterable[bpy.types.Object]) -> list[list]:
    """Soft skins, with those in one list that press on each other."""
    out: list[list] = []
    for obj in objects:
        on = pressed(obj)
        mine = [group for group in out if any(other in on for other in group)]
        out = [group for group in out if group not in mine] + [[*chain.from_iterable(mine), obj]]
    return out


def _moves(obj: bpy.types.Object) -> bool:
    return bool(obj.dynamorph.targets) and obj.dynamorph.model.method != "STATIC"


def of_body(obj: bpy.types.Object) -> Callable[[bpy.types.Object], bool]:
    """Which objects are the body `obj` itself, or move with it: a function of an object."""
    attached = {obj, *(each.object for each in obj.dynamorph.attachments)}
    rigs = {modifier.object for modifier in armature_modifiers(obj)}

    def belongs(other: bpy.types.Object) -> bool:
        follows = any(checks.follows_by(modifier, obj) for modifier in other.modifiers)
        skinned = any(modifier.object in rigs for modifier in armature_modifiers(other))
        return other in attached or other.dynamorph.follows == obj or follows or skinned

    return belongs


def notes(obj: bpy.types.Object) -> Iterator[Problem]:
    """Colliders of `obj` that do not act as they render. Reads no mesh: fit for drawing."""
    if obj.dynamorph.collision.use:
        yield from _idle(obj)
        yield from _simulated_by_nodes(obj)


def _idle(obj: bpy.types.Object) -> Iterator[Problem]:
    """What would be a collider, and renders, but is off in viewports. As for Blender's own Cloth, it stops nothing."""
    settings, mine = obj.dynamorph.collision, of_body(obj)
    among = settings.collection.all_objects if settings.collection else shown_objects()
    for other in among:
        if not is_collider(other) or mine(other):
            continue
        if "hide_viewport" in moved_paths(other):
            yield Problem(
                "'{name}' collides, and whether it is disabled in viewports is keyed or driven, which a bake does not "
                "follow: key its Collision (Physics tab) instead",
                name=other.name,
            )
        elif other.hide_viewport and not other.hide_render:
            yield Problem(
                "'{name}' has Collision, but is disabled in viewports, so it stops nothing: enable it there (the "
                "screen in the Outliner)",
                name=other.name,
            )


def _simulated_by_nodes(obj: bpy.types.Object) -> Iterator[Problem]:
    """Those with a simulation zone. Blender does not say whether that is baked, and what it has not simulated yet is
    read as it was last.
    """
    for other in colliders(obj):
        for modifier in other.modifiers:
            if modifier.type == "NODES" and modifier.show_viewport and _has_simulation(modifier.node_group):
                yield Problem(
                    "'{name}' collides and is simulated by modifier '{modifier}': bake its Simulation Nodes (Physics "
                    "tab), or play all frames before you bake",
                    name=other.name,
                    modifier=modifier.name,
                )


def _has_simulation(group: bpy.types.NodeTree | None) -> bool:
    nodes = group.nodes if group else ()
    return any(node.type == "SIMULATION_OUTPUT" or _has_simulation(getattr(node, "node_tree", None)) for node in nodes)


def problems(obj: bpy.types.Object) -> Iterator[Problem]:
    """What prevents the colliders of `obj` from being read. Reads no mesh: fit for drawing."""
    for other in colliders(obj):
        body = other.rigid_body
        if body and body.type == "ACTIVE" and not body.kinematic:
            yield Problem(
                "'{name}' collides and is moved by Rigid Body: bake that to keyframes (Object > Rigid Body), or turn "
                "its Collision off",
                name=other.name,
            )
        for modifier in other.modifiers:
            if modifier.show_viewport and not all(cache.is_baked for cache in _caches(modifier)):
                yield Problem(
                    "'{name}' collides and is simulated by modifier '{modifier}': bake that first, or turn the "
                    "Collision of '{name}' off",
                    name=other.name,
                    modifier=modifier.name,
                )


def _caches(modifier: bpy.types.Modifier) -> list[bpy.types.PointCache]:
    """Of a modifier whose result depends on what was before."""
    if modifier.type in {"CLOTH", "SOFT_BODY"}:
        return [modifier.point_cache]
    if modifier.type == "DYNAMIC_PAINT" and modifier.canvas_settings:
        surfaces = modifier.canvas_settings.canvas_surfaces
        return [each.point_cache for each in surfaces if each.is_active and each.surface_type in {"DISPLACE", "WAVE"}]
    if modifier.type not in {"EXPLODE", "PARTICLE_INSTANCE"}:
        return []
    of_particles = modifier.object if modifier.type == "PARTICLE_INSTANCE" else modifier.id_data
    systems = of_particles.particle_systems if of_particles else ()
    return [each.point_cache for each in systems if each.settings.type == "EMITTER"]


def deforming_vertices(obj: bpy.types.Object) -> int:
    """How many vertices those colliders of `obj` have that may change their shape."""
    deforming = [
        other
        for other in colliders(obj)
        if other.data.shape_keys or any(modifier.type != "COLLISION" for modifier in other.modifiers)
    ]
    if not deforming:
        return 0
    depsgraph = bpy.context.evaluated_depsgraph_get()
    return sum(len(other.evaluated_get(depsgraph).data.vertices) for other in deforming)


class ColliderReader:
    """Reads one collider at the sample times of a rig. friction: instead of the object's own."""

    def __init__(self, obj: bpy.types.Object, count: int, friction: float | None):
        self.name = obj.name
        self._own_friction = friction is None
        self._friction = np.full(count, friction or 0.0)
        self._active = np.ones(count, bool)
        self._worlds = np.empty((count, 4, 4))
        self._shapes: list[np.ndarray] = []
        self._shape = np.zeros(count, int)
        self._one_sided = False

    def read(self, sample: int, evaluated: bpy.types.Object, frame: int) -> None:
        """evaluated: the object, in the dependency graph of the rig. Raises SceneError."""
        self._worlds[sample] = tuple(map(tuple, evaluated.matrix_world))
        settings = evaluated.collision
        if settings:
            self._active[sample] = settings.use
            self._one_sided = settings.use_culling
            if self._own_friction:
                self._friction[sample] = CLOTH_FRICTION * settings.cloth_friction
        elif self._own_friction:
            self._friction[sample] = _asset_friction(evaluated)
        mesh = evaluated.to_mesh()
        try:
            self._read_shape(sample, mesh, frame)
        finally:
            evaluated.to_mesh_clear()

    def _read_shape(self, sample: int, mesh: bpy.types.Mesh, frame: int) -> None:
        points = np.empty((len(mesh.vertices), 3), np.float32)
        mesh.attributes["position"].data.foreach_get("vector", points.ravel())
        counts = len(mesh.vertices), len(mesh.loops), len(mesh.polygons)
        if not self._shapes:
            self._counts, self._triangles, self._topology = counts, mesh_triangles(mesh), mesh_topology(mesh)
            if not len(self._triangles):
                raise SceneError(
                    "'{name}' collides but has no faces: model some, or turn its Collision off", name=self.name
                )
        elif counts != self._counts:
            raise SceneError(
                "'{name}' collides, but its faces change at frame {frame}: keep the number of vertices and faces "
                "constant, or turn its Collision off",
                name=self.name,
                frame=frame,
            )
        if not self._shapes or not np.array_equal(points, self._shapes[-1]):
            if not np.isfinite(points).all():
                raise SceneError(not_numbers(self.name, frame))
            self._shapes.append(points)
        self._shape[sample] = len(self._shapes) - 1

    def track(self, to_meters: Callable[[np.ndarray], np.ndarray], frame_of: Callable[[int], int]) -> ColliderTrack:
        """Everything that was read. to_meters: of world transforms; frame_of(sample). Raises SceneError."""
        known = np.concatenate([self._worlds.reshape(len(self._worlds), -1), self._friction[:, None]], axis=1)
        bad = np.flatnonzero(~np.isfinite(known).all(axis=1))
        if len(bad):
            raise SceneError(not_numbers(self.name, frame_of(bad[0])))
        return ColliderTrack(
            self.name,
            self._triangles,
            self._topology,
            self._one_sided,
            np.array(self._shapes),
            with_before(self._shape),
            with_before(to_meters(self._worlds)[:, :3]),
            self._friction,
            self._active,
        )


def readers(obj: bpy.types.Object, count: int) -> list[ColliderReader]:
    """Of the colliders of the soft skin `obj`, for so many samples. Raises SceneError."""
    for problem in problems(obj):
        raise SceneError(problem.text)
    settings = obj.dynamorph.collision
    friction = settings.friction if settings.use_friction else None
    return [ColliderReader(other, count, friction) for other in colliders(obj)]


def not_numbers(name: str, frame: int) -> str:
    return Message(
        "'{name}' collides, but has values that are not numbers at frame {frame}: check its curves, drivers and "
        "constraints",
        name=name,
        frame=frame,
    )


# The Collider modifier of Blender 5.2 --------------------------------------------------------------------------------


def _is_asset(modifier: bpy.types.Modifier) -> bool:
    group = modifier.node_group if modifier.type == "NODES" and hasattr(modifier, "properties") else None
    return group is not None and group.name.partition(".")[0] == ASSET


def _asset_friction(obj: bpy.types.Object) -> float:
    """The value of its socket Friction."""
    modifier = next(modifier for modifier in obj.modifiers if _is_asset(modifier))
    for item in modifier.node_group.interface.items_tree:
        if item.item_type == "SOCKET" and item.in_out == "INPUT" and item.name == "Friction":
            return getattr(modifier.properties.inputs, item.identifier).value
    return FRICTION
