# SPDX-License-Identifier: GPL-3.0-or-later
"""Setups: as files, as presets, and copied to other meshes; and the preferences."""

import json
import sys
import types
from copy import deepcopy
from pathlib import Path

import addon_utils
import bpy
import numpy as np
import pytest
import scenes
from bl_ext.user_default.dynamic_morph_targets import preferences as preferences_module
from bl_ext.user_default.dynamic_morph_targets.core import engine as core_engine
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.core import settings as core_settings
from bl_ext.user_default.dynamic_morph_targets.core.material import presets
from bl_ext.user_default.dynamic_morph_targets.scene import references
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.scene.read import nearest as scene_nearest
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store
from bl_ext.user_default.dynamic_morph_targets.ui.operators import materials
from bl_ext.user_default.dynamic_morph_targets.ui.operators.presets import DYNAMORPH_OT_load_preset
from bl_ext.user_default.dynamic_morph_targets.write import storage
from bl_ext.user_default.dynamic_morph_targets.write.authoring import setups
from builders import activate, add_key, make_arm, make_mesh, make_soft, refused, rig_of
from costs import cost
from installed import MODULE
from layout import Layout
from mathutils import Matrix
from mathutils.bvhtree import BVHTree
from pressed import invoked

OPS = bpy.ops.dynamorph


def add_group(obj, name, weights):
    group = obj.vertex_groups.new(name=name)
    for vertex, weight in enumerate(weights):
        group.add([vertex], float(weight), "REPLACE")


@pytest.fixture
def rich(soft_arm):
    """The soft arm with something authored in every place that a setup knows."""
    settings = soft_arm.dynamorph
    bpy.context.scene.frame_set(10)
    OPS.add_target(key="smile")
    bpy.context.scene.frame_set(1)
    height = np.array([vertex.co.z for vertex in soft_arm.data.vertices])
    for name, weights in (("belly", height / height.max()), ("loose", 1.0 - height / height.max())):
        add_group(soft_arm, name, weights)
    smile = settings.targets["smile"]
    smile.mute, smile.fade_out_angle, smile.region, smile.stiffness, smile.density = True, 0.7, "belly", 54_321.0, 900.1
    settings.firmness_group = "loose"
    settings.model.material_model, settings.model.modes, settings.model.pin_radius = "STVK", 7, 0.31
    settings.simulation.integrator, settings.simulation.gravity, settings.simulation.substeps = "EULER", 0.3, 4
    settings.modes.add().gain = 0.4
    settings.modes.add().solo = True
    settings.collision.use, settings.collision.friction = True, 0.9
    settings.collision.collection = bpy.data.collections.new("Furniture")
    return soft_arm


def setup_of(obj):
    return setups.of_object(obj)


@pytest.fixture
def file(rich, tmp_path):
    """The setup of `rich` as a file."""
    path = tmp_path / "arm.json"
    assert OPS.save_setup(filepath=str(path)) == {"FINISHED"}
    return path


def clear(obj):
    settings = obj.dynamorph
    for group in (settings.model, settings.simulation, settings.collision, settings):
        for prop in group.bl_rna.properties:
            if not prop.is_readonly:
                group.property_unset(prop.identifier)
    settings.targets.clear()
    settings.modes.clear()


# Files ------------------------------------------------------------------------------------------------------------


def test_a_setup_comes_back_as_it_was_saved(rich, file):
    before, character = setup_of(rich), extract.character(rich)
    assert json.loads(file.read_text()) == before
    clear(rich)
    assert setup_of(rich) != before
    assert OPS.load_setup(filepath=str(file)) == {"FINISHED"}
    assert setup_of(rich) == before
    again = extract.character(rich)
    assert (again.settings, [t.name for t in again.targets]) == (character.settings, ["Neutral", "flexed"])
    for old, new in zip(character.targets, again.targets, strict=True):
        np.testing.assert_array_equal(new.local, old.local)
        assert new.material == old.material


def test_a_setup_holds_what_was_authored_and_no_results(rich, stand_in):
    OPS.build()
    setup = setup_of(rich)
    settings = core_settings
    assert set(setup["model"]) == set(vars(settings.ModelSettings()))
    assert set(vars(settings.Material())) < set(setup["targets"][0])
    assert setup["targets"][2]["bones"] == ["lower"] and set(setup["targets"][2]["pose"]) == {"upper", "lower"}
    assert setup["skin"] == {"firmness_group": "loose", "max_distance_group": "", "excluded_group": ""}
    assert [mode["gain"] for mode in setup["modes"][:2]] == [pytest.approx(0.4), 1.0]
    setups.check(json.loads(json.dumps(setup)))


def test_the_same_setup_does_not_make_the_model_out_of_date(rich, file, stand_in):
    OPS.build()
    OPS.load_setup(filepath=str(file))
    assert rich.dynamorph.model.stale == ""
    assert rich.dynamorph.model.content_id


def test_matrices_take_one_line_each_and_names_stay(rich, tmp_path):
    setup = setup_of(rich)
    setup["targets"][1]["name"] = '[\n 1,\n 2 ] ü \\ "'
    setups.write(tmp_path / "odd.json", setup)
    assert setups.read(tmp_path / "odd.json") == setup
    lines = (tmp_path / "odd.json").read_text().splitlines()
    assert sum(line.count(",") >= 15 for line in lines) == 3 * (1 + 2 * 2)  # of the rig, and two for each of two bones


def test_on_another_character_what_is_missing_is_listed_and_skipped(scene, rich, file, capfd):
    other = make_arm(scene, "Leg")
    other.data.shape_keys.key_blocks["smile"].name = "grin"
    rig_of(other).data.bones["upper"].name = "thigh"
    assert OPS.load_setup(filepath=str(file)) == {"FINISHED"}
    out = capfd.readouterr().out
    assert "shape keys 'smile'; bones 'upper'; vertex groups 'loose'" in out and out.count("Warning") == 1
    settings = other.dynamorph
    assert [target.name for target in settings.targets] == ["Neutral", "flexed"]
    assert [bone.name for bone in settings.targets[1].pose] == ["lower"]
    assert (settings.firmness_group, settings.model.modes) == ("", 7)
    assert settings.targets[1].bone_names() == ("lower",)
    extract.character(other)


def test_a_rig_that_rests_otherwise_is_named(scene, rich, file, capfd):
    rig = rig_of(rich)
    activate(rig)
    bpy.ops.object.mode_set(mode="EDIT")
    rig.data.edit_bones["lower"].roll += 0.5
    bpy.ops.object.mode_set(mode="OBJECT")
    assert OPS.load_setup(filepath=str(file)) == {"FINISHED"}  # the armature is active: its soft skin is meant
    assert "the rest pose of bones 'lower'" in capfd.readouterr().out
    stored = rich.dynamorph.targets[1].pose["lower"]
    np.testing.assert_allclose(stored.rest, np.ravel(rig.data.bones["lower"].matrix_local), atol=1e-6)


def test_loading_makes_a_mesh_a_soft_skin(scene, rich, file):
    other = make_arm(scene, "Leg")
    other.shape_key_clear()
    OPS.load_setup(filepath=str(file))
    assert [target.name for target in other.dynamorph.targets] == ["Neutral"]
    assert [key.name for key in other.data.shape_keys.key_blocks] == ["Basis"]
    bare = make_mesh(scene, "Bare", *scenes.tube())
    activate(bare)
    refused(OPS.load_setup, "no Armature modifier", filepath=str(file))
    assert bare.data.shape_keys is None and not bare.dynamorph.targets


def test_loading_is_undone(rich, file):
    bpy.ops.ed.undo_push(message="before")
    rich.dynamorph.targets[1].stiffness = 1.0e5
    before = setup_of(rich)
    bpy.ops.ed.undo_push(message="changed")
    OPS.load_setup(filepath=str(file))
    bpy.ops.ed.undo_push(message="loaded")
    bpy.ops.ed.undo()
    assert setup_of(bpy.data.objects["Arm"]) == before


def drop(path, editor="VIEW_3D"):
    """What Blender calls when a file is dropped onto an editor of its window."""
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == editor)
    with bpy.context.temp_override(window=window, area=area):
        return bpy.ops.wm.drop_import_file("INVOKE_DEFAULT", directory=str(path.parent), files=[{"name": path.name}])


@pytest.mark.parametrize("editor", ["VIEW_3D", "PROPERTIES"])
def test_a_setup_is_dropped_onto_an_editor(rich, file, editor, capfd):
    before = setup_of(rich)
    clear(rich)
    drop(file, editor)
    assert setup_of(rich) == before and "Setup 'arm.json' applied to 'Arm'" in capfd.readouterr().out


def test_another_json_that_is_dropped_is_refused(rich, tmp_path, capfd):
    before, other = setup_of(rich), tmp_path / "other.json"
    other.write_text('{"format": "scene"}')
    drop(other)
    assert setup_of(rich) == before
    printed = capfd.readouterr()
    assert "'other.json': This is not a Dynamorph setup" in printed.out + printed.err


def test_a_setup_is_dropped_only_where_a_mesh_can_take_it(rich, file):
    before = setup_of(rich)
    rich.dynamorph.model.modes = 3
    drop(file, "OUTLINER")
    activate(None)
    drop(file)
    assert rich.dynamorph.model.modes == 3
    activate(rig_of(rich))
    drop(file)
    assert setup_of(rich) == before


def test_a_setup_from_the_file_browser(rich, file):
    """Without a file it asks for one, also after another one was loaded."""
    drop(file)
    asked = []
    invoked(rich, "DYNAMORPH_OT_load_setup", fileselect_add=asked.append)
    assert len(asked) == 1


def changed(*path, to):
    """A change of a setup: the value at `path`, which may be new."""

    def change(setup):
        *way, last = path
        for step in way:
            setup = setup[step]
        setup[last] = to

    return change


def dropped(*path):
    def change(setup):
        *way, last = path
        for step in way:
            setup = setup[step]
        del setup[last]

    return change


FLAT = [0.0] * 16


@pytest.mark.fault("P08")
@pytest.mark.parametrize(
    "change, words",
    [
        (changed("format", to="scene"), "not a Dynamorph setup"),
        (dropped("format"), "not a Dynamorph setup"),
        (changed("version", to=2), "version 2, this add-on reads 1 to 1: update"),
        (changed("version", to=True), "version True"),
        (dropped("version"), "version None"),
        (dropped("targets"), "no list of targets"),
        (changed("targets", to=[]), "no list of targets"),
        (changed("targets", to={}), "no list of targets"),
        (changed("targets", 1, to="flexed"), "has no name"),
        (changed("targets", 1, "name", to=7), "has no name"),
        (changed("targets", 2, "name", to="flexed"), "Two targets are called 'flexed'"),
        (changed("targets", 1, "stiffness", to="soft"), "'flexed': stiffness is 'soft', but must be a number from"),
        (changed("targets", 1, "stiffness", to=float("nan")), "stiffness is nan"),
        (changed("targets", 1, "stiffness", to=float("inf")), "stiffness is inf"),
        (changed("targets", 1, "stiffness", to=10**400), "stiffness is 1000"),
        (changed("targets", 1, "stiffness", to=-1), "stiffness is -1"),
        (changed("targets", 1, "mute", to=1), "mute is 1, but must be true or false"),
        (changed("targets", 1, "region", to=None), "region is None, but must be a text"),
        (changed("targets", 1, "region", to="a\0b"), "region is"),
        (changed("targets", 1, "region", to="\ud800"), "region is"),
        (changed("targets", 1, "viscosity", to=1.0), "'viscosity' that this add-on does not know"),
        (changed("targets", 1, "key_hash", to="0"), "'key_hash' that this add-on does not know"),
        (changed("targets", 1, "bones", to="lower"), "bones must be a list of names"),
        (changed("targets", 1, "bones", to=[["lower"]]), "bones must be a list of names"),
        (changed("targets", 1, "pose", to=[]), "pose must have an entry for each bone"),
        (
            changed("targets", 1, "pose", "lower", "local", to=FLAT),
            "local of bone 'lower' is a transform",
        ),
        (changed("targets", 1, "pose", "lower", "local", to=FLAT[1:]), "but must be 16 numbers"),
        (changed("targets", 1, "pose", "lower", "local", to=["x"] * 16), "but must be 16 numbers"),
        (changed("targets", 1, "pose", "lower", to=3), "must have properties by name"),
        (dropped("targets", 1, "pose", "lower", "rest"), "rest and local are needed"),
        (changed("targets", 0, "rig_world", to=FLAT), "'Neutral': rig_world is a transform that flattens"),
        (
            changed("model", "material_model", to="JELLY"),
            "material_model is 'JELLY', but must be one of LINEAR, STVK, STABLE_STVK",
        ),
        (changed("model", "material_model", to=["STVK"]), "material_model is"),
        (changed("model", "material_model", to="\ud800"), "material_model is"),
        (changed("model", "material_model", to="\0"), "material_model is"),
        (changed("model", "modes", to=2.5), "modes is 2.5, but must be a whole number from 1 to 400"),
        (changed("model", "content_id", to="0" * 32), "'content_id' that this add-on does not know"),
        (changed("model", to=[]), "Model must have properties by name"),
        (changed("simulation", "frame_end", to=2**40), "frame_end is"),
        (changed("skin", "targets", to=[]), "'targets' that this add-on does not know"),
        (changed("modes", to=3), "no list of targets"),
        (changed("modes", 0, "gain", to=-3), "Mode 1: gain is -3"),
        (
            changed("targets", to=[{"name": f"target {k}"} for k in range(20_000)]),
            "20000 targets, and 1000 are the most",
        ),
        (changed("modes", to=[{"gain": 1.0}] * 10**6), "1000000 modes, and 1000 are the most"),
        (changed("attachments", to=[{"group": "tip"}] * 2000), "2000 attachments, and 1000 are the most"),
        (changed("targets", 1, "pose", to={str(k): {} for k in range(10**5)}), "posed bones, and 100000 are the most"),
    ],
)
def test_a_wrong_file_is_refused_and_nothing_changed(rich, tmp_path, change, words):
    before = setup_of(rich)
    wrong = setup_of(rich)
    wrong["targets"][0]["stiffness"] = 99.0  # it would be written first
    change(wrong)
    path = tmp_path / "wrong.json"
    path.write_text(json.dumps(wrong))
    refused(OPS.load_setup, words, filepath=str(path))
    assert setup_of(rich) == before


@pytest.mark.parametrize(
    "content", [b"", b"dynamorph", b"\xff\xfe", b"[" * 100_000, b"[1]", b'"x"', b"null", b"9" * 9999]
)
def test_other_files_are_refused(rich, tmp_path, content):
    path = tmp_path / "other.json"
    path.write_bytes(content)
    refused(OPS.load_setup, "'other.json': This is not a Dynamorph setup", filepath=str(path))
    refused(OPS.load_setup, "No such file", filepath=str(tmp_path / "none.json"))


def test_many_names_are_looked_up_soon(rich, tmp_path):
    """Ten times as many cost about ten times as much, not a hundred times."""
    setup = setup_of(rich)
    path = tmp_path / "many.json"

    def cost_of(bones: int) -> float:
        many = deepcopy(setup)
        many["targets"][1]["bones"] = [f"bone {k}" for k in range(bones)]
        many["targets"] += [{"name": f"target {k}"} for k in range(bones // 200)]
        path.write_text(json.dumps(many))
        return cost(lambda: OPS.load_setup(filepath=str(path)))

    assert cost_of(100_000) < 30 * cost_of(10_000)


def test_what_no_file_may_hold_is_not_saved(rich, tmp_path):
    path = tmp_path / "arm.json"
    path.write_text("the last good one")
    rich.dynamorph.targets[1].stiffness = float("nan")
    refused(OPS.save_setup, "'flexed': stiffness is nan", filepath=str(path))
    assert path.read_text() == "the last good one" and list(tmp_path.iterdir()) == [path]


def test_what_a_file_leaves_out_stays(rich, tmp_path):
    path = tmp_path / "small.json"
    small = {"format": "dynamorph setup", "version": 1, "targets": [{"name": "Neutral"}, {"name": "flexed"}]}
    path.write_text(json.dumps(small))
    OPS.load_setup(filepath=str(path))
    settings = rich.dynamorph
    assert (settings.model.modes, settings.simulation.integrator, settings.firmness_group) == (7, "EULER", "loose")
    assert settings.targets[1].stiffness == core_settings.Material().stiffness
    assert len(settings.targets[1].pose) == 0  # every bone at rest


# Presets ----------------------------------------------------------------------------------------------------------


def preset_file(kind, name):
    return Path(bpy.utils.user_resource("SCRIPTS")) / "presets" / "dynamorph" / kind / f"{name}.py"


def use(kind, name):
    return OPS.load_preset(filepath=str(preset_file(kind, name)), menu_idname=f"DYNAMORPH_PT_{kind}_presets")


@pytest.mark.parametrize("on_the_rig", [False, True])
def test_a_material_of_ones_own(rich, on_the_rig):
    neutral, flexed, _ = rich.dynamorph.targets
    rich.dynamorph.active_target_index = 1
    flexed.stiffness, flexed.poisson, flexed.mass_damping = 12_345.6, 0.33, 2.5
    before, untouched = flexed.material(), neutral.material()
    if on_the_rig:
        activate(rig_of(rich))
    assert OPS.material_preset(name="My Jelly") == {"FINISHED"}
    assert preset_file("material", "My_Jelly").is_file()
    flexed.set_material(presets.PRESETS["SKIN"].material)
    assert use("material", "My_Jelly") == {"FINISHED"}
    assert flexed.material() == before and neutral.material() == untouched
    assert rich.dynamorph.model.modes == 7
    assert "My Jelly" in texts("DYNAMORPH_PT_material_presets")
    assert OPS.material_preset(name="My Jelly", remove_name=True) == {"FINISHED"}
    assert not preset_file("material", "My_Jelly").exists()


def test_a_whole_setup_as_preset(rich):
    settings = rich.dynamorph
    before = setup_of(rich)
    assert OPS.setup_preset(name="Jelly") == {"FINISHED"}
    clear_settings = settings.model, settings.simulation
    for group in clear_settings:
        for name in setups.authored(group):
            group.property_unset(name)
    settings.simulation.frame_start, settings.simulation.frame_end = 40, 50
    assert use("setup", "Jelly") == {"FINISHED"}
    after = setup_of(rich)
    assert after["model"] == before["model"] and after["targets"] == before["targets"]
    frames = {"use_scene_range": True, "frame_start": 40, "frame_end": 50}  # of the shot, not of the character
    assert after["simulation"] == before["simulation"] | frames
    assert OPS.setup_preset(name="Jelly", remove_name=True) == {"FINISHED"}
    assert not preset_file("setup", "Jelly").exists()


def test_a_preset_is_undone_and_does_not_make_the_model_out_of_date(rich, stand_in):
    OPS.build()
    OPS.setup_preset(name="Same")
    assert use("setup", "Same") == {"FINISHED"}
    assert rich.dynamorph.model.stale == ""
    OPS.setup_preset(name="Same", remove_name=True)
    assert "UNDO" in DYNAMORPH_OT_load_preset.bl_options


@pytest.mark.parametrize("basis", ["MODES", "RESPONSES"])
def test_a_preset_has_the_modes_that_it_was_saved_with(rich, basis):
    model = rich.dynamorph.model
    model.basis, model.modes = basis, 33
    OPS.setup_preset(name="Modes")
    model.basis, model.modes = "RESPONSES" if basis == "MODES" else "MODES", 7
    assert use("setup", "Modes") == {"FINISHED"}
    assert (model.basis, model.modes) == (basis, 33)
    OPS.setup_preset(name="Modes", remove_name=True)


def test_presets_need_a_target(scene, arm):
    for operator in (OPS.material_preset, OPS.setup_preset, OPS.load_preset):
        assert not operator.poll()


def texts(panel):
    """What a preset panel draws."""
    out = []
    kind = getattr(bpy.types, panel)
    self = types.SimpleNamespace(layout=PresetLayout(out))
    for name in dir(kind):
        if name.startswith("preset_") or name in ("path_menu", "bl_idname"):
            value = getattr(kind, name)
            setattr(self, name, types.MethodType(value, self) if callable(value) else value)
    kind.draw(self, bpy.context)
    return out


class PresetLayout(Layout):
    def operator(self, name, text="", **options):
        settings = super().operator(name, **options)
        self.drawn.append(text)
        return settings


def test_the_material_menu_lists_the_measured_ones_first(rich):
    OPS.material_preset(name="Ogre")
    try:
        drawn = [text for text in texts("DYNAMORPH_PT_material_presets") if text]
    finally:
        OPS.material_preset(name="Ogre", remove_name=True)
    labels = [preset.label for preset in presets.PRESETS.values()]
    assert [text for text in drawn if text in labels] == labels
    assert drawn.index("Ogre") > drawn.index(labels[-1]) and "dynamorph.material_preset" in drawn
    described = materials.DYNAMORPH_OT_apply_material.description
    given = types.SimpleNamespace(preset="FAT", is_property_set=lambda _name: True)
    assert described(bpy.context, given) == presets.PRESETS["FAT"].source


def test_before_the_first_preset_there_is_no_complaint(rich):
    assert not [text for text in texts("DYNAMORPH_PT_setup_presets") if "Missing" in text]


# Copies to other meshes -------------------------------------------------------------------------------------------


def twin(obj, name="Twin", keys=False):
    """A copy without a soft skin, and without shape keys unless asked for."""
    other = obj.copy()
    other.data = obj.data.copy()
    other.name = name
    bpy.context.scene.collection.objects.link(other)
    other.dynamorph.targets.clear()
    if not keys:
        other.shape_key_clear()
        for group in ("belly", "loose"):
            other.vertex_groups.remove(other.vertex_groups[group])
    return other


def select(source, *others):
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj in (source, *others))
    activate(source)
    bpy.context.view_layer.update()


def shape(obj, name):
    return mesh_data.target_shape(obj, name)


def weights(obj, name):
    return mesh_data.group_weights(obj, [name])[:, 0]


def test_an_identical_mesh_gets_the_same(rich, capfd):
    other = twin(rich)
    select(rich, other)
    assert OPS.copy_to_selected() == {"FINISHED"}
    assert setup_of(other) == setup_of(rich)
    for name in ("flexed", "smile"):
        np.testing.assert_array_equal(
            references.key_points(other.data.shape_keys.key_blocks[name]),
            references.key_points(rich.data.shape_keys.key_blocks[name]),
        )
        assert other.data.shape_keys.key_blocks[name].value == 0.0
    for name in ("belly", "loose"):
        np.testing.assert_array_equal(weights(other, name), weights(rich, name))
    out = capfd.readouterr().out
    assert "'Twin': at most 0 m away from 'Arm'" in out and "Warning" not in out
    expected, got = extract.character(rich), extract.character(other)
    for old, new in zip(expected.targets, got.targets, strict=True):
        np.testing.assert_array_equal(new.shape, old.shape)


def test_a_subdivided_mesh_gets_what_lies_between(rich):
    other = twin(rich)
    count = len(rich.data.vertices)
    activate(other)
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.subdivide()
    bpy.ops.object.mode_set(mode="OBJECT")
    edges = {tuple(sorted(edge.vertices)) for edge in rich.data.edges}
    select(rich, other)
    assert OPS.copy_to_selected() == {"FINISHED"}
    source, carried = shape(rich, "flexed"), shape(other, "flexed")
    np.testing.assert_array_equal(carried[:count], source)
    places = {tuple(vertex.co): index for index, vertex in enumerate(other.data.vertices)}
    middles = 0
    for a, b in edges:
        middle = places[tuple((rich.data.vertices[a].co + rich.data.vertices[b].co) / 2)]
        np.testing.assert_allclose(carried[middle], (source[a] + source[b]) / 2, atol=1e-6)
        middles += 1
    assert middles == len(edges) > count


@pytest.mark.parametrize("scale", [(2.0, 0.5, 3.0), (-1.0, 1.0, 1.0)])
def test_scales_and_rotations_of_both_are_carried_along(rich, scale):
    """A mesh in the same place that stores its points in another space."""
    other = twin(rich)
    rich.matrix_world = Matrix.LocRotScale((1, 2, 3), Matrix.Rotation(0.5, 3, "X"), (1.5, 1.5, 0.7))
    bpy.context.view_layer.update()
    into = Matrix.LocRotScale((-3, 0, 1), Matrix.Rotation(1.0, 3, "Y"), scale)
    other.data.transform(into.inverted() @ rich.matrix_world)
    other.matrix_world = into
    select(rich, other)
    assert OPS.copy_to_selected() == {"FINISHED"}
    in_world = [shape(obj, "flexed") @ np.array(obj.matrix_world)[:3, :3].T for obj in (rich, other)]
    np.testing.assert_allclose(in_world[1], in_world[0], atol=1e-5)
    assert np.abs(in_world[0]).max() > 0.05


def test_others_stay_as_they_are_unless_asked(rich, capfd):
    other = twin(rich, keys=True)
    other.data.shape_keys.key_blocks["flexed"].points[0].co.x += 1.0
    other.vertex_groups["belly"].add([0], 0.123, "REPLACE")
    add_key(other, "own", 0.1)
    bones = weights(other, "lower")
    mine, own = shape(other, "flexed"), shape(other, "own")
    select(rich, other)
    assert OPS.copy_to_selected() == {"FINISHED"}
    np.testing.assert_array_equal(shape(other, "flexed"), mine)
    assert weights(other, "belly")[0] == pytest.approx(0.123)
    refused(OPS.copy_to_selected, "'Twin' has a soft skin already", overwrite=True)
    np.testing.assert_array_equal(shape(other, "flexed"), mine)
    assert OPS.copy_to_selected(overwrite=True, replace=True) == {"FINISHED"}
    np.testing.assert_array_equal(shape(other, "flexed"), shape(rich, "flexed"))
    np.testing.assert_array_equal(weights(other, "belly"), weights(rich, "belly"))
    np.testing.assert_array_equal(shape(other, "own"), own)
    np.testing.assert_array_equal(weights(other, "lower"), bones)


def test_a_region_that_is_a_bones_group_leaves_the_skin_weights_alone(rich):
    other = twin(rich)
    rich.dynamorph.targets["smile"].region = "lower"
    other.vertex_groups["lower"].add([0], 0.77, "REPLACE")
    select(rich, other)
    OPS.copy_to_selected(overwrite=True)
    assert weights(other, "lower")[0] == pytest.approx(0.77)
    assert other.dynamorph.targets["smile"].region == "lower"


def test_a_replaced_soft_skin_loses_its_bake_and_model(rich, stand_in):
    other = twin(rich, keys=True)
    make_soft(other, keys=("smile",))
    OPS.bake()
    assert other.dynamorph.bake.keys
    select(rich, other)
    assert OPS.copy_to_selected(replace=True) == {"FINISHED"}
    assert not other.dynamorph.bake.keys and not other.dynamorph.model.content_id
    assert [key.name for key in other.data.shape_keys.key_blocks] == ["Basis", "flexed", "smile"]
    assert not any(key.mute for key in other.data.shape_keys.key_blocks)
    assert [target.name for target in other.dynamorph.targets] == ["Neutral", "flexed", "smile"]


def test_copies_that_are_refused_change_nothing(scene, rich):
    good = twin(rich, "Good")
    bad = twin(rich, "Bad")
    untouched = len(bpy.data.shape_keys)

    def is_refused(words):
        select(rich, good, bad)
        refused(OPS.copy_to_selected, words)
        assert len(bpy.data.shape_keys) == untouched and not good.dynamorph.targets

    rig = bad.modifiers["Armature"].object
    bad.modifiers["Armature"].object = None
    is_refused("'Bad' has no Armature modifier")
    bad.modifiers["Armature"].object = rig_of(make_arm(scene, "Leg"))
    untouched = len(bpy.data.shape_keys)
    is_refused("'Bad' is moved by another armature: choose 'Arm Rig'")
    bad.modifiers["Armature"].object = rig
    bad.scale = (0, 0, 0)
    is_refused("'Bad' is scaled to zero")
    bad.scale = (1, 1, 1)
    bad.data.vertices[3].co.x = float("nan")
    is_refused("'Bad' has vertices whose coordinates are not numbers")
    bad.data, own = rich.data, bad.data
    is_refused("Mesh 'Arm' is shared by 2 objects")
    bad.data = own
    bad.data.clear_geometry()
    is_refused("no faces")
    rich.data.shape_keys.key_blocks["flexed"].name = "Basis 2"
    select(rich)
    assert not OPS.copy_to_selected.poll()


def test_a_far_mesh_is_reported(rich, capfd):
    other = twin(rich)
    other.location.x = 5.0
    select(rich, other)
    assert OPS.copy_to_selected() == {"FINISHED"}
    assert "'Twin' is up to 5" in capfd.readouterr().out


def test_the_dialog_only_asks_where_something_would_be_lost(rich):
    for keys, result in ((False, "FINISHED"), (True, "CANCELLED")):
        other = twin(rich, keys=keys)
        select(rich, other)
        name = "DYNAMORPH_OT_copy_to_selected"
        assert invoked(rich, name, invoke_props_dialog=lambda _button: {"CANCELLED"}) == {result}
        assert bool(other.dynamorph.targets) != keys


def test_nearest_points_of_a_surface():
    """They are compared with a dense sampling of the triangles, and are exact at the vertices."""
    rng = np.random.default_rng(3)
    vertices = rng.normal(size=(30, 3))
    triangles = np.concatenate([rng.permutation(30).reshape(-1, 3) for _ in range(3)])
    triangles = np.concatenate([triangles, [[0, 0, 1], [2, 2, 2]]])  # without area
    points = np.concatenate([rng.normal(size=(200, 3)) * 2.0, vertices])
    found = scene_nearest.nearest(points, vertices, triangles)
    steps = np.linspace(0.0, 1.0, 60)
    grid = np.array([(1 - a - b, a, b) for a in steps for b in steps if a + b <= 1.0 + 1e-9])
    dense = np.einsum("gc,tcx->tgx", grid, vertices[triangles]).reshape(-1, 3)
    best = np.array([np.linalg.norm(dense - point, axis=1).min() for point in points])
    assert (found.distances <= best + 1e-6).all() and (found.distances >= best - 0.06).all()
    assert (found.weights >= 0.0).all()
    np.testing.assert_allclose(found.weights.sum(axis=1), 1.0, rtol=1e-12)
    used = np.unique(triangles[:-2])
    np.testing.assert_array_equal(found.carry(vertices)[200:][used], vertices[used])


def test_nearest_points_of_triangles_whose_corners_are_in_a_line():
    """Rounding is an exception: it leaves the coordinates on their planes to chance."""
    rng = np.random.default_rng(4)
    start, along = rng.uniform(-1.0, 1.0, (2000, 3)), 0.1 * rng.normal(size=(2000, 3))
    corners = np.stack([start, start + along, start + 0.5 * along], axis=1)
    points = start + rng.uniform(0.0, 1.0, (2000, 1)) * along
    for point, triangle in zip(points, corners, strict=True):
        found = scene_nearest.nearest(point[None], triangle, np.array([[0, 1, 2]]))
        np.testing.assert_allclose(found.carry(triangle), point[None], atol=1e-14)


def test_the_nearest_points_cost_little_more_than_to_find_their_triangles(addon):
    """Of a character of 13,000 vertices, with what is carried to them."""
    nearest = scene_nearest.nearest
    side = 115
    x, y = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    vertices = np.stack([x, y, np.sin(x * 0.1) * 5], axis=-1).reshape(-1, 3) * 0.01
    corner = (x * side + y)[:-1, :-1].ravel()
    triangles = np.concatenate(
        [[corner, corner + 1, corner + side], [corner + 1, corner + side + 1, corner + side]], 1
    ).T
    rng = np.random.default_rng(1)
    points = vertices + rng.normal(size=vertices.shape) * 0.002

    def carried():
        found = nearest(points, vertices, triangles)
        for _ in range(10):
            found.carry(vertices)

    def triangles_found():
        tree = BVHTree.FromPolygons(vertices.tolist(), triangles.tolist(), all_triangles=True)
        for point in points.tolist():
            tree.find_nearest(point)

    assert cost(carried) < 4 * cost(triangles_found)
    assert nearest(points, vertices, triangles).distances.max() < 0.01


# Preferences ------------------------------------------------------------------------------------------------------


@pytest.fixture
def chosen(scene):
    preferences = bpy.context.preferences.addons[MODULE].preferences
    yield preferences
    for name in ("model_folder", "threads"):
        preferences.property_unset(name)


def test_large_models_go_where_the_user_wants(soft_arm, stand_in, tmp_path, monkeypatch, chosen):
    monkeypatch.setattr(storage, "PACK_LIMIT", 100)
    chosen.model_folder = str(tmp_path / "models")
    OPS.build()  # even though the .blend has no folder yet
    name = f"{soft_arm.dynamorph.model.content_id}.dynamorph"
    assert [file.name for file in (tmp_path / "models").iterdir()] == [name]
    assert model_store.stored_model(soft_arm)
    (tmp_path / "shots").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shots" / "arm.blend"))
    chosen.model_folder = "//cache/models"
    with pytest.raises(errors.ModelFileError, match="missing"):
        model_store.stored_model(soft_arm)
    OPS.build()
    assert (tmp_path / "shots" / "cache" / "models" / name).is_file()
    chosen.model_folder = "//elsewhere"  # another user still finds a model beside the .blend
    (tmp_path / "shots" / "cache" / "models").rename(tmp_path / "shots" / "dynamorph_models")
    assert model_store.stored_model(soft_arm)
    soft_arm.dynamorph.model.content_id = "../../etc/passwd"
    with pytest.raises(errors.ModelFileError, match="elsewhere"):
        model_store.stored_model(soft_arm)


def test_threads_are_passed_to_the_engine_by_whatever_uses_it_first(soft_arm, monkeypatch, chosen):
    dynamorph = pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    counts = []
    fake = types.SimpleNamespace(set_threads=counts.append, unpack_model=dynamorph.unpack_model, Error=RuntimeError)
    monkeypatch.delitem(sys.modules, "dynamorph", raising=False)
    chosen.threads = 3  # nothing is loaded for it
    assert "dynamorph" not in sys.modules
    monkeypatch.setitem(sys.modules, "dynamorph", fake)
    assert core_engine.dynamorph.Error is RuntimeError  # what any module does that uses the engine
    assert counts == [3]
    chosen.threads = 0
    assert counts == [3, 0]
    assert core_engine.dynamorph.Error is RuntimeError  # what any module does that uses the engine
    assert counts == [3, 0]


def test_threads_chosen_before_the_add_on_starts_are_passed_on(scene, monkeypatch):
    counts = []
    engine = types.SimpleNamespace(set_threads=counts.append, Error=RuntimeError)
    bpy.context.preferences.addons[MODULE].preferences.threads = 5
    try:
        addon_utils.disable(MODULE)
        core_engine.use_threads(0)
        monkeypatch.setitem(sys.modules, "dynamorph", engine)
        addon_utils.enable(MODULE)
        assert counts == [5]
    finally:
        monkeypatch.undo()
        bpy.context.preferences.addons[MODULE].preferences.threads = 0


def test_the_preferences_show_the_engine(chosen, monkeypatch):
    def drawn():
        out = []
        type(chosen).draw(_Drawing(chosen, Layout(out)), None)
        return out

    preferences = preferences_module
    monkeypatch.setattr(core_engine, "engine_problem", lambda: "")
    monkeypatch.setattr(preferences, "installed_version", lambda: "1.2.3")
    assert drawn() == ["model_folder", "threads", "Engine: version 1.2.3"]
    monkeypatch.setattr(core_engine, "engine_problem", lambda: "The engine cannot be loaded")
    assert drawn()[-1] == "The engine cannot be loaded"


class _Drawing:
    def __init__(self, preferences, layout):
        self.bl_rna, self.layout = preferences.bl_rna, layout


def test_a_setup_replaces_no_file_of_another_kind(soft_arm, tmp_path):
    path = tmp_path / "shot.blend"
    path.write_bytes(b"mine")
    with pytest.raises(RuntimeError, match="A setup is a .json, 'shot.blend' is not"):
        bpy.ops.dynamorph.save_setup(filepath=str(path))
    assert path.read_bytes() == b"mine"
