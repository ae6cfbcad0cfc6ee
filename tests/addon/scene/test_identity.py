# SPDX-License-Identifier: GPL-3.0-or-later
"""The body that is seen is the one that is simulated: shape keys that are always on belong to it."""

import bmesh
import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene import references
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.read import identity, mesh_data
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from bl_ext.user_default.dynamic_morph_targets.write import storage
from builders import activate, add_key, evaluated_points, keys_of, make_arm, make_soft, rig_of
from robustness import coarse
from test_attachments import add_attachment, make_sleeve


@pytest.fixture
def smile(soft_arm):
    """A key of the arm that is no target."""
    return keys_of(soft_arm).key_blocks["smile"]


def added(obj) -> float:
    """How far the body that is seen is from the Basis."""
    return float(np.abs(identity.body_points(obj) - mesh_data.rest_points(obj)).max())


def at_rest(obj) -> np.ndarray:
    """What Blender shows without the armature, local space."""
    obj.modifiers["Armature"].show_viewport = False
    shown = evaluated_points(obj)
    obj.modifiers["Armature"].show_viewport = True
    return shown


@pytest.mark.fault("K06")
def test_it_is_what_blender_shows(soft_arm, smile):
    group = soft_arm.vertex_groups.new(name="half")
    group.add(range(200), 0.9, "REPLACE")
    smile.vertex_group, smile.value = "half", 1.0
    heavy = add_key(soft_arm, "heavy", 0.2 * np.ones((len(soft_arm.data.vertices), 3)))
    heavy.relative_key, heavy.value = smile, 1.0
    assert list(identity.shifts(soft_arm)) == ["smile", "heavy"]
    np.testing.assert_allclose(identity.body_points(soft_arm), at_rest(soft_arm), atol=1e-6)


def test_what_moves_or_hardly_shows_does_not_count(soft_arm, smile):
    assert added(soft_arm) == 0.0
    smile.value = 0.02
    assert added(soft_arm) == 0.0
    smile.value = 1.0
    assert added(soft_arm) > 0.04
    smile.mute = True
    assert added(soft_arm) == 0.0
    smile.mute = False
    smile.keyframe_insert("value", frame=1)  # an expression
    assert added(soft_arm) == 0.0
    keys_of(soft_arm).animation_data_clear()
    keys_of(soft_arm).key_blocks["flexed"].value = smile.value = 1.0
    assert list(identity.shifts(soft_arm)) == ["smile"]  # the other is a target


def driven(owner, path, target, source):
    """A driver by one property of another data-block."""
    curve = owner.driver_add(path)
    variable = curve.driver.variables.new()
    variable.name = "value"
    variable.targets[0].id_type = target.id_type
    variable.targets[0].id, variable.targets[0].data_path = target, source
    curve.driver.expression = "value"
    return curve.driver


def test_keys_may_be_driven_by_properties_that_stand_still(scene, soft_arm, smile):
    """As those of Daz characters: by a property of the armature, by one of the armature object."""
    rig = rig_of(soft_arm)
    rig["Heavy"], rig.data["Heavy(fin)"] = 1.0, 0.0
    driven(rig.data, '["Heavy(fin)"]', rig, '["Heavy"]')
    driver = driven(keys_of(soft_arm), 'key_blocks["smile"].value', rig.data, '["Heavy(fin)"]')
    scene.frame_set(2)
    assert smile.value == 1.0 and list(identity.shifts(soft_arm)) == ["smile"]
    for moving in ("value + 0 * frame", "value + 0 * noise.random()", "value + 0 * dynamorph_test()"):
        driver.expression = moving  # a function may say something else at each frame
        assert added(soft_arm) == 0.0
    driver.expression = "max(value, 0.5)"
    assert added(soft_arm) > 0.04
    driver.expression = "value"
    rig.keyframe_insert('["Heavy"]', frame=1)
    assert added(soft_arm) == 0.0
    rig.animation_data_clear()
    driver.variables[0].targets[0].id_type = "OBJECT"
    driver.variables[0].targets[0].id, driver.variables[0].targets[0].data_path = rig, "location.x"
    assert added(soft_arm) == 0.0


def test_properties_that_drive_each_other_do_not_stand_still(scene, soft_arm, smile):
    rig = rig_of(soft_arm)
    rig["a"] = rig["b"] = 1.0
    driven(rig, '["a"]', rig, '["b"]')
    driven(rig, '["b"]', rig, '["a"]')
    driven(keys_of(soft_arm), 'key_blocks["smile"].value', rig, '["a"]')
    smile.value = 1.0
    assert added(soft_arm) == 0.0


@pytest.mark.fault("K06")
def test_the_model_is_out_of_date_when_the_body_is_another(soft_arm, smile):
    soft_arm.dynamorph.model.cage_nodes = 120
    batch.run(Job(soft_arm, goal="BUILD"))
    assert staleness.model_age(soft_arm) == []
    smile.value = 1.0
    character = extract.character(soft_arm)
    np.testing.assert_allclose(character.vertices, at_rest(soft_arm), atol=1e-6)
    storage.show_stale(soft_arm)
    assert staleness.model_age(soft_arm) == ["mesh changed"]


@pytest.mark.fault("K06")
@pytest.mark.parametrize("output", ["MODES", "PC2"])
def test_it_moves_as_if_the_shape_were_the_basis(scene, tmp_path, output):
    """With a sleeve that has a key of its own."""
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    baked = {}
    for is_key in (True, False):
        obj = coarse(make_soft(make_arm(scene, f"Arm {is_key}")))
        sleeve = make_sleeve(obj, f"Sleeve {is_key}")
        add_attachment(obj, sleeve)
        for mesh in (obj, sleeve):
            swell(mesh, is_key)
        obj.dynamorph.output.format = output
        activate(obj)
        assert bpy.ops.dynamorph.bake() == {"FINISHED"}
        baked[is_key] = played(scene, obj, sleeve)
        if output == "MODES":
            bpy.ops.dynamorph.delete_bake()
            bpy.ops.dynamorph.live()
            for live, bake in zip(played(scene, obj, sleeve), baked[is_key], strict=True):
                assert np.abs(live - bake).max() < 1e-4
            bpy.ops.dynamorph.live()
    for as_key, as_basis in zip(baked[True], baked[False], strict=True):
        assert np.abs(as_key - as_basis).max() < 1e-4


def swell(obj, is_key):
    """Make it thicker in the middle, by a key that is always on, or in all its keys. The diagonals of its faces, which
    Blender chooses by the Basis, stay.
    """
    faces = bmesh.new()
    faces.from_mesh(obj.data)
    bmesh.ops.triangulate(faces, faces=faces.faces)
    faces.to_mesh(obj.data)
    faces.free()
    points = mesh_data.rest_points(obj)
    swollen = 0.25 * np.exp(-(((points[:, 2] - 0.5) / 0.3) ** 2))
    out = points * [1.0, 1.0, 0.0] / np.linalg.norm(points[:, :2], axis=1)[:, None] * swollen[:, None]
    if is_key:
        if not obj.data.shape_keys:
            obj.shape_key_add(name="Basis")
        add_key(obj, "heavy", out).value = 1.0
    elif obj.data.shape_keys:
        for key in keys_of(obj).key_blocks:
            key.points.foreach_set("co", (references.key_points(key) + out).astype(np.float32).ravel())
    else:
        obj.data.attributes["position"].data.foreach_set("vector", (points + out).astype(np.float32).ravel())


def played(scene, *objects) -> list[np.ndarray]:
    """What Blender shows of each, (F, V, 3)."""
    shown = []
    for frame in range(scene.frame_start, scene.frame_end + 1):
        scene.frame_set(frame)
        shown.append([evaluated_points(each) for each in objects])
    return [np.array(each) for each in zip(*shown, strict=True)]
