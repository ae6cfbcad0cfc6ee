# SPDX-License-Identifier: GPL-3.0-or-later
"""A bake -> Blender: shape keys or a point cache, and their removal.

surface = vertices + modes . coordinates + residual_shapes . weights becomes a shape key for each mode and each
residual shape, with the coordinates as F-curves, in an Action of their own or in slots of the armature's
(`baked_action`), as strips on two NLA tracks, because the animation data's one Action is the artist's. The lower track
plays the targets' shapes, the upper one replaces them by the motion, as far as its influence says. In its place there
may be a point cache: a Mesh Cache modifier before all others.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import bpy
import numpy as np
from bpy.types import ID, Action, ActionChannelbag, ActionGroup, ActionSlot, AnimData, Object, ShapeKey

from ...core.errors import WriteError
from ...core.message import Message
from ...core.motion.baked import Bake
from ...core.result.slider_keys import Key, scaled_keys
from ...scene import animation
from ...scene.animation import GROUP, played
from ...scene.check import checks
from ...scene.read import identity
from ...scene.references import basis_hash, key_displacement, key_points
from ...scene.skin import cache_modifier, shown_attachments
from ..reconcile import reconcile
from . import on_override
from .baked_action import MOTION, SHAPES, BakedAction
from .before import Before
from .cache_player import play_cache
from .influence import carry_influence, keep_influence, strip_of
from .muting import leave_to_live, mute_targets, unmute_targets
from .reading import baked_names
from .removal import clear_unused, remove_keys, remove_modifier

LINEAR = 1  # the value of Keyframe.interpolation for foreach_set


def check(obj: Object, skin: Object | None = None) -> None:
    """Refuse, before any work, data to which a bake cannot be written. Raises WriteError.

    skin: the soft skin that `obj` is to follow, if it is none itself. Its Basis is created if there is none; that of a
    soft skin if the neutral target is alone.
    """
    if obj.type != "MESH":
        raise WriteError("'{name}' is not a mesh: select the character's mesh object", name=obj.name)
    keys = obj.data.shape_keys
    if keys is None and skin is None and len(obj.dynamorph.targets) != 1:
        raise WriteError("'{name}' has no shape keys: add a Basis first", name=obj.name)
    check_local(obj, obj.data, *filter(None, [keys]))
    for problem in checks.shared_mesh(obj):
        raise WriteError(problem.text)
    check_not_edited(obj)
    if not (keys and keys.animation_data):
        return
    check_not_tweaked(obj)
    animation = keys.animation_data
    targets = (skin or obj).dynamorph.targets[1:]
    solo = next((track.name for track in animation.nla_tracks if track.is_solo), None)
    paths = {f'key_blocks["{bpy.utils.escape_identifier(target.name)}"].mute' for target in targets}
    driven = next((driver.data_path for driver in animation.drivers if driver.data_path in paths), None)
    keyed = next((curve.data_path for curve in played(animation) if curve.data_path in paths), None)
    text = ""
    if not animation.use_nla:
        text = "NLA is turned off for the shape keys of '{name}': turn it on (Key in the NLA editor)"
    elif solo is not None:
        text = "NLA track '{track}' of the shape keys of '{name}' is solo: turn its star off"
    elif driven is not None:
        text = "'{name}': {key} has a driver, so a bake cannot mute the key: remove the driver"
    elif keyed is not None:
        text = "'{name}': {key} is animated, so a bake cannot mute the key: delete its keyframes"
    if text:
        raise WriteError(text, name=obj.name, track=solo, key=driven or keyed)


def check_bake(obj: Object, skin: Object | None = None) -> None:
    """The same, where a library override may get a point cache. Raises WriteError."""
    (on_override.check if obj.override_library else check)(obj, skin)


def check_not_tweaked(obj: Object) -> None:
    """Refuse shape keys whose Action Blender lets nobody change. Raises WriteError."""
    keys = obj.data.shape_keys
    if keys and keys.animation_data and keys.animation_data.use_tweak_mode:
        text = "The shape keys of '{name}' are in NLA tweak mode: leave it first (Tab in the NLA editor)"
        raise WriteError(text, name=obj.name)


def check_cache(obj: Object, folder: Path | None) -> None:
    """Refuse a point cache that has no place: folder is that of the .blend. Raises WriteError."""
    if folder is None:
        text = "The point cache of '{name}' goes into a folder beside the .blend: save the .blend first"
        raise WriteError(text, name=obj.name)


def overwritten_keys(obj: Object) -> list[str]:
    """The artist's own shape keys that move, and that a point cache overrides."""
    excluded = {target.name for target in obj.dynamorph.targets[1:]} | animation.baked_keys(obj)
    excluded |= identity.shifts(obj).keys()  # the cache has them
    return [name for name in animation.moving_keys(obj) if name not in excluded]


def check_not_edited(obj: Object) -> None:
    """Refuse Edit Mode, in which Blender removes no shape keys. Raises WriteError."""
    if obj.mode == "EDIT":
        raise WriteError("'{name}' is in Edit Mode: leave it first", name=obj.name)


def check_local(*blocks: ID) -> None:
    """Refuse data-blocks whose changes would not be saved. Raises WriteError."""
    for block in blocks:
        if block.library or block.override_library:
            how = "linked" if block.library else "a library override"
            raise WriteError(
                "{kind} '{name}' is {how}, so the result would be lost on save: make it local (Object > Relations > "
                "Make Local > Selected Objects and Data)",
                kind=block.bl_rna.name,
                name=block.name,
                how=how,
            )


def write_keys(obj: Object, bake: Bake, skin: Object | None = None, cache: Path | None = None) -> int:
    """Write the bake as shape keys and F-curves, replacing the previous bake of `obj`. Raises WriteError.

    The old bake goes only when the new one plays; its Influence stays. skin: the soft skin that `obj` follows,
    if it is none itself; its Basis is made if there is none. cache: a point cache (.pc2) that plays the motion,
    if the keys do not. Returns the bytes of keys and curves.
    """
    with ExitStack() as undo:
        undo.callback(Before(obj).restore)
        new = NewBake(obj, bake, skin, cache)
        undo.callback(new.take_back)
        new.add()
        new.show()
        undo.pop_all()
    new.remove_old()
    return new.size


def new_bake(
    obj: Object, bake: Bake, skin: Object | None = None, cache: Path | None = None
) -> NewBake | on_override.OverrideBake:
    """A bake of `obj`, which may be a library override; the arguments are those of `write_keys`. Raises WriteError."""
    return (on_override.OverrideBake if obj.override_library else NewBake)(obj, bake, skin, cache)


class NewBake:
    """A bake of `obj` that takes the place of another; the arguments are those of `write_keys`.

    `add` writes it beside the old one, `show` lets it play in the place of the old one, and `remove_old` removes that.
    Until then `take_back` and `Before.restore` undo everything.
    """

    def __init__(self, obj: Object, bake: Bake, skin: Object | None = None, cache: Path | None = None):
        """Changes nothing yet. Raises WriteError."""
        check(obj, skin)
        reconcile(obj)
        if bake.modes.shape[1] != len(obj.data.vertices):
            text = "Mesh '{name}' has {count} vertices, the bake {expected}: bake again"
            raise WriteError(text, name=obj.name, count=len(obj.data.vertices), expected=bake.modes.shape[1])
        self._obj, self._bake, self._skin, self._cache = obj, bake, skin, cache
        record, keys = obj.dynamorph.bake, obj.data.shape_keys
        self._followed = obj.dynamorph.follows
        self._old = baked_names(obj)  # now: a new key may look like an old one, or take the name of a deleted one
        self._old_cache = ""  # name of the old bake's modifier, if the new one does not use it
        self._old_action, self._old_index = BakedAction.of(obj), record.active_index
        self._had_animation_data = record.had_animation_data if record.exists else bool(keys and keys.animation_data)
        self._had_tracks = len(keys.animation_data.nla_tracks) if keys and keys.animation_data else 0
        self._had_names = keys.key_blocks.keys() if keys else ["Basis"]
        self._active_index = obj.active_shape_key_index
        self._keys: list[Key] = []
        self._names: list[str] = []  # temporary, because the old bake may still use the final names
        self._action = BakedAction(None)

    @property
    def size(self) -> int:
        """Bytes of keys and curves."""
        return sum(key.bytes() for key in self._keys)

    def add(self) -> None:
        """Write its keys and curves beside those of the old one."""
        obj = self._obj
        follow(obj, self._skin)
        self._keys = scaled_keys(self._bake, key_points(obj.data.shape_keys.reference_key))
        for key in self._keys:
            self._names.append(_add_key(obj, key).name)
        self._action = BakedAction.new(obj, self._skin or obj)
        _add_curves(obj.data.shape_keys, self._action, self._names, self._bake.frames, self._keys)
        obj.active_shape_key_index = self._active_index

    def take_back(self) -> None:
        """Remove what `add` has written, however far it came."""
        obj, keys = self._obj, self._obj.data.shape_keys
        if keys is None:
            return
        tracks = keys.animation_data.nla_tracks if keys.animation_data else []
        for track in list(tracks)[self._had_tracks :]:
            tracks.remove(track)
        for name in set(keys.key_blocks.keys()) - set(self._had_names):
            obj.shape_key_remove(keys.key_blocks[name])
        self._action.take_back()
        obj.active_shape_key_index = self._active_index
        clear_unused(keys, self._had_animation_data)
        if self._followed is None:
            leave(obj)

    def show(self) -> None:
        """Let it be the bake of its object. The old one stays, muted, and nothing refers to it any more."""
        obj, record, modifier = self._obj, self._obj.dynamorph.bake, cache_modifier(self._obj)
        keep_influence(strip_of(obj.data.shape_keys, self._old_action), strip_of(obj.data.shape_keys, self._action))
        for name in self._old:
            obj.data.shape_keys.key_blocks[name].mute = True
        unmute_targets(obj, record.muted)
        if modifier and not self._cache:
            modifier.show_viewport = modifier.show_render = False
            self._old_cache, record.cache = modifier.name, ""
        self._record()
        if self._cache:
            play_cache(obj, self._cache, self._bake, self._skin)
        mute_targets(obj, record.muted, self._bake.target_names, self._skin)

    def _record(self) -> None:
        record, blocks = self._obj.dynamorph.bake, self._obj.data.shape_keys.key_blocks
        record.keys.clear()
        for name in self._names:
            index = blocks.find(name)
            key = record.keys.add()
            key.refer_to(blocks, index)
            key.reach = key_displacement(blocks[index])
        record.basis = basis_hash(blocks)
        self._action.record(record)
        record.slot = (self._skin or self._obj).dynamorph.live.slot
        record.had_animation_data = self._had_animation_data
        record.active_index = self._obj.active_shape_key_index
        record.summary = record.warnings = record.verdict = ""
        record.off_full = -1.0

    def remove_old(self) -> list[Message]:
        """Remove the bake that it has replaced, and take its names. Returns what the artist should know."""
        obj, record = self._obj, self._obj.dynamorph.bake
        messages = self._carry_influence()
        if self._old_cache:
            remove_modifier(obj, obj.modifiers[self._old_cache])
        messages += remove_keys(obj, self._old, self._old_action, self._old_index, self._names)
        self._action.name_slots()
        record.active_index = obj.active_shape_key_index
        blocks = obj.data.shape_keys.key_blocks
        for reference, name, key in zip(record.keys, self._names, self._keys, strict=True):
            index = blocks.find(name)
            if name != key.name and key.name not in blocks:
                blocks[index].name = key.name  # the curves' paths follow
            reference.refer_to(blocks, index)
        return messages + self._overridden()

    def _overridden(self) -> list[Message]:
        """Keyframes of the artist's on baked keys, such as a keying set adds, which play instead of the bake."""
        keys = self._obj.data.shape_keys
        paths = {f"{keys.key_blocks[key.name].path_from_id()}.value": key.name for key in self._obj.dynamorph.bake.keys}
        curves = played(keys.animation_data) if keys.animation_data else ()
        ours = self._action.action
        others = {(paths[c.data_path], c.id_data.name) for c in curves if c.data_path in paths and c.id_data != ours}
        text = (
            "'{key}' of '{name}' has keyframes in Action '{action}', which play instead of the bake: delete them there"
        )
        return [Message(text, key=key, name=self._obj.name, action=action) for key, action in sorted(others)]

    def _carry_influence(self) -> list[Message]:
        """Between shape keys and a point cache; what follows takes it from the soft skin."""
        obj = self._obj
        old = obj.modifiers[self._old_cache] if self._old_cache else strip_of(obj.data.shape_keys, self._old_action)
        new = cache_modifier(obj) if self._cache else strip_of(obj.data.shape_keys, self._action)
        if self._skin or not old or not new or old.bl_rna == new.bl_rna:
            return []
        messages = []
        if not carry_influence(obj, old, new):
            messages.append(
                Message("'{name}': the animation of its Influence could not be carried along", name=obj.name)
            )
        drivers = obj.animation_data.drivers if obj.animation_data and self._old_cache else ()
        if any(driver.data_path == old.path_from_id("factor") for driver in drivers):
            text = "'{name}': the driver of its Influence was removed: only that of a point cache can have one"
            messages.append(Message(text, name=obj.name))
        return messages


def ensure_basis(obj: Object) -> None:
    """Create the shape key that the others are relative to, unless it exists."""
    if obj.data.shape_keys is None:
        obj.shape_key_add(name="Basis", from_mix=False)


def follow(obj: Object, skin: Object | None) -> None:
    """Record that `obj` will show the motion of the soft skin `skin`, in shape keys; None: its own."""
    settings = obj.dynamorph
    if settings.follows != skin:
        settings.had_keys = settings.had_keys if settings.follows else obj.data.shape_keys is not None
        settings.follows = skin
    ensure_basis(obj)


def leave(obj: Object) -> None:
    """The inverse of `follow`, after the keys are removed."""
    settings, keys = obj.dynamorph, obj.data.shape_keys
    if settings.follows is None:
        return
    settings.follows = None
    unused = keys and len(keys.key_blocks) == 1 and not keys.animation_data  # else the artist, or a new bake, has keys
    if unused and not settings.had_keys:
        obj.shape_key_clear()


def free(obj: Object) -> list[Message]:
    """Remove the bake of `obj` and of what follows it, if any, and restore what it changed: keys, order, active key,
    mute, animation data. Returns what the artist should know. Raises WriteError.
    """
    baked, messages = (obj, *shown_attachments(obj)), []
    for each in baked:
        check_free(each)
    for each in baked:
        if each.override_library:
            on_override.free(each)
            continue
        reconcile(each)
        messages += _free(each, baked_names(each))
        if not each.dynamorph.live.key.name:  # which it still shows
            leave(each)
    return messages


def check_free(obj: Object) -> None:
    """Refuse, before any work, data that a bake cannot be removed from. Raises WriteError."""
    if obj.override_library:
        check_not_edited(obj)
    elif obj.dynamorph.bake.exists and obj.data.shape_keys:  # otherwise the artist has removed everything
        check(obj)


def _free(obj: Object, names: list[str]) -> list[Message]:
    record, keys, messages = obj.dynamorph.bake, obj.data.shape_keys, []
    if record.exists and keys:
        messages = remove_keys(obj, names, BakedAction.of(obj), record.active_index)
        clear_unused(keys, record.had_animation_data)
    if obj.dynamorph.live.key.name:
        leave_to_live(obj)
    else:
        unmute_targets(obj, record.muted)
    modifier = cache_modifier(obj)
    if modifier:
        remove_modifier(obj, modifier)
    record.cache = record.summary = record.warnings = record.verdict = ""
    record.keys.clear()
    BakedAction(None).record(record)
    record.off_full = -1.0
    return messages


def _add_key(obj: Object, key: Key) -> ShapeKey:
    block = obj.shape_key_add(name=key.name, from_mix=False)
    block.value = 0.0  # 5.2 creates keys at 1
    block.relative_key = obj.data.shape_keys.reference_key
    block.slider_min, block.slider_max = key.lowest, 1.0
    block.points.foreach_set("co", key.points.ravel())
    return block


def _add_curves(
    keys: bpy.types.Key, action: BakedAction, names: list[str], frames: np.ndarray, values: list[Key]
) -> None:
    """The curves in new slots, on NLA tracks above the artist's: without the motion, and with it."""
    render = bpy.context.scene.render
    times = frames * (render.frame_map_old / render.frame_map_new)  # frame 10 of a remapped scene may be time 5
    animation = keys.animation_data or keys.animation_data_create()
    for title, curves in ((SHAPES, [key.shapes for key in values]), (MOTION, [key.motion for key in values])):
        if all(curve is None for curve in curves):
            continue
        slot, channels = action.add_slot(keys, title)
        group = channels.groups.new(GROUP)
        for name, curve in zip(names, curves, strict=True):
            if curve is not None:
                add_curve(channels, name, times, curve, group)
        _add_track(animation, title, action.action, slot, times)


def add_curve(
    channels: ActionChannelbag, name: str, times: np.ndarray, values: np.ndarray, group: ActionGroup | None = None
) -> None:
    """A curve of the value of the key `name`, linear between the times; runs of equal values keep only their ends.
    group: of the curve, if any.
    """
    points = np.column_stack([times, values]).astype(np.float32)
    same = points[1:, 1] == points[:-1, 1]
    points = points[~(np.r_[False, same] & np.r_[same, False])]
    curve = channels.fcurves.new(f'key_blocks["{bpy.utils.escape_identifier(name)}"].value')
    if group:
        curve.group = group
    curve.keyframe_points.add(len(points))
    curve.keyframe_points.foreach_set("co", points.ravel())
    curve.keyframe_points.foreach_set("interpolation", np.full(len(points), LINEAR, np.int32))
    curve.update()


def _add_track(animation: AnimData, title: str, action: Action, slot: ActionSlot, times: np.ndarray) -> None:
    track = animation.nla_tracks.new()
    track.name = title
    strip = track.strips.new(title, int(times[0]), action)
    strip.action_slot = slot
    strip.action_frame_start, strip.action_frame_end = times[0], max(times[-1], times[0] + 1)
    strip.frame_start, strip.frame_end = strip.action_frame_start, strip.action_frame_end  # it was made at whole frames
    strip.extrapolation = "HOLD"  # the ends hold; other keys have no curve here, so they are left alone
    strip.blend_type = "REPLACE"
    if title == MOTION:
        strip.use_animated_influence = True
        strip.fcurves.find("influence").keyframe_points.clear()  # or the slider would spring back to its one key
        strip.influence = 1.0
