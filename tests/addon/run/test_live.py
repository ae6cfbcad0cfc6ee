# SPDX-License-Identifier: GPL-3.0-or-later
"""Live shows what a bake would, continues through edits, and leaves no trace; so do its previews."""

import json
import types
from itertools import pairwise

import addon_utils
import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.core.motion.player import Player
from bl_ext.user_default.dynamic_morph_targets.run import live as run_live
from bl_ext.user_default.dynamic_morph_targets.run import remembered
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.run.playing import session as run_session
from bl_ext.user_default.dynamic_morph_targets.run.playing import tissue as run_tissue
from bl_ext.user_default.dynamic_morph_targets.run.tools import preview as run_preview
from bl_ext.user_default.dynamic_morph_targets.run.tools.heat import displacements
from bl_ext.user_default.dynamic_morph_targets.scene import animation, references
from bl_ext.user_default.dynamic_morph_targets.scene import events as scene_events
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from bl_ext.user_default.dynamic_morph_targets.ui.operators import playback
from bl_ext.user_default.dynamic_morph_targets.write.display import comparison
from builders import activate, evaluated_points, fingerprint, refused, rig_of, skinning_of, soon
from built import BuiltOnce
from installed import MODULE
from layout import drawn
from mathutils import Matrix
from pressed import Pressed, press

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

built = BuiltOnce()


@pytest.fixture
def live_arm(soft_arm):
    """The soft arm with a coarse model, built."""
    settings = soft_arm.dynamorph
    settings.model.cage_nodes, settings.model.modes = 200, 8
    built.give(soft_arm, 8)
    settings.simulation.gravity = 0.0
    return soft_arm


@pytest.fixture
def playing(live_arm):
    bpy.ops.dynamorph.live()
    return live_arm


def surface(obj) -> np.ndarray:
    """Points (V, 3) that the shape keys make at the present frame."""
    return references.key_points(obj.data.shape_keys.key_blocks["Dynamorph Live"]).astype(float)


def play(obj, frames) -> np.ndarray:
    """The surface (F, V, 3) at frames that are played one after the other."""
    shown = []
    for frame in frames:
        bpy.context.scene.frame_set(int(frame), subframe=frame % 1)
        shown.append(surface(obj))
        assert run_live.problem(obj) == ""
    return np.array(shown)


def session(obj):
    return remembered.live.sessions[obj.session_uid]


def baked(obj, **settings):
    """The surface (F, V, 3) of a bake of the same scene, which is not written."""
    job = Job(obj, goal="BAKE", stored=False, **settings)
    batch.run(job)
    assert job.input.reasons == []
    rest = extract.character(obj).vertices
    return np.array([rest + job.outcome.bake.displacement(k) for k in range(len(job.outcome.bake.frames))])


def begun_at(obj, frame, **settings):
    """The surface (V, 3) with which a bake begins that starts at this frame."""
    simulation = obj.dynamorph.simulation
    whole = simulation.use_scene_range, simulation.frame_start, simulation.frame_end
    simulation.use_scene_range, simulation.frame_start, simulation.frame_end = False, frame, frame + 1
    first = baked(obj, **settings)[0]
    simulation.use_scene_range, simulation.frame_start, simulation.frame_end = whole
    return first


def values_at(obj, frame):
    """What Live shows at a frame: coordinates (r,) and target weights (J,)."""
    now, settings = session(obj), run_tissue.simulation_settings(obj, bpy.context.scene)
    return np.split(now.values(obj, settings, frame, arrives=False), [now.tissue.modes])


def apart(first, second) -> float:
    """The largest distance, as a fraction of the arm's length."""
    return float(np.abs(first - second).max() / 2.0)


# Playback ----------------------------------------------------------------------------------------------------------


def sliding(obj):
    """The arm whose rig also travels, with its mesh."""
    rig = rig_of(obj)
    obj.parent = rig
    for frame, x in ((1, 0.0), (8, 0.5), (20, 0.0)):
        rig.location.x = x
        rig.keyframe_insert("location", frame=frame)
    obj.dynamorph.simulation.gravity = 1.0


@pytest.mark.parametrize("change", [lambda obj: None, sliding])
def test_playback_is_the_bake(live_arm, change):
    change(live_arm)
    bpy.ops.dynamorph.live()
    assert apart(play(live_arm, range(1, 21)), baked(live_arm)) < 1e-6


def test_samples_between_frames_are_for_bakes(live_arm):
    live_arm.dynamorph.simulation.samples = 2
    bpy.ops.dynamorph.live()
    assert apart(play(live_arm, range(1, 21)), baked(live_arm)[::2]) < 1e-6


def test_what_blender_shows_is_the_live_surface(playing):
    bpy.context.scene.frame_set(1)
    bpy.context.scene.frame_set(9)
    shown = evaluated_points(playing)
    playing.modifiers["Armature"].show_viewport = False
    assert apart(evaluated_points(playing), surface(playing)) < 1e-6
    assert apart(evaluated_points(playing), shown) > 0.01


def test_sub_frames_are_those_of_the_bake(playing):
    whole = baked(playing)
    shown = play(playing, [1, 0.75, 1.25, 1, 2, 1.75, 2.25, 3, 3.5])
    between = whole[2] + 0.5 * (whole[3] - whole[2])
    assert apart(shown[0], whole[0]) < 1e-6 and apart(shown[1], whole[0]) < 1e-6
    assert apart(shown[2], 0.75 * whole[0] + 0.25 * whole[1]) < 1e-6
    assert apart(shown[5], 0.25 * whole[0] + 0.75 * whole[1]) < 1e-6
    assert apart(shown[7], whole[2]) < 1e-6 and apart(shown[8], between) < 1e-6


def test_begins_again_at_the_start_and_after_a_jump(playing):
    whole = play(playing, range(1, 11))
    assert apart(play(playing, range(1, 11)), whole) == 0.0
    for frame in (40, 20):  # too far to have been played
        (shown,) = play(playing, [frame])
        assert apart(shown, begun_at(playing, frame)) < 1e-6


@pytest.mark.fault("A12")
def test_dropped_frames_are_simulated_all_the_same(playing):
    whole = baked(playing)
    assert apart(play(playing, [1, 4, 5, 12, 20]), whole[[0, 3, 4, 11, 19]]) < 1e-6


def test_playback_that_drops_too_many_frames_says_so(playing, monkeypatch):
    """Until it goes on from there without another gap."""
    monkeypatch.setattr(scene_events, "is_playing", lambda: True)
    play(playing, [1, 1 + run_session.CATCH_UP])
    assert run_live.played_texts(playing) == []
    play(playing, [2 + 2 * run_session.CATCH_UP])
    assert len(run_live.played_texts(playing)) == 1
    play(playing, [1, 1 + run_session.CATCH_UP, 80])
    assert "Playback dropped 54 frames, so Live began again at 80: set Sync" in " ".join(drawn(playing))
    play(playing, [1])
    assert run_live.played_texts(playing) == []
    monkeypatch.setattr(scene_events, "is_playing", lambda: False)
    play(playing, [80])  # the artist has jumped there
    assert run_live.played_texts(playing) == []


def test_scrubbing_reads_no_rig_until_the_mouse_is_up(playing, monkeypatch):
    """Blender 5.2 crashes when a scene is removed from a handler while the artist drags through the timeline."""
    scene = bpy.context.scene
    for frame in range(1, 5):
        scene.frame_set(frame)
    shown = {4: surface(playing)}
    scene.frame_set(3)
    scrubbing, looks = [True], []
    monkeypatch.setattr(scene_events, "soon", lambda look, _seconds: looks.append(look))
    monkeypatch.setattr(scene_events, "is_scrubbing", lambda: scrubbing[0])
    remembered.live.sessions[playing.session_uid].rig.forget()
    sample = rig_motion.sample_rig
    monkeypatch.setattr(rig_motion, "sample_rig", lambda *_args: pytest.fail("the rig is read"))
    scene.frame_set(4)  # known: shows at once
    assert np.array_equal(surface(playing), shown[4])
    scene.frame_set(9)  # not known: waits
    assert np.array_equal(surface(playing), shown[4])
    (look,) = looks
    assert look() > 0.0  # seconds until it looks again
    scrubbing[0] = False
    monkeypatch.setattr(rig_motion, "sample_rig", sample)
    assert look() is None
    assert not np.array_equal(surface(playing), shown[4])


@pytest.mark.fault("A04")
def test_scrubbing_back_shows_what_was(playing):
    whole = play(playing, range(1, 13))
    assert apart(play(playing, [7, 3, 9]), whole[[6, 2, 8]]) == 0.0
    assert apart(play(playing, [13]), baked(playing)[[12]]) < 1e-6


def test_a_loop_goes_on_without_a_jump(live_arm):
    bone = rig_of(live_arm).pose.bones["lower"]
    for frame, angle in ((1, 0.2), (10, 1.2), (20, 0.2)):
        bone.rotation_euler.x = angle
        bone.keyframe_insert("rotation_euler", frame=frame)
    live_arm.dynamorph.simulation.loop = True
    bpy.ops.dynamorph.live()
    first = play(live_arm, range(1, 21))
    second = play(live_arm, range(1, 21))
    assert apart(second[0], first[-1]) < 1e-6 and apart(second[0], first[0]) > 1e-4
    for _ in range(15):
        play(live_arm, range(1, 21))
    assert apart(play(live_arm, range(1, 21)), baked(live_arm)) < 2e-4


def test_a_loop_whose_last_frames_are_dropped_goes_on(live_arm):
    live_arm.dynamorph.simulation.loop = True
    bpy.ops.dynamorph.live()
    first = play(live_arm, range(1, 18))[0]
    assert apart(play(live_arm, [1])[0], first) > 1e-3
    assert apart(play(live_arm, [2, 9, 1])[-1], first) < 1e-6  # that was no end


def test_static_morph_targets_loop(live_arm):
    live_arm.dynamorph.model.method = "STATIC"
    live_arm.dynamorph.simulation.loop = True
    bpy.ops.dynamorph.build()
    bpy.ops.dynamorph.live()
    assert apart(play(live_arm, range(1, 21)), play(live_arm, range(1, 21))) == 0.0


@pytest.mark.parametrize("method", ["SINGLE", "SHAPE"])
def test_other_methods_show_what_their_bake_does(live_arm, method):
    """With the Method Single the targets' own keys go on playing."""
    live_arm.dynamorph.model.method = method
    live_arm.data.shape_keys.key_blocks["flexed"].value = 0.5
    bpy.ops.dynamorph.build()
    bpy.ops.dynamorph.live()
    play(live_arm, range(1, 6))
    shown = evaluated_points(live_arm)
    bpy.ops.dynamorph.bake()
    assert apart(evaluated_points(live_arm), shown) < 1e-5


def test_collapsed_bones_keep_their_size_from_block_to_block(live_arm):
    bone = rig_of(live_arm).pose.bones["lower"]
    for frame, size in ((10, 1.0), (11, 0.0)):
        bone.scale = (size, size, size)
        bone.keyframe_insert("scale", frame=frame)
    bpy.context.scene.frame_end = 20
    bpy.ops.dynamorph.live()
    assert apart(play(live_arm, range(1, 21)), baked(live_arm)) < 1e-6


def test_the_latest_rig_of_a_long_shot_is_kept(playing, monkeypatch):
    whole = play(playing, range(1, 41))
    monkeypatch.setattr(run_session, "RIG_BYTES", 1)
    monkeypatch.setattr(run_session, "UNNOTICED", 1e9)
    rig, read = session(playing).rig, []
    rig.forget()
    sample_rig = rig_motion.sample_rig
    monkeypatch.setattr(rig_motion, "sample_rig", lambda *args: read.append(args[1:3]) or sample_rig(*args))
    assert apart(play(playing, range(1, 41)), whole) == 0.0
    begins = [first for first, _ in read]
    assert read[-1][1] - read[-1][0] == 16 and begins[1:] == [end for _, end in read[:-1]]
    before = len(read)
    for frame in (40, 20):
        rig.after(playing, frame)
    assert len(read) == before
    rig.after(playing, 2)
    assert read[before:] == [(2, 18)]


def test_a_slow_rig_is_read_frame_by_frame(playing, monkeypatch):
    """Blender would stand still while it reads more."""
    whole = play(playing, range(1, 13))
    monkeypatch.setattr(run_session, "UNNOTICED", 0.0)
    rig, read = session(playing).rig, []
    rig.after(playing, 30)
    rig.forget()
    sample_rig = rig_motion.sample_rig
    monkeypatch.setattr(rig_motion, "sample_rig", lambda *args: read.append(args[1:3]) or sample_rig(*args))
    assert apart(play(playing, range(1, 13)), whole) == 0.0
    assert all(end - first == 1 for first, end in read[1:])


# Changes while it plays --------------------------------------------------------------------------------------------


def test_other_materials_go_on_from_where_the_tissue_is(playing):
    before = play(playing, range(1, 9))
    play(playing, [9, 10, 8])  # two frames further, and back
    playing.dynamorph.targets[0].stiffness = playing.dynamorph.targets[1].stiffness = 1500.0
    after = play(playing, range(9, 19))
    step = np.abs(np.diff(np.concatenate([before, after[:2]]), axis=0)).max(axis=(1, 2))
    assert step[7] < 2 * step[:7].max()
    rest = baked(playing)  # it is softer from the first frame on
    playing.dynamorph.targets[0].stiffness = playing.dynamorph.targets[1].stiffness = 2e4
    as_before = baked(playing)
    assert apart(after, as_before[8:18]) > 1e-3 and apart(after[0], as_before[8]) < apart(after[0], rest[8])


def test_the_same_settings_written_again_change_nothing(playing):
    play(playing, range(1, 9))
    player = session(playing).tissue.player
    playing.dynamorph.targets[1].stiffness = playing.dynamorph.targets[1].stiffness
    play(playing, [9])
    assert session(playing).tissue.player is player


def test_another_pose_of_a_target_counts_at_once(playing):
    play(playing, range(1, 15))
    _, weights = values_at(playing, 14)
    playing.dynamorph.active_target_index = 1
    bpy.ops.dynamorph.capture_pose()  # of frame 14
    play(playing, [15])
    assert values_at(playing, 15)[1] == pytest.approx([0, 1])
    assert values_at(playing, 14)[1] == pytest.approx(weights)


def test_steps_of_another_length_begin_a_session(playing):
    play(playing, range(1, 6))
    playing.dynamorph.simulation.substeps = 2
    (shown,) = play(playing, [6])
    assert apart(shown, begun_at(playing, 6)) < 1e-6


def test_edited_animation_is_read_again(playing):
    play(playing, range(1, 6))
    bone = rig_of(playing).pose.bones["lower"]
    bone.rotation_euler.x = -1.0
    bone.keyframe_insert("rotation_euler", frame=8)
    bpy.context.view_layer.update()
    play(playing, range(6, 9))
    assert values_at(playing, 8)[1] == pytest.approx([1, 0], abs=1e-6)


def test_another_frame_map_counts_at_once(playing):
    play(playing, range(1, 6))
    bpy.context.scene.render.frame_map_old, bpy.context.scene.render.frame_map_new = 100, 50
    assert apart(play(playing, range(1, 9)), baked(playing)[:8]) < 1e-6


def test_gains_and_solo_show_at_once(playing):
    play(playing, range(1, 9))
    coordinates, weights = values_at(playing, 8)
    modes, tissue = playing.dynamorph.modes, session(playing).tissue
    static = tissue.player.static(weights)
    assert [mode.name for mode in modes][:2] == ["Mode 01", "Mode 02"] and len(modes) == 8
    modes[2].solo = True
    modes[2].gain = 2.0
    alone = static.copy()
    alone[2] += 2.0 * (coordinates - static)[2]
    expected = tissue.points(np.concatenate([alone, weights])).reshape(-1, 3)
    assert apart(surface(playing), expected) < 1e-7
    assert bpy.ops.dynamorph.reset_gains() == {"FINISHED"}
    assert apart(surface(playing), baked(playing)[7]) < 1e-6


def test_motion_amount_of_a_target_shows_at_once_and_as_in_the_bake(playing):
    whole = play(playing, range(1, 21))
    playing.dynamorph.targets["flexed"].amount = 0.0
    bake, static = baked(playing), session(playing).tissue.player.static
    assert apart(surface(playing), bake[-1]) < 1e-6 < apart(whole[-1], bake[-1])
    _, weights = values_at(playing, 20)
    expected = session(playing).tissue.points(np.concatenate([static(weights), weights])).reshape(-1, 3)
    assert apart(surface(playing), expected) < 1e-6
    assert apart(play(playing, range(1, 21)), bake) < 1e-6
    playing.dynamorph.targets["flexed"].amount = 1.0
    assert apart(play(playing, range(1, 21)), whole) < 1e-6


def test_a_motion_amount_that_is_not_a_number_is_refused(playing):
    play(playing, range(1, 4))
    playing.dynamorph.targets["flexed"].amount = float("nan")
    stopped(playing, "press Reset Amounts")
    with pytest.raises(errors.SceneError, match="Amount of target 'flexed' is nan, but must be"):
        baked(playing)


def test_a_gain_that_is_not_a_number_is_not_shown(playing):
    play(playing, range(1, 4))
    playing.dynamorph.modes[0].gain = float("nan")
    stopped(playing, "press Reset Amounts")
    assert np.isfinite(surface(playing)).all()
    bpy.ops.dynamorph.reset_gains()
    bpy.context.view_layer.update()
    play(playing, [5])


def test_amount_shows_at_once_and_as_in_the_bake(playing, monkeypatch):
    play(playing, range(1, 10))
    whole, player, simulated = surface(playing), Player, []

    def moved():
        return displacements(playing)[playing.session_uid]

    heat = moved()
    assert heat.max() > 0.05
    for amount in (0.5, 0.0, 2.0):
        with monkeypatch.context() as patch:
            for step in ("begin", "steps", "advance"):
                patch.setattr(player, step, lambda *args: simulated.append(args))
            playing.dynamorph.simulation.amount = amount
        assert not simulated
        assert apart(surface(playing), baked(playing)[8]) < 1e-6
        np.testing.assert_allclose(moved(), amount * heat, rtol=1e-4, atol=1e-6)
    playing.dynamorph.simulation.amount = 1.0
    assert apart(surface(playing), whole) < 1e-9


def test_a_feel_shows_while_it_plays(playing):
    play(playing, range(1, 6))
    before = surface(playing)
    bpy.ops.dynamorph.apply_feel(feel="SUBTLE")
    assert run_live.problem(playing) == "" and session(playing).last == 5
    play(playing, range(6, 10))
    assert apart(surface(playing), before) > 0.0


def test_plain_skinning_in_the_place_of_live(playing):
    scene = bpy.context.scene
    soft = play(playing, range(1, 8))
    key, flexed = (playing.data.shape_keys.key_blocks[name] for name in ("Dynamorph Live", "flexed"))
    before = fingerprint(playing)
    bpy.ops.dynamorph.show_plain()
    assert key.mute and not flexed.mute and comparison.is_plain(playing)
    play(playing, range(8, 10))  # it continues invisibly
    scene.frame_set(7)
    bpy.ops.dynamorph.show_plain()
    assert apart(surface(playing), soft[-1]) < 1e-6 and fingerprint(playing) == before
    bpy.ops.dynamorph.show_plain()
    bpy.ops.dynamorph.live()
    assert not flexed.mute and "Dynamorph Live" not in playing.data.shape_keys.key_blocks


def test_gains_are_in_the_bake_too(playing):
    for mode in playing.dynamorph.modes:
        mode.gain = 0.5
    shown = play(playing, range(1, 21))
    bpy.ops.dynamorph.bake()
    bpy.context.scene.frame_set(12)
    playing.modifiers["Armature"].show_viewport = False
    assert apart(evaluated_points(playing), shown[11]) < 1e-5


# On and off --------------------------------------------------------------------------------------------------------


def test_off_leaves_no_trace(live_arm):
    live_arm.data.shape_keys.key_blocks["flexed"].mute = True
    live_arm.data.shape_keys.key_blocks["smile"].value = 0.3
    live_arm.active_shape_key_index = 1
    before = fingerprint(live_arm)
    bpy.ops.dynamorph.live()
    keys = live_arm.data.shape_keys.key_blocks
    assert keys["Dynamorph Live"].value == 1.0 and keys["flexed"].mute and not keys["smile"].mute
    play(live_arm, range(1, 5))
    bpy.context.scene.frame_set(1)
    bpy.ops.dynamorph.live()
    assert fingerprint(live_arm) == before


def test_undo_of_the_button(live_arm):
    bpy.ops.ed.undo_push(message="before")
    before = fingerprint(live_arm)
    bpy.ops.dynamorph.live()
    bpy.ops.ed.undo_push(message="live")
    play(live_arm, range(1, 5))
    bpy.ops.ed.undo()
    obj = bpy.data.objects["Arm"]
    bpy.context.scene.frame_set(1)
    assert fingerprint(obj) == before and not run_live.is_on(obj)
    bpy.ops.ed.redo()
    obj = bpy.data.objects["Arm"]
    assert run_live.is_on(obj)
    assert apart(play(obj, range(1, 6)), baked(obj)[:5]) < 1e-6


def test_undo_while_it_plays_goes_on(playing):
    bpy.ops.ed.undo_push(message="live")
    play(playing, range(1, 6))
    playing.dynamorph.targets[1].density = 500.0
    bpy.ops.ed.undo_push(message="denser")
    bpy.ops.ed.undo()
    obj = bpy.data.objects["Arm"]
    assert apart(play(obj, [6, 7]), baked(obj)[5:7]) < 1e-6


def test_it_goes_on_playing_after_save_and_load(playing, tmp_path):
    whole = play(playing, range(1, 6))
    path = str(tmp_path / "live.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    obj = bpy.data.objects["Arm"]
    obj.data.shape_keys.key_blocks["Dynamorph Live"].name = "renamed"
    bpy.context.view_layer.update()
    assert obj.dynamorph.live.key.name == "renamed"
    obj.data.shape_keys.key_blocks["renamed"].name = "Dynamorph Live"
    bpy.context.view_layer.update()
    assert apart(play(obj, range(1, 6)), whole) < 1e-6


def test_renamed_and_moved_keys_are_followed(playing):
    play(playing, range(1, 4))
    keys = playing.data.shape_keys.key_blocks
    keys["flexed"].name = "biceps"
    keys["Dynamorph Live"].name = "wobble"
    playing.active_shape_key_index = keys.find("wobble")
    bpy.ops.object.shape_key_move(type="TOP")
    bpy.context.view_layer.update()
    bpy.context.scene.frame_set(4)
    assert playing.dynamorph.live.key.name == "wobble" and run_live.problem(playing) == ""
    bpy.ops.dynamorph.live()
    assert [(key.name, key.mute) for key in keys] == [("Basis", False), ("biceps", False), ("smile", False)]


def test_a_deleted_live_key_is_live_turned_off(playing):
    play(playing, range(1, 4))
    playing.shape_key_remove(playing.data.shape_keys.key_blocks["Dynamorph Live"])
    bpy.context.view_layer.update()
    assert not run_live.is_on(playing) and not playing.data.shape_keys.key_blocks["flexed"].mute
    bpy.context.scene.frame_set(5)


def test_a_bake_replaces_live(playing):
    play(playing, range(1, 4))
    assert bpy.ops.dynamorph.bake() == {"FINISHED"}
    keys = playing.data.shape_keys.key_blocks
    assert "Dynamorph Live" not in keys and keys["flexed"].mute and not run_live.is_on(playing)
    bpy.ops.dynamorph.delete_bake()
    assert not keys["flexed"].mute
    assert bpy.ops.dynamorph.live() == {"FINISHED"}


# Over a bake -------------------------------------------------------------------------------------------------------


@pytest.fixture(params=["MODES", "PC2"])
def over_a_bake(live_arm, tmp_path, request):
    """The arm, baked, and what Blender shows of the bake at frame 9."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    live_arm.dynamorph.output.format = request.param
    bpy.ops.dynamorph.bake()
    bpy.context.scene.frame_set(9)
    return live_arm, evaluated_points(live_arm)


def at_nine(obj):
    bpy.context.scene.frame_set(9)
    return evaluated_points(obj)


def test_live_plays_over_a_bake_which_stays(over_a_bake):
    arm, shown = over_a_bake
    before = fingerprint(arm)
    bpy.context.scene.frame_set(1)
    assert bpy.ops.dynamorph.live() == {"FINISHED"} and arm.dynamorph.bake.exists
    arm.dynamorph.simulation.amount = 0.0
    play(arm, range(2, 10))
    still = evaluated_points(arm)
    assert apart(still, shown) > 1e-3, "the bake shows, or both do"
    arm.dynamorph.simulation.amount = 1.0
    assert apart(at_nine(arm), shown) < 1e-4, "Live shows something else than the bake"
    bpy.ops.dynamorph.live()
    assert fingerprint(arm) == before and apart(at_nine(arm), shown) < 1e-6


def test_a_file_saved_with_live_over_a_bake_plays_the_bake(over_a_bake, tmp_path):
    arm, shown = over_a_bake
    muted = {block.name: block.mute for block in arm.data.shape_keys.key_blocks}
    bpy.ops.dynamorph.live()
    seen = []
    look = lambda *_: seen.append({b.name: b.mute for b in arm.data.shape_keys.key_blocks})  # noqa: E731
    bpy.app.handlers.save_post.insert(0, look)
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "live.blend"))
    finally:
        bpy.app.handlers.save_post.remove(look)
    assert seen == [muted | {"Dynamorph Live": True}] and run_live.is_on(arm)
    bpy.ops.dynamorph.live()
    assert apart(at_nine(arm), shown) < 1e-6


def test_a_bake_that_is_deleted_under_live(over_a_bake):
    arm, _ = over_a_bake
    bpy.ops.dynamorph.live()
    play(arm, range(2, 5))
    assert bpy.ops.dynamorph.delete_bake() == {"FINISHED"}
    keys = arm.data.shape_keys.key_blocks
    assert run_live.is_on(arm) and keys["flexed"].mute and not keys["Dynamorph Live"].mute
    bpy.ops.dynamorph.live()
    assert not keys["flexed"].mute and keys.keys() == ["Basis", "flexed", "smile"]


def test_another_bake_under_live(over_a_bake):
    arm, shown = over_a_bake
    bpy.ops.dynamorph.live()
    bpy.ops.dynamorph.bake()
    assert not run_live.is_on(arm) and apart(at_nine(arm), shown) < 1e-4
    bpy.ops.dynamorph.delete_bake()
    assert not arm.data.shape_keys.key_blocks["flexed"].mute


def test_plain_skinning_with_live_over_a_bake(over_a_bake):
    arm, shown = over_a_bake
    bpy.ops.dynamorph.live()
    live = evaluated_points(arm)
    for plain in (True, False):
        bpy.ops.dynamorph.show_plain()
        assert comparison.is_plain(arm) == plain
    assert apart(evaluated_points(arm), live) < 1e-6
    bpy.ops.dynamorph.show_plain()
    bpy.ops.dynamorph.live()
    assert not comparison.is_plain(arm) and apart(at_nine(arm), shown) < 1e-6
    bpy.ops.dynamorph.show_plain()
    bpy.ops.dynamorph.live()
    assert not comparison.is_plain(arm)
    play(arm, range(1, 10))
    assert apart(evaluated_points(arm), shown) < 1e-4


def test_a_shake_test_over_a_bake(over_a_bake):
    arm, shown = over_a_bake
    before = fingerprint(arm)
    assert bpy.ops.dynamorph.shake_test(kind="HOP", seconds=0.2) == {"FINISHED"}
    assert fingerprint(arm) == before and apart(at_nine(arm), shown) < 1e-6


# What is in the way ------------------------------------------------------------------------------------------------


def test_needs_a_model(soft_arm, monkeypatch):
    """In a window the button builds it first."""
    refused(bpy.ops.dynamorph.live, "Press Build Model first: not built yet")
    pressed = []
    monkeypatch.setattr(playback, "press", lambda _by, name: pressed.append(name))
    monkeypatch.setattr(playback.bpy, "app", types.SimpleNamespace(background=False))
    operator = types.SimpleNamespace(execute=lambda _context: {"FINISHED"})
    assert playback.DYNAMORPH_OT_live.invoke(operator, bpy.context, None) == {"CANCELLED"}
    assert pressed == ["dynamorph.build_live"]


def test_a_build_for_live_ends_live_without_a_hop(live_arm, monkeypatch):
    live_arm.dynamorph.model.modes = 5
    seen = FirstLook(live_arm, monkeypatch, operator="DYNAMORPH_OT_build_live")
    assert seen.result == {"FINISHED"} and run_live.is_on(live_arm) and seen.pressed == []


def test_live_goes_on_after_a_build(playing):
    play(playing, range(1, 6))
    playing.dynamorph.model.modes = 4
    bpy.context.scene.frame_set(6)
    assert run_live.problem(playing)
    bpy.ops.dynamorph.build()
    assert run_live.problem(playing) == "" and session(playing).tissue.modes == 4


def test_a_model_out_of_date_is_refused(live_arm):
    live_arm.data.shape_keys.key_blocks["flexed"].points[3].co.x += 0.01
    before = fingerprint(live_arm)
    with pytest.raises(RuntimeError, match="out of date .*shape of 'flexed' changed"):
        bpy.ops.dynamorph.live()
    assert fingerprint(live_arm) == before


# Full Quality -----------------------------------------------------------------------------------------------------


def test_final_quality_plays_what_it_bakes_without_another_build(live_arm):
    settings, content_id = live_arm.dynamorph, live_arm.dynamorph.model.content_id
    reduced = baked(live_arm)
    settings.model.solver = "FULL"
    bpy.ops.dynamorph.live()
    shown = play(live_arm, range(1, 21))
    assert settings.model.content_id == content_id
    bpy.ops.dynamorph.live()
    assert apart(shown, baked(live_arm)) < 1e-5 < 1e-3 < apart(shown, reduced)


def test_quality_changes_while_it_plays(playing):
    reduced = play(playing, range(1, 11))
    playing.dynamorph.model.solver = "FULL"
    assert play(playing, range(1, 11)).shape == reduced.shape and not session(playing).tissue.modes
    playing.dynamorph.model.solver = "REDUCED"
    assert np.array_equal(play(playing, range(1, 11)), reduced)
    assert session(playing).tissue.modes == 8


def test_frames_that_take_too_much_memory_are_simulated_again(live_arm, monkeypatch):
    monkeypatch.setattr(run_session, "KEPT", 4)
    monkeypatch.setattr(run_session, "FRAME_BYTES", 0)
    live_arm.dynamorph.model.solver = "FULL"
    bpy.ops.dynamorph.live()
    there = play(live_arm, range(1, 13))
    assert np.array_equal(play(live_arm, [9, 10, 11, 12]), there[-4:])  # the latest frames are remembered
    assert not np.array_equal(play(live_arm, [5])[0], there[4])  # it starts over where there is none
    play(live_arm, range(6, 13))


def test_a_single_mode_needs_reduced_quality(live_arm):
    live_arm.dynamorph.model.solver = "FULL"
    with pytest.raises(RuntimeError, match="set Quality to Reduced"):
        bpy.ops.dynamorph.play_mode()
    assert bpy.ops.dynamorph.shake_test(kind="HOP", seconds=0.5) == {"FINISHED"}


def stopped(obj, words):
    bpy.context.scene.frame_set(bpy.context.scene.frame_current + 1)
    assert words in run_live.problem(obj)


def test_a_model_that_ages_stops_it_until_it_is_built(playing):
    play(playing, range(1, 4))
    playing.dynamorph.model.modes = 6
    stopped(playing, "out of date")
    batch.run(Job(playing, goal="BUILD"))
    play(playing, range(5, 7))
    assert len(playing.dynamorph.modes) == 6 and session(playing).tissue.modes == 6


def test_what_else_stops_it_says_so(playing):
    play(playing, range(1, 4))
    bpy.data.objects.remove(rig_of(playing))
    bpy.context.view_layer.update()
    stopped(playing, "no Armature modifier")
    bpy.ops.dynamorph.live()
    assert "Dynamorph Live" not in playing.data.shape_keys.key_blocks


@pytest.mark.fault("M14")
def test_a_mesh_with_other_vertices_stops_it(playing):
    play(playing, range(1, 4))
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.context.scene.frame_set(5)
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.subdivide()
    bpy.context.scene.frame_set(6)
    bpy.ops.object.mode_set(mode="OBJECT")
    stopped(playing, "vertices, its model")


@pytest.mark.fault("G03", "G08")
def test_deleted_objects_and_other_scenes_are_left_alone(playing):
    play(playing, range(1, 4))
    other = bpy.data.scenes.new("Other")
    other.collection.objects.link(playing)
    shown = surface(playing)
    other.frame_set(9)
    assert apart(surface(playing), shown) == 0.0
    bpy.data.objects.remove(playing)
    bpy.context.scene.frame_set(5)
    assert not remembered.live.sessions


def test_another_file_begins_afresh(playing, tmp_path):
    path, state = str(tmp_path / "live.blend"), remembered.live
    play(playing, range(1, 4))
    bpy.ops.wm.save_as_mainfile(filepath=path)
    state.problems[1], state.frozen, state.hidden = ("no", ()), {2}, [3]
    state.suspended, state.any_live = {4}, True
    bpy.ops.wm.open_mainfile(filepath=path)
    assert state == type(state)(asleep=False)  # it has looked for what is live
    bpy.context.scene.frame_set(4)
    assert state.sessions and state.any_live


@pytest.mark.fault("G08")
def test_two_scenes_that_play_alternately_go_on(playing):
    """As in two windows; each has its own copy of the character."""
    window, first = bpy.context.window, bpy.context.scene
    bpy.ops.scene.new(type="FULL_COPY")
    copy = next(obj for obj in bpy.context.scene.objects if obj.name.startswith("Arm") and obj.type == "MESH")
    window.scene = first
    alone = play(playing, range(1, 11))
    shown = []
    for frame in range(1, 11):
        for scene, obj in ((first, playing), (copy.users_scene[0], copy)):
            window.scene = scene
            scene.frame_set(frame)
            shown.append(surface(obj))
    for each in (shown[::2], shown[1::2]):
        assert apart(np.array(each), alone) < 1e-6
    window.scene = first
    rig_of(playing).pose.bones["lower"].location.z = 0.3
    rig_of(playing).pose.bones["lower"].keyframe_insert("location", frame=5)
    bpy.context.view_layer.update()
    assert copy.session_uid not in remembered.live.sessions  # what was edited may move it too


def test_two_characters_and_a_copy(playing):
    play(playing, range(1, 4))
    playing.select_set(True)
    bpy.ops.object.duplicate()
    copy = bpy.context.object
    bpy.context.scene.frame_set(4)
    assert copy != playing and len(remembered.live.sessions) == 2
    activate(copy)
    bpy.ops.dynamorph.live()
    assert run_live.is_on(playing) and not run_live.is_on(copy)
    assert apart(play(playing, [5]), baked(playing)[4]) < 1e-6


def test_rendering_in_the_background_simulates(playing):
    scene = bpy.context.scene
    whole = baked(playing)
    scene.frame_set(1)
    play(playing, range(2, 6))
    assert not run_live.holds_still(scene)
    assert apart(surface(playing), whole[4]) < 1e-6


# The first look at a new soft skin -----------------------------------------------------------------------------------


class FirstLook(Pressed):
    """`first_look` pressed in a window; pressed: the buttons that it calls next."""

    def __init__(self, obj, monkeypatch, events=(), operator="DYNAMORPH_OT_first_look"):
        self.pressed = []
        monkeypatch.setattr(playback, "press", lambda _by, name, **given: self.pressed.append((name, given)))
        super().__init__(obj, events, operator=operator)


@pytest.fixture
def new_arm(arm):
    """A soft skin that was just added, with a coarse cage."""
    bpy.ops.dynamorph.add_soft_skin()
    arm.dynamorph.model.cage_nodes, arm.dynamorph.model.modes = 200, 8
    arm.dynamorph.model.method = "SINGLE"
    return arm


def test_a_new_soft_skin_ends_live_and_hops(new_arm, monkeypatch):
    seen = FirstLook(new_arm, monkeypatch)
    assert seen.result == {"FINISHED"} and new_arm.dynamorph.model.content_id
    assert run_live.is_on(new_arm) and run_live.problem(new_arm) == ""
    assert seen.pressed == [("dynamorph.shake_test", {"kind": "HOP", "seconds": 2.0, "then_plays": True})]
    assert ("ERROR",) not in {report[:1] for report in seen.reports}


def test_a_build_that_fails_leaves_the_soft_skin(new_arm, monkeypatch):
    new_arm.modifiers.clear()
    seen = FirstLook(new_arm, monkeypatch)
    assert seen.result == {"CANCELLED"} and seen.reports[-1][0] == "ERROR" and seen.pressed == []
    assert new_arm.dynamorph.targets and not run_live.is_on(new_arm)


def test_escape_leaves_the_soft_skin_too(new_arm, monkeypatch):
    seen = FirstLook(new_arm, monkeypatch, ["TIMER", "ESC"])
    assert seen.result == {"CANCELLED"} and seen.reports == [("WARNING", "Canceled: nothing was changed")]
    assert new_arm.dynamorph.targets and seen.pressed == []


def test_without_a_window_nothing_is_built(arm):
    assert bpy.ops.dynamorph.add_soft_skin("INVOKE_DEFAULT") == {"FINISHED"}
    assert arm.dynamorph.targets and not arm.dynamorph.model.content_id and not run_live.is_on(arm)


def test_undo_of_the_first_look(new_arm, monkeypatch):
    """The two undo steps as Blender names them: the model with Live, and the soft skin."""
    bpy.ops.ed.undo_push(message="Add Soft Skin")
    FirstLook(new_arm, monkeypatch)
    bpy.ops.ed.undo_push(message="Build Soft Skin")
    bpy.ops.ed.undo()
    arm = bpy.data.objects["Arm"]
    assert arm.dynamorph.targets and not arm.dynamorph.model.content_id and not run_live.is_on(arm)
    bpy.ops.ed.redo()
    arm = bpy.data.objects["Arm"]
    assert run_live.is_on(arm)
    assert apart(play(arm, [2]), surface(arm)) == 0.0


def test_a_hop_of_two_seconds(live_arm, shown):
    assert bpy.ops.dynamorph.shake_test(kind="HOP", seconds=2.0) == {"FINISHED"}
    assert len(shown) == 49
    shown.clear()
    live_arm.dynamorph.simulation.speed = 0.5  # twice as many in slow motion
    assert bpy.ops.dynamorph.shake_test(kind="HOP", seconds=2.0) == {"FINISHED"}
    assert len(shown) == 97


def test_keys_that_only_hold_a_pose_are_no_animation(arm):
    rig = rig_of(arm)
    assert animation.is_animated(skinning_of(arm))
    rig.animation_data_clear()
    rig.pose.bones["lower"].keyframe_insert("rotation_euler", frame=1)
    assert not animation.is_animated(skinning_of(arm))


def test_live_that_stood_still_in_a_render_is_told_afterward(live_arm, monkeypatch):
    live, scene = run_live, bpy.context.scene
    bpy.ops.dynamorph.live()
    lines = " ".join(drawn(live_arm))
    assert "To render Live, turn on" in lines
    monkeypatch.setattr(live, "holds_still", lambda _scene: True)  # as in a window without Lock Interface
    scene.frame_set(3)
    monkeypatch.undo()
    assert "Live was frozen in the last render: turn on" in " ".join(drawn(live_arm)) and live.stood_still(live_arm)
    assert bpy.ops.dynamorph.fix(problem="LOCK_INTERFACE") == {"FINISHED"} and scene.render.use_lock_interface
    assert "Live st" not in " ".join(drawn(live_arm))


# Previews ----------------------------------------------------------------------------------------------------------


def deltas(obj):
    return [tuple(getattr(obj, name)) for name in run_preview.DELTAS]


@pytest.fixture
def shown(monkeypatch):
    """What previews show, frame by frame: a list of (points (V, 3), world position of the rig)."""
    frames = []
    show = run_preview.Preview.show

    def spy(preview, *frame):
        show(preview, *frame)
        obj = preview.object.find()
        bpy.context.view_layer.update()
        frames.append((surface(obj), tuple(rig_of(obj).matrix_world.translation)))

    monkeypatch.setattr(run_preview.Preview, "show", spy)
    return frames


@pytest.mark.parametrize("kind", ["STOMP", "TWIST", "HOP"])
def test_a_shake_test_moves_the_tissue_and_nothing_stays(live_arm, shown, kind):
    rig = rig_of(live_arm)
    live_arm.parent = rig
    rig.delta_location, rig.delta_rotation_euler = (0.1, 0.0, 0.2), (0.3, 0.0, 0.0)
    bpy.context.view_layer.update()
    before = fingerprint(live_arm), deltas(rig), deltas(live_arm)
    assert bpy.ops.dynamorph.shake_test(kind=kind) == {"FINISHED"}
    assert (fingerprint(live_arm), deltas(rig), deltas(live_arm)) == before
    points, places = np.array([frame[0] for frame in shown]), np.array([frame[1] for frame in shown])
    assert len(points) == 61 and 1e-3 < np.abs(points - points[0]).max() < 0.4
    rise = places[:, 2] - 0.2
    assert rise.max() == pytest.approx({"STOMP": 0.08, "TWIST": 0.0, "HOP": 0.12}[kind] * 2.17, rel=0.05, abs=1e-6)
    assert np.abs(places[-1] - places[0]).max() < 1e-6


def test_a_twist_turns_a_tilted_rig_about_the_vertical(live_arm):
    """Imported rigs lie on their backs, in their own space."""
    rig = rig_of(live_arm)
    live_arm.parent = rig
    rig.rotation_euler = (1.5, 0.2, 0.0)
    bpy.context.view_layer.update()
    tissue = run_tissue.Tissue(live_arm, bpy.context.scene)
    _, transforms = run_preview.shaken(live_arm, tissue, "TWIST")
    assert transforms[:, 2, :] == pytest.approx(np.broadcast_to((0.0, 0.0, 1.0, 0.0), (len(transforms), 4)), abs=1e-9)
    assert transforms[:, 0, 0].min() == pytest.approx(0.5, abs=1e-6)


def test_a_shake_moves_the_rig_as_it_says(live_arm):
    """Rig and mesh, each with a parent, a rotation and deltas of its own, by one world transform."""
    preview = run_preview
    parent = bpy.data.objects.new("Parent", None)
    bpy.context.scene.collection.objects.link(parent)
    parent.rotation_euler, parent.location, parent.scale = (0.2, 0.5, 1.0), (1, 2, 3), (2, 2, 2)
    rig = rig_of(live_arm)
    rig.parent, rig.delta_location, rig.delta_rotation_euler = parent, (0.1, 0.2, 0.3), (0.4, 0.1, 0.0)
    rig.rotation_mode = "ZXY"
    live_arm.rotation_mode, live_arm.delta_rotation_quaternion = "QUATERNION", (0.8, 0.6, 0.0, 0.0)
    live_arm.scale = (-1.0, 1.0, 1.0)
    bpy.context.view_layer.update()
    transform = Matrix.Translation((0.3, -0.2, 0.1)) @ Matrix.Rotation(0.7, 4, (0.6, 0.0, 0.8))
    live_arm.dynamorph.model.hold = "THICKNESS"  # the bones are elsewhere
    bpy.ops.dynamorph.build()
    before = {obj: np.array(obj.matrix_world) for obj in preview.movers(live_arm)}
    running = preview.Preview(live_arm, bpy.types.DYNAMORPH_OT_shake_test)
    running.show(np.concatenate([np.zeros(running.tissue.modes), [1.0, 0.0]]), transform)
    bpy.context.view_layer.update()
    for obj, stood in before.items():
        assert np.array(obj.matrix_world) == pytest.approx(np.array(transform) @ stood, abs=1e-5)
    running.end()
    bpy.context.view_layer.update()
    for obj, stood in before.items():
        assert np.array(obj.matrix_world) == pytest.approx(stood, abs=1e-6)
    assert [obj.name for obj in preview.movers(live_arm)] == ["Arm Rig", "Arm"]
    live_arm.parent = rig
    assert [obj.name for obj in preview.movers(live_arm)] == ["Arm Rig"]


class Playing:
    """The button of a preview, pressed in a window; it has a clock of its own."""

    def __init__(self, obj, operator, monkeypatch, **settings):
        self.now = 0.0  # seconds
        monkeypatch.setattr(playback, "time", types.SimpleNamespace(monotonic=lambda: self.now))
        assert press(obj, operator, self._begin, **settings) == {"RUNNING_MODAL"}

    def _begin(self, button, context):
        self.button = button
        return button.invoke(context, None)

    def send(self, kind="TIMER"):
        """An event and its consequences."""
        return self.button.modal(bpy.context, types.SimpleNamespace(type=kind, value="PRESS"))


def played_after_a_hop(obj, monkeypatch, event="TIMER", **settings) -> list[str]:
    """What is pressed after a hop in a window has reached its end, or got Esc."""
    pressed = []
    monkeypatch.setattr(playback, "press", lambda _by, name: pressed.append(name))
    button = Playing(obj, "DYNAMORPH_OT_shake_test", monkeypatch, kind="HOP", **settings)
    button.now = 10.0
    assert button.send(event) not in ({"RUNNING_MODAL"}, {"PASS_THROUGH"}) and remembered.live.preview is None
    return pressed


def test_the_artists_animation_plays_after_the_hop(live_arm, monkeypatch):
    assert played_after_a_hop(live_arm, monkeypatch, then_plays=True) == ["screen.animation_play"]
    assert played_after_a_hop(live_arm, monkeypatch, "ESC", then_plays=True) == []
    assert played_after_a_hop(live_arm, monkeypatch) == []
    rig_of(live_arm).animation_data_clear()
    assert played_after_a_hop(live_arm, monkeypatch, then_plays=True) == []


@pytest.fixture
def shaken(playing, monkeypatch):
    """A live arm in the middle of a shake test at frame 3, how its rig stood before, and the button of the test."""
    play(playing, range(1, 4))
    bpy.ops.ed.undo_push(message="before")
    bpy.context.scene.frame_set(3)
    bpy.ops.ed.undo_push(message="another")
    stood = deltas(rig_of(playing))
    button = Playing(playing, "DYNAMORPH_OT_shake_test", monkeypatch, kind="HOP")
    button.now = 0.35
    assert button.send() == {"PASS_THROUGH"}
    assert deltas(rig_of(playing)) != stood and run_preview.is_running("dynamorph.shake_test")
    return playing, stood, button


def test_frames_that_pass_do_not_disturb_a_preview(shaken):
    obj, stood, button = shaken
    swung = surface(obj)
    bpy.context.scene.frame_set(4)
    assert apart(surface(obj), swung) == 0.0
    assert button.send("ESC") == {"CANCELLED"} and deltas(rig_of(obj)) == stood
    assert apart(surface(obj), baked(obj)[3]) < 1e-6


def test_undo_ends_a_preview(shaken):
    _, stood, button = shaken
    bpy.ops.ed.undo()
    obj = bpy.data.objects["Arm"]
    assert deltas(rig_of(obj)) == stood and button.send() == {"CANCELLED"}
    assert apart(play(obj, [4]), baked(obj)[3]) < 1e-6


def test_saving_and_loading_end_a_preview(shaken, tmp_path, monkeypatch):
    obj, stood, button = shaken
    path = str(tmp_path / "shaken.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    assert deltas(rig_of(obj)) == stood and button.send() == {"CANCELLED"}
    Playing(obj, "DYNAMORPH_OT_play_mode", monkeypatch)
    bpy.ops.wm.open_mainfile(filepath=path)
    assert remembered.live.preview is None and not remembered.live.suspended
    assert deltas(rig_of(bpy.data.objects["Arm"])) == stood


def test_a_preview_puts_the_shown_sculpt_back(live_arm):
    bpy.context.scene.frame_set(20)
    live_arm.dynamorph.active_target_index = 1
    bpy.ops.dynamorph.go_to_pose()
    flexed, still = live_arm.data.shape_keys.key_blocks["flexed"], evaluated_points(live_arm)
    assert flexed.value == 1.0
    assert bpy.ops.dynamorph.play_mode() == {"FINISHED"}
    assert flexed.value == 1.0 and apart(evaluated_points(live_arm), still) == 0.0
    live_arm.dynamorph.active_target_index = 0
    bpy.ops.dynamorph.go_to_pose()
    assert flexed.value == 0.0


def test_a_mode_plays_alone(live_arm, shown):
    bpy.context.scene.frame_set(20)
    before = fingerprint(live_arm)
    live_arm.dynamorph.active_mode_index = 1
    live_arm.dynamorph.modes[1].gain = 2.0
    assert bpy.ops.dynamorph.play_mode() == {"FINISHED"}
    assert fingerprint(live_arm) == before
    points = np.array([frame[0] for frame in shown])
    sculpted = references.key_points(live_arm.data.shape_keys.key_blocks["flexed"])
    assert apart(points[0], sculpted) < 1e-5  # in its pose
    swings = np.linalg.norm(points - points[0], axis=2).max(axis=1)
    size = run_tissue.Tissue(live_arm, bpy.context.scene).player.size
    assert swings.max() == pytest.approx(2.0 * 0.05 * size, rel=0.01)
    assert apart(points[6] - points[0], points[0] - points[18]) < 1e-6  # a sine


def test_play_mode_is_refused_while_blender_renders(live_arm, monkeypatch):
    before = fingerprint(live_arm)
    monkeypatch.setattr(scene_events, "render_runs", lambda: True)
    refused(bpy.ops.dynamorph.play_mode, "Blender is rendering: wait until it is done")
    assert fingerprint(live_arm) == before


def test_a_mode_that_plays_stands_still_while_blender_renders(live_arm, monkeypatch):
    """A render that begins meanwhile reads what would be written."""
    button, shown = Playing(live_arm, "DYNAMORPH_OT_play_mode", monkeypatch), []
    monkeypatch.setattr(scene_events, "render_runs", lambda: button.now > 0.3)
    for button.now in (0.1, 0.2, 0.3, 0.4, 0.5):
        assert button.send() == {"PASS_THROUGH"}
        shown.append(surface(live_arm))
    assert button.send("ESC") == {"CANCELLED"}
    steps = [apart(first, second) for first, second in pairwise(shown)]
    assert min(steps[:2]) > 1e-4 and steps[2:] == [0.0, 0.0]
    assert remembered.live.preview is None


# Comparing ---------------------------------------------------------------------------------------------------------


def test_slots_swap_and_come_back(playing):
    settings = playing.dynamorph
    play(playing, range(1, 4))
    bpy.ops.dynamorph.swap_slot()
    assert settings.live.slot == "B"
    settings.targets[0].stiffness, settings.simulation.gravity, settings.modes[3].gain = 5e3, 0.5, 1.5
    bpy.ops.dynamorph.swap_slot()
    now = settings.live.slot, settings.targets[0].stiffness, settings.simulation.gravity, settings.modes[3].gain
    assert now == ("A", 2e4, 0.0, 1.0)
    assert session(playing).tissue.player.amounts.gains[3] == 1.0
    bpy.ops.dynamorph.swap_slot()
    now = settings.live.slot, settings.targets[0].stiffness, settings.simulation.gravity, settings.modes[3].gain
    assert now == ("B", 5e3, 0.5, 1.5)
    assert session(playing).tissue.player.amounts.gains[3] == 1.5
    assert session(playing).tissue.character.targets[0].material.stiffness == 5e3
    bpy.ops.dynamorph.copy_slot()
    bpy.ops.dynamorph.swap_slot()
    assert settings.targets[0].stiffness == 5e3 and json.loads(settings.live.other)["gains"][3] == 1.5
    play(playing, [4, 5])


def test_check_targets(live_arm):
    assert bpy.ops.dynamorph.check_targets() == {"FINISHED"}
    lines = live_arm.dynamorph.live.checks.split("\n")
    misses = {name: float(text.removesuffix(" mm")) for name, text in (line.split(": ") for line in lines)}
    assert list(misses) == ["Neutral", "flexed"] and max(misses.values()) < 0.05


def test_disabling_the_add_on_forgets_sessions(playing):
    live = run_live
    play(playing, range(1, 4))
    live.unregister()
    shown = surface(playing)
    bpy.context.scene.frame_set(4)
    assert not remembered.live.sessions and apart(surface(playing), shown) == 0.0
    live.register()
    play(playing, [5])
    assert all(list(getattr(bpy.app.handlers, name)).count(handler) == 1 for name, handler in live.HANDLERS.items())


# Without the add-on ------------------------------------------------------------------------------------------------


def key_mutes(obj) -> dict:
    return {key.name: key.mute for key in obj.data.shape_keys.key_blocks[1:]}


def assert_turns_off(obj):
    """Turning Live off leaves the keys as they were before."""
    activate(obj)
    bpy.ops.dynamorph.live()
    assert key_mutes(obj) == {"flexed": False, "smile": False}


LIVE = {"flexed": True, "smile": False, "Dynamorph Live": False}
ASLEEP = {"flexed": False, "smile": False, "Dynamorph Live": True}


def in_file(path):
    """The arm as a file has it, linked, so that no handler has seen it."""
    with bpy.data.libraries.load(str(path), link=True) as (_, wanted):
        wanted.objects = ["Arm"]
    return wanted.objects[0]


def test_a_saved_file_has_no_frozen_skin(playing, tmp_path):
    whole = play(playing, range(1, 10))
    shown, path = evaluated_points(playing), tmp_path / "live.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    assert key_mutes(playing) == LIVE and apart(evaluated_points(playing), shown) == 0.0
    play(playing, [10])
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    assert key_mutes(in_file(path)) == ASLEEP
    bpy.ops.wm.open_mainfile(filepath=str(path))
    obj = bpy.data.objects["Arm"]
    assert key_mutes(obj) == LIVE and run_live.is_on(obj)
    assert apart(play(obj, range(1, 10)), whole) < 1e-6
    assert_turns_off(obj)


def test_a_copy_is_saved_like_a_file(playing, tmp_path):
    play(playing, range(1, 5))
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "copy.blend"), copy=True)
    assert key_mutes(playing) == LIVE
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    assert key_mutes(in_file(tmp_path / "copy.blend")) == ASLEEP


def autosaved(path):
    """Write the .blend as Blender's autosave and quit.blend do, which call no handler."""
    lists = bpy.app.handlers.save_pre, bpy.app.handlers.save_post
    before = [list(handlers) for handlers in lists]
    for handlers in lists:
        handlers.clear()
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    for handlers, each in zip(lists, before, strict=True):
        handlers[:] = each


def test_an_autosave_is_recovered_with_live_on(playing, tmp_path):
    whole = play(playing, range(1, 10))
    shown, path = evaluated_points(playing), tmp_path / "autosave.blend"
    autosaved(path)
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(path))
    obj = bpy.data.objects["Arm"]
    assert key_mutes(obj) == LIVE and run_live.is_on(obj) and apart(evaluated_points(obj), shown) < 1e-6
    assert apart(play(obj, range(1, 10)), whole) < 1e-6
    assert_turns_off(obj)


def test_an_autosave_after_the_live_key_was_renamed(playing, tmp_path):
    play(playing, range(1, 10))
    playing.data.shape_keys.key_blocks["Dynamorph Live"].name = "mine"
    autosaved(tmp_path / "autosave.blend")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "autosave.blend"))
    obj = bpy.data.objects["Arm"]
    assert run_live.is_on(obj)
    assert_turns_off(obj)


@pytest.mark.parametrize("was_live", [False, True])
def test_an_autosave_of_a_preview_is_recovered_without_it(live_arm, tmp_path, was_live):
    if was_live:
        bpy.ops.dynamorph.live()
    path, stood = tmp_path / "autosave.blend", deltas(rig_of(live_arm))
    running = run_preview.begin_preview(live_arm, playback.DYNAMORPH_OT_shake_test)
    before = evaluated_points(live_arm)
    running.show(np.concatenate([np.full(8, 0.01), [1.0, 0.0]]), Matrix.Translation((0.0, 0.0, 0.5)))
    assert apart(evaluated_points(live_arm), before) > 0.1
    autosaved(path)
    bpy.ops.wm.open_mainfile(filepath=str(path))
    obj = bpy.data.objects["Arm"]
    assert deltas(rig_of(obj)) == stood and run_live.is_on(obj) == was_live
    assert ("Dynamorph Live" in obj.data.shape_keys.key_blocks) == was_live
    bpy.context.scene.frame_set(1)
    assert apart(evaluated_points(obj), before) < 1e-6


def test_a_file_that_cannot_be_saved_goes_on_playing(playing, tmp_path):
    play(playing, range(1, 5))
    with pytest.raises(RuntimeError):
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "no folder" / "live.blend"))
    assert key_mutes(playing) == LIVE
    play(playing, [5])


def test_a_target_that_the_artist_muted_is_saved_muted(live_arm, tmp_path):
    live_arm.data.shape_keys.key_blocks["flexed"].mute = True
    bpy.ops.dynamorph.live()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "live.blend"))
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    assert key_mutes(in_file(tmp_path / "live.blend")) == ASLEEP | {"flexed": True}


def test_disabling_the_add_on_leaves_no_frozen_skin(playing):
    whole = play(playing, range(1, 10))
    addon_utils.disable(MODULE)
    assert key_mutes(playing) == ASLEEP
    addon_utils.enable(MODULE)
    assert apart(play(playing, range(1, 10)), whole) < 1e-6 and key_mutes(playing) == LIVE


# Paint -------------------------------------------------------------------------------------------------------------


def test_a_stroke_of_paint_shows_without_a_build(arm):
    """What is painted softer moves more, and the stored model stays; a build then shows the same, nearly."""
    activate(arm)
    bpy.ops.dynamorph.add_soft_skin()
    arm.dynamorph.model.cage_nodes, arm.dynamorph.model.modes = 400, 40
    rig, frames = rig_of(arm), range(1, 37)
    for frame in frames:  # far below its bounce
        rig.location.z = 0.3 * np.sin(frame / 24 * 2.0 * np.pi)
        rig.keyframe_insert("location", frame=frame)
    bpy.ops.dynamorph.build()
    bpy.ops.dynamorph.live()
    before, built = np.ptp(play(arm, frames), axis=0), arm.dynamorph.model.content_id
    bpy.ops.dynamorph.paint_firmness()
    with soon():
        arm.vertex_groups["Firmness"].add(range(len(arm.data.vertices)), 0.25, "REPLACE")
        arm.data.update()
        bpy.context.view_layer.update()
    softer = np.ptp(play(arm, frames), axis=0)
    assert softer.max() > 1.2 * before.max() and arm.dynamorph.model.content_id == built
    bpy.ops.dynamorph.paint_firmness()  # done: the model is out of date, and Live goes on
    assert staleness.model_age(arm) and not run_live.problem(arm)
    np.testing.assert_array_equal(np.ptp(play(arm, frames), axis=0), softer)
    bpy.ops.dynamorph.build()
    assert arm.dynamorph.model.content_id != built
    assert np.ptp(play(arm, frames), axis=0).max() == pytest.approx(softer.max(), rel=0.15)
