# SPDX-License-Identifier: GPL-3.0-or-later
"""The sections that say how soft the skin is, and where."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ...core.material import feel
from ...core.painted_map import FIRMNESS, MAX_DISTANCE, PaintedMap
from ...run import remembered
from ...scene.properties.target_properties import DynamorphTarget
from ...write.authoring import painting
from ..operators import painting as paint_operators


def draw_feel(layout: bpy.types.UILayout, _context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """The presets and the amount of the whole skin, and how much and how the tissue of the selected target swings."""
    settings = obj.dynamorph
    layout.enabled = remembered.work.running is None
    column = layout.column(align=True)
    row = column.row(align=True)
    chosen = feel.active(settings.targets[0], settings.simulation)
    for key, preset in feel.FEELS.items():
        row.operator("dynamorph.apply_feel", text=preset.label, depress=key == chosen).feel = key
    column.prop(settings.simulation, "amount", slider=True)
    target = settings.active_target
    if target:
        layout.label(text=name_of(obj, target), icon=icon_of(obj, target), translate=False)
        draw_swing(layout, target)


def name_of(obj: bpy.types.Object, target: DynamorphTarget) -> str:
    """What the settings below are of; without other targets, the neutral one needs no name."""
    return target.name if len(obj.dynamorph.targets) > 1 else iface_("Whole Body")


def icon_of(obj: bpy.types.Object, target: DynamorphTarget) -> str:
    return "ARMATURE_DATA" if target == obj.dynamorph.targets[0] else "SHAPEKEY_DATA"


def draw_swing(layout: bpy.types.UILayout, target: DynamorphTarget) -> None:
    """Amount, Bounce and Settle Time of a target."""
    column = layout.column(align=True)
    if len(target.id_data.dynamorph.targets) > 1:  # alone, it has the whole body's amount
        amount = column.row()
        amount.enabled = remembered.work.running is None
        amount.prop(target, "amount")
    bounce, settle = column.column(align=True), column.column(align=True)
    bounce.enabled = remembered.work.running is None
    bounce.prop(target, "bounce")
    settle.enabled = target.is_measured and remembered.work.running is None
    settle.prop(target, "settle_time")
    if not target.is_measured:
        column.label(text="Measured by the next build", icon="INFO")
    elif not target.bounce:
        column.label(text="Damped too much to swing", icon="INFO")


def draw_material(layout: bpy.types.UILayout, _context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """The material of the selected target in physical units."""
    target = obj.dynamorph.active_target
    layout.enabled = remembered.work.running is None
    if target is None:
        return
    layout.label(text=name_of(obj, target), icon=icon_of(obj, target), translate=False)
    column = layout.column(align=True)
    for name in ("stiffness", "poisson", "density", "mass_damping"):
        column.prop(target, name)
    column.prop(target, "stiffness_damping", text="Stiff. Damping")  # that much fits
    mass = column.column(align=True)
    mass.enabled = target.volume > 0.0
    mass.prop(target, "mass")
    layout.operator("dynamorph.fit_material")


def draw_firmness(layout: bpy.types.UILayout, context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """What a body has by nature, from soft to firm, and the map that these sliders write."""
    column = layout.column(align=True)
    column.enabled = obj.mode != "EDIT"  # Blender changes no vertex group then
    for part in obj.dynamorph.parts:
        column.prop(part, "firmness", text=iface_(part.name), slider=True, translate=False)
    _draw_map(layout, context, obj, FIRMNESS)


def draw_max_distance(layout: bpy.types.UILayout, context: bpy.types.Context, obj: bpy.types.Object) -> None:
    _draw_map(layout, context, obj, MAX_DISTANCE)


def _draw_map(layout: bpy.types.UILayout, context: bpy.types.Context, obj: bpy.types.Object, of: PaintedMap) -> None:
    """A map that is painted."""
    layout.enabled = remembered.work.running is None
    row = layout.row(align=True)
    row.prop_search(obj.dynamorph, of.group, obj, "vertex_groups", text="")  # the name of the group fits
    button = row.row(align=True)
    button.ui_units_x = 2.5
    button.operator(f"dynamorph.paint_{of.name}", text="Done" if painting.is_painting(obj, of) else "Paint")
    paint_operators.draw_tools(layout, obj, of)
    layout.prop(context.window_manager.dynamorph, of.name, icon="OVERLAY", toggle=True)
