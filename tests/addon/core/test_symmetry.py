# SPDX-License-Identifier: GPL-3.0-or-later
"""A mirror-symmetric body moves symmetrically under symmetric motion; any other body is simulated as it is."""

from functools import partial

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core.engine import dynamorph
from bl_ext.user_default.dynamic_morph_targets.core.model import cage
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from builders import activate, make_mesh

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

RINGS, AROUND = 25, 32
MIRROR = np.array([-1.0, 1.0, 1.0])
BUMP = 0.35  # how far the bumps stand out, of the body's radius


def make_torso(scene, right=BUMP):
    """An egg with two bumps on its front, on a bone in the middle and one at each side, which hops. The diagonals of
    its faces are not symmetric. right: how far the bump on the right stands out.
    """
    latitude, longitude = np.meshgrid(np.linspace(0.0, np.pi, RINGS), np.arange(AROUND) * 2.0 * np.pi / AROUND)
    out = np.stack(
        [np.sin(latitude) * np.cos(longitude), np.sin(latitude) * np.sin(longitude), -np.cos(latitude)], axis=-1
    ).reshape(-1, 3)
    egg = out * [0.3, 0.2, 0.5]
    points = egg.copy()
    for side, bump in ((1.0, BUMP), (-1.0, right)):
        near = np.linalg.norm(egg - [0.13 * side, -0.17, 0.1], axis=1)
        points += 0.3 * bump * np.exp(-((near / 0.09) ** 2))[:, None] * [0.0, -1.0, 0.0]
    index = np.arange(len(points)).reshape(AROUND, RINGS)
    a, b = index[:, :-1], np.roll(index, -1, axis=0)[:, :-1]
    quads = np.stack([a, b, b + 1, a + 1], axis=-1).reshape(-1, 4)
    obj = make_mesh(scene, "Torso", points, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]]).tolist())
    armature = bpy.data.armatures.new("Torso Rig")
    rig = bpy.data.objects.new("Torso Rig", armature)
    scene.collection.objects.link(rig)
    activate(rig)
    bpy.ops.object.mode_set(mode="EDIT")
    for name, x in (("spine", 0.0), ("side.L", 0.2), ("side.R", -0.2)):
        bone = armature.edit_bones.new(name)
        bone.head, bone.tail = (x, 0.0, -0.3), (x, 0.0, 0.3)
    bpy.ops.object.mode_set(mode="OBJECT")
    beside = np.clip((np.abs(points[:, 0]) - 0.05) / 0.15, 0.0, 1.0)
    left = points[:, 0] > 0.0
    for name, weights in {"spine": 1.0 - beside, "side.L": beside * left, "side.R": beside * ~left}.items():
        group = obj.vertex_groups.new(name=name)
        for vertex in np.flatnonzero(weights).tolist():
            group.add([vertex], float(weights[vertex]), "REPLACE")
    obj.modifiers.new("Armature", "ARMATURE").object = obj.parent = rig
    for frame in range(1, 25):
        rig.location.z = 0.4 * abs(np.sin(0.5 * (frame - 1)))
        rig.keyframe_insert("location", frame=frame)
    scene.frame_start, scene.frame_end = 1, 24
    scene.frame_set(1)
    activate(obj)
    bpy.ops.dynamorph.add_soft_skin()
    return obj


def bake(obj, solver="REDUCED"):
    """The model and the displacements (F, V, 3), local space, meters."""
    model = obj.dynamorph.model
    model.cage_nodes, model.modes, model.solver, model.hold_head = 500, 60, solver, False
    job = Job(obj, goal="BAKE", substeps=4)
    batch.run(job)
    found = job.outcome.bake
    return job.outcome.model, np.array([found.displacement(k) for k in range(len(found.frames))])


def apart(points: np.ndarray, moved: np.ndarray) -> float:
    """RMS difference between the motion (F, V, 3) and its mirror image, relative to it."""
    distances = np.linalg.norm(points[:, None] * MIRROR - points, axis=-1)
    assert distances.min(axis=1).max() < 1e-6
    image = moved[:, distances.argmin(axis=1)] * MIRROR
    return float(np.linalg.norm(moved - image) / np.linalg.norm(moved))


def rest(obj) -> np.ndarray:
    return np.array([vertex.co for vertex in obj.data.vertices])


@pytest.mark.parametrize("solver", ["REDUCED", "FULL"])
def test_left_and_right_hop_alike(scene, solver):
    """Limited as by default, and held back: the limit is no reason to differ."""
    torso = make_torso(scene)
    model, moved = bake(torso, solver)
    assert np.abs(moved).max() > 0.005
    assert {tuple(node) for node in model.nodes.tolist()} == {tuple(node) for node in (model.nodes * MIRROR).tolist()}
    assert apart(rest(torso), moved) < 0.01


def test_without_a_symmetric_cage_they_do_not(scene, monkeypatch):
    """That the test above can fail."""
    monkeypatch.setattr(cage.dynamorph, "symmetric_like", lambda mesh, *_: mesh)
    torso = make_torso(scene)
    assert apart(rest(torso), bake(torso)[1]) > 0.03


def test_an_asymmetric_body_is_simulated_as_it_is(scene, monkeypatch):
    """To the last bit as if there were no symmetry to look for."""
    make = partial(make_torso, scene, right=1.3 * BUMP)
    model, moved = bake(make())
    monkeypatch.setattr(cage.dynamorph, "symmetric_like", lambda mesh, *_: mesh)
    again, moved_again = bake(make())
    np.testing.assert_array_equal(again.nodes, model.nodes)
    np.testing.assert_array_equal(moved_again, moved)


def test_an_artists_symmetric_cage_is_filled_symmetrically(scene):
    """And a cage that is not symmetric is filled as it is, whatever the skin."""
    torso = make_torso(scene)
    bpy.ops.mesh.primitive_uv_sphere_add(segments=16, ring_count=10)
    sphere = bpy.context.object.data
    faces = sorted(tuple(face.vertices) for face in sphere.polygons)  # Blender makes them in another order each time
    own = make_mesh(scene, "Cage", [vertex.co for vertex in sphere.vertices], faces)
    own.scale = (0.45, 0.55, 0.7)
    bpy.context.view_layer.update()
    activate(torso)
    torso.dynamorph.model.cage_object = own
    model, moved = bake(torso)
    mirrored = dynamorph.embed(dynamorph.TetMesh(model.nodes, model.tets), model.nodes * MIRROR)
    assert mirrored.distances.max() < 1e-6
    assert apart(rest(torso), moved) < 0.01
    own.scale.x = 0.5
    own.location.x = 0.03
    bpy.context.view_layer.update()
    model, _ = bake(torso)
    assert (model.nodes[:, 0] > 0.4).any()
