# SPDX-License-Identifier: GPL-3.0-or-later
"""Model + moving rig -> frames. Never touches bpy. The button, the command line and scripts all run this."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence, Set
from dataclasses import replace

import numpy as np

from ..character import Character
from ..geometry import determinant
from ..message import Message
from ..model.build import build
from ..model.cage import ProgressFn, Report
from ..model.model import Model
from ..settings import ModelSettings, SimulationSettings
from .baked import Bake
from .contact import Touched, touched
from .coupling import Coupling
from .limits import Held, held
from .loops import cycle, loop_warnings
from .player import STEP, Frame, Player, changed, statistics
from .rig_samples import RigSamples

LOST = 1e-3  # of a motion, RMS: what a bake may lack beside the targets' shapes where most modes hardly move
NEGLIGIBLE = 1e-5  # of a motion, RMS: what an exact bake may lack
POSES_BYTES = 2**28  # of a shot's poses, which longer ones do without
CHECKED = 10  # frames that are checked for inverted tetrahedra: those with the largest coordinates


def simulate(
    model: Model,
    character: Character,
    rig: RigSamples,
    settings: SimulationSettings,
    progress: ProgressFn | None = None,
) -> Iterator[Frame]:
    """Yields one frame per entry of settings.frames, in one pass. rig: 1 + (end - first) * substeps samples, from
    settings.first on.

    progress(fraction, message) -> bool is asked at every frame, for an unreduced model at every iteration; False raises
    dynamorph.Cancelled.
    """
    return _player(model, character, settings, progress).run(rig)


def _player(model: Model, character: Character, settings: SimulationSettings, progress: ProgressFn | None) -> Player:
    """A player that reports to `progress`."""

    def keep_going(player: Player) -> bool:
        done = (player.number - settings.first) / len(settings.simulated)
        message = Message("Simulating frame {frame}", frame=player.number)
        if settings.loop:  # the number of passes is not known
            done = 1.0 - 0.5 ** (player.passes + done)
            message = Message("Simulating frame {frame}, pass {count}", frame=player.number, count=player.passes + 1)
        return progress is None or progress(done, message)

    return Player(model, character, settings, keep_going=keep_going)


def build_for(
    character: Character,
    rig: RigSamples | None,
    settings: SimulationSettings | None,
    progress: ProgressFn | None = None,
    previous: Model | None = None,
    draft: Callable[[Model], None] | None = None,
) -> Model:
    """`build.build` for a character and, if its modes are fitted, for this shot."""

    if rig is None or settings is None:
        return build(character, progress, previous, draft=draft)

    def simulate_shot(model: Model, report: Report) -> tuple[np.ndarray, np.ndarray]:
        frames = list(simulate(model, character, rig, settings, lambda fraction, _message: report(fraction)))
        return np.array([frame.coordinates for frame in frames]), np.array([frame.weights for frame in frames])

    model = build(character, progress, previous, simulate_shot)
    fitted = "rehearsal" in model.summary.seconds
    return model.with_summary(fitted=(settings.frame_start, settings.frame_end)) if fitted else model


class Shot:
    """A bake in progress. The moving rig comes in chunks, so that a long shot takes no more memory than a short one. It
    can be kept after each chunk and resumed, also by another process. A loop is one chunk.

    The run-up is part of the shot, but not of its bake. progress(fraction, message) -> bool; False raises
    dynamorph.Cancelled.
    """

    def __init__(
        self, model: Model, character: Character, settings: SimulationSettings, progress: ProgressFn | None = None
    ):
        self.player = _player(model, character, settings, progress)
        self.done = 0  # number of settings.times
        self._coordinates: list[np.ndarray] = []  # one entry per chunk, like the next two
        self._weights: list[np.ndarray] = []
        self._steps: list[np.ndarray] = []
        self._amounts: list[np.ndarray] = []  # that are keyed
        self._poses: list[np.ndarray] = []
        self._loop: dict = {}
        self._warnings: list[str] = []
        self._seconds = 0.0

    @property
    def is_complete(self) -> bool:
        return self.done == len(self.player.settings.times)

    def play(self, rig: RigSamples) -> None:
        """Simulates the next chunk: the sample of the first frame, unless that is done, then settings.substeps per
        frame.
        """
        if self.is_complete:
            return
        began, player = time.perf_counter(), self.player
        self._see_poses(rig)
        if player.settings.loop:
            frames, gap = cycle(player, rig)
            self._loop, self._warnings = {"gap": gap}, loop_warnings(player, rig, gap)
        else:
            frames, rig, numbers = self.begun(rig)
            frames += player.play(rig, numbers)
        self.take(frames, time.perf_counter() - began)

    def _see_poses(self, rig: RigSamples) -> None:
        """Keep where the bones are at the frames of a chunk, as it comes."""
        player, settings = self.player, self.player.settings
        size = 4 * 12 * len(settings.times) * player.character.weights.shape[1]
        if not player.probed and size <= POSES_BYTES:
            stride = settings.substeps // settings.samples
            at_frames = replace(rig, tracks=())[stride - 1 if self.done else 0 :: stride]
            self._poses.append(player.posing.frames(at_frames).astype(np.float32))

    @property
    def poses(self) -> np.ndarray | None:
        """The bones (F, B + 1, 3, 4), bind to world space, at what was played without the run-up; None where they were
        not kept.
        """
        settings = self.player.settings
        found = np.concatenate(self._poses) if self._poses else np.zeros((0, 0, 3, 4))
        return found[settings.run_up * settings.samples :] if len(found) == self.done else None

    def begun(self, rig: RigSamples) -> tuple[list[Frame], RigSamples, range]:
        """The first frame, unless that is done, and what is left of the chunk: its rig, and the frames' numbers."""
        frames = [] if self.done else [self.player.begin(rig)]
        rig, reached = rig[len(frames) :], self.player.settings.reached(self.done)
        return frames, rig, range(reached + 1, reached + 1 + len(rig) // self.player.settings.substeps)

    def take(self, frames: Sequence[Frame], seconds: float) -> None:
        """Add frames that were simulated in so many seconds."""
        self.done += len(frames)
        self._coordinates.append(np.array([frame.coordinates for frame in frames]))
        self._weights.append(np.array([frame.weights for frame in frames]))
        self._steps.append(statistics(frames))
        self._amounts += [np.array([frame.amounts for frame in frames])] if frames[0].amounts is not None else []
        self._seconds += seconds

    def kept(self) -> dict[str, np.ndarray]:
        """Everything that `resume` needs."""
        state = self.player.state
        return {
            "coordinates": np.concatenate(self._coordinates),
            "weights": np.concatenate(self._weights),
            "steps": np.concatenate(self._steps),
            # In a file, all numbers must be finite.
            "amounts": np.nan_to_num(np.concatenate(self._amounts), nan=-1.0) if self._amounts else np.zeros((0, 0)),
            "past": np.array(state.coordinates),
            "bones": np.array(state.bones),
            "limit": np.array(state.limit),
            "contact": np.array(state.contact),
            "dents": np.array(state.dents),
        }

    def resume(self, kept: dict[str, np.ndarray], first: RigSamples) -> None:
        """Continues after the frames of another instance of the same shot; first: the sample of the first frame."""
        self._coordinates, self._weights, self._steps = ([kept[name]] for name in ("coordinates", "weights", "steps"))
        self.done, self._amounts = len(kept["coordinates"]), list[np.ndarray]()
        if kept["amounts"].size:
            self._amounts = [np.where(kept["amounts"] < 0.0, np.nan, kept["amounts"])]
        past = {"coordinates": list(kept["past"])} | {name: kept[name] for name in ("limit", "contact", "dents")}
        self.player.resume(first, changed(self.player.state, **past, bones=list(kept["bones"])))

    @property
    def held(self) -> Held:
        """Where the limits worked hardest in what was played, without the run-up."""
        return held(*self._statistics(), self.player.model.bone_names)

    @property
    def touched(self) -> Touched | None:
        """How deep it went into colliders, without the run-up; None without Collision."""
        player = self.player
        if player.collision is None:
            return None
        return touched(*self._statistics(), player.collision, player.model.bone_names)

    def _statistics(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """The times of what was played, without the run-up, and the steps' statistics to each of them by name."""
        settings = self.player.settings
        kept = slice(settings.run_up * settings.samples, None)
        steps = dict(zip(STEP, np.concatenate(self._steps)[kept].T, strict=True))
        return settings.times[kept][: len(steps["steps"])], steps

    def bake(self, exact: bool = False) -> tuple[Bake, dict]:
        """The bake and its report, when all is played. exact: an unreduced one has as many modes as it takes for all of
        the motion, else as many as the model's settings say.
        """
        began, player = time.perf_counter(), self.player
        model, character, settings = player.model, player.character, player.settings
        kept = slice(settings.run_up * settings.samples, None)
        coordinates, weights = (np.concatenate(rows)[kept] for rows in (self._coordinates, self._weights))
        amounts = np.concatenate(self._amounts)[kept] if self._amounts else None
        static = player.static(weights)
        report = _report(settings.times, np.concatenate(self._steps)) | self._loop
        report["warnings"] += self._warnings
        report.update(_worst_elements(player, coordinates, static))
        coordinates, free = player.amounts.shown(coordinates, weights, amounts), player.modes.T
        full = model.settings.solver == "FULL" and player.engine is not None
        dents = player.collision is not None and player.collision.dents.size > 0
        if full or ((model.responses.size or dents) and not exact):  # most of them hardly move in one shot
            few = _few_modes(model.settings, coordinates, static, exact)
            if full:
                report["compression_error"] = float(np.abs(coordinates - coordinates @ few.T @ few).max())  # meters
            coordinates, static, free = coordinates @ few.T, static @ few.T, few if full else few @ free
        modes = node_modes(model, free)
        skin, empty = player.skin, np.zeros((0, *character.vertices.shape))
        surface = skin.surface(modes) if modes.size else empty
        report["seconds"] = self._seconds + time.perf_counter() - began
        names = tuple(target.name for target in character.targets)
        return Bake(settings.frames, coordinates, weights, surface, skin.residual_shapes, names, static, modes), report


def play_together(
    shots: Sequence[Shot], rigs: Sequence[RigSamples], garments: Set[tuple[str, str]] = frozenset()
) -> None:
    """Simulates the next chunk of shots, with the same frames, whose bodies press on each other. None is a loop.
    garments: (clothes, body), names of those that lie on others.
    """
    began = time.perf_counter()
    for shot, rig in zip(shots, rigs, strict=True):
        shot._see_poses(rig)
    firsts, rests, numbers = zip(*map(Shot.begun, shots, rigs), strict=True)
    players = {shot.player.character.name: shot.player for shot in shots}
    coupling = Coupling(list(players.values()), [(players[clothes], players[body]) for clothes, body in garments])
    played = list(coupling.play(rests, numbers[0]))
    seconds = (time.perf_counter() - began) / len(shots)
    for k, shot in enumerate(shots):
        shot.take([*firsts[k], *(frames[k] for frames in played)], seconds)


def bake(
    model: Model,
    character: Character,
    rig: RigSamples,
    settings: SimulationSettings,
    progress: ProgressFn | None = None,
) -> tuple[Bake, dict]:
    """Simulates a shot at once: (Bake, report); as `Shot`."""
    shot = Shot(model, character, settings, progress)
    shot.play(rig)
    return shot.bake()


def part_of(bake: Bake, members: slice, from_body: np.ndarray | None = None) -> Bake:
    """The same shot for some of its vertices; from_body (3, 3): maps displacements to the space of these vertices."""
    modes, residual_shapes = bake.modes[:, members], bake.residual_shapes[:, members]
    if from_body is not None:
        modes, residual_shapes = modes @ from_body.T, residual_shapes @ from_body.T
    return replace(bake, modes=modes, residual_shapes=residual_shapes)


def _report(frames: np.ndarray, steps: np.ndarray) -> dict:
    """Statistics of the steps to each of `frames` (F,), from (F, STEP)."""
    by_name = dict(zip(STEP, steps.T, strict=True))
    moving = by_name["steps"] > 0
    rates = by_name["steps"][moving] / by_name["seconds"][moving]
    warnings: list[str] = []
    report = {
        "steps": int(by_name["steps"].sum()),
        "engine_seconds": float(by_name["seconds"].sum()),
        "steps_per_second": float(np.median(rates))
        if len(rates)
        else 0.0,  # the median, because machines have other work
        "iterations": int(by_name["iterations"].sum()),
        "residual": float(by_name["residual"].max()),  # relative to the largest force
        "energy": float(by_name["energy"].max()),  # elastic, J
        "warnings": warnings,
    }
    unconverged = _whole(frames[by_name["converged"] == 0])
    if unconverged:
        warnings.append(
            Message("Steps did not converge at {frames}: raise Substeps Per Frame", frames=_some(unconverged))
        )
    cuts = _whole(frames[by_name["teleported"] != 0])
    if cuts:
        warnings.append(Message("The rig jumps at {frames}: the soft skin was carried along", frames=_some(cuts)))
    return report


def _whole(frames: np.ndarray) -> list[int]:
    """The frames to which steps belong, given the times at which they ended."""
    return np.unique(np.ceil(frames)).astype(int).tolist()


def _some(numbers: list[int]) -> Message:
    listed = ", ".join(map(str, numbers[:5])) + (", ..." if len(numbers) > 5 else "")
    return Message("frames {numbers}" if len(numbers) > 1 else "frame {numbers}", numbers=listed)


def _worst_elements(player: Player, coordinates: np.ndarray, static: np.ndarray) -> dict:
    """The smallest det F and the largest number of inverted tetrahedra over the most deformed frames.

    coordinates, static (F, dofs): with and without motion.
    """
    if player.engine is None:
        return {"smallest_det": 1.0, "inverted": 0}
    model, displacement = player.model, player.displacement
    strength = np.abs(coordinates - static).max(axis=1, initial=0.0)
    rest = _volumes(model.nodes, model.tets)
    smallest, inverted = np.inf, 0
    for k in np.argsort(strength)[-CHECKED:]:
        moved = _volumes(model.nodes + displacement(coordinates[k]), model.tets) / rest
        smallest = min(smallest, moved.min())
        inside_out = model.tets[moved <= 0]
        sculpted = _volumes(model.nodes + displacement(static[k]), inside_out)
        inverted = max(inverted, int((sculpted > 0).sum()))  # without those that the sculpt itself inverts
    return {"smallest_det": float(smallest), "inverted": inverted}


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


def _few_modes(settings: ModelSettings, coordinates: np.ndarray, static: np.ndarray, exact: bool) -> np.ndarray:
    """As few orthonormal modes (r, dofs) as a shot needs: those of the targets' shapes, and for the rest of the motion
    as many as `settings` say, without those that hardly move in it; exact: those for all of it.

    coordinates, static (F, dofs): with and without motion.
    """
    _, s, shapes = np.linalg.svd(static, full_matrices=False)
    shapes = shapes[s > 1e-9 * max(s.max(initial=0.0), 1e-300)]
    _, s, others = np.linalg.svd(coordinates - coordinates @ shapes.T @ shapes, full_matrices=False)
    without = np.sqrt(np.cumsum(s[::-1] ** 2)[::-1])  # what is lost without a mode and all later ones
    lost = NEGLIGIBLE if exact else LOST if settings.basis == "RESPONSES" else 0.0
    rounding = 1e-9 * np.linalg.norm(coordinates)  # the directions of less than this may be those of the shapes
    enough = int((without > max(lost * without[0], rounding)).sum())
    limit = enough if exact else min(enough, settings.modes)
    return np.concatenate([shapes, others[: max(limit, 1 - len(shapes))]])
