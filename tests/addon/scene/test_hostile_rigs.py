# SPDX-License-Identifier: GPL-3.0-or-later
"""Faults of rigs, animation and settings that nothing else here is about: see tests/faults.toml."""

import bpy
import numpy as np
import pytest
import scenes
from bl_ext.user_default.dynamic_morph_targets.scene import animation
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from builders import activate, assert_shows, make_mesh, refused, rig_of
from mathutils import Quaternion
from robustness import OPS, bake, coarse, motion

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

SIZE = 2.0  # meters, of the arm


@pytest.fixture
def skin(soft_arm):
    return coarse(soft_arm)


def displaced(job):
    """The displacements (F, V, 3) of a bake."""
    return np.array([job.outcome.bake.displacement(k) for k in range(len(job.outcome.bake.frames))])


def interpolate(rig, interpolation):
    """How Blender goes from one keyframe of the rig to the next."""
    for curve in animation.curves(rig.animation_data.action, rig.animation_data.action_slot):
        for point in curve.keyframe_points:
            point.interpolation = interpolation


# Rigs --------------------------------------------------------------------------------------------------------------


@pytest.mark.fault("R05")
def test_a_cycle_a_constraint_without_its_target_and_a_broken_driver(skin):
    """Blender evaluates what it can of them; so does a bake."""
    rig = rig_of(skin)
    upper, lower = rig.pose.bones["upper"], rig.pose.bones["lower"]
    lower.constraints.new("DAMPED_TRACK")
    follow = upper.constraints.new("COPY_ROTATION")
    follow.target, follow.subtarget, follow.influence = rig, "lower", 0.2
    lower.driver_add("location", 1).driver.expression = "nonsense +"
    bpy.context.view_layer.update()
    job = bake(skin)
    assert np.isfinite(displaced(job)).all()
    assert np.isfinite(motion(skin)).all()


@pytest.mark.fault("R07")
def test_far_from_the_origin_the_tissue_is_as_calm(scene, skin):
    near = displaced(bake(skin))
    root = bpy.data.objects.new("Root", None)
    scene.collection.objects.link(root)
    skin.parent, rig_of(skin).parent = rig_of(skin), root
    root.location = 1e5, -1e5, 1e5
    bpy.context.view_layer.update()
    assert np.abs(displaced(bake(skin)) - near).max() < 1e-4 * SIZE


def chained(scene, count, deforming):
    """A soft skin on a chain of `count` bones that bend together; each `deforming`-th bone carries it."""
    rig = bpy.data.objects.new("Chain Rig", bpy.data.armatures.new("Chain Rig"))
    scene.collection.objects.link(rig)
    activate(rig)
    bpy.ops.object.mode_set(mode="EDIT")
    for i in range(count):
        bone = rig.data.edit_bones.new(f"{i}")
        bone.head, bone.tail = (0.0, 0.0, SIZE * i / count), (0.0, 0.0, SIZE * (i + 1) / count)
        bone.parent, bone.use_deform = rig.data.edit_bones.get(f"{i - 1}"), i % deforming == 0
    bpy.ops.object.mode_set(mode="OBJECT")
    vertices, faces = scenes.tube()
    obj = make_mesh(scene, "Chain", vertices, faces)
    for vertex in range(len(vertices)):  # which go upward
        name = f"{count * vertex // len(vertices) // deforming * deforming}"
        group = obj.vertex_groups.get(name) or obj.vertex_groups.new(name=name)
        group.add([vertex], 1.0, "REPLACE")
    obj.modifiers.new("Armature", "ARMATURE").object = rig
    for frame, angle in ((1, 0.0), (5, 1.0 / count)):
        for bone in rig.pose.bones:
            bone.rotation_mode, bone.rotation_euler.x = "XYZ", angle
            bone.keyframe_insert("rotation_euler", index=0, frame=frame)
    scene.frame_start, scene.frame_end = 1, 5
    scene.frame_set(1)
    activate(obj)
    OPS.add_soft_skin()
    return coarse(obj)


@pytest.mark.fault("R06")
@pytest.mark.parametrize("basis, deforming", [("MODES", 20), ("RESPONSES", 1)])
def test_a_thousand_bones(scene, basis, deforming):
    obj = chained(scene, 1000, deforming)
    obj.dynamorph.model.basis, obj.dynamorph.model.modes = basis, 12
    job = bake(obj, substeps=1)
    assert len(job.outcome.character.skeleton.names) == 1000
    assert_shows(obj, job.outcome.bake)
    assert np.abs(displaced(job)).max() > 1e-4


# Animation ---------------------------------------------------------------------------------------------------------


@pytest.mark.fault("A02")
def test_stepped_keys(scene, skin):
    """Twelve poses a second at 24 frames: each jump is a blow; after the last one the tissue comes to rest."""
    rig = rig_of(skin)
    rig.animation_data_clear()
    lower = rig.pose.bones["lower"]
    for frame in range(1, 21, 2):
        lower.rotation_euler.x = 0.06 * frame
        lower.keyframe_insert("rotation_euler", frame=frame)
    interpolate(rig, "CONSTANT")
    scene.frame_end = 120
    job = bake(skin)
    assert_shows(skin, job.outcome.bake)
    moved = displaced(job)
    assert np.isfinite(moved).all() and np.abs(moved).max() < 0.5 * SIZE
    steps = np.abs(np.diff(moved, axis=0)).max(axis=(1, 2))
    assert steps[-20:].max() < 0.05 * steps[:20].max()


@pytest.mark.fault("A08")
def test_what_is_for_rendering_alone_changes_no_bake(scene, skin):
    plain = bake(skin).outcome.bake
    scene.frame_step, scene.render.use_simplify, scene.render.simplify_subdivision = 3, True, 0
    again = bake(skin).outcome.bake
    np.testing.assert_array_equal(again.frames, plain.frames)
    np.testing.assert_array_equal(again.coordinates, plain.coordinates)


@pytest.mark.fault("A03")
@pytest.mark.parametrize("turns", ["signs", "degrees"])
def test_the_same_rotation_written_otherwise(skin, turns):
    """Each second quaternion with the other sign, or angles that jump by a turn: no pose is another."""
    rig = rig_of(skin)
    lower = rig.pose.bones["lower"]
    lower.rotation_mode = "QUATERNION" if turns == "signs" else "XYZ"
    path = "rotation_quaternion" if turns == "signs" else "rotation_euler"
    found = []
    for other in (False, True):
        rig.animation_data_clear()
        for frame in range(1, 21):
            angle, jumps = 0.06 * frame, other and frame % 2
            if turns == "signs":
                lower.rotation_quaternion = Quaternion((1, 0, 0), angle) * (-1.0 if jumps else 1.0)
            else:
                lower.rotation_euler.x = angle + (2.0 * np.pi if jumps else 0.0)
            lower.keyframe_insert(path, frame=frame)
        interpolate(rig, "CONSTANT")
        found.append(displaced(bake(skin, substeps=1)))
    assert np.abs(found[0]).max() > 1e-3
    assert np.abs(found[1] - found[0]).max() < 1e-4 * SIZE


# Settings ----------------------------------------------------------------------------------------------------------


@pytest.mark.fault("P03")
def test_more_modes_than_the_cage_has(skin):
    skin.dynamorph.model.cage_nodes, skin.dynamorph.model.modes = 50, 170
    refused(OPS.bake, "'Arm': 170 modes.*fewer than")
    assert not skin.dynamorph.model.content_id and not skin.dynamorph.bake.exists


@pytest.mark.fault("P05")
def test_a_driven_material(scene, skin):
    """It acts over the shot, whichever frame shows; what it reads counts, too."""
    curve = skin.driver_add("dynamorph.targets[0].stiffness")
    curve.driver.expression = "2e4 * frame"
    scene.frame_set(3)
    first = displaced(bake(skin))
    assert staleness.outdated(skin) == []
    scene.frame_set(5)
    assert staleness.outdated(skin) == []
    np.testing.assert_array_equal(displaced(bake(skin)), first)
    curve.driver.expression = "3e4 * frame"
    assert staleness.outdated(skin) == ['Stiffness of "Neutral" changed']


@pytest.mark.fault("P06")
def test_targets_that_are_a_million_million_times_stiffer(skin):
    targets = skin.dynamorph.targets
    targets[0].stiffness, targets[1].stiffness = 1.0, 1e12
    job = bake(skin)
    assert np.isfinite(displaced(job)).all() and job.outcome.report["residual"] < 1e-3
