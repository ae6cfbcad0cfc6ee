# SPDX-License-Identifier: GPL-3.0-or-later
"""Drawing only: one function draws the settings in the sidebar and below the Shape Keys panel."""

from __future__ import annotations

import textwrap

import bpy
from bpy.types import Panel, UIList

from . import jobs, properties

LINE = 36  # characters that fit into the sidebar at its default width


class DYNAMORPH_UL_targets(UIList):
    """Dynamic morph targets, as Blender lists shape keys."""

    def draw_item(self, _context, layout, data, item, _icon, _active_data, _active_property, index):
        neutral = index == 0
        keys = data.id_data.data.shape_keys
        gone = not neutral and (keys is None or item.name not in keys.key_blocks)
        icon = "ERROR" if gone else "ARMATURE_DATA" if neutral else "SHAPEKEY_DATA"
        row = layout.row()
        row.active = not item.mute
        row.label(text=item.name, icon=icon, translate=False)
        if not neutral:
            row.enabled = jobs.running is None
            row.prop(item, "mute", text="", icon="CHECKBOX_DEHLT" if item.mute else "CHECKBOX_HLT", emboss=False)


def draw_soft_skin(layout, context, obj):
    """The whole interface for one object, in the order of work."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    if jobs.engine_problem():
        draw_message(layout, jobs.engine_problem())
    draw_problems(layout, obj)
    if not obj.dynamorph.targets:
        layout.operator("dynamorph.add_soft_skin", icon="ADD")
        return
    draw_cage(layout, context, obj)
    draw_targets(layout, obj)
    draw_influence(layout, context, obj)
    draw_model(layout, obj)
    draw_modes(layout, obj)
    draw_live(layout, obj)
    draw_bake(layout, obj)
    draw_setup(layout, obj)


# Checks and cage ---------------------------------------------------------------------------------------------------


def draw_problems(layout, obj):
    """What keeps this mesh from being a soft skin, each with its Fix."""


def draw_cage(layout, context, obj):
    settings = obj.dynamorph
    header, body = layout.panel("dynamorph_cage", default_closed=True)
    header.label(text="Cage")
    if body:
        body.enabled = jobs.running is None
        body.prop(settings.model, "cage_nodes")
        body.prop(settings.model, "pin_radius")
        body.prop_search(settings, "soft_group", obj, "vertex_groups")


# Targets -----------------------------------------------------------------------------------------------------------


def draw_targets(layout, obj):
    settings = obj.dynamorph
    header, body = layout.panel("dynamorph_targets")
    header.label(text="Targets")
    if body:
        draw_target_list(body, settings)
        if settings.active_target:
            draw_target(body, obj, settings.active_target)


def draw_target_list(layout, settings):
    row = layout.row()
    row.template_list("DYNAMORPH_UL_targets", "", settings, "targets", settings, "active_target_index", rows=4)
    column = row.column(align=True)
    column.operator("dynamorph.add_target", text="", icon="ADD")
    column.operator("dynamorph.remove_target", text="", icon="REMOVE")


def draw_target(layout, obj, target):
    neutral = target == obj.dynamorph.targets[0]
    column = layout.column(align=True)
    column.operator("dynamorph.capture_pose", icon="ARMATURE_DATA")
    if not neutral:
        column.operator("dynamorph.use_selected_bones", icon="BONE_DATA")
        draw_message(layout, "Bones: " + (", ".join(target.bone_names()) or "none"), icon="BONE_DATA")
    column = layout.column(align=True)
    column.enabled = jobs.running is None
    if not neutral:
        column.prop_search(target, "region", obj, "vertex_groups")
        column.prop(target, "radius")
    draw_material(column, target)


def draw_material(column, target):
    row = column.row(align=True)
    row.popover("DYNAMORPH_PT_material_presets", text="Material", icon="PRESET")
    row.operator("dynamorph.fit_material", text="Bounce")
    for name in ("stiffness", "poisson", "density"):
        column.prop(target, name)
    column.prop(target, "mass_damping", text="Damping Mass")
    column.prop(target, "stiffness_damping", text="Stiffness")


def draw_influence(layout, context, obj):
    """How much each target counts in the present pose, and over the frames."""


# Model, Live, bake -------------------------------------------------------------------------------------------------


def draw_model(layout, obj):
    model = obj.dynamorph.model
    header, body = layout.panel("dynamorph_model", default_closed=True)
    header.label(text="Model")
    if body:
        body.enabled = jobs.running is None
        for name in ("method", "law", "solver", "blending", "modes", "fit_to_shot"):
            body.prop(model, name)
    if model.stale:
        draw_message(layout, f"Out of date: {model.stale}")
    draw_job(layout, "dynamorph.build", "Build Model", "MOD_LATTICE")
    if model.summary:
        draw_message(layout, model.summary, icon="CHECKMARK")
        draw_warnings(layout, model.warnings)


def draw_modes(layout, obj):
    """The modes of the built model, to look at and to weigh."""


def draw_live(layout, obj):
    """Simulation during playback."""


def draw_bake(layout, obj):
    settings = obj.dynamorph
    simulation = settings.simulation
    header, body = layout.panel("dynamorph_simulation", default_closed=True)
    header.label(text="Simulation")
    if body:
        body.enabled = jobs.running is None
        body.prop(simulation, "use_scene_range")
        column = body.column(align=True)
        column.active = not simulation.use_scene_range
        column.prop(simulation, "start")
        column.prop(simulation, "end")
        for name in ("substeps", "scheme", "gravity", "fields", "preroll"):
            body.prop(simulation, name)
    draw_job(layout, "dynamorph.bake", "Bake", "REC")
    if settings.bake.keys:
        if settings.bake.summary:
            draw_message(layout, settings.bake.summary, icon="CHECKMARK")
            draw_warnings(layout, settings.bake.warnings)
        layout.operator("dynamorph.free_bake", icon="X")


def draw_setup(layout, obj):
    """Setups as files and presets, and copies for other meshes."""
    header, body = layout.panel("dynamorph_setup", default_closed=True)
    header.label(text="Setup")
    if body:
        body.popover("DYNAMORPH_PT_setup_presets", text="Presets", icon="PRESET")
        body.operator("dynamorph.copy_to_selected", text="Copy to Selected", icon="COPYDOWN")
        row = body.row(align=True)
        row.operator("dynamorph.save_setup", icon="EXPORT")
        row.operator("dynamorph.load_setup", icon="IMPORT")


# Pieces ------------------------------------------------------------------------------------------------------------


def draw_job(layout, operator: str, text: str, icon: str):
    """The button, or in its place the progress of its job."""
    job = jobs.running
    if job is None or operator != f"dynamorph.{job.goal.lower()}":
        layout.operator(operator, text=text, icon=icon)
        return
    row = layout.row(align=True)
    row.progress(factor=job.fraction, text=f"{job.name}: {job.message}")
    row.operator("dynamorph.cancel", text="", icon="X")


def draw_warnings(layout, warnings: str):
    for warning in filter(None, warnings.split("\n")):
        draw_message(layout, warning)


def draw_message(layout, text: str, icon="ERROR"):
    """Text broken into lines, because labels do not wrap."""
    column = layout.column(align=True)
    for i, line in enumerate(textwrap.wrap(text, LINE)):
        column.label(text=line, icon="BLANK1" if i else icon, translate=False)


class SoftSkinPanel:
    bl_label = "Dynamorph"

    @classmethod
    def poll(cls, context):
        return properties.mesh_in(context) is not None

    def draw(self, context):
        obj = properties.mesh_in(context)
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


CLASSES = (DYNAMORPH_UL_targets, DYNAMORPH_PT_sidebar, DYNAMORPH_PT_object_data)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
