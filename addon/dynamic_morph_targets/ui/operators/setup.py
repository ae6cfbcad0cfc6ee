# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons that make a mesh a soft skin, fix its problems, take back what scripts have set, and prepare its cage."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import EnumProperty
from bpy.types import Operator

from ...core.errors import SceneError, sentence
from ...core.material.feel import FEELS
from ...core.message import translated
from ...run import live
from ...run.tools.removal import remove_soft_skin
from ...run.work import child
from ...scene import cuts, references, skin
from ...scene.character import extract
from ...scene.check import body_checks, checks
from ...scene.properties import scripted, target_properties
from ...scene.read.source import read_again, read_once
from ...scene.read.worlds import world_now
from ...scene.references import armature_modifiers
from ...scene.registration import of_classes
from ...scene.skinning import Skinning
from ...write.authoring import attachments, parts
from ...write.authoring.fixes import FIXES
from ...write.bake import writer
from .. import messages
from ..base import SoftSkinOperator
from . import feel
from .jobs import JobOperator, StartsJob


class DYNAMORPH_OT_add_soft_skin(StartsJob, Operator):
    """Make the active mesh a soft skin, build it and show it in Live: a hop, then the animation. Esc stops it"""

    bl_idname = "dynamorph.add_soft_skin"
    bl_label = "Add Soft Skin"
    needs_soft_skin = False
    job = "dynamorph.first_look"

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        disabled_reason, obj = super().disabled_reason(context), skin.mesh_in(context)
        if not disabled_reason and not armature_modifiers(obj) and not attachments.carried_by(obj):
            return "The mesh needs an Armature modifier with an armature"
        return disabled_reason

    def apply(self, obj: bpy.types.Object) -> None:
        with read_once():
            self._add(obj)

    def _add(self, obj: bpy.types.Object) -> None:
        chosen = _body_meant(obj)
        if chosen != obj:
            text = rpt_("'{name}' becomes the soft skin: it has the largest soft surface on its armature")
            self.report({"INFO"}, text.format(name=chosen.name))
        obj = chosen
        if obj.dynamorph.targets:
            raise SceneError("'{name}' is a soft skin already: press Bake, or add targets", name=obj.name)
        if not bpy.app.background:
            child.prepare()  # while the mesh is looked at
        in_the_way = extract.first_look(obj)
        rig = references.rig_of(obj)
        skeleton, rig_world = references.rest_skeleton(rig.data), world_now(rig)
        if obj.mode != "EDIT":
            writer.ensure_basis(obj)
        target = obj.dynamorph.targets.add()
        target.name = target_properties.NEUTRAL
        target.set_pose(skeleton, np.tile(np.eye(4), (len(skeleton.names), 1, 1)), rig_world)
        feel.give_feel(obj, FEELS["NATURAL"])
        in_the_way += [text for text in _find_attachments(obj) if text not in in_the_way]
        body_checks.look(obj)
        skinning = Skinning.of(obj)
        found = (*checks.problems(skinning), *checks.notes(skinning), *body_checks.known(skinning))
        drawn = [problem.text for problem in found]
        obj.dynamorph.model.warnings = "\n".join(text for text in in_the_way if text not in drawn)  # until a build
        for text in in_the_way:
            self.report({"WARNING"}, translated(text, rpt_))


class DYNAMORPH_OT_remove_soft_skin(SoftSkinOperator, Operator):
    """Remove the soft skin with its targets, its model and its bake. Shape keys stay"""

    bl_idname = "dynamorph.remove_soft_skin"
    bl_label = "Remove Soft Skin"

    def apply(self, obj: bpy.types.Object) -> None:
        remove_soft_skin(obj)


def _body_meant(obj: bpy.types.Object) -> bpy.types.Object:
    """The mesh that becomes a soft skin, and becomes active, when `obj` (a helmet, for example) or its armature is
    active.
    """
    active = bpy.context.object
    if "EDIT" in (obj.mode, active.mode):  # what is edited cannot be read
        return obj
    chosen = attachments.body_for(active if active.type == "ARMATURE" else obj)
    if chosen.type != "MESH":  # none of the armature's can be one
        return obj
    if active == obj != chosen and obj.mode == "OBJECT":
        bpy.context.view_layer.objects.active = chosen
    return chosen


def _find_attachments(obj: bpy.types.Object) -> list[str]:
    """List what belongs to the body of `obj`, in one cage with it. Returns the problems with that."""
    problem = next(checks.problems(Skinning.of(obj)), None)
    if problem:  # which is reported already
        return []
    try:
        attachments.find(obj)
        read_again()  # they have groups of their own
        parts.find(obj, extract.character(obj, without_targets=True))
    except SceneError as error:
        return [sentence(error)]
    return []


class DYNAMORPH_OT_fix(SoftSkinOperator, Operator):
    """Fix a problem that prevents a soft skin"""

    bl_idname = "dynamorph.fix"
    bl_label = "Fix"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}  # a search would offer only the first problem
    needs_soft_skin = False
    on_linked_mesh = True  # what is in the way may be of the armature; each fix looks at what it changes

    problem: EnumProperty(
        name="Problem",
        description="The problem to fix",
        items=[(key, fix.label, fix.tooltip, number) for number, (key, fix) in enumerate(FIXES.items())],
    )

    @classmethod
    def description(cls, _context: bpy.types.Context, given: bpy.types.OperatorProperties) -> str:
        return FIXES[given.problem].tooltip

    def apply(self, obj: bpy.types.Object) -> None:
        for look in (body_checks.look, cuts.look):
            look(obj)
        if self.problem not in [problem.fix for problem, _ in messages.messages(obj)]:
            raise SceneError(
                "'{name}' does not have this problem: {label} is not needed",
                name=obj.name,
                label=FIXES[self.problem].label,
            )
        FIXES[self.problem].apply(obj)


class DYNAMORPH_OT_reset_setting(SoftSkinOperator, Operator):
    """Set what a script has set back to its default, which suits nearly every body"""

    bl_idname = "dynamorph.reset_setting"
    bl_label = "Reset Setting"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}  # a search would offer only the first setting

    setting: EnumProperty(
        name="Setting",
        description="The setting to reset",
        items=[(name, name, "", number) for number, name in enumerate(scripted.SCRIPTED)],
    )

    def apply(self, obj: bpy.types.Object) -> None:
        scripted.reset(obj, self.setting)
        live.refresh(obj)


# Cage --------------------------------------------------------------------------------------------------------------


class DYNAMORPH_OT_build_cage(JobOperator, Operator):
    """Build only the cage of tetrahedra with the nodes that are held, so that you can look at it before Build Model"""

    bl_idname = "dynamorph.build_cage"
    bl_label = "Build Cage"
    goal = "BUILD_CAGE"


CLASSES = (
    DYNAMORPH_OT_add_soft_skin,
    DYNAMORPH_OT_remove_soft_skin,
    DYNAMORPH_OT_fix,
    DYNAMORPH_OT_reset_setting,
    DYNAMORPH_OT_build_cage,
)
register, unregister = of_classes(CLASSES)
