# SPDX-License-Identifier: GPL-3.0-or-later
"""How a soft skin feels, as three presets: how fast it swings, how soon it settles, how far it may move. No bpy."""

from __future__ import annotations

from dataclasses import dataclass
from math import isclose, pi, sqrt
from typing import Protocol


@dataclass(frozen=True)
class Feel:
    """frequency: at which it is seen to swing, Hz; damping_ratio: fraction of critical damping; max_displacement: how
    far the skin may move, as a fraction of the body's size; max_thickness: the same of the local thickness.
    """

    label: str
    tooltip: str
    frequency: float
    damping_ratio: float
    max_displacement: float
    max_thickness: float

    @property
    def undamped(self) -> float:
        """The frequency that it would have without damping, Hz."""
        return self.frequency / sqrt(1.0 - self.damping_ratio**2)

    @property
    def damping(self) -> dict[str, float]:
        """The dampings of a `Material`, SI, that give a swing of this frequency this damping ratio."""
        return {"mass_damping": 0.0, "stiffness_damping": self.damping_ratio / (pi * self.undamped)}


# Half of the thickness is the way to the middle of the body: tissue that is pressed farther turns inside out.
FEELS = {
    "SUBTLE": Feel("Subtle", "A firm body with small, quick motion, for athletic characters", 4.5, 0.3, 0.03, 0.4),
    "NATURAL": Feel("Natural", "An average body", 3.5, 0.2, 0.05, 0.5),
    "CARTOON": Feel("Cartoon", "A very soft body with large, slow motion, for caricatures", 2.5, 0.12, 0.07, 0.75),
}


class NeutralTarget(Protocol):
    """What of the neutral target's properties a feel sets."""

    by_hand: bool
    frequency: float


class Simulation(Protocol):
    """What of the simulation's properties a feel sets."""

    max_displacement: float
    max_thickness: float


def active(neutral: NeutralTarget, simulation: Simulation) -> str:
    """Which of FEELS the neutral target and the simulation settings of a soft skin match; "" if none."""
    if neutral.by_hand:
        return ""
    for key, feel in FEELS.items():
        pairs = [
            (neutral.frequency, feel.undamped),
            (simulation.max_displacement, feel.max_displacement),
            (simulation.max_thickness, feel.max_thickness),
        ]
        if all(isclose(*pair, rel_tol=1e-5) for pair in pairs):
            return key
    return ""
