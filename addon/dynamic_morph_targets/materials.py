# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials from measurements: presets from the literature, and fits of a target's own. Never touches bpy.

A free oscillation of one mode is x(t) = e^(-s t) (a cos w t + b sin w t) + c with

    w0^2 = w^2 + s^2        undamped angular frequency; proportional to E / rho on a given cage
    s = (alpha + beta w0^2) / 2        decay of Rayleigh damping C = alpha M + beta K
    zeta = s / w0 = eta / 2        damping ratio, loss factor

(e.g. Bathe, Finite Element Procedures, ch. 9). Stiffness is calibrated on the model's own cage, because a coarse cage
of linear tetrahedra is too stiff: what is fitted is the Young's modulus that makes *this* cage move as observed.

An artist's units: bounce is w / 2 pi, settle the time until a twentieth of the swing is left, weight the mass of the
flesh. `references` measures a built model once, so that they can be shown and set without it.
"""

from __future__ import annotations

import csv
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import astuple, dataclass, replace
from math import exp, hypot, inf, log, pi, sqrt
from pathlib import Path

import numpy as np

from .scene_data import Character, Material, determinant

REST = 0.05  # of the amplitude: an oscillation has settled when this much is left
POISSON = 0.4  # real flesh is nearly incompressible, 0.5; linear tetrahedra lock above 0.4
TABLE_BEGIN, TABLE_END = "<!-- presets -->", "<!-- end of presets -->"
MODES = 8  # that are looked at, to find the one that shows
SEARCHED = 24  # that are looked at where thin parts, which swing first, may be many
EFFECTIVE = 0.02  # of the mass that a mode must move to be one of the body
IDLE = 0.02  # of the highest of them: slower modes turn the flesh about a straight bone, which hardly holds it
SOFTEST, STIFFEST = 1.0, 1e9  # Pa, between which a stiffness is sought
REFERENCE = 2 * pi * 5.0  # rad/s, at which the presets have the damping that was measured: flesh bounces at about 5 Hz


# Presets -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Preset:
    """A measured material. source: what was measured, how, by whom, and how it was converted."""

    label: str
    material: Material
    source: str


def _preset(label: str, density: float, loss: float, source: str, *, young=None, shear=None) -> Preset:
    """From Young's or the shear modulus (Pa), density (kg/m^3) and loss factor.

    A shear modulus becomes E = 2 mu (1 + nu), so that the engine's mu is the measured one. Tissue loses about the same
    fraction at any frequency; alpha = zeta w, beta = zeta / w is the flattest that Rayleigh damping can be about w.
    """
    stiffness = young or 2 * shear * (1 + POISSON)
    zeta = loss / 2
    material = Material(float(f"{stiffness:.3g}"), POISSON, density, zeta * REFERENCE, zeta / REFERENCE)
    return Preset(label, material, source)


def _springpot_loss(exponent: float) -> float:
    """Loss factor of a springpot, G* ~ (i w)^exponent."""
    return float(np.tan(pi / 2 * exponent))


_DENSITY = "Density: Kaye & Laby, Tables of Physical and Chemical Constants, 2.4.6."
_BREAST_LOSS = (
    "Damping: ratio 0.215 of the breast's free vibration, Chen, Ng, Yu, Zhou & Wan 2013, Ergonomics 56(5), 868-878."
)
_MUSCLE_LOSS = (
    "Damping: springpot exponent {} of the thigh's muscle, MR elastography at 25-62.5 Hz, Klatt et al. 2010, Phys. "
    "Med. Biol. 55, 6445, doi 10.1088/0031-9155/55/21/007."
)
_GUESSED_LOSS = "Damping: assumed, loss factor {}."

PRESETS: dict[str, Preset] = {
    "FAT": _preset(
        "Fat", 923.0, 0.43,
        "Shear modulus 752 Pa of the buttock's fat in vivo, MR elastography at 50 Hz: Hatt, Lloyd, Bolsterlee & "
        f"Bilston 2023, J. Mech. Behav. Biomed. Mater., doi 10.1016/j.jmbbm.2023.105924. {_BREAST_LOSS} {_DENSITY}",
        shear=752.0,
    ),
    "FAT_FIRM": _preset(
        "Fat, Firm", 923.0, 0.43,
        "Shear modulus 3.04 kPa of the thigh's subcutaneous fat in vivo, MR elastography: Chakouch, Charleux & "
        f"Bensamoun 2015, PLoS ONE 10(9), e0138873. {_BREAST_LOSS} {_DENSITY}",
        shear=3.04e3,
    ),
    "BREAST": _preset(
        "Breast", 1020.0, 0.43,
        "Young's modulus 3.04 kPa of fatty and fibroglandular tissue in vivo, suction: Briot, Chagnon, Connesson & "
        "Payan 2022, Clin. Biomech. 99, 105743; fat and gland are alike at small strain, Samani, Zubovits & Plewes "
        f"2007, Phys. Med. Biol. 52, 1565. {_BREAST_LOSS} {_DENSITY}",
        young=3.04e3,
    ),
    "MUSCLE_RELAXED": _preset(
        "Muscle, Relaxed", 1047.0, _springpot_loss(0.253),
        "Shear modulus 3.91 kPa of the rectus femoris at rest, MR elastography: Chakouch, Charleux & Bensamoun 2015, "
        f"PLoS ONE 10(9), e0138873. {_MUSCLE_LOSS.format(0.253)} {_DENSITY}",
        shear=3.91e3,
    ),
    "MUSCLE_FLEXED": _preset(
        "Muscle, Flexed", 1047.0, _springpot_loss(0.270),
        "Shear modulus 123 kPa along the fibres of the tibialis anterior at maximum voluntary contraction, ultrasound "
        "elastography: In vivo tibialis anterior muscle mechanics through force estimation using ankle joint moment "
        f"and shear wave elastography, 2025, 14 volunteers. {_MUSCLE_LOSS.format('0.270')} {_DENSITY}",
        shear=123e3,
    ),
    "TONGUE": _preset(
        "Tongue", 1047.0, _springpot_loss(0.253),
        "Storage shear modulus 2.67 kPa in vivo, MR elastography: Cheng, Gandevia, Green, Sinkus & Bilston 2011, J. "
        "Biomech. 44(3), 450-454, doi 10.1016/j.jbiomech.2010.09.027. "
        f"{_MUSCLE_LOSS.format(0.253)} {_DENSITY}",
        shear=2.67e3,
    ),
    "CHEEK": _preset(
        "Cheek", 1047.0, _springpot_loss(0.253),
        "Young's modulus 31 to 42 kPa of cheek, cheekbone, forehead and lip with their skin in vivo, suction, the "
        f"middle taken: Luboz, Promayon & Payan 2014, HAL hal-01092748. {_MUSCLE_LOSS.format(0.253)} {_DENSITY}",
        young=36e3,
    ),
    "SKIN": _preset(
        "Skin", 1150.0, 0.14,
        "Young's modulus 56.3 kPa of the breast's skin in vivo, suction: Briot, Chagnon, Connesson & Payan 2022, Clin. "
        "Biomech. 99, 105743. Damping: loss factor 0.14 of pig skin at 1 Hz, Kirkpatrick, Duncan & Fang 2004, J. "
        f"Biomed. Opt. 9(6), doi 10.1117/1.1803843. {_DENSITY}",
        young=56.3e3,
    ),
    "GELATIN": _preset(
        "Gelatin", 1000.0, 0.06,
        "Young's modulus 4.34 kPa of gelatin in 20 parts of water, compression: Bonavia et al. 2025, arXiv:2512.20502. "
        "Damping: loss factor 0.06 of a soft gel at 20 Hz, Okamoto, Clayton & Bayly 2011, Phys. Med. Biol. 56, 6379. "
        "Density: assumed, as water.",
        young=4.34e3,
    ),
    "SILICONE_SOFT": _preset(
        "Silicone, Soft", 1070.0, 0.1,
        "100 % modulus 69 kPa (10 psi) and specific gravity 1.07 of Ecoflex 00-30: manufacturer's bulletin, Smooth-On. "
        f"Neo-Hookean: mu = 69 kPa / (2 - 1/4). {_GUESSED_LOSS.format(0.1)}",
        shear=69e3 / 1.75,
    ),
    "SILICONE_FIRM": _preset(
        "Silicone, Firm", 1030.0, 0.1,
        "Young's modulus 1.32 MPa of Sylgard 184 cured at 25 C, tension: Johnston, McCluskey, Tan & Tracey 2014, J. "
        "Micromech. Microeng. 24, 035017. Density: manufacturer's data sheet, Dow. "
        f"{_GUESSED_LOSS.format(0.1)}",
        young=1.32e6,
    ),
    "RUBBER": _preset(
        "Rubber", 950.0, 0.05,
        "Shear modulus 0.5 MPa and density of vulcanised natural rubber: MatWeb, Natural Rubber, Vulcanized. "
        f"{_GUESSED_LOSS.format(0.05)}",
        shear=0.5e6,
    ),
}  # fmt: skip


def table() -> str:
    """The presets as a Markdown table, for docs/materials.md."""
    head = "| Material | E, kPa | Poisson | Density, kg/m³ | Mass damping, 1/s | Stiffness damping, ms | Source |"
    rows = [head, "|---|--:|--:|--:|--:|--:|---|"]
    for preset in PRESETS.values():
        e, nu, rho, alpha, beta = astuple(preset.material)
        values = f"{e / 1e3:g} | {nu:.2g} | {rho:.0f} | {alpha:.2g} | {1e3 * beta:.2g}"
        rows.append(f"| {preset.label} | {values} | {preset.source} |")
    return "\n".join(rows) + "\n"


def write_table(path: Path):
    """Put `table` between the marks of a Markdown file."""
    before, begin, rest = path.read_text(encoding="utf-8").partition(TABLE_BEGIN)
    _, end, after = rest.partition(TABLE_END)
    if not end:
        raise ValueError(f"'{path}': the marks {TABLE_BEGIN} and {TABLE_END} are missing")
    path.write_text(f"{before}{begin}\n{table()}{end}{after}", encoding="utf-8")


# Reading an oscillation off a tracked point ------------------------------------------------------------------------


@dataclass(frozen=True)
class Oscillation:
    """A damped oscillation: frequency (Hz; 0 if it creeps back without swinging) and decay s (1/s) of e^(-s t).

    The errors are one standard deviation of the fit.
    """

    frequency: float
    decay: float
    frequency_error: float = 0.0
    decay_error: float = 0.0

    @property
    def settle(self) -> float:
        """Seconds until 5 % of the amplitude is left."""
        return log(1 / REST) / self.decay if self.decay else inf


def decay_of(settle: float) -> float:
    """The decay (1/s) of an oscillation that settles within so many seconds."""
    if not settle > 0.0:
        raise ValueError(f"the motion settles in {settle} s: give a time above zero")
    return log(1 / REST) / settle


def oscillation(times: np.ndarray, positions: np.ndarray) -> Oscillation:
    """Frequency and decay of a point that swings freely about its rest.

    times (n,) s, increasing, need not be even; positions (n,), (n, 2) or (n, 3), any unit: only the direction in
    which the point moves most is used. Begin where the body is let go, and leave out the first moments if fast ripples
    show. Least squares by variable projection (Golub & Pereyra 1973), from the highest peak of the spectrum. Raises
    ValueError when there is no oscillation of at least two periods to see.
    """
    times, along = _track(times, positions)
    best = min((_refine(times, along, *start) for start in _starts(times, along)), key=lambda fit: fit[2])
    decay, omega, squares = best
    if squares > 0.5 * np.square(along).sum():
        raise ValueError("no oscillation found: noise or another motion hides it; track a point that swings more")
    if omega * times[-1] < 4 * pi:
        raise ValueError("fewer than two periods: record longer, or push less damped flesh; the motion hardly swings")
    if decay > 0.5 * hypot(decay, omega):
        raise ValueError("too damped: the point hardly swings back; measure force and displacement instead")
    jacobian = _jacobian(times, along, decay, omega)
    variance = squares / (len(times) - 5) * np.linalg.inv(jacobian.T @ jacobian).diagonal()
    decay_error, omega_error = np.sqrt(variance[:2])
    if decay < -3 * decay_error:
        raise ValueError("the motion grows: cut the record where the body is let go")
    return Oscillation(omega / (2 * pi), max(decay, 0.0), omega_error / (2 * pi), decay_error)


def _track(times, positions) -> tuple[np.ndarray, np.ndarray]:
    """Times from zero (n,), and the motion along its principal direction (n,), centred."""
    times, positions = np.asarray(times, float), np.asarray(positions, float)
    if times.ndim != 1 or len(times) < 10 or positions.ndim > 2 or len(positions) != len(times):
        raise ValueError(
            f"expected at least 10 times (n,) and positions (n,) or (n, 3), got {times.shape} and {positions.shape}"
        )
    if not (np.isfinite(times).all() and np.isfinite(positions).all()):
        raise ValueError("some times or positions are not numbers: remove those samples")
    if not (np.diff(times) > 0).all():
        raise ValueError("times must increase from sample to sample: sort them and remove repeated ones")
    if not np.ptp(positions, axis=0).any():
        raise ValueError("the point does not move: track one that swings")
    positions = positions.reshape(len(times), -1)
    centred = positions - positions.mean(axis=0)
    _, size, directions = np.linalg.svd(centred, full_matrices=False)
    return times - times[0], centred @ directions[0] / size[0]


def _starts(times: np.ndarray, along: np.ndarray) -> list[tuple[float, float]]:
    """First guesses (decay, angular frequency): the peak of the spectrum, weakly to strongly damped."""
    n = len(times)
    even = np.interp(np.linspace(0.0, times[-1], n), times, along)
    spectrum = np.abs(np.fft.rfft(even, 4 * n))
    omega = 2 * pi * max(int(spectrum.argmax()), 1) * (n - 1) / (4 * n * times[-1])
    return [(ratio * omega, omega) for ratio in (0.01, 0.1, 0.4)]


def _refine(times: np.ndarray, along: np.ndarray, decay: float, omega: float) -> tuple[float, float, float]:
    """Gauss-Newton on decay and frequency, with the amplitudes always at their best: (decay, omega, squares)."""
    guess = np.array([decay, omega])
    squares = np.square(_residual(times, along, *guess)).sum()
    for _ in range(50):
        residual = _residual(times, along, *guess)
        step = np.linalg.lstsq(_jacobian(times, along, *guess), residual, rcond=None)[0][:2]
        step *= min(1.0, 0.3 * guess[1] / max(np.abs(step).max(), 1e-300))  # else it may leave the peak
        while np.abs(step).max() > 1e-10 * abs(guess[1]):
            tried = np.square(_residual(times, along, *(guess + step))).sum()
            if tried < squares:
                break
            step /= 2
        else:
            break
        guess, squares = guess + step, tried
    return guess[0], guess[1], squares


def _columns(times: np.ndarray, decay: float, omega: float) -> np.ndarray:
    """e^(-s t) cos w t, e^(-s t) sin w t, 1 at all times (n, 3)."""
    fall = np.exp(-decay * times)
    return np.column_stack([fall * np.cos(omega * times), fall * np.sin(omega * times), np.ones_like(times)])


def _residual(times: np.ndarray, along: np.ndarray, decay: float, omega: float) -> np.ndarray:
    columns = _columns(times, decay, omega)
    return along - columns @ np.linalg.lstsq(columns, along, rcond=None)[0]


def _jacobian(times: np.ndarray, along: np.ndarray, decay: float, omega: float) -> np.ndarray:
    """Derivatives (n, 5) of the best motion by decay, angular frequency and the three amplitudes."""
    columns = _columns(times, decay, omega)
    a, b, _ = np.linalg.lstsq(columns, along, rcond=None)[0]
    cosine, sine, _ = columns.T
    return np.column_stack([-times * (a * cosine + b * sine), times * (b * cosine - a * sine), columns])


def read_columns(path: Path, counts: tuple[int, ...]) -> np.ndarray:
    """Numbers (n, c) of a CSV file, c one of `counts`; a first line of names is skipped. Raises ValueError, OSError."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = [row for row in csv.reader(file) if row]
    if rows and not re.match(r"\s*[-+.\d]", rows[0][0]):
        del rows[0]
    try:
        table = np.array(rows, float)
    except ValueError:
        table = np.empty(0)
    if table.ndim != 2 or table.shape[1] not in counts:
        wanted = " or ".join(map(str, counts))
        raise ValueError(f"'{path.name}': expected {wanted} numbers with commas between them in every line")
    return table


# Fitting a target --------------------------------------------------------------------------------------------------


def bounce(model, character: Character, target: int, patch: np.ndarray | None = None) -> Oscillation:
    """How the flesh swings at a target after a push: the slowest visible mode at its pose.

    model: build.Model; target: index into character.targets; patch (V,): weights of the surface vertices that are
    looked at, default the target's region. Raises ValueError or dynamorph.Error.
    """
    character, patch = _checked(model, character, target, patch)
    engine = _unreduced(model).engine(character)
    return _damped(_natural_frequency(model, engine, target, patch), character.targets[target].material)


def _damped(omega: float, material: Material) -> Oscillation:
    """Of a mode that would swing at omega, rad/s, without damping."""
    decay = (material.mass_damping + material.stiffness_damping * omega**2) / 2
    if decay >= omega:  # creeps back; the slower of the two exponentials is the one that shows
        return Oscillation(0.0, omega**2 / (decay + sqrt(decay**2 - omega**2)))
    return Oscillation(sqrt(omega**2 - decay**2) / (2 * pi), decay)


def fit_oscillation(
    model,
    character: Character,
    target: int,
    frequency: float,
    decay: float,
    patch: np.ndarray | None = None,
    mass_share: float | None = None,
) -> Material:
    """The material with which the flesh swings at a target as observed: see `oscillation`, and `bounce` for the rest.

    frequency: Hz, as seen (damped); decay: 1/s. mass_share: the part of the damping that is in proportion to mass, 0
    to 1, default what the target has now. Poisson's ratio and density stay. Other targets' damping is not counted.
    """
    if not (np.isfinite([frequency, decay]).all() and frequency > 0.0 and decay >= 0.0):
        raise ValueError(f"frequency {frequency} Hz, decay {decay} 1/s: give numbers above zero")
    character, patch = _checked(model, character, target, patch)
    now = character.targets[target].material
    omega_now = _natural_frequency(model, _unreduced(model).engine(character), target, patch)
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


def _stiffness_for(model, character: Character, target: int, omega: float, omega_now: float, patch) -> float:
    """Young's modulus with which the flesh at a target swings at omega, rad/s.

    omega^2 ~ E where the target has the flesh to itself, so the first step lands; where other regions hold it too,
    secant steps on log omega^2 over log E follow.
    """
    wanted, slope = 2 * log(omega), 1.0
    stiffness, reached = log(character.targets[target].material.stiffness), 2 * log(omega_now)
    for _ in range(30):
        if abs(wanted - reached) < 1e-8:
            return exp(stiffness)
        step = float(np.clip((wanted - reached) / slope, -5.0, 5.0))
        if not log(SOFTEST) < stiffness + step < log(STIFFEST):
            break
        stiffer = _with_stiffness(character, target, exp(stiffness + step))
        now = 2 * log(_natural_frequency(model, _unreduced(model).engine(stiffer), target, patch))
        slope = max((now - reached) / step, 0.05)
        stiffness, reached = stiffness + step, now
    raise ValueError(
        f"'{character.targets[target].name}' cannot swing at {omega / (2 * pi):.3g} Hz: its size, or the flesh around "
        "its region, sets the pace"
    )


def fit_force_displacement(
    model,
    character: Character,
    target: int,
    forces: np.ndarray,
    displacements: np.ndarray,
    patch: np.ndarray | None = None,
) -> Material:
    """The material with which forces push the flesh, at a target's pose, as far as was measured: least squares on E.

    forces (k, 3) newtons on the patch as a whole, displacements (k, 3) metres of the patch's mean from where it is
    without force; both in bind space, the mesh's own axes before the armature. patch (V,): weights of the surface
    vertices that are pushed. The model's own law and modes answer, so large deflections are right. Poisson's ratio,
    density and damping stay. Raises ValueError when the measurements cannot be met.
    """
    forces, displacements = _measurements(forces, displacements)
    character, patch = _checked(model, character, target, patch)
    press = _Press(model, character, target, patch)
    linear = _Press(_unreduced(model, law="LINEAR"), character, target, patch)
    now = character.targets[target].material
    # Exact if the law is linear and the target has all the flesh; else a start.
    answer = linear(now.stiffness, forces)
    along = (answer * displacements).sum()
    if along <= 0.0:
        raise ValueError("the displacements go against the forces: check signs, axes and units (newtons, metres)")
    start = log(now.stiffness * (answer**2).sum() / along)
    stiffness, misses = _least_squares(lambda log_e: press(exp(log_e), forces) - displacements, start)
    if not (misses**2).sum() <= 0.25 * (displacements**2).sum():  # nor if they are not numbers
        raise ValueError(
            "no stiffness meets these displacements: check axes and units (newtons, metres), and the patch"
        )
    return replace(now, stiffness=exp(stiffness))


def _measurements(forces, displacements) -> tuple[np.ndarray, np.ndarray]:
    forces, displacements = np.atleast_2d(np.asarray(forces, float)), np.atleast_2d(np.asarray(displacements, float))
    if forces.ndim != 2 or forces.shape[1] != 3 or forces.shape != displacements.shape:
        raise ValueError(f"forces and displacements: expected (k, 3) each, got {forces.shape}, {displacements.shape}")
    if not (np.isfinite(forces).all() and np.isfinite(displacements).all()):
        raise ValueError("some forces or displacements are not numbers: remove those rows")
    if not (forces.any() and displacements.any()):
        raise ValueError("all forces or all displacements are zero: measure at least one push that moves the flesh")
    order = np.argsort(np.linalg.norm(forces, axis=1))  # each answer helps to find the next
    return forces[order], displacements[order]


class _Press:
    """Pushes a patch of the flesh at a target's pose: (Young's modulus Pa, forces (k, 3) N) -> displacements (k, 3)."""

    def __init__(self, model, character: Character, target: int, patch: np.ndarray):
        self.model, self.character, self.target = model, character, target
        self.carriers = np.zeros(len(model.nodes))  # how much of the patch each node carries, sum 1
        np.add.at(self.carriers, model.embedding_nodes, model.embedding_weights * patch[:, None])
        self.weights = _at_target(character, target)
        self.bones = np.tile(np.eye(3, 4), (model.node_weights.shape[1], 1, 1))
        self.guesses: list[np.ndarray] = []  # where the flesh came to rest the last time

    def __call__(self, stiffness: float, forces: np.ndarray) -> np.ndarray:
        """NaN where the flesh finds no rest."""
        engine = self.model.engine(_with_stiffness(self.character, self.target, stiffness))
        simulation = self.model.stepper(engine, 1.0, tolerance=1e-9, max_iterations=100)
        answers, found = [], []
        for k, force in enumerate([np.zeros(3), *forces]):
            guess = self.guesses[k] if self.guesses else found[-1] if found else None
            at_rest, report = simulation.solve_static(self.bones, self.weights, np.outer(self.carriers, force), guess)
            moved = self.carriers @ engine.displacement(at_rest)
            answers.append(moved if report["converged"] else np.full(3, np.nan))
            found.append(at_rest)
        if np.isfinite(answers).all():
            self.guesses = found
        return np.array(answers[1:]) - answers[0]


def _least_squares(residual: Callable[[float], np.ndarray], x: float) -> tuple[float, np.ndarray]:
    """The x of the least sum of squares, and what is left: Gauss-Newton with a difference quotient. NaN is far off."""
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


# What the artist sees of a material --------------------------------------------------------------------------------


def references(model, character: Character) -> Iterator[tuple[float, float]]:
    """For each target: its undamped bounce in Hz per square root of stiffness over density, and its flesh in m^3.

    At another stiffness or density it follows as `swing` says, exactly where the target has the flesh to itself.
    Zeros for a target without flesh of its own, or whose modes cannot be found.
    """
    character = character.by_method()
    if not len(model.tets):
        yield from [(0.0, 0.0)] * len(character.targets)
        return
    engine = _unreduced(model).engine(character)
    corners = model.nodes[model.tets]
    volumes = model.fill * determinant(corners[:, 1:] - corners[:, :1]) / 6.0
    neutral_only = character.settings.method == "SHAPE"
    for s, indices in enumerate(_indices(character)):
        for target in indices:
            neutral = target == indices[0]
            if neutral_only and not neutral:
                yield 0.0, 0.0
                continue
            try:
                omega = _natural_frequency(model, engine, target, _checked(model, character, target, None)[1])
            except RuntimeError:  # the engine's, about a sculpt that no mode can be found of
                omega = 0.0
            material = character.targets[target].material
            share = 1.0 if neutral else model.shares[:, s]
            yield omega / (2 * pi) / sqrt(material.stiffness / material.density), float((volumes * share).sum())


def calibrated(character: Character, found: list[tuple[float, float]]) -> Character:
    """The character with the stiffness that its targets' frequencies ask for; found: its `references`.

    Targets that the artist has not set by hand follow the neutral one, as much stiffer than it as they were.
    """
    neutral = character.targets[0]
    before, after = neutral.material.stiffness, _stiffness_of(neutral, found[0][0])
    neutrals = {indices[0] for indices in _indices(character)}

    def material(index: int, target) -> Material:
        stiffness = target.material.stiffness
        if index in neutrals:
            stiffness = after
        elif target.by_hand and len(found) == len(character.targets):
            stiffness = _stiffness_of(target, found[index][0])
        elif target.frequency:
            stiffness *= after / before
        return replace(target.material, stiffness=as_stored(stiffness))

    return character.with_materials(material)


def as_stored(value: float) -> float:
    """A number as Blender keeps it, in single precision: what is simulated is what a file says."""
    return float(np.float32(value))


def stored(target) -> dict[str, float]:
    """What a build or a rehearsal may change of a target, by the names of its properties."""
    material = target.material
    return {
        "stiffness": material.stiffness,
        "mass_damping": material.mass_damping,
        "stiffness_damping": material.stiffness_damping,
        "frequency": target.frequency,
    }


def _stiffness_of(target, reference: float) -> float:
    if not (target.frequency and reference):
        return target.material.stiffness
    return stiffness_for(reference, target.material, target.frequency)


def stiffened(character: Character, factor: float) -> Character:
    """The character with its frequency `factor` times as high at all targets that are not set by hand; the damping
    ratio stays."""

    def material(_index: int, target) -> Material:
        old = target.material
        if target.by_hand or not target.frequency:
            return old
        return replace(
            old,
            stiffness=as_stored(old.stiffness * factor**2),
            mass_damping=as_stored(old.mass_damping * factor),
            stiffness_damping=as_stored(old.stiffness_damping / factor),
        )

    sets = tuple(
        replace(
            target_set,
            targets=tuple(
                target if target.by_hand else replace(target, frequency=as_stored(target.frequency * factor))
                for target in target_set.targets
            ),
        )
        for target_set in character.with_materials(material).target_sets
    )
    return replace(character, target_sets=sets)


def swing(reference: float, material: Material) -> Oscillation:
    """How flesh with a reference of `references` swings when it is of this material."""
    return _damped(_omega(reference, material), material)


def stiffness_for(reference: float, material: Material, frequency: float) -> float:
    """Young's modulus with which such flesh swings `frequency` times a second, or as often as its damping lets it.

    With x = w0^2: x - (alpha + beta x)^2 / 4 = (2 pi frequency)^2, of whose two roots the upper is nearly overdamped.
    """
    alpha, beta = material.mass_damping, material.stiffness_damping
    if alpha * beta >= 1.0:  # overdamped whatever the stiffness
        return material.stiffness
    half = 1.0 - alpha * beta / 2
    wanted = (2 * pi * frequency) ** 2 + alpha**2 / 4
    if beta:
        wanted = min(wanted, (half / beta) ** 2)
    x = 2 * wanted / (half + sqrt(max(half**2 - beta**2 * wanted, 0.0)))
    return material.density * x / (2 * pi * reference) ** 2


def with_bounce(reference: float, material: Material, frequency: float) -> Material:
    """The material with which such flesh swings `frequency` times a second, and settles as soon as now.

    The dampings keep their proportion.
    """
    now = swing(reference, material)
    undamped = (2 * pi * frequency) ** 2 + now.decay**2
    stiffer = replace(material, stiffness=material.density * undamped / (2 * pi * reference) ** 2)
    alpha, beta = damping_for(reference, stiffer, now.settle)
    return replace(stiffer, mass_damping=alpha, stiffness_damping=beta)


def damping_for(reference: float, material: Material, settle: float) -> tuple[float, float]:
    """Mass and stiffness damping, in their present proportion, with which such flesh settles within so many seconds.

    Critical damping settles soonest: more only makes it creep.
    """
    omega = _omega(reference, material)
    wanted = min(decay_of(settle), omega)
    now = (material.mass_damping + material.stiffness_damping * omega**2) / 2
    if not now:
        return wanted, wanted / omega**2  # the flattest about this frequency
    return material.mass_damping * wanted / now, material.stiffness_damping * wanted / now


def _omega(reference: float, material: Material) -> float:
    return 2 * pi * reference * sqrt(material.stiffness / material.density)


# What both fits share ----------------------------------------------------------------------------------------------


def _checked(model, character: Character, target: int, patch) -> tuple[Character, np.ndarray]:
    """The character that is simulated, and the weights (V,) of its surface vertices, by default the target's region.

    The neutral target is all sets', so its region is all of the flesh.
    """
    character = character.by_method()
    if not len(model.tets):
        raise ValueError(f"'{character.name}': the model has no flesh to fit: choose another Method and build it")
    if not 0 <= target < len(character.targets):
        raise ValueError(f"target: expected 0 to {len(character.targets) - 1}, got {target}")
    if patch is None:
        sets = zip(character.target_sets, _indices(character), strict=True)
        share, neutral = next((s.share, indices[0]) for s, indices in sets if target in indices)
        patch = np.ones(len(character.vertices)) if target == neutral else share
    patch = np.asarray(patch, float)
    if patch.shape != (len(character.vertices),) or not np.isfinite(patch).all() or (patch < 0.0).any():
        raise ValueError(f"patch: expected a weight of 0 or more for each of {len(character.vertices)} vertices")
    if not patch.any():
        raise ValueError("the patch is empty: paint the vertices that were measured")
    return character, patch / patch.sum()


def _indices(character: Character) -> list[range]:
    """Where each target set's targets are among all; the first of each is neutral."""
    ends = np.cumsum([len(target_set.targets) for target_set in character.target_sets]).tolist()
    return [range(begin, end) for begin, end in zip([0, *ends], ends, strict=False)]


def _at_target(character: Character, target: int) -> np.ndarray:
    """Weights (J,) at a target's own pose; the sets without it are neutral."""
    weights = np.zeros(len(character.targets))
    weights[[target if target in indices else indices[0] for indices in _indices(character)]] = 1.0
    return weights


def _with_stiffness(character: Character, target: int, stiffness: float) -> Character:
    """The character with another Young's modulus at one target. All sets' neutrals are one to the artist."""
    ranges = _indices(character)
    neutrals = [indices[0] for indices in ranges]
    if character.settings.method == "SHAPE" and target not in neutrals:
        raise ValueError("with the method Shape the flesh is the neutral target's everywhere: fit that one")
    targets = list(character.targets)
    for index in neutrals if target in neutrals else [target]:
        targets[index] = replace(targets[index], material=replace(targets[index].material, stiffness=stiffness))
    sets = tuple(
        replace(target_set, targets=tuple(targets[indices.start : indices.stop]))
        for target_set, indices in zip(character.target_sets, ranges, strict=True)
    )
    return replace(character, target_sets=sets)


def _unreduced(model, **settings):
    return replace(model, settings=replace(model.settings, solver="FULL", **settings))


def _natural_frequency(model, engine, target: int, patch: np.ndarray) -> float:
    """Undamped angular frequency, rad/s, of the mode that answers most to a push on the patch.

    engine: of the unreduced model. A mode phi of unit mass moves by |phi|^2 / omega^2 for a unit force: modes are
    compared by that, over the patch.
    """
    if model.settings.hold == "THICKNESS":
        return _body_frequency(model, engine, target, patch)
    omega, shapes = engine.linear_modes(target, min(MODES, engine.dofs - 1))
    at_nodes = np.zeros((len(model.nodes), 3, len(omega)))
    at_nodes[engine.body.free_nodes] = shapes.reshape(-1, 3, len(omega))
    on_surface = np.einsum("va,vack->vck", model.embedding_weights, at_nodes[model.embedding_nodes])
    swings = omega > IDLE * omega[-1]
    answer = np.einsum("v,vck->k", patch, on_surface[:, :, swings] ** 2) / omega[swings] ** 2
    return float(omega[swings][answer.argmax()])


def _body_frequency(model, engine, target: int, patch: np.ndarray) -> float:
    """The same of a body that is held by thickness: the lowest mode with at least EFFECTIVE of the effective mass.

    With the patch (V,) moving as one along an axis, s its pattern on the nodes, a mode phi of unit mass has the
    effective mass (phi^T M s)^2 of s^T M s. Where no mode has as much, the one that has most.
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


if __name__ == "__main__":
    write_table(Path(sys.argv[1]))
