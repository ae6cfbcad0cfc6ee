# SPDX-License-Identifier: GPL-3.0-or-later
"""The artist's own mesh as the cage: it is read where the skin rests, the model depends on it, and refusals come with
advice.
"""

import inspect

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.properties import model_properties
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store
from builders import make_mesh, refused, rig_of
from mathutils import Matrix

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

CORNERS = np.array([[x, y, z] for z in (0, 1) for y in (-1, 1) for x in (-1, 1)])
FACES = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (1, 3, 7, 5), (3, 2, 6, 7), (2, 0, 4, 6)]
LOW, HIGH = -0.1, 2.1  # around the arm


@pytest.fixture
def caged(soft_arm):
    """The arm with a box as its cage, which stands elsewhere and is scaled."""
    soft_arm.dynamorph.model.cage_nodes = 200
    soft_arm.dynamorph.model.modes = 8
    box = make_mesh(bpy.context.scene, "Box", CORNERS, FACES)
    box.matrix_world = Matrix.LocRotScale((0, 0, LOW), None, (0.5, 0.5, HIGH - LOW))
    bpy.context.view_layer.update()
    soft_arm.dynamorph.model.cage_object = box
    return soft_arm


def box_of(obj):
    return obj.dynamorph.model.cage_object


def reasons(obj):
    return model_store.stale_reasons(obj, extract.character(obj))


def test_the_model_is_made_in_the_artists_cage(caged):
    bpy.ops.dynamorph.build()
    model = model_store.load_model(caged)
    np.testing.assert_allclose(model.nodes.min(axis=0), (-0.5, -0.5, LOW), atol=1e-4)
    np.testing.assert_allclose(model.nodes.max(axis=0), (0.5, 0.5, HIGH), atol=1e-4)
    assert abs(len(model.nodes) / 200 - 1) < 0.2
    assert reasons(caged) == []


def test_the_cage_is_read_at_rest_and_at_the_start(caged):
    """It does not matter whether it is skinned like the body or moved with it, nor what the current frame is."""
    rig, box = rig_of(caged), box_of(caged)
    for bone in ("upper", "lower"):
        group = box.vertex_groups.new(name=bone)
        group.add(range(8), 0.5, "REPLACE")
    box.modifiers.new("Armature", "ARMATURE").object = rig
    expected = extract.character(caged).cage
    bpy.context.scene.frame_set(20)  # bent
    bent = extract.character(caged).cage
    np.testing.assert_array_equal(bent.points, expected.points)
    assert rig.data.pose_position == "POSE"
    for moved in (rig, box, caged):
        moved.matrix_world = Matrix.Translation((3.0, 1.0, 0.5)) @ moved.matrix_world
    bpy.context.view_layer.update()
    np.testing.assert_allclose(extract.character(caged).cage.points, expected.points, atol=1e-4)


def test_the_cage_fits_a_body_of_any_scale(caged):
    """One unit of the body is a thousand units of the cage."""
    box = box_of(caged)
    for moved in (caged, rig_of(caged)):
        moved.scale = (1000.0,) * 3
    box.matrix_world = Matrix.LocRotScale((0, 0, 0), None, (412.34, 412.34, 2345.6))
    bpy.context.view_layer.update()
    points = extract.character(caged).cage.points
    np.testing.assert_allclose(np.ptp(points, axis=0), (824.68, 824.68, 2345.6), rtol=1e-4)


def test_the_cage_is_a_dependency(caged):
    bpy.ops.dynamorph.build()
    box = box_of(caged)
    box.name = "Renamed"
    assert reasons(caged) == []
    box.location.x += 0.05
    assert reasons(caged) == ["cage object changed"]
    box.location.x -= 0.05
    box.data.vertices[0].co.x -= 0.1
    assert reasons(caged) == ["cage object changed"]
    box.data.vertices[0].co.x += 0.1
    assert reasons(caged) == []
    caged.dynamorph.model.cage_object = None
    assert reasons(caged) == ["cage object changed"]


@pytest.mark.fault("P04")
def test_a_deleted_cage_is_missed_or_forgotten(caged):
    box = box_of(caged)
    bpy.context.scene.collection.objects.unlink(box)  # what Delete leaves of an object that still has users
    refused(bpy.ops.dynamorph.build, "'Box' of 'Arm' is not in the scene any more")
    bpy.data.objects.remove(box)
    bpy.ops.dynamorph.build()
    assert model_store.load_model(caged).nodes[:, 0].max() < 0.45


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda box: box.data.clear_geometry(), "'Box' has no faces"),
        (lambda box: setattr(box, "hide_viewport", True), "'Box' is disabled in viewports"),
        (lambda box: box.modifiers.new("Build", "BUILD"), "'Box'.*has 1 holes.*Fill Holes"),
        (lambda box: setattr(box, "scale", (0.5, 0.5, 0.4)), "'Box' leaves out .* of 'Arm'.*enlarge"),
        (lambda box: setattr(box, "scale", (1e-4, 1e-4, 1e-4)), "'Box' leaves out .* of 'Arm'.*enlarge"),
    ],
    ids=["empty", "disabled", "open", "too small", "in another unit"],
)
def test_an_unusable_cage_is_refused_with_its_name(caged, spoil, words):
    box = box_of(caged)
    spoil(box)
    if "BUILD" in [modifier.type for modifier in box.modifiers]:
        box.modifiers["Build"].frame_start, box.modifiers["Build"].frame_duration = -5, 10
    refused(bpy.ops.dynamorph.build, words)


@pytest.mark.fault("P04")
def test_only_other_meshes_can_be_cages(caged):
    """Blender asks the property as it is registered, when it lists what to choose from."""
    model = caged.dynamorph.model
    annotations = inspect.get_annotations(model_properties.DynamorphModel, eval_str=True)
    candidates = annotations["cage_object"].keywords["poll"]
    assert candidates(model, box_of(caged))
    assert not candidates(model, caged)
    assert not candidates(model, rig_of(caged))


def test_undo_brings_the_cage_back(caged):
    bpy.ops.ed.undo_push(message="with a cage")
    caged.dynamorph.model.cage_object = None
    bpy.ops.ed.undo_push(message="without")
    bpy.ops.ed.undo()
    assert box_of(bpy.data.objects["Arm"]).name == "Box"
