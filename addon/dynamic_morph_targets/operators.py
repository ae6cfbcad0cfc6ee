# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons: check, call, report. What all have in common, and those of the jobs: build, bake, free, cancel."""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent
from bpy.types import Operator

from . import jobs, properties, sinks
from .extract import Cancelled


def guarded(operator, action, *args) -> set[str]:
    """Call `action`; what the artist can do something about becomes a report, and the operator is cancelled."""
    try:
        return action(*args) or {"FINISHED"}
    except Cancelled:
        operator.report({"WARNING"}, "Cancelled: nothing was changed")
    except jobs.expected_errors() as error:
        operator.report({"ERROR"}, str(error))
    return {"CANCELLED"}


class SoftSkinOperator:
    """Mixin: works on the mesh of the context, which must carry a soft skin, while no job runs."""

    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        problem = ""
        obj = properties.mesh_in(context)
        if obj is None:
            problem = "Select the character's mesh object"
        elif jobs.running:
            problem = f"Wait until '{jobs.running.name}' is done, or cancel it"
        elif cls.needs_soft_skin and not obj.dynamorph.targets:
            problem = "Press Add Soft Skin first"
        if problem:
            cls.poll_message_set(problem)
        return not problem

    needs_soft_skin = True

    def execute(self, context):
        return guarded(self, self.apply, properties.mesh_in(context))


class DYNAMORPH_OT_free_bake(SoftSkinOperator, Operator):
    """Remove the baked shape keys and curves, and restore the target keys"""

    bl_idname = "dynamorph.free_bake"
    bl_label = "Free Bake"

    def apply(self, obj):
        sinks.check(obj)
        sinks.free(obj)


class JobOperator(SoftSkinOperator):
    """Mixin: runs a job, in a window with a progress bar while Blender stays usable, else at once."""

    goal = "BUILD"

    def apply(self, obj):
        jobs.run(self._job(obj))
        self._done(self.job)

    def invoke(self, context, _event):
        if bpy.app.background:
            return self.execute(context)
        return guarded(self, self._begin, context)

    def modal(self, context, event):
        if event.type == "ESC" and event.value == "PRESS":
            self.job.cancelled = True
            return {"RUNNING_MODAL"}  # this Esc is used up: it must not also stop the playback
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        result = {"CANCELLED"}
        try:
            result = guarded(self, self._tick, context)
        finally:
            if result != {"RUNNING_MODAL"}:
                self._end(context)
        return result

    def cancel(self, _context):
        """Blender ends the operator itself, because the window closes or another file is opened: all else is gone."""
        jobs.stop(self.job)
        jobs.running = None

    def _job(self, obj):
        self.job = jobs.Job(obj, self.goal, rebuild=self.goal == "BUILD")
        return self.job

    def _begin(self, context):
        job = self._job(properties.mesh_in(context))
        context.window.cursor_set("WAIT")  # sampling moves a copy of the rig and cannot share the main thread
        try:
            job.prepare()
        finally:
            context.window.cursor_set("DEFAULT")
        job.start()
        jobs.running = job
        self.timer = context.window_manager.event_timer_add(0.1, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def _tick(self, context):
        job = self.job
        text = f"{job.name}: {job.message}  {job.fraction:.0%}    Esc: cancel"
        context.workspace.status_text_set(text)
        redraw(context)
        if not job.wait(0.0):
            return {"RUNNING_MODAL"}
        job.commit()
        return self._done(job)

    def _end(self, context):
        jobs.running = None
        context.window_manager.event_timer_remove(self.timer)
        context.workspace.status_text_set(None)
        redraw(context)

    def _done(self, job):
        built = f" (built first: {'; '.join(job.reasons)})" if job.bake and job.reasons else ""
        self.report({"INFO"}, f"{job.name}: {job.summary()}{built}")
        for warning in job.warnings:  # after the rest, because the status bar shows the last report
            self.report({"WARNING"}, warning)
        return {"FINISHED"}


class DYNAMORPH_OT_build(JobOperator, Operator):
    """Compute the model of the soft skin: its cage, modes and forces"""

    bl_idname = "dynamorph.build"
    bl_label = "Build Model"


class DYNAMORPH_OT_bake(JobOperator, Operator):
    """Simulate the frame range and write the motion as shape keys; builds the model first if it is out of date"""

    bl_idname = "dynamorph.bake"
    bl_label = "Bake Soft Skin"
    goal = "BAKE"


class DYNAMORPH_OT_cancel(Operator):
    """Stop the running build or bake; what was there before stays"""

    bl_idname = "dynamorph.cancel"
    bl_label = "Cancel Soft Skin Job"

    def execute(self, _context):
        if jobs.running:
            jobs.running.cancelled = True
        return {"FINISHED"}


def redraw(context):
    """Let every panel that shows progress draw again, but not the 3D view, which may take longer than the job."""
    shown_in = {"VIEW_3D": "UI", "PROPERTIES": "WINDOW"}
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            for region in area.regions:
                if region.type == shown_in.get(area.type):
                    region.tag_redraw()


@persistent
def _before_load(*_args):
    """load_pre: the job's results would have nowhere to go."""
    if jobs.running:
        jobs.running.cancelled = True


@persistent
def _check_changed(_scene, depsgraph):
    """depsgraph_update_post: a second after the last edit of shape keys, see whether the model is out of date."""
    if not bpy.app.background and any(obj.dynamorph.model.content_id for obj in properties.changed_objects(depsgraph)):
        if bpy.app.timers.is_registered(_check_models):
            bpy.app.timers.unregister(_check_models)
        bpy.app.timers.register(_check_models, first_interval=1.0)


def _check_models():
    for obj in properties.soft_skins(bpy.context.scene.objects):
        if obj.dynamorph.model.content_id and obj.mode == "OBJECT" and not jobs.running:
            jobs.show_stale(obj)


CLASSES = (
    DYNAMORPH_OT_build,
    DYNAMORPH_OT_bake,
    DYNAMORPH_OT_free_bake,
    DYNAMORPH_OT_cancel,
)


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.app.handlers.load_pre.append(_before_load)
    bpy.app.handlers.depsgraph_update_post.append(_check_changed)


def unregister():
    if jobs.running:
        jobs.stop(jobs.running)
        jobs.running = None
    bpy.app.handlers.depsgraph_update_post.remove(_check_changed)
    bpy.app.handlers.load_pre.remove(_before_load)
    if bpy.app.timers.is_registered(_check_models):
        bpy.app.timers.unregister(_check_models)
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
