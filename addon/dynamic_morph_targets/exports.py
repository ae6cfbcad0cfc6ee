# SPDX-License-Identifier: GPL-3.0-or-later
"""A baked character as a file of another format, and what that format will leave out.

Blender's own exporters write what Blender shows: glTF and FBX the shape keys as morph targets with their values at each
frame, Alembic and USD the posed surface. A raw clip is the bake alone, before skinning, for engines of one's own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from . import checks, clips, model_file, sinks
from .properties import followers, key_points, rig_of

MORPHS = 8  # that common engines and viewers blend at once
INFLUENCES = 4  # bones of a vertex that glTF writes


class ExportError(ValueError):
    """The character cannot be exported so. The message names what is in the way and what to do."""


@dataclass(frozen=True)
class Format:
    """suffix: of its files; write(obj, path, frames); skins: whether armature and keys are written, not their result;
    option: of bpy.app.build_options that it needs."""

    label: str
    suffix: str
    description: str
    write: Callable
    skins: bool = False
    option: str = ""

    @property
    def is_available(self) -> bool:
        return not self.option or getattr(bpy.app.build_options, self.option)


def export(obj, key: str, path: Path, frames: tuple[int, int]):
    """Write the baked `obj`, with its armature and what moves with its flesh, over `frames` (first, last) to `path`,
    whole or not at all.

    key: of FORMATS. Selection, frame, keys and curves are afterwards as before. Raises ExportError, OSError.
    """
    chosen = FORMATS[key]
    if not any(key.name in _keys(obj) for key in obj.dynamorph.bake.keys):
        raise ExportError(f"'{obj.name}' has no bake to export: press Bake first")
    if not chosen.is_available:
        raise ExportError(f"This Blender was built without {chosen.label}: choose another format")
    sinks.check_not_edited(obj)
    hidden = next((other for other in _together(obj) if not other.visible_get()), None)
    if hidden:
        raise ExportError(f"'{hidden.name}' is hidden, so Blender exports nothing of it: show it")
    if not path.parent.is_dir():
        raise ExportError(f"There is no folder '{path.parent}' to write '{path.name}' to: choose another")
    partial = path.with_name(f"{path.stem}.part{path.suffix}")  # exporters look at the suffix
    try:
        with _as_it_was(obj):
            chosen.write(obj, partial, frames)
        if not partial.is_file():
            raise ExportError(f"Blender's {chosen.label} exporter wrote nothing: its report says why")
        partial.replace(path)
    except RuntimeError as error:  # what an operator reports
        raise ExportError(f"'{obj.name}' could not be exported: {str(error).strip()}") from error
    finally:
        partial.unlink(missing_ok=True)


def losses(obj, key: str) -> Iterator[str]:
    """What the format will not show as Blender does, as sentences. Reads the scene only."""
    chosen = FORMATS[key]
    pieces = ", ".join(f"'{piece.name}'" for piece in followers(obj))
    if key == "RAW" and pieces:
        yield f"A raw clip is of one mesh: {pieces} is left out"
    if not chosen.skins:
        return
    modifiers = checks.armature_modifiers(obj)
    if not modifiers:
        yield f"'{obj.name}' has no Armature modifier: its bones are not written"
        return
    for modifier in obj.modifiers:
        if modifier not in modifiers and modifier.show_viewport:
            yield f"Modifier '{modifier.name}' is left out: {chosen.label} writes shape keys or modifiers, not both"
    if any(modifier.use_deform_preserve_volume for modifier in modifiers) or len(modifiers) > 1:
        yield "The armature skins by more than one linear blend (Preserve Volume, several modifiers): it will differ"
    if any(bone.bbone_segments > 1 for bone in checks.deforming_bones(obj, rig_of(obj))):
        yield f"Bendy bones are written straight: {chosen.label} has none"
    keys = _moving_keys(obj)
    if len(keys) > MORPHS:
        yield (
            f"{len(keys)} keys move: many engines blend {MORPHS} at most. Set Keys to {MORPHS} and bake again, or use "
            "Alembic or USD"
        )
    driven = [name for name in keys if name in _driven_keys(obj)]
    if driven:
        yield f"Drivers are left out, their values at each frame are written: {', '.join(driven)}"
    crowded = _crowded_vertices(obj)
    if key == "GLTF" and crowded:
        yield f"{crowded} vertices follow more than {INFLUENCES} bones: the weakest of them are dropped"


def _keys(obj):
    """The shape keys of `obj`, by name too; empty when the artist has removed all."""
    return obj.data.shape_keys.key_blocks if obj.data.shape_keys else {}


def _moving_keys(obj) -> list[str]:
    """The keys that count: not muted, and with a curve, a driver, or a value."""
    animated = _animated_keys(obj)
    return [name for name, key in list(_keys(obj).items())[1:] if not key.mute and (key.value or name in animated)]


def _animated_keys(obj) -> set[str]:
    baked = {key.name for key in obj.dynamorph.bake.keys}
    return baked | _driven_keys(obj)


def _driven_keys(obj) -> set[str]:
    animation = obj.data.shape_keys and obj.data.shape_keys.animation_data
    paths = [driver.data_path for driver in animation.drivers] if animation else []
    return {name for name, key in _keys(obj).items() if f"{key.path_from_id()}.value" in paths}


def _crowded_vertices(obj) -> int:
    bones = {bone.name for bone in checks.deforming_bones(obj, rig_of(obj))}
    groups = {group.index for group in obj.vertex_groups if group.name in bones}
    return sum(
        sum(element.group in groups and element.weight > 0.0 for element in vertex.groups) > INFLUENCES
        for vertex in obj.data.vertices
    )


# Writers -----------------------------------------------------------------------------------------------------------


def _write_gltf(obj, path: Path, frames):
    with _sampled(obj, frames):
        bpy.ops.export_scene.gltf(
            filepath=str(path), use_selection=True, export_animation_mode="SCENE", export_force_sampling=True,
            export_anim_scene_split_object=False,
            export_optimize_animation_size=False, export_morph_normal=False, export_frame_range=True,
        )  # fmt: skip


def _write_fbx(obj, path: Path, frames):
    with _sampled(obj, frames):
        bpy.ops.export_scene.fbx(
            filepath=str(path), use_selection=True, add_leaf_bones=False, bake_anim_use_nla_strips=False,
            bake_anim_use_all_actions=False, bake_anim_simplify_factor=0.0, use_mesh_modifiers=False,
        )  # fmt: skip


def _write_alembic(_obj, path: Path, frames):
    bpy.ops.wm.alembic_export(
        filepath=str(path), selected=True, start=frames[0], end=frames[1], uvs=True, normals=False,
        as_background_job=False,
    )  # fmt: skip


def _write_usd(_obj, path: Path, _frames):
    bpy.ops.wm.usd_export(
        filepath=str(path), selected_objects_only=True, export_animation=True, export_armatures=False,
        export_shapekeys=False, export_normals=False,
    )  # fmt: skip


def _write_raw(obj, path: Path, _frames):
    render = bpy.context.scene.render
    basis = key_points(obj.data.shape_keys.reference_key)
    model_file.save(path, clips.raw(sinks.read_back(obj), basis, render.fps / render.fps_base))


FORMATS = {
    "GLTF": Format("glTF", ".glb", "Morph targets and bones, for engines and the web", _write_gltf, skins=True),
    "FBX": Format("FBX", ".fbx", "Morph targets and bones, for engines and other packages", _write_fbx,
                  skins=True),
    "ALEMBIC": Format("Alembic", ".abc", "The posed surface at every frame", _write_alembic, option="alembic"),
    "USD": Format("USD", ".usdc", "The posed surface at every frame", _write_usd, option="usd"),
    "RAW": Format("Raw Clip", ".npz", "Modes and their values, for NumPy and runtime/dynamorph.h", _write_raw),
}  # fmt: skip


# Around the exporters ----------------------------------------------------------------------------------------------


def _together(obj) -> list:
    """The character: its mesh, its armature, and the meshes that its bake moves."""
    return [other for other in (obj, rig_of(obj), *followers(obj)) if other]


@contextmanager
def _as_it_was(obj):
    """The character alone selected; afterwards selection and frames as they were."""
    layer, scene, character = bpy.context.view_layer, bpy.context.scene, _together(obj)
    selected = [other for other in layer.objects if other.select_get()]
    active, frame = layer.objects.active, (scene.frame_current, scene.frame_subframe)
    ends = scene.frame_start, scene.frame_end
    try:
        for other in layer.objects:
            other.select_set(other in character)
        layer.objects.active = obj
        yield
    finally:
        for other in layer.objects:
            other.select_set(other in selected)
        layer.objects.active = active
        scene.frame_start, scene.frame_end = ends
        scene.frame_set(frame[0], subframe=frame[1])


@contextmanager
def _sampled(obj, frames):
    """The frames as the scene's, and `_sampled_keys` of the whole character."""
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = frames
    with ExitStack() as stack:
        for each in (obj, *followers(obj)):
            if each.data.shape_keys and each.data.shape_keys.animation_data:  # the artist may have removed them
                stack.enter_context(_sampled_keys(each, frames))
        yield


@contextmanager
def _sampled_keys(obj, frames):
    """The values that all keys have, whatever moves them, as plain curves of one Action: exporters look no further."""
    scene, keys = bpy.context.scene, obj.data.shape_keys
    times = np.arange(frames[0], frames[1] + 1)
    values = np.empty((len(times), len(keys.key_blocks)), np.float32)
    for row, frame in zip(values, times, strict=True):
        scene.frame_set(int(frame))
        keys.key_blocks.foreach_get("value", row)
    animation = keys.animation_data
    before = animation.action, animation.action_slot, animation.use_nla, [d.mute for d in animation.drivers]
    names = [block.name for block in keys.key_blocks]
    action = bpy.data.actions.new(obj.name)
    try:
        slot = action.slots.new(keys.id_type, obj.name)
        channels = action.layers.new("Layer").strips.new(type="KEYFRAME").channelbag(slot, ensure=True)
        for name, column in zip(names[1:], values.T[1:], strict=True):
            sinks.add_curve(channels, name, times, column)
        for driver in animation.drivers:
            driver.mute = True
        animation.use_nla = False
        animation.action, animation.action_slot = action, slot
        yield
    finally:
        animation.action = before[0]
        if before[1]:
            animation.action_slot = before[1]
        animation.use_nla = before[2]
        for driver, mute in zip(animation.drivers, before[3], strict=True):
            driver.mute = mute
        bpy.data.actions.remove(action)
