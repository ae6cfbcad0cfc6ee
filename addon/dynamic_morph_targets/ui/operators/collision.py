# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons that let other objects stop the soft skin."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.types import Operator

from ...scene import skin
from ...scene.registration import of_classes
from ...write.authoring import collision
from ..base import SoftSkinOperator, listed


class DYNAMORPH_OT_collide(SoftSkinOperator, Operator):
    """Give the other selected meshes Blender's Collision, and let the soft skin collide with them"""

    bl_idname = "dynamorph.collide"
    bl_label = "Collide with Selected"

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        reason = super().disabled_reason(context)
        return reason or ("" if _others(context) else "Select other mesh objects too")

    def apply(self, obj: bpy.types.Object) -> None:
        names = collision.add_collision(obj, _others(bpy.context))
        text = rpt_("'{name}' collides with {names}").format(name=obj.name, names=listed(names))
        self.report({"INFO"}, text)


def _others(context: bpy.types.Context) -> list:
    """The selected meshes beside that of the context."""
    obj = skin.mesh_in(context)
    return [other for other in context.selected_objects if other.type == "MESH" and other != obj]


class DYNAMORPH_OT_add_floor(SoftSkinOperator, Operator):
    """Add a plane with Blender's Collision below the soft skin as it stands now"""

    bl_idname = "dynamorph.add_floor"
    bl_label = "Add Floor"

    def apply(self, obj: bpy.types.Object) -> None:
        collision.add_floor(obj)


CLASSES = (DYNAMORPH_OT_collide, DYNAMORPH_OT_add_floor)
register, unregister = of_classes(CLASSES)
