# SPDX-License-Identifier: GPL-3.0-or-later
"""Soft skin files from Blender: made of the model alone, by the button and by the command line, or refused."""

import json
from pathlib import Path

import bpy
import dynamorph
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.cli import main
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.remembered import opened
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store
from bl_ext.user_default.dynamic_morph_targets.write import storage
from bl_ext.user_default.dynamic_morph_targets.write.export import losses
from builders import activate, fingerprint, make_arm, rig_of
from built import SmallModel
from pressed import Instead, press
from test_command_line import run, shot  # noqa: F401

OPS = bpy.ops.dynamorph
built = SmallModel()


@pytest.fixture
def skin(soft_arm):
    """The arm with a model, and without a bake."""
    built.give(soft_arm)
    return soft_arm


def exported(folder, name="arm") -> Path:
    OPS.export(format="SOFT_SKIN", filepath=str(folder / name))
    return folder / f"{name}.dynamorph"


def read(path) -> tuple[dict, dict]:
    arrays, text = dynamorph.unpack_model(path.read_bytes())
    return arrays, json.loads(text)["character"]


def refused(words, operator=OPS.export, **options):
    with pytest.raises(RuntimeError, match=words):
        operator(format="SOFT_SKIN", **options)


def offered(obj) -> list[str]:
    """The names with which the button opens its dialog."""
    names = []

    def invoke(operator, context):
        asks = Instead(context.window_manager, fileselect_add=lambda opened: names.append(opened.filepath))
        return operator.invoke(Instead(context, window_manager=asks), None)

    press(obj, "DYNAMORPH_OT_export", invoke, format="SOFT_SKIN")
    return names


# What is written -----------------------------------------------------------------------------------------------------


def test_the_button_writes_the_built_model(skin, tmp_path):
    before = fingerprint(skin)
    arrays, described = read(exported(tmp_path))
    assert [file.name for file in tmp_path.iterdir()] == ["arm.dynamorph"]
    assert fingerprint(skin) == before and not skin.dynamorph.bake.exists
    assert described["name"] == "Arm" and described["targets"] == ["Neutral", "flexed"]
    model, character = model_store.current_model(skin)
    np.testing.assert_array_equal(arrays["basis"], model.to_arrays()[0]["basis"])
    np.testing.assert_allclose(arrays["vertices"], character.vertices, atol=1e-6)
    np.testing.assert_allclose(arrays["object_frames"][0], rig_of(skin).matrix_world, atol=1e-6)


def test_a_pose_and_a_bake_make_no_difference(skin, tmp_path):
    first = exported(tmp_path, "first").read_bytes()
    bpy.context.scene.frame_set(15)
    OPS.bake()
    assert skin.dynamorph.bake.exists
    assert exported(tmp_path, "second").read_bytes() == first


def test_a_model_in_a_file_gives_the_same_bytes(skin, tmp_path, monkeypatch):
    packed = exported(tmp_path, "packed").read_bytes()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    monkeypatch.setattr(storage, "PACK_LIMIT", 100)
    OPS.build()
    (file,) = (tmp_path / "dynamorph_models").iterdir()
    opened.models.clear()
    assert model_store.PACKED not in skin
    assert exported(tmp_path, "beside").read_bytes() == packed
    file.unlink()
    opened.models.clear()
    refused("The model of 'Arm' is missing .* put it back", filepath=str(tmp_path / "none"))


# What is refused, and before the file is asked for -------------------------------------------------------------------


def more_modifiers(obj):
    obj.modifiers.new("Again", "ARMATURE").object = rig_of(obj)


SETTINGS = {
    "modes of Reduced Quality: set Quality to Reduced": lambda obj: setattr(obj.dynamorph.model, "solver", "FULL"),
    "with Method Static there is no motion": lambda obj: setattr(obj.dynamorph.model, "method", "STATIC"),
    "'Arm' is skinned with Preserve Volume": lambda obj: setattr(
        obj.modifiers["Armature"], "use_deform_preserve_volume", True
    ),
    "'Arm' is skinned with several Armature modifiers": more_modifiers,
    "'Arm' is skinned with bendy bones": lambda obj: setattr(rig_of(obj).data.bones["lower"], "bbone_segments", 4),
}


@pytest.mark.parametrize("words", SETTINGS)
def test_settings_that_it_cannot_have(skin, tmp_path, words):
    SETTINGS[words](skin)
    refused(words, filepath=str(tmp_path / "arm"))
    refused(words, OPS.export_check)
    with pytest.raises(RuntimeError, match=words):
        offered(skin)
    assert list(tmp_path.iterdir()) == []


def test_the_dialog_needs_no_bake_and_offers_a_name(skin, tmp_path):
    assert offered(skin) == ["Arm.dynamorph"]
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    assert offered(skin) == [str(tmp_path / "Arm.dynamorph")]


def test_quality_is_set_back_without_a_build(skin, tmp_path):
    skin.dynamorph.model.solver = "FULL"
    refused("set Quality to Reduced", filepath=str(tmp_path / "arm"))
    skin.dynamorph.model.solver = "REDUCED"
    assert exported(tmp_path).is_file()


def test_an_attachment_is_part_of_it_or_refused_by_its_name(scene, skin, tmp_path):
    sleeve = make_arm(scene, "Sleeve")
    bpy.data.objects.remove(rig_of(sleeve))
    sleeve.modifiers["Armature"].object = rig_of(skin)
    attachment = skin.dynamorph.attachments.add()
    attachment.object, attachment.attached_by = sleeve, "WITH_BODY"
    activate(skin)
    assert list(losses.losses(skin, "SOFT_SKIN")) == []
    sleeve.modifiers["Armature"].use_deform_preserve_volume = True
    refused("'Sleeve' is skinned with Preserve Volume", filepath=str(tmp_path / "arm"))


def test_a_model_that_is_missing_or_out_of_date(soft_arm, tmp_path):
    assert not OPS.export_check.poll()
    refused("The model of 'Arm' is out of date .not built yet.: press Build Model", filepath=str(tmp_path / "arm"))
    built.give(soft_arm)
    soft_arm.data.vertices[0].co.x += 0.01
    soft_arm.data.shape_keys.reference_key.points[0].co.x += 0.01
    refused("'Arm' is out of date .mesh changed.*: press Build Model", filepath=str(tmp_path / "arm"))
    assert list(tmp_path.iterdir()) == []


# What it leaves out --------------------------------------------------------------------------------------------------


def test_export_check_needs_no_bake(skin):
    assert list(losses.losses(skin, "SOFT_SKIN")) == []
    assert OPS.export_check(format="SOFT_SKIN") == {"FINISHED"}
    with pytest.raises(RuntimeError, match="no bake to export: press Bake first"):
        OPS.export_check(format="GLTF")


def add_shirt(obj):
    shirt = make_arm(bpy.context.scene, "Shirt")
    shirt.modifiers["Armature"].object = rig_of(obj)


def collide(obj):
    obj.dynamorph.collision.use = obj.dynamorph.collision.use_self = True


LOSSES = {
    "meshes of one body: 'Shirt' is left out": add_shirt,
    "only the targets' keys: smile is left out": lambda obj: obj.data.shape_keys.key_blocks["smile"].driver_add(
        "value"
    ),
    "no collision: 'Arm' passes through": collide,
    "no Amount: all motion of 'Arm'": lambda obj: setattr(obj.dynamorph.targets[1], "amount", 0.5),
}


@pytest.mark.parametrize("words", LOSSES)
def test_export_check_says_what_is_left_out(skin, words):
    LOSSES[words](skin)
    (text,) = losses.losses(skin, "SOFT_SKIN")
    assert words in text


# The command line ----------------------------------------------------------------------------------------------------


@pytest.fixture
def small_shot(skin, tmp_path):
    """A saved file with the arm and its model."""
    path = tmp_path / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def test_the_command_line_writes_it_without_a_simulation(small_shot, tmp_path, capfd):
    report = tmp_path / "report.json"
    given = ["bake", str(small_shot), "--object", "Arm", "--format", "soft_skin", "--report", str(report)]
    assert main.main(given, opens_file=True) == 0
    said = capfd.readouterr().out
    assert "Arm: written to Arm.dynamorph" in said and "steps per second" not in said
    (character,) = json.loads(report.read_text())["characters"]
    assert character["model_from"] == "file" and "bake" not in character
    bpy.ops.wm.open_mainfile(filepath=str(small_shot))
    assert exported(tmp_path, "button").read_bytes() == (tmp_path / "Arm.dynamorph").read_bytes()


def test_the_command_line_builds_what_is_out_of_date(small_shot, tmp_path, capfd):
    file, output = tmp_path / "other.dynamorph", tmp_path / "built.blend"
    given = ["--object", "Arm", "--format", "soft_skin", "--output-file", str(file), "-o", str(output), "--modes", "3"]
    assert main.main(["bake", str(small_shot), *given], opens_file=True) == 0
    assert read(file)[0]["basis"].shape[-1] == 3
    bpy.ops.wm.open_mainfile(filepath=str(output))
    arm = bpy.data.objects["Arm"]
    assert not arm.dynamorph.bake.exists and model_store.stale_reasons(arm, extract.character(arm)) == []


@pytest.mark.parametrize(
    "options, words",
    [
        (["--solver", "full"], "set Quality to Reduced"),
        (["--method", "static"], "choose another Method"),
        (["--compare-full"], "--compare-full compares a reduced bake: leave out"),
        (["--clips", "actions"], "--clips actions needs --format gltf"),
    ],
)
def test_the_command_line_refuses_before_the_work(shot, run, stand_in, options, words):  # noqa: F811
    code, _, said = run("bake", shot, "--object", "Arm", "--format", "soft_skin", *options)
    assert code == 2 and words in said and "Traceback" not in said
    assert stand_in.built == 0 and [file.name for file in shot.parent.iterdir()] == [shot.name]
