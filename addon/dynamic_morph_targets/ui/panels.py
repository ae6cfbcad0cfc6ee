# SPDX-License-Identifier: GPL-3.0-or-later
"""Drawing only: one function draws the settings in the sidebar and below the Shape Keys panel."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Panel

from ..core import engine, feel
from ..core.time_left import clock
from ..run import batch, preview
from ..scene import checks, skin
from ..scene.registration import of_classes
from . import paint_operators
from .panel_attachments import DYNAMORPH_UL_pieces, draw_pieces
from .panel_bake import DYNAMORPH_UL_modes, draw_bake, draw_live, draw_model, draw_modes, draw_plain, draw_setup
from .panel_targets import DYNAMORPH_MT_targets, DYNAMORPH_UL_targets, draw_target_weights, draw_targets
from .widgets import draw_job, draw_message, draw_problem, progress_text


def draw_soft_skin(layout, context, obj):
    """The whole interface for one object, in the order of work."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    if engine.engine_problem():
        draw_message(layout, engine.engine_problem())
    draw_problems(layout, obj)
    if not obj.dynamorph.targets:
        if obj.dynamorph.follows:
            text = iface_("'{name}' moves with '{body}'").format(name=obj.name, body=obj.dynamorph.follows.name)
            draw_message(layout, text, icon="LINKED")
        if skin.is_shown_on(obj):
            layout.operator("dynamorph.free_bake", icon="X")
        layout.operator("dynamorph.add_soft_skin", icon="ADD")
        return
    draw_feel(layout, obj)
    draw_cage(layout, context, obj)
    draw_pieces(layout, obj)
    draw_targets(layout, obj)
    draw_target_weights(layout, context, obj)
    draw_model(layout, obj)
    draw_modes(layout, obj)
    draw_live(layout, obj)
    draw_bake(layout, context, obj)
    draw_plain(layout, obj)
    draw_setup(layout)


# Checks and cage ---------------------------------------------------------------------------------------------------


def draw_problems(layout, obj):
    """What keeps this mesh from being a soft skin, each with its Fix."""
    for problem in checks.problems(obj):
        draw_problem(layout, problem, "ERROR")
    if not obj.dynamorph.targets:
        return
    for problem in (*checks.next_steps(obj), *checks.notes(obj)):
        draw_problem(layout, problem, "INFO")
    outgrown = checks.outgrown(obj)
    if outgrown:
        draw_message(layout, outgrown)
        draw_job(layout, "dynamorph.build", "MOD_LATTICE")


def draw_feel(layout, obj):
    """How soft the skin feels: the presets, how much of the motion shows, and its limits."""
    simulation = obj.dynamorph.simulation
    sliders = layout.column()
    sliders.enabled = batch.running is None
    sliders.use_property_split = False  # there is no room for the names beside them
    column = sliders.column(align=True)
    row = column.row(align=True)
    chosen = feel.active(obj.dynamorph.targets[0], simulation)
    for key, preset in feel.FEELS.items():
        row.operator("dynamorph.apply_feel", text=preset.label, depress=key == chosen).feel = key
    column.prop(simulation, "amount", slider=True)
    column = sliders.column(align=True)
    column.prop(simulation, "max_displacement")
    column.prop(simulation, "max_thickness")
    if simulation.rehearsed:
        draw_message(layout, simulation.rehearsed, icon="INFO")


def draw_cage(layout, context, obj):
    settings = obj.dynamorph
    header, body = layout.panel("dynamorph_cage", default_closed=True)
    header.label(text="Cage")
    if not body:
        return
    column = body.column()
    column.enabled = batch.running is None
    column.prop(settings.model, "cage_nodes")
    column.prop(settings.model, "cage_object")
    thickness = column.row()
    thickness.active = settings.model.cage_object is None
    thickness.prop(settings.model, "cage_thickness")
    column.prop(settings.model, "cage_grading")
    column.prop(settings.model, "hold")
    pinning = column.row()
    pinning.active = settings.model.hold == "BONES"
    pinning.prop(settings.model, "pin_radius")
    column.prop(settings.model, "separate")
    column.prop(settings.model, "one_cage")
    draw_painted_group(column, obj, "SOFT")
    pair = column.column(align=True)  # side by side, their names would be cut off
    pair.use_property_split = False
    pair.prop(context.window_manager.dynamorph, "hold", icon="OVERLAY", toggle=True)
    pair.operator("dynamorph.hold_to_group", icon="GROUP_VERTEX")
    draw_painted_group(column, obj, "STIFFNESS")
    if settings.stiffness_group:
        column.prop(settings, "stiffness_factor")
    draw_job(body, "dynamorph.build_cage", "MESH_ICOSPHERE")
    if settings.model.cage:
        draw_message(body, settings.model.cage, icon="CHECKMARK")
        body.prop(context.window_manager.dynamorph, "cage", text="Show Cage")


def draw_painted_group(layout, obj, which: str):
    row = layout.row(align=True)
    row.prop_search(obj.dynamorph, paint_operators.PAINTED[which].field, obj, "vertex_groups")
    text = "Done" if paint_operators.is_painting(obj, which) else "Paint"
    button = row.row(align=True)
    button.ui_units_x = 2.5  # the name of the group needs the rest
    button.operator("dynamorph.paint_group", text=text).which = which
    if text == "Done":
        fill = layout.row()
        fill.operator_context = "EXEC_DEFAULT"
        fill.operator("paint.weight_set", text="Fill with Brush Weight", icon="BRUSH_DATA")


def draw_status(header, _context):
    """What runs, at the left of the status bar of every window, wherever it was started."""
    work = batch.running
    if work:
        text = iface_("{progress}    Esc: cancel").format(progress=progress_text(work))
    elif preview.preview:
        seconds = preview.preview.seconds_left
        text = iface_("{name}    Esc: stop" if seconds is None else "{name}  {time} left    Esc: stop")
        text = text.format(name=iface_(preview.preview.label, "Operator"), time=clock(seconds or 0.0))
    else:
        return
    header.layout.label(text=text, translate=False)


class SoftSkinPanel:
    bl_label = "Dynamorph"

    @classmethod
    def poll(cls, context):
        return skin.mesh_in(context) is not None

    def draw(self, context):
        obj = skin.mesh_in(context)
        if obj != context.object:  # the armature is active
            self.layout.label(text=obj.name, icon="MESH_DATA", translate=False)
        draw_soft_skin(self.layout, context, obj)


class DYNAMORPH_PT_sidebar(SoftSkinPanel, Panel):
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Dynamorph"


class DYNAMORPH_PT_object_data(SoftSkinPanel, Panel):
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "data"
    bl_parent_id = "DATA_PT_shape_keys"
    bl_options = {"DEFAULT_CLOSED"}


CLASSES = (
    DYNAMORPH_UL_targets,
    DYNAMORPH_UL_pieces,
    DYNAMORPH_UL_modes,
    DYNAMORPH_MT_targets,
    DYNAMORPH_PT_sidebar,
    DYNAMORPH_PT_object_data,
)
_register, _unregister = of_classes(CLASSES)


def register():
    _register()
    bpy.types.STATUSBAR_HT_header.prepend(draw_status)


def unregister():
    bpy.types.STATUSBAR_HT_header.remove(draw_status)
    _unregister()
