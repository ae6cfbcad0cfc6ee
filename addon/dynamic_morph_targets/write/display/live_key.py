# SPDX-License-Identifier: GPL-3.0-or-later
"""The one shape key in which Live and its previews show the soft skin, and the keys muted meanwhile."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager

import bpy
import numpy as np

from ...scene.references import key_points
from ...scene.skin import shown_attachments
from ..bake import muting, writer
from ..reconcile import note_others, reconcile

NAME = "Dynamorph Live"


def add(obj: bpy.types.Object, target_names: Collection[str], attachments: Sequence[bpy.types.Object] = ()) -> None:
    """Add the key at value 1, and mute the keys of these targets: it contains their shapes. A bake stays, without any
    effect. Raises WriteError.

    attachments: other meshes that follow the soft skin `obj`; each gets one too.
    """
    writer.check(obj)
    for attachment in attachments:
        writer.check(attachment, obj)
    _add(obj, target_names)
    for attachment in attachments:
        _add(attachment, target_names, skin=obj)
    for each in (obj, *shown_attachments(obj)):
        muting.show_bake(each, False)


def _add(obj: bpy.types.Object, target_names: Collection[str], skin: bpy.types.Object | None = None) -> None:
    reconcile(obj)
    writer.follow(obj, skin)
    blocks = obj.data.shape_keys.key_blocks
    active = obj.active_shape_key_index
    block = obj.shape_key_add(name=NAME, from_mix=False)
    block.value = 1.0
    block.relative_key = obj.data.shape_keys.reference_key
    obj.active_shape_key_index = active
    obj.dynamorph.live.key.refer_to(blocks, blocks.find(block.name))
    note_others(blocks, obj.dynamorph.live)
    muting.mute_targets(obj, obj.dynamorph.live.muted, target_names, skin)


def remove(obj: bpy.types.Object) -> None:
    """Remove the key of `obj` and of what follows it, where there is one, and restore what it muted and the active key.

    Raises WriteError.
    """
    shown = (obj, *shown_attachments(obj))
    for each in shown:
        if find(each):
            writer.check_not_edited(each)
    had_key = bool(obj.dynamorph.live.key.name)
    for each in shown:
        _remove(each)
        if had_key:
            muting.show_bake(each, True)


def _remove(obj: bpy.types.Object) -> None:
    reconcile(obj)
    record = obj.dynamorph.live
    block = find(obj)
    if block is not None:
        blocks = obj.data.shape_keys.key_blocks
        active = obj.active_shape_key.name if obj.active_shape_key else ""
        obj.shape_key_remove(block)
        index = blocks.find(active)
        obj.active_shape_key_index = index if index >= 0 else len(blocks) - 1
    muting.unmute_targets(obj, record.muted)
    record.key.name = record.others = ""
    if not obj.dynamorph.bake.exists:
        writer.leave(obj)


def remove_hidden(obj: bpy.types.Object) -> None:
    """The same for a hidden key, whose targets something else has muted since: they stay as they are."""
    for each in (obj, *shown_attachments(obj)):
        each.dynamorph.live.muted.clear()
    remove(obj)


def hide(obj: bpy.types.Object, hidden: bool) -> None:
    """Let `obj` and what follows it look as without Live, while the key stays; or as with it again."""
    for each in (obj, *shown_attachments(obj)) if find(obj) else ():
        muting.show_bake(each, hidden)
        block = find(each)
        if block is None:
            continue
        block.mute = hidden
        blocks = each.data.shape_keys.key_blocks
        for key in each.dynamorph.live.muted:
            if key.name in blocks:
                blocks[key.name].mute = key.was_muted if hidden else True


def is_hidden(obj: bpy.types.Object) -> bool:
    """Whether there is the key, and it shows nothing."""
    block = find(obj)
    return block is not None and block.mute


@contextmanager
def left_out(obj: bpy.types.Object) -> Iterator[None]:
    """While it is open, Live is hidden and a bake shows."""
    shown = find(obj) is not None and not is_hidden(obj)
    if shown:
        hide(obj, True)
    try:
        yield
    finally:
        if shown:
            hide(obj, False)


def find(obj: bpy.types.Object, written: np.ndarray | None = None) -> bpy.types.ShapeKey | None:
    """The key, or None. written (3 V,): the last points written to it, which identify it after a rename."""
    reference, keys = obj.dynamorph.live.key, obj.data.shape_keys
    if not (reference.name and keys):
        return None
    block = keys.key_blocks.get(reference.name)
    if block is None and written is not None:
        blocks, others = keys.key_blocks, obj.dynamorph.live.others.split("\n")
        alike = [k for k, other in enumerate(blocks) if np.array_equal(key_points(other).ravel(), written)]
        if len(alike) == 1 and blocks[alike[0]].name not in others:  # otherwise it may be a key of the artist's
            reference.refer_to(blocks, alike[0])
            block = blocks[alike[0]]
    return block


def write(block: bpy.types.ShapeKey, points: np.ndarray) -> None:
    """Show points (3 V,) float32, local space, which Blender copies in one piece."""
    block.points.foreach_set("co", points)
    block.id_data.update_tag()


def evaluated(block: bpy.types.ShapeKey, depsgraph: bpy.types.Depsgraph) -> bpy.types.ShapeKey | None:
    """The copy of the key in a depsgraph; None where that has none like it."""
    shown = block.id_data.evaluated_get(depsgraph).key_blocks.get(block.name)
    alike = shown is not None and shown.id_data != block.id_data and len(shown.points) == len(block.points)
    return shown if alike else None
