# SPDX-License-Identifier: GPL-3.0-or-later
"""How long the next bake of a soft skin that collides takes in Full Quality, about: the artist should know before.

A step takes as long as in the last such bake since Blender was started; before one, as long as usual with a cage of
that size.
"""

from __future__ import annotations

import bpy

from ...core.errors import SceneError
from ...core.message import Message
from ...core.settings import SimulationSettings
from ...scene.motion import run_settings
from ..remembered import work
from ..work.job_data import BakeInput

STEP, NODES = 0.08, 2000  # seconds of a step with a cage of so many nodes, where something is touched, on two cores
PASSES = 4  # of a loop


def learn(obj: bpy.types.Object, given: BakeInput, seconds: float) -> None:
    """Note how many seconds the simulation of a bake took."""
    if given.solver == "FULL" and given.settings.collision and not given.resumed:
        work.seconds[obj.session_uid] = seconds / _count(given.settings)


def expected(obj: bpy.types.Object, frames: tuple[int, int] | None = None, substeps: int | None = None) -> Message:
    """In words for the artist. frames, substeps: instead of those of the object."""
    try:
        settings = run_settings.simulation_settings(obj, bpy.context.scene, frames, substeps)
    except SceneError:  # the bake will say what is wrong
        return Message("longer")
    nodes = obj.dynamorph.model.cage_nodes
    usual = STEP * (nodes / NODES) ** 2 * (PASSES if settings.loop else 1)
    minutes = work.seconds.get(obj.session_uid, usual) * _count(settings) / 60.0
    return Message("about {count:.0f} min", count=minutes) if minutes >= 1.0 else Message("less than a minute")


def _count(settings: SimulationSettings) -> int:
    """Steps from the first frame to the last."""
    return max(len(settings.simulated) - 1, 1) * settings.substeps
