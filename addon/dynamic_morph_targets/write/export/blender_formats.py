# SPDX-License-Identifier: GPL-3.0-or-later
"""Writers of the formats of Blender's own exporters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import bpy
import numpy as np

from ...io import glb
from ...scene.store import staleness
from ..actions import Clip
from ..bake import writer
from . import process


def write_gltf(
    _obj: bpy.types.Object, collection: str, path: Path, frames: tuple[int, int], takes: Sequence[Clip]
) -> None:
    with _sampled(collection, frames):
        bpy.ops.export_scene.gltf(
            filepath=str(path), collection=collection, export_animation_mode="SCENE", export_force_sampling=True,
            export_anim_scene_split_object=False,
            export_optimize_animation_size=False, export_morph_normal=False, export_frame_range=True,
            export_anim_slide_to_zero=True,
        )  # fmt: skip
    if takes:
        parts = {clip.name: (clip.first - frames[0], clip.last - frames[0]) for clip in takes}
        render = bpy.context.scene.render
        path.write_bytes(glb.split_animation(path.read_bytes(), parts, render.fps / render.fps_base))


def write_fbx(
    _obj: bpy.types.Object, collection: str, path: Path, frames: tuple[int, int], takes: Sequence[Clip]
) -> None:
    with _sampled(collection, frames):
        bpy.ops.export_scene.fbx(
            filepath=str(path), collection=collection, add_leaf_bones=False, bake_anim_use_nla_strips=bool(takes),
            bake_anim_use_all_actions=False, bake_anim_simplify_factor=0.0, use_mesh_modifiers=False,
        )  # fmt: skip


def write_alembic(
    obj: bpy.types.Object, collection: str, path: Path, frames: tuple[int, int], _takes: Sequence[Clip]
) -> None:
    samples = staleness.baked_samples(obj)
    process.export(
        "alembic", collection, path, frames, start=frames[0], end=frames[1], uvs=True, normals=False,
        xsamples=samples, gsamples=samples,
        as_background_job=False, export_custom_properties=False,  # Blender crashes on bytes such as a model's
    )  # fmt: skip


def write_usd(
    _obj: bpy.types.Object, collection: str, path: Path, frames: tuple[int, int], _takes: Sequence[Clip]
) -> None:
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = frames  # until `frames_kept`
    process.export(
        "usd", collection, path, frames, export_animation=True, export_armatures=False,
        export_shapekeys=False, export_normals=False, export_custom_properties=False,
    )  # fmt: skip


@contextmanager
def _sampled(collection: str, frames: tuple[int, int]) -> Iterator[None]:
    """Use the frames as the scene's, with `_sampled_keys` of all meshes of the collection."""
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = frames
    with ExitStack() as stack:
        for each in bpy.data.collections[collection].objects:
            keys = each.data.shape_keys if each.type == "MESH" else None  # the artist may have removed them
            if keys and keys.animation_data:
                stack.enter_context(_sampled_keys(each, frames))
        yield


@contextmanager
def _sampled_keys(obj: bpy.types.Object, frames: tuple[int, int]) -> Iterator[None]:
    """The values that all keys have, whatever moves them, as plain curves of one Action: exporters look no further."""
    scene, keys = bpy.context.scene, obj.data.shape_keys
    stretch = scene.render.frame_map_old / scene.render.frame_map_new
    times = np.arange(frames[0], frames[1] + 1)
    values = np.empty((len(times), len(keys.key_blocks)), np.float32)
    muted = np.empty(values.shape, bool)
    window = bpy.context.window_manager
    window.progress_begin(0, len(times))  # beside the pointer: Blender's exporters leave no room for more
    for k, (row, frame) in enumerate(zip(values, times, strict=True)):
        window.progress_update(k)
        scene.frame_set(int(frame))
        keys.key_blocks.foreach_get("value", row)
        keys.key_blocks.foreach_get("mute", muted[k])
    window.progress_end()
    animation = keys.animation_data
    before = animation.action, animation.action_slot, animation.use_nla, [d.mute for d in animation.drivers]
    names = [block.name for block in keys.key_blocks]
    shown = {block.name: (block.value, block.mute) for block in keys.key_blocks}
    values[muted] = 0.0  # FBX knows no muted keys
    keys.key_blocks.foreach_set("mute", muted.all(axis=0))
    action = bpy.data.actions.new(obj.name)
    try:
        slot = action.slots.new(keys.id_type, obj.name)
        channels = action.layers.new("Layer").strips.new(type="KEYFRAME").channelbag(slot, ensure=True)
        for name, column in zip(names[1:], values.T[1:], strict=True):
            writer.add_curve(channels, name, times * stretch, column)
        for driver in animation.drivers:
            driver.mute = True
        animation.use_nla = False
        animation.action, animation.action_slot = action, slot
        yield
    finally:
        animation.action = before[0]
        if before[0]:
            animation.action_slot = before[1]  # None too: Blender has chosen one
        animation.use_nla = before[2]
        for driver, mute in zip(animation.drivers, before[3], strict=True):
            driver.mute = mute
        for name, (value, mute) in shown.items():
            keys.key_blocks[name].value, keys.key_blocks[name].mute = value, mute
        bpy.data.actions.remove(action)
