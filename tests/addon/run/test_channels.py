# SPDX-License-Identifier: GPL-3.0-or-later
"""Channels: any number may place a target, beside bones or without any, in bakes and in Live alike."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core.errors import SceneError
from bl_ext.user_default.dynamic_morph_targets.core.motion import posing
from bl_ext.user_default.dynamic_morph_targets.io import model_file, soft_skin_file
from bl_ext.user_default.dynamic_morph_targets.run import live as run_live
from bl_ext.user_default.dynamic_morph_targets.run.tools import weight_curves
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store, staleness
from bl_ext.user_default.dynamic_morph_targets.write.authoring import channels, setups
from builders import rig_of
from built import BuiltOnce
from test_keyed import SOFT, apart, baked, key
from test_live import play, surface

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

built = BuiltOnce()


def still(obj):
    """No bone moves any more."""
    rig = rig_of(obj)
    rig.animation_data_clear()
    rig.pose.bones["lower"].rotation_euler.x = 0.0
    bpy.context.view_layer.update()


@pytest.fixture
def muscle(soft_arm):
    """The soft arm, built, with 'flexed' placed by a channel alone, and without gravity."""
    settings = soft_arm.dynamorph
    target = settings.targets[1]
    target.set_bones([])
    target.channel, target.reached_at = channels.ensure(soft_arm, "Tension").name, 1.0
    target.set_pose(*rig_motion.current_pose(soft_arm))  # the neutral one
    settings.model.cage_nodes, settings.model.modes = 200, 12
    built.give(soft_arm, 12)
    settings.targets[0].stiffness, target.stiffness = SOFT, 8 * SOFT
    settings.simulation.max_thickness = settings.simulation.max_displacement = 0.0
    settings.simulation.gravity = 0.0
    still(soft_arm)
    return soft_arm


def sculpted(obj):
    """Displacements (V, 3) of the target's key."""
    return extract.character(obj).targets[1].shape


@pytest.mark.parametrize("solver", ["REDUCED", "FULL"])
def test_a_muscle_is_flexed_without_any_bone(muscle, solver):
    """At the target the bulge is the sculpted one, as near as the model has it; with the channel at 0 nothing moves."""
    muscle.dynamorph.channels[0].value = 1.0
    shown = baked(muscle, solver=solver)
    assert apart(shown[-1], sculpted(muscle)) < 0.05
    muscle.dynamorph.channels[0].value = 0.0
    assert np.abs(baked(muscle, solver=solver)).max() < 1e-6


def test_a_channel_that_is_keyed_is_one_that_is_set(muscle):
    muscle.dynamorph.channels[0].value = 0.6
    expected = baked(muscle)
    key(muscle.dynamorph.channels[0], "value", (1, 0.6))
    assert apart(baked(muscle), expected) < 1e-6


def test_substeps_and_live_see_the_channel_move(muscle):
    """It is read at each substep; Live shows what a bake has."""
    key(muscle.dynamorph.channels[0], "value", (4, 0.0), (8, 1.0))
    muscle.dynamorph.simulation.substeps = 5
    shown = baked(muscle)
    muscle.dynamorph.simulation.substeps = 10
    finer = baked(muscle)
    assert np.abs(shown[:3]).max() < 1e-6 < np.abs(shown[5]).max()
    assert apart(shown, finer) < 0.1
    assert apart(finer[-1], sculpted(muscle)) < 0.1
    bpy.ops.dynamorph.live()
    rest = extract.character(muscle).vertices
    np.testing.assert_allclose(play(muscle, range(1, 21)), rest + finer, atol=1e-5)


def on_rig(obj):
    rig_of(obj)["Flex"] = 0.0
    rig_of(obj).id_properties_ui("Flex").update(min=0.0, max=2.0, soft_max=2.0)
    return rig_of(obj), '["Flex"]', "Flex"


def on_armature(obj):
    rig_of(obj).data["Flex"] = 0.25
    rig_of(obj).data.id_properties_ui("Flex").update(default=0.25)
    return rig_of(obj).data, '["Flex"]', "Flex"


def on_bone(obj):
    rig_of(obj).pose.bones["lower"]["Flex"] = 0
    return rig_of(obj), 'pose.bones["lower"]["Flex"]', "Flex"


def on_object(obj):
    obj["Flex"] = False
    return obj, '["Flex"]', "Flex"


def on_key(obj):
    return obj.data.shape_keys, 'key_blocks["smile"].value', "smile"


def on_another(_obj):
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    bpy.context.scene.collection.objects.link(lamp)
    lamp.data.energy = 10.0
    return lamp.data, "energy", "Power"


PLACES = [on_rig, on_armature, on_bone, on_object, on_key, on_another]


@pytest.mark.parametrize("place", PLACES)
def test_any_number_of_blender_is_a_channel(muscle, place):
    """Added where it is at rest, the largest value of its slider reaches the target; moved there, it shows."""
    bpy.ops.dynamorph.remove_channel()
    assert len(muscle.dynamorph.channels) == 0
    owner, path, name = place(muscle)
    rest = float(owner.path_resolve(path))
    full_path = channels.full_path(owner, path)
    assert bpy.ops.dynamorph.add_channel(data_path=full_path) == {"FINISHED"}
    target = muscle.dynamorph.targets[1]
    assert target.channel == name
    read = channels.named(full_path)
    read.value = read.rest + target.reached_at
    bpy.context.view_layer.update()
    assert muscle.dynamorph.channels[name].value == pytest.approx(target.reached_at)
    muscle.data.shape_keys.key_blocks["smile"].mute = True
    assert apart(baked(muscle)[-1], sculpted(muscle)) < 0.05
    read.value = rest
    bpy.context.view_layer.update()


def test_a_channel_is_added_once_and_reached_at_the_present_value(muscle):
    bpy.ops.dynamorph.add_target(key="smile")
    rig = rig_of(muscle)
    rig["Flex"] = 0.4
    for index in (1, 2):
        muscle.dynamorph.active_target_index = index
        bpy.ops.dynamorph.add_channel(data_path='bpy.data.objects["Arm Rig"]["Flex"]')
    assert [channel.name for channel in muscle.dynamorph.channels] == ["Flex"]
    assert [target.reached_at for target in muscle.dynamorph.targets[1:]] == pytest.approx([0.4, 0.4])
    rig.name = "Renamed"  # Blender keeps the path
    rig["Flex"] = 0.7
    bpy.context.view_layer.update()
    assert muscle.dynamorph.channels["Flex"].value == pytest.approx(0.7)
    bpy.ops.dynamorph.remove_target()
    assert len(muscle.dynamorph.channels) == 1
    muscle.dynamorph.active_target_index = 1
    bpy.ops.dynamorph.remove_channel()
    assert len(muscle.dynamorph.channels) == 0 and not muscle.animation_data.drivers


@pytest.mark.parametrize("path", ["", ".location", ".name", ".nothing", '["nothing"]', ".dynamorph.simulation.amount"])
def test_what_is_no_number_is_refused(muscle, path):
    with pytest.raises(RuntimeError, match="choose"):
        bpy.ops.dynamorph.add_channel(data_path=f'bpy.data.objects["Arm"]{path}')
    assert muscle.dynamorph.targets[1].channel == "Tension"


@pytest.mark.parametrize("path", ["Flex", 'bpy.data.objects["Nobody"]["Flex"]', "import os", "bpy.data.nothing[0].x"])
def test_what_is_no_path_is_refused(muscle, path):
    with pytest.raises(RuntimeError, match="full data path"):
        bpy.ops.dynamorph.add_channel(data_path=path)
    assert muscle.dynamorph.targets[1].channel == "Tension"


def test_tension_is_one_click(muscle):
    """A slider that tenses: eight times as firm where it is 1, in the selected target's region."""
    group = muscle.vertex_groups.new(name="biceps")
    group.add(range(len(muscle.data.vertices) // 2), 1.0, "REPLACE")
    muscle.dynamorph.targets[1].set_region("biceps", automatic=False)
    bpy.ops.dynamorph.add_tension()
    target = muscle.dynamorph.active_target
    assert (target.name, target.region, target.channel) == ("Tension 1", "biceps", "Tension 1")
    assert target.stiffness == pytest.approx(channels.TENSE * SOFT)
    extract.character(muscle)  # nothing prevents a build
    bpy.ops.dynamorph.add_tension(region="")
    assert muscle.dynamorph.active_target.region == ""


def test_a_bake_tells_when_its_channel_moved(muscle):
    bpy.ops.dynamorph.bake()
    muscle.dynamorph.channels[0].value = 0.5
    assert any("Tension" in text for text in staleness.outdated(muscle))
    muscle.dynamorph.channels[0].value = 0.0
    assert staleness.outdated(muscle) == []
    rig_of(muscle)["Flex"] = 0.5
    bpy.ops.dynamorph.add_channel(data_path='bpy.data.objects["Arm Rig"]["Flex"]')
    bpy.ops.dynamorph.bake()
    assert staleness.outdated(muscle) == []
    rig_of(muscle)["Flex"] = 0.25
    bpy.context.view_layer.update()
    assert staleness.outdated(muscle) != []


def test_bones_and_a_channel_place_a_target_together(soft_arm):
    """One metric: the whole way along a channel is a right angle, as that between the poses here."""
    target = soft_arm.dynamorph.targets[1]
    target.channel, target.reached_at = channels.ensure(soft_arm, "Tension").name, 4.0
    channel = soft_arm.dynamorph.channels[0]
    for frame, value, weight in ((1, 0.0, 0.0), (20, 4.0, 1.0), (1, 4.0, 0.5), (20, 0.0, 0.5)):
        bpy.context.scene.frame_set(frame)
        channel.value = value
        now = weight_curves.weights_now(soft_arm, bpy.context.evaluated_depsgraph_get())
        assert now.weights[0, 1] == pytest.approx(weight, abs=1e-6)


def test_a_pose_has_its_channel(muscle):
    """New from Pose, Capture Pose and Go to Pose read and set where a channel stands."""
    channel, rig = muscle.dynamorph.channels[0], rig_of(muscle)
    channel.value = 0.5
    assert bpy.ops.dynamorph.new_from_pose(key="half", mode="EDIT") == {"FINISHED"}
    bpy.ops.dynamorph.finish_sculpt()
    half = muscle.dynamorph.active_target
    assert (half.channel, half.reached_at, len(half.bones)) == ("Tension", 0.5, 0)
    with pytest.raises(RuntimeError, match="in the pose of 'half'"):
        bpy.ops.dynamorph.new_from_pose(key="another", mode="EDIT")
    channel.value = 0.75
    bpy.ops.dynamorph.capture_pose()
    assert half.reached_at == 0.75
    for index, value in ((0, 0.0), (1, 1.0), (2, 0.75)):
        muscle.dynamorph.active_target_index = index
        bpy.ops.dynamorph.go_to_pose()
        assert channel.value == value
    rig["Flex"] = 0.0
    bpy.ops.dynamorph.add_channel(data_path='bpy.data.objects["Arm Rig"]["Flex"]')
    bpy.ops.dynamorph.go_to_pose()
    assert (rig["Flex"], channel.value) == (1.0, 0.0)


def test_errors_name_the_target_and_the_remedy(muscle):
    target = muscle.dynamorph.targets[1]

    def problem():
        with pytest.raises(SceneError) as refused:
            extract.character(muscle)
        return str(refused.value)

    target.reached_at = 0.0
    assert "'flexed' is reached at 0 of its channel" in problem()
    target.reached_at, target.channel = 1.0, "Nobody"
    assert "channel 'Nobody' of target 'flexed' is gone" in problem()


def test_a_setup_has_the_channels(muscle):
    rig_of(muscle)["Flex"] = 0.5
    bpy.ops.dynamorph.add_channel(data_path='bpy.data.objects["Arm Rig"]["Flex"]')
    setup = setups.of_object(muscle)
    setups.check(setup)
    bpy.ops.dynamorph.remove_channel()
    setups.apply(muscle, setup)
    assert muscle.dynamorph.targets[1].channel == "Flex"
    rig_of(muscle)["Flex"] = 0.7
    bpy.context.view_layer.update()
    assert muscle.dynamorph.channels["Flex"].value == pytest.approx(0.7)
    setup["channels"][0]["source"] = 'bpy.data.objects["Nobody"]["Flex"]'
    assert setups.apply(muscle, setup) == {"properties": ['bpy.data.objects["Nobody"]["Flex"]']}


def test_the_other_side_has_its_own_region_or_channel(muscle):
    muscle.data.shape_keys.key_blocks["flexed"].name = "flexed.L"
    muscle.dynamorph.channels[0].name = muscle.dynamorph.targets[1].channel = "Tension.L"
    assert bpy.ops.dynamorph.mirror_target() == {"FINISHED"}
    assert muscle.dynamorph.active_target.channel == "Tension.R"
    assert [channel.name for channel in muscle.dynamorph.channels] == ["Tension.L", "Tension.R"]


def test_live_shows_a_channel_that_is_dragged(muscle):
    """While the animation stands: the skin is where it comes to rest, also where a driver moves the channel."""
    bpy.ops.dynamorph.live()
    rest = surface(muscle)
    muscle.dynamorph.channels[0].value = 1.0
    assert apart(surface(muscle) - rest, sculpted(muscle)) < 0.05
    muscle.dynamorph.channels[0].value = 0.0
    assert np.abs(surface(muscle) - rest).max() < 1e-5
    rig_of(muscle)["Flex"] = 0.0
    bpy.ops.dynamorph.add_channel(data_path='bpy.data.objects["Arm Rig"]["Flex"]')
    bpy.context.scene.frame_set(2)
    rig_of(muscle)["Flex"] = 1.0
    rig_of(muscle).update_tag()
    bpy.context.view_layer.update()
    run_live.refresh(muscle)  # by a timer, which nothing calls here
    assert run_live.problem(muscle) == ""
    assert apart(surface(muscle) - rest, sculpted(muscle)) < 0.05


def test_the_file_for_programs_has_the_channels(muscle):
    model, character = model_store.live_model(muscle)
    packed = soft_skin_file.packed(model, character, rig_motion.sample_present(muscle), (0.0, 0.0, 0.0))
    arrays, meta = model_file.unpack(packed)
    assert meta["character"]["channels"] == ["Tension"]
    assert meta["character"]["sets"][0]["channels"] == [0]
    np.testing.assert_array_equal(arrays["target_channels"], [[0.0], [1.0]])


def test_without_channels_nothing_is_asked_of_them(soft_arm):
    character = extract.character(soft_arm)
    assert posing.channels(character.targets) == []
    rig = rig_motion.sample_rig(soft_arm, 1, 3, 2)
    assert rig.tracks == ()


def test_at_its_target_the_material_is_that_alone(muscle):
    """Tense, the body swings as if the relaxed material were not there; relaxed, as if the tense one were not."""
    relaxed, tense = muscle.dynamorph.targets
    bone = rig_of(muscle).pose.bones["upper"]
    for frame, place in ((1, 0.0), (4, 0.3), (20, 0.3)):
        bone.location.x = place
        bone.keyframe_insert("location", frame=frame)
    found = {}
    for value, other, own in ((1.0, relaxed, tense), (0.0, tense, relaxed)):
        muscle.dynamorph.channels[0].value = value
        found[value] = baked(muscle)
        other.stiffness *= 3.0
        assert apart(baked(muscle), found[value]) < 1e-9
        other.stiffness /= 3.0
        own.stiffness *= 3.0
        assert apart(baked(muscle), found[value]) > 0.1
        own.stiffness /= 3.0
    assert np.abs(found[1.0] - sculpted(muscle)).max() < 0.9 * np.abs(found[0.0]).max()
