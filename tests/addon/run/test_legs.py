# SPDX-License-Identifier: GPL-3.0-or-later
"""Self Collision of two legs, each on a bone of its own, that turn into each other."""

from math import asin, pi

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from builders import activate, evaluated_points, make_mesh
from mathutils import Vector
from mathutils.bvhtree import BVHTree

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

RADIUS, LENGTH, OVERLAP = 0.063, 0.7, 0.038  # meters; how deep the bones take one leg into the other
BLENDED = 0.1  # of a leg, meters, below which it is on its own bone alone
MOST = 0.001  # meters that may stay
TURNED, FRAMES = 12, 20  # by which frame they have turned, and by which they rest


def legs_of(gap: float, around=32, apart=0.02):
    """A tube that goes down both legs, and around between them at the height 0: vertices (V, 3), triangles, and the
    weights (V, 3) of its bones: left, right, hip.
    """
    x, cap = RADIUS + gap / 2, RADIUS * pi / 2
    ends = np.linspace(0.0, cap, 9)
    down = np.linspace(0.0, LENGTH, round(LENGTH / apart) + 1)
    turn = np.linspace(0.0, pi, 3 + round(pi * x / apart))[1:-1]
    places = [(-x, -LENGTH - RADIUS * np.cos(s / RADIUS), 0.0, RADIUS * np.sin(s / RADIUS)) for s in ends[1:-1]]
    places += [(-x, z - LENGTH, 0.0, RADIUS) for z in down]
    middle = [(-x * np.cos(a), x * np.sin(a), a, RADIUS) for a in turn]
    rings = places + middle + [(-x, z, pi - a, r) for x, z, a, r in places[::-1]]
    angles = 2 * pi * np.arange(around) / around
    points = [
        [(x - r * np.cos(t) * np.cos(a), r * np.sin(t), z + r * np.cos(t) * np.sin(a)) for t in angles]
        for x, z, a, r in rings
    ]
    bottom = -LENGTH - RADIUS
    vertices = np.concatenate([*points, [(-x, 0.0, bottom), (x, 0.0, bottom)]])
    ring, last = np.arange(around), len(vertices)
    after = np.roll(ring, -1)
    faces = [np.stack([np.full(around, last - 2), ring, after], axis=1)]
    for a in around * np.arange(len(rings) - 1):
        b = a + around
        faces += [np.stack([a + ring, b + after, a + after], 1), np.stack([a + ring, b + ring, b + after], 1)]
    faces.append(np.stack([last - around - 2 + after, last - around - 2 + ring, np.full(around, last - 1)], axis=1))
    own = np.clip(-vertices[:, 2] / BLENDED, 0.0, 1.0)
    left = vertices[:, 0] < 0.0
    return vertices, np.concatenate(faces), np.stack([own * left, own * ~left, 1.0 - own], axis=1)


def make_legs(scene, gap: float):
    """The object, its triangles, and the leg of each vertex: -1, 0 for none, 1."""
    x = RADIUS + gap / 2
    vertices, faces, weights = legs_of(gap)
    obj = make_mesh(scene, "Legs", vertices, faces.tolist())
    rig = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    scene.collection.objects.link(rig)
    activate(rig)
    bpy.ops.object.mode_set(mode="EDIT")
    hip = rig.data.edit_bones.new("hip")
    hip.head, hip.tail = (0.0, 0.0, x), (0.0, 0.0, x + 0.05)
    for name, side in (("left", -1.0), ("right", 1.0)):
        bone = rig.data.edit_bones.new(name)
        bone.head, bone.tail, bone.parent = (side * x, 0.0, 0.0), (side * x, 0.0, -LENGTH), hip
    bpy.ops.object.mode_set(mode="OBJECT")
    for name, column in zip(("left", "right", "hip"), weights.T, strict=True):
        group = obj.vertex_groups.new(name=name)
        for vertex in np.flatnonzero(column):
            group.add([int(vertex)], column[vertex], "REPLACE")
    for name, side in (("left", -1.0), ("right", 1.0)):
        bone = rig.pose.bones[name]
        bone.rotation_mode = "XYZ"
        axis = bone.bone.matrix_local.to_3x3().inverted() @ Vector((0.0, 1.0, 0.0))
        index = max(range(3), key=lambda i: abs(axis[i]))
        for frame, turn in ((1, 0.0), (TURNED, asin((gap + OVERLAP) / (2 * LENGTH)))):
            bone.rotation_euler[index] = side * axis[index] * turn
            bone.keyframe_insert("rotation_euler", frame=frame)
    obj.shape_key_add(name="Basis", from_mix=False)
    obj.modifiers.new("Armature", "ARMATURE").object = rig
    scene.frame_start, scene.frame_end = 1, FRAMES
    scene.frame_set(1)
    activate(obj)
    bpy.ops.dynamorph.add_soft_skin()
    obj.dynamorph.simulation.gravity = 0.0
    return obj, faces, np.where(vertices[:, 2] < 0.0, np.sign(vertices[:, 0]), 0.0)


def deepest(points: np.ndarray, faces: np.ndarray, legs: np.ndarray) -> float:
    """How deep a vertex of one leg is in the other one, at most, meters."""
    found = 0.0
    for side in (-1.0, 1.0):
        other = faces[(legs[faces] == side).all(axis=1)]
        tree = BVHTree.FromPolygons(points.tolist(), other.tolist())
        for point in points[legs == -side]:
            place, normal, _, distance = tree.find_nearest(Vector(point))
            if (Vector(point) - place).dot(normal) < 0.0:
                found = max(found, distance)
    return found


@pytest.mark.parametrize("gap", [0.01, 0.02, 0.04, 0.07, 0.12])
@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
def test_legs_do_not_stay_in_each_other(scene, solver, gap):
    legs, *shape = make_legs(scene, gap)
    legs.dynamorph.model.solver = solver
    legs.dynamorph.collision.bake_full = False
    left = {}
    for own in (False, True):
        legs.dynamorph.collision.use = legs.dynamorph.collision.use_self = own
        job = Job(legs, goal="BAKE")
        batch.run(job)
        assert job.warnings == []
        depths = []
        for frame in range(1, FRAMES + 1):
            scene.frame_set(frame)
            depths.append(deepest(evaluated_points(legs), *shape))
        left[own] = max(depths)
    print(solver, gap, left, depths[-1], job.outcome.verdict.touched.left_inside)
    assert left[False] > 0.9 * OVERLAP
    assert left[True] < MOST
