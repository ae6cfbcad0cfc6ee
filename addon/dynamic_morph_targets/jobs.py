# SPDX-License-Identifier: GPL-3.0-or-later
"""Build and Bake as one path for the button, the command line and scripts; and where a built model is kept.

A job has three phases: `prepare` reads Blender, `compute` runs in a thread and never touches bpy, `commit` writes
Blender all at once, so that it is one undo step and an error before it changes nothing.
"""

from __future__ import annotations

import hashlib
import json
import re
import threading
import time
from array import array
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import bpy
import numpy as np

from . import (
    changes,
    clips,
    comparison,
    extract,
    judge,
    live_key,
    materials,
    model_file,
    preferences,
    probe,
    properties,
    share,
    sinks,
)
from .extract import SceneError
from .rehearsal import Rehearsal
from .scene_data import Bake

PACKED = "dynamorph_model"  # custom property of the Object: the model's bytes, as whole numbers after their count
CAGE = 0.1  # of a job, the part that a cage takes if the rig cannot be read without
PACK_LIMIT = 32 * 2**20  # larger models go into a file

FADE = 5  # frames in which a part that is baked again goes over into the rest
STRETCH = 1000  # frames of a shot that are read and simulated at once: bounds memory
SHORT_STRETCH = 100  # where each node is read, or where they are kept for other processes, which go on from there

running: Batch | None = None  # the work whose progress the panels draw
winding_down: list[threading.Thread] = []  # of cancelled jobs: the engine has not noticed yet


class Cancelled(Exception):
    """The user stopped the job."""


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
        obj.pop(PACKED, None)
        obj[PACKED] = _as_numbers(packed)  # exporters of Blender's own crash on bytes with zeros in them
    obj.dynamorph.model.content_id = content_id


def stored_model(obj) -> bytes | None:
    """The packed model of `obj`, or None. Raises ModelFileError when there should be one."""
    packed = obj.get(PACKED)
    if isinstance(packed, bytes):  # of version 0.1's first files
        return packed
    if packed is not None:
        return _as_bytes(obj.name, packed)
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


def _as_numbers(packed: bytes) -> array:
    numbers = array("i", [len(packed)])
    numbers.frombytes(packed + bytes(-len(packed) % numbers.itemsize))
    return numbers


def _as_bytes(name: str, numbers) -> bytes:
    """The inverse of `_as_numbers`; name: of the object. Raises ModelFileError."""
    try:
        numbers = np.asarray(numbers, "<i4")
        count, packed = int(numbers[0]), numbers[1:].tobytes()
        if not 0 <= len(packed) - count < 4:
            raise ValueError
    except (TypeError, ValueError, IndexError):
        raise model_file.ModelFileError(f"The model of '{name}' is damaged: build it again") from None
    return packed[:count]


def fit_modes(obj, count: int):
    """List the modes of a new model; those that there were keep their gain."""
    modes = obj.dynamorph.modes
    while len(modes) > count:
        modes.remove(len(modes) - 1)
    while len(modes) < count:
        modes.add().name = f"Mode {len(modes) + 1:02d}"
    obj.dynamorph.active_mode_index = min(obj.dynamorph.active_mode_index, max(count - 1, 0))


def forget_model(obj):
    """Drop the model kept in the .blend. A file stays: another .blend may use it."""
    obj.pop(PACKED, None)
    record = obj.dynamorph.model
    record.content_id = record.summary = record.cage = record.stale = record.warnings = record.built = ""


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


def current_model(obj):
    """(model, character) of an object whose model is up to date. Raises SceneError."""
    character = extract.character(obj)
    reasons = stale_reasons(obj, character)
    if reasons:
        raise SceneError(f"The model of '{obj.name}' is out of date ({'; '.join(reasons)}): press Build Model first")
    return load_model(obj), character


def fit_input(obj, target):
    """What the fits of `materials` ask for: (model, character, index there) of one of the object's targets.

    Raises SceneError unless the model is up to date.
    """
    model, character = current_model(obj)
    index = index_in(character, obj, target)
    if index is None:
        raise SceneError(f"Target '{target.name}' is not in the model: it is muted, or the Method leaves it out")
    return model, character, index


def index_in(character, obj, target) -> int | None:
    """Where one of the object's targets is among those of the character that is simulated; None if it is not."""
    names = [each.name for each in character.by_method().targets]
    first = 0 if target == obj.dynamorph.targets[0] else 1  # a shape key may be called like the neutral target
    return names.index(target.name, first) if target.name in names[first:] else None


def show_stale(obj):
    """Look at the mesh, and let the panel say why the model of `obj` is out of date."""
    stale = ""
    if not changes.model_changes(obj):  # they say enough
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

    goal: "BUILD", "BUILD_CAGE" (the model's tetrahedra alone) or "BAKE". frames: (start, end), substeps: override the
    object's settings. folder: where large models go. rebuild: build even when the model is up to date. share: where
    built models and unfinished bakes are kept for other processes.

    A long shot is read and simulated in stretches, one after the other.

    The first bake of a whole shot is a rehearsal too: while the skin moves further than the limits allow, the tissue is
    made stiffer and the shot begins anew; what that comes to is stored with the targets. rehearse: do so again.
    """

    def __init__(
        self, obj, goal: str, frames=None, substeps=None, folder: Path | None = None, rebuild=False,
        share: share.Share | None = None, rehearse=False,
    ):  # fmt: skip
        self.session_uid = obj.session_uid
        self.name = obj.name
        self.goal = goal
        self.bake = goal == "BAKE"
        self.only_cage = goal == "BUILD_CAGE"
        self.frames = frames
        self.substeps = substeps
        self.folder = folder
        self.rebuild = rebuild
        self.share = share
        self.limits = judge.Limits()
        self.verdict: judge.Verdict | None = None
        self.rehearsed = ""  # what the rehearsal has set, in a sentence
        self._rehearse = rehearse
        self._rehearsal: Rehearsal | None = None  # until it has found out
        self._best: tuple = ()  # what it keeps: the character, and its result, report and verdict
        self.fraction = 0.0
        self.message = ""
        self.cancelled = False
        self.seconds: dict[str, float] = {}  # by stage
        self.warnings: list[str] = []
        self.reasons: list[str] = []  # why the model was built
        self.report: dict = {}  # of the simulation
        self.previous = None  # the model that the object had
        self.inputs: dict = {}  # of the bake
        self.settings = self.rig = self._sampling = self._probe = None  # the shot, of which rig is the last stretch
        self.shot = None  # simulate.Shot
        self._whole = True
        self.resumed: dict = {}  # what another process kept of it
        self.kept: Path | None = None  # where it is kept for other processes while it is unfinished
        self.model = None
        self._shared_model = None
        self.references: list[tuple[float, float]] = []  # of a model that was built: `materials.references`
        self.before: list = []  # the bakes that these are to become parts of
        self.result = None
        self.followers: list = []  # other meshes that the flesh carries along
        self.carried: list = []  # the bakes of those that are not in the cage: they are in `result`
        self.cache_files: dict[str, Path] = {}  # where point caches go, by mesh, if not where they go by default
        self.written: list[tuple] = []  # what they become: shape keys, and the file of a point cache or None
        self.size = 0  # of that, in bytes
        self._stretches = 0  # of the shot that were simulated
        self._read_from = 0.0  # of the whole, the part done before the rig is read
        self._error: BaseException | None = None
        self.thread = self._thread(self._compute)

    def prepare(self):
        """Check and read the scene at once, all of the shot; main thread."""
        self.read(whole=True)
        if self.needs_cage():
            self._make_cage()
        self.sample()
        self._take_rig()

    def read(self, whole=False):
        """Check and read the character and its settings. whole: the shot is to be one stretch."""
        self.message = "Reading the character"
        engine()
        preferences.use_threads()
        obj = find(self.session_uid)
        sinks.check_local(obj)
        self.character = extract.character(obj, without_targets=self.only_cage)
        if self.bake:
            sinks.check(obj)
            self.followers = extract.followers(obj, self.character)
            for follower in self.followers:
                sinks.check(find(follower.session_uid), needs_keys=False)
        self.warnings = extract.warnings(obj, self.character)
        self.warnings += extract.far_followers(self.character, self.followers)
        if self.bake:
            self._read_output(obj)
        with suppress(model_file.ModelFileError):  # then one of the reasons
            self.previous = load_model(obj)
        self.reasons = self._reasons(obj)
        if not self.reasons:
            self.model = self.previous
        self.built = json.dumps(changes.model_inputs(obj))
        chosen = self.character.settings
        fits = bool(self.reasons) and chosen.fit_to_shot and chosen.solver == "REDUCED" and chosen.method != "STATIC"
        self._shares_model = bool(self.share) and not fits  # a fitted one depends on the shot
        if self.reasons and self._shares_model:
            self._shared_model = self.share.built(self.character)
            self.previous = self._shared_model or self.previous
        if self.only_cage or not (self.bake or fits):
            return
        self.settings = settings = extract.simulation_settings(obj, bpy.context.scene, self.frames, self.substeps)
        self.inputs = changes.bake_inputs(obj, settings) | {"animation": extract.animation(obj)}
        chosen = obj.dynamorph.simulation
        self._read_limits(chosen)
        if self.bake and (chosen.is_patch or (chosen.keep_outside and self.frames)):
            self._read_kept(obj)
        self._whole = whole or settings.loop or fits
        if self.share and self.bake and not (self._whole or self.before or self.character.probed):
            self.kept = self.share.bake_path(self)
            model = self.model or self._shared_model
            self.resumed = self.share.unfinished(self.kept, model) if model else {}
        if self.resumed:
            self._first = extract.sample_rig(obj, settings.first, settings.first, 1)
        self._next_stretch(obj)

    def _read_limits(self, chosen):
        """How far the skin may move, and whether this bake finds out what keeps it there; chosen: the settings.

        Not what others have to agree with: a part of a shot, a worker of a farm, what the artist has set by hand.
        """
        self.limits = judge.Limits(chosen.max_displacement, chosen.max_thickness)
        model, neutral = self.character.settings, self.character.targets[0]
        limited = self.limits != judge.Limits() and model.solver == "REDUCED" and model.method != "STATIC"
        whole = self.bake and not (self.frames or self.share or chosen.is_patch)
        adjustable = neutral.frequency > 0.0 and not neutral.by_hand
        if limited and whole and adjustable and (self._rehearse or not chosen.rehearsed):
            self._rehearsal = Rehearsal(neutral.frequency)
            self.rehearsed = f"Bounce of {neutral.frequency:.3g} Hz keeps the skin within Max Displacement"

    def _read_kept(self, obj):
        """The bake that the frames go into, if there is one, and the way up to them. Raises SceneError, SinkError."""
        if not obj.dynamorph.bake.exists:
            return
        self.before = [sinks.read_back(find(uid), self.settings.samples) for uid in self._meshes()]
        if self.character.parts:
            to_body = [np.eye(3), *(np.linalg.inv(follower.from_body) for follower in self.followers)]
            self.before = [clips.united(self.before, to_body)]
        settings, (first, last) = self.settings, self.before[0].frames[[0, -1]].astype(int).tolist()
        if settings.start > last + 1 or settings.end < first - 1:
            raise SceneError(
                f"'{self.name}': frames {settings.start} to {settings.end} are not next to those of the last bake, "
                f"{first} to {last}: choose others, or turn Keep Other Frames off"
            )
        whole = {"start": min(settings.start, first), "end": max(settings.end, last)}
        self.inputs["simulation"] |= whole
        run_up = min(settings.start - whole["start"], max(settings.preroll, round(settings.fps)))
        since = ", ".join(changes.outdated(obj))
        if since:
            self.warnings.append(f"Since the other frames were baked: {since}")
        if settings.loop:
            self.warnings.append("A part of a bake is no loop: Loop is ignored")
        self.settings = replace(settings, loop=False)
        if run_up:
            self.settings = replace(self.settings, preroll=run_up, preroll_pose="ANIMATED")

    def _read_output(self, obj):
        self.output = extract.output_settings(obj)
        if self.output.sink in clips.CACHES:
            self.caches = self.folder or _blend_folder()
            sinks.check_cache(obj, self.caches)
            for mesh in map(find, self._meshes()):
                lost = ", ".join(f"'{name}'" for name in sinks.overwritten_keys(mesh))
                if lost:
                    self.warnings.append(
                        f"The point cache of '{mesh.name}' plays over shape keys that move too: {lost}"
                    )

    def _next_stretch(self, obj):
        """What is to be read next."""
        settings = self.settings
        done = self.shot.done if self.shot else len(self.resumed.get("coordinates", ()))
        first = settings.reached(done)
        stretch = SHORT_STRETCH if self.kept or self.character.probed else STRETCH
        frames = settings.end - first if self._whole else stretch
        self._sampling = extract.RigSampling(obj, first, min(first + frames, settings.end), settings.substeps)
        self._sampling.probe = self._probe

    def go_on(self) -> bool:
        """Whether there is another stretch to be read and simulated, after one is."""
        begins_anew = self._stretches > 0 and self.shot is None
        if not begins_anew and (not self.shot or self.shot.is_complete):
            return False
        self._next_stretch(find(self.session_uid))
        return True

    def needs_cage(self) -> bool:
        """Whether there must be a cage before `sample`, because Blender is asked how it moves its nodes."""
        build, _ = engine()
        return self._probes() and not (self.previous and build.has_cage(self.previous, self.character))

    def _probes(self) -> bool:
        return bool(self._sampling and self.character.probed and self.character.settings.method != "STATIC")

    def start_cage(self):
        """Begin to make the cage, in a thread."""
        self.thread = self._thread(self._make_cage)
        self.thread.start()

    def _make_cage(self):
        build, _ = engine()
        with self._stage("build"):
            self.previous = build.build_cage(self.character, self._progress(0.0, CAGE), self.previous)
        self._read_from = CAGE

    def sample(self, seconds: float = np.inf) -> bool:
        """Read the moving rig, if the job needs it, for about so long; True when all is read."""
        sampling = self._sampling
        if sampling is None:
            return True
        with self._stage("sample rig"):
            obj = find(self.session_uid)
            if self._probes() and sampling.probe is None:
                sampling.probe = self._probe = probe.Probe(obj, self.previous, self.character)
            done = sampling.advance(obj, seconds)
        self._progress(self._read_from, 0.2)(sampling.done / sampling.count, f"Reading frame {sampling.frame}")
        return done

    def _reasons(self, obj) -> list[str]:
        """Why something is to be built."""
        if self.only_cage:
            build, _ = engine()
            current = self.previous is not None and build.has_cage(self.previous, self.character)
            return [] if current else ["the cage is out of date"]
        return stale_reasons(obj, self.character) or ["asked for"] * self.rebuild

    def _take_rig(self):
        """Check what was sampled; any thread. Raises SceneError."""
        if self._sampling:
            samples, self._sampling = self._sampling.samples(), None
            before = self.rig.pose[-1] if self.rig else self.resumed.get("pose")
            if before is not None:  # the frame that was the last is the first again
                samples = samples[1:]
            self.rig = samples
            if len(samples):
                self.rig, warnings = extract.hold_collapsed(samples, self.character.skeleton, before)
                self.warnings += [text for text in warnings if text not in self.warnings]

    def start(self):
        """Begin to compute, in a thread."""
        self.thread = self._thread(self._compute)
        self.thread.start()

    def wait(self, timeout: float | None = None) -> bool:
        """True when the computation has ended. Raises what it raised, Cancelled if the user stopped it."""
        self.thread.join(timeout)
        if self.thread.is_alive():
            return False
        if self.cancelled:
            raise Cancelled
        if self._error:
            raise self._error
        return True

    def target(self):
        """The object that the results are for. Raises SceneError when they do not fit it any more."""
        for uid, vertices in self._meshes().items():
            obj = find(uid)
            if len(obj.data.vertices) != len(vertices):
                raise SceneError(f"Mesh '{obj.name}' changed while the job ran: nothing was written, start again")
        return find(self.session_uid)

    def _meshes(self) -> dict[int, np.ndarray]:
        """The vertices of all objects that results are for, by session_uid."""
        own = self.character.vertices[self.character.own]
        return {self.session_uid: own, **{f.session_uid: f.vertices for f in self.followers}}

    def of_meshes(self, bake: Bake) -> list[Bake]:
        """A bake of the whole body as one of each mesh, if they are in one cage; else it is of one mesh already."""
        if not self.character.parts:
            return [bake]
        _, simulate = engine()
        followers = (simulate.follow(self.model, bake, follower) for follower in self.followers)
        return [simulate.part_of(bake, self.character.own), *followers]

    def must_wait(self) -> bool:
        """Whether a bake cannot be written yet: the artist went on in Edit Mode, which has a mesh of its own."""
        waits = self.bake and any(find(uid).mode == "EDIT" for uid in self._meshes())
        if waits:
            self.message = "Waiting for you to leave Edit Mode"
        return waits

    def commit(self):
        """Write the results; main thread."""
        self._probe = None  # Blender's own memory, for which Python's collector need not come in time
        obj = self.target()
        with self._stage("store model"):
            self._store_model(obj)
            self._store_materials(obj)
        if not self.bake:
            return
        with self._stage("write keys"):
            self._write_keys(obj)
        record = obj.dynamorph.bake
        record.summary = self.summary()
        record.warnings = "\n".join(text for text in self.warnings if text not in self.model.summary["warnings"])
        record.inputs = json.dumps(self.inputs | {"content_id": obj.dynamorph.model.content_id})
        found = self.verdict.as_dict(self.limits)
        own = self.character.own
        record.verdict = json.dumps(found | {"vertices": [v for v in found["vertices"] if v < own.stop]})
        if self.rehearsed:
            obj.dynamorph.simulation.rehearsed = self.rehearsed
        record.content_id = self.content_id()
        record.digest = clips.digest(self.result)
        changes.look_at_animation(obj)

    def content_id(self) -> str:
        """Hash of all that the bake was made from."""
        build, _ = engine()
        made_from = [self.inputs, build.dependencies(self.character), *map(clips.digest, self.before)]
        return hashlib.sha256(json.dumps(made_from, sort_keys=True).encode()).hexdigest()

    def _write_keys(self, obj):
        pieces = [find(follower.session_uid) for follower in self.followers]
        for piece in pieces:
            sinks.check(piece, needs_keys=False)  # before anything is written
        if comparison.is_plain(obj):
            comparison.show(obj, False)
        live_key.remove(obj)
        for piece in properties.followers(obj):
            if piece not in pieces:
                sinks.free(piece)
        for each, (keys, cache) in zip((obj, *pieces), self.written, strict=True):
            self.size += sinks.write_keys(each, keys, None if each == obj else obj, cache)
            self.size += cache.stat().st_size if cache else 0

    def summary(self) -> str:
        """One line for the artist."""
        if self.only_cage:
            return self.cage_summary() if self.reasons else "the cage is up to date"
        if not self.bake:
            return self.model_summary()
        frames = self.settings.end - self.settings.start + 1
        seconds = sum(value for stage, value in self.seconds.items() if stage != "build")
        gap = f", loop gap {1000 * self.report['gap']:.3g} mm" if "gap" in self.report else ""
        off = self.report.get("keys_error", 0.0)
        error = f", {self.report['keys']} keys off by at most {1000 * off:.2g} mm" if off else ""
        seam = f", {1000 * self.report['seam']:.3g} mm from the other frames" if "seam" in self.report else ""
        return f"{frames} frames in {seconds:.1f}\u00a0s, {self.size / 2**20:.1f}\u00a0MB{error}{gap}{seam}"

    def model_summary(self) -> str:
        made = self.model.summary
        if not made["tets"]:
            return f"{self._authored_targets()}, nothing to simulate"
        kept = sum(made.get("fallbacks", {}).values())  # models of older versions do not say
        crushed = f", crushed tetrahedra: {kept}" if kept else ""
        return f"{made['nodes']} nodes, {made['modes']} modes, {self._authored_targets()}{crushed}"

    def _authored_targets(self) -> str:
        """How many there are in the panel's list: each set has the neutral one."""
        sets = self.character.by_method().target_sets
        count = 1 + sum(len(target_set.targets) - 1 for target_set in sets)
        return f"{count} target{'s' * (count > 1)}"

    def cage_summary(self) -> str:
        made = self.model.summary
        if not made["tets"]:
            return ""
        quality = made.get("quality")  # models of older versions do not say
        angles = f", angles {quality['min_dihedral']:.0f}° to {quality['max_dihedral']:.0f}°" if quality else ""
        share = made.get("held", made["pinned"] / made["nodes"])  # models of older versions have pins alone
        held = f"{share:.0%} held" + (" by bones" if made["pinned"] else "")
        return f"{made['nodes']} nodes, {made['tets']} tetrahedra, {held}{angles}"

    def _store_model(self, obj):
        record = obj.dynamorph.model
        if self.reasons:
            packed = model_file.pack(*self.model.to_arrays())
            store_model(obj, packed, self.folder)
            size = f"{len(packed) / 2**20:.1f}\u00a0MB, {self.seconds['build']:.1f}\u00a0s"
            record.summary = "" if self.only_cage else f"{self.model_summary()}, {size}"
            record.cage = self.cage_summary()
            record.vertices = self.character.own.stop
            record.warnings = "\n".join(self.model.summary["warnings"])
        elif PACKED not in obj and self.folder not in (None, _blend_folder()):
            store_model(obj, stored_model(obj), self.folder)  # the .blend moves, its model moves along
        if self.reasons or not self.only_cage:
            record.stale, record.built = "only the cage is built" if self.only_cage else "", self.built
        if self.reasons and not self.only_cage:
            obj.dynamorph.live.checks = ""
            fit_modes(obj, self.model.summary["modes"])
            self._store_references(obj)

    def _store_materials(self, obj):
        """What a build or a rehearsal has made of the targets' frequencies."""
        for target in obj.dynamorph.targets:
            index = index_in(self.character, obj, target)
            if index is None or not self.character.targets[0].frequency:
                continue
            with properties.as_computed():
                for name, value in materials.stored(self.character.targets[index]).items():
                    if getattr(target, name) != value:
                        setattr(target, name, value)

    def _store_references(self, obj):
        measured = self.character.by_method().targets
        for target in obj.dynamorph.targets:
            index = index_in(self.character, obj, target)
            bounce, volume = self.references[index] if index is not None else (0.0, 0.0)
            target.set_references(bounce, volume, measured[index or 0].material.poisson)

    def _thread(self, work) -> threading.Thread:
        return threading.Thread(target=self._work, args=[work], name=f"dynamorph {self.name}", daemon=True)

    def _work(self, work):
        try:
            work()
        except _engine_errors() as error:  # the engine does not know whose cage it works on
            named = f"'{self.name}'" in str(error)
            self._error = error if named else type(error)(f"'{self.name}': {error}")
        except BaseException as error:  # raised again in the main thread, by wait
            self._error = error

    def _compute(self):
        build, simulate = engine()
        if self.only_cage:
            if self.reasons:
                with self._stage("build"):
                    self.model = build.build_cage(self.character, self._progress(0.0, 1.0), self.previous)
            return
        self._take_rig()
        if self.model is None:
            self._build(simulate)
        if not self.bake or self.cancelled:
            return
        while True:
            self._play(simulate)
            if not self.shot.is_complete:
                return
            self._judge()
            if not self._rehearse_again():
                break
            if self._stretches > 1:  # of the rig the last is left: it is read again
                self.rig, self._stretches, self.shot = None, 1, None
                return
            self._stretches, self.shot = 0, None
        self._finish(simulate)

    def _play(self, simulate):
        """The shot, on to the end of the rig that was read."""
        with self._stage("simulate"):
            if self.shot is None:
                begin = self.fraction if self.reasons else 0.2
                self.shot = simulate.Shot(self.model, self.character, self.settings, self._progress(begin, 1.0))
                if self.resumed:
                    self.shot.resume(self.resumed, self._first)
            self.shot.play(self.rig)
            self._stretches += 1
        if self.kept and len(self.rig):  # else nothing was left to do
            self.share.keep(self.kept, self.shot, self.rig.pose[-1])

    def _judge(self):
        with self._stage("simulate"):
            self.result, self.report = self.shot.bake()
        with self._stage("judge"):
            self.verdict = judge.judge(self.model, self.character, self.result)
        self.report["inverted_volume"] = self.verdict.inverted

    def _rehearse_again(self) -> bool:
        """Go on with another frequency, if there is a rehearsal and it asks for one; else with the best."""
        rehearsal = self._rehearsal
        if not rehearsal:
            return False
        now = self.character.targets[0].frequency
        rehearsal.learn(now, self.verdict.excess(self.limits))
        if rehearsal.best == now:
            self._best = self.character, self.result, self.report, self.verdict
        frequency = rehearsal.next()
        if frequency:
            self._adopt(materials.stiffened(self.character, frequency / now))
            return True
        self._rehearsal = None
        character, self.result, self.report, self.verdict = self._best
        if rehearsal.best != now:
            self._adopt(character)
        if rehearsal.best != rehearsal.asked:
            kept = self.verdict.excess(self.limits) <= judge.SHOWS
            outcome = ": the skin stays within Max Displacement" if kept else ", and the skin still moves too far"
            self.rehearsed = f"Bounce raised from {rehearsal.asked:.3g} to {rehearsal.best:.3g} Hz{outcome}"
        return False

    def _adopt(self, character):
        """Go on with other materials, which are stored when the job is written."""
        self.character = character
        neutrals = np.cumsum([0, *(len(each.targets) for each in character.target_sets)])
        for index, target in enumerate(character.targets):
            name = "" if index == 0 else target.name
            known = self.inputs.get("targets", {}).get(name)
            if known is not None and (index == 0 or index not in neutrals):
                known |= {key: value for key, value in materials.stored(target).items() if key in known}

    def _build(self, simulate):
        built = 0.95 if self.character.settings.fit_to_shot else 0.7
        with self._stage("build"):
            self.model = self._shared_model
            if not self.model:
                progress = self._progress(0.2, built if self.bake else 1.0)
                self.model = simulate.build_for(self.character, self.rig, self.settings, progress, self.previous)
                if self._shares_model:
                    self.share.keep_model(self.model)
        with self._stage("measure"):
            for reference in materials.references(self.model, self.character):
                self.references.append(reference)
                if self.cancelled:
                    return
        self._adopt(materials.calibrated(self.character, self.references))
        self.fraction = built
        self.warnings += self.model.summary["warnings"]

    def _finish(self, simulate):
        outside = [] if self.character.parts else self.followers
        self.carried = [simulate.follow(self.model, self.result, follower) for follower in outside]
        for name in ("coordinates", "weights", "modes", "details", "dry"):
            if not all(np.isfinite(getattr(bake, name)).all() for bake in (self.result, *self.carried)):
                raise SelfCheckError(f"'{self.name}': the engine's {name} are not numbers: nothing was written")
        self.message = "Making keys"
        with self._stage("make keys"):
            if self.before:
                self._splice()
            self._make_keys()
        self.warnings += self.report["warnings"]
        first, last = self.model.summary.get("fitted", (self.settings.start, self.settings.end))
        if self.settings.start < first or self.settings.end > last:
            self.warnings.append(f"The modes were fitted to frames {first} to {last}: press Build Model")
        found = self.verdict.as_dict(self.limits)
        if not found["ok"]:
            self.warnings.append(f"{found['text']}. Raise Bounce or Cage Nodes, or paint Softness")

    def _to_metres(self) -> list[np.ndarray]:
        """Local to metric space (3, 3) of the body, and of what follows it outside of its cage."""
        to_bind, outside = self.character.to_bind, self.followers[: len(self.carried)]
        return [to_bind, *(to_bind @ np.linalg.inv(follower.from_body) for follower in outside)]

    def _splice(self):
        """Make the results parts of the bakes that there were."""
        parts = zip(self.before, (self.result, *self.carried), self._to_metres(), strict=True)
        spliced = [clips.splice(before, part, FADE, to_metres) for before, part, to_metres in parts]
        self.result, *self.carried = (bake for bake, _ in spliced)
        self.report["seam"] = max(seam for _, seam in spliced)

    def _make_keys(self):
        """What the results become, apart from Blender: shape keys, and the files of point caches."""
        names = self.name, *(follower.name for follower in self.followers)
        points_of = self.character.vertices[self.character.own], *(follower.points for follower in self.followers)
        off, all_keys, bakes = 0.0, [], []
        for name, whole, to_metres in zip(names, (self.result, *self.carried), self._to_metres(), strict=False):
            try:
                keys, error = clips.as_keys(whole, self.output, to_metres)
            except clips.ClipError as refusal:
                raise SceneError(f"'{name}': {refusal}") from refusal
            off = max(off, error)
            all_keys += self.of_meshes(keys)
            bakes += self.of_meshes(whole)
        for name, points, bake, keys in zip(names, points_of, bakes, all_keys, strict=True):
            cache = None
            if self.output.sink in clips.CACHES:
                content = clips.digest(bake, points, self.settings.fps)
                default = sinks.cache_path(self.caches, name, content, self.output.sink)
                cache = self.cache_files.get(name, default)
                model_file.save(cache, clips.CACHES[self.output.sink](bake, points, self.settings.fps))
            self.written.append((keys, cache))
        self.report["keys"] = len(self.written[0][0].modes) + len(self.written[0][0].details)
        self.report["keys_error"] = off

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


class Batch:
    """Jobs one after the other, of which all are written when all are done: one undo step, or nothing.

    goal: the button's, as in Job, or "BAKE_ALL".
    """

    def __init__(self, jobs: list[Job], goal: str):
        self.jobs = jobs
        self.goal = goal
        self.undone = False  # by the user, since it began
        self._at = jobs[0]

    @property
    def name(self) -> str:
        return self._at.name

    @property
    def message(self) -> str:
        return f"{self.name}: {self._at.message}" if len(self.jobs) > 1 else self._at.message

    @property
    def fraction(self) -> float:
        return sum(job.fraction for job in self.jobs) / len(self.jobs)

    def cancel(self):
        for job in self.jobs:
            job.cancelled = True

    def steps(self, seconds: float = np.inf, pause: float = 0.1) -> Iterator[None]:
        """The work, main thread. Yields when it has held that for about so many seconds, and every `pause` seconds
        while a thread computes. Raises Cancelled, SceneError and what the threads raise.
        """
        for job in self.jobs:
            self._at = job
            job.read()
            yield from self._turn(reading=True)
        for job in filter(Job.needs_cage, self.jobs):
            self._at = job
            job.start_cage()
            while not job.wait(pause):
                yield from self._turn(reading=True)
        for job in self.jobs:
            self._at = job
            while not job.sample(seconds):
                yield from self._turn(reading=True)
        for job in self.jobs:
            self._at = job
            yield from self._computed(job, pause)
            while job.go_on():
                yield from self._turn(reading=True)
                while not job.sample(seconds):
                    yield from self._turn(reading=True)
                yield from self._computed(job, pause)
        while waiting := next((job for job in self.jobs if job.must_wait()), None):
            self._at = waiting
            yield from self._turn()
        for job in self.jobs:
            job.target()
        for job in self.jobs:
            job.commit()

    def _computed(self, job: Job, pause: float) -> Iterator[None]:
        job.start()
        while not job.wait(pause):
            yield from self._turn()

    def _turn(self, reading=False) -> Iterator[None]:
        """The window's turn, and what came of it."""
        yield
        if self._at.cancelled:
            raise Cancelled
        if reading and self.undone:
            raise SceneError(f"The scene was undone while '{self.name}' was read: nothing was written, start again")

    def abandon(self):
        """Cancel, and leave the thread to end when the engine notices; what it comes to is dropped."""
        self.cancel()
        winding_down[:] = [thread for thread in (*winding_down, *self._threads()) if thread.is_alive()]

    def stop(self):
        """Cancel, and wait until the thread has left the engine."""
        self.cancel()
        for thread in self._threads():
            thread.join()

    def _threads(self) -> list[threading.Thread]:
        return [job.thread for job in self.jobs if job.thread.is_alive()]


def run(job: Job, tick=None):
    """The whole job at once. tick(job) is called in the main thread about ten times a second."""
    run_all(Batch([job], job.goal), tick and (lambda _batch: tick(job)))


def run_all(batch: Batch, tick=None):
    """All jobs at once, or nothing. tick(batch): as in `run`."""
    try:
        for _ in batch.steps():
            if tick:
                tick(batch)
    except BaseException:
        batch.stop()
        raise


def stop():
    """Cancel what runs, and wait until no thread is in the engine: Blender, its file or the add-on goes away."""
    global running
    if running:
        running.stop()
        running = None
    while winding_down:
        winding_down.pop().join()
