# SPDX-License-Identifier: GPL-3.0-or-later
"""The section Advanced, and those below it: the cage, the detail of the model, its modes, and how it is stepped through
time.
"""

from __future__ import annotations

import bpy
from bpy.types import UIList

from ...run import remembered
from ...run.tools import preview
from ...scene.motion import rig_motion
from ...scene.properties import scripted
from ...scene.properties.model_properties import DynamorphMode
from ...scene.properties.object_properties import DynamorphSettings
from ..widgets import draw_limit, draw_message, draw_setting, draw_with_button, pair


class DYNAMORPH_UL_modes(UIList):
    """The modes of the built model."""

    def draw_item(
        self,
        _context: bpy.types.Context,
        layout: bpy.types.UILayout,
        _data: DynamorphSettings,
        item: DynamorphMode,
        _icon: int,
        _active_data: DynamorphSettings,
        _active_property: str,
        _index: int,
    ) -> None:
        row = layout.row(align=True)
        row.label(text=item.name, translate=False)
        row.prop(item, "gain", text="", slider=True)
        row.prop(item, "solo", text="", icon="SOLO_ON" if item.solo else "SOLO_OFF", emboss=False)


def draw_advanced(layout: bpy.types.UILayout, _context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """What a script has set of the settings that no panel has, and what takes it back."""
    for name, text in scripted.changed(obj):
        draw_with_button(layout, text, "SCRIPT", "dynamorph.reset_setting", text="Reset").setting = name


def draw_cage(layout: bpy.types.UILayout, context: bpy.types.Context, obj: bpy.types.Object) -> None:
    model = obj.dynamorph.model
    column = layout.column()
    column.enabled = remembered.work.running is None
    column.prop(model, "cage_nodes")
    draw_setting(column, model, "cage_object")
    layout.operator("dynamorph.build_cage", icon="MESH_ICOSPHERE")
    shown = layout.row()
    shown.enabled = bool(model.cage)
    shown.prop(context.window_manager.dynamorph, "cage", text="Show Cage")
    if model.cage:
        draw_message(layout, model.cage, icon="CHECKMARK")


def draw_detail(layout: bpy.types.UILayout, _context: bpy.types.Context, obj: bpy.types.Object) -> None:
    model = obj.dynamorph.model
    column = layout.column()
    column.enabled = remembered.work.running is None
    column.prop(model, "modes")
    if obj.dynamorph.output.format == "MODES":
        draw_limit(column, obj.dynamorph.output, "keys")
    draw_setting(column, model, "method")
    layout.operator("dynamorph.check_targets", icon="CHECKMARK")
    for line in filter(None, obj.dynamorph.live.checks.split("\n")):
        draw_message(layout, line, icon="DOT")
    if model.summary:
        draw_message(layout, model.summary, icon="CHECKMARK")


def has_modes(obj: bpy.types.Object) -> bool:
    return len(obj.dynamorph.modes) > 0


def draw_modes(layout: bpy.types.UILayout, _context: bpy.types.Context, obj: bpy.types.Object) -> None:
    settings = obj.dynamorph
    layout.template_list("DYNAMORPH_UL_modes", "", settings, "modes", settings, "active_mode_index", rows=4)
    row = pair(layout)
    playing = preview.is_running("dynamorph.play_mode")
    row.operator("dynamorph.play_mode", icon="PAUSE" if playing else "PLAY", depress=playing)
    row.operator("dynamorph.reset_gains", icon="LOOP_BACK")


def draw_solver(layout: bpy.types.UILayout, context: bpy.types.Context, obj: bpy.types.Object) -> None:
    layout.enabled = remembered.work.running is None
    for name in ("speed", "substeps", "samples", "gravity"):
        draw_setting(layout, obj.dynamorph.simulation, name)
    if rig_motion.pushing(context.view_layer):
        draw_setting(layout, obj.dynamorph.simulation, "fields")
        draw_message(layout, "A Wind or Force field of strength 1 pushes with 1 N/m² of skin", icon="INFO")
    draw_setting(layout, obj.dynamorph.simulation, "initial_state")
