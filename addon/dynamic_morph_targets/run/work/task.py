# SPDX-License-Identifier: GPL-3.0-or-later
"""Work that is no job, in chunks: a window shows its progress, and Esc stops it."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from typing import Any, Protocol, TypeVar

import bpy
import numpy as np

from ...core.errors import Cancelled, SceneError
from ...core.time_left import TimeLeft
from ...scene.skin import ObjectHandle, SceneHandle
from .child import Child, Here
from .computation import Errand

T = TypeVar("T")
Chunks = Generator[tuple[float, str], None, T]  # yields (fraction, message) after each chunk, and returns the result
UNDONE = "The scene was undone while '{name}' was read: nothing was written, start again"


class Work(Protocol):
    """What a window runs step by step, with progress: a `batch.Batch`, or a `Task`. undone: by the user, meanwhile."""

    goal: str
    undone: bool
    time_left: TimeLeft
    tick: Callable[[Any], object] | None

    @property
    def name(self) -> str: ...
    @property
    def message(self) -> str: ...
    @property
    def fraction(self) -> float: ...
    def steps(self, seconds: float = ...) -> Iterator[None]: ...
    def cancel(self) -> None: ...
    def stop(self) -> None: ...


W = TypeVar("W", bound=Work)


def worker_for(kind: Callable[..., Any], *args: Any, **options: Any) -> Child | Here:
    """Where an object computes: a window must go on meanwhile. Arguments as for `Child`."""
    if bpy.app.background:
        return Here(kind, *args, heard=options["heard"])
    return Child(kind, *args, **options)


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
        self.tick: Callable[[Task], object] | None = None
        self.result: Any = None
        self._chunks, self._canceled = chunks, False

    def steps(self, seconds: float = np.inf) -> Iterator[None]:
        """As `batch.Batch.steps`."""
        ends = time.monotonic() + seconds
        while not self._canceled and self._next():
            if self.undone:
                raise SceneError(UNDONE, name=self.name)
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

    def stop(self) -> None:
        """End what the chunks have begun."""
        self.cancel()
        self._chunks.close()


def elsewhere(work: Callable[..., T], message: str, name: str, reports: bool = False) -> Chunks[T]:
    """The chunks of work() for the object `name`, which never touches bpy: in a process of its own where a window is to
    go on. reports: work(report) calls its argument with the fraction that is done.
    """
    fraction = 0.0

    def hear(done: float) -> None:
        nonlocal fraction
        fraction = done

    worker = worker_for(Errand, heard=hear, name=name)
    answer = worker.call("run", work, reports)
    try:
        while True:
            try:
                next(answer)
            except StopIteration as end:
                return end.value
            yield fraction, message
    finally:
        worker.end()
