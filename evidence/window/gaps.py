# SPDX-License-Identifier: GPL-3.0-or-later
"""How long the window waits while a soft skin is added, built, shown and baked: run by evidence/gaps.py in Blender.

A timer that Blender calls in each turn of its event loop notes when that was. WORK/gaps.json gets, for each stage, the
seconds from one turn to the next, what the add-on was doing before the longest, and the memory of all processes.
"""

from __future__ import annotations

import importlib
import json
import os
import re
import resource
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import bpy

ADD_ON = "bl_ext.user_default.dynamic_morph_targets"
REST = 3.0  # seconds in which nothing runs
LOOK = 0.1  # seconds between two looks at the memory
PLAYED = 60  # frames of Live
LONGEST = 5  # gaps that are named

remembered = importlib.import_module(f"{ADD_ON}.run.remembered")
gaps: dict[str, list[tuple[float, str]]] = {}  # by stage: seconds, and what was done
memory: dict[str, list[int]] = {}  # by stage: the most bytes that Blender had, and the processes that it began
stage, last, looked, doing = "", 0.0, 0.0, ""


def resident(process: int | str) -> int:
    """Bytes of its memory that are in use; 0 if it has ended."""
    try:
        return int(Path(f"/proc/{process}/statm").read_text(encoding="ascii").split()[1]) * resource.getpagesize()
    except (FileNotFoundError, ProcessLookupError):
        return 0


def look_at_memory() -> None:
    begun = Path(f"/proc/self/task/{os.getpid()}/children").read_text(encoding="ascii").split()
    found = resident("self"), sum(map(resident, begun))
    memory[stage] = [max(pair) for pair in zip(found, memory.get(stage, (0, 0)), strict=True)]


def beat() -> float:
    global last, looked, doing
    now = time.perf_counter()
    if stage and now > looked + LOOK:
        looked = now
        look_at_memory()
    if stage and last:
        gaps.setdefault(stage, []).append((now - last, doing))
    last = now
    doing = re.sub(r"[\d.]+", "N", str(remembered.work.running.message)) if remembered.work.running else ""
    return 0.0


def pressed(name: str) -> None:
    """A button, as a click presses it."""
    window = bpy.context.window_manager.windows[0]
    area = window.screen.areas[0]
    with bpy.context.temp_override(window=window, area=area, region=area.regions[-1]):
        getattr(bpy.ops.dynamorph, name)("INVOKE_DEFAULT")


def rest(*drawn: bpy.types.Area) -> Iterator[None]:
    """Nothing runs; as often as with a progress bar, these areas are drawn."""
    ends, last_drawn = time.perf_counter() + REST, 0.0
    while time.perf_counter() < ends:
        if time.perf_counter() > last_drawn + 0.1:
            last_drawn = time.perf_counter()
            for area in drawn:
                area.tag_redraw()
        yield


def played() -> Iterator[None]:
    scene = bpy.context.scene
    for frame in range(scene.frame_start, scene.frame_start + PLAYED):
        scene.frame_set(frame)
        yield


def steps() -> Iterator[None]:
    global stage
    areas = bpy.context.window_manager.windows[0].screen.areas
    for area in areas:  # without a graphics card, drawing a 3D view takes longer than what is measured
        area.type = "PROPERTIES" if area == areas[0] else "CONSOLE"
    yield from rest()
    for title in ("Nothing runs", "Panels are drawn"):
        stage = title
        yield from rest(*(areas[:1] if title == "Panels are drawn" else ()))
    for title, name in (
        ("Add Soft Skin", "add_soft_skin"),
        ("Build", "build"),
        ("Live on", "live"),
        ("Live plays", ""),
        ("Live off", "live"),
        ("Bake", "bake"),
        ("Live on, with a floor", "live"),
        ("Live plays, with a floor", ""),
    ):
        stage = title
        if not name:
            yield from played()
            continue
        if title == "Live on, with a floor":
            bpy.ops.dynamorph.add_floor()
        if name == "add_soft_skin":
            bpy.ops.dynamorph.add_soft_skin()
        else:
            pressed(name)
        yield
        while remembered.work.running:
            yield
        yield
    stage = ""


def take(left: Iterator[None]):
    def look() -> float | None:
        if next(left, True) is None:
            return 0.01
        Path(sys.argv[-1], "gaps.json").write_text(json.dumps({
            title: {
                "gaps": [gap for gap, _ in found],
                "longest": sorted(found, reverse=True)[:LONGEST],
                "memory": memory.get(title, (0, 0)),
            }
            for title, found in gaps.items()
        }), encoding="utf-8")  # fmt: skip
        bpy.ops.wm.quit_blender()
        return None

    return look


bpy.app.timers.register(beat)
bpy.app.timers.register(take(steps()), first_interval=1.0)
