# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons about how much each target counts over the frames."""

from __future__ import annotations

import numpy as np
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.types import Operator

from ..run import weight_curves
from ..scene import events, skin
from ..scene.registration import of_classes
from .base import SoftSkinOperator, guarded


class DYNAMORPH_OT_update_influence(SoftSkinOperator, Operator):
    """Evaluate the armature at every frame of the scene again, for the graph of the targets' influence"""

    bl_idname = "dynamorph.update_influence"
    bl_label = "Update Influence"
    bl_options = {"REGISTER"}

    def execute(self, context):
        return guarded(self, self._update, skin.mesh_in(context), context.scene)

    def _update(self, obj, scene):
        weight_curves.curves(obj, scene.frame_start, scene.frame_end)
        events.redraw(events.PANELS | events.VIEWS)


class DYNAMORPH_OT_suggest_pose(SoftSkinOperator, Operator):
    """Go to the frame whose pose is furthest from all targets: the place for another one"""

    bl_idname = "dynamorph.suggest_pose"
    bl_label = "Suggest Pose"

    @classmethod
    def obstacle(cls, context):
        obstacle = super().obstacle(context)
        if not obstacle and len(skin.mesh_in(context).dynamorph.targets) < 2:
            return "Add a target first"
        return obstacle

    def execute(self, context):
        return guarded(self, self._suggest, skin.mesh_in(context), context.scene)

    def _suggest(self, obj, scene):
        found = weight_curves.curves(obj, scene.frame_start, scene.frame_end)
        worst = found.worst()
        if worst is None:
            self.report({"INFO"}, rpt_("Every frame is near a target: no pose is poorly covered"))
            return
        pose, s = worst
        scene.frame_set(scene.frame_start + pose)
        text = rpt_("Frame {frame}: {away:.0f} degrees from any target of {name}. New from Pose adds one here")
        away, name = np.degrees(found.nearest[pose, s]), found.sets[s].name
        self.report({"INFO"}, text.format(frame=scene.frame_current, away=away, name=name))


CLASSES = (DYNAMORPH_OT_update_influence, DYNAMORPH_OT_suggest_pose)
register, unregister = of_classes(CLASSES)
