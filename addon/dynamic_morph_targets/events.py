# SPDX-License-Identifier: GPL-3.0-or-later
"""What the add-on asks of Blender's events and windows: to be called back, and to draw again."""

from __future__ import annotations

from collections.abc import Callable

import bpy

PANELS = {("VIEW_3D", "UI"), ("PROPERTIES", "WINDOW")}  # types of area and region
VIEWS = {("VIEW_3D", "WINDOW")}


def add(handlers: dict[str, Callable]):
    """handlers: functions by the name of their list in bpy.app.handlers."""
    for name, handler in handlers.items():
        getattr(bpy.app.handlers, name).append(handler)


def remove(handlers: dict[str, Callable]):
    for name, handler in handlers.items():
        getattr(bpy.app.handlers, name).remove(handler)


def soon(look: Callable, seconds: float):
    """Call `look` by a timer when nobody has asked for it for so long."""
    forget(look)
    bpy.app.timers.register(look, first_interval=seconds)


def forget(look: Callable):
    if bpy.app.timers.is_registered(look):
        bpy.app.timers.unregister(look)


def redraw(regions: set[tuple[str, str]]):
    """Let these kinds of regions draw again, and no others: a 3D view may take longer than what the panels show."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            for region in area.regions:
                if (area.type, region.type) in regions:
                    region.tag_redraw()


def redraw_status(context):
    """Let the status bar of a window draw again, where `panels.draw_status` says what runs."""
    context.workspace.status_text_set(None)
