# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons that paint the maps of a soft skin."""

from __future__ import annotations

from collections.abc import Callable

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import EnumProperty
from bpy.types import Operator

from ...core.errors import DynamorphError, sentence
from ...core.message import Message, translated
from ...core.painted_map import FIRMNESS, MAX_DISTANCE, PaintedMap
from ...scene import events, skin
from ...scene.registration import of_classes
from ...write.authoring import painting, parts
from ..base import SoftSkinOperator


class Paint(SoftSkinOperator):
    """Paints a map, or ends that."""

    of: PaintedMap

    def apply(self, obj: bpy.types.Object) -> None:
        if painting.is_painting(obj, self.of):
            painting.leave(obj)
        else:
            painting.enter(obj, self.of)


class DYNAMORPH_OT_paint_firmness(Paint, Operator):
    """Paint the Firmness map in Weight Paint: 0 is softer, 0.5 unchanged, 1 held by the bones. Press again to leave"""

    bl_idname = "dynamorph.paint_firmness"
    bl_label = "Paint Firmness"
    of = FIRMNESS


class DYNAMORPH_OT_paint_max_distance(Paint, Operator):
    """Paint the Max Distance map in Weight Paint: 1 moves as before, 0 follows the bones. Press again to leave"""

    bl_idname = "dynamorph.paint_max_distance"
    bl_label = "Paint Max Distance"
    of = MAX_DISTANCE


class DYNAMORPH_OT_hold_bones(SoftSkinOperator, Operator):
    """Set Firmness to 1 where the selected pose bones move the skin, with a soft border"""

    bl_idname = "dynamorph.hold_bones"
    bl_label = "Hold Selected Bones"

    def apply(self, obj: bpy.types.Object) -> None:
        painting.hold_selected_bones(obj)


class Mirror(SoftSkinOperator):
    """Copies a map to the other side."""

    of: PaintedMap
    to: EnumProperty(
        name="To",
        description="The side to which the map is copied",
        items=(
            ("RIGHT", "Left to Right", "From the character's left, +X, to its right", 0),
            ("LEFT", "Right to Left", "From the character's right, -X, to its left", 1),
        ),
    )

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        disabled_reason = super().disabled_reason(context)
        if not disabled_reason and not painting.is_painting(skin.mesh_in(context), cls.of):
            return Message("Press Paint beside {map} first", map=Message(cls.of.label))
        return disabled_reason

    def apply(self, obj: bpy.types.Object) -> None:
        alone = painting.mirror(obj, self.of, self.to)
        if alone:
            text = rpt_("{count} vertices have no mirror image and are unchanged")
            self.report({"WARNING"}, text.format(count=alone))


class DYNAMORPH_OT_mirror_firmness(Mirror, Operator):
    """Copy the Firmness map to the other side of the mesh, about its local X axis"""

    bl_idname = "dynamorph.mirror_firmness"
    bl_label = "Mirror Firmness"
    of = FIRMNESS


class DYNAMORPH_OT_mirror_max_distance(Mirror, Operator):
    """Copy the Max Distance map to the other side of the mesh, about its local X axis"""

    bl_idname = "dynamorph.mirror_max_distance"
    bl_label = "Mirror Max Distance"
    of = MAX_DISTANCE


def _set_part(obj: bpy.types.Object, name: str, firmness: float) -> None:
    """A slider of a part was moved, or a script has set it; what is in the way is said in a pop-up."""
    try:
        parts.set_firmness(obj, name, firmness)
    except DynamorphError as problem:
        if bpy.app.background:
            raise
        text = translated(sentence(problem), rpt_)
        bpy.context.window_manager.popup_menu(lambda menu, _: menu.layout.label(text=text), icon="ERROR")


def draw_tools(layout: bpy.types.UILayout, obj: bpy.types.Object, of: PaintedMap) -> None:
    """What helps to paint a map; Blender's own buttons where it has some."""
    column = layout.column(align=True)
    column.use_property_split = False
    if painting.is_painting(obj, of):
        row = column.row(align=True)
        row.operator_context = "EXEC_DEFAULT"
        row.operator("paint.weight_set", text="Fill", icon="BRUSH_DATA")
        blur = row.operator("object.vertex_group_smooth", text="Blur")
        blur.group_select_mode, blur.factor, blur.repeat = "ACTIVE", 0.5, 2
        row = column.row(align=True)
        for to, text in (("RIGHT", "Left to Right"), ("LEFT", "Right to Left")):
            row.operator(f"dynamorph.mirror_{of.name}", text=text, icon="MOD_MIRROR").to = to
    if of == FIRMNESS:
        column.operator("dynamorph.hold_bones", icon="BONE_DATA")


CLASSES = (
    DYNAMORPH_OT_paint_firmness,
    DYNAMORPH_OT_paint_max_distance,
    DYNAMORPH_OT_hold_bones,
    DYNAMORPH_OT_mirror_firmness,
    DYNAMORPH_OT_mirror_max_distance,
)
_register_classes, _unregister_classes = of_classes(CLASSES)
LISTENERS: dict[events.Event, Callable[..., object]] = {events.Event.PART_SET: _set_part}


def register() -> None:
    _register_classes()
    events.subscribe(LISTENERS)


def unregister() -> None:
    events.unsubscribe(LISTENERS)
    _unregister_classes()
