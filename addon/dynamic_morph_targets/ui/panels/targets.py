# SPDX-License-Identifier: GPL-3.0-or-later
"""The sections about targets."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Menu, UIList

from ...core import engine, errors
from ...core.character import region_label
from ...run import remembered
from ...run.tools import weight_curves
from ...scene import skin
from ...scene.check import checks
from ...scene.properties.object_properties import DynamorphSettings
from ...scene.properties.target_properties import DynamorphTarget
from ..widgets import draw_limit, draw_message
from .feel import draw_material, draw_swing

WIDE = 340  # pixels at a resolution scale of 1; a list this wide has room for more than names


class DYNAMORPH_UL_targets(UIList):
    """Dynamic morph targets, as Blender lists shape keys. Renaming one here renames its shape key."""

    def draw_item(
        self,
        context: bpy.types.Context,
        layout: bpy.types.UILayout,
        data: DynamorphSettings,
        item: DynamorphTarget,
        _icon: int,
        _active_data: DynamorphSettings,
        _active_property: str,
        index: int,
    ) -> None:
        neutral = index == 0
        wide = context.region.width > WIDE * context.preferences.system.ui_scale
        keys = data.id_data.data.shape_keys
        block = keys.key_blocks.get(item.name) if keys and not neutral else None
        row = layout.row(align=True)
        row.enabled = remembered.work.running is None
        row.active = not item.mute
        split = row.split(factor=0.66 if wide else 1.0)
        if block:
            split.prop(block, "name", text="", icon="SHAPEKEY_DATA", emboss=False)
        else:  # a target cannot be built without its key
            split.label(text=item.name, icon="ARMATURE_DATA" if neutral else "ERROR", translate=False)
        if wide:
            split.label(text=f"{item.stiffness / 1000:.3g} kPa", translate=False)
        if neutral:
            row.label(text="", icon="BLANK1")
        else:
            row.prop(item, "mute", text="", icon="CHECKBOX_DEHLT" if item.mute else "CHECKBOX_HLT", emboss=False)


class DYNAMORPH_MT_targets(Menu):
    """Less frequent actions on targets."""

    bl_label = "Target Specials"

    def draw(self, _context: bpy.types.Context) -> None:
        layout = self.layout
        layout.operator_context = "INVOKE_DEFAULT"
        layout.operator("dynamorph.suggest_targets", icon="DRIVER")
        layout.operator("dynamorph.add_tension", icon="FORCE_FORCE")
        layout.separator()
        layout.operator("dynamorph.duplicate_target", icon="DUPLICATE")
        layout.operator("dynamorph.mirror_target", icon="ARROW_LEFTRIGHT")
        layout.operator("dynamorph.mirror_target", text="Mirror Target (Overwrite Key)").overwrite = True
        layout.separator()
        layout.operator("dynamorph.use_selected_bones", text="Use Only Selected Bones", icon="BONE_DATA").extend = False
        layout.operator("dynamorph.select_key", icon="SHAPEKEY_DATA")


def draw_targets(layout: bpy.types.UILayout, _context: bpy.types.Context, obj: bpy.types.Object) -> None:
    settings = obj.dynamorph
    draw_target_list(layout, settings)
    if settings.active_target:
        draw_pose(layout, settings)
        draw_extent(layout, obj, settings.active_target)
    for hint in checks.hints(obj):
        draw_message(layout, hint, icon="INFO")


def draw_target_list(layout: bpy.types.UILayout, settings: DynamorphSettings) -> None:
    row = layout.row()
    row.template_list("DYNAMORPH_UL_targets", "", settings, "targets", settings, "active_target_index", rows=5)
    column = row.column(align=True)
    column.operator("dynamorph.add_target", text="", icon="ADD")
    column.operator("dynamorph.remove_target", text="", icon="REMOVE")
    column.separator()
    column.menu("DYNAMORPH_MT_targets", text="", icon="DOWNARROW_HLT")
    column.separator()
    column.operator("dynamorph.move_target", text="", icon="TRIA_UP").direction = "UP"
    column.operator("dynamorph.move_target", text="", icon="TRIA_DOWN").direction = "DOWN"
    if settings.sculpt.active:
        layout.operator("dynamorph.finish_sculpt", icon="CHECKMARK")
    else:
        row = layout.row(align=True)
        row.operator("dynamorph.new_from_pose", icon="SCULPTMODE_HLT")
        row.operator("dynamorph.shape_by_physics", icon="PHYSICS")


def draw_pose(layout: bpy.types.UILayout, settings: DynamorphSettings) -> None:
    """The pose of the selected target."""
    row = layout.row(align=True)
    row.operator("dynamorph.capture_pose", icon="ARMATURE_DATA")
    row.operator("dynamorph.go_to_pose", icon="POSE_HLT")
    if settings.active_target_index > 0:
        row.operator("dynamorph.sculpt_target", text="", icon="SCULPTMODE_HLT")


def draw_extent(layout: bpy.types.UILayout, obj: bpy.types.Object, target: DynamorphTarget) -> None:
    """Where a target counts, on the body and around its pose. The neutral one counts everywhere."""
    if target == obj.dynamorph.targets[0]:
        return
    column = layout.column(align=True)
    column.enabled = remembered.work.running is None
    column.label(text="Region")  # above the name of a group, which needs the whole row
    row = column.row(align=True)
    row.use_property_split = False
    row.prop_search(target, "region", obj, "vertex_groups", text="")
    row.operator("dynamorph.region_from_sculpt", text="", icon="AUTO", depress=target.auto_region)
    draw_limit(column, target, "fade_out_angle")
    draw_channel(column, obj.dynamorph, target)


def draw_channel(layout: bpy.types.UILayout, settings: DynamorphSettings, target: DynamorphTarget) -> None:
    """The slider of the selected target's channel, wherever that comes from, and where the target is reached."""
    channel = settings.channels.get(target.channel)
    if channel is None:
        return
    column = layout.column(align=True)
    row = column.row(align=True)
    row.prop(channel, "value", text=channel.name, translate=False, slider=True)
    row.operator("dynamorph.remove_channel", text="", icon="X")
    column.prop(target, "reached_at")


def bones_title(obj: bpy.types.Object) -> str:
    target = obj.dynamorph.active_target
    return iface_("Bones ({count})").format(count=len(target.bones))


def has_bones(obj: bpy.types.Object) -> bool:
    """Whether bones place the selected target, as all but the neutral one."""
    return obj.dynamorph.active_target_index > 0 and obj.dynamorph.active_target is not None


def draw_bones(layout: bpy.types.UILayout, _context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """The bones that place the selected target; clicking one removes it."""
    column = layout.column(align=True)
    column.operator("dynamorph.use_selected_bones", text="Selected Bones", icon="ADD")
    for bone in obj.dynamorph.active_target.bone_names():
        column.operator("dynamorph.remove_bone", text=bone, icon="X", translate=False).bone = bone


def draw_key(layout: bpy.types.UILayout, context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """What belongs to the active shape key: its target, or how it becomes one."""
    settings, index = obj.dynamorph, skin.target_of_active_key(obj)
    if index is None:
        layout.operator("dynamorph.add_target", icon="ADD").key = obj.active_shape_key.name
    elif index != settings.active_target_index:
        layout.operator("dynamorph.select_target", icon="RESTRICT_SELECT_OFF")
    else:
        target = settings.targets[index]
        draw_pose(layout, settings)
        draw_extent(layout, obj, target)
        draw_swing(layout, target)
        draw_material(layout, context, obj)


def has_weights(obj: bpy.types.Object) -> bool:
    return len(obj.dynamorph.targets) > 1 and not engine.engine_problem()


def draw_target_weights(layout: bpy.types.UILayout, context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """How much each target counts in the current pose and over the frames."""
    row = layout.row(align=True)
    row.use_property_split = False
    row.prop(context.window_manager.dynamorph, "target_weights", text="Graph", icon="FCURVE", toggle=True)
    row.operator("dynamorph.update_target_weights", text="", icon="FILE_REFRESH")
    layout.operator("dynamorph.find_uncovered_pose", icon="VIEWZOOM")
    draw_bars(layout, context, obj)
    if context.window_manager.dynamorph.target_weights and weight_curves.problem(obj):
        draw_message(layout, weight_curves.problem(obj))


def draw_bars(layout: bpy.types.UILayout, context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Each target's weight now, set by set."""
    depsgraph = context.view_layer.depsgraph
    if depsgraph is None:  # nothing has been evaluated yet
        return
    weight_curves.follow_frames()
    try:
        now = weight_curves.weights_now(obj, depsgraph)
    except engine.expected_errors() as error:
        draw_message(layout, errors.sentence(error))
        return
    shown = now.by_set()
    for s, targets in shown:
        column = layout.column(align=True)
        if len(shown) > 1:
            name = now.sets[s].name
            column.label(text=region_label(name) if s else name, icon="GROUP_VERTEX", translate=False)
        for target, weight in zip(now.sets[s].targets, now.weights[0, targets.start : targets.stop], strict=True):
            column.progress(factor=weight, text=f"{target.name}  {weight:.2f}")
        if now.outside[0, s]:
            text = iface_("Uncovered: {away:.0f}° from the nearest target").format(away=np.degrees(now.nearest[0, s]))
            column.label(text=text, icon="INFO", translate=False)
