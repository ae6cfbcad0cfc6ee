# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel's sections from the model to the export."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import UIList

from ..core import verdict
from ..run import batch, final_comparison, live, preview
from ..scene import skin, staleness
from ..write import bake_influence, comparison
from .widgets import draw_job, draw_message, draw_outdated, draw_warnings


class DYNAMORPH_UL_modes(UIList):
    """The modes of the built model."""

    def draw_item(self, _context, layout, _data, item, _icon, _active_data, _active_property, _index):
        row = layout.row(align=True)
        row.label(text=item.name, translate=False)
        row.prop(item, "gain", text="", slider=True)
        row.prop(item, "solo", text="", icon="SOLO_ON" if item.solo else "SOLO_OFF", emboss=False)


def draw_model(layout, obj):
    model = obj.dynamorph.model
    header, body = layout.panel("dynamorph_model", default_closed=True)
    header.label(text="Model")
    if body:
        body.enabled = batch.running is None
        for name in ("method", "law", "blending", "basis", "modes", "fit_to_shot"):
            body.prop(model, name)
    draw_outdated(layout, staleness.model_age(obj))
    draw_job(layout, "dynamorph.build", "MOD_LATTICE")
    if model.summary:
        draw_message(layout, model.summary, icon="CHECKMARK")
    draw_warnings(layout, model.warnings)


def draw_modes(layout, obj):
    settings = obj.dynamorph
    header, body = layout.panel("dynamorph_modes", default_closed=True)
    header.label(text="Modes")
    if not body:
        return
    if settings.modes:
        body.template_list("DYNAMORPH_UL_modes", "", settings, "modes", settings, "active_mode_index", rows=4)
        row = body.row(align=True)
        playing = preview.is_running("dynamorph.play_mode")
        row.operator("dynamorph.play_mode", icon="PAUSE" if playing else "PLAY", depress=playing)
        row.operator("dynamorph.reset_gains", icon="LOOP_BACK")
    draw_job(body, "dynamorph.check_targets", "CHECKMARK")
    for line in filter(None, settings.live.checks.split("\n")):
        draw_message(body, line, icon="DOT")


def draw_live(layout, obj):
    header, body = layout.panel("dynamorph_live", default_closed=True)
    header.label(text="Live")
    if not body:
        return
    playing = live.is_on(obj)
    body.operator("dynamorph.live", icon="PAUSE" if playing else "PLAY", depress=playing)
    if playing and live.problem(obj):
        draw_message(body, live.problem(obj))
    elif playing and not bpy.context.scene.render.use_lock_interface:
        draw_message(body, "To render, turn on Lock Interface (Render menu), or bake", icon="INFO")
    column = body.column(align=True)
    column.label(text="Shake Test")
    row = column.row(align=True)
    for kind in ("STOMP", "TWIST", "HOP"):
        row.operator("dynamorph.shake_test", text=kind.capitalize()).kind = kind
    row = body.row(align=True)
    slot = obj.dynamorph.live.slot
    row.operator("dynamorph.swap_slot", text=f"Compare {slot}", icon="FILE_REFRESH")
    row.operator("dynamorph.copy_slot", text=f"Copy to {'A' if slot == 'B' else 'B'}", icon="COPYDOWN")


def draw_plain(layout, obj):
    """The button that shows plain skinning in place of a bake or of Live."""
    if not skin.is_shown_on(obj):
        return
    plain = comparison.is_plain(obj)
    text = "Show Soft Skin" if plain else "Show Plain Skinning"
    layout.operator("dynamorph.show_plain", text=text, icon="HIDE_OFF" if plain else "HIDE_ON", depress=plain)
    if plain:
        draw_message(
            layout, "Plain skinning is shown: the soft skin stays hidden until you press Show Soft Skin or save"
        )


REMEDIES = {
    "REHEARSE": ("dynamorph.rehearse", "PLAY"),
    "STIFFEN": ("dynamorph.stiffen", "FORCE_HARMONIC"),
    "CAGE": ("dynamorph.refine_cage", "MOD_LATTICE"),
}  # fmt: skip


def draw_verdict(layout, context, obj):
    """How believable the bake looks, where it looks worst, and the button that repairs it."""
    found = verdict.parsed(obj.dynamorph.bake.verdict)
    if found is None:
        return
    draw_message(layout, found.text, icon="CHECKMARK" if found.ok else "ERROR")
    column = layout.column(align=True)
    for name, value in found.figures:
        split = column.split(factor=0.55)
        split.label(text=name)
        split.label(text=value, translate=False)
    row = layout.row(align=True)
    row.use_property_split = False
    if found.frame is not None:
        text = iface_("Show Frame {frame}").format(frame=found.frame)
        row.operator("dynamorph.show_worst", text=text, icon="RESTRICT_SELECT_OFF", translate=False)
    row.prop(context.window_manager.dynamorph, "heat", icon="OVERLAY", toggle=True)
    if found.remedy == "SOFTNESS":
        layout.operator("dynamorph.paint_group", text="Paint Softness", icon="WPAINT_HLT").which = "SOFT"
    elif found.remedy:
        operator, icon = REMEDIES[found.remedy]
        layout.operator(operator, icon=icon)


def draw_off_final(layout, obj):
    """How far the bake's reduced motion, which Live shows too, is from Final quality, and the button that finds out."""
    if final_comparison.told(obj):
        draw_message(layout, final_comparison.told(obj), icon="INFO")
    if not final_comparison.disabled_reason(obj):
        draw_job(layout, "dynamorph.compare_final", "NONE")


def draw_bake(layout, context, obj):
    settings = obj.dynamorph
    simulation = settings.simulation
    header, body = layout.panel("dynamorph_simulation", default_closed=True)
    header.label(text="Simulation")
    if body:
        body.enabled = batch.running is None
        body.prop(simulation, "use_scene_range")
        column = body.column(align=True)
        column.enabled = not simulation.use_scene_range
        column.prop(simulation, "start")
        column.prop(simulation, "end")
        column.prop(simulation, "keep_outside")
        for name in ("substeps", "samples", "scheme", "gravity", "fields", "begin", "preroll", "preroll_pose", "loop"):
            body.prop(simulation, name)
    draw_output(layout, settings)
    draw_job(layout, "dynamorph.bake", "REC", "Bake")
    draw_job(layout, "dynamorph.bake_all", "NONE", "Bake All")
    if settings.bake.exists:
        draw_outdated(layout, staleness.outdated(obj))
        influence = bake_influence.influence(obj)
        if influence:
            row = layout.row()
            row.use_property_decorate = True  # for its keyframe button
            row.prop(*influence, text="Bake Influence", slider=True)
        if settings.bake.summary:
            draw_message(layout, settings.bake.summary, icon="CHECKMARK")
            found = verdict.parsed(settings.bake.verdict)
            draw_warnings(layout, settings.bake.warnings, said=found.text if found else "")
        draw_verdict(layout, context, obj)
        draw_off_final(layout, obj)
        layout.operator("dynamorph.free_bake", icon="X")
    draw_export(layout, obj)


def draw_export(layout, obj):
    if batch.running and batch.running.goal == "EXPORT_ACTIONS":
        draw_job(layout, "dynamorph.export_actions", "EXPORT")
        return
    row = layout.row(align=True)
    # A menu does not poll its buttons. A model alone is enough to export Actions as clips.
    row.enabled = batch.running is None and (obj.dynamorph.bake.exists or bool(obj.dynamorph.model.content_id))
    row.operator_menu_enum("dynamorph.export", "format", icon="EXPORT")
    row.operator_menu_enum("dynamorph.export_check", "format", text="", icon="VIEWZOOM")


def draw_output(layout, settings):
    output = settings.output
    column = layout.column()
    column.enabled = batch.running is None
    column.prop(settings.model, "solver")
    column.prop(output, "sink")
    if output.sink == "MODES":
        column.prop(output, "keys")
    elif output.sink == "FRAMES":
        column.prop(output, "tolerance")
        row = column.row()
        row.active = output.tolerance == 0.0
        row.prop(output, "every")


def draw_setup(layout):
    """Setups as files and presets, and copies for other meshes."""
    header, body = layout.panel("dynamorph_setup", default_closed=True)
    header.label(text="Setup")
    if body:
        body.popover("DYNAMORPH_PT_setup_presets", text="Presets", icon="PRESET")
        body.operator("dynamorph.copy_to_selected", text="Copy to Selected", icon="COPYDOWN")
        row = body.row(align=True)
        row.operator("dynamorph.save_setup", icon="EXPORT")
        row.operator("dynamorph.load_setup", icon="IMPORT")
