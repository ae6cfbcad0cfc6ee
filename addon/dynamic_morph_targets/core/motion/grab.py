# SPDX-License-Identifier: GPL-3.0-or-later
"""Springs that pull vertices of the skin: of an artist's hand, and of objects that grip it. Never touches bpy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from .. import records
from ..character import Character
from ..engine import dynamorph
from ..model.model import EngineModel, Model
from .contact import carried
from .keyed import KeyedSettings
from .rig_samples import RigSamples, Track

RADIUS = 0.03  # of the body's size: of what a hand takes hold of
MOST = 8  # vertices that a hand pulls: more would only take time
MOST_OF_GROUP = 24  # the same of a group, which may be wider
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


@dataclass(frozen=True)
class Patch:
    """The vertices that something holds. count: of the whole mesh; vertices (K,); offsets (K, 3): where they are held,
    in the space of what holds them, Blender units; share (K,): of the springs' stiffness, summing to 1; radius: that
    the springs pull, meters.
    """

    count: int
    vertices: np.ndarray
    offsets: np.ndarray
    share: np.ndarray
    radius: float

    def text(self) -> str:
        """As it is kept in a file."""
        arrays = {name: getattr(self, name).tolist() for name in ("vertices", "offsets", "share")}
        return records.patch_text({"count": self.count, **arrays, "radius": self.radius})

    @classmethod
    def of_text(cls, text: str) -> Patch:
        """The inverse. Raises RecordError."""
        read = records.patch(text)
        return cls(
            read["count"], np.array(read["vertices"]), np.array(read["offsets"], float), np.array(read["share"], float),
            read["radius"],
        )  # fmt: skip


@dataclass(frozen=True)
class GripTrack(Track):
    """Something that holds a patch of the skin, at S sample times: world (S, 4, 4), from its space to meters. Its
    strength is a setting, GRIP of this name.
    """

    SAMPLED = ("world",)
    name: str
    patch: Patch
    world: np.ndarray


def spread(points: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (K,) of a group, far from each other, and the share of each, summing to 1. points (V, 3); weights (V,):
    of the group, not all 0.
    """
    members = np.flatnonzero(weights > 0.0)
    chosen, away = [int(members[weights[members].argmax()])], np.full(len(members), np.inf)
    while len(chosen) < min(MOST_OF_GROUP, len(members)):
        away = np.minimum(away, np.linalg.norm(points[members] - points[chosen[-1]], axis=1))
        if not away.max() > 0.0:  # the rest is at the same places
            break
        chosen.append(int(members[away.argmax()]))
    return np.array(chosen), weights[chosen] / weights[chosen].sum()


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
    """What pulls the skin of a simulation: the artist, frame by frame, and grips."""

    def __init__(self, model: Model, engine: EngineModel, character: Character):
        self._model, self._engine, self._character = model, engine, character
        _, shear = character.material(0).lame()  # of the neutral target
        self._firm = FIRM * shear
        self._pulled = NOTHING  # by the artist, at the end of this frame
        self._before = NOTHING  # and where this was at the end of the last one
        self._vertices = NOTHING.vertices  # that were pulled last
        self._skin: Any = None  # these

    def pull(self, grabs: Sequence[Grab]) -> None:
        """What the artist does in the next frame. Where the same vertices are pulled as before, they are led to their
        new goals.
        """
        before, self._pulled = self._pulled, together(grabs)
        self._before = before if np.array_equal(before.vertices, self._pulled.vertices) else self._pulled

    def springs(self, rig: RigSamples, steps: slice, substeps: int) -> Any:
        """For the engine; None where nothing is pulled. rig: at these steps of a frame of `substeps`."""
        parts = (np.arange(steps.start, steps.stop) % substeps + 1.0) / substeps
        way = self._pulled.goals - self._before.goals
        led = self._before.goals + parts[:, None, None] * way
        grips = [track for track in rig.tracks if isinstance(track, GripTrack)]
        held = [(*self._pulled_by(grip, rig), grip.patch.vertices) for grip in grips]
        held = [each for each in held if each[1].any()]
        vertices = np.concatenate([self._pulled.vertices, *(each[2] for each in held)])
        if not len(vertices):
            return None
        if not np.array_equal(vertices, self._vertices):
            self._vertices = vertices
            self._skin = dynamorph.Skin(self._engine, *carried(self._model, self._character, vertices))
        firm = np.broadcast_to(self._pulled.stiffness, (len(parts), len(self._pulled.stiffness)))
        goals = np.concatenate([led, *(each[0] for each in held)], axis=1)
        stiffness = np.concatenate([firm, *(each[1] for each in held)], axis=1)
        return dynamorph.Grabs(self._skin, np.arange(len(vertices)), goals, stiffness)

    def _pulled_by(self, grip: GripTrack, rig: RigSamples) -> tuple[np.ndarray, np.ndarray]:
        """Goals (S, K, 3) and stiffness (S, K) of what a grip holds."""
        keyed, patch = rig.track(KeyedSettings), grip.patch
        strength = keyed.of("GRIP", grip.name) if keyed else None
        goals = patch.offsets @ grip.world[:, :3, :3].swapaxes(1, 2) + grip.world[:, None, :3, 3]
        strengths = np.ones(len(rig)) if strength is None else strength
        return goals, strengths[:, None] * (self._firm * patch.radius * patch.share)
