# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job computes from its input: model, motion, verdict and keys. Neither this module nor what it imports touches
bpy.
"""

from __future__ import annotations

import copy
import hashlib
import json
import weakref
from collections.abc import Callable, Iterator, Sequence, Set
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...core import engine
from ...core.character import Character
from ...core.errors import SelfCheckError
from ...core.material import calibration
from ...core.message import Message
from ...core.model import build
from ...core.model.model import Model
from ...core.motion import baked, rig_samples, simulate
from ...core.motion.baked import Bake
from ...core.motion.player import Player
from ...core.motion.rig_samples import RigSamples
from ...core.motion.simulate import Shot, play_together
from ...core.result import judge
from ...core.result.keys import as_keys, splice
from ...core.settings import OutputSettings
from ...io import disk, model_file, paths, point_cache
from .child import Lasting, News
from .job_data import BakeInput, Outcome, Progress

CAGE = 0.1  # fraction of a job for a cage that is needed before the rig is read
READ = 0.2  # fraction of a job after which the rig is read
FADE = 5  # frames over which a part that is baked again blends into the rest


class Draft(Lasting):
    """News of the job `number`: a model of few modes, and the character with its materials, to be played while the rest
    is built.
    """

    def __init__(self, number: int, model: Model, character: Character):
        self.number, self.model, self.character = number, model, character


class Errand:
    """A piece of work that is one call. news: gets the fraction of it that is done, where the call tells that."""

    def __init__(self, news: News):
        self._news = news

    def run(self, work: Callable[..., Any], reports: bool) -> Any:
        """What work() returns, or with reports work(report=...)."""
        return work(report=self._news) if reports else work()


class Computations:
    """What the jobs of a batch compute, by their numbers, in whichever process. news: gets a list of (fraction,
    message) of all jobs, and each `Draft`.
    """

    def __init__(self, inputs: Sequence[BakeInput], news: News):
        self._news = news
        # Not itself: the engine's simulations ask for their progress, and Python does not see such a circle.
        this = weakref.proxy(self)
        self.each = [
            Computation(given, lambda: this._tell(), partial(Computations._offer, this, k))
            for k, given in enumerate(inputs)
        ]

    def make_cage(self, number: int) -> Model:
        """What must exist before the rig of a job is read."""
        with _named(self.each[number]):
            return self.each[number].make_cage()

    def compute(
        self, numbers: Sequence[int], chunks: Sequence[RigSamples | None], garments: Set[tuple[str, str]]
    ) -> list[Outcome | int]:
        """All that can be computed before the next chunks of the rigs are read. Several jobs are simulated as one, with
        these `garments`: see `play_together`. Returns for each its outcome, or how many states come before that chunk.

        Raises SceneError, SelfCheckError, OSError and what the engine raises.
        """
        jobs = [self.each[number] for number in numbers]
        for job, chunk in zip(jobs, chunks, strict=True):
            if chunk is not None:
                job.take(chunk)
            job.go_on()
        played = [(job.shot, job.rig) for job in jobs if job.shot is not None and job.rig is not None]
        with ExitStack() as stages:
            for job in jobs:
                stages.enter_context(job.progress.stage("simulate"))
            if len(played) > 1:
                play_together([shot for shot, _ in played], [rig for _, rig in played], garments)
            for shot, rig in played if len(played) == 1 else ():
                stages.enter_context(_named(jobs[0]))
                shot.play(rig)
        for job in jobs:
            job.go_on()
        return [job.outcome if job.shot is None or job.shot.is_complete else job.shot.done for job in jobs]

    def _tell(self) -> None:
        self._news([(job.progress.fraction, job.progress.message) for job in self.each])

    def _offer(self, number: int, model: Model, character: Character) -> None:
        self._news(Draft(number, model, character))


@contextmanager
def _named(job: Computation) -> Iterator[None]:
    """Errors of the engine, which does not know whose cage it works on, name the object."""
    try:
        yield
    except engine.engine_errors() as error:
        if f"'{job.given.name}'" in str(error):
            raise
        raise type(error)(f"'{job.given.name}': {error}") from error


class Computation:
    """Computes what a job is for, one chunk of the rig after the other, so that a long shot takes no more memory.

    rig: the chunk that is simulated, or was last. shot: the one that is simulated, or was. changed(): is called when
    there is progress; offer(draft, character) when there is a draft.
    """

    def __init__(
        self, given: BakeInput, changed: Callable[[], None], offer: Callable[[Model, Character], None] | None = None
    ):
        self.given, self.progress = given, Progress(changed)
        self.outcome = Outcome(given.character, warnings=list(given.warnings), inputs=copy.deepcopy(given.inputs))
        self.outcome.seconds = self.progress.seconds
        if given.model is not None:
            self.outcome.model = given.model
        self.rig: RigSamples | None = None
        self.shot: Shot | None = None
        self._previous = given.previous  # a model whose cage may be used again
        self._shot_from = READ  # of the job, the part that is done before the shot is simulated
        self._offer_draft = offer
        self._work = self._steps()

    def make_cage(self) -> Model:
        """Build what must exist before the rig is read."""
        with self.progress.stage("build"):
            self._previous = build.build_cage(self.given.character, self.progress.part(0.0, CAGE), self._previous)
        return self._previous

    def take(self, samples: RigSamples) -> None:
        """Check what was read of the rig, and go on with that as `rig`. Raises SceneError."""
        before = self.rig.pose[-1] if self.rig else self.given.resumed.get("pose")
        self.rig, found = checked(samples, self.given.character, before)
        self.outcome.warnings += [text for text in found if text not in self.outcome.warnings]

    def go_on(self) -> None:
        """Compute until the shot is to be played to the end of `rig`, then until the next chunk is needed."""
        with _named(self):
            next(self._work, None)

    def _steps(self) -> Iterator[None]:
        """The work: yields where `go_on` ends."""
        given, outcome = self.given, self.outcome
        if given.only_cage:
            if given.reasons:
                self._build_cage()
            return
        if given.model is None:
            self._build()
        elif not given.is_bake:
            with self.progress.stage("build"):
                self.progress.message = "Preparing its motion"
                self._prepare(given.model, given.character)
            if given.cache_dir and given.caches_model:
                outcome.model_files.append(given.cache_dir.keep_model(given.model))
        if given.is_bake:
            yield from self._bake()
            finish(given, outcome, self.progress)

    def _build_cage(self) -> None:
        with self.progress.stage("build"):
            model = build.build_cage(self.given.character, self.progress.part(0.0, 1.0), self._previous)
        self._take_model(model)

    def _build(self) -> None:
        given, outcome = self.given, self.outcome
        built = 0.95 if given.character.settings.fits_shot else 0.7
        with self.progress.stage("build"):
            model = given.cached_model
            if not model:
                progress = self.progress.part(READ, built if given.is_bake else 1.0)
                settings = given.settings if given.has_shot else None
                draft = self._offer if given.drafts else None
                model = simulate.build_for(given.character, self.rig, settings, progress, self._previous, draft)
                if given.cache_dir and given.caches_model:
                    outcome.model_files.append(given.cache_dir.keep_model(model))
        self._take_model(model)
        self._measure(model)
        adopt(outcome, self._calibrated())
        self._prepare(model.with_settings(outcome.character.settings), outcome.character)
        self.progress.fraction = self._shot_from = built
        outcome.warnings += model.summary.warnings

    def _measure(self, model: Model) -> None:
        """What its targets' frequencies follow from. That does not depend on the modes: a draft's is the model's."""
        if self.outcome.reference is None:
            with self.progress.stage("measure"):
                self.outcome.reference = calibration.reference(model, self.given.character)

    def _calibrated(self) -> Character:
        assert self.outcome.reference is not None  # it was measured
        return calibration.calibrated(self.given.character, self.outcome.reference)

    def _offer(self, draft: Model) -> None:
        self._measure(draft)
        character = self._calibrated()
        self._prepare(draft, character)
        assert self._offer_draft is not None  # it is asked for
        self._offer_draft(draft, character)

    def _prepare(self, model: Model, character: Character) -> None:
        """Make here what Live would make next, while the window waits for it."""
        live = self.given.live
        if live and model.settings.method != "STATIC":
            with suppress(*engine.expected_errors()):  # Live says what prevents it
                Player(model, character, live)

    def _take_model(self, model: Model) -> None:
        with self.progress.stage("store model"):
            self.outcome.model = self.outcome.stored = model
            self.outcome.packed = model_file.pack(*model.to_arrays())

    def _bake(self) -> Iterator[None]:
        """The whole shot in its quality, with the materials of the outcome's character."""
        given, outcome = self.given, self.outcome
        outcome.character = outcome.character.with_settings(solver=given.solver)
        outcome.model = outcome.model.with_settings(outcome.character.settings)
        with self.progress.stage("simulate"):
            shot = simulate.Shot(
                outcome.model, outcome.character, given.settings, self.progress.part(self._shot_from, 1.0)
            )
            if given.first is not None:
                shot.resume(given.resumed, given.first)
        self.shot = shot
        while True:
            yield  # it is played now
            if given.cache_dir and given.kept and self.rig:  # otherwise nothing was left to do
                given.cache_dir.keep(given.kept, shot, self.rig.pose[-1])
            if shot.is_complete:
                break
            yield  # the next chunk is read now
        with self.progress.stage("simulate"):
            outcome.bake, outcome.report = shot.bake(exact=given.output is None or given.output.format != "MODES")
        check_finite(given.name, outcome.bake)
        with self.progress.stage("judge"):
            found = shot.held, shot.touched, shot.poses
            outcome.verdict = judge.judge(outcome.model, outcome.character, outcome.bake, given.settings, *found)
        outcome.report["inverted_volume"] = outcome.verdict.inverted


def needs_cage(given: BakeInput) -> bool:
    """Whether a cage must exist before the rig is read, because Blender poses its nodes."""
    if not given.is_probed:
        return False
    return not (given.previous and build.has_cage(given.previous, given.character))


def checked(
    samples: RigSamples, character: Character, before: np.ndarray | None = None
) -> tuple[RigSamples, list[str]]:
    """What was read of the rig after a pose (B, 4, 4), with a transform for each bone that collapses, and what to tell
    the artist of those.
    """
    if before is not None:  # the last frame becomes the first again
        samples = samples[1:]
    return rig_samples.keep_collapsed(samples, character.skeleton, before) if len(samples) else (samples, [])


def check_finite(name: str, bake: Bake) -> None:
    """Raises SelfCheckError for a bake of the object `name` that has values that are no numbers."""
    for result in ("coordinates", "weights", "modes", "residual_shapes", "static"):
        if not np.isfinite(getattr(bake, result)).all():
            raise SelfCheckError(
                "'{name}': the engine's {result} are not numbers: nothing was written", name=name, result=result
            )


def adopt(outcome: Outcome, character: Character) -> None:
    """Continue with other materials, which are stored when the job is written."""
    outcome.character = character
    neutrals = np.cumsum([0, *(len(each.targets) for each in character.target_sets)])
    for index, target in enumerate(character.targets):
        name = "" if index == 0 else target.name
        known = outcome.inputs.get("targets", {}).get(name)
        is_value = known is not None and isinstance(known.get("stiffness"), float)  # not what drives it
        if is_value and (index == 0 or index not in neutrals):
            known["stiffness"] = target.material.stiffness


def finish(given: BakeInput, outcome: Outcome, progress: Progress) -> None:
    """Make the result from the simulated shot, and the messages about it. Raises SceneError, OSError."""
    progress.message = "Making keys"
    with progress.stage("make keys"):
        if given.before:
            outcome.bake, outcome.report["seam"] = splice(given.before, outcome.bake, FADE, given.character.to_bind)
        if given.output:
            _make_keys(given, outcome, given.output)
            outcome.content_id = _content_id(given, outcome)
    outcome.warnings += outcome.report["warnings"]
    settings = given.settings
    first, last = outcome.model.summary.fitted or (settings.frame_start, settings.frame_end)
    uses_modes = outcome.model.settings.solver == "REDUCED"
    if uses_modes and (settings.frame_start < first or settings.frame_end > last):
        outcome.warnings.append(
            Message("The modes were fitted to frames {first} to {last}: press Build Model", first=first, last=last)
        )
    outcome.warnings += outcome.verdict.contact_texts
    if outcome.verdict.is_too_large:
        text = "{verdict}. Raise Bounce or Cage Nodes, or paint Firmness"
        if outcome.verdict.is_pressed:
            text = "{verdict}, where objects press it: move them away, raise Distance (Collision), or paint Firmness"
        outcome.warnings.append(Message(text, verdict=outcome.verdict.text))


def of_meshes(character: Character, bake: Bake) -> list[Bake]:
    """A bake of the whole body divided into one per mesh."""
    parts = (simulate.part_of(bake, each.members, each.from_body) for each in character.attachments)
    return [simulate.part_of(bake, character.own_vertices), *parts]


def _make_keys(given: BakeInput, outcome: Outcome, output: OutputSettings) -> None:
    """The form of the results apart from Blender: shape keys, and the files of point caches."""
    character = given.character
    names = character.name, *(each.name for each in character.attachments)
    points_of = character.vertices[character.own_vertices], *(each.points for each in character.attachments)
    whole, outcome.report["keys_error"] = as_keys(outcome.bake, output, character.to_bind)
    bakes, all_keys = of_meshes(character, outcome.bake), of_meshes(character, whole)
    for name, points, bake, keys in zip(names, points_of, bakes, all_keys, strict=True):
        file = None
        if output.format == "PC2":
            file = _point_cache(given, outcome, name, points, bake)
        outcome.written.append((keys, file))


def _point_cache(given: BakeInput, outcome: Outcome, name: str, points: np.ndarray, bake: Bake) -> Path:
    """Write what plays the bake of the mesh `name`, and return the path that it is for."""
    default = paths.cache_path(given.caches, name, baked.digest(bake, points, given.settings.fps))
    file = given.cache_files.get(name, default)
    written = outcome.beside[file] = given.unfinished[name]
    written.parent.mkdir(parents=True, exist_ok=True)
    disk.discard(written)  # which a process that has crashed has begun
    with disk.named(file, written):
        disk.write(written, point_cache.point_cache(bake, points))
    return file


def _content_id(given: BakeInput, outcome: Outcome) -> str:
    before = [baked.digest(given.before)] if given.before else []
    made_from = [outcome.inputs, build.dependencies(outcome.character), *before]
    return hashlib.sha256(json.dumps(made_from, sort_keys=True).encode()).hexdigest()
