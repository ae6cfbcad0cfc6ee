# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures what docs/bakes.md shows, for bakes_page.py: one section in a process of its own.

    python evidence/bakes.py SECTION FILE.json

Pictures go to docs/images/bakes.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from random import Random

import project  # noqa: F401
import fresh_blender  # noqa: F401

import bpy
import characters
import dynamic_morph_targets
import numpy as np
import plots
import test_kills
import test_time
import walks
from builders import make_arm, make_soft
from contact_sheet import quiet
from dynamic_morph_targets.core.result import slider_keys
from dynamic_morph_targets.io import model_file, paths
from dynamic_morph_targets.run.bake import bake_input, batch
from dynamic_morph_targets.run.bake.job import Job


def main() -> int:
    section, file = sys.argv[1:]
    dynamic_morph_targets.register()
    with tempfile.TemporaryDirectory(prefix="dynamorph_bakes_") as folder:
        found = SECTIONS[section](Path(folder))
    Path(file).write_text(json.dumps(found | {"blender": bpy.app.version_string}))
    return 0


# Round trips ----------------------------------------------------------------------------------------------------------

ARM = replace(characters.SHOTS["Shoulder"], frames=(11, 70))
ARM_MODES = 40  # more than the largest budget of keys
BUDGETS = (4, 8, 16, 32, 0)  # keys of the motion; 0: all modes


def round_trips(folder: Path) -> dict:
    """Every form of one bake, and how many keys it takes."""
    import round_trips  # it needs the readers of other formats, which the other sections do not

    def soft_arm():
        with quiet():
            body = characters.open_shot(ARM)
        body.dynamorph.model.modes = ARM_MODES
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / "arm.blend"))
        return body

    def baked(obj, budget: int) -> dict:
        """A bake to at most so many keys: by how much it is said to be off, and is, in body sizes."""
        obj.dynamorph.output.keys = budget
        job = Job(obj, "BAKE", folder=folder)
        batch.run(job)
        ours = round_trips.exact(job)
        shown = round_trips.shown(obj.name, job.outcome.bake.frames)
        return {
            "keys": job.outcome.report["keys"],
            "said": job.outcome.report["keys_error"] / ours.size,
            "error": round_trips.farthest(shown, ours.world) / ours.size,
            "bytes": job.outcome.size,
            "size": ours.size,
            "frames": len(job.outcome.bake.frames),
        }

    body = soft_arm()
    budgets = [baked(body, budget) for budget in BUDGETS]
    about = {"vertices": len(body.data.vertices), "size": budgets[0]["size"], "modes": ARM_MODES}
    forms = round_trips.measure(soft_arm(), folder)  # which empties the scene
    return about | {"budgets": budgets, "forms": forms}


# Loops ----------------------------------------------------------------------------------------------------------------


def loops(_folder: Path) -> dict:
    return {"walks": [walks.looped(name) for name in walks.WALKS], "repeated": walks.REPEATED}


# Long bakes -----------------------------------------------------------------------------------------------------------

LONG = characters.Shot("mh_male_53bones.blend", "gen_run_in_place", (1, 91), {"muscular": 37})
LENGTHS = (1000, 4000, 10_000)
LONG_FORMATS = ("modes", "pc2")


def long(folder: Path) -> dict:
    """Bakes of many frames by the command line: the memory of the whole process, and what became of it."""
    with quiet():
        body = characters.open_shot(LONG)
    rig = body.modifiers["Armature"].object
    repeat_forever(rig)
    shot = folder / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(shot))
    built = folder / "built.blend"
    name, about = body.name, {"vertices": len(body.data.vertices), "bones": len(rig.pose.bones)}
    command_line("build", shot, "--object", name, "-o", built)
    opened = command_line("info", built, "--object", name)
    rows = [long_bake(built, name, kind, frames) for kind in LONG_FORMATS for frames in LENGTHS]
    return about | {"stretch": bake_input.CHUNK_FRAMES, "opened": opened["memory"], "bakes": rows}


def repeat_forever(rig):
    """The action of a rig, again and again."""
    animation = rig.animation_data
    for curve in animation.action.layers[0].strips[0].channelbag(animation.action_slot).fcurves:
        curve.modifiers.new("CYCLES")


def long_bake(shot: Path, name: str, kind: str, frames: int) -> dict:
    output = shot.with_name("long.blend")
    more = ["--output-file", shot.with_name(f"{paths.OBJECT}.pc2")] if kind == "pc2" else []
    arguments = ("--object", name, "--frames", 1, frames, "--format", kind, *more, "-o", output)
    run = command_line("bake", shot, *arguments)
    bpy.ops.wm.open_mainfile(filepath=str(output))
    action = bpy.data.objects[name].dynamorph.bake.action
    bags = [action.layers[0].strips[0].channelbag(slot) for slot in action.slots] if action else []
    points = sum(len(curve.keyframe_points) for bag in bags if bag for curve in bag.fcurves)
    caches = list(shot.parent.glob("*.pc2"))
    file = sum(cache.stat().st_size for cache in caches)
    for cache in caches:
        cache.unlink()
    return {
        "format": kind, "frames": frames, "keyframes": points, "keyframe_bytes": points * slider_keys.KEYFRAME_BYTES,
        "file": file, **run,
    }  # fmt: skip


def command_line(command: str, *arguments) -> dict:
    """Runs the add-on's command line; returns the seconds it took, and the most memory it had, bytes."""
    began = time.perf_counter()
    words = [sys.executable, "-m", "dynamic_morph_targets", command, *map(str, arguments)]
    output = os.open(os.devnull, os.O_WRONLY)
    process = os.posix_spawn(words[0], words, test_kills.environment(), file_actions=[(os.POSIX_SPAWN_DUP2, output, 1)])
    _, status, usage = os.wait4(process, 0)
    os.close(output)
    if status:
        raise RuntimeError(f"{command} ended with {os.waitstatus_to_exitcode(status)}")
    return {"seconds": time.perf_counter() - began, "memory": 1024 * usage.ru_maxrss}


# Kills ----------------------------------------------------------------------------------------------------------------

KILLS = 20
FRAMES = 10_000  # so many that it is not done before


def kills(folder: Path) -> dict:
    """A bake that is killed with -9 at random moments, each time continued, and one that is not."""
    test_kills.FRAMES = FRAMES
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    arm = make_soft(make_arm(bpy.context.scene))
    arm.dynamorph.model.cage_nodes, arm.dynamorph.model.modes = 300, 6
    shot, caches, random = folder / "shot.blend", folder / "caches", Random(1)
    bpy.ops.wm.save_as_mainfile(filepath=str(shot))
    whole, done = folder / "whole.json", folder / "done.json"
    undisturbed, kept = test_kills.baked(test_kills.baking(shot, whole), whole), []
    while len(kept) < KILLS and test_kills.killed(shot, done, caches, random):
        (unfinished,) = caches.glob("*.unfinished")
        kept.append(len(model_file.unpack(unfinished.read_bytes())[0]["coordinates"]))
    found = test_kills.baked(test_kills.baking(shot, done, "--cache-dir", caches), done)
    same = {name: found[name] == undisturbed[name] for name in ("hash", "steps", "made_from")}
    left = {kind: len(list(caches.glob(f"*.{kind}"))) for kind in ("unfinished", "part")}
    return {"frames": FRAMES, "kept": kept, "same": same, "hash": found["hash"], "left": left}


# Time -----------------------------------------------------------------------------------------------------------------

RATES = (24, 30, 60)
INTEGRATORS = {"BDF2": 2, "EULER": 1}  # and their order
SUBSTEPS = (8, 16, 32, 64)
FINEST = (24, 512)  # frames a second and substeps of what counts as exact
SAME_STEPS = ((24, 5), (30, 4), (60, 2), (120, 1))
STEPS = (0.25, 0.5, 1, 2, 4)  # ms, at the axis
COMPARED = 6  # times a second, which all frame rates have


def times(_folder: Path) -> dict:
    """One motion at several frame rates and substeps: errors are of the largest coordinate."""
    run = test_time.swaying_bar()

    def at(fps: int, substeps: int, integrator="BDF2") -> np.ndarray:
        return run(fps, substeps, integrator)[:: fps // COMPARED]

    exact, same = at(*FINEST), [at(*rate) for rate in SAME_STEPS]
    scale = np.abs(exact).max()
    errors = [
        {
            "integrator": integrator,
            "fps": fps,
            "errors": [float(np.abs(at(fps, n, integrator) - exact).max() / scale) for n in SUBSTEPS],
        }
        for integrator in INTEGRATORS
        for fps in RATES
    ]
    for row in errors:
        row["order"] = float(np.log2(row["errors"][-2] / row["errors"][-1]))
    apart = max(float(np.abs(each - same[0]).max() / scale) for each in same)
    draw_errors(errors)
    off = float(np.abs(same[0] - exact).max() / scale)
    return {
        "finest": FINEST,
        "substeps": SUBSTEPS,
        "errors": errors,
        "same_steps": SAME_STEPS,
        "apart": apart,
        "off": off,
    }


def draw_errors(rows: list[dict]):
    drawing, (axes,) = plots.figure(1)
    curves = {}
    for integrator, order in INTEGRATORS.items():
        points = [
            (1000.0 / (row["fps"] * n), error)
            for row in rows
            if row["integrator"] == integrator
            for n, error in zip(SUBSTEPS, row["errors"], strict=True)
        ]
        curves[f"{integrator}, order {order}"] = tuple(zip(*sorted(points), strict=True))
    plots.draw(axes, "24, 30 and 60 frames a second", curves, "step, ms", "error", marker="o", ms=4)
    axes.set(xscale="log", yscale="log")
    axes.set_xticks(STEPS, [f"{step:g}" for step in STEPS])
    axes.set_xticks([], minor=True)
    plots.save(drawing, walks.IMAGES / "order.svg")


SECTIONS = {section.__name__: section for section in (round_trips, loops, long, kills, times)}

if __name__ == "__main__":
    sys.exit(main())
