# SPDX-License-Identifier: GPL-3.0-or-later
"""A rigged, animated body made by others, headless from end to end: built, baked, compared and rendered."""

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
import real_character
from bl_ext.user_default.dynamic_morph_targets.core.model import build
from bl_ext.user_default.dynamic_morph_targets.core.motion import simulate
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.write.bake import writer
from builders import evaluated_points
from mathutils import Vector

ROOT = Path(__file__).parents[3]
PICTURE = ROOT / "build" / "reports" / f"real_character_{bpy.app.version[0]}.{bpy.app.version[1]}.png"
CLIP, LAST = "gen_jump", 45
PICTURED = {8: "crouched", 14: "in the air", 24: "landing", 33: "bounced"}

pytestmark = pytest.mark.skipif(
    not real_character.CHARACTER.exists(), reason="needs ../shared/assets/mh_male_53bones.blend"
)


@pytest.fixture(scope="module")
def baked(addon):
    """The body with its bake, and the job that made it."""
    body = real_character.open_character(CLIP)
    job = Job(body, goal="BAKE", frames=(1, LAST), substeps=4)
    batch.run(job)
    return body, job


@pytest.fixture(scope="module")
def single(baked):
    """The same shot with the neutral target alone."""
    _, job = baked
    character = job.outcome.character.with_settings(method="SINGLE")
    return simulate.bake(build.build(character), character, job.computation.rig, job.input.settings)[0]


def displacements(bake):
    return np.array([bake.displacement(k) for k in range(len(bake.frames))])


def height(job):
    return np.ptp(job.outcome.character.vertices[:, 2])


def test_targets_are_the_file_s_driven_keys(baked):
    body, job = baked
    driven = {curve.data_path.split('"')[1] for curve in body.data.shape_keys.animation_data.drivers}
    targets = job.outcome.character.targets[1:]
    assert len(targets) >= 3
    assert {target.name for target in targets} <= driven
    stiffness = [target.material.stiffness for target in job.outcome.character.targets]
    assert max(stiffness) >= 4 * min(stiffness)


def test_tissue_moves_and_knows_its_pose(baked, single):
    _, job = baked
    moved = displacements(job.outcome.bake)
    assert np.isfinite(moved).all()
    weights = job.outcome.bake.weights
    assert weights[:, 1:3].max() > 0.4  # both knees bend at the same time, and each has its own target
    assert np.allclose(weights.sum(axis=1), 1.0)
    peak = np.linalg.norm(moved, axis=2).max()
    assert 0.01 * height(job) < peak < 0.1 * height(job)
    apart = np.linalg.norm(moved - displacements(single), axis=2).max()
    assert apart > 0.01 * height(job)
    held = job.outcome.character.firmness == 1  # head, hands and feet
    assert np.abs(moved[:, held]).max() < 0.02 * height(job)


def test_blender_shows_what_the_engine_computed(baked):
    body, job = baked
    deviations = []
    for frame in (1, 14, 24, LAST):
        bpy.context.scene.frame_set(frame)
        sample = job.computation.rig[(frame - 1) * 4 : (frame - 1) * 4 + 1]
        skin = sample.skin_matrices(job.outcome.character.skeleton, job.outcome.character.to_bind)[0]
        local = job.outcome.character.vertices + job.outcome.bake.displacement(frame - 1)
        blended = np.einsum("vb,bij->vij", job.outcome.character.weights, skin)
        bind = local @ job.outcome.character.to_bind.T
        world = np.einsum("vij,vj->vi", blended[:, :, :3], bind) + blended[:, :, 3]
        deviations.append(np.abs(evaluated_points(body) - world).max())
    assert max(deviations) < 1e-5 * height(job)


def test_a_target_s_pose_shows_the_sculpted_shape(baked):
    """Held at the pose of a target, the body rests in the shape of its key, to 1e-6 of its size, with or without
    gravity.
    """
    _, job = baked
    targets = job.outcome.character.targets
    pose = job.outcome.character.skeleton.pose(np.array([targets[1].local]))
    rig = replace(job.computation.rig[:1], pose=pose)
    assert any(job.input.settings.gravity)
    for gravity in (job.input.settings.gravity, (0.0, 0.0, 0.0)):
        settings = replace(job.input.settings, frame_start=1, frame_end=1, gravity=gravity)
        still, _ = simulate.bake(job.outcome.model, job.outcome.character, rig, settings)
        assert still.weights[0] == pytest.approx(np.eye(len(targets))[1], abs=1e-9)
        assert np.abs(still.displacement(0) - targets[1].shape).max() < 1e-6 * height(job)


def test_picture(baked, single):
    """Plain skinning, single material and dynamic morph targets, at the same frames: build/reports/."""
    pytest.importorskip("PIL", reason="needs Pillow")
    from contact_sheet import Row, compose, save

    body, job = baked
    _keep_outside(bpy.data.objects["Swimsuit"], body)
    bake = writer
    rows = [Row("Dynamic morph targets", "", _pictures(), [""] * len(PICTURED))]
    bake.write_keys(body, single)
    rows.insert(0, Row("Single material", "", _pictures(), [""] * len(PICTURED)))
    bake.free(body)
    rows.insert(0, Row("Plain skinning", "", _pictures(), [""] * len(PICTURED)))
    bake.write_keys(body, job.outcome.bake)
    columns = [f"{frame}: {event}" for frame, event in PICTURED.items()]
    save(
        compose("MakeHuman body", f"{CLIP}, the file's own clip and shape keys", columns, rows),
        PICTURE,
    )
    pixels = [np.asarray(row.pictures[2], float) for row in rows]
    assert pixels[0].std() > 5  # the picture is not empty
    assert np.abs(pixels[0] - pixels[2]).mean() > 0.1  # and the body moves


def _keep_outside(clothes, body):
    """Clothes that are not simulated are pushed out of the body under them, as an artist would do."""
    wrap = clothes.modifiers.new("Outside", "SHRINKWRAP")
    wrap.target, wrap.wrap_mode, wrap.offset = body, "OUTSIDE_SURFACE", 0.006


def _pictures():
    from contact_sheet import render

    scene, rig = bpy.context.scene, bpy.data.objects["Rig"]
    scene.world = scene.world or bpy.data.worlds.new("World")
    scene.world.color = (0.25, 0.28, 0.32)
    offset = Vector((1.9, -2.8, 0.35))
    pictures = []
    for frame in PICTURED:
        scene.frame_set(frame)
        scene.camera.location = rig.matrix_world @ rig.pose.bones["pelvis"].head + offset
        scene.camera.rotation_euler = (-offset).to_track_quat("-Z", "Y").to_euler()
        scene.camera.data.lens = 50
        pictures += render([frame], (240, 330), "BLENDER_WORKBENCH")
    return pictures
