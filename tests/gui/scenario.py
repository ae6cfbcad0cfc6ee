# SPDX-License-Identifier: GPL-3.0-or-later
"""What an artist does with a fresh rigged arm, click by click, in a Blender window: run by tools/gui_test.py.

The first ten actions, the installation among them, lead to a baked character that plays.
"""

from __future__ import annotations

import importlib
import sys
import time
from pathlib import Path

import bpy
import numpy as np

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS), str(TESTS / "gui")]

import driver  # noqa: E402
import limb  # noqa: E402
from bpy_extras.view3d_utils import location_3d_to_region_2d  # noqa: E402
from driver import Region, measure, step, until, window  # noqa: E402
from mathutils import Euler  # noqa: E402

view = Region("VIEW_3D")
viewport = Region("VIEW_3D", "WINDOW")
sidebar = Region("VIEW_3D", "UI")
properties = Region("PROPERTIES", "WINDOW")
tabs = Region("PROPERTIES", "NAVIGATION_BAR")
timeline = Region("DOPESHEET_EDITOR", "WINDOW")
start = time.monotonic()


def arm():
    return bpy.data.objects["Arm"]


def settings():
    return arm().dynamorph


def jobs():
    return importlib.import_module("bl_ext.user_default.dynamic_morph_targets.jobs")


def key_names() -> list[str]:
    return [block.name for block in arm().data.shape_keys.key_blocks]


def baked() -> list[str]:
    return [key.name for key in settings().bake.keys]


def points(frame: int) -> np.ndarray:
    """The arm as it is shown at a frame: (V, 3)."""
    bpy.context.scene.frame_set(frame)
    mesh = arm().evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    found = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.attributes["position"].data.foreach_get("vector", found.ravel())
    return found


def wobble() -> float:
    """How far the skin moves after the rig has stopped, metres."""
    now = bpy.context.scene.frame_current
    moved = np.abs(points(limb.FLEXED + 1) - points(limb.FLEXED + 4)).max()
    bpy.context.scene.frame_set(now)
    return float(moved)


def job_done(limit=120.0):
    yield from until(lambda: jobs().running is None, "the end of the job", limit)


# Ten actions ---------------------------------------------------------------------------------------------------------


@step("A fresh rigged arm")
def open_scene():
    """Not by hand: the installation, action 1, is tools/gui_test.py's, and this scene is where the artist begins."""
    limb.make_limb()
    eye = view.area.spaces.active.region_3d
    eye.view_location, eye.view_distance = (0.3, 0.0, 0.1), 0.9
    eye.view_rotation = Euler((1.3, 0.0, 0.3)).to_quaternion()
    properties.area.spaces.active.context = "OBJECT"
    yield from driver.drawn()
    measure("Blender", f"{bpy.app.version_string}, Python {sys.version.split()[0]}")
    measure("Character", f"{len(arm().data.vertices)} vertices, {limb.LAST} frames")
    assert wobble() == 0.0, "the arm moves by itself before anything was done"


@step("Select the mesh")
def select_mesh():
    x, y, *_ = viewport.box
    on_skin = location_3d_to_region_2d(viewport.region, view.area.spaces.active.region_3d, (0.1, 0.0, 0.0))
    yield from driver.click((x + on_skin.x, y + on_skin.y))
    yield from until(lambda: bpy.context.view_layer.objects.active == arm(), "the arm to be selected")


@step("Open the sidebar")
def open_sidebar():
    yield from viewport.key("N")
    yield from until(lambda: sidebar.region.width > 1, "the sidebar")


@step("Open the tab", picture=view)
def open_tab():
    x, _, width, _ = sidebar.box
    yield from sidebar.pick(x + width - 10, lambda: sidebar.region.active_panel_category == "Dynamorph", "the tab")


@step("Add Soft Skin", picture=sidebar)
def add_soft_skin():
    yield from sidebar.press("dynamorph.add_soft_skin")
    yield from until(lambda: settings().targets, "a neutral target")


@step("Open the mesh's shape keys")
def open_shape_keys():
    x, _, width, _ = tabs.box
    yield from tabs.pick(x + width / 2, lambda: properties.area.spaces.active.context == "DATA", "Object Data")


@step("Select the sculpted key", picture=properties)
def select_key():
    _, row = yield from properties.find('key_blocks["flexed"].value')
    yield from driver.click((properties.box[0] + 80, row))
    yield from until(lambda: arm().active_shape_key.name == "flexed", "the key 'flexed' to be active")


@step("Pose: go to the flexed frame")
def pose():
    x, y, _, height = timeline.box
    across, _ = timeline.region.view2d.view_to_region(limb.FLEXED, 0, clip=False)
    yield from driver.click((x + across, y + height - 12))
    yield from until(lambda: bpy.context.scene.frame_current == limb.FLEXED, f"frame {limb.FLEXED}")


@step("Add Target", picture=view)
def add_target():
    yield from sidebar.press("dynamorph.add_target")
    yield from until(lambda: len(settings().targets) == 2, "a second target")
    assert settings().targets[1].bone_names() == ("forearm",)


@step("Build Model", picture=sidebar)
def build():
    yield from sidebar.press("dynamorph.build")
    yield from until(lambda: jobs().running, "the build to begin")
    yield from job_done()
    assert settings().model.content_id and settings().model.summary


@step("Bake", picture=sidebar)
def bake():
    yield from sidebar.press("dynamorph.bake")
    yield from until(lambda: jobs().running, "the bake to begin")
    yield from job_done()
    measure("From installed to baked", f"{driver.actions} actions, {time.monotonic() - start:.0f} s")
    assert driver.actions <= 10
    assert baked() and wobble() > 1e-4


@step("Undo the bake")
def undo():
    keys = key_names()
    yield from viewport.key("Z", ctrl=True)
    yield from until(lambda: not baked(), "the bake to be undone")
    assert key_names() == ["Basis", "flexed"] and settings().model.content_id
    yield from viewport.key("Z", ctrl=True, shift=True)
    yield from until(baked, "the bake to be redone")
    assert key_names() == keys and wobble() > 1e-4


@step("Play", picture=view)
def play():
    shown = []
    bpy.app.handlers.frame_change_pre.append(begin := lambda *_: shown.append([time.perf_counter()]))
    bpy.app.handlers.frame_change_post.append(end := lambda *_: shown[-1].append(time.perf_counter()))
    yield from viewport.key("SPACE")
    yield from until(lambda: window().screen.is_animation_playing, "the playback")
    yield from until(lambda: len(shown) > 24, "25 frames", 60)
    yield from viewport.key("SPACE")
    yield from until(lambda: not window().screen.is_animation_playing, "the end of the playback")
    bpy.app.handlers.frame_change_pre.remove(begin)
    bpy.app.handlers.frame_change_post.remove(end)
    fps = (len(shown) - 1) / (shown[-1][0] - shown[0][0])
    evaluation = np.median([done - begun for begun, done in shown])
    measure("Playback, software OpenGL", f"{fps:.0f} of {bpy.context.scene.render.fps} frames/s")
    measure("Evaluation of a frame", f"{1e3 * evaluation:.1f} ms")
    bpy.context.scene.frame_set(limb.FLEXED + 1)  # the same picture each time


# Change of mind ------------------------------------------------------------------------------------------------------


@step("Change the stiffness, bake again", picture=sidebar)
def change_stiffness():
    before, model = wobble(), settings().model.content_id
    yield from sidebar.enter("targets[1].stiffness", "5000")
    assert settings().targets[1].stiffness == 5000
    begin = time.monotonic()
    yield from sidebar.press("dynamorph.bake")
    yield from until(lambda: jobs().running, "the bake to begin")
    yield from job_done()
    measure("A changed stiffness, baked", f"{time.monotonic() - begin:.1f} s")
    assert settings().model.content_id == model, "a new stiffness rebuilt the model"
    assert wobble() > 1.2 * before


@step("Free Bake")
def free_bake():
    yield from sidebar.press("dynamorph.free_bake")
    yield from until(lambda: not baked(), "the bake to be freed")
    assert key_names() == ["Basis", "flexed"] and wobble() == 0.0


# Esc -----------------------------------------------------------------------------------------------------------------


def simulates(job) -> bool:
    return job.message.startswith("Simulating")


def cancelled(name: str, button: str, when, picture=None):
    """Press `button`, and Esc as soon as when(job) holds."""
    before = key_names(), baked(), settings().model.content_id
    position = yield from sidebar.find(button)
    begin = time.monotonic()
    yield from driver.click(position)
    yield from until(lambda: jobs().running, "the job to begin", 60)
    measure(f"Window held at the start, {name}", f"{time.monotonic() - begin:.2f} s")
    yield from until(lambda: jobs().running is None or when(jobs().running), f"the job to get there: {name}", 60)
    assert jobs().running, "the job was done before Esc could be pressed"
    if picture:
        yield from driver.keep(picture, sidebar)
    begin = time.perf_counter()
    driver.send("ESC", "PRESS", viewport.middle)
    yield from until(lambda: jobs().running is None, "the job to be gone", 30)
    latency = time.perf_counter() - begin
    driver.send("ESC", "RELEASE", viewport.middle)
    measure(f"Esc, {name}", f"{latency:.2f} s")
    assert latency < 2.0  # two tenths of a second on a machine that does nothing else
    assert (key_names(), baked(), settings().model.content_id) == before


@step("Esc while it builds")
def cancel_build():
    yield from cancelled("building", "dynamorph.build", lambda job: job.fraction > 0.3)


@step("Esc while it simulates")
def cancel_simulation():
    bpy.context.scene.frame_end = 2000
    yield from sidebar.unfold("simulation.substeps", above="dynamorph.bake")
    yield from sidebar.enter("simulation.substeps", "20")
    assert settings().simulation.substeps == 20
    yield from cancelled("simulating", "dynamorph.bake", simulates)


@step("Esc while it simulates every node")
def cancel_full():
    bpy.context.scene.frame_end = limb.LAST
    settings().simulation.substeps = 0
    settings().model.solver = "FULL"
    yield from cancelled("simulating every node", "dynamorph.bake", simulates, picture="baking")


driver.run()
