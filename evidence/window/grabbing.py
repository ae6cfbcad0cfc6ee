# SPDX-License-Identifier: GPL-3.0-or-later
"""The tool that grabs the skin: drag, slap and hold it, while Blender stands and while it plays."""

from __future__ import annotations

import bpy
import driver
import frames
import limb
import numpy as np
from driver import Task, measure, step, until
from editors import addon, close, keys, on_screen, physics, properties, settings, shown, sidebar, skin, view, viewport

PULLED = 70  # pixels
before: list[str]  # shape keys


def place() -> tuple[float, float]:
    """On the screen, a part of the arm that is soft."""
    return on_screen((limb.BALL_AT, 0.0, 0.0))


def press_and_pull(pixels: int):
    """The mouse stays pressed."""
    x, y = place()
    yield from driver.move((x, y))
    driver.send("LEFTMOUSE", "PRESS", (x, y))
    yield 0.05
    for part in np.linspace(0.0, pixels, 8):
        driver.send("MOUSEMOVE", "NOTHING", (x, y + part))
        yield 0.05


def release(pixels: int, **details):
    x, y = place()
    driver.send("LEFTMOUSE", "RELEASE", (x, y + pixels), **details)
    yield 0.1


def keep(name: str):
    """A picture for the guide, of the viewport while the mouse is pressed."""
    yield from driver.drawn_smoothly()
    driver.photograph(name, viewport.box)
    driver.result["pictures"].append(name)


def hands() -> dict:
    current = addon("run.remembered").live.hands
    return current.holds if current else {}


@step("Live, and the tool")
def choose():
    global before
    before = keys()
    yield from physics("grips")
    yield from frames.click(limb.FIRST)
    yield from sidebar.press("dynamorph.live")
    yield from until(lambda: addon("run.live").is_on(skin()), "Live to be on")
    view.area.spaces.active.show_region_toolbar = True
    with viewport.context():
        bpy.ops.wm.tool_set_by_id(name="dynamorph.grab_object")
    yield from driver.drawn()


@step("Drag the skin, and let go")
def drag():
    still = shown()
    yield from press_and_pull(PULLED)
    yield 1.0
    pulled = shown()
    yield from keep("grab_drag")
    measure("Dragged skin", f"{1e3 * np.abs(pulled - still).max():.1f} mm, {len(hands())} hand")
    assert len(hands()) == 1 and np.abs(pulled - still).max() > 1e-3
    yield from release(PULLED)
    along, rings = (pulled - still).ravel(), []
    for _ in range(20):
        yield 0.05
        rings.append(float((shown() - still).ravel() @ along / (along @ along)))
    driver.photograph("grab_ring", view.box)
    measure("Skin that was let go", f"swings back to {min(rings):.2f} of the pull")
    assert not hands() and min(rings) < 0.5


@step("Slap it")
def slap():
    still = shown()
    yield from driver.click(place())
    yield from until(lambda: np.abs(shown() - still).max() > 1e-3, "the skin to move")
    driver.photograph("grab_slap", view.box)
    yield from until(lambda: not hands(), "the hand to let go")


@step("Leave the hand there, and let go of all")
def hold():
    yield from press_and_pull(PULLED)
    yield from release(PULLED, shift=True)
    yield 0.5
    assert len(hands()) == 1
    driver.photograph("grab_hold", view.box)
    x, y = place()
    driver.send("LEFTMOUSE", "PRESS", (x + 40, y))
    yield 0.1
    assert len(hands()) == 2
    yield from driver.tap("ESC", (x + 40, y))
    yield from until(lambda: not hands(), "all hands to let go")
    driver.send("LEFTMOUSE", "RELEASE", (x + 40, y))
    yield 0.1


@step("While Blender plays")
def playing():
    yield from frames.click(limb.FIRST)
    yield from frames.start()
    yield from press_and_pull(PULLED)
    yield 1.0
    driver.photograph("grab_playing", view.box)
    assert len(hands()) == 1
    yield from release(PULLED)
    yield from until(lambda: not hands(), "the hand to let go")
    yield from frames.stop()
    assert not addon("run.live").problem(skin())


@step("Record Drags, and see them again")
def record():
    yield from frames.click(limb.FIRST)
    yield from properties.press("dynamorph.record_drags")
    yield from frames.start()
    yield from press_and_pull(PULLED)
    yield 1.0
    yield from release(PULLED)
    yield from until(lambda: not hands(), "the hand to let go")
    yield from frames.stop()
    yield from properties.press("dynamorph.record_drags")
    yield from until(lambda: len(settings().grips), "the drags to be kept")
    yield from driver.drawn()
    driver.photograph("grab_recorded", properties.box)
    yield from properties.press("dynamorph.remove_grip")
    yield from until(lambda: not len(settings().grips), "the drags to be removed")


@step("Let an object hold the skin")
def attach():
    """An empty beside the arm, selected before it: not by hand, because that is Blender's."""
    hook = bpy.data.objects.new("Hook", None)
    bpy.context.scene.collection.objects.link(hook)
    hook.location = limb.BALL_AT, -0.2, 0.0
    hook.select_set(True)
    yield from driver.drawn()
    task = Task("an object that holds the skin, with a key", 2)
    yield from properties.press("dynamorph.attach")
    yield from until(lambda: len(settings().grips) == 1, "the grip")
    x, y = yield from properties.find("grips[0].strength")
    driver.actions += 1
    yield from driver.move((x, y))
    yield from driver.tap("I", (x, y))
    yield from until(lambda: addon("scene.animation").moved_paths(skin()), "the key")
    task.done()
    driver.photograph("grip_attached", properties.box)
    before_it = shown()
    hook.location.y -= 0.08
    bpy.context.scene.frame_set(limb.FIRST)
    for frame in range(limb.FIRST, limb.FIRST + 12):
        bpy.context.scene.frame_set(frame)
    pulled = float(np.abs(shown() - before_it).max())
    measure("Skin that an object pulls", f"{1e3 * pulled:.1f} mm of 80")
    assert pulled > 0.01 and not addon("run.live").problem(skin())
    yield from properties.press("dynamorph.remove_grip")
    yield from until(lambda: not len(settings().grips), "the grip to be removed")
    bpy.data.objects.remove(hook)
    skin().animation_data_clear()
    yield from close("grips")


@step("Without it")
def without():
    """The next part goes on as if nothing had been."""
    with viewport.context():
        bpy.ops.wm.tool_set_by_id(name="builtin.select_box")
    view.area.spaces.active.show_region_toolbar = False
    yield from sidebar.press("dynamorph.live")
    yield from until(lambda: not addon("run.live").is_on(skin()), "Live to be off")
    assert keys() == before
