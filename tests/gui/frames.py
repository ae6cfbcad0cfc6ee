# SPDX-License-Identifier: GPL-3.0-or-later
"""What playback in the window takes, frame by frame."""

from __future__ import annotations

import time
from contextlib import contextmanager

import bpy
import numpy as np
from driver import until, window
from editors import viewport


class Playback:
    """While it is open, notes when each frame began and when it was evaluated, and when a viewport was drawn."""

    def __enter__(self):
        self.begun, self.evaluated, self.drawn = [], [], []
        handlers = bpy.app.handlers
        self._handlers = [
            (handlers.frame_change_pre, lambda *_: self.begun.append(time.perf_counter())),
            (handlers.frame_change_post, lambda *_: self.evaluated.append(time.perf_counter())),
        ]
        for handlers, handler in self._handlers:
            handlers.append(handler)
        draw = bpy.types.SpaceView3D.draw_handler_add
        self._draws = draw(lambda: self.drawn.append(time.perf_counter()), (), "WINDOW", "POST_PIXEL")
        return self

    def __exit__(self, *_error):
        for handlers, handler in self._handlers:
            handlers.remove(handler)
        bpy.types.SpaceView3D.draw_handler_remove(self._draws, "WINDOW")

    @property
    def fps(self) -> float:
        return (len(self.evaluated) - 1) / (self.evaluated[-1] - self.evaluated[0])

    @property
    def milliseconds(self) -> float:
        """Of the evaluation of a frame, with all handlers: the median."""
        count = len(self.evaluated)
        return 1e3 * float(np.median(np.subtract(self.evaluated, self.begun[:count])))


def is_playing() -> bool:
    return window().screen.is_animation_playing


def play(frames: int, seconds=60.0):
    """Play so many frames with the space bar; returns the Playback."""
    with Playback() as playback:
        yield from start()
        yield from until(lambda: len(playback.evaluated) > frames, f"{frames} frames", seconds)
        yield from stop()
    return playback


def start():
    yield from viewport.key("SPACE")
    yield from until(is_playing, "the playback")


def stop():
    yield from viewport.key("SPACE")
    yield from until(lambda: not is_playing(), "the end of the playback")


@contextmanager
def timed(module, name: str):
    """The milliseconds of each call of a module's function, while it is open."""
    function, calls = getattr(module, name), []

    def call(*args, **options):
        begin = time.perf_counter()
        try:
            return function(*args, **options)
        finally:
            calls.append(1e3 * (time.perf_counter() - begin))

    setattr(module, name, call)
    try:
        yield calls
    finally:
        setattr(module, name, function)
