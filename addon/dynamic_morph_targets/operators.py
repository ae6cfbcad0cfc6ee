# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons: check, call, report. What all have in common, and those of the jobs: build, bake, free, cancel."""

from __future__ import annotations

import time

import bpy
from bpy.app.handlers import persistent
from bpy.types import Operator

from . import changes, jobs, properties, sinks
from .extract import Cancelled

TICK = 0.05  # seconds between two turns of a job
SLICE = 0.035  # of which it may hold the window, about
SHOWN = 0.1  # seconds between two looks of its progress


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
        elif obj.library:
            problem = f"'{obj.name}' is linked: make a library override to change its materials, else make it local"
        elif obj.override_library and not cls.on_override:
            problem = f"'{obj.name}' is a library override, which would lose this when saved: make it local"
        elif jobs.running:
            problem = f"Wait until '{jobs.running.name}' is done, or cancel it"
        elif cls.needs_soft_skin and not obj.dynamorph.targets:
            problem = "Press Add Soft Skin first"
        if problem:
            cls.poll_message_set(problem)
        return not problem

    needs_soft_skin = True
    on_override = False  # whether a library override keeps what the button changes

    def execute(self, context):
        return guarded(self, self.apply, properties.mesh_in(context))


class DYNAMORPH_OT_free_bake(SoftSkinOperator, Operator):
    """Remove the baked shape keys and curves, and restore the target keys"""

    bl_idname = "dynamorph.free_bake"
    bl_label = "Free Bake"

    def apply(self, obj):
        sinks.free(obj)


class JobOperator(SoftSkinOperator):
    """Mixin: runs a job, in a window with a progress bar while Blender stays usable, else at once."""

    goal = "BUILD"

    def _jobs(self, obj) -> list[jobs.Job]:
        """The jobs to be done one after the other; obj: the mesh of the context."""
        return [jobs.Job(obj, self.goal, rebuild=self.goal == "BUILD")]

    def apply(self, obj):
        batch = jobs.Batch(self._jobs(obj), self.goal)
        jobs.run_all(batch)
        self._done(batch)

    def invoke(self, context, _event):
        if bpy.app.background:
            return self.execute(context)
        return guarded(self, self._begin, context)

    def modal(self, context, event):
        if event.type == "ESC" and event.value == "PRESS":  # used up: it must not also stop the playback
            self.batch.cancel()
        elif event.type != "TIMER":
            return {"PASS_THROUGH"}
        result = {"CANCELLED"}
        try:
            result = guarded(self, self._tick, context)
        finally:
            if result != {"RUNNING_MODAL"}:
                self._end(context)
        return result

    def cancel(self, _context):
        """Blender ends the operator itself, because the window closes or another file is opened."""
        jobs.stop()

    def _begin(self, context):
        self.batch = jobs.running = jobs.Batch(self._jobs(properties.mesh_in(context)), self.goal)
        self.steps = self.batch.steps(SLICE, 0.0)
        self.shown = 0.0  # when
        self.timer = context.window_manager.event_timer_add(TICK, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def _tick(self, context):
        batch = self.batch
        try:
            next(self.steps)
        except StopIteration:
            return self._done(batch)
        if time.monotonic() - self.shown > SHOWN:
            self.shown = time.monotonic()
            redraw(context)
            redraw_status(context)
        return {"RUNNING_MODAL"}

    def _end(self, context):
        self.batch.abandon()
        jobs.running = None
        context.window_manager.event_timer_remove(self.timer)
        redraw(context)
        redraw_status(context)

    def _done(self, batch):
        for job in batch.jobs:
            built = f" (built first: {'; '.join(job.reasons)})" if job.bake and job.reasons else ""
            self.report({"INFO"}, f"{job.name}: {job.summary()}{built}")
        for job in batch.jobs:
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


class DYNAMORPH_OT_bake_all(JobOperator, Operator):
    """Bake every soft skin of the scene, one after the other; none of them changes before all are done"""

    bl_idname = "dynamorph.bake_all"
    bl_label = "Bake All"
    goal = "BAKE_ALL"
    needs_soft_skin = False

    @classmethod
    def poll(cls, context):
        problem = ""
        if jobs.running:
            problem = f"Wait until '{jobs.running.name}' is done, or cancel it"
        elif not _own_skins(context.scene):
            problem = "The scene has no soft skin of its own: press Add Soft Skin first, or make a linked one local"
        if problem:
            cls.poll_message_set(problem)
        return not problem

    def _jobs(self, _obj):
        return [jobs.Job(skin, "BAKE") for skin in _own_skins(bpy.context.scene)]


def _own_skins(scene) -> list:
    """The soft skins whose bake would be saved."""
    return [skin for skin in properties.soft_skins(scene.objects) if not (skin.library or skin.override_library)]


class DYNAMORPH_OT_cancel(Operator):
    """Stop the running build or bake; what was there before stays"""

    bl_idname = "dynamorph.cancel"
    bl_label = "Cancel Soft Skin Job"

    def execute(self, _context):
        if jobs.running:
            jobs.running.cancel()
        return {"FINISHED"}


def redraw(context):
    """Let every panel that shows progress draw again, but not the 3D view, which may take longer than the job."""
    shown_in = {"VIEW_3D": "UI", "PROPERTIES": "WINDOW"}
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            for region in area.regions:
                if region.type == shown_in.get(area.type):
                    region.tag_redraw()


def redraw_status(context):
    """Let the status bar draw again, where `panels.draw_status` says what runs."""
    context.workspace.status_text_set(None)


@persistent
def _before_load(*_args):
    """load_pre: the job's results would have nowhere to go."""
    jobs.stop()


@persistent
def _after_undo(*_args):
    """undo_post and redo_post: what a job has read so far is of another scene, and curves are others again."""
    if jobs.running:
        jobs.running.undone = True
    _soon(_look_at_animations)


@persistent
def _check_changed(_scene, depsgraph):
    """depsgraph_update_post: a second after the last edit, see whether a model or a bake is out of date."""
    if any(obj.dynamorph.model.content_id for obj in properties.changed_objects(depsgraph)):
        _soon(_look_at_meshes)
    if any(isinstance(update.id, bpy.types.Action) for update in depsgraph.updates):
        _soon(_look_at_animations)


def _soon(look):
    if bpy.app.timers.is_registered(look):
        bpy.app.timers.unregister(look)
    if not bpy.app.background:
        bpy.app.timers.register(look, first_interval=1.0)


def _look_at_meshes():
    for obj in properties.soft_skins(bpy.context.scene.objects):
        if obj.dynamorph.model.content_id and obj.mode == "OBJECT" and not jobs.running:
            jobs.show_stale(obj)


def _look_at_animations():
    for obj in properties.soft_skins(bpy.context.scene.objects):
        if obj.dynamorph.bake.keys and obj.is_editable:
            changes.look_at_animation(obj)


@persistent
def _watch_influence(*_args):
    """load_post too: a file that is opened ends all subscriptions."""
    bpy.msgbus.clear_by_owner(CLASSES)
    bpy.msgbus.subscribe_rna(key=(bpy.types.NlaStrip, "influence"), owner=CLASSES, args=(), notify=_influence_changed)


def _influence_changed():
    for obj in properties.soft_skins(bpy.data.objects):
        sinks.show_influence(obj)


CLASSES = (
    DYNAMORPH_OT_build,
    DYNAMORPH_OT_bake,
    DYNAMORPH_OT_bake_all,
    DYNAMORPH_OT_free_bake,
    DYNAMORPH_OT_cancel,
)


def _handlers():
    handlers = bpy.app.handlers
    return (
        (handlers.load_pre, _before_load),
        (handlers.load_post, _watch_influence),
        (handlers.undo_post, _after_undo),
        (handlers.redo_post, _after_undo),
        (handlers.depsgraph_update_post, _check_changed),
    )


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    for handlers, handler in _handlers():
        handlers.append(handler)
    _watch_influence()


def unregister():
    jobs.stop()
    bpy.msgbus.clear_by_owner(CLASSES)
    for handlers, handler in _handlers():
        handlers.remove(handler)
    for look in (_look_at_meshes, _look_at_animations):
        if bpy.app.timers.is_registered(look):
            bpy.app.timers.unregister(look)
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
