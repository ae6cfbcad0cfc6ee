# SPDX-License-Identifier: GPL-3.0-or-later
"""A clip for each Action, as games use them: each read back and compared with what Blender shows when it plays and
bakes that Action alone.
"""

from dataclasses import replace

import bpy
import numpy as np
import pytest
import round_trips
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.core.motion import baked as motion_baked
from bl_ext.user_default.dynamic_morph_targets.core.motion import loops
from bl_ext.user_default.dynamic_morph_targets.core.result import keys as result_keys
from bl_ext.user_default.dynamic_morph_targets.run.bake import export_actions
from bl_ext.user_default.dynamic_morph_targets.run.bake.batch import run, run_all
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.run.work import computation
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.write import actions
from bl_ext.user_default.dynamic_morph_targets.write.bake import influence
from bl_ext.user_default.dynamic_morph_targets.write.export import exports, losses
from builders import activate, fingerprint, keys_of, make_arm, make_soft, rig_of
from pressed import Pressed
from robustness import OPS, coarse, settings
from round_trips import farthest
from test_exports import add_sleeve

BEND, WAVE = range(1, 13), range(5, 18)  # the frames of the Actions
CLOSE = 2e-5  # of an arm of 2.4 m
GAP = 1e-7  # of its loop, in body sizes: with the usual one, two searches for it may end farther apart than CLOSE


def new_action(rig, name, bone, axis, keys):
    """An Action that turns one bone: keys, (frame, angle)."""
    action = bpy.data.actions.new(name)
    rig.animation_data.action = action
    for frame, angle in keys:
        rig.pose.bones[bone].rotation_euler[axis] = angle
        rig.pose.bones[bone].keyframe_insert("rotation_euler", index=axis, frame=frame)
    rig.pose.bones[bone].rotation_euler[axis] = 0.0
    return action


@pytest.fixture
def game_arm(scene, monkeypatch):
    """The soft arm with a built model, a sleeve, and two clips as artists store them: "Bend", which is active, and
    "Wave", a loop of a bone that Bend does not move, which is pushed down. No other Action is a clip of it.
    """
    monkeypatch.setattr(loops, "CLOSED", GAP)
    obj = coarse(make_soft(make_arm(scene)))
    rig = rig_of(obj)
    add_sleeve(scene, obj)
    piece = obj.dynamorph.attachments.add()
    piece.object, piece.name = bpy.data.objects["Sleeve"], "Sleeve"
    animation = rig.animation_data
    bpy.data.actions.remove(animation.action)
    rig.pose.bones["lower"].rotation_euler.x = 0.0
    # Wilder, the arm would swing in more than one way, and its loop might find either.
    wave = new_action(rig, "Wave", "upper", 1, [(5, 0.0), (9, 0.5), (13, -0.3), (17, 0.0)])
    wave.use_frame_range = wave.use_cyclic = True
    wave.frame_start, wave.frame_end = WAVE[0], WAVE[-1]
    track = animation.nla_tracks.new()
    track.name = "Wave"
    track.strips.new("Wave", 40, wave).action_slot = wave.slots[0]
    new_action(rig, "A Pose", "upper", 1, [(3, 0.2)]).use_fake_user = True
    bend = new_action(rig, "Bend", "lower", 0, [(1, 0.0), (8, 1.2), (12, 0.9)])
    camera = bpy.data.objects.new("Camera", None)
    camera.keyframe_insert("location", frame=1)
    camera.keyframe_insert("location", frame=50)
    animation.action = bend
    scene.frame_set(3)
    activate(obj)
    OPS.build()
    return obj


def alone(obj, name, frames, loop):
    """Each mesh as Blender shows it with this Action and a bake of it, and nothing else."""
    animation, simulation = rig_of(obj).animation_data, obj.dynamorph.simulation
    for bone in rig_of(obj).pose.bones:
        bone.rotation_euler = 0.0, 0.0, 0.0
    animation.action, animation.use_nla = bpy.data.actions[name], False
    simulation.loop, simulation.keep_outside = loop, False
    run(Job(obj, "BAKE", (frames[0], frames[-1])))
    return {mesh: round_trips.shown(mesh, frames) for mesh in ("Arm", "Sleeve")}


def state(obj):
    """Everything that an export could leave behind."""
    rig = rig_of(obj)
    animation = rig.animation_data
    bones = [tuple(bone.rotation_euler) for bone in rig.pose.bones]
    tracks = [(t.name, t.mute, t.is_solo, [(s.name, s.frame_start) for s in t.strips]) for t in animation.nla_tracks]
    blocks = (bpy.data.objects, bpy.data.meshes, bpy.data.shape_keys, bpy.data.actions, bpy.data.scenes)
    names = [sorted(block.name for block in kind) for kind in blocks]
    chosen = [other.name for other in bpy.context.selected_objects], bpy.context.object.name
    return {
        "rig": (animation.action.name, animation.action_slot.identifier, animation.use_nla, bones, tracks),
        "names": names,
        "chosen": chosen,
        "frame": bpy.context.scene.frame_current,
        "keys": {mesh: fingerprint(bpy.data.objects[mesh]) for mesh in ("Arm", "Sleeve")},
        "settings": settings(obj.dynamorph),
    }


def seen(obj):
    """The same without what Blender hides, as the scene of a rig that is read in several turns."""
    found = state(obj)
    found["names"] = [[name for name in kind if not name.startswith(".")] for kind in found["names"]]
    return found


def exported(obj, folder, key="GLTF"):
    path = folder / f"arm{exports.FORMATS[key].suffix}"
    export_actions.export(obj, key, path, (1, 1), takes="ACTIONS")
    return path


def test_a_bake_in_the_armature_s_action_is_in_no_clip(game_arm, tmp_path):
    before = exported(game_arm, tmp_path).read_bytes()
    game_arm.dynamorph.output.bake_to_action = True
    run(Job(game_arm, "BAKE", (1, 20)))
    assert game_arm.dynamorph.bake.action == rig_of(game_arm).animation_data.action
    noted = state(game_arm)
    assert exported(game_arm, tmp_path).read_bytes() == before and state(game_arm) == noted


@pytest.mark.parametrize("baked", [True, False])
def test_gltf_has_a_clip_for_each_action(game_arm, tmp_path, baked):
    pytest.importorskip("pygltflib")
    obj = game_arm
    simulation = obj.dynamorph.simulation
    if baked:  # no clip becomes a part of it, whatever the settings of the bake
        OPS.bake()
        simulation.keep_outside, simulation.samples = True, 2
    before = state(obj)
    path = exported(obj, tmp_path)
    assert state(obj) == before
    assert [file.name for file in tmp_path.iterdir()] == ["arm.glb"]
    file = round_trips.Gltf(path)
    assert [animation.name for animation in file.file.animations] == ["Bend", "Wave"]
    for name, frames in (("Bend", BEND), ("Wave", WAVE)):
        assert file.times(name) == pytest.approx((np.array(frames) - frames[0]) / 24.0)
        for mesh, exact in alone(obj, name, frames, loop=name == "Wave").items():
            assert farthest(file.surfaces(mesh, len(frames), name), exact, same_order=False) < CLOSE, (name, mesh)
    loop = file.surfaces("Arm", len(WAVE), "Wave")
    assert farthest(loop[:1], loop[-1:]) < 1e-5  # the Bake is closed to a millionth; shape keys are float32
    assert np.linalg.norm(loop - loop[0], axis=2).max() > 0.1


def test_fbx_has_a_clip_for_each_action(game_arm, tmp_path):
    obj = game_arm
    before = state(obj)
    path = exported(obj, tmp_path, "FBX")
    assert state(obj) == before
    exact = {name: alone(obj, name, frames, name == "Wave") for name, frames in (("Bend", BEND), ("Wave", WAVE))}
    round_trips.imported(bpy.ops.import_scene.fbx, path, anim_offset=0.0)
    assert sorted({action.name.rpartition("|")[2] for action in bpy.data.actions}) == ["Bend", "Wave"]
    for name, meshes in exact.items():
        frames = range(len(meshes["Arm"]))
        for owner in (bpy.data.objects["Arm Rig"], *bpy.data.shape_keys):
            wanted = "OBJECT" if owner.id_type == "OBJECT" else "KEY"
            for action in bpy.data.actions:
                prefix, _, clip = action.name.rpartition("|")
                if clip == name and action.slots[0].target_id_type == wanted and prefix == owner.name:
                    owner.animation_data.action = action
                    owner.animation_data.action_slot = action.slots[0]
        for mesh, surface in meshes.items():
            assert farthest(round_trips.shown(mesh, frames), surface) < CLOSE, (name, mesh)


def test_the_clips_share_as_many_keys_as_are_asked_for(game_arm, tmp_path):
    pytest.importorskip("pygltflib")
    obj = game_arm
    obj.dynamorph.output.keys = 3
    keys, baked = result_keys, motion_baked
    assert not any("keys move" in text for text in losses.losses(obj, "GLTF", "ACTIONS"))
    batch = export_actions.ActionsExport(obj, "GLTF", tmp_path / "arm.glb")
    run_all(batch)
    file = round_trips.Gltf(tmp_path / "arm.glb")
    (mesh,) = (mesh for mesh in file.file.meshes if mesh.name == "Arm")
    assert [name for name in mesh.extras["targetNames"] if "Dynamorph" in name] == [
        f"Dynamorph Mode 0{k}" for k in (1, 2, 3)
    ]
    whole = export_actions.joined([job.outcome.bake for job in batch.jobs])
    fewer = computation.of_meshes(batch.jobs[0].input.character, keys.with_fewer_keys(whole, 3))[0]
    basis = mesh_data.rest_points(obj)
    found = np.concatenate([file.morphed("Arm", name) for name in ("Bend", "Wave")])
    exact = np.concatenate(list(baked.surfaces(fewer, basis)))
    assert farthest(found, exact, same_order=False) < CLOSE
    obj.dynamorph.output.keys = 0
    obj.dynamorph.modes.add()
    obj.dynamorph.modes.add()
    (text,) = losses.losses(obj, "GLTF", "ACTIONS")
    assert "'Arm': 9 keys move" in text and "set Key Limit to 8, or" in text


def test_influence_counts(game_arm, tmp_path):
    pytest.importorskip("pygltflib")
    obj = game_arm
    OPS.bake()
    influence.influence_strip(obj).influence = 0.5
    batch = export_actions.ActionsExport(obj, "GLTF", tmp_path / "arm.glb")
    run_all(batch)
    bend = batch.jobs[0].outcome.bake
    half = replace(bend, coordinates=(bend.coordinates + bend.static) / 2)
    half = computation.of_meshes(batch.jobs[0].input.character, half)[0]
    exact = np.concatenate(list(motion_baked.surfaces(half, mesh_data.rest_points(obj))))
    assert farthest(round_trips.Gltf(batch.path).morphed("Arm", "Bend"), exact, same_order=False) < CLOSE


@pytest.mark.parametrize("assigned", [False, True])
def test_faces_that_an_action_moves_are_in_its_clip(game_arm, tmp_path, assigned):
    """An Action may have slots for the shape keys too, which may have it assigned; drivers count as well."""
    pytest.importorskip("pygltflib")
    obj, keys = game_arm, keys_of(game_arm)
    bend = bpy.data.actions["Bend"]
    keys.animation_data_create().action = bend
    keys.animation_data.action_slot = bend.slots.new("KEY", "Face")
    for frame in (1, 12):
        keys.key_blocks["smile"].value = (frame - 1) / 11
        keys.key_blocks["smile"].keyframe_insert("value", frame=frame)
    keys.key_blocks["smile"].value = 0.0
    if not assigned:
        keys.animation_data.action = None
    file = round_trips.Gltf(exported(obj, tmp_path))
    keys.animation_data.action = bend
    keys.animation_data.action_slot = bend.slots[-1]
    exact = alone(obj, "Bend", BEND, loop=False)["Arm"]
    assert farthest(file.surfaces("Arm", len(BEND), "Bend"), exact, same_order=False) < CLOSE


def test_a_clip_whose_action_another_rig_plays_too(game_arm, tmp_path):
    """Shift-D without Duplicate Actions lets both rigs use one slot."""
    pytest.importorskip("pygltflib")
    exact = alone(game_arm, "Bend", BEND, loop=False)["Arm"]
    copy = rig_of(game_arm).copy()
    bpy.context.scene.collection.objects.link(copy)
    assert len(bpy.data.actions["Bend"].slots[0].users()) == 2
    file = round_trips.Gltf(exported(game_arm, tmp_path))
    assert farthest(file.surfaces("Arm", len(BEND), "Bend"), exact, same_order=False) < CLOSE


def test_actions_that_are_named_after_another_rig_are_no_clips(game_arm, tmp_path):
    """They fit its bones too, and nothing plays them; those that are named after nothing stay clips."""
    pytest.importorskip("pygltflib")
    other = rig_of(game_arm).copy()
    other.name = "Other Rig"
    bpy.context.scene.collection.objects.link(other)
    for name, slot in (("Run", other.name), ("Jump", "Downloaded")):
        action = new_action(rig_of(game_arm), name, "lower", 0, [(1, 0.0), (5, 0.4)])
        action.slots[0].name_display, action.use_fake_user = slot, True
    rig_of(game_arm).animation_data.action = bpy.data.actions["Bend"]
    clips = round_trips.Gltf(exported(game_arm, tmp_path)).clips
    assert "Jump" in clips and "Run" not in clips


def test_actions_of_one_name_are_refused(game_arm, tmp_path):
    library = tmp_path / "clips.blend"
    bpy.data.libraries.write(str(library), {bpy.data.actions["Wave"]})
    with bpy.data.libraries.load(str(library), link=True) as (_, wanted):
        wanted.actions = ["Wave"]
    with pytest.raises(errors.SceneError, match="two Actions 'Wave'"):
        actions.clips_of(game_arm)


@pytest.mark.parametrize("linked_is_clip", [True, False])
def test_only_one_of_two_actions_of_one_name_is_a_clip(game_arm, tmp_path, linked_is_clip):
    """The clip that is laid out is the local one."""
    library, other = tmp_path / "clips.blend", bpy.data.actions["A Pose"]
    linked, local = (bpy.data.actions["Wave"], other) if linked_is_clip else (other, bpy.data.actions["Wave"])
    linked.name, local.name = "Same", "Kept"
    bpy.data.libraries.write(str(library), {linked})
    linked.name, local.name = "Former", "Same"
    with bpy.data.libraries.load(str(library), link=True) as (_, wanted):
        wanted.actions = ["Same"]
    if linked_is_clip:
        with pytest.raises(errors.SceneError, match="two Actions 'Same'"):
            actions.clips_of(game_arm)
    else:
        assert [clip.name for clip in actions.clips_of(game_arm)] == ["Bend", "Same"]


def test_the_buttons_write_clips(game_arm, tmp_path, capfd):
    activate(game_arm)
    OPS.bake()
    assert OPS.export(format="GLTF", clips="ACTIONS", filepath=str(tmp_path / "arm")) == {"FINISHED"}
    assert "'Arm' written as 'arm.glb': Bend, Wave" in capfd.readouterr().out
    OPS.export(format="ALEMBIC", clips="ACTIONS", filepath=str(tmp_path / "arm"))  # it has only one
    assert sorted(file.name for file in tmp_path.iterdir()) == ["arm.abc", "arm.glb"]


def test_in_a_window_the_artist_s_animation_is_there_between_two_turns(game_arm, tmp_path):
    obj = game_arm
    before, between = state(obj), []
    pressed = Pressed(
        obj,
        operator="DYNAMORPH_OT_export_actions",
        before_tick=lambda _batch: between.append(seen(obj) == before),
        format="GLTF",
        filepath=str(tmp_path / "arm.glb"),
    )
    assert pressed.result == {"FINISHED"} and len(between) > 5 and all(between)
    assert pressed.reports[-1] == ("INFO", "'Arm' written as 'arm.glb': Bend, Wave")
    assert state(obj) == before and (tmp_path / "arm.glb").exists()


def fail(*_arguments):
    raise RuntimeError("Error: no disk")


def test_what_fails_or_is_canceled_leaves_all_as_it_was(game_arm, tmp_path, monkeypatch):
    obj = game_arm
    rig_of(obj).animation_data.nla_tracks[0].is_solo = True
    bpy.context.scene.frame_set(3)
    before = state(obj)
    broken = replace(exports.FORMATS["GLTF"], write=fail)
    with monkeypatch.context() as patch:
        patch.setitem(exports.FORMATS, "GLTF", broken)
        with pytest.raises(errors.ExportError, match="no disk"):
            exported(obj, tmp_path)
    assert state(obj) == before
    with pytest.raises(errors.Cancelled):
        export_actions.export(obj, "GLTF", tmp_path / "arm.glb", (1, 1), "ACTIONS", tick=lambda batch: batch.cancel())
    assert state(obj) == before
    assert list(tmp_path.iterdir()) == []


def linked_to_tweak(obj):
    animation = rig_of(obj).animation_data
    animation.nla_tracks[0].strips[0].select = True
    animation.use_tweak_mode = True


def without_clips(obj):
    for action in list(bpy.data.actions):
        bpy.data.actions.remove(action)


def stretched(_obj):
    bpy.context.scene.render.frame_map_new = 200


def sculpted(obj):
    keys_of(obj).key_blocks["flexed"].points[0].co.x += 0.1


@pytest.mark.parametrize(
    "change, words",
    [
        (without_clips, "No Action moves bones of 'Arm Rig'"),
        (stretched, "Time Stretching"),
        (sculpted, "out of date.*press Build Model"),
        (linked_to_tweak, "in NLA tweak mode"),
    ],
)
def test_refused(game_arm, tmp_path, change, words):
    change(game_arm)
    with pytest.raises(errors.DynamorphError, match=words):
        exported(game_arm, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_formats_of_a_surface_have_no_clips(game_arm, tmp_path):
    with pytest.raises(errors.ExportError, match="Alembic has one animation only"):
        exported(game_arm, tmp_path, "ALEMBIC")
