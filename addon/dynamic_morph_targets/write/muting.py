# SPDX-License-Identifier: GPL-3.0-or-later
"""Targets' keys muted while a bake or Live shows them, and shown again."""

from __future__ import annotations

from ..scene import animation


def mute_targets(obj, muted, simulated, skin=None):
    """Mute the targets' own keys, whose shapes the result contains, and keys with the same names on meshes that follow.
    muted: the list that records them; skin: as for `write_keys`.
    """
    show_target(obj, "")
    blocks = obj.data.shape_keys.key_blocks
    for target in (skin or obj).dynamorph.targets[1:]:
        index = blocks.find(target.name)
        if target.name not in simulated or index < 1:
            continue
        key = muted.add()
        key.refer_to(blocks, index)
        key.was_muted = blocks[index].mute
        blocks[index].mute = True


def unmute_targets(obj, muted):
    """The inverse of `mute_targets`; the references must be reconciled."""
    blocks = obj.data.shape_keys.key_blocks if obj.data.shape_keys else {}
    for key in muted:
        if key.name in blocks:
            blocks[key.name].mute = key.was_muted
    muted.clear()


def show_target(obj, name: str):
    """Turn on the shape key of one target, "" for none, and turn off the previous one, unless the artist has set it.

    It shows the sculpt as long as neither a bake nor Live does, and stays as it is where something else moves it.
    """
    shown, blocks = obj.dynamorph.sculpt.shown, animation.keys_of(obj)
    before, block = blocks.get(shown.name), blocks.get(name)
    if before and before.value == min(1.0, before.slider_max):
        before.value = 0.0
    shown.name = ""
    if block and not (block.mute or obj.dynamorph.bake.exists or name in animation.moving_keys(obj)):
        block.value = 1.0
        shown.refer_to(blocks, blocks.find(name))
