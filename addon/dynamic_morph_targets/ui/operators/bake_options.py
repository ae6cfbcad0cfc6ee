# SPDX-License-Identifier: GPL-3.0-or-later
"""The dialog of a bake."""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty
from bpy.types import Operator

from ...scene import skin
from ...scene.properties import bake_properties
from ...scene.registration import of_classes
from ..base import SoftSkinOperator
from .jobs import DYNAMORPH_OT_bake, press


class DYNAMORPH_OT_bake_options(SoftSkinOperator, Operator):
    """Choose where the curves of the bakes go, and bake"""

    bl_idname = "dynamorph.bake_options"
    bl_label = "Bake with Options"
    on_override = True

    to_action: BoolProperty(name="Bake to Action", description=bake_properties.TO_ACTION)

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        return DYNAMORPH_OT_bake.disabled_reason(context)

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        self.to_action = skin.mesh_in(context).dynamorph.output.bake_to_action
        return context.window_manager.invoke_props_dialog(self, confirm_text="Bake")

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.active = skin.mesh_in(context).dynamorph.output.format != "PC2"  # which has no curves
        self.layout.prop(self, "to_action")

    def execute(self, context: bpy.types.Context) -> set[str]:
        result = super().execute(context)
        if result == {"FINISHED"}:
            press(self, "dynamorph.bake")
        return result

    def apply(self, obj: bpy.types.Object) -> None:
        obj.dynamorph.output.bake_to_action = self.to_action


CLASSES = (DYNAMORPH_OT_bake_options,)
register, unregister = of_classes(CLASSES)
