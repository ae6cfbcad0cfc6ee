# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons of a target's pose: capture it, go to it, choose its bones."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import BoolProperty, StringProperty
from bpy.types import Operator

from ...core.errors import SceneError
from ...scene.check import checks
from ...scene.motion import rig_motion
from ...scene.registration import of_classes
from ...write.authoring import channels, controls, regions, targets
from ...write.bake import muting
from ..base import TargetOperator, listed


class DYNAMORPH_OT_capture_pose(TargetOperator, Operator):
    """Place the selected target at the current pose of the armature, and choose its bones from that pose"""

    bl_idname = "dynamorph.capture_pose"
    bl_label = "Capture Pose"
    neutral_too = True

    def apply(self, obj: bpy.types.Object) -> None:
        self.warn(targets.capture(obj, obj.dynamorph.active_target, rig_motion.current_pose(obj)))
        regions.update(obj)


class DYNAMORPH_OT_go_to_pose(TargetOperator, Operator):
    """Put the armature into the pose that was captured for the selected target"""

    bl_idname = "dynamorph.go_to_pose"
    bl_label = "Go to Pose"
    neutral_too = True

    def apply(self, obj: bpy.types.Object) -> None:
        go_to_pose(self, obj)


def go_to_pose(operator: bpy.types.Operator, obj: bpy.types.Object) -> None:
    skeleton, *_ = rig_motion.current_pose(obj)
    local = obj.dynamorph.active_target.local(skeleton)
    targets.pose_rig(checks.armature_modifier(obj).object, skeleton, local)
    operator.warn(channels.go_to(obj, obj.dynamorph.active_target))
    elsewhere = targets.bones_elsewhere(obj, skeleton, local)
    if elsewhere:
        text = rpt_("Constraints or drivers keep bones out of this pose: {bones}")
        operator.report({"WARNING"}, text.format(bones=listed(elsewhere)))
    index = obj.dynamorph.active_target_index
    muting.show_target(obj, obj.dynamorph.active_target.name if index else "")


class DYNAMORPH_OT_use_selected_bones(TargetOperator, Operator):
    """Make the selected pose bones decide when the selected target applies"""

    bl_idname = "dynamorph.use_selected_bones"
    bl_label = "Use Selected Bones"

    extend: BoolProperty(name="Extend", description="Keep the bones that the target already depends on", default=True)

    def apply(self, obj: bpy.types.Object) -> None:
        target = obj.dynamorph.active_target
        rig = checks.armature_modifier(obj).object
        chosen = controls.bent_by_selected(obj)
        if not chosen:
            raise SceneError(
                "Select in Pose Mode the bones of '{rig}' that '{target}' depends on", rig=rig.name, target=target.name
            )
        kept = target.bone_names() if self.extend else ()
        target.set_bones(dict.fromkeys((*kept, *chosen)))
        regions.update(obj)


class DYNAMORPH_OT_remove_bone(TargetOperator, Operator):
    """Remove this bone from those that the selected target depends on"""

    bl_idname = "dynamorph.remove_bone"
    bl_label = "Remove Bone"

    bone: StringProperty(name="Bone", description="Bone of the target to remove", options={"SKIP_SAVE"})

    def apply(self, obj: bpy.types.Object) -> None:
        target = obj.dynamorph.active_target
        target.set_bones([bone for bone in target.bone_names() if bone != self.bone])
        regions.update(obj)


CLASSES = (
    DYNAMORPH_OT_capture_pose,
    DYNAMORPH_OT_go_to_pose,
    DYNAMORPH_OT_use_selected_bones,
    DYNAMORPH_OT_remove_bone,
)
register, unregister = of_classes(CLASSES)
