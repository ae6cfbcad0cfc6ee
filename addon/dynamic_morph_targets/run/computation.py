# SPDX-License-Identifier: GPL-3.0-or-later
"""What a job's thread computes from its input: model, motion, verdict and keys. Neither this module nor its imports
touch bpy.
"""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Generator, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Protocol

import numpy as np

from ..core import engine, errors
from ..core.character import Character
from ..core.errors import SceneError, SelfCheckError
from ..core.material import calibration
from ..core.message import Message
from ..core.model import build
from ..core.model.model import Model
from ..core.motion import baked, rig_samples, simulate
from ..core.motion.baked import Bake
from ..core.motion.prepared import prepared
from ..core.motion.rig_samples import RigSamples
from ..core.motion.simulate import Shot
from ..core.result import judge
from ..core.result.keys import as_keys, splice
from ..core.settings import OutputSettings
from ..io import disk, model_file, outputs, paths, point_cache
from .job_data import BakeInput, Outcome, Progress

CAGE = 0.1  # fraction of a job for a cage that is needed before the rig is read
READ = 0.2  # fraction of a job after which the rig is read
FADE = 5  # frames over which a part that is baked again blends into the rest


class Together(Protocol):
    """Shots that are simulated as one: `together.Together`."""

    def play(self, shot: Shot, rig: RigSamples) -> None: ...
    def leave(self) -> None: ...


class Sampling(Protocol):
    """A chunk of the rig that was read of Blender: `rig_motion.RigSampling`."""

    def samples(self) -> RigSamples: ...


class Computation:
    """Computes what a job is for, one chunk of the rig after the other, so that a long shot takes no more memory.

    wanted: how many states of the shot come before the next chunk that it needs; None when there is none. rig: the
    chunk that was simulated last. shot: the one that is simulated, or was last.
    """

    def __init__(self, given: BakeInput, progress: Progress):
        self.given, self.progress = given, progress
        self.outcome = Outcome(given.character, warnings=list(given.warnings), inputs=copy.deepcopy(given.inputs))
        if given.model is not None:
            self.outcome.model = given.model
        self.rig: RigSamples | None = None
        self.shot: Shot | None = None
        self.previous = given.previous  # a model whose cage may be used again
        self.together: Together | None = None  # with the computations of others, whose bodies press on this one
        self.read_from = 0.0  # of the job, the part that is done before the rig is read
        self._shot_from = READ  # of the job, the part that is done before the shot is simulated
        self.wanted: int | None = len(given.resumed.get("coordinates", ()))
        self._work = self._steps()

    @property
    def needs_cage(self) -> bool:
        """Whether a cage must exist before the rig is read, because Blender poses its nodes."""
        if not self.given.is_probed:
            return False
        return not (self.previous and build.has_cage(self.previous, self.given.character))

    def make_cage(self) -> None:
        """Build what must exist before the rig is read."""
        with self.progress.stage("build"):
            progress = self.progress.part(0.0, CAGE)
            self.previous = build.build_cage(self.given.character, progress, self.previous)
        self.read_from = CAGE

    def compute(self, sampling: Sampling | None = None) -> None:
        """All that can be computed before the next chunk is read. sampling: of this one, which was read.

        Raises SceneError, SelfCheckError, OSError and what the engine raises.
        """
        if sampling:
            self.take(sampling.samples())
        self.wanted = next(self._work, None)

    def take(self, samples: RigSamples) -> RigSamples:
        """Check what was read of the rig, and go on with that as `rig`. Raises SceneError."""
        before = self.rig.pose[-1] if self.rig else self.given.resumed.get("pose")
        if before is not None:  # the last frame becomes the first again
            samples = samples[1:]
        if len(samples):
            samples, found = rig_samples.keep_collapsed(samples, self.given.character.skeleton, before)
            self.outcome.warnings += [text for text in found if text not in self.outcome.warnings]
        self.rig = samples
        return samples

    def _steps(self) -> Iterator[int]:
        """The work, from chunk to chunk of the rig: yields what becomes `wanted`, and goes on when `rig` is that."""
        given, outcome = self.given, self.outcome
        if given.only_cage:
            if given.reasons:
                self._build_cage()
            return
        if given.model is None:
            self._build()
        elif given.cache_dir and given.caches_model and not given.is_bake:
            outcome.model_files.append(given.cache_dir.keep_model(given.model))
        if not given.is_bake or self.progress.canceled:
            return
        yield from self._bake()
        finish(given, outcome, self.progress)

    def _build_cage(self) -> None:
        with self.progress.stage("build"):
            model = build.build_cage(self.given.character, self.progress.part(0.0, 1.0), self.previous)
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
                model = simulate.build_for(given.character, self.rig, settings, progress, self.previous, draft)
                if given.cache_dir and given.caches_model:
                    outcome.model_files.append(given.cache_dir.keep_model(model))
        self._take_model(model)
        self._measure(model)
        if self.progress.canceled:
            return
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
        if self.progress.canceled:
            return
        character = self._calibrated()
        self._prepare(draft, character)
        self.progress.draft = draft, character

    def _prepare(self, model: Model, character: Character) -> None:
        """Make here what Live would make next in the main thread."""
        if self.given.live and model.settings.method != "STATIC":
            with suppress(*engine.expected_errors()):  # Live says what prevents it
                prepared(model, character, self.given.live)

    def _take_model(self, model: Model) -> None:
        with self.progress.stage("store model"):
            self.outcome.model = self.outcome.stored = model
            self.outcome.packed = model_file.pack(*model.to_arrays())

    def _bake(self) -> Generator[int, None, None]:
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
        self._play(shot)
        while not shot.is_complete:
            yield shot.done
            self._play(shot)
        with self.progress.stage("simulate"):
            outcome.bake, outcome.report = shot.bake(exact=given.output is None or given.output.format != "MODES")
        with self.progress.stage("judge"):
            found = shot.held, shot.touched
            outcome.verdict = judge.judge(outcome.model, outcome.character, outcome.bake, given.settings, *found)
        outcome.report["inverted_volume"] = outcome.verdict.inverted

    def _play(self, shot: Shot) -> None:
        """Simulate the shot to the end of the rig that was read."""
        given, rig = self.given, self.rig
        assert rig is not None  # a shot has one
        with self.progress.stage("simulate"):
            if self.together:
                self.together.play(shot, rig)
            else:
                shot.play(rig)
        if given.cache_dir and given.kept and len(rig):  # otherwise nothing was left to do
            given.cache_dir.keep(given.kept, shot, rig.pose[-1])


def adopt(outcome: Outcome, character: Character) -> None:
    """Continue with other materials, which are stored when the job is written."""
    outcome.character = character
    neutrals = np.cumsum([0, *(len(each.targets) for each in character.target_sets)])
    for index, target in enumerate(character.targets):
        name = "" if index == 0 else target.name
        known = outcome.inputs.get("targets", {}).get(name)
        if known is not None and (index == 0 or index not in neutrals):
            known["stiffness"] = target.material.stiffness


def finish(given: BakeInput, outcome: Outcome, progress: Progress) -> None:
    """Make the result from the simulated shot, and the messages about it. Raises SceneError, SelfCheckError,
    OSError.
    """
    for name in ("coordinates", "weights", "modes", "residual_shapes", "static"):
        if not np.isfinite(getattr(outcome.bake, name)).all():
            raise SelfCheckError(
                "'{name}': the engine's {result} are not numbers: nothing was written", name=given.name, result=name
            )
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
    try:
        whole, outcome.report["keys_error"] = as_keys(outcome.bake, output, character.to_bind)
    except errors.KeysError as refusal:
        raise SceneError("'{name}': {refusal}", name=character.name, refusal=refusal) from refusal
    bakes, all_keys = of_meshes(character, outcome.bake), of_meshes(character, whole)
    for name, points, bake, keys in zip(names, points_of, bakes, all_keys, strict=True):
        file = None
        if output.format == "PC2":
            file = _point_cache(given, outcome, name, points, bake)
        outcome.written.append((keys, file))


def _point_cache(given: BakeInput, outcome: Outcome, name: str, points: np.ndarray, bake: Bake) -> Path:
    """Write the file that plays the bake of the mesh `name`."""
    default = paths.cache_path(given.caches, name, baked.digest(bake, points, given.settings.fps))
    file = written = given.cache_files.get(name, default)
    if name in given.cache_files:  # the earlier file plays until the .blend is saved
        outputs.remove_abandoned(file)
        written = outcome.beside[file] = outputs.partial_of(file)
    if not written.exists():
        outcome.new_files.append(written)
    disk.save(written, point_cache.point_cache(bake, points))
    return file


def _content_id(given: BakeInput, outcome: Outcome) -> str:
    before = [baked.digest(given.before)] if given.before else []
    made_from = [outcome.inputs, build.dependencies(outcome.character), *before]
    return hashlib.sha256(json.dumps(made_from, sort_keys=True).encode()).hexdigest()
