# SPDX-License-Identifier: GPL-3.0-or-later
"""What a simulation with collision needs: the points of the skin that can touch something, and the engine's colliders;
and how deep it went. Never touches bpy.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ..character import Character, same
from ..engine import dynamorph
from ..errors import SceneError
from ..geometry import diagonal, is_closed, loose_parts, signed_volume
from ..message import Message, named_frames
from ..model.model import EngineModel, Model
from .colliders import ColliderTrack, colliders_of
from .contact_points import ContactPoints, contact_points, spread
from .limits import THINNEST, frames_around
from .rig_samples import RigSamples

PLACES = 3000  # of the skin by which its patches are pressed, at most
PATCHES = 512  # of the skin that give way by themselves in Reduced Quality
SAMPLES = 20000  # points of the skin that can touch something, at most
REDUCED_SAMPLES = 6000  # the same in Reduced Quality: a dozen for each patch that gives way
PROBED_SAMPLES = 4000  # the same where Blender poses the nodes, which have a matrix of weights
OWN_SAMPLES = 3000  # of them that can touch the body itself, at most
SHARED = 0.2  # of the weights: a vertex that two bones move by more than that is skin that they share
COVERED = 0.08  # of the tissue's thickness: how near the balls that stand for the body come to its skin
ASKED, WITHIN = 100, 0.9  # points of the skin that are asked, and the part of them that is in what is around it
EXCLUDED = 0.5  # smallest weight of `Character.excluded` with which a point touches nothing
BITS = 52  # of a float, which are exact: so many colliders are told apart where they are unusable


class Collision:
    """What a player with collision has of it: the points of the skin that can touch something, P of them, and the
    engine's colliders in a shot: those of its first sample, whose faces they keep.

    skin: the engine's points of an engine model, or None where no skin is soft; vertices (P,): nearest to those. dents
    (3 free, K): displacement of the free nodes by each patch of the skin that gives way by itself in Reduced Quality;
    none otherwise. others: names of the bodies of its coupling, which the engine numbers below -1.
    """

    def __init__(self, model: Model, engine: EngineModel, character: Character):
        surface, points = _points(model, character)
        self.skin: Any = None
        self.dents = np.zeros((3 * int(model.free.sum()), 0))
        self.vertices = points.vertices[:, 0]
        self.others: tuple[str, ...] = ()
        self._model, self._character, self._points = model, character, points
        self._bones = character.weights[self.vertices].argmax(axis=1)
        self._known: list[tuple[str, int]] = []  # names and topologies of the colliders
        self._shapes: list[np.ndarray] = []
        self._colliders: list[Any] = []
        if not len(points.rest):
            model.made[_found(model)] = character, None
            return
        local = None
        if model.settings.solver == "REDUCED":
            local, self.dents = _local_responses(model, surface)
        vertices, corners = np.unique(points.vertices, return_inverse=True)
        rest, embedding, weights, residual_shapes = carried(model, character, vertices)
        of, known = model.made.get(_found(model), (None, None))
        self.skin = dynamorph.Contact(
            engine,
            rest,
            embedding,
            weights,
            points.normals,
            points.least(_thickness(model, character)),
            residual_shapes,
            local,
            corners.reshape(points.vertices.shape),
            points.weights,
            known if same(of, character) else None,
        )
        model.made[_found(model)] = character, self.skin.found

    @cached_property
    def own(self) -> Any:
        """Where those points meet skin, of the body itself or of others: the engine's, None where no skin is soft."""
        if self.skin is None:
            return None
        chosen = spread(self._points.rest, self._points.normals, OWN_SAMPLES)
        return _self_contact(self.skin, self._model, self._character, self._points[chosen], chosen)

    def begin(self, first: RigSamples, skin: np.ndarray) -> None:
        """Take the colliders of the first sample. skin (V, 3): there, world space. Raises SceneError for one that the
        engine refuses.
        """
        tracks = colliders_of(first)
        self._known = [(track.name, track.topology) for track in tracks]
        self._shapes = [track.shapes[track.shape[0, 1]].copy() for track in tracks]
        self._colliders = [collider_of(track, shape, skin) for track, shape in zip(tracks, self._shapes, strict=True)]

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
        """Its name; of -1 the body's own, and below that of `others`."""
        return self._known[number][0] if number >= 0 else (self._character.name, *self.others)[-1 - number]


def has_kept(model: Model, own: bool) -> bool:
    """Whether a `Collision` has been made of it, so that the next one, of the same materials, is made soon. own: with
    the body itself, too.
    """
    return _found(model) in model.made and (not own or any(key[0] == "balls" for key in model.made))


def _found(model: Model) -> tuple[str, ...]:
    """By what it is kept with the model."""
    return "found", model.settings.solver, model.settings.material_model


def _points(model: Model, character: Character) -> tuple[ContactPoints, ContactPoints]:
    """All of the skin's points, and those that can touch something."""
    surface = contact_points(model, character)
    touchable = surface[surface.of(character.excluded) < EXCLUDED]
    most = SAMPLES if model.settings.solver == "FULL" else REDUCED_SAMPLES
    return surface, touchable.at_most(PROBED_SAMPLES if character.probed else most)


def carried(model: Model, character: Character, vertices: np.ndarray) -> tuple[Any, ...]:
    """How the engine's points at these vertices (V,) of the skin move: rest positions, embedding, weights of what moves
    them, and residual shapes, as `dynamorph.Skin` takes them.
    """
    return (
        character.bind_points[vertices],
        dynamorph.Embedding(model.embedding_nodes[vertices], model.embedding_weights[vertices]),
        _moving_weights(model, character, vertices),
        model.residual_shapes[:, vertices] @ character.to_bind.T,
    )


def _moving_weights(model: Model, character: Character, vertices: np.ndarray) -> np.ndarray:
    """Weights (V, B + 1) of what moves these vertices (V,): of the bones, or of the free nodes where Blender poses
    those.
    """
    if not character.probed:
        return character.weights[vertices].clip(0.0)  # rounding may leave less than nothing
    nodes = model.embedding_nodes[vertices]
    out = np.zeros((len(vertices), len(model.nodes)))
    np.add.at(out, (np.arange(len(vertices))[:, None], nodes), model.embedding_weights[vertices].clip(0.0))
    return out[:, model.free]


def _self_contact(contact: Any, model: Model, character: Character, points: ContactPoints, numbers: np.ndarray) -> Any:
    """The engine's, for those points of a contact that have these numbers. Parts are what a bone moves most."""
    centers, radii = _balls(model, character, points.rest)
    embedding = dynamorph.embed(dynamorph.TetMesh(model.nodes, model.tets), centers)
    carried_by = np.zeros((len(centers), len(model.nodes)))
    np.add.at(carried_by, (np.arange(len(centers))[:, None], embedding.nodes), embedding.weights.clip(0.0))
    of_bones = carried_by @ model.node_weights
    weights = carried_by[:, model.free] if character.probed else of_bones
    shared = (character.weights > SHARED).astype(np.float32)
    joints = np.argwhere(np.triu(shared.T @ shared, 1) > 0.0)
    of_balls, of_points = of_bones.argmax(axis=1), points.of(character.weights).argmax(axis=1)
    return dynamorph.SelfContact(
        contact, centers, radii, embedding, weights, list(numbers), list(of_balls), list(of_points), list(joints)
    )


def _balls(model: Model, character: Character, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centers (K, 3) and radii (K,) of balls that fill the body near these places (P, 3) of the skin. They take a
    while, so they are kept with the model.
    """
    made_of = hashlib.sha256(places.tobytes()).digest()
    if ("balls", made_of) not in model.made:
        body = dynamorph.Thickness(character.bind_points, character.soft_triangles)
        model.made["balls", made_of] = body.covering(places, COVERED)
    return model.made["balls", made_of]


def _thickness(model: Model, character: Character) -> np.ndarray:
    """Of the tissue below each vertex of the skin (V,), meters, above zero."""
    rest = character.bind_points
    found = model.thickness
    if not len(found):
        soft = character.soft_triangles
        found = dynamorph.Thickness(rest, soft).at(rest)[0]
    return np.maximum(found, 0.5 * THINNEST * diagonal(rest))


def _local_responses(model: Model, surface: ContactPoints) -> tuple[Any, np.ndarray]:
    """How the skin gives way locally, and the `Collision.dents` of it. surface: all of it. It takes a while, so it is
    kept with the model, and made for one material: the engine scales it by the shear modulus, and what Live changes
    must not depend on when Live began.
    """
    made_for = model.settings.material_model
    if ("responses", made_for) in model.made:
        local = model.made["responses", made_for]
        return local, local.shapes
    places = surface.at_most(PLACES)
    law = dynamorph.MaterialModel.__members__[made_for]
    local = model.made["responses", made_for] = dynamorph.LocalResponses(
        dynamorph.FullModel(model.soft_body(), model.plain_targets(), law, dynamorph.Blending.EVEN),
        model.modes,
        places.rest,
        places.normals,
        model.embedding,
        spread(places.rest, places.normals, PATCHES).tolist(),
        places.vertices,
        places.weights,
    )
    return local, local.shapes


def collider_of(track: ColliderTrack, points: np.ndarray, skin: np.ndarray) -> Any:
    """The engine's, with the vertices at points (V, 3). skin: as for `Collision.begin`. Raises SceneError for what it
    refuses.
    """
    # A closed surface has an inside of its own, also where its normals point inward; but one around the body is a room.
    facing = _facing(track, skin)
    triangles = track.triangles if facing is None else facing
    one_sided = facing is not None or (track.one_sided and not is_closed(track.triangles))
    try:
        return dynamorph.Collider(points, triangles, one_sided)
    except (ValueError, dynamorph.Error) as error:
        raise SceneError("'{name}' cannot collide: {reason}", name=track.name, reason=error) from error


def _facing(track: ColliderTrack, skin: np.ndarray) -> np.ndarray | None:
    """The triangles (T, 3) of a closed collider that is around the skin, but for feet in its floor, as a room is: those
    around it are turned to face it. None for any other. skin (V, 3): world space, at the first sample.
    """
    triangles, transform = track.triangles, track.transforms[0, 1]
    if (np.ptp(track.points(0), axis=0) < np.ptp(skin, axis=0)).any() or not np.linalg.det(transform[:, :3]):
        return None
    if not is_closed(triangles):
        return None
    points = track.shapes[track.shape[0, 1]]
    own = np.linalg.solve(transform[:, :3], (skin - transform[:, 3]).T).T
    center, size, part = own.mean(axis=0), np.ptp(own, axis=0), loose_parts(points, triangles)
    low, high = np.full((part.max() + 1, 3), np.inf), np.full((part.max() + 1, 3), -np.inf)
    np.minimum.at(low, part, points)
    np.maximum.at(high, part, points)
    facing, asked = None, own[np.linspace(0, len(own) - 1, ASKED).astype(int)]
    for each in np.flatnonzero(((low < center) & (high > center) & (high - low > size)).all(axis=1)):
        faces = part[triangles[:, 0]] == each
        distances = dynamorph.Collider(points, triangles[faces]).signed_distances(asked)
        if (distances < 0.0).mean() >= WITHIN:
            facing = triangles.copy() if facing is None else facing
            if signed_volume(points, triangles[faces]) > 0.0:
                facing[faces] = triangles[faces][:, ::-1]
    return facing


def _motion(collider: Any, first: np.ndarray, track: ColliderTrack) -> Any:
    """first (V, 3): the shape at the first sample."""
    keeps_shape = all(np.array_equal(track.shapes[shape], first) for shape in np.unique(track.shape))
    if keeps_shape:
        motion = np.concatenate([track.transforms[:1, 0], track.transforms[:, 1]])
    else:
        samples = range(len(track.friction))
        motion = np.array([track.points(0, side=0), *(track.points(sample) for sample in samples)])
    return dynamorph.ColliderMotion(collider, motion, track.friction, track.active)


class TooDeep(NamedTuple):
    """Where a bone leaves the tissue no room: depth, meters, is how deep the skin stays in a collider, at most; first,
    last: the frames about that one.
    """

    bone: str
    collider: str
    depth: float
    first: int
    last: int

    @property
    def text(self) -> Message:
        return Message(
            "Bone '{bone}' pushes the skin {depth:.3g} mm too deep into '{collider}' at {frames}: pose it farther out",
            bone=self.bone,
            depth=1000.0 * self.depth,
            collider=self.collider,
            frames=named_frames(self.first, self.last),
        )


@dataclass(frozen=True)
class Touched:
    """How deep a shot went into colliders, and into skin that stops it. penetration: of the skin, after a step, at
    most, meters. left_inside: one of each collider that was the deepest at some time, the worst first. unusable: of
    each collider that could not stop anything somewhere, the name, and the first frame and the last where it could not.
    pressed: first and last of each run of frames in which something touched the skin.
    """

    penetration: float = 0.0
    left_inside: tuple[TooDeep, ...] = ()
    unusable: tuple[tuple[str, int, int], ...] = ()
    pressed: tuple[tuple[int, int], ...] = ()

    @property
    def texts(self) -> list[Message]:
        """What did not go as the artist wants it, in sentences."""
        text = "'{name}' does not stop anything at {frames}, because it is scaled to zero there"
        without = [Message(text, name=name, frames=named_frames(*frames)) for name, *frames in self.unusable]
        return [*(each.text for each in self.left_inside), *without]


def touched(times: np.ndarray, steps: dict[str, np.ndarray], collision: Collision, bones: Sequence[str]) -> Touched:
    """Of the steps' statistics by name, each (F,), to each of the times (F,). bones: names."""
    return Touched(
        float(steps["penetration"].max(initial=0.0)),
        tuple(sorted(_too_deep(times, steps, collision, bones), key=lambda each: -each.depth)),
        tuple(_unusable(times, steps["unusable_colliders"], collision)),
        tuple(_runs(times, steps["contacts"] > 0)),
    )


def _runs(times: np.ndarray, there: np.ndarray) -> Iterator[tuple[int, int]]:
    """The first frame and the last of each run of times (F,) at which something is there."""
    ends = np.flatnonzero(np.diff(np.r_[False, there, False]))
    for first, end in ends.reshape(-1, 2):
        yield int(np.floor(times[first])), int(np.ceil(times[end - 1]))


def _too_deep(
    times: np.ndarray, steps: dict[str, np.ndarray], collision: Collision, bones: Sequence[str]
) -> Iterator[TooDeep]:
    """`Touched.left_inside`: of each step only the deepest place is known."""
    samples, colliders = steps["too_deep_sample"].astype(int), steps["too_deep_collider"].astype(int)
    for collider in np.unique(colliders[steps["too_deep"] > 0.0]):
        depth = np.where(colliders == collider, steps["too_deep"], 0.0)
        worst = int(depth.argmax())
        names = collision.names(samples[worst], collider, bones)
        yield TooDeep(*names, float(depth[worst]), *frames_around(worst, depth <= 0.0, times))


def as_bits(colliders: Sequence[int]) -> float:
    """Numbers of colliders as one number among a step's statistics, which are floats."""
    return float(sum(1 << collider for collider in colliders if collider < BITS))


def _unusable(times: np.ndarray, bits: np.ndarray, collision: Collision) -> Iterator[tuple[str, int, int]]:
    """`Touched.unusable`, from `as_bits` of the steps to each of the times (F,)."""
    for collider in range(BITS):
        found = times[(bits.astype(np.int64) >> collider & 1).astype(bool)]
        if len(found):
            yield collision.collider(collider), int(np.floor(found[0])), int(np.ceil(found[-1]))
