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

from . import actions, checks, clips, glb, jobs, live_key, model_file, sinks
from .properties import followers, key_points, rig_of

MORPHS = 8  # that common engines and viewers blend at once
INFLUENCES = 4  # bones of a vertex that glTF writes


class ExportError(ValueError):
    """The character cannot be exported so. The message names what is in the way and what to do."""


@dataclass(frozen=True)
class Format:
    """suffix: of its files; write(obj, path, frames, takes); skins: whether it has armature and keys, and so a clip for
    each Action; surface: whether it has what they result in; option: of bpy.app.build_options that it needs."""

    label: str
    suffix: str
    description: str
    write: Callable
    skins: bool = False
    surface: bool = False
    option: str = ""

    @property
    def is_available(self) -> bool:
        return not self.option or getattr(bpy.app.build_options, self.option)


def export(obj, key: str, path: Path, frames: tuple[int, int], takes="SCENE", tick=None) -> list[str]:
    """Write `obj`, with its armature and all meshes on that, to `path`, whole or not at all; returns warnings.

    key: of FORMATS. takes: SCENE, the bake over `frames` (first, last), or ACTIONS, see `ActionsExport`; tick(batch) is
    then called about ten times a second. Selection, frame, keys and curves are afterwards as before. Raises
    ExportError, OSError, and with ACTIONS as `jobs.run`.
    """
    if takes == "ACTIONS":
        batch = ActionsExport(obj, key, path)
        jobs.run_all(batch, tick)
        return batch.warnings
    check_place(obj, key, path)
    check_bake(obj, key)
    _write(obj, key, path, frames)
    return []


class ActionsExport(jobs.Batch):
    """Simulates a clip for each Action that moves the armature of `obj`, with the model as it is built, and writes all
    to `path`, whole or not at all: an animation for each, by its name, of bones and of shape keys that all clips share.

    It needs no bake, and leaves the one that there is as it is. key: of a format that skins. Raises ExportError, and as
    `actions.clips_of` and `jobs.Batch`.
    """

    def __init__(self, obj, key: str, path: Path):
        check_place(obj, key, path)
        if not FORMATS[key].skins:
            raise ExportError(
                f"{FORMATS[key].label} has one animation only: choose glTF or FBX for one for each Action"
            )
        if obj.dynamorph.model.solver == "FULL" and obj.dynamorph.model.method != "STATIC":
            raise ExportError(
                f"'{obj.name}': clips share their shape keys, and the Full solver makes others for each: choose Reduced"
            )
        self.key, self.path = key, path
        self.clips = actions.clips_of(obj)
        super().__init__([actions.ClipJob(obj, clip, self.clips) for clip in self.clips], "EXPORT_ACTIONS")

    @property
    def warnings(self) -> list[str]:
        return [f"{job.clip.name}: {warning}" for job in self.jobs for warning in job.warnings]

    def steps(self, seconds: float = np.inf, pause: float = 0.1) -> Iterator[None]:
        yield from super().steps(seconds, pause)
        self._write_clips()

    def _write_clips(self):
        obj, job = self.jobs[0].target(), self.jobs[0]
        pieces = [jobs.find(follower.session_uid) for follower in job.followers]
        wholes = [actions.joined(each) for each in zip(*([job.result, *job.carried] for job in self.jobs), strict=True)]
        budget = obj.dynamorph.output.keys
        wholes = [clips.with_fewer_keys(bake, budget) if budget else bake for bake in wholes]
        bakes = [bake for whole in wholes for bake in job.of_meshes(whole)]
        with ExitStack() as stack:
            stack.enter_context(_as_it_was(obj))
            stack.enter_context(actions.laid_out(rig_of(obj), self.clips))
            copies = stack.enter_context(_stand_ins((obj, *pieces)))
            for copy, bake in zip(copies, bakes, strict=True):
                skin = None if copy == copies[0] else copies[0]
                live_key.remove(copy)
                if copy.data.shape_keys:
                    actions.lay_out(copy.data.shape_keys, self.clips)
                sinks.write_keys(copy, bake, skin)
            frames = self.clips[0].first, self.clips[-1].last
            _write(copies[0], self.key, self.path, frames, self.clips, without=(obj, *pieces))


def check_place(obj, key: str, path: Path):
    """Refuse, before any work, what cannot be written. Raises ExportError, sinks.SinkError."""
    chosen = FORMATS[key]
    if not chosen.is_available:
        raise ExportError(f"This Blender was built without {chosen.label}: choose another format")
    sinks.check_not_edited(obj)
    hidden = next((other for other in (obj, rig_of(obj), *followers(obj)) if other and not other.visible_get()), None)
    if hidden:
        raise ExportError(f"'{hidden.name}' is hidden, so Blender exports nothing of it: show it")
    if not path.parent.is_dir():
        raise ExportError(f"There is no folder '{path.parent}' to write '{path.name}' to: choose another")


def _write(obj, key: str, path: Path, frames: tuple[int, int], takes=(), without=()):
    """Write the character of `obj` as it shows; takes: the clips that are laid out, if each is to be an animation;
    without: meshes that others stand in for.

    Raises ExportError, OSError.
    """
    chosen = FORMATS[key]
    partial = path.with_name(f"{path.stem}.part{path.suffix}")  # exporters look at the suffix
    try:
        with _as_it_was(obj, without):
            chosen.write(obj, partial, frames, takes)
        if not partial.is_file():
            raise ExportError(f"Blender's {chosen.label} exporter wrote nothing: its report says why")
        partial.replace(path)
    except RuntimeError as error:  # what an operator reports
        raise ExportError(f"'{obj.name}' could not be exported: {str(error).strip()}") from error
    finally:
        partial.unlink(missing_ok=True)


def check_bake(obj, key: str):
    """Refuse a bake that is not there, or not in the form that the format writes. Raises ExportError."""
    chosen = FORMATS[key]
    record = obj.dynamorph.bake
    keys = checks.baked_keys(obj).intersection(checks.keys_of(obj).keys())
    shown = sinks.cache_modifier(obj) if record.cache else keys
    if not shown:
        raise ExportError(f"'{obj.name}' has no bake to export: press Bake first")
    if record.cache and not chosen.surface:
        raise ExportError(
            f"The bake of '{obj.name}' is a point cache, {chosen.label} writes shape keys: bake to Shape Keys first, "
            "or choose Alembic or USD"
        )


def losses(obj, key: str, takes="SCENE") -> Iterator[str]:
    """What the format will not show as Blender does, as sentences; takes: as for `export`. Reads the scene only."""
    if key == "RAW":
        yield from _raw_losses(obj)
    elif FORMATS[key].skins:
        planned = _planned_keys(obj) if takes == "ACTIONS" else None
        moved = obj, *followers(obj)
        for mesh in _meshes_together(obj):
            if mesh in moved or checks.armature_modifiers(mesh):
                yield from _skinning_losses(mesh, key)
            yield from _key_losses(mesh, key, planned if mesh in moved else None)
    if key != "RAW":
        for mesh in _left_out(obj):
            yield f"'{mesh.name}' is hidden, so Blender exports nothing of it: show it"


def _planned_keys(obj) -> int:
    """How many keys the clips of all Actions take together, at most."""
    settings = obj.dynamorph
    return settings.output.keys or len(settings.modes) + max(len(settings.targets) - 1, 0)


def _raw_losses(obj) -> Iterator[str]:
    pieces = ", ".join(f"'{piece.name}'" for piece in _meshes_together(obj) if piece != obj)
    if pieces:
        yield f"A raw clip is of one mesh: {pieces} is left out"
    others = [name for name in checks.moving_keys(obj) if name not in checks.baked_keys(obj)]
    if others:
        yield f"A raw clip has the bake's keys alone: {', '.join(others)} is left out"


def _skinning_losses(obj, key: str) -> Iterator[str]:
    label, modifiers = FORMATS[key].label, checks.armature_modifiers(obj)
    if not modifiers:
        yield f"'{obj.name}' has no Armature modifier: its bones are not written"
        return
    for modifier in obj.modifiers:
        if modifier not in modifiers and modifier.show_viewport:
            where = "after" if obj.modifiers.find(modifier.name) > obj.modifiers.find(modifiers[-1].name) else "before"
            yield (
                f"'{obj.name}': modifier '{modifier.name}' {where} the Armature is left out: {label} takes shape keys "
                "or modifiers, not both. Use Alembic or USD"
            )
    beyond = checks.beyond_bones(obj)
    if beyond:
        yield f"'{obj.name}' is skinned with {beyond}, {label} skins by plain bones: it will differ. Use Alembic or USD"
    crowded = _crowded_vertices(obj)
    if key == "GLTF" and crowded:
        yield f"'{obj.name}': {crowded} vertices follow more than {INFLUENCES} bones: the weakest of them are dropped"


def _key_losses(obj, key: str, planned: int | None) -> Iterator[str]:
    """planned: how many keys there will be in the place of the bake's, if there will be others."""
    moving, baked = checks.moving_keys(obj), checks.baked_keys(obj)
    others = [name for name in moving if name not in baked]
    count = len(moving) if planned is None else len(others) + planned
    if count > MORPHS:
        room = MORPHS - len(others)
        again = "bake to Shape Keys again with Keys" if planned is None else "set Keys to"
        remedy = f"{again} {room}, or use" if room > 0 else "use"
        yield f"'{obj.name}': {count} keys move, many engines blend {MORPHS} at most: {remedy} Alembic or USD"
    driven = [name for name in moving if name in checks.driven_keys(obj)]
    if driven:
        yield f"'{obj.name}': drivers are left out, the values they give at each frame are written: {', '.join(driven)}"
    blocks = obj.data.shape_keys.key_blocks if moving else ()
    whole = [name for name in moving if blocks[name].vertex_group or blocks[name].relative_key != blocks[0]]
    if key == "GLTF" and whole:
        yield (
            f"'{obj.name}': glTF knows no vertex groups of shape keys, and none relative to others than "
            f"'{blocks[0].name}': {', '.join(whole)} will differ"
        )


def _crowded_vertices(obj) -> int:
    bones = {bone.name for bone in checks.deforming_bones(obj, rig_of(obj))}
    groups = {group.index for group in obj.vertex_groups if group.name in bones}
    return sum(
        sum(element.group in groups and element.weight > 0.0 for element in vertex.groups) > INFLUENCES
        for vertex in obj.data.vertices
    )


# Writers -----------------------------------------------------------------------------------------------------------


def _write_gltf(obj, path: Path, frames, takes):
    with _sampled(obj, frames):
        bpy.ops.export_scene.gltf(
            filepath=str(path), use_selection=True, export_animation_mode="SCENE", export_force_sampling=True,
            export_anim_scene_split_object=False,
            export_optimize_animation_size=False, export_morph_normal=False, export_frame_range=True,
        )  # fmt: skip
    if takes:
        parts = {clip.name: (clip.first - frames[0], clip.last - frames[0]) for clip in takes}
        path.write_bytes(glb.split_animation(path.read_bytes(), parts, _fps()))


def _write_fbx(obj, path: Path, frames, takes):
    with _sampled(obj, frames):
        bpy.ops.export_scene.fbx(
            filepath=str(path), use_selection=True, add_leaf_bones=False, bake_anim_use_nla_strips=bool(takes),
            bake_anim_use_all_actions=False, bake_anim_simplify_factor=0.0, use_mesh_modifiers=False,
        )  # fmt: skip


def _write_alembic(_obj, path: Path, frames, _takes):
    bpy.ops.wm.alembic_export(
        filepath=str(path), selected=True, start=frames[0], end=frames[1], uvs=True, normals=False,
        as_background_job=False, export_custom_properties=False,  # Blender crashes on bytes, as a model's
    )  # fmt: skip


def _write_usd(_obj, path: Path, frames, _takes):
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = frames  # until `_as_it_was`
    bpy.ops.wm.usd_export(
        filepath=str(path), selected_objects_only=True, export_animation=True, export_armatures=False,
        export_shapekeys=False, export_normals=False, export_custom_properties=False,
    )  # fmt: skip


def _write_raw(obj, path: Path, _frames, _takes):
    """One row a frame, whatever the bake's samples are: players count by frames."""
    basis = key_points(obj.data.shape_keys.reference_key)
    model_file.save(path, clips.raw(sinks.read_back(obj), basis, _fps()))


def _fps() -> float:
    render = bpy.context.scene.render
    return render.fps / render.fps_base


FORMATS = {
    "GLTF": Format("glTF", ".glb", "Morph targets and bones, for engines and the web", _write_gltf, skins=True),
    "FBX": Format("FBX", ".fbx", "Morph targets and bones, for engines and other packages", _write_fbx,
                  skins=True),
    "ALEMBIC": Format("Alembic", ".abc", "The posed surface at every frame", _write_alembic,
                      surface=True, option="alembic"),
    "USD": Format("USD", ".usdc", "The posed surface at every frame", _write_usd, surface=True,
                  option="usd"),
    "RAW": Format("Raw Clip", ".npz", "Modes and their values, for NumPy and runtime/dynamorph.h", _write_raw),
}  # fmt: skip


def named(path: Path, key: str) -> Path:
    """The path with the suffix of a format, in place of that of another one."""
    if path.suffix.lower() in {each.suffix for each in FORMATS.values()}:
        return path.with_suffix(FORMATS[key].suffix)
    return path.with_name(f"{path.name}{FORMATS[key].suffix}")


# Around the exporters ----------------------------------------------------------------------------------------------


def _meshes_together(obj) -> list:
    """The meshes of the character that Blender shows: its own, those that its bake moves, and all others that its
    armature skins or carries.
    """
    return [mesh for mesh in _meshes_of(obj) if mesh.visible_get()]


def _left_out(obj) -> list:
    """The meshes of the character that are hidden."""
    return [mesh for mesh in _meshes_of(obj) if not mesh.visible_get()]


def _meshes_of(obj) -> list:
    rig = rig_of(obj)
    return list(dict.fromkeys((obj, *followers(obj), *(checks.meshes_on(rig) if rig else ()))))


def _together(obj, without=()) -> list:
    """The character: its meshes, its armature, and what they hang on; without: meshes that others stand in for."""
    meshes = [mesh for mesh in _meshes_together(obj) if mesh not in without]
    found, rig = dict.fromkeys((obj, *filter(None, [rig_of(obj)]), *meshes)), rig_of(obj)
    for mesh in meshes:
        above = mesh.parent
        while above and above != rig and rig in _parents(above):
            found[above] = None
            above = above.parent
    return list(found)


def _parents(obj) -> list:
    found = []
    while obj.parent:
        obj = obj.parent
        found.append(obj)
    return found


@contextmanager
def _as_it_was(obj, without=()):
    """The character alone selected; afterwards selection and frames as they were."""
    layer, scene, character = bpy.context.view_layer, bpy.context.scene, _together(obj, without)
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
def _stand_ins(meshes):
    """Copies of mesh objects, by their names, to be changed and written: the originals stay as they are."""
    layer, actions_before = bpy.context.view_layer, set(bpy.data.actions)
    names = [(block, block.name) for mesh in meshes for block in (mesh, mesh.data)]
    copies = []
    try:
        for mesh in meshes:
            copies.append(mesh.copy())
            copies[-1].data = mesh.data.copy()
            bpy.context.scene.collection.objects.link(copies[-1])
        for (original, name), copy in zip(names, (b for c in copies for b in (c, c.data)), strict=True):
            original.name = actions.ASIDE
            copy.name = name
        layer.update()
        yield copies
    finally:
        for copy in copies:
            mesh = copy.data
            bpy.data.objects.remove(copy)
            bpy.data.meshes.remove(mesh)  # with its shape keys
        for action in set(bpy.data.actions) - actions_before:  # of the curves
            bpy.data.actions.remove(action)
        for original, name in names:
            original.name = name


@contextmanager
def _sampled(obj, frames):
    """The frames as the scene's, and `_sampled_keys` of the whole character."""
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = frames
    with ExitStack() as stack:
        for each in _meshes_together(obj):
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
    values[:, [block.mute for block in keys.key_blocks]] = 0.0  # FBX knows no muted keys
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
