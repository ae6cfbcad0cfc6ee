# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes that are killed and resume in another process with the same bytes; models that processes share."""

import importlib
import json
import os
import random
import subprocess
import sys
import threading
import time
from pathlib import Path

import bpy
import pytest
from builders import make_arm, make_soft

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

ROOT = Path(__file__).parents[3]
KILLS = int(os.environ.get("DYNAMORPH_KILLS", "3"))
FRAMES = 3000


@pytest.fixture
def shot(scene, tmp_path):
    """A saved file with a soft skin, and a folder to share."""
    obj = make_soft(make_arm(scene))
    obj.dynamorph.model.cage_nodes, obj.dynamorph.model.modes = 300, 6
    path = tmp_path / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def environment():
    """The environment variables of a process that runs the add-on's command line."""
    paths = os.pathsep.join(filter(None, [str(ROOT / "addon"), os.environ.get("PYTHONPATH")]))
    return os.environ | {"PYTHONPATH": paths}


def baking(shot, report, *more):
    """A process that bakes the shot."""
    arguments = "bake", shot, "--object", "Arm", "--frames", 1, FRAMES, "-o", report.with_suffix(".blend"), *more
    return subprocess.Popen(
        [sys.executable, "-m", "dynamic_morph_targets", *map(str, arguments), "--report", report],
        stdout=subprocess.DEVNULL, env=environment(),
    )  # fmt: skip


def baked(process, report):
    """The report of a process's bake, after it has ended."""
    with process:
        assert process.wait() == 0
    return json.loads(report.read_text())["characters"][0]["bake"]


def kept_at(caches):
    """The time at which the state of an unfinished bake was last stored."""
    return [path.stat().st_mtime_ns for path in caches.glob("*.unfinished")]


def killed(shot, report, caches, moments):
    """Resumes a bake until its state is stored, and kills it at a random moment after that; False if it finished
    before.
    """
    before = kept_at(caches)
    with baking(shot, report, "--cache-dir", caches) as process:
        while process.poll() is None and kept_at(caches) == before:
            time.sleep(0.01)
        time.sleep(moments.uniform(0.0, 0.1))
        process.kill()
        return process.wait() != 0


@pytest.mark.fault("B03", "C01")
def test_killed_at_any_moment_nothing_is_lost(shot, tmp_path):
    """The bake is killed with kill -9 at random moments, as often as DYNAMORPH_KILLS says; then it finishes with the
    bytes of an undisturbed bake.
    """
    whole, caches = tmp_path / "whole.json", tmp_path / "caches"
    undisturbed = baked(baking(shot, whole), whole)
    done, moments, kills = tmp_path / "done.json", random.Random(1), 0
    while kills < KILLS and killed(shot, done, caches, moments):
        kills += 1
    assert kills > 0
    found = baked(baking(shot, done, "--cache-dir", caches), done)
    assert found["hash"] == undisturbed["hash"]
    assert found["steps"] == undisturbed["steps"]
    assert not list(caches.glob("*.unfinished"))  # it is saved now
    assert len(list(caches.glob("*.dynamorph"))) == 1


@pytest.mark.parametrize("given", [0, 3])
def test_without_threads_it_says_to_try_again(monkeypatch, capsys, given):
    """Blender would end the process while it is loaded."""
    command = importlib.import_module("dynamic_morph_targets.__main__")
    start, started = threading.Thread.start, []

    def limited(thread):
        if len(started) == given:
            raise RuntimeError("can't start new thread")
        started.append(thread)
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", limited)
    assert command.run() == 75 and "no more threads or processes" in capsys.readouterr().err
    assert not any(thread.is_alive() for thread in started)
