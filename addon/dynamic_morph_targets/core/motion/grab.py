# SPDX-License-Identifier: GPL-3.0-or-later
"""A hand on the skin: springs that pull some of its vertices. Never touches bpy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from .. import records
from ..character import Character
from ..engine import dynamorph
from ..errors import RecordError
from ..model.model import EngineModel, Model
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


def as_text(track: Mapping[int, Grab]) -> str:
    """A track of drags as it is kept in a file: '' for none."""
    drags = [
        {"frame": frame, **{each.name: getattr(grab, each.name).tolist() for each in fields(Grab)}}
        for frame, grab in sorted(track.items())
        if len(grab.vertices)
    ]
    return records.drags_text(drags) if drags else ""


def from_text(text: str, vertices: int) -> dict[int, Grab]:
    """The track of a skin of so many vertices: what leads it to each frame. Raises RecordError."""
    track = {
        int(each["frame"]): Grab(
            np.array(each["vertices"]), np.array(each["goals"], float), np.array(each["stiffness"])
        )
        for each in (records.drags(text) if text else ())
    }
    if any(grab.vertices.max() >= vertices for grab in track.values()):
        raise RecordError("The recorded drags are of a mesh with more vertices: clear them")
    return track


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
    """What pulls the skin of a simulation, frame by frame: the artist, and a track of recorded drags."""

    def __init__(self, model: Model, engine: EngineModel, character: Character):
        self._model, self._engine, self._character = model, engine, character
        self.track: Mapping[int, Grab] = {}  # at the ends of the frames to which these lead
        self._pulled: Sequence[Grab] = ()  # by the artist
        self._last: Sequence[Grab] = ()  # the same in the last frame
        self._before = NOTHING  # all of it, at the end of the last frame
        self._grab = NOTHING  # and of this one
        self._skin: Any = None  # its vertices

    def pull(self, grabs: Sequence[Grab]) -> None:
        """What the artist does, from the next frame on."""
        self._pulled = grabs

    def begin(self, frame: int) -> None:
        """The steps to this frame begin. Where the same vertices are pulled as before, they are led to their new
        goals.
        """
        before, grab = (
            together([*grabs, *filter(None, [self.track.get(number)])])
            for grabs, number in ((self._last, frame - 1), (self._pulled, frame))
        )
        if not np.array_equal(grab.vertices, self._grab.vertices):
            self._skin = self._skin_of(grab.vertices) if len(grab.vertices) else None
        self._before = before if np.array_equal(before.vertices, grab.vertices) else grab
        self._last, self._grab = self._pulled, grab

    def springs(self, steps: slice, substeps: int) -> Any:
        """For the engine, in these steps of a frame of `substeps`; None where nothing is pulled."""
        if not len(self._grab.vertices):
            return None
        parts = (np.arange(steps.start, steps.stop) % substeps + 1.0) / substeps
        way = self._grab.goals - self._before.goals
        goals = self._before.goals + parts[:, None, None] * way
        return dynamorph.Grabs(self._skin, np.arange(len(way)), goals, self._grab.stiffness)

    def _skin_of(self, vertices: np.ndarray) -> Any:
        return dynamorph.Skin(self._engine, *carried(self._model, self._character, vertices))
