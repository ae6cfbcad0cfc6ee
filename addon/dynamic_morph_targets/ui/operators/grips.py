# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons of grips: objects that hold patches of the skin, and drags that are recorded as such."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import StringProperty
from bpy.types import Operator

from ...run import live
from ...run.tools import grabbing
from ...scene import skin
from ...scene.registration import of_classes
from ...write.authoring import grips
from ..base import ElementOperator, SoftSkinOperator


class DYNAMORPH_OT_attach(SoftSkinOperator, Operator):
    """Let the other selected object, or in Pose Mode the active bone, hold the skin where it is now"""

    bl_idname = "dynamorph.attach"
    bl_label = "Attach to Object"

    group: StringProperty(
        name="Group", description="Vertex group of the patch; empty for the nearest skin", options={"SKIP_SAVE"}
    )

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.prop_search(self, "group", skin.mesh_in(context), "vertex_groups")

    def apply(self, obj: bpy.types.Object) -> None:
        holder, bone = grips.holder_in(bpy.context.selected_objects, obj)
        grip = grips.attach(obj, holder, bone, self.group)
        self.report({"INFO"}, rpt_("'{name}' holds the skin from here on: key its Strength").format(name=grip.name))


class GripOperator(ElementOperator):
    """Mixin: works on the grip that is selected in the list."""

    active, nothing_selected = "active_grip", "Select a grip in the list first"


class DYNAMORPH_OT_attach_here(GripOperator, Operator):
    """Let the selected grip hold the skin as it is now, and the patch of its group"""

    bl_idname = "dynamorph.attach_here"
    bl_label = "Attach Here"

    def apply(self, obj: bpy.types.Object) -> None:
        grips.attach_here(obj, obj.dynamorph.active_grip)


class DYNAMORPH_OT_remove_grip(GripOperator, Operator):
    """Let go of the patch of the selected grip. The object that holds it stays"""

    bl_idname = "dynamorph.remove_grip"
    bl_label = "Remove Grip"

    def apply(self, obj: bpy.types.Object) -> None:
        grips.remove(obj, obj.dynamorph.active_grip_index)


class DYNAMORPH_OT_record_drags(SoftSkinOperator, Operator):
    """Record what Grab Soft Skin does while Blender plays; press again to keep it as grips of empties that are keyed"""

    bl_idname = "dynamorph.record_drags"
    bl_label = "Record Drags"

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        reason = super().disabled_reason(context)
        return reason or ("" if live.is_on(skin.mesh_in(context)) else "Press Live Soft Skin first")

    def apply(self, obj: bpy.types.Object) -> None:
        if not grabbing.is_recording(obj):
            grabbing.record(obj)
            return
        self.report({"INFO"}, rpt_("{count} drags were recorded").format(count=grabbing.recorded(obj)))


CLASSES = (DYNAMORPH_OT_attach, DYNAMORPH_OT_attach_here, DYNAMORPH_OT_remove_grip, DYNAMORPH_OT_record_drags)
register, unregister = of_classes(CLASSES)
