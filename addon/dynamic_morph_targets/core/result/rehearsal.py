# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the frequency that keeps a shot within its limits: the lowest one, so that the tissue stays as lively as
possible.

The motion of tissue decreases with its frequency, but how fast depends on the excitation, so frequencies are tried:
upward from the requested one until the shot is within its limits, and then back if that was much farther than needed.
No bpy.
"""

from __future__ import annotations

import math

from . import judge

TRIES = 6  # at most
STIFFER = (
    0.75  # power of the excess by which the frequency is raised; displacements decrease with its square or more slowly
)
FACTOR = 1.06, 4.0  # smallest and largest factor by which it is raised
LIVELY = 0.75  # of the limits; motion that uses less of them is tried with a lower frequency
AIM = 0.87  # of the limits: then
INSIDE = 0.25  # of the way between two tried frequencies; the next is at least that far from both
CLOSE = 1.05  # ratio of two frequencies between which no other is tried


class Rehearsal:
    """The frequencies that were tried for one shot, Hz, and the factor by which the motion was too large with each."""

    def __init__(self, asked: float):
        self.asked = asked
        self.tried: dict[float, float] = {}

    def learn(self, frequency: float, excess: float) -> None:
        """excess: `judge.Verdict.excess`."""
        self.tried[frequency] = excess

    @property
    def best(self) -> float:
        """The lowest frequency that keeps the limits; while none does, the highest one tried."""
        return min(self._within, default=max(self.tried))

    def next(self) -> float | None:
        """The frequency to try next, or None to keep `best`."""
        beyond = [frequency for frequency in self.tried if frequency not in self._within]
        if not beyond or len(self.tried) >= TRIES or not all(map(math.isfinite, self.tried.values())):
            return None
        low = max(beyond)
        if not self._within:
            smallest, largest = FACTOR
            return low * min(max((self.tried[low] / judge.SLACK) ** STIFFER, smallest), largest)
        high = self.best
        if self.tried[high] >= LIVELY or high < CLOSE * low:
            return None
        way = math.log(self.tried[low] / AIM) / math.log(self.tried[low] / max(self.tried[high], 1e-6))
        return low * (high / low) ** min(max(way, INSIDE), 1.0 - INSIDE)

    @property
    def _within(self) -> list[float]:
        return [frequency for frequency, excess in self.tried.items() if excess <= judge.SLACK]
