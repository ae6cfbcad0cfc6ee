# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of earlier versions, in tests/golden, with the model and the bake that they wrote.

arm_COMMIT.blend holds the arm of builders.make_arm with 8 modes in a cage of 200 nodes, baked over frames 1 to 20.
golden/author.py, which wrote them, says what other files each version has.
"""

import json
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
from builders import activate, evaluated_points
from robustness import bake

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
FOLDER = Path(__file__).parents[1] / "golden"
GOLDEN = sorted(FOLDER.glob("arm_*.blend"))
VERSIONS = [path.stem.removeprefix("arm_") for path in GOLDEN]
sys.path.append(str(FOLDER))

import author  # noqa: E402


@pytest.fixture(params=GOLDEN, ids=lambda path: path.stem)
def old_arm(scene, request):
    bpy.ops.wm.open_mainfile(filepath=str(request.param))
    return bpy.data.objects["Arm"]


def played(obj) -> np.ndarray:
    """The surface (20, V, 3) in frames 1 to 20, as Blender evaluates it."""
    scene, points = bpy.context.scene, []
    for frame in range(1, 21):
        scene.frame_set(frame)
        points.append(evaluated_points(obj))
    return np.array(points)


def test_there_are_old_files():
    assert len(GOLDEN) > 1


def assert_says(now, then, place="dynamorph"):
    """Check that all values of a property group are as recorded; there may be more."""
    if isinstance(then, dict):
        for name, value in then.items():
            assert_says(now[name], value, f"{place}.{name}")
    elif isinstance(then, list):
        assert len(now) == len(then), place
        for index, (mine, theirs) in enumerate(zip(now, then, strict=True)):
            assert_says(mine, theirs, f"{place}[{index}]")
    elif isinstance(then, float):
        assert now == pytest.approx(then, rel=1e-6, abs=1e-9), place
    else:
        assert now == then, place


@pytest.fixture(params=VERSIONS)
def version(scene, request):
    return request.param


def written(version: str) -> dict:
    return json.loads((FOLDER / f"authored_{version}.json").read_text())


def test_what_was_keyed_and_driven_still_is(version):
    bpy.ops.wm.open_mainfile(filepath=str(FOLDER / f"authored_{version}.blend"))
    obj = bpy.data.objects["Arm"]
    then = written(version)["local"]
    assert_says(author.at_frames(obj), then)
    path, (_, last) = next(iter(author.KEYED.items()))
    assert then["20"]["targets"][1]["influence"] == last
    bpy.context.scene.frame_set(20)
    assert obj.path_resolve(path) == last
    bpy.context.scene.frame_set(1)
    before = played(obj)
    bpy.context.scene.frame_set(1)
    assert not bake(obj).reasons
    assert np.abs(played(obj) - before).max() < 1e-6 * np.linalg.norm(np.ptp(before[0], axis=0))


def test_what_was_linked_and_overridden_still_is(version):
    """The override has its own settings, and plays like the arm that it overrides."""
    bpy.ops.wm.open_mainfile(filepath=str(FOLDER / f"shot_{version}.blend"))
    then = written(version)
    override = bpy.data.objects["Arm Override"]
    linked = next(obj for obj in bpy.data.objects if obj.library and obj.type == "MESH")
    assert_says(author.at_frames(linked), then["linked"])
    assert_says(author.at_frames(override), then["override"])
    assert override.dynamorph.model.cage_nodes == author.OVERRIDDEN["model.cage_nodes"]
    assert linked.dynamorph.model.cage_nodes == 200
    surface = played(linked)
    assert np.abs(surface - surface[0]).max() > 0.05 * np.linalg.norm(np.ptp(surface[0], axis=0))
    np.testing.assert_allclose(played(override), surface, atol=1e-6)


def test_an_old_setup_and_old_presets_load(version, tmp_path):
    """It is applied to an arm without targets: saved again, the setup says the same."""
    bpy.ops.wm.open_mainfile(filepath=str(FOLDER / f"arm_{version}.blend"))
    obj = bpy.data.objects["Arm"]
    before = author.said(obj.dynamorph)
    bpy.context.view_layer.objects.active = obj
    bpy.ops.dynamorph.remove_target()  # 'flexed', which is the active one
    assert len(obj.dynamorph.targets) == 1
    bpy.ops.dynamorph.load_setup(filepath=str(FOLDER / f"setup_{version}.json"))
    bpy.ops.dynamorph.save_setup(filepath=str(tmp_path / "again.json"))
    again, then = (json.loads(path.read_text()) for path in (tmp_path / "again.json", FOLDER / f"setup_{version}.json"))
    assert again.pop("version") >= then.pop("version")
    assert_says(again, then, "setup")
    target = obj.dynamorph.active_target
    target.density, obj.dynamorph.simulation.substeps = 1.0, 9
    for kind in ("material", "setup"):
        preset = str(FOLDER / f"{kind}_{version}.py")
        bpy.ops.dynamorph.load_preset(filepath=preset, menu_idname=f"DYNAMORPH_PT_{kind}_presets")
    assert target.density == pytest.approx(before["targets"][1]["density"])
    assert obj.dynamorph.simulation.substeps == before["simulation"]["substeps"]


def test_old_presets_give_a_new_soft_skin_the_modes_that_they_meant(version, arm):
    activate(arm)
    bpy.ops.dynamorph.add_soft_skin()
    model = arm.dynamorph.model
    for kind, expected in (("material", ("RESPONSES", 120)), ("setup", ("MODES", 8))):
        preset = str(FOLDER / f"{kind}_{version}.py")
        bpy.ops.dynamorph.load_preset(filepath=preset, menu_idname=f"DYNAMORPH_PT_{kind}_presets")
        assert (model.basis, model.modes) == expected


@pytest.mark.fault("F06", "V05")
def test_an_old_file_bakes_as_it_was_baked(old_arm):
    """It is baked with the stored model, not with a new one, and agrees to 1e-6 of the body's size."""
    before = played(old_arm)
    size = np.linalg.norm(np.ptp(before[0], axis=0))
    assert np.abs(before - before[0]).max() > 0.05 * size
    job = bake(old_arm)
    assert not job.reasons
    assert np.abs(played(old_arm) - before).max() < 1e-6 * size


def test_an_old_bake_goes_on(old_arm):
    """A part of it is baked again into the existing frames."""
    before = played(old_arm)
    size = np.linalg.norm(np.ptp(before[0], axis=0))
    simulation = old_arm.dynamorph.simulation
    simulation.use_scene_range, simulation.keep_outside = False, True
    simulation.start, simulation.end = 12, 20
    job = bake(old_arm)
    assert not job.reasons
    assert np.abs(played(old_arm) - before).max() < 1e-6 * size
