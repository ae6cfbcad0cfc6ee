# SPDX-License-Identifier: GPL-3.0-or-later
"""Drawing only: one function draws the settings in the sidebar and below the Shape Keys panel."""

from __future__ import annotations

import textwrap

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import Menu, Panel, UIList

from . import (
    changes,
    checks,
    comparison,
    feel,
    influence,
    jobs,
    live,
    live_operators,
    pieces,
    properties,
    setup_operators,
    sinks,
    verdict,
)

LINE = 34  # characters that fit into the sidebar at its default width
FEW_BONES = 8  # of a target: more are folded away
FEW_NOTES = 3  # about what is left alone
WIDE = 340  # pixels, at a resolution scale of 1: a list this wide has room for more than names


class DYNAMORPH_UL_targets(UIList):
    """Dynamic morph targets, as Blender lists shape keys. Renaming one here renames its shape key."""

    def draw_item(self, context, layout, data, item, _icon, _active_data, _active_property, index):
        neutral = index == 0
        wide = context.region.width > WIDE * context.preferences.system.ui_scale
        keys = data.id_data.data.shape_keys
        block = keys.key_blocks.get(item.name) if keys and not neutral else None
        row = layout.row(align=True)
        row.enabled = jobs.running is None
        row.active = not item.mute
        split = row.split(factor=0.66 if wide else 1.0)
        if block:
            split.prop(block, "name", text="", icon="SHAPEKEY_DATA", emboss=False)
        else:  # without its key a target cannot be built
            split.label(text=item.name, icon="ARMATURE_DATA" if neutral else "ERROR", translate=False)
        if wide:
            split.label(text=f"{item.stiffness / 1000:.3g} kPa", translate=False)
        if neutral:
            row.label(text="", icon="BLANK1")
        else:
            row.prop(item, "mute", text="", icon="CHECKBOX_DEHLT" if item.mute else "CHECKBOX_HLT", emboss=False)


class DYNAMORPH_MT_targets(Menu):
    """What is done to targets less often."""

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


class DYNAMORPH_UL_pieces(UIList):
    """The pieces of a character, each with what moves it."""

    def draw_item(self, _context, layout, data, item, _icon, _active_data, _active_property, _index):
        row = layout.row(align=True)
        row.enabled = jobs.running is None
        name = item.group or (item.object.name if item.object else item.name)
        if item.group and item.object:
            name = f"{item.object.name}: {name.removeprefix(pieces.PREFIX)}"
        icon = "GROUP_VERTEX" if item.group else "OBJECT_DATA"
        row.label(
            text=name.removeprefix(pieces.PREFIX),
            icon="ERROR" if pieces.problem(data.id_data, item) else icon,
            translate=False,
        )
        row.prop(item, "choice", text="")


class DYNAMORPH_UL_modes(UIList):
    """The modes of the built model."""

    def draw_item(self, _context, layout, _data, item, _icon, _active_data, _active_property, _index):
        row = layout.row(align=True)
        row.label(text=item.name, translate=False)
        row.prop(item, "gain", text="", slider=True)
        row.prop(item, "solo", text="", icon="SOLO_ON" if item.solo else "SOLO_OFF", emboss=False)


def draw_soft_skin(layout, context, obj):
    """The whole interface for one object, in the order of work."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    if jobs.engine_problem():
        draw_message(layout, jobs.engine_problem())
    draw_problems(layout, obj)
    if not obj.dynamorph.targets:
        if obj.dynamorph.follows:
            text = iface_("'{name}' moves with '{body}'").format(name=obj.name, body=obj.dynamorph.follows.name)
            draw_message(layout, text, icon="LINKED")
        if properties.is_shown_on(obj):
            layout.operator("dynamorph.free_bake", icon="X")
        layout.operator("dynamorph.add_soft_skin", icon="ADD")
        return
    draw_feel(layout, obj)
    draw_cage(layout, context, obj)
    draw_pieces(layout, obj)
    draw_targets(layout, obj)
    draw_influence(layout, context, obj)
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


def draw_problem(layout, problem, icon: str):
    row = layout.row()
    draw_message(row, problem.text, icon=icon, width=LINE - 10 if problem.fix else LINE)
    if problem.fix:
        button = row.column()
        button.alignment = "RIGHT"
        button.operator("dynamorph.fix").problem = problem.fix


def draw_feel(layout, obj):
    """How soft the skin feels: the presets, how much of the motion shows, and how far it may go."""
    simulation = obj.dynamorph.simulation
    sliders = layout.column()
    sliders.enabled = jobs.running is None
    sliders.use_property_split = False  # beside them there is no room for the names
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
    column.enabled = jobs.running is None
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
    pair = column.column(align=True)  # side by side their names are cut
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
    row.prop_search(obj.dynamorph, setup_operators.PAINTED[which].field, obj, "vertex_groups")
    text = "Done" if setup_operators.is_painting(obj, which) else "Paint"
    button = row.row(align=True)
    button.ui_units_x = 2.5  # the name of the group needs the rest
    button.operator("dynamorph.paint_group", text=text).which = which
    if text == "Done":
        fill = layout.row()
        fill.operator_context = "EXEC_DEFAULT"
        fill.operator("paint.weight_set", text="Fill with Brush Weight", icon="BRUSH_DATA")


# Pieces of the character -------------------------------------------------------------------------------------------


def draw_pieces(layout, obj):
    settings = obj.dynamorph
    header, body = layout.panel("dynamorph_pieces", default_closed=True)
    count = len(settings.pieces)
    title = iface_("Attachments ({count})").format(count=count) if count else iface_("Attachments")
    header.label(text=title, translate=False)
    if not body:
        return
    row = body.row()
    row.template_list("DYNAMORPH_UL_pieces", "", settings, "pieces", settings, "active_piece_index", rows=3)
    column = row.column(align=True)
    column.operator("dynamorph.add_piece", text="", icon="ADD")
    column.operator("dynamorph.remove_piece", text="", icon="REMOVE")
    column.operator("dynamorph.select_piece", text="", icon="RESTRICT_SELECT_OFF")
    if settings.active_piece:
        draw_piece(body, obj, settings.active_piece)
    if settings.model.one_cage:
        draw_head(body, settings.model)
    body.operator("dynamorph.find_pieces", icon="VIEWZOOM")
    alone = list(pieces.left_alone(obj))
    for text in alone[:FEW_NOTES]:
        draw_message(body, text, icon="INFO")
    if len(alone) > FEW_NOTES:
        draw_message(body, iface_("And {count} more like them").format(count=len(alone) - FEW_NOTES), icon="BLANK1")


def draw_head(layout, model):
    """Whether the skin of the head is held, and which bone that is."""
    row = layout.row()
    row.enabled = jobs.running is None
    row.prop(model, "hold_head")
    if model.hold_head and model.head:
        draw_message(layout, iface_("Held as the head: {bones}").format(bones=model.head), icon="INFO")
    elif model.hold_head:
        layout.label(text="No head was found", icon="INFO")


def draw_piece(layout, obj, piece):
    column = layout.column(align=True)
    column.enabled = jobs.running is None
    if not piece.group or piece.object:
        column.prop(piece, "object")
    if not piece.object or piece.group:
        column.prop_search(piece, "group", piece.object or obj, "vertex_groups")
    if piece.reason:
        draw_message(layout, piece.reason, icon="INFO")
    if pieces.problem(obj, piece):
        draw_message(layout, pieces.problem(obj, piece))
    elif piece.object and piece.choice == "OWN_CAGE" and not piece.object.dynamorph.targets:
        text = iface_("'{name}' needs a soft skin of its own").format(name=piece.object.name)
        draw_message(layout, text, icon="INFO")
        button = layout.row()
        button.context_pointer_set("object", piece.object)
        button.operator("dynamorph.add_soft_skin", icon="ADD")


# Targets -----------------------------------------------------------------------------------------------------------


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
    column.enabled = jobs.running is None
    if not neutral:
        row = column.row(align=True)
        row.prop_search(target, "region", obj, "vertex_groups")
        row.operator("dynamorph.region_from_sculpt", text="", icon="AUTO", depress=target.auto_region)
        column.prop(target, "radius")
    column.prop(target, "influence")
    draw_material(layout, target)


def draw_bones(layout, target):
    """The bones that place a target; a click on one takes it away."""
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
    column.enabled = jobs.running is None
    row = column.row(align=True)
    row.popover("DYNAMORPH_PT_material_presets", text="Material", icon="PRESET")
    row.operator("dynamorph.fit_material", text="Fit Bounce")
    units = column.column(align=True)
    units.enabled = target.is_measured
    for name in ("bounce", "settle", "weight"):
        units.prop(target, name)
    if not target.is_measured:
        column.label(text="Build Model first", icon="INFO")
    header, body = layout.panel("dynamorph_material", default_closed=True)
    header.label(text="Advanced")
    if body:
        body = body.column(align=True)
        body.enabled = jobs.running is None
        for name in ("stiffness", "poisson", "density"):
            body.prop(target, name)
        body.prop(target, "mass_damping")
        body.prop(target, "stiffness_damping", text="Stiff. Damping")  # that much fits


def draw_influence(layout, context, obj):
    """How much each target counts in the present pose, and over the frames."""
    if jobs.engine_problem() or len(obj.dynamorph.targets) < 2:
        return
    header, body = layout.panel("dynamorph_influence", default_closed=True)
    header.label(text="Influence")
    if not body:
        return
    draw_bars(body, context, obj)
    row = body.row(align=True)
    row.use_property_split = False
    row.prop(context.window_manager.dynamorph, "influence", text="Graph", icon="FCURVE", toggle=True)
    row.operator("dynamorph.update_influence", text="", icon="FILE_REFRESH")
    if context.window_manager.dynamorph.influence and influence.problem(obj):
        draw_message(body, influence.problem(obj))
    body.operator("dynamorph.suggest_pose", icon="VIEWZOOM")


def draw_bars(layout, context, obj):
    """Each target's weight now, set by set."""
    depsgraph = context.view_layer.depsgraph
    if depsgraph is None:  # nothing is evaluated yet
        return
    influence.follow_frames()
    try:
        now = influence.weights_now(obj, depsgraph)
    except jobs.expected_errors() as error:
        draw_message(layout, str(error))
        return
    shown = now.by_set()
    for s, targets in shown:
        column = layout.column(align=True)
        if len(shown) > 1:
            column.label(text=now.sets[s].name, icon="GROUP_VERTEX", translate=False)
        for target, weight in zip(now.sets[s].targets, now.weights[0, targets.start : targets.stop], strict=True):
            column.progress(factor=weight, text=f"{target.name}  {weight:.2f}")
        if now.outside[0, s]:
            text = iface_("Outside: {away:.0f}° from the nearest target").format(away=np.degrees(now.nearest[0, s]))
            column.label(text=text, icon="INFO", translate=False)


# Model, Live, bake -------------------------------------------------------------------------------------------------


def draw_model(layout, obj):
    model = obj.dynamorph.model
    header, body = layout.panel("dynamorph_model", default_closed=True)
    header.label(text="Model")
    if body:
        body.enabled = jobs.running is None
        for name in ("method", "law", "solver", "blending", "modes", "fit_to_shot"):
            body.prop(model, name)
    draw_outdated(layout, changes.model_age(obj))
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
        playing = live_operators.is_running("dynamorph.play_mode")
        row.operator("dynamorph.play_mode", icon="PAUSE" if playing else "PLAY", depress=playing)
        row.operator("dynamorph.reset_gains", icon="LOOP_BACK")
    body.operator("dynamorph.check_targets", icon="CHECKMARK")
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
    row.operator("dynamorph.swap_slot", text=f"Settings {slot}", icon="FILE_REFRESH")
    row.operator("dynamorph.copy_slot", text=f"Copy to {'A' if slot == 'B' else 'B'}", icon="COPYDOWN")


def draw_plain(layout, obj):
    """The look at plain skinning in the place of a bake or of Live."""
    if not properties.is_shown_on(obj):
        return
    plain = comparison.is_plain(obj)
    text = "Show Soft Skin" if plain else "Show Plain Skinning"
    layout.operator("dynamorph.show_plain", text=text, icon="HIDE_OFF" if plain else "HIDE_ON", depress=plain)
    if plain:
        draw_message(layout, "This is plain skinning: the soft skin is hidden until you press Show Soft Skin or save")


REMEDIES = {
    "REHEARSE": ("dynamorph.rehearse", "PLAY"),
    "STIFFEN": ("dynamorph.stiffen", "FORCE_HARMONIC"),
    "CAGE": ("dynamorph.refine_cage", "MOD_LATTICE"),
}  # fmt: skip


def draw_verdict(layout, context, obj):
    """How believable the bake looks, where it looks worst, and what mends it."""
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


def draw_bake(layout, context, obj):
    settings = obj.dynamorph
    simulation = settings.simulation
    header, body = layout.panel("dynamorph_simulation", default_closed=True)
    header.label(text="Simulation")
    if body:
        body.enabled = jobs.running is None
        body.prop(simulation, "use_scene_range")
        column = body.column(align=True)
        column.enabled = not simulation.use_scene_range
        column.prop(simulation, "start")
        column.prop(simulation, "end")
        column.prop(simulation, "keep_outside")
        for name in ("substeps", "samples", "scheme", "gravity", "fields", "begin", "preroll", "preroll_pose", "loop"):
            body.prop(simulation, name)
    draw_output(layout, settings.output)
    draw_job(layout, "dynamorph.bake", "REC", "Bake")
    draw_job(layout, "dynamorph.bake_all", "NONE", "Bake All")
    if settings.bake.exists:
        draw_outdated(layout, changes.outdated(obj))
        influence = sinks.influence(obj)
        if influence:
            row = layout.row()
            row.use_property_decorate = True  # it is to be keyed
            row.prop(*influence, text="Influence", slider=True)
        if settings.bake.summary:
            draw_message(layout, settings.bake.summary, icon="CHECKMARK")
            found = verdict.parsed(settings.bake.verdict)
            draw_warnings(layout, settings.bake.warnings, said=found.text if found else "")
        draw_verdict(layout, context, obj)
        layout.operator("dynamorph.free_bake", icon="X")
    draw_export(layout, obj)


def draw_export(layout, obj):
    if jobs.running and jobs.running.goal == "EXPORT_ACTIONS":
        draw_job(layout, "dynamorph.export_actions", "EXPORT")
        return
    row = layout.row(align=True)
    # Menus do not ask the buttons in them; a model alone is enough for the Actions as clips.
    row.enabled = jobs.running is None and (obj.dynamorph.bake.exists or bool(obj.dynamorph.model.content_id))
    row.operator_menu_enum("dynamorph.export", "format", icon="EXPORT")
    row.operator_menu_enum("dynamorph.export_check", "format", text="", icon="VIEWZOOM")


def draw_output(layout, output):
    column = layout.column()
    column.enabled = jobs.running is None
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


# What panels are made of -------------------------------------------------------------------------------------------


def draw_job(layout, operator: str, icon: str, text: str | None = None):
    """The button, with its operator's label or `text`, or in its place the progress of its job."""
    job = jobs.running
    if job is None or operator != f"dynamorph.{job.goal.lower()}":
        layout.operator(operator, text=text, icon=icon)
        return
    row = layout.row(align=True)
    row.progress(factor=job.fraction, text=f"{job.fraction:.0%}  {iface_(job.message)}")
    row.operator("dynamorph.cancel", text="", icon="X")


def draw_outdated(layout, reasons: list[str]):
    """Up to three of the reasons; while a job runs they are those from before."""
    if reasons and not jobs.running:
        more = len(reasons) - 3
        text = iface_("Out of date: {reasons}, and {count} more" if more > 0 else "Out of date: {reasons}")
        draw_message(layout, text.format(reasons=", ".join(reasons[:3]), count=more))


def draw_warnings(layout, warnings: str, said=""):
    """said: what the panel says elsewhere; a warning that begins so is left out."""
    for warning in filter(None, warnings.split("\n")):
        if not (said and warning.startswith(said)):
            draw_message(layout, warning)


def draw_message(layout, text: str, icon="ERROR", width=LINE):
    """Text, translated unless it was put together, and broken into lines, because labels do not wrap."""
    column = layout.column(align=True)
    for i, line in enumerate(textwrap.wrap(iface_(text), width)):
        column.label(text=line, icon="BLANK1" if i else icon, translate=False)


def draw_status(header, _context):
    """What runs, at the left of the status bar; of every window, wherever it was started."""
    batch = jobs.running
    if batch:
        text = iface_("{done:.0%}  {message}    Esc: cancel")
        text = text.format(done=batch.fraction, message=iface_(batch.message))
    elif live_operators.preview:
        text = iface_("{name}    Esc: stop").format(name=iface_(live_operators.preview.label))
    else:
        return
    header.layout.label(text=text, translate=False)


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


CLASSES = (
    DYNAMORPH_UL_targets,
    DYNAMORPH_UL_pieces,
    DYNAMORPH_UL_modes,
    DYNAMORPH_MT_targets,
    DYNAMORPH_PT_sidebar,
    DYNAMORPH_PT_object_data,
)
_register, _unregister = bpy.utils.register_classes_factory(CLASSES)


def register():
    _register()
    bpy.types.STATUSBAR_HT_header.prepend(draw_status)


def unregister():
    bpy.types.STATUSBAR_HT_header.remove(draw_status)
    _unregister()
