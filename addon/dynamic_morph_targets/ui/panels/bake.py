# SPDX-License-Identifier: GPL-3.0-or-later
"""The sections about the bake and its result, exports and setups."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ...core.errors import RecordError, sentence
from ...core.result import judge
from ...run import remembered
from ...write.bake import baked_action
from ...write.bake import influence as bake_influence
from ..messages import verdict
from ..widgets import draw_limit, draw_message, draw_setting, pair

# The bake ------------------------------------------------------------------------------------------------------------


def is_baked(obj: bpy.types.Object) -> bool:
    return obj.dynamorph.bake.exists


def draw_result(layout: bpy.types.UILayout, _context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """The result of the bake: how much of it shows, how believable it looks, and its way to a game engine."""
    influence = bake_influence.influence(obj)
    if influence:
        row = layout.row()
        row.use_property_decorate = True  # for its keyframe button
        row.prop(*influence, text="Influence", slider=True)
    draw_verdict(layout, obj)
    layout.operator("dynamorph.export", text="Export glTF", icon="EXPORT").format = "GLTF"


def draw_verdict(layout: bpy.types.UILayout, obj: bpy.types.Object) -> None:
    """How believable the bake looks, and the button that repairs it."""
    try:
        found = judge.parsed(obj.dynamorph.bake.verdict)
    except RecordError as unreadable:
        draw_message(layout, sentence(unreadable))
        return
    if found is None:
        return
    draw_message(layout, found.text, icon="CHECKMARK" if found.is_believable else "ERROR")
    if found.is_too_large and not found.is_pressed:
        layout.operator("dynamorph.stiffen", icon="FORCE_HARMONIC")
    if found.held_back:
        draw_message(layout, found.held_back, icon="INFO")
    for text in found.contact_texts:
        draw_message(layout, text, icon="INFO")


def draw_details(layout: bpy.types.UILayout, context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Where the bake looks worst, and what was measured."""
    found = verdict(obj)
    row = layout.row(align=True)
    row.use_property_split = False
    if found:
        text = iface_("Show Frame {frame}").format(frame=round(found.frame))
        row.operator("dynamorph.show_worst", text=text, icon="RESTRICT_SELECT_OFF", translate=False)
    row.prop(context.window_manager.dynamorph, "heat", icon="OVERLAY", toggle=True)
    column = layout.column(align=True)
    for name, value in found.figures.items() if found else ():
        split = column.split(factor=0.55)
        split.label(text=name)
        split.label(text=value, translate=False)
    if obj.dynamorph.bake.summary:
        draw_message(layout, obj.dynamorph.bake.summary, icon="CHECKMARK")


def draw_bake(layout: bpy.types.UILayout, _context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """What is baked, how far the skin may move in it, and what stores the motion."""
    settings = obj.dynamorph
    simulation, output = settings.simulation, settings.output
    layout.enabled = remembered.work.running is None
    draw_setting(layout, settings.model, "quality")
    draw_limit(layout, simulation, "max_displacement")
    layout.prop(simulation, "use_scene_range")
    if not simulation.use_scene_range:
        column = layout.column(align=True)
        for name in ("frame_start", "frame_end", "keep_outside"):
            column.prop(simulation, name)
    layout.prop(simulation, "loop")
    draw_setting(layout, output, "format")
    if baked_action.goes_to_rig(obj):
        draw_message(layout, "Bakes to the armature's Action", icon="ACTION")
    buttons = layout.column(align=True)
    buttons.operator("dynamorph.bake_options")
    buttons.operator("dynamorph.bake_all")


# To and from files ---------------------------------------------------------------------------------------------------


def draw_export(layout: bpy.types.UILayout, _context: bpy.types.Context, obj: bpy.types.Object) -> None:
    row = layout.row(align=True)
    # A menu does not poll its buttons. A model alone is enough to export Actions as clips.
    row.enabled = remembered.work.running is None and (
        obj.dynamorph.bake.exists or bool(obj.dynamorph.model.content_id)
    )
    row.operator_menu_enum("dynamorph.export", "format", icon="EXPORT")
    row.operator_menu_enum("dynamorph.export_check", "format", text="", icon="VIEWZOOM")


def draw_setup(layout: bpy.types.UILayout, _context: bpy.types.Context, _obj: bpy.types.Object) -> None:
    """Setups as files, and copies for other meshes."""
    layout.operator("dynamorph.copy_to_selected", text="Copy to Selected", icon="COPYDOWN")
    row = pair(layout)
    row.operator("dynamorph.save_setup", icon="EXPORT")
    row.operator("dynamorph.load_setup", icon="IMPORT")
