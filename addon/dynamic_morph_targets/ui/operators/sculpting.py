# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons that sculpt a target in its pose."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import EnumProperty, StringProperty
from bpy.types import Operator

from ...core import engine, errors
from ...core.errors import SceneError
from ...core.message import translated
from ...run.tools import shaping
from ...run.work import task
from ...scene import skin
from ...scene.registration import of_classes
from ...write.assign import free_name
from ...write.authoring import targets
from ...write.authoring.targets import sculpted_key
from ...write.bake import muting
from ..base import SoftSkinOperator, TargetOperator, report_errors
from .jobs import JobOperator
from .poses import go_to_pose

SCULPT_MODE = EnumProperty(
    name="Mode",
    description="The mode in which the shape key is edited in the current pose",
    items=(
        ("SCULPT", "Sculpt Mode", "Sculpt the shape with brushes", "SCULPTMODE_HLT", 0),
        ("EDIT", "Edit Mode", "Move the vertices of the shape", "EDITMODE_HLT", 1),
    ),
)


class SculptOperator:
    """Mixin, listed first: begins to sculpt, unless a target is being sculpted already."""

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        disabled_reason = super().disabled_reason(context)  # type: ignore[misc]  # of SoftSkinOperator
        if not disabled_reason and skin.mesh_in(context).dynamorph.sculpt.active:
            return "Press Finish Sculpting first"
        return disabled_reason


class DYNAMORPH_OT_new_from_pose(SculptOperator, SoftSkinOperator, Operator):
    """Create a target for the current pose and sculpt it. Its shape starts as the blend of the other targets"""

    bl_idname = "dynamorph.new_from_pose"
    bl_label = "New from Pose"

    key: StringProperty(name="Name", description="Name of the shape key and of the target", options={"SKIP_SAVE"})
    mode: SCULPT_MODE

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        return report_errors(self, self._ask, context)

    def _ask(self, context: bpy.types.Context) -> set[str]:
        obj = skin.mesh_in(context)
        self._check(obj)
        self.key = self.key or free_key_name(obj)
        return context.window_manager.invoke_props_dialog(self)

    def apply(self, obj: bpy.types.Object) -> None:
        pose = self._check(obj)
        shape = targets.blended_shape(obj, pose[1])
        muting.show_target(obj, "")
        unsculpted = np.zeros_like(shape)  # all bones that are turned place it, until it is sculpted
        target = targets.add_in_pose(obj, self.key or free_key_name(obj), shape, pose, unsculpted)
        block = obj.data.shape_keys.key_blocks[target.name]
        targets.begin_sculpting(obj, block, self.mode, is_new=True)

    def _check(self, obj: bpy.types.Object) -> targets.Pose:
        """The current pose. Raises SceneError if it cannot have a new target."""
        targets.check_can_sculpt(obj)
        pose, other = targets.posed_target(obj)
        if other:
            raise SceneError(
                "The armature is in the pose of '{name}': change the pose, or sculpt that target", name=other.name
            )
        return pose


def free_key_name(obj: bpy.types.Object) -> str:
    keys = obj.data.shape_keys
    return free_name(keys.key_blocks.keys() if keys else (), "Pose")


class DYNAMORPH_OT_shape_by_physics(SculptOperator, JobOperator, Operator):
    """Bend the body into the current pose as soft tissue bends, and make the shape that it takes there a target"""

    bl_idname = "dynamorph.shape_by_physics"
    bl_label = "Shape by Physics"
    goal = "SHAPE"

    def _batch(self, obj: bpy.types.Object) -> task.Task:
        targets.check_can_sculpt(obj)
        self.pose, other = targets.posed_target(obj)
        self.key = other.name if other else free_key_name(obj)
        return task.Task(obj, self.goal, shaping.shape(obj.session_uid, self.pose[1]))

    def _done(self, task: task.Task) -> set[str]:
        obj = task.object.find()
        warnings = shaping.write(obj, self.pose, self.key, task.result)
        self.report({"INFO"}, rpt_("Shape of '{name}' found").format(name=obj.dynamorph.active_target.name))
        self.warn(warnings)
        return {"FINISHED"}


class DYNAMORPH_OT_sculpt_target(SculptOperator, TargetOperator, Operator):
    """Pose the armature as captured for the selected target, and sculpt its shape key there"""

    bl_idname = "dynamorph.sculpt_target"
    bl_label = "Sculpt Target"

    mode: SCULPT_MODE

    def apply(self, obj: bpy.types.Object) -> None:
        block = sculpted_key(obj)
        targets.check_can_sculpt(obj)
        go_to_pose(self, obj)
        targets.begin_sculpting(obj, block, self.mode)


class DYNAMORPH_OT_finish_sculpt(SoftSkinOperator, Operator):
    """Leave the sculpting mode, show all shape keys again, and choose the target's bones and region from the sculpt"""

    bl_idname = "dynamorph.finish_sculpt"
    bl_label = "Finish Sculpting"

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        disabled_reason = super().disabled_reason(context)
        if not disabled_reason and not skin.mesh_in(context).dynamorph.sculpt.active:
            return "No target is being sculpted"
        return disabled_reason

    def apply(self, obj: bpy.types.Object) -> None:
        targets.finish_sculpting(obj)
        try:
            targets.learn_from_sculpt(obj)
        except engine.expected_errors() as error:  # the mode is left in any case
            self.report({"WARNING"}, translated(errors.sentence(error), rpt_))


CLASSES = (
    DYNAMORPH_OT_new_from_pose,
    DYNAMORPH_OT_shape_by_physics,
    DYNAMORPH_OT_sculpt_target,
    DYNAMORPH_OT_finish_sculpt,
)
register, unregister = of_classes(CLASSES)
