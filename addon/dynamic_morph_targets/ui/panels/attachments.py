# SPDX-License-Identifier: GPL-3.0-or-later
"""The section about attachments."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.types import UIList

from ...run import remembered
from ...scene.motion import colliders
from ...scene.properties.model_properties import DynamorphAttachment, DynamorphModel
from ...scene.properties.object_properties import DynamorphSettings
from ...write.authoring import attachments
from .. import messages
from ..widgets import draw_message

FEW_NOTES = 3  # notes about meshes that are left alone


class DYNAMORPH_UL_attachments(UIList):
    """The attachments of a character, each with what moves it."""

    def draw_item(
        self,
        _context: bpy.types.Context,
        layout: bpy.types.UILayout,
        data: DynamorphSettings,
        item: DynamorphAttachment,
        _icon: int,
        _active_data: DynamorphSettings,
        _active_property: str,
        _index: int,
    ) -> None:
        row = layout.row(align=True)
        row.enabled = remembered.work.running is None
        name = item.group or (item.object.name if item.object else item.name)
        if item.group and item.object:
            name = f"{item.object.name}: {name.removeprefix(attachments.PREFIX)}"
        icon = "GROUP_VERTEX" if item.group else "OBJECT_DATA"
        row.label(
            text=name.removeprefix(attachments.PREFIX),
            icon="ERROR" if attachments.problem(data.id_data, item) else icon,
            translate=False,
        )
        row.prop(item, "attached_by", text="")


def attachments_title(obj: bpy.types.Object) -> str:
    count = len(obj.dynamorph.attachments)
    return iface_("Attachments ({count})").format(count=count) if count else iface_("Attachments")


def draw_attachments(layout: bpy.types.UILayout, _context: bpy.types.Context, obj: bpy.types.Object) -> None:
    settings = obj.dynamorph
    row = layout.row()
    row.template_list(
        "DYNAMORPH_UL_attachments", "", settings, "attachments", settings, "active_attachment_index", rows=3
    )
    column = row.column(align=True)
    column.operator("dynamorph.add_attachment", text="", icon="ADD")
    column.operator("dynamorph.remove_attachment", text="", icon="REMOVE")
    column.operator("dynamorph.select_attachment", text="", icon="RESTRICT_SELECT_OFF")
    layout.operator("dynamorph.find_attachments", icon="VIEWZOOM")
    draw_head(layout, settings.model)
    if settings.active_attachment:
        draw_attachment(layout, obj, settings.active_attachment)
    alone = list(attachments.left_alone(obj))
    for text in alone[:FEW_NOTES]:
        draw_message(layout, text, icon="INFO")
    if len(alone) > FEW_NOTES:
        draw_message(layout, iface_("And {count} more like them").format(count=len(alone) - FEW_NOTES), icon="BLANK1")


def draw_attachment(layout: bpy.types.UILayout, obj: bpy.types.Object, attachment: DynamorphAttachment) -> None:
    column = layout.column(align=True)
    column.enabled = remembered.work.running is None
    if not attachment.group or attachment.object:
        column.prop(attachment, "object")
    if not attachment.object or attachment.group:
        column.prop_search(attachment, "group", attachment.object or obj, "vertex_groups")
    if attachment.reason:
        draw_message(layout, attachment.reason, icon="INFO")
    wrong = attachments.problem(obj, attachment)
    if wrong:
        if wrong not in {problem.text for problem, _ in messages.messages(obj)}:
            draw_message(layout, wrong)
    elif attachment.object and attachment.attached_by == "OWN_CAGE" and not attachment.object.dynamorph.targets:
        text = iface_("'{name}' needs a soft skin of its own").format(name=attachment.object.name)
        draw_message(layout, text, icon="INFO")
        button = layout.row()
        button.context_pointer_set("object", attachment.object)
        button.operator("dynamorph.add_soft_skin", icon="ADD")
    elif attachment.object in colliders.passing_through(obj):
        text = iface_("'{name}' passes through this body: turn Collision of both on to stop it")
        draw_message(layout, text.format(name=attachment.object.name), icon="INFO")


def draw_head(layout: bpy.types.UILayout, model: DynamorphModel) -> None:
    """Whether the skin of the head is held, and which bone that is."""
    row = layout.row()
    row.enabled = remembered.work.running is None
    row.prop(model, "hold_head")
    if model.hold_head and model.head:
        draw_message(layout, iface_("Held as the head: {bones}").format(bones=model.head), icon="INFO")
    elif model.hold_head:
        layout.label(text="No head was found", icon="INFO")
