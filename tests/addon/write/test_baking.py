# SPDX-License-Identifier: GPL-3.0-or-later
"""A bake in Blender moves the mesh as the engine said, and Delete Bake leaves no trace."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.core.motion import baked
from bl_ext.user_default.dynamic_morph_targets.scene import animation as scene_animation
from bl_ext.user_default.dynamic_morph_targets.scene import references
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.write.bake import influence as influence_module
from bl_ext.user_default.dynamic_morph_targets.write.bake import writer
from builders import (
    activate,
    add_key,
    assert_shows,
    evaluated_points,
    fingerprint,
    hand_made_bake,
    keys_of,
    make_arm,
    make_mesh,
    make_soft,
)
from costs import cost


def test_blender_shows_the_bake(soft_arm):
    bake = hand_made_bake(soft_arm)
    soft_arm.scale = (1.0, 2.0, 0.5)
    writer.write_keys(soft_arm, bake)
    assert [k.name for k in keys_of(soft_arm).key_blocks] == [
        "Basis", "flexed", "smile", "Dynamorph Mode 01", "Dynamorph Mode 02", "Dynamorph Mode 03",
        "Dynamorph Detail flexed",
    ]  # fmt: skip
    assert_shows(soft_arm, bake)


def test_the_artists_keys_play_on_top(soft_arm):
    blocks = keys_of(soft_arm).key_blocks
    blocks["flexed"].value = 1.0  # muted by the bake, which contains it
    blocks["smile"].driver_add("value").driver.expression = "0.5"
    blocks["smile"].relative_key = blocks["flexed"]  # a muted key still serves as reference
    soft_arm.vertex_groups.new(name="Half").add(list(range(200)), 0.5, "REPLACE")
    blocks["smile"].vertex_group = "Half"
    bake = hand_made_bake(soft_arm)
    writer.write_keys(soft_arm, bake)
    assert blocks["flexed"].mute and not blocks["smile"].mute
    assert_shows(soft_arm, bake, extra=0.5 * mesh_data.target_shape(soft_arm, "smile"))


def test_the_artists_action_and_nla_play_on(scene, soft_arm):
    keys = keys_of(soft_arm)
    smile = keys.key_blocks["smile"]
    for frame in (1, 20):
        smile.value = frame / 20
        smile.keyframe_insert("value", frame=frame)
    animation = keys.animation_data
    pushed = animation.action
    track = animation.nla_tracks.new()
    track.strips.new("smile", 1, pushed).action_slot = pushed.slots[0]
    animation.action = None
    keys.key_blocks["flexed"].keyframe_insert("value", frame=1)  # a new active Action
    scene.frame_set(1)
    before = fingerprint(soft_arm)
    bake = hand_made_bake(soft_arm)
    writer.write_keys(soft_arm, bake)
    assert keys.animation_data.action.name == before["animation"][0]
    scene.frame_set(20)
    assert smile.value == pytest.approx(1.0)
    scene.frame_set(1)
    assert smile.value == pytest.approx(1 / 20)
    values = bake.coordinates[:, 0] / np.abs(bake.coordinates[:, 0]).max()
    for frame, index in ((-50, 0), (1, 0), (7, 6), (20, 19), (500, 19)):  # constant outside the range
        scene.frame_set(frame)
        assert keys.key_blocks["Dynamorph Mode 01"].value == pytest.approx(values[index], abs=1e-6)
    scene.frame_set(7, subframe=0.5)
    assert keys.key_blocks["Dynamorph Mode 01"].value == pytest.approx(values[6:8].mean(), abs=1e-6)
    scene.frame_set(1)
    writer.free(soft_arm)
    assert fingerprint(soft_arm) == before


def nothing(_obj):
    pass


def with_driver(obj):
    keys_of(obj).key_blocks["flexed"].driver_add("value").driver.expression = "0.25"


def with_action(obj):
    keys_of(obj).key_blocks["smile"].keyframe_insert("value", frame=1)


def with_muted_target(obj):
    keys_of(obj).key_blocks["flexed"].mute = True


def with_empty_animation_data(obj):
    keys_of(obj).animation_data_create()


def with_keys_of_the_same_name(obj):
    add_key(obj, "Dynamorph Mode 01", 0.1)
    add_key(obj, 'quote " and \\ backslash', 0.1)


@pytest.mark.parametrize(
    "prepare",
    [nothing, with_driver, with_action, with_muted_target, with_empty_animation_data, with_keys_of_the_same_name],
)
def test_free_leaves_no_trace(scene, soft_arm, prepare):
    prepare(soft_arm)
    soft_arm.active_shape_key_index = 1
    scene.frame_set(5)
    before = fingerprint(soft_arm)
    bake = writer
    bake.write_keys(soft_arm, hand_made_bake(soft_arm))
    assert soft_arm.active_shape_key_index == 1
    scene.frame_set(5)
    bake.write_keys(soft_arm, hand_made_bake(soft_arm, modes=5, seed=2))  # bake again
    scene.frame_set(5)
    assert [track.name for track in keys_of(soft_arm).animation_data.nla_tracks] == ["Dynamorph Shapes", "Dynamorph"]
    bake.free(soft_arm)
    assert fingerprint(soft_arm) == before
    bake.free(soft_arm)
    assert fingerprint(soft_arm) == before


def test_baking_again_replaces_the_bake(soft_arm):
    bake = writer
    bake.write_keys(soft_arm, hand_made_bake(soft_arm))
    names = [k.name for k in keys_of(soft_arm).key_blocks]
    second = hand_made_bake(soft_arm, seed=2)
    bake.write_keys(soft_arm, second)
    assert [k.name for k in keys_of(soft_arm).key_blocks] == names
    assert len(bpy.data.actions) == 2  # the rig's and the bake's
    assert_shows(soft_arm, second)


def spoil_curves(patch):
    """Let there be no memory for a curve."""

    def add_curve(*_args):
        raise MemoryError

    patch.setattr(writer, "add_curve", add_curve)


def spoil_keys(patch):
    """Let the last of the new keys have a point too few, which Blender refuses when the others are there."""
    scaled_keys = writer.scaled_keys

    def spoiled(*args):
        *keys, last = scaled_keys(*args)
        return [*keys, replace(last, points=last.points[1:])]

    patch.setattr(writer, "scaled_keys", spoiled)


def test_a_failure_keeps_the_previous_bake(soft_arm, monkeypatch):
    bake = writer
    bake.write_keys(soft_arm, hand_made_bake(soft_arm))
    bpy.context.scene.frame_set(5)
    before = fingerprint(soft_arm)
    for spoil in (spoil_curves, spoil_keys):
        with monkeypatch.context() as patch:
            spoil(patch)
            with pytest.raises((MemoryError, RuntimeError)):
                bake.write_keys(soft_arm, hand_made_bake(soft_arm, seed=2))
        bpy.context.scene.frame_set(5)
        assert fingerprint(soft_arm) == before


def test_a_failed_first_bake_leaves_no_trace(soft_arm, monkeypatch):
    bake = writer
    before = fingerprint(soft_arm)
    spoil_curves(monkeypatch)
    with pytest.raises(MemoryError):
        bake.write_keys(soft_arm, hand_made_bake(soft_arm))
    assert fingerprint(soft_arm) == before


def test_free_finds_renamed_and_moved_keys(soft_arm):
    bake = writer
    before = fingerprint(soft_arm)
    bake.write_keys(soft_arm, hand_made_bake(soft_arm))
    blocks = keys_of(soft_arm).key_blocks
    blocks["Dynamorph Mode 02"].name = "my favorite"
    blocks["flexed"].name = "biceps"
    keys_of(soft_arm).animation_data.nla_tracks[0].name = "soft"
    keys_of(soft_arm).animation_data.nla_tracks[0].strips[0].action.name = "soft"
    soft_arm.active_shape_key_index = 4
    activate(soft_arm)
    bpy.ops.object.shape_key_move(type="TOP")
    assert [t.name for t in soft_arm.dynamorph.targets] == ["Neutral", "biceps"]
    blocks["biceps"].name = "flexed"
    bpy.context.view_layer.update()
    bake.free(soft_arm)
    assert {**fingerprint(soft_arm), "active": 0} == {**before, "active": 0}


def test_a_users_key_named_like_ours_is_never_taken(soft_arm):
    """The record knows its keys by name and shape, not by a prefix."""
    bake = writer
    bake.write_keys(soft_arm, hand_made_bake(soft_arm))
    add_key(soft_arm, "Dynamorph Mode 09", 0.1)
    bake.free(soft_arm)
    assert [k.name for k in keys_of(soft_arm).key_blocks] == ["Basis", "flexed", "smile", "Dynamorph Mode 09"]


def test_baking_again_after_a_key_was_deleted(soft_arm):
    before = fingerprint(soft_arm)
    bake = hand_made_bake(soft_arm)
    writer.write_keys(soft_arm, bake)
    soft_arm.shape_key_remove(keys_of(soft_arm).key_blocks["Dynamorph Mode 01"])
    writer.write_keys(soft_arm, bake)
    assert [key.key_index for key in soft_arm.dynamorph.bake.keys] == [3, 4, 5, 6]
    assert_shows(soft_arm, bake)
    bpy.context.scene.frame_set(1)
    writer.free(soft_arm)
    assert fingerprint(soft_arm) == before


@pytest.mark.parametrize("name", ["Dynamorph Mode 01", "Dynamorph Detail flexed"])  # the first and the last key
def test_a_users_key_in_place_of_a_deleted_one_is_never_taken(soft_arm, name):
    bake = writer
    bake.write_keys(soft_arm, hand_made_bake(soft_arm))
    soft_arm.shape_key_remove(keys_of(soft_arm).key_blocks[name])
    add_key(soft_arm, name, 0.1)
    bake.write_keys(soft_arm, hand_made_bake(soft_arm, seed=2))
    bake.free(soft_arm)
    assert [k.name for k in keys_of(soft_arm).key_blocks] == ["Basis", "flexed", "smile", name]


def test_free_finds_its_keys_after_an_edit_of_the_mesh(soft_arm):
    """Blender carries the edit of the Basis into the other keys, and rounds."""
    bake = writer
    bake.write_keys(soft_arm, hand_made_bake(soft_arm))
    soft_arm.active_shape_key_index = 0
    activate(soft_arm)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.transform.translate(value=(0.1234567, 0.0, 0.0))
    bpy.ops.object.mode_set(mode="OBJECT")
    bake.free(soft_arm)
    assert [k.name for k in keys_of(soft_arm).key_blocks] == ["Basis", "flexed", "smile"]


@pytest.mark.fault("F17")
def test_a_duplicate_is_freed_alone(soft_arm):
    before = [k.name for k in keys_of(soft_arm).key_blocks]
    bake = hand_made_bake(soft_arm)
    writer.write_keys(soft_arm, bake)
    activate(soft_arm)
    soft_arm.select_set(True)
    bpy.ops.object.duplicate()
    copy = bpy.context.object
    assert copy != soft_arm and copy.data != soft_arm.data
    writer.free(copy)
    assert [k.name for k in keys_of(copy).key_blocks] == before
    assert not keys_of(copy).animation_data
    assert_shows(soft_arm, bake)
    writer.free(soft_arm)
    assert [k.name for k in keys_of(soft_arm).key_blocks] == before


def test_bakes_survive_save_and_load(soft_arm, tmp_path):
    before = fingerprint(soft_arm)
    bake = hand_made_bake(soft_arm)
    writer.write_keys(soft_arm, bake)
    for _ in range(2):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "shot.blend"))
    obj = bpy.data.objects["Arm"]
    assert_shows(obj, bake)
    bpy.context.scene.frame_set(1)
    writer.free(obj)
    assert fingerprint(obj) == before


def test_two_baked_characters(scene, soft_arm):
    bake = writer
    other = make_soft(make_arm(scene, "Leg"))
    first, second = hand_made_bake(soft_arm), hand_made_bake(other, seed=5)
    bake.write_keys(soft_arm, first)
    bake.write_keys(other, second)
    assert_shows(soft_arm, first)
    bake.free(soft_arm)
    assert_shows(other, second)


def test_single_frame_and_still_bakes(scene, soft_arm):
    bake = hand_made_bake(soft_arm, frames=range(7, 8))
    bake.coordinates[:, 1] = 0.0
    writer.write_keys(soft_arm, bake)
    for frame in (1, 7, 30):
        scene.frame_set(frame)
        value = keys_of(soft_arm).key_blocks["Dynamorph Mode 01"].value
        assert abs(value) == pytest.approx(1.0) and np.sign(value) == np.sign(bake.coordinates[0, 0])
    assert keys_of(soft_arm).key_blocks["Dynamorph Mode 02"].value == 0.0


# Influence ---------------------------------------------------------------------------------------------------------


def influenced(bake, influence, frame):
    """The displacement that Blender must show at a frame with an influence."""
    coordinates = influence * bake.coordinates + (1.0 - influence) * bake.static
    return replace(bake, coordinates=coordinates).displacement(frame - int(bake.frames[0]))


def shown_displacement(obj):
    """The sum of the shape keys (V, 3) as Blender evaluates it: the mesh with its Armature modifier off."""
    obj.modifiers["Armature"].show_viewport = False
    bpy.context.view_layer.update()
    points = evaluated_points(obj)
    obj.modifiers["Armature"].show_viewport = True
    return points - references.key_points(obj.data.shape_keys.reference_key)


@pytest.mark.parametrize("influence", [1.0, 0.5, 0.0])
def test_influence_blends_from_the_shapes_to_the_motion(scene, soft_arm, influence):
    bake_influence = influence_module
    bake = hand_made_bake(soft_arm)
    bake.static[:, 1] = 0.0  # a mode that no shape needs
    writer.write_keys(soft_arm, bake)
    bake_influence.influence_strip(soft_arm).influence = influence
    for frame in (1, 7, 20, 30):
        scene.frame_set(frame)
        expected = influenced(bake, influence, min(frame, 20))
        assert shown_displacement(soft_arm) == pytest.approx(expected, abs=1e-6)


def test_the_slider_shows_at_once(scene, soft_arm):
    bake_influence = influence_module
    bake = hand_made_bake(soft_arm)
    writer.write_keys(soft_arm, bake)
    scene.frame_set(4)
    bake_influence.influence_strip(soft_arm).influence = 0.25
    bake_influence.show_influence(soft_arm)
    bpy.context.view_layer.update()
    assert shown_displacement(soft_arm) == pytest.approx(influenced(bake, 0.25, 4), abs=1e-6)
    assert bake_influence.influence_strip(soft_arm).influence == 0.25


def test_keyed_influence_survives_saving_and_another_bake(scene, soft_arm, tmp_path):
    bake_influence = influence_module
    before = fingerprint(soft_arm)
    writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    strip = bake_influence.influence_strip(soft_arm)
    for frame, influence in ((1, 0.0), (11, 1.0)):
        strip.influence = influence
        assert strip.keyframe_insert("influence", frame=frame)
    for point in strip.fcurves.find("influence").keyframe_points:
        point.interpolation = "LINEAR"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "shot.blend"))
    obj, scene = bpy.data.objects["Arm"], bpy.context.scene
    bake = hand_made_bake(obj, frames=range(1, 31), seed=4)
    writer.write_keys(obj, bake)
    for frame, influence in ((1, 0.0), (6, 0.5), (11, 1.0), (25, 1.0)):
        scene.frame_set(frame)
        assert shown_displacement(obj) == pytest.approx(influenced(bake, influence, frame), abs=1e-6)
    scene.frame_set(1)
    writer.free(obj)
    assert fingerprint(obj) == before


def test_a_slider_that_was_set_stays_for_the_next_bake(soft_arm):
    bake, bake_influence = writer, influence_module
    bake.write_keys(soft_arm, hand_made_bake(soft_arm))
    bake_influence.influence_strip(soft_arm).influence = 0.375
    bake.write_keys(soft_arm, hand_made_bake(soft_arm, seed=3))
    strip = bake_influence.influence_strip(soft_arm)
    assert strip.influence == 0.375 and not strip.fcurves.find("influence").keyframe_points
    bake.free(soft_arm)
    assert bake_influence.influence_strip(soft_arm) is None
    bake.write_keys(soft_arm, hand_made_bake(soft_arm))
    assert bake_influence.influence_strip(soft_arm).influence == 1.0


def test_static_morph_targets_have_no_motion_to_influence(scene, soft_arm):
    bake_influence = influence_module
    bake = hand_made_bake(soft_arm, modes=0)
    writer.write_keys(soft_arm, bake)
    assert [track.name for track in keys_of(soft_arm).animation_data.nla_tracks] == ["Dynamorph Shapes"]
    assert bake_influence.influence_strip(soft_arm) is None
    assert_shows(soft_arm, bake)


def test_the_size_of_a_bake(soft_arm):
    bake = hand_made_bake(soft_arm)
    size = writer.write_keys(soft_arm, bake)
    keys, vertices, frames = 4, len(soft_arm.data.vertices), 20
    assert size == keys * vertices * 12 + (3 + 3 + 2) * frames * 72


# What is refused, before anything changes ------------------------------------------------------------------------


def shared_mesh(obj):
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("Twin", obj.data))


def edit_mode(obj):
    activate(obj)
    bpy.ops.object.mode_set(mode="EDIT")


def nla_off(obj):
    keys_of(obj).animation_data_create().use_nla = False


def solo_track(obj):
    track = keys_of(obj).animation_data_create().nla_tracks.new()
    track.name = "Lips"
    track.is_solo = True


def tweak_mode(obj):
    with_action(obj)
    animation = keys_of(obj).animation_data
    action = animation.action
    animation.action = None
    strip = animation.nla_tracks.new().strips.new("a", 1, action)
    strip.action_slot = action.slots[0]
    strip.select = animation.nla_tracks[0].select = True
    animation.nla_tracks.active = animation.nla_tracks[0]
    animation.use_tweak_mode = True


@pytest.mark.parametrize(
    "spoil, words",
    [
        (shared_mesh, "'Arm' is shared by 2 objects.*single-user"),
        (edit_mode, "'Arm' is in Edit Mode"),
        (nla_off, "'Arm'.*turn it on"),
        (solo_track, "'Lips'.*solo"),
        (tweak_mode, "'Arm' are in NLA tweak mode"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_refused(soft_arm, spoil, words):
    bake = hand_made_bake(soft_arm)
    spoil(soft_arm)
    names = [k.name for k in keys_of(soft_arm).key_blocks]
    with pytest.raises(errors.WriteError, match=words):
        writer.write_keys(soft_arm, bake)
    assert [k.name for k in keys_of(soft_arm).key_blocks] == names
    assert not soft_arm.dynamorph.bake.keys


def test_linked_data_is_refused(soft_arm, tmp_path):
    path = str(tmp_path / "asset.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.objects = ["Arm"]
    linked = wanted.objects[0]
    bpy.context.scene.collection.objects.link(linked)
    with pytest.raises(errors.WriteError, match=r"'Arm' is linked.*make it local"):
        writer.check(linked)
    override = linked.override_create()
    assert [t.name for t in override.dynamorph.targets] == ["Neutral", "flexed"]
    with pytest.raises(errors.WriteError, match=r"library override.*make it local"):
        writer.check(override)


def test_vertex_count_must_match(soft_arm):
    bake = hand_made_bake(soft_arm)
    other = make_mesh(bpy.context.scene, "Other", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    other.shape_key_add(name="Basis")
    with pytest.raises(errors.WriteError, match="'Other' has 3 vertices, the bake 272"):
        writer.write_keys(other, bake)


def test_writing_is_fast(scene):
    """20 keys on 13,000 vertices with 250 frames are written much faster than point by point in Python."""
    rng = np.random.default_rng(0)
    obj = make_mesh(scene, "Body", rng.normal(size=(13_000, 3)), [(0, 1, 2)])
    obj.shape_key_add(name="Basis")
    bake = baked.Bake(
        np.arange(250), rng.normal(size=(250, 20)), np.ones((250, 1)), rng.normal(size=(20, 13_000, 3)),
        np.zeros((1, 13_000, 3)), ("Neutral",), rng.normal(size=(250, 20)),
    )  # fmt: skip

    def one_by_one():
        for mode in bake.modes:
            for point, place in zip(keys_of(obj).reference_key.points, mode, strict=True):
                point.co = place

    assert 5 * cost(lambda: writer.write_keys(obj, bake), times=3) < cost(one_by_one, times=1)


def test_a_key_whose_mute_is_driven_is_refused(soft_arm):
    soft_arm.data.shape_keys.key_blocks["flexed"].driver_add("mute")
    with pytest.raises(errors.WriteError, match="flexed.*has a driver"):
        writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    assert not soft_arm.dynamorph.bake.keys


def keyed_in_the_bake(obj):
    """The artist has pressed Tab on the bake's strip and keyed another key there."""
    data = keys_of(obj).animation_data
    track = data.nla_tracks[-1]
    track.select = track.strips[0].select = True
    data.nla_tracks.active = track
    data.use_tweak_mode = True
    smile = keys_of(obj).key_blocks["smile"]
    for frame, value in ((1, 0.0), (10, 1.0), (20, 0.2)):
        smile.value = value
        smile.keyframe_insert("value", frame=frame)
    data.use_tweak_mode = False


@pytest.mark.parametrize("again", [False, True])
def test_keys_that_the_artist_has_set_in_the_bake_s_strip_stay(scene, soft_arm, again):
    bake = writer
    bake.write_keys(soft_arm, hand_made_bake(soft_arm))
    keyed_in_the_bake(soft_arm)
    second = hand_made_bake(soft_arm, seed=2)
    if again:
        bake.write_keys(soft_arm, second)
    else:
        bake.free(soft_arm)
    keys = keys_of(soft_arm)
    for frame, value in ((1, 0.0), (10, 1.0), (20, 0.2)):
        scene.frame_set(frame)
        assert keys.key_blocks["smile"].value == pytest.approx(value)
    curves = scene_animation.curves
    moved = [
        {curve.data_path for slot in action.slots for curve in curves(action, slot)} for action in bpy.data.actions
    ]
    assert moved.count({'key_blocks["smile"].value'}) == 1
    if not again:
        assert [block.name for block in keys.key_blocks] == ["Basis", "flexed", "smile"]
        assert len([paths for paths in moved if any("key_blocks" in path for path in paths)]) == 1
    else:
        keys.key_blocks["smile"].mute = True
        assert_shows(soft_arm, second)
        bake.free(soft_arm)
        keys.key_blocks["smile"].mute = False
        scene.frame_set(10)
        assert keys.key_blocks["smile"].value == pytest.approx(1.0)


def test_a_copy_of_the_bake_s_action_with_a_name_of_the_artist_s_stays(soft_arm):
    bake = writer
    bake.write_keys(soft_arm, hand_made_bake(soft_arm))
    data = keys_of(soft_arm).animation_data
    mine, copy = soft_arm.dynamorph.bake.action.copy(), soft_arm.dynamorph.bake.action.copy()
    mine.name = "Mine"
    for action in (mine, copy):
        track = data.nla_tracks.new()
        track.strips.new(action.name, 100, action)
    name = copy.name
    bake.free(soft_arm)
    assert "Mine" in bpy.data.actions and name not in bpy.data.actions


@pytest.mark.parametrize("again", [False, True])
def test_a_baked_key_that_the_artist_has_sculpted_stays_without_effect(scene, soft_arm, again):
    """Its value was that of the old motion: on top of a new bake, the skin would be somewhere else."""
    bake, second = writer, hand_made_bake(soft_arm, seed=2)
    bake.write_keys(soft_arm, hand_made_bake(soft_arm))
    scene.frame_set(7)
    block = keys_of(soft_arm).key_blocks["Dynamorph Mode 02"]
    for point in block.points:
        point.co.z += 1.0
    shape = [tuple(point.co) for point in block.points]
    if again:
        new = bake.NewBake(soft_arm, second)
        new.add()
        new.show()
        messages = new.remove_old()
        assert_shows(soft_arm, second)
    else:
        messages = bake.free(soft_arm)
    assert len(messages) == 1 and "'Dynamorph Mode 02' of 'Arm' was edited after the bake: it stays" in messages[0]
    kept = [block for block in keys_of(soft_arm).key_blocks if [tuple(point.co) for point in block.points] == shape]
    scene.frame_set(9)
    assert len(kept) == 1 and kept[0].value == 0.0


def test_a_baked_key_that_was_renamed_and_sculpted_stays_without_effect(scene, soft_arm):
    bake, second = writer, hand_made_bake(soft_arm, seed=2)
    bake.write_keys(soft_arm, hand_made_bake(soft_arm))
    block = keys_of(soft_arm).key_blocks["Dynamorph Mode 02"]
    block.name = "mine"
    for point in block.points:
        point.co.z += 1.0
    bake.write_keys(soft_arm, second)
    assert_shows(soft_arm, second)
    assert keys_of(soft_arm).key_blocks["mine"].value == 0.0
    assert len(keys_of(soft_arm).animation_data.nla_tracks) == 2


def test_nothing_is_said_of_a_baked_key_that_was_deleted(soft_arm):
    bake = writer
    bake.write_keys(soft_arm, hand_made_bake(soft_arm))
    soft_arm.shape_key_remove(keys_of(soft_arm).key_blocks["Dynamorph Mode 02"])
    new = bake.NewBake(soft_arm, hand_made_bake(soft_arm, seed=2))
    new.add()
    new.show()
    assert new.remove_old() == []


def test_copies_of_strips_go_with_the_bake_of_an_object_with_a_long_name(soft_arm):
    """Blender 4.5 cuts names at 63 bytes."""
    soft_arm.name = "x" * 60
    bake, before = writer, fingerprint(soft_arm)
    bake.write_keys(soft_arm, hand_made_bake(soft_arm))
    track = keys_of(soft_arm).animation_data.nla_tracks.new()
    track.strips.new("copy", 100, soft_arm.dynamorph.bake.action.copy())
    bake.free(soft_arm)
    assert fingerprint(soft_arm) == before
