# SPDX-License-Identifier: GPL-3.0-or-later
"""Soft skins of the file: which objects they are, and what belongs to them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import bpy

from ..core.errors import SceneError
from ..core.message import Message
from .references import rig_of


def unit_scale() -> float:
    """Meters per Blender unit, from the scene's unit settings. Everything that is read of the world is in meters."""
    units = bpy.context.scene.unit_settings
    return 1.0 if units.system == "NONE" else units.scale_length


@dataclass(frozen=True)
class ObjectHandle:
    """Which object is meant: its session id outlives undo and renames; Python references do not.

    name: what it was called when the handle was made, for messages; empty where that is not known.
    """

    session_uid: int
    name: str

    @classmethod
    def of(cls, obj: bpy.types.Object) -> ObjectHandle:
        return cls(obj.session_uid, obj.name)

    def find(self) -> bpy.types.Object:
        """The object. Raises SceneError when it was deleted."""
        obj = next((obj for obj in bpy.data.objects if obj.session_uid == self.session_uid), None)
        if obj is None:
            name = f"'{self.name}'" if self.name else "The object"
            raise SceneError("{name} was deleted while the job ran: nothing was written", name=name)
        return obj


@dataclass(frozen=True)
class SceneHandle:
    """Which scene and view layer are meant, whatever the window shows meanwhile; as `ObjectHandle`."""

    session_uid: int
    name: str
    view_layer: str

    @classmethod
    def present(cls) -> SceneHandle:
        scene = bpy.context.scene
        return cls(scene.session_uid, scene.name, bpy.context.view_layer.name)

    def find(self) -> bpy.types.Scene:
        """The scene. Raises SceneError when it was deleted."""
        scene = next((scene for scene in bpy.data.scenes if scene.session_uid == self.session_uid), None)
        if scene is None:
            raise SceneError("Scene '{name}' was deleted while the job ran: nothing was written", name=self.name)
        return scene

    @contextmanager
    def as_context(self) -> Iterator[None]:
        """Let `bpy.context` have the scene for a while. Raises SceneError."""
        scene = self.find()
        if scene == bpy.context.scene:
            yield
            return
        layer = scene.view_layers.get(self.view_layer) or scene.view_layers[0]
        with bpy.context.temp_override(scene=scene, view_layer=layer):
            yield


def find(session_uid: int) -> bpy.types.Object:
    """The object with this session id, where its name is not known. Raises SceneError."""
    return ObjectHandle(session_uid, "").find()


def named_targets(obj: bpy.types.Object) -> list[tuple]:
    """(name, target) of all targets; the neutral target's name is empty, because a shape key may have the same name."""
    return [(target.name if i else "", target) for i, target in enumerate(obj.dynamorph.targets)]


def used_grips(obj: bpy.types.Object) -> list:
    """The grips of `obj` that hold something."""
    return [grip for grip in obj.dynamorph.grips if not grip.mute]


def target_of_active_key(obj: bpy.types.Object) -> int | None:
    """Index of the target whose shape the active shape key is; the Basis is that of the neutral one. None: of none."""
    key = obj.active_shape_key
    if key is None or key == obj.data.shape_keys.reference_key:
        return 0
    names = [name for name, _ in named_targets(obj)]
    return names.index(key.name) if key.name in names else None


def shown_objects(view_layer: bpy.types.ViewLayer | None = None) -> list:
    """The objects of a view layer, by default of the present one.

    Blender itself has None among them in place of one that was removed since it updated the view layer: its exporters
    remove objects and change the frame next.
    """
    return [obj for obj in (view_layer or bpy.context.view_layer).objects if obj is not None]


def is_rendered(obj: bpy.types.Object) -> bool:
    """Whether renders of the view layer show an object: neither it nor all collections that it is in are off."""
    return not obj.hide_render and any(
        obj.name in layer.collection.objects for layer in _rendered_layers(bpy.context.view_layer.layer_collection)
    )


def _rendered_layers(layer: bpy.types.LayerCollection) -> Iterator[bpy.types.LayerCollection]:
    if not layer.exclude and not layer.collection.hide_render:
        yield layer
        for child in layer.children:
            yield from _rendered_layers(child)


def soft_skins(objects: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    """Those of `objects` that carry a soft skin."""
    return [obj for obj in objects if obj.type == "MESH" and obj.dynamorph.targets]


def own_attachments(obj: bpy.types.Object) -> list:
    """The attachments of a soft skin that are parts of its own mesh."""
    return attachments_of(obj, None)


def attachments_of(obj: bpy.types.Object, mesh: bpy.types.Object | None) -> list:
    """The attachments of a soft skin that are parts of another mesh object; None: of its own."""
    return [each for each in obj.dynamorph.attachments if each.group and each.object == mesh]


def attached_meshes(obj: bpy.types.Object) -> list:
    """The other meshes in the cage of a soft skin, without deleted ones."""
    choices = {"WITH_BODY", "HELD"}
    meshes = [each.object for each in obj.dynamorph.attachments if not each.group and each.attached_by in choices]
    return [mesh for mesh in dict.fromkeys(meshes) if mesh and mesh.users_scene]


def is_shown_on(obj: bpy.types.Object) -> bool:
    """Whether a mesh has keys of a bake or of Live."""
    return obj.dynamorph.bake.exists or bool(obj.dynamorph.live.key.name)


def cache_modifier(obj: bpy.types.Object) -> Any:
    """The modifier that plays the bake's point cache, or None. The artist may have renamed it, or moved the file."""
    file = obj.dynamorph.bake.cache
    caches = (modifier for modifier in obj.modifiers if modifier.type == "MESH_CACHE") if file else ()
    return next((modifier for modifier in caches if re.split(r"[/\\]", modifier.filepath)[-1] == file), None)


def edited_elsewhere(obj: bpy.types.Object) -> str:
    """Why `obj` cannot change its mode, or ''. Blender crashes when it enters Weight Paint then."""
    if obj.mode == "EDIT" or not obj.data.is_editmode:
        return ""
    return Message("Mesh '{name}' is in Edit Mode on another object: leave it there first", name=obj.data.name)


def shown_attachments(obj: bpy.types.Object) -> list:
    """The meshes that now show the motion of the soft skin `obj`, by its bake or by Live."""
    return [other for other in bpy.data.objects if other.dynamorph.follows == obj]


def mesh_in(context: bpy.types.Context) -> Any:
    """The mesh object that buttons and panels refer to, or None: the active one; for an armature, the soft skin on it.

    Of several soft skins on one armature, a selected one; without any, the largest mesh.
    """
    obj = context.object
    if obj is not None and obj.type == "ARMATURE":
        skins = [skin for skin in soft_skins(shown_objects(context.view_layer)) if rig_of(skin) == obj]
        return min(skins, key=lambda skin: not skin.select_get(), default=None) or _largest_on(obj, context)
    return obj if obj is not None and obj.type == "MESH" else None


def _largest_on(rig: bpy.types.Object, context: bpy.types.Context) -> bpy.types.Object | None:
    """The mesh with the most vertices that an armature object skins, or None."""
    skinned = [obj for obj in shown_objects(context.view_layer) if obj.type == "MESH" and rig_of(obj) == rig]
    return max(skinned, key=lambda obj: len(obj.data.vertices), default=None)
