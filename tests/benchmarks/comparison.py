# SPDX-License-Identifier: GPL-3.0-or-later
"""`make comparison`: the table of docs/comparison.md that was run here: sample_blends/bulging_cylinder.blend, baked by
Dynamorph and simulated by Blender's own ways. No number is typed here.

    python tests/benchmarks/comparison.py        runs each way in a process of its own, and writes the table
    python tests/benchmarks/comparison.py WAY    one way in this process: prints JSON

Blender's ways get what an artist would give them: the limb with its sculpted shapes, blended by its pose, as the shape
that they are held to. Everything else is as it comes. What is measured is what Blender shows.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

os.environ["BLENDER_USER_RESOURCES"] = tempfile.mkdtemp(prefix="dynamorph_comparison_")  # before bpy is imported
ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / folder) for folder in ("addon", "tests/addon", "sample_blends", "tools")]

import bpy  # noqa: E402
import dynamic_morph_targets  # noqa: E402
import numpy as np  # noqa: E402
from believable_measure import triangles_of, world_points  # noqa: E402
from claims import FLEXED, SHAKEN, STRAIGHT  # noqa: E402
from collision_press import HELD, set_socket  # noqa: E402
from contact_sheet import quiet  # noqa: E402
from dynamic_morph_targets.__main__ import leave  # noqa: E402
from dynamic_morph_targets.run import batch  # noqa: E402
from dynamic_morph_targets.run.job import Job  # noqa: E402
from measured import measured_at  # noqa: E402
from measures import volume  # noqa: E402
from performance_page import grid  # noqa: E402
from run import machine  # noqa: E402

PAGE = ROOT / "docs" / "comparison.md"
SCENE = ROOT / "sample_blends" / "bulging_cylinder.blend"
BEGIN, END = "<!-- run here -->", "<!-- end of run here -->"
STILL = 65  # frame at which the limb is flexed and has come to rest after the first push
LONGEST = 1800  # seconds that a way may take
NONE = "-"


def main() -> int:
    if len(sys.argv) > 1:
        return measure(sys.argv[1])
    newest = sorted((ROOT / ".venv").glob("3.*/bin/python"))[-1]  # of Blender too
    rows = []
    for way in WAYS:
        try:
            done = subprocess.run([newest, __file__, way], capture_output=True, text=True, check=False, timeout=LONGEST)
        except subprocess.TimeoutExpired:
            rows.append([WAYS[way].title, f"over {LONGEST}", *[NONE] * 6])
            continue
        if done.returncode:
            sys.exit(f"comparison: {way}: {done.stdout}{done.stderr}")
        found = json.loads(done.stdout.strip().rpartition("\n")[2])
        rows.append(WAYS[way].row(found))
        print(f"comparison: {' | '.join(rows[-1])}", flush=True)
    write(rows, found)
    return 0
