# SPDX-License-Identifier: GPL-3.0-or-later
"""The model's settings, its modes and its errors; bounce; the skin in motion without a bake."""

from __future__ import annotations

import time

import bpy
import frames
import limb
import numpy as np
from driver import measure, step, until
from editors import (
    addon,
    close,
    job_done,
    keys,
    moved,
    physics,
    properties,
    rig,
    settings,
    shown,
    sidebar,
    skin,
    view,
    viewport,
)


@step("Scrub while the rig is read")
def read_while_scrubbing():
    """As when the mesh is compared with its model, a second after an edit."""
    read = lambda: addon("scene.read.worlds").worlds_at_start(skin(), rig())  # noqa: E731
    yield from frames.scrub(limb.FIRST, limb.FLEXED, read)
    yield from frames.click(limb.FIRST)


# The model -----------------------------------------------------------------------------------------------------------


@step("Build Model")
def build():
    yield from sidebar.press("dynamorph.build")
    yield from job_done()
    assert settings().model.summary and not addon("scene.store.staleness").model_age(skin())
    measure("Model of the arm", settings().model.summary)


@step("Set Bounce")
def bounce():
    """Of the key that was sculpted by a stroke."""
    target, before = settings().targets[2], settings().targets[2].stiffness
    assert 0.5 < target.bounce < 50.0
    wanted = round(0.6 * target.bounce, 2)
    yield from sidebar.enter("targets[2].bounce", str(wanted))
    found = f"{target.bounce} Hz of {wanted} at {target.stiffness} Pa, before {before}"
    assert abs(target.bounce - wanted) < 0.02 and target.stiffness < 0.5 * before, found
    assert not addon("scene.store.staleness").model_age(skin()), "a new stiffness needs no new model"


@step("The model's settings")
def model():
    yield from sidebar.fold("DYNAMORPH_PT_targets")
    yield from physics("advanced", "detail")
    yield from properties.choose_other("model.method")
    assert not addon("scene.store.staleness").model_age(skin())


@step("Modes and Check Targets")
def modes():
    yield from properties.press("dynamorph.check_targets")
    yield from until(lambda: settings().live.checks, "what the targets miss")
    measure("Check Targets", ", ".join(settings().live.checks.split("\n")))
    before, still = keys(), shown()
    yield from close("detail")
    yield from physics("modes")
    yield from properties.press("dynamorph.play_mode")
    yield from until(lambda: addon("run.tools.preview").is_running("dynamorph.play_mode"), "the mode to play")
    yield from until(lambda: np.abs(shown() - still).max() > 5e-3, "the mode to swing")
    yield from viewport.key("ESC")
    yield from until(lambda: keys() == before, "the preview to end")
    assert np.array_equal(shown(), still)
    yield from close("modes", "advanced")


# Live ----------------------------------------------------------------------------------------------------------------


@step("Live")
def live():
    bpy.context.scene.frame_set(limb.FIRST)
    yield from frames.click(limb.FIRST)
    begin = time.perf_counter()
    yield from sidebar.press("dynamorph.live")
    yield from until(lambda: addon("run.live").is_on(skin()), "Live to be on")
    measure("Live, turned on after", f"{time.perf_counter() - begin:.2f} s")
    assert keys()[-1] == "Dynamorph Live"


@step("Play it live")
def play_live():
    with frames.timed(addon("run.live"), "follow") as follow:
        played = yield from frames.play(limb.FLEXED - limb.FIRST + 5)
    assert len(follow) >= len(played.evaluated)
    measure("Playback with Live", f"{played.fps:.0f} of {bpy.context.scene.render.fps} frames/s")
    measure("Live, a frame of the arm", f"{np.mean(follow):.1f} ms, at most {max(follow):.0f} ms")
    assert moved(limb.FLEXED + 1, limb.FLEXED + 4) > 1e-4, "the skin does not swing"
    assert not addon("run.live").problem(skin())


@step("Change the stiffness while it plays")
def stiffness_live():
    """By its property: a field that is being edited holds the playback."""
    yield from frames.click(limb.FLEXED - 3)
    target = settings().targets[1]
    latency, problem = yield from frames.latency(skin(), target, 0.5 * target.stiffness)
    measure("Stiffness to the next picture, arm", f"{latency:.2f} s")
    assert not problem


@step("Scrub back and forward")
def scrub():
    forward = [shown_by_click(frame) for frame in (limb.FLEXED, limb.FLEXED + 1, limb.FLEXED + 2)]
    first = []
    for frame in forward:
        first.append((yield from frame))
    again = yield from shown_by_click(limb.FLEXED)
    assert np.array_equal(first[0], again), "scrubbing back shows something else"
    assert not np.array_equal(first[0], first[1])


def shown_by_click(frame: int):
    yield from frames.click(frame)
    return shown()


@step("Shake Test", picture=view)
def shake():
    yield from sidebar.unfold("DYNAMORPH_PT_shake_test")
    rested, stood = shown(), rig().matrix_world.copy()
    running = lambda: addon("run.tools.preview").is_running("dynamorph.shake_test")  # noqa: E731
    hop = "dynamorph.shake_test(kind='HOP')"
    yield from sidebar.press(hop)
    yield from until(running, "the shake test")
    yield from until(lambda: rig().matrix_world.translation.z > 0.02, "the rig to hop")
    yield from until(lambda: not running(), "the end of the shake test", 60)
    assert rig().matrix_world == stood and np.array_equal(shown(), rested)
    yield from sidebar.press(hop)
    yield from until(lambda: rig().matrix_world.translation.z > 0.02, "the rig to hop")
    yield from viewport.key("ESC")
    yield from until(lambda: not running(), "the shake test to stop")
    assert rig().matrix_world == stood and np.array_equal(shown(), rested)


@step("Compare A and B")
def slots():
    yield from sidebar.fold("DYNAMORPH_PT_shake_test")
    yield from sidebar.unfold("DYNAMORPH_PT_compare")
    target = settings().targets[1]
    before = target.stiffness
    yield from sidebar.press("dynamorph.swap_slot")
    yield from until(lambda: settings().live.slot == "B", "slot B")
    target.stiffness = 4.0 * before
    yield from sidebar.press("dynamorph.swap_slot")
    yield from until(lambda: settings().live.slot == "A", "slot A")
    assert target.stiffness == before
    yield from sidebar.press("dynamorph.swap_slot")
    yield from until(lambda: target.stiffness == 4.0 * before, "the settings of slot B")
    yield from sidebar.press("dynamorph.swap_slot")
    yield from until(lambda: target.stiffness == before, "the settings of slot A")


@step("Live off")
def live_off():
    yield from sidebar.press("dynamorph.live")
    yield from until(lambda: not addon("run.live").is_on(skin()), "Live to be off")
    assert keys() == ["Basis", "flexed", "Pose 1"]
    assert not any(block.mute for block in skin().data.shape_keys.key_blocks)
    assert moved(limb.FLEXED + 1, limb.FLEXED + 4) == 0.0
    yield from sidebar.fold("DYNAMORPH_PT_compare")
