# SPDX-License-Identifier: GPL-3.0-or-later
"""A frame that motion capture has lost, and a cut that nobody marked, in the clips of characters made by others: the
limits hold the tissue back there, and leave the rest of the shot as it is.
"""

from dataclasses import replace

import bpy
import characters
import numpy as np
import pytest
import real_character
from bl_ext.user_default.dynamic_morph_targets.core.motion import simulate
from bl_ext.user_default.dynamic_morph_targets.core.result import judge
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
ASSETS = real_character.CHARACTER.parent
CLIPS = {"mh_male_53bones.blend": "cmu_131_01_walk", "zoo/Cow.glb": "Walk"}
FAR = 0.3  # of the body's size, by which all of it is displaced
SECONDS = 0.75  # of a swing that dies away after it


@pytest.fixture(scope="module", params=CLIPS)
def walk(addon, request):
    """The job that baked the character, with the defaults."""
    if not (ASSETS / request.param).exists():
        pytest.skip(f"needs ../shared/assets/{request.param}")
    characters.open_file(ASSETS / request.param)
    body = characters.largest_skinned()
    rig = characters.armature_of(body)
    (clip,) = [action for action in bpy.data.actions if action.name.split("|")[-1] == CLIPS[request.param]]
    characters.play(rig, clip)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = map(round, clip.frame_range)
    bpy.context.view_layer.objects.active = body
    bpy.ops.dynamorph.add_soft_skin()
    job = Job(body, goal="BAKE")
    batch.run(job)
    return job


def simulated(job, rig):
    """Offsets (F, 3V) from the targets' shapes, and the verdict."""
    model, character, settings = job.outcome.model, job.outcome.character, job.input.settings
    shot = simulate.Shot(model, character, settings)
    shot.play(rig)
    bake, _ = shot.bake()
    offsets = (bake.coordinates - bake.static) @ bake.modes.reshape(len(bake.modes), -1)
    return offsets, judge.judge(model, character, bake, settings, shot.held)


@pytest.mark.parametrize("kind", ["a lost frame", "a cut"])
def test_the_rest_of_the_shot_keeps_its_motion(walk, kind):
    settings, rig = walk.input.settings, walk.computation.rig
    frames = len(settings.frames)
    bad = frames // 2
    samples = np.arange(len(rig.rig_world)) - (len(rig.rig_world) - (frames - 1) * settings.substeps - 1)
    after = samples / settings.substeps - bad
    away = np.clip(1.0 + after, 0.0, 1.0) if kind == "a cut" else np.clip(1.0 - np.abs(after), 0.0, 1.0)
    size = np.linalg.norm(np.ptp(walk.outcome.character.vertices @ walk.outcome.character.to_bind.T, axis=0))
    moved = [world.copy() for world in (rig.rig_world, rig.object_world)]
    for world in moved:
        world[:, 0, 3] += FAR * size * away
    plain, _ = simulated(walk, rig)
    found, verdict = simulated(walk, replace(rig, rig_world=moved[0], object_world=moved[1]))
    numbers = np.arange(frames)
    elsewhere = (numbers < bad - 1) | (numbers > bad + SECONDS * settings.fps)
    plain, found = plain[elsewhere], found[elsewhere]
    assert (found * plain).sum() > 0.95 * (plain**2).sum()
    assert np.linalg.norm(found - plain) < 0.05 * np.linalg.norm(plain)
    first, last = verdict.held.frames
    assert first - 1 <= settings.frames[bad] <= last + 1
    assert verdict.held.excess > 5.0
