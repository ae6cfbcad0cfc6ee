# SPDX-License-Identifier: GPL-3.0-or-later
"""How far each point of the skin may move away from its targets' shape. Never touches bpy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import max_distance
from ..character import Character, same
from ..engine import dynamorph
from ..geometry import diagonal
from ..model.model import EngineModel, Model
from ..settings import SimulationSettings

THINNEST = 0.02  # of the body's size; thinner parts count as this thick


def largest_distances(model: Model, character: Character, settings: SimulationSettings) -> np.ndarray:
    """The limit (V,) in meters of each vertex, without the Max Distance map; infinite without one."""
    size = diagonal(character.bind_points)
    out = np.full(len(character.vertices), settings.max_displacement * size or np.inf)
    if settings.max_thickness and len(model.thickness):
        thickness = np.maximum(2.0 * model.thickness, THINNEST * size)
        out = np.minimum(out, settings.max_thickness * thickness)
    return out


def motion_limit(model: Model, engine: EngineModel, character: Character, settings: SimulationSettings) -> Any:
    """What limits the motion of such an engine model; None without limits, or where no skin is soft."""
    distances = largest_distances(model, character, settings)
    soft = character.soft_triangles
    if not np.isfinite(distances).all() or not len(soft):
        return None
    painted = max_distance.pulled(character.max_distance)
    known = _looked_at(model, character)
    limit = dynamorph.MotionLimit(
        engine,
        character.bind_points,
        model.embedding,
        soft,
        character.weights,
        distances,
        model.node_weights[model.free] if character.probed else None,
        painted if (painted < 1.0).any() else None,
        tissue=known,
    )
    if known is None:
        model.made[_made(model)] = character, limit.tissue
    return limit


def _looked_at(model: Model, character: Character) -> Any:
    """What the engine found of the character's skin; None where it is to look. It takes a while, so it is kept with the
    model.
    """
    of, found = model.made.get(_made(model), (None, None))
    return found if same(of, character) else None


def _made(model: Model) -> tuple[str, ...]:
    """By what it is kept. The engine's class is named with its constants, which docs/limit.md compares."""
    return "limited", model.settings.solver, str(dynamorph.MotionLimit)


@dataclass(frozen=True)
class Held:
    """Where the limits worked hardest in a shot. bone: whose load exceeded its limit most, and excess: by which factor;
    frames: the first and last about that one in which it exceeded it by half as much. reached: the largest distance of
    a point from its targets' shape over its limit, between frames too; pulled: share of the steps in which something
    was so far that it was pulled back.
    """

    bone: str = ""
    excess: float = 0.0
    frames: tuple[int, int] = (0, 0)
    reached: float = 0.0
    pulled: float = 0.0


def held(times: np.ndarray, steps: dict[str, np.ndarray], bones: Sequence[str]) -> Held:
    """Of the steps' statistics by name, each (F,), to each of the times (F,)."""
    excess, bone = steps["excess"], steps["excess_bone"].astype(int)
    worst = int(excess.argmax())
    reached = float(steps["farthest"].max(initial=0.0))
    pulled = float(steps["pulled"].sum() / max(steps["steps"].sum(), 1))
    if not 0 <= bone[worst] < len(bones):
        return Held(reached=reached, pulled=pulled)
    frames = frames_around(worst, (excess < 0.5 * excess[worst]) | (bone != bone[worst]), times)
    return Held(bones[bone[worst]], float(excess[worst]), frames, reached, pulled)


def frames_around(worst: int, over: np.ndarray, times: np.ndarray) -> tuple[int, int]:
    """The first and last frame about the time `worst` up to where it is `over` (F,), before and after. times (F,)."""
    ends = np.flatnonzero(over)
    first, last = ends[ends < worst].max(initial=-1) + 1, ends[ends > worst].min(initial=len(times)) - 1
    return int(np.floor(times[first])), int(np.ceil(times[last]))
