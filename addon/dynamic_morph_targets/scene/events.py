# SPDX-License-Identifier: GPL-3.0-or-later
"""What the add-on asks of Blender's events and windows, and how `run` learns that properties were set."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import Enum

import bpy

from ..core.errors import SceneError

PANELS = {("VIEW_3D", "UI"), ("PROPERTIES", "WINDOW")}  # types of area and region
VIEWS = {("VIEW_3D", "WINDOW")}
OURS = __package__.rpartition(".")[0]  # how our modules' names begin
EVALUATED = ("frame_change_pre", "frame_change_post", "depsgraph_update_pre", "depsgraph_update_post")


class Event(Enum):
    """What properties announce, and what is passed along."""

    SHOWN_CHANGED = "what is shown of an object's motion"  # (object)
    MESH_CHANGED = "what a built model depends on, but no setting tells: a cage, a map"  # ()
    PART_SET = "the firmness of a part of a body was set"  # (object, name of the part, firmness)
    LOOK_ASKED = "a panel shows a body that nobody has looked at as it is now"  # (look, object): to call look(object)
    WEIGHTS_ASKED = "someone wants to see the weights over the frames"  # ()


_listeners: dict[Event, list[Callable]] = {event: [] for event in Event}


def subscribe(listeners: dict[Event, Callable]) -> None:
    for event, listener in listeners.items():
        _listeners[event].append(listener)


def unsubscribe(listeners: dict[Event, Callable]) -> None:
    """Those of them that have subscribed."""
    for event, listener in listeners.items():
        if listener in _listeners[event]:
            _listeners[event].remove(listener)


def emit(event: Event, *args: object) -> None:
    for listener in _listeners[event]:
        listener(*args)


def add(handlers: dict[str, Callable]) -> None:
    """handlers: functions by the name of their list in bpy.app.handlers."""
    for name, handler in handlers.items():
        getattr(bpy.app.handlers, name).append(handler)


def remove(handlers: dict[str, Callable]) -> None:
    """Those of them that were added."""
    for name, handler in handlers.items():
        if handler in getattr(bpy.app.handlers, name):
            getattr(bpy.app.handlers, name).remove(handler)


@contextmanager
def without_handlers() -> Iterator[None]:
    """No handler is called for what Blender evaluates in the block, in a scene of ours: other add-ons' handlers would
    take its frames for the artist's, and ours do not need them. What is added in the block stays, after the others.
    See docs/decisions/0011.
    """
    lists = [getattr(bpy.app.handlers, name) for name in EVALUATED]
    kept = [list(handlers) for handlers in lists]
    for handlers in lists:
        handlers.clear()
    try:
        yield
    finally:
        for handlers, before in zip(lists, kept, strict=True):
            handlers[:0] = before


def others() -> list[Callable]:
    """What other add-ons and the file's texts let Blender call when the frame changes."""
    called = (*bpy.app.handlers.frame_change_pre, *bpy.app.handlers.frame_change_post)
    return [handler for handler in called if not str(getattr(handler, "__module__", "")).startswith(OURS)]


def soon(look: Callable, seconds: float) -> None:
    """Call `look` by a timer once it has not been asked for during so many seconds."""
    forget(look)
    bpy.app.timers.register(look, first_interval=seconds)


def forget(look: Callable) -> None:
    if bpy.app.timers.is_registered(look):
        bpy.app.timers.unregister(look)


def is_playing() -> bool:
    """Whether the animation plays in a window."""
    return any(window.screen.is_animation_playing for window in bpy.context.window_manager.windows)


def is_scrubbing() -> bool:
    """Whether the artist drags through the timeline of a window.

    Blender 5.2 crashes when a handler removes a scene meanwhile.
    """
    return any(window.screen.is_scrubbing for window in bpy.context.window_manager.windows)


def render_runs() -> bool:
    """Whether Blender renders beside this thread. Adding or removing data then makes it crash."""
    return threading.current_thread() is threading.main_thread() and bpy.app.is_job_running("RENDER")


def check_not_rendering() -> None:
    """Raises SceneError while `render_runs`."""
    if render_runs():
        raise SceneError("Blender is rendering: wait until it is done")


def redraw(regions: set[tuple[str, str]]) -> None:
    """Let these kinds of regions draw again, and no others: a 3D view may take longer than what the panels show."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            for region in area.regions:
                if (area.type, region.type) in regions:
                    region.tag_redraw()


def redraw_status(context: bpy.types.Context) -> None:
    """Let the status bar of a window draw again, where `ui/panels/sections` says what runs."""
    context.workspace.status_text_set(None)


def shown_changed(group: bpy.types.PropertyGroup, _context: bpy.types.Context) -> None:
    """update: of a property that changes what Live shows."""
    emit(Event.SHOWN_CHANGED, group.id_data)


def sampled_changed(group: bpy.types.PropertyGroup, context: bpy.types.Context) -> None:
    """update: of a number that is read with the rig, from where Blender evaluates it, which it does when it is told."""
    group.id_data.update_tag()
    shown_changed(group, context)


def mesh_changed(group: bpy.types.PropertyGroup, _context: bpy.types.Context) -> None:
    """update: of a property that chooses a mesh or a vertex group on which a model depends."""
    if group.id_data.dynamorph.model.content_id:
        emit(Event.MESH_CHANGED)
