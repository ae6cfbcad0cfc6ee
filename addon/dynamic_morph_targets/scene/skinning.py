# SPDX-License-Identifier: GPL-3.0-or-later
"""How an object is skinned: its Armature modifiers and their settings."""

from __future__ import annotations

import bpy

from .references import is_armature, rig_of

SKINNING_FIELDS = ("use_deform_preserve_volume", "use_multi_modifier", "vertex_group", "invert_vertex_group")


def beyond_bones(obj) -> str:
    """What makes Blender's skinning of `obj` more than sums of bone matrices, which the engine supports; '' if
    nothing.
    """
    modifiers = armature_modifiers(obj)
    if len(modifiers) > 1:
        return "several Armature modifiers"
    if any(modifier.use_deform_preserve_volume for modifier in modifiers):
        return "Preserve Volume"
    bendy = any(bone.bbone_segments > 1 for modifier in modifiers for bone in deforming_bones(obj, modifier.object))
    return "bendy bones" if bendy else ""


def skinning_settings(obj) -> list:
    """Settings of the Armature modifiers and of bendy bones that a bake depends on, as JSON data."""
    found = []
    for modifier in armature_modifiers(obj):
        segments = [
            bone.bbone_segments for bone in deforming_bones(obj, modifier.object)
        ]  # without names, which may change
        found.append([*(getattr(modifier, name) for name in SKINNING_FIELDS), segments])
    return found


def main_modifier(obj):
    """The Armature modifier of `references.rig_of`, or None."""
    rig = rig_of(obj)
    return next((modifier for modifier in armature_modifiers(obj) if modifier.object == rig), None)


def armature_modifiers(obj) -> list:
    """The Armature modifiers of `obj` that have an armature."""
    return [modifier for modifier in obj.modifiers if modifier.type == "ARMATURE" and is_armature(modifier.object)]


def armature_for(obj):
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


def deforming_bones(obj, armature) -> list:
    """The bones of the armature object that skin `obj`."""
    groups = set(obj.vertex_groups.keys())
    return [bone for bone in armature.data.bones if bone.use_deform and bone.name in groups]
