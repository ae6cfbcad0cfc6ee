# SPDX-License-Identifier: GPL-3.0-or-later
"""States that artists leave a character in: what is theirs stays, and what cannot work is refused by name."""

import bpy
import numpy as np
import pytest
import round_trips
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.run import live
from bl_ext.user_default.dynamic_morph_targets.scene import animation, references
from bl_ext.user_default.dynamic_morph_targets.scene.check import checks
from bl_ext.user_default.dynamic_morph_targets.write import reconcile
from bl_ext.user_default.dynamic_morph_targets.write.authoring import fixes
from bl_ext.user_default.dynamic_morph_targets.write.bake import writer
from builders import activate, add_key, hand_made_bake, keys_of, make_arm, make_soft, refused, rig_of, skinning_of
from robustness import OPS, coarse
from test_attachments import add_attachment, make_sleeve
from test_exports import CLOSE, EVERY, off, posed, written

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")


@pytest.fixture
def built(scene):
    """The soft arm with a coarse model."""
    obj = coarse(make_soft(make_arm(scene)))
    activate(obj)
    OPS.build()
    return obj


def baked(obj):
    writer.write_keys(obj, hand_made_bake(obj))
    return obj


def shapes(obj) -> dict:
    """The points of each key."""
    return {key.name: references.key_points(key).copy() for key in keys_of(obj).key_blocks}


# Live ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("frames", [(), (5, 6)], ids=["at rest", "moving"])
@pytest.mark.parametrize("how", ["deleted", "renamed"])
def test_live_never_takes_a_key_of_the_artist_for_its_own(built, frames, how):
    """At rest the shown key is like the Basis, and like one that is not sculpted yet."""
    add_key(built, "to do", np.zeros((len(built.data.vertices), 3)))
    before = shapes(built)
    OPS.live()
    for frame in frames:
        bpy.context.scene.frame_set(frame)
    keys = keys_of(built).key_blocks
    if how == "deleted":
        built.shape_key_remove(keys["Dynamorph Live"])
    else:
        keys["Dynamorph Live"].name = "mine"
    for frame in (10, 11, 12):
        bpy.context.scene.frame_set(frame)
    if live.is_on(built):
        OPS.live()
    after = shapes(built)
    assert all(np.array_equal(after[name], points) for name, points in before.items())
    assert not keys["flexed"].mute


@pytest.mark.parametrize("frames", [(), (3, 4)], ids=["at rest", "moving"])
@pytest.mark.parametrize("from_mix", [False, True])
def test_live_takes_no_key_that_was_made_beside_its_own(built, frames, from_mix):
    """Such as a snapshot of what Live shows. When Live's key is deleted, it moves to its place."""
    OPS.live()
    for frame in frames:
        bpy.context.scene.frame_set(frame)
    built.shape_key_add(name="mine", from_mix=from_mix)
    bpy.context.view_layer.update()
    before = shapes(built)["mine"]
    built.shape_key_remove(keys_of(built).key_blocks["Dynamorph Live"])
    bpy.context.view_layer.update()
    bpy.context.scene.frame_set(10)
    assert not live.is_on(built)
    assert np.array_equal(shapes(built)["mine"], before)


def test_the_key_of_live_is_no_target(built):
    OPS.live()
    refused(OPS.add_target, "belongs to Live", key="Dynamorph Live")


# Bakes ---------------------------------------------------------------------------------------------------------------


def test_a_point_cache_comes_first_also_where_a_modifier_is_last_for_good(built, tmp_path):
    """As Shade Auto Smooth adds one."""
    smooth = built.modifiers.new("Smooth by Angle", "NODES")
    smooth.use_pin_to_last = True
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    obj = bpy.data.objects["Arm"]
    obj.dynamorph.output.format = "PC2"
    OPS.bake()
    assert [modifier.type for modifier in obj.modifiers] == ["MESH_CACHE", "ARMATURE", "NODES"]


def test_a_bake_s_action_that_is_assigned_goes_with_it(soft_arm):
    """An artist has chosen it to see its curves."""
    data = keys_of(baked(soft_arm)).animation_data
    data.action = soft_arm.dynamorph.bake.action
    data.action_slot = data.action.slots[0]
    baked(soft_arm)
    assert data.action is None
    writer.free(soft_arm)
    assert not [action.name for action in bpy.data.actions if action.name.startswith("Dynamorph")]


@pytest.mark.parametrize("again", [False, True])
def test_keys_of_the_artist_in_a_bake_s_action_that_is_assigned_stay(soft_arm, again):
    """Blender gives them a slot of their own."""
    data = keys_of(baked(soft_arm)).animation_data
    action = data.action = soft_arm.dynamorph.bake.action
    smile = keys_of(soft_arm).key_blocks["smile"]
    for frame, smile.value in ((1, 0.0), (10, 1.0)):
        smile.keyframe_insert("value", frame=frame)
    if again:
        baked(soft_arm)
    writer.free(soft_arm)
    assert data.action == action and action.users == 1
    assert [curve.data_path for curve in animation.played(data)] == ['key_blocks["smile"].value']
    bpy.context.scene.frame_set(1)
    assert smile.value == 0.0


def test_a_mesh_that_two_soft_skins_carry_along_is_refused(built):
    """Both bakes would play on it, and Delete Bake would leave one there."""
    sleeve, second = make_sleeve(built), coarse(make_soft(make_arm(bpy.context.scene, "Second")))
    second.modifiers["Armature"].object = rig_of(built)
    for obj in (built, second):
        add_attachment(obj, sleeve)
    refused(OPS.bake_all, "'Sleeve' is attached to 'Arm' and to 'Second'")
    assert sleeve.data.shape_keys is None and not built.dynamorph.bake.exists


def test_an_animated_mute_of_an_attachment_s_key_is_refused(built):
    sleeve = make_sleeve(built)
    add_attachment(built, sleeve)
    sleeve.shape_key_add(name="Basis")
    sleeve.shape_key_add(name="flexed").keyframe_insert("mute", frame=1)
    refused(OPS.bake, "'Sleeve': .*mute is animated")
    OPS.build()
    refused(OPS.live, "'Sleeve': .*mute is animated")


def test_influence_that_strips_animate_is_reported(built, tmp_path):
    """It cannot be carried from a point cache to shape keys."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    obj = bpy.data.objects["Arm"]
    obj.dynamorph.output.format = "PC2"
    OPS.bake()
    obj.modifiers["Dynamorph"].keyframe_insert("factor", frame=1)
    data = obj.animation_data
    data.nla_tracks.new().strips.new("Fade", 1, data.action).action_slot = data.action_slot
    data.action = None
    obj.dynamorph.output.format = "MODES"
    OPS.bake()
    assert "could not be carried along" in obj.dynamorph.bake.warnings


def test_keyframes_on_baked_keys_are_reported(built):
    """A keying set adds them, and they play instead of the bake."""
    OPS.bake()
    keys_of(built).key_blocks[built.dynamorph.bake.keys[0].name].keyframe_insert("value", frame=3)
    OPS.bake()
    assert "has keyframes in Action" in built.dynamorph.bake.warnings


def test_an_animated_mute_of_a_target_is_refused(soft_arm):
    keys_of(soft_arm).key_blocks["flexed"].keyframe_insert("mute", frame=1)
    with pytest.raises(errors.WriteError, match="is animated.*delete its keyframes"):
        baked(soft_arm)


# Exports -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", ["GLTF", "FBX"])
def test_an_export_in_tweak_mode_is_refused_and_changes_nothing(soft_arm, tmp_path, key):
    data = keys_of(baked(soft_arm)).animation_data
    data.nla_tracks[1].select = data.nla_tracks[1].strips[0].select = True
    data.nla_tracks.active = data.nla_tracks[1]
    data.use_tweak_mode = True
    actions = len(bpy.data.actions)
    with pytest.raises(errors.WriteError, match="tweak mode: leave it first"):
        written(soft_arm, key, tmp_path)
    assert data.use_tweak_mode and data.use_nla and len(bpy.data.actions) == actions


def test_an_export_leaves_a_slot_unassigned(soft_arm, tmp_path):
    keys = keys_of(soft_arm)
    keys.key_blocks["smile"].keyframe_insert("value", frame=1)
    keys.animation_data.action_slot = None
    written(baked(soft_arm), "GLTF", tmp_path)
    assert keys.animation_data.action and keys.animation_data.action_slot is None


@pytest.mark.parametrize("state", ["REST", "EDIT"])
def test_an_export_of_a_rig_that_shows_no_pose_is_refused(soft_arm, tmp_path, state):
    rig = rig_of(baked(soft_arm))
    if state == "REST":
        rig.data.pose_position = "REST"
    else:
        activate(rig)
        bpy.ops.object.mode_set(mode="EDIT")
    with pytest.raises(errors.SceneError, match="rest position|Edit Mode"):
        written(soft_arm, "ALEMBIC", tmp_path)


def test_a_deleted_attachment_does_not_stop_an_export(built, tmp_path):
    sleeve = make_sleeve(built)
    add_attachment(built, sleeve)
    OPS.bake()
    bpy.context.scene.collection.objects.unlink(sleeve)
    assert written(built, "GLTF", tmp_path).stat().st_size


@pytest.mark.parametrize("name", ["GLTF by pygltflib", "FBX"])
def test_stretched_time_is_exported_in_step(soft_arm, tmp_path, name):
    bpy.context.scene.render.frame_map_new = 200
    baked(soft_arm)
    exact = posed("Arm")
    assert np.ptp(exact, axis=0).max() > 0.01 and len(exact) == len(EVERY)
    assert off(name, written(soft_arm, name.split()[0], tmp_path), exact) < CLOSE


@pytest.mark.parametrize("name", ["GLTF by pygltflib", "FBX"])
def test_an_animated_mute_is_exported(soft_arm, tmp_path, name):
    smile = keys_of(baked(soft_arm)).key_blocks["smile"]
    smile.value = 1.0
    for frame, smile.mute in ((1, True), (10, False), (16, True)):
        smile.keyframe_insert("mute", frame=frame)
    exact = posed("Arm")
    assert off(name, written(soft_arm, name.split()[0], tmp_path), exact) < CLOSE


# Skinning ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("modifier", [False, True])
def test_a_parent_of_type_armature_is_fixed(soft_arm, modifier):
    """It deforms like a modifier."""
    rig, before = rig_of(soft_arm), round_trips.shown("Arm", EVERY)
    world = soft_arm.matrix_world.copy()
    soft_arm.parent, soft_arm.parent_type, soft_arm.matrix_world = rig, "ARMATURE", world
    if not modifier:
        soft_arm.modifiers.remove(soft_arm.modifiers["Armature"])
    (problem,) = list(checks.skinning_problems(skinning_of(soft_arm)))
    fixes.FIXES[problem.fix].apply(soft_arm)
    assert list(checks.problems(skinning_of(soft_arm))) == []
    assert round_trips.shown("Arm", EVERY) == pytest.approx(before, abs=1e-5)


def test_a_rig_whose_library_is_missing_is_reported(built, tmp_path):
    """Blender puts an empty in its place. The bake plays on, and can be removed."""
    library = tmp_path / "rig.blend"
    rig = rig_of(baked(built))
    name = rig.name
    bpy.data.libraries.write(str(library), {rig})
    with bpy.data.libraries.load(str(library), link=True) as (_, wanted):
        wanted.objects = [name]
    bpy.data.objects.remove(rig)
    bpy.context.scene.collection.objects.link(wanted.objects[0])
    built.modifiers["Armature"].object = wanted.objects[0]
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    library.unlink()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "shot.blend"))
    obj = bpy.data.objects["Arm"]
    activate(obj)
    assert obj.modifiers["Armature"].object.type == "EMPTY"
    refused(OPS.bake, "no Armature modifier with an armature")
    writer.free(obj)
    assert list(keys_of(obj).key_blocks.keys()) == ["Basis", "flexed", "smile"]


def test_a_parent_is_fixed_where_a_constraint_places_the_mesh_too(soft_arm):
    mark = bpy.data.objects.new("Mark", None)
    bpy.context.scene.collection.objects.link(mark)
    mark.location = 1.0, 2.0, 3.0
    follow = soft_arm.constraints.new("COPY_LOCATION")
    follow.target, follow.use_offset = mark, True
    soft_arm.parent, soft_arm.parent_type = rig_of(soft_arm), "ARMATURE"
    bpy.context.view_layer.update()
    before = soft_arm.matrix_world.copy()
    fixes.FIXES["PARENT_OBJECT"].apply(soft_arm)
    bpy.context.view_layer.update()
    assert soft_arm.matrix_world == before


# Targets -------------------------------------------------------------------------------------------------------------


def test_a_key_that_moves_to_the_place_of_a_deleted_one_is_no_target(soft_arm):
    """Neither of them is sculpted yet."""
    for name in ("deleted", "mine"):
        add_key(soft_arm, name, np.zeros((len(soft_arm.data.vertices), 3)))
    rig_of(soft_arm).pose.bones["upper"].rotation_euler.y = 0.9
    OPS.add_target(key="deleted")
    soft_arm.shape_key_remove(keys_of(soft_arm).key_blocks["deleted"])
    reconcile.reconcile(soft_arm)
    assert soft_arm.dynamorph.targets[-1].name == "deleted"
    (problem,) = list(checks.problems(skinning_of(soft_arm)))
    assert "the shape key of target 'deleted' is gone" in problem.text


# Sculpting -----------------------------------------------------------------------------------------------------------


def test_sculpting_leaves_the_other_armature_modifier_as_it_was(soft_arm):
    other = soft_arm.modifiers.new("Second", "ARMATURE")
    other.object, other.show_in_editmode, other.show_on_cage = rig_of(soft_arm), True, True
    soft_arm.modifiers["Armature"].show_in_editmode = False
    soft_arm.dynamorph.active_target_index = 1
    OPS.sculpt_target()
    OPS.finish_sculpt()
    assert other.show_in_editmode and other.show_on_cage and not soft_arm.modifiers["Armature"].show_in_editmode


def test_modifiers_move_below_an_armature_that_is_pinned_to_last(soft_arm):
    soft_arm.modifiers["Armature"].use_pin_to_last = True
    soft_arm.modifiers.new("Mask", "MASK")
    OPS.fix(problem="MOVE_BELOW")
    assert soft_arm.modifiers.keys() == ["Armature", "Mask"]
