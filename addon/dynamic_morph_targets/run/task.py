# SPDX-License-Identifier: GPL-3.0-or-later
"""Work that is no job, in chunks: a window shows its progress, and Esc stops it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Generator, Iterator
from typing import Any, TypeVar

import bpy
import numpy as np

from ..core import blas
from ..core.errors import Cancelled, SceneError
from ..core.time_left import TimeLeft
from ..scene.skin import ObjectHandle, SceneHandle
from . import batch

T = TypeVar("T")
Chunks = Generator[tuple[float, str], None, T]  # yields (fraction, message) after each chunk, and returns the result
Report = Callable[[float], None]


class Task:
    """Runs where a `batch.Batch` does. result: of its chunks, when all are done. goal: the button's.

    The chunks run in the main thread and in the scene that it is made in; between them Blender does other things.
    """

    def __init__(self, obj: bpy.types.Object, goal: str, chunks: Chunks[Any]):
        self.object, self.scene = ObjectHandle.of(obj), SceneHandle.present()
        self.name, self.goal = obj.name, goal
        self.fraction, self.message = 0.0, ""
        self.undone = False  # by the user, since it began
        self.time_left = TimeLeft()
        self.result: Any = None
        self._chunks, self._canceled = chunks, False

    def steps(self, seconds: float = np.inf, pause: float = 0.1) -> Iterator[None]:
        """As `batch.Batch.steps`."""
        ends = time.monotonic() + seconds
        while not self._canceled and self._next():
            if self.undone:
                raise SceneError(batch.UNDONE, name=self.name)
            self.time_left.learn(time.monotonic(), self.fraction)
            if time.monotonic() > ends:
                yield
                ends = time.monotonic() + seconds
        if self._canceled:
            raise Cancelled

    def _next(self) -> bool:
        """Whether there was another chunk to be done."""
        with self.scene.as_context():
            try:
                self.fraction, self.message = next(self._chunks)
            except StopIteration as end:
                self.result = end.value
                return False
        return True

    def cancel(self) -> None:
        self._canceled = True

    def abandon(self) -> None:
        """End what the chunks have begun; a thread runs until its next report."""
        self.cancel()
        self._chunks.close()

    stop = abandon  # `batch.stop` waits for the thread


def in_thread(work: Callable[[Report], T], message: str) -> Chunks[T]:
    """The chunks of work in a thread, which never touches bpy and calls its argument with the fraction that is done."""
    found: list[T] = []
    errors: list[BaseException] = []
    fraction, wanted = 0.0, True

    def report(done: float) -> None:
        nonlocal fraction
        fraction = done
        if not wanted:
            raise Cancelled

    def run() -> None:
        try:
            with blas.one_thread():
                found.append(work(report))
        except BaseException as error:  # raised again in the main thread
            errors.append(error)

    thread = threading.Thread(target=run, name="dynamorph task", daemon=True)
    thread.start()
    try:
        while thread.is_alive():
            yield fraction, message
            thread.join(0.02)
    finally:
        wanted = False
        if thread.is_alive():
            batch.winding_down.append(thread)
    if errors:
        raise errors[0]
    return found[0]
