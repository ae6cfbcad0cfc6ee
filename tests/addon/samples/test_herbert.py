# SPDX-License-Identifier: GPL-3.0-or-later
"""The sample scene Herbert: what its description says is true in every Blender."""

import subprocess
import sys
from pathlib import Path

import bpy
import herbert_motion as motion
import herbert_skeleton as kinematics
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion
from builders import warnings_of

SAMPLES = Path(__file__).parents[3] / "sample_blends"
SCENE = SAMPLES / "herbert.blend"
WALL = 128  # first frame of the second shot
TAKE_OFF, ENTRY = (1 + round(t * motion.FPS) for t in (motion.TAKE_OFF, motion.ENTRY))
IMPACT = WALL + round(motion.IMPACT * motion.FPS)
TUCKED = [1 + round(t * motion.FPS) for t in motion.TUCKED]


@pytest.fixture
def herbert(scene):
    bpy.ops.wm.open_mainfile(filepath=str(SCENE))
    return bpy.data.objects["Herbert"]


def center_of_mass(herbert):
    """The path (F, 3) of his center of mass over the whole scene, armature space."""
    bones = herbert.modifiers["Armature"].object.data.bones
    rest = {bone.name: np.array([bone.head_local, bone.tail_local]).mean(axis=0) for bone in bones}
    character = extract.character(herbert)
    pose = rig_motion.sample_rig(herbert, 1, bpy.context.scene.frame_end, 1).pose
    skin = pose @ np.linalg.inv(character.skeleton.rest)
    names = character.skeleton.names
    middles = [skin[:, names.index(b), :3] @ [*rest[b], 1.0] for b in kinematics.MASSES]
    return np.tensordot(kinematics.SHARES, np.array(middles), 1)


def test_is_a_ready_scene(herbert):
    scene = bpy.context.scene
    assert SCENE.stat().st_size < 3_000_000
    assert (scene.frame_start, scene.frame_end, scene.render.fps) == (1, 218, 24)
    assert {m.name: m.frame for m in scene.timeline_markers} == {"Dive": 1, "Wall": WALL}
    assert {m.camera.name for m in scene.timeline_markers} == {"Dive camera", "Wall camera"}
    assert scene.camera.name == "Dive camera"
    assert "MakeHuman" in bpy.data.texts["LICENCE"].as_string()
    assert f"{WALL}-218  Wall" in bpy.data.texts["README"].as_string()
    assert len(bpy.data.objects["Rig"].data.bones) == 46
    assert 10_000 <= len(herbert.data.vertices) <= 15_000
    assert all(polygon.use_smooth for polygon in herbert.data.polygons)
    assert warnings_of(herbert) == []


def test_targets_go_from_flabby_upright_to_stiff_in_the_tuck(herbert):
    character = extract.character(herbert)
    targets = character.targets
    assert [target.name for target in targets] == ["Neutral", "Half tuck", "Tuck"]
    spine = [character.skeleton.names.index(name) for name in kinematics.SPINE]
    bends = [np.degrees(np.arctan2(t.local[spine, 2, 1], t.local[spine, 1, 1])).sum() for t in targets]
    assert bends[0] == pytest.approx(0, abs=0.1)
    assert 25 < abs(bends[1]) < 50 < 75 < abs(bends[2])
    assert [target.bones for target in targets] == [(), kinematics.SPINE, kinematics.SPINE]
    stiffness = [target.material.stiffness for target in targets]
    assert stiffness == sorted(stiffness)
    assert stiffness[2] >= 8 * stiffness[0]


def test_tuck_bulges_only_what_is_soft(herbert):
    character = extract.character(herbert)
    tuck = np.linalg.norm(character.targets[2].shape, axis=1)
    assert 0.05 < tuck.max() < 0.25
    assert tuck[character.firmness == 1].max() < 0.001
    for bone in ("head", "hand_l", "foot_r"):
        column = character.weights[:, character.skeleton.names.index(bone)]
        assert character.firmness[column > 0.5].min() == 1


def test_flight_is_ballistic(herbert):
    path = center_of_mass(herbert)[TAKE_OFF - 1 : ENTRY]
    assert np.allclose(np.diff(path, 2, axis=0) * motion.FPS**2, [0, 0, -motion.GRAVITY], atol=0.05)


def test_wall_stops_him_within_a_frame(herbert):
    speed = -np.diff(center_of_mass(herbert)[:, 1]) * motion.FPS
    before, after = speed[IMPACT - 2], speed[IMPACT - 1]
    assert before == pytest.approx(motion.SPEED, abs=0.05)
    assert after == pytest.approx(0, abs=0.05)


def test_belly_swings_upright_and_holds_in_the_tuck(herbert):
    """By itself: what the thighs push is in test_claims.py."""
    pytest.importorskip("dynamorph", reason="needs the engine")
    herbert.dynamorph.collision.use = False
    job = Job(herbert, goal="BAKE")
    batch.run(job)
    assert job.outcome.model.summary.modes == 12
    assert job.outcome.model.summary.dofs == pytest.approx(603, rel=0.1)
    assert job.outcome.report["inverted"] <= 10
    assert not any("converge" in warning for warning in job.warnings)

    character, bake = job.outcome.character, job.outcome.bake
    shapes = np.array([target.shape for target in character.targets])
    belly = np.argsort(character.targets[2].shape[:, 1])[:200]  # bulges most to the front
    apart = np.array([bake.displacement(k)[belly] for k in range(len(bake.frames))])
    apart -= np.tensordot(bake.weights, shapes[:, belly], 1)
    swing = np.linalg.norm(apart, axis=2).mean(axis=1)

    def largest(first, last):
        return swing[first - 1 : last].max()

    assert np.isfinite(swing).all()
    assert 0.03 < largest(61, 68) < 0.3  # the landing on the board
    assert 0.06 < largest(IMPACT, IMPACT + 8) < 0.3
    assert largest(TUCKED[0] + 1, TUCKED[1]) < 0.15 * largest(IMPACT, IMPACT + 8)
    assert bake.weights[TUCKED[0], 2] == pytest.approx(1, abs=1e-3)


def test_script_reproduces_the_file(herbert, tmp_path):
    pytest.importorskip("dynamorph", reason="needs the engine")
    if not (SAMPLES.parent / "build" / "makehuman").is_dir():
        pytest.skip("needs MakeHuman's data: make it once with make_samples.py")
    script = [sys.executable, str(SAMPLES / "make_samples.py"), str(tmp_path), "herbert"]
    subprocess.run(script, check=True, stdout=subprocess.DEVNULL, timeout=120)
    stored, path = extract.character(herbert), center_of_mass(herbert)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / SCENE.name))
    made = extract.character(bpy.data.objects["Herbert"])
    assert np.allclose(stored.vertices, made.vertices, atol=1e-6)
    assert np.allclose(stored.weights, made.weights, atol=1e-6)
    assert np.allclose([t.shape for t in stored.targets], [t.shape for t in made.targets], atol=1e-6)
    assert np.allclose(path, center_of_mass(bpy.data.objects["Herbert"]), atol=1e-5)
