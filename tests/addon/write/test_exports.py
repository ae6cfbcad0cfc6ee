# SPDX-License-Identifier: GPL-3.0-or-later
"""A baked character in other formats: written, read back by others and by Blender, and compared at each frame."""

import re
import types
from functools import partial
from pathlib import Path

import bpy
import numpy as np
import pytest
import round_trips
from bl_ext.user_default.dynamic_morph_targets.core import errors, records
from bl_ext.user_default.dynamic_morph_targets.core.result import keys
from bl_ext.user_default.dynamic_morph_targets.io import disk, point_cache
from bl_ext.user_default.dynamic_morph_targets.run.bake import export_actions
from bl_ext.user_default.dynamic_morph_targets.scene import animation, references
from bl_ext.user_default.dynamic_morph_targets.scene.motion import run_settings
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store, staleness
from bl_ext.user_default.dynamic_morph_targets.ui.operators import export as operators_export
from bl_ext.user_default.dynamic_morph_targets.write.bake import influence, writer
from bl_ext.user_default.dynamic_morph_targets.write.export import exports, losses
from builders import activate, fingerprint, hand_made_bake, keys_of, make_arm, make_soft, rig_of, skinning_of
from built import SmallModel
from layout import Layout
from round_trips import farthest

FRAMES = 1, 20
EVERY = range(1, 21)
posed = partial(round_trips.shown, frames=EVERY)  # of a mesh's name
CLOSE = 1e-5
built = SmallModel()


@pytest.fixture
def baked(soft_arm):
    """The arm with a bake of every frame."""
    bake = hand_made_bake(soft_arm)
    writer.write_keys(soft_arm, bake)
    return soft_arm, bake


READERS = {  # of a posed surface: format, who reads, whether the vertices come in the same order
    "GLTF": (round_trips.by_import("import_scene.gltf", from_0=True), False),
    "GLTF by pygltflib": (round_trips.by_pygltflib, False),
    "FBX": (round_trips.FBX, True),
    "ALEMBIC": (round_trips.ALEMBIC, True),
    "USD": (round_trips.by_import("wm.usd_import"), True),
    "USD by usd-core": (round_trips.by_usd_core, True),
}


def off(name, path, exact, mesh="Arm"):
    """The distance between a reader's surface and the exact one."""
    read, same_order = READERS[name]
    try:
        return farthest(read(path, mesh, EVERY), exact, same_order)
    except round_trips.ReaderMissing as missing:
        pytest.skip(str(missing))


def written(obj, key, folder):
    """The path of an export."""
    path = folder / f"{obj.name}{exports.FORMATS[key].suffix}"
    export_actions.export(obj, key, path, FRAMES)
    return path


@pytest.mark.parametrize("name", READERS)
def test_what_blender_shows_is_read_back(baked, tmp_path, name):
    obj, _ = baked
    exact, before = posed("Arm"), fingerprint(obj)
    path = written(obj, name.split()[0], tmp_path)
    assert fingerprint(obj) == before
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    assert off(name, path, exact) < CLOSE


@pytest.mark.parametrize("key", ["GLTF", "FBX", "ALEMBIC", "USD"])
def test_an_export_changes_neither_selection_nor_mode(scene, baked, tmp_path, key):
    obj, _ = baked
    other = make_arm(scene, "Other")
    other.select_set(True)
    activate(rig_of(obj))
    bpy.ops.object.mode_set(mode="POSE")
    chosen = [each.name for each in bpy.context.selected_objects]
    written(obj, key, tmp_path)
    assert rig_of(obj).mode == "POSE" and bpy.context.object == rig_of(obj)
    assert [each.name for each in bpy.context.selected_objects] == chosen
    assert not bpy.data.collections


@pytest.mark.parametrize("name", READERS)
def test_what_stands_beside_the_character_stays_out(scene, baked, tmp_path, name):
    """Whether they are selected or not, and in whichever scenes they are."""
    obj, _ = baked
    make_arm(scene, "Other").select_set(True)
    bpy.data.scenes.new("Second").collection.objects.link(obj)
    exact, path = posed("Arm"), written(obj, name.split()[0], tmp_path)
    assert off(name, path, exact) < CLOSE
    assert b"Other" not in path.read_bytes()


def test_gltf_holds_the_bake_s_shapes_and_values(baked, tmp_path):
    """The surface before skinning: rest + weights . morph targets."""
    pytest.importorskip("pygltflib")
    obj, bake = baked
    exact = key_positions(obj) + np.array([bake.displacement(k) for k in range(len(bake.frames))])
    file = round_trips.Gltf(written(obj, "GLTF", tmp_path))
    times = file.times(None) * bpy.context.scene.render.fps
    assert times == pytest.approx(np.array(EVERY) - 1, abs=1e-3)  # a clip begins at 0 s
    assert farthest(file.morphed("Arm"), exact, same_order=False) < CLOSE


def test_a_point_cache_is_exported_as_a_surface_only(baked, tmp_path):
    obj, bake = baked
    file = tmp_path / "arm.pc2"
    disk.save(file, point_cache.point_cache(bake, key_positions(obj)))
    writer.write_keys(obj, keys.targets_alone(bake), cache=file)
    exact = posed("Arm")
    for key in ("GLTF", "FBX"):
        with pytest.raises(errors.ExportError, match="'Arm' is a point cache.*bake to Shape Keys first"):
            export_actions.export(obj, key, tmp_path / "Arm.file", FRAMES)
    content = file.read_bytes()
    for spoiled in (content[:-1], content[:20], b"", None):  # Blender shows the plain skin then
        file.unlink() if spoiled is None else file.write_bytes(spoiled)
        for key in ("ALEMBIC", "USD"):
            with pytest.raises(errors.ExportError, match=f"'{file.name}' of 'Arm' is missing or damaged: bring"):
                written(obj, key, tmp_path)
    file.write_bytes(content)
    paths = {key: written(obj, key, tmp_path) for key in ("ALEMBIC", "USD")}
    for key, path in paths.items():
        assert off(key, path, exact) < CLOSE


def key_positions(obj):
    return references.key_points(keys_of(obj).reference_key).astype(float)


@pytest.mark.parametrize("key", ["ALEMBIC", "USD"])
def test_a_model_that_is_kept_with_the_object_is_not_exported(baked, tmp_path, key):
    """Blender's exporter would crash on bytes, which the first versions stored."""
    obj, _ = baked
    obj.pop(model_store.PACKED, None)
    obj[model_store.PACKED] = b"a\0b"
    path = written(obj, key, tmp_path)
    assert model_store.PACKED.encode() not in path.read_bytes()


def test_blenders_own_exporter_accepts_a_model(soft_arm, stand_in, tmp_path):
    """All custom properties are written by default."""
    bpy.ops.dynamorph.build()
    assert model_store.PACKED in soft_arm
    bpy.ops.wm.alembic_export(filepath=str(tmp_path / "own.abc"), as_background_job=False)
    assert (tmp_path / "own.abc").is_file()


def test_drivers_actions_and_influence_are_exported_as_shown(scene, baked, tmp_path):
    """Everything that moves a key counts, not only the bake: sampled, and left as it was."""
    obj, _ = baked
    smile = keys_of(obj).key_blocks["smile"]
    driver = smile.driver_add("value").driver
    driver.expression = "0.05 * frame"
    influence.influence_strip(obj).influence = 0.5
    exact, before = posed("Arm"), fingerprint(obj)
    assert any("drivers are not exported" in text and "smile" in text for text in losses.losses(obj, "GLTF"))
    path = written(obj, "GLTF", tmp_path)
    assert fingerprint(obj) == before
    assert off("GLTF", path, exact) < CLOSE


def add_sleeve(scene, obj):
    """Another mesh on the same armature."""
    sleeve = make_arm(scene, "Sleeve")
    bpy.data.actions.remove(rig_of(sleeve).animation_data.action)
    bpy.data.objects.remove(rig_of(sleeve))
    sleeve.modifiers["Armature"].object = rig_of(obj)
    sleeve.location.x = 0.5
    bpy.context.view_layer.objects.active = obj
    return sleeve


@pytest.mark.parametrize("name", READERS)
def test_what_moves_with_the_tissue_is_exported_too(scene, baked, tmp_path, name):
    obj, _ = baked
    sleeve = add_sleeve(scene, obj)
    writer.write_keys(sleeve, hand_made_bake(obj, seed=2), obj)
    exact, before = posed("Sleeve"), fingerprint(sleeve)
    path = written(obj, name.split()[0], tmp_path)
    assert fingerprint(sleeve) == before
    assert off(name, path, exact, "Sleeve") < CLOSE


@pytest.mark.parametrize("name", ["GLTF by pygltflib", "FBX"])
def test_fewer_keys_are_exported_as_shown(soft_arm, tmp_path, name):
    bake = hand_made_bake(soft_arm, modes=6)
    writer.write_keys(soft_arm, keys.with_fewer_keys(bake, 2))
    path, exact = written(soft_arm, name.split()[0], tmp_path), posed("Arm")
    assert off(name, path, exact) < CLOSE


def more_bones(obj):
    for group in (obj.vertex_groups.new(name=f"b{i}") for i in range(5)):
        group.add([0], 0.1, "REPLACE")
        bpy.context.view_layer.objects.active = rig_of(obj)
        bpy.ops.object.mode_set(mode="EDIT")
        bone = rig_of(obj).data.edit_bones.new(group.name)
        bone.head, bone.tail = (0, 0, 0), (0, 1, 0)
        bpy.ops.object.mode_set(mode="OBJECT")


def bend(obj):
    rig_of(obj).data.bones["lower"].bbone_segments = 4


def subdivide_first(obj):
    obj.modifiers.new("Subdivision", "SUBSURF")
    obj.modifiers.move(1, 0)


def skin_twice(obj):
    obj.modifiers.new("Again", "ARMATURE").object = rig_of(obj)


def limit(obj):
    obj.vertex_groups.new(name="Half")
    key = keys_of(obj).key_blocks["smile"]
    key.value, key.vertex_group = 0.5, "Half"


def make_relative(obj):
    key = keys_of(obj).key_blocks["smile"]
    key.value, key.relative_key = 0.5, keys_of(obj).key_blocks["flexed"]


def drive(obj):
    keys_of(obj).key_blocks["smile"].driver_add("value").driver.expression = "0.5"


LOSSES = {
    "modifier 'Subdivision' after the Armature is left out": lambda obj: obj.modifiers.new("Subdivision", "SUBSURF"),
    "modifier 'Subdivision' before the Armature is left out": subdivide_first,
    "Preserve Volume": lambda obj: setattr(obj.modifiers["Armature"], "use_deform_preserve_volume", True),
    "several Armature modifiers": skin_twice,
    "bendy bones": bend,
    "1 vertices follow more than 4 bones": more_bones,
    "no vertex groups of shape keys, .* smile will": limit,
    "none relative to others than 'Basis': smile will": make_relative,
    "drivers are not exported; .* smile": drive,
}


@pytest.mark.fault("F19")
@pytest.mark.parametrize("words", LOSSES)
def test_export_check_says_what_is_dropped(baked, words):
    obj, _ = baked
    assert list(losses.losses(obj, "GLTF")) == []
    LOSSES[words](obj)
    assert any(re.search(words, text) for text in losses.losses(obj, "GLTF"))
    of_levels = "Subdivision Surface", "levels in viewports"
    assert [text for text in losses.losses(obj, "ALEMBIC") if not any(words in text for words in of_levels)] == []


def stretch(obj):
    rig = rig_of(obj)
    rig.pose.bones["upper"].scale = 1.2, 0.7, 1.2
    rig.pose.bones["upper"].keyframe_insert("scale", frame=1)


@pytest.mark.parametrize("inherit", ["FULL", "FIX_SHEAR", "ALIGNED", "AVERAGE", "NONE"])
def test_export_check_names_bones_that_do_not_inherit_a_scale(baked, inherit):
    obj, _ = baked
    rig_of(obj).data.bones["lower"].inherit_scale = inherit
    assert list(losses.losses(obj, "GLTF")) == []  # nothing has a scale
    stretch(obj)
    alike = inherit in {"FULL", "FIX_SHEAR"}
    for key in ("GLTF", "FBX"):
        assert any("inherit" in text and "lower will differ" in text for text in losses.losses(obj, key)) != alike
    assert list(losses.losses(obj, "ALEMBIC")) == []


def test_bones_that_inherit_a_scale_are_exported_as_shown(baked, tmp_path):
    obj, _ = baked
    stretch(obj)
    exact = posed("Arm")
    assert off("GLTF by pygltflib", written(obj, "GLTF", tmp_path), exact) < CLOSE


def test_export_check_names_the_scene_s_unit(baked):
    obj, _ = baked
    bpy.context.scene.unit_settings.scale_length = 0.01
    for key in ("GLTF", "USD"):
        assert any("one Blender unit, 0.01 m by the scene's Unit Scale" in text for text in losses.losses(obj, key))
    assert not any("Unit Scale" in text for text in losses.losses(obj, "FBX"))  # Blender's exporter converts it


def test_export_check_names_what_follows_the_skin_by_modifiers(scene, baked):
    """Blender's exporters leave the modifiers out: the shirt would stand still."""
    obj, _ = baked
    shirt = make_arm(scene, "Shirt")
    shirt.modifiers.remove(shirt.modifiers["Armature"])
    shirt.parent = rig_of(obj)
    shirt.modifiers.new("SurfaceDeform", "SURFACE_DEFORM").target = obj
    for key in ("GLTF", "FBX"):
        said = list(losses.losses(obj, key))
        assert any("'Shirt': modifier 'SurfaceDeform' is left out" in text for text in said)
    assert list(losses.losses(obj, "ALEMBIC")) == []


def in_file(obj, key, folder) -> int:
    """How many vertices of the mesh come back from a file."""
    path = written(obj, key, folder)
    importer = bpy.ops.wm.alembic_import if key == "ALEMBIC" else bpy.ops.wm.usd_import
    before = set(bpy.data.objects)
    importer(filepath=str(path))
    return sum(len(each.data.vertices) for each in set(bpy.data.objects) - before if each.type == "MESH")


@pytest.mark.parametrize("key", ["ALEMBIC", "USD"])
def test_export_check_says_where_surfaces_are_those_of_renders(scene, baked, tmp_path, key):
    obj, _ = baked
    count = len(obj.data.vertices)
    thick = obj.modifiers.new("Thick", "SOLIDIFY")
    thick.show_render = False
    (text,) = losses.losses(obj, key)
    assert "modifier 'Thick' is on only in viewports or only in renders" in text
    assert in_file(obj, key, tmp_path) == count
    obj.modifiers.remove(thick)
    obj.modifiers.new("Smooth", "SUBSURF")
    (text,) = losses.losses(obj, key)
    assert "leaves its Subdivision Surface to the program that opens the file" in text
    assert in_file(obj, key, tmp_path) == count
    obj.modifiers.clear()
    obj.modifiers.new("Fine", "SUBSURF").render_levels = 3
    obj.modifiers.new("Thick", "SOLIDIFY")
    (text,) = losses.losses(obj, key)
    assert "modifier 'Fine' has 1 levels in viewports and 3 in renders" in text
    scene.render.use_simplify, scene.render.simplify_subdivision, scene.render.simplify_subdivision_render = True, 1, 1
    assert list(losses.losses(obj, key)) == []
    obj.modifiers["Thick"].keyframe_insert("show_render", frame=1)
    obj.keyframe_insert("hide_render", frame=1)
    hidden, modifier = losses.losses(obj, key)
    assert "'hide_render' is keyed or driven" in hidden and "show_render' is keyed or driven" in modifier
    obj.animation_data_clear()
    obj.modifiers.clear()
    obj.hide_render = True
    (text,) = losses.losses(obj, key)
    assert "'Arm' is off in renders" in text
    assert not any("off in renders" in text for text in losses.losses(obj, "GLTF"))


def off_itself(obj):
    obj.hide_render = True


def in_a_collection_that_is_off(obj):
    home = bpy.data.collections.new("Low")
    outer = bpy.data.collections.new("Outer")
    bpy.context.scene.collection.children.link(outer)
    outer.children.link(home)
    for collection in obj.users_collection:
        collection.objects.unlink(obj)
    home.objects.link(obj)
    outer.hide_render = True


@pytest.mark.parametrize("hide", [off_itself, in_a_collection_that_is_off])
def test_what_is_off_in_renders_is_refused_where_files_have_what_renders_have(baked, tmp_path, hide):
    """And the disk is not blamed."""
    obj, _ = baked
    hide(obj)
    for key in ("ALEMBIC", "USD"):
        assert any("'Arm' is off in renders" in text for text in losses.losses(obj, key))
        with pytest.raises(errors.ExportError, match="'Arm' is off in renders, and .* has what renders have"):
            written(obj, key, tmp_path)
        assert not list(tmp_path.iterdir())
    assert written(obj, "GLTF", tmp_path).exists()
    other = bpy.data.collections.new("Shown")
    bpy.context.scene.collection.children.link(other)
    other.objects.link(obj)
    obj.hide_render = False
    assert written(obj, "ALEMBIC", tmp_path).exists()


def test_samples_between_frames_are_in_alembic_and_others_say_that_they_lack_them(scene, soft_arm, tmp_path):
    """A bake whose keys wave within each frame."""
    soft_arm.dynamorph.simulation.samples = 4
    settings = run_settings.simulation_settings(soft_arm, scene)
    bake = hand_made_bake(soft_arm, frames=np.arange(1.0, 20.01, 0.25))
    writer.write_keys(soft_arm, bake)
    inputs = staleness.bake_inputs(skinning_of(soft_arm), settings)
    animated = {"animation": animation.animation(skinning_of(soft_arm)), "content_id": "", "painted": ""}
    soft_arm.dynamorph.bake.inputs = records.text(inputs | animated)
    for key in ("GLTF", "FBX", "USD", "ALEMBIC"):
        lacks = [text for text in losses.losses(soft_arm, key) if "4 samples per frame" in text]
        assert len(lacks) == (key != "ALEMBIC")
    halves = np.arange(1.5, 19.5)
    exact = round_trips.shown("Arm", frames=halves)
    whole = round_trips.shown("Arm", frames=EVERY)
    straight = 0.5 * (whole[:-2] + whole[1:-1])
    read = round_trips.ALEMBIC(written(soft_arm, "ALEMBIC", tmp_path), "Arm", halves)
    assert np.abs(straight - exact).max() > 0.01
    assert np.abs(read - exact).max() < CLOSE


def test_keys_of_two_soft_skins_have_different_names_in_a_file(scene, baked, tmp_path):
    """Engines that merge the meshes of one armature play morph targets of one name alike."""
    pytest.importorskip("pygltflib")
    obj, _ = baked
    tail = make_soft(make_arm(scene, "Tail"))
    bpy.data.objects.remove(rig_of(tail))
    tail.modifiers["Armature"].object = rig_of(obj)
    writer.write_keys(tail, hand_made_bake(tail))
    before = [fingerprint(each) for each in (obj, tail)]
    file = round_trips.Gltf(written(obj, "GLTF", tmp_path))
    names = {mesh: file.morph_names(mesh) for mesh in ("Arm", "Tail")}
    baked_names = [key.name for key in tail.dynamorph.bake.keys]
    assert set(baked_names) < set(names["Arm"]) and not set(baked_names) & set(names["Tail"])
    assert {f"Tail {name}" for name in baked_names} < set(names["Tail"])
    assert [fingerprint(each) for each in (obj, tail)] == before


@pytest.mark.parametrize("key", ["GLTF", "FBX", "ALEMBIC", "USD"])
def test_a_hidden_armature_is_named_before_the_export(baked, key):
    """Which refuses it, after the file was chosen."""
    obj, _ = baked
    rig_of(obj).hide_set(True)
    assert "'Arm Rig' is hidden, so Blender does not export it: unhide it" in list(losses.losses(obj, key))
    rig_of(obj).hide_set(False)
    assert not any("is hidden" in text for text in losses.losses(obj, key))


@pytest.mark.parametrize("invoked", [False, True])
def test_what_the_dialog_has_said_is_not_said_again(baked, invoked):
    obj, _ = baked
    said = []
    operator = types.SimpleNamespace(
        options=types.SimpleNamespace(is_invoke=invoked),
        format="GLTF",
        report=lambda kind, text: said.append((*kind, text)),
    )
    drive(obj)
    operators_export.report_export(operator, obj, Path("arm.glb"))
    assert said[-1] == ("INFO", "'Arm' written as 'arm.glb'")
    assert [kind for kind, _ in said[:-1]] == ([] if invoked else ["WARNING"])


@pytest.mark.parametrize("smile, remedy", [(0.0, "with Key Limit 8, or use"), (0.5, "with Key Limit 7, or use")])
def test_export_check_counts_the_morphs_that_move(scene, smile, remedy):
    obj = make_soft(make_arm(scene))
    writer.write_keys(obj, hand_made_bake(obj, modes=9))
    keys_of(obj).key_blocks["smile"].value = smile
    (text,) = losses.losses(obj, "FBX")
    assert f"{10 + (smile > 0)} keys move, many engines blend 8 at most" in text and remedy in text


def test_export_check_sees_keys_that_stand_at_0_now(baked):
    obj, _ = baked
    smile = keys_of(obj).key_blocks["smile"]
    for frame in (1, 20):
        smile.value = (frame - 1) / 19
        smile.keyframe_insert("value", frame=frame)
    bpy.context.scene.frame_set(1)
    assert smile.value == 0.0
    assert "A soft skin file has only the targets' keys: smile is left out" in losses.losses(obj, "SOFT_SKIN")


def test_a_muted_key_is_not_shown(scene, baked, tmp_path):
    """FBX knows no muted keys."""
    obj, _ = baked
    smile = keys_of(obj).key_blocks["smile"]
    smile.value, smile.mute = 1.0, True
    exact = posed("Arm")
    assert off("FBX", written(obj, "FBX", tmp_path), exact) < CLOSE


@pytest.mark.parametrize("key", ["GLTF", "FBX"])
def test_an_export_leaves_the_values_of_keys(baked, tmp_path, key):
    """Also of those that no other program knows to be muted."""
    obj, _ = baked
    blocks = keys_of(obj).key_blocks
    blocks["smile"].value, blocks["smile"].mute, blocks["flexed"].value = 0.4, True, 0.7
    written(obj, key, tmp_path)
    assert (blocks["smile"].value, blocks["flexed"].value) == pytest.approx((0.4, 0.7))


def test_the_button_writes_what_the_format_is_called(baked, tmp_path):
    obj, _ = baked
    bpy.context.view_layer.objects.active = obj
    bpy.ops.dynamorph.export(format="GLTF", filepath=str(tmp_path / "arm"))
    assert [file.name for file in tmp_path.iterdir()] == ["arm.glb"]
    assert bpy.ops.dynamorph.export_check(format="FBX") == {"FINISHED"}
    writer.free(obj)
    with pytest.raises(RuntimeError, match="press Bake first"):
        bpy.ops.dynamorph.export(format="GLTF", filepath=str(tmp_path / "none"))
    assert not bpy.ops.dynamorph.export_check.poll()


@pytest.mark.parametrize("folder", ["", "{}/", "{}/none/"])
def test_a_file_without_a_name_is_refused(baked, tmp_path, folder):
    obj, _ = baked
    activate(obj)
    with pytest.raises(RuntimeError, match="There is no file name: type one"):
        bpy.ops.dynamorph.export(format="GLTF", filepath=folder.format(tmp_path))
    assert list(tmp_path.iterdir()) == []


def file_menu() -> list[str]:
    """What the add-on adds to File > Export."""
    layout = Layout([])
    operators_export.draw_in_file_menu(types.SimpleNamespace(layout=layout), bpy.context)
    assert layout.operator_context == "INVOKE_DEFAULT", "a shortcut to the menu would export to the last file"
    return layout.drawn


def test_the_file_menu_exports_a_soft_skin(scene, arm):
    assert file_menu() == ["dynamorph.export", "Soft Skin"] and not bpy.ops.dynamorph.export.poll()
    make_soft(arm)
    assert bpy.ops.dynamorph.export.poll()


def test_a_name_keeps_what_only_looks_like_a_suffix():
    assert exports.named(Path("hero.v002"), "GLTF") == Path("hero.v002.glb")
    assert exports.named(Path("hero.v002.fbx"), "GLTF") == Path("hero.v002.glb")


def test_usd_has_the_frames_that_were_asked_for(baked, tmp_path):
    """USD's exporter uses the frames of the scene."""
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not for this Python")
    obj, _ = baked
    export_actions.export(obj, "USD", tmp_path / "part.usdc", (5, 9))
    stage = usd.Stage.Open(str(tmp_path / "part.usdc"))
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (5.0, 9.0)
    assert (bpy.context.scene.frame_start, bpy.context.scene.frame_end) == FRAMES


@pytest.mark.fault("A07")
@pytest.mark.parametrize("key", exports.FORMATS)
def test_frames_before_0_are_written_or_refused(baked, tmp_path, key):
    """No scene of Blender has them, whose range most exporters take."""
    obj, _ = baked
    built.give(obj)
    path = tmp_path / f"arm{exports.FORMATS[key].suffix}"
    export = export_actions.export
    if key in ("ALEMBIC", "SOFT_SKIN"):
        export(obj, key, path, (-10, 10))
        assert path.is_file()
        return
    with pytest.raises(errors.ExportError, match="no frames before 0, 'Arm' is to begin at -10: choose Alembic"):
        export(obj, key, path, (-10, 10))
    assert not path.exists()


def test_refused(baked, tmp_path):
    obj, _ = baked
    error = errors.ExportError
    with pytest.raises(error, match="folder '.*nowhere' .* does not exist"):
        export_actions.export(obj, "GLTF", tmp_path / "nowhere" / "arm.glb", FRAMES)
    obj.hide_set(True)
    with pytest.raises(error, match="'Arm' is hidden"):
        export_actions.export(obj, "USD", tmp_path / "arm.usdc", FRAMES)
    obj.hide_set(False)
    writer.free(obj)
    with pytest.raises(error, match="no bake to export: press Bake"):
        export_actions.export(obj, "GLTF", tmp_path / "arm.glb", FRAMES)
    assert list(tmp_path.iterdir()) == []


def test_the_dialog_reads_no_weights_when_it_draws_again(baked, monkeypatch):
    obj, _ = baked
    export_operators = operators_export
    looked, original = [], losses.losses
    monkeypatch.setattr(losses, "losses", lambda *args: looked.append(args) or original(*args))

    def drawn(format="GLTF", clips="SCENE"):
        out = []
        dialog = types.SimpleNamespace(format=format, clips=clips, chosen_clips=clips, layout=Layout(out))
        dialog.bl_rna = types.SimpleNamespace(properties=("format", "clips"))
        dialog.layout.prop = lambda *_args: None
        export_operators.DYNAMORPH_OT_export.draw(dialog, bpy.context)
        return " ".join(out)

    for _ in range(5):
        assert drawn() == ""
    assert len(looked) == 1
    drawn("FBX"), drawn("GLTF", "ACTIONS"), drawn("FBX")
    assert len(looked) == 3
    obj.modifiers.new("Smooth", "SMOOTH")
    obj.update_tag()
    bpy.context.view_layer.update()
    for _ in range(3):
        assert "modifier 'Smooth' after" in drawn()
    assert len(looked) == 4
