# SPDX-License-Identifier: GPL-3.0-or-later
"""Build and Bake as one path for the button, the command line and scripts; and where a built model is kept.

A job has three phases: `prepare` reads Blender, `compute` runs in a thread and never touches bpy, `commit` writes
Blender all at once, so that it is one undo step and an error before it changes nothing.
"""

from __future__ import annotations

import re
import threading
import time
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path

import bpy
import numpy as np

from . import extract, model_file, preferences, sinks
from .extract import Cancelled, SceneError

PACKED = "dynamorph_model"  # custom property of the Object: the model's bytes
PACK_LIMIT = 32 * 2**20  # larger models go into a file

running: Job | None = None  # the job whose progress the panels draw


class NativeMissing(Exception):
    """The compiled engine cannot be imported. The message says why and what to do."""


class SelfCheckError(Exception):
    """The engine returned something that cannot be right."""


def engine():
    """The modules that need the compiled engine: (build, simulate). Raises NativeMissing.

    Imported here and not at the top, so that a missing wheel leaves an add-on that can say so.
    """
    try:
        import dynamorph  # noqa: F401
    except Exception as error:  # a wheel for another system fails in many ways
        raise NativeMissing(
            f"The engine cannot be loaded ({error}). Install the Dynamorph extension made for this Blender and system "
            "from its .zip, or with pip the package 'dynamorph', and restart"
        ) from error
    from . import build, simulate

    return build, simulate


@lru_cache(maxsize=1)
def engine_problem() -> str:
    """Why the engine cannot be loaded, or ''."""
    try:
        engine()
    except NativeMissing as error:
        return str(error)
    return ""


def expected_errors() -> tuple[type[Exception], ...]:
    """The exceptions whose message is meant for the artist."""
    return (NativeMissing, SelfCheckError, ValueError, OSError, *_engine_errors())


def _engine_errors() -> tuple[type[Exception], ...]:
    try:
        import dynamorph
    except Exception:
        return ()
    return (dynamorph.Error,)


# The built model ---------------------------------------------------------------------------------------------------


def store_model(obj, packed: bytes, folder: Path | None = None):
    """Keep a packed model with `obj`: in the .blend, or if it is large in a file as the preferences say.

    folder: of the .blend that the model belongs to; by default of the open one.
    Files are named by their content: a copy of the object shares its file, and a new build never overwrites one that
    another .blend may use.
    """
    content_id = model_file.content_id(packed)
    if len(packed) > PACK_LIMIT:
        folders = preferences.model_folders(folder or _blend_folder())
        if not folders:
            raise SceneError(
                f"The model of '{obj.name}' is large ({len(packed) / 2**20:.0f} MB) and goes into a file beside the "
                ".blend: save the .blend first"
            )
        model_file.save(folders[0] / f"{content_id}.dynamorph", packed)
        obj.pop(PACKED, None)
    else:
        obj.pop(PACKED, None)  # Blender cuts bytes that replace other bytes at their first zero
        obj[PACKED] = packed
    obj.dynamorph.model.content_id = content_id


def stored_model(obj) -> bytes | None:
    """The packed model of `obj`, or None. Raises ModelFileError when there should be one."""
    packed = obj.get(PACKED)
    if packed is not None:
        if not isinstance(packed, bytes):
            raise model_file.ModelFileError(f"The model of '{obj.name}' is damaged: build it again")
        return packed
    content_id = obj.dynamorph.model.content_id
    if not content_id:
        return None
    folders = preferences.model_folders(_blend_folder())
    paths = [folder / f"{content_id}.dynamorph" for folder in folders]
    # The id comes from the .blend, which may be anybody's: it must not lead out of the folder.
    path = next(filter(Path.is_file, paths), None) if re.fullmatch("[0-9a-f]{32}", content_id) else None
    if path is None:
        places = " and ".join(f"'{folder}'" for folder in folders) or "beside the .blend"
        raise model_file.ModelFileError(
            f"The model of '{obj.name}' is missing (looked for in {places}): put it back or build again"
        )
    return path.read_bytes()


def forget_model(obj):
    """Drop the model kept in the .blend. A file stays: another .blend may use it."""
    obj.pop(PACKED, None)
    record = obj.dynamorph.model
    record.content_id = record.summary = record.stale = record.warnings = ""


def load_model(obj):
    """The built model of `obj`, or None. Raises ModelFileError."""
    content_id = obj.dynamorph.model.content_id
    return _load(obj.session_uid, content_id) if content_id else None


@lru_cache(maxsize=4)
def _load(session_uid: int, _content_id: str):
    build, _ = engine()
    try:
        return build.Model.from_arrays(*model_file.unpack(stored_model(find(session_uid))))
    except model_file.ModelFileError:
        raise
    except ValueError as error:  # it lacks something, or has what this version does not know
        raise model_file.ModelFileError(str(error)) from error


def stale_reasons(obj, character) -> list[str]:
    """Why the model of `obj` must be built (again); empty when it is up to date."""
    build, _ = engine()
    try:
        model = load_model(obj)
    except model_file.ModelFileError as error:
        return [str(error)]
    return ["not built yet"] if model is None else build.stale_reasons(model, character)


def fit_input(obj, target):
    """What the fits of `materials` ask for: (model, character, index there) of one of the object's targets.

    Raises SceneError unless the model is up to date.
    """
    character = extract.character(obj)
    reasons = stale_reasons(obj, character)
    if reasons:
        raise SceneError(f"The model of '{obj.name}' is out of date ({'; '.join(reasons)}): press Build Model first")
    names = [each.name for each in character.by_method().targets]
    first = 0 if target == obj.dynamorph.targets[0] else 1  # a shape key may be called like the neutral target
    if target.name not in names[first:]:
        raise SceneError(f"Target '{target.name}' is not in the model: it is muted, or the Method leaves it out")
    return load_model(obj), character, names.index(target.name, first)


def show_stale(obj):
    """Let the panel say why the model of `obj` is out of date."""
    try:
        stale = "; ".join(stale_reasons(obj, extract.character(obj)))
    except expected_errors() as error:
        stale = str(error)
    if obj.dynamorph.model.stale != stale:
        obj.dynamorph.model.stale = stale


def _blend_folder() -> Path | None:
    return Path(bpy.data.filepath).parent if bpy.data.filepath else None


def find(session_uid: int):
    """The object with this id, which outlives undo and renames; Python references do not. Raises SceneError."""
    obj = next((obj for obj in bpy.data.objects if obj.session_uid == session_uid), None)
    if obj is None:
        raise SceneError("The object was deleted while the job ran: nothing was written")
    return obj


# Jobs --------------------------------------------------------------------------------------------------------------


class Job:
    """Builds the model of one object if that is necessary, and with the goal "BAKE" simulates and writes the shot.

    goal: "BUILD" or "BAKE". frames: (start, end), substeps: override the object's settings. folder: where large models
    go. rebuild: build even when the model is up to date.
    """

    def __init__(self, obj, goal: str, frames=None, substeps=None, folder: Path | None = None, rebuild=False):
        self.session_uid = obj.session_uid
        self.name = obj.name
        self.goal = goal
        self.bake = goal == "BAKE"
        self.frames = frames
        self.substeps = substeps
        self.folder = folder
        self.rebuild = rebuild
        self.fraction = 0.0
        self.message = ""
        self.cancelled = False
        self.seconds: dict[str, float] = {}  # by stage
        self.warnings: list[str] = []
        self.reasons: list[str] = []  # why the model was built
        self.report: dict = {}  # of the simulation
        self.previous = None  # the model that the object had
        self.settings = self.rig = None  # the shot
        self.model = None
        self.result = None
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name=f"dynamorph {obj.name}", daemon=True)

    def prepare(self):
        """Check and read the scene; main thread."""
        engine()
        preferences.use_threads()
        obj = find(self.session_uid)
        self.character = extract.character(obj)
        if self.bake:
            sinks.check(obj)
        self.warnings = extract.warnings(obj, self.character)
        self.reasons = stale_reasons(obj, self.character) or ["asked for"] * self.rebuild
        with suppress(model_file.ModelFileError):  # then one of the reasons
            self.previous = load_model(obj)
        if not self.reasons:
            self.model = self.previous
        chosen = self.character.settings
        fits = bool(self.reasons) and chosen.fit_to_shot and chosen.solver == "REDUCED" and chosen.method != "STATIC"
        if not (self.bake or fits):
            return
        self.settings = extract.simulation_settings(obj, bpy.context.scene, self.frames, self.substeps)
        with self._stage("sample rig"):
            samples = extract.sample_rig(
                obj, self.settings.start, self.settings.end, self.settings.substeps, self._progress(0.0, 0.2)
            )
        self.rig, warnings = extract.hold_collapsed(samples, self.character.skeleton)
        self.warnings += warnings

    def start(self):
        """Begin to compute, in a thread."""
        self._thread.start()

    def wait(self, timeout: float | None = None) -> bool:
        """True when the computation has ended. Raises what it raised, Cancelled if the user stopped it."""
        self._thread.join(timeout)
        if self._thread.is_alive():
            return False
        if self.cancelled:
            raise Cancelled
        if self._error:
            raise self._error
        return True

    def commit(self):
        """Write the results; main thread."""
        obj = find(self.session_uid)
        if len(obj.data.vertices) != len(self.character.vertices):
            raise SceneError(f"Mesh '{obj.name}' changed while the job ran: nothing was written, start again")
        with self._stage("store model"):
            self._store_model(obj)
        if self.bake:
            with self._stage("write keys"):
                sinks.write_modal_keys(obj, self.result)
            obj.dynamorph.bake.summary = self.summary()
            obj.dynamorph.bake.warnings = "\n".join(
                warning for warning in self.warnings if warning not in self.model.summary["warnings"]
            )

    def summary(self) -> str:
        """One line for the artist."""
        if not self.bake:
            return self.model_summary()
        frames = len(self.settings.frames)
        seconds = sum(value for stage, value in self.seconds.items() if stage != "build")
        return f"{frames} frames, {frames / max(seconds, 1e-9):.0f} frames/s"

    def model_summary(self) -> str:
        made = self.model.summary
        if not made["tets"]:
            return f"{made['targets']} targets, nothing to simulate"
        return f"{made['nodes']} nodes, {made['modes']} modes, {made['targets']} targets, {made['dofs']} DOF"

    def _store_model(self, obj):
        record = obj.dynamorph.model
        if self.reasons:
            packed = model_file.pack(*self.model.to_arrays())
            store_model(obj, packed, self.folder)
            record.summary = f"{self.model_summary()}, {len(packed) / 2**20:.1f} MB, {self.seconds['build']:.1f} s"
        elif PACKED not in obj and self.folder not in (None, _blend_folder()):
            store_model(obj, stored_model(obj), self.folder)  # the .blend moves, its model moves along
        record.stale = ""
        if self.reasons:
            record.warnings = "\n".join(self.model.summary["warnings"])

    def _work(self):
        try:
            self._compute()
        except _engine_errors() as error:  # the engine does not know whose cage it works on
            named = f"'{self.name}'" in str(error)
            self._error = error if named else type(error)(f"'{self.name}': {error}")
        except BaseException as error:  # raised again in the main thread, by wait
            self._error = error

    def _compute(self):
        _, simulate = engine()
        start = 0.2
        built = 0.95 if self.character.settings.fit_to_shot else 0.7
        if self.reasons:
            with self._stage("build"):
                progress = self._progress(start, built if self.bake else 1.0)
                self.model = simulate.build_for(self.character, self.rig, self.settings, progress, self.previous)
            start = built
            self.warnings += self.model.summary["warnings"]
        if not self.bake:
            return
        with self._stage("simulate"):
            self.result, self.report = simulate.bake(
                self.model, self.character, self.rig, self.settings, self._progress(start, 1.0)
            )
        self.warnings += self.report["warnings"]
        first, last = self.model.summary.get("fitted", (self.settings.start, self.settings.end))
        if self.settings.start < first or self.settings.end > last:
            self.warnings.append(f"The modes were fitted to frames {first} to {last}: press Build Model")
        if self.report["inverted"]:
            self.warnings.append(
                f"{self.report['inverted']} of {len(self.model.tets)} tetrahedra turn inside out at worst: raise "
                "Stiffness or Cage Nodes, or smooth the sculpt"
            )
        for name in ("coordinates", "weights", "modes", "details"):
            if not np.isfinite(getattr(self.result, name)).all():
                raise SelfCheckError(f"'{self.name}': the engine's {name} are not numbers: nothing was written")

    def _progress(self, begin: float, end: float):
        def progress(fraction: float, message: str) -> bool:
            self.fraction = begin + (end - begin) * fraction
            self.message = message
            return not self.cancelled

        return progress

    @contextmanager
    def _stage(self, name: str):
        began = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began


def run(job: Job, tick=None):
    """The whole job at once. tick(job) is called in the main thread about ten times a second."""
    job.prepare()
    job.start()
    try:
        while not job.wait(0.1):
            if tick:
                tick(job)
    except KeyboardInterrupt:
        stop(job)
        raise
    job.commit()


def stop(job: Job):
    """Cancel and wait until the thread has left the engine."""
    job.cancelled = True
    with suppress(Cancelled):
        job.wait()
