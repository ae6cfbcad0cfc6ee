# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons about the targets' weights over the frames."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.types import Operator

from ...core.character import region_label
from ...run.tools import weight_curves
from ...run.work import task
from ...scene import events, skin
from ...scene.registration import of_classes
from .jobs import JobOperator


class ReadsFrames(JobOperator):
    """Mixin: evaluates the armature at every frame of the scene first."""

    def _batch(self, obj: bpy.types.Object) -> task.Task:
        scene = bpy.context.scene
        pieces = weight_curves.reading(obj.session_uid, scene.frame_start, scene.frame_end)
        return task.Task(obj, self.goal, pieces)


class DYNAMORPH_OT_update_target_weights(ReadsFrames, Operator):
    """Evaluate the armature again at every frame of the scene for the graph of the targets' weights"""

    bl_idname = "dynamorph.update_target_weights"
    bl_label = "Update Target Weights"
    bl_options = {"REGISTER"}
    goal = "UPDATE_INFLUENCE"

    def _done(self, _task: task.Task) -> set[str]:
        events.redraw(events.PANELS | events.VIEWS)
        return {"FINISHED"}


class DYNAMORPH_OT_find_uncovered_pose(ReadsFrames, Operator):
    """Go to the frame whose pose is farthest from all targets, where another target helps most"""

    bl_idname = "dynamorph.find_uncovered_pose"
    bl_label = "Find Uncovered Pose"
    goal = "SUGGEST_POSE"

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        disabled_reason = super().disabled_reason(context)
        if not disabled_reason and len(skin.mesh_in(context).dynamorph.targets) < 2:
            return "Add a target first"
        return disabled_reason

    def _done(self, task: task.Task) -> set[str]:
        found, scene = task.result, task.scene.find()
        worst = found.worst()
        if worst is None:
            self.report({"INFO"}, rpt_("Every frame is near a target: no pose is uncovered"))
            return {"FINISHED"}
        pose, s = worst
        scene.frame_set(scene.frame_start + pose)
        text = rpt_("Frame {frame}: {away:.0f} degrees from any target of {name}. New from Pose adds one here")
        away, name = np.degrees(found.nearest[pose, s]), found.sets[s].name
        name = region_label(name) if s else name
        self.report({"INFO"}, text.format(frame=scene.frame_current, away=away, name=name))
        return {"FINISHED"}


CLASSES = (DYNAMORPH_OT_update_target_weights, DYNAMORPH_OT_find_uncovered_pose)
register, unregister = of_classes(CLASSES)
