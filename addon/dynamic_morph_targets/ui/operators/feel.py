# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons that set how soft a skin feels, and those that repair what the verdict on a bake has found."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import bpy
import numpy as np
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import EnumProperty
from bpy.types import Operator

from ...core.errors import SceneError
from ...core.material.feel import FEELS, Feel
from ...core.result import judge
from ...run import live
from ...scene.properties.target_properties import DynamorphTarget
from ...scene.registration import of_classes
from ..base import SoftSkinOperator
from .jobs import StartsJob


def give_feel(obj: bpy.types.Object, feel: Feel) -> None:
    """Give the neutral target this feel and limit the motion. Every other target that was not set by hand keeps its
    ratio of undamped frequency to the neutral target.
    """
    settings = obj.dynamorph
    ratios = [_frequency_ratio(target, settings.targets[0]) for target in settings.targets]
    for target, ratio in zip(settings.targets, ratios, strict=True):
        if target == settings.targets[0] or not target.by_hand:
            target.set_swing(ratio * feel.undamped, replace(target.material(), **feel.damping))
            target.by_hand = False
    simulation = settings.simulation
    simulation.max_displacement, simulation.max_thickness = feel.max_displacement, feel.max_thickness


def _frequency_ratio(target: DynamorphTarget, neutral: DynamorphTarget) -> float:
    if target.frequency and neutral.frequency:
        return target.frequency / neutral.frequency
    one, other = target.material(), neutral.material()
    return sqrt(one.stiffness / one.density * other.density / other.stiffness)


class DYNAMORPH_OT_apply_feel(SoftSkinOperator, Operator):
    """Set how soft the skin feels: its bounce, its settle time and how far it may move"""

    bl_idname = "dynamorph.apply_feel"
    bl_label = "Apply Feel"
    on_override = on_linked_mesh = True

    feel: EnumProperty(
        name="Feel",
        description="How soft the skin feels",
        items=[(key, feel.label, feel.tooltip, number) for number, (key, feel) in enumerate(FEELS.items())],
        default="NATURAL",
    )

    @classmethod
    def description(cls, _context: bpy.types.Context, given: bpy.types.OperatorProperties) -> str:
        feel = FEELS[given.feel]
        text = rpt_("{feel}. It sets Bounce to {frequency:g} Hz and the limits. Targets set by hand are not changed")
        return text.format(feel=rpt_(feel.tooltip), frequency=feel.frequency)

    def apply(self, obj: bpy.types.Object) -> None:
        give_feel(obj, FEELS[self.feel])
        live.refresh(obj)


# What the verdict on a bake asks for -------------------------------------------------------------------------------


def _verdict(obj: bpy.types.Object) -> judge.Verdict:
    """Raises SceneError when there is none, and RecordError."""
    found = judge.parsed(obj.dynamorph.bake.verdict)
    if found is None:
        raise SceneError("'{name}' has no verdict: press Bake first", name=obj.name)
    return found


class DYNAMORPH_OT_show_worst(SoftSkinOperator, Operator):
    """Go to the frame in which the skin looks worst, select the vertices there, and show the heat map"""

    bl_idname = "dynamorph.show_worst"
    bl_label = "Show Worst Place"

    def apply(self, obj: bpy.types.Object) -> None:
        found = _verdict(obj)
        if obj.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")  # Edit Mode has a selection of its own
        mesh = obj.data
        on_mesh = [vertex for vertex in found.vertices if vertex < len(mesh.vertices)]
        frame = round(found.frame)
        bpy.context.scene.frame_set(frame)
        for elements in (mesh.edges, mesh.polygons):
            elements.foreach_set("select", np.zeros(len(elements), bool))
        chosen = np.zeros(len(mesh.vertices), bool)
        chosen[on_mesh] = True
        mesh.vertices.foreach_set("select", chosen)
        mesh.update()
        bpy.context.window_manager.dynamorph.heat = True
        text = rpt_("Frame {frame}: {count} vertices selected; press Tab to see them in Edit Mode")
        self.report({"INFO"}, text.format(frame=frame, count=len(on_mesh)))


class DYNAMORPH_OT_stiffen(StartsJob, Operator):
    """Raise Bounce by as much as the verdict on the bake asks for, even if it was set by hand, and bake again"""

    bl_idname = "dynamorph.stiffen"
    bl_label = "Raise Bounce and Bake"
    job = "dynamorph.bake"

    def apply(self, obj: bpy.types.Object) -> None:
        factor = _verdict(obj).factor
        measured = [target for target in obj.dynamorph.targets if target.is_measured]
        if not measured:
            raise SceneError("'{name}': the bounce has not been measured yet: press Build Model first", name=obj.name)
        before = measured[0].bounce
        for target in measured:
            by_hand = target.by_hand
            target.bounce = factor * target.bounce
            target.by_hand = by_hand
        text = rpt_("Bounce {before:.2g} Hz → {after:.2g} Hz")
        self.report({"INFO"}, text.format(before=before, after=measured[0].bounce))


CLASSES = (
    DYNAMORPH_OT_apply_feel,
    DYNAMORPH_OT_show_worst,
    DYNAMORPH_OT_stiffen,
)
register, unregister = of_classes(CLASSES)
