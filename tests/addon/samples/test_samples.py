# SPDX-License-Identifier: GPL-3.0-or-later
"""The sample scenes: what their descriptions say is true in every Blender, and the script that wrote them still writes
the same.
"""

import re
import subprocess
import sys
from pathlib import Path

import bmesh
import bpy
import measures
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion
from bl_ext.user_default.dynamic_morph_targets.scene.skin import soft_skins
from bl_ext.user_default.dynamic_morph_targets.write.authoring import setups
from builders import warnings_of
from PIL import Image

SAMPLES = Path(__file__).parents[3] / "sample_blends"
SCENE = SAMPLES / "bulging_cylinder.blend"
SCENES = sorted(path.stem for path in SAMPLES.glob("*.blend"))
THESIS = {"bulging_cylinder", "herbert", "shoulder"}  # held by the bones, as in the thesis; others as buttons set it
BENDS = {"Neutral": 0.0, "Half bend": 50.0, "Flexed": 100.0, "Back bend": -34.0}  # degrees, of the whole elbow


@pytest.fixture
def limb(scene):
    return open_limb(SCENE)


def open_limb(path):
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return bpy.data.objects["Limb"]


@pytest.mark.parametrize("name", SCENES)
def test_opens_without_an_error(scene, capfd, name):
    """Such as Blender's dependency graph prints."""
    capfd.readouterr()
    bpy.ops.wm.open_mainfile(filepath=str(SAMPLES / f"{name}.blend"))
    bpy.context.scene.frame_set(2)
    assert capfd.readouterr().err == ""


def test_the_demo_bakes_and_draws(tmp_path):
    """`make demo`, a newcomer's first command, in a process of its own as there."""
    command = [sys.executable, SAMPLES / "demo.py", "--draft", "--out", tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "bulging_cylinder.png", "bulging_cylinder.webp", "bulging_cylinder_baked.blend",
    ]  # fmt: skip
    assert "160 frames" in done.stdout
    relaxed, flexed, single = map(float, re.findall(r"([\d.]+) mm", done.stdout.split("In short")[1]))
    assert flexed < relaxed / 5 and abs(single - relaxed) < relaxed / 5
    with Image.open(tmp_path / "bulging_cylinder.webp") as loop:
        assert loop.n_frames > 30


def volume(limb):
    mesh = bmesh.new()
    mesh.from_object(limb, bpy.context.evaluated_depsgraph_get())
    try:
        return mesh.calc_volume()
    finally:
        mesh.free()


def test_is_a_ready_scene(limb):
    scene = bpy.context.scene
    assert SCENE.stat().st_size < 400_000
    assert scene.camera and (scene.frame_start, scene.frame_end, scene.render.fps) == (1, 160, 24)
    assert "CC0" in bpy.data.texts["LICENCE"].as_string()
    assert "Flexed" in bpy.data.texts["README"].as_string()
    assert 2000 <= len(limb.data.vertices) <= 4000
    assert all(polygon.use_smooth for polygon in limb.data.polygons)
    assert warnings_of(limb) == []


def test_mesh_is_closed_and_skinned_smoothly(limb):
    mesh = bmesh.new()
    mesh.from_mesh(limb.data)
    assert all(edge.is_manifold for edge in mesh.edges)
    weights = extract.character(limb).weights
    jumps = [np.abs(weights[edge.verts[0].index] - weights[edge.verts[1].index]).max() for edge in mesh.edges]
    mesh.free()
    assert max(jumps) < 0.2


def test_targets_have_their_poses_and_materials(limb):
    targets = extract.character(limb).targets
    assert [target.name for target in targets] == list(BENDS)
    for target in targets:
        bend = np.degrees(np.arctan2(target.local[2:, 2, 1], target.local[2:, 2, 2])).sum()
        assert bend == pytest.approx(BENDS[target.name], abs=0.01)
        assert np.allclose(target.local[:2], np.eye(4), atol=1e-6)
        assert target.bones == (() if target.name == "Neutral" else ("Bone 3", "Bone 4"))
    stiffness = {target.name: target.material.stiffness for target in targets}
    assert stiffness["Flexed"] >= 4 * stiffness["Neutral"]
    assert min(stiffness.values()) == stiffness["Neutral"]


def test_sculpted_shapes_are_sane(limb):
    character = extract.character(limb)
    held = character.firmness == 1
    assert held.any()
    for target in character.targets[1:]:
        size = np.linalg.norm(target.shape, axis=1)
        assert 0.005 < size.max() < 0.05
        assert size[held].max() < 0.001


def test_flexed_shape_regains_the_volume_that_skinning_loses(limb):
    scene = bpy.context.scene
    scene.frame_set(1)
    straight = volume(limb)
    scene.frame_set(44)
    bent = volume(limb)
    limb.data.shape_keys.key_blocks["Flexed"].value = 1.0
    assert bent < 0.99 * straight < straight < volume(limb)


def test_soft_when_straight_and_hard_when_flexed(limb):
    pytest.importorskip("dynamorph", reason="needs the engine")
    job = Job(limb, goal="BAKE")
    batch.run(job)
    assert job.warnings == []
    assert job.outcome.model.summary.dofs == pytest.approx(918, rel=0.02)
    assert job.outcome.model.summary.modes == 13

    def swing(first, last):
        shapes = np.array([target.shape for target in job.outcome.character.targets])
        frames = range(first - 1, last)
        apart = [
            job.outcome.bake.displacement(k) - np.tensordot(job.outcome.bake.weights[k], shapes, 1) for k in frames
        ]
        return np.linalg.norm(apart, axis=2).max()

    pushed, shaken = swing(114, 124), swing(136, 150)
    assert 0.01 < pushed < shaken
    assert swing(46, 56) < 0.25 * pushed
    assert swing(66, 80) < 0.25 * shaken


def test_the_push_acts_with_the_same_force_when_flexed_and_when_straight(limb):
    character = extract.character(limb)
    samples = rig_motion.sample_rig(limb, 1, 160, 1)
    (field,) = samples.fields
    assert field.strength[46 - 1 :][:20] == pytest.approx(field.strength[114 - 1 :][:20], abs=0.1)
    reached = [pushed_vertices(character, samples, frame).sum() for frame in (55, 123)]
    assert reached[0] == pytest.approx(reached[1], rel=0.1)


def pushed_vertices(character, samples, frame):
    """Which vertices (V,) the field reaches at a frame."""
    matrices = samples.skin_matrices(character.skeleton, character.to_bind)[frame - 1]
    shape = character.targets[2].shape if frame < 86 else 0
    points = measures.posed(character.vertices + shape, character.weights, matrices)
    return samples.fields[0].pull(frame - 1, points).any(axis=1)


def test_script_reproduces_the_file(limb, tmp_path):
    script = [sys.executable, str(SAMPLES / "make_samples.py"), str(tmp_path), SCENE.stem]
    subprocess.run(script, check=True, stdout=subprocess.DEVNULL, timeout=120)
    stored, settings = content(limb), limb.dynamorph.model.settings()
    limb = open_limb(tmp_path / SCENE.name)
    made = content(limb)
    assert limb.dynamorph.model.settings() == settings
    assert stored.keys() == made.keys()
    for name in stored:
        assert np.allclose(stored[name], made[name], atol=1e-6), name


@pytest.mark.parametrize("name", SCENES)
def test_the_file_has_every_setting_of_its_script(scene, tmp_path, name):
    """A property that was renamed since the file was written would have its default there, without a word."""
    script = [sys.executable, str(SAMPLES / "make_samples.py"), str(tmp_path), name]
    subprocess.run(script, check=True, stdout=subprocess.DEVNULL, timeout=120)
    stored, made = (authored(folder / f"{name}.blend") for folder in (SAMPLES, tmp_path))
    assert stored == made
    # Neither of the first is what buttons set.
    expected = ("BONES", "MODES", "REDUCED") if name in THESIS else ("THICKNESS", "RESPONSES", "FULL")
    assert tuple(stored["model"][setting] for setting in ("hold", "basis", "solver")) == expected


def authored(path) -> dict:
    """All settings of the soft skin in a file, without poses, whose last digits depend on the machine."""
    bpy.ops.wm.open_mainfile(filepath=str(path))
    (skin,) = soft_skins(bpy.data.objects)
    setup = setups.of_object(skin)
    for target in setup["targets"]:
        del target["pose"], target["rig_world"]
    return setup


def content(limb):
    """What matters of the scene as arrays: mesh, keys, weights, targets and the rig's motion."""
    character = extract.character(limb)
    content = {name: getattr(character, name) for name in ("vertices", "triangles", "weights", "firmness")}
    for target in character.targets:
        material = target.material
        content[f"shape {target.name}"] = target.shape
        content[f"pose {target.name}"] = target.local
        content[f"material {target.name}"] = [material.stiffness, material.mass_damping, material.stiffness_damping]
    samples = rig_motion.sample_rig(limb, 1, 160, 1)
    (field,) = samples.fields
    motion = {"motion": samples.pose, "rig": samples.rig_world, "push": field.strength, "from": field.world}
    return content | motion
