# SPDX-License-Identifier: GPL-3.0-or-later
"""Model + moving rig -> frames. Never touches bpy. The button, the command line and scripts all run this."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, islice

import dynamorph
import numpy as np

from .build import Model, Progress, build
from .loops import cycle, loop_warnings
from .scene_data import Bake, Character, Follower, RigSamples, SimulationSettings, connected_parts, determinant, inverse

CHUNK = 32  # frames whose rig is turned into matrices at once: bounds memory, hides NumPy's call overhead
CHUNK_NODES = 2**18  # transforms of nodes made at once, if those are known: 25 MB
TELEPORT = 18.0  # body sizes a second off its course in one step: no motion, but a cut
STEP = ("steps", "iterations", "converged", "residual", "energy", "teleported", "seconds")  # what a frame's steps say
NO_STEPS = dict.fromkeys(STEP, 0) | {"converged": True}
FLAT = 1e-9  # determinant of a node's transform below which it has no size
CHECKED = 10  # frames looked at for inverted tetrahedra: those with the largest coordinates


@dataclass(frozen=True)
class Frame:
    """A frame, or a time between two: coordinates (dofs,), target weights (J,), and a report of the steps to it."""

    number: float
    coordinates: np.ndarray
    weights: np.ndarray
    steps: dict


def placing_bones(character: Character) -> list[int]:
    """Indices of the bones whose rotations place targets in pose space; those that are missing left out."""
    names = character.skeleton.names
    placing = {bone for target in character.targets for bone in target.bones}
    return [index for index, name in enumerate(names) if name in placing]


def pose_space(character: Character) -> dynamorph.PoseSpace:
    """Raises dynamorph.Error, naming both, when two targets have the same pose; ValueError on a missing bone."""
    names = character.skeleton.names
    sets = []
    for target_set in character.target_sets:
        named = sorted({bone for target in target_set.targets for bone in target.bones})
        missing = [bone for bone in named if bone not in names]
        if missing:
            raise ValueError(f"'{character.name}': bone '{missing[0]}' of target set '{target_set.name}' is missing")
        sets.append(
            dynamorph.TargetSet(
                [names.index(bone) for bone in named],
                [target.name for target in target_set.targets],
                [target.local for target in target_set.targets],
                radii=[target.radius for target in target_set.targets],
            )
        )
    return dynamorph.PoseSpace(sets)


class Player:
    """One character, stepped frame by frame: a bake and playback both run this.

    keep_going() -> bool is asked at every frame, of an unreduced model at every iteration; False raises
    dynamorph.Cancelled. number: the frame it is at; passes: how often it has begun again. gains (dofs,) and influence
    (J,) of the targets: what `shown` applies, to be set at any time. engine: model.engine(character), if it is at hand
    already; afterwards None for static morph targets.
    """

    def __init__(
        self, model: Model, character: Character, settings: SimulationSettings, *, keep_going=None, engine=None
    ):
        self.model = model
        self.settings = settings
        self.number, self.passes = settings.first, 0
        self.engine = None
        self._keep_going = keep_going
        self.character = character.by_method()
        self._space = pose_space(self.character)
        self._first: RigSamples | None = None  # the sample that it began with
        self._shapes = np.zeros((len(self.character.targets), 0))
        self._simulation = _NothingMoves()
        if model.settings.method != "STATIC":
            self.engine = engine or model.engine(self.character, self.character.probed)
            self._shapes = model.target_coordinates(self.engine)
            self._simulation = self._stepper()
        self.influence = np.array([target.influence for target in self.character.targets])
        self.gains = np.ones(self._shapes.shape[1])
        if model.settings.solver == "REDUCED":
            known = min(len(settings.gains), len(self.gains))
            self.gains[:known] = settings.gains[:known]

    @property
    def state(self):
        """What it goes on from; to be kept, and set to go on from there again."""
        return self._simulation.state

    @state.setter
    def state(self, state):
        self._simulation.state = state

    @property
    def past(self) -> np.ndarray:
        """Its coordinates now and at the last three steps: (4, dofs)."""
        return np.array(self.state[0])

    @past.setter
    def past(self, coordinates: np.ndarray):
        self.state = list(coordinates), self.state[1]

    @property
    def probed(self) -> bool:
        """Whether it asks for `RigSamples.nodes`."""
        return self.character.probed and self.engine is not None

    @property
    def size(self) -> float:
        """Diagonal of the body's bounding box, metres."""
        return float(np.linalg.norm(np.ptp(self.character.vertices @ self.character.to_bind.T, axis=0)))

    def run(self, rig: RigSamples) -> Iterator[Frame]:
        """One of each of settings.frames, one pass; rig: 1 + (end - first) * substeps samples."""
        settings = self.settings
        frames = chain([self.begin(rig)], self.play(rig[1:], settings.simulated[1:]))
        yield from islice(frames, settings.run_up * settings.samples, None)

    def begin(self, rig: RigSamples) -> Frame:
        """The frame settings.first. rig: its sample and those that follow it, of which the first counts."""
        self._hold_targets(rig[:1])
        bones, weights = self._posed(rig[:2])  # or nodes, if those are known
        if self.settings.begin == "REST":
            self.state = [self.dry(weights[0])] * 4, [bones[0].reshape(-1, 12)] * 4
            begun = NO_STEPS
        else:
            held = self.settings.held > 0
            begun = self._simulation.start(bones[0], bones[0] if held else bones[-1], weights[0])
        still = [np.repeat(first[:1], self.settings.substeps, axis=0) for first in (bones, weights)]
        for _ in range(self.settings.held):
            self._ask()
            self._simulation.advance(*still, self._push(rig.fields, 0, bones[0]))
        self.number = self.settings.first
        return Frame(self.number, self._simulation.coordinates, weights[0], begun)

    def resume(self, first: RigSamples, state):
        """Go on from the `state` of another player that began with the sample `first`; its next frames are to come."""
        self._hold_targets(first)
        self.state = state

    def begin_again(self, rig: RigSamples, frame: Frame) -> Frame:
        """From `frame`, the last of a cycle, back to the first, where the soft skin goes on as it came.

        What the rig has travelled meanwhile, its past travels back.
        """
        first, last = self._ends(rig)
        turn, shift = _rigid_fit(last, first)
        coordinates, bones = self.state
        moved = [turn @ past.reshape(-1, 3, 4) for past in bones]
        for past in moved:
            past[:, :, 3] += shift
        self.state = coordinates, [past.reshape(-1, 12) for past in moved]
        self.number, self.passes = self.settings.start, self.passes + 1
        return Frame(self.number, frame.coordinates, self._posed(rig[:1])[1][0], NO_STEPS)

    def pose_gap(self, rig: RigSamples) -> float:
        """How far the skin of the last pose, moved as a whole, is off that of the first: metres, at most."""
        first, last = self._ends(rig)
        turn, shift = _rigid_fit(last, first)
        return float(np.linalg.norm(last @ turn.T + shift - first, axis=1).max(initial=0.0))

    def gap(self, first: Frame, second: Frame) -> float:
        """The largest distance, in metres, between the soft skins of two frames in one pose, as `shown` by targets of
        full influence: what others hide at the seam of a loop is seen elsewhere.
        """
        displacement = np.tensordot(second.weights - first.weights, self.model.details, 1)
        if self.engine is not None:
            first, second = (self._with_gains(frame.coordinates, self.dry(frame.weights)) for frame in (first, second))
            displacement += self.model.surface(self.engine.displacement(second - first))
        return float(np.linalg.norm(displacement @ self.model.to_bind.T, axis=1).max())

    def advance(self, rig: RigSamples, number: int) -> Frame:
        """The frame `number`, one frame after the last; rig: its settings.substeps samples."""
        *_, frame = self.play(rig, [number])
        return frame

    def play(self, rig: RigSamples, numbers) -> Iterator[Frame]:
        """The frames `numbers`, which follow the last, and what is kept between; rig: settings.substeps samples each.

        Force fields change from frame to frame.
        """
        substeps, samples = self.settings.substeps, self.settings.samples
        stride = substeps // samples
        if len(rig) != len(numbers) * substeps:
            raise ValueError(f"rig: expected {len(numbers) * substeps} samples, got {len(rig)}")
        frames = max(1, CHUNK_NODES // (len(rig.nodes.rest) * substeps)) if rig.nodes else CHUNK
        for first in range(0, len(numbers), frames):
            chunk = numbers[first : first + frames]
            moving = rig[first * substeps : (first + len(chunk)) * substeps]
            bones, weights = self._posed(moving)
            for k, number in enumerate(chunk):
                self.number = int(number)
                self._ask()
                last = (k + 1) * substeps - 1
                push = self._push(moving.fields, last, bones[last])
                for left in reversed(range(samples)):
                    end = last + 1 - left * stride
                    steps = slice(end - stride, end)
                    report = self._simulation.advance(bones[steps], weights[steps], push)
                    time = self.number - left / samples
                    yield Frame(time, self._simulation.coordinates, weights[end - 1], report)

    def exchange(self, character: Character, settings: SimulationSettings | None = None) -> Player:
        """A player that goes on from here with the materials, poses and blending of `character`.

        settings: others with steps as long.
        """
        other = Player(self.model, character, settings or self.settings, keep_going=self._keep_going)
        other.gains, other.number, other.passes = self.gains, self.number, self.passes
        if self._first is not None:
            other._hold_targets(self._first)
            other.state = self.state
        return other

    def dry(self, weights: np.ndarray) -> np.ndarray:
        """Coordinates (..., dofs) of the targets' shapes blended by the weights (..., J): what does not move."""
        return weights @ self._shapes

    def shown(self, frame: Frame) -> np.ndarray:
        """The frame's coordinates, where the amount, the modes' gains and the targets' influence scale the motion about
        the targets' shapes.
        """
        return self.as_shown(frame.coordinates, frame.weights)

    def as_shown(self, coordinates: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """As `shown`, of coordinates (..., dofs) at the targets' weights (..., J).

        In the region of a set the motion has the mean influence of its targets, by their weights, which sum to one.
        """
        dry = self.dry(weights)
        coordinates = self._with_gains(coordinates, dry)
        if self.engine is None or (self.influence == 1.0).all():
            return coordinates
        sizes = [len(target_set.targets) for target_set in self.character.target_sets]
        begins = np.cumsum([0, *sizes[:-1]])
        shares = np.add.reduceat(weights * self.influence, begins, axis=-1)
        parts = self._in_regions(coordinates - dry)
        return dry + sum(share[..., None] * part for share, part in zip(np.moveaxis(shares, -1, 0), parts, strict=True))

    def _with_gains(self, coordinates: np.ndarray, dry: np.ndarray) -> np.ndarray:
        return coordinates + (self.settings.amount * self.gains - 1.0) * (coordinates - dry)

    def _in_regions(self, motion: np.ndarray) -> list[np.ndarray]:
        """Each set's part of a motion (..., dofs); they sum to it."""
        if len(self.character.target_sets) == 1:
            return [motion]
        if self.model.settings.solver == "FULL":
            return [motion * share for share in self._node_shares]
        return [motion @ part for part in self._region_parts]

    @cached_property
    def _node_shares(self) -> np.ndarray:
        """How much of each free node follows each set, once an axis: (S, 3 free)."""
        model = self.model
        corners, around = model.tets.ravel(), np.repeat(model.shares, 4, axis=0)
        total = np.array([np.bincount(corners, share, len(model.nodes)) for share in around.T])
        return np.repeat((total / total.sum(axis=0).clip(1e-300))[:, model.free], 3, axis=1)

    @cached_property
    def _region_parts(self) -> list[np.ndarray]:
        """For each set the (r, r) that takes coordinates to what the modes can do of their motion in its region alone,
        by least squares.
        """
        back = np.linalg.pinv(self.model.basis)
        return [(back @ (share[:, None] * self.model.basis)).T for share in self._node_shares]

    def _ask(self):
        """Raises dynamorph.Cancelled when it is not to go on."""
        if self._keep_going and not self._keep_going():
            raise dynamorph.Cancelled("cancelled")

    def _ends(self, rig: RigSamples) -> np.ndarray:
        """The skin at rest, posed by the first sample and by the last: (2, V, 3), world space."""
        return self._skinned(rig[:: max(1, len(rig) - 1)])[[0, -1]]

    def _skinned(self, rig: RigSamples) -> np.ndarray:
        """The skin at rest, posed as the rig is: (S, V, 3), world space; of it what moves as is known."""
        return np.array([self._skin.posed(frame) for frame in self._frames(rig)])[:, self._skin.known]

    def _stepper(self):
        settings, full = self.settings, self.model.settings.solver == "FULL"
        return self.model.stepper(
            self.engine,
            settings.step,
            scheme=dynamorph.Scheme.__members__[settings.scheme],
            gravity=settings.gravity,
            teleport=TELEPORT * self.engine.body.size * settings.step,
            keep_going=self._keep_going if full else None,  # a reduced step takes less than the question
        )

    def _hold_targets(self, first: RigSamples):
        """Sculpted shapes are what the artist saw under gravity, so each is held up in its own pose."""
        self._first = first
        if any(self.settings.gravity):
            self._simulation.hold_targets(self._target_frames(first))

    def _target_frames(self, rig: RigSamples) -> np.ndarray:
        """Transforms as `_frames` of the targets' captured poses (J, ...), with the armature where it stood then."""
        targets = self.character.targets
        pose = self.model.skeleton.pose(np.array([target.local for target in targets]))
        rig_world = np.array([_resized(target.rig_world, rig.rig_world[0]) for target in targets])
        object_world = rig_world @ inverse(rig.rig_world[0]) @ rig.object_world[0]
        return self._frames(RigSamples(pose, rig_world, object_world, nodes=rig.held))

    def _posed(self, rig: RigSamples) -> tuple[np.ndarray, np.ndarray]:
        """Transforms as `_frames`, and target weights (S, J)."""
        local = self.model.skeleton.local_transforms(rig.pose, placing_bones(self.character))
        return self._frames(rig), self._space.weights(local)

    def _frames(self, rig: RigSamples) -> np.ndarray:
        """The transforms that the engine asks for: of the bones (S, B + 1, 3, 4), or of the free nodes (S, n, 3, 4)."""
        model = self.model
        if not self.probed:
            return rig.skin_matrices(model.skeleton, model.to_bind)
        if rig.nodes is None or not np.array_equal(rig.nodes.rest, model.nodes[model.free]):
            raise ValueError(f"'{self.character.name}' was sampled without the nodes of its model: sample it again")
        frames = rig.nodes.transforms(rig.object_world)
        flat = np.abs(determinant(frames[..., :3])) < FLAT
        if flat.any():  # bones scaled to zero, which `extract.hold_collapsed` holds
            sample, node = np.nonzero(flat)
            bones = rig.skin_matrices(model.skeleton, model.to_bind)[sample]
            frames[flat] = np.einsum("kb,kbij->kij", model.node_weights[model.free][node], bones)
        return frames

    def _push(self, fields, sample: int, bones: np.ndarray) -> np.ndarray | None:
        """What the force fields do to the nodes, from where the flesh is now; None without any."""
        if not fields or self.engine is None:
            return None
        return self._skin.push(fields, sample, bones, self.engine.displacement(self._simulation.coordinates))

    @cached_property
    def _skin(self) -> _Skin:
        return _Skin(self.model, self.character)


class _NothingMoves:
    """In the place of the engine's simulation for static morph targets: there are no coordinates."""

    coordinates = np.zeros(0)
    state = (), ()

    def start(self, _now, _next, _weights) -> dict:
        return NO_STEPS

    def advance(self, _bones, _weights, _external=None) -> dict:
        return NO_STEPS

    def hold_targets(self, _bones):
        pass


def simulate(
    model: Model,
    character: Character,
    rig: RigSamples,
    settings: SimulationSettings,
    progress: Progress | None = None,
) -> Iterator[Frame]:
    """Yields one of each of settings.frames, in one pass.

    rig: 1 + (end - first) * substeps samples, from settings.first on. progress(fraction, message) -> bool is asked at
    every frame, of an unreduced model at every iteration; False raises dynamorph.Cancelled.
    """
    return _player(model, character, settings, progress).run(rig)


def _player(model: Model, character: Character, settings: SimulationSettings, progress: Progress | None) -> Player:
    """A player that reports to `progress`."""

    def keep_going() -> bool:
        done = (player.number - settings.first) / len(settings.simulated)
        message = f"Simulating frame {player.number}"
        if settings.loop:  # nobody knows how many passes it takes
            done, message = 1.0 - 0.5 ** (player.passes + done), f"{message}, pass {player.passes + 1}"
        return progress is None or progress(done, message)

    player = Player(model, character, settings, keep_going=keep_going)
    return player


def build_for(
    character: Character,
    rig: RigSamples | None,
    settings: SimulationSettings | None,
    progress: Progress | None = None,
    previous: Model | None = None,
) -> Model:
    """`build.build` for a character in a shot, to which its modes are fitted if it says so; else no shot is needed."""

    def rehearse(model: Model, report) -> tuple[np.ndarray, np.ndarray]:
        frames = list(simulate(model, character, rig, settings, lambda fraction, _message: report(fraction)))
        return np.array([frame.coordinates for frame in frames]), np.array([frame.weights for frame in frames])

    model = build(character, progress, previous, rehearse if rig is not None else None)
    if "rehearsal" in model.summary["seconds"]:
        model.summary["fitted"] = [settings.start, settings.end]
    return model


class Shot:
    """A bake in the making: the moving rig comes in stretches, so that a long shot takes no more memory than a short
    one, and it can be kept after each and gone on with, by another process too. A loop is one stretch. The run-up is
    part of the shot, but not of its bake.

    progress(fraction, message) -> bool; False raises dynamorph.Cancelled.
    """

    def __init__(
        self, model: Model, character: Character, settings: SimulationSettings, progress: Progress | None = None
    ):
        self.player = _player(model, character, settings, progress)
        self.done = 0  # of settings.times
        self._coordinates, self._weights, self._steps = [], [], []  # a stretch each
        self._loop: dict = {}
        self._warnings: list[str] = []
        self._seconds = 0.0

    @property
    def is_complete(self) -> bool:
        return self.done == len(self.player.settings.times)

    def play(self, rig: RigSamples):
        """The next stretch: the sample of the first frame, unless that is done, then settings.substeps a frame."""
        if self.is_complete:
            return
        began, player = time.perf_counter(), self.player
        settings = player.settings
        if settings.loop:
            frames, gap = cycle(player, rig)
            self._loop, self._warnings = {"gap": gap}, loop_warnings(player, rig, gap)
        else:
            frames = [] if self.done else [player.begin(rig)]
            rig, reached = rig[len(frames) :], settings.reached(self.done)
            frames += player.play(rig, range(reached + 1, reached + 1 + len(rig) // settings.substeps))
        self.done += len(frames)
        self._coordinates.append(np.array([frame.coordinates for frame in frames]))
        self._weights.append(np.array([frame.weights for frame in frames]))
        self._steps.append(np.array([[frame.steps[name] for name in STEP] for frame in frames], float))
        self._seconds += time.perf_counter() - began

    def kept(self) -> dict[str, np.ndarray]:
        """All that `resume` asks for."""
        coordinates, bones = self.player.state
        return {
            "coordinates": np.concatenate(self._coordinates),
            "weights": np.concatenate(self._weights),
            "steps": np.concatenate(self._steps),
            "past": np.array(coordinates),
            "bones": np.array(bones),
        }

    def resume(self, kept: dict[str, np.ndarray], first: RigSamples):
        """Go on after the frames of another shot of the same; first: the sample of the first frame."""
        self._coordinates, self._weights, self._steps = ([kept[name]] for name in ("coordinates", "weights", "steps"))
        self.done = len(kept["coordinates"])
        self.player.resume(first, (list(kept["past"]), list(kept["bones"])))

    def bake(self) -> tuple[Bake, dict]:
        """The bake and its report, when all is played."""
        began, player = time.perf_counter(), self.player
        model, character, settings = player.model, player.character, player.settings
        kept = slice(settings.run_up * settings.samples, None)
        coordinates, weights = (np.concatenate(rows)[kept] for rows in (self._coordinates, self._weights))
        dry = player.dry(weights)
        report = _report(settings.times, np.concatenate(self._steps)) | self._loop
        report["warnings"] += self._warnings
        report.update(_worst_elements(player, coordinates, dry))
        coordinates, free = player.as_shown(coordinates, weights), model.basis.T
        if model.settings.solver == "FULL" and player.engine is not None:
            coordinates, dry, free, report["compression_error"] = _compress(model, coordinates, dry)
        modes = node_modes(model, free)
        surface = model.surface(modes) if modes.size else np.zeros((0, *character.vertices.shape))
        report["seconds"] = self._seconds + time.perf_counter() - began
        names = tuple(target.name for target in character.targets)
        return Bake(settings.frames, coordinates, weights, surface, model.details, names, dry, modes), report


def bake(
    model: Model,
    character: Character,
    rig: RigSamples,
    settings: SimulationSettings,
    progress: Progress | None = None,
) -> tuple[Bake, dict]:
    """Simulates a shot at once: (Bake, report); as `Shot`."""
    shot = Shot(model, character, settings, progress)
    shot.play(rig)
    return shot.bake()


def follow(model: Model, bake: Bake, follower: Follower) -> Bake:
    """The same shot of what the flesh carries along, in the follower's own local space."""
    if follower.members:
        return part_of(bake, follower.members, follower.from_body)
    modes, details = carried(model, bake.node_modes, follower)
    return replace(bake, modes=modes, details=details)


def part_of(bake: Bake, members: slice, from_body: np.ndarray | None = None) -> Bake:
    """The same shot of some of its vertices; from_body (3, 3): of a displacement into the space that they are in."""
    turn = np.eye(3) if from_body is None else from_body
    return replace(bake, modes=bake.modes[:, members] @ turn.T, details=bake.details[:, members] @ turn.T)


def carried(model: Model, modes: np.ndarray, follower: Follower) -> tuple[np.ndarray, np.ndarray]:
    """What modes (r, n, 3) of the nodes, bind space, and the model's details do to a follower of P vertices.

    Returns (r, P, 3) and (J, P, 3) in its local space. Where it is outside the cage the nearest tetrahedron goes on
    there, bounded; of the details it has those of the skin nearest to it.
    """
    details = np.moveaxis(follower.skin.carry(np.moveaxis(model.details, 0, 1)), 1, 0) @ follower.from_body.T
    if not len(model.tets):
        return np.zeros((0, *follower.vertices.shape)), details
    part = connected_parts(model.tets, len(model.nodes))  # pieces may have a cage of their own in the same place
    under = part[model.embedding_nodes[np.unique(follower.skin.corners), 0]]
    used, tets = np.unique(model.tets[np.isin(part[model.tets[:, 0]], under)], return_inverse=True)
    embedding = dynamorph.embed(dynamorph.TetMesh(model.nodes[used], tets.reshape(-1, 4)), follower.vertices)
    bind = np.einsum("pa,rpac->rpc", embedding.weights, modes[:, used[embedding.nodes]])
    return bind @ np.linalg.inv(model.to_bind).T @ follower.from_body.T, details


class _Skin:
    """The skin in world space: where it is, and which nodes carry what acts on it."""

    def __init__(self, model: Model, character: Character):
        self.model = model
        self.rest = character.vertices @ character.to_bind.T
        self._weights = character.weights
        self._carriers, self.known = None, slice(None)
        if character.probed and len(model.tets):
            # The bones do not say where it is, the free nodes do: each vertex is moved like those that carry it, on
            # average. What only held nodes carry is not known, but nothing that acts there has an effect.
            carried = model.embedding_weights.clip(0.0) * model.free[model.embedding_nodes]
            total = carried.sum(axis=1, keepdims=True)
            self.known = total[:, 0] > 0.0
            self._weights = carried / np.where(total > 0.0, total, np.inf)
            self._carriers = (np.cumsum(model.free) - 1)[model.embedding_nodes]
        corners = self.rest[character.triangles]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        thirds = np.repeat(np.linalg.norm(across, axis=1) / 6.0, 3)
        self.areas = np.bincount(character.triangles.ravel(), thirds, len(self.rest))  # m^2

    def posed(self, frames: np.ndarray, displacement=0.0) -> np.ndarray:
        """The skin (V, 3), displaced by (V, 3) in bind space, at the transforms that the engine gets (B + 1, 3, 4)."""
        if self._carriers is None:
            matrices = np.tensordot(self._weights, frames, 1)
        else:
            matrices = np.einsum("va,vaij->vij", self._weights, frames[self._carriers])
        return np.einsum("vij,vj->vi", matrices[:, :, :3], self.rest + displacement) + matrices[:, :, 3]

    def push(self, fields, sample: int, frames: np.ndarray, displacement: np.ndarray) -> np.ndarray | None:
        """Newtons on the nodes (n, 3), world space; frames as for `posed`, displacement of the nodes (n, 3)."""
        acting = [field for field in fields if field.strength[sample]]
        if not acting:
            return None
        model = self.model
        moved = np.einsum("va,vac->vc", model.embedding_weights, displacement[model.embedding_nodes])
        points = self.posed(frames, moved)
        return model.on_nodes(self.areas[:, None] * sum(field.pull(sample, points) for field in acting))


def _resized(world: np.ndarray, like: np.ndarray) -> np.ndarray:
    """The place and tilt of a world transform (4, 4) with the size of another: a scale may have been applied since."""
    u, _, vt = np.linalg.svd(world[:3, :3])
    _, sizes, axes = np.linalg.svd(like[:3, :3])
    out = world.copy()
    out[:3, :3] = u @ vt @ (axes.T * sizes) @ axes
    return out


def _report(frames: np.ndarray, steps: np.ndarray) -> dict:
    """Of what the steps to each of `frames` (F,) did (F, STEP)."""
    by_name = dict(zip(STEP, steps.T, strict=True))
    moving = by_name["steps"] > 0
    rates = by_name["steps"][moving] / by_name["seconds"][moving]
    report = {
        "steps": int(by_name["steps"].sum()),
        "engine_seconds": float(by_name["seconds"].sum()),
        "steps_per_second": float(np.median(rates)) if len(rates) else 0.0,  # the median: machines have other work
        "iterations": int(by_name["iterations"].sum()),
        "residual": float(by_name["residual"].max()),  # of the largest force
        "energy": float(by_name["energy"].max()),  # elastic, J
        "warnings": [],
    }
    unconverged = _whole(frames[by_name["converged"] == 0])
    if unconverged:
        report["warnings"].append(f"Steps did not converge at {_some(unconverged)}: raise Substeps")
    cuts = _whole(frames[by_name["teleported"] != 0])
    if cuts:
        report["warnings"].append(f"The rig jumps at {_some(cuts)}: the soft skin was carried along")
    return report


def _whole(frames: np.ndarray) -> list[int]:
    """The frames that steps, named by where they ended, belong to."""
    return np.unique(np.ceil(frames)).astype(int).tolist()


def _some(numbers: list[int]) -> str:
    listed = ", ".join(map(str, numbers[:5])) + (", ..." if len(numbers) > 5 else "")
    return f"frame{'s' * (len(numbers) > 1)} {listed}"


def _worst_elements(player: Player, coordinates: np.ndarray, dry: np.ndarray) -> dict:
    """The smallest det F and the largest number of inverted tetrahedra over the most deformed frames.

    coordinates, dry (F, dofs): with and without motion.
    """
    if player.engine is None:
        return {"smallest_det": 1.0, "inverted": 0}
    model, displacement = player.model, player.engine.displacement
    strength = np.abs(coordinates - dry).max(axis=1, initial=0.0)
    rest = _volumes(model.nodes, model.tets)
    smallest, inverted = np.inf, 0
    for k in np.argsort(strength)[-CHECKED:]:
        moved = _volumes(model.nodes + displacement(coordinates[k]), model.tets) / rest
        smallest = min(smallest, moved.min())
        inside_out = model.tets[moved <= 0]
        sculpted = _volumes(model.nodes + displacement(dry[k]), inside_out)
        inverted = max(inverted, int((sculpted > 0).sum()))  # not what the sculpt itself inverts
    return {"smallest_det": float(smallest), "inverted": inverted}


def _rigid_fit(points: np.ndarray, onto: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rotation (3, 3) and shift (3,) that carry points (V, 3) nearest to others, as a whole."""
    if not len(points):
        return np.eye(3), np.zeros(3)
    centre, goal = points.mean(axis=0), onto.mean(axis=0)
    u, _, vt = np.linalg.svd((onto - goal).T @ (points - centre))
    turn = (u * [1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return turn, goal - turn @ centre


def _volumes(nodes: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """Six times the signed volume of each tetrahedron."""
    corners = nodes[tets]
    return determinant(corners[:, 1:] - corners[:, :1])


def node_modes(model: Model, free: np.ndarray) -> np.ndarray:
    """Displacement of all nodes (r, n, 3), bind space, from rows over the free nodes (r, 3 free)."""
    modes = np.zeros((len(free), len(model.nodes), 3))
    if not modes.size:  # static morph targets
        return modes
    modes[:, model.free] = free.reshape(len(free), -1, 3)
    return modes


def _compress(model: Model, wet: np.ndarray, dry: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """The best `settings.modes` modes of an unreduced shot, and what they lack of the targets' shapes.

    wet, dry (F, 3 free): displacements with and without motion. Returns the coordinates of both, modes (r, 3 free),
    and the largest error of `wet` in metres.
    """
    _, s, modes = np.linalg.svd(wet, full_matrices=False)
    modes = modes[: min(model.settings.modes, len(s))]
    _, s, others = np.linalg.svd(dry - dry @ modes.T @ modes, full_matrices=False)
    modes = np.concatenate([modes, others[s > 1e-6 * np.linalg.norm(dry)]])
    coordinates = wet @ modes.T
    error = float(np.abs(wet - coordinates @ modes).max())
    return coordinates, dry @ modes.T, modes, error
