# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of earlier versions, with the model and the bake that they wrote: tests/golden/arm_COMMIT.blend.

Each holds the arm of builders.make_soft with 8 modes in a cage of 200 nodes, baked over frames 1 to 20.
"""

from pathlib import Path

import bpy
import numpy as np
import pytest
from builders import evaluated_points, part

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
GOLDEN = sorted((Path(__file__).parents[1] / "golden").glob("arm_*.blend"))


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


def run(obj):
    job = part("job").Job(obj, goal="BAKE")
    part("batch").run(job)
    return job


def test_there_are_old_files():
    assert GOLDEN


def test_an_old_file_bakes_as_it_was_baked(old_arm):
    """With the model that it holds, not with a new one; to 1e-6 of the body's size."""
    before = played(old_arm)
    size = np.linalg.norm(np.ptp(before[0], axis=0))
    assert np.abs(before - before[0]).max() > 0.05 * size
    job = run(old_arm)
    assert not job.reasons
    assert np.abs(played(old_arm) - before).max() < 1e-6 * size


def test_an_old_bake_goes_on(old_arm):
    """A part of it again, into the frames that there are."""
    before = played(old_arm)
    size = np.linalg.norm(np.ptp(before[0], axis=0))
    simulation = old_arm.dynamorph.simulation
    simulation.use_scene_range, simulation.keep_outside = False, True
    simulation.start, simulation.end = 12, 20
    job = run(old_arm)
    assert not job.reasons
    assert np.abs(played(old_arm) - before).max() < 1e-6 * size
