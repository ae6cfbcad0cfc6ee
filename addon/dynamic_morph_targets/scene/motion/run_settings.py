# SPDX-License-Identifier: GPL-3.0-or-later
"""The settings of a simulation and its output as the scene and the object have them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import bpy
import numpy as np

from ...core.errors import SceneError
from ...core.motion.keyed import Setting
from ...core.settings import MOST_SUBSTEPS, SimulationSettings
from .. import keyed
from .colliders import colliders, pressed


def bake_solver(obj: bpy.types.Object) -> str:
    """The quality of a bake of `obj`, REDUCED or FULL: that of Live and clips, or Full where it collides and its
    Quality is Automatic.
    """
    settings = obj.dynamorph
    collision = settings.collision
    touches = collision.use and (collision.use_self or colliders(obj) or pressed(obj))
    if settings.model.method != "STATIC" and collision.bake_full and touches:
        return "FULL"
    return settings.model.solver


def frame_range(obj: bpy.types.Object, scene: bpy.types.Scene, frames: Sequence[int] | None = None) -> tuple[int, int]:
    """The first frame and the last that are requested; frames: instead of those of `obj`. Raises SceneError."""
    chosen, blenders = obj.dynamorph.simulation, scene.bl_rna.properties["frame_current"]
    authored = scene if chosen.use_scene_range else chosen
    start, end = frames or (authored.frame_start, authored.frame_end)
    if end < start:
        raise SceneError(
            "'{name}': the last frame {end} comes before the first {start}: change the range",
            name=obj.name,
            end=end,
            start=start,
        )
    if start < blenders.hard_min or end > blenders.hard_max:
        raise SceneError(
            "'{name}': Blender has no frames beyond {first} and {last}: change the range",
            name=obj.name,
            first=blenders.hard_min,
            last=blenders.hard_max,
        )
    return start, end


def simulation_settings(
    obj: bpy.types.Object, scene: bpy.types.Scene, frames: Sequence[int] | None = None, substeps: int | None = None
) -> SimulationSettings:
    """The run that `obj` requests in `scene`; frames (start, end) and substeps override it. Substeps are rounded up to
    a multiple of the samples per frame. What is not said here is the property of the same name. Raises SceneError.

    The scene's gravity is taken as m/s^2 whatever its unit scale. Blender's own simulations take it as Blender units
    per s^2.
    """
    chosen, collision = obj.dynamorph.simulation, obj.dynamorph.collision
    fps = scene.render.fps / scene.render.fps_base
    start, end = frame_range(obj, scene, frames)
    substeps = chosen.steps_per_frame(fps, substeps)
    if substeps > MOST_SUBSTEPS:
        raise SceneError(
            "'{name}': a frame of {seconds:.3g} s takes {count} time steps, and {most} are the most: raise the Frame "
            "Rate, lower the Speed, or set Substeps Per Frame",
            name=obj.name,
            seconds=chosen.speed / fps,
            count=substeps,
            most=MOST_SUBSTEPS,
        )
    known = keyed.always(obj)
    gravity = np.array(scene.gravity) * (chosen.gravity if scene.use_gravity else 0.0)
    gains = tuple(mode.gain for mode in obj.dynamorph.modes)
    authored = {
        each.name: getattr(chosen, each.name) for each in fields(SimulationSettings) if hasattr(chosen, each.name)
    }
    friction = known.get(Setting("FRICTION"), collision.friction)
    read = {
        "frame_start": start,
        "frame_end": end,
        "fps": fps,
        "substeps": -(-substeps // chosen.samples) * chosen.samples,
        "gravity": tuple(gravity.tolist()),
        "gains": gains if set(gains) != {1.0} else (),
        "collision": collision.use,
        "amount": known.get(Setting("AMOUNT"), chosen.amount),
        "distance": known.get(Setting("DISTANCE"), collision.distance),
        "self_collision": collision.use and collision.use_self,
        "self_friction": friction if collision.use_friction else SimulationSettings.self_friction,
    }
    return SimulationSettings(**{**authored, **read})
