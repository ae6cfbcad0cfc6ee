# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons of the list of attachments: eyes, teeth, clothes."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.types import Operator

from ...core.errors import SceneError
from ...run import live
from ...scene import skin
from ...scene.registration import of_classes
from ...write.authoring import attachments, parts
from ...write.bake import writer
from ..base import ElementOperator, SoftSkinOperator, listed


class DYNAMORPH_OT_find_attachments(SoftSkinOperator, Operator):
    """List the other meshes on the armature and the loose parts of this mesh, so that you can choose what moves each"""

    bl_idname = "dynamorph.find_attachments"
    bl_label = "Find Attachments"

    def apply(self, obj: bpy.types.Object) -> set[str]:
        found = attachments.find(obj)
        parts.find(obj)
        if not found:
            self.report({"INFO"}, rpt_("'{name}' has no other attachments").format(name=obj.name))
            return {"CANCELLED"}
        names = listed([name.removeprefix(attachments.PREFIX) for name in found])
        self.report({"INFO"}, rpt_("Found: {names}").format(names=names))
        return {"FINISHED"}


class DYNAMORPH_OT_add_attachment(SoftSkinOperator, Operator):
    """Add the other selected meshes to the list. Without a selection, add an attachment to choose an object for"""

    bl_idname = "dynamorph.add_attachment"
    bl_label = "Add Attachment"

    def apply(self, obj: bpy.types.Object) -> None:
        settings = obj.dynamorph
        known = [each.object for each in settings.attachments]
        selected = [other for other in bpy.context.selected_objects if other.type == "MESH" and other != obj]
        for other in [other for other in selected if other not in known] or [None]:
            attachment = settings.attachments.add()
            attachment.object, attachment.name = other, other.name if other else ""
        settings.active_attachment_index = len(settings.attachments) - 1


class PieceOperator(ElementOperator):
    """Mixin: works on the attachment selected in the list."""

    active, nothing_selected = "active_attachment", "Select an attachment in the list first"


class DYNAMORPH_OT_remove_attachment(PieceOperator, Operator):
    """Remove the selected attachment from the list together with its baked keys. The mesh itself stays"""

    bl_idname = "dynamorph.remove_attachment"
    bl_label = "Remove Attachment"

    def apply(self, obj: bpy.types.Object) -> None:
        active = obj.dynamorph.active_attachment
        mesh = None if active.group else active.object
        if mesh and mesh.dynamorph.follows == obj:
            live.turn_off(mesh)
            writer.free(mesh)
        attachments.remove(obj, obj.dynamorph.active_attachment_index)


class DYNAMORPH_OT_select_attachment(PieceOperator, Operator):
    """Select the attachment in the viewport: its object, or its vertices in Edit Mode"""

    bl_idname = "dynamorph.select_attachment"
    bl_label = "Select Attachment"

    def apply(self, obj: bpy.types.Object) -> None:
        attachment = obj.dynamorph.active_attachment
        problem = attachments.problem(obj, attachment)
        shown = attachment.object or (obj if attachment.group else None)
        if shown is None or (attachment.group and problem):
            raise SceneError(problem)
        if not shown.visible_get():
            raise SceneError("'{name}' is hidden: show it to select it", name=shown.name)
        if bpy.context.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")
        if refusal := skin.edited_elsewhere(shown):
            raise SceneError(refusal)
        for other in bpy.context.selected_objects:
            other.select_set(False)
        shown.select_set(True)
        bpy.context.view_layer.objects.active = shown
        if attachment.group:
            _select_vertices(shown, attachments.members(shown, attachment.group))


def _select_vertices(obj: bpy.types.Object, members: np.ndarray) -> None:
    """Show the vertices (V,) bool selected in Edit Mode."""
    mesh = obj.data
    for elements in (mesh.polygons, mesh.edges):
        elements.foreach_set("select", np.zeros(len(elements), bool))
    mesh.vertices.foreach_set("select", members)
    bpy.context.tool_settings.mesh_select_mode = True, False, False
    bpy.ops.object.mode_set(mode="EDIT")


CLASSES = (
    DYNAMORPH_OT_find_attachments,
    DYNAMORPH_OT_add_attachment,
    DYNAMORPH_OT_remove_attachment,
    DYNAMORPH_OT_select_attachment,
)
register, unregister = of_classes(CLASSES)
