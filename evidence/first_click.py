# SPDX-License-Identifier: GPL-3.0-or-later
"""What a user waits for from the click to Live, after a stroke of paint and in a bake, of one character: a process of
its own, as after Blender has started.

python evidence/first_click.py CHARACTER [CHECKOUT]   prints JSON; CHECKOUT: another one, that is built, to compare.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]
ROOT = Path(sys.argv[2]).resolve() if len(sys.argv) > 2 else HERE
sys.path[:0] = [str(ROOT / folder) for folder in ("build/cmake/python", "addon", "tests", "tests/addon", "tools")]

from installed import MODULE  # noqa: E402, I001 - before bpy

import addon_utils  # noqa: E402 - of bpy
import bpy  # noqa: E402
import characters  # noqa: E402
import numpy as np  # noqa: E402
import rig_families  # noqa: E402
import table  # noqa: E402
from bl_ext.user_default.dynamic_morph_targets.core import engine  # noqa: E402
from bl_ext.user_default.dynamic_morph_targets.run import remembered  # noqa: E402
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch  # noqa: E402
from bl_ext.user_default.dynamic_morph_targets.run import live  # noqa: E402
from bl_ext.user_default.dynamic_morph_targets.run.work import task  # noqa: E402
from bl_ext.user_default.dynamic_morph_targets.run.work.child import Child  # noqa: E402
from bl_ext.user_default.dynamic_morph_targets.run.tools.first_look import FirstLook  # noqa: E402
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job  # noqa: E402

FRAMES = 250  # of the bake


def _steps(work: FirstLook) -> Iterator[None]:
    """Of the work as in a window, which looks now and then."""
    task.worker_for = Child
    for _ in work.steps():
        yield
        time.sleep(0.005)


def main() -> int:
    assert addon_utils.enable(MODULE, default_set=True) is not None
    engine.load()
    body = opened(sys.argv[1])
    wall, cpu = {}, {}

    @contextmanager
    def timed(stage: str) -> Iterator[None]:
        began, used = time.perf_counter(), cpu_seconds()
        yield
        wall[stage], cpu[stage] = time.perf_counter() - began, cpu_seconds() - used

    with timed("add"):
        bpy.ops.dynamorph.add_soft_skin()
    body = bpy.context.object
    job = Job(body, "BUILD", rebuild=True)
    if FirstLook:
        work = FirstLook(body)
        job, steps = work.jobs[0], _steps(work)
        turn_on = live.turn_on

        def timed_turn_on(*given: object) -> None:
            with timed("live"):
                turn_on(*given)
                show()

        live.turn_on = timed_turn_on
        with timed("build"):
            while not work.shows:
                next(steps)
        wall["build"], cpu["build"] = wall["build"] - wall["live"], cpu["build"] - cpu["live"]
        with timed("the rest of the model"):
            for _ in steps:
                pass
    else:
        with timed("build"):
            batch.run(job)
        with timed("live"):
            bpy.ops.dynamorph.live()
            show()
    model = job.outcome.model
    seconds = {name: value for name, value in model.summary.seconds.items() if value > 1e-3}
    if FirstLook:  # those of the whole model are not waited for
        seconds = {name: value for name, value in seconds.items() if name not in ("modes", "polynomials")}
    baked = Job(body, "BAKE", frames=(1, FRAMES))
    with timed("bake"):
        batch.run(baked)
    free = Job(body, "BAKE", frames=(1, FRAMES), stored=False, changes={"max_displacement": 0.0, "max_thickness": 0.0})
    batch.run(free)
    bpy.ops.dynamorph.live()
    stroke = painted(body)
    whole = sum(wall[stage] for stage in ("add", "build", "live"))
    found = {
        "vertices": len(body.data.vertices),
        "bones": len(body.find_armature().data.bones),
        "nodes": len(model.nodes),
        "stages": {
            "add": wall["add"],
            **seconds,
            "the rest of the build": wall["build"] - sum(seconds.values()),
            "live": wall["live"],
        },
        "wall": whole,
        "cpu": sum(cpu[stage] for stage in ("add", "build", "live")),
        "whole": whole + wall.get("the rest of the model", 0.0),
        "stroke": stroke,
        "bake": wall["bake"],
        "step": 1.0 / free.outcome.report["steps_per_second"],
        "rig": baked.progress.seconds["sample rig"],  # nearly all of it is Blender's
    }
    print(json.dumps(found))
    return 0


def show() -> None:
    bpy.context.scene.frame_set(bpy.context.scene.frame_current)


def painted(body) -> float:
    """The lower half is painted a little softer: seconds until Live shows it."""
    group = body.vertex_groups.get("Firmness") or body.vertex_groups.new(name="Firmness")
    body.dynamorph.firmness_group = group.name
    points = np.empty(3 * len(body.data.vertices), np.float32)
    body.data.vertices.foreach_get("co", points)
    height = points.reshape(-1, 3) @ np.array(body.matrix_world)[2, :3]
    group.add(list(range(len(height))), 0.5, "REPLACE")
    group.add(np.flatnonzero(height < np.median(height)).tolist(), 0.4, "REPLACE")
    began = time.perf_counter()
    sessions = remembered.live.sessions
    del sessions[body.session_uid]  # as `live` does after a stroke
    live.refresh(body)
    assert live.problem(body) == ""
    return time.perf_counter() - began


def opened(name: str):
    """The character's body, active."""
    if file := table.CLICKED[name]:
        characters.open_file(characters.ASSETS / file)
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
    code = main()
    sys.stdout.flush()
    os._exit(code)  # bpy 4.5 may crash as Python ends; an older checkout has no helper for it
