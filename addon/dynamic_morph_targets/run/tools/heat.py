# SPDX-License-Identifier: GPL-3.0-or-later
"""What the viewport colors the skin by: how far it moves away from the animation, and the maps that are painted.

There is one value from 0 to 1 for each vertex of a mesh; `overlays` draws them.
"""

from __future__ import annotations

import bpy
import numpy as np

from ...core import engine, errors, states
from ...core.errors import SceneError
from ...core.firmness import NEUTRAL
from ...core.geometry import diagonal
from ...core.message import Message
from ...core.painted_map import FIRMNESS, MAX_DISTANCE
from ...scene import references, skin
from ...scene.character import extract
from ...scene.read import mesh_data
from ...scene.remembered import opened
from ...scene.store import model_store
from ...write.bake import reading
from .. import live, remembered

LIMIT = 0.05  # of the body's size; used when Max Displacement is 0
# Colors from 0 to 1, also for people who confuse red and green, and the color beyond 1.
RAMP = np.array([[0.10, 0.14, 0.40], [0.13, 0.52, 0.62], [0.75, 0.83, 0.40], [0.99, 0.75, 0.22], [0.85, 0.20, 0.12]])
BEYOND = np.array([1.0, 0.1, 0.9])


def colors(values: np.ndarray) -> np.ndarray:
    """RGB (V, 3) float32 of values (V,); those over 1 have a color of their own."""
    at = values.clip(0.0, 1.0) * (len(RAMP) - 1)
    between = np.column_stack([np.interp(at, np.arange(len(RAMP)), channel) for channel in RAMP.T])
    return np.where((values > 1.0)[:, None], BEYOND, between).astype(np.float32)


def limit_of(obj: bpy.types.Object) -> float:
    """The limit of the skin's displacement, of the body's size."""
    return obj.dynamorph.simulation.max_displacement or LIMIT


def displacements(obj: bpy.types.Object) -> dict[int, np.ndarray]:
    """How far the vertices (V,) of the soft skin `obj` and of the meshes that move with it are, at the present frame,
    from where the targets' shapes alone would have them: of what they may be; by session_uid.

    Raises SceneError when nothing moves them, or a point cache does.
    """
    if live.is_on(obj):
        motions = _live_motions(obj)
    elif skin.cache_modifier(obj):
        raise SceneError("The heat map shows bakes to shape keys and Live, not point caches")
    elif obj.dynamorph.bake.exists:
        motions = {each.session_uid: _baked_motion(each) for each in (obj, *skin.shown_attachments(obj))}
    else:
        raise SceneError("The heat map shows a bake or Live: turn Live on or press Bake")
    rest = references.key_points(obj.data.shape_keys.reference_key)
    size = diagonal(rest @ _linear(obj).T)
    allowed = limit_of(obj) * max(size, 1e-30)
    return {
        uid: np.linalg.norm(motion @ _linear(skin.find(uid)).T, axis=1) / allowed for uid, motion in motions.items()
    }


def _linear(obj: bpy.types.Object) -> np.ndarray:
    return np.array(obj.matrix_world)[:3, :3]


def _baked_motion(obj: bpy.types.Object) -> np.ndarray:
    """The motion of the vertices (V, 3), local space: the present effect of the bake's keys without that of the shapes
    alone.
    """
    keys = obj.data.shape_keys
    render = bpy.context.scene.render
    time = bpy.context.scene.frame_current_final * render.frame_map_old / render.frame_map_new
    shapes = reading.shape_curves(obj)
    basis = references.key_points(keys.reference_key)
    motion = np.zeros_like(basis)
    for reference in obj.dynamorph.bake.keys:
        block = keys.key_blocks.get(reference.name)
        if block is None:
            continue
        curve = shapes.get(f"{block.path_from_id()}.value")
        value = block.value - (curve.evaluate(time) if curve else 0.0)
        if value:
            motion += np.float32(value) * (_points(obj.session_uid, reference.key_hash, block.name) - basis)
    return motion


@states.cached(opened, 64)
def _points(session_uid: int, _key_hash: str, name: str) -> np.ndarray:
    """The points of a key of a bake, which is read once."""
    return references.key_points(skin.find(session_uid).data.shape_keys.key_blocks[name])


def _live_motions(obj: bpy.types.Object) -> dict[int, np.ndarray]:
    """The motion of the vertices (V, 3), local space, by session_uid. Raises SceneError when Live does not play."""
    session = remembered.live.sessions.get(obj.session_uid)
    motions = session.motions() if session else {}
    if not motions:
        raise SceneError(live.problem(obj) or "Live has not shown this frame yet")
    return motions


def firmness(obj: bpy.types.Object) -> dict[int, np.ndarray]:
    """How firm the vertices (V,) of the soft skin `obj` and of the meshes in its cage are, by session_uid: weights of
    the Firmness map, and toward 1 what the built model holds. Raises SceneError when there is neither map nor model.
    """
    group, built = obj.dynamorph.firmness_group, _holds(obj.session_uid, obj.dynamorph.model.content_id)
    if isinstance(built, str) and not group:
        raise SceneError(built)
    painted = {obj.session_uid: _weights(obj.session_uid, group, FIRMNESS.neutral)}
    if isinstance(built, str):
        return painted
    if len(built[obj.session_uid]) != len(obj.data.vertices):
        raise SceneError("'{name}' has other vertices than its model: press Build Model", name=obj.name)
    return {uid: (painted.get(uid, NEUTRAL) + held - NEUTRAL).clip(0.0, 1.0) for uid, held in built.items()}


def max_distance(obj: bpy.types.Object) -> dict[int, np.ndarray]:
    """The Max Distance map (V,) of the soft skin `obj` and of the meshes in its cage that have a group of its name, by
    session_uid. Raises SceneError when there is no map.
    """
    group = obj.dynamorph.max_distance_group
    if not group:
        raise SceneError("'{name}' has no Max Distance map: press Paint beside Max Distance", name=obj.name)
    meshes = obj, *(each for each in skin.attached_meshes(obj) if group in each.vertex_groups)
    return {each.session_uid: _weights(each.session_uid, group, MAX_DISTANCE.neutral) for each in meshes}


@states.cached(opened, 4)
def _holds(session_uid: int, _content_id: str) -> dict[int, np.ndarray] | str:
    """What the built model holds, as weights (V,) of the Firmness map from NEUTRAL to 1, by session_uid; or why it is
    not known. Cached, because a viewport asks whenever it draws.
    """
    obj = skin.find(session_uid)
    try:
        model = model_store.load_model(obj)
        if model is None or not len(model.tets):
            return Message("'{name}' has no model: press Build Model, or Paint beside Firmness", name=obj.name)
        character = extract.character(obj)
    except engine.expected_errors() as error:
        return errors.sentence(error)
    at_nodes = model.hold if len(model.hold) else model.pinned.astype(float)
    on_skin = np.einsum("va,va->v", model.embedding_weights, at_nodes[model.embedding_nodes]).clip(0.0, 1.0)
    on_skin[~model.embedding_weights.any(axis=1)] = 1.0  # what only bones move
    if len(on_skin) != len(character.vertices):
        return Message("'{name}' has other vertices than its model: press Build Model", name=obj.name)
    weights = NEUTRAL + (1.0 - NEUTRAL) * on_skin
    return {session_uid: weights[character.own_vertices]} | {
        each.session_uid: weights[each.members] for each in character.attachments
    }


@states.cached(opened, 4)
def _weights(session_uid: int, name: str, absent: float) -> np.ndarray:
    """A map (V,). It is asked whenever a viewport draws, and Blender hands weights out vertex by vertex."""
    return mesh_data.group_weights(skin.find(session_uid), [name], absent)[:, 0]


def edited() -> None:
    """Free what an edit of a mesh may have changed."""
    _weights.cache_clear()
