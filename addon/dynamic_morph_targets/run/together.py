# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs whose bodies press on each other: which they are, and their shots as one. Their threads wait for each other at
each chunk, and the last one there simulates the shots of all.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence, Set
from typing import TYPE_CHECKING

from ..core.errors import SceneError
from ..core.message import Message
from ..core.motion.coupling import refusal
from ..core.motion.rig_samples import RigSamples
from ..core.motion.simulate import Shot, play_together
from ..scene import collider_state, colliders

if TYPE_CHECKING:
    from .job import Job


def groups(jobs: Sequence[Job]) -> list[list[Job]]:
    """The jobs, which are read, with those in one list whose bodies press on each other: that work will simulate their
    shots together. Raises SceneError where that cannot be.
    """
    of = {job.request.target.find(): job for job in jobs}
    for obj, job in of.items():
        for clothes, body in colliders.garments([obj, *colliders.pressed(obj)]):
            if clothes == obj and body not in of:
                job.outcome.warnings.append(
                    Message(
                        "'{name}' lies on '{body}' but is baked without it: Bake All lets them press on each other",
                        name=obj.name,
                        body=body.name,
                    )
                )
    if len(of) < len(jobs):  # one body in several ways
        return [[job] for job in jobs]
    out = [[of[obj] for obj in group] for group in colliders.pressing(of)]
    for group in out:
        if len(group) > 1:
            _join({obj: job for obj, job in of.items() if job in group})
    return out


def _join(of: dict) -> None:
    """of: jobs by object."""
    jobs = list(of.values())
    for job in jobs:
        for other in jobs[: jobs.index(job)]:
            reason = _refusal(job, other)
            if reason:
                raise SceneError(
                    "'{one}' and '{other}' press on each other, but {reason}: set both alike, or turn the Collision of "
                    "one of them off",
                    one=other.name,
                    other=job.name,
                    reason=reason,
                )
    meet = Together(len(jobs), {(clothes.name, body.name) for clothes, body in colliders.garments(list(of))})
    frames = min(job.input.frames_per_chunk for job in jobs)
    for obj, job in of.items():
        job.input.frames_per_chunk, job.computation.together = frames, meet
        job.input.together = tuple(other.name for other in jobs if other != job)
        job.outcome.inputs["together"] = list(job.input.together)
        job.outcome.inputs["colliders"] = collider_state.states(obj, job.input.together)
        job.next_chunk()
    note_inputs(jobs)


def _refusal(job: Job, other: Job) -> str:
    mine, its = job.input.settings, other.input.settings
    if mine.loop or its.loop:
        return "one of them is a loop"
    if (mine.first, mine.frame_end) != (its.first, its.frame_end):
        return "their frames differ"
    return refusal((job.input.solver, mine), (other.input.solver, its))


def note_inputs(jobs: Sequence[Job]) -> None:
    """Note in what each of these bakes is made from what those together with it are made from."""
    made_from = {job.name: collider_state.input_hash(job.outcome.inputs) for job in jobs}
    for job in jobs:
        for state in job.outcome.inputs["colliders"]:
            if state[0] in made_from:
                state[2] = made_from[state[0]]


class Together:
    """Where the threads of so many jobs meet. garments: (clothes, body), names of objects."""

    def __init__(self, count: int, garments: Set[tuple[str, str]]):
        self._barrier = threading.Barrier(count, self._play)
        self._garments = garments
        self._waiting: list[tuple[Shot, RigSamples]] = []

    def play(self, shot: Shot, rig: RigSamples) -> None:
        """As `Shot.play`, when all are here. Raises BrokenBarrierError when one of the others has left, or failed."""
        self._waiting.append((shot, rig))
        self._barrier.wait()

    def leave(self) -> None:
        """Wait for nobody any more."""
        self._barrier.abort()

    def _play(self) -> None:
        waiting, self._waiting = sorted(self._waiting, key=lambda each: each[0].player.character.name), []
        shots, rigs = zip(*waiting, strict=True)
        play_together(shots, rigs, self._garments)
