# SPDX-License-Identifier: GPL-3.0-or-later
"""Side by side: a copy of a soft skin that stands beside it, to compare the two while they play.

The copy shows plain skinning until a bake gives way that was made with the settings of the other slot: then it shows
that bake. It is in a collection of its own, which an empty instances beside the body. So it is in no view layer, and
nothing selects, bakes or exports it; the empty cannot be clicked and is not rendered. All of that is runtime data,
which Blender keeps in undo steps and leaves out of files.
"""

from __future__ import annotations

from collections.abc import Iterable

import bpy
import numpy as np

from ...core.errors import SceneError
from ...scene import animation, skin
from ...scene.store.model_store import PACKED
from ..bake import writer
from ..bake.baked_action import MOTION, SHAPES
from . import comparison

GAP = 1.15  # widths of the body from its middle to that of the copy


def find(body: bpy.types.Object) -> bpy.types.Object | None:
    """The empty that shows a copy beside the soft skin `body`, or None. Fast enough for drawing."""
    return next((each for each in _empties() if each.dynamorph.live.beside == body), None)


def add(body: bpy.types.Object, right: np.ndarray) -> None:
    """Show a copy of `body` with plain skinning, a bit more than its width away. right (3,): the direction, of length
    1, world space. Raises SceneError, WriteError.
    """
    if not body.visible_get():
        raise SceneError("'{name}' is hidden: show it to compare it", name=body.name)
    empty = bpy.data.objects.new(f"{body.name} Beside", None)
    empty.instance_type, empty.hide_select, empty.hide_render = "COLLECTION", True, True
    empty.empty_display_size = 0.0  # there is only the copy to be seen
    try:
        _fill(empty, body, plain=True)
    except BaseException:
        bpy.data.objects.remove(empty)
        raise
    empty.location = GAP * _width(empty.instance_collection.objects, body, right) * right
    empty.dynamorph.live.beside = body
    bpy.context.scene.collection.objects.link(empty)


def keep_bake(body: bpy.types.Object) -> None:
    """Before the bake of `body` is replaced or deleted: the copy shows it, if it was made with the other slot."""
    empty, record = find(body), body.dynamorph.bake
    if empty and record.exists and record.slot != body.dynamorph.live.slot:
        _fill(empty, body, plain=False)
        empty.dynamorph.live.beside_slot = record.slot


def remove(empty: bpy.types.Object) -> None:
    """Remove the empty with the copy."""
    collection = empty.instance_collection
    bpy.data.objects.remove(empty)
    if collection:
        _remove_copies(collection)


def remove_all() -> None:
    """Remove what a file that Blender saved automatically has kept."""
    for empty in _empties():
        remove(empty)


def leave_out_of_file() -> list[bpy.types.Action]:
    """Before a file is saved. Returns the Actions that are left out only this once: an undone bake may use them
    again.
    """
    actions = []
    for empty in _empties():
        if not empty.dynamorph.live.beside.users_scene:  # it was deleted
            remove(empty)
            continue
        collection = empty.instance_collection
        copies = _copies(collection) if collection else []
        for block in filter(None, (empty, collection, *copies, *(copy.data for copy in copies))):
            block.is_runtime_data = True
        for keys in filter(None, (copy.data.shape_keys for copy in copies)):
            keys.is_runtime_data = True
            played = _played(keys)
            actions += [action for action in set(played) if action.users == played.count(action)]
    for action in actions:
        action.is_runtime_data = True
    return actions


def _empties() -> list:
    return [each for each in bpy.data.objects if each.type == "EMPTY" and each.dynamorph.live.beside]


def _fill(empty: bpy.types.Object, body: bpy.types.Object, plain: bool) -> None:
    """Let the empty show copies of `body` and of what follows it, as they are now, and what its bones carry along.
    Raises WriteError, and then nothing is changed.
    """
    moving = [body, *(each for each in skin.shown_attachments(body) if each.visible_get())]
    for each in moving:
        writer.check_not_edited(each)
    rigid = {each.object for each in body.dynamorph.attachments if each.object and each.object.visible_get()}
    collection = bpy.data.collections.new(empty.name)
    for each in (*(_copy(each, plain) for each in moving), *rigid.difference(moving)):
        collection.objects.link(each)
    before, empty.instance_collection = empty.instance_collection, collection
    if before:
        _remove_copies(before)


def _copy(obj: bpy.types.Object, plain: bool) -> bpy.types.Object:
    """A copy of a mesh object that is no soft skin, and follows none: it only plays."""
    copy = obj.copy()
    copy.data = obj.data.copy()
    if comparison.can_show(copy):
        comparison.show(copy, plain)
    copy.property_unset("dynamorph")
    copy.pop(PACKED, None)
    copy.dynamorph.live.beside = obj  # which tells it from what the bones carry along
    return copy


def _copies(collection: bpy.types.Collection) -> list:
    return [each for each in collection.objects if each.dynamorph.live.beside]


def _remove_copies(collection: bpy.types.Collection) -> None:
    for copy in _copies(collection):
        mesh = copy.data
        actions = set(_played(mesh.shape_keys)) if mesh.shape_keys else ()
        bpy.data.objects.remove(copy)
        bpy.data.meshes.remove(mesh)
        for action in actions:
            if not action.users:
                bpy.data.actions.remove(action)
    bpy.data.collections.remove(collection)


def _played(keys: bpy.types.Key) -> list[bpy.types.Action]:
    """The Actions of bakes that the NLA strips of shape keys play, one for each strip."""
    tracks = keys.animation_data.nla_tracks if keys.animation_data else ()
    slots = [(strip.action, strip.action_slot) for strip in animation.strips(tracks)]
    return [action for action, slot in slots if slot and slot.name_display in (SHAPES, MOTION)]


def _width(copies: Iterable[bpy.types.Object], body: bpy.types.Object, right: np.ndarray) -> float:
    """How wide `body` and all that stands with it is along a direction, in the present pose."""
    depsgraph, along = bpy.context.evaluated_depsgraph_get(), []
    standing = {each for each in (body, *skin.shown_attachments(body), *copies) if each.users_scene}
    for each in standing:
        evaluated = each.evaluated_get(depsgraph)
        world = np.array(evaluated.matrix_world)
        along.append((np.array(evaluated.bound_box) @ world[:3, :3].T + world[:3, 3]) @ right)
    return float(np.ptp(np.concatenate(along)))
