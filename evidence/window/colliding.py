# SPDX-License-Identifier: GPL-3.0-or-later
"""A ball is pressed into the arm: selected together, one button, Live, and the skin gives way; and a floor."""

from __future__ import annotations

import bpy
import driver
import frames
import limb
import numpy as np
from driver import Task, measure, step, until
from editors import (
    addon,
    close,
    keys,
    on_screen,
    physics,
    properties,
    settings,
    shown,
    shown_at,
    sidebar,
    skin,
    view,
)

task: Task
before: list[str]  # shape keys


def ball():
    return bpy.data.objects["Ball"]


def depth() -> float:
    """How deep the skin is in the ball, meters; outside below 0."""
    center = np.array(ball().matrix_world.translation)
    return limb.BALL - float(np.linalg.norm(shown() - center, axis=1).min())


@step("Select a ball and the arm")
def select():
    global before
    before = keys()
    limb.make_ball()
    yield from frames.click(1)
    yield from physics("collision")
    yield from driver.click(on_screen(ball().matrix_world.translation))
    yield from until(lambda: bpy.context.view_layer.objects.active == ball(), "the ball to be selected")
    place = on_screen((0.05, 0.0, 0.0))
    yield from driver.move(place)
    for value in ("PRESS", "RELEASE"):
        driver.send("LEFTMOUSE", value, place, shift=True)
        yield 0
    yield from until(lambda: bpy.context.view_layer.objects.active == skin(), "the arm to be selected too")
    assert ball().select_get()


@step("Collide with Selected, Live, and play")
def collide():
    global task
    task = Task("from a selected ball and body to a dent in Live", 3)
    yield from properties.press("dynamorph.collide")
    yield from until(lambda: settings().collision.use, "Collision to be on")
    yield from sidebar.press("dynamorph.live")
    yield from until(lambda: addon("run.live").is_on(skin()), "Live to be on", 60)
    with frames.Playback() as playback:
        yield from frames.start()
        yield from until(lambda: len(playback.evaluated) > limb.PRESSES + 5, "the ball to press", 60)
    task.done()
    yield from frames.stop()
    assert not addon("run.live").problem(skin())
    pressed, deep = shown(), depth()
    measure("A ball in Live", f"{1e3 * limb.PRESSED:.0f} mm deep, the skin {1e3 * deep:.2f} mm in it")
    assert -0.01 < deep < 1e-3 and np.abs(pressed - shown_at(1)).max() > 0.5 * limb.PRESSED


@step("The section")
def section():
    collision = settings().collision
    yield from properties.look_into("collision.collection")
    yield from properties.look_into("excluded_group")
    yield from properties.press("collision.use_self")
    yield from until(lambda: collision.use_self, "Self Collision to be on")
    yield from properties.enter("collision.distance", "0.004")
    collision.use_friction = True
    yield from driver.drawn()
    yield from properties.enter("collision.friction", "0.3")
    assert np.allclose((collision.distance, collision.friction), (0.004, 0.3))


@step("Add Floor")
def add_floor():
    yield from properties.press("dynamorph.add_floor")
    yield from until(lambda: "Floor" in bpy.data.objects, "a floor")
    assert abs(bpy.data.objects["Floor"].location.z - shown()[:, 2].min()) < 1e-3


@step("Two bodies press on each other")
def two_bodies():
    settings().collision.property_unset("distance")
    yield from sidebar.press("dynamorph.live")
    yield from until(lambda: not addon("run.live").is_on(skin()), "Live to be off")
    bpy.data.objects["Floor"].hide_viewport = bpy.data.objects["Ball"].hide_viewport = True
    other = limb.make_other(skin())
    for obj in (other, skin()):
        obj.select_set(True)
    bpy.context.view_layer.objects.active = skin()
    yield from frames.click(1)
    yield from properties.press("dynamorph.collide")
    yield from until(lambda: other.dynamorph.collision.use, "the other arm to collide too")
    yield from driver.drawn()
    driver.photograph("pair_panel", properties.box)
    yield from sidebar.press("dynamorph.live")
    yield from until(lambda: addon("run.live").is_on(skin()), "Live to be on", 60)
    bpy.context.view_layer.objects.active = other
    yield from driver.drawn()
    yield from sidebar.press("dynamorph.live")
    yield from until(lambda: addon("run.live").is_on(other), "Live of the other one to be on", 60)
    yield from frames.click(1)
    with frames.Playback() as playback:
        yield from frames.start()
        yield from until(lambda: len(playback.evaluated) > limb.PRESSES + 5, "the arms to meet", 60)
    yield from frames.stop()
    driver.photograph("pair_live", view.box)
    sessions = addon("run.remembered").live.sessions
    measure("Two bodies in Live", f"{len(sessions[skin().session_uid].group.names)} simulated together")
    assert len(sessions[skin().session_uid].group.names) == 2
    yield from sidebar.press("dynamorph.live")
    yield from until(lambda: not addon("run.live").is_on(other), "Live of the other one to be off")
    bpy.data.objects.remove(other)
    skin().modifiers.remove(skin().modifiers["Collision"])
    bpy.context.view_layer.objects.active = skin()
    yield from driver.drawn()


@step("Without them")
def without():
    """The next part has the arm alone again."""
    yield from sidebar.press("dynamorph.live")
    yield from until(lambda: not addon("run.live").is_on(skin()), "Live to be off")
    assert keys() == before
    for name in ("Ball", "Floor"):
        bpy.data.objects.remove(bpy.data.objects[name])
    for name in ("use", "use_self", "use_friction"):
        setattr(settings().collision, name, False)
    settings().collision.property_unset("distance")
    yield from frames.click(limb.FIRST)
    yield from close("collision")
