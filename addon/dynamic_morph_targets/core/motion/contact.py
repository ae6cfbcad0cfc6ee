# SPDX-License-Identifier: GPL-3.0-or-later
"""What a simulation with collision needs: the points of the skin that can touch something, and the engine's colliders;
and how deep it went. Never touches bpy.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..character import Character
from ..engine import dynamorph
from ..errors import SceneError
from ..geometry import diagonal, is_closed, signed_volume, vertex_normals
from ..message import Message, named_frames
from ..model.model import EngineModel, Model
from ..settings import Material
from .colliders import ColliderTrack, colliders_of
from .limits import THINNEST, frames_around
from .rig_samples import RigSamples

PLACES = 3000  # of the skin by which its patches are pressed, at most
PATCHES = 256  # of the skin that give way by themselves in Reduced Quality
SAMPLES = 20000  # points of the skin that can touch something, at most; of more vertices, those that are spread evenly
PROBED_SAMPLES = 4000  # the same where Blender poses the nodes, which have a matrix of weights
EXCLUDED = 0.5  # smallest weight of `Character.excluded` with which a vertex touches nothing
BITS = 52  # of a float, which are exact: so many colliders are told apart where they are unusable


class Collision:
    """What a player with collision has of it: the points of the skin that can touch something, P of its vertices, and
    the engine's colliders in a shot: those of its first sample, whose faces they keep.

    skin: the engine's points of an engine model, or None where no skin is soft; vertices (P,): which those are. dents
    (3 free, K): displacement of the free nodes by each patch of the skin that gives way by itself in Reduced Quality;
    none otherwise.
    """

    def __init__(self, model: Model, engine: EngineModel, character: Character):
        rest = character.vertices @ character.to_bind.T
        soft = character.triangles[(character.cage_index[character.triangles] >= 0).all(axis=1)]
        outward = -1.0 if signed_volume(rest, soft) < 0.0 else 1.0  # some meshes are inside out
        normals = outward * vertex_normals(rest, character.triangles)
        seen = np.unique(character.coincident[soft])  # of points at one place, one
        seen = seen[model.free[model.embedding_nodes[seen]].any(axis=1) & normals[seen].any(axis=1)]
        touchable = seen[character.excluded[seen] < EXCLUDED]
        most = PROBED_SAMPLES if character.probed else SAMPLES
        chosen = touchable[spread(rest[touchable], normals[touchable], most)]
        self.skin: Any = None
        self.dents = np.zeros((3 * int(model.free.sum()), 0))
        self.vertices = chosen
        self._bones = character.weights[chosen].argmax(axis=1)
        self._known: list[tuple[str, int]] = []  # names and topologies of the colliders
        self._shapes: list[np.ndarray] = []
        self._colliders: list[Any] = []
        if not len(chosen):
            return
        thickness = model.thickness if len(model.thickness) else dynamorph.Thickness(rest, soft).at(rest)[0]
        full = model.settings.solver == "FULL"
        local = None
        if not full:
            local, self.dents = _local_responses(model, character, seen, rest, normals)
        kind: Callable[..., Any] = dynamorph.FullContact if full else dynamorph.ReducedContact
        self.skin = kind(
            engine,
            rest[chosen],
            dynamorph.Embedding(model.embedding_nodes[chosen], model.embedding_weights[chosen]),
            _moving(model, character, chosen),
            normals[chosen],
            np.maximum(thickness[chosen], 0.5 * THINNEST * diagonal(rest)),
            model.residual_shapes[:, chosen] @ character.to_bind.T,
            local,
        )

    def begin(self, first: RigSamples) -> None:
        """Take the colliders of the first sample. Raises SceneError for one that the engine refuses."""
        tracks = colliders_of(first)
        self._known = [(track.name, track.topology) for track in tracks]
        self._shapes = [track.shapes[track.shape[0, 1]].copy() for track in tracks]
        self._colliders = [_collider(track, shape) for track, shape in zip(tracks, self._shapes, strict=True)]

    def fits(self, rig: RigSamples) -> bool:
        """Whether these samples have the same colliders."""
        return self._known == [(track.name, track.topology) for track in colliders_of(rig)]

    def motions(self, rig: RigSamples) -> list[Any]:
        """For the engine: how each collider moves in the steps to these samples. What keeps its shape moves as a
        whole.
        """
        if not self.fits(rig):
            raise ValueError("the colliders are others than at the first sample: begin again")
        return [
            _motion(collider, shape, track)
            for collider, shape, track in zip(self._colliders, self._shapes, colliders_of(rig), strict=True)
        ]

    def names(self, sample: int, collider: int, bones: Sequence[str]) -> tuple[str, str]:
        """The bone that moves a point of the skin most, '' for the object itself, and the collider. bones: names."""
        bone = int(self._bones[sample])
        return bones[bone] if bone < len(bones) else "", self.collider(collider)

    def collider(self, number: int) -> str:
        """Its name."""
        return self._known[number][0]


def _local_responses(
    model: Model, character: Character, seen: np.ndarray, rest: np.ndarray, normals: np.ndarray
) -> tuple[Any, np.ndarray]:
    """How the skin gives way locally, and the `Collision.dents` of it. seen: the vertices that can touch something;
    rest, normals (V, 3): bind space. It takes a while, so it is kept with the model, and made for one material: the
    engine scales it by the shear modulus, and what Live changes must not depend on when Live began.
    """
    known = _known_responses.get(id(model))
    if known:
        return known
    places = seen[spread(rest[seen], normals[seen], PLACES)]
    lame_lambda, lame_mu = Material().lame()
    sets = [s for s, target_set in enumerate(character.target_sets) for _ in target_set.targets]
    targets = [
        dynamorph.MorphTarget("", shape, lame_lambda=lame_lambda, lame_mu=lame_mu, density=Material.density, set=s)
        for shape, s in zip(model.displacements, sets, strict=True)
    ]
    law = dynamorph.MaterialModel.__members__[model.settings.material_model]
    local = dynamorph.LocalResponses(
        dynamorph.FullModel(model.soft_body(), targets, law, dynamorph.Blending.EVEN),
        model.modes,
        rest[places],
        normals[places],
        dynamorph.Embedding(model.embedding_nodes[places], model.embedding_weights[places]),
        spread(rest[places], normals[places], PATCHES).tolist(),
    )
    _known_responses[id(model)] = local, local.shapes
    weakref.finalize(model, _known_responses.pop, id(model), None)
    return _known_responses[id(model)]


_known_responses: dict[int, tuple[Any, np.ndarray]] = {}  # by id(model)


def _moving(model: Model, character: Character, points: np.ndarray) -> np.ndarray:
    """Weights (P, B + 1) of what moves these points (P,) of the skin: of the bones, or of the free nodes where Blender
    poses those.
    """
    if not character.probed:
        return character.weights[points].clip(0.0)  # rounding may leave less than nothing
    nodes = model.embedding_nodes[points]
    out = np.zeros((len(points), len(model.nodes)))
    np.add.at(out, (np.arange(len(points))[:, None], nodes), model.embedding_weights[points].clip(0.0))
    return out[:, model.free]


def spread(points: np.ndarray, normals: np.ndarray, count: int) -> np.ndarray:
    """Indices of at most `count` of the points (P, 3) that are spread over a surface: of each cell of a grid, and each
    of six directions of the normals (P, 3), so that both sides of something thin have some, the outermost: it touches
    first.
    """
    if len(points) <= count:
        return np.arange(len(points))
    rows = np.arange(len(points))
    axis = np.abs(normals).argmax(axis=1)
    sign = np.sign(normals[rows, axis])
    side = 2 * axis + (sign > 0.0)
    inward = np.argsort(-sign * points[rows, axis], kind="stable")
    low, high = 0.0, diagonal(points)  # of a cell
    found = np.zeros(0, np.int64)
    for _ in range(12):
        size = 0.5 * (low + high)
        cells = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
        _, first = np.unique(np.column_stack([cells, side])[inward], axis=0, return_index=True)
        if len(first) > count:
            low = size
        else:
            high, found = size, inward[first]
    return np.sort(found)


def _collider(track: ColliderTrack, points: np.ndarray) -> Any:
    # A closed surface has an inside of its own, also where its normals point inward.
    one_sided = track.one_sided and not is_closed(track.triangles)
    try:
        return dynamorph.Collider(points, track.triangles, one_sided)
    except (ValueError, dynamorph.Error) as error:
        raise SceneError("'{name}' cannot collide: {reason}", name=track.name, reason=error) from error


def _motion(collider: Any, first: np.ndarray, track: ColliderTrack) -> Any:
    """first (V, 3): the shape at the first sample."""
    keeps_shape = all(np.array_equal(track.shapes[shape], first) for shape in np.unique(track.shape))
    if keeps_shape:
        motion = np.concatenate([track.transforms[:1, 0], track.transforms[:, 1]])
    else:
        samples = range(len(track.friction))
        motion = np.array([track.points(0, side=0), *(track.points(sample) for sample in samples)])
    return dynamorph.ColliderMotion(collider, motion, track.friction, track.active)


@dataclass(frozen=True)
class Touched:
    """How deep a shot went into colliders. penetration: of the skin, after a step, at most, meters. depth: how much
    deeper the bones took it into `collider` than it can give way, meters, 0 where they never did; bone:
    which; frames: the first and last about that one. unusable: of each collider that could not stop anything somewhere,
    the name, and the first frame and the last where it could not.
    """

    penetration: float = 0.0
    depth: float = 0.0
    bone: str = ""
    collider: str = ""
    frames: tuple[int, int] = (0, 0)
    unusable: tuple[tuple[str, int, int], ...] = ()

    @property
    def texts(self) -> list[Message]:
        """What did not go as the artist wants it, in sentences."""
        text = "'{name}' stops nothing at {frames}: it is scaled to zero there"
        without = [Message(text, name=name, frames=named_frames(*frames)) for name, *frames in self.unusable]
        return [self.too_deep, *without] if self.too_deep else without

    @property
    def too_deep(self) -> Message | None:
        """Where the bones leave the tissue no room, in a sentence; None where they always leave some."""
        if self.depth <= 0.0:
            return None
        return Message(
            "The bones take '{bone}' {depth:.3g} mm too deep into '{collider}' at {frames}: pose them out of it",
            bone=self.bone,
            depth=1000.0 * self.depth,
            collider=self.collider,
            frames=named_frames(*self.frames),
        )


def touched(times: np.ndarray, steps: dict[str, np.ndarray], collision: Collision, bones: Sequence[str]) -> Touched:
    """Of the steps' statistics by name, each (F,), to each of the times (F,). bones: names."""
    penetration, depth = float(steps["penetration"].max(initial=0.0)), steps["too_deep"]
    unusable = tuple(_unusable(times, steps["unusable_colliders"], collision))
    if not (depth > 0.0).any():
        return Touched(penetration, unusable=unusable)
    worst, collider = int(depth.argmax()), steps["too_deep_collider"].astype(int)
    frames = frames_around(worst, (depth <= 0.0) | (collider != collider[worst]), times)
    names = collision.names(int(steps["too_deep_sample"][worst]), collider[worst], bones)
    return Touched(penetration, float(depth[worst]), *names, frames, unusable)


def pressed(state: np.ndarray) -> np.ndarray:
    """The points of the skin that something pushes, from what is touched in a player's `State`: planes of 8 numbers,
    one for each collider, then pressures (sample, collider, normal, force).
    """
    if not len(state):
        return np.zeros(0, int)
    planes, colliders = state[:2].astype(int)
    pressures = state[2 + 8 * planes + colliders :].reshape(-1, 6)
    return np.unique(pressures[pressures[:, 5] > 0.0, 0].astype(int))


def as_bits(colliders: Sequence[int]) -> float:
    """Numbers of colliders as one number among a step's statistics, which are floats."""
    return float(sum(1 << collider for collider in colliders if collider < BITS))


def _unusable(times: np.ndarray, bits: np.ndarray, collision: Collision) -> Iterator[tuple[str, int, int]]:
    """`Touched.unusable`, from `as_bits` of the steps to each of the times (F,)."""
    for collider in range(BITS):
        found = times[(bits.astype(np.int64) >> collider & 1).astype(bool)]
        if len(found):
            yield collision.collider(collider), int(np.floor(found[0])), int(np.ceil(found[-1]))
