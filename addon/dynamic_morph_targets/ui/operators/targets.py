# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons of the list of targets: which shape keys are targets, at which poses, with which material."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import BoolProperty, EnumProperty, StringProperty
from bpy.types import Operator

from ...core.errors import SceneError
from ...run.tools.removal import remove_soft_skin
from ...run.work import task
from ...scene import skin
from ...scene.check import checks
from ...scene.motion import rig_motion
from ...scene.references import rest_skeleton
from ...scene.registration import of_classes
from ...write.authoring import channels, mirror, regions, suggest, targets
from ...write.authoring.targets import sculpted_key
from ...write.bake import muting
from ..base import SoftSkinOperator, TargetOperator
from .jobs import JobOperator

# The list ----------------------------------------------------------------------------------------------------------


class DYNAMORPH_OT_add_target(SoftSkinOperator, Operator):
    """Make a shape key a dynamic morph target at the current pose of the armature"""

    bl_idname = "dynamorph.add_target"
    bl_label = "Add Target"

    key: StringProperty(
        name="Shape Key",
        description="The shape key to use. If it is empty, the active one is used",
        options={"SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Use the only key that can be a target, or show a menu: the sidebar has no list of shape keys to select one
        in.
        """
        names = [] if self.key else targets.eligible(skin.mesh_in(context))
        if len(names) < 2:
            self.key = names[0] if names else self.key
            return self.execute(context)

        def draw(menu: bpy.types.Menu, _context: bpy.types.Context) -> None:
            menu.layout.operator_context = "EXEC_DEFAULT"
            for name in names:
                menu.layout.operator(self.bl_idname, text=name, icon="SHAPEKEY_DATA", translate=False).key = name

        context.window_manager.popup_menu(draw, title="Shape Key at This Pose")
        return {"INTERFACE"}

    def apply(self, obj: bpy.types.Object) -> None:
        settings = obj.dynamorph
        keys = obj.data.shape_keys
        block = keys and (keys.key_blocks.get(self.key) if self.key else obj.active_shape_key)
        if not block:
            wanted = f"shape key '{self.key}'" if self.key else "active shape key"
            raise SceneError("'{name}' has no {wanted}: sculpt one, or select another", name=obj.name, wanted=wanted)
        if block == keys.reference_key:
            raise SceneError(
                "'{name}' is the shape of the neutral target: select another shape key, or make one by New from Pose",
                name=block.name,
            )
        if block.name in [target.name for target in settings.targets[1:]]:
            raise SceneError(
                "'{name}' is a target already: pose the armature and press Capture Pose to move it", name=block.name
            )
        if block.name in settings.bake.keys:
            raise SceneError("'{name}' belongs to the bake: select another shape key", name=block.name)
        if block.name == settings.live.key.name:
            raise SceneError("'{name}' belongs to Live: select another shape key", name=block.name)
        pose = rig_motion.current_pose(obj)
        self.warn(targets.capture(obj, targets.add(obj, block), pose))
        regions.update(obj)


class DYNAMORPH_OT_suggest_targets(JobOperator, Operator):
    """Make targets from the shape keys whose drivers read bones, each at the pose in which its driver turns it on"""

    bl_idname = "dynamorph.suggest_targets"
    bl_label = "Suggest from Drivers"
    goal = "SUGGEST_TARGETS"

    def _batch(self, obj: bpy.types.Object) -> task.Task:
        return task.Task(obj, self.goal, suggest.suggestions(obj.session_uid))

    def _done(self, task: task.Task) -> set[str]:
        obj, (found, skipped), added = task.object.find(), task.result, []
        for suggestion in found:
            skeleton, local, _ = suggestion.pose
            other = targets.at_pose_of(obj, skeleton, local, suggestion.bones, {})
            if other:
                skipped.append(f"'{suggestion.key}': it has the pose of '{other.name}'")
                continue
            target = targets.add(obj, obj.data.shape_keys.key_blocks[suggestion.key])
            target.set_pose(*suggestion.pose)
            target.set_bones(suggestion.bones)
            added.append(target.name)
        regions.update(obj)
        messages = [rpt_("Targets added: {names}").format(names=", ".join(added))] * bool(added)
        messages += [rpt_("Keys skipped: {names}").format(names=", ".join(skipped))] * bool(skipped)
        if not added:
            raise SceneError("; ".join(messages))
        self.report({"WARNING" if skipped else "INFO"}, "; ".join(messages))
        return {"FINISHED"}


class DYNAMORPH_OT_remove_target(TargetOperator, Operator):
    """Remove the selected target. Its shape key stays. Removing the neutral target removes the soft skin"""

    bl_idname = "dynamorph.remove_target"
    bl_label = "Remove Target"
    neutral_too = True

    def apply(self, obj: bpy.types.Object) -> None:
        settings = obj.dynamorph
        if settings.active_target_index > 0:
            target = settings.active_target
            if target.name == settings.sculpt.shown.name:
                muting.show_target(obj, "")
            left = regions.automatic_regions(obj, [target])
            targets.remove(obj, settings.active_target_index)
            channels.remove_unused(obj)
            regions.update(obj, left)
            return
        remove_soft_skin(obj)


class DYNAMORPH_OT_move_target(TargetOperator, Operator):
    """Move the selected target up or down in the list. The neutral target always stays first"""

    bl_idname = "dynamorph.move_target"
    bl_label = "Move Target"

    direction: EnumProperty(
        name="Direction",
        description="Direction in which the target moves",
        items=(("UP", "Up", "Toward the neutral target", 0), ("DOWN", "Down", "Away from the neutral target", 1)),
    )

    def apply(self, obj: bpy.types.Object) -> set[str]:
        settings = obj.dynamorph
        index = settings.active_target_index
        wanted = index + (1 if self.direction == "DOWN" else -1)
        if not 1 <= wanted < len(settings.targets):
            return {"CANCELLED"}
        targets.move(obj, index, wanted)
        return {"FINISHED"}


class DYNAMORPH_OT_duplicate_target(TargetOperator, Operator):
    """Copy the selected target and its shape key, as a start for another pose"""

    bl_idname = "dynamorph.duplicate_target"
    bl_label = "Duplicate Target"

    def apply(self, obj: bpy.types.Object) -> None:
        index = obj.dynamorph.active_target_index
        skeleton = rest_skeleton(checks.armature_modifier(obj).object.data)
        target = targets.add(obj, targets.copy_key(obj, sculpted_key(obj).name), after=index)
        source = obj.dynamorph.targets[index]
        targets.copy_settings(source, target)
        target.set_pose(skeleton, source.local(skeleton), np.array(source.rig_world))
        target.set_bones(source.bone_names(), source.auto_bones)
        regions.update(obj)
        text = rpt_("'{name}' has the same pose as '{source}': pose the armature and press Capture Pose")
        self.report({"WARNING"}, text.format(name=target.name, source=source.name))


class DYNAMORPH_OT_mirror_target(TargetOperator, Operator):
    """Create the target of the other side, with names, pose, shape key and region mirrored about the X axis"""

    bl_idname = "dynamorph.mirror_target"
    bl_label = "Mirror Target"

    overwrite: BoolProperty(
        name="Overwrite",
        description="Replace the shape of an existing shape key of the other side. If off, that key is used unchanged",
    )

    def apply(self, obj: bpy.types.Object) -> None:
        self.warn(mirror.mirror_target(obj, self.overwrite))


class DYNAMORPH_OT_select_key(TargetOperator, Operator):
    """Make the selected target's shape key the active one in the Shape Keys panel"""

    bl_idname = "dynamorph.select_key"
    bl_label = "Select Shape Key"

    def apply(self, obj: bpy.types.Object) -> None:
        block = sculpted_key(obj)
        obj.active_shape_key_index = obj.data.shape_keys.key_blocks.find(block.name)


class DYNAMORPH_OT_select_target(SoftSkinOperator, Operator):
    """Select the target of the active shape key in the list of targets"""

    bl_idname = "dynamorph.select_target"
    bl_label = "Select Target"

    def apply(self, obj: bpy.types.Object) -> None:
        index = skin.target_of_active_key(obj)
        if index is None:
            name = obj.active_shape_key.name
            raise SceneError("'{name}' is not a target: press Add Target, or select another shape key", name=name)
        obj.dynamorph.active_target_index = index


class DYNAMORPH_OT_region_from_sculpt(TargetOperator, Operator):
    """Make the region of the selected target from the sculpt, together with the targets that share its bones"""

    bl_idname = "dynamorph.region_from_sculpt"
    bl_label = "Region from Sculpt"

    def apply(self, obj: bpy.types.Object) -> None:
        target = obj.dynamorph.active_target
        sculpted_key(obj)
        checks.check_mesh(obj)
        target.set_region("", automatic=True)
        target.made_region = ""
        regions.update(obj)
        if not target.region:
            text = rpt_("'{name}' is not sculpted yet: its region is the whole body until it is")
            self.report({"WARNING"}, text.format(name=target.name))


CLASSES = (
    DYNAMORPH_OT_add_target,
    DYNAMORPH_OT_suggest_targets,
    DYNAMORPH_OT_remove_target,
    DYNAMORPH_OT_move_target,
    DYNAMORPH_OT_duplicate_target,
    DYNAMORPH_OT_mirror_target,
    DYNAMORPH_OT_select_key,
    DYNAMORPH_OT_select_target,
    DYNAMORPH_OT_region_from_sculpt,
)
register, unregister = of_classes(CLASSES)
