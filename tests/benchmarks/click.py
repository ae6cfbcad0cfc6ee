# SPDX-License-Identifier: GPL-3.0-or-later
"""What a user waits for from the click to Live, of one character: a process of its own, as after Blender has started.

python tests/benchmarks/click.py CHARACTER [CHECKOUT]   prints JSON; CHECKOUT: another one, that is built, to compare.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

HERE = Path(__file__).resolve().parents[2]
ROOT = Path(sys.argv[2]).resolve() if len(sys.argv) > 2 else HERE
sys.path[:0] = [str(ROOT / folder) for folder in ("build/cmake/python", "addon", "tests", "tests/addon", "tools")]

from installed import MODULE  # noqa: E402, I001 - before bpy

import addon_utils  # noqa: E402 - of bpy
import bpy  # noqa: E402
import characters  # noqa: E402
import rig_families  # noqa: E402
import table  # noqa: E402
from bl_ext.user_default.dynamic_morph_targets.core import engine  # noqa: E402
from bl_ext.user_default.dynamic_morph_targets.ui.operators import jobs  # noqa: E402
from dynamic_morph_targets.__main__ import leave  # noqa: E402

ASSETS = HERE.parent / "shared" / "assets"


def main() -> int:
    assert addon_utils.enable(MODULE, default_set=True) is not None
    engine.load()
    body = opened(sys.argv[1])
    work = []
    run_all = jobs.run_all
    jobs.run_all = lambda batch, tick=None: work.append(batch) or run_all(batch, tick)
    wall, cpu = {}, {}

    @contextmanager
    def timed(stage: str) -> Iterator[None]:
        began, used = time.perf_counter(), cpu_seconds()
        yield
        wall[stage], cpu[stage] = time.perf_counter() - began, cpu_seconds() - used

    with timed("add"):
        bpy.ops.dynamorph.add_soft_skin()
    with timed("build"):
        bpy.ops.dynamorph.build()
    with timed("live"):
        bpy.ops.dynamorph.live()
        bpy.context.scene.frame_set(bpy.context.scene.frame_current)
    model = work[-1].jobs[-1].outcome.model
    found = {
        "vertices": len(body.data.vertices),
        "bones": len(body.find_armature().data.bones),
        "nodes": len(model.nodes),
        "stages": {
            "add": wall["add"],
            **{name: value for name, value in model.summary.seconds.items() if value > 1e-3},
            "the rest of the build": wall["build"] - sum(model.summary.seconds.values()),
            "live": wall["live"],
        },
        "wall": sum(wall.values()),
        "cpu": sum(cpu.values()),
    }
    print(json.dumps(found))
    return 0


def opened(name: str):
    """The character's body, active."""
    if file := table.CLICKED[name]:
        characters.open_file(ASSETS / file)
        body = characters.largest_skinned()
    else:
        bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
        body = rig_families.make(name).body
    bpy.ops.object.select_all(action="DESELECT")
    body.select_set(True)
    bpy.context.view_layer.objects.active = body
    return body


def cpu_seconds() -> float:
    """Of this process and of those that it has started and that have ended."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


if __name__ == "__main__":
    leave(main())
