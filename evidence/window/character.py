# SPDX-License-Identifier: GPL-3.0-or-later
"""A body of 13,000 vertices that nobody here made: how fast it plays, without a simulation, live and baked."""

from __future__ import annotations

import time

import bpy
import driver
import frames
import numpy as np
import real_character
from driver import WORK, measure, step, until, window
from editors import (
    addon,
    baked,
    from_menu,
    job_done,
    rig,
    select_target,
    settings,
    sidebar,
    skin,
    timeline,
    view,
    viewport,
)
from mathutils import Euler

FILE = WORK / "character_before.blend"
CLIP, START = "gen_jump", 5
FRAMES = 8  # of a playback that is drawn
UNDRAWN = 24  # of one that is not


@step("Open a real character")
def open_character():
    """Not by hand."""
    with bpy.context.temp_override(window=window()):
        bpy.ops.wm.open_mainfile(filepath=str(FILE), load_ui=False)
    yield 0.5
    with viewport.context():
        real_character.make_soft(CLIP)
    bpy.context.scene.frame_set(START)
    eye = view.area.spaces.active.region_3d
    eye.view_location, eye.view_distance = (0.0, 0.0, 0.9), 2.6
    eye.view_rotation = Euler((1.45, 0.0, 0.5)).to_quaternion()
    yield from driver.drawn()
    vertices, bones = len(skin().data.vertices), len(rig().data.bones)
    measure("Character", f"{vertices:,} vertices, {bones} bones, {len(settings().targets)} targets")


@step("Mirror Target")
def mirror():
    names = [target.name for target in settings().targets]
    left, right = names.index("biceps_bulge_L"), names.index("biceps_bulge_R")
    skeleton = addon("scene.references").rest_skeleton(rig().data)
    captured = settings().targets[right].local(skeleton)
    yield from select_target(right)
    yield from sidebar.press("dynamorph.remove_target")
    yield from until(lambda: len(settings().targets) == len(names) - 1, "the target to be removed")
    yield from select_target(left - (right < left))
    yield from from_menu("DOWN_ARROW", "DOWN_ARROW", "DOWN_ARROW")
    yield from until(lambda: len(settings().targets) == len(names), "the mirrored target")
    target = settings().active_target
    assert target.name == "biceps_bulge_R" and target.bone_names() == ("lowerarm_r",)
    assert np.abs(target.local(skeleton) - captured).max() < 1e-3
    target.stiffness = real_character.STIFF
    yield from sidebar.fold("DYNAMORPH_PT_targets")


@step("Build it")
def build():
    yield from sidebar.press("dynamorph.build")
    yield from job_done()
    measure("Its model", settings().model.summary)
    expected = addon("run.bake.expected_error")
    begin = time.monotonic()
    yield from until(lambda: expected.known(skin()) is not None, "the expected error", 60.0)
    measure("Its expected error", f"{100 * expected.known(skin()):.0f} %, found in {time.monotonic() - begin:.1f} s")
    yield from measured("plain")


@step("Play it live")
def live():
    yield from sidebar.press("dynamorph.live")
    yield from until(lambda: addon("run.live").is_on(skin()), "Live to be on")
    with frames.timed(addon("run.live"), "follow") as follow:
        yield from measured("Live")
    measure("Live's own share of a frame", f"{np.median(follow):.1f} ms, mean {np.mean(follow):.1f} ms")
    seconds, problem = yield from frames.latency(skin(), settings().targets[0], 2.0 * settings().targets[0].stiffness)
    assert not problem
    measure("Stiffness to the next picture", f"{seconds:.2f} s")
    yield from sidebar.press("dynamorph.live")
    yield from until(lambda: not addon("run.live").is_on(skin()), "Live to be off")


@step("Bake it")
def bake():
    bpy.context.scene.frame_end = bpy.context.scene.frame_current + 3 * UNDRAWN
    yield from sidebar.press("dynamorph.bake")
    begin = time.monotonic()
    yield from job_done()
    count = bpy.context.scene.frame_end - bpy.context.scene.frame_start + 1
    measure("Its bake", f"{count} frames in {time.monotonic() - begin:.1f} s")
    assert baked()
    yield from measured("baked")


def measured(how: str):
    """How fast it plays in the window, and with a text where the viewport is; and what Blender takes to evaluate."""
    bpy.context.scene.frame_set(START)
    drawn = yield from frames.play(FRAMES)
    area = view.area
    area.type = "TEXT_EDITOR"
    try:
        bpy.context.scene.frame_set(START)
        undrawn = yield from frames.play(UNDRAWN, timeline)
    finally:
        area.type = "VIEW_3D"
    yield from driver.drawn()
    rate = bpy.context.scene.render.fps
    measure(f"Playback, {how}", f"{drawn.fps:.1f} frames/s in the window, {undrawn.fps:.0f} of {rate} without viewport")
    measure(f"Evaluation of a frame, {how}", f"{undrawn.milliseconds:.1f} ms")
