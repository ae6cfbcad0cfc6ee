# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings follow renames, survive save, load and undo, and stay apart."""

import dataclasses
import hashlib
import types

import addon_utils
import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors, settings
from bl_ext.user_default.dynamic_morph_targets.scene import references
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion, run_settings
from bl_ext.user_default.dynamic_morph_targets.scene.properties import (
    bake_properties,
    model_properties,
    target_properties,
)
from bl_ext.user_default.dynamic_morph_targets.write import reconcile
from builders import activate, add_key, make_arm, make_soft, rig_of
from installed import MODULE


def names(obj):
    return [target.name for target in obj.dynamorph.targets]


def test_a_new_soft_skin_is_built_by_default(arm):
    bpy.ops.dynamorph.add_soft_skin()
    assert vars(arm.dynamorph.model.settings()) == pytest.approx(vars(settings.ModelSettings()))


def test_every_setting_of_a_simulation_is_read(soft_arm):
    """By its name, but for those that the scene or other settings decide."""
    chosen, scene = soft_arm.dynamorph.simulation, bpy.context.scene
    decided = {"frame_start", "frame_end", "substeps", "gravity"}
    named = {each.name for each in dataclasses.fields(settings.SimulationSettings)} - decided
    props = [prop for prop in chosen.bl_rna.properties if prop.identifier in named]
    assert len(props) >= 8
    chosen.use_scene_range, chosen.frame_end = False, 20
    for prop in props:
        value = another_value(prop)
        setattr(chosen, prop.identifier, value)
        read = run_settings.simulation_settings(soft_arm, scene)
        assert getattr(read, prop.identifier) == pytest.approx(value), prop.identifier


def another_value(prop):
    """One that is not the default."""
    if prop.type == "ENUM":
        return next(item.identifier for item in prop.enum_items if item.identifier != prop.default)
    if prop.type == "BOOLEAN":
        return not prop.default
    return prop.default + 1 if prop.type == "INT" else 0.5 * (prop.default + prop.soft_max)


def test_every_property_has_a_description():
    for cls in (
        target_properties.DynamorphTarget,
        model_properties.DynamorphModel,
        bake_properties.DynamorphSimulation,
    ):
        for prop in cls.bl_rna.properties:
            assert prop.description or prop.identifier in {"rna_type", "name"}, prop.identifier


@pytest.mark.fault("P01")
@pytest.mark.parametrize("field", ["stiffness", "poisson", "density", "mass_damping", "stiffness_damping"])
@pytest.mark.parametrize("value", [-1.0, 1e30, float("inf"), float("nan")])
def test_materials_stay_physical(soft_arm, field, value):
    target = soft_arm.dynamorph.targets[0]
    setattr(target, field, value)
    if np.isnan(value):
        name = target.bl_rna.properties[field].name
        with pytest.raises(errors.SceneError, match=f"'Arm': {name} of target 'Neutral' is nan"):
            extract.character(soft_arm)
    else:
        assert np.isfinite(getattr(target, field)) and getattr(target, field) >= 0.0


@pytest.mark.fault("P02")
@pytest.mark.parametrize("fps, substeps", [(24, 5), (25, 5), (30, 4), (60, 2), (120, 1), (240, 1), (23.976, 6)])
def test_steps_are_at_most_a_120th_of_a_second(soft_arm, fps, substeps):
    assert soft_arm.dynamorph.simulation.steps_per_frame(fps) == substeps
    soft_arm.dynamorph.simulation.speed = 0.5  # a frame is half as long then
    assert soft_arm.dynamorph.simulation.steps_per_frame(fps / 2.0) == substeps
    soft_arm.dynamorph.simulation.substeps = 3
    assert soft_arm.dynamorph.simulation.steps_per_frame(fps) == 3
    assert soft_arm.dynamorph.simulation.steps_per_frame(fps / 2.0, 0) == substeps


def test_pose_round_trip(scene, soft_arm):
    scene.frame_set(20)
    skeleton, local, rig_world = rig_motion.current_pose(soft_arm)
    target = soft_arm.dynamorph.targets[1]
    np.testing.assert_allclose(target.local(skeleton), local, atol=1e-6)
    np.testing.assert_allclose(np.array(target.rig_world).reshape(4, 4), rig_world)
    pose = skeleton.pose(target.local(skeleton))
    evaluated = rig_of(soft_arm).evaluated_get(bpy.context.evaluated_depsgraph_get())
    np.testing.assert_allclose(pose[1], evaluated.pose.bones["lower"].matrix, atol=1e-6)


# Renames ----------------------------------------------------------------------------------------------------------


def test_key_rename_is_followed_at_once(soft_arm):
    soft_arm.data.shape_keys.key_blocks["flexed"].name = "biceps"
    bpy.context.view_layer.update()
    assert names(soft_arm) == ["Neutral", "biceps"]


def test_key_renamed_after_sculpting_is_followed(soft_arm):
    soft_arm.active_shape_key_index = 1
    block = soft_arm.data.shape_keys.key_blocks["flexed"]
    block.points[3].co.x += 1.0
    soft_arm.data.update_tag()
    bpy.context.view_layer.update()
    block.name = "biceps"
    bpy.context.view_layer.update()
    assert names(soft_arm) == ["Neutral", "biceps"]


def test_key_renamed_while_the_addon_was_off_is_followed(soft_arm):
    handlers = bpy.app.handlers.depsgraph_update_post
    kept = handlers[:]
    handlers.clear()
    blocks = soft_arm.data.shape_keys.key_blocks
    blocks["flexed"].name = "biceps"
    soft_arm.active_shape_key_index = 1
    bpy.ops.object.shape_key_move(type="BOTTOM")
    handlers.extend(kept)
    reconcile.reconcile(soft_arm)
    assert [t.name for t in extract.character(soft_arm).targets] == ["Neutral", "biceps"]
    assert soft_arm.dynamorph.targets[1].key_index == 2


def test_equal_shapes_are_told_apart_by_place(soft_arm):
    basis = [c for p in soft_arm.data.shape_keys.reference_key.points for c in p.co]
    for name in ("flexed", "smile"):
        soft_arm.data.shape_keys.key_blocks[name].points.foreach_set("co", basis)
    reconcile.reconcile(soft_arm)
    soft_arm.data.shape_keys.key_blocks["flexed"].name = "biceps"
    reconcile.reconcile(soft_arm)
    assert names(soft_arm) == ["Neutral", "biceps"]


def test_a_removed_key_is_never_mistaken(soft_arm):
    soft_arm.shape_key_remove(soft_arm.data.shape_keys.key_blocks["flexed"])
    add_key(soft_arm, "other", 0.1)
    bpy.context.view_layer.update()
    assert names(soft_arm) == ["Neutral", "flexed"]
    with pytest.raises(errors.SceneError, match="'flexed' is gone"):
        extract.character(soft_arm)


def test_bone_rename_is_followed_at_once(soft_arm):
    before = extract.character(soft_arm)
    rig_of(soft_arm).data.bones["lower"].name = "forearm"
    bpy.context.view_layer.update()
    target = soft_arm.dynamorph.targets[1]
    assert target.bone_names() == ("forearm",)
    assert [bone.name for bone in target.pose] == ["upper", "forearm"]
    after = extract.character(soft_arm)
    np.testing.assert_array_equal(after.targets[1].local, before.targets[1].local)
    np.testing.assert_array_equal(after.weights, before.weights)


def test_bones_renamed_in_edit_mode_and_moved_later(soft_arm):
    rig = rig_of(soft_arm)
    activate(rig)
    bpy.ops.object.mode_set(mode="EDIT")
    rig.data.edit_bones["lower"].tail.x += 0.5
    bpy.ops.object.mode_set(mode="OBJECT")
    reconcile.reconcile(soft_arm)
    bpy.ops.object.mode_set(mode="EDIT")
    rig.data.edit_bones["lower"].name = "forearm"
    bpy.ops.object.mode_set(mode="OBJECT")
    assert extract.character(soft_arm).targets[1].bones == ("forearm",)


def test_a_bone_added_later_is_at_rest(soft_arm):
    rig = rig_of(soft_arm)
    activate(rig)
    bpy.ops.object.mode_set(mode="EDIT")
    bone = rig.data.edit_bones.new("helper")
    bone.tail = (0, 1, 0)
    bpy.ops.object.mode_set(mode="OBJECT")
    character = extract.character(soft_arm)
    helper = character.skeleton.names.index("helper")
    np.testing.assert_array_equal(character.targets[1].local[helper], np.eye(4))


def test_posing_costs_little(scene, soft_arm):
    """The handler must not hash and compare everything while the artist drags a bone."""
    calls = []
    original, reconcile.reconcile = reconcile.reconcile, lambda obj: calls.append(obj)
    try:
        rig_of(soft_arm).pose.bones["lower"].rotation_euler.x = 0.4
        bpy.context.view_layer.update()
        scene.frame_set(12)
    finally:
        reconcile.reconcile = original
    assert not calls


def hashed(monkeypatch) -> list:
    """Record what is hashed from now on."""
    found = []
    original = references.hashlib.blake2b

    def counted(data, **options):
        found.append(data)
        return original(data, **options)

    monkeypatch.setattr(references, "hashlib", types.SimpleNamespace(blake2b=counted))
    return found


def test_a_slider_step_hashes_no_keys(scene, arm, monkeypatch):
    """The keys are unchanged: only their values differ."""
    many = [add_key(arm, f"key {i}", 0.01 * i) for i in range(1, 21)]
    make_soft(arm, [key.name for key in many[:1]])
    with_targets(arm, many)
    bpy.context.view_layer.update()
    found, blocks = hashed(monkeypatch), arm.data.shape_keys.key_blocks
    for step in range(1, 6):
        blocks["key 3"].value = 0.1 * step
        bpy.context.view_layer.update()
    assert found == []
    blocks["key 3"].points[0].co.x += 0.1
    bpy.context.view_layer.update()
    assert len(found) == 1
    blocks["key 3"].points[0].co.x -= 0.1
    blocks["key 4"].name = "other"
    bpy.context.view_layer.update()
    assert "other" in names(arm) and len(found) < 8  # of 23 keys


def with_targets(obj, blocks):
    for block in blocks[1:]:
        target = obj.dynamorph.targets.add()
        target.refer_to(obj.data.shape_keys.key_blocks, obj.data.shape_keys.key_blocks.find(block.name))


def test_hashes_are_those_of_the_points(scene, arm):
    """They equal those stored in files, whatever is cached: after each edit, and for keys whose points trade places,
    too.
    """
    block = arm.data.shape_keys.key_blocks["flexed"]

    def expected():
        shape = references.key_points(block) - references.key_points(block.relative_key)
        return hashlib.blake2b(shape.tobytes(), digest_size=8).hexdigest()

    assert references.key_hash(block) == expected()
    points = references.key_points(block)
    basis = references.key_points(block.relative_key)
    shape = points - basis
    for changed in (shape[::-1], np.roll(shape, 1, axis=0), -shape, shape[:, ::-1], shape):
        block.points.foreach_set("co", (basis + changed).ravel())
        assert references.key_hash(block) == expected()
    rng = np.random.default_rng(3)
    for _ in range(50):
        at = rng.integers(len(points))
        block.points[at].co.x = np.nextafter(np.float32(block.points[at].co.x), np.float32(9.0))
        assert references.key_hash(block) == expected()
    arm.data.shape_keys.reference_key.points[3].co.y += 0.01
    assert references.key_hash(block) == expected()


# Keeping ----------------------------------------------------------------------------------------------------------


def test_save_and_load(soft_arm, tmp_path):
    before = extract.character(soft_arm)
    soft_arm.dynamorph.targets[1].stiffness = 123_456.0
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "arm.blend"))
    after = extract.character(bpy.data.objects["Arm"])
    assert after.targets[1].material.stiffness == pytest.approx(123_456.0)
    for field in ("vertices", "triangles", "weights", "to_bind", "firmness"):
        np.testing.assert_array_equal(getattr(after, field), getattr(before, field))
    for old, new in zip(before.targets, after.targets, strict=True):
        assert (old.name, old.bones) == (new.name, new.bones)
        np.testing.assert_array_equal(old.local, new.local)
        np.testing.assert_array_equal(old.shape, new.shape)


def test_undo_and_redo(soft_arm):
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.dynamorph.remove_target()
    bpy.ops.ed.undo_push(message="removed")
    assert names(bpy.data.objects["Arm"]) == ["Neutral"]
    bpy.ops.ed.undo()
    assert names(bpy.data.objects["Arm"]) == ["Neutral", "flexed"]
    assert extract.character(bpy.data.objects["Arm"]).targets[1].bones == ("lower",)
    bpy.ops.ed.redo()
    assert names(bpy.data.objects["Arm"]) == ["Neutral"]


def test_two_characters_are_apart(scene, soft_arm):
    other = make_soft(make_arm(scene, "Leg"))
    other.data.shape_keys.key_blocks["flexed"].name = "thigh"
    other.dynamorph.model.modes = 7
    bpy.context.view_layer.update()
    assert (names(soft_arm), names(other)) == (["Neutral", "flexed"], ["Neutral", "thigh"])
    assert soft_arm.dynamorph.model.modes == 20


def test_disable_and_enable_keeps_settings(soft_arm):
    for _ in range(3):
        addon_utils.disable(MODULE)
        assert not hasattr(bpy.types.Object, "dynamorph")
        addon_utils.enable(MODULE)
        assert names(soft_arm) == ["Neutral", "flexed"]
    handlers = [h for h in bpy.app.handlers.depsgraph_update_post if "dynamic_morph_targets" in h.__module__]
    assert handlers and len({h.__name__ for h in handlers}) == len(handlers)
