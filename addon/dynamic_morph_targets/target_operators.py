# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons of the list of targets: which shape keys are targets, at which poses, of which material."""

from __future__ import annotations

import bpy
from bpy.props import EnumProperty, FloatProperty, StringProperty
from bpy.types import Operator

from . import extract, jobs, materials, properties, sinks
from .extract import SceneError
from .operators import SoftSkinOperator, guarded


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
    bl_label = "Apply Material"

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


CLASSES = (
    DYNAMORPH_OT_add_target,
    DYNAMORPH_OT_remove_target,
    DYNAMORPH_OT_capture_pose,
    DYNAMORPH_OT_use_selected_bones,
    DYNAMORPH_OT_apply_material,
    DYNAMORPH_OT_fit_material,
)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
