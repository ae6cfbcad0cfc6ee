# SPDX-License-Identifier: GPL-3.0-or-later
"""The editors of Blender's window, the add-on as it was installed, and what the scene looks like: for all steps."""

from __future__ import annotations

import importlib

import bpy
import driver
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from driver import Region, click, is_button, tap, until

ADDON = "bl_ext.user_default.dynamic_morph_targets"
LIST, LIST_ROW = 130, 21  # pixels: more than a list of targets has, and a row of it
CHECKBOX = 0.7  # across the sidebar, in such a row

view = Region("VIEW_3D")
viewport = Region("VIEW_3D", "WINDOW")
sidebar = Region("VIEW_3D", "UI")
properties = Region("PROPERTIES", "WINDOW")
tabs = Region("PROPERTIES", "NAVIGATION_BAR")
timeline = Region("DOPESHEET_EDITOR", "WINDOW")


def addon(module: str):
    """A module of the installed add-on, such as run.live."""
    return importlib.import_module(f"{ADDON}.{module}")


def skin():
    """The soft skin that is being worked on: the only mesh of the scene with a rig."""
    return next(obj for obj in bpy.context.scene.objects if obj.type == "MESH" and obj.find_armature())


def rig():
    return skin().find_armature()


def settings():
    return skin().dynamorph


def keys() -> list[str]:
    return [block.name for block in skin().data.shape_keys.key_blocks]


def baked() -> list[str]:
    return [key.name for key in settings().bake.keys]


def job():
    """What is being built or baked, or None."""
    return addon("run.remembered").work.running


def job_done(limit=120.0):
    """Wait for a job that a button has just begun."""
    yield from until(job, "the job to begin")
    yield from until(lambda: job() is None, "the end of the job", limit)


def shown() -> np.ndarray:
    """The skin as Blender shows it now: (V, 3)."""
    mesh = skin().evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    points = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.attributes["position"].data.foreach_get("vector", points.ravel())
    return points


def shown_at(frame: int) -> np.ndarray:
    """The same at a frame, which is then the present one."""
    bpy.context.scene.frame_set(frame)
    return shown()


def moved(first: int, second: int) -> float:
    """How far the skin is at a frame from where it is at another, meters."""
    now = bpy.context.scene.frame_current
    moved = float(np.abs(shown_at(first) - shown_at(second)).max())
    bpy.context.scene.frame_set(now)
    return moved


def key_points() -> np.ndarray:
    """The active shape key: (V, 3)."""
    block = skin().active_shape_key
    points = np.empty((len(block.points), 3), np.float32)
    block.points.foreach_get("co", points.ravel())
    return points


def differing(before: np.ndarray) -> float:
    """The share of the viewport's pixels that are clearly others than in a picture of it from before."""
    return float((np.abs(driver.pixels(viewport.box) - before).max(axis=-1) > 0.1).mean())


def on_screen(point) -> tuple[float, float]:
    """Where a point in the scene is, pixels of the window."""
    x, y, *_ = viewport.box
    place = location_3d_to_region_2d(viewport.region, view.area.spaces.active.region_3d, point)
    return x + place.x, y + place.y


def physics(*sections: str):
    """Click the Physics tab, and open sections in it."""
    space = properties.area.spaces.active
    if space.context != "PHYSICS":
        x, _, width, _ = tabs.box
        yield from tabs.pick(x + width // 2, lambda: space.context == "PHYSICS", "the Physics tab")
    for section in sections:
        yield from properties.unfold(f"DYNAMORPH_PT_{section}")


def close(*sections: str):
    """Close sections of the Physics tab again."""
    for section in sections:
        yield from properties.fold(f"DYNAMORPH_PT_{section}")


def select_target(index: int):
    """Click a row of the list of targets."""
    yield from sidebar.unfold("DYNAMORPH_PT_targets")
    yield from sidebar.scroll("WHEELUPMOUSE", 40)
    _, row = yield from sidebar.find("dynamorph.active_target_index")  # all rows are this button
    left, _, width, _ = sidebar.box
    checkbox = left + int(CHECKBOX * width)  # of every target but the neutral one, by which its row is known
    for y in range(row + LIST, row - LIST, -LIST_ROW // 3):
        if is_button((yield from sidebar.look((checkbox, y))), f"targets[{max(index, 1)}].mute"):
            break
    else:
        raise AssertionError(f"no row of target {index} in the sidebar")
    middle = y - LIST_ROW // 3 + (LIST_ROW if index == 0 else 0)  # the neutral one is above the first
    yield from click((left + width // 2, middle))
    yield from until(lambda: settings().active_target_index == index, f"target {index} to be selected")


def from_menu(*arrows: str):
    """Choose from the menu beside the list of targets, with the arrow keys."""
    x, row = yield from sidebar.find("dynamorph.remove_target")
    yield from click((x, row - 30))
    yield 0.2
    for key in (*arrows, "RET"):
        yield from tap(key, (x, row - 30))
        yield 0.1
