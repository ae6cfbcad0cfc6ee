# SPDX-License-Identifier: GPL-3.0-or-later
"""Renames, duplicates, edits of the mesh, the artist's own animation of the keys: a soft skin follows them all."""

import bmesh
import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.scene import references
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store
from bl_ext.user_default.dynamic_morph_targets.write import reconcile, storage
from bl_ext.user_default.dynamic_morph_targets.write.bake import writer
from builders import activate, add_key, evaluated_points, fingerprint, make_arm, make_soft, rig_of
from robustness import OPS, bake, coarse, motion, names
from test_baking import assert_shows, keys_of
from test_extract import skinned
from test_operators import refused


@pytest.fixture
def skin(soft_arm):
    """A soft arm for the real engine."""
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    return coarse(soft_arm)


# Renames -----------------------------------------------------------------------------------------------------------


def add_group(obj, name, low, high):
    """A vertex group that fades in between two heights."""
    heights = references.key_points(keys_of(obj).reference_key)[:, 2]
    group = obj.vertex_groups.new(name=name)
    for index, weight in enumerate(np.clip((heights - low) / (high - low), 0.0, 1.0)):
        group.add([index], float(weight), "REPLACE")


def rename_everything(obj):
    rig, blocks = rig_of(obj), keys_of(obj).key_blocks
    for block in blocks:
        block.name = f"key of {block.name}"
    for bone in rig.data.bones:
        bone.name = f"bone of {bone.name}"
    for group in obj.vertex_groups:
        if group.name in ("Firm", "Tip"):
            group.name = f"group of {group.name}"
    for data in (obj, obj.data, keys_of(obj), rig, rig.data, *bpy.data.actions):
        data.name = f"new {data.name}"
    for modifier in obj.modifiers:
        modifier.name = "Skin"
    for track in keys_of(obj).animation_data.nla_tracks:
        track.name = track.strips[0].name = "new"
    bpy.context.view_layer.update()


@pytest.mark.fault("R02")
def test_everything_is_renamed_after_a_bake(skin):
    add_group(skin, "Firm", -1.0, 1.0)
    add_group(skin, "Tip", 0.5, 1.5)
    skin.dynamorph.firmness_group = "Firm"
    skin.dynamorph.targets[1].region = "Tip"
    before = names(skin)
    first = bake(skin).outcome.bake
    shown = motion(skin)
    rename_everything(skin)
    target = skin.dynamorph.targets[1]
    assert (target.name, target.region, target.bone_names()) == (
        "key of flexed", "group of Tip", ("bone of lower",)
    )  # fmt: skip
    assert skin.dynamorph.firmness_group == "group of Firm"
    assert skin.dynamorph.model.stale == ""
    np.testing.assert_array_equal(motion(skin), shown)
    job = bake(skin)
    assert job.input.reasons == []
    np.testing.assert_array_equal(job.outcome.bake.coordinates, first.coordinates)
    assert OPS.delete_bake() == {"FINISHED"}
    assert names(skin) == [f"key of {name}" for name in before]
    assert not any(block.mute for block in keys_of(skin).key_blocks)
    assert keys_of(skin).animation_data is None


def test_groups_swapped_sorted_or_removed_are_not_mistaken_for_renamed(soft_arm):
    for name in ("Tip", "Firm"):
        soft_arm.vertex_groups.new(name=name).add([1], 1.0, "REPLACE")
    soft_arm.dynamorph.firmness_group = "Firm"
    bpy.context.view_layer.update()
    bpy.ops.object.vertex_group_sort(sort_type="NAME")
    bpy.context.view_layer.update()
    assert soft_arm.dynamorph.firmness_group == "Firm"
    soft_arm.vertex_groups.remove(soft_arm.vertex_groups["Firm"])
    soft_arm.vertex_groups.new(name="Hair")
    bpy.context.view_layer.update()
    assert soft_arm.dynamorph.firmness_group == "Firm"
    with pytest.raises(errors.SceneError, match="'Firm' of Firmness is gone"):
        extract.character(soft_arm)


def test_a_bone_is_renamed_whose_group_is_a_region(soft_arm):
    """Blender renames the group with the bone."""
    soft_arm.dynamorph.targets[1].region = "lower"
    bpy.context.view_layer.update()
    reconcile.reconcile(soft_arm)
    rig_of(soft_arm).data.bones["lower"].name = "forearm"
    bpy.context.view_layer.update()
    assert soft_arm.dynamorph.targets[1].region == "forearm"


@pytest.mark.parametrize("name", ["x" * 63, "日本語" * 7])
def test_names_as_long_as_blender_allows(skin, name):
    """Such names have 63 bytes, and are cut within a letter when something is put before them."""
    keys_of(skin).key_blocks["flexed"].name = skin.name = skin.data.name = name
    before = fingerprint(skin)
    for _ in range(2):
        assert_shows(skin, bake(skin).outcome.bake)
    bpy.context.scene.frame_set(1)
    assert OPS.delete_bake() == {"FINISHED"}
    assert fingerprint(skin) == before


# Duplicates, and two characters on one armature --------------------------------------------------------------------


def duplicate(obj, linked, *others):
    bpy.ops.object.select_all(action="DESELECT")
    for each in (obj, *others):
        each.select_set(True)
    activate(obj)
    bpy.ops.object.duplicate(linked=linked)
    return bpy.context.object


def make_single_user(obj):
    bpy.ops.object.select_all(action="DESELECT")
    obj.select_set(True)
    activate(obj)
    bpy.ops.object.make_single_user(object=True, obdata=True)


@pytest.mark.fault("M18")
@pytest.mark.parametrize("when", ["before the bake", "after the bake"])
def test_alt_d(skin, when):
    """Two objects on one mesh cannot move apart: they are refused with the remedy, and it works."""
    before = names(skin)
    if when == "after the bake":
        bake(skin)
    keys = fingerprint(skin)["keys"]
    twin = duplicate(skin, True)
    assert twin.data == skin.data and len(twin.dynamorph.targets) == 2
    for obj in (skin, twin):
        activate(obj)
        refused(OPS.bake, "'Arm' is shared by 2 objects.*single-user")
        if when == "after the bake":
            refused(OPS.delete_bake, "'Arm' is shared by 2 objects.*single-user")
            obj.dynamorph.active_target_index = 0
            refused(OPS.remove_target, "'Arm' is shared by 2 objects.*single-user")
    assert fingerprint(skin)["keys"] == keys
    make_single_user(twin)
    first, second = bake(skin, frames=(1, 10)), bake(twin)
    assert (first.input.reasons, second.input.reasons) == (
        (["there was no model"],) * 2 if when == "before the bake" else ([], [])
    )
    assert_shows(skin, first.outcome.bake)
    assert_shows(twin, second.outcome.bake)
    writer.free(skin)
    assert names(skin) == before
    assert_shows(twin, second.outcome.bake)
    writer.free(twin)
    assert names(twin) == before


@pytest.mark.fault("F17")
def test_shift_d_of_the_whole_character(skin):
    """The copy has its own rig, which moves differently, and a model that is still valid."""
    bake(skin)
    copy = duplicate(skin, False, rig_of(skin))
    assert copy.data != skin.data and rig_of(copy) != rig_of(skin)
    for each in (copy, rig_of(copy)):
        each.location.x = 3.0
        each.rotation_euler.z = 1.0
    copy.dynamorph.targets[1].stiffness = 5e5
    shown = motion(skin)
    job = bake(copy)
    assert job.input.reasons == []
    assert_shows(copy, job.outcome.bake)
    np.testing.assert_array_equal(motion(skin), shown)
    activate(copy)
    copy.dynamorph.active_target_index = 0
    assert OPS.remove_target() == {"FINISHED"}
    assert names(copy) == ["Basis", "flexed", "smile"]
    np.testing.assert_array_equal(motion(skin), shown)
    assert bake(skin).input.reasons == []


def test_a_full_copy_of_the_scene(skin):
    job = bake(skin)
    bpy.ops.scene.new(type="FULL_COPY")
    copy = next(obj for obj in bpy.context.scene.objects if obj.type == "MESH")
    assert_shows(copy, job.outcome.bake)
    activate(copy)
    assert OPS.delete_bake() == {"FINISHED"}
    assert len(names(copy)) == 3 and len(names(skin)) == 10
    assert bake(copy).input.reasons == []
    assert_shows(copy, job.outcome.bake)


def test_a_fake_user_is_no_second_object(skin):
    skin.data.use_fake_user = True
    assert OPS.bake() == OPS.delete_bake() == {"FINISHED"}


def test_two_characters_on_one_armature(scene, skin):
    other = coarse(make_soft(make_arm(scene, "Sleeve")))
    bpy.data.objects.remove(rig_of(other))
    other.modifiers["Armature"].object = rig_of(skin)
    before = fingerprint(other)["keys"]
    activate(rig_of(skin))
    results = {}
    for obj, stiffness in ((skin, 5e3), (other, 8e4)):
        bpy.ops.object.select_all(action="DESELECT")
        obj.select_set(True)  # of two skins on the active armature, the buttons act on the selected one
        obj.dynamorph.targets[0].stiffness = stiffness
        assert OPS.bake() == {"FINISHED"}
        results[obj] = bake(obj).outcome.bake
    assert np.abs(results[skin].displacement(9) - results[other].displacement(9)).max() > 1e-4
    for obj, result in results.items():
        assert_shows(obj, result)
    activate(skin)
    assert OPS.delete_bake() == {"FINISHED"}
    assert_shows(other, results[other])
    writer.free(other)
    bpy.context.scene.frame_set(1)
    assert fingerprint(other)["keys"] == before


# The mesh is edited ------------------------------------------------------------------------------------------------


def edit(obj, change):
    """Edits the mesh in Edit Mode."""
    activate(obj)
    bpy.ops.object.mode_set(mode="EDIT")
    mesh = bmesh.from_edit_mesh(obj.data)
    change(mesh)
    bmesh.update_edit_mesh(obj.data)
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.update()


def tip_deleted(obj):
    def cut_and_close(mesh):
        bmesh.ops.delete(mesh, geom=[v for v in mesh.verts if v.co.z > 1.2], context="VERTS")
        bmesh.ops.holes_fill(mesh, edges=mesh.edges)

    edit(obj, cut_and_close)


def loop_cut(obj):
    edit(obj, lambda mesh: bmesh.ops.subdivide_edges(mesh, edges=mesh.edges[:40], cuts=1))


def vertices_sorted(obj):
    edit(obj, lambda mesh: mesh.verts.sort(key=lambda vertex: -vertex.co.z))


def scale_applied(obj):
    obj.scale = (1.5, 0.5, 2.0)
    apply_transform(obj)


def rotation_applied(obj):
    obj.rotation_euler = (0.0, 0.0, 0.7)
    apply_transform(obj)


def apply_transform(obj):
    bpy.ops.object.select_all(action="DESELECT")
    obj.select_set(True)
    activate(obj)
    bpy.ops.object.transform_apply(location=True, rotation=True, scale=True)
    bpy.context.view_layer.update()


EDITS = [tip_deleted, loop_cut, vertices_sorted, scale_applied, rotation_applied]


@pytest.mark.fault("M14", "M15")
@pytest.mark.parametrize("change", EDITS)
def test_mesh_edited_after_the_bake(skin, change):
    """It still plays; the model says what changed; Delete Bake works; baking again builds first, and shows."""
    bake(skin)
    change(skin)
    assert np.isfinite(motion(skin)).all()
    storage.show_stale(skin)
    stale = skin.dynamorph.model.stale
    vertices = len(skin.data.vertices)
    assert stale == f"the mesh has {vertices} vertices instead of 272" if vertices != 272 else "mesh changed" in stale
    assert model_store.load_model(skin) and len(skin.dynamorph.targets) == 2
    job = bake(skin)
    assert job.input.reasons == [stale] or vertices == 272
    assert_shows(skin, job.outcome.bake)
    assert OPS.delete_bake() == {"FINISHED"}
    assert names(skin) == ["Basis", "flexed", "smile"]
    assert not any(block.mute for block in keys_of(skin).key_blocks)


@pytest.mark.parametrize("change", EDITS)
def test_delete_bake_after_an_edit(skin, change):
    bake(skin)
    change(skin)
    assert OPS.delete_bake() == {"FINISHED"}
    assert names(skin) == ["Basis", "flexed", "smile"]
    assert keys_of(skin).animation_data is None


def test_parts_separated_and_joined_after_the_bake(skin):
    """Each part keeps the keys of the bake, and their record."""
    bake(skin)
    activate(skin)
    bpy.ops.object.mode_set(mode="EDIT")
    mesh = bmesh.from_edit_mesh(skin.data)
    for vertex in mesh.verts:
        vertex.select_set(vertex.co.z > 1.5)
    mesh.select_flush_mode()
    bpy.ops.mesh.separate(type="SELECTED")
    bpy.ops.object.mode_set(mode="OBJECT")
    tip = next(obj for obj in bpy.data.objects if obj.type == "MESH" and obj != skin)
    assert (len(tip.data.vertices), len(skin.data.vertices)) == (64, 224)  # both have the ring of the cut
    writer.free(tip)
    assert names(tip) == ["Basis", "flexed", "smile"]
    tip.select_set(True)
    skin.select_set(True)
    assert bpy.ops.object.join() == {"FINISHED"} and len(skin.data.vertices) == 288
    assert np.isfinite(motion(skin)).all()
    assert OPS.delete_bake() == {"FINISHED"}
    assert names(skin) == ["Basis", "flexed", "smile"]


@pytest.mark.fault("M01")
def test_a_refused_bake_after_an_edit_keeps_model_and_bake(skin):
    bake(skin)
    model = model_store.stored_model(skin)
    edit(skin, lambda mesh: bmesh.ops.delete(mesh, geom=list(mesh.faces), context="FACES_ONLY"))
    keys = names(skin)
    refused(OPS.bake, "'Arm' has no faces")
    assert model_store.stored_model(skin) == model and names(skin) == keys and len(skin.dynamorph.bake.keys) == 7


def test_shape_keys_reordered(skin):
    first = bake(skin)
    shown = motion(skin)
    for name, where in (("smile", "TOP"), ("Dynamorph Mode 03", "TOP"), ("flexed", "BOTTOM")):
        skin.active_shape_key_index = names(skin).index(name)
        bpy.ops.object.shape_key_move(type=where)
        bpy.context.view_layer.update()
    assert names(skin)[0] == "Basis" and names(skin)[-1] == "flexed"
    np.testing.assert_allclose(motion(skin), shown, atol=1e-6)
    again = bake(skin)
    assert again.input.reasons == []
    np.testing.assert_array_equal(again.outcome.bake.coordinates, first.outcome.bake.coordinates)
    assert OPS.delete_bake() == {"FINISHED"}
    assert names(skin) == ["Basis", "smile", "flexed"]


def test_all_shape_keys_deleted(skin):
    bake(skin)
    skin.shape_key_clear()
    bpy.context.view_layer.update()
    refused(OPS.bake, "'Arm' has no shape keys")
    assert OPS.delete_bake() == {"FINISHED"}
    assert not skin.dynamorph.bake.keys and len(skin.dynamorph.targets) == 2


def test_the_soft_skin_is_not_half_removed(skin):
    """Blender removes no shape keys in Edit Mode."""
    bake(skin)
    keys = names(skin)
    activate(skin)
    skin.dynamorph.active_target_index = 0
    bpy.ops.object.mode_set(mode="EDIT")
    refused(OPS.remove_target, "'Arm' is in Edit Mode")
    bpy.ops.object.mode_set(mode="OBJECT")
    assert names(skin) == keys and len(skin.dynamorph.targets) == 2 and len(skin.dynamorph.bake.keys) == 7
    assert OPS.remove_target() == {"FINISHED"}
    assert names(skin) == ["Basis", "flexed", "smile"] and not skin.dynamorph.targets


# The artist's own animation of the keys ----------------------------------------------------------------------------


def animate_keys(obj):
    """A driver on the target's key, an Action on 'smile', a strip on 'brow'; returns what they add (20, V, 3)."""
    add_key(obj, "brow", np.array([0.0, 0.02, 0.0]))
    keys = keys_of(obj)
    animation = keys.animation_data_create()
    brow, smile = keys.key_blocks["brow"], keys.key_blocks["smile"]
    for block, values in ((brow, (0.0, 1.0)), (smile, (1.0, 0.0))):
        for frame, value in zip((1, 20), values, strict=True):
            block.value = value
            block.keyframe_insert("value", frame=frame)
        for curve in animation.action.layers[0].strips[0].channelbags[0].fcurves:
            for point in curve.keyframe_points:
                point.interpolation = "LINEAR"
        if block == brow:
            track = animation.nla_tracks.new()
            track.strips.new("brow", 1, animation.action).action_slot = animation.action.slots[0]
            animation.action = None
    keys.key_blocks["flexed"].driver_add("value").driver.expression = "frame / 20"
    time = np.linspace(0.0, 1.0, 20)[:, None, None]
    shape = mesh_data.target_shape
    return time * shape(obj, "brow") + (1.0 - time) * shape(obj, "smile")


@pytest.mark.fault("K04")
def test_driver_nla_and_action_on_the_keys(scene, skin):
    own = animate_keys(skin)
    scene.frame_set(1)
    before = fingerprint(skin)
    shown = motion(skin)
    job = bake(skin)
    samples, character = rig_motion.sample_rig(skin, 1, 20, 1), extract.character(skin)
    for i in range(20):
        scene.frame_set(i + 1)
        expected = skinned(character, samples[i : i + 1], job.outcome.bake.displacement(i) + own[i])[0]
        assert np.abs(evaluated_points(skin) - expected).max() < 2e-5
    assert keys_of(skin).key_blocks["flexed"].value == pytest.approx(1.0)  # still driven, but muted
    scene.frame_set(1)
    assert OPS.delete_bake() == {"FINISHED"}
    assert fingerprint(skin) == before
    np.testing.assert_array_equal(motion(skin), shown)
