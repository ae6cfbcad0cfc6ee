# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the skin that shows touches its colliders, for the viewport: in Live, in a bake, and with the bones alone."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from ...core.geometry import diagonal
from ...core.motion import contact
from ...scene.motion import colliders
from ...scene.read import identity, mesh_data
from .. import remembered

NEAR = 5e-4  # of the size, beyond Distance: what is nearer is touched
INSIDE = 2e-3  # of the size: what is deeper in a collider shows


# By Object.session_uid: a collider's last shape (V, 3), what tells its faces, and the engine's.
def touching(
    obj: bpy.types.Object, points: np.ndarray, depsgraph: bpy.types.Depsgraph
) -> tuple[np.ndarray, np.ndarray]:
    """The vertices of the soft skin `obj` that something pushes, and those that are inside something all the same.

    points (V, 3): where they show, world space. Raises SceneError for a collider that cannot be read.
    """
    world = np.array(obj.matrix_world)
    size = diagonal(identity.body_points(obj) @ mesh_data.stretch(world))
    touched = (obj.dynamorph.collision.distance + NEAR) * size
    distances = np.full(len(points), np.inf)
    for other in colliders.colliders(obj):
        _lower(distances, points, other.evaluated_get(depsgraph), touched)
    found = np.flatnonzero(distances < touched)
    group = obj.vertex_groups.get(obj.dynamorph.excluded_group)
    excluded = np.array(
        [group is not None and _weight(obj, group.index, int(v)) >= contact.EXCLUDED for v in found], bool
    )
    found = found[~excluded]
    inside = distances[found] < -INSIDE * size
    return found[~inside], found[inside]


def _lower(distances: np.ndarray, points: np.ndarray, evaluated: bpy.types.Object, reach: float) -> None:
    """Lower the distances (V,) of points to those from one collider, negative inside, where these are below `reach`."""
    reader = colliders.ColliderReader(evaluated.original, 1, 0.0)
    frame = bpy.context.scene.frame_current
    reader.read(0, evaluated, frame)
    track = reader.track(lambda worlds: worlds, lambda _sample: frame)
    world = track.transforms[0, 1]
    if not track.active[0] or abs(np.linalg.det(world[:, :3])) < np.finfo(float).tiny:
        return
    stretch = mesh_data.stretch(world)
    shape = track.shapes[0] @ stretch
    own = (points - world[:, 3]) @ (stretch @ np.linalg.inv(world[:, :3])).T
    near = np.flatnonzero(((own > shape.min(axis=0) - reach) & (own < shape.max(axis=0) + reach)).all(axis=1))
    if len(near):
        collider = _collider(evaluated.session_uid, track, shape, points)
        distances[near] = np.minimum(distances[near], collider.signed_distances(own[near]))


def _collider(uid: int, track: Any, shape: np.ndarray, skin: np.ndarray) -> Any:
    """The engine's collider with this shape (V, 3), which is kept while its object has it. skin: world space."""
    known = remembered.live.colliders.get(uid)
    faces = track.topology, track.one_sided
    if known is None or known[1] != faces or not np.array_equal(known[0], shape):
        known = remembered.live.colliders[uid] = shape, faces, contact.collider_of(track, shape, skin)
    return known[2]


def _weight(obj: bpy.types.Object, group: int, vertex: int) -> float:
    return next((each.weight for each in obj.data.vertices[vertex].groups if each.group == group), 0.0)
