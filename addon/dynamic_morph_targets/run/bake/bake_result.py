# SPDX-License-Identifier: GPL-3.0-or-later
"""The results of jobs -> Blender: all of them or nothing; and the messages for the artist."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import bpy

from ...core import logger, records
from ...core.character import Character
from ...core.errors import SceneError
from ...core.material import calibration
from ...core.model.model import MODES, Model
from ...core.motion import baked
from ...io import disk
from ...scene import keyed, skin
from ...scene.store import staleness
from ...scene.store.model_store import PACKED, blend_folder, index_in, remember, stored_model
from ...write.bake.baked_action import check_rig_action
from ...write.bake.before import Before
from ...write.bake.writer import check_bake, check_free, check_local, check_not_edited, free, new_bake
from ...write.display import beside, comparison, live_key
from ...write.storage import fit_modes, keep_model, model_path
from ..work.job_data import BakeInput, Outcome, Progress
from . import bake_time
from .bake_input import Request, handles


def write_all(writers: Sequence[Writer]) -> None:
    """Write the results of several jobs. If anything is refused or fails, nothing of it stays. Raises SceneError,
    WriteError, ModelFileError, OSError.
    """
    with ExitStack() as undo:
        for writer in writers:
            undo.callback(writer.forget_point_caches)
        for writer in writers:
            writer.check()
        for writer in writers:
            writer.save_model(undo)
        for writer in writers:
            writer.keep(undo)
        for writer in writers:
            writer.add_keys(undo)
        for writer in writers:
            writer.show_keys()
        for writer in writers:
            writer.store()
        for writer in writers:
            writer.look_at_colliders()  # which those before may have changed
        undo.pop_all()
    for writer in writers:
        writer.remove_old()


def target(request: Request, given: BakeInput) -> bpy.types.Object:
    """The object for which the results are. Raises SceneError when they do not fit it any more."""
    points = given.character.vertices[given.character.own_vertices]
    meshes = [
        (request.target, points),
        *zip(handles(given.character.attachments), (each.points for each in given.character.attachments), strict=True),
    ]
    for handle, vertices in meshes:
        obj = handle.find()
        if len(obj.data.vertices) != len(vertices):
            raise SceneError("Mesh '{name}' changed while the job ran: nothing was written, start again", name=obj.name)
    return request.target.find()


class Writer:
    """Writes the result of one job in steps. Each step is done for all jobs before the next one begins.

    Everything that can be refused is refused first. The earlier bake stays until all new bakes play, and is removed
    last: if a step fails before that, the earlier bake plays again.
    """

    def __init__(self, request: Request, given: BakeInput, outcome: Outcome, progress: Progress):
        self.request, self.given, self.outcome, self.progress = request, given, outcome, progress
        self._packed: bytes | None = None  # the model to store, if one was built
        self._file: Path | None = None  # where, if not in the .blend
        self._new: list = []  # bakes

    def check(self) -> None:
        """Refuse, before anything is written, what cannot be written. Raises SceneError, WriteError, ModelFileError."""
        obj = target(self.request, self.given)
        if not self.given.is_bake:
            check_local(obj)
        else:
            attachments = self._attachments()
            check_bake(obj)
            check_rig_action(obj)
            for attachment in attachments:
                check_bake(attachment, obj)
            for attachment in skin.shown_attachments(obj):
                check_not_edited(attachment)
            for attachment in self._left_behind():
                check_free(attachment)
        self._packed = self.outcome.packed
        moves = self.request.folder not in (None, blend_folder())
        if self._packed is None and not self.given.only_cage and PACKED not in obj and moves:
            self._packed = stored_model(obj)  # the .blend moves, its model moves along
        if self._packed is not None:
            self._file = model_path(obj.name, self._packed, self.request.folder)

    def save_model(self, undo: ExitStack) -> None:
        """Write the file of a model that is too large for the .blend. Raises OSError."""
        if self._file is None or self._packed is None:
            return
        if not self._file.exists():
            undo.callback(disk.discard, self._file)
        with self.progress.stage("store model"):
            disk.save(self._file, self._packed)
        self.outcome.model_files.append(self._file)

    def keep(self, undo: ExitStack) -> None:
        """Remember what the next steps change."""
        obj = self.request.target.find()
        others = (*self._attachments(), *skin.shown_attachments(obj)) if self.given.is_bake else ()
        for each in dict.fromkeys((obj, *others)):
            undo.callback(Before(each).restore)
        if self.given.is_bake:
            with self.request.scene.as_context():
                beside.keep_bake(obj)

    def add_keys(self, undo: ExitStack) -> None:
        """Write the bakes of all meshes beside the existing ones. Raises WriteError."""
        if not self.given.is_bake:
            return
        obj = self.request.target.find()
        with self.progress.stage("write keys"), self.request.scene.as_context():
            self._place_caches()
            for each, (keys, cache) in zip((obj, *self._attachments()), self.outcome.written, strict=True):
                new = new_bake(each, keys, None if each == obj else obj, cache)
                undo.callback(new.take_back)
                new.add()
                self._new.append(new)
                self.outcome.size += new.size
                if cache:
                    self.outcome.size += self.outcome.beside.get(cache, cache).stat().st_size

    def _place_caches(self) -> None:
        """Give point caches their names, beside the .blend, which may have been saved elsewhere meanwhile. Those that
        were given others get them with that. Raises OSError.
        """
        given, outcome, folder = self.given, self.outcome, self.request.folder or blend_folder()
        for k, (keys, file) in enumerate(outcome.written):
            if file is None:
                continue
            if file in given.cache_files.values():
                outcome.new_files.append(outcome.beside[file])
                continue
            written = outcome.beside.pop(file)
            moves = folder is not None and file.parent.parent == given.caches and folder != given.caches
            place = folder / file.parent.name / file.name if moves else file  # type: ignore[operator]  # it is there
            if not place.exists():
                outcome.new_files.append(place)
            if moves:
                with written.open("rb") as content:
                    disk.save(place, iter(partial(content.read, 2**20), b""))
                disk.discard(written)
            else:
                disk.replace(written, place)
            outcome.written[k] = keys, place

    def show_keys(self) -> None:
        """Make the new bakes play in the place of the old ones and of Live."""
        if not self.given.is_bake:
            return
        obj = self.request.target.find()
        with self.progress.stage("write keys"), self.request.scene.as_context():
            if comparison.is_plain(obj):
                comparison.show(obj, False)
            live_key.hide(obj, True)
            for attachment in self._left_behind():
                comparison.show(attachment, True)
            for new in self._new:
                new.show()

    def remove_old(self) -> None:
        """Remove what no longer plays. What fails here is logged: the new bakes play, so the job has succeeded."""
        if not self.given.is_bake:
            return
        obj = self.request.target.find()
        left = [(free, attachment) for attachment in self._left_behind()]
        messages: list[str] = []
        with self.request.scene.as_context():
            for remove, *what in ((live_key.remove_hidden, obj), *left, *((new.remove_old,) for new in self._new)):
                try:
                    messages += remove(*what) or ()
                except Exception as bug:
                    logger.log_bug(bug)
        self.outcome.warnings += messages
        record = obj.dynamorph.bake
        record.warnings = "\n".join(filter(None, [record.warnings, *messages]))

    def store(self) -> None:
        """Store the model and the findings with the object."""
        obj = self.request.target.find()
        with self.request.scene.as_context():
            with self.progress.stage("store model"):
                self._store_model(obj)
                store_materials(obj, self.outcome.character)
            if self.given.is_bake:
                self._record(obj)

    def look_at_colliders(self) -> None:
        """Note what stops a soft skin that was baked, when all that is baked with it is stored."""
        if self.given.is_bake:
            with self.request.scene.as_context():
                staleness.look_at_colliders(self.request.target.find())

    def forget_point_caches(self) -> None:
        """Remove the files of point caches that nothing plays."""
        for file in self.outcome.new_files:
            disk.discard(file)

    def _attachments(self) -> list[bpy.types.Object]:
        return [handle.find() for handle in handles(self.given.character.attachments)]

    def _left_behind(self) -> list[bpy.types.Object]:
        """The meshes that follow the old bake or Live, but not the new bake."""
        attachments = self._attachments()
        return [each for each in skin.shown_attachments(self.request.target.find()) if each not in attachments]

    def _store_model(self, obj: bpy.types.Object) -> None:
        given, model = self.given, self.outcome.model
        record = obj.dynamorph.model
        if self._packed is not None:
            keep_model(obj, self._packed, self._file)
            if self.outcome.stored is not None:
                remember(obj, self.outcome.stored)
        if given.reasons:
            size = f"{len(self._packed or b'') / 2**20:.1f}\u00a0MB, {self.progress.seconds['build']:.1f}\u00a0s"
            record.summary = "" if given.only_cage else f"{model_summary(given, model)}, {size}"
            record.cage = cage_summary(model)
            record.vertices = given.character.own_vertices.stop
            record.warnings = "\n".join(model.summary.warnings)
        if given.reasons or not given.only_cage:
            record.stale, record.built = "only the cage is built" if given.only_cage else "", given.built_from
            record.stale_part = MODES if given.only_cage else ""
        if given.reasons and not given.only_cage:
            obj.dynamorph.live.checks = ""
            fit_modes(obj, model.summary.tabulated)
            self._store_measured(obj, model)

    def _store_measured(self, obj: bpy.types.Object, model: Model) -> None:
        character, reference = self.outcome.character, self.outcome.reference
        obj.dynamorph.model.set_reference(reference or 0.0, character.material(0).poisson)
        volumes = calibration.volumes(model, character)
        for target in obj.dynamorph.targets:
            index = index_in(character, obj, target)
            target.volume = volumes[index] if index is not None else 0.0

    def _record(self, obj: bpy.types.Object) -> None:
        """Store what the panels show about the bake."""
        given, outcome = self.given, self.outcome
        record = obj.dynamorph.bake
        outcome.report["keys"] = len(record.keys)
        record.summary = summary(given, outcome, self.progress.waited)
        record.warnings = "\n".join(text for text in outcome.warnings if text not in outcome.model.summary.warnings)
        record.inputs = records.text(outcome.inputs | {"content_id": obj.dynamorph.model.content_id})
        record.verdict = outcome.verdict.record
        record.content_id = outcome.content_id
        record.digest = baked.digest(outcome.bake)
        record.lost = ""
        bake_time.learn(obj, given, self.progress.seconds["simulate"])
        staleness.look_at_animation(obj)
        staleness.look_at_map(obj, outcome.character)


def store_materials(obj: bpy.types.Object, character: Character) -> None:
    """Store the stiffness that a build has computed from the targets' frequencies."""
    for target in obj.dynamorph.targets:
        index = index_in(character, obj, target)
        if index is None or not keyed.frequency_of(target):
            continue
        built = character.targets[index]
        if (target.frequency, target.density) == (built.frequency, built.material.density):
            target.set_computed_stiffness(built.material.stiffness)
        else:  # set since the build began
            target.follow_frequency()


# For the artist ------------------------------------------------------------------------------------------------------


def summary(given: BakeInput, outcome: Outcome, waited: float) -> str:
    """One line about a job; waited: seconds."""
    if given.only_cage:
        return cage_summary(outcome.model) if given.reasons else "the cage is up to date"
    if not given.is_bake:
        return model_summary(given, outcome.model)
    report = outcome.report
    frames = given.settings.frame_end - given.settings.frame_start + 1
    gap = f", loop gap {1000 * report['gap']:.3g} mm" if "gap" in report else ""
    off = report.get("keys_error", 0.0)
    if given.output and given.output.format == "MODES":  # others hold all of an unreduced motion
        off += report.get("compression_error", 0.0)
    error = f", {report['keys']} keys off by at most {1000 * off:.2g} mm" if off else ""
    seam = f", {1000 * report['seam']:.3g} mm from the other frames" if "seam" in report else ""
    quality = ", Full Quality" if given.solver == "FULL" else ""
    return f"{frames} frames in {waited:.1f}\u00a0s{quality}, {outcome.size / 2**20:.1f}\u00a0MB{error}{gap}{seam}"


def model_summary(given: BakeInput, model: Model) -> str:
    made, count = model.summary, given.character.target_count
    targets = f"{count} target{'s' * (count > 1)}"
    if not made.tets:
        return f"{targets}, nothing to simulate"
    return f"{made.nodes} nodes, {made.modes} modes, {targets}"


def cage_summary(model: Model) -> str:
    made = model.summary
    if not made.tets:
        return ""
    by = " by bones" if made.pinned else ""
    return f"{made.nodes} nodes, {made.tets} tetrahedra, {made.held:.0%} held{by}"
