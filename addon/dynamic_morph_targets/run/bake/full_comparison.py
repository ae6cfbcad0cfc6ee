# SPDX-License-Identifier: GPL-3.0-or-later
"""How far the reduced motion of a bake, which Live shows too, is from the same shot in Full Quality."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import bpy

from ...core import records
from ...core.errors import SceneError
from ...core.geometry import vertex_areas
from ...core.message import Message, joined
from ...core.motion import baked
from ...core.motion.keyed import KeyedSettings
from ...core.motion.rig_samples import RigSamples
from .batch import Batch
from .job import Job

REDUCED = 0.05  # of the time, for the reduced simulation


class ShotJob(Job):
    """Simulates a shot in one quality with the model as it is built, and writes nothing: the motion is in `outcome`.

    solver: REDUCED or FULL; frames: first and last.
    """

    def __init__(self, obj: bpy.types.Object, solver: str, frames: tuple[int, int]):
        # As simulated: what is shown of the motion is not its error.
        changes = {"gains": (), "amount": 1.0}
        super().__init__(obj, "BAKE", frames, solver=solver, whole=True, stored=False, changes=changes)

    def end_chunk(self) -> RigSamples | None:
        samples = super().end_chunk()
        assert samples is not None  # it has a shot
        tracks = (each.without("AMOUNT") if isinstance(each, KeyedSettings) else each for each in samples.tracks)
        return replace(samples, tracks=tuple(tracks))

    def read(self) -> None:
        super().read()
        if self.input.model is None:
            raise SceneError(
                "The model of '{name}' is out of date ({why}): bake again first",
                name=self.name,
                why=joined("; ", self.input.reasons),
            )


class FullComparison(Batch):
    """Simulates the shot of an object's bake in both qualities, and notes with the bake how far they are apart, as
    `baked.motion_distance`. Raises SceneError, as `disabled_reason` says.
    """

    def __init__(self, obj: bpy.types.Object):
        why = disabled_reason(obj)
        if why:
            raise SceneError("'{name}': {why}", name=obj.name, why=why)
        simulated = records.bake_inputs(obj.dynamorph.bake.inputs)["simulation"]
        frames = simulated["frame_start"], simulated["frame_end"]
        super().__init__([ShotJob(obj, solver, frames) for solver in ("REDUCED", "FULL")], "COMPARE_FULL")

    @property
    def fraction(self) -> float:
        reduced, full = self.jobs
        return REDUCED * reduced.progress.fraction + (1.0 - REDUCED) * full.progress.fraction

    def write(self) -> Iterator[None]:
        yield from super().write()
        reduced, full = self.jobs
        character = reduced.outcome.character
        areas = vertex_areas(character.bind_points, character.triangles)
        distance = baked.motion_distance(reduced.outcome.bake, full.outcome.bake, character.to_bind, areas)
        reduced.target().dynamorph.bake.off_full = distance


def disabled_reason(obj: bpy.types.Object) -> str:
    """Why the bake of an object cannot be compared, or ''."""
    settings = obj.dynamorph
    if not settings.bake.exists:
        return "Bake first: there is no motion to compare"
    if settings.model.method == "STATIC":
        return "With the Method Static nothing moves by itself: there is no motion to compare"
    if settings.model.solver == "FULL":
        return "This is Full Quality: set Quality to Reduced and bake to compare"
    return ""


def summary(obj: bpy.types.Object) -> str:
    """What was found, as a sentence; '' before the bake was compared."""
    distance = obj.dynamorph.bake.off_full
    return Message("Measured error: {percent:.1f} % of the motion", percent=100 * distance) if distance >= 0 else ""
