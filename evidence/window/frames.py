# SPDX-License-Identifier: GPL-3.0-or-later
"""What playback in the window takes, frame by frame."""

from __future__ import annotations

import time
from contextlib import contextmanager

import bpy
import driver
import numpy as np
from driver import until, window
from editors import addon, timeline, viewport


class Playback:
    """While it is open, notes when each frame began and when it was evaluated, and when a viewport was drawn."""

    def __enter__(self):
        self.begun, self.evaluated, self.drawn = [], [], []
        self._handlers = [
            (bpy.app.handlers.frame_change_pre, self._noting(self.begun)),
            (bpy.app.handlers.frame_change_post, self._noting(self.evaluated)),
        ]
        (begins, begin), (ends, end) = self._handlers
        begins.insert(0, begin)  # before Live, which simulates then
        ends.append(end)
        draw = bpy.types.SpaceView3D.draw_handler_add
        self._draws = draw(lambda: self.drawn.append(time.perf_counter()), (), "WINDOW", "POST_PIXEL")
        return self

    def __exit__(self, *_error):
        for handlers, handler in self._handlers:
            handlers.remove(handler)
        bpy.types.SpaceView3D.draw_handler_remove(self._draws, "WINDOW")

    @staticmethod
    def _noting(times: list):
        def note(scene, *_):
            if scene == window().scene:  # the add-on reads rigs in a scene of its own
                times.append(time.perf_counter())

        return note

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


def play(frames: int, over=viewport):
    """Play so many frames with the space bar, the mouse over a region; returns the Playback."""
    with Playback() as playback:
        yield from start(over)
        yield from until(lambda: len(playback.evaluated) > frames, f"{frames} frames", 60)
        yield from stop(over)
    return playback


def start(over=viewport):
    yield from over.key("SPACE")
    yield from until(is_playing, "the playback")


def stop(over=viewport):
    yield from over.key("SPACE")
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


def place(frame: int) -> tuple[float, float]:
    """Where a frame is in the timeline."""
    x, y, _, height = timeline.box
    across, _ = timeline.region.view2d.view_to_region(frame, 0, clip=False)
    return x + across, y + height - 12


def scrub(first: int, last: int, meanwhile):
    """Drag from one frame to another, and call `meanwhile()` before the mouse is let go."""
    yield from driver.move(place(first))
    driver.send("LEFTMOUSE", "PRESS", place(first))
    yield 0.1
    driver.send("MOUSEMOVE", "NOTHING", place(last))
    yield from until(lambda: window().screen.is_scrubbing, "the scrubbing")
    meanwhile()
    driver.send("LEFTMOUSE", "RELEASE", place(last))
    yield from until(lambda: not window().screen.is_scrubbing, "the end of the scrubbing")


def click(frame: int):
    """Go to a frame by a click in the timeline."""
    yield from driver.click(place(frame))
    yield from until(lambda: bpy.context.scene.frame_current == frame, f"frame {frame}")


def latency(skin, target, stiffness: float):
    """Seconds from a change of a target's stiffness, while Live plays, until a picture shows its effect.

    Also why Live does not play, or ''.
    """
    live = addon("run.live")
    with Playback() as playback:
        yield from start()
        yield from until(lambda: len(playback.drawn) > 3, "the first pictures", 60)
        seen = len(playback.evaluated)
        begin = time.perf_counter()
        target.stiffness = stiffness
        yield from until(lambda: len(playback.evaluated) > seen, "the next frame", 60)
        done = playback.evaluated[-1]
        yield from until(lambda: playback.drawn[-1] > done, "the picture of it", 60)
        seconds = playback.drawn[-1] - begin
        yield from stop()
    sets = addon("run.remembered").live.sessions[skin.session_uid].tissue.character.target_sets
    used = [each.material.stiffness for target_set in sets for each in target_set.targets]
    assert stiffness in used, "the frame was simulated as before"
    return seconds, live.problem(skin)
