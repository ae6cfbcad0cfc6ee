# SPDX-License-Identifier: GPL-3.0-or-later
"""How far the reduced motion of a new model is from Full Quality, found in the background after a build or bake.

The motion is the same for every character: the Shake Test's hop, in the pose that shows. For a whole body the error is
near that of its worst clip (docs/panels/compare.md). What was found is kept by what it depends on, so that neither
undo nor redo loses it, and goes into the file when that is saved.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from functools import partial

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ...core import engine, logger
from ...core.errors import SceneError
from ...core.motion import shake
from ...core.settings import SimulationSettings
from ...scene import events
from ...scene.motion import rig_motion, run_settings
from ...scene.read import probe
from ...scene.skin import ObjectHandle, soft_skins
from ...scene.skinning import Skinning
from ...scene.store import staleness
from ..remembered import work
from ..work.child import Child
from ..work.computation import Errand
from .job import Job

FRAMES, FPS, SUBSTEPS = 30, 24.0, 5  # of the motion: two hops, and how they end
LARGEST = 30_000  # degrees of freedom; with more an unreduced step takes too long to be taken unasked
TICK = 0.25  # seconds from one look at the measurement to the next


class Measurement:
    """The error of one model, which a job has built or used. Raises SceneError when the rig cannot be read.

    key: what it depends on. work: finds it, in another process.
    """

    def __init__(self, job: Job):
        obj = job.target()
        self.object, self.key = ObjectHandle.of(obj), _key(obj)
        model, character = job.outcome.model, job.outcome.character
        nodes = probe.Probe(obj, model, character) if character.probed else None
        still = rig_motion.sample_present(obj, nodes)
        self.work = partial(shake.expected_error, model, character, still, _settings(obj))


def known(obj: bpy.types.Object) -> float | None:
    """The error of the model of `obj` with its present settings, as a fraction of the motion, if it was measured."""
    record = obj.dynamorph.model
    if not _concerns(record) or not (work.errors or record.expected_from):
        return None
    key = _key(obj)
    return record.expected_error if record.expected_from == key else work.errors.get(key)


def summary(obj: bpy.types.Object) -> str:
    """What the panel says of it, or ''."""
    error = known(obj)
    if error is not None:
        return iface_("Expected error: {percent:.0f} % of the motion").format(percent=100 * error)
    return iface_("Expected error: measuring...") if any(_is_of(each, obj) for each in work.measuring) else ""


def begin(jobs: Sequence[Job]) -> None:
    """Measure, in the background, the models of jobs that have ended, where that is not known. Only in a window: a farm
    has others to wait for it.
    """
    cancel()
    if bpy.app.background:
        return
    for job in jobs:
        try:
            with job.request.scene.as_context():
                if _is_wanted(job):
                    work.measuring.append(Measurement(job))
        except engine.expected_errors():  # then it is not known
            continue
    if work.measuring:
        work.steps = _steps()
        events.soon(look, TICK)


def cancel() -> None:
    """What is measured now is not needed any more, or stands in the way."""
    work.measuring.clear()
    work.steps = iter(())
    events.forget(look)
    _end_child()


def store() -> None:
    """Note what was found with the objects, before their file is saved."""
    found = work.errors
    for obj in soft_skins(bpy.data.objects) if found else ():
        record = obj.dynamorph.model
        key = _key(obj) if obj.is_editable and _concerns(record) else ""
        if key in found and key != record.expected_from:
            record.expected_error, record.expected_from = found[key], key


def _steps() -> Iterator[None]:
    """Measure one after the other. Nobody waits for it, so that no error is the artist's concern."""
    while work.measuring:
        now = work.measuring[0]
        try:
            work.child = Child(Errand, heard=lambda _news: None, name=now.object.name, gentle=True)
            work.errors[now.key] = yield from work.child.call("run", now.work, False)
        except Exception as error:
            if not isinstance(error, engine.expected_errors()):
                logger.log_bug(error)
        finally:
            _end_child()
        work.measuring.remove(now)


def _end_child() -> None:
    if work.child:
        work.child.end()
    work.child = None


def look() -> float | None:
    """By a timer: whether what is measured is still of use, or is known now."""
    if work.measuring and not _is_present(work.measuring[0]):
        _end_child()
        del work.measuring[0]
        work.steps = _steps()
    if next(work.steps, True) is None:
        return TICK  # seconds from now
    events.redraw(events.PANELS)
    return None


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
