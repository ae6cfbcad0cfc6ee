# SPDX-License-Identifier: GPL-3.0-or-later
"""A model built where that is necessary, a shot simulated and written: the order of the phases, thread and progress."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ..core import blas, engine
from ..core.errors import Cancelled
from ..core.message import Message
from ..core.motion.rig_samples import RigSamples
from ..scene import events
from ..scene.skin import ObjectHandle, SceneHandle
from . import bake_input, bake_result
from .bake_input import Request, RigReader
from .bake_result import Writer
from .computation import READ, Computation
from .job_data import BakeInput, Outcome, Progress


class Job:
    """Builds the model of one object if that is necessary, and with the goal "BAKE" simulates and writes the shot.

    What it reads of Blender is in `input`, what a thread computes of that in `outcome`; `batch.Batch` runs it. goal,
    frames, substeps, folder and the other options: as in `Request`. It belongs to the scene that it is made in.
    """

    input: BakeInput  # this and the next are there after `read`
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
        self.thread = threading.Thread()  # the last one that was started
        self._error: BaseException | None = None

    @property
    def name(self) -> str:
        return self.request.name

    @property
    def outcome(self) -> Outcome:
        return self.computation.outcome

    @property
    def warnings(self) -> list[str]:
        """What to tell the artist at the end."""
        return [*self.input.notes, *self.outcome.warnings]

    def summary(self) -> str:
        """One line for the artist."""
        return bake_result.summary(self.input, self.outcome, self.progress.waited)

    # Reading: main thread --------------------------------------------------------------------------------------------

    def read(self) -> None:
        """Check and read the character and its settings. Raises as `bake_input.read`."""
        self.progress.message = "Reading the character"
        with self.request.scene.as_context():
            self.input = bake_input.read(self.request)
            self.computation = Computation(self.input, self.progress)
            self._reader = RigReader(self.request, self.input)
            self.next_chunk()

    def sample(self, seconds: float = np.inf) -> bool:
        """Read the moving rig, if the job needs it, for about so long; True when the chunk is read."""
        sampling = self._reader.sampling
        if sampling is None:
            return True
        progress, before = self.progress, self.progress.fraction
        with progress.stage("sample rig"), self.request.scene.as_context():
            done = self._reader.advance(seconds, self.computation.previous)
        report = progress.part(self.computation.read_from, READ)
        report(sampling.done / sampling.count, Message("Reading frame {frame}", frame=sampling.frame))
        progress.fraction = max(before, progress.fraction)  # another chunk than the first
        return done

    def leave_rig(self) -> None:
        """Nothing more of the chunk is read."""
        self._reader.leave()

    def next_chunk(self) -> bool:
        """Whether there is another chunk to be read and computed; then it begins."""
        wanted = self.computation.wanted
        if wanted is None:
            return False
        with self.request.scene.as_context():
            self._reader.begin_chunk(wanted)
        return True

    def take_rig(self) -> RigSamples:
        """What was read of the rig, for others than the job. Raises SceneError."""
        sampling = self._reader.end_chunk()
        assert sampling is not None  # it is asked of a job that reads one
        return self.computation.take(sampling.samples())

    # Computing: a thread ---------------------------------------------------------------------------------------------

    def start_cage(self) -> None:
        """Begin to make the cage, in a thread."""
        self._start(self.computation.make_cage)

    def start(self) -> None:
        """Begin to compute with what was read, in a thread."""
        self._start(self.computation.compute, self._reader.end_chunk())

    def wait(self, timeout: float | None = None) -> bool:
        """True when the computation has ended. Raises what it raised, Cancelled if the user stopped it."""
        self.thread.join(timeout)
        if self.thread.is_alive():
            return False
        if self.progress.canceled:
            raise Cancelled
        if self._error and not isinstance(self._error, threading.BrokenBarrierError):  # another one has the reason
            raise self._error
        return True

    def _start(self, work: Callable[..., None], *args: object) -> None:
        name = f"dynamorph {self.name}"
        self.thread = threading.Thread(target=self._work, args=[work, *args], name=name, daemon=True)
        self.thread.start()

    def _work(self, work: Callable[..., None], *args: object) -> None:
        try:
            with blas.one_thread():
                work(*args)
        except engine.engine_errors() as error:  # the engine does not know whose cage it works on
            named = f"'{self.name}'" in str(error)
            self._error = error if named else type(error)(f"'{self.name}': {error}")
        except BaseException as error:  # raised again in the main thread, by wait
            self._error = error
        if self._error or self.progress.canceled:
            self.leave()

    def leave(self) -> None:
        """Let nobody wait for it any more."""
        if self.computation.together:
            self.computation.together.leave()

    # Writing: main thread --------------------------------------------------------------------------------------------

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
