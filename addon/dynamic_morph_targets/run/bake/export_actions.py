# SPDX-License-Identifier: GPL-3.0-or-later
"""Every Action of a character baked and exported as a clip."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

from ...core import message
from ...core.errors import ExportError, SceneError
from ...core.motion.baked import Bake
from ...core.motion.keyed import KeyedSettings
from ...core.motion.rig_samples import RigSamples
from ...core.result import keys
from ...scene import keyed
from ...scene.references import rig_of
from ...write import actions
from ...write.actions import Clip, laid_out
from ...write.bake.writer import write_keys
from ...write.display import live_key
from ...write.export.exports import FORMATS, check_bake, check_place, frames_kept, stand_ins, write_file
from ..work.computation import of_meshes
from . import batch
from .bake_input import handles
from .batch import run_all
from .job import Job


class ClipJob(Job):
    """Simulates one of the clips with the built model, and writes nothing: the motion is in `outcome`."""

    def __init__(self, obj: bpy.types.Object, clip: Clip, clips: Sequence[Clip]):
        name, frames = f"{obj.name}: {clip.name}", (clip.first, clip.last)
        changes, solver = {"loop": clip.cyclic, "samples": 1}, obj.dynamorph.model.solver
        super().__init__(obj, "BAKE", frames, name=name, solver=solver, whole=True, stored=False, changes=changes)
        self._clips = clips

    def read(self) -> None:
        super().read()
        if self.input.reasons:
            why = message.joined("; ", self.input.reasons)
            raise SceneError(
                "The model of '{name}' is out of date ({why}): press Build Model first",
                name=self.input.character.name,
                why=why,
            )

    def end_chunk(self) -> RigSamples | None:
        """Clips are at other frames than the keys of settings, so these have the values of their first keys. Channels
        that are driven follow the clip as its rig does.
        """
        samples, obj = super().end_chunk(), self.request.target.find()
        assert samples is not None  # it has a shot
        tracks = (keyed.held(obj, each) if isinstance(each, KeyedSettings) else each for each in samples.tracks)
        return replace(samples, tracks=tuple(tracks))

    def sample(self, seconds: float = np.inf) -> bool:
        with laid_out(rig_of(self.request.target.find()), self._clips):
            return super().sample(seconds)


def joined(bakes: Sequence[Bake]) -> Bake:
    """Bakes of one mesh, joined one after the other in time."""
    first, moved = bakes[0], ("coordinates", "static")
    together = {name: np.concatenate([getattr(bake, name) for bake in bakes]) for name in ("frames", "weights")}
    if all(np.array_equal(bake.modes, first.modes) for bake in bakes):
        together |= {name: np.concatenate([getattr(bake, name) for bake in bakes]) for name in moved}
        return replace(first, **together)
    # Each has modes of its own, and does not move in those of the others.
    ends = np.cumsum([len(bake.modes) for bake in bakes])
    for name in moved:
        rows = [np.zeros((len(bake.frames), ends[-1])) for bake in bakes]
        for bake, row, end in zip(bakes, rows, ends, strict=True):
            row[:, end - len(bake.modes) : end] = getattr(bake, name)
        together[name] = np.concatenate(rows)
    modes = np.concatenate([bake.modes for bake in bakes])
    return keys.with_fewer_keys(replace(first, **together, modes=modes, node_modes=None))


def export(
    obj: bpy.types.Object,
    key: str,
    path: Path,
    frames: tuple[int, int],
    takes: str = "SCENE",
    tick: Callable[[batch.Batch], object] | None = None,
) -> list[str]:
    """Write `obj`, with its armature and all meshes on that, to `path`, whole or not at all; returns warnings.

    key: of FORMATS. takes: SCENE, the bake over `frames` (first, last), or ACTIONS, see `ActionsExport`; tick(batch) is
    then called about ten times a second. Selection, frame, keys and curves are afterward as before. Raises
    ExportError, OSError, and with ACTIONS as `batch.run_all`.
    """
    if takes == "ACTIONS":
        batch = ActionsExport(obj, key, path)
        run_all(batch, tick)
        return batch.warnings
    check_place(obj, key, path, frames)
    check_bake(obj, key)
    with live_key.left_out(obj):
        write_file(obj, key, path, frames)
    return []


class ActionsExport(batch.Batch):
    """Simulates a clip for each Action that moves the armature of `obj`, with the model as it is built, and writes all
    to `path`, whole or not at all: an animation for each, by its name, of bones and of shape keys that all clips share.

    It needs no bake, and leaves the one that there is as it is. key: of a format that skins. Raises ExportError, and as
    `actions.clips_of` and `batch.Batch`.
    """

    def __init__(self, obj: bpy.types.Object, key: str, path: Path):
        if not FORMATS[key].skins:
            raise ExportError(
                "{format} has one animation only: choose glTF or FBX for one for each Action", format=FORMATS[key].label
            )
        if obj.dynamorph.model.solver == "FULL" and obj.dynamorph.model.method != "STATIC":
            raise ExportError(
                "'{name}': clips share their shape keys, and Full Quality makes others for each: set Quality to "
                "Reduced",
                name=obj.name,
            )
        self.key, self.path = key, path
        self.clips = actions.clips_of(obj)
        check_place(obj, key, path, (self.clips[0].first, self.clips[-1].last))
        super().__init__([ClipJob(obj, clip, self.clips) for clip in self.clips], "EXPORT_ACTIONS")

    @property
    def warnings(self) -> list[str]:
        return [
            message.joined(": ", [clip.name, text])
            for clip, job in zip(self.clips, self.jobs, strict=True)
            for text in job.warnings
        ]

    def write(self) -> Iterator[None]:
        yield from super().write()
        with self.jobs[0].request.scene.as_context():
            self._write_clips()

    def _write_clips(self) -> None:
        obj, job = self.jobs[0].target(), self.jobs[0]
        attachments = [handle.find() for handle in handles(job.input.character.attachments)]
        outcomes = [job.outcome for job in self.jobs]
        whole, budget = joined([outcome.bake for outcome in outcomes]), obj.dynamorph.output.keys
        bakes = of_meshes(job.input.character, keys.with_fewer_keys(whole, budget) if budget else whole)
        with ExitStack() as stack:
            stack.enter_context(frames_kept())
            stack.enter_context(actions.laid_out(rig_of(obj), self.clips))
            copies = stack.enter_context(stand_ins((obj, *attachments)))
            for mesh, copy, bake in zip((obj, *attachments), copies, bakes, strict=True):
                skin = None if copy == copies[0] else copies[0]
                live_key.remove(copy)
                copy.dynamorph.output.bake_to_action = False  # the armature's Actions are what the clips are made of
                if copy.data.shape_keys:
                    actions.lay_out(copy.data.shape_keys, self.clips, mesh.data.shape_keys)
                write_keys(copy, bake, skin)
            frames = self.clips[0].first, self.clips[-1].last
            write_file(copies[0], self.key, self.path, frames, self.clips, without=(obj, *attachments))
