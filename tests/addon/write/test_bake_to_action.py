# SPDX-License-Identifier: GPL-3.0-or-later
"""A bake in slots of the Action that the armature plays, which keeps everything of the artist's in it."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.scene import animation
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from bl_ext.user_default.dynamic_morph_targets.write import actions, reconcile
from bl_ext.user_default.dynamic_morph_targets.write.bake import baked_action, influence, reading, writer
from builders import evaluated_points, fingerprint, hand_made_bake, keys_of, rig_of
from robustness import OPS, bake, coarse, motion
from test_attachments import add_attachment, make_sleeve

SLOTS = ["Dynamorph", "Dynamorph Shapes"]


@pytest.fixture
def arm(soft_arm):
    """An arm whose bakes go to the armature's Action, which also has the slot of a face that smiles."""
    action = rig_of(soft_arm).animation_data.action
    keys = keys_of(soft_arm)
    slot = action.slots.new("KEY", "Face")
    channels = action.layers[0].strips[0].channelbag(slot, ensure=True)
    writer.add_curve(channels, "smile", np.array([1.0, 20.0]), np.array([0.0, 1.0]))
    data = keys.animation_data_create()
    data.action, data.action_slot = action, slot
    soft_arm.dynamorph.output.bake_to_action = True
    return soft_arm


def slots(obj):
    """The names of the slots of the armature's Action, without that of its own."""
    return sorted(slot.name_display for slot in rig_of(obj).animation_data.action.slots)[1:]


def curves_of(obj, name):
    """The paths of the curves in a slot of the armature's Action."""
    action = rig_of(obj).animation_data.action
    slot = next(slot for slot in action.slots if slot.name_display == name)
    return [curve.data_path for curve in animation.curves(action, slot)]


def written(obj, seed=1):
    """A bake without the engine."""
    writer.write_keys(obj, hand_made_bake(obj, seed=seed))


def state(obj):
    """What Delete Bake restores, with the curves of the armature's Action."""
    return fingerprint(obj), {name: curves_of(obj, name) for name in slots(obj)}


def test_the_curves_go_to_slots_of_the_armature_s_action(arm):
    before, count = state(arm), len(bpy.data.actions)
    written(arm)
    assert len(bpy.data.actions) == count and slots(arm) == sorted([*SLOTS, "Face"])
    assert arm.dynamorph.bake.action == rig_of(arm).animation_data.action
    assert curves_of(arm, "Face") == ['key_blocks["smile"].value'] and len(curves_of(arm, "Dynamorph")) > 1
    data = keys_of(arm).animation_data
    assert data.action_slot.name_display == "Face"  # as it was
    writer.free(arm)
    assert state(arm) == before


def test_it_plays_as_in_an_action_of_its_own(arm):
    arm.dynamorph.output.bake_to_action = False
    written(arm)
    shown = motion(arm)
    arm.dynamorph.output.bake_to_action = True
    written(arm)
    np.testing.assert_array_equal(motion(arm), shown)
    assert reading.read_back(arm, 1).coordinates.any()
    influence.influence_strip(arm).influence = 0.5
    influence.show_influence(arm)
    assert np.abs(motion(arm) - shown).max() > 0.0


def test_another_bake_takes_the_place_of_its_slots_alone(arm):
    written(arm)
    influence.influence_strip(arm).influence = 0.25
    written(arm, seed=2)
    assert slots(arm) == sorted([*SLOTS, "Face"]) and influence.influence_strip(arm).influence == 0.25
    assert len(keys_of(arm).animation_data.nla_tracks) == 2
    influence.influence_strip(arm).influence = 1.0
    shown = motion(arm)
    arm.dynamorph.output.bake_to_action = False
    written(arm, seed=2)
    np.testing.assert_array_equal(motion(arm), shown)
    assert slots(arm) == ["Face"] and arm.dynamorph.bake.action.name.startswith("Dynamorph")


def test_a_bake_that_fails_leaves_the_action_as_it_was(arm, monkeypatch):
    written(arm)
    before = state(arm)
    monkeypatch.setattr(writer, "mute_targets", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        written(arm, seed=2)
    assert state(arm) == before and influence.influence_strip(arm) is not None


def test_what_the_artist_keys_in_its_slot_stays(arm):
    written(arm)
    action, title = rig_of(arm).animation_data.action, "Dynamorph"
    slot = next(slot for slot in action.slots if slot.name_display == title)
    writer.add_curve(action.layers[0].strips[0].channelbag(slot), "smile", np.array([1.0, 9.0]), np.array([0.0, 1.0]))
    writer.free(arm)
    assert curves_of(arm, title) == ['key_blocks["smile"].value'] and "Dynamorph Shapes" not in slots(arm)


def test_pieces_of_the_body_have_slots_of_their_own(arm):
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    sleeve = make_sleeve(coarse(arm))
    add_attachment(arm, sleeve)
    before = slots(arm)
    bake(arm)
    assert len(slots(arm)) == len(before) + 2 * len(SLOTS)
    shown = evaluated_points(arm), evaluated_points(sleeve)
    bake(arm)
    assert len(slots(arm)) == len(before) + 2 * len(SLOTS) and staleness.outdated(arm) == []
    np.testing.assert_allclose(evaluated_points(sleeve), shown[1], atol=1e-6)
    assert OPS.delete_bake() == {"FINISHED"}
    assert slots(arm) == before


@pytest.mark.parametrize("to_rig", [False, True])
def test_a_strip_that_the_artist_has_duplicated_goes_with_the_bake(arm, to_rig):
    """For it Blender copies the Action, here with the performance."""
    arm.dynamorph.output.bake_to_action = to_rig
    before, count = state(arm), len(bpy.data.actions)
    written(arm)
    strip = influence.influence_strip(arm)
    track = keys_of(arm).animation_data.nla_tracks.new()
    twin = track.strips.new("Twin", 30, strip.action.copy())
    twin.action_slot = next(slot for slot in twin.action.slots if slot.handle == strip.action_slot.handle)
    writer.free(arm)
    assert state(arm) == before and len(bpy.data.actions) == count


def test_a_bake_without_curves_has_no_part_in_the_action(arm):
    """Nothing of it is ever removed."""
    record, action = arm.dynamorph.bake, rig_of(arm).animation_data.action
    baked_action.BakedAction(action, is_shared=True).record(record)
    assert record.action is None and baked_action.BakedAction.of(arm).slot("Dynamorph") is None


def test_a_duplicate_keeps_the_slots_that_it_plays(arm):
    written(arm)
    copy = arm.copy()
    copy.data = arm.data.copy()
    bpy.context.scene.collection.objects.link(copy)
    shown = motion(copy)
    writer.free(arm)
    np.testing.assert_array_equal(motion(copy), shown)
    writer.free(copy)
    assert slots(arm) == ["Face"]


def test_saving_keeps_which_slots_are_the_bake_s(arm, tmp_path):
    written(arm)
    shown = motion(arm)
    file = str(tmp_path / "saved.blend")
    bpy.ops.wm.save_as_mainfile(filepath=file)
    bpy.ops.wm.open_mainfile(filepath=file)
    arm = bpy.data.objects["Arm"]
    np.testing.assert_array_equal(motion(arm), shown)
    writer.free(arm)
    assert slots(arm) == ["Face"]


def test_a_clip_of_the_action_plays_the_face_and_not_the_bake(arm):
    writer.write_keys(arm, hand_made_bake(arm, frames=range(1, 41)))
    rig, keys = rig_of(arm), keys_of(arm)
    clips = actions.clips_of(arm)
    assert [(clip.begin, clip.end) for clip in clips] == [(1, 20)]
    keys.animation_data.action = None  # so that no slot is preferred
    actions.lay_out(keys, clips)
    strips = [strip for track in keys.animation_data.nla_tracks if not track.mute for strip in track.strips]
    assert [strip.action_slot.name_display for strip in strips] == ["Face"] and rig.animation_data.action


def test_a_gltf_is_the_same(arm, tmp_path):
    files = [tmp_path / "own.glb", tmp_path / "shared.glb"]
    for file, shared in zip(files, (False, True), strict=True):
        arm.dynamorph.output.bake_to_action = shared
        written(arm)
        before = state(arm)
        assert OPS.export(format="GLTF", filepath=str(file)) == {"FINISHED"}
        assert state(arm) == before
    assert files[0].read_bytes() == files[1].read_bytes()


def test_one_undo_takes_the_slots_back(arm):
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    coarse(arm)
    reconcile.reconcile(arm)
    bpy.ops.ed.undo_push(message="before")
    before = state(arm)
    assert OPS.bake("EXEC_DEFAULT", True) == {"FINISHED"}
    assert len(slots(bpy.data.objects["Arm"])) == 1 + len(SLOTS)
    bpy.ops.ed.undo()
    assert state(bpy.data.objects["Arm"]) == before
    bpy.ops.ed.redo()
    assert OPS.delete_bake() == {"FINISHED"} and slots(bpy.data.objects["Arm"]) == ["Face"]


def test_an_armature_without_an_action_is_refused(arm):
    rig_of(arm).animation_data.action = None
    with pytest.raises(errors.WriteError, match="The armature of 'Arm' plays no Action.*turn Bake to Action off"):
        bake(arm)
