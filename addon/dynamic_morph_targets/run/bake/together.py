# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs whose bodies press on each other, and are simulated as one: which they are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from ...core.errors import SceneError
from ...core.message import Message
from ...core.motion.coupling import refusal
from ...scene.motion import collider_state, colliders

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
                job.input.warnings.append(
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
    frames = min(job.input.frames_per_chunk for job in jobs)
    for obj, job in of.items():
        given = job.input
        given.frames_per_chunk = frames
        given.together = tuple(other.name for other in jobs if other != job)
        given.inputs |= {"together": [*given.together], "colliders": collider_state.states(obj, given.together)}
        job.begin_chunk(0)
    _note({job.name: job.input.inputs for job in jobs})


def garments(jobs: Sequence[Job]) -> frozenset[tuple[str, str]]:
    """Of jobs that are simulated as one: (clothes, body), names of objects."""
    if len(jobs) == 1:
        return frozenset()
    found = colliders.garments([job.request.target.find() for job in jobs])
    return frozenset((clothes.name, body.name) for clothes, body in found)


def _refusal(job: Job, other: Job) -> str:
    mine, its = job.input.settings, other.input.settings
    if mine.loop or its.loop:
        return "one of them is a loop"
    if (mine.first, mine.frame_end) != (its.first, its.frame_end):
        return "their frames differ"
    return refusal((job.input.solver, mine), (other.input.solver, its))


def note_inputs(jobs: Sequence[Job]) -> None:
    """Note in what each of these bakes is made from what those together with it are made from."""
    _note({job.name: job.outcome.inputs for job in jobs})


def _note(inputs: Mapping[str, dict]) -> None:
    made_from = {name: collider_state.input_hash(each) for name, each in inputs.items()}
    for each in inputs.values():
        for state in each["colliders"]:
            if state[0] in made_from:
                state[2] = made_from[state[0]]
