# SPDX-License-Identifier: GPL-3.0-or-later
"""What a real character costs from mesh to shape keys, by stage: `make bench`. Not part of `make test`.

The MakeHuman body: 13k vertices, 53 bones, 5 targets; 20 modes of StVK, 4 substeps.
"""

from __future__ import annotations

import time
from contextlib import contextmanager

import project  # noqa: F401
import fresh_blender  # noqa: F401

import bpy
import dynamic_morph_targets
import dynamorph
import pytest
import real_character
from dynamic_morph_targets.run import live
from dynamic_morph_targets.run.bake import batch, job
from dynamic_morph_targets.run.bake.job import Job
from dynamic_morph_targets.scene import events
from dynamic_morph_targets.scene.character import extract
from dynamic_morph_targets.scene.read import sampling_scene

SUBSTEPS = 4
ROUNDS = 7
DRIVEN_KEYS = 200

pytestmark = pytest.mark.skipif(not real_character.CHARACTER.exists(), reason="../shared/assets is not here")


@pytest.fixture(scope="module", autouse=True)
def registered():
    dynamic_morph_targets.register()
    yield
    dynamic_morph_targets.unregister()


@pytest.fixture(autouse=True)
def in_playback(monkeypatch):
    """Live writes as it does while a window plays."""
    monkeypatch.setattr(events, "is_playing", lambda: True)


def open_body(subdivided: bool = False):
    body = real_character.open_character("cmu_131_03_hop")
    body.dynamorph.model.material_model = "STVK"
    if subdivided:
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.ops.mesh.select_all(action="SELECT")
        bpy.ops.mesh.subdivide()
        bpy.ops.object.mode_set(mode="OBJECT")
    return body


class TimedScene:
    """A scene that knows how long Blender evaluated it."""

    def __init__(self, scene, seconds: list[float]):
        self._scene, self._seconds = scene, seconds

    def __getattr__(self, name):
        return getattr(self._scene, name)

    def frame_set(self, *frame, **subframe):
        began = time.perf_counter()
        self._scene.frame_set(*frame, **subframe)
        self._seconds.append(time.perf_counter() - began)


@pytest.fixture
def pose_evaluation(monkeypatch) -> list[float]:
    """Seconds of every frame_set of the scenes that `extract` samples the rig in."""
    seconds: list[float] = []
    opened = sampling_scene.SamplingScene.opened

    @contextmanager
    def timed(*content):
        with opened(*content) as (scene, follower):
            yield TimedScene(scene, seconds), follower

    monkeypatch.setattr(sampling_scene.SamplingScene, "opened", timed)
    return seconds


def test_meshing(benchmark):
    """Cage, tetrahedra and embedding."""
    character = extract.character(open_body())
    surface = character.vertices @ character.to_bind.T
    settings = character.settings

    def mesh():
        made = dynamorph.mesh_body(
            surface,
            character.triangles,
            settings.cage_nodes,
            bones=character.bone_segments,
            pin_radius=settings.pin_radius,
        )[2]
        return made, dynamorph.embed(made, surface)

    mesh, _ = benchmark.pedantic(mesh, rounds=3)
    benchmark.extra_info.update(vertices=len(surface), nodes=len(mesh.nodes))


@pytest.mark.parametrize(("frames", "subdivided"), [(63, False), (125, False), (250, False), (500, False), (250, True)])
def test_bake(benchmark, pose_evaluation, frames, subdivided):
    """A bake whose model is up to date."""
    body = open_body(subdivided)
    build = job.Job(body, goal="BUILD", rebuild=True)
    batch.run(build)
    runs = []

    def bake():
        pose_evaluation.clear()
        began = time.perf_counter()
        job = Job(body, goal="BAKE", frames=(1, frames), substeps=SUBSTEPS)
        batch.run(job)
        total = time.perf_counter() - began
        evaluated, engine = sum(pose_evaluation), job.outcome.report["engine_seconds"]
        stages = {
            "pose evaluation": evaluated,
            "read the rig": job.progress.seconds["sample rig"] - sum(pose_evaluation[1:]),  # one places the character
            "engine": engine,
            "simulate, but for the engine": job.progress.seconds["simulate"] - engine,
            "write keys": job.progress.seconds["write keys"],
        }
        runs.append({"total": total, **stages, "extract": total - sum(stages.values())})

    benchmark.pedantic(bake, rounds=ROUNDS, warmup_rounds=1)
    made = build.outcome.model.summary
    benchmark.extra_info.update(
        frames=frames,
        substeps=SUBSTEPS,
        bones=len(build.outcome.character.skeleton.names),
        vertices=len(build.outcome.character.vertices),
        **{name: getattr(made, name) for name in ("nodes", "dofs", "modes", "targets")},
        build=made.seconds,
        stages=min(runs, key=lambda run: run["total"] - run["pose evaluation"]),
    )


@pytest.fixture
def live_body():
    """The character with Live on, at the first frame."""
    body = open_body()
    body.dynamorph.simulation.substeps = SUBSTEPS
    batch.run(job.Job(body, goal="BUILD", rebuild=True))
    bpy.context.scene.frame_set(1)
    live.turn_on(body, bpy.context.scene)
    return body


def next_frame():
    scene = bpy.context.scene
    scene.frame_set(scene.frame_current + 1)


def test_live(benchmark, live_body):
    """Our share of a frame that is simulated while it plays, with the rig's sub-frames; `whole` has Blender's too."""
    scene, plays = bpy.context.scene, bpy.app.handlers.frame_change_pre
    follows = live.HANDLERS["frame_change_pre"]
    plays.remove(follows)
    benchmark.pedantic(lambda: live.follow(live_body, scene), setup=next_frame, rounds=200)
    without = fastest_frames(100)
    plays.append(follows)
    scene.frame_set(1)
    assert not live.problem(live_body)
    benchmark.extra_info.update(whole=fastest_frames(100), without=without)


def test_live_with_many_keys(benchmark, live_body):
    """What Live adds to a frame where Blender copies the shape keys as soon as one of them is written."""
    for number in range(DRIVEN_KEYS):
        block = live_body.shape_key_add(name=f"driven {number}", from_mix=False)
        block.driver_add("value").driver.expression = f"0.001 * frame + {number}"
    plays, follows = bpy.app.handlers.frame_change_pre, live.HANDLERS["frame_change_pre"]
    plays.remove(follows)
    without = fastest_frames(100)
    plays.append(follows)
    bpy.context.scene.frame_set(1)
    assert not live.problem(live_body)
    benchmark.pedantic(next_frame, rounds=200)
    benchmark.extra_info.update(whole=fastest_frames(100), without=without)


def fastest_frames(count: int) -> float:
    """Seconds that Blender takes for the next frame, on average over the fastest of some runs of them."""
    began = []
    for _ in range(ROUNDS):
        bpy.context.scene.frame_set(1)
        began.append(time.perf_counter())
        for _ in range(count):
            next_frame()
        began[-1] = time.perf_counter() - began[-1]
    return min(began) / count


def test_live_change(benchmark, live_body):
    """From another stiffness to the frame that moves with it, Blender's evaluation and all."""
    target = live_body.dynamorph.targets[0]

    def change():
        next_frame()
        target.stiffness *= 1.01

    benchmark.pedantic(next_frame, setup=change, rounds=50)
    assert not live.problem(live_body)
