# SPDX-License-Identifier: GPL-3.0-or-later
"""The meshes that Live shows in motion: what displaces their points, and the live key that they are written to."""

from __future__ import annotations

import threading
from collections.abc import Callable, Set
from contextlib import suppress

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...core.engine import dynamorph
from ...core.errors import SceneError
from ...scene import events, skin
from ...scene.motion import colliders
from ...scene.references import key_points
from ...write.display import live_key
from .. import remembered

AWAY = {"EDIT", "SCULPT"}  # modes that show or hold a mesh of their own
# What displaces the points of a surface: coordinates (dofs,) -> (3 V,), float32, local space.
Move = Callable[[np.ndarray], np.ndarray]


class LiveMesh:
    """A mesh whose live key shows the motion: the soft skin's own, or one that follows it.

    vertices (V, 3), residual_shapes (J, V, 3): local space. move: see Move. written (3 V,): the points of the key.
    ahead: those that show without having been written to it, because that makes Blender copy all keys of the mesh.
    """

    def __init__(self, handle: skin.ObjectHandle, vertices: np.ndarray, move: Move, residual_shapes: np.ndarray):
        self.object = handle
        self.move = move
        self.written: np.ndarray | None = None
        self.ahead: np.ndarray | None = None
        self._goes_ahead = True  # until something prevents that they show
        self._rest = vertices.astype(np.float32).ravel()
        self._residual_shapes = residual_shapes.reshape(len(residual_shapes), -1).astype(np.float32)

    def points(self, values: np.ndarray) -> np.ndarray:
        """Points (3 V,), float32, local space."""
        coordinates, weights = np.split(values, [len(values) - len(self._residual_shapes)])
        return self._rest + self.move(coordinates) + _blended(weights, self._residual_shapes)

    def show(self, values: np.ndarray, depsgraph: bpy.types.Depsgraph | None = None) -> bool:
        """Write the key; False when it is gone, or the mesh has other vertices now. depsgraph: that is evaluated next,
        if the mesh moves by itself. Raises SceneError.
        """
        obj = self.object.find()
        block = live_key.find(obj, self.written)
        if block is None or 3 * len(block.points) != len(self._rest):
            return False
        points = self.points(values)
        shown = None
        if depsgraph and self._goes_ahead and not colliders.is_collider(obj):  # those are read elsewhere
            shown = live_key.evaluated(block, depsgraph)
        if shown is None or not self._still_shows(shown):
            self._write(block, points)
        else:
            shown.points.foreach_set("co", points)
            self.ahead, remembered.live.ahead[obj.session_uid] = points, self
        return True

    def follow_up(self, depsgraph: bpy.types.Depsgraph, evaluated: Set[int]) -> None:
        """After a frame, in which Blender has evaluated meshes (session ids): what does not show is written."""
        block = live_key.find(self.object.find(), self.written)
        shown = block and live_key.evaluated(block, depsgraph)
        if shown is None or self.object.session_uid not in evaluated or not self._still_shows(shown):
            self._goes_ahead = False
            self.catch_up()

    def catch_up(self) -> None:
        """Write to the key what shows already. Raises SceneError."""
        obj = self.object.find()
        block = live_key.find(obj, self.written)
        if self.ahead is not None and block is not None and obj.mode not in AWAY:
            self._write(block, self.ahead)
        self.ahead = None

    def _still_shows(self, shown: bpy.types.ShapeKey) -> bool:
        """Whether nobody has made Blender copy the keys again since points went ahead."""
        if self.ahead is None:
            return True
        self._goes_ahead = np.array_equal(key_points(shown).ravel(), self.ahead)
        return self._goes_ahead

    def _write(self, block: bpy.types.ShapeKey, points: np.ndarray) -> None:
        live_key.write(block, points)
        self.written, self.ahead = points, None
        remembered.live.ahead.pop(self.object.session_uid, None)


@persistent
def catch_up(*_args: object) -> None:
    """animation_playback_post, object_bake_pre: the keys get what shows already, for whoever reads them."""
    for surface in [*remembered.live.ahead.values()]:
        with suppress(SceneError):  # it was deleted
            surface.catch_up()
    remembered.live.ahead.clear()


def evaluated_next() -> bpy.types.Depsgraph | None:
    """What Blender evaluates after the handlers while it plays. None where that may not be all that shows the skin:
    then the keys catch up.
    """
    layers = {(window.scene, window.view_layer) for window in bpy.context.window_manager.windows}
    in_main = threading.current_thread() is threading.main_thread()  # exports evaluate in others
    if in_main and events.is_playing() and not events.render_runs() and len(layers) <= 1:
        return bpy.context.view_layer.depsgraph
    catch_up()
    return None


@persistent
def frame_evaluated(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """frame_change_post: see that what went ahead shows."""
    if not remembered.live.ahead or depsgraph is None or scene != bpy.context.scene:
        return
    if depsgraph != bpy.context.view_layer.depsgraph:  # of an export, or of a render that a script asked for
        catch_up()
        return
    updates = [update for update in depsgraph.updates if update.is_updated_geometry]
    evaluated = {update.id.original.session_uid for update in updates if isinstance(update.id, bpy.types.Object)}
    for surface in [*remembered.live.ahead.values()]:
        with suppress(SceneError):  # it was deleted
            surface.follow_up(depsgraph, evaluated)


HANDLERS = {
    "frame_change_post": frame_evaluated,
    "animation_playback_post": catch_up,
    "object_bake_pre": catch_up,
}


def by_modes(modes: np.ndarray, nodes: np.ndarray, weights: np.ndarray) -> Move:
    """The Move of a reduced simulation, whose modes displace the cage's nodes by (r, n, 3).

    nodes, weights (V, 4): which carry each point.
    """
    used, places = np.unique(nodes, return_inverse=True)
    embedding = dynamorph.Embedding(places.reshape(nodes.shape), weights)
    shapes = modes[:, used].reshape(len(modes), -1).astype(np.float32)
    return lambda coordinates: _carried(embedding, _blended(coordinates, shapes))


def still(count: int) -> Move:
    """The Move of points that nothing displaces."""
    return lambda _coordinates: np.zeros(3 * count, np.float32)


def by_nodes(free: np.ndarray, nodes: np.ndarray, weights: np.ndarray, turn: np.ndarray) -> Move:
    """The Move of an unreduced simulation, whose coordinates are displacements of the `free` nodes (n,) of the cage.

    nodes, weights (V, 4): which carry each point; turn (3, 3): from bind space to that of the points.
    """
    embedding = dynamorph.Embedding(nodes, weights)

    def move(coordinates: np.ndarray) -> np.ndarray:
        moved = np.zeros((len(free), 3))
        moved[free] = np.einsum("nc,dc->nd", coordinates.reshape(-1, 3), turn)
        return _carried(embedding, moved)

    return move


def _carried(embedding: dynamorph.Embedding, moved: np.ndarray) -> np.ndarray:
    """Displacements (3 V,) of the points, of those of the nodes (3 n,)."""
    return embedding.interpolate(moved.reshape(-1, 3)).astype(np.float32).ravel()


def _blended(values: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """The product of (k,) and (k, n), float32. `@` would wake threads; if they must wait, it takes a hundred times as
    long. Most patches of the skin are flat most of the time: runs of zeros are left out.
    """
    used = np.concatenate([[False], values != 0.0, [False]])
    starts, ends = np.flatnonzero(used[1:] & ~used[:-1]), np.flatnonzero(used[:-1] & ~used[1:])
    out = np.zeros(shapes.shape[1], np.float32)
    for start, end in zip(starts, ends, strict=True):
        out += np.einsum("k,kv->v", values[start:end].astype(np.float32), shapes[start:end])
    return out
