# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons that let other objects stop the soft skin."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.types import Operator

from ...core.message import Message
from ...scene import skin
from ...scene.registration import of_classes
from ...write.authoring import collision
from ..base import SoftSkinOperator, listed

CONVERTIBLE = {"CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME"}  # into meshes


class DYNAMORPH_OT_collide(SoftSkinOperator, Operator):
    """Select other meshes beside the soft skin first: they get Blender's Collision, and it collides with them"""

    bl_idname = "dynamorph.collide"
    bl_label = "Collide with Selected"

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        reason = super().disabled_reason(context)
        return reason or ("" if _others(context) else _why_none(context))

    def apply(self, obj: bpy.types.Object) -> None:
        names = collision.add_collision(obj, _others(bpy.context))
        text = rpt_("'{name}' collides with {names}").format(name=obj.name, names=listed(names))
        self.report({"INFO"}, text)


def _others(context: bpy.types.Context) -> list:
    """The selected meshes beside that of the context."""
    obj = skin.mesh_in(context)
    return [other for other in context.selected_objects if other.type == "MESH" and other != obj]


def _why_none(context: bpy.types.Context) -> str:
    """What to do before the selected objects can collide, if there are some."""
    for other in context.selected_objects:
        if other.type == "EMPTY" and other.instance_type == "COLLECTION":
            text = "'{name}' has instances: make them real first (Object > Apply > Make Instances Real)"
            return Message(text, name=other.name)
        if other.type in CONVERTIBLE:
            return Message("'{name}' is no mesh: convert it first (Object > Convert > Mesh)", name=other.name)
    return "Select other mesh objects too"


class DYNAMORPH_OT_add_floor(SoftSkinOperator, Operator):
    """Add a plane with Blender's Collision below the soft skin as it stands now. Nothing else needs to be selected"""

    bl_idname = "dynamorph.add_floor"
    bl_label = "Add Floor"

    def apply(self, obj: bpy.types.Object) -> None:
        collision.add_floor(obj)


CLASSES = (DYNAMORPH_OT_collide, DYNAMORPH_OT_add_floor)
register, unregister = of_classes(CLASSES)
