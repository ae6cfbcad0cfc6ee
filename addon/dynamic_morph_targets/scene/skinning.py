# SPDX-License-Identifier: GPL-3.0-or-later
"""How an object is skinned: its Armature modifiers and their settings."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import bpy

from .references import armature_modifiers, rig_among

SKINNING_FIELDS = ("use_deform_preserve_volume", "use_multi_modifier", "vertex_group", "invert_vertex_group")


@dataclass(frozen=True, eq=False)
class Skinning:
    """How Blender skins the mesh object `obj`, read once. An undo replaces what it refers to, so nobody keeps it.

    modifiers: its Armature modifiers that have an armature; rig: the armature object that places the targets, or None.
    """

    obj: Any  # of Blender, as the next two
    modifiers: tuple
    rig: Any
    _bones: dict = field(default_factory=dict)  # by armature object

    @classmethod
    def of(cls, obj: bpy.types.Object | Skinning) -> Skinning:
        """obj: the mesh object, or what has been read of it already."""
        if isinstance(obj, Skinning):
            return obj
        modifiers = tuple(armature_modifiers(obj)) if obj else ()
        return cls(obj, modifiers, rig_among(obj, modifiers))

    @property
    def modifier(self) -> bpy.types.Modifier | None:
        """The Armature modifier of `rig`, or None."""
        return self.modifier_of(self.rig)

    def modifier_of(self, rig: bpy.types.Object | None) -> bpy.types.Modifier | None:
        """The first Armature modifier with this armature object, or None."""
        return next((modifier for modifier in self.modifiers if modifier.object == rig), None)

    def bones(self, armature: bpy.types.Object) -> list:
        """`deforming_bones` of one of the armature objects."""
        if armature not in self._bones:
            self._bones[armature] = deforming_bones(self.obj, armature)
        return self._bones[armature]

    @cached_property
    def beyond_bones(self) -> str:
        """What makes Blender's skinning more than sums of bone matrices, which the engine supports; '' if nothing."""
        if len(self.modifiers) > 1:
            return "several Armature modifiers"
        if any(modifier.use_deform_preserve_volume for modifier in self.modifiers):
            return "Preserve Volume"
        bendy = any(bone.bbone_segments > 1 for modifier in self.modifiers for bone in self.bones(modifier.object))
        return "bendy bones" if bendy else ""

    def settings(self) -> list:
        """Settings of the Armature modifiers and of bendy bones that a bake depends on, as JSON data."""
        found = []
        for modifier in self.modifiers:
            segments = [bone.bbone_segments for bone in self.bones(modifier.object)]  # bones' names may change
            found.append([*(getattr(modifier, name) for name in SKINNING_FIELDS), segments])
        return found


def deforming_bones(obj: bpy.types.Object, armature: bpy.types.Object) -> list:
    """The bones of the armature object that skin `obj`."""
    groups = set(obj.vertex_groups.keys())
    return [bone for bone in armature.data.bones if bone.use_deform and bone.name in groups]


def armature_for(obj: bpy.types.Object) -> bpy.types.Object | None:
    """The armature for which `obj` was most likely weighted: its parent, or the only one of the scene whose bones are
    named like its vertex groups; or None.
    """
    parent = obj.parent
    if parent and parent.type == "ARMATURE" and obj.parent_type in {"OBJECT", "ARMATURE"}:
        return parent
    groups = set(obj.vertex_groups.keys())
    armatures = [other for other in bpy.context.scene.objects if other.type == "ARMATURE"]
    fitting = [armature for armature in armatures if not groups.isdisjoint(armature.data.bones.keys())]
    return fitting[0] if len(fitting) == 1 else None


def meshes_on(rig: bpy.types.Object) -> list:
    """The mesh objects of the scene that an armature moves: those that it skins, and those parented to it or its
    bones.
    """
    hanging = set(rig.children_recursive)
    return [
        other
        for other in bpy.context.scene.objects
        if other.type == "MESH"
        and (other in hanging or any(m.type == "ARMATURE" and m.object == rig for m in other.modifiers))
    ]
