# SPDX-License-Identifier: GPL-3.0-or-later
"""The NLA on both sides of a bake: rigs that its strips move, and strips of the bake itself that are edited."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene import animation, references
from bl_ext.user_default.dynamic_morph_targets.write.bake import influence as bake_influence
from bl_ext.user_default.dynamic_morph_targets.write.bake import writer
from builders import fingerprint, hand_made_bake, keys_of, make_mesh, rig_of, skinning_of, soon

FIRST, LAST = 1, 20  # of the bakes
STEPS = 4  # a frame


# The rig's strips --------------------------------------------------------------------------------------------------


@pytest.fixture
def swaying(soft_arm):
    """The soft arm with a coarse cage, whose rig sways and turns; and the action of the rig, which nothing plays."""
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    soft_arm.dynamorph.model.cage_nodes, soft_arm.dynamorph.model.modes = 200, 6
    soft_arm.dynamorph.simulation.substeps = STEPS
    rig = soft_arm.parent = rig_of(soft_arm)
    for frame, (x, bend) in {1: (0.0, 0.0), 6: (0.2, 0.7), 12: (-0.1, 0.3), 20: (0.1, 1.5)}.items():
        rig.location.x, rig.pose.bones["lower"].rotation_euler.x = x, bend
        rig.keyframe_insert("location", frame=frame)
        rig.pose.bones["lower"].keyframe_insert("rotation_euler", frame=frame)
    action, rig.animation_data.action = rig.animation_data.action, None
    return soft_arm, action


def strip_of(rig, action, start=FIRST, **settings):
    """A strip on a track above the others."""
    strip = rig.animation_data.nla_tracks.new().strips.new("Sway", start, action)
    strip.action_slot = action.slots[0]
    for name, value in settings.items():
        setattr(strip, name, value)
    return strip


def scaled_and_extended(rig, action):
    strip_of(rig, action, 4, scale=0.6, extrapolation="HOLD")


def backward(rig, action):
    strip_of(rig, action, use_reverse=True)


def several_times(rig, action):
    strip_of(rig, action, scale=0.3, repeat=2.5)


def nothing_before_and_after(rig, action):
    strip_of(rig, action, 3, scale=0.5, extrapolation="NOTHING")


def faded(rig, action):
    """One strip fades into another that travels further, by blending and by a keyed influence."""
    strip_of(rig, action, -4, extrapolation="HOLD")
    strip_of(rig, action, 8, scale=0.7, extrapolation="NOTHING", blend_in=5, blend_out=3)
    added = strip_of(rig, action, 2, blend_type="ADD", use_animated_influence=True, use_reverse=True)
    for frame, influence in ((2, 0.0), (10, 0.6), (20, 0.2)):
        added.influence = influence
        added.keyframe_insert("influence", frame=frame)


def key_plainly(rig):
    """Replace the NLA by curves with a key at every step that play the same."""
    scene, times = bpy.context.scene, FIRST + np.arange((LAST - FIRST) * STEPS + 1) / STEPS
    bone = rig.pose.bones["lower"]
    values = []
    for time in times:
        scene.frame_set(int(time), subframe=time % 1)
        values.append((rig.location.copy(), bone.rotation_euler.copy()))
    rig.animation_data_clear()
    for time, (rig.location, bone.rotation_euler) in zip(times, values, strict=True):
        rig.keyframe_insert("location", frame=time)
        bone.keyframe_insert("rotation_euler", frame=time)
    bag = rig.animation_data.action.layers[0].strips[0].channelbag(rig.animation_data.action_slot)
    for curve in bag.fcurves:
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"


def pushed(action, curve, rig, strip):
    """Nothing but pushed down."""


def retimed(action, curve, rig, strip):
    """To half speed, with the keys brought back in the Action."""
    for each in animation.curves(action, action.slots[0]):
        for key in each.keyframe_points:
            for point in (key.co, key.handle_left, key.handle_right):
                point.x = FIRST + (point.x - FIRST) / 2.0
    strip.action_frame_end = FIRST + (LAST - FIRST) / 2.0
    strip.scale = 2.0


def half_speed(action, curve, rig, strip):
    strip.scale = 2.0


def shifted(action, curve, rig, strip):
    strip.frame_start_ui += 5


def cut(action, curve, rig, strip):
    strip.action_frame_end = 12


def cycled(action, curve, rig, strip):
    curve.modifiers.new("CYCLES")


def extrapolated(action, curve, rig, strip):
    curve.extrapolation = "LINEAR"


def twice(action, curve, rig, strip):
    strip_of(rig, action, 8)


@pytest.mark.parametrize(
    "change, same",
    [(pushed, True), (retimed, True), (half_speed, False), (shifted, False), (cut, False), (cycled, False),
     (extrapolated, False), (twice, False), (faded, False), (backward, False)],
)  # fmt: skip
def test_a_strip_is_another_animation_where_it_moves_otherwise(swaying, change, same):
    obj, action = swaying
    rig = rig_of(obj)
    rig.animation_data.action = action
    rig.animation_data.action_slot = action.slots[0]
    before = dict(animation.animation(skinning_of(obj)))
    rig.animation_data.action = None
    if change in (faded, backward):
        change(rig, action)
    else:
        strip = strip_of(rig, action)
        change(action, animation.curves(action, action.slots[0])[0], rig, strip)
    assert (dict(animation.animation(skinning_of(obj))) == before) == same


@pytest.mark.parametrize("playing", [scaled_and_extended, backward, several_times, nothing_before_and_after, faded])
def test_a_rig_that_strips_move_is_baked_as_one_that_is_keyed(swaying, playing):
    obj, action = swaying
    rig = rig_of(obj)
    playing(rig, action)
    job = Job(obj, "BAKE")
    batch.run(job)
    key_plainly(rig)
    plain = Job(obj, "BAKE")
    batch.run(plain)
    assert plain.input.reasons == [] and np.ptp(plain.computation.rig.rig_world[:, 0, 3]) > 0.05
    assert plain.computation.rig.pose == pytest.approx(job.computation.rig.pose, abs=1e-6)
    largest = np.abs(plain.outcome.bake.coordinates - plain.outcome.bake.static).max()
    assert job.outcome.bake.coordinates == pytest.approx(plain.outcome.bake.coordinates, abs=1e-4 * largest)


# The bake's own strips ---------------------------------------------------------------------------------------------


@pytest.fixture
def baked(soft_arm):
    """The arm with a bake, and its data."""
    bake = hand_made_bake(soft_arm, range(FIRST, LAST + 1))
    writer.write_keys(soft_arm, bake)
    return soft_arm, bake


FRAMES = (-3, 1, 2.5, 6, 10, 13, 19, 20, 21, 24, 30, 38, 39, 45)


def strips_of(obj):
    """The strips of the targets' shapes and of the motion."""
    return [track.strips[0] for track in keys_of(obj).animation_data.nla_tracks]


def timing(strip) -> tuple:
    return strip.frame_start, strip.frame_end, strip.scale, strip.repeat, strip.use_reverse, strip.action_frame_start


def shown(obj) -> np.ndarray:
    """Displacement (V, 3) by the shape keys as Blender evaluates them now."""
    for modifier in obj.modifiers:
        modifier.show_viewport = False
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    points = np.empty((len(evaluated.data.vertices), 3), np.float32)
    evaluated.data.attributes["position"].data.foreach_get("vector", points.ravel())
    return points - references.key_points(keys_of(obj).reference_key)


def displacement(bake, time, influence=1.0) -> np.ndarray:
    """The displacement that the bake shows at a time; it holds before and after its frames."""

    def at(rows):
        return np.array([np.interp(time, bake.frames, column) for column in rows.T])

    static = at(bake.static)
    moved = static + influence * (at(bake.coordinates) - static)
    return np.tensordot(moved, bake.modes, 1) + np.tensordot(at(bake.weights), bake.residual_shapes, 1)


def assert_plays(obj, bake, time_at, frames, influence_at=lambda frame: 1.0):
    for frame in frames:
        bpy.context.scene.frame_set(int(frame), subframe=frame % 1)
        expected = displacement(bake, time_at(frame), influence_at(frame))
        assert shown(obj) == pytest.approx(expected, abs=1e-5 * np.abs(expected).max()), frame


def slower(strip):
    strip.scale = 2.0


def moved(strip):
    strip.frame_start, strip.frame_end = 7.5, 7.5 + LAST - FIRST


def reversed_(strip):
    strip.use_reverse = True


def repeated(strip):
    strip.repeat = 2.0


def cut(strip):
    strip.action_frame_start, strip.action_frame_end = 5, 12
    strip.frame_start, strip.frame_end = 5, 12


EDITS = [
    (slower, lambda frame: FIRST + (frame - FIRST) / 2),
    (moved, lambda frame: frame - 6.5),
    (reversed_, lambda frame: FIRST + LAST - frame),
    (repeated, lambda frame: FIRST + (frame - FIRST) % (LAST - FIRST) if FIRST < frame < 2 * LAST - FIRST else frame),
    (cut, lambda frame: np.clip(frame, 5, 12)),
]


@pytest.mark.parametrize("edit, time_at", EDITS)
@pytest.mark.parametrize("influence", [1.0, 0.5])
def test_edited_strips_show_what_was_baked(baked, edit, time_at, influence):
    obj, bake = baked
    for strip in strips_of(obj):
        edit(strip)
    strips_of(obj)[1].influence = influence
    assert_plays(obj, bake, time_at, FRAMES, lambda frame: influence)


@pytest.mark.parametrize("edit, time_at", EDITS)
def test_the_strip_of_the_motion_is_enough(baked, edit, time_at):
    """It is enough where all of the motion shows; otherwise the strip of the shapes follows soon after."""
    obj, bake = baked
    with soon():
        edit(strips_of(obj)[1])
        assert_plays(obj, bake, time_at, FRAMES)
        assert timing(strips_of(obj)[0]) != timing(strips_of(obj)[1])
    assert timing(strips_of(obj)[0]) == timing(strips_of(obj)[1])
    strips_of(obj)[1].influence = 0.5
    assert_plays(obj, bake, time_at, FRAMES, lambda frame: 0.5)


def test_what_follows_a_soft_skin_follows_its_strip(baked):
    obj, bake = baked
    vertices = references.key_points(keys_of(obj).reference_key)
    piece = make_mesh(bpy.context.scene, "Piece", vertices, [])
    writer.write_keys(piece, bake, obj)
    with soon():
        moved(strips_of(obj)[1])
        strips_of(obj)[1].scale = 1.5
        bpy.context.view_layer.update()
    assert len({timing(strip) for each in (obj, piece) for strip in strips_of(each)}) == 1
    assert_plays(piece, bake, lambda frame: FIRST + (frame - 7.5) / 1.5, (7.5, 10, 30))


def again(obj, start, copy_action):
    """Second strips of the bake in the tracks of the first, whose action Blender copies or shares."""
    for track in keys_of(obj).animation_data.nla_tracks:
        first = track.strips[0]
        action = first.action.copy() if copy_action else first.action
        strip = track.strips.new("Again", start, action)
        strip.action_slot = next(s for s in action.slots if s.name_display == first.action_slot.name_display)
        strip.action_frame_start, strip.action_frame_end = FIRST, LAST
        strip.frame_start, strip.frame_end = start, start + LAST - FIRST
        strip.blend_type, strip.extrapolation = "REPLACE", "HOLD"


@pytest.mark.parametrize("copy_action", [False, True])
def test_strips_of_one_track_fade_into_each_other(baked, copy_action):
    """The motion fades to the targets' shapes."""
    obj, bake = baked
    again(obj, 30, copy_action)
    motion = keys_of(obj).animation_data.nla_tracks[1]
    for strip in motion.strips:
        strip.use_animated_influence = False
    motion.strips[0].blend_out, motion.strips[1].blend_in = 5, 4

    def time_at(frame):
        return min(frame, LAST) if frame < 30 else frame - 29

    def influence_at(frame):
        return np.interp(frame, [LAST - 5, LAST, 30, 34], [1.0, 0.0, 0.0, 1.0])

    assert_plays(obj, bake, time_at, (-3, 10, 15, 17, 19.5, 20, 25, 30, 31, 33.5, 34, 40, 49, 60), influence_at)


@pytest.mark.parametrize("copy_action", [False, True])
def test_delete_bake_removes_every_strip_of_the_bake(soft_arm, copy_action):
    before = fingerprint(soft_arm)
    writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    again(soft_arm, 30, copy_action)
    for strip in strips_of(soft_arm):
        slower(strip)
    writer.free(soft_arm)
    assert fingerprint(soft_arm) == before


def make_meta(owner):
    """Put the strips of each track of shape keys or of a rig into a Meta strip, as Ctrl-G does."""
    area = bpy.context.window.screen.areas[0]
    before, area.type = area.type, "NLA_EDITOR"
    area.spaces.active.dopesheet.show_only_selected = False
    for strip in animation.strips(owner.animation_data.nla_tracks):
        strip.select = True
    region = next(region for region in area.regions if region.type == "WINDOW")
    with bpy.context.temp_override(window=bpy.context.window, area=area, region=region):
        assert bpy.ops.nla.meta_add() == {"FINISHED"}
    area.type = before


@pytest.mark.parametrize("copy_action", [False, True])
def test_strips_in_meta_strips_are_removed_too(soft_arm, copy_action):
    before = fingerprint(soft_arm)
    for remove in (writer.free, lambda obj: writer.write_keys(obj, hand_made_bake(obj))):
        writer.write_keys(soft_arm, hand_made_bake(soft_arm))
        again(soft_arm, 30, copy_action)
        make_meta(keys_of(soft_arm))
        make_meta(keys_of(soft_arm))  # one within another
        assert [strip.strips[0].type for strip in strips_of(soft_arm)] == ["META", "META"]
        remove(soft_arm)
    assert [strip.type for strip in strips_of(soft_arm)] == ["CLIP", "CLIP"]
    writer.free(soft_arm)
    assert fingerprint(soft_arm) == before
    assert not [action.name for action in bpy.data.actions if action.name.startswith("Dynamorph")]


def test_influence_counts_in_a_meta_strip(baked):
    """It is shown, and a new bake takes it along."""
    obj, bake = baked
    strips_of(obj)[1].influence = 0.25
    make_meta(keys_of(obj))
    strip, name = bake_influence.influence(obj)
    assert getattr(strip, name) == 0.25
    assert_plays(obj, bake, lambda frame: frame, (1, 10, 20), lambda frame: 0.25)
    writer.write_keys(obj, bake)
    assert_plays(obj, bake, lambda frame: frame, (1, 10, 20), lambda frame: 0.25)


def test_strips_of_others_stay_in_a_meta_strip(baked):
    """Blender cannot take a strip out of a Meta strip: that of the bake stays there, and plays nothing."""
    obj, _ = baked
    smile(obj)
    make_meta(keys_of(obj))
    writer.free(obj)
    (meta,) = strips_of(obj)
    assert [(strip.name, strip.action and strip.action.name) for strip in meta.strips] == [
        ("Dynamorph", None),
        ("Smile", "Smile"),
    ]
    assert not [action.name for action in bpy.data.actions if action.name.startswith("Dynamorph")]


def test_what_plays_in_a_meta_strip_of_the_rig_is_noticed(soft_arm):
    rig = rig_of(soft_arm)
    action, rig.animation_data.action = rig.animation_data.action, None
    strip_of(rig, action)
    make_meta(rig)
    digests = [animation.animation(skinning_of(soft_arm))]
    action.layers[0].strips[0].channelbags[0].fcurves[0].keyframe_points[0].co.y += 1.0
    digests.append(animation.animation(skinning_of(soft_arm)))
    rig.animation_data.nla_tracks[0].strips[0].mute = True
    digests.append(animation.animation(skinning_of(soft_arm)))
    assert len(set(map(str, digests))) == 3


def test_another_bake_takes_the_place_of_every_strip(baked):
    obj, bake = baked
    again(obj, 30, copy_action=True)
    writer.write_keys(obj, bake)
    assert [len(track.strips) for track in keys_of(obj).animation_data.nla_tracks] == [1, 1]
    assert_plays(obj, bake, lambda frame: frame, (1, 10, 20, 35))


def smile(obj):
    """Add a strip of the artist to the track of the motion; returns the shape keys."""
    keys, action = keys_of(obj), bpy.data.actions.new("Smile")
    slot = action.slots.new(keys.id_type, "Smile")
    channels = action.layers.new("Layer").strips.new(type="KEYFRAME").channelbag(slot, ensure=True)
    channels.fcurves.new('key_blocks["smile"].value').keyframe_points.insert(1, 0.5)
    strip = keys.animation_data.nla_tracks[1].strips.new("Smile", 60, action)
    strip.action_slot = slot
    return keys


def test_strips_of_others_stay(baked):
    obj, _ = baked
    keys = smile(obj)
    writer.free(obj)
    assert [s.name for track in keys.animation_data.nla_tracks for s in track.strips] == ["Smile"]
    assert "Smile" in bpy.data.actions
