# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons that make a mesh a soft skin, put right what is in the way, and prepare its cage."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import bpy
import numpy as np
from bpy.props import EnumProperty
from bpy.types import Operator

from . import checks, extract, feel_operators, heat, jobs, pieces, properties, sinks, targets
from .extract import SceneError
from .feel import FEELS
from .operators import JobOperator, SoftSkinOperator, StartsJob

STEPS = 1000  # of softness that are told apart in a vertex group


class DYNAMORPH_OT_add_soft_skin(StartsJob, Operator):
    """Make the active mesh a soft skin, which is then built and shown in Live, with a hop of its armature; Esc stops"""

    bl_idname = "dynamorph.add_soft_skin"
    bl_label = "Add Soft Skin"
    needs_soft_skin = False
    job = "dynamorph.first_look"

    @classmethod
    def obstacle(cls, context):
        obstacle, obj = super().obstacle(context), properties.mesh_in(context)
        if not obstacle and not checks.armature_modifiers(obj) and not pieces.carried_by(obj):
            return "The mesh needs an Armature modifier with an armature"
        return obstacle

    def apply(self, obj):
        chosen = _body_meant(obj)
        if chosen != obj:
            self.report(
                {"INFO"}, f"'{chosen.name}' becomes the soft skin: it has most of the soft skin on its armature"
            )
        obj = chosen
        if obj.dynamorph.targets:
            raise SceneError(f"'{obj.name}' has a soft skin already")
        in_the_way = extract.first_look(obj)
        rig = properties.rig_of(obj)
        skeleton, rig_world = properties.rest_skeleton(rig.data), extract.world_now(rig)
        if obj.mode != "EDIT":
            targets.ensure_basis(obj)
        target = obj.dynamorph.targets.add()
        target.name = properties.NEUTRAL
        target.set_pose(skeleton, np.tile(np.eye(4), (len(skeleton.names), 1, 1)), rig_world)
        obj.dynamorph.model.hold = "THICKNESS"  # unlike in files from before
        feel_operators.give_feel(obj, FEELS["NATURAL"])
        in_the_way += [text for text in _find_attachments(obj) if text not in in_the_way]
        drawn = [problem.text for problem in (*checks.problems(obj), *checks.notes(obj))]
        obj.dynamorph.model.warnings = "\n".join(text for text in in_the_way if text not in drawn)  # until a build
        for text in in_the_way:
            self.report({"WARNING"}, text)


def _body_meant(obj):
    """The mesh that is to become a soft skin, which is made active, when `obj`, a helmet say, or its armature is."""
    active = bpy.context.object
    if "EDIT" in (obj.mode, active.mode):  # what is edited cannot be read
        return obj
    chosen = pieces.body_for(active if active.type == "ARMATURE" else obj)
    if chosen.type != "MESH":  # none of the armature's can be one
        return obj
    if active == obj != chosen and obj.mode == "OBJECT":
        bpy.context.view_layer.objects.active = chosen
    return chosen


def _find_attachments(obj) -> list[str]:
    """List what belongs to the body of `obj`, in one cage with it. Returns what is in the way of that."""
    obj.dynamorph.model.one_cage = obj.dynamorph.model.hold_head = True
    problem = next(checks.problems(obj), None)
    if problem:  # which is told already
        return []
    try:
        pieces.find(obj)
        extract.character(obj, without_targets=True)
    except SceneError as error:
        return [str(error)]
    return []


# Fixes of checks.Problem -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Fix:
    """label, tooltip: for the artist; apply(obj): puts it right. Raises SceneError."""

    label: str
    tooltip: str
    apply: Callable


def _owned(data):
    """`data`, if changes of it are saved. Raises SceneError."""
    if not data.is_editable:
        raise SceneError(f"{data.bl_rna.name} '{data.name}' is linked, so the change would be lost: make it local")
    return data


def _in_modifier(**values) -> Callable:
    """A fix that sets properties of the Armature modifiers."""

    def apply(obj):
        for modifier in checks.armature_modifiers(obj):
            for name, value in values.items():
                setattr(modifier, name, value)

    return apply


def _in_bones(name: str, value) -> Callable:
    """A fix that sets a property of every bone that skins the mesh."""

    def apply(obj):
        for rig in _rigs(obj):
            _owned(rig.data)
            for bone in checks.deforming_bones(obj, rig):
                setattr(bone, name, value)

    return apply


def _rigs(obj) -> list:
    """The armature objects that skin `obj`."""
    return [modifier.object for modifier in checks.armature_modifiers(obj)]


def _leave_edit_mode(obj):
    objects = bpy.context.view_layer.objects
    active = objects.active
    for edited in (obj, *_rigs(obj)):
        if edited.mode == "EDIT":
            objects.active = edited
            bpy.ops.object.mode_set(mode="OBJECT")
    objects.active = active


def _make_single_user(obj):
    obj.data = obj.data.copy()


def _add_armature_modifier(obj):
    """In the first place: what comes before an Armature modifier must not add vertices."""
    empty = [modifier for modifier in obj.modifiers if modifier.type == "ARMATURE"]
    modifier = empty[0] if empty else obj.modifiers.new("Armature", "ARMATURE")
    modifier.object = checks.armature_for(obj)
    obj.modifiers.move(obj.modifiers.find(modifier.name), 0)


def _move_below(obj):
    *_, armature = checks.armature_modifiers(obj)
    for modifier in reversed(checks.generating_before(obj, armature)):  # each to the place next to it: keeps the order
        obj.modifiers.move(obj.modifiers.find(modifier.name), obj.modifiers.find(armature.name))


def _pose_position(obj):
    for rig in _rigs(obj):
        _owned(rig.data).pose_position = "POSE"


def _enable_armature(obj):
    for rig in _rigs(obj):
        _owned(rig).hide_viewport = False


def _add_basis(obj):
    _owned(obj.data)
    targets.ensure_basis(obj)


def _relative_keys(obj):
    _owned(obj.data.shape_keys).use_relative = True


def _unpin(obj):
    obj.show_only_shape_key = False


FIXES = {
    "LEAVE_EDIT_MODE": Fix("Leave Edit Mode", "Go back to Object Mode", _leave_edit_mode),
    "SINGLE_USER": Fix(
        "Make Mesh Single-User", "Give this object a copy of the mesh; the others keep the one they had",
        _make_single_user,
    ),
    "ADD_ARMATURE": Fix(
        "Add Armature Modifier",
        "Add an Armature modifier with the parent, or the only armature that has bones named like the vertex groups",
        _add_armature_modifier,
    ),
    "MOVE_BELOW": Fix(
        "Move below Armature",
        "Move the modifiers that change the number of vertices below the Armature modifier, where they work on the "
        "posed mesh",
        _move_below,
    ),
    "ENABLE_MODIFIER": Fix(
        "Enable Modifier", "Show the Armature modifier in viewports", _in_modifier(show_viewport=True)
    ),
    "ENVELOPES": Fix(
        "Skin by Vertex Groups", "Turn Bone Envelopes off and Vertex Groups on in the Armature modifier",
        _in_modifier(use_bone_envelopes=False, use_vertex_groups=True),
    ),
    "POSE_POSITION": Fix("Pose Position", "Let the armature show its pose, not its rest position", _pose_position),
    "ENABLE_ARMATURE": Fix("Enable Armature", "Enable the armature in viewports", _enable_armature),
    "ENVELOPE_MULTIPLY": Fix(
        "Turn off Envelope Multiply", "Turn Envelope Multiply off for every bone that deforms the mesh",
        _in_bones("use_envelope_multiply", False),
    ),
    "ADD_BASIS": Fix("Add Basis", "Add the shape key that the others are relative to", _add_basis),
    "RELATIVE_KEYS": Fix("Relative Shape Keys", "Make the shape keys relative to their Basis", _relative_keys),
    "UNPIN": Fix("Show All Shape Keys", "Show the mix of all shape keys, not the active one alone", _unpin),
}  # fmt: skip


class DYNAMORPH_OT_fix(SoftSkinOperator, Operator):
    """Put right what is in the way of a soft skin"""

    bl_idname = "dynamorph.fix"
    bl_label = "Fix"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}  # a search would offer only the first problem
    needs_soft_skin = False

    problem: EnumProperty(
        name="Problem",
        description="What to put right",
        items=[(key, fix.label, fix.tooltip) for key, fix in FIXES.items()],
    )

    @classmethod
    def description(cls, _context, given):
        return FIXES[given.problem].tooltip

    def apply(self, obj):
        if self.problem not in [problem.fix for problem in (*checks.problems(obj), *checks.notes(obj))]:
            raise SceneError(f"'{obj.name}' does not have this problem: {FIXES[self.problem].label} is not needed")
        FIXES[self.problem].apply(obj)


# Cage --------------------------------------------------------------------------------------------------------------


class DYNAMORPH_OT_build_cage(JobOperator, Operator):
    """Build only the cage of tetrahedra and what the bones hold of it, to look at; Build Model goes on from there"""

    bl_idname = "dynamorph.build_cage"
    bl_label = "Build Cage"
    goal = "BUILD_CAGE"


@dataclass(frozen=True)
class Painted:
    """A vertex group that the artist paints. field: of DynamorphSettings; start: weight of a new group everywhere."""

    name: str
    field: str
    start: float


PAINTED = {"SOFT": Painted("Soft", "soft_group", 1.0), "STIFFNESS": Painted("Stiffness", "stiffness_group", 0.0)}


def is_painting(obj, which: str) -> bool:
    """Whether this vertex group of `obj` is the one being painted."""
    active = obj.vertex_groups.active
    return (
        obj.mode == "WEIGHT_PAINT"
        and active is not None
        and active.name == getattr(obj.dynamorph, PAINTED[which].field)
    )


class DYNAMORPH_OT_paint_group(SoftSkinOperator, Operator):
    """Paint the vertex group in Weight Paint, made if there is none; press again to go back to the mode before"""

    bl_idname = "dynamorph.paint_group"
    bl_label = "Paint Soft Skin Group"

    which: EnumProperty(
        name="Which",
        description="What the painted weights say",
        items=[(key, painted.name, f"Where the skin is painted {painted.name}") for key, painted in PAINTED.items()],
    )

    def apply(self, obj):
        if is_painting(obj, self.which):
            self._leave(obj)
        else:
            self._enter(obj)

    def _enter(self, obj):
        if not obj.visible_get():
            raise SceneError(f"'{obj.name}' is hidden: show it to paint on it")
        _owned(obj.data)
        active, display = bpy.context.object, bpy.context.window_manager.dynamorph
        if obj.mode != "WEIGHT_PAINT":
            display.posed = active.name if active.mode == "POSE" else ""
            bpy.context.view_layer.objects.active = obj
            obj.select_set(True)
            bpy.ops.object.mode_set(mode="WEIGHT_PAINT", toggle=True)  # remembers the mesh's own mode
        settings, field = obj.dynamorph, PAINTED[self.which].field
        name = getattr(settings, field) or PAINTED[self.which].name
        known = name in obj.vertex_groups
        if not known:
            _write_groups(name, self._start(obj))
        weights, group = extract.group_weights(obj, [name])[:, 0], obj.vertex_groups[name]
        if getattr(settings, field) != group.name:
            setattr(settings, field, group.name)
        obj.vertex_groups.active_index = group.index
        if len(weights) and (not known or np.ptp(weights) < 1e-3):
            _set_brush(weights)

    def _start(self, obj) -> dict[int, np.ndarray]:
        """Weights (V,) of a new group, by session_uid of each mesh that gets one. Softness begins with what the hold by
        thickness comes to: all 1 would say that thin parts are soft.
        """
        with suppress(*jobs.expected_errors()):
            if self.which == "SOFT" and obj.dynamorph.model.hold == "THICKNESS":
                return _softness_of_hold(obj)
        return {obj.session_uid: np.full(len(obj.data.vertices), PAINTED[self.which].start)}

    def _leave(self, obj):
        display, objects = bpy.context.window_manager.dynamorph, bpy.context.view_layer.objects
        bpy.ops.object.mode_set(mode="WEIGHT_PAINT", toggle=True)
        posed, display.posed = objects.get(display.posed), ""
        if posed:
            objects.active = posed
            bpy.ops.object.mode_set(mode="POSE")
        if obj.dynamorph.model.content_id:
            jobs.show_stale(obj)


def _softness_of_hold(obj) -> dict[int, np.ndarray]:
    """How soft the model takes the vertices (V,) of each mesh in its cage to be, by session_uid. Raises SceneError."""
    return {uid: 1.0 - held for uid, held in heat.holds(obj).items()}


def _write_groups(name: str, weights: dict[int, np.ndarray]):
    """As `_write_group`, for each mesh by session_uid."""
    for uid, values in weights.items():
        _write_group(jobs.find(uid), name, values)


def _write_group(obj, name: str, weights: np.ndarray):
    """Let the vertex group of this name, made if there is none, have weights (V,), to a thousandth."""
    group = obj.vertex_groups.get(name) or obj.vertex_groups.new(name=name)
    steps = np.round(weights * STEPS).astype(int)
    for step in np.unique(steps):
        group.add(np.flatnonzero(steps == step).tolist(), step / STEPS, "REPLACE")


def _set_brush(weights: np.ndarray):
    """Let the first stroke show: the brush paints 0 where most of the weights (V,) are over a half, else 1."""
    tools = bpy.context.scene.tool_settings
    shared = getattr(tools.weight_paint, "unified_paint_settings", None) or tools.unified_paint_settings
    shared.weight = 0.0 if np.median(weights) > 0.5 else 1.0
    brush = tools.weight_paint.brush
    if brush and brush.is_editable:
        brush.weight = shared.weight


class DYNAMORPH_OT_hold_to_group(SoftSkinOperator, Operator):
    """Replace the Soft vertex group, of all meshes in the cage, by how soft the model takes each vertex to be"""

    bl_idname = "dynamorph.hold_to_group"
    bl_label = "Softness from Hold"

    @classmethod
    def obstacle(cls, context):
        obstacle = super().obstacle(context)
        if not obstacle and not properties.mesh_in(context).dynamorph.model.content_id:
            return "Press Build Model first: it computes the hold"
        return obstacle

    def apply(self, obj):
        sinks.check_not_edited(obj)
        _owned(obj.data)
        name = obj.dynamorph.soft_group or PAINTED["SOFT"].name
        _write_groups(name, _softness_of_hold(obj))
        obj.dynamorph.soft_group = name
        obj.vertex_groups.active_index = obj.vertex_groups[name].index
        jobs.show_stale(obj)


CLASSES = (
    DYNAMORPH_OT_add_soft_skin,
    DYNAMORPH_OT_fix,
    DYNAMORPH_OT_build_cage,
    DYNAMORPH_OT_paint_group,
    DYNAMORPH_OT_hold_to_group,
)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
