# SPDX-License-Identifier: GPL-3.0-or-later
"""Modes as shape keys with slider ranges that Blender accepts. NumPy only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..motion.baked import Bake

NEGLIGIBLE = 1e-7  # of the bounding box; smaller displacements get no key
KEYFRAME_BYTES = 72  # that Blender accepts for a slider
NAME_BYTES = 59  # Blender has room for 63, cuts within a letter, and may add ".001"


@dataclass(frozen=True)
class Key:
    """A shape key to create: its points (V, 3), and its values (F,) with and without the motion, if it has any."""

    name: str
    points: np.ndarray
    lowest: float  # value of the slider
    motion: np.ndarray | None
    shapes: np.ndarray | None

    def bytes(self) -> int:
        curves = [curve for curve in (self.motion, self.shapes) if curve is not None]
        return self.points.nbytes + KEYFRAME_BYTES * sum(len(curve) for curve in curves)


def scaled_keys(bake: Bake, basis: np.ndarray) -> list[Key]:
    """The keys of a bake, each with curves scaled into its slider's range.

    Blender clamps an animated value to its slider, so the largest coordinate becomes 1 and the shape takes the factor.
    """
    keys, count = [], len(bake.modes)
    numbered = [f"Dynamorph Mode {k + 1:02d}" for k in range(count)]
    names = bake.key_names or (*numbered, *(f"Dynamorph Detail {name}" for name in bake.target_names))
    negligible = NEGLIGIBLE * np.ptp(basis, axis=0).max()

    def points(displacement: np.ndarray) -> np.ndarray:
        return (basis + displacement).astype(np.float32)

    for k, mode in enumerate(bake.modes):
        motion, shapes = bake.coordinates[:, k], bake.static[:, k]
        largest = max(np.abs(motion).max(), np.abs(shapes).max()) or 1.0
        needed = np.abs(mode).max() * np.abs(shapes).max() > negligible
        without = shapes / largest if needed else None
        keys.append(Key(_fit(names[k]), points(largest * mode), -1.0, motion / largest, without))
    for j, shape in enumerate(bake.residual_shapes):
        weights = bake.weights[:, j]
        largest = np.abs(weights).max()
        if np.abs(shape).max() * largest > negligible:
            name = _fit(names[count + j])
            values = weights / largest  # also with the motion, because the strips may be moved apart
            lowest = -1.0 if weights.min() < 0.0 else 0.0
            keys.append(Key(name, points(largest * shape), lowest, values if len(bake.modes) else None, values))
    return keys


def _fit(name: str) -> str:
    return name.encode()[:NAME_BYTES].decode(errors="ignore")
