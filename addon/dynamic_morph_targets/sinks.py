# SPDX-License-Identifier: GPL-3.0-or-later
"""A bake -> Blender: modal shape keys, and their removal.

surface = vertices + modes . coordinates + details . weights becomes one shape key a mode and one a target's detail,
with the coordinates as F-curves. The curves sit in an Action of their own, as a strip on an NLA track, because an
animation data holds one Action and that is the artist's.
"""

from __future__ import annotations

import bpy
import numpy as np

from .properties import basis_hash, key_points, key_reach, reconcile
from .scene_data import Bake

TRACK = "Dynamorph"
NEGLIGIBLE = 1e-7  # of the bounding box: displacements that no key is made for
NAME_BYTES = 59  # Blender has room for 63, cuts within a letter, and may add ".001"
LINEAR = 1  # Keyframe.interpolation as foreach_set knows it


class SinkError(ValueError):
    """The result cannot be written here. The message names the data and what to do."""


def check(obj):
    """Refuse, before any work, data to which a bake cannot be written. Raises SinkError."""
    if obj.type != "MESH":
        raise SinkError(f"'{obj.name}' is not a mesh: select the character's mesh object")
    keys = obj.data.shape_keys
    if keys is None:
        raise SinkError(f"'{obj.name}' has no shape keys: add a Basis first")
    check_local(obj, obj.data, keys)
    users = sum(each.data == obj.data for each in bpy.data.objects)  # Mesh.users counts a fake user too
    if users > 1:
        raise SinkError(
            f"Mesh '{obj.data.name}' is shared by {users} objects, which would all move alike: "
            "make it single-user (Object > Relations > Make Single User > Object & Data)"
        )
    if obj.mode == "EDIT":
        raise SinkError(f"'{obj.name}' is in Edit Mode: leave it first")
    animation = keys.animation_data
    if animation is None:
        return
    if animation.use_tweak_mode:
        raise SinkError(f"The shape keys of '{obj.name}' are in NLA tweak mode: leave it first (Tab in the NLA editor)")
    if not animation.use_nla:
        raise SinkError(f"NLA is turned off for the shape keys of '{obj.name}': turn it on (Key in the NLA editor)")
    solo = next((track.name for track in animation.nla_tracks if track.is_solo), None)
    if solo is not None:
        raise SinkError(f"NLA track '{solo}' of the shape keys of '{obj.name}' is solo: turn its star off")


def check_local(*blocks):
    """Refuse data-blocks whose changes would not be saved. Raises SinkError."""
    for block in blocks:
        if block.library or block.override_library:
            how = "linked" if block.library else "a library override"
            raise SinkError(
                f"{block.bl_rna.name} '{block.name}' is {how}, so what is made here would be lost on save: make it "
                "local (Object > Relations > Make Local > Selected Objects and Data)"
            )


def write_modal_keys(obj, bake: Bake):
    """Write the bake as modal shape keys and F-curves, replacing the previous bake of `obj`. Raises SinkError.

    The old bake goes only when the new one is complete.
    """
    check(obj)
    reconcile(obj)
    if bake.modes.shape[1] != len(obj.data.vertices):
        raise SinkError(
            f"Mesh '{obj.name}' has {len(obj.data.vertices)} vertices, the bake {bake.modes.shape[1]}: bake again"
        )
    names, shapes, curves, lowest = _scaled_keys(bake, key_points(obj.data.shape_keys.reference_key))
    record = obj.dynamorph.bake
    old = _baked_names(obj)  # now: a new key may look like an old one, or take the name of one that was deleted
    before = obj.data.shape_keys.animation_data is not None
    had_animation_data = record.had_animation_data if record.keys else before
    active_index = obj.active_shape_key_index
    blocks, action = [], None
    try:
        for name, shape, low in zip(names, shapes, lowest, strict=True):
            blocks.append(_add_key(obj, name, shape, low))
        action = _add_curves(obj.data.shape_keys, [block.name for block in blocks], bake.frames, curves)
    except BaseException:
        _remove(obj, blocks, action)
        obj.active_shape_key_index = active_index
        if not before:
            obj.data.shape_keys.animation_data_clear()
        raise
    obj.active_shape_key_index = active_index
    temporary_names = [block.name for block in blocks]
    _free(obj, old)
    _record(obj, temporary_names, names, action, had_animation_data)
    _mute_targets(obj, bake.target_names)


def free(obj):
    """Remove the bake of `obj`, if any, and restore what it changed: keys, order, active key, mute, animation data.

    Raises SinkError.
    """
    if obj.dynamorph.bake.keys and obj.data.shape_keys:  # else the artist has removed all there was
        check(obj)
    reconcile(obj)
    _free(obj, _baked_names(obj))


def _baked_names(obj) -> list[str]:
    """Names of the shape keys that the bake added and that are still there; the references must be reconciled."""
    return [key.name for key in obj.dynamorph.bake.keys if key.name]


def _free(obj, names):
    record = obj.dynamorph.bake
    keys = obj.data.shape_keys
    if record.keys and keys:
        active = obj.active_shape_key.name if obj.active_shape_key else ""
        _remove(obj, [keys.key_blocks[name] for name in names], record.action)
        for key in record.muted:
            if key.name in keys.key_blocks:
                keys.key_blocks[key.name].mute = key.was_muted
        index = keys.key_blocks.find(active)
        obj.active_shape_key_index = index if index >= 0 else min(record.active_index, len(keys.key_blocks) - 1)
        animation = keys.animation_data
        unused = animation and not (animation.action or animation.nla_tracks or animation.drivers)
        if unused and not record.had_animation_data:
            keys.animation_data_clear()
    record.keys.clear()
    record.muted.clear()
    record.action = None
    record.summary = record.warnings = ""


def _scaled_keys(bake: Bake, basis: np.ndarray):
    """Keys as (names, shapes [(V, 3)], curves [(F,)], slider minima), each curve scaled into its slider's range.

    Blender clamps an animated value to its slider, so the largest coordinate becomes 1 and the shape takes the factor.
    """
    names, shapes, curves, lowest = [], [], [], []

    def add(name, displacement, curve, low):
        largest = np.abs(curve).max() or 1.0
        names.append(name)
        shapes.append((basis + largest * displacement).astype(np.float32))
        curves.append(curve / largest)
        lowest.append(low)

    negligible = NEGLIGIBLE * np.ptp(basis, axis=0).max()
    for k, mode in enumerate(bake.modes):
        add(f"Dynamorph Mode {k + 1:02d}", mode, bake.coordinates[:, k], -1.0)
    for j, detail in enumerate(bake.details):
        if np.abs(detail).max() * np.abs(bake.weights[:, j]).max() > negligible:
            name = f"Dynamorph Detail {bake.target_names[j]}".encode()[:NAME_BYTES].decode(errors="ignore")
            add(name, detail, bake.weights[:, j], 0.0)
    return names, shapes, curves, lowest


def _add_key(obj, name: str, points: np.ndarray, low: float):
    block = obj.shape_key_add(name=name, from_mix=False)
    block.value = 0.0  # 5.2 creates keys at 1
    block.relative_key = obj.data.shape_keys.reference_key
    block.slider_min, block.slider_max = low, 1.0
    block.points.foreach_set("co", points.ravel())
    return block


def _add_curves(keys, names, frames, curves):
    """An Action with one F-curve a key, on an NLA track of its own above the artist's; returns the Action."""
    render = bpy.context.scene.render
    times = frames * (render.frame_map_old / render.frame_map_new)  # at frame 10 of a remapped scene it may be time 5
    animation = keys.animation_data or keys.animation_data_create()
    action = bpy.data.actions.new(f"{TRACK} {keys.user.name}")
    slot = action.slots.new(keys.id_type, keys.name)
    channels = action.layers.new("Layer").strips.new(type="KEYFRAME").channelbag(slot, ensure=True)
    points = np.empty((len(frames), 2), np.float32)
    points[:, 0] = times
    linear = np.full(len(frames), LINEAR, np.int32)
    for name, values in zip(names, curves, strict=True):
        points[:, 1] = values
        curve = channels.fcurves.new(f'key_blocks["{bpy.utils.escape_identifier(name)}"].value')
        curve.keyframe_points.add(len(frames))
        curve.keyframe_points.foreach_set("co", points.ravel())
        curve.keyframe_points.foreach_set("interpolation", linear)
        curve.update()
    track = animation.nla_tracks.new()
    track.name = TRACK
    strip = track.strips.new(TRACK, int(times[0]), action)
    strip.action_slot = slot
    strip.frame_start, strip.frame_end = strip.action_frame_start, strip.action_frame_end  # a strip is made at a frame
    strip.extrapolation = "HOLD"  # the ends hold; other keys have no curve here, so they are left alone
    strip.blend_type = "REPLACE"
    return action


def _remove(obj, blocks, action):
    """Remove shape keys, and the Action with its strips and the tracks that then are empty."""
    keys = obj.data.shape_keys
    animation = keys.animation_data
    if animation and action:
        for track in list(animation.nla_tracks):
            for strip in [strip for strip in track.strips if strip.action == action]:
                track.strips.remove(strip)
                if not track.strips:
                    animation.nla_tracks.remove(track)
    for name in [block.name for block in blocks]:  # by name: each removal moves the others in memory
        obj.shape_key_remove(keys.key_blocks[name])
    recorded = obj.dynamorph.bake.action == action  # the record counts as a user
    if action and action.users == int(recorded):
        bpy.data.actions.remove(action)


def _record(obj, names, wanted, action, had_animation_data):
    """Give the new keys the names they should have, now that the old bake is gone, and note them."""
    blocks = obj.data.shape_keys.key_blocks
    record = obj.dynamorph.bake
    for name, want in zip(names, wanted, strict=True):
        index = blocks.find(name)
        if name != want and want not in blocks:
            blocks[index].name = want  # the curves' paths follow
        key = record.keys.add()
        key.refer_to(blocks, index)
        key.reach = key_reach(blocks[index])
    record.basis = basis_hash(blocks)
    record.action = action
    record.had_animation_data = had_animation_data
    record.active_index = obj.active_shape_key_index


def _mute_targets(obj, simulated):
    """The modal keys contain the targets' shapes, so the targets' own keys rest until Free Bake."""
    blocks = obj.data.shape_keys.key_blocks
    for target in obj.dynamorph.targets[1:]:
        index = blocks.find(target.name)
        if target.name not in simulated or index < 0:
            continue
        key = obj.dynamorph.bake.muted.add()
        key.refer_to(blocks, index)
        key.was_muted = blocks[index].mute
        blocks[index].mute = True
