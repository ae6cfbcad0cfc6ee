# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons that compare: soft against plain, two sets of settings, and either side by side."""

from __future__ import annotations

from contextlib import suppress

import bpy
import numpy as np
from bpy.app.handlers import persistent
from bpy.types import Operator
from mathutils import Quaternion, Vector

from ...core import records
from ...core.errors import WriteError
from ...run import live
from ...run.tools.preview import end_preview
from ...scene import events, skin
from ...scene.registration import of_classes
from ...scene.remembered import opened
from ...write.authoring.slots import put_slot, slot_settings
from ...write.display import beside, comparison
from ..base import SoftSkinOperator


class DYNAMORPH_OT_show_plain(SoftSkinOperator, Operator):
    """Show the mesh moved only by the rig, for comparison. Pressing again or saving the file shows the soft skin"""

    bl_idname = "dynamorph.show_plain"
    bl_label = "Show Plain Skinning"

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        disabled_reason = super().disabled_reason(context)
        if not disabled_reason and not comparison.can_show(skin.mesh_in(context)):
            return "Turn Live on or bake first: only plain skinning exists so far"
        return disabled_reason

    def apply(self, obj: bpy.types.Object) -> None:
        end_preview()
        comparison.show(obj, not comparison.is_plain(obj))


class DYNAMORPH_OT_swap_slot(SoftSkinOperator, Operator):
    """Switch to the other of two sets of settings to compare them: materials, simulation and the Amounts of modes"""

    bl_idname = "dynamorph.swap_slot"
    bl_label = "Compare A and B"

    def apply(self, obj: bpy.types.Object) -> None:
        record = obj.dynamorph.live
        left = slot_settings(obj)
        put_slot(obj, records.slot(record.other) if record.other else left)
        record.other = records.text(left)
        record.slot = "B" if record.slot == "A" else "A"
        live.refresh(obj)


class DYNAMORPH_OT_copy_slot(SoftSkinOperator, Operator):
    """Copy this set of settings to the other one"""

    bl_idname = "dynamorph.copy_slot"
    bl_label = "Copy to Other Slot"

    def apply(self, obj: bpy.types.Object) -> None:
        obj.dynamorph.live.other = records.text(slot_settings(obj))


class DYNAMORPH_OT_compare_beside(SoftSkinOperator, Operator):
    """Show a copy beside the body: plain skinning, or the last bake of the other settings. Press again to remove it"""

    bl_idname = "dynamorph.compare_beside"
    bl_label = "Compare Side by Side"

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        disabled_reason, obj = super().disabled_reason(context), skin.mesh_in(context)
        if not disabled_reason and not (comparison.can_show(obj) or beside.find(obj)):
            return "Turn Live on or bake first: only plain skinning exists so far"
        return disabled_reason

    def apply(self, obj: bpy.types.Object) -> None:
        shown = beside.find(obj)
        if shown:
            beside.remove(shown)
        else:
            beside.add(obj, _right_of_view(bpy.context))


def _right_of_view(context: bpy.types.Context) -> np.ndarray:
    """The direction (3,) to the right in the viewport of the context, or in the first of the window."""
    views = [area for area in context.screen.areas if area.type == "VIEW_3D"] if context.screen else []
    area = context.area if context.area in views else next(iter(views), None)
    turned = area.spaces.active.region_3d.view_rotation if area else Quaternion()
    return np.array(turned @ Vector((1.0, 0.0, 0.0)))


@persistent
def _before_save(*_args: object) -> None:
    """save_pre: a saved file shows the soft skin wherever it is opened or rendered."""
    for obj in skin.soft_skins(bpy.data.objects):
        if obj.library is None and comparison.is_plain(obj):
            with suppress(WriteError):  # in Edit Mode the panel keeps saying that plain skinning is shown
                comparison.show(obj, False)
    opened.left_out[:] = beside.leave_out_of_file()


@persistent
def _after_save(*_args: object) -> None:
    """save_post, save_post_fail."""
    for action in opened.left_out:
        action.is_runtime_data = False
    opened.left_out.clear()


@persistent
def _loaded(*_args: object) -> None:
    """load_post."""
    beside.remove_all()


HANDLERS = {
    "load_post": _loaded,
    "save_pre": _before_save,
    "save_post": _after_save,
    "save_post_fail": _after_save,
}
CLASSES = (
    DYNAMORPH_OT_show_plain,
    DYNAMORPH_OT_swap_slot,
    DYNAMORPH_OT_copy_slot,
    DYNAMORPH_OT_compare_beside,
)
_register_classes, _unregister_classes = of_classes(CLASSES)


def register() -> None:
    _register_classes()
    events.add(HANDLERS)


def unregister() -> None:
    events.remove(HANDLERS)
    _unregister_classes()
