# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons of jobs: build, bake, delete the bake, cancel. `base` has what all buttons have in common."""

from __future__ import annotations

import time
from typing import Any

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.app.translations import pgettext_tip as tip_
from bpy.types import Operator

from ...core.message import Message, joined, translated
from ...run import live, remembered
from ...run.bake import batch, expected_error, full_comparison
from ...run.bake.batch import run_all
from ...run.bake.job import Job
from ...run.work import child
from ...scene import events
from ...scene.registration import of_classes
from ...scene.skin import is_shown_on, mesh_in, soft_skins
from ...scene.store import staleness
from ...write.bake import on_override, writer
from ...write.display import beside, live_key
from .. import messages
from ..base import SoftSkinOperator, at_work, reconciled, report_errors, reported

TICK = 0.02  # seconds from one turn of a job to the next
SLICE = 0.018  # seconds of a turn that may block the window, approximately
SHOWN = 0.1  # seconds between two updates of the progress bar


class DYNAMORPH_OT_delete_bake(SoftSkinOperator, Operator):
    """Delete the baked shape keys, curves and modifier, and restore the target keys"""

    bl_idname = "dynamorph.delete_bake"
    bl_label = "Delete Bake"
    needs_soft_skin = False
    on_override = True

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        reason = super().disabled_reason(context)
        if reason:
            return reason
        obj = mesh_in(context)
        if obj.override_library:
            return "" if on_override.is_baked(obj) else "This library override has no bake of its own yet"
        if obj.dynamorph.targets:
            return "" if obj.dynamorph.bake.exists else "There is no bake yet"
        return "" if is_shown_on(obj) else "Press Add Soft Skin first"

    def apply(self, obj: bpy.types.Object) -> None:
        if not obj.dynamorph.targets:  # an attachment, which may show Live
            live_key.remove(obj)
        writer.check_free(obj)
        beside.keep_bake(obj)
        for text in writer.free(obj):
            self.report({"WARNING"}, translated(text, rpt_))


class JobOperator(SoftSkinOperator):
    """Mixin: runs a job. In a window it shows a progress bar and Blender stays usable; in the background it runs at
    once.
    """

    goal = "BUILD"
    builds_again = True  # a model that is up to date

    def _jobs(self, obj: bpy.types.Object) -> list[Job]:
        """The jobs to run one after the other; obj: the mesh of the context."""
        return [Job(obj, self.goal, rebuild=self.builds_again and self.goal == "BUILD")]

    def _batch(self, obj: bpy.types.Object) -> Any:  # a Batch; in some buttons, other Work
        return batch.Batch(self._jobs(obj), self.goal)

    def apply(self, obj: bpy.types.Object) -> None:
        batch = self._batch(obj)
        run_all(batch)
        self._done(batch)

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        if bpy.app.background:
            return self.execute(context)
        return report_errors(self, self._begin, context)

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type == "ESC" and event.value == "PRESS":  # not passed on: it must not also stop the playback
            self.batch.cancel()
        elif event.type != "TIMER":
            return {"PASS_THROUGH"}
        result = {"CANCELLED"}
        try:
            result = report_errors(self, self._tick, context)
        finally:
            if result != {"RUNNING_MODAL"}:
                self._end(context)
        return result

    def cancel(self, _context: bpy.types.Context) -> None:
        """Blender itself ends the operator because the window closes or another file is opened."""
        batch.stop()

    def _begin(self, context: bpy.types.Context) -> set[str]:
        expected_error.cancel()  # the job needs the computer, and outdates what is measured
        self.batch = remembered.work.running = self._batch(reconciled(mesh_in(context)))
        self.steps = self.batch.steps(SLICE)
        self._show(context)
        self.timer = context.window_manager.event_timer_add(TICK, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def _show(self, context: bpy.types.Context) -> None:
        """Have the progress drawn."""
        self.shown, self.worked = time.monotonic(), False
        events.redraw(events.PANELS)
        events.redraw_status(context)

    def _tick(self, context: bpy.types.Context) -> set[str]:
        batch = self.batch
        # A turn of its own, because drawing the panels takes as long as a slice; after it, work goes on however long
        # that took.
        if self.worked and time.monotonic() - self.shown > SHOWN:
            self._show(context)
            return {"RUNNING_MODAL"}
        self.worked = True
        try:
            next(self.steps)
        except StopIteration:
            return self._done(batch)
        return {"RUNNING_MODAL"}

    def _end(self, context: bpy.types.Context) -> None:
        self.batch.stop()
        remembered.work.running = None
        child.prepare()  # for what comes next
        context.window_manager.event_timer_remove(self.timer)
        self._show(context)

    def _done(self, batch: Any) -> set[str]:
        expected_error.begin(batch.jobs)
        for job in batch.jobs:
            built_first = job.input.is_bake and job.input.reasons
            text = "{name}: {result} (built first: {reasons})" if built_first else "{name}: {result}"
            reasons = joined("; ", job.input.reasons)
            message = Message(text, name=job.name, result=job.summary(), reasons=reasons)
            self.report({"INFO"}, translated(message, rpt_))
        for job in batch.jobs:
            for warning in job.warnings:  # last, because the status bar shows the last report
                self.report({"WARNING"}, translated(warning, rpt_))
        return {"FINISHED"}


class StartsJob(SoftSkinOperator):
    """Mixin: `apply` is an undo step of its own; in a window, the operator `job` continues from there."""

    job = ""

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        result = self.execute(context)
        if result == {"FINISHED"} and not bpy.app.background:
            press(self, self.job)
        return result


def press(operator: bpy.types.Operator, name: str, **settings: Any) -> None:
    """Call another operator where `operator` ends, and report what prevents it."""
    module, function = name.split(".")
    button = getattr(getattr(bpy.ops, module), function)
    try:
        if button.poll():
            button("INVOKE_DEFAULT", **settings)
    except RuntimeError as error:  # what it reported as an error
        operator.report({"ERROR"}, reported(error))


class DYNAMORPH_OT_build(JobOperator, Operator):
    """Compute the model of the soft skin: its cage, modes and forces"""

    bl_idname = "dynamorph.build"
    bl_label = "Build Model"

    @classmethod
    def description(cls, context: bpy.types.Context, _given: bpy.types.OperatorProperties) -> str:
        """The tooltip, with the parts that it would make again now."""
        obj = mesh_in(context)
        texts = [cls.__doc__, messages.rebuilt(obj) if obj and obj.dynamorph.model.content_id else ""]
        return ".\n".join(tip_(text) for text in texts if text)

    def _done(self, batch: batch.Batch) -> set[str]:
        for job in batch.jobs:
            live.refresh(job.target())
        return super()._done(batch)


class DYNAMORPH_OT_bake(JobOperator, Operator):
    """Simulate the frame range and write the motion in the chosen Format. An outdated model is built first"""

    bl_idname = "dynamorph.bake"
    bl_label = "Bake Soft Skin"
    goal = "BAKE"
    on_override = True

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        reason, obj = super().disabled_reason(context), mesh_in(context)
        return reason or (on_override.refused_format(obj) if obj.override_library else "")


class DYNAMORPH_OT_bake_all(JobOperator, Operator):
    """Bake all soft skins of the scene, one after the other. Nothing changes until all bakes are done"""

    bl_idname = "dynamorph.bake_all"
    bl_label = "Bake All"
    goal = "BAKE_ALL"

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        if not _own_skins(context.scene):
            return "The scene has no soft skin of its own: press Add Soft Skin first, or make a linked one local"
        return at_work()

    def _jobs(self, _obj: bpy.types.Object) -> list[Job]:
        return [Job(skin, "BAKE") for skin in _own_skins(bpy.context.scene)]


def _own_skins(scene: bpy.types.Scene) -> list:
    """The soft skins whose bake would be saved with the file."""
    found = [each for each in soft_skins(scene.objects) if not each.library]
    lost = (on_override.refused_format(each) if each.override_library else each.data.library for each in found)
    return [each for each, why in zip(found, lost, strict=True) if not why]


class DYNAMORPH_OT_compare_full(JobOperator, Operator):
    """Simulate the shot of the bake in Full Quality too, and say how far the reduced motion is from that"""

    bl_idname = "dynamorph.compare_full"
    bl_label = "Compare with Full Quality"
    goal = "COMPARE_FULL"

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        obj = mesh_in(context)
        reason = super().disabled_reason(context) or full_comparison.disabled_reason(obj)
        return reason or ("The bake is out of date: bake again first" if staleness.outdated(obj) else "")

    def _batch(self, obj: bpy.types.Object) -> full_comparison.FullComparison:
        return full_comparison.FullComparison(obj)

    def _done(self, batch: full_comparison.FullComparison) -> set[str]:
        obj = batch.jobs[0].target()
        self.report({"INFO"}, translated(joined(": ", [obj.name, full_comparison.summary(obj)]), rpt_))
        return {"FINISHED"}


class DYNAMORPH_OT_cancel(Operator):
    """Stop the running build or bake. The previous model and bake stay"""

    bl_idname = "dynamorph.cancel"
    bl_label = "Cancel Soft Skin Job"

    def execute(self, _context: bpy.types.Context) -> set[str]:
        if remembered.work.running:
            remembered.work.running.cancel()
        return {"FINISHED"}


CLASSES = (
    DYNAMORPH_OT_build,
    DYNAMORPH_OT_bake,
    DYNAMORPH_OT_bake_all,
    DYNAMORPH_OT_compare_full,
    DYNAMORPH_OT_delete_bake,
    DYNAMORPH_OT_cancel,
)
register, unregister = of_classes(CLASSES)
