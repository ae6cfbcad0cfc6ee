# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel's section about targets."""

from __future__ import annotations

import numpy as np
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Menu, UIList

from ..core import engine, errors
from ..core.character import region_label
from ..run import batch, weight_curves
from ..scene import checks
from .widgets import draw_job, draw_message

FEW_BONES = 8  # more bones of a target than these are folded away
WIDE = 340  # pixels at a resolution scale of 1; a list this wide has room for more than names


class DYNAMORPH_UL_targets(UIList):
    """Dynamic morph targets, as Blender lists shape keys. Renaming one here renames its shape key."""

    def draw_item(self, context, layout, data, item, _icon, _active_data, _active_property, index):
        neutral = index == 0
        wide = context.region.width > WIDE * context.preferences.system.ui_scale
        keys = data.id_data.data.shape_keys
        block = keys.key_blocks.get(item.name) if keys and not neutral else None
        row = layout.row(align=True)
        row.enabled = batch.running is None
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

    def draw(self, _context):
        layout = self.layout
        layout.operator_context = "INVOKE_DEFAULT"
        layout.operator("dynamorph.suggest_targets", icon="DRIVER")
        layout.separator()
        layout.operator("dynamorph.duplicate_target", icon="DUPLICATE")
        layout.operator("dynamorph.mirror_target", icon="ARROW_LEFTRIGHT")
        layout.operator("dynamorph.mirror_target", text="Mirror Target (Overwrite Key)").overwrite = True
        layout.separator()
        layout.operator("dynamorph.use_selected_bones", text="Use Only Selected Bones", icon="BONE_DATA").extend = False
        layout.operator("dynamorph.select_key", icon="SHAPEKEY_DATA")


def draw_targets(layout, obj):
    settings = obj.dynamorph
    header, body = layout.panel("dynamorph_targets")
    header.label(text="Targets")
    if body:
        draw_target_list(body, settings)
        for hint in checks.hints(obj):
            draw_message(body, hint, icon="INFO")
        if settings.active_target:
            draw_target(body, obj, settings.active_target)


def draw_target_list(layout, settings):
    row = layout.row()
    row.template_list("DYNAMORPH_UL_targets", "", settings, "targets", settings, "active_target_index", rows=5)
    column = row.column(align=True)
    column.operator("dynamorph.add_target", text="", icon="ADD")
    column.operator("dynamorph.remove_target", text="", icon="REMOVE")
    column.separator()
    column.menu("DYNAMORPH_MT_targets", text="", icon="DOWNARROW_HLT")
    if len(settings.targets) > 2:
        column.separator()
        column.operator("dynamorph.move_target", text="", icon="TRIA_UP").direction = "UP"
        column.operator("dynamorph.move_target", text="", icon="TRIA_DOWN").direction = "DOWN"
    if len(settings.targets) == 1:
        layout.operator("dynamorph.add_target", icon="ADD")
    if settings.sculpt.active:
        layout.operator("dynamorph.finish_sculpt", icon="CHECKMARK")
    else:
        layout.operator("dynamorph.new_from_pose", icon="SCULPTMODE_HLT")


def draw_target(layout, obj, target):
    neutral = target == obj.dynamorph.targets[0]
    row = layout.row(align=True)
    row.operator("dynamorph.capture_pose", icon="ARMATURE_DATA")
    row.operator("dynamorph.go_to_pose", icon="POSE_HLT")
    if not neutral:
        row.operator("dynamorph.sculpt_target", text="", icon="SCULPTMODE_HLT")
        draw_bones(layout, target)
    column = layout.column(align=True)
    column.enabled = batch.running is None
    if not neutral:
        row = column.row(align=True)
        row.prop_search(target, "region", obj, "vertex_groups")
        row.operator("dynamorph.region_from_sculpt", text="", icon="AUTO", depress=target.auto_region)
        column.prop(target, "radius")
    column.prop(target, "influence")
    draw_material(layout, target)


def draw_bones(layout, target):
    """The bones that place a target; clicking one removes it."""
    bones = target.bone_names()
    if len(bones) > FEW_BONES:
        header, layout = layout.panel("dynamorph_bones", default_closed=True)
        header.label(text=iface_("{count} Bones").format(count=len(bones)), translate=False)
        if not layout:
            return
    flow = layout.grid_flow(row_major=True, columns=2, even_columns=True, align=True)
    for bone in bones:
        flow.operator("dynamorph.remove_bone", text=bone, icon="X", translate=False).bone = bone
    flow.operator("dynamorph.use_selected_bones", text="Selected Bones", icon="ADD")


def draw_material(layout, target):
    column = layout.column(align=True)
    column.enabled = batch.running is None
    row = column.row(align=True)
    row.popover("DYNAMORPH_PT_material_presets", text="Material", icon="PRESET")
    row.operator("dynamorph.fit_material", text="Fit Bounce")
    units = column.column(align=True)
    units.enabled = target.is_measured
    for name in ("bounce", "settle_time", "weight"):
        units.prop(target, name)
    if not target.is_measured:
        column.label(text="Build Model first", icon="INFO")
    header, body = layout.panel("dynamorph_material", default_closed=True)
    header.label(text="Advanced")
    if body:
        body = body.column(align=True)
        body.enabled = batch.running is None
        for name in ("stiffness", "poisson", "density"):
            body.prop(target, name)
        body.prop(target, "mass_damping")
        body.prop(target, "stiffness_damping", text="Stiff. Damping")  # that much fits


def draw_target_weights(layout, context, obj):
    """How much each target counts in the current pose and over the frames."""
    if engine.engine_problem() or len(obj.dynamorph.targets) < 2:
        return
    header, body = layout.panel("dynamorph_influence", default_closed=True)
    header.label(text="Target Weights")
    if not body:
        return
    draw_bars(body, context, obj)
    row = body.row(align=True)
    row.use_property_split = False
    row.prop(context.window_manager.dynamorph, "target_weights", text="Graph", icon="FCURVE", toggle=True)
    row.operator("dynamorph.update_influence", text="", icon="FILE_REFRESH")
    if context.window_manager.dynamorph.target_weights and weight_curves.problem(obj):
        draw_message(body, weight_curves.problem(obj))
    draw_job(body, "dynamorph.suggest_pose", "VIEWZOOM")


def draw_bars(layout, context, obj):
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
