# SPDX-License-Identifier: GPL-3.0-or-later
"""A character as a file of another format.

Blender's own exporters write what Blender shows: glTF and FBX the shape keys as morph targets with their values at each
frame, Alembic and USD the posed surface. A soft skin is the model and its character, to be simulated
elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy

from ...core.errors import ExportError
from ...io import outputs, whole
from ...scene import animation, skin
from ...scene.check import checks
from ...scene.check.problem import refuse
from ...scene.references import key_points, rig_of
from ...scene.skin import shown_attachments
from ...scene.skinning import meshes_on
from ...scene.store import model_store, staleness
from .. import actions
from ..bake import writer
from ..reconcile import reconcile
from . import blender_formats, own_formats


@dataclass(frozen=True)
class Format:
    """suffix: of its files; write(obj, collection, path, frames, takes), collection: the name of the one that holds the
    character, raises RuntimeError, OSError, MemoryError; skins: whether it contains armature and keys, and so a clip
    for each Action; surface: whether it contains the resulting surface; has_parts: whether other files belong to it;
    scenes: whether its frames are those of the scene, which must not be before 0; samples: whether it has those between
    frames; option: of bpy.app.build_options that it needs; needs_bake: whether it is made of a bake, not of the built
    model; check(obj): refuses settings that it cannot have, raises ExportError.
    """

    label: str
    suffix: str
    description: str
    write: Callable
    skins: bool = False
    surface: bool = False
    has_parts: bool = False
    scenes: bool = False
    samples: bool = False
    option: str = ""
    needs_bake: bool = True
    check: Callable | None = None

    @property
    def is_available(self) -> bool:
        return not self.option or getattr(bpy.app.build_options, self.option)


def check_place(obj: bpy.types.Object, key: str, path: Path, frames: tuple[int, int]) -> None:
    """Refuse, before any work, what cannot be written. Raises ExportError, WriteError, SceneError, OSError."""
    chosen = FORMATS[key]
    if not chosen.is_available:
        raise ExportError("This Blender was built without {format}: choose another format", format=chosen.label)
    if chosen.scenes and frames[0] < 0:
        raise ExportError(
            "{format} has no frames before 0, '{name}' is to begin at {first}: choose {others}, or move the animation",
            format=chosen.label,
            name=obj.name,
            first=frames[0],
            others=" or ".join(each.label for each in FORMATS.values() if not each.scenes and each.is_available),
        )
    writer.check_not_edited(obj)
    if rig_of(obj):
        refuse(checks.armature_state(rig_of(obj)))
    for mesh in () if chosen.surface else meshes_together(obj):
        writer.check_not_tweaked(mesh)
    shown = (obj, rig_of(obj), *_followers(obj))
    hidden = next((other for other in shown if other and not other.visible_get()), None)
    if hidden:
        raise ExportError("'{name}' is hidden, so Blender does not export it: unhide it", name=hidden.name)
    if chosen.surface and not skin.is_rendered(obj):
        raise ExportError(
            "'{name}' is off in renders, and {format} has what renders have: turn it and its collection on there (the "
            "camera in the Outliner)",
            name=obj.name,
            format=chosen.label,
        )
    if not path.parent.is_dir():
        raise ExportError(
            "The folder '{folder}' for '{name}' does not exist: choose another", folder=path.parent, name=path.name
        )
    outputs.try_file(path)
    outputs.check_space(path, _size(obj, chosen, frames))
    if chosen.surface:  # written by another process, from a copy of the scene that is put there
        outputs.try_folder(Path(bpy.app.tempdir))


def write_file(
    obj: bpy.types.Object,
    key: str,
    path: Path,
    frames: tuple[int, int],
    takes: Sequence[actions.Clip] = (),
    without: Collection[bpy.types.Object] = (),
) -> None:
    """Write the character of `obj` as it shows; takes: the clips that are laid out, if each becomes an animation;
    without: meshes that others replace. The earlier file stands until the new one is complete. Raises ExportError,
    OSError, MemoryError.
    """
    chosen = FORMATS[key]
    outputs.check_space(path, _size(obj, chosen, frames, without))
    with (
        frames_kept(),
        _collected(obj, without) as collection,
        _morphs_named_apart(obj, without),
        outputs.replacing(path, chosen.has_parts) as partial,
    ):
        try:
            chosen.write(obj, collection, partial, frames, takes)
            if not partial.is_file() or not partial.stat().st_size:
                raise RuntimeError("Blender's exporter wrote nothing")
            if path.suffix.lower() in whole.CHECKS and not whole.is_whole(partial):
                raise RuntimeError(outputs.UNREADABLE)
        except RuntimeError as error:  # of the operator, with what it reported
            text = str(error)
            if fault := outputs.why_not(path, text):  # asked while what was written still takes its room
                raise fault from error
            raise ExportError(
                "'{name}' could not be exported to '{file}' ({error}): try again, or choose another format",
                name=obj.name,
                file=path,
                error=_last_line(text),
            ) from error


def _last_line(text: str) -> str:
    """What an operator's report says, without the traceback before it."""
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith("Location:")]
    return lines[-1].removeprefix("Error: ") if lines else ""


def _size(
    obj: bpy.types.Object, chosen: Format, frames: tuple[int, int], without: Collection[bpy.types.Object] = ()
) -> int:
    """About how many bytes the file has at least: those of positions, single precision, and of the keys' values; or
    those of the model.
    """
    if not chosen.needs_bake:
        return own_formats.model_size(obj)
    count, size = frames[1] - frames[0] + 1, 0
    samples = staleness.baked_samples(obj) if chosen.samples else 1
    moving = obj, *shown_attachments(obj)
    for mesh in meshes_together(obj):
        point = 12 * len(mesh.data.vertices)
        if mesh in without:
            continue
        if chosen.surface:
            size += point * (count * samples if mesh in moving else 1)
            continue
        size += point
        for key in mesh.data.shape_keys.key_blocks[1:] if mesh.data.shape_keys else ():
            shift = key_points(key) != key_points(key.relative_key)
            size += 12 * int(shift.any(axis=1).sum()) + 4 * count
    return size


def check_settings(obj: bpy.types.Object, key: str) -> None:
    """Refuse, before any work, settings that the format cannot have. Raises ExportError."""
    if check := FORMATS[key].check:
        check(obj)


def check_bake(obj: bpy.types.Object, key: str) -> None:
    """Refuse a missing bake, or one in a form that the format cannot write; where it needs none, a model that is out of
    date. Raises ExportError, SceneError.
    """
    check_settings(obj, key)
    chosen = FORMATS[key]
    if not chosen.needs_bake:
        model_store.current_model(obj)
        return
    record = obj.dynamorph.bake
    keys = animation.baked_keys(obj).intersection(animation.keys_of(obj).keys())
    shown = skin.cache_modifier(obj) if record.cache else keys
    if not shown:
        raise ExportError("'{name}' has no bake to export: press Bake first", name=obj.name)
    for text in staleness.lost_caches(obj) if chosen.surface else ():
        raise ExportError("{what}: bring the file back, or bake again", what=text)
    if record.cache and not chosen.surface:
        raise ExportError(
            "The bake of '{name}' is a point cache, {format} writes shape keys: bake to Shape Keys first, or choose "
            "{others}",
            name=obj.name,
            format=chosen.label,
            others=surface_formats(),
        )


def surface_formats() -> str:
    """Those that have the posed surface itself, as a message names them."""
    labels = [each.label for each in FORMATS.values() if each.surface and each.is_available]
    return " or ".join(labels) or "a Blender that exports Alembic or USD"


FORMATS = {
    "GLTF": Format("glTF", ".glb", "Morph targets and bones, for engines and the web", blender_formats.write_gltf,
                   skins=True, scenes=True),
    "FBX": Format("FBX", ".fbx", "Morph targets and bones, for engines and other packages", blender_formats.write_fbx,
                  skins=True, scenes=True),
    "ALEMBIC": Format("Alembic", ".abc", "The posed surface at every frame", blender_formats.write_alembic,
                      surface=True, samples=True, option="alembic"),
    "USD": Format("USD", ".usdc", "The posed surface at every frame", blender_formats.write_usd, surface=True,
                  has_parts=True, scenes=True, option="usd"),
    "SOFT_SKIN": Format("Soft Skin", ".dynamorph", "The built model, for programs that simulate it. It needs no bake",
                        own_formats.write_soft_skin, needs_bake=False, check=own_formats.check_soft_skin),
}  # fmt: skip


def named(path: Path, key: str) -> Path:
    """The path with the suffix of a format, in place of that of another one."""
    if path.suffix.lower() in {each.suffix for each in FORMATS.values()}:
        return path.with_suffix(FORMATS[key].suffix)
    return path.with_name(f"{path.name}{FORMATS[key].suffix}")


# Around the exporters ----------------------------------------------------------------------------------------------


def meshes_together(obj: bpy.types.Object) -> list:
    """The meshes of the character that Blender shows: its own, those that its bake moves, and all others that its
    armature skins or carries.
    """
    return [mesh for mesh in _meshes_of(obj) if mesh.visible_get()]


def left_out(obj: bpy.types.Object) -> list:
    """The armature and the meshes of the character that are hidden."""
    return [each for each in (rig_of(obj), *_meshes_of(obj)) if each and not each.visible_get()]


def _meshes_of(obj: bpy.types.Object) -> list:
    rig = rig_of(obj)
    return list(dict.fromkeys((obj, *_followers(obj), *(meshes_on(rig) if rig else ()))))


def _followers(obj: bpy.types.Object) -> list:
    """Those that are in some scene: an attachment keeps the data of one that was deleted."""
    return [mesh for mesh in shown_attachments(obj) if mesh.users_scene]


def _together(obj: bpy.types.Object, without: Collection[bpy.types.Object] = ()) -> list:
    """The character: its meshes, its armature, and their parents; without: meshes that others replace."""
    meshes = [mesh for mesh in meshes_together(obj) if mesh not in without]
    found, rig = dict.fromkeys((obj, *filter(None, [rig_of(obj)]), *meshes)), rig_of(obj)
    for mesh in meshes:
        above = mesh.parent
        while above and above != rig and rig in _parents(above):
            found[above] = None
            above = above.parent
    return list(found)


def _parents(obj: bpy.types.Object) -> list:
    found = []
    while obj.parent:
        obj = obj.parent
        found.append(obj)
    return found


@contextmanager
def frames_kept() -> Iterator[None]:
    """Restore the scene's frame and range afterward."""
    scene = bpy.context.scene
    frame, ends = (scene.frame_current, scene.frame_subframe), (scene.frame_start, scene.frame_end)
    try:
        yield
    finally:
        scene.frame_start, scene.frame_end = ends
        scene.frame_set(frame[0], subframe=frame[1])


@contextmanager
def _morphs_named_apart(obj: bpy.types.Object, without: Collection[bpy.types.Object] = ()) -> Iterator[None]:
    """Let the bake's keys of another soft skin of the character have its name before theirs: engines that merge the
    meshes of one armature play morph targets of one name alike.
    """
    moved = {obj, *shown_attachments(obj), *without}
    taken = {key.name for mesh in moved for key in animation.keys_of(mesh).values()}
    owners = {mesh: mesh.dynamorph.follows or mesh for mesh in meshes_together(obj) if mesh not in moved}
    named: list[tuple] = []
    for owner in dict.fromkeys(each for each in owners.values() if each not in moved):
        meshes = [mesh for mesh in owners if owners[mesh] == owner]
        keys = [key for mesh in meshes for key in animation.keys_of(mesh).values()]
        baked = {name for mesh in meshes for name in animation.baked_keys(mesh)}
        named += [(key, key.name, f"{owner.name} {key.name}") for key in keys if key.name in taken & baked]
        taken |= baked
    try:
        for key, _, apart in named:
            key.name = apart
        yield
    finally:
        for key, name, _ in named:
            key.name = name
        for mesh in owners if named else ():
            reconcile(mesh)  # its references have followed the names


@contextmanager
def _collected(obj: bpy.types.Object, without: Collection[bpy.types.Object] = ()) -> Iterator[str]:
    """The name of a collection with the character alone, for the exporters; it is in no scene.

    `obj` is the active object meanwhile, because the glTF exporter makes the active one leave its mode.
    """
    collection, objects = bpy.data.collections.new(obj.name), bpy.context.view_layer.objects
    active = objects.active
    try:
        for each in _together(obj, without):
            collection.objects.link(each)
        objects.active = obj
        yield collection.name
    finally:
        objects.active = active
        bpy.data.collections.remove(collection)


@contextmanager
def stand_ins(meshes: Sequence[bpy.types.Object]) -> Iterator[list[bpy.types.Object]]:
    """Copies of mesh objects, by name, that can be changed and written: the originals stay as they are."""
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
