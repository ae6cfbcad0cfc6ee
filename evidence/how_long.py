# SPDX-License-Identifier: GPL-3.0-or-later
"""`make how-long`: docs/how_long.md, what an artist waits for with characters of three sizes. No number is typed here.

    python evidence/how_long.py                     measures, and writes the page
    python evidence/how_long.py --page              the page from what was measured before
    python evidence/how_long.py VERTICES SETTING    one character in this process: prints JSON

Each measurement is a process of its own, as after Blender has started. The character is Herbert of sample_blends, so
that everybody can measure it: only his mesh, rig and animation, with more or fewer vertices.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import fresh_blender  # noqa: F401
from project import ROOT

import bpy
import dynamic_morph_targets
from bench import machine
from contact_sheet import quiet
from dynamic_morph_targets.run import live
from dynamic_morph_targets.run.bake import batch
from dynamic_morph_targets.run.bake.job import Job
from dynamic_morph_targets.run.tools.first_look import FirstLook
from dynamic_morph_targets.run.work import task
from dynamic_morph_targets.run.work.child import Child
from mathutils import Vector
from measured import measured_at
from performance_page import grid

PAGE = ROOT / "docs" / "how_long.md"
KEPT = ROOT / "build" / "reports" / "how_long.json"
SCENE = ROOT / "sample_blends" / "herbert.blend"
SIZES = (5_000, 15_000, 50_000)  # vertices
COMPARED = SIZES[1]  # with which the settings are tried
RUNS = 3  # of each size unless --runs says otherwise; the median counts. Of each setting one must do
FRAMES = 250
PLAYED = 60  # frames
MEGABYTE = 1024 * 1024
BUSY = 0.5  # load before anything is measured
BUSY_TEXT = "**The machine had other work (load {:.1f}), so these times are longer than on an idle one.**"
RUN_TEXTS = ("Medians of {} runs each", "One run each")
BALL, PRESSED = 0.1, 0.8  # meters; where its middle is in front of the belly, of its radius

PAGE_TEXT = """# How long will my character take?

This page tells you how long you wait, how much memory Blender needs, and how much larger your file becomes. Look up the
row that is closest to your character, then the settings that you changed. A machine of today with more cores and a
faster clock is quicker than the one that these figures come from; compare the columns with each other rather than with
your own clock.

`make -C evidence how-long` measures and writes this page; nothing on it is typed by hand.

{commit}. Blender {blender}; {machine}. {busy}

## By the number of vertices

The character is Herbert from `sample_blends`: one mesh, {bones} bones, animated with a walk, a dive and a run. His mesh
is subdivided and decimated to each size. Everything is as *Add Soft Skin* sets it. {runs}, in a Blender that has just
started.

{sizes}
- *Click to Live*: from **Add Soft Skin** to the first frame that Live shows. Live starts with a coarse draft.
- *Whole model*: from the click until Live plays with all of its modes. You can work in the meantime.
- *Build Model*: the button pressed again later. The cage is kept, because the mesh has not changed.
- *Bake*: **Bake** for {frames} frames to shape keys, when the model is already built. It includes reading the rig.
- *Frame*: how long Blender takes to evaluate a frame of playback, without drawing it: the rig and the mesh only, with
  Live, and with the finished bake. To play at 24 frames a second, a frame may take 42 ms, drawing included.
- *Memory*: the most that Blender's process used, on top of what the open file needed.
- *File*: what the model, and the bake, add to the saved .blend.

Time grows much more slowly than the number of vertices. The simulation runs in a cage of about {nodes:,} nodes
(**Cage Nodes**), however dense your mesh is; only reading the mesh, attaching it to the cage and writing the keys
depend on its vertices. Memory and file size do grow with them, because each key of a bake stores every vertex.

## What makes it longer

The same character with {compared:,} vertices is measured with one setting changed at a time. The table gives its times
as multiples of those with the defaults, in one run each. *Build* is the whole model after the click. *Simulation* is
the part of the bake without reading the rig and writing.

{settings}
- **Detail** is the number of modes: each simulated step takes longer, and a bake writes as many shape keys. Lower it
  first when Live is too slow.
- **Cage Nodes** makes the build longer, and every step in Full Quality. Reduced Quality uses the modes only.
- **Samples Per Frame** stores several states of each frame for motion blur. The substeps are rounded up to a multiple
  of it, so more of them are simulated, and more states of the rig are read.
- **Quality: Full** simulates every node instead of modes. Use it for the last bake.
- **Collision** is baked in Full Quality unless you turn that off, which explains most of its price. Here a ball is
  pressed into the belly in every frame.

The rig matters too. Blender has to evaluate it for every substep: a rig with hundreds of bones, constraints and
drivers, such as Rigify's, can take longer to read than the skin takes to simulate. [Performance](performance.md) lists
such a rig and shows where the time goes, stage by stage.
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("one", nargs="*", metavar="VERTICES SETTING", help="measure one character in this process")
    parser.add_argument("--page", action="store_true", help="write the page from what was measured before")
    parser.add_argument("--runs", type=int, default=RUNS, help=f"of each size; default: {RUNS}")
    arguments = parser.parse_args()
    if arguments.one:
        return measure(int(arguments.one[0]), arguments.one[1])
    if not arguments.page:
        found = {
            "commit": measured_at(PAGE.name),
            "machine": machine(),
            "blender": bpy.app.version_string,
            "load": os.getloadavg()[0],
            "runs": arguments.runs,
        }
        found["sizes"] = {str(size): median(size, DEFAULT, arguments.runs) for size in SIZES}
        found["settings"] = {name: median(COMPARED, name, 1) for name in SETTINGS if name != DEFAULT}
        KEPT.parent.mkdir(parents=True, exist_ok=True)
        KEPT.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    if not KEPT.exists():
        sys.exit("how-long: nothing was measured yet: run it without --page first")
    write_page(json.loads(KEPT.read_text(encoding="utf-8")))
    print(f"written to {PAGE.relative_to(ROOT)}")
    return 0


def median(vertices: int, setting: str, count: int) -> dict[str, float]:
    """The median of each figure over so many processes. Raises SystemExit when one of them fails."""
    runs = []
    for _ in range(count):
        done = subprocess.run(
            [sys.executable, __file__, str(vertices), setting], capture_output=True, text=True, check=False
        )
        if done.returncode:
            sys.exit(f"how-long: {vertices:,} vertices, {setting}: {done.stdout}{done.stderr}")
        runs.append(json.loads(done.stdout.strip().rpartition("\n")[2]))
    print(f"how-long: {vertices:,} vertices, {setting}", flush=True)
    return {name: statistics.median(run[name] for run in runs) for name in runs[0]}


# One character --------------------------------------------------------------------------------------------------------


def paced(steps: Iterator[None]) -> Iterator[None]:
    """Leaves the processor to who computes."""
    for _ in steps:
        yield
        time.sleep(0.005)


def measure(vertices: int, setting: str) -> int:
    """Print what one character takes as JSON, in seconds and bytes."""
    dynamic_morph_targets.register()
    with quiet(), tempfile.TemporaryDirectory() as folder:
        body = character(vertices)
        found = {"vertices": len(body.data.vertices), "bones": len(body.find_armature().data.bones)}
        before, plain, in_use = saved(folder), played(), resident()
        began = time.perf_counter()
        bpy.ops.dynamorph.add_soft_skin()
        SETTINGS[setting](body)
        work = FirstLook(body)
        task.worker_for = Child  # as in a window
        steps = paced(work.steps())
        any(work.shows for _ in steps)  # until there is a draft
        if not work.shows:  # Full Quality has none
            live.turn_on(body, bpy.context.scene)
        show(bpy.context.scene.frame_current)
        found["live"] = time.perf_counter() - began
        for _ in steps:
            pass
        found["whole"] = time.perf_counter() - began
        build = Job(body, "BUILD", rebuild=True)
        found["build"] = seconds(lambda: batch.run(build))
        found["nodes"] = len(build.outcome.model.nodes)
        found["plain_frame"], found["live_frame"] = plain, played()
        live.turn_off(body)
        found["model_bytes"] = saved(folder) - before
        bake = Job(body, "BAKE", frames=(1, FRAMES))
        found["bake"] = seconds(lambda: batch.run(bake))
        found["simulate"] = bake.progress.seconds["simulate"]
        found["baked_frame"] = played()
        found["bake_bytes"] = saved(folder) - before - found["model_bytes"]
        found["memory"] = status("VmHWM") - in_use
    print(json.dumps(found))
    return 0


def character(vertices: int) -> bpy.types.Object:
    """Herbert's mesh with so many vertices, on his rig with his animation, and nothing else; active."""
    bpy.ops.wm.open_mainfile(filepath=str(SCENE))
    herbert = bpy.data.objects["Herbert"]
    rig = herbert.find_armature()
    herbert.shape_key_clear()
    body = bpy.data.objects.new("Body", herbert.data)  # which was never a soft skin
    bpy.context.scene.collection.objects.link(body)
    for other in set(bpy.data.objects) - {body, rig}:
        bpy.data.objects.remove(other)
    body.vertex_groups.remove(body.vertex_groups["Firmness"])
    body.parent = rig
    bpy.context.view_layer.objects.active = body
    body.select_set(True)
    finer = body.modifiers.new("Subdivision", "SUBSURF")
    finer.levels = 1
    bpy.ops.object.modifier_apply(modifier=finer.name)
    fewer = body.modifiers.new("Decimate", "DECIMATE")
    fewer.ratio = vertices / len(body.data.vertices)
    bpy.ops.object.modifier_apply(modifier=fewer.name)
    body.modifiers.new("Armature", "ARMATURE").object = rig
    bpy.data.orphans_purge(do_recursive=True)
    bpy.context.scene.frame_end = FRAMES
    bpy.context.scene.frame_set(1)
    return body


def press_a_ball(body: bpy.types.Object) -> None:
    """A ball with Blender's Collision, pressed into the belly wherever it goes."""
    rig = body.find_armature()
    belly = min((vertex.co for vertex in body.data.vertices if abs(vertex.co.x) < 0.05 and vertex.co.z < 1.2),
                key=lambda point: point.y)  # fmt: skip  # the most in front
    bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24, radius=BALL)
    ball = bpy.context.object
    ball.modifiers.new("Collision", "COLLISION")
    bone = rig.data.bones["spine_01"]
    ball.parent, ball.parent_type, ball.parent_bone = rig, "BONE", bone.name
    place = bone.matrix_local.copy()
    place.translation = bone.tail_local  # children of a bone hang on its tail
    ball.location = place.inverted() @ (belly + Vector((0.0, -PRESSED * BALL, 0.0)))
    bpy.context.view_layer.objects.active = body
    body.dynamorph.collision.use = True


def set_to(group: str, name: str, value: object) -> Callable[[bpy.types.Object], None]:
    return lambda body: setattr(getattr(body.dynamorph, group), name, value)


def reduced_collision(body: bpy.types.Object) -> None:
    press_a_ball(body)
    body.dynamorph.collision.bake_full = False


DEFAULT = "Defaults"
SETTINGS: dict[str, Callable[[bpy.types.Object], None]] = {
    DEFAULT: lambda body: None,
    "Detail 60": set_to("model", "modes", 60),
    "Detail 240": set_to("model", "modes", 240),
    "Cage Nodes 4,000": set_to("model", "cage_nodes", 4000),
    "Samples Per Frame 4": set_to("simulation", "samples", 4),
    "Quality: Full": set_to("model", "solver", "FULL"),
    "Collision, in Reduced Quality": reduced_collision,
    "Collision": press_a_ball,
}


def seconds(work: Callable[[], None]) -> float:
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def show(frame: int) -> None:
    bpy.context.scene.frame_set(frame)


def played() -> float:
    """Seconds that Blender takes to evaluate a frame, one after the other; the median."""
    show(1)
    return statistics.median(seconds(lambda frame=frame: show(frame)) for frame in range(2, 2 + PLAYED))


def saved(folder: str) -> int:
    """The size of the file, with what belongs to it, if it is saved."""
    bpy.ops.wm.save_as_mainfile(filepath=str(Path(folder) / "shot.blend"), copy=True, compress=False)
    return sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file())


def resident() -> int:
    """The memory in use, from which the most is counted from now on."""
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    return status("VmRSS")


def status(name: str) -> int:
    """Bytes that Linux counts for this process."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(f"{name}:"))


# The page -------------------------------------------------------------------------------------------------------------


def write_page(found: dict) -> None:
    sizes = list(found["sizes"].values())
    compared = found["sizes"][str(COMPARED)]
    PAGE.write_text(
        PAGE_TEXT.format(
            commit=found["commit"], blender=found["blender"], machine=found["machine"],
            busy=busy(found["load"]), runs=RUN_TEXTS[found["runs"] == 1].format(found["runs"]), frames=FRAMES,
            bones=f"{compared['bones']:.0f}", nodes=round(compared["nodes"], -2), compared=COMPARED,
            sizes=grid(["vertices", "click to Live", "whole model", "Build Model", "bake", "frame, rig only",
                        "frame, Live", "frame, baked", "memory", "file, model", "file, bake"], map(size_row, sizes)),
            settings=grid(["", "build", "bake", "simulation", "frame, Live", "file, bake"],
                          [setting_row(name, each, compared) for name, each in found["settings"].items()]),
        ),
        encoding="utf-8",
    )  # fmt: skip


def busy(load: float) -> str:
    """What to say of times that were measured under a load."""
    return BUSY_TEXT.format(load) if load > BUSY else ""


def size_row(each: dict[str, float]) -> list[str]:
    return [
        f"{each['vertices']:,.0f}",
        *(f"{each[name]:.1f} s" for name in ("live", "whole", "build", "bake")),
        *(f"{1000 * each[name]:.1f} ms" for name in ("plain_frame", "live_frame", "baked_frame")),
        *(f"{each[name] / MEGABYTE:,.0f} MB" for name in ("memory", "model_bytes", "bake_bytes")),
    ]


def setting_row(name: str, each: dict[str, float], defaults: dict[str, float]) -> list[str]:
    factors = (each[key] / defaults[key] for key in ("whole", "bake", "simulate", "live_frame", "bake_bytes"))
    return [name, *(f"{factor:.2g} times" for factor in factors)]


if __name__ == "__main__":
    sys.exit(main())
