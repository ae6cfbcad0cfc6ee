# SPDX-License-Identifier: GPL-3.0-or-later
"""The section about grips."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import UIList

from ...core import errors
from ...run import remembered
from ...scene.motion import grips
from ...scene.properties.grip_properties import DynamorphGrip
from ...scene.properties.object_properties import DynamorphSettings
from ..widgets import draw_message, draw_record


class DYNAMORPH_UL_grips(UIList):
    """What holds patches of the skin."""

    def draw_item(
        self,
        _context: bpy.types.Context,
        layout: bpy.types.UILayout,
        _data: DynamorphSettings,
        item: DynamorphGrip,
        _icon: int,
        _active_data: DynamorphSettings,
        _active_property: str,
        _index: int,
    ) -> None:
        row = layout.row(align=True)
        row.enabled = remembered.work.running is None
        row.active = not item.mute
        row.label(text=item.name, icon="BONE_DATA" if item.bone else "OBJECT_DATA", translate=False)
        row.prop(item, "mute", text="", icon="CHECKBOX_DEHLT" if item.mute else "CHECKBOX_HLT", emboss=False)


def grips_title(obj: bpy.types.Object) -> str:
    count = len(obj.dynamorph.grips)
    return iface_("Grips ({count})").format(count=count) if count else iface_("Grips")


def draw_grips(layout: bpy.types.UILayout, _context: bpy.types.Context, obj: bpy.types.Object) -> None:
    settings = obj.dynamorph
    row = layout.row()
    row.template_list("DYNAMORPH_UL_grips", "", settings, "grips", settings, "active_grip_index", rows=3)
    column = row.column(align=True)
    column.operator("dynamorph.attach", text="", icon="ADD")
    column.operator("dynamorph.remove_grip", text="", icon="REMOVE")
    grip = settings.active_grip
    if grip:
        column = layout.column(align=True)
        column.enabled = remembered.work.running is None
        column.prop(grip, "strength")
        column.prop_search(grip, "group", obj, "vertex_groups")
        layout.operator("dynamorph.attach_here", icon="PINNED")
    draw_record(layout, obj)
    try:
        for problem in grips.problems(obj):
            draw_message(layout, problem.text)
    except errors.RecordError as error:
        draw_message(layout, errors.sentence(error))
