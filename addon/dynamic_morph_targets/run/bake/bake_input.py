# SPDX-License-Identifier: GPL-3.0-or-later
"""The request of a job, and what it reads of Blender: the character and its settings at once, then the moving rig in
chunks.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core import engine, errors, memory, records
from ...core.character import Attachment
from ...core.errors import SceneError
from ...core.message import Message, joined
from ...core.model import build
from ...core.model.model import Model
from ...core.result.keys import united
from ...io import outputs, paths
from ...io.cache_dir import CacheDir
from ...scene import animation, keyed
from ...scene.character import extract
from ...scene.check import animation_checks
from ...scene.motion import collider_state, colliders, rig_motion, run_settings
from ...scene.read import probe
from ...scene.read.source import Source
from ...scene.skin import ObjectHandle, SceneHandle
from ...scene.skinning import Skinning
from ...scene.store import staleness
from ...scene.store.model_store import blend_folder, load_model, stale_reasons
from ...write.bake.baked_action import check_rig_action
from ...write.bake.reading import read_back
from ...write.bake.writer import check_bake, check_cache, check_local, overwritten_keys
from ...write.reconcile import reconcile
from ..work.job_data import BakeInput

CHUNK_FRAMES = 1000  # of a shot, that are read and simulated at once: bounds memory
COLLIDER_BYTES = 2**28  # of a chunk that those colliders take which may deform
FITTED = (
    "The modes are fitted to this shot, so the cache folder keeps no model, and a bake that builds one starts over if "
    "it is stopped. With --no-fit-to-shot models are shared and bakes resume"
)
SHORT_CHUNK_FRAMES = 100  # where each node is read, or chunks are kept for other processes, which go on from there


@dataclass(frozen=True)
class Request:
    """What a job is asked for.

    target: the object. goal: "BUILD", "BUILD_CAGE" (the model's tetrahedra alone) or "BAKE", which builds too where
    that is necessary. frames: (start, end), substeps, and changes, by name, override the object's settings of the
    simulation. solver: its quality, REDUCED or FULL, if not that of the object's bakes. folder: where large models go.
    rebuild: build even when the model is up to date. cache_dir: where built models and unfinished bakes are kept for
    other processes. cache_files: where point caches go, by mesh, if not where they go by default. whole: the shot is
    one chunk. stored: the result goes into Blender. drafts: as in `BakeInput`.
    """

    target: ObjectHandle
    scene: SceneHandle
    name: str
    goal: str
    frames: tuple[int, int] | None = None
    substeps: int | None = None
    solver: str = ""
    folder: Path | None = None
    rebuild: bool = False
    cache_dir: CacheDir | None = None
    cache_files: Mapping[str, Path] = field(default_factory=dict)
    whole: bool = False
    stored: bool = True
    drafts: bool = False
    changes: Mapping[str, Any] = field(default_factory=dict)


def read(request: Request) -> BakeInput:
    """Check and read the character and its settings. Raises SceneError, WriteError, ModelFileError, OSError."""
    engine.load()
    obj = request.target.find()
    if request.goal == "BAKE" and obj.override_library:
        check_bake(obj)
    else:
        check_local(obj)
    if obj.type == "MESH":
        reconcile(obj)
    source = Source.of(Skinning.of(obj))
    character = extract.read(source, without_targets=request.goal == "BUILD_CAGE")
    given = BakeInput(request.name, request.goal, character, cache_files=dict(request.cache_files))
    given.drafts = request.drafts
    if given.goal == "BUILD" and (given.drafts or obj.dynamorph.live.key.name or not bpy.app.background):
        with suppress(SceneError):  # Live will say so
            given.live = run_settings.simulation_settings(obj, bpy.context.scene)
    if given.is_bake:
        check_bake(obj)
        for each in handles(character.attachments):
            check_bake(each.find(), obj)
    given.notes = extract.warnings(source)
    if given.is_bake:  # what the bake lacks for that stays said when the keys are gone
        given.warnings += [problem.text for problem in animation_checks.keyed_settings(obj)]
        given.notes = [text for text in given.notes if text not in given.warnings]
    if given.is_bake and request.stored:
        _read_output(given, obj, request.folder)
    fits = _read_model(given, obj, request)
    if given.reasons and obj.override_library:
        raise SceneError(
            "'{name}' is a library override, which keeps no model: open the file that it is linked from, press Build "
            "Model and save it ({reasons})",
            name=obj.name,
            reasons=joined("; ", given.reasons),
        )
    if given.is_bake or (fits and not given.only_cage):
        _read_shot(given, source.skinning, request, fits)
    if given.output and given.output.format == "PC2":
        _try_caches(given)
        for name in (given.name, *(each.name for each in character.attachments)):
            place = given.cache_files.get(name) or paths.cache_path(given.caches, name, "")
            outputs.remove_abandoned(place)
            given.unfinished[name] = outputs.partial_of(place)
    _check_memory(given)
    return given


def _check_memory(given: BakeInput) -> None:
    """Refuse, before any work, what there is not enough memory for. Raises SceneError, MemoryShortError."""
    character, model = given.character, given.model or given.cached_model
    settings = character.settings
    nodes = settings.cage_nodes if model is None else model.summary.nodes
    size = memory.Size(len(character.vertices), len(character.targets), len(character.skeleton.names), nodes)
    if given.reasons and model is None:
        changes = {"solver": "FULL"} if given.only_cage else {"modes": settings.rehearsed_modes}
        memory.check(given.name, memory.build_bytes(size, replace(settings, **changes), os.cpu_count() or 1))
    if given.has_shot:
        settings = given.simulated.settings
        chunk = given.frames_per_chunk
        memory.check(given.name, memory.bake_bytes(size, settings, given.settings, chunk))


def _frames_per_chunk(given: BakeInput, obj: bpy.types.Object) -> int:
    if given.whole:
        return given.settings.frame_end - given.settings.first
    frames = SHORT_CHUNK_FRAMES if given.kept or given.character.probed else CHUNK_FRAMES
    bytes_per_frame = 12 * colliders.deforming_vertices(obj) * given.settings.substeps
    return min(frames, max(COLLIDER_BYTES // max(bytes_per_frame, 1), 1))


def handles(attachments: Sequence[Attachment]) -> list[ObjectHandle]:
    """The handles of the other meshes of a body."""
    return [ObjectHandle(each.session_uid, each.name) for each in attachments]


def _read_output(given: BakeInput, obj: bpy.types.Object, folder: Path | None) -> None:
    """The form of the bake in Blender. Raises WriteError."""
    given.output = obj.dynamorph.output.settings()
    check_rig_action(obj)
    if given.output.format != "PC2":
        return
    caches = folder or blend_folder()
    check_cache(obj, caches)
    assert caches is not None  # that would have been refused
    given.caches = caches
    for mesh in (obj, *(handle.find() for handle in handles(given.character.attachments))):
        lost = ", ".join(f"'{name}'" for name in overwritten_keys(mesh))
        if lost:
            given.warnings.append(
                Message(
                    "The point cache of '{name}' plays over these shape keys: {lost}. Bake to Shape Keys to keep them",
                    name=mesh.name,
                    lost=lost,
                )
            )


def _try_caches(given: BakeInput) -> None:
    """Find out whether the point caches can be written. Raises OSError."""
    surfaces = {given.name: given.character.vertices[given.character.own_vertices]}
    surfaces |= {each.name: each.points for each in given.character.attachments}
    sizes: Counter[Path] = Counter()
    for name, vertices in surfaces.items():
        file = given.cache_files.get(name)
        folder = file.parent if file else given.caches / paths.CACHE_FOLDER
        sizes[folder] += 12 * len(given.settings.frames) * len(vertices)
    for folder, size in sizes.items():
        outputs.try_folder(folder)
        outputs.check_space(folder, size)


def _read_model(given: BakeInput, obj: bpy.types.Object, request: Request) -> bool:
    """The existing model, and why another one must be built; True if that is fitted to the shot."""
    with suppress(errors.ModelFileError):  # then one of the reasons
        given.previous = load_model(obj)
    given.reasons = _reasons(given, obj, request.rebuild)
    chosen, built_from = given.character.settings, staleness.model_inputs(obj)
    if not given.reasons and given.previous is not None:
        given.model = given.previous.with_settings(chosen)
        built_from["model"]["solver"] = given.previous.settings.solver
    given.built_from = records.text(built_from)
    fits = bool(given.reasons) and chosen.fits_shot
    given.cache_dir = request.cache_dir
    given.caches_model = bool(given.cache_dir) and not chosen.fits_shot  # a fitted one depends on the shot
    if given.cache_dir and (fits or (chosen.fits_shot and not given.is_bake)):
        given.notes.append(FITTED)
    if given.reasons and given.cache_dir and given.caches_model:
        given.cached_model = given.cache_dir.built(given.character)
        given.previous = given.cached_model or given.previous
    return fits


def _reasons(given: BakeInput, obj: bpy.types.Object, rebuild: bool) -> list[str]:
    """Why something must be built."""
    if given.only_cage:
        current = given.previous is not None and build.has_cage(given.previous, given.character)
        return [] if current else ["the cage is out of date"]
    if not obj.dynamorph.model.content_id:
        return ["there was no model"]
    return stale_reasons(obj, given.character) or ["it was asked for"] * rebuild


def _read_shot(given: BakeInput, skinning: Skinning, request: Request, fits: bool) -> None:
    """The settings of the simulation, and the part of its result that exists already."""
    obj = skinning.obj
    settings = run_settings.simulation_settings(obj, bpy.context.scene, request.frames, request.substeps)
    given.has_shot, given.settings = True, replace(settings, **request.changes)
    given.solver = request.solver or run_settings.bake_solver(obj)
    given.inputs = staleness.bake_inputs(skinning, given.settings)
    given.keyed = tuple(each.path.removeprefix("dynamorph.") for each in keyed.settings(obj) if each.moved)
    given.inputs |= {"animation": animation.animation(skinning), "painted": staleness.map_hash(given.character)}
    given.inputs |= {"colliders": collider_state.states(obj)} if given.settings.collision else {}
    chosen = obj.dynamorph.simulation
    is_part = chosen.is_patch or (chosen.keep_outside and request.frames)
    if given.output and is_part and obj.dynamorph.bake.exists:
        _read_kept(given, obj)
    given.whole = request.whole or given.settings.loop or fits
    pieces = not (given.whole or given.before or given.character.probed)
    given.resumable = given.is_bake and pieces and not colliders.pressed(obj)
    if given.cache_dir and given.resumable:
        files = animation.source_files()
        given.kept = given.cache_dir.bake_path(given.name, given.inputs, given.simulated, files, bpy.app.version)
        model = given.model or given.cached_model
        if model:
            model = model.with_settings(given.simulated.settings)
            given.resumed = given.cache_dir.unfinished(given.kept, model, len(given.settings.times))
    given.frames_per_chunk = _frames_per_chunk(given, obj)
    if given.resumed:
        first = given.settings.first
        given.first = rig_motion.sample_rig(obj, first, first, 1)


def _read_kept(given: BakeInput, obj: bpy.types.Object) -> None:
    """The bake into which the frames go, and the run-up to them. Raises SceneError, WriteError."""
    attachments = given.character.attachments
    meshes = (obj, *(handle.find() for handle in handles(attachments)))
    to_body = [np.eye(3), *(np.linalg.inv(each.from_body) for each in attachments)]
    given.before = united([read_back(mesh, given.settings.samples) for mesh in meshes], to_body)
    settings, (first, last) = given.settings, given.before.frames[[0, -1]].astype(int).tolist()
    if settings.frame_start > last + 1 or settings.frame_end < first - 1:
        raise SceneError(
            "'{name}': frames {start} to {end} are not next to those of the last bake, {first} to {last}: choose "
            "others, or turn Keep Other Frames off",
            name=given.name,
            start=settings.frame_start,
            end=settings.frame_end,
            first=first,
            last=last,
        )
    whole = {"frame_start": min(settings.frame_start, first), "frame_end": max(settings.frame_end, last)}
    given.inputs["simulation"] |= whole
    run_up = min(settings.frame_start - whole["frame_start"], round(settings.rate))
    changes = staleness.outdated(obj)
    if changes:
        given.warnings.append(Message("Since the other frames were baked: {changes}", changes=joined(", ", changes)))
    if settings.loop:
        given.warnings.append("A part of a bake cannot be a loop: Loop is ignored")
    given.settings = replace(settings, loop=False, run_up=run_up)


class RigReader:
    """Reads the rig of a shot a chunk after the other, each in slices between which Blender does other things.

    sampling: of the chunk that is being read; None for a job that needs no rig.
    """

    def __init__(self, request: Request, given: BakeInput):
        self.sampling: rig_motion.RigSampling | None = None
        self._object, self._given = request.target, given
        self._probe: probe.Probe | None = None  # Blender's own memory

    def begin_chunk(self, done: int) -> None:
        """Continue after this many states of the shot. Raises SceneError."""
        given = self._given
        if not given.has_shot:
            return
        settings = given.settings
        first = settings.reached(done)
        end = min(first + given.frames_per_chunk, settings.frame_end)
        obj, together = self._object.find(), given.together
        self.sampling = rig_motion.RigSampling(obj, first, end, settings.substeps, together)
        self.sampling.probe = self._probe

    def advance(self, seconds: float, model: Model | None) -> bool:
        """Read the chunk for about so many seconds; True when everything is read. model: its cage has the nodes that
        are probed.
        """
        sampling, given, obj = self.sampling, self._given, self._object.find()
        assert sampling is not None  # a chunk has begun
        if given.is_probed and sampling.probe is None:
            assert model is not None  # `needs_cage` has it made first
            sampling.probe = self._probe = probe.Probe(obj, model, given.character)
        return sampling.advance(obj, seconds)

    def leave(self) -> None:
        """Nothing more of the chunk is read."""
        if self.sampling:
            self.sampling.close()

    def end_chunk(self) -> rig_motion.RigSampling | None:
        """The chunk that was read."""
        sampling, self.sampling = self.sampling, None
        return sampling

    def free(self) -> None:
        """Free Blender's memory at once, without waiting for Python's garbage collector."""
        self._probe = None
