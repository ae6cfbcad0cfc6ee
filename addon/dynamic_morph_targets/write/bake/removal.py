# SPDX-License-Identifier: GPL-3.0-or-later
"""The removal of a bake's shape keys, curves and modifier; what the artist has made of them stays."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Sequence

import bpy

from ...core.message import Message
from ...scene import animation
from ...scene.animation import is_baked, strips
from .baked_action import BakedAction, players_of

LONG_NAME = 58  # bytes, of 63 in Blender 4.5


def remove_keys(
    obj: bpy.types.Object, names: Sequence[str], baked: BakedAction, active_index: int, new: Sequence[str] = ()
) -> list[Message]:
    """Remove these shape keys with their strips and their Action, of the artist's Action only their slots; what is the
    artist's in them stays. active_index: of the key that is active afterward, if the active one is among them; new:
    keys of the bake that takes the place. Returns what the artist should know.
    """
    blocks = obj.data.shape_keys.key_blocks
    active = obj.active_shape_key.name if obj.active_shape_key else ""
    messages = []
    for block in _edited(blocks, (*names, *new), baked):
        block.value = 0.0  # that of the old motion, on top of the new one
        text = "'{key}' of '{name}' was edited after the bake: it stays, at the value 0"
        messages.append(Message(text, key=block.name, name=obj.name))
    _remove(obj, [blocks[name] for name in names], baked, {f"{blocks[name].path_from_id()}.value" for name in new})
    index = blocks.find(active)
    obj.active_shape_key_index = index if index >= 0 else min(active_index, len(blocks) - 1)
    return messages


def remove_modifier(obj: bpy.types.Object, modifier: bpy.types.Modifier) -> None:
    modifier.driver_remove("factor")
    obj.modifiers.remove(modifier)


def clear_unused(keys: bpy.types.Key, had_animation_data: bool) -> None:
    """Remove the animation data of shape keys that had none, unless something else is in it now."""
    animation = keys.animation_data
    unused = animation and not (animation.action or animation.nla_tracks or animation.drivers)
    if unused and not had_animation_data:
        keys.animation_data_clear()


def _edited(blocks: bpy.types.bpy_prop_collection, names: Collection[str], baked: BakedAction) -> list:
    """The keys that a bake's curves move, and that are not among its keys any more: the artist has sculpted them."""
    moved = _curves(baked.action) if baked.action else ()
    paths = {curve.data_path for bag, curve in moved if is_baked(curve) and baked.holds(bag.slot)}
    return [block for block in blocks if block.name not in names and f"{block.path_from_id()}.value" in paths]


def _remove(obj: bpy.types.Object, blocks: Sequence[bpy.types.ShapeKey], baked: BakedAction, new: set[str]) -> None:
    """Remove shape keys, and the Action with its strips and the tracks that become empty; also the copies of the Action
    that Blender makes for duplicated strips. One in which the artist has animated other keys keeps their curves. new:
    paths of the keys of the bake that takes the place.
    """
    keys, action = obj.data.shape_keys, baked.action
    actions = [action] if action else []
    tracks = keys.animation_data.nla_tracks if keys.animation_data and action else []
    paths = {f"{block.path_from_id()}.value" for block in blocks}
    kept: Counter = Counter()  # strips that play what the artist has keyed in them, by Action
    for track in list(tracks):
        for strip in list(track.strips):
            played = [each for each in (strip, *strips([strip])) if each.action]
            for each in played:
                slot = each.action_slot if baked.is_shared else None
                if each.action not in actions and _is_copy(each.action, slot, action, paths, new):
                    actions.append(each.action)
            ours = [each for each in played if each.action in actions and baked.holds(each.action_slot)]
            if len(ours) < len(played) or any(_others(each.action, paths, each.action_slot) for each in ours):
                kept.update(each.action for each in ours)  # Blender cannot take one strip out of a Meta strip
            elif ours:
                track.strips.remove(strip)
                if all(left.type == "TRANSITION" for left in track.strips):
                    tracks.remove(track)
                    break
    for name in [block.name for block in blocks]:  # by name: each removal moves the others in memory
        obj.shape_key_remove(keys.key_blocks[name])
    data = keys.animation_data
    chosen = data and data.action in actions and baked.holds(data.action_slot)
    if chosen:  # in an editor, to see its curves or to key others
        if _others(data.action, paths, data.action_slot):
            kept[data.action] += 1
        else:
            data.action = None
    if action and baked.is_shared:
        _remove_slots(obj, baked)
        actions.remove(action)
    for each in actions:
        recorded = obj.dynamorph.bake.action == each  # the record counts as a user
        if each.users > kept[each] + int(recorded):  # somebody else plays it
            continue
        others = [] if baked.is_shared else _others(each, paths)  # a copy of the artist's Action goes as a whole
        for bag, curve in _curves(each) if others else ():
            if curve not in others:
                bag.fcurves.remove(curve)
        if not others:
            bpy.data.actions.remove(each)


def _remove_slots(obj: bpy.types.Object, baked: BakedAction) -> None:
    """Remove the slots of the bake of `obj` in an Action of the artist's, unless a duplicate plays them; and those that
    are left there because one has played them. What is the artist's in them stays.
    """
    action, keys = baked.action, obj.data.shape_keys
    records = [each.dynamorph.bake for each in bpy.data.objects if each.dynamorph.bake.action == action]
    noted = {handle for record in records for handle in record.action_slots}
    for slot in [slot for slot in action.slots if slot.target_id_type == keys.id_type]:
        players, moved = players_of(slot), animation.curves(action, slot)
        made = [curve for curve in moved if is_baked(curve)]
        mine = baked.holds(slot) and all(player == keys for player in players)
        left = made and not players and slot.handle not in noted
        if not (mine or left):
            continue
        if len(made) == len(moved) and not players:
            action.slots.remove(slot)
            continue
        for curve in made:
            animation.remove_curve(action, slot, curve)


def _curves(action: bpy.types.Action) -> list[tuple]:
    """All curves of an Action, each with the list that it is in."""
    bags = [bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags]
    return [(bag, curve) for bag in bags for curve in bag.fcurves]


def _others(action: bpy.types.Action, paths: set[str], slot: bpy.types.ActionSlot | None = None) -> list:
    """The curves of an Action, or of one slot of it, that move neither these paths nor baked keys."""
    found = [curve for bag, curve in _curves(action) if slot is None or bag.slot == slot]
    return [curve for curve in found if not (curve.data_path in paths or is_baked(curve))]


def _is_copy(
    copy: bpy.types.Action, slot: bpy.types.ActionSlot | None, action: bpy.types.Action, paths: set[str], new: set[str]
) -> bool:
    """Whether an Action is a copy that Blender has made and named, with a bake's curves alone, or those alone in this
    slot.
    """
    moved = [(bag, curve) for bag, curve in _curves(copy) if slot is None or bag.slot == slot]
    stem, original = (re.sub(r"\.\d+$", "", each.name) for each in (copy, action))
    is_named = stem == original or (
        len(copy.name.encode()) > LONG_NAME and original.startswith(stem)
    )  # Blender cuts long ones
    is_new = any(curve.data_path in new for _, curve in moved)
    return bool(moved) and is_named and not is_new and not _others(copy, paths, slot)
