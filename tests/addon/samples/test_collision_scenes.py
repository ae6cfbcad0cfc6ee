# SPDX-License-Identifier: GPL-3.0-or-later
"""The sample scenes in which the skin is touched: by something that it does not let in, by itself, and by a hand."""

from dataclasses import dataclass
from pathlib import Path

import bpy
import measures
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core.geometry import diagonal
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.motion import colliders
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from builders import warnings_of
from mathutils import Vector

SAMPLES = Path(__file__).parents[3] / "sample_blends"

DEEP, SHALLOW = 0.01, 0.002  # of the body's size: how deep the skin goes without collision, and with it


@dataclass(frozen=True)
class Scene:
    """frames: the whole scene; baked: up to this one, by when each collider has touched the skin."""

    name: str
    body: str
    colliders: tuple[str, ...]
    frames: int
    baked: int


SCENES = [
    Scene("rolling_ball", "Torso", ("Ball",), 84, 30),
    Scene("herbert_bench", "Herbert", ("Bench", "Floor"), 84, 26),
    Scene("pressed_cylinder", "Limb", ("Hand",), 72, 20),
]


@pytest.fixture(params=SCENES, ids=lambda made: made.name)
def made(scene, request):
    bpy.ops.wm.open_mainfile(filepath=str(SAMPLES / f"{request.param.name}.blend"))
    return request.param


def skin(body) -> np.ndarray:
    """Where Blender shows it (V, 3), world space."""
    evaluated = body.evaluated_get(bpy.context.evaluated_depsgraph_get())
    points = np.array([vertex.co for vertex in evaluated.data.vertices])
    world = np.array(evaluated.matrix_world)
    return points @ world[:3, :3].T + world[:3, 3]


def depth(points: np.ndarray, collider) -> float:
    """How deep the deepest of the points (V, 3) is in the collider; outside below 0."""
    evaluated = collider.evaluated_get(bpy.context.evaluated_depsgraph_get())
    corners = np.array([evaluated.matrix_world @ Vector(corner) for corner in evaluated.bound_box])
    near = ((points > corners.min(axis=0) - 0.02) & (points < corners.max(axis=0) + 0.02)).all(axis=1)
    inverse = evaluated.matrix_world.inverted()  # none of them is scaled
    deepest = -np.inf
    for point in points[near]:
        local = inverse @ Vector(point)
        _, place, normal, _ = evaluated.closest_point_on_mesh(local)
        deepest = max(deepest, (place - local).dot(normal))
    return deepest


def test_is_a_ready_scene(made):
    scene, body = bpy.context.scene, bpy.data.objects[made.body]
    assert (SAMPLES / f"{made.name}.blend").stat().st_size < 1_000_000
    assert scene.camera and (scene.frame_start, scene.frame_end, scene.render.fps) == (1, made.frames, 24)
    assert "CC0" in bpy.data.texts["LICENCE"].as_string()
    assert all(name in bpy.data.texts["README"].as_string() for name in (made.body, "Collision", "Bake"))
    assert warnings_of(body) == []
    assert tuple(other.name for other in colliders.colliders(body)) == made.colliders
    assert body.dynamorph.model.solver == "FULL"


def test_what_is_pressed_gives_way_and_lets_nothing_in(made):
    pytest.importorskip("dynamorph", reason="needs the engine")
    scene, body = bpy.context.scene, bpy.data.objects[made.body]
    scene.frame_end = made.baked
    character = extract.character(body)
    soft, size = character.firmness < 0.75, diagonal(character.vertices)
    frames = range(1, made.baked + 1)

    def bake(collides: bool):
        """The job; how deep the soft skin then is in each collider (F, C), and where it is (F, V, 3)."""
        body.dynamorph.collision.use = collides
        job = Job(body, goal="BAKE")
        batch.run(job)
        depths, points = [], []
        for frame in frames:
            scene.frame_set(frame)
            points.append(skin(body)[soft])
            depths.append([depth(points[-1], bpy.data.objects[name]) for name in made.colliders])
        return job, np.array(depths), np.array(points)

    _, free, plain = bake(collides=False)
    job, baked, points = bake(collides=True)
    print(made.name, free.max(axis=0) / size, baked.max(axis=0) / size, job.outcome.verdict.text)
    assert (free.max(axis=0) > DEEP * size).all()
    assert (baked < SHALLOW * size).all()
    assert np.linalg.norm(points - plain, axis=2).max() > DEEP * size
    assert (baked.max(axis=0) > -0.005 * size).all()  # it is touched, not pushed away
    assert job.warnings == [] and job.outcome.verdict.contact_texts == []


def opened(name: str, body: str, last: int):
    """The soft object of a sample scene, which then ends with a frame."""
    bpy.ops.wm.open_mainfile(filepath=str(SAMPLES / f"{name}.blend"))
    bpy.context.scene.frame_end = last
    obj = bpy.data.objects[body]
    assert warnings_of(obj) == []
    assert obj.dynamorph.model.solver == "FULL"
    return obj


def baked(body, *frames: int) -> list[np.ndarray]:
    """Where the skin is in frames (V, 3), after a bake without warnings."""
    job = Job(body, goal="BAKE")
    batch.run(job)
    assert job.warnings == []
    points = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        points.append(skin(body))
    return points


def test_a_folded_limb_flattens_itself(scene):
    pytest.importorskip("dynamorph", reason="needs the engine")
    limb = opened("folded_limb", "Limb", 22)
    triangles = mesh_data.mesh_triangles(limb.data)
    depths = {}
    for collides in (False, True):
        limb.dynamorph.collision.use = collides
        (points,) = baked(limb, 22)
        depths[collides] = measures.self_intersections(points, triangles).depth
    print(depths)
    assert depths[False] > 0.02
    assert depths[True] < 0.2 * depths[False]


def test_a_hand_pulls_the_belly_and_lets_go(scene):
    pytest.importorskip("dynamorph", reason="needs the engine")
    torso = opened("grabbed_belly", "Torso", 26)
    before, pulled, free = baked(torso, 1, 18, 26)
    top = before[:, 2].argmax()
    assert pulled[top, 2] - before[top, 2] > 0.05
    assert np.linalg.norm(free - before, axis=1).max() < 0.03
    torso.dynamorph.grips[0].mute = True
    before, still = baked(torso, 1, 18)
    assert np.linalg.norm(still - before, axis=1).max() < 1e-3
