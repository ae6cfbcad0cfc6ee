# SPDX-License-Identifier: GPL-3.0-or-later
"""The shoulder scene: one folded target, two ways to fold, and no skin that runs into itself in either."""

from pathlib import Path
from types import SimpleNamespace

import bmesh
import bpy
import measures
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion
from builders import warnings_of
from mathutils.bvhtree import BVHTree

SAMPLES = Path(__file__).parents[3] / "sample_blends"
SCENE = SAMPLES / "shoulder.blend"
FOLDS = {"Arm raised": (38, 68, 104), "Arm lowered": (148, 170, 214)}  # frames: open, folded, open again
CHEST, CLAVICLE, UPPERARM, FOREARM = range(4)


@pytest.fixture(scope="module")
def shoulder(addon):
    """The soft skin as arrays, and `posed`: its vertices at a frame, displaced by a shape before the bones act."""
    bpy.ops.wm.open_mainfile(filepath=str(SCENE))
    skin = bpy.data.objects["Shoulder"]
    character = extract.character(skin)
    samples = rig_motion.sample_rig(skin, 1, bpy.context.scene.frame_end, 1)
    matrices = samples.skin_matrices(character.skeleton, character.to_bind)

    def posed(frame, shape=0):
        return measures.posed(character.vertices + shape, character.weights, matrices[frame - 1])

    return SimpleNamespace(
        object=skin,
        character=character,
        posed=posed,
        bones=matrices,
        elbow=character.skeleton.local_transforms(samples.pose)[:, FOREARM],
        targets={target.name: target for target in character.targets},
    )


@pytest.fixture(scope="module")
def baked(shoulder):
    pytest.importorskip("dynamorph", reason="needs the engine")
    job = Job(shoulder.object, goal="BAKE")
    batch.run(job)
    return job


def static_shape(shoulder, motion, frame):
    """The targets' shapes blended by the pose, without any dynamics; the arm is posed as in target `motion`."""
    names = ("Neutral", "Half fold", "Folded")
    knots = [turn(shoulder.targets[name].local[FOREARM]) for name in names]
    angle = turn(shoulder.elbow[frame - 1])
    weights = [np.interp(angle, knots, hat) for hat in np.eye(3)]
    folded = sum(w * shoulder.targets[name].shape for w, name in zip(weights, names, strict=True))
    return shoulder.targets[motion].shape + folded


def turn(transform):
    """Angle of a rotation, in degrees."""
    return np.degrees(np.arccos(np.clip((np.trace(transform[:3, :3]) - 1) / 2, -1, 1)))


def intersecting_pairs(shoulder, vertices):
    """Pairs of triangles of the elbow's region and of the whole skin that intersect and share no vertex.

    The rest of the skin keeps its shape while the elbow folds, so it is examined once, with `measures`.
    """
    triangles = shoulder.character.triangles
    near = triangles[(shoulder.character.target_sets[1].region_weights[triangles] > 0).any(axis=1)]
    points = vertices.tolist()
    whole, elbow = (BVHTree.FromPolygons(points, faces.tolist()) for faces in (triangles, near))
    pairs = np.array(elbow.overlap(whole), int).reshape(-1, 2)
    return (near[pairs[:, 0]][:, :, None] != triangles[pairs[:, 1]][:, None]).all(axis=(1, 2)).sum()


def test_is_a_ready_scene(shoulder):
    scene, skin = bpy.context.scene, shoulder.object
    assert SCENE.stat().st_size < 1_500_000
    assert scene.camera and (scene.frame_start, scene.frame_end, scene.render.fps) == (1, 260, 24)
    assert "MakeHuman" in bpy.data.texts["LICENCE"].as_string()
    assert "Folded" in bpy.data.texts["README"].as_string()
    assert 6000 <= len(skin.data.vertices) <= 15000
    assert all(polygon.use_smooth == (polygon.material_index == 0) for polygon in skin.data.polygons)
    assert warnings_of(skin) == []


def test_mesh_is_closed_and_skinned_smoothly(shoulder):
    mesh = bmesh.new()
    mesh.from_mesh(shoulder.object.data)
    assert all(edge.is_manifold for edge in mesh.edges)
    weights = shoulder.character.weights
    jumps = [
        np.abs(weights[edge.verts[0].index] - weights[edge.verts[1].index]).max() / edge.calc_length()
        for edge in mesh.edges
        if edge.calc_length() > 1e-3 and edge.is_contiguous
    ]
    mesh.free()
    assert np.max(jumps) < 25  # per meter: a joint extends over at least 4 cm


def test_six_targets_in_two_sets_on_four_bones(shoulder):
    character = shoulder.character
    assert character.skeleton.names == ("chest", "clavicle", "upperarm", "forearm")
    body, elbow = character.target_sets
    assert [target.name for target in body.targets] == ["Neutral", "Arm raised", "Arm lowered"]
    assert [target.name for target in elbow.targets] == ["Neutral Elbow", "Half fold", "Folded"]
    assert all(set(target.bones) == {"clavicle", "upperarm"} for target in body.targets[1:])
    assert all(target.bones == ("forearm",) for target in elbow.targets[1:])
    folds = [turn(target.local[FOREARM]) for target in body.targets + elbow.targets]
    assert folds == pytest.approx([0, 0, 0, 0, 60, 110], abs=0.5)
    stiffness = {target.name: target.material.stiffness for target in character.targets}
    assert stiffness["Folded"] >= 8 * stiffness["Neutral"]
    assert stiffness["Neutral"] == min(stiffness.values())


@pytest.mark.parametrize("motion", FOLDS)
def test_plain_skinning_runs_into_itself_and_the_sculpt_does_not(shoulder, motion):
    opened, folded, _ = FOLDS[motion]
    frames = range(opened, folded + 1)
    assert intersecting_pairs(shoulder, shoulder.posed(folded)) > 50
    pairs = {f: intersecting_pairs(shoulder, shoulder.posed(f, static_shape(shoulder, motion, f))) for f in frames}
    assert {f: count for f, count in pairs.items() if count} == {}


@pytest.mark.parametrize("motion", FOLDS)
def test_simulated_skin_stays_out_of_itself_all_the_way(shoulder, baked, motion):
    def skin(frame):
        return shoulder.posed(frame, baked.outcome.bake.displacement(frame - 1))

    opened, folded, closed = FOLDS[motion]
    pairs = {f: intersecting_pairs(shoulder, skin(f)) for f in range(opened, closed + 1, 2)}
    assert {f: count for f, count in pairs.items() if count} == {}
    for frame in (opened, folded):
        assert measures.self_intersections(skin(frame), shoulder.character.triangles).pairs == 0


def test_model_has_the_size_of_the_thesis(baked):
    made = baked.outcome.model.summary
    assert made.modes == 19 and made.targets == 5  # the neutral one once
    assert made.dofs == pytest.approx(4899, rel=0.1)
    assert baked.outcome.report["inverted"] == 0


def test_elbow_shakes_when_relaxed_and_holds_when_folded(shoulder, baked):
    shapes = np.array([target.shape for target in shoulder.character.targets])
    elbow = shoulder.character.target_sets[1].region_weights > 0.9

    def swing(first, last):
        weights = baked.outcome.bake.weights
        apart = [
            baked.outcome.bake.displacement(k) - np.tensordot(weights[k], shapes, 1) for k in range(first - 1, last)
        ]
        return np.linalg.norm(np.array(apart)[:, elbow], axis=2).max()

    assert swing(234, 250) > 0.004
    assert swing(176, 192) < 0.35 * swing(234, 250)


def test_chest_bulges_as_the_arm_comes_down(shoulder, baked):
    frame = 146
    chest = np.flatnonzero(shoulder.character.weights[:, CHEST] > 0.7)

    def depth(shape):
        return measures.depth(shoulder.posed(frame, shape), chest, np.array([0.0, 1.0, 0.0]))

    assert depth(baked.outcome.bake.displacement(frame - 1)) > depth(0) + 0.005


@pytest.mark.parametrize("frame", [80, 174])
def test_biceps_bulges_when_the_elbow_is_folded(shoulder, baked, frame):
    character = shoulder.character
    arm = measures.region(character.triangles, character.weights[:, UPPERARM:].sum(axis=1) > 0.7)
    upper = arm[(character.weights[:, UPPERARM][arm] > 0.5).all(axis=1)]
    ends = character.bone_segments[UPPERARM] @ shoulder.bones[frame - 1, UPPERARM, :, :3].T
    head, tail = ends + shoulder.bones[frame - 1, UPPERARM, :, 3]

    def girth(shape):
        return measures.girth(shoulder.posed(frame, shape), upper, (head + tail) / 2, tail - head)

    assert girth(baked.outcome.bake.displacement(frame - 1)) > 1.04 * girth(0)
