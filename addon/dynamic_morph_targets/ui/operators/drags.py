# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons that record how the skin is dragged, as an input of the shot."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.types import Operator

from ...run import live
from ...run.tools import grabbing
from ...scene import skin
from ...scene.registration import of_classes
from ..base import SoftSkinOperator


class DYNAMORPH_OT_record_drags(SoftSkinOperator, Operator):
    """Record what Grab Soft Skin does while Blender plays; press again to keep it for Live and bakes"""

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
        simulation = obj.dynamorph.simulation
        simulation.drags, frames = grabbing.recorded(obj)
        simulation.use_drags = True
        self.report({"INFO"}, rpt_("Drags were recorded in {count} frames").format(count=frames))


class DYNAMORPH_OT_clear_drags(SoftSkinOperator, Operator):
    """Remove the recorded drags"""

    bl_idname = "dynamorph.clear_drags"
    bl_label = "Clear Drags"

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        reason = super().disabled_reason(context)
        return reason or ("" if skin.mesh_in(context).dynamorph.simulation.drags else "No drags are recorded")

    def apply(self, obj: bpy.types.Object) -> None:
        obj.dynamorph.simulation.drags = ""


CLASSES = (DYNAMORPH_OT_record_drags, DYNAMORPH_OT_clear_drags)
register, unregister = of_classes(CLASSES)
