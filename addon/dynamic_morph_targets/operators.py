# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons: check, call, report. The work is in extract, jobs and sinks."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.app.handlers import persistent
from bpy.props import EnumProperty, FloatProperty, StringProperty
from bpy.types import Operator

from . import extract, jobs, materials, properties, sinks
from .extract import Cancelled, SceneError


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


class DYNAMORPH_OT_add_soft_skin(SoftSkinOperator, Operator):
    """Make the active mesh a soft skin, with a neutral target at the armature's rest pose"""

    bl_idname = "dynamorph.add_soft_skin"
    bl_label = "Add Soft Skin"
    needs_soft_skin = False

    def apply(self, obj):
        if obj.dynamorph.targets:
            raise SceneError(f"'{obj.name}' has a soft skin already")
        skeleton, _, rig_world = extract.current_pose(obj)
        if obj.data.shape_keys is None:
            obj.shape_key_add(name="Basis", from_mix=False)
        target = obj.dynamorph.targets.add()
        target.name = properties.NEUTRAL
        target.set_pose(skeleton, np.tile(np.eye(4), (len(skeleton.names), 1, 1)), rig_world)


class DYNAMORPH_OT_add_target(SoftSkinOperator, Operator):
    """Make a shape key a dynamic morph target at the current pose of the armature"""

    bl_idname = "dynamorph.add_target"
    bl_label = "Add Target"

    key: StringProperty(name="Shape Key", description="The shape key; the active one if empty", options={"SKIP_SAVE"})

    def apply(self, obj):
        settings = obj.dynamorph
        keys = obj.data.shape_keys
        block = keys and (keys.key_blocks.get(self.key) if self.key else obj.active_shape_key)
        if not block:
            wanted = f"shape key '{self.key}'" if self.key else "active shape key"
            raise SceneError(f"'{obj.name}' has no {wanted}: sculpt one, or select another")
        if block == keys.reference_key:
            raise SceneError(f"'{block.name}' is the shape of the neutral target: select another shape key")
        if block.name in [target.name for target in settings.targets[1:]]:
            raise SceneError(f"'{block.name}' is a target already: pose the armature and press Capture Pose to move it")
        if block.name in settings.bake.keys:
            raise SceneError(f"'{block.name}' belongs to the bake: select another shape key")
        pose = extract.current_pose(obj)
        target = settings.targets.add()
        target.refer_to(keys.key_blocks, keys.key_blocks.find(block.name))
        settings.active_target_index = len(settings.targets) - 1
        capture(self, obj, target, pose)


class DYNAMORPH_OT_remove_target(SoftSkinOperator, Operator):
    """Remove the selected target; its shape key stays. Removing the neutral target removes the soft skin"""

    bl_idname = "dynamorph.remove_target"
    bl_label = "Remove Target"

    def apply(self, obj):
        settings = obj.dynamorph
        if settings.active_target is None:
            raise SceneError("Select a target in the list")
        if settings.active_target_index > 0:
            settings.targets.remove(settings.active_target_index)
            settings.active_target_index -= 1
            return
        sinks.free(obj)
        settings.targets.clear()
        jobs.forget_model(obj)


class DYNAMORPH_OT_capture_pose(SoftSkinOperator, Operator):
    """Let the selected target apply at the current pose of the armature, and choose its bones from that pose"""

    bl_idname = "dynamorph.capture_pose"
    bl_label = "Capture Pose"

    def apply(self, obj):
        if obj.dynamorph.active_target is None:
            raise SceneError("Select a target in the list")
        capture(self, obj, obj.dynamorph.active_target, extract.current_pose(obj))


def capture(operator, obj, target, pose):
    """Store a pose as `extract.current_pose` gives it; the bones turned away from the neutral pose place the target."""
    skeleton, local, rig_world = pose
    neutral = obj.dynamorph.targets[0]
    target.set_pose(skeleton, local, rig_world)
    if target == neutral:
        return
    target.set_bones(extract.bones_turned(obj, skeleton, neutral.local(skeleton), local))
    if not target.bones:
        operator.report(
            {"WARNING"}, f"'{target.name}': no bone is turned away from the neutral pose. Pose it, then Capture Pose"
        )


class DYNAMORPH_OT_use_selected_bones(SoftSkinOperator, Operator):
    """Let the pose bones that are selected decide when the selected target applies"""

    bl_idname = "dynamorph.use_selected_bones"
    bl_label = "Use Selected Bones"

    def apply(self, obj):
        target = obj.dynamorph.active_target
        rig = extract.armature_modifier(obj).object
        # 5.0 moved the selection from the bone to the pose bone.
        chosen = [bone.name for bone in rig.pose.bones if (bone if hasattr(bone, "select") else bone.bone).select]
        if target is None or not chosen:
            raise SceneError(f"Select a target in the list, and in Pose Mode the bones of '{rig.name}' it depends on")
        target.set_bones(chosen)


class DYNAMORPH_OT_apply_material(SoftSkinOperator, Operator):
    """Give the selected target the properties of a measured material"""

    bl_idname = "dynamorph.apply_material"
    bl_label = "Material"

    preset: EnumProperty(
        name="Material",
        description="What the flesh is made of at this target",
        items=[(key, preset.label, preset.source) for key, preset in materials.PRESETS.items()],
    )

    @classmethod
    def description(cls, _context, given):
        """The tooltip: Blender does not show the descriptions of items of an operator's menu."""
        return materials.PRESETS[given.preset].source if given.is_property_set("preset") else ""

    def apply(self, obj):
        selected_target(obj).set_material(materials.PRESETS[self.preset].material)


class DYNAMORPH_OT_fit_material(SoftSkinOperator, Operator):
    """Set stiffness and damping of the selected target so that the flesh swings as observed, on the cage as built"""

    bl_idname = "dynamorph.fit_material"
    bl_label = "Fit Bounce"

    frequency: FloatProperty(
        name="Bounce (Hz)", description="Swings a second after a push", default=3.0, min=0.01, max=1000.0
    )
    settle: FloatProperty(
        name="Settle (s)",
        description="Seconds until a twentieth of the swing is left",
        default=1.0,
        min=0.001,
        max=1000.0,
    )

    @classmethod
    def poll(cls, context):
        if not super().poll(context):
            return False
        if not properties.mesh_in(context).dynamorph.model.content_id:
            cls.poll_message_set("Press Build Model first: the bounce is measured on its cage")
            return False
        return True

    def invoke(self, context, _event):
        return guarded(self, self._ask, context)

    def _ask(self, context):
        obj = properties.mesh_in(context)
        now = materials.bounce(*jobs.fit_input(obj, selected_target(obj)))
        self.frequency, self.settle = now.frequency or self.frequency, now.settle
        return context.window_manager.invoke_props_dialog(self)

    def apply(self, obj):
        target, decay = selected_target(obj), materials.decay_of(self.settle)
        target.set_material(materials.fit_oscillation(*jobs.fit_input(obj, target), self.frequency, decay))


def selected_target(obj):
    target = obj.dynamorph.active_target
    if target is None:
        raise SceneError("Select a target in the list")
    return target


class DYNAMORPH_OT_free_bake(SoftSkinOperator, Operator):
    """Remove the baked shape keys and curves, and restore the target keys"""

    bl_idname = "dynamorph.free_bake"
    bl_label = "Free Bake"

    def apply(self, obj):
        sinks.check(obj)
        sinks.free(obj)


class JobOperator(SoftSkinOperator):
    """Mixin: runs a job, in a window with a progress bar while Blender stays usable, else at once."""

    bake = False

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
        self.job = jobs.Job(obj, bake=self.bake, rebuild=not self.bake)
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
        built = f" (built first: {'; '.join(job.reasons)})" if self.bake and job.reasons else ""
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
    bl_label = "Bake"
    bake = True


class DYNAMORPH_OT_cancel(Operator):
    """Stop the running build or bake; what was there before stays"""

    bl_idname = "dynamorph.cancel"
    bl_label = "Cancel"

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
    DYNAMORPH_OT_add_soft_skin,
    DYNAMORPH_OT_add_target,
    DYNAMORPH_OT_remove_target,
    DYNAMORPH_OT_capture_pose,
    DYNAMORPH_OT_use_selected_bones,
    DYNAMORPH_OT_apply_material,
    DYNAMORPH_OT_fit_material,
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
