# SPDX-License-Identifier: GPL-3.0-or-later
"""The list of targets: they are suggested by drivers, sculpted in their pose, mirrored, moved, copied, and posed on the
rig.
"""

import types
from math import pi, radians

import bpy
import numpy as np
import pytest
import real_character
import scenes
from bl_ext.user_default.dynamic_morph_targets.core import engine, errors, geometry
from bl_ext.user_default.dynamic_morph_targets.scene import plain as scene_plain
from bl_ext.user_default.dynamic_morph_targets.scene import references
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.check import checks
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.ui.panels.targets import draw_target_list
from bl_ext.user_default.dynamic_morph_targets.write.authoring import controls, mirror
from bl_ext.user_default.dynamic_morph_targets.write.authoring import targets as authoring_targets
from bl_ext.user_default.dynamic_morph_targets.write.bake import writer
from builders import (
    activate,
    add_key,
    evaluated_points,
    hand_made_bake,
    make_mesh,
    make_rig,
    refused,
    rig_of,
    skinning_of,
)
from layout import Layout, drawn
from mathutils import Matrix

OPS = bpy.ops.dynamorph


def key_points(obj, name):
    return references.key_points(obj.data.shape_keys.key_blocks[name])


def shape(obj, name):
    return mesh_data.target_shape(obj, name)


def angles(obj, target):
    """How far each bone is turned in a target's pose, in degrees, by name; bones that are not turned are left out."""
    skeleton = references.rest_skeleton(rig_of(obj).data)
    local = target.local(skeleton)
    turned = np.degrees(geometry.turned(local, np.tile(np.eye(4), (len(local), 1, 1))))
    return {name: angle for name, angle in zip(skeleton.names, turned, strict=True) if angle > 0.01}


def names(obj):
    return [target.name for target in obj.dynamorph.targets]


def pose_by_hand(obj, **turned):
    """Bones turned about their x axis, in radians, without any animation."""
    rig = rig_of(obj)
    rig.animation_data_clear()
    for bone in rig.pose.bones:
        bone.rotation_euler.x = turned.get(bone.name, 0.0)
    bpy.context.view_layer.update()
    return rig


def pose_mode(obj):
    activate(rig_of(obj))
    bpy.ops.object.mode_set(mode="POSE")


# Suggest from Drivers ----------------------------------------------------------------------------------------------


def drive(obj, key, expression, **variables):
    """A driver on a key's value. Each variable: ("ROT_X", bone), with a space, ("DIFF", bone, bone) or a path."""
    driver = obj.data.shape_keys.key_blocks[key].driver_add("value").driver
    driver.expression = expression
    rig = rig_of(obj)
    for name, read in variables.items():
        variable = driver.variables.new()
        variable.name = name
        if isinstance(read, str):
            variable.targets[0].id, variable.targets[0].data_path = rig, read
            continue
        kind, bone, *more = read
        variable.type = "ROTATION_DIFF" if kind == "DIFF" else "TRANSFORMS"
        for target in variable.targets:
            target.id, target.bone_target = rig, bone
        if kind == "DIFF":
            variable.targets[1].bone_target = more[0]
        else:
            variable.targets[0].transform_type = kind
            variable.targets[0].transform_space = more[0] if more else "LOCAL_SPACE"
    return driver


def channels(rig):
    fields = controls.CHANNELS
    return [[tuple(getattr(bone, field)) for field in fields] for bone in rig.pose.bones]


@pytest.mark.parametrize(
    "expression, variables, turned",
    [
        ("a / 1.2", {"a": ("ROT_X", "lower")}, {"lower": 1.2}),
        ("-a / 1.2", {"a": ("ROT_Z", "lower")}, {"lower": 1.2}),
        ("a / 1.2", {"a": 'pose.bones["lower"].rotation_euler[1]'}, {"lower": 1.2}),
        ("a / 1.2", {"a": 'pose.bones["lower"].rotation_euler.y'}, {"lower": 1.2}),
        ("-a / 1.2", {"a": ("ROT_Z", "lower", "WORLD_SPACE")}, {"lower": 1.2}),
        ("a - 1", {"a": ("DIFF", "upper", "lower")}, {"lower": 2.0}),
        ("sin(a)", {"a": ("ROT_X", "lower")}, {"lower": pi / 2}),
        ("a * b * 4 / pi / pi", {"a": ("ROT_X", "upper"), "b": ("ROT_X", "lower")}, {"upper": pi / 2, "lower": pi / 2}),
        ("min(a, -b / 2)", {"a": ("ROT_X", "upper"), "b": ("ROT_Z", "lower")}, {"upper": 1.0, "lower": 2.0}),
        ("(min(a, 1) + min(b, 1)) / 2", {"a": ("ROT_X", "upper"), "b": ("ROT_X", "lower")}, {"upper": 1, "lower": 1}),
        ("a + b", {"a": ("ROT_X", "upper"), "b": ("ROT_X", "lower")}, {"upper": 1.0}),
        ("0.7 * (1 - abs(a - 1))", {"a": ("ROT_X", "lower")}, {"lower": 1.0}),
    ],
)
def test_a_driver_suggests_bones_and_pose(scene, arm, expression, variables, turned):
    OPS.add_soft_skin()
    scene.frame_set(7)
    drive(arm, "flexed", expression, **variables)
    rig, block = rig_of(arm), arm.data.shape_keys.key_blocks["flexed"]
    bpy.context.view_layer.update()
    before = channels(rig), block.value, rig.animation_data.action, len(bpy.data.scenes), len(bpy.data.objects)
    assert OPS.suggest_targets() == {"FINISHED"}
    bpy.context.view_layer.update()
    after = channels(rig), block.value, rig.animation_data.action, len(bpy.data.scenes), len(bpy.data.objects)
    assert before == after
    target = arm.dynamorph.active_target
    assert target.name == "flexed" and target.bone_names() == tuple(turned)
    assert angles(arm, target) == pytest.approx({bone: np.degrees(angle) for bone, angle in turned.items()}, abs=2.6)
    OPS.go_to_pose()
    assert block.value > 0.998 * (0.7 if "0.7" in expression else 1.0)


def test_a_driver_by_its_curve(scene, arm):
    """The F-curve of a driver may be drawn by hand: here it is on from 40 to 60 degrees only."""
    OPS.add_soft_skin()
    drive(arm, "smile", "a", a=("ROT_X", "lower"))
    curve = arm.data.shape_keys.animation_data.drivers[0]
    for modifier in list(curve.modifiers):
        curve.modifiers.remove(modifier)
    for degrees, value in ((0, 0), (30, 0), (40, 1), (60, 1), (70, 0)):
        curve.keyframe_points.insert(radians(degrees), value).interpolation = "LINEAR"
    OPS.suggest_targets()
    assert angles(arm, arm.dynamorph.active_target) == pytest.approx({"lower": 40.0}, abs=0.1)


def chained(obj, *owners):
    """Property by property: the first is driven by a bone, each other by the one before, the key by the last."""
    read = None
    for owner, path in owners:
        if path.startswith("["):
            owner[path[2:-2]] = 0.0
        elif path.startswith("pose"):
            rig_of(obj).pose.bones["upper"]["bend"] = 0.0
        driver = owner.driver_add(path).driver
        variable = driver.variables.new()
        variable.name, driver.expression = "a", "a"
        follow(obj, variable, read)
        read = owner, path
    driver = drive(obj, "smile", "a / 1.2")
    variable = driver.variables.new()
    variable.name = "a"
    follow(obj, variable, read)


def follow(obj, variable, read):
    target = variable.targets[0]
    if read is None:
        variable.type, target.id, target.bone_target = "TRANSFORMS", rig_of(obj), "lower"
        target.transform_type, target.transform_space = "ROT_X", "LOCAL_SPACE"
    else:
        target.id_type, target.id, target.data_path = read[0].id_type, *read


@pytest.mark.parametrize("steps", [["rig"], ["data"], ["bone"], ["other"], ["key"], ["data", "rig"], ["key", "other"]])
def test_drivers_are_followed_through_properties(scene, arm, steps):
    OPS.add_soft_skin()
    other = bpy.data.objects.new("Other", None)
    scene.collection.objects.link(other)
    rig = rig_of(arm)
    owners = {
        "rig": (rig, '["bend"]'), "data": (rig.data, '["bend"]'), "bone": (rig, 'pose.bones["upper"]["bend"]'),
        "other": (other, '["bend"]'), "key": (arm.data.shape_keys, 'key_blocks["flexed"].value'),
    }  # fmt: skip
    chained(arm, *(owners[step] for step in steps))
    if "key" in steps:
        arm.data.shape_keys.key_blocks["flexed"].slider_max = 3.0
    OPS.suggest_targets()
    target = next(each for each in arm.dynamorph.targets if each.name == "smile")
    assert angles(arm, target) == pytest.approx({"lower": np.degrees(1.2)}, abs=2.6)


def placed_by_driver(_arm, rig, other):
    driver = other.driver_add("location", 0).driver
    variable = driver.variables.new()
    variable.name, driver.expression = "a", "a"
    follow(_arm, variable, None)
    return other, ""


def on_the_bone(_arm, rig, other):
    other.parent, other.parent_type, other.parent_bone = rig, "BONE", "lower"
    return other, ""


def copied(_arm, rig, other):
    limb = rig.copy()
    bpy.context.scene.collection.objects.link(limb)
    limb.animation_data_clear()
    copy = limb.pose.bones["lower"].constraints.new("COPY_ROTATION")
    copy.target, copy.subtarget = rig, "lower"
    return limb, "lower"


@pytest.mark.parametrize("place", [placed_by_driver, on_the_bone, copied])
def test_drivers_are_followed_through_what_bones_place(scene, arm, place):
    OPS.add_soft_skin()
    other, rig = bpy.data.objects.new("Other", None), rig_of(arm)
    scene.collection.objects.link(other)
    driver = drive(arm, "smile", f"abs(a - {pi / 2 if place is on_the_bone else 0.0}) / 1.2")
    variable = driver.variables.new()
    variable.name, variable.type = "a", "TRANSFORMS"
    target = variable.targets[0]
    target.id, target.bone_target = place(arm, rig, other)
    target.transform_type = "LOC_X" if place is placed_by_driver else "ROT_X"
    target.transform_space = "WORLD_SPACE" if place is on_the_bone else "LOCAL_SPACE"
    OPS.suggest_targets()
    assert next(each for each in arm.dynamorph.targets if each.name == "smile").bone_names() == ("lower",)


def test_drivers_in_a_circle_end(arm):
    OPS.add_soft_skin()
    rig = rig_of(arm)
    rig["one"] = rig["two"] = 0.0
    for path, read in (('["one"]', '["two"]'), ('["two"]', '["one"]')):
        variable = rig.driver_add(path).driver.variables.new()
        follow(arm, variable, (rig, read))
    drive(arm, "smile", "a", a='["one"]')
    refused(OPS.suggest_targets, "no shape key, besides targets, whose driver reads bones of 'Arm Rig'")


def test_what_drivers_do_not_suggest(arm, capfd):
    OPS.add_soft_skin()
    refused(OPS.suggest_targets, "no shape key, besides targets, whose driver reads bones of 'Arm Rig'")
    drive(arm, "smile", "0.2 * sin(a)", a=("ROT_X", "lower"))
    refused(OPS.suggest_targets, "Keys skipped: 'smile': its driver never exceeds 0.2")
    drive(arm, "flexed", "a", a=("ROT_X", "lower"))
    for name, expression in (("late", "a * a"), ("always", "1 + a * a")):
        add_key(arm, name, 0.0)
        drive(arm, name, expression, a=("ROT_X", "lower"))
    OPS.suggest_targets()
    assert names(arm) == ["Neutral", "flexed"]
    messages = capfd.readouterr().out
    assert "Targets added: flexed; Keys skipped: " in messages and "'late': it has the pose of 'flexed'" in messages
    assert "'always': its driver turns it on in the neutral pose already" in messages


def test_a_failure_puts_the_armature_back(arm, monkeypatch):
    OPS.add_soft_skin()
    drive(arm, "flexed", "a", a=("ROT_X", "lower"))
    before = channels(rig_of(arm)), len(bpy.data.scenes)
    current_pose, turned = rig_motion.current_pose, []

    def broken(obj, depsgraph=None):
        if depsgraph is None:  # as the artist sees it, before bones are turned
            return current_pose(obj)
        turned.append(channels(rig_of(arm)))
        raise errors.SceneError("broken")

    monkeypatch.setattr(rig_motion, "current_pose", broken)
    refused(OPS.suggest_targets, "broken")
    assert turned and turned[0] != before[0]
    assert (channels(rig_of(arm)), len(bpy.data.scenes)) == before and names(arm) == ["Neutral"]


@pytest.mark.skipif(not real_character.CHARACTER.exists(), reason="needs ../shared/assets/mh_male_53bones.blend")
def test_a_real_character_s_drivers(addon):
    bpy.ops.wm.open_mainfile(filepath=str(real_character.CHARACTER))
    body, rig = bpy.data.objects["Body"], bpy.data.objects["Rig"]
    activate(body)
    OPS.add_soft_skin()
    before = channels(rig)
    OPS.suggest_targets()
    assert channels(rig) == before
    found = {target.name: target for target in body.dynamorph.targets}
    for key, (bone, degrees) in real_character.DRIVEN.items():
        assert found[key].bone_names() == (bone,)
        assert angles(body, found[key]) == pytest.approx({bone: abs(degrees)}, abs=20.0)


# New from Pose, Sculpt ---------------------------------------------------------------------------------------------


def test_a_new_target_starts_as_the_targets_look_there(soft_arm):
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    pose_by_hand(soft_arm, lower=pi / 4)
    OPS.new_from_pose(key="half")
    block = soft_arm.data.shape_keys.key_blocks["half"]
    assert shape(soft_arm, "half") == pytest.approx(0.5 * shape(soft_arm, "flexed"), abs=1e-6)
    assert (block.value, block.mute, block.relative_key.name) == (0.0, False, "Basis")
    target = soft_arm.dynamorph.active_target
    assert target.name == "half" and target.bone_names() == ("lower",)
    assert angles(soft_arm, target) == pytest.approx({"lower": 45.0}, abs=0.01)
    assert soft_arm.mode == "SCULPT" and soft_arm.show_only_shape_key and soft_arm.active_shape_key == block
    assert extract.character(soft_arm).targets[2].name == "half"


def test_without_the_engine_a_new_target_starts_as_the_basis(soft_arm, monkeypatch):
    monkeypatch.setattr(engine, "engine_problem", lambda: "no wheel")
    pose_by_hand(soft_arm, upper=1.0)
    OPS.new_from_pose(mode="EDIT")
    OPS.finish_sculpt()
    assert soft_arm.dynamorph.active_target.name == "Pose 1" and not shape(soft_arm, "Pose 1").any()
    pose_by_hand(soft_arm, upper=-1.0)
    OPS.new_from_pose(mode="EDIT")
    assert names(soft_arm) == ["Neutral", "flexed", "Pose 1", "Pose 2"]


def test_edits_in_the_pose_land_in_bind_space(soft_arm):
    """A vertex that is moved up in the posed mesh stays moved up there, so the shape key stores the displacement turned
    back.
    """
    pose_by_hand(soft_arm, lower=pi / 3)
    soft_arm.show_only_shape_key = True
    OPS.new_from_pose(key="up", mode="EDIT")
    OPS.finish_sculpt()
    before, key_before = evaluated_points(soft_arm), shape(soft_arm, "up")
    OPS.sculpt_target(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.transform.translate(value=(0.0, 0.0, 0.1))
    assert OPS.finish_sculpt() == {"FINISHED"}
    assert evaluated_points(soft_arm) - before == pytest.approx(np.tile([0.0, 0.0, 0.1], (len(before), 1)), abs=1e-5)
    tip = evaluated_points(soft_arm)[:, 2].argmax()
    assert not np.allclose((shape(soft_arm, "up") - key_before)[tip], (0.0, 0.0, 0.1), atol=0.02)
    assert not shape(soft_arm, "flexed")[tip].any()


@pytest.mark.parametrize("mode", ["SCULPT", "EDIT"])
@pytest.mark.parametrize("pinned", [False, True])
def test_finish_puts_back_what_was_shown(soft_arm, mode, pinned):
    rig = pose_by_hand(soft_arm, lower=0.7)
    modifier = soft_arm.modifiers["Armature"]
    soft_arm.show_only_shape_key, modifier.show_on_cage = pinned, pinned
    pose_mode(soft_arm)
    OPS.new_from_pose(mode=mode)
    assert bpy.context.object == soft_arm and soft_arm.mode == mode and rig.mode == "OBJECT"
    assert soft_arm.show_only_shape_key and "dynamorph.finish_sculpt" in drawn(soft_arm)
    assert not list(checks.notes(skinning_of(soft_arm)))  # there is no advice to end what the button has begun
    refused(OPS.new_from_pose, "Press Finish Sculpting first")
    OPS.finish_sculpt()
    assert bpy.context.object == rig and rig.mode == "POSE" and soft_arm.mode == "OBJECT"
    assert (soft_arm.show_only_shape_key, modifier.show_in_editmode, modifier.show_on_cage) == (pinned, False, pinned)
    refused(OPS.finish_sculpt, "No target is being sculpted")


@pytest.mark.parametrize("pinned", [False, True])
def test_removing_a_soft_skin_ends_its_sculpting(soft_arm, pinned):
    """There is no button then that would show all shape keys again."""
    modifier = soft_arm.modifiers["Armature"]
    soft_arm.show_only_shape_key, modifier.show_on_cage = pinned, pinned
    OPS.sculpt_target()
    OPS.remove_soft_skin()
    assert (soft_arm.show_only_shape_key, modifier.show_in_editmode, modifier.show_on_cage) == (pinned, False, pinned)
    assert not soft_arm.dynamorph.sculpt.active


def test_finish_of_a_hidden_mesh(soft_arm):
    OPS.sculpt_target()
    soft_arm.hide_viewport = True
    refused(OPS.finish_sculpt, "'Arm' is hidden: show it")
    soft_arm.hide_viewport = False
    assert OPS.finish_sculpt() == {"FINISHED"} and soft_arm.mode == "OBJECT"


def test_finish_after_the_artist_left_by_hand(soft_arm):
    pose_by_hand(soft_arm, lower=0.7)
    pose_mode(soft_arm)
    OPS.new_from_pose()
    bpy.ops.object.mode_set(mode="OBJECT")
    assert [problem.fix for problem in checks.notes(skinning_of(soft_arm))] == ["UNPIN"]
    pose_mode(soft_arm)
    OPS.finish_sculpt()
    assert rig_of(soft_arm).mode == "POSE" and not soft_arm.show_only_shape_key


def test_a_new_sculpt_shows_in_its_pose_beside_a_bake(soft_arm):
    """The bake was made without it, and mutes the targets that it contains."""
    writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    pose_by_hand(soft_arm, lower=0.7)
    OPS.new_from_pose(key="up")
    OPS.finish_sculpt()
    keys = soft_arm.data.shape_keys.key_blocks
    assert keys["up"].value == 1.0 and not keys["up"].mute and keys["flexed"].mute


def test_sculpting_a_target_again(soft_arm):
    pose_by_hand(soft_arm)
    soft_arm.dynamorph.active_target_index = 1
    OPS.sculpt_target()
    assert soft_arm.mode == "SCULPT" and soft_arm.active_shape_key.name == "flexed"
    assert rig_of(soft_arm).pose.bones["lower"].rotation_euler.x == pytest.approx(pi / 2)
    OPS.finish_sculpt()
    activate(soft_arm)
    bpy.ops.object.mode_set(mode="EDIT")
    for operator in (OPS.sculpt_target, OPS.duplicate_target):
        refused(operator, "'Arm' is in Edit Mode")
    bpy.ops.object.mode_set(mode="OBJECT")
    soft_arm.data.shape_keys.key_blocks["flexed"].mute = True
    refused(OPS.sculpt_target, "'flexed' is muted and would not show")
    soft_arm.hide_set(True)
    refused(OPS.sculpt_target, "'Arm' is hidden")


def test_no_new_target_where_there_can_be_none(soft_arm):
    pose_by_hand(soft_arm)
    refused(OPS.new_from_pose, "No bone is turned away")
    pose_by_hand(soft_arm, lower=pi / 2)
    refused(OPS.new_from_pose, "in the pose of 'flexed'")
    assert soft_arm.mode == "OBJECT" and len(soft_arm.data.shape_keys.key_blocks) == 3


# Go to Pose --------------------------------------------------------------------------------------------------------


def test_go_to_pose_and_back(soft_arm):
    rig = pose_by_hand(soft_arm, upper=0.3)
    soft_arm.dynamorph.active_target_index = 1
    pose_mode(soft_arm)
    bpy.ops.ed.undo_push(message="before")
    OPS.go_to_pose()
    bpy.ops.ed.undo_push(message="posed")
    assert [bone.rotation_euler.x for bone in rig.pose.bones] == pytest.approx([0.0, pi / 2], abs=1e-6)
    bpy.ops.ed.undo()
    rig = bpy.data.objects["Arm Rig"]
    assert [bone.rotation_euler.x for bone in rig.pose.bones] == pytest.approx([0.3, 0.0], abs=1e-6)
    bpy.data.objects["Arm"].dynamorph.active_target_index = 0
    OPS.go_to_pose()
    assert all(bone.matrix_basis == Matrix() for bone in rig.pose.bones)


def test_a_pose_of_bones_that_inherit_otherwise(soft_arm):
    """The captured pose comes back where a bone takes neither rotation nor scale from its parent."""
    rig = pose_by_hand(soft_arm, upper=0.8, lower=-0.5)
    rig.data.bones["lower"].use_inherit_rotation = False
    rig.data.bones["lower"].inherit_scale = "NONE"
    rig.pose.bones["upper"].scale = (1.1, 1.3, 1.0)
    rig.pose.bones["upper"].location = (0.1, 0.2, 0.3)
    bpy.context.view_layer.update()
    soft_arm.dynamorph.active_target_index = 1
    OPS.capture_pose()
    captured = rig_motion.current_pose(soft_arm)[1]
    pose_by_hand(soft_arm)
    rig.pose.bones["upper"].matrix_basis = Matrix()
    OPS.go_to_pose()
    assert rig_motion.current_pose(soft_arm)[1] == pytest.approx(captured, abs=1e-5)


def test_go_to_pose_names_bones_that_stay_elsewhere(soft_arm, capfd):
    rig = pose_by_hand(soft_arm)
    limit = rig.pose.bones["lower"].constraints.new("LIMIT_ROTATION")
    limit.owner_space, limit.use_limit_x, limit.max_x = "LOCAL", True, 1.0
    soft_arm.dynamorph.active_target_index = 1
    OPS.go_to_pose()
    assert "Constraints or drivers keep bones out of this pose: lower" in capfd.readouterr().out


# Mirror ------------------------------------------------------------------------------------------------------------


def make_two_arms(scene):
    """A bar along x with two arms of two bones each, whose rolls differ; weights and keys are alike."""
    rig = make_rig(scene, "Arms Rig", bones=0)
    activate(rig)
    bpy.ops.object.mode_set(mode="EDIT")
    for side, sign in (("L", 1.0), ("R", -1.0)):
        parent = None
        for i, part_name in enumerate(("upper", "lower")):
            bone = rig.data.edit_bones.new(f"{part_name}.{side}")
            bone.head, bone.tail = (sign * i, 0, 0), (sign * (i + 1), 0.1, 0)
            bone.roll, bone.parent, parent = (0.4 * (i + 1) if sign > 0 else 1.3), parent, bone
    bpy.ops.object.mode_set(mode="OBJECT")
    vertices, faces = scenes.tube(rings=33, length=4.0)
    vertices = (vertices - [0.0, 0.0, 2.0]) @ np.array([[0, 0, 1], [0, 1, 0], [1, 0, 0]])
    obj = make_mesh(scene, "Arms", vertices, faces)
    obj.shape_key_add(name="Basis", from_mix=False)
    reach = np.abs(vertices[:, 0])
    for bone in rig.data.bones:
        at = np.clip(reach, 0, 1) if bone.name.startswith("upper") else np.clip(reach - 1, 0, 1)
        mine = np.where((vertices[:, 0] > 0) == bone.name.endswith("L"), at, 0.0)
        group = obj.vertex_groups.new(name=bone.name)
        for index in np.flatnonzero(mine):
            group.add([int(index)], float(mine[index]), "REPLACE")
    obj.modifiers.new("Armature", "ARMATURE").object = rig
    x = vertices[:, 0]
    bump = np.exp(-(((x - 0.8) / 0.4) ** 2))[:, None] * (0.2 + vertices[:, 1:2]) * [0.1, 0.3, 0.2] * (x > 0)[:, None]
    add_key(obj, "flexed.L", bump)
    activate(obj)
    return obj


@pytest.fixture
def arms(scene):
    """Two arms; the left one has a target."""
    obj = make_two_arms(scene)
    OPS.add_soft_skin()
    rig = rig_of(obj)
    rig.pose.bones["upper.L"].rotation_mode = "QUATERNION"
    rig.pose.bones["upper.L"].rotation_quaternion = (0.9, 0.1, 0.2, -0.3)
    rig.pose.bones["lower.L"].rotation_mode = "XYZ"
    rig.pose.bones["lower.L"].rotation_euler = (0.3, -0.2, 0.9)
    bpy.context.view_layer.update()
    OPS.add_target(key="flexed.L")
    obj.dynamorph.active_target.stiffness = 7e4
    return obj


def shown(obj, key):
    """The evaluated points (V, 3) with one key on."""
    for block in obj.data.shape_keys.key_blocks[1:]:
        block.value = float(block.name == key)
    return evaluated_points(obj)


def test_blender_shows_the_mirror_image(arms):
    partners = mirror.mirror_partners(key_points(arms, "Basis"))
    assert (partners[partners] == np.arange(len(partners))).all()
    left = shown(arms, "flexed.L")
    assert OPS.mirror_target() == {"FINISHED"}
    assert names(arms) == ["Neutral", "flexed.L", "flexed.R"]
    target = arms.dynamorph.active_target
    assert target.bone_names() == ("upper.R", "lower.R") and target.stiffness == 7e4
    OPS.go_to_pose()
    assert shown(arms, "flexed.R") == pytest.approx(left[partners] * [-1, 1, 1], abs=1e-5)
    assert np.ptp(left - key_points(arms, "Basis"), axis=0).max() > 0.5


def test_mirrored_twice_is_the_original(arms):
    skeleton = references.rest_skeleton(rig_of(arms).data)
    before = arms.dynamorph.targets[1].local(skeleton), shape(arms, "flexed.L")
    OPS.mirror_target()
    arms.dynamorph.targets[1].stiffness = 1.0
    arms.data.shape_keys.key_blocks["flexed.L"].points[0].co = (9, 9, 9)
    OPS.mirror_target()
    assert arms.dynamorph.active_target_index == 1 and len(arms.dynamorph.targets) == 3
    assert arms.dynamorph.targets[1].local(skeleton) == pytest.approx(before[0], abs=1e-5)
    assert arms.dynamorph.targets[1].stiffness == 7e4
    assert np.abs(shape(arms, "flexed.L")[0]).max() > 5  # used as it is
    arms.dynamorph.active_target_index = 2
    OPS.mirror_target(overwrite=True)
    assert shape(arms, "flexed.L") == pytest.approx(before[1], abs=1e-6)
    assert len(arms.data.shape_keys.key_blocks) == 3


def test_gravity_is_mirrored_with_the_armature(arms):
    """The mirrored armature leans the other way than the one whose pose was captured: its gravity is mirrored."""
    rig_of(arms).rotation_euler = (0.3, 0.5, -0.2)
    bpy.context.view_layer.update()
    OPS.capture_pose()
    OPS.mirror_target()
    source, target = (np.array(t.rig_world).reshape(4, 4)[:3, :3] for t in arms.dynamorph.targets[1:])
    down = np.array([0.0, 0.0, -1.0])
    assert target.T @ down == pytest.approx([-1, 1, 1] * (source.T @ down), abs=1e-6)
    assert np.linalg.det(target) == pytest.approx(1.0, abs=1e-5)


def test_a_region_is_mirrored_where_it_can_be(arms, capfd):
    arms.vertex_groups.new(name="Arm.L")
    arms.dynamorph.active_target.region = "Arm.L"
    OPS.mirror_target()
    assert arms.dynamorph.active_target.region == "" and "no vertex group 'Arm.R'" in capfd.readouterr().out
    arms.vertex_groups.new(name="Arm.R")
    arms.dynamorph.active_target_index = 1
    OPS.mirror_target()
    assert arms.dynamorph.active_target.region == "Arm.R"


def test_what_has_no_mirror_image(arms, capfd):
    basis = arms.data.shape_keys.reference_key
    basis.points[0].co.x += 0.05
    OPS.mirror_target()
    assert "vertices have no mirror image and stay as in the Basis: 0, " in capfd.readouterr().out
    arms.dynamorph.active_target_index = 1
    points = key_points(arms, "Basis")
    points[:, 0] += 5.0
    basis.points.foreach_set("co", points.ravel())
    refused(OPS.mirror_target, "'Arms' is not symmetric about its X axis", overwrite=True)
    rig_of(arms).data.bones["upper.R"].name = "other"
    refused(OPS.mirror_target, "Bone 'upper.R' is missing")
    arms.data.shape_keys.key_blocks["flexed.L"].name = "flexed"
    bpy.context.view_layer.update()
    refused(OPS.mirror_target, "'flexed' does not say its side")


def test_a_symmetric_target_has_no_other_side(arms):
    rig = rig_of(arms)
    OPS.mirror_target()
    OPS.go_to_pose()
    right = {name: rig.pose.bones[name].matrix_basis.copy() for name in ("upper.R", "lower.R")}
    arms.dynamorph.active_target_index = 1
    OPS.go_to_pose()
    for name, basis in right.items():
        rig.pose.bones[name].matrix_basis = basis
    bpy.context.view_layer.update()
    OPS.capture_pose()
    refused(OPS.mirror_target, "'flexed.L' has a symmetric pose")


# The list ----------------------------------------------------------------------------------------------------------


def test_moving_targets(scene, soft_arm):
    scene.frame_set(10)
    OPS.add_target(key="smile")
    assert names(soft_arm) == ["Neutral", "flexed", "smile"]
    OPS.move_target(direction="UP")
    assert names(soft_arm) == ["Neutral", "smile", "flexed"] and soft_arm.dynamorph.active_target.name == "smile"
    assert OPS.move_target(direction="UP") == {"CANCELLED"}  # the neutral target stays first
    OPS.move_target(direction="DOWN")
    assert OPS.move_target(direction="DOWN") == {"CANCELLED"}
    assert names(soft_arm) == ["Neutral", "flexed", "smile"] and soft_arm.dynamorph.active_target_index == 2
    soft_arm.dynamorph.active_target_index = 0
    for operator in (OPS.move_target, OPS.mirror_target, OPS.duplicate_target, OPS.sculpt_target, OPS.select_key):
        refused(operator, "Select a target other than the neutral one")


def test_duplicating_a_target(scene, soft_arm, capfd):
    scene.frame_set(10)
    OPS.add_target(key="smile")
    settings, keys = soft_arm.dynamorph, soft_arm.data.shape_keys
    settings.active_target_index = 1
    settings.targets[1].stiffness, settings.targets[1].fade_out_angle = 3e5, 0.4
    keys.key_blocks["flexed"].relative_key = keys.key_blocks["smile"]
    keys.key_blocks["flexed"].vertex_group = "lower"
    OPS.duplicate_target()
    assert names(soft_arm) == ["Neutral", "flexed", "flexed copy", "smile"] and settings.active_target_index == 2
    assert "'flexed copy' has the same pose as 'flexed'" in capfd.readouterr().out
    assert (key_points(soft_arm, "flexed copy") == key_points(soft_arm, "flexed")).all()
    assert (shape(soft_arm, "flexed copy") == shape(soft_arm, "flexed")).all()
    assert keys.key_blocks["flexed copy"].value == 0.0
    source, copy = settings.targets[1], settings.targets[2]
    plain = scene_plain.plain
    skip = ("name", "key_index", "key_hash")
    assert plain(source, skip) == plain(copy, skip) and source.bone_names() == copy.bone_names()
    assert [plain(bone) for bone in source.pose] == [plain(bone) for bone in copy.pose]
    with pytest.raises(errors.SceneError, match="have the same pose"):
        extract.character(soft_arm)


@pytest.mark.parametrize("how", ["keyed", "driven"])
def test_what_animates_a_target_follows_it_in_the_list(soft_arm, how):
    """Blender's paths name a place in the list, where another target may be soon."""
    settings = soft_arm.dynamorph
    for key in ("smile", "third", "fourth"):
        if key != "smile":
            add_key(soft_arm, key, 0.01)
        OPS.add_target(key=key)
    for name, amount in (("flexed", 0.9), ("smile", 0.2), ("third", 0.3)):
        target = settings.targets[names(soft_arm).index(name)]
        if how == "keyed":
            target.amount = amount
            target.keyframe_insert("amount", frame=1)
        else:
            target.driver_add("amount").driver.expression = str(amount)

    def amounts():
        bpy.context.scene.frame_set(2)
        return {target.name: round(target.amount, 3) for target in settings.targets[1:]}

    settings.active_target_index = names(soft_arm).index("third")
    OPS.move_target(direction="UP")
    assert amounts() == {"flexed": 0.9, "third": 0.3, "smile": 0.2, "fourth": 1.0}
    settings.active_target_index = names(soft_arm).index("flexed")
    OPS.remove_target()
    assert amounts() == {"third": 0.3, "smile": 0.2, "fourth": 1.0}
    settings.active_target_index = names(soft_arm).index("third")
    OPS.duplicate_target()
    assert {**amounts(), "third copy": None} == {"third": 0.3, "third copy": None, "smile": 0.2, "fourth": 1.0}


def test_the_bones_of_a_target(soft_arm):
    pose_mode(soft_arm)
    for bone in rig_of(soft_arm).pose.bones:
        (bone if hasattr(bone, "select") else bone.bone).select = True
    soft_arm.dynamorph.active_target_index = 1
    OPS.use_selected_bones()
    assert soft_arm.dynamorph.active_target.bone_names() == ("lower", "upper")
    assert {"lower", "upper", "dynamorph.remove_bone"} <= set(drawn(rig_of(soft_arm)))
    OPS.remove_bone(bone="lower")
    assert soft_arm.dynamorph.active_target.bone_names() == ("upper",)


def test_select_shape_key(soft_arm):
    soft_arm.dynamorph.active_target_index = 1
    soft_arm.active_shape_key_index = 0
    OPS.select_key()
    assert soft_arm.active_shape_key.name == "flexed"
    soft_arm.shape_key_clear()
    refused(OPS.select_key, "the shape key of target 'flexed' is gone")


def test_renaming_in_the_list_renames_the_key(soft_arm):
    """The list draws the key's own name, and the target follows."""
    edited = []

    class Recorder(Layout):
        def prop(self, data, name, **options):
            edited.append((data, name))
            super().prop(data, name, **options)

    settings = soft_arm.dynamorph
    draw_target_list(Recorder([]), settings)
    assert (soft_arm.data.shape_keys.key_blocks["flexed"], "name") in edited
    soft_arm.data.shape_keys.key_blocks["flexed"].name = "biceps"
    bpy.context.view_layer.update()
    assert names(soft_arm) == ["Neutral", "biceps"] and "biceps" in drawn(soft_arm)


def test_the_menu(soft_arm):
    out = []
    bpy.types.DYNAMORPH_MT_targets.draw(types.SimpleNamespace(layout=Layout(out)), bpy.context)
    assert {"dynamorph.suggest_targets", "dynamorph.mirror_target", "dynamorph.duplicate_target"} <= set(out)


@pytest.mark.parametrize(
    "operator",
    [OPS.suggest_targets, OPS.mirror_target, OPS.duplicate_target, OPS.go_to_pose, OPS.move_target, OPS.new_from_pose],
)
def test_each_is_one_undo_step(arms, operator):
    drive(arms, "flexed.L", "a", a=("ROT_X", "lower.R"))
    add_key(arms, "smile", 0.1)
    drive(arms, "smile", "a", a=("ROT_X", "lower.R"))
    pose_mode(arms)
    rig_of(arms).pose.bones["upper.L"].rotation_quaternion = (1, 0, 0, 0)
    bpy.context.view_layer.update()

    def state():
        obj = bpy.data.objects["Arms"]
        plain = scene_plain.plain
        return (
            [(plain(target), target.bone_names()) for target in obj.dynamorph.targets],
            [(block.name, key_points(obj, block.name).tolist()) for block in obj.data.shape_keys.key_blocks],
            channels(rig_of(obj)), plain(obj.dynamorph.sculpt), obj.show_only_shape_key, obj.mode, rig_of(obj).mode,
        )  # fmt: skip

    bpy.ops.ed.undo_push(message="before")
    before = state()
    operator()
    after = state()
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    assert state() == before
    bpy.ops.ed.redo()
    assert state() == after


def test_adding_asks_for_the_key_only_where_there_are_several(soft_arm):
    targets = authoring_targets
    add_key(soft_arm, "frown", 0.0)
    assert targets.eligible(soft_arm) == ["smile", "frown"]
    writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    assert targets.eligible(soft_arm) == ["smile", "frown"]
