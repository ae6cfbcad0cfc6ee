# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons of channels: numbers that place a target beside its bones."""

from __future__ import annotations

import bpy
from bpy.props import StringProperty
from bpy.types import Operator

from ...core.errors import SceneError
from ...scene import skin
from ...scene.registration import of_classes
from ...write.authoring import channels, regions
from ..base import SoftSkinOperator, TargetOperator


class DYNAMORPH_OT_add_channel(TargetOperator, Operator):
    """Let this property place the selected target too, which is reached at the property's present value"""

    bl_idname = "dynamorph.add_channel"
    bl_label = "Add Channel"

    data_path: StringProperty(
        name="Full Data Path",
        description="The property, as Copy Full Data Path gives it",
        options={"SKIP_SAVE"},
    )

    def apply(self, obj: bpy.types.Object) -> None:
        channels.add(obj, obj.dynamorph.active_target, channels.named(self.data_path))


class DYNAMORPH_OT_remove_channel(TargetOperator, Operator):
    """Let bones alone place the selected target. A channel that places no other target is removed"""

    bl_idname = "dynamorph.remove_channel"
    bl_label = "Remove Channel"

    def apply(self, obj: bpy.types.Object) -> None:
        obj.dynamorph.active_target.channel = ""
        channels.remove_unused(obj)
        regions.update(obj)


class DYNAMORPH_OT_add_tension(SoftSkinOperator, Operator):
    """Add a slider that tenses the selected target's region, or the whole body, by a firm target without any bone"""

    bl_idname = "dynamorph.add_tension"
    bl_label = "Add Tension"

    region: StringProperty(
        name="Region", description="Vertex group that tenses; empty for the whole body", options={"SKIP_SAVE"}
    )

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.prop_search(self, "region", skin.mesh_in(context), "vertex_groups")

    def apply(self, obj: bpy.types.Object) -> None:
        target = obj.dynamorph.active_target
        if target and not self.properties.is_property_set("region"):
            self.region = target.region
        if self.region and self.region not in obj.vertex_groups:
            raise SceneError("'{name}' has no vertex group '{region}'", name=obj.name, region=self.region)
        channels.add_tension(obj, self.region)


def draw_add_channel(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    """In the menu of every property of Blender's."""
    found = getattr(context, "property", None)
    if not found or found[2] >= 0 or not isinstance(found[0], bpy.types.ID):
        return
    owner, path, _ = found
    if path.startswith("dynamorph.") or not DYNAMORPH_OT_add_channel.poll(context):
        return
    try:
        channels.Property(owner, path)
    except SceneError:
        return
    menu.layout.separator()
    button = menu.layout.operator(DYNAMORPH_OT_add_channel.bl_idname, icon="SHAPEKEY_DATA")
    button.data_path = channels.full_path(owner, path)


CLASSES = (DYNAMORPH_OT_add_channel, DYNAMORPH_OT_remove_channel, DYNAMORPH_OT_add_tension)
_register, _unregister = of_classes(CLASSES)


def register() -> None:
    _register()
    bpy.types.UI_MT_button_context_menu.append(draw_add_channel)


def unregister() -> None:
    bpy.types.UI_MT_button_context_menu.remove(draw_add_channel)
    _unregister()
