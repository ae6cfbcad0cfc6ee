# SPDX-License-Identifier: GPL-3.0-or-later
"""Model + moving rig -> frames, step by step: the bake and Live both use this. Never touches bpy."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np

from ..character import Character
from ..engine import dynamorph
from ..geometry import diagonal
from ..model.model import EngineModel, Model
from ..settings import SimulationSettings
from .amounts import Amounts
from .contact import Collision, as_bits
from .grab import Hand
from .keyed import amounts_of, for_engine
from .posing import Posing
from .prepared import prepared
from .rig_samples import RigSamples
from .shown_skin import ShownSkin

CHUNK = 32  # frames whose rig becomes matrices at once; bounds memory and amortizes NumPy's call overhead
CHUNK_NODES = 2**18  # transforms of nodes computed at once, if those are known: 25 MB
TELEPORT = 18.0  # body sizes per second off its course in one step; more is a cut, not a motion
STEP = (
    "steps",
    "iterations",
    "converged",
    "residual",
    "energy",
    "teleported",
    "seconds",
    "excess",
    "excess_bone",
    "farthest",
    "pulled",
    "contacts",
    "penetration",
    "too_deep",
    "too_deep_sample",
    "too_deep_collider",
    "unusable_colliders",
)  # statistics of a frame's steps
NOTHING = {"converged": True, "excess_bone": -1, "unusable_colliders": ()}
NO_STEPS: Any = SimpleNamespace(**dict.fromkeys(STEP, 0) | NOTHING)  # StepReport() without the engine
State: TypeAlias = "dynamorph.State"
STATE = ("coordinates", "bones", "limit", "contact", "dents")  # its parts


def changed(state: State, **parts: Any) -> State:
    """The same state but for some parts."""
    return type(state)(**{name: getattr(state, name) for name in STATE} | parts)


@dataclass(frozen=True)
class Frame:
    """A frame, or a time between two: coordinates (dofs,), target weights (J,), and the engine's report of the steps to
    it. amounts (1 + J,): that are keyed, as of `KeyedSettings.amounts`.
    """

    number: float
    coordinates: np.ndarray
    weights: np.ndarray
    steps: dynamorph.StepReport
    amounts: np.ndarray | None = None


@dataclass(frozen=True)
class Steps:
    """Some steps to a time. motion: what the engine's `advance` takes; bones (S, B, 3, 4), weights (S, J), and more.
    amounts: of the frame then.
    """

    time: float
    motion: tuple
    amounts: np.ndarray | None


def statistics(frames: Sequence[Frame], names: Sequence[str] = STEP) -> np.ndarray:
    """Those of the steps to each of the frames as numbers: (F, len(names))."""
    kinds = {"unusable_colliders": as_bits}
    return np.array([[kinds.get(name, float)(getattr(frame.steps, name)) for name in names] for frame in frames])


class Player:
    """One character, stepped frame by frame, for bakes and playback.

    keep_going(player) -> bool is asked at every frame, for an unreduced model at every iteration; False raises
    dynamorph.Cancelled. number: the current frame; passes: how often the motion has begun again. amounts: applied by
    `shown`; skin: what the coordinates move. first: the first sample. modes (3 free, dofs): displacement of the free
    nodes by each coordinate of a reduced model. engine: None for static targets.
    """

    def __init__(
        self,
        model: Model,
        character: Character,
        settings: SimulationSettings,
        *,
        keep_going: Callable[[Player], bool] | None = None,
    ):
        self.model, self.character, self.settings = model, character, settings
        self.number, self.passes = settings.first, 0
        self.engine: EngineModel | None = None
        self._keep_going = keep_going
        self.collision: Collision | None = None
        self.hand: Hand | None = None  # by which the artist pulls the skin
        self.first: RigSamples | None = None
        self.modes = model.modes
        self._shapes = np.zeros((len(self.character.targets), 0))
        self._simulation: dynamorph.Simulation | _NothingMoves = _NothingMoves()
        if model.settings.method != "STATIC":
            ready = prepared(model, character, settings)
            self.engine = ready.engine
            self._shapes = model.target_coordinates(self.engine)
            self.hand = Hand(model, self.engine, character)
            if settings.collision:
                self.collision = Collision(model, self.engine, character)
            self._simulation = _simulation_of(self, self.engine, ready.limit, self._asked_by_engine())
            if self.collision and (dents := self.collision.dents.shape[1]):
                self.modes = np.hstack([model.modes, self.collision.dents])
                self._shapes = np.pad(self._shapes, ((0, 0), (0, dents)))
        self.posing = Posing(model, self.character, self.probed)
        self.skin = ShownSkin(model, self.character)
        self.amounts = Amounts(model, self.character, self._shapes, self.modes, settings)

    @property
    def simulation(self) -> dynamorph.Simulation:
        """The engine's, of a model that moves."""
        assert not isinstance(self._simulation, _NothingMoves)
        return self._simulation

    @property
    def state(self) -> State:
        """The state from which it continues. It can be kept, and set again to continue from there."""
        return self._simulation.state

    @state.setter
    def state(self, state: State) -> None:
        self._simulation.state = state

    @property
    def coordinates(self) -> np.ndarray:
        """Of the model, now, and the dents where the skin gives way by itself: (dofs,)."""
        return np.concatenate([self._simulation.coordinates, self._simulation.dents])

    def displacement(self, coordinates: np.ndarray) -> np.ndarray:
        """Of the nodes (n, 3), bind space, by coordinates (dofs,)."""
        assert self.engine is not None
        own = self.engine.dofs
        moved = self.engine.displacement(coordinates[:own])
        if len(coordinates) > own:
            moved[self.model.free] += (self.modes[:, own:] @ coordinates[own:]).reshape(-1, 3)
        return moved

    @property
    def probed(self) -> bool:
        """Whether it needs `RigSamples.nodes`."""
        return self.character.probed and self.engine is not None

    @property
    def size(self) -> float:
        """Diagonal of the body's bounding box, meters."""
        return diagonal(self.character.bind_points)

    def run(self, rig: RigSamples) -> Iterator[Frame]:
        """Yields one frame per entry of settings.frames, in one pass; rig: 1 + (end - first) * substeps samples."""
        settings = self.settings
        frames = chain([self.begin(rig)], self.play(rig[1:], settings.simulated[1:]))
        yield from islice(frames, settings.run_up * settings.samples, None)

    def begin(self, rig: RigSamples) -> Frame:
        """The frame settings.first. rig: its sample and those that follow it; only the first is used."""
        self._begin_with(rig[:1])
        bones, weights = self.posing.posed(rig[:2])  # or of the nodes, if they are probed
        if self.settings.initial_state == "REST_SHAPE":
            rest = self.static(weights[0])[: self.engine.dofs if self.engine else 0]
            if self.engine is not None:
                self.state = dynamorph.State([rest] * 4, [bones[0].reshape(-1, 12)] * 4)
            begun = NO_STEPS
        else:
            lies_on = self.collision.motions(rig[:1].still(1)) if self.collision else None
            keyed = for_engine(rig[:1], self.character, self.size)
            stiffness, distance, friction = (None if values is None else values[0] for values in keyed)
            held = self.hand.springs(rig[:1], slice(0, 1), 1) if self.hand else None
            at_first = lies_on, stiffness, distance, friction, held
            begun = self._simulation.start(bones[0], bones[-1], weights[0], *at_first)
        self.number = self.settings.first
        return first_frame(self, rig, self.coordinates, weights[0], begun)

    def resume(self, first: RigSamples, state: State) -> None:
        """Continues from the `state` of another player that began with the sample `first`; its next frames follow."""
        self._begin_with(first)
        self.state = state

    def gap(self, first: Frame, second: Frame) -> float:
        """The largest distance, in meters, between the soft skins of two frames in one pose, as `shown` with the full
        motion of the targets: what a lower motion amount hides at the seam of a loop is visible elsewhere.
        """
        displacement = np.tensordot(second.weights - first.weights, self.skin.residual_shapes, 1)
        if self.engine is not None:
            before, after = (self.amounts.with_gains(frame.coordinates, frame.weights) for frame in (first, second))
            displacement += self.skin.surface(self.displacement(after - before))
        return float(np.linalg.norm(displacement @ self.model.to_bind.T, axis=1).max())

    def advance(self, rig: RigSamples, number: int) -> Frame:
        """The frame `number`, one frame after the last; rig: its settings.substeps samples."""
        *_, frame = self.play(rig, [number])
        return frame

    def play(self, rig: RigSamples, numbers: Sequence[int] | np.ndarray) -> Iterator[Frame]:
        """The frames `numbers`, which follow the last one, and the samples between; rig: settings.substeps samples
        each.
        """
        for steps in self.steps(rig, numbers):
            yield self.taken(steps, self._simulation.advance(*steps.motion))

    def steps(self, rig: RigSamples, numbers: Sequence[int] | np.ndarray) -> Iterator[Steps]:
        """The steps to each of the frames of `play`, to be taken before the next are asked for."""
        substeps, samples = self.settings.substeps, self.settings.samples
        stride = substeps // samples
        if len(rig) != len(numbers) * substeps:
            raise ValueError(f"rig: expected {len(numbers) * substeps} samples, got {len(rig)}")
        frames = max(1, CHUNK_NODES // (len(rig.nodes.rest) * substeps)) if rig.nodes else CHUNK
        for first in range(0, len(numbers), frames):
            chunk = numbers[first : first + frames]
            moving = rig[first * substeps : (first + len(chunk)) * substeps]
            bones, weights = self.posing.posed(moving)
            keyed, amounts = for_engine(moving, self.character, self.size), amounts_of(moving, self.character)
            for k, number in enumerate(chunk):
                self.number = int(number)
                if self._keep_going and not self._keep_going(self):
                    raise dynamorph.Cancelled("canceled")
                for left in reversed(range(samples)):
                    end = (k + 1) * substeps - left * stride
                    steps = slice(end - stride, end)
                    push = self._push(moving[steps], bones[steps])
                    stops = self.collision.motions(moving[steps]) if self.collision else None
                    grabs = self.hand.springs(moving[steps], steps, substeps) if self.hand else None
                    of_steps = (None if values is None else values[steps] for values in keyed)
                    motion = bones[steps], weights[steps], push, grabs, stops, *of_steps
                    shown = None if amounts is None else amounts[end - 1]
                    yield Steps(self.number - left / samples, motion, shown)

    def taken(self, steps: Steps, report: dynamorph.StepReport) -> Frame:
        """The frame after steps, with the engine's report on them."""
        return Frame(steps.time, self.coordinates, steps.motion[1][-1], report, steps.amounts)

    def exchange(self, character: Character, settings: SimulationSettings | None = None) -> Player:
        """A player that continues from here with the materials, poses and blending of `character`. settings: others
        with the same time step.
        """
        other = Player(self.model, character, settings or self.settings, keep_going=self._keep_going)
        other.number, other.passes = self.number, self.passes
        if self.first is not None:
            other._begin_with(self.first)
            other.state = self.state
        return other

    def follow(self, settings: SimulationSettings, motion_amounts: np.ndarray) -> None:
        """Go on with settings of the same physics; motion_amounts (J,): those of the targets from now on."""
        self.settings = settings
        self.amounts.follow(settings, motion_amounts)

    def static(self, weights: np.ndarray) -> np.ndarray:
        """Coordinates (..., dofs) of the targets' shapes blended by the weights (..., J): the static part."""
        return weights @ self._shapes

    def shown(self, frame: Frame) -> np.ndarray:
        """The frame's coordinates with `amounts`."""
        return self.amounts.shown(frame.coordinates, frame.weights, frame.amounts)

    def _asked_by_engine(self) -> Callable[[], bool] | None:
        """`keep_going` for the engine. It must not hold the player, which holds the engine's simulation: Python's
        collector does not see what the engine holds, and neither would ever be freed.
        """
        keep_going, this = self._keep_going, weakref.proxy(self)
        return (lambda: keep_going(this)) if keep_going else None

    def _begin_with(self, first: RigSamples) -> None:
        """What the first sample says: which colliders there are, and how the targets' shapes are balanced. These are
        what the artist saw under gravity, each in its own pose.
        """
        self.first = first
        if self.collision:
            self.collision.begin(first, self.posing.skinned(first[:1])[0])
        if any(self.settings.gravity):
            self._simulation.balance_targets(self.posing.target_frames(first))

    def _push(self, rig: RigSamples, bones: np.ndarray) -> np.ndarray | None:
        """`Skin.pushes` of the force fields, where the skin is displaced as it is now; None without any."""
        if self.engine is None or not any(field.strength.any() for field in rig.fields):
            return None
        return self.posing.skin.pushes(rig.fields, bones, self.displacement(self.coordinates))


def first_frame(
    player: Player, rig: RigSamples, coordinates: np.ndarray, weights: np.ndarray, steps: dynamorph.StepReport
) -> Frame:
    """The frame of a player at the first sample. steps: what its solution says."""
    amounts = amounts_of(rig[:1], player.character)
    return Frame(player.number, coordinates, weights, steps, None if amounts is None else amounts[0])


def _simulation_of(
    player: Player, engine: EngineModel, limit: Any, keep_going: Callable[[], bool] | None
) -> dynamorph.Simulation:
    settings, collision = player.settings, player.collision
    return dynamorph.Simulation(
        engine,
        settings.step,
        limit=limit,
        contact=collision.skin if collision else None,
        distance=settings.distance * player.size,
        self_contact=collision.own if collision and settings.self_collision else None,
        self_friction=settings.self_friction,
        integrator=dynamorph.Integrator.__members__[settings.integrator],
        gravity=settings.gravity,
        teleport=TELEPORT * engine.body.size * settings.step,
        # A reduced step takes less time than asking.
        keep_going=keep_going if player.model.settings.solver == "FULL" else None,
    )


class _NothingMoves:
    """Replaces the engine's simulation for static morph targets, which have no coordinates."""

    coordinates = dents = np.zeros(0)
    state: Any = SimpleNamespace(**dict.fromkeys(STATE, ()))

    def start(self, *_at_rest: object) -> Any:
        return NO_STEPS

    def advance(self, *_moving: object) -> Any:
        return NO_STEPS

    def balance_targets(self, _bones: np.ndarray) -> None:
        pass
