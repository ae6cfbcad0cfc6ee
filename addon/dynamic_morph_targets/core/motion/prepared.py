# SPDX-License-Identifier: GPL-3.0-or-later
"""What all players of one soft skin share: the engine's model and the limits of its motion. Never touches bpy.

Both take long to make, and Live, its tests and the first bake play the same skin one after the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

from ..character import Character, same
from ..engine import dynamorph
from ..model.model import EngineModel, Model
from ..settings import SimulationSettings
from .limits import motion_limit

KEPT = 2  # of the last skins


@dataclass(frozen=True, eq=False)
class Prepared:
    """engine: the model with the character's materials; limit: what limits its motion, None without limits, made by
    `limits`: the engine's class with its constants, Max Displacement, Of Thickness. Players may share them, in any
    thread.
    """

    model: Model
    character: Character
    limits: tuple[Callable[..., Any], float, float]
    engine: EngineModel
    limit: Any


_kept: list[Prepared] = []


def prepared(model: Model, character: Character, settings: SimulationSettings) -> Prepared:
    """What was made of these before, or made now. Raises SceneError if the model is not the character's."""
    limits = dynamorph.MotionLimit, settings.max_displacement, settings.max_thickness
    for known in _kept[:]:  # other threads prepare others
        if known.limits == limits and _is_model(known.model, model) and same(known.character, character):
            return known
    engine = model.engine(character, character.probed)
    made = Prepared(model, character, limits, engine, motion_limit(model, engine, character, settings))
    _kept[:] = [*_kept[1 - KEPT :], made]
    return made


def forget() -> None:
    """Free what is kept."""
    _kept.clear()


def _is_model(one: Model, other: Model) -> bool:
    names = [field.name for field in fields(Model) if field.init and field.name != "summary"]  # how it was built
    return all(same(getattr(one, name), getattr(other, name)) for name in names)
