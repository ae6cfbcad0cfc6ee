# SPDX-License-Identifier: GPL-3.0-or-later
"""A hand on the skin: springs that pull some of its vertices. Never touches bpy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ..character import Character
from ..engine import dynamorph
from ..model.model import EngineModel, EngineSimulation, Model
from .contact import carried

MOST = 8  # vertices that a hand pulls: more would only take time
FIRM = 30.0  # of the springs together, in shear moduli of the tissue times the radius that they pull: skin follows


@dataclass(frozen=True)
class Grab:
    """vertices (K,): of the character's skin. goals (K, 3): where the springs pull them, world space, meters. stiffness
    (K,): newtons per meter.
    """

    vertices: np.ndarray
    goals: np.ndarray
    stiffness: np.ndarray


NOTHING = Grab(np.zeros(0, int), np.zeros((0, 3)), np.zeros(0))


def together(grabs: Sequence[Grab]) -> Grab:
    """All of them as one."""
    if not grabs:
        return NOTHING
    return Grab(*(np.concatenate([getattr(each, field.name) for each in grabs]) for field in fields(Grab)))


def pinch(points: np.ndarray, place: np.ndarray, radius: float, moves: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The vertices (K,) that a hand at `place` (3,) takes hold of, and how firmly each, summing to 1. points (V, 3):
    the skin as it shows; moves (V,): which of them can move by themselves. Nothing where none is near.
    """
    distances = np.where(moves, np.linalg.norm(points - place, axis=1), np.inf)
    near = np.argsort(distances, kind="stable")[: max(1, np.count_nonzero(distances < radius))]
    near = near[np.unique(np.linspace(0, len(near) - 1, MOST).round().astype(int))]
    near = near[distances[near] < 2.0 * radius]
    firmness = (1.0 - (distances[near] / (2.0 * radius)) ** 2) ** 2
    return near, firmness / max(firmness.sum(), 1e-300)


class Hand:
    """What pulls the skin of a simulation, frame by frame."""

    def __init__(self, model: Model, engine: EngineModel, character: Character, simulation: EngineSimulation):
        self._model, self._engine, self._character, self._simulation = model, engine, character, simulation
        self._before = NOTHING  # at the end of the last frame
        self.grab = NOTHING  # at the end of the next one

    def pull(self, grabs: Sequence[Grab]) -> None:
        """From now on. Where the same vertices are pulled, they are led to their new goals during the next frame."""
        grab = together(grabs)
        if not np.array_equal(grab.vertices, self.grab.vertices):
            skin: Any = self._skin(grab.vertices) if len(grab.vertices) else None
            self._simulation.set_skin(skin)
            self._before = grab
        self.grab = grab

    def springs(self, steps: slice, substeps: int) -> Any:
        """For the engine, in these steps of a frame of `substeps`; None where nothing is pulled."""
        if not len(self.grab.vertices):
            return None
        parts = (np.arange(steps.start, steps.stop) % substeps + 1.0) / substeps
        way = self.grab.goals - self._before.goals
        goals = self._before.goals + parts[:, None, None] * way
        if steps.stop % substeps == 0:  # the frame is over
            self._before = self.grab
        return dynamorph.Grabs(np.arange(len(way)), goals, self.grab.stiffness)

    def _skin(self, vertices: np.ndarray) -> Any:
        kind: Any = dynamorph.FullSkin if self._model.settings.solver == "FULL" else dynamorph.ReducedSkin
        return kind(self._engine, *carried(self._model, self._character, vertices))
