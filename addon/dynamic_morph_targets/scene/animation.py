# SPDX-License-Identifier: GPL-3.0-or-later
"""The animation of an object and its shape keys: curves, keyed and driven values, and what has changed in it."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Collection, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy_extras import anim_utils

from .plain import plain
from .skin import used_grips
from .skinning import Skinning

GROUP = "Dynamorph"  # of the curves of baked keys, which tells them from the artist's in the same Action


def is_baked(curve: bpy.types.FCurve) -> bool:
    """Whether a bake has made a curve."""
    return bool(curve.group) and curve.group.name == GROUP and curve.data_path.startswith("key_blocks[")


def curves(action: bpy.types.Action | None, slot: bpy.types.ActionSlot | None) -> list:
    """The F-curves of one slot of an Action; either may be None."""
    channels = anim_utils.action_get_channelbag_for_slot(action, slot)
    return list(channels.fcurves) if channels else []


def remove_curve(action: bpy.types.Action, slot: bpy.types.ActionSlot, curve: bpy.types.FCurve) -> None:
    """Remove one of `curves`."""
    anim_utils.action_get_channelbag_for_slot(action, slot).fcurves.remove(curve)


def follow_list(obj: bpy.types.Object, path: str, before: list[int]) -> None:
    """Let the curves and drivers of a list's elements follow them: Blender tells the elements apart by their place.

    before: where each element was. What animates an element that is gone is removed.
    """
    data = obj.animation_data
    now, element = {old: new for new, old in enumerate(before)}, re.compile(rf"{re.escape(path)}\[(\d+)\]")

    def follow(curves: list[bpy.types.FCurve], remove: Callable[[bpy.types.FCurve], object]) -> None:
        for curve in curves:
            found = element.match(curve.data_path)
            place = now.get(int(found[1]), -1) if found else None
            if place == -1:
                remove(curve)
            elif found and place != int(found[1]):
                curve.data_path = f"{path}[{place}]{curve.data_path[found.end() :]}"
                if curve.driver:  # Blender tries one that did not work at its old place only when it is changed
                    curve.driver.type = curve.driver.type

    if data and any(element.match(curve.data_path) for curve in curves(data.action, data.action_slot)):
        _own_action(obj, data)
    if data:
        players = {(each.action, each.action_slot) for each in (data, *strips(data.nla_tracks))}
        for action, slot in players:
            follow(curves(action, slot), partial(remove_curve, action, slot))
        follow(list(data.drivers), data.drivers.remove)


def _own_action(obj: bpy.types.Object, data: bpy.types.AnimData) -> None:
    """Give `obj` an Action of its own where others play the same slot of it, as copies do."""
    playing = data.action, data.action_slot
    others = [other.animation_data for other in bpy.data.objects if other != obj and other.animation_data]
    if any((other.action, other.action_slot) == playing for other in others):
        slot = data.action_slot.identifier
        data.action = data.action.copy()
        data.action_slot = data.action.slots[slot]


def strips(tracks: Iterable[bpy.types.NlaTrack | bpy.types.NlaStrip], muted: bool = True) -> list:
    """The strips of NLA tracks, followed by those in Meta strips; muted: also those that do not play."""
    found = []
    for group in (track for track in tracks if muted or not track.mute):
        inside = [strip for strip in group.strips if muted or not strip.mute]
        found += [*inside, *strips(inside, muted)]
    return found


def played(data: bpy.types.AnimData) -> list:
    """The F-curves that animation data play: of their Action and of their strips. Muted and empty ones do nothing."""
    alone = [track for track in data.nla_tracks if track.is_solo]
    players = data, *strips(alone or data.nla_tracks, muted=False)
    found = [curve for player in players for curve in curves(player.action, player.action_slot)]
    return [curve for curve in found if not (curve.mute or (curve.group and curve.group.mute) or curve.is_empty)]


def moved_paths(owner: bpy.types.ID) -> list[str]:
    """The paths of a data-block that curves and drivers move, each once."""
    data = getattr(owner, "animation_data", None)  # not all kinds of data-blocks have it
    if data is None:
        return []
    drivers = [driver for driver in data.drivers if not driver.mute]
    return list(dict.fromkeys(curve.data_path for curve in (*played(data), *drivers)))


def keys_of(obj: bpy.types.Object) -> bpy.types.bpy_prop_collection:
    """The shape keys of `obj` by name; empty when the artist has removed all of them."""
    return obj.data.shape_keys.key_blocks if obj.data.shape_keys else {}


def baked_keys(obj: bpy.types.Object) -> set[str]:
    return {key.name for key in obj.dynamorph.bake.keys}


def moving_keys(obj: bpy.types.Object) -> list[str]:
    """The keys with an effect: not muted, and with a curve, a driver or a value."""
    animated = baked_keys(obj) | driven_keys(obj) | played_keys(obj)
    return [name for name, key in list(keys_of(obj).items())[1:] if not key.mute and (key.value or name in animated)]


def driven_keys(obj: bpy.types.Object) -> set[str]:
    animation = obj.data.shape_keys and obj.data.shape_keys.animation_data
    return _keys_at(obj, {driver.data_path for driver in animation.drivers} if animation else ())


def played_keys(obj: bpy.types.Object) -> set[str]:
    """The keys that Actions of the artist move, by the NLA too."""
    animation = obj.data.shape_keys and obj.data.shape_keys.animation_data
    if not animation:
        return set()
    return _keys_at(obj, {curve.data_path for curve in played(animation)})


def _keys_at(obj: bpy.types.Object, paths: Collection[str]) -> set[str]:
    return {name for name, key in keys_of(obj).items() if f"{key.path_from_id()}.value" in paths}


def source_files() -> list[Path]:
    """The files that contain what moves the scene: the .blend, its libraries and caches."""
    outside = (*bpy.data.libraries, *bpy.data.cache_files)
    files = [bpy.data.filepath, *(bpy.path.abspath(each.filepath, library=each.library) for each in outside)]
    return [Path(file) for file in files]


STRIP_FIELDS = (
    "frame_start", "frame_end", "action_frame_start", "action_frame_end", "scale", "repeat", "use_reverse",
    "blend_type", "extrapolation", "blend_in", "blend_out", "influence",
)  # fmt: skip
# Of a strip that plays its Action as it is. Its influence then is what Blender makes of the others.
PLAIN = {
    "blend_type": "REPLACE", "extrapolation": "HOLD", "use_animated_influence": False, "blend_in": 0.0,
    "blend_out": 0.0, "repeat": 1.0, "use_reverse": False, "use_animated_time": False,
}  # fmt: skip
SAME_TIME = 1e-3  # frames
USUAL = {"use_nla": True, "action_blend_type": "REPLACE", "action_extrapolation": "HOLD", "action_influence": 1.0}


def animation(skinning: Skinning) -> list[tuple[str, str]]:
    """(name, hash of the F-curves and NLA strips) of the objects that move the skin."""
    return [(mover.name, animation_hash(mover.animation_data)) for mover in _movers(skinning)]


def is_animated(skinning: Skinning) -> bool:
    """Whether F-curves move the skin, and do not only hold a pose."""
    data = filter(None, (mover.animation_data for mover in _movers(skinning)))
    return any(len(curve.keyframe_points) > 1 for each in data for curve in played(each))


def _movers(skinning: Skinning) -> list:
    """The objects that move or hold the skin, all their parents, and what their constraints and drivers follow, as a
    source armature or the goal of IK.
    """
    moving: list = []
    holding = [grip.object for grip in used_grips(skinning.obj)]
    skinned_by = (modifier.object for modifier in skinning.modifiers)
    _add_with_parents((skinning.rig, skinning.obj, *skinned_by, *holding), moving)
    for mover in moving:  # grows
        _add_with_parents(_followed(mover), moving)
    return moving


def rigid_bodies(skinning: Skinning) -> list[str]:
    """The names of those objects that Rigid Body moves, which it does in the artist's own scene alone."""
    if bpy.context.scene.rigidbody_world is None:
        return []
    bodies = ((mover.name, mover.rigid_body) for mover in _movers(skinning))
    return [name for name, body in bodies if body and body.type == "ACTIVE" and not body.kinematic]


def _add_with_parents(movers: Iterable[bpy.types.Object | None], moving: list) -> None:
    for mover in movers:
        while mover is not None and mover not in moving:
            moving.append(mover)
            mover = mover.parent


def _followed(mover: bpy.types.Object) -> list:
    """The objects that the constraints and drivers of an object, and of its bones, follow."""
    bones = mover.pose.bones if mover.pose else ()
    constraints = [*mover.constraints, *(constraint for bone in bones for constraint in bone.constraints)]
    found = [getattr(constraint, name, None) for constraint in constraints for name in ("target", "pole_target")]
    found += [each.target for constraint in constraints for each in getattr(constraint, "targets", ())]
    drivers = mover.animation_data.drivers if mover.animation_data else ()
    found += [each.id for driver in drivers for variable in driver.driver.variables for each in variable.targets]
    return [other for other in found if isinstance(other, bpy.types.Object)]


def animation_hash(data: bpy.types.AnimData | None) -> str:
    """Of the F-curves and NLA strips that animation data, or None, play. An Action that was pushed down, and moves what
    it did, has the hash that it had.
    """
    if data is None:
        return ""
    digest = hashlib.blake2b(digest_size=8)
    unusual = {name: getattr(data, name) for name, usual in USUAL.items() if getattr(data, name) != usual}
    unusual |= {track.name: "solo" for track in data.nla_tracks if track.is_solo}
    digest.update(repr(unusual).encode() if unusual else b"")
    playing = strips(data.nla_tracks, muted=False)
    if not data.action and not unusual and len(playing) == 1 and _is_plain(playing[0]):
        _add_curves(playing[0], digest, playing[0])
        return digest.hexdigest()
    for strip in playing:
        fields = [name for name in STRIP_FIELDS if not (name == "influence" and strip.use_animated_influence)]
        digest.update(repr([getattr(strip, name) for name in fields]).encode())
    for player in (data, *playing):
        _add_curves(player, digest)
    return digest.hexdigest()


def _is_plain(strip: bpy.types.NlaStrip) -> bool:
    """Whether a strip plays its Action as that would play by itself, but for when and how fast."""
    changed = [name for name, usual in PLAIN.items() if getattr(strip, name) != usual]
    own = [curve for curve in strip.fcurves if len(curve.keyframe_points)]
    played = curves(strip.action, strip.action_slot)
    if strip.type != "CLIP" or changed or own or len(strip.modifiers) or not played:
        return False
    if any(len(curve.modifiers) or curve.extrapolation != "CONSTANT" for curve in played):
        return False
    times = [key.co.x for curve in played for key in curve.keyframe_points]
    return min(times) >= strip.action_frame_start - SAME_TIME and max(times) <= strip.action_frame_end + SAME_TIME


def _add_curves(player: Any, digest: Any, strip: bpy.types.NlaStrip | None = None) -> None:
    """Add the F-curves of animation data or a strip to a hash. strip: in whose time their keys are."""
    for curve in (*curves(player.action, player.action_slot), *getattr(player, "fcurves", ())):
        if strip and curve.id_data != strip.action:
            continue
        digest.update(f"{curve.data_path}[{curve.array_index}] {curve.extrapolation} {curve.mute}".encode())
        for name, width in (("co", 2), ("handle_left", 2), ("handle_right", 2), ("interpolation", 1)):
            values = np.empty(width * len(curve.keyframe_points), np.float32 if width == 2 else np.int32)
            curve.keyframe_points.foreach_get(name, values)
            if strip and width == 2 and (strip.scale, strip.frame_start) != (1.0, strip.action_frame_start):
                values[::2] = strip.frame_start + strip.scale * (values[::2] - strip.action_frame_start)
            digest.update(values.tobytes())
        for modifier in curve.modifiers:
            digest.update(repr(plain(modifier, skip=("active", "show_expanded"))).encode())
