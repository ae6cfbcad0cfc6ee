# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons of a target's material: presets, and fits to observations."""

from __future__ import annotations

from functools import partial

import bpy
from bpy.props import EnumProperty, FloatProperty
from bpy.types import Operator

from ...core.material import fit as material_fit
from ...core.material import oscillation, presets
from ...run.work import task
from ...scene import skin
from ...scene.registration import of_classes
from ...scene.store import model_store
from ..base import TargetOperator, report_errors
from .jobs import JobOperator, press


class DYNAMORPH_OT_apply_material(TargetOperator, Operator):
    """Give the selected target the properties of a measured material"""

    bl_idname = "dynamorph.apply_material"
    bl_label = "Apply Material"
    neutral_too = True
    on_override = on_linked_mesh = True

    preset: EnumProperty(
        name="Material",
        description="Measured material of the soft tissue at this target",
        items=[(key, p.label, p.source, number) for number, (key, p) in enumerate(presets.PRESETS.items())],
    )

    @classmethod
    def description(cls, _context: bpy.types.Context, given: bpy.types.OperatorProperties) -> str:
        """The tooltip: Blender does not show the descriptions of items of an operator's menu."""
        return presets.PRESETS[given.preset].source if given.is_property_set("preset") else ""

    def apply(self, obj: bpy.types.Object) -> None:
        obj.dynamorph.active_target.set_material(presets.PRESETS[self.preset].material, by_hand=True)


class FitsBounce(TargetOperator, JobOperator):
    """Mixin: sets the material by what was observed."""

    neutral_too = True
    on_override = on_linked_mesh = True
    goal = "FIT_MATERIAL"

    frequency: FloatProperty(
        name="Bounce",
        description="Observed natural frequency, in swings per second after a push",
        default=3.0,
        min=0.01,
        max=1000.0,
        subtype="FREQUENCY",
    )
    settle_time: FloatProperty(
        name="Settle Time",
        description="Observed time until a twentieth of the swing is left",
        subtype="TIME_ABSOLUTE",
        default=1.0,
        min=0.001,
        max=1000.0,
    )

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        disabled_reason = super().disabled_reason(context)
        if not disabled_reason and not skin.mesh_in(context).dynamorph.model.content_id:
            return "Press Build Model first: the bounce is measured on its cage"
        return disabled_reason

    def _batch(self, obj: bpy.types.Object) -> task.Task:
        return task.Task(obj, self.goal, self._fitted(obj, self.frequency, oscillation.decay_of(self.settle_time)))

    @staticmethod
    def _fitted(obj: bpy.types.Object, frequency: float, decay: float) -> task.Chunks[tuple]:
        """The result: the index of the target in the list, and its material."""
        index = obj.dynamorph.active_target_index
        model, character, target = model_store.fit_input(obj, obj.dynamorph.active_target)

        fit = partial(material_fit.fit_oscillation, model, character, target, frequency, decay)
        return index, (yield from task.elsewhere(fit, "Fitting the bounce", obj.name))

    def _done(self, task: task.Task) -> set[str]:
        index, fitted = task.result
        task.object.find().dynamorph.targets[index].set_material(fitted, by_hand=True)
        return {"FINISHED"}


class DYNAMORPH_OT_fit_bounce(FitsBounce, Operator):
    """Set stiffness and damping of the selected target, as the dialog of Fit Bounce says"""

    bl_idname = "dynamorph.fit_bounce"
    bl_label = "Fit Bounce to Observation"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}


class DYNAMORPH_OT_fit_material(FitsBounce, Operator):
    """Set stiffness and damping of the selected target so that the built skin swings as observed"""

    bl_idname = "dynamorph.fit_material"
    bl_label = "Fit Bounce"

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        return report_errors(self, self._ask, context)

    def _ask(self, context: bpy.types.Context) -> set[str]:
        obj = skin.mesh_in(context)
        now = material_fit.bounce(*model_store.fit_input(obj, obj.dynamorph.active_target))
        self.frequency, self.settle_time = now.frequency or self.frequency, now.settle
        return context.window_manager.invoke_props_dialog(self)

    def execute(self, context: bpy.types.Context) -> set[str]:
        if bpy.app.background:
            return super().execute(context)
        press(self, "dynamorph.fit_bounce", frequency=self.frequency, settle_time=self.settle_time)
        return {"CANCELLED"}  # the other button makes the undo step


CLASSES = (
    DYNAMORPH_OT_apply_material,
    DYNAMORPH_OT_fit_bounce,
    DYNAMORPH_OT_fit_material,
)
register, unregister = of_classes(CLASSES)
