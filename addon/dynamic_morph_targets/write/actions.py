# SPDX-License-Identifier: GPL-3.0-or-later
"""A clip for each Action of a character's armature, as games use them: its place in time, and its simulation.

The Actions are laid out one after the other as NLA strips, replacing the artist's own animation while a `with` block
lasts. A bone that one of them moves and another does not is at rest in the other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import bpy

from ..core.errors import SceneError
from ..scene import animation
from ..scene.references import rig_of

POSE = "pose.bones["  # begins the path of what an Action does to a bone
ASIDE = "Dynamorph Aside"  # temporary name of other data with the name of a clip


@dataclass(frozen=True)
class Clip:
    """An Action, by name, and its place: from its own frame `begin` on it occupies the scene's frames `first` to
    `last`. cyclic: it is a loop.
    """

    name: str
    begin: int
    first: int
    last: int
    cyclic: bool

    @property
    def end(self) -> int:
        return self.begin + self.last - self.first


def clips_of(obj: bpy.types.Object) -> list[Clip]:
    """Every Action that moves bones that skin `obj`, over its own range. Actions of a single frame are poses, and left
    out. Raises SceneError.
    """
    rig, render = rig_of(obj), bpy.context.scene.render
    if rig is None:
        raise SceneError(
            "'{name}' has no Armature modifier with an armature: it has no Actions to export", name=obj.name
        )
    if not rig.is_editable:
        raise SceneError("'{name}' is linked, so its Actions cannot be played in turn: make it local", name=rig.name)
    if rig.animation_data and rig.animation_data.use_tweak_mode:
        raise SceneError("'{name}' is in NLA tweak mode: leave it first (Tab in the NLA editor)", name=rig.name)
    if render.frame_map_old != render.frame_map_new:
        raise SceneError("The scene stretches time, clips have their own: set Time Stretching to 100 (Output tab)")
    found, first = [], 1
    for action in bpy.data.actions:
        begin, end = _frames(action)
        if end > begin and _slot(action, rig):
            if bpy.data.actions.get(action.name) != action:  # it is linked
                raise SceneError(
                    "There are two Actions '{name}', one of them linked: rename the local one", name=action.name
                )
            last = first + end - begin
            found.append(Clip(action.name, begin, first, last, action.use_cyclic))
            first = last + 2
    if not found:
        raise SceneError("No Action moves bones of '{name}': make one for each clip", name=rig.name)
    return found


@contextmanager
def laid_out(rig: bpy.types.Object, clips: Sequence[Clip]) -> Iterator[None]:
    """`lay_out` for the duration of a `with` block, on an armature object that is restored afterward."""
    had = rig.animation_data is not None
    animation = rig.animation_data or rig.animation_data_create()
    before = animation.action, animation.action_slot, animation.use_nla
    tracks = [(track, track.mute, track.is_solo) for track in animation.nla_tracks]
    strips = [(strip, strip.name) for track in animation.nla_tracks for strip in track.strips]
    values = _values(rig, clips)
    try:
        lay_out(rig, clips)
        yield
    finally:
        for track in list(animation.nla_tracks)[len(tracks) :]:
            animation.nla_tracks.remove(track)
        for strip, name in strips:
            strip.name = name
        for track, mute, is_solo in tracks:
            track.mute = mute
            if is_solo:
                track.is_solo = True
        animation.use_nla = before[2]
        animation.action = before[0]
        if before[0]:
            animation.action_slot = before[1]  # None too: Blender has chosen one
        if not had:
            rig.animation_data_clear()
        for path, value in values.items():
            _set(rig, path, value)


def lay_out(owner: bpy.types.ID, clips: Sequence[Clip], original: bpy.types.ID | None = None) -> None:
    """Make the clips strips of `owner`, an armature object or shape keys, on which nothing else then plays. original:
    what `owner` is a copy of, if it is one; its slots are those that count.
    """
    slots = [_slot(_action(clip), original or owner) for clip in clips]  # before the owner is no user of its slot
    animation = owner.animation_data or owner.animation_data_create()
    for track in animation.nla_tracks:
        track.mute = True
        if track.is_solo:
            track.is_solo = False
        for strip in track.strips:
            strip.name = ASIDE  # no two have the same name, and FBX writes it
    animation.action, animation.use_nla = None, True
    for clip, slot in zip(clips, slots, strict=True):
        if slot:
            _fill(animation.nla_tracks.new(), clip, _action(clip), slot)


def _action(clip: Clip) -> bpy.types.Action:
    action = bpy.data.actions.get(clip.name)
    if action is None:
        raise SceneError("Action '{name}' was removed or renamed meanwhile: start again", name=clip.name)
    return action


def _fill(track: bpy.types.NlaTrack, clip: Clip, action: bpy.types.Action, slot: bpy.types.ActionSlot) -> None:
    track.name = clip.name
    strip = track.strips.new(clip.name, clip.first, action)
    strip.name = clip.name
    strip.action_slot = slot
    strip.action_frame_start, strip.action_frame_end = clip.begin, clip.end
    strip.frame_start, strip.frame_end = clip.first, clip.last
    strip.extrapolation, strip.blend_type = "NOTHING", "REPLACE"


def _frames(action: bpy.types.Action) -> tuple[int, int]:
    """Its first frame and its last. Those of a bake that is in slots of the Action do not count."""
    found = [curve for slot in action.slots for curve in animation.curves(action, slot)]
    own = [curve.range() for curve in found if not animation.is_baked(curve)]
    ends = action.frame_range
    if own and len(own) < len(found) and not action.use_frame_range:
        ends = min(first for first, _ in own), max(last for _, last in own)
    return math.floor(ends[0]), math.ceil(ends[1])


def _slot(action: bpy.types.Action, owner: bpy.types.ID) -> bpy.types.ActionSlot | None:
    """The slot of an Action that moves `owner`, for an armature object its bones; preferably the one that it plays,
    or one with its name. Or None. What another one plays, or is named after another one, belongs to that.
    """
    fitting = [slot for slot in action.slots if slot.target_id_type in {owner.id_type, "UNSPECIFIED"}]
    fitting = [slot for slot in fitting if owner in (slot.users() or [_namesake(slot, owner)])]
    for slot in sorted(fitting, key=lambda slot: (owner not in slot.users(), slot.name_display != owner.name)):
        paths = [curve.data_path for curve in animation.curves(action, slot) if not animation.is_baked(curve)]
        if any(_has(owner, path) for path in paths if owner.id_type == "KEY" or path.startswith(POSE)):
            return slot
    return None


def _namesake(slot: bpy.types.ActionSlot, owner: bpy.types.ID) -> bpy.types.ID:
    """The armature object that is named as a slot and has its bones; else `owner`. Shape keys have no names that an
    artist gives.
    """
    named = bpy.data.objects.get(slot.name_display) if owner.id_type == "OBJECT" else None
    if named is None or named.type != owner.type:
        return owner
    paths = (curve.data_path for curve in animation.curves(slot.id_data, slot))
    return named if any(_has(named, path) for path in paths if path.startswith(POSE)) else owner


def _has(owner: bpy.types.ID, path: str) -> bool:
    try:
        owner.path_resolve(path)
    except ValueError:
        return False
    return True


def _values(owner: bpy.types.ID, clips: Sequence[Clip]) -> dict:
    """The values that the clips would change, by path: Blender leaves the last evaluated values in place."""
    actions = [_action(clip) for clip in clips]
    paths = {curve.data_path for action in actions for curve in animation.curves(action, _slot(action, owner))}
    found = {path: owner.path_resolve(path) for path in paths if _has(owner, path)}
    return {path: value if isinstance(value, str | int | float) else tuple(value) for path, value in found.items()}


def _set(owner: bpy.types.ID, path: str, value: Any) -> None:
    """The inverse of `path_resolve`; a path ends with .name or, of a custom property, with ["name"]."""
    if path.endswith('"]'):
        where, _, name = path[:-2].rpartition('["')
        (owner.path_resolve(where) if where else owner)[bpy.utils.unescape_identifier(name)] = value
    else:
        where, _, name = path.rpartition(".")
        setattr(owner.path_resolve(where) if where else owner, name, value)
