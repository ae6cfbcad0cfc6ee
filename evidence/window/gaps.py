# SPDX-License-Identifier: GPL-3.0-or-later
"""How long the window waits while a soft skin is added, built, shown and baked: run by evidence/gaps.py in Blender.

A timer that Blender calls in each turn of its event loop notes when that was. WORK/gaps.json gets, for each stage, the
seconds from one turn to the next, and what the add-on was doing before the longest.
"""

from __future__ import annotations

import importlib
import json
import re
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import bpy

ADD_ON = "bl_ext.user_default.dynamic_morph_targets"
REST = 3.0  # seconds in which nothing runs
LONGEST = 5  # gaps that are named

remembered = importlib.import_module(f"{ADD_ON}.run.remembered")
gaps: dict[str, list[tuple[float, str]]] = {}  # by stage: seconds, and what was done
stage, last, doing = "", 0.0, ""


def beat() -> float:
    global last, doing
    now = time.perf_counter()
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
        ("Live off", "live"),
        ("Bake", "bake"),
    ):
        stage = title
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
            title: {"gaps": [gap for gap, _ in found], "longest": sorted(found, reverse=True)[:LONGEST]}
            for title, found in gaps.items()
        }), encoding="utf-8")  # fmt: skip
        bpy.ops.wm.quit_blender()
        return None

    return look


bpy.app.timers.register(beat)
bpy.app.timers.register(take(steps()), first_interval=1.0)
