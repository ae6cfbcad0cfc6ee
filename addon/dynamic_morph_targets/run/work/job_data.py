# SPDX-License-Identifier: GPL-3.0-or-later
"""The plain values that the phases of a job exchange, without bpy."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from ...core.character import Character
from ...core.model.model import Model
from ...core.motion.baked import Bake
from ...core.motion.rig_samples import RigSamples
from ...core.result.judge import Verdict
from ...core.settings import OutputSettings, SimulationSettings
from ...io.cache_dir import CacheDir

# The stages of a build in an artist's words.
STAGES = {
    "Meshing": "Wrapping a cage",
    "Embedding": "Placing the skin in it",
    "Target shapes": "Carrying over the sculpts",
    "Draft": "Finding how it swings",
    "Modes": "Finding how it swings in detail",
    "Polynomials": "Preparing its motion",
    "Rehearsal": "Rehearsing the shot",
}


class Progress:
    """How far a job is. changed(): is called when `part` was told."""

    def __init__(self, changed: Callable[[], None] = lambda: None) -> None:
        self.fraction = 0.0
        self.message = ""
        self.canceled = False  # by the user
        self.seconds: dict[str, float] = {}  # by stage
        self._waited, self._began = 0.0, 0.0  # seconds of the turns that have ended, and when the present one began
        self._changed = changed

    @contextmanager
    def turn(self) -> Iterator[None]:
        """Measure the seconds that somebody waits for the job."""
        self._began = time.perf_counter()
        try:
            yield
        finally:
            self._waited, self._began = self.waited, 0.0

    @property
    def waited(self) -> float:
        """Seconds of the job's turns until now, with all that Blender did between their slices."""
        return self._waited + (time.perf_counter() - self._began if self._began else 0.0)

    def part(self, begin: float, end: float) -> Callable[[float, str], bool]:
        """progress(fraction, message) -> True for a part of the work."""

        def progress(fraction: float, message: str) -> bool:
            self.fraction = begin + (end - begin) * fraction
            self.message = STAGES.get(message, message)
            self._changed()
            return True

        return progress

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure the seconds that it takes."""
        began = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began


@dataclass(repr=False, eq=False)
class BakeInput:
    """Everything that is read of Blender for a job, except the moving rig.

    name: of the job, for messages. goal: BUILD, BUILD_CAGE or BAKE. inputs: the settings that the bake depends on.
    before: the bake into which these frames go. notes: warnings that are reported and not stored: panels find them by
    themselves, or they are about this run alone.
    """

    name: str
    goal: str
    character: Character
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    # The model.
    previous: Model | None = None  # that of the object, or of another process; its cage may be used again
    model: Model | None = None  # that one, if it is up to date
    cached_model: Model | None = None
    cache_dir: CacheDir | None = None  # where built models and unfinished bakes are kept for other processes
    caches_model: bool = False
    reasons: list[str] = field(default_factory=list)  # why the model must be built
    built_from: str = ""  # the settings, as JSON
    drafts: bool = False  # whether a draft of the model is asked for, to be played while the rest is built
    live: SimulationSettings | None = None  # with which Live goes on with the model
    # The shot.
    has_shot: bool = False  # otherwise only a model is built, no rig is read, and the fields below are not set
    settings: SimulationSettings = field(init=False)
    solver: str = field(init=False)  # its quality, REDUCED or FULL, which need not be that of the model
    inputs: dict = field(default_factory=dict)
    keyed: tuple[str, ...] = ()  # paths of settings that change over the shot
    whole: bool = True  # it is read as one chunk
    together: tuple[str, ...] = ()  # names of the other bodies that press on this one in one piece of work
    frames_per_chunk: int = 0  # how many frames of the rig are read at once
    before: Bake | None = None
    resumable: bool = False  # whether another process can go on with it where there is a cache folder
    kept: Path | None = None  # the file there that keeps it for other processes while it is unfinished
    resumed: dict = field(default_factory=dict)  # what another process stored there
    first: RigSamples | None = None  # the rig at the first frame, if that was resumed
    # What the result becomes.
    output: OutputSettings | None = None  # None: no form in Blender
    caches: Path = field(init=False)  # the folder of the .blend, beside which point caches are written
    cache_files: dict[str, Path] = field(default_factory=dict)  # other paths for them, by mesh
    unfinished: dict[str, Path] = field(default_factory=dict)  # where they are written first, by mesh

    @property
    def is_bake(self) -> bool:
        return self.goal == "BAKE"

    @property
    def only_cage(self) -> bool:
        return self.goal == "BUILD_CAGE"

    @property
    def simulated(self) -> Character:
        """The character with the quality of the shot."""
        return self.character.with_settings(solver=self.solver)

    @property
    def is_probed(self) -> bool:
        """Whether Blender poses the nodes of the cage."""
        return self.has_shot and self.character.probed and self.character.settings.method != "STATIC"


@dataclass(repr=False, eq=False)
class Outcome:
    """What was computed for a job: for a build the model, for a bake everything.

    character: with the materials that a build has found. bake: of the whole body. written: for
    each mesh its shape keys, and the file of its point cache or None.
    """

    character: Character
    model: Model = field(init=False)
    packed: bytes | None = None  # the model, if it was built
    stored: Model | None = None  # which that is of
    reference: float | None = None  # of it: `calibration.reference`
    warnings: list[str] = field(default_factory=list)
    inputs: dict = field(default_factory=dict)
    bake: Bake = field(init=False)
    report: dict = field(default_factory=dict)  # of the simulation
    verdict: Verdict = field(init=False)
    content_id: str = ""  # hash of everything that the bake was made from
    written: list[tuple[Bake, Path | None]] = field(default_factory=list)
    model_files: list[Path] = field(default_factory=list)  # that were written: in the cache folder, beside the .blend
    new_files: list[Path] = field(default_factory=list)  # new files of point caches
    beside: dict[Path, Path] = field(default_factory=dict)  # where each point cache is until it has its path
    seconds: dict[str, float] = field(default_factory=dict)  # by stage
    size: int = 0  # size of the written data in bytes
