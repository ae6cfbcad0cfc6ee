# SPDX-License-Identifier: GPL-3.0-or-later
"""What the viewport colors the skin by: how far it moves away from the animation, and how firmly it is held.

Values are one for each vertex of the mesh, 0 to 1; `overlays` draws them.
"""

from __future__ import annotations

from functools import lru_cache

import bpy
import numpy as np

from . import jobs, live, properties, sinks
from .extract import SceneError

LIMIT = 0.05  # of the body's size, where Max Displacement is 0
# Colors from 0 to 1 that those who see red and green alike can tell apart too, and the one beyond.
RAMP = np.array([[0.10, 0.14, 0.40], [0.13, 0.52, 0.62], [0.75, 0.83, 0.40], [0.99, 0.75, 0.22], [0.85, 0.20, 0.12]])
BEYOND = np.array([1.0, 0.1, 0.9])


def colors(values: np.ndarray) -> np.ndarray:
    """RGB (V, 3) float32 of values (V,); those over 1 have a color of their own."""
    at = values.clip(0.0, 1.0) * (len(RAMP) - 1)
    between = np.column_stack([np.interp(at, np.arange(len(RAMP)), channel) for channel in RAMP.T])
    return np.where((values > 1.0)[:, None], BEYOND, between).astype(np.float32)


def limit_of(obj) -> float:
    """How far the skin may move, of the body's size."""
    return obj.dynamorph.simulation.max_displacement or LIMIT


def displacement_of(obj) -> np.ndarray:
    """How far each vertex (V,) is, at the present frame, from where the targets' shapes alone would have it: of what it
    may be. Raises SceneError when nothing on the mesh moves it, or a point cache does.
    """
    if properties.cache_modifier(obj):
        raise SceneError("The heat map shows bakes to shape keys and Live, not point caches")
    if live.is_on(obj):
        motion = _live_motion(obj)
    elif obj.dynamorph.bake.exists:
        motion = _baked_motion(obj)
    else:
        raise SceneError("The heat map shows a bake or Live: turn Live on or press Bake")
    linear = np.array(obj.matrix_world)[:3, :3]
    rest = properties.key_points(obj.data.shape_keys.reference_key)
    size = np.linalg.norm(np.ptp(rest @ linear.T, axis=0))
    return np.linalg.norm(motion @ linear.T, axis=1) / (limit_of(obj) * max(size, 1e-30))


def _baked_motion(obj) -> np.ndarray:
    """Of the vertices (V, 3), local space: what the bake's keys add now, without what they add for the shapes alone."""
    keys = obj.data.shape_keys
    render = bpy.context.scene.render
    time = bpy.context.scene.frame_current_final * render.frame_map_old / render.frame_map_new
    shapes = sinks.shape_curves(obj)
    basis = properties.key_points(keys.reference_key)
    motion = np.zeros_like(basis)
    for reference in obj.dynamorph.bake.keys:
        block = keys.key_blocks.get(reference.name)
        if block is None:
            continue
        curve = shapes.get(f"{block.path_from_id()}.value")
        value = block.value - (curve.evaluate(time) if curve else 0.0)
        if value:
            motion += np.float32(value) * (_points(obj.session_uid, obj.dynamorph.bake.digest, block.name) - basis)
    return motion


@lru_cache(maxsize=64)
def _points(session_uid: int, _digest: str, name: str) -> np.ndarray:
    """Of a key of a bake, which is read once."""
    return properties.key_points(jobs.find(session_uid).data.shape_keys.key_blocks[name])


def _live_motion(obj) -> np.ndarray:
    """Of the vertices (V, 3), local space. Raises SceneError when Live does not play."""
    session = live.sessions.get(obj.session_uid)
    motion = session and session.motion()
    if motion is None:
        raise SceneError(live.problem(obj) or "Live has not shown this frame yet")
    return motion


def hold_of(obj) -> np.ndarray:
    """How firmly each vertex (V,) is held, by the model as it was built: 0 free to 1. Raises SceneError when the model
    does not say, or the mesh has other vertices now.
    """
    model = jobs.load_model(obj)
    hold = getattr(model, "hold", None)
    if hold is None or not len(hold):
        raise SceneError(f"'{obj.name}' has no model with a hold by thickness: set Hold to Thickness and build")
    if len(model.embedding_nodes) != len(obj.data.vertices):
        raise SceneError(f"'{obj.name}' has other vertices than its model: press Build Model")
    on_skin = np.einsum("va,va->v", model.embedding_weights, np.asarray(hold)[model.embedding_nodes])
    return on_skin.clip(0.0, 1.0)
