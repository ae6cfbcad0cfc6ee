# SPDX-License-Identifier: GPL-3.0-or-later
"""Build and Bake as one path for the button, the command line and scripts.

The work has three parts: `read` reads Blender, `compute` waits for what is computed, in a window by another process
(see `child`), `write` changes Blender all at once, so that it is one undo step and an error before it changes nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack
from typing import Any

import numpy as np

from ...core.errors import Cancelled, SceneError
from ...core.message import joined
from ...core.motion.rig_samples import RigSamples
from ...core.time_left import TimeLeft
from ...scene import events
from ..remembered import work
from ..work import task
from ..work.child import Child, Here
from ..work.computation import Computations, Draft, checked
from ..work.job_data import Outcome
from ..work.task import UNDONE, W, Work
from . import together
from .bake_input import handles
from .bake_result import write_all
from .job import Job

OFTEN = 0.1  # seconds from one look at the progress to the next, where no window waits


class Batch:
    """Jobs one after the other. All are written when all are done: one undo step, or nothing.

    goal: the button's, as in Job, or "BAKE_ALL". worker: where `Computations` are, once the jobs are read. tick(self):
    is called about ten times a second while no window waits for what is computed.
    """

    def __init__(self, jobs: Sequence[Job], goal: str):
        self.jobs = jobs
        self.goal = goal
        self.undone = False  # by the user, since it began
        self.time_left = TimeLeft()
        self.tick: Callable[[Batch], object] | None = None
        self._ticked = 0.0
        self._at = jobs[0]
        self._groups: list[list[Job]] = []  # when they are read: those in one are simulated together
        self.worker: Child | Here | None = None

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

    def steps(self, seconds: float = np.inf) -> Iterator[None]:
        """The work. Yields when it has blocked the window for about so many seconds, and while another process
        computes. Raises Cancelled, SceneError and what the computations raise.
        """
        yield from self.read(seconds)
        yield from self.compute(seconds)
        yield from self.write()
        if self.worker:
            self.worker.leave()

    def read(self, seconds: float = np.inf) -> Iterator[None]:
        """The first part of the work: all that the jobs begin with, and the first chunk of their rigs."""
        for job in self.jobs:
            self._at = job
            with job.progress.turn():
                job.read()
                self._check_shared(job)
                yield from self._turn(reading=True)
        bakes = all(job.input.is_bake for job in self.jobs)
        self._groups = together.groups(self.jobs) if bakes else [[job] for job in self.jobs]
        self.worker = task.worker_for(Computations, [job.input for job in self.jobs], heard=self._hear, name=self.name)
        if self.worker.object:
            for job, computation in zip(self.jobs, self.worker.object.each, strict=True):
                job.computation = computation
        for number, job in enumerate(self.jobs):
            if job.needs_cage:
                job.take_cage((yield from self._asked([job], "make_cage", number)))
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

    def compute(self, seconds: float = np.inf) -> Iterator[None]:
        """The second part, for which the rest of the rigs is read. Nothing is written."""
        for group in self._groups:
            numbers = [self.jobs.index(job) for job in group]
            garments = together.garments(group)
            while True:
                chunks = [job.end_chunk() for job in group]
                found = yield from self._asked(group, "compute", numbers, chunks, garments)
                if isinstance(found[0], Outcome):  # of one, or of all of them
                    break
                for job, done in zip(group, found, strict=True):
                    job.begin_chunk(done)
                for job in group:
                    yield from self._turn(reading=True)
                    yield from self._sampled(job, seconds)
            for job, outcome in zip(group, found, strict=True):
                job.take_outcome(outcome)

    def write(self) -> Iterator[None]:
        """The last part, when all can be written: all of it, or nothing."""
        while waiting := next((job for job in self.jobs if job.must_wait()), None):
            self._at = waiting
            yield from self._turn()
        for group in self._groups:
            if len(group) > 1:
                together.note_inputs(group)
        writers = [job.writer() for job in self.jobs]
        with ExitStack() as turns:
            for job in self.jobs:
                turns.enter_context(job.progress.turn())
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

    def _asked(self, group: Sequence[Job], name: str, *args: Any) -> Generator[None, None, Any]:
        """What the method of `Computations` returns, which works for these jobs."""
        assert self.worker is not None  # the jobs are read
        self._at = group[0]
        with ExitStack() as turns:
            for job in group:
                turns.enter_context(job.progress.turn())
            answer = self.worker.call(name, *args)
            while True:
                try:
                    next(answer)
                except StopIteration as end:
                    return end.value
                yield from self._turn()

    def _hear(self, news: Draft | Sequence[tuple[float, str]]) -> None:
        """What `Computations` report. Raises Cancelled."""
        if isinstance(news, Draft):
            self.jobs[news.number].draft = news.model, news.character
            return
        for job, (fraction, message) in zip(self.jobs, news, strict=True):
            job.progress.fraction = max(fraction, job.progress.fraction)
            job.progress.message = message or job.progress.message
        self._check_canceled()
        if self.tick and time.monotonic() - self._ticked > OFTEN:
            self._ticked = time.monotonic()
            self.tick(self)

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
        self._check_canceled()
        if reading and self.undone:
            raise SceneError(UNDONE, name=self.name)

    def _check_canceled(self) -> None:
        if any(job.progress.canceled for job in self.jobs):
            raise Cancelled

    def stop(self) -> None:
        """End what computes, and remove the files that it has begun, if the results are not written."""
        if self.worker:
            self.worker.end()
        for job in self.jobs:
            job.discard()


def run(job: Job, tick: Callable[[Batch], object] | None = None) -> None:
    """The whole job at once. tick: as in `Batch`."""
    run_all(Batch([job], job.request.goal), tick)


def run_all(whole: W, tick: Callable[[W], object] | None = None) -> None:
    """All jobs at once, or nothing. tick: as in `Batch`."""
    whole.tick = tick
    _exhaust(whole, whole.steps())


def read_rig(job: Job) -> RigSamples:
    """All that a job reads, at once, to be used otherwise: returns the rig."""
    batch = Batch([job], job.request.goal)
    _exhaust(batch, batch.read())
    chunk = job.end_chunk()
    assert chunk is not None  # it is asked of a job that reads one
    return checked(chunk, job.input.character)[0]


def _exhaust(whole: Work, steps: Iterator[None]) -> None:
    """All steps; if one fails, nothing is left of them."""
    try:
        for _ in steps:
            if whole.tick:
                whole.tick(whole)
    except BaseException:
        whole.stop()
        raise


def stop() -> None:
    """Cancel what runs: Blender, its file or the add-on goes away."""
    if work.running:
        work.running.stop()
        work.running = None
