# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds the model of one object where that is necessary, simulates its shot, and writes it."""

from __future__ import annotations

import hashlib
import json
import threading
import time
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

from .. import preferences
from ..core import baked, calibration, engine, errors, judge, rig_samples
from ..core.baked import Bake
from ..core.errors import Cancelled, SceneError, SelfCheckError
from ..core.keys import as_keys, splice, united
from ..core.rehearsal import Rehearsal
from ..io import cache_dir, model_file, paths, point_cache
from ..scene import animation, extract, probe, rig_motion, run_settings, skin, staleness, target_properties
from ..scene.model_store import PACKED, blend_folder, index_in, load_model, stale_reasons, stored_model
from ..scene.skin import find
from ..write import comparison, live_key
from ..write.bake import check, check_cache, check_local, free, overwritten_keys, read_back, write_keys
from ..write.reconcile import reconcile
from ..write.storage import fit_modes, store_model

CAGE = 0.1  # of a job, the part that a cage takes if the rig cannot be read without
FADE = 5  # frames in which a part that is baked again goes over into the rest
STRETCH = 1000  # frames of a shot that are read and simulated at once: bounds memory
SHORT_STRETCH = 100  # where each node is read, or where they are kept for other processes, which go on from there


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
        share: cache_dir.Share | None = None, rehearse=False,
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
        engine.engine()
        preferences.use_threads()
        obj = find(self.session_uid)
        check_local(obj)
        if obj.type == "MESH":
            reconcile(obj)
        self.character = extract.character(obj, without_targets=self.only_cage)
        if self.bake:
            check(obj)
            self.followers = extract.followers(obj, self.character)
            for follower in self.followers:
                check(find(follower.session_uid), needs_keys=False)
        self.warnings = extract.warnings(obj, self.character)
        self.warnings += extract.far_followers(self.character, self.followers)
        if self.bake:
            self._read_output(obj)
        with suppress(errors.ModelFileError):  # then one of the reasons
            self.previous = load_model(obj)
        self.reasons = self._reasons(obj)
        if not self.reasons:
            self.model = self.previous
        self.built = json.dumps(staleness.model_inputs(obj))
        chosen = self.character.settings
        fits = bool(self.reasons) and chosen.fit_to_shot and chosen.solver == "REDUCED" and chosen.method != "STATIC"
        self._shares_model = bool(self.share) and not fits  # a fitted one depends on the shot
        if self.reasons and self._shares_model:
            self._shared_model = self.share.built(self.character)
            self.previous = self._shared_model or self.previous
        if self.only_cage or not (self.bake or fits):
            return
        self.settings = settings = run_settings.simulation_settings(obj, bpy.context.scene, self.frames, self.substeps)
        self.inputs = staleness.bake_inputs(obj, settings) | {"animation": animation.animation(obj)}
        chosen = obj.dynamorph.simulation
        self._read_limits(chosen)
        if self.bake and (chosen.is_patch or (chosen.keep_outside and self.frames)):
            self._read_kept(obj)
        self._whole = whole or settings.loop or fits
        if self.share and self.bake and not (self._whole or self.before or self.character.probed):
            files = animation.source_files()
            self.kept = self.share.bake_path(self.name, self.inputs, self.character, files, bpy.app.version)
            model = self.model or self._shared_model
            self.resumed = self.share.unfinished(self.kept, model) if model else {}
        if self.resumed:
            self._first = rig_motion.sample_rig(obj, settings.first, settings.first, 1)
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
        self.before = [read_back(find(uid), self.settings.samples) for uid in self._meshes()]
        if self.character.parts:
            to_body = [np.eye(3), *(np.linalg.inv(follower.from_body) for follower in self.followers)]
            self.before = [united(self.before, to_body)]
        settings, (first, last) = self.settings, self.before[0].frames[[0, -1]].astype(int).tolist()
        if settings.start > last + 1 or settings.end < first - 1:
            raise SceneError(
                f"'{self.name}': frames {settings.start} to {settings.end} are not next to those of the last bake, "
                f"{first} to {last}: choose others, or turn Keep Other Frames off"
            )
        whole = {"start": min(settings.start, first), "end": max(settings.end, last)}
        self.inputs["simulation"] |= whole
        run_up = min(settings.start - whole["start"], max(settings.preroll, round(settings.fps)))
        since = ", ".join(staleness.outdated(obj))
        if since:
            self.warnings.append(f"Since the other frames were baked: {since}")
        if settings.loop:
            self.warnings.append("A part of a bake cannot be a loop: Loop is ignored")
        self.settings = replace(settings, loop=False)
        if run_up:
            self.settings = replace(self.settings, preroll=run_up, preroll_pose="ANIMATED")

    def _read_output(self, obj):
        self.output = run_settings.output_settings(obj)
        if self.output.sink in point_cache.CACHES:
            self.caches = self.folder or blend_folder()
            check_cache(obj, self.caches)
            for mesh in map(find, self._meshes()):
                lost = ", ".join(f"'{name}'" for name in overwritten_keys(mesh))
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
        self._sampling = rig_motion.RigSampling(obj, first, min(first + frames, settings.end), settings.substeps)
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
        build, _ = engine.engine()
        return self._probes() and not (self.previous and build.has_cage(self.previous, self.character))

    def _probes(self) -> bool:
        return bool(self._sampling and self.character.probed and self.character.settings.method != "STATIC")

    def start_cage(self):
        """Begin to make the cage, in a thread."""
        self.thread = self._thread(self._make_cage)
        self.thread.start()

    def _make_cage(self):
        build, _ = engine.engine()
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
            build, _ = engine.engine()
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
                self.rig, warnings = rig_samples.hold_collapsed(samples, self.character.skeleton, before)
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
        from ..core import followers, simulate  # which need the engine

        carried = (followers.follow(self.model, bake, follower) for follower in self.followers)
        return [simulate.part_of(bake, self.character.own), *carried]

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
        record.digest = baked.digest(self.result)
        staleness.look_at_animation(obj)

    def content_id(self) -> str:
        """Hash of all that the bake was made from."""
        build, _ = engine.engine()
        made_from = [self.inputs, build.dependencies(self.character), *map(baked.digest, self.before)]
        return hashlib.sha256(json.dumps(made_from, sort_keys=True).encode()).hexdigest()

    def _write_keys(self, obj):
        pieces = [find(follower.session_uid) for follower in self.followers]
        for piece in pieces:
            check(piece, needs_keys=False)  # before anything is written
        if comparison.is_plain(obj):
            comparison.show(obj, False)
        live_key.remove(obj)
        for piece in skin.followers(obj):
            if piece not in pieces:
                free(piece)
        for each, (keys, cache) in zip((obj, *pieces), self.written, strict=True):
            self.size += write_keys(each, keys, None if each == obj else obj, cache)
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
        elif PACKED not in obj and self.folder not in (None, blend_folder()):
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
            with target_properties.as_computed():
                for name, value in calibration.stored(self.character.targets[index]).items():
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
        except engine.engine_errors() as error:  # the engine does not know whose cage it works on
            named = f"'{self.name}'" in str(error)
            self._error = error if named else type(error)(f"'{self.name}': {error}")
        except BaseException as error:  # raised again in the main thread, by wait
            self._error = error

    def _compute(self):
        build, simulate = engine.engine()
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
        self._finish()

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
            self._adopt(calibration.stiffened(self.character, frequency / now))
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
                known |= {key: value for key, value in calibration.stored(target).items() if key in known}

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
            for reference in calibration.references(self.model, self.character):
                self.references.append(reference)
                if self.cancelled:
                    return
        self._adopt(calibration.calibrated(self.character, self.references))
        self.fraction = built
        self.warnings += self.model.summary["warnings"]

    def _finish(self):
        from ..core import followers  # which needs the engine

        outside = [] if self.character.parts else self.followers
        self.carried = [followers.follow(self.model, self.result, follower) for follower in outside]
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
            self.warnings.append(f"{found['text']}. Raise Bounce or Cage Nodes, or paint the Softness Map")

    def _to_metres(self) -> list[np.ndarray]:
        """Local to metric space (3, 3) of the body, and of what follows it outside of its cage."""
        to_bind, outside = self.character.to_bind, self.followers[: len(self.carried)]
        return [to_bind, *(to_bind @ np.linalg.inv(follower.from_body) for follower in outside)]

    def _splice(self):
        """Make the results parts of the bakes that there were."""
        parts = zip(self.before, (self.result, *self.carried), self._to_metres(), strict=True)
        spliced = [splice(before, part, FADE, to_metres) for before, part, to_metres in parts]
        self.result, *self.carried = (bake for bake, _ in spliced)
        self.report["seam"] = max(seam for _, seam in spliced)

    def _make_keys(self):
        """What the results become, apart from Blender: shape keys, and the files of point caches."""
        names = self.name, *(follower.name for follower in self.followers)
        points_of = self.character.vertices[self.character.own], *(follower.points for follower in self.followers)
        off, all_keys, bakes = 0.0, [], []
        for name, whole, to_metres in zip(names, (self.result, *self.carried), self._to_metres(), strict=False):
            try:
                keys, error = as_keys(whole, self.output, to_metres)
            except errors.ClipError as refusal:
                raise SceneError(f"'{name}': {refusal}") from refusal
            off = max(off, error)
            all_keys += self.of_meshes(keys)
            bakes += self.of_meshes(whole)
        for name, points, bake, keys in zip(names, points_of, bakes, all_keys, strict=True):
            cache = None
            if self.output.sink in point_cache.CACHES:
                content = baked.digest(bake, points, self.settings.fps)
                default = paths.cache_path(self.caches, name, content, self.output.sink)
                cache = self.cache_files.get(name, default)
                model_file.save(cache, point_cache.CACHES[self.output.sink](bake, points, self.settings.fps))
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
