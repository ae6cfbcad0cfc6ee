# SPDX-License-Identifier: GPL-3.0-or-later
"""A model built where that is necessary, a shot simulated and written: what a job reads and writes of Blender."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.character import Character
from ...core.message import Message
from ...core.model.model import Model
from ...core.motion.rig_samples import RigSamples
from ...io import disk
from ...scene import events
from ...scene.motion import read_poses
from ...scene.skin import ObjectHandle, SceneHandle
from ..work.computation import CAGE, READ, Computation, needs_cage
from ..work.job_data import BakeInput, Outcome, Progress
from . import bake_input, bake_result
from .bake_input import Request, RigReader
from .bake_result import Writer


class Job:
    """Builds the model of one object if that is necessary, and with the goal "BAKE" simulates and writes the shot.

    What it reads of Blender is in `input`, what is computed of that in `outcome`; `batch.Batch` runs it. goal, frames,
    substeps, folder and the other options: as in `Request`. It belongs to the scene that it is made in. computation: of
    one that is computed in this process. draft: a model and the character with its materials, to be played while the
    rest is built.
    """

    input: BakeInput  # this is there after `read`
    outcome: Outcome  # this at the end
    computation: Computation
    _reader: RigReader

    def __init__(
        self,
        obj: bpy.types.Object,
        goal: str,
        frames: tuple[int, int] | None = None,
        substeps: int | None = None,
        folder: Path | None = None,
        **options: Any,
    ):
        options = {"name": obj.name, "frames": frames, "substeps": substeps, "folder": folder, **options}
        self.request = Request(ObjectHandle.of(obj), SceneHandle.present(), goal=goal, **options)
        self.progress = Progress()
        self.draft: tuple[Model, Character] | None = None
        self._cage: Model | None = None  # that Blender poses
        self._read_from = 0.0  # of the job, the part that is done before the rig is read

    @property
    def name(self) -> str:
        return self.request.name

    @property
    def warnings(self) -> list[str]:
        """What to tell the artist at the end."""
        return [*self.input.notes, *self.outcome.warnings]

    def summary(self) -> str:
        """One line for the artist."""
        return bake_result.summary(self.input, self.outcome, self.progress.waited)

    # Reading ---------------------------------------------------------------------------------------------------------

    def read(self) -> None:
        """Check and read the character and its settings. Raises as `bake_input.read`."""
        self.progress.message = "Reading the character"
        with self.request.scene.as_context():
            self.input = bake_input.read(self.request)
            self._cage = self.input.previous
            if self.input.is_bake and self.request.stored:
                read_poses.forget(self.request.target.find())
            self._reader = RigReader(self.request, self.input)
            self.begin_chunk(len(self.input.resumed.get("coordinates", ())))

    @property
    def needs_cage(self) -> bool:
        """Whether a cage must be made before the rig is read, because Blender poses its nodes."""
        return needs_cage(self.input)

    def take_cage(self, cage: Model) -> None:
        self._cage, self._read_from = cage, CAGE

    def begin_chunk(self, done: int) -> None:
        """Read what follows after so many states of the shot."""
        with self.request.scene.as_context():
            self._reader.begin_chunk(done)

    def sample(self, seconds: float = np.inf) -> bool:
        """Read the moving rig, if the job needs it, for about so long; True when the chunk is read."""
        sampling = self._reader.sampling
        if sampling is None:
            return True
        progress, before = self.progress, self.progress.fraction
        with progress.stage("sample rig"), self.request.scene.as_context():
            done = self._reader.advance(seconds, self._cage)
        report = progress.part(self._read_from, READ)
        report(sampling.done / sampling.count, Message("Reading frame {frame}", frame=sampling.frame))
        progress.fraction = max(before, progress.fraction)  # another chunk than the first
        return done

    def leave_rig(self) -> None:
        """Nothing more of the chunk is read."""
        self._reader.leave()

    def end_chunk(self) -> RigSamples | None:
        """The chunk that was read; None for a job that needs no rig. Raises SceneError."""
        sampling = self._reader.end_chunk()
        if sampling is None:
            return None
        samples = sampling.samples()
        if self.input.is_bake and self.request.stored:
            read_poses.remember(self.request.target.find(), sampling.start, samples[:: sampling.substeps])
        return samples

    def take_outcome(self, outcome: Outcome) -> None:
        self.outcome = outcome
        if self.input.model is not None:  # of which the other process has made something
            self.input.model.made.update(outcome.model.made)
        seconds = self.progress.seconds
        for stage, took in outcome.seconds.items():
            seconds[stage] = seconds.get(stage, 0.0) + took

    # Writing ---------------------------------------------------------------------------------------------------------

    def must_wait(self) -> bool:
        """Whether nothing can be written yet: Blender renders what is there, or the artist went on in Edit Mode, which
        has a mesh of its own.
        """
        if events.render_runs():
            self.progress.message = "Waiting for the render to end"
            return True
        handles = (self.request.target, *bake_input.handles(self.input.character.attachments))
        if self.input.is_bake and any(handle.find().mode == "EDIT" for handle in handles):
            self.progress.message = "Waiting for you to leave Edit Mode"
            return True
        return False

    def target(self) -> bpy.types.Object:
        """The object that the results are for. Raises SceneError when they do not fit it any more."""
        return bake_result.target(self.request, self.input)

    def writer(self) -> Writer:
        """What writes the results."""
        self._reader.free()
        return Writer(self.request, self.input, self.outcome, self.progress)

    def discard(self) -> None:
        """Remove the files that it has begun. Nothing is written."""
        for file in self.input.unfinished.values() if hasattr(self, "input") else ():
            disk.discard(file)
