# SPDX-License-Identifier: GPL-3.0-or-later
"""Frequency and decay of a damped oscillation, from a track. NumPy only."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass, replace
from math import hypot, inf, log, pi, sqrt
from pathlib import Path

import numpy as np

from ..errors import FitError
from ..settings import Material

LARGEST = 1e60  # seconds or meters; squares of larger ones may be too large for a float
REST = 0.05  # fraction of the amplitude at which an oscillation has settled


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
    """The decay (1/s) of an oscillation with this settle time in seconds."""
    if not settle > 0.0:
        raise FitError("the motion settles in {settle} s: give a time above zero", settle=settle)
    return log(1 / REST) / settle


def oscillation(times: np.ndarray, positions: np.ndarray) -> Oscillation:
    """Frequency and decay of a point that swings freely about its rest position.

    times (n,) s, increasing, need not be evenly spaced; positions (n,), (n, 2) or (n, 3), any unit: only the direction
    in which the point moves most is used. Begin at the release, and leave out the first moments if fast ripples show.
    Least squares by variable projection (Golub & Pereyra 1973), from the highest peak of the spectrum. Raises
    FitError when there is no visible oscillation of at least two periods.
    """
    times, along = _track(times, positions)
    best = min((_refine(times, along, *start) for start in _starts(times, along)), key=lambda fit: fit[2])
    decay, omega, squares = best
    if squares > 0.5 * np.square(along).sum():
        raise FitError("no oscillation found: noise or another motion hides it; track a point that swings more")
    if omega * times[-1] < 4 * pi:
        raise FitError(
            "fewer than two periods: record longer, or lower the damping of the real body; the motion hardly swings"
        )
    if decay > 0.5 * hypot(decay, omega):
        raise FitError("too damped: the point hardly swings back; measure force and displacement instead")
    jacobian = _jacobian(times, along, decay, omega)
    variance = squares / (len(times) - 5) * np.linalg.inv(jacobian.T @ jacobian).diagonal()
    decay_error, omega_error = np.sqrt(variance[:2])
    if decay < -3 * decay_error:
        raise FitError("the motion grows: cut the record where the body is let go")
    return Oscillation(omega / (2 * pi), max(decay, 0.0), omega_error / (2 * pi), decay_error)


def _track(times: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times from zero (n,), and the motion along its principal direction (n,), centered."""
    times, positions = np.asarray(times, float), np.asarray(positions, float)
    if times.ndim != 1 or len(times) < 10 or positions.ndim > 2 or len(positions) != len(times):
        raise FitError(
            "expected at least 10 times (n,) and positions (n,) or (n, 3), got {times} and {positions}",
            times=times.shape,
            positions=positions.shape,
        )
    if not ((np.abs(times) < LARGEST).all() and (np.abs(positions) < LARGEST).all()):  # as no NaN is
        raise FitError("some times or positions are not numbers: remove those samples")
    if not (np.diff(times) > 0).all():
        raise FitError("times must increase from sample to sample: sort them and remove repeated ones")
    if not np.ptp(positions, axis=0).any():
        raise FitError("the point does not move: track one that swings")
    positions = positions.reshape(len(times), -1)
    centered = positions - positions.mean(axis=0)
    _, size, directions = np.linalg.svd(centered, full_matrices=False)
    return times - times[0], centered @ directions[0] / size[0]


def _starts(times: np.ndarray, along: np.ndarray) -> list[tuple[float, float]]:
    """First guesses (decay, angular frequency): the peak of the spectrum, weakly to strongly damped."""
    n = len(times)
    even = np.interp(np.linspace(0.0, times[-1], n), times, along)
    spectrum = np.abs(np.fft.rfft(even, 4 * n))
    omega = 2 * pi * max(int(spectrum.argmax()), 1) * (n - 1) / (4 * n * times[-1])
    return [(ratio * omega, omega) for ratio in (0.01, 0.1, 0.4)]


def _refine(times: np.ndarray, along: np.ndarray, decay: float, omega: float) -> tuple[float, float, float]:
    """Gauss-Newton on decay and frequency, with optimal amplitudes at each step: (decay, omega, squares)."""
    guess = np.array([decay, omega])
    squares = np.square(_residual(times, along, *guess)).sum()
    for _ in range(50):
        residual = _residual(times, along, *guess)
        step = np.linalg.lstsq(_jacobian(times, along, *guess), residual, rcond=None)[0][:2]
        step *= min(1.0, 0.3 * guess[1] / max(np.abs(step).max(), 1e-300))  # otherwise it may leave the peak
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
    """Numbers (n, c) of a CSV file, c one of `counts`; a first line of names is skipped. Raises FitError, OSError."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = [row for row in csv.reader(file) if row]
        if rows and not re.match(r"\s*[-+.\d]", rows[0][0]):
            del rows[0]
        table = np.array(rows, float)
    except (ValueError, csv.Error):
        table = np.empty(0)
    if table.ndim != 2 or table.shape[1] not in counts:
        wanted = " or ".join(map(str, counts))
        raise FitError(
            "'{name}': expected {wanted} numbers with commas between them in every line", name=path.name, wanted=wanted
        )
    return table


def damped(omega: float, material: Material) -> Oscillation:
    """The oscillation of a mode that would swing at omega, rad/s, without damping."""
    decay = (material.mass_damping + material.stiffness_damping * omega**2) / 2
    if decay >= omega:  # it creeps back, and the slower of the two exponentials is visible
        return Oscillation(0.0, omega**2 / (decay + sqrt(decay**2 - omega**2)))
    return Oscillation(sqrt(omega**2 - decay**2) / (2 * pi), decay)


def undamped(frequency: float, material: Material) -> float:
    """The undamped frequency, Hz, at which tissue with this material's dampings swings at `frequency` Hz, or as fast as
    they permit.

    With x = w0^2: x - (alpha + beta x)^2 / 4 = (2 pi frequency)^2. The upper one of its two roots is nearly overdamped.
    """
    alpha, beta = material.mass_damping, material.stiffness_damping
    if alpha * beta >= 1.0:  # overdamped whatever the stiffness
        return frequency
    half = 1.0 - alpha * beta / 2
    wanted = (2 * pi * frequency) ** 2 + alpha**2 / 4
    if beta:
        wanted = min(wanted, (half / beta) ** 2)
    return sqrt(2 * wanted / (half + sqrt(max(half**2 - beta**2 * wanted, 0.0)))) / (2 * pi)


def damping_for(omega: float, material: Material, settle: float) -> tuple[float, float]:
    """Mass and stiffness damping, in their present proportion, with which tissue that would swing at omega, rad/s,
    without damping has this settle time in seconds.

    Critical damping settles soonest: more damping only makes it creep.
    """
    wanted = min(decay_of(settle), omega)
    now = (material.mass_damping + material.stiffness_damping * omega**2) / 2
    if not now:
        return wanted, wanted / omega**2  # the flattest damping around this frequency
    return material.mass_damping * wanted / now, material.stiffness_damping * wanted / now


def with_bounce(omega: float, material: Material, bounce: float) -> tuple[float, Material]:
    """What swings at `bounce` Hz and settles as before: its undamped frequency in Hz, and the material with other
    dampings in the same proportion. omega: the undamped frequency now, rad/s.
    """
    return with_swing(material, bounce, damped(omega, material).settle)


def with_swing(material: Material, bounce: float, settle: float) -> tuple[float, Material]:
    """As `with_bounce`, for this settle time in seconds: w0^2 = w^2 + s^2 with the decay s."""
    omega = hypot(2 * pi * bounce, decay_of(settle))
    alpha, beta = damping_for(omega, material, settle)
    return omega / (2 * pi), replace(material, mass_damping=alpha, stiffness_damping=beta)
