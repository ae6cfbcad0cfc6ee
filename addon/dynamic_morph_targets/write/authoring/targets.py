# SPDX-License-Identifier: GPL-3.0-or-later
"""What the buttons of the list of targets do to shape keys and poses: blend, copy, pose the armature."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import asdict, replace
from typing import TypeAlias

import bpy
import numpy as np
from mathutils import Matrix

from ...core import engine
from ...core.character import Character, Skeleton
from ...core.errors import SceneError
from ...core.geometry import turned
from ...core.message import Message
from ...core.motion import posing
from ...scene import animation, skinning
from ...scene.character import extract
from ...scene.check import checks, data_checks
from ...scene.motion import rig_motion
from ...scene.plain import plain
from ...scene.properties.target_properties import DynamorphTarget
from ...scene.read import mesh_data
from ...scene.references import KEY_REFERENCE, key_points, rest_skeleton, rig_of
from ..assign import assign
from ..bake.muting import show_target
from ..bake.writer import ensure_basis
from ..reconcile import reconcile
from . import regions

NEAR = 1e-3  # of a channel: what a slider shows
Pose: TypeAlias = tuple[Skeleton, np.ndarray, np.ndarray]  # as returned by `rig_motion.current_pose`
NOTHING = 1e-6  # of the coordinates; smaller differences are round-off, not sculpted


# Shape keys --------------------------------------------------------------------------------------------------------


def new_key(obj: bpy.types.Object, name: str, shape: np.ndarray) -> bpy.types.ShapeKey:
    """Create a shape key, with this name if it is free, that at value 1 adds `shape` (V, 3), local space, to the Basis.
    Raises SceneError.
    """
    checks.check_mesh(obj)
    ensure_basis(obj)
    block = obj.shape_key_add(name=name, from_mix=False)
    set_shape(block, shape)
    block.value = 0.0
    return block


def set_shape(block: bpy.types.ShapeKey, shape: np.ndarray) -> None:
    points = key_points(block.relative_key) + shape
    block.points.foreach_set("co", points.astype(np.float32).ravel())
    block.id_data.update_tag()


def sculpt_anew(block: bpy.types.ShapeKey, shape: np.ndarray) -> None:
    """Make a shape key add `shape` (V, 3), local space, to the Basis, whatever it did before."""
    block.relative_key, block.vertex_group = block.id_data.reference_key, ""
    set_shape(block, shape)


def copy_key(obj: bpy.types.Object, name: str) -> bpy.types.ShapeKey:
    """A copy of a shape key, without its drivers and curves, named "name copy"."""
    block = new_key(obj, f"{name} copy", np.zeros((len(obj.data.vertices), 3)))
    source = obj.data.shape_keys.key_blocks[name]
    block.points.foreach_set("co", key_points(source).ravel())
    for field in ("relative_key", "vertex_group", "slider_min", "slider_max"):
        setattr(block, field, getattr(source, field))
    return block


def blended_shape(obj: bpy.types.Object, local: np.ndarray) -> np.ndarray:
    """The shape (V, 3), local space, of the blended targets in a pose (B, 4, 4); zero without the engine. Raises
    SceneError.
    """
    active = [target for target in obj.dynamorph.targets[1:] if not target.mute]
    if not active or engine.engine_problem():
        return np.zeros((len(obj.data.vertices), 3))
    reconcile(obj)
    return _blend(authored(obj), local, channels_now(obj))


def authored(obj: bpy.types.Object) -> Character:
    """With all its targets, whichever its method simulates. Raises SceneError."""
    return extract.character(obj).with_settings(method="DYNAMIC")


def _blend(character: Character, local: np.ndarray, channels: dict[str, float]) -> np.ndarray:
    """The shape (V, 3), local space, of a character's blended targets in a pose (B, 4, 4), where channels that are not
    named are 0.
    """
    if not character.authored_sets:
        return np.zeros_like(character.vertices)
    values = [[channels.get(name, 0.0) for name in posing.channels(character.targets)]]
    weights = posing.pose_space(character).weights(local[None], values)[0]
    return np.tensordot(weights, [target.shape[character.own_vertices] for target in character.targets], 1)


# Targets -----------------------------------------------------------------------------------------------------------


def eligible(obj: bpy.types.Object) -> list[str]:
    """Names of the shape keys that can become targets."""
    keys, settings = obj.data.shape_keys, obj.dynamorph
    blocks = keys.key_blocks[1:] if keys else []
    references = (*settings.targets[1:], *settings.bake.keys, settings.live.key)
    taken = {reference.name for reference in references}
    return [block.name for block in blocks if block.name not in taken]


def add(obj: bpy.types.Object, block: bpy.types.ShapeKey, after: int | None = None) -> DynamorphTarget:
    """A target for a shape key, selected; at the end of the list, or after the target with that index.

    It has the neutral target's material until the artist changes it.
    """
    settings, keys = obj.dynamorph, obj.data.shape_keys.key_blocks
    target = settings.targets.add()
    target.refer_to(keys, keys.find(block.name))
    start_as(settings.targets[0], target)
    target.auto_region = settings.model.hold == "THICKNESS"  # with pins all share the body, as in the method's source
    settings.active_target_index = len(settings.targets) - 1
    if after is not None:
        move(obj, settings.active_target_index, after + 1)
    return settings.active_target


def add_in_pose(
    obj: bpy.types.Object, name: str, shape: np.ndarray, pose: Pose, sculpted: np.ndarray
) -> DynamorphTarget:
    """A target with a new key of this shape (V, 3), local space, in a pose; the bones that place it follow from what is
    `sculpted` (V, 3). Raises SceneError.
    """
    target = add(obj, new_key(obj, name, shape))
    target.set_pose(*pose)
    take_channel(obj, target)
    choose_bones(obj, target, pose[0], sculpted)
    return target


def move(obj: bpy.types.Object, index: int, wanted: int) -> None:
    """Move a target to another place in the list, and select it there."""
    settings = obj.dynamorph
    order = list(range(len(settings.targets)))
    order.insert(wanted, order.pop(index))
    settings.targets.move(index, wanted)
    settings.active_target_index = wanted
    animation.follow_list(obj, "dynamorph.targets", order)


def remove(obj: bpy.types.Object, index: int) -> None:
    """Remove a target other than the neutral one, and select the one above it."""
    settings = obj.dynamorph
    order = [place for place in range(len(settings.targets)) if place != index]
    settings.targets.remove(index)
    settings.active_target_index = index - 1
    animation.follow_list(obj, "dynamorph.targets", order)


def start_as(source: DynamorphTarget, target: DynamorphTarget) -> None:
    """Give a target the material of another, and the state of its settings."""
    assign(target, asdict(source.material()) | {"frequency": source.frequency, "by_hand": source.by_hand})


def choose_bones(
    obj: bpy.types.Object, target: DynamorphTarget, skeleton: Skeleton, shape: np.ndarray | None = None
) -> None:
    """Choose the bones that place a target: those that are turned in its pose and bend what the shape (V, 3) moves.

    shape: by default its key's; as long as that moves nothing, all turned bones place it. Raises SceneError.
    """
    if shape is None:
        there = target.name in animation.keys_of(obj)
        shape = mesh_data.target_shape(obj, target.name) if there else np.zeros((0, 3))
    neutral, local = obj.dynamorph.targets[0].local(skeleton), target.local(skeleton)
    bones = regions.driver_bones(obj, skeleton, neutral, local, shape, alone=not target.channel)
    target.set_bones(bones, automatic=True)


def copy_settings(source: DynamorphTarget, target: DynamorphTarget) -> None:
    """Copies everything except the shape key, the captured bones' transforms and the bones."""
    assign(target, plain(source, skip=KEY_REFERENCE))


def at_pose_of(
    obj: bpy.types.Object, skeleton: Skeleton, local: np.ndarray, bones: Collection[str], channels: dict[str, float]
) -> DynamorphTarget | None:
    """The target, other than the neutral one, that a pose (B, 4, 4) with these bones, and channels that are not 0,
    cannot be distinguished from.
    """
    for target in obj.dynamorph.targets[1:]:
        used = [name in {*bones, *target.bone_names()} for name in skeleton.names]
        if data_checks.same_pose(target.local(skeleton)[used], local[used]) and _alike(target.reached, channels):
            return target
    return None


def posed_target(obj: bpy.types.Object) -> tuple[Pose, DynamorphTarget | None]:
    """The current pose, and the target that is there already. Raises SceneError if the armature is at rest."""
    skeleton, local, rig_world = rig_motion.current_pose(obj)
    bones = rig_motion.bones_turned(obj, skeleton, obj.dynamorph.targets[0].local(skeleton), local)
    channels = channels_now(obj)
    if not (bones or channels):
        raise SceneError("No bone is turned away from the neutral pose: pose the armature first")
    other = at_pose_of(obj, skeleton, local, bones, channels)
    # Another limb that is turned too may have a target there: by its sculpt it comes into another set.
    if other and obj.dynamorph.model.hold == "THICKNESS" and not set(bones) <= {*other.bone_names()}:
        other = None
    return (skeleton, local, rig_world), other


def channels_now(obj: bpy.types.Object) -> dict[str, float]:
    """Where the channels stand that are away from 0."""
    return {channel.name: channel.value for channel in obj.dynamorph.channels if abs(channel.value) > NEAR}


def _alike(first: dict[str, float], second: dict[str, float]) -> bool:
    return all(abs(first.get(name, 0.0) - second.get(name, 0.0)) <= NEAR for name in first | second)


def take_channel(obj: bpy.types.Object, target: DynamorphTarget) -> None:
    """Let a target be reached where its channel stands, or, without one, the first that is away from 0."""
    now = {name: value for name, value in channels_now(obj).items() if target.channel in ("", name)}
    for name, value in [*now.items()][:1]:
        target.channel, target.reached_at = name, value


# The armature ------------------------------------------------------------------------------------------------------


def pose_rig(rig: bpy.types.Object, skeleton: Skeleton, local: np.ndarray) -> None:
    """Turn the bones of the armature so that, without constraints, they have the local transforms (B, 4, 4)."""
    pose = [Matrix(matrix) for matrix in skeleton.pose(local)]
    for b, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents, strict=True)):
        bone = rig.data.bones[name]
        above = {"parent_matrix": pose[parent], "parent_matrix_local": bone.parent.matrix_local} if bone.parent else {}
        # Blender's own conversion, because a bone may not inherit its parent's rotation or scale.
        rig.pose.bones[name].matrix_basis = bone.convert_local_to_pose(pose[b], bone.matrix_local, invert=True, **above)


def bones_elsewhere(obj: bpy.types.Object, skeleton: Skeleton, local: np.ndarray) -> list[str]:
    """Bones that constraints or drivers keep more than a degree from the local transforms (B, 4, 4)."""
    angles = turned(rig_motion.current_pose(obj)[1], local)
    return [name for name, angle in zip(skeleton.names, angles, strict=True) if angle > np.radians(1.0)]


def selected_bones(rig: bpy.types.Object) -> list[str]:
    # 5.0 moved the selection from the bone to the pose bone.
    return [bone.name for bone in rig.pose.bones if (bone if hasattr(bone, "select") else bone.bone).select]


# Sculpting ---------------------------------------------------------------------------------------------------------


def begin_sculpting(obj: bpy.types.Object, block: bpy.types.ShapeKey, mode: str, is_new: bool = False) -> None:
    """Show the shape key alone, in the current pose, and enter "SCULPT" or "EDIT" mode.

    is_new: the key shows what the other targets do in this pose, and the bones and the region are not chosen yet.
    Blender maps strokes back through the Armature modifier, in Edit Mode if the modifier is shown there. Raises
    SceneError.
    """
    check_can_sculpt(obj)
    if block.mute:
        raise SceneError(
            "Shape key '{name}' is muted and would not show: unmute it, or press Delete Bake", name=block.name
        )
    modifier, remembered = checks.armature_modifier(obj), obj.dynamorph.sculpt
    blocks = obj.data.shape_keys.key_blocks
    remembered.active, remembered.is_new = True, is_new
    remembered.key.refer_to(blocks, blocks.find(block.name))
    remembered.was_posing = bpy.context.mode == "POSE"
    remembered.was_pinned = obj.show_only_shape_key
    remembered.in_editmode, remembered.on_cage = modifier.show_in_editmode, modifier.show_on_cage
    _make_active(obj)
    obj.show_only_shape_key = True
    obj.active_shape_key_index = blocks.find(block.name)
    modifier.show_in_editmode = modifier.show_on_cage = True
    bpy.ops.object.mode_set(mode=mode)


def check_can_sculpt(obj: bpy.types.Object) -> None:
    """Raises SceneError."""
    checks.check_mesh(obj)
    if not obj.visible_get():
        raise SceneError("'{name}' is hidden: show it to sculpt", name=obj.name)


def finish_sculpting(obj: bpy.types.Object) -> None:
    """Leave the mode, and show what was shown before `begin_sculpting`."""
    remembered, rig = obj.dynamorph.sculpt, rig_of(obj)
    _make_active(obj)
    show_as_before(obj)
    if remembered.was_posing and rig and rig.visible_get():
        _make_active(rig)
        bpy.ops.object.mode_set(mode="POSE")


def show_as_before(obj: bpy.types.Object) -> None:
    """Undo what `begin_sculpting` has changed in what is shown, if a target is being sculpted. The mode stays."""
    remembered, modifier = obj.dynamorph.sculpt, skinning.Skinning.of(obj).modifier
    if not remembered.active:
        return
    obj.show_only_shape_key = remembered.was_pinned
    if modifier:
        modifier.show_in_editmode, modifier.show_on_cage = remembered.in_editmode, remembered.on_cage
    remembered.active = False


def learn_from_sculpt(obj: bpy.types.Object) -> None:
    """`learn` of the target that was sculpted. Raises the same."""
    remembered = obj.dynamorph.sculpt
    name, is_new = remembered.key.name, remembered.is_new
    remembered.key.name, remembered.is_new = "", False
    learn(obj, name, is_new)


def learn(obj: bpy.types.Object, name: str, is_new: bool) -> None:
    """Choose the bones and regions of the target `name` from its shape, unless the artist has chosen them, and show it
    in its pose.

    is_new: the shape is all that shows there. What other sets of targets show there is removed from it, because they
    still show it. Raises SceneError, and the exceptions of `engine.expected_errors`.
    """
    target = next((target for target in obj.dynamorph.targets[1:] if target.name == name), None)
    if target is None or name not in animation.keys_of(obj):
        return
    show_target(obj, name)
    skeleton = rest_skeleton(checks.armature_modifier(obj).object.data)
    local, channels = target.local(skeleton), target.reached
    sculpted = mesh_data.target_shape(obj, name)
    if is_new and not (target.mute or engine.engine_problem()):
        sculpted = sculpted - _blend(_with_sets(obj, name, with_set=True), local, channels)
    if target.auto_bones and np.abs(sculpted).max() > NOTHING * np.abs(key_points(animation.keys_of(obj)[name])).max():
        choose_bones(obj, target, skeleton, sculpted)
    regions.update(obj)
    if is_new and target.region and not (target.mute or engine.engine_problem()):
        others = _blend(_with_sets(obj, name, with_set=False), local, channels)
        if others.any():
            set_shape(animation.keys_of(obj)[name], mesh_data.target_shape(obj, name) - others)
            regions.update(obj)


def hide_out_of_pose(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> None:
    """Turn off the sculpt that Finish Sculpting or Go to Pose shows, when the armature has left its pose.

    depsgraph: where it is evaluated.
    """
    name = obj.dynamorph.sculpt.shown.name
    target = name and next((target for target in obj.dynamorph.targets[1:] if target.name == name), None)
    if target and _is_in_pose(obj, target, depsgraph):
        return
    show_target(obj, "")


def _is_in_pose(obj: bpy.types.Object, target: DynamorphTarget, depsgraph: bpy.types.Depsgraph) -> bool:
    try:
        skeleton, local, _ = rig_motion.current_pose(obj, depsgraph)
    except SceneError:  # no armature, or one without a pose that could be captured
        return False
    bones = target.bone_names() or skeleton.names
    used = [name in bones for name in skeleton.names]
    return data_checks.same_pose(target.local(skeleton)[used], local[used]) and _alike(
        target.reached, channels_now(obj)
    )


def _with_sets(obj: bpy.types.Object, name: str, with_set: bool) -> Character:
    """The character without a target and, unless `with_set`, without its whole set."""
    reconcile(obj)
    character, sets = authored(obj), []
    for target_set in character.authored_sets:
        others = tuple(target for target in target_set.targets[1:] if target.name != name)
        if with_set or len(others) == len(target_set.targets) - 1:
            sets.append(replace(target_set, targets=(target_set.targets[0], *others)))
    return replace(character, authored_sets=tuple(sets))


def _make_active(obj: bpy.types.Object) -> None:
    """Make an object active in Object Mode."""
    objects = bpy.context.view_layer.objects
    for other in (objects.active, obj):  # each object may be in a different mode
        objects.active = other
        if other and other.mode != "OBJECT":
            if not bpy.ops.object.mode_set.poll():
                raise SceneError("'{name}' is hidden: show it to leave its mode", name=other.name)
            bpy.ops.object.mode_set(mode="OBJECT")
    obj.select_set(True)


def sculpted_key(obj: bpy.types.Object) -> bpy.types.ShapeKey:
    """The shape key of the selected target. Raises SceneError."""
    target, keys = obj.dynamorph.active_target, obj.data.shape_keys
    block = keys and keys.key_blocks.get(target.name)
    if not block:
        raise SceneError(
            "'{name}': the shape key of target '{target}' is gone: remove the target", name=obj.name, target=target.name
        )
    return block


def capture(obj: bpy.types.Object, target: DynamorphTarget, pose: Pose) -> list[Message]:
    """Store a pose, and where its channel stands. The target is placed by
    those bones that are turned away from the neutral pose and bend the sculpt. Returns warnings.
    """
    skeleton, local, rig_world = pose
    target.set_pose(skeleton, local, rig_world)
    if target == obj.dynamorph.targets[0]:
        return []
    take_channel(obj, target)
    choose_bones(obj, target, skeleton)
    if target.bones or target.channel:
        return []
    text = "'{name}': no bone is turned away from the neutral pose. Pose it, then Capture Pose"
    return [Message(text, name=target.name)]
