# SPDX-License-Identifier: GPL-3.0-or-later
"""How far the reduced motion of a new model is from Full Quality, found in the background after a build or bake.

The motion is the same for every character: the Shake Test's hop, in the pose that shows. For a whole body the error is
near that of its worst clip (docs/panels/detail.md). What was found is kept by what it depends on, so that neither
undo nor redo loses it, and goes into the file when that is saved.
"""

from __future__ import annotations

import hashlib
import json
import threading
import time
from collections.abc import Sequence
from dataclasses import replace

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core import engine, logger
from ..core.errors import SceneError
from ..core.geometry import vertex_areas
from ..core.motion import baked, simulate
from ..core.settings import SimulationSettings
from ..scene import events, probe, rig_motion, run_settings, staleness
from ..scene.skin import ObjectHandle, soft_skins
from ..scene.skinning import Skinning
from . import batch, preview
from .job import Job

FRAMES, FPS, SUBSTEPS = 30, 24.0, 5  # of the motion: two hops, and how they end
LARGEST = 30_000  # degrees of freedom; with more an unreduced step takes too long to be taken unasked
TICK = 0.25  # seconds from one look at the thread to the next

found: dict[str, float] = {}  # by `_key`, since Blender was started
measuring: list[Measurement] = []  # one after the other, by `thread`
thread = threading.Thread()  # the last one that was started


class Measurement:
    """The error of one model, which a job has built or used. Raises SceneError when the rig cannot be read.

    key: what it depends on. pauses: whether to wait, because the computer has better things to do.
    """

    def __init__(self, job: Job):
        obj = job.target()
        self.object, self.key = ObjectHandle.of(obj), _key(obj)
        self.pauses = self.canceled = False
        self._model, self._character, self._settings = job.outcome.model, job.outcome.character, _settings(obj)
        nodes = probe.Probe(obj, self._model, self._character) if self._character.probed else None
        self._still = rig_motion.sample_present(obj, nodes)

    def run(self) -> float:
        """In any thread. Raises dynamorph.Cancelled, and what else the engine raises."""
        model, character = self._model, self._character
        settings = [replace(character.settings, solver=solver) for solver in ("REDUCED", "FULL")]
        shots = [simulate.Shot(model.with_settings(each), character, self._settings, self.goes_on) for each in settings]
        hop = self._still.moved(preview.shake_transforms("HOP", self._still, shots[0].player, FRAMES / FPS))
        for shot in shots:
            shot.play(hop)
        reduced, full = (shot.bake(exact=shot is shots[1])[0] for shot in shots)  # exact reduced ones take memory
        areas = vertex_areas(character.bind_points, character.triangles)
        return baked.motion_distance(reduced, full, character.to_bind, areas)

    def goes_on(self, _fraction: float, _message: str) -> bool:
        """Asked by the simulation, in the thread."""
        while self.pauses and not self.canceled:
            time.sleep(TICK)
        return not self.canceled


def known(obj: bpy.types.Object) -> float | None:
    """The error of the model of `obj` with its present settings, as a fraction of the motion, if it was measured."""
    record = obj.dynamorph.model
    if not _concerns(record) or not (found or record.expected_from):
        return None
    key = _key(obj)
    return record.expected_error if record.expected_from == key else found.get(key)


def summary(obj: bpy.types.Object) -> str:
    """What the panel says of it, or ''."""
    error = known(obj)
    if error is not None:
        return iface_("Expected error: {percent:.0f} % of the motion").format(percent=100 * error)
    return iface_("Expected error: measuring...") if any(_is_of(each, obj) for each in measuring) else ""


def begin(jobs: Sequence[Job]) -> None:
    """Measure, in the background, the models of jobs that have ended, where that is not known. Only in a window: a farm
    has others to wait for it.
    """
    global thread
    cancel()
    if bpy.app.background:
        return
    for job in jobs:
        try:
            with job.request.scene.as_context():
                if _is_wanted(job):
                    measuring.append(Measurement(job))
        except engine.expected_errors():  # then it is not known
            continue
    if measuring:
        thread = threading.Thread(target=_run, args=[list(measuring)], name="dynamorph measurement", daemon=True)
        thread.start()
        events.soon(look, TICK)


def cancel() -> None:
    """What is measured now is not needed any more, or stands in the way."""
    for each in measuring:
        each.canceled = True
    measuring.clear()
    events.forget(look)
    if thread.is_alive():
        batch.winding_down.append(thread)


def store() -> None:
    """Note what was found with the objects, before their file is saved."""
    for obj in soft_skins(bpy.data.objects) if found else ():
        record = obj.dynamorph.model
        key = _key(obj) if obj.is_editable and _concerns(record) else ""
        if key in found and key != record.expected_from:
            record.expected_error, record.expected_from = found[key], key


def _run(measurements: Sequence[Measurement]) -> None:
    """In a thread. Nobody waits for it, so that no error is the artist's concern."""
    for each in measurements:
        if each.canceled:
            continue
        try:
            found[each.key] = each.run()
        except Exception as error:
            if not (each.canceled or isinstance(error, engine.expected_errors())):
                logger.log_bug(error)


def look() -> float | None:
    """By a timer: whether what is measured is still of use, may go on, or has ended."""
    for each in measuring:
        each.pauses = plays()
        each.canceled = each.canceled or not _is_present(each)
    if thread.is_alive():
        return TICK  # seconds from now
    measuring.clear()
    events.redraw(events.PANELS)
    return None


def plays() -> bool:
    """Whether something moves on the screen, which the measurement would slow down."""
    return preview.preview is not None or events.is_playing()


def _is_present(measurement: Measurement) -> bool:
    """Whether its object is still what it was, for all that the error depends on."""
    try:
        return _is_of(measurement, measurement.object.find())
    except SceneError:
        return False


def _is_of(measurement: Measurement, obj: bpy.types.Object) -> bool:
    return measurement.key == _key(obj)


def _is_wanted(job: Job) -> bool:
    """Whether the error of its model concerns the artist, is not known, and is soon found."""
    obj = job.target()
    return _concerns(obj.dynamorph.model) and known(obj) is None and 0 < len(job.outcome.model.modes) <= LARGEST


def _concerns(record: bpy.types.PropertyGroup) -> bool:
    """Whether there is a model whose reduced motion shows."""
    return bool(record.content_id) and record.solver == "REDUCED" and record.method != "STATIC"


def _settings(obj: bpy.types.Object) -> SimulationSettings:
    chosen = run_settings.simulation_settings(obj, bpy.context.scene, (0, FRAMES), SUBSTEPS)
    return SimulationSettings(0, FRAMES, FPS, SUBSTEPS, chosen.integrator, chosen.gravity)


def _key(obj: bpy.types.Object) -> str:
    """Identifies what the error depends on: the model, and what of the settings acts in it."""
    inputs = staleness.bake_inputs(Skinning.of(obj), _settings(obj))
    del inputs["output"], inputs["simulation"]["fields"]
    return hashlib.sha256(json.dumps([obj.dynamorph.model.content_id, inputs], sort_keys=True).encode()).hexdigest()
