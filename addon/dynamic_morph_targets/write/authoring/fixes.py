# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixes for what prevents a soft skin, one button each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
from mathutils.kdtree import KDTree

from ...core.errors import SceneError
from ...scene import cuts, references, skinning
from ...scene.check import body_checks, checks, modifier_order
from ...scene.read.source import Source
from ...scene.skin import unit_scale
from ..bake import writer
from . import applying
from .collision import add_collision


@dataclass(frozen=True)
class Fix:
    """label, tooltip: for the artist; apply(obj): applies the fix. Raises SceneError."""

    label: str
    tooltip: str
    apply: Callable


def owned(data: bpy.types.ID) -> bpy.types.ID:
    """`data`, if changes to it are saved. Raises SceneError."""
    if not data.is_editable:
        raise SceneError(
            "{kind} '{name}' is linked, so the change would be lost: make it local",
            kind=data.bl_rna.name,
            name=data.name,
        )
    return data


def _in_modifier(**values: Any) -> Callable:
    """A fix that sets properties of the Armature modifiers."""

    def apply(obj: bpy.types.Object) -> None:
        for modifier in references.armature_modifiers(obj):
            for name, value in values.items():
                setattr(modifier, name, value)

    return apply


def _in_bones(name: str, value: Any) -> Callable:
    """A fix that sets a property of every bone that skins the mesh."""

    def apply(obj: bpy.types.Object) -> None:
        for rig in _rigs(obj):
            owned(rig.data)
            for bone in skinning.deforming_bones(obj, rig):
                setattr(bone, name, value)

    return apply


def _rigs(obj: bpy.types.Object) -> list:
    """The armature objects that skin `obj`."""
    return [modifier.object for modifier in references.armature_modifiers(obj)]


def _leave_edit_mode(obj: bpy.types.Object) -> None:
    objects = bpy.context.view_layer.objects
    active = objects.active
    for edited in (obj, *_rigs(obj)):
        if edited.mode == "EDIT":
            objects.active = edited
            bpy.ops.object.mode_set(mode="OBJECT")
    objects.active = active


def _make_single_user(obj: bpy.types.Object) -> None:
    _leave_edit_mode(obj)  # where an object takes no other mesh, and Blender does not say so
    obj.data = obj.data.copy()


def _add_armature_modifier(obj: bpy.types.Object) -> None:
    """It becomes the first modifier, because none before an Armature modifier may add vertices."""
    empty = [modifier for modifier in obj.modifiers if modifier.type == "ARMATURE"]
    modifier = empty[0] if empty else obj.modifiers.new("Armature", "ARMATURE")
    modifier.object = skinning.armature_for(obj)
    if obj.parent_type == "ARMATURE":
        _parent_as_object(obj)
    obj.modifiers.move(obj.modifiers.find(modifier.name), 0)


def _parent_as_object(obj: bpy.types.Object) -> None:
    """The parent moves it as a whole from now on, and does not deform it."""
    obj.parent_type = "OBJECT"


def _move_below(obj: bpy.types.Object) -> None:
    *_, armature = references.armature_modifiers(obj)
    armature.use_pin_to_last = False  # nothing can be below one that is pinned
    hiding = modifier_order.hiding_before(obj, armature)
    for modifier in reversed(hiding):  # each moves next to it, which keeps the order
        obj.modifiers.move(obj.modifiers.find(modifier.name), obj.modifiers.find(armature.name))


def _pose_position(obj: bpy.types.Object) -> None:
    for rig in _rigs(obj):
        owned(rig.data).pose_position = "POSE"


def _enable_armature(obj: bpy.types.Object) -> None:
    for rig in _rigs(obj):
        owned(rig).hide_viewport = False


def _add_basis(obj: bpy.types.Object) -> None:
    owned(obj.data)
    writer.ensure_basis(obj)


def _relative_keys(obj: bpy.types.Object) -> None:
    owned(obj.data.shape_keys).use_relative = True


def _person_size(obj: bpy.types.Object) -> None:
    units = bpy.context.scene.unit_settings
    scale = unit_scale() * body_checks.PERSON / body_checks.size_now(obj)
    if units.system == "NONE":  # which has no scale
        units.system = "METRIC"
    units.scale_length = scale


def _weight_like_nearest(obj: bpy.types.Object) -> None:
    """Give every vertex that no bone moves the weights of the nearest one that a bone moves."""
    owned(obj.data)
    source = Source.of(checks.skinned(obj))
    left = source.left_behind
    if left.all():
        raise SceneError("'{name}' has no vertex with a bone weight: weight some first", name=obj.name)
    names = list({bone.name: None for rig in _rigs(obj) for bone in source.skinning.bones(rig)})
    weights, points = source.groups.weights(names), body_checks.mesh_points(obj)
    tree = KDTree(len(points))
    for vertex in np.flatnonzero(~left):
        tree.insert(points[vertex], vertex)
    tree.balance()
    for vertex in np.flatnonzero(left):
        _, nearest, _ = tree.find(points[vertex])
        for column in np.flatnonzero(weights[nearest]):
            obj.vertex_groups[names[column]].add([int(vertex)], weights[nearest, column], "REPLACE")


def _leave_attachments(obj: bpy.types.Object) -> None:
    """Take those from the list that belong to the body that was copied."""
    attachments = obj.dynamorph.attachments
    theirs = [other for other, _ in checks.of_others(skinning.Skinning.of(obj))]
    for index in reversed(range(len(attachments))):
        if attachments[index].object in theirs:
            attachments.remove(index)
    obj.dynamorph.active_attachment_index = 0


def _lock_interface(_obj: bpy.types.Object) -> None:
    bpy.context.scene.render.use_lock_interface = True


def _collide(obj: bpy.types.Object) -> None:
    add_collision(obj, cuts.cutting(obj))


def _full_quality(obj: bpy.types.Object) -> None:
    obj.dynamorph.model.quality = "AUTOMATIC"


def _no_head(obj: bpy.types.Object) -> None:
    obj.dynamorph.model.hold_head = False


def _unpin(obj: bpy.types.Object) -> None:
    obj.show_only_shape_key = False


FIXES = {
    "LEAVE_EDIT_MODE": Fix("Leave Edit Mode", "Go back to Object Mode", _leave_edit_mode),
    "SINGLE_USER": Fix(
        "Make Mesh Single-User", "Give this object a copy of the mesh; the others keep the one they had",
        _make_single_user,
    ),
    "ADD_ARMATURE": Fix(
        "Add Armature Modifier",
        "Add an Armature modifier with the parent, or the only armature that has bones named like the vertex groups",
        _add_armature_modifier,
    ),
    "PARENT_OBJECT": Fix(
        "Parent as Object", "Let the parent move the mesh as a whole, and the Armature modifier deform it",
        _parent_as_object,
    ),
    "MOVE_BELOW": Fix(
        "Move below Armature",
        "Move the modifiers that hide vertices below the Armature modifier, where they hide the same ones",
        _move_below,
    ),
    "APPLY": Fix(
        "Apply",
        "Put what the modifiers before the Armature do into the mesh. Shape keys stay, with their values, drivers and "
        "animation",
        applying.apply_before_armature,
    ),
    "ENABLE_MODIFIER": Fix(
        "Enable Modifier", "Show the Armature modifier in viewports", _in_modifier(show_viewport=True)
    ),
    "ENVELOPES": Fix(
        "Skin by Vertex Groups", "Turn Bone Envelopes off and Vertex Groups on in the Armature modifier",
        _in_modifier(use_bone_envelopes=False, use_vertex_groups=True),
    ),
    "POSE_POSITION": Fix("Pose Position", "Let the armature show its pose, not its rest position", _pose_position),
    "ENABLE_ARMATURE": Fix("Enable Armature", "Enable the armature in viewports", _enable_armature),
    "ENVELOPE_MULTIPLY": Fix(
        "Turn off Envelope Multiply", "Turn Envelope Multiply off for every bone that deforms the mesh",
        _in_bones("use_envelope_multiply", False),
    ),
    "ADD_BASIS": Fix("Add Basis", "Add the shape key that the others are relative to", _add_basis),
    "RELATIVE_KEYS": Fix("Relative Shape Keys", "Make the shape keys relative to their Basis", _relative_keys),
    "PERSON_SIZE": Fix(
        "Treat as 1.7 m",
        "Set the scene's Unit Scale so that the longest side of this body counts as 1.7 m. Nothing is resized",
        _person_size,
    ),
    "WEIGHT_LIKE_NEAREST": Fix(
        "Weight Like Nearest",
        "Give every vertex without a bone weight the weights of the nearest vertex that has some",
        _weight_like_nearest,
    ),
    "LEAVE_ATTACHMENTS": Fix(
        "Leave It", "Remove from the Attachments of this copy what belongs to the body that it was copied from",
        _leave_attachments,
    ),
    "LOCK_INTERFACE": Fix(
        "Lock Interface", "Lock Blender's interface during renders, so that Live can move the skin",
        _lock_interface,
    ),
    "FULL_QUALITY": Fix(
        "Bake in Full Quality", "Bake with every node of the cage, for accurate dents",
        _full_quality,
    ),
    "COLLIDE": Fix(
        "Collide", "Give the objects that cut the body Blender's Collision, and let them stop the skin",
        _collide,
    ),
    "NO_HEAD": Fix("There Is No Head", "Turn Hold Head off: everything is as soft as it is painted", _no_head),
    "UNPIN": Fix("Show All Shape Keys", "Show the mix of all shape keys, not only the active one", _unpin),
}  # fmt: skip
