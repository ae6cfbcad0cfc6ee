# SPDX-License-Identifier: GPL-3.0-or-later
"""What is muted and shown again: targets' keys while a bake or Live shows them, a bake while Live plays over it."""

from __future__ import annotations

from collections.abc import Collection

import bpy

from ...scene import animation, skin


def mute_targets(
    obj: bpy.types.Object,
    muted: bpy.types.bpy_prop_collection,
    simulated: Collection[str],
    body: bpy.types.Object | None = None,
) -> None:
    """Mute the targets' own keys, whose shapes the result contains, and keys with the same names on meshes that follow.
    muted: the list that records them; body: the soft skin that `obj` follows, if it is none itself.
    """
    show_target(obj, "")
    blocks = obj.data.shape_keys.key_blocks
    recorded = [key.name for key in obj.dynamorph.bake.muted]  # by the bake that Live plays over
    for target in (body or obj).dynamorph.targets[1:]:
        index = blocks.find(target.name)
        if target.name not in simulated or index < 1 or target.name in recorded:
            continue
        key = muted.add()
        key.refer_to(blocks, index)
        key.was_muted = blocks[index].mute
        blocks[index].mute = True


def unmute_targets(obj: bpy.types.Object, muted: bpy.types.bpy_prop_collection) -> None:
    """The inverse of `mute_targets`; the references must be reconciled."""
    blocks = obj.data.shape_keys.key_blocks if obj.data.shape_keys else {}
    for key in muted:
        if key.name in blocks:
            blocks[key.name].mute = key.was_muted
    muted.clear()


def leave_to_live(obj: bpy.types.Object) -> None:
    """The bake goes while Live plays: Live keeps the targets' keys muted that the bake had muted."""
    record, keys = obj.dynamorph, obj.data.shape_keys
    for key in record.bake.muted:
        if keys and key.name in keys.key_blocks:
            left = record.live.muted.add()
            left.refer_to(keys.key_blocks, keys.key_blocks.find(key.name))
            left.was_muted = key.was_muted
    record.bake.muted.clear()


def show_bake(obj: bpy.types.Object, shown: bool) -> None:
    """Let the bake of `obj` play, or let it stay without any effect; nothing happens without a bake."""
    record, modifier = obj.dynamorph.bake, skin.cache_modifier(obj)
    if modifier and shown:
        modifier.show_viewport, modifier.show_render = True, record.was_rendered
    elif modifier and modifier.show_viewport:
        record.was_rendered = modifier.show_render
        modifier.show_viewport = modifier.show_render = False
    blocks = obj.data.shape_keys.key_blocks if obj.data.shape_keys else {}
    for key in record.keys:
        if key.name in blocks:
            blocks[key.name].mute = not shown


def show_target(obj: bpy.types.Object, name: str) -> None:
    """Turn on the shape key of one target, "" for none, and turn off the previous one, unless the artist has set it.

    It shows the sculpt as long as neither a bake nor Live does, which mute it, and stays as it is where something else
    moves it.
    """
    shown, blocks = obj.dynamorph.sculpt.shown, animation.keys_of(obj)
    before, block = blocks.get(shown.name), blocks.get(name)
    if before and before.value == min(1.0, before.slider_max):
        before.value = 0.0
    shown.name = ""
    if block and not (block.mute or name in animation.moving_keys(obj)):
        block.value = 1.0
        shown.refer_to(blocks, blocks.find(name))
