# SPDX-License-Identifier: GPL-3.0-or-later
"""What a weight w of the Firmness map does to the soft tissue. Never touches bpy.

w                 0     0.5    0.9    1
stiffness        1/4     1      4     4     times, linear in its logarithm between these weights
held              0      0      0     1     by the bones, smooth from 0.9 on: firmness rises without a jump
automatic hold    0      1      1     1     times: of thin parts and of heads, so that soft paint frees them
"""

from __future__ import annotations

import numpy as np

from .geometry import smooth_step

NEUTRAL = 0.5  # leaves the tissue as it is, and counts wherever nothing is painted
FIRM = 0.9  # from here on the bones take hold
OCTAVES = 2.0  # binary logarithm of the stiffness at FIRM, and minus that at 0


def stiffness(weights: np.ndarray) -> np.ndarray:
    """Factor on the stiffness."""
    return 2.0 ** np.interp(weights, [0.0, NEUTRAL, FIRM], [-OCTAVES, 0.0, OCTAVES])


def held(weights: np.ndarray) -> np.ndarray:
    """How firmly the bones hold, 0 to 1."""
    return smooth_step(weights, FIRM, 1.0)


def kept(weights: np.ndarray) -> np.ndarray:
    """How much remains of the automatic hold, 0 to 1."""
    return (1.0 + (weights - NEUTRAL) / NEUTRAL).clip(0.0, 1.0)
