# SPDX-License-Identifier: GPL-3.0-or-later
"""A short random walk over all buttons; and that a walk can be repeated and sees what is wrong."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

SOAK = Path(__file__).parents[1] / "soak.py"


def walk(log, *arguments):
    """Runs a walk: what it says, and its steps without the places of temporary files and the memory."""
    run = subprocess.run(
        [sys.executable, SOAK, "--log", log, *map(str, arguments)], capture_output=True, text=True, check=False
    )
    steps = [line for line in log.read_text(errors="replace").splitlines() if re.match(r" *\d+  ", line)]
    return run, [re.sub(r"/tmp/\S+?/|file: .*", "", line) for line in steps]


@pytest.mark.fault("S01")
def test_a_walk_finds_nothing_wrong(tmp_path):
    run, steps = walk(tmp_path / "log.txt", "--minutes", 20 / 60, "--seed", 1)
    assert run.returncode == 0, run.stdout + run.stderr + "\n".join(steps[-20:])


def test_a_walk_can_be_repeated(tmp_path):
    (first, steps), (_, again) = (walk(tmp_path / name, "--steps", 45, "--seed", 3) for name in ("1.txt", "2.txt"))
    assert first.returncode == 0 and "seed 3" in first.stdout and "45 steps, 2 files" in first.stdout
    assert len(steps) > 45 and steps == again


SPOIL = """
import sys, threading
sys.path.insert(0, sys.argv.pop())
import soak, bpy
from bl_ext.user_default.dynamic_morph_targets.core import logger
from bl_ext.user_default.dynamic_morph_targets.run.tools import watch

def handler(walk):
    bpy.app.handlers.load_post.append(watch.HANDLERS["load_post"])

def unused_data(walk):
    bpy.data.actions.new("left")

def scene(walk):
    bpy.data.scenes.new("left")

def thread(walk):
    threading.Thread(target=threading.Event().wait, name="dynamorph left", daemon=True).start()

def open_file(walk):
    walk.left_open = (walk.folder / "left").open("w")

def partial_file(walk):
    (walk.folder / "left.part.glb").touch()

def bug(walk):
    try:
        raise ValueError("left")
    except ValueError as error:
        logger.log_bug(error)

def failure(walk):
    raise KeyError("left")

spoil = globals()[sys.argv.pop()]
if spoil is unused_data:
    soak.press = spoil
soak.STEPS = {spoil: 1}
soak.leave(soak.main())
"""


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("handler", "handlers: load_post"),
        ("unused_data", "unused data: ('actions', 'left')"),
        ("scene", "scenes: left"),
        ("thread", "threads: dynamorph left"),
        ("open_file", "open files: "),
        ("partial_file", "partial files: left.part.glb"),
        ("bug", "a traceback was printed"),
        ("failure", "KeyError: 'left'"),
    ],
)
def test_a_walk_sees_what_is_wrong(tmp_path, what, words):
    arguments = ("--steps", "9", "--seed", "1", "--log", tmp_path / "log.txt", what, SOAK.parent)
    run = subprocess.run([sys.executable, "-c", SPOIL, *arguments], capture_output=True, text=True, check=False)
    assert run.returncode == 1 and f"after step 2: {words}" in run.stdout, run.stdout + run.stderr
    assert "again: make -C evidence soak seed=1 steps=2" in run.stdout


def test_growing_memory_is_seen():
    code = "import soak; assert soak.growth([*range(60)]) == 1.0 and soak.growth([0, 9000] + 58 * [20]) == 0.0"
    subprocess.run([sys.executable, "-c", code], cwd=SOAK.parent, capture_output=True, check=True)
