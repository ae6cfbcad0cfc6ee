# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials from measurements: fits of a target's own. Never touches bpy.

A free oscillation of one mode is

    x(t)  = e^(-s t) (a cos w t + b sin w t) + c        with w0^2 = w^2 + s^2
    w0    undamped angular frequency; proportional to sqrt(E / rho) on a given cage
    s     = (alpha + beta w0^2) / 2      decay of Rayleigh damping C = alpha M + beta K
    zeta  = s / w0 = eta / 2             damping ratio, loss factor

(e.g. Bathe, Finite Element Procedures, ch. 9). Stiffness is calibrated on the model's own cage, because a coarse cage
of linear tetrahedra is too stiff: the fit finds the Young's modulus that makes *this* cage move as observed.

The artist's units: bounce is w / 2 pi, settle time the time until a twentieth of the swing is left, mass that of the
tissue. `calibration` measures a built model once, so that they can be shown and set without it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import exp, hypot, log, pi
from typing import TYPE_CHECKING, cast

import numpy as np

from ..character import Character, Target, TargetSet
from ..engine import dynamorph
from ..errors import FitError
from ..geometry import interpolated
from ..model.model import Model
from ..settings import Material
from .oscillation import Oscillation, damped

if TYPE_CHECKING:
    from dynamorph import FullModel

MODES = 8  # modes among which the visible one is sought
SEARCHED = 24  # the same where many thin parts may swing more slowly
EFFECTIVE = 0.02  # fraction of the mass that a mode of the body must move
IDLE = 0.02  # of the highest frequency; slower modes turn the tissue about a straight bone, which hardly resists that
SOFTEST, STIFFEST = 1.0, 1e9  # Pa, the range in which a stiffness is sought


# Fitting a target --------------------------------------------------------------------------------------------------


def bounce(model: Model, character: Character, target: int, patch: np.ndarray | None = None) -> Oscillation:
    """How the tissue swings at a target after a push: the slowest visible mode in its pose.

    target: index into character.targets; patch (V,): weights of the observed surface vertices, by default the target's
    region. Raises FitError or dynamorph.Error.
    """
    patch = checked_patch(model, character, target, patch)
    engine = full_engine(model, character)
    return damped(natural_frequency(model, engine, target, patch), character.material(target))


def fit_oscillation(
    model: Model,
    character: Character,
    target: int,
    frequency: float,
    decay: float,
    patch: np.ndarray | None = None,
    mass_share: float | None = None,
) -> Material:
    """The material with which the tissue swings at a target as observed: see `oscillation`, and `bounce` for the other
    arguments.

    frequency: Hz, as seen (damped); decay: 1/s. mass_share: the part of the damping that is in proportion to mass, 0 to
    1, by default that of the target. Poisson's ratio and density stay. The damping of other targets is ignored.
    """
    if not (np.isfinite([frequency, decay]).all() and frequency > 0.0 and decay >= 0.0):
        raise FitError(
            "frequency {frequency} Hz, decay {decay} 1/s: give numbers above zero", frequency=frequency, decay=decay
        )
    patch = checked_patch(model, character, target, patch)
    now = character.material(target)
    omega_now = natural_frequency(model, full_engine(model, character), target, patch)
    if mass_share is None:
        total = now.mass_damping + now.stiffness_damping * omega_now**2
        mass_share = now.mass_damping / total if total else 0.0
    omega = hypot(2 * pi * frequency, decay)
    return replace(
        now,
        stiffness=_stiffness_for(model, character, target, omega, omega_now, patch),
        mass_damping=2 * decay * mass_share,
        stiffness_damping=2 * decay * (1 - mass_share) / omega**2,
    )


def _stiffness_for(
    model: Model, character: Character, target: int, omega: float, omega_now: float, patch: np.ndarray
) -> float:
    """Young's modulus with which the tissue at a target swings at omega, rad/s.

    omega^2 ~ E where no other region holds the tissue, so the first step is exact. Elsewhere, secant steps on log
    omega^2 over log E follow.
    """
    wanted, slope = 2 * log(omega), 1.0
    stiffness, reached = log(character.material(target).stiffness), 2 * log(omega_now)
    for _ in range(30):
        if abs(wanted - reached) < 1e-8:
            return exp(stiffness)
        step = float(np.clip((wanted - reached) / slope, -5.0, 5.0))
        if not log(SOFTEST) < stiffness + step < log(STIFFEST):
            break
        stiffer = _with_stiffness(character, target, exp(stiffness + step))
        now = 2 * log(natural_frequency(model, full_engine(model, stiffer), target, patch))
        slope = max((now - reached) / step, 0.05)
        stiffness, reached = stiffness + step, now
    raise FitError(
        "'{name}' cannot swing at {frequency:.3g} Hz: its size, or the tissue around its region, sets the pace",
        name=character.targets[target].name,
        frequency=omega / (2 * pi),
    )


def fit_force_displacement(
    model: Model,
    character: Character,
    target: int,
    forces: np.ndarray,
    displacements: np.ndarray,
    patch: np.ndarray | None = None,
) -> Material:
    """The material for which forces displace the tissue, in a target's pose, as measured: least squares on E.

    forces (k, 3) newtons on the patch as a whole, displacements (k, 3) meters of the patch's mean from its place
    without force; both in bind space, the mesh's own axes before the armature. patch (V,): weights of the surface
    vertices that are pushed. The model's own law and modes are used, so large deflections are right. Poisson's ratio,
    density and damping stay. Raises FitError when no stiffness fits the measurements.
    """
    forces, displacements = _measurements(forces, displacements)
    patch = checked_patch(model, character, target, patch)
    press = _Press(model, character, target, patch)
    linear = _Press(unreduced(model, material_model="LINEAR"), character, target, patch)
    now = character.material(target)
    # Exact if the law is linear and no other target shares the tissue; otherwise a first guess.
    answer = linear(now.stiffness, forces)
    along = (answer * displacements).sum()
    if along <= 0.0:
        raise FitError("the displacements go against the forces: check signs, axes and units (newtons, meters)")
    start = log(now.stiffness * (answer**2).sum() / along)
    stiffness, misses = _least_squares(lambda log_e: press(exp(log_e), forces) - displacements, start)
    if not (misses**2).sum() <= 0.25 * (displacements**2).sum():  # also true for NaN
        raise FitError("no stiffness meets these displacements: check axes and units (newtons, meters), and the patch")
    return replace(now, stiffness=exp(stiffness))


def _measurements(forces: np.ndarray, displacements: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    forces, displacements = np.atleast_2d(np.asarray(forces, float)), np.atleast_2d(np.asarray(displacements, float))
    if forces.ndim != 2 or forces.shape[1] != 3 or forces.shape != displacements.shape:
        raise ValueError(f"forces and displacements: expected (k, 3) each, got {forces.shape}, {displacements.shape}")
    if not (np.isfinite(forces).all() and np.isfinite(displacements).all()):
        raise FitError("some forces or displacements are not numbers: remove those rows")
    if not (forces.any() and displacements.any()):
        raise FitError("all forces or all displacements are zero: measure at least one push that moves the body")
    order = np.argsort(np.linalg.norm(forces, axis=1))  # each solution is the first guess of the next
    return forces[order], displacements[order]


class _Press:
    """Pushes a patch of the skin in a target's pose: (Young's modulus Pa, forces (k, 3) N) -> displacements (k, 3)."""

    def __init__(self, model: Model, character: Character, target: int, patch: np.ndarray):
        self.model, self.character, self.target = model, character, target
        self.carriers = np.zeros(len(model.nodes))  # weights of the nodes in the patch, with sum 1
        np.add.at(self.carriers, model.embedding_nodes, model.embedding_weights * patch[:, None])
        self.weights = _at_target(character, target)
        self.bones = np.tile(np.eye(3, 4), (model.node_weights.shape[1], 1, 1))
        self.guesses: list[np.ndarray] = []  # equilibria found last time

    def __call__(self, stiffness: float, forces: np.ndarray) -> np.ndarray:
        """NaN where no equilibrium is found."""
        engine = self.model.engine(_with_stiffness(self.character, self.target, stiffness))
        simulation = dynamorph.Simulation(engine, 1.0, tolerance=1e-9, max_iterations=100)
        answers: list[np.ndarray] = []
        found: list[np.ndarray] = []
        for k, force in enumerate([np.zeros(3), *forces]):
            guess = self.guesses[k] if self.guesses else found[-1] if found else None
            at_rest, report = simulation.solve_static(self.bones, self.weights, np.outer(self.carriers, force), guess)
            moved = self.carriers @ engine.displacement(at_rest)
            answers.append(moved if report.converged else np.full(3, np.nan))
            found.append(at_rest)
        if np.isfinite(answers).all():
            self.guesses = found
        return np.array(answers[1:]) - answers[0]


def _least_squares(residual: Callable[[float], np.ndarray], x: float) -> tuple[float, np.ndarray]:
    """The x with the least sum of squares, and the residual: Gauss-Newton with a difference quotient. NaN counts as far
    away.
    """
    nudge = 1e-4
    r = residual(x)
    for _ in range(20):
        if not np.isfinite(r).all():  # too soft to carry the forces
            x, r = x + 1.0, residual(x + 1.0)
            continue
        slope = (residual(x + nudge) - r) / nudge
        step = float(np.clip(-(slope * r).sum() / (slope**2).sum(), -1.0, 1.0))
        while abs(step) > 1e-6:
            tried = residual(x + step)
            if np.isfinite(tried).all() and (tried**2).sum() < (r**2).sum():
                break
            step /= 2
        else:
            break
        x, r = x + step, tried
    return x, r


# What both fits share ----------------------------------------------------------------------------------------------


def checked_patch(model: Model, character: Character, target: int, patch: np.ndarray | None) -> np.ndarray:
    """The weights (V,) of the observed surface vertices, with sum 1; by default the target's region.

    The neutral target belongs to all sets, so its region is the whole body. Raises FitError, ValueError.
    """
    if not len(model.tets):
        raise FitError(
            "'{name}': the model simulates nothing, so no material can be fitted: choose another Method and build it",
            name=character.name,
        )
    if not 0 <= target < len(character.targets):
        raise ValueError(f"target: expected 0 to {len(character.targets) - 1}, got {target}")
    if patch is None:
        sets = zip(character.target_sets, target_indices(character.target_sets), strict=True)
        region, neutral = next((s.region_weights, indices[0]) for s, indices in sets if target in indices)
        patch = np.ones(len(character.vertices)) if target == neutral else region
    patch = np.asarray(patch, float)
    if patch.shape != (len(character.vertices),) or not np.isfinite(patch).all() or (patch < 0.0).any():
        raise ValueError(f"patch: expected a weight of 0 or more for each of {len(character.vertices)} vertices")
    if not patch.any():
        raise FitError("the patch is empty: paint the vertices that were measured")
    return patch / patch.sum()


def target_indices(target_sets: Sequence[TargetSet]) -> list[range]:
    """The index of each target set's targets among all targets; the first of each is the neutral one."""
    ends = np.cumsum([len(target_set.targets) for target_set in target_sets]).tolist()
    return [range(begin, end) for begin, end in zip([0, *ends], ends, strict=False)]


def _at_target(character: Character, target: int) -> np.ndarray:
    """Weights (J,) at a target's own pose; the sets without it are neutral."""
    weights = np.zeros(len(character.targets))
    ranges = target_indices(character.target_sets)
    weights[[target if target in indices else indices[0] for indices in ranges]] = 1.0
    return weights


def _with_stiffness(character: Character, target: int, stiffness: float) -> Character:
    """The character with another Young's modulus at one target. The artist sees the neutral targets of all sets
    as one.
    """
    neutrals = [indices[0] for indices in target_indices(character.authored_sets)]
    if character.settings.method == "SHAPE" and target not in neutrals:
        raise FitError("with the Method Shape the material is the neutral target's everywhere: fit that target")
    changed = neutrals if target in neutrals else [target]

    def with_stiffness(index: int, each: Target) -> Target:
        return replace(each, material=replace(each.material, stiffness=stiffness)) if index in changed else each

    return character.with_targets(with_stiffness)


def unreduced(model: Model, material_model: str | None = None) -> Model:
    return replace(
        model,
        settings=replace(model.settings, solver="FULL", material_model=material_model or model.settings.material_model),
    )


def full_engine(model: Model, character: Character) -> FullModel:
    return cast("FullModel", unreduced(model).engine(character))  # as its solver says


def natural_frequency(model: Model, engine: FullModel, target: int, patch: np.ndarray) -> float:
    """Undamped angular frequency, rad/s, of the mode that responds most to a push on the patch. engine: the unreduced
    model.

    A mode phi of unit mass moves by |phi|^2 / omega^2 under a unit force: modes are compared by that, over the patch.
    """
    if model.settings.hold == "THICKNESS":
        return _body_frequency(model, engine, target, patch)
    omega, shapes = engine.linear_modes(target, min(MODES, engine.dofs - 1))
    at_nodes = np.zeros((len(omega), len(model.nodes), 3))
    at_nodes[:, engine.body.free_nodes] = shapes.T.reshape(len(omega), -1, 3)
    on_surface = interpolated(at_nodes, model.embedding_nodes, model.embedding_weights)
    swings = omega > IDLE * omega[-1]
    answer = np.einsum("v,kvc->k", patch, on_surface[swings] ** 2) / omega[swings] ** 2
    return float(omega[swings][answer.argmax()])


def _body_frequency(model: Model, engine: FullModel, target: int, patch: np.ndarray) -> float:
    """`natural_frequency` of a body that is held by thickness: the lowest mode with at least EFFECTIVE of the effective
    mass.

    If the patch (V,) moves as one along an axis, with pattern s on the nodes, a mode phi of unit mass has the effective
    mass (phi^T M s)^2 out of s^T M s. If no mode has enough, the one that has most.
    """
    omega, shapes = engine.linear_modes(target, min(SEARCHED, engine.dofs - 1))
    free = engine.body.free_nodes
    moved = model.at_nodes((patch / patch.max())[:, None])[free, 0].clip(0.0, 1.0)
    mass = engine.body.volumes.sum(axis=1)
    shapes = shapes.reshape(len(free), 3, -1)
    along = np.einsum("n,nck->ck", mass * moved, shapes)
    share = (along**2 / np.einsum("n,nck,nck->k", mass, shapes, shapes)).max(axis=0) / (mass * moved**2).sum()
    body = np.flatnonzero(share >= EFFECTIVE)
    return float(omega[body[0] if len(body) else share.argmax()])
