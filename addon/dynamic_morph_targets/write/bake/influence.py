# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of a bake is shown: the influence of its strip in the NLA, which can be animated."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import bpy
import numpy as np

from ...scene import animation
from ...scene.skin import cache_modifier, shown_attachments
from .baked_action import MOTION, SHAPES, BakedAction

# The timing properties of a strip. The ends come last, because the others move them.
TIMING = (
    "extrapolation", "use_reverse", "action_frame_start", "action_frame_end", "scale", "repeat", "frame_start_raw",
    "frame_end_raw",
)  # fmt: skip


def influence(obj: bpy.types.Object) -> tuple | None:
    """What controls how much of the bake's motion shows: an NLA strip or a modifier, and the name of its property; None
    without.
    """
    if modifier := cache_modifier(obj):
        return modifier, "factor"
    strip = influence_strip(obj)
    return strip and (strip, "influence")


def influence_strip(obj: bpy.types.Object) -> bpy.types.NlaStrip | None:
    """The NLA strip that plays the bake's motion, or None."""
    keys = obj.data.shape_keys
    return keys and strip_of(keys, BakedAction.of(obj))


def show_influence(obj: bpy.types.Object) -> None:
    """Make Blender evaluate again, which it does not do by itself when an influence is set."""
    strip = influence_strip(obj)
    if strip:
        strip.mute = strip.mute
        share_strip(obj)


def share_strip(obj: bpy.types.Object) -> None:
    """Let the strip of the targets' shapes, and the strips of what follows a soft skin, play when that of its motion
    does; what follows with the same influence, set or animated. Strips that were cut or doubled stay as they are.
    """
    motion = _strips(obj.data.shape_keys, BakedAction.of(obj), MOTION)
    for other in (obj, *shown_attachments(obj)) if motion else ():
        shapes, moving = (_strips(other.data.shape_keys, BakedAction.of(other), t) for t in (SHAPES, MOTION))
        for strips in (shapes, moving):
            if len(motion) == len(strips) == 1:
                _keep_timing(motion[0], strips[0])
        if moving and _influence(moving[0]) != _influence(motion[0]):
            keep_influence(motion[0], moving[0])
            moving[0].mute = moving[0].mute


def strip_of(keys: bpy.types.Key | None, baked: BakedAction) -> bpy.types.NlaStrip | None:
    """The first strip that plays the motion of a bake, or None."""
    return next(iter(_strips(keys, baked, MOTION)), None)


def _strips(keys: bpy.types.Key | None, baked: BakedAction, title: str) -> list:
    """The strips that play a slot of a bake."""
    slot = baked.slot(title)
    if slot is None or keys is None or keys.animation_data is None:
        return []
    strips = [strip for strip in animation.strips(keys.animation_data.nla_tracks) if strip.action == baked.action]
    return [strip for strip in strips if strip.action_slot == slot]


def _keep_timing(old: bpy.types.NlaStrip, new: bpy.types.NlaStrip) -> None:
    """Make a strip play when another does."""
    if any(getattr(old, name) != getattr(new, name) for name in TIMING):
        for name in TIMING:
            setattr(new, name, getattr(old, name))


def _influence(strip: bpy.types.NlaStrip) -> tuple:
    """The influence of a strip, set or animated, for comparison."""
    curve = strip.fcurves.find("influence")
    points = np.empty(2 * len(curve.keyframe_points) if curve else 0, np.float32)
    if curve:
        curve.keyframe_points.foreach_get("co", points)
    return strip.influence, points.tobytes()


def keep_influence(old: Any, new: bpy.types.NlaStrip | None) -> None:
    """Set the influence of a strip as the artist has set or animated that of another; both may be None."""
    curve = old and old.fcurves.find("influence")
    if not (curve and new):
        return
    new.influence = old.influence
    _copy_points(curve, new.fcurves.find("influence"))


def carry_influence(
    obj: bpy.types.Object, old: bpy.types.NlaStrip | bpy.types.Modifier, new: bpy.types.NlaStrip | bpy.types.Modifier
) -> bool:
    """The same for a bake that takes another form: one of the two is the modifier of a point cache, on `obj`. Returns
    whether all of it could be written.
    """
    value, curve = getattr(old, _property(old)), _curve_of(obj, old)
    points = curve and len(curve.keyframe_points)
    if not points:
        _remove_curve(obj, new)  # of an earlier bake
        setattr(new, _property(new), value)
        return not _is_in_strips(obj, old)
    setattr(new, _property(new), value)
    with suppress(RuntimeError, TypeError):  # the object's Action is linked
        new.keyframe_insert(_property(new), frame=curve.keyframe_points[0].co[0])
    copy = _curve_of(obj, new)
    if copy is None:
        return False
    _copy_points(curve, copy)
    _remove_curve(obj, old)
    return True


def _remove_curve(obj: bpy.types.Object, owner: bpy.types.NlaStrip | bpy.types.Modifier) -> None:
    """For a modifier alone: that of a strip goes with it."""
    curve = None if hasattr(owner, "influence") else _curve_of(obj, owner)
    if curve and obj.animation_data.action.is_editable:
        animation.remove_curve(obj.animation_data.action, obj.animation_data.action_slot, curve)


def _property(owner: bpy.types.NlaStrip | bpy.types.Modifier) -> str:
    return "influence" if hasattr(owner, "influence") else "factor"


def _curve_of(obj: bpy.types.Object, owner: bpy.types.NlaStrip | bpy.types.Modifier) -> Any:
    """The curve of the influence of a strip or of a modifier of `obj`, or None."""
    if hasattr(owner, "influence"):
        return owner.fcurves.find("influence")
    data, path = obj.animation_data, owner.path_from_id("factor")
    found = animation.curves(data.action, data.action_slot) if data else []
    return next((curve for curve in found if curve.data_path == path), None)


def _is_in_strips(obj: bpy.types.Object, owner: bpy.types.NlaStrip | bpy.types.Modifier) -> bool:
    """Whether strips of the NLA animate the influence of a modifier of `obj`."""
    data = None if hasattr(owner, "influence") else obj.animation_data
    return bool(data) and owner.path_from_id("factor") in {curve.data_path for curve in animation.played(data)}


def _copy_points(curve: bpy.types.FCurve, copy: bpy.types.FCurve) -> None:
    copy.keyframe_points.clear()
    copy.extrapolation = curve.extrapolation
    copy.keyframe_points.add(len(curve.keyframe_points))
    handles = ("handle_left_type", "handle_right_type", "handle_left", "handle_right")
    for point, same in zip(curve.keyframe_points, copy.keyframe_points, strict=True):
        for name in ("co", *handles, "interpolation", "easing"):
            setattr(same, name, getattr(point, name))
    copy.update()
