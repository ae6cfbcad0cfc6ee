# SPDX-License-Identifier: GPL-3.0-or-later
"""Build and Bake as one path for the button, the command line and scripts.

The work has three parts: `read` reads Blender, `compute` runs in threads that never touch bpy, `write` changes Blender
all at once, so that it is one undo step and an error before it changes nothing.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from typing import Protocol, TypeVar

import numpy as np

from ..core.errors import Cancelled, SceneError
from ..core.message import joined
from ..core.motion.rig_samples import RigSamples
from ..core.time_left import TimeLeft
from ..scene import events
from . import together
from .bake_input import handles
from .bake_result import write_all
from .job import Job

UNDONE = "The scene was undone while '{name}' was read: nothing was written, start again"


class Work(Protocol):
    """What a window runs step by step, with progress: a `Batch`, or a `task.Task`. undone: by the user, meanwhile."""

    goal: str
    undone: bool
    time_left: TimeLeft

    @property
    def name(self) -> str: ...
    @property
    def message(self) -> str: ...
    @property
    def fraction(self) -> float: ...
    def steps(self, seconds: float = ..., pause: float = ...) -> Iterator[None]: ...
    def cancel(self) -> None: ...
    def abandon(self) -> None: ...
    def stop(self) -> None: ...


running: Work | None = None  # the work whose progress the panels draw
winding_down: list[threading.Thread] = []  # of canceled jobs: the engine has not noticed yet


W = TypeVar("W", bound=Work)


class Batch:
    """Jobs one after the other. All are written when all are done: one undo step, or nothing.

    goal: the button's, as in Job, or "BAKE_ALL".
    """

    def __init__(self, jobs: Sequence[Job], goal: str):
        self.jobs = jobs
        self.goal = goal
        self.undone = False  # by the user, since it began
        self.time_left = TimeLeft()
        self._at = jobs[0]
        self._groups: list[list[Job]] = []  # when they are read: those in one are simulated together

    @property
    def name(self) -> str:
        return self._at.name

    @property
    def message(self) -> str:
        message = self._at.progress.message
        return joined(": ", [self.name, message]) if len(self.jobs) > 1 else message

    @property
    def fraction(self) -> float:
        return sum(job.progress.fraction for job in self.jobs) / len(self.jobs)

    def cancel(self) -> None:
        for job in self.jobs:
            job.progress.canceled = True

    def steps(self, seconds: float = np.inf, pause: float = 0.1) -> Iterator[None]:
        """The work, main thread. Yields when it has blocked that for about so many seconds, and every `pause` seconds
        while a thread computes. Raises Cancelled, SceneError and what the threads raise.
        """
        yield from self.read(seconds, pause)
        yield from self.compute(seconds, pause)
        yield from self.write()

    def read(self, seconds: float = np.inf, pause: float = 0.1) -> Iterator[None]:
        """The first part of the work: all that the jobs begin with, and the first chunk of their rigs."""
        for job in self.jobs:
            self._at = job
            with job.progress.turn():
                job.read()
                self._check_shared(job)
                yield from self._turn(reading=True)
        bakes = all(job.input.is_bake for job in self.jobs)
        self._groups = together.groups(self.jobs) if bakes else [[job] for job in self.jobs]
        for job in self.jobs:
            if job.computation.needs_cage:
                self._at = job
                with job.progress.turn():
                    job.start_cage()
                    while not job.wait(pause):
                        yield from self._turn(reading=True)
        for job in self.jobs:
            yield from self._sampled(job, seconds)

    def _check_shared(self, job: Job) -> None:
        """Refuse a mesh that another job, which was read before, carries along too. Raises SceneError."""
        for other in self.jobs[: self.jobs.index(job)]:
            shared = {*handles(job.input.character.attachments)}.intersection(
                handles(other.input.character.attachments)
            )
            if shared and other.request.target != job.request.target:
                raise SceneError(
                    "'{name}' is attached to '{one}' and to '{other}': remove it from the Attachments of one of them",
                    name=shared.pop().name,
                    one=other.name,
                    other=job.name,
                )

    def compute(self, seconds: float = np.inf, pause: float = 0.1) -> Iterator[None]:
        """The second part, for which the rest of the rigs is read. Nothing is written."""
        for group in self._groups:
            yield from self._computed(group, pause)
            while sum(job.next_chunk() for job in group):  # all of a group, or none
                for job in group:
                    yield from self._turn(reading=True)
                    yield from self._sampled(job, seconds)
                yield from self._computed(group, pause)

    def write(self) -> Iterator[None]:
        """The last part, when all can be written: all of it, or nothing."""
        while waiting := next((job for job in self.jobs if job.must_wait()), None):
            self._at = waiting
            yield from self._turn()
        for group in self._groups:
            if len(group) > 1:
                together.note_inputs(group)
        writers = [job.writer() for job in self.jobs]
        write_all([writer for writer in writers if writer.request.stored])

    def _sampled(self, job: Job, seconds: float) -> Iterator[None]:
        self._at = job
        try:
            while self._waits_for_render(job):
                yield from self._turn(reading=True)
            with job.progress.turn():
                while self._waits_for_render(job) or not job.sample(seconds):
                    yield from self._turn(reading=True)
        finally:
            job.leave_rig()

    def _computed(self, group: Sequence[Job], pause: float) -> Iterator[None]:
        with ExitStack() as turns:
            for job in group:
                turns.enter_context(job.progress.turn())
                job.start()
            for job in group:
                self._at = job
                while not job.wait(pause):
                    yield from self._turn()

    def _waits_for_render(self, job: Job) -> bool:
        """Whether Blender renders, beside which no rig can be read."""
        if events.render_runs():
            job.progress.message = "Waiting for the render to end"
            return True
        return False

    def _turn(self, reading: bool = False) -> Iterator[None]:
        """The window's turn, and what came of it."""
        self.time_left.learn(time.monotonic(), self.fraction)
        yield
        if self._at.progress.canceled:
            raise Cancelled
        if reading and self.undone:
            raise SceneError(UNDONE, name=self.name)

    def abandon(self) -> None:
        """Cancel, and leave the thread to end when the engine notices; its result is dropped."""
        self.cancel()
        self._part()
        winding_down[:] = [thread for thread in (*winding_down, *self._threads()) if thread.is_alive()]

    def stop(self) -> None:
        """Cancel, and wait until the thread has left the engine."""
        self.cancel()
        self._part()
        for thread in self._threads():
            thread.join()

    def _part(self) -> None:
        """Let no thread wait for another one."""
        for group in self._groups:
            group[0].leave()

    def _threads(self) -> list[threading.Thread]:
        return [job.thread for job in self.jobs if job.thread.is_alive()]


def run(job: Job, tick: Callable[[Batch], object] | None = None) -> None:
    """The whole job at once. tick(its batch) is called in the main thread about ten times a second."""
    run_all(Batch([job], job.request.goal), tick)


def run_all(work: W, tick: Callable[[W], object] | None = None) -> None:
    """All jobs at once, or nothing. tick(work): as in `run`."""
    _exhaust(work, work.steps(), tick)


def read_rig(job: Job) -> RigSamples:
    """All that a job reads, at once, to be used otherwise: returns the rig."""
    batch = Batch([job], job.request.goal)
    _exhaust(batch, batch.read())
    return job.take_rig()


def _exhaust(work: W, steps: Iterator[None], tick: Callable[[W], object] | None = None) -> None:
    """All steps; if one fails, no thread is left."""
    try:
        for _ in steps:
            if tick:
                tick(work)
    except BaseException:
        work.stop()
        raise


def stop() -> None:
    """Cancel what runs, and wait until no thread is in the engine: Blender, its file or the add-on goes away."""
    global running
    if running:
        running.stop()
        running = None
    while winding_down:
        winding_down.pop().join()
