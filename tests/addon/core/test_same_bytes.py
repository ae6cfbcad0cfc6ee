# SPDX-License-Identifier: GPL-3.0-or-later
"""A build and a bake make the same bytes in every process of a machine, whatever the number of threads."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import bpy
import pytest
from builders import make_arm, make_soft

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

ROOT = Path(__file__).parents[3]
CORES = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
SOLVERS = {"Reduced": "REDUCED", "Full": "FULL"}  # by the name of a mesh


@pytest.fixture
def shot(scene, tmp_path):
    """A saved file with a reduced and an unreduced soft skin."""
    for name, solver in SOLVERS.items():
        obj = make_soft(make_arm(scene, name))
        obj.dynamorph.model.solver, obj.dynamorph.model.cage_nodes, obj.dynamorph.model.modes = solver, 200, 8
    path = tmp_path / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def hashes(shot, cores, numpy_threads=None) -> dict[str, tuple[str, str]]:
    """The hashes of the model and the bake of each character, made by a process that may use these cores.

    numpy_threads: those of a NumPy that is there before the command, as in `blender -b`; None: the command chooses.
    """
    report = shot.with_suffix(".json")
    run = "runpy.run_module('dynamic_morph_targets', run_name='__main__')"
    blas = {"OPENBLAS_NUM_THREADS": str(numpy_threads)} if numpy_threads else {}
    command = f"import os, runpy; os.sched_setaffinity(0, {cores}); {'import numpy; ' * bool(blas)}{run}"
    paths = os.pathsep.join(filter(None, [str(ROOT / "addon"), os.environ.get("PYTHONPATH")]))
    subprocess.run(
        [sys.executable, "-c", command, "bake", shot, "--all", "-o", shot.with_name("baked.blend"),
         "--report", report],
        env=os.environ | {"PYTHONPATH": paths} | blas, check=True, stdout=subprocess.DEVNULL,
    )  # fmt: skip
    characters = json.loads(report.read_text())["characters"]
    report.unlink()
    return {made["name"]: (made["model"], made["bake"]["hash"]) for made in characters}


@pytest.mark.fault("S02")
@pytest.mark.skipif(len(CORES) < 2, reason="one core, or a system that does not pin processes")
def test_builds_and_bakes_make_the_same_bytes(shot):
    alone = hashes(shot, CORES[:1])
    assert alone.keys() == SOLVERS.keys() and all(alone["Reduced"]) and alone["Reduced"] != alone["Full"]
    assert hashes(shot, CORES[:2]) == alone
    assert hashes(shot, CORES[:2]) == alone
    stored = shot.with_name("stored.blend")
    shot.with_name("baked.blend").rename(stored)
    assert hashes(stored, CORES[:1]) == alone  # from the models that are there


def test_threads_of_numpy_make_no_difference(tmp_path):
    """In `blender -b` NumPy is loaded before the command, which cannot choose how many threads it has any more."""
    shot = tmp_path / "shot.blend"
    shutil.copy(ROOT / "sample_blends" / "shoulder.blend", shot)
    found = [hashes(shot, CORES, threads) for threads in (1, 4)]
    assert found[0] == found[1] and all(all(each) for each in found[0].values())
