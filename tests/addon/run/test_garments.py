# SPDX-License-Identifier: GPL-3.0-or-later
"""A sleeve lies on an arm that is shaken: neither sinks into the other, in bakes and in Live."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import records
from bl_ext.user_default.dynamic_morph_targets.run import live as live_module
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene.motion import colliders
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from builders import activate, evaluated_points, make_arm, make_mesh, rig_of
from built import BuiltOnce
from layout import drawn
from mathutils.bvhtree import BVHTree
from scenes import tube, two_bone_weights

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

PHYSICS = "DYNAMORPH_PT_physics"
RADIUS, CLEARANCE = 0.3, 0.004  # meters: of the arm, and how far the sleeve is from it
FRAMES = 8
arm_built, sleeve_built, both_built = BuiltOnce(), BuiltOnce(), BuiltOnce()


def make_sleeve(scene, rig):
    """An open tube around the middle of an arm."""
    vertices, faces = tube(30, 32)
    wider = 1.0 + CLEARANCE / RADIUS
    vertices = vertices * [wider, wider, 0.6] + [0.0, 0.0, 0.4]
    sleeve = make_mesh(scene, "Sleeve", vertices, [face for face in faces if len(face) == 4])
    for bone, weights in zip(["upper", "lower"], two_bone_weights(vertices).T, strict=True):
        group = sleeve.vertex_groups.new(name=bone)
        for index in np.flatnonzero(weights):
            group.add([int(index)], float(weights[index]), "REPLACE")
    sleeve.modifiers.new("Armature", "ARMATURE").object = rig
    return sleeve


def make_soft_skin(obj):
    activate(obj)
    bpy.ops.dynamorph.add_soft_skin()
    settings = obj.dynamorph
    settings.model.cage_nodes, settings.model.modes, settings.simulation.gravity = 600, 40, 0.0


@pytest.fixture
def arm(scene):
    """Soft, with a sleeve, and shaken."""
    obj = make_arm(scene, rings=41, around=32)
    rig = rig_of(obj)
    rig.animation_data_clear()
    rig.pose.bones["lower"].rotation_euler.x = 0.0
    obj.parent = make_sleeve(scene, rig).parent = rig
    make_soft_skin(obj)
    obj.dynamorph.targets[0].stiffness = 1.5e5
    for frame in range(1, FRAMES + 1):
        rig.location.x = 0.3 * np.sin(0.9 * (frame - 1))
        rig.keyframe_insert("location", index=0, frame=frame)
    scene.frame_end = FRAMES
    scene.frame_set(1)
    return obj


@pytest.fixture
def dressed(arm):
    """The arm, and the sleeve in a cage of its own."""
    sleeve = bpy.data.objects["Sleeve"]
    arm.dynamorph.attachments["Sleeve"].attached_by = "OWN_CAGE"
    arm_built.give(arm, 10)
    make_soft_skin(sleeve)
    sleeve.dynamorph.targets[0].stiffness = 1.4e4  # or only the first sleeve would get what its build measures
    sleeve_built.give(sleeve, 10)
    return arm, sleeve


def collide(*objects, full=True):
    for obj in objects:
        obj.dynamorph.collision.use, obj.dynamorph.collision.bake_full = True, full


def bake_all(*objects):
    jobs = [Job(obj, "BAKE") for obj in objects]
    batch.run_all(batch.Batch(jobs, "BAKE_ALL"))
    return jobs


def deepest(arm, sleeve) -> float:
    """How deep the sleeve is in the arm as Blender shows both now, meters; below zero: out of it."""
    triangles = [tuple(face.vertices) for face in arm.data.polygons]
    tree = BVHTree.FromPolygons(evaluated_points(arm).tolist(), triangles)
    out = []
    for point in evaluated_points(sleeve):
        place, normal, *_ = tree.find_nearest(point)
        out.append(np.dot(np.array(place) - point, normal))
    return max(out)


def deepest_in_shot(arm, sleeve) -> float:
    out = []
    for frame in range(1, FRAMES + 1):
        bpy.context.scene.frame_set(frame)
        out.append(deepest(arm, sleeve))
    assert out[0] == pytest.approx(-CLEARANCE, rel=0.1)  # at rest, it lies where it lay
    return max(out)


@pytest.mark.parametrize("full", [True, False])
def test_clothes_in_a_cage_of_their_own_do_not_sink_in(dressed, full):
    """A tenth is left of what they would, and nothing is out of date."""
    bake_all(*dressed)
    without = deepest_in_shot(*dressed)
    collide(*dressed, full=full)
    jobs = bake_all(*dressed)
    assert without > 0.02 and deepest_in_shot(*dressed) < 0.1 * without
    assert {job.outcome.model.settings.solver for job in jobs} == {"FULL" if full else "REDUCED"}
    assert [records.bake_inputs(obj.dynamorph.bake.inputs)["together"] for obj in dressed] == [["Sleeve"], ["Arm"]]
    for obj in dressed:
        assert not staleness.outdated(obj) and "without" not in obj.dynamorph.bake.warnings


def test_live_is_as_the_bake(dressed):
    collide(*dressed, full=False)
    bake_all(*dressed)
    bpy.context.scene.frame_set(FRAMES)
    baked = [evaluated_points(obj) for obj in dressed]
    for obj in dressed:
        activate(obj)
        bpy.ops.dynamorph.delete_bake()
        bpy.ops.dynamorph.live()
    for frame in range(1, FRAMES + 1):
        bpy.context.scene.frame_set(frame)
    for obj, points in zip(dressed, baked, strict=True):
        assert live_module.is_on(obj) and not live_module.problem(obj)
        assert np.abs(evaluated_points(obj) - points).max() < 1e-5


def test_clothes_with_the_body_do_not_sink_in(arm):
    """They share its motion, and what presses it presses them."""
    sleeve = bpy.data.objects["Sleeve"]
    assert arm.dynamorph.attachments["Sleeve"].attached_by == "WITH_BODY"
    both_built.give(arm, 10)
    bake_all(arm)
    assert deepest_in_shot(arm, sleeve) < -0.5 * CLEARANCE


def test_clothes_baked_alone_say_so(dressed):
    arm, sleeve = dressed
    collide(*dressed, full=False)
    bake_all(sleeve)
    assert "'Sleeve' lies on 'Arm' but is baked without it: Bake All" in sleeve.dynamorph.bake.warnings
    bake_all(arm)
    assert not arm.dynamorph.bake.warnings


def test_a_change_of_the_body_makes_its_clothes_out_of_date(dressed):
    arm, sleeve = dressed
    collide(*dressed, full=False)
    bake_all(*dressed)
    arm.dynamorph.targets[0].density *= 1.5
    arm.dynamorph.collision.distance *= 2.0
    bake_all(arm)
    staleness.look_at_colliders(sleeve)
    assert staleness.outdated(sleeve) == ["'Arm' changed"]


def test_the_button_lets_them_press_on_each_other(dressed):
    arm, sleeve = dressed
    assert colliders.garments(dressed) == [(sleeve, arm)]  # each is attached to the other: the smaller one lies on it
    assert "'Sleeve' passes through this body: turn Collision of both on to stop it" in " ".join(drawn(arm, PHYSICS))
    sleeve.select_set(True)
    activate(arm)
    bpy.ops.dynamorph.collide()
    assert colliders.pressed(arm) == [sleeve] and colliders.pressed(sleeve) == [arm]
    assert not any(modifier.type == "COLLISION" for obj in dressed for modifier in obj.modifiers)
    text = " ".join(drawn(arm, PHYSICS))
    assert "Presses on: Sleeve. Bake All bakes them together" in text and "passes through" not in text
