# SPDX-License-Identifier: GPL-3.0-or-later
"""What a weight w of the Max Distance map does to how far the skin may move. Never touches bpy.

w                 0      0.1     1
pulled back from  0.1    0.1     1     times the distance without the map, linear between these weights
shown             0      1       1     times the motion about the targets' shapes

Together they let a point go w times as far, and one with 0 follows its bones to the last bit. A pull keeps small motion
as it is, which the scale would make smaller too; but pulls alone let everything move a little, and cost more the nearer
they hold (docs/theory.md, Limits, has the figures).
"""

from __future__ import annotations

import numpy as np

NEUTRAL = 1.0  # leaves the limit as it is, and counts wherever nothing is painted
NEAREST = 0.1  # of the distance: from no less are points pulled back


def pulled(weights: np.ndarray) -> np.ndarray:
    """Factor on the distance from which points are pulled back."""
    return weights.clip(NEAREST, 1.0)


def shown(weights: np.ndarray) -> np.ndarray:
    """How much of the motion shows, 0 to 1."""
    return (weights / NEAREST).clip(0.0, 1.0)
