# SPDX-License-Identifier: GPL-3.0-or-later
"""Plain against soft: shows the mesh as its rig alone moves it, while a bake or Live stays as it is.

What shows the soft skin is muted, and the targets' own keys count again. No other state is stored: a soft skin is shown
plain when everything that would show it is muted.
"""

from __future__ import annotations

import bpy

from ...scene import skin
from .. import reconcile
from ..bake import muting, writer
from . import live_key


def is_plain(obj: bpy.types.Object) -> bool:
    """Whether `obj` shows plain skinning in place of its bake or of Live. Fast enough for drawing."""
    modifier = skin.cache_modifier(obj)
    hidden = [block.mute for block in _blocks(obj)] + ([not modifier.show_viewport] if modifier else [])
    return bool(hidden) and all(hidden)


def can_show(obj: bpy.types.Object) -> bool:
    """Whether a bake or Live exists that could be muted."""
    return bool(_blocks(obj) or skin.cache_modifier(obj))


def show(obj: bpy.types.Object, plain: bool) -> None:
    """Show `obj` and what follows it plain, or soft again. Raises WriteError in Edit Mode."""
    shown = (obj, *skin.shown_attachments(obj))
    for each in shown:
        writer.check_not_edited(each)
    for each in shown:
        reconcile.reconcile(each)
        _show(each, plain)


def _show(obj: bpy.types.Object, plain: bool) -> None:
    settings, live = obj.dynamorph, live_key.find(obj)
    if live:
        live.mute = plain
    else:  # a bake has no effect while Live plays over it
        muting.show_bake(obj, not plain)
    blocks = obj.data.shape_keys.key_blocks if obj.data.shape_keys else {}
    for key in (*settings.bake.muted, *settings.live.muted):
        if key.name in blocks:
            blocks[key.name].mute = key.was_muted if plain else True


def _blocks(obj: bpy.types.Object) -> list:
    """The shape keys of the bake and of Live."""
    if obj.data.shape_keys is None:
        return []
    found = [obj.data.shape_keys.key_blocks.get(key.name) for key in obj.dynamorph.bake.keys if key.name]
    return [block for block in (*found, live_key.find(obj)) if block is not None]
