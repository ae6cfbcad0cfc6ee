# SPDX-License-Identifier: GPL-3.0-or-later
"""What an artist paints on the skin: vertex groups with a weight from 0 to 1 at each vertex. Never touches bpy."""

from __future__ import annotations

from dataclasses import dataclass

from . import firmness, max_distance


@dataclass(frozen=True)
class PaintedMap:
    """name: of the field of `Character`, and of the overlay; label: what an artist calls it; neutral: the weight that
    changes nothing, and counts wherever nothing is painted.
    """

    name: str
    label: str
    neutral: float

    @property
    def group(self) -> str:
        """The setting that names the vertex group."""
        return f"{self.name}_group"


FIRMNESS = PaintedMap("firmness", "Firmness", firmness.NEUTRAL)
MAX_DISTANCE = PaintedMap("max_distance", "Max Distance", max_distance.NEUTRAL)
EXCLUDED = PaintedMap("excluded", "Exclude", 0.0)
MAPS = (FIRMNESS, MAX_DISTANCE, EXCLUDED)
