# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons that paint vertex groups: softness, stiffness, and what is held."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import bpy
import numpy as np
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import EnumProperty
from bpy.types import Operator

from ..core import engine
from ..core.errors import SceneError
from ..run import heat
from ..scene import checks, mesh_data, references, skin
from ..scene.registration import of_classes
from ..write import bake, storage, targets
from ..write.fixes import owned
from .base import SoftSkinOperator

STEPS = 1000  # levels of softness that a vertex group distinguishes
BORDER = 4  # edges, over which held skin becomes soft


@dataclass(frozen=True)
class Painted:
    """A map that the artist paints. name: of a new vertex group; label: of the map; field: of DynamorphSettings; start:
    weight of a new group everywhere.
    """

    name: str
    label: str
    field: str
    start: float


PAINTED = {
    "SOFT": Painted("Soft", "Softness Map", "soft_group", 1.0),
    "STIFFNESS": Painted("Stiffness", "Stiffness Map", "stiffness_group", 0.0),
}


def is_painting(obj, which: str) -> bool:
    """Whether this vertex group of `obj` is the one being painted."""
    active = obj.vertex_groups.active
    return (
        obj.mode == "WEIGHT_PAINT"
        and active is not None
        and active.name == getattr(obj.dynamorph, PAINTED[which].field)
    )


class DYNAMORPH_OT_paint_group(SoftSkinOperator, Operator):
    """Paint the map in Weight Paint, with a new vertex group if there is none. Press again to leave Weight Paint"""

    bl_idname = "dynamorph.paint_group"
    bl_label = "Paint Soft Skin Map"

    which: EnumProperty(
        name="Map",
        description="The map to paint",
        items=[
            (key, painted.label, f"Paint the {painted.label}", i) for i, (key, painted) in enumerate(PAINTED.items())
        ],
    )

    def apply(self, obj):
        if is_painting(obj, self.which):
            self._leave(obj)
        else:
            self._enter(obj)

    def _enter(self, obj):
        if not obj.visible_get():
            raise SceneError("'{name}' is hidden: show it to paint on it", name=obj.name)
        if refusal := skin.edited_elsewhere(obj):
            raise SceneError(refusal)
        owned(obj.data)
        active, display = bpy.context.object, bpy.context.window_manager.dynamorph
        if obj.mode != "WEIGHT_PAINT":
            display.posed = active.name if active.mode == "POSE" else ""
            bpy.context.view_layer.objects.active = obj
            obj.select_set(True)
            bpy.ops.object.mode_set(mode="WEIGHT_PAINT", toggle=True)  # remembers the mesh's own mode
        settings, field = obj.dynamorph, PAINTED[self.which].field
        name = _map_name(obj, self.which)
        known = name in obj.vertex_groups
        if not known:
            _write_groups(name, _start(obj, self.which))
        weights, group = mesh_data.group_weights(obj, [name])[:, 0], obj.vertex_groups[name]
        if getattr(settings, field) != group.name:
            setattr(settings, field, group.name)
        obj.vertex_groups.active_index = group.index
        if len(weights) and (not known or np.ptp(weights) < 1e-3):
            _set_brush(weights)

    def _leave(self, obj):
        display, objects = bpy.context.window_manager.dynamorph, bpy.context.view_layer.objects
        bpy.ops.object.mode_set(mode="WEIGHT_PAINT", toggle=True)
        posed, display.posed = objects.get(display.posed), ""
        if posed:
            objects.active = posed
            bpy.ops.object.mode_set(mode="POSE")
        if obj.dynamorph.model.content_id:
            storage.show_stale(obj)


def _map_name(obj, which: str) -> str:
    """The vertex group of a map. A new one is named like no bone and no group of the meshes in the cage, because what
    is written there would be skin weights, or the artist's.
    """
    painted, rig = PAINTED[which], references.rig_of(obj)
    if chosen := getattr(obj.dynamorph, painted.field):
        return chosen
    taken = {group.name for mesh in (obj, *skin.clothes_in(obj)) for group in mesh.vertex_groups}
    taken |= {bone.name for bone in rig.data.bones} if rig else set()
    return targets.free_name(taken, painted.name) if painted.name in taken else painted.name


def _start(obj, which: str) -> dict[int, np.ndarray]:
    """Weights (V,) of a new group, by session_uid of each mesh that gets one. A new softness map starts from the hold
    by thickness: 1 everywhere would make thin parts soft.
    """
    with suppress(*engine.expected_errors()):
        if which == "SOFT" and obj.dynamorph.model.hold == "THICKNESS":
            return _softness_of_hold(obj)
    return {obj.session_uid: np.full(len(obj.data.vertices), PAINTED[which].start)}


def _softness_of_hold(obj) -> dict[int, np.ndarray]:
    """Softness (V,) in the model of the vertices of each mesh in its cage, by session_uid. Raises SceneError."""
    return {uid: 1.0 - held for uid, held in heat.holds(obj).items()}


def _write_groups(name: str, weights: dict[int, np.ndarray]):
    """`_write_group` for each mesh, by session_uid. Raises SceneError, and then nothing is written."""
    for mesh in map(skin.find, weights):
        _check_unlocked(mesh, name)
    for uid, values in weights.items():
        _write_group(skin.find(uid), name, values)


def _check_unlocked(obj, name: str):
    """Raises SceneError."""
    if name in obj.vertex_groups and obj.vertex_groups[name].lock_weight:
        raise SceneError("'{name}': vertex group '{group}' is locked: unlock it first", name=obj.name, group=name)


def _write_group(obj, name: str, weights: np.ndarray):
    """Write weights (V,), rounded to a thousandth, to the vertex group of this name; it is created if there is none."""
    group = obj.vertex_groups.get(name) or obj.vertex_groups.new(name=name)
    steps = np.round(weights * STEPS).astype(int)
    for step in np.unique(steps):
        group.add(np.flatnonzero(steps == step).tolist(), step / STEPS, "REPLACE")


def _set_brush(weights: np.ndarray):
    """Make the first stroke visible: the brush paints 0 if most of the weights (V,) are over a half, otherwise 1."""
    tools = bpy.context.scene.tool_settings
    shared = getattr(tools.weight_paint, "unified_paint_settings", None) or tools.unified_paint_settings
    shared.weight = 0.0 if np.median(weights) > 0.5 else 1.0
    brush = tools.weight_paint.brush
    if brush and brush.is_editable:
        brush.weight = shared.weight


class DYNAMORPH_OT_hold_to_group(SoftSkinOperator, Operator):
    """Fill the softness map of all meshes in the cage with the softness that the built model gives each vertex"""

    bl_idname = "dynamorph.hold_to_group"
    bl_label = "Softness from Hold"

    @classmethod
    def disabled_reason(cls, context):
        disabled_reason = super().disabled_reason(context)
        if not disabled_reason and not skin.mesh_in(context).dynamorph.model.content_id:
            return "Press Build Model first: it computes the hold"
        return disabled_reason

    def apply(self, obj):
        bake.check_not_edited(obj)
        owned(obj.data)
        name = _map_name(obj, "SOFT")
        _write_groups(name, _softness_of_hold(obj))
        obj.dynamorph.soft_group = name
        obj.vertex_groups.active_index = obj.vertex_groups[name].index
        storage.show_stale(obj)


class DYNAMORPH_OT_hold_bones(SoftSkinOperator, Operator):
    """Set the softness map to 0 where the selected pose bones move the skin, with a soft border"""

    bl_idname = "dynamorph.hold_bones"
    bl_label = "Hold Selected Bones"

    def apply(self, obj):
        bake.check_not_edited(obj)
        owned(obj.data)
        held = _held_by_bones(obj)
        name = _map_name(obj, "SOFT")
        known = {obj.session_uid: mesh_data.group_weights(obj, [name])[:, 0]}
        weights = known if name in obj.vertex_groups else _start(obj, "SOFT")
        weights[obj.session_uid] = np.minimum(weights[obj.session_uid], 1.0 - held)
        _write_groups(name, weights)
        obj.dynamorph.soft_group = name
        obj.vertex_groups.active_index = obj.vertex_groups[name].index
        if obj.dynamorph.model.content_id:
            storage.show_stale(obj)


def _held_by_bones(obj) -> np.ndarray:
    """How firmly the selected pose bones hold each vertex (V,): 1 where half of its skin weight is theirs, from there
    less and less over BORDER edges. Raises SceneError.
    """
    rig = checks.armature_modifier(obj).object
    chosen = targets.selected_bones(rig)
    if not chosen:
        raise SceneError(
            "Select in Pose Mode the bones of '{rig}' that hold the skin of '{name}'", rig=rig.name, name=obj.name
        )
    bones = references.rest_skeleton(rig.data).names
    theirs = mesh_data.skin_weights(obj)[:, [bones.index(bone) for bone in chosen]].sum(axis=1)
    if not theirs.any():
        raise SceneError(
            "The selected bones of '{rig}' move no skin of '{name}': select others", rig=rig.name, name=obj.name
        )
    edges = np.empty((len(obj.data.edges), 2), np.int32)
    obj.data.edges.foreach_get("vertices", edges.ravel())
    ends, others = np.concatenate([edges, edges[:, ::-1]]).T
    neighbors = np.maximum(np.bincount(ends, minlength=len(theirs)), 1)
    held = np.clip(2.0 * theirs, 0.0, 1.0)
    for _ in range(BORDER):
        held = np.maximum(held, np.bincount(ends, held[others], len(theirs)) / neighbors)
    return held


class DYNAMORPH_OT_mirror_map(SoftSkinOperator, Operator):
    """Copy the map that is being painted to the other side of the mesh, about its local X axis"""

    bl_idname = "dynamorph.mirror_map"
    bl_label = "Mirror Map"

    to: EnumProperty(
        name="To",
        description="The side to which the map is copied",
        items=(
            ("RIGHT", "Left to Right", "From the character's left, +X, to its right", 0),
            ("LEFT", "Right to Left", "From the character's right, -X, to its left", 1),
        ),
    )

    @classmethod
    def disabled_reason(cls, context):
        disabled_reason = super().disabled_reason(context)
        if not disabled_reason and not any(is_painting(skin.mesh_in(context), which) for which in PAINTED):
            return "Press Paint beside a map first"
        return disabled_reason

    def apply(self, obj):
        points = mesh_data.rest_points(obj)
        partners = targets.mirror_partners(points)
        overwritten = (points[:, 0] < 0.0 if self.to == "RIGHT" else points[:, 0] > 0.0) & (partners >= 0)
        if not overwritten.any():
            raise SceneError("'{name}' is not symmetric about its X axis: paint the other side yourself", name=obj.name)
        name = obj.vertex_groups.active.name
        _check_unlocked(obj, name)
        weights = mesh_data.group_weights(obj, [name])[:, 0]
        _write_group(obj, name, np.where(overwritten, weights[partners], weights))
        alone = int(np.count_nonzero(partners < 0))
        if alone:
            text = rpt_("{count} vertices have no mirror image and stay as they are")
            self.report({"WARNING"}, text.format(count=alone))


def draw_tools(layout, obj, which: str):
    """What helps to paint a map; Blender's own buttons where it has some."""
    column = layout.column(align=True)
    column.use_property_split = False
    if is_painting(obj, which):
        row = column.row(align=True)
        row.operator_context = "EXEC_DEFAULT"
        row.operator("paint.weight_set", text="Fill with Brush Weight", icon="BRUSH_DATA")
        blur = row.operator("object.vertex_group_smooth", text="Blur")
        blur.group_select_mode, blur.factor, blur.repeat = "ACTIVE", 0.5, 2
        row = column.row(align=True)
        for to, text in (("RIGHT", "Left to Right"), ("LEFT", "Right to Left")):
            row.operator("dynamorph.mirror_map", text=text, icon="MOD_MIRROR").to = to
    if which == "SOFT":
        column.operator("dynamorph.hold_bones", icon="BONE_DATA")


CLASSES = (
    DYNAMORPH_OT_paint_group,
    DYNAMORPH_OT_hold_to_group,
    DYNAMORPH_OT_hold_bones,
    DYNAMORPH_OT_mirror_map,
)
register, unregister = of_classes(CLASSES)
