# SPDX-License-Identifier: GPL-3.0-or-later
"""Twelve actions of somebody who has the zip and a rigged arm: the last of them leaves a baked character."""

from __future__ import annotations

import sys
import time

import bpy
import driver
import frames
import limb
import openings
from driver import WORK, Task, measure, step, until
from editors import (
    ADDON,
    addon,
    baked,
    job,
    job_done,
    keys,
    moved,
    on_screen,
    properties,
    settings,
    sidebar,
    skin,
    view,
    viewport,
)
from mathutils import Euler

start = 0.0  # when the zip was dropped
task: Task  # begun with the mesh that is selected


def wobble() -> float:
    """How far the skin moves after the rig has stopped, meters."""
    return moved(limb.FLEXED + 1, limb.FLEXED + 4)


@step("A rigged arm, as it was left")
def open_scene():
    """Not by hand. The Properties editor shows the shape keys, because that is where they were made."""
    limb.make_limb()
    eye = view.area.spaces.active.region_3d
    eye.view_location, eye.view_distance = (0.3, 0.0, 0.1), 0.9
    eye.view_rotation = Euler((1.3, 0.0, 0.3)).to_quaternion()
    properties.area.spaces.active.context = "DATA"
    view.area.spaces.active.show_region_hud = False  # it would hide the graph in pictures
    overlay = view.area.spaces.active.overlay
    overlay.show_floor = overlay.show_axis_x = overlay.show_axis_y = False  # slow without a graphics card
    yield from driver.drawn()
    measure("Blender", f"{bpy.app.version_string}, Python {sys.version.split()[0]}")
    measure("Arm", f"{len(skin().data.vertices)} vertices, {limb.LAST} frames")
    assert wobble() == 0.0, "the arm moves by itself before anything was done"


@step("Drop the zip onto the window")
def drop_zip():
    """Events cannot drop files: this calls what Blender calls then."""
    global start
    (archive,) = WORK.glob("*.zip")
    yield from driver.move(viewport.middle)
    start = time.monotonic()
    driver.actions += 1
    with viewport.context():
        bpy.ops.extensions.package_install_files("INVOKE_DEFAULT", url=str(archive))
    yield from driver.drawn()
    x, y = viewport.middle
    driver.photograph("install", (x - 480, y - 120, 640, 230))
    driver.result["pictures"].append("install")


@step("Confirm")
def install():
    yield from viewport.key("RET")
    yield from until(lambda: ADDON in bpy.context.preferences.addons, "the extension to be installed and enabled", 60)
    measure("Installed", f"{time.monotonic() - start:.0f} s")
    openings.watch()


@step("Select the mesh")
def select_mesh():
    global task
    task = Task("from a rigged mesh to skin that jiggles in Live", 4)
    yield from driver.click(on_screen((0.1, 0.0, 0.0)))
    yield from until(lambda: bpy.context.view_layer.objects.active == skin(), "the arm to be selected")


@step("Open the sidebar")
def open_sidebar():
    yield from viewport.key("N")
    yield from until(lambda: sidebar.region.width > 1, "the sidebar")


@step("Open the tab", picture=view)
def open_tab():
    x, _, width, _ = sidebar.box
    yield from sidebar.pick(x + width - 10, lambda: sidebar.region.active_panel_category == "Dynamorph", "the tab")


@step("Add Soft Skin")
def add_soft_skin():
    """It ends with Live on, after a hop in which other clicks do nothing, and the animation plays."""
    clicked = time.monotonic()  # with the way of the mouse
    yield from sidebar.press("dynamorph.add_soft_skin")
    yield from until(lambda: settings().targets, "a neutral target")
    seen = time.monotonic()
    yield from until(lambda: settings().live.key.name, "Live to be on", 60.0)  # and lent to the hop at once
    shown, modes = time.monotonic(), addon("run.remembered").live.sessions[skin().session_uid].tissue.modes
    yield from until(lambda: addon("run.remembered").live.preview is None, "the end of the hop")
    yield from until(frames.is_playing, "the animation to play")
    yield from until(lambda: job() is None, "all of its modes")
    whole = addon("run.remembered").live.sessions[skin().session_uid].tissue.modes
    assert modes < whole and frames.is_playing(), (modes, whole, frames.is_playing())
    measure("From Add Soft Skin to its progress, to Live", f"{seen - clicked:.1f} s, {shown - clicked:.1f} s")
    task.done()


@step("Space stops it")
def stop():
    yield from frames.stop()
    bpy.context.scene.frame_set(1)


@step("Select the sculpted key")
def select_key():
    _, row = yield from properties.find('key_blocks["flexed"].value')
    yield from driver.click((properties.box[0] + 80, row))
    yield from until(lambda: skin().active_shape_key.name == "flexed", "the key 'flexed' to be active")


@step("Go to the frame where the arm is flexed")
def pose():
    yield from frames.click(limb.FLEXED)


@step("Open Targets")
def open_targets():
    yield from sidebar.unfold("DYNAMORPH_PT_targets")


@step("Add Target", picture=view)
def add_target():
    yield from sidebar.press("dynamorph.add_target")
    yield from until(lambda: len(settings().targets) == 2, "a second target")
    assert settings().targets[1].bone_names() == ("forearm",)


@step("Bake")
def bake():
    yield from sidebar.press("dynamorph.bake")
    yield from job_done()
    measure("From the zip to a baked arm", f"{driver.actions} actions, {time.monotonic() - start:.0f} s")
    assert driver.actions == 12
    assert settings().model.content_id and baked() and wobble() > 1e-4


@step("Undo the bake, and redo it")
def undo():
    """Without it there is what Add Soft Skin has made: a model without the target, and Live."""
    before = keys()
    yield from viewport.key("Z", ctrl=True)
    yield from until(lambda: not baked(), "the bake to be undone")
    assert keys() == ["Basis", "flexed", "Dynamorph Live"] and len(settings().modes)
    yield from viewport.key("Z", ctrl=True, shift=True)
    yield from until(baked, "the bake to be redone")
    assert keys() == before and wobble() > 1e-4 and settings().model.content_id


@step("Play it", picture=view)
def play():
    played = yield from frames.play(12)
    measure("Playback of the bake", f"{played.fps:.0f} of {bpy.context.scene.render.fps} frames/s")
    measure("Evaluation of a baked frame", f"{played.milliseconds:.1f} ms")
    bpy.context.scene.frame_set(limb.FLEXED + 1)  # the same picture each time
