# SPDX-License-Identifier: GPL-3.0-or-later
"""A model built where that is necessary, a shot simulated and written: the order of the phases, thread and progress."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np

from ..core import engine
from ..core.baked import Bake
from ..core.character import Character
from ..core.errors import Cancelled
from ..core.judge import Verdict
from ..core.message import Message
from ..core.rig_samples import RigSamples
from ..core.settings import SimulationSettings
from ..scene import rig_motion
from ..scene.skin import ObjectHandle, SceneHandle
from . import bake_input, bake_result
from .bake_input import Request, RigReader
from .bake_result import Writer
from .computation import READ, Computation
from .job_data import BakeInput, Outcome, Progress

if TYPE_CHECKING:  # it needs the engine
    from ..core.model import Model


class Job(Progress):
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
        super().__init__()
        options = {"name": obj.name, "frames": frames, "substeps": substeps, "folder": folder, **options}
        self.request = Request(ObjectHandle.of(obj), SceneHandle.present(), goal=goal, **options)
        self.thread = threading.Thread()  # the last one that was started
        self._error: BaseException | None = None

    @property
    def name(self) -> str:
        return self.request.name

    @property
    def outcome(self) -> Outcome:
        return self.computation.outcome

    @property
    def character(self) -> Character:
        return self.outcome.character

    @property
    def settings(self) -> SimulationSettings:
        return self.input.settings

    @property
    def reasons(self) -> list[str]:
        """Why the model was built."""
        return self.input.reasons

    @property
    def model(self) -> Model:
        return self.outcome.model

    @property
    def result(self) -> Bake:
        return self.outcome.bake

    @property
    def report(self) -> dict:
        """What the simulation reported."""
        return self.outcome.report

    @property
    def verdict(self) -> Verdict:
        return self.outcome.verdict

    @property
    def warnings(self) -> list[str]:
        return [*self.input.notes, *self.outcome.warnings]

    def summary(self) -> str:
        """One line for the artist."""
        return bake_result.summary(self.input, self.outcome, self.seconds)

    # Reading: main thread --------------------------------------------------------------------------------------------

    def read(self) -> None:
        """Check and read the character and its settings. Raises as `bake_input.read`."""
        self.message = "Reading the character"
        with self.request.scene.as_context():
            self.input = bake_input.read(self.request)
            self.computation = Computation(self.input, self)
            self._reader = RigReader(self.request, self.input)
            self._reader.begin_chunk(self.computation.done)

    def sample(self, seconds: float = np.inf) -> bool:
        """Read the moving rig, if the job needs it, for about so long; True when the chunk is read."""
        sampling = self._reader.sampling
        if sampling is None:
            return True
        with self.stage("sample rig"), self.request.scene.as_context():
            done = self._reader.advance(seconds, self.computation.previous)
        before, progress = self.fraction, self.part(self.computation.read_from, READ)
        progress(sampling.done / sampling.count, Message("Reading frame {frame}", frame=sampling.frame))
        self.fraction = max(before, self.fraction)  # another chunk than the first
        return done

    def next_chunk(self) -> bool:
        """Whether there is another chunk to be read and computed, after one is."""
        if not self.computation.needs_chunk:
            return False
        with self.request.scene.as_context():
            self._reader.begin_chunk(self.computation.done)
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
        if self.canceled:
            raise Cancelled
        if self._error:
            raise self._error
        return True

    def _start(self, work: Callable[..., None], *args: object) -> None:
        name = f"dynamorph {self.name}"
        self.thread = threading.Thread(target=self._work, args=[work, *args], name=name, daemon=True)
        self.thread.start()

    def _work(self, work: Callable[..., None], *args: object) -> None:
        try:
            work(*args)
        except engine.engine_errors() as error:  # the engine does not know whose cage it works on
            named = f"'{self.name}'" in str(error)
            self._error = error if named else type(error)(f"'{self.name}': {error}")
        except BaseException as error:  # raised again in the main thread, by wait
            self._error = error

    # Writing: main thread --------------------------------------------------------------------------------------------

    def must_wait(self) -> bool:
        """Whether nothing can be written yet: Blender renders what is there, or the artist went on in Edit Mode, which
        has a mesh of its own.
        """
        if rig_motion.render_runs():
            self.message = "Waiting for the render to end"
            return True
        handles = (self.request.target, *bake_input.handles(self.input.followers))
        if self.input.is_bake and any(handle.find().mode == "EDIT" for handle in handles):
            self.message = "Waiting for you to leave Edit Mode"
            return True
        return False

    def target(self) -> bpy.types.Object:
        """The object that the results are for. Raises SceneError when they do not fit it any more."""
        return bake_result.target(self.request, self.input)

    def writer(self) -> Writer:
        """What writes the results."""
        self._reader.free()
        return Writer(self.request, self.input, self.outcome, self)
