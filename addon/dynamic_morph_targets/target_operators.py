# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons of the list of targets: which shape keys are targets, at which poses, of which material."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty
from bpy.types import Operator

from . import checks, extract, jobs, live, materials, properties, regions, sinks, suggest, targets
from .extract import SceneError
from .operators import SoftSkinOperator, guarded, listed
from .properties import key_points, rest_skeleton

SCULPT_MODE = EnumProperty(
    name="Mode",
    description="Where the shape key is edited, in the pose as it is",
    items=(
        ("SCULPT", "Sculpt Mode", "Sculpt it with brushes", "SCULPTMODE_HLT", 0),
        ("EDIT", "Edit Mode", "Move its vertices", "EDITMODE_HLT", 1),
    ),
)


class TargetOperator(SoftSkinOperator):
    """Mixin: works on the target that is selected in the list."""

    neutral_too = False

    @classmethod
    def obstacle(cls, context):
        obstacle = super().obstacle(context)
        settings = not obstacle and properties.mesh_in(context).dynamorph
        if settings and settings.active_target is None:
            return "Select a target in the list"
        if settings and settings.active_target_index == 0 and not cls.neutral_too:
            return "Select a target other than the neutral one"
        return obstacle


# The list ----------------------------------------------------------------------------------------------------------


class DYNAMORPH_OT_add_target(SoftSkinOperator, Operator):
    """Make a shape key a dynamic morph target at the current pose of the armature"""

    bl_idname = "dynamorph.add_target"
    bl_label = "Add Target"

    key: StringProperty(name="Shape Key", description="The shape key; the active one if empty", options={"SKIP_SAVE"})

    def invoke(self, context, _event):
        """The only key that can be a target, or a menu of them: the sidebar shows no shape keys to select one in."""
        names = [] if self.key else targets.eligible(properties.mesh_in(context))
        if len(names) < 2:
            self.key = names[0] if names else self.key
            return self.execute(context)

        def draw(menu, _context):
            menu.layout.operator_context = "EXEC_DEFAULT"
            for name in names:
                menu.layout.operator(self.bl_idname, text=name, icon="SHAPEKEY_DATA", translate=False).key = name

        context.window_manager.popup_menu(draw, title="Shape Key at This Pose")
        return {"INTERFACE"}

    def apply(self, obj):
        settings = obj.dynamorph
        keys = obj.data.shape_keys
        block = keys and (keys.key_blocks.get(self.key) if self.key else obj.active_shape_key)
        if not block:
            wanted = f"shape key '{self.key}'" if self.key else "active shape key"
            raise SceneError(f"'{obj.name}' has no {wanted}: sculpt one, or select another")
        if block == keys.reference_key:
            raise SceneError(
                f"'{block.name}' is the shape of the neutral target: select another shape key, or make one by New from "
                "Pose"
            )
        if block.name in [target.name for target in settings.targets[1:]]:
            raise SceneError(f"'{block.name}' is a target already: pose the armature and press Capture Pose to move it")
        if block.name in settings.bake.keys:
            raise SceneError(f"'{block.name}' belongs to the bake: select another shape key")
        pose = extract.current_pose(obj)
        capture(self, obj, targets.add(obj, block), pose)
        regions.update(obj)


class DYNAMORPH_OT_suggest_targets(SoftSkinOperator, Operator):
    """Make targets of the shape keys whose drivers read bones, each at the pose in which its driver turns it on"""

    bl_idname = "dynamorph.suggest_targets"
    bl_label = "Suggest from Drivers"

    def apply(self, obj):
        found, skipped = suggest.suggestions(obj)
        added = []
        for suggestion in found:
            skeleton, local, _ = suggestion.pose
            other = targets.at_pose_of(obj, skeleton, local, suggestion.bones)
            if other:
                skipped.append(f"'{suggestion.key}': it has the pose of '{other.name}'")
                continue
            target = targets.add(obj, obj.data.shape_keys.key_blocks[suggestion.key])
            target.set_pose(*suggestion.pose)
            target.set_bones(suggestion.bones)
            added.append(target.name)
        regions.update(obj)
        told = [rpt_("Targets added: {names}").format(names=", ".join(added))] * bool(added)
        told += [rpt_("Keys skipped: {names}").format(names=", ".join(skipped))] * bool(skipped)
        if not added:
            raise SceneError("; ".join(told))
        self.report({"WARNING" if skipped else "INFO"}, "; ".join(told))


class DYNAMORPH_OT_remove_target(TargetOperator, Operator):
    """Remove the selected target; its shape key stays. Removing the neutral target removes the soft skin"""

    bl_idname = "dynamorph.remove_target"
    bl_label = "Remove Target"
    neutral_too = True

    def apply(self, obj):
        settings = obj.dynamorph
        if settings.active_target_index > 0:
            target = settings.active_target
            if target.name == settings.sculpt.shown.name:
                sinks.show_target(obj, "")
            left = [target.region] * target.auto_region
            settings.targets.remove(settings.active_target_index)
            settings.active_target_index -= 1
            regions.update(obj, left)
            return
        remove_soft_skin(obj)


def remove_soft_skin(obj):
    """Its targets, model and bake; shape keys and settings stay. Raises SinkError."""
    live.turn_off(obj)
    sinks.free(obj)
    sinks.show_target(obj, "")
    left = {target.region for target in obj.dynamorph.targets if target.auto_region}
    obj.dynamorph.targets.clear()
    regions.update(obj, left)
    jobs.forget_model(obj)


class DYNAMORPH_OT_move_target(TargetOperator, Operator):
    """Move the selected target up or down in the list; the neutral target stays the first"""

    bl_idname = "dynamorph.move_target"
    bl_label = "Move Target"

    direction: EnumProperty(
        name="Direction",
        description="Where the target goes",
        items=(("UP", "Up", "Towards the neutral target"), ("DOWN", "Down", "Away from the neutral target")),
    )

    def apply(self, obj):
        settings = obj.dynamorph
        index = settings.active_target_index
        wanted = index + (1 if self.direction == "DOWN" else -1)
        if not 1 <= wanted < len(settings.targets):
            return {"CANCELLED"}
        settings.targets.move(index, wanted)
        settings.active_target_index = wanted
        return {"FINISHED"}


class DYNAMORPH_OT_duplicate_target(TargetOperator, Operator):
    """Copy the selected target and its shape key, to start another pose from it"""

    bl_idname = "dynamorph.duplicate_target"
    bl_label = "Duplicate Target"

    def apply(self, obj):
        index = obj.dynamorph.active_target_index
        skeleton = rest_skeleton(extract.armature_modifier(obj).object.data)
        target = targets.add(obj, targets.copy_key(obj, sculpted_key(obj).name), after=index)
        source = obj.dynamorph.targets[index]
        targets.copy_settings(source, target)
        target.set_pose(skeleton, source.local(skeleton), np.array(source.rig_world))
        target.set_bones(source.bone_names(), source.auto_bones)
        regions.update(obj)
        text = rpt_("'{name}' has the pose of '{source}': pose the armature and press Capture Pose")
        self.report({"WARNING"}, text.format(name=target.name, source=source.name))


class DYNAMORPH_OT_mirror_target(TargetOperator, Operator):
    """Make the target of the other side: names, pose, shape key and region mirrored about the X axis"""

    bl_idname = "dynamorph.mirror_target"
    bl_label = "Mirror Target"

    overwrite: BoolProperty(
        name="Overwrite",
        description="If there is a shape key of the other side's name, sculpt it anew instead of using it as it is",
    )

    def apply(self, obj):
        settings = obj.dynamorph
        source, index = settings.active_target, settings.active_target_index
        skeleton = rest_skeleton(extract.armature_modifier(obj).object.data)
        local = targets.mirrored_pose(skeleton, source.local(skeleton))
        bones = self._bones(source, skeleton, local)
        region = "" if source.auto_region else self._region(obj, source)
        block = self._key(obj)
        existing = [i for i, target in enumerate(settings.targets) if i and target.name == block.name]
        if existing:
            settings.active_target_index = existing[0]
        else:
            targets.add(obj, block, after=index)
        source, target = settings.targets[index], settings.active_target
        targets.copy_settings(source, target)
        target.set_region(region, source.auto_region)
        target.made_region = ""
        target.set_pose(skeleton, local, targets.mirrored_world(source.rig_world))
        target.set_bones(bones, source.auto_bones)
        regions.update(obj)

    def _bones(self, source, skeleton, mirrored) -> list[str]:
        """The target's bones on the other side. Raises SceneError where there is no other side."""
        if bpy.utils.flip_name(source.name) == source.name:
            raise SceneError(f"'{source.name}' does not say its side: give it a name that ends in .L or _R, say")
        bones = [bpy.utils.flip_name(bone) for bone in source.bone_names()]
        missing = [bone for bone in bones if bone not in skeleton.names]
        if missing:
            raise SceneError(f"Bone '{missing[0]}' is missing: '{source.name}' has no other side")
        used = [name in {*bones, *source.bone_names()} for name in skeleton.names]
        if checks.same_pose(source.local(skeleton)[used], mirrored[used]):
            raise SceneError(f"'{source.name}' has a symmetric pose, which its mirror image would share")
        return bones

    def _region(self, obj, source) -> str:
        region = bpy.utils.flip_name(source.region)
        if not region or region in obj.vertex_groups:
            return region
        text = rpt_("There is no vertex group '{region}': the mirrored target has no Region")
        self.report({"WARNING"}, text.format(region=region))
        return ""

    def _key(self, obj):
        """The shape key of the other side; made, or made anew, unless it is to be used as it is."""
        keys = obj.data.shape_keys
        source = sculpted_key(obj)
        name = bpy.utils.flip_name(source.name)
        existing = keys.key_blocks.get(name)
        if existing and not self.overwrite:
            return existing
        extract.check_mesh(obj)
        partners = targets.mirror_partners(key_points(keys.reference_key))
        alone = (partners < 0).nonzero()[0]
        if len(alone) == len(partners):
            raise SceneError(f"'{obj.name}' is not symmetric about its X axis: sculpt a shape key '{name}' yourself")
        if len(alone):
            text = rpt_("{count} vertices have no mirror image and stay as in the Basis: {numbers}")
            self.report({"WARNING"}, text.format(count=len(alone), numbers=listed([str(vertex) for vertex in alone])))
        shape = targets.mirrored_shape(extract.target_shape(obj, source.name), partners)
        if existing is None:
            return targets.new_key(obj, name, shape)
        targets.sculpt_anew(existing, shape)
        return existing


class DYNAMORPH_OT_select_key(TargetOperator, Operator):
    """Make the selected target's shape key the active one in the Shape Keys panel"""

    bl_idname = "dynamorph.select_key"
    bl_label = "Select Shape Key"

    def apply(self, obj):
        block = sculpted_key(obj)
        obj.active_shape_key_index = obj.data.shape_keys.key_blocks.find(block.name)


def sculpted_key(obj):
    """The shape key of the selected target. Raises SceneError."""
    target, keys = obj.dynamorph.active_target, obj.data.shape_keys
    block = keys and keys.key_blocks.get(target.name)
    if not block:
        raise SceneError(f"'{obj.name}': the shape key of target '{target.name}' is gone: remove the target")
    return block


# Poses and bones ---------------------------------------------------------------------------------------------------


class DYNAMORPH_OT_capture_pose(TargetOperator, Operator):
    """Let the selected target apply at the current pose of the armature, and choose its bones from that pose"""

    bl_idname = "dynamorph.capture_pose"
    bl_label = "Capture Pose"
    neutral_too = True

    def apply(self, obj):
        capture(self, obj, obj.dynamorph.active_target, extract.current_pose(obj))
        regions.update(obj)


def capture(operator, obj, target, pose):
    """Store a pose as `extract.current_pose` gives it; of the bones turned away from the neutral pose those that bend
    what the target sculpts place it.
    """
    skeleton, local, rig_world = pose
    target.set_pose(skeleton, local, rig_world)
    if target == obj.dynamorph.targets[0]:
        return
    targets.choose_bones(obj, target, skeleton)
    if not target.bones:
        text = rpt_("'{name}': no bone is turned away from the neutral pose. Pose it, then Capture Pose")
        operator.report({"WARNING"}, text.format(name=target.name))


class DYNAMORPH_OT_go_to_pose(TargetOperator, Operator):
    """Pose the armature as it was captured for the selected target"""

    bl_idname = "dynamorph.go_to_pose"
    bl_label = "Go to Pose"
    neutral_too = True

    def apply(self, obj):
        go_to_pose(self, obj)


def go_to_pose(operator, obj):
    skeleton, *_ = extract.current_pose(obj)
    local = obj.dynamorph.active_target.local(skeleton)
    targets.pose_rig(extract.armature_modifier(obj).object, skeleton, local)
    elsewhere = targets.held_elsewhere(obj, skeleton, local)
    if elsewhere:
        text = rpt_("Constraints or drivers hold bones off: {bones}")
        operator.report({"WARNING"}, text.format(bones=listed(elsewhere)))
    index = obj.dynamorph.active_target_index
    sinks.show_target(obj, obj.dynamorph.active_target.name if index else "")


class DYNAMORPH_OT_use_selected_bones(TargetOperator, Operator):
    """Let the selected pose bones decide when the selected target applies"""

    bl_idname = "dynamorph.use_selected_bones"
    bl_label = "Use Selected Bones"

    extend: BoolProperty(name="Extend", description="Keep the bones that the target depends on already", default=True)

    def apply(self, obj):
        target = obj.dynamorph.active_target
        rig = extract.armature_modifier(obj).object
        chosen = targets.selected_bones(rig)
        if not chosen:
            raise SceneError(f"Select in Pose Mode the bones of '{rig.name}' that '{target.name}' depends on")
        kept = target.bone_names() if self.extend else ()
        target.set_bones(dict.fromkeys((*kept, *chosen)))
        regions.update(obj)


class DYNAMORPH_OT_remove_bone(TargetOperator, Operator):
    """The selected target no longer depends on this bone"""

    bl_idname = "dynamorph.remove_bone"
    bl_label = "Remove Bone"

    bone: StringProperty(name="Bone", description="Which of the target's bones", options={"SKIP_SAVE"})

    def apply(self, obj):
        target = obj.dynamorph.active_target
        target.set_bones([bone for bone in target.bone_names() if bone != self.bone])
        regions.update(obj)


class DYNAMORPH_OT_region_from_sculpt(TargetOperator, Operator):
    """Make the region of the selected target from what is sculpted, together with the targets that share its bones"""

    bl_idname = "dynamorph.region_from_sculpt"
    bl_label = "Region from Sculpt"

    def apply(self, obj):
        target = obj.dynamorph.active_target
        sculpted_key(obj)
        extract.check_mesh(obj)
        target.set_region("", automatic=True)
        target.made_region = ""
        regions.update(obj)
        if not target.region:
            text = rpt_("'{name}' is not sculpted yet: its region is the whole body until it is")
            self.report({"WARNING"}, text.format(name=target.name))


# Sculpting ---------------------------------------------------------------------------------------------------------


class SculptOperator:
    """Mixin, before the other: begins to sculpt, which must not have begun already."""

    @classmethod
    def obstacle(cls, context):
        obstacle = super().obstacle(context)
        if not obstacle and properties.mesh_in(context).dynamorph.sculpt.active:
            return "Press Finish Sculpting first"
        return obstacle


class DYNAMORPH_OT_new_from_pose(SculptOperator, SoftSkinOperator, Operator):
    """Make a target for the pose as it is, with a shape key that starts as the other targets look there; sculpt it"""

    bl_idname = "dynamorph.new_from_pose"
    bl_label = "New from Pose"

    key: StringProperty(name="Name", description="Of the shape key and target", options={"SKIP_SAVE"})
    mode: SCULPT_MODE

    def invoke(self, context, _event):
        return guarded(self, self._ask, context)

    def _ask(self, context):
        obj = properties.mesh_in(context)
        self._check(obj)
        self.key = self.key or self._default_name(obj)
        return context.window_manager.invoke_props_dialog(self)

    def apply(self, obj):
        pose = self._check(obj)
        shape = targets.blended_shape(obj, pose[1])
        sinks.show_target(obj, "")
        block = targets.new_key(obj, self.key or self._default_name(obj), shape)
        target = targets.add(obj, block)
        target.set_pose(*pose)
        targets.choose_bones(obj, target, pose[0], np.zeros_like(shape))  # all that are turned, until it is sculpted
        targets.begin_sculpting(obj, block, self.mode, is_new=True)

    def _check(self, obj):
        """The pose as it is. Raises SceneError if there can be no new target."""
        targets.check_can_sculpt(obj)
        skeleton, local, rig_world = extract.current_pose(obj)
        bones = extract.bones_turned(obj, skeleton, obj.dynamorph.targets[0].local(skeleton), local)
        if not bones:
            raise SceneError("No bone is turned away from the neutral pose: pose the armature first")
        other = targets.at_pose_of(obj, skeleton, local, bones)
        # Another limb that is turned too may have a target there: by its sculpt it comes into another set.
        if other and (obj.dynamorph.model.hold != "THICKNESS" or set(bones) <= {*other.bone_names()}):
            raise SceneError(f"The armature is in the pose of '{other.name}': pose it otherwise, or sculpt that target")
        return skeleton, local, rig_world

    def _default_name(self, obj) -> str:
        keys = obj.data.shape_keys
        return targets.free_name(keys.key_blocks.keys() if keys else (), "Pose")


class DYNAMORPH_OT_sculpt_target(SculptOperator, TargetOperator, Operator):
    """Sculpt the selected target in its pose"""

    bl_idname = "dynamorph.sculpt_target"
    bl_label = "Sculpt Target"

    mode: SCULPT_MODE

    def apply(self, obj):
        block = sculpted_key(obj)
        targets.check_can_sculpt(obj)
        go_to_pose(self, obj)
        targets.begin_sculpting(obj, block, self.mode)


class DYNAMORPH_OT_finish_sculpt(SoftSkinOperator, Operator):
    """Leave the mode, show all shape keys again, and choose bones and region by what was sculpted"""

    bl_idname = "dynamorph.finish_sculpt"
    bl_label = "Finish Sculpting"

    @classmethod
    def obstacle(cls, context):
        obstacle = super().obstacle(context)
        if not obstacle and not properties.mesh_in(context).dynamorph.sculpt.active:
            return "No target is being sculpted"
        return obstacle

    def apply(self, obj):
        targets.finish_sculpting(obj)
        try:
            targets.learn_from_sculpt(obj)
        except jobs.expected_errors() as error:  # the mode is left in any case
            self.report({"WARNING"}, str(error))


# Materials ---------------------------------------------------------------------------------------------------------


class DYNAMORPH_OT_apply_material(TargetOperator, Operator):
    """Give the selected target the properties of a measured material"""

    bl_idname = "dynamorph.apply_material"
    bl_label = "Apply Material"
    neutral_too = True
    on_override = True

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
        obj.dynamorph.active_target.set_material(materials.PRESETS[self.preset].material, by_hand=True)


class DYNAMORPH_OT_fit_material(TargetOperator, Operator):
    """Set stiffness and damping of the selected target so that the flesh swings as observed, on the cage as built"""

    bl_idname = "dynamorph.fit_material"
    bl_label = "Fit Bounce"
    neutral_too = True
    on_override = True

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
    def obstacle(cls, context):
        obstacle = super().obstacle(context)
        if not obstacle and not properties.mesh_in(context).dynamorph.model.content_id:
            return "Press Build Model first: the bounce is measured on its cage"
        return obstacle

    def invoke(self, context, _event):
        return guarded(self, self._ask, context)

    def _ask(self, context):
        obj = properties.mesh_in(context)
        now = materials.bounce(*jobs.fit_input(obj, obj.dynamorph.active_target))
        self.frequency, self.settle = now.frequency or self.frequency, now.settle
        return context.window_manager.invoke_props_dialog(self)

    def apply(self, obj):
        target, decay = obj.dynamorph.active_target, materials.decay_of(self.settle)
        fitted = materials.fit_oscillation(*jobs.fit_input(obj, target), self.frequency, decay)
        target.set_material(fitted, by_hand=True)


CLASSES = (
    DYNAMORPH_OT_add_target,
    DYNAMORPH_OT_suggest_targets,
    DYNAMORPH_OT_remove_target,
    DYNAMORPH_OT_move_target,
    DYNAMORPH_OT_duplicate_target,
    DYNAMORPH_OT_mirror_target,
    DYNAMORPH_OT_select_key,
    DYNAMORPH_OT_capture_pose,
    DYNAMORPH_OT_go_to_pose,
    DYNAMORPH_OT_use_selected_bones,
    DYNAMORPH_OT_remove_bone,
    DYNAMORPH_OT_region_from_sculpt,
    DYNAMORPH_OT_new_from_pose,
    DYNAMORPH_OT_sculpt_target,
    DYNAMORPH_OT_finish_sculpt,
    DYNAMORPH_OT_apply_material,
    DYNAMORPH_OT_fit_material,
)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
