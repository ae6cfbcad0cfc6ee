# SPDX-License-Identifier: GPL-3.0-or-later
"""A bake as plain data: the result of a shot, and its surface at any frame. Never touches bpy."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

CHUNK = 64  # frames whose surfaces are computed at once, to bound memory


def surfaces(bake: Bake, vertices: np.ndarray | float, chunk: int = CHUNK) -> Iterator[np.ndarray]:
    """The surface at each frame, a few frames (F', V, 3) at a time; vertices (V, 3): the Basis, or 0.0: from it."""
    for first in range(0, len(bake.frames), chunk):
        frames = slice(first, first + chunk)
        yield vertices + displaced(bake.coordinates[frames], bake.weights[frames], bake.modes, bake.residual_shapes)


def digest(bake: Bake, *more: ArrayLike) -> str:
    """Identifies a result: SHA-256 of all numbers of a bake, and of more."""
    found, names = hashlib.sha256(), ("frames", "coordinates", "weights", "modes", "residual_shapes", "static")
    for name, numbers in (*((name, getattr(bake, name)) for name in names), *(("more", each) for each in more)):
        array = np.ascontiguousarray(numbers)
        found.update(f"{name} {array.dtype.str} {array.shape}".encode())
        found.update(array.tobytes())
    return found.hexdigest()


def largest_displacement(bake: Bake, to_bind: np.ndarray) -> float:
    """The largest displacement of a vertex from the Basis, in meters; to_bind (3, 3): local to metric space."""
    in_meters = replace(bake, modes=bake.modes @ to_bind.T, residual_shapes=bake.residual_shapes @ to_bind.T)
    return max(float(np.linalg.norm(chunk, axis=2).max(initial=0.0)) for chunk in surfaces(in_meters, 0.0))


def distance(bake: Bake, other: Bake, to_bind: np.ndarray) -> float:
    """The largest distance of a vertex between two bakes of the same frames, in meters; to_bind (3, 3): local to
    metric space.
    """
    difference = Bake(
        frames=bake.frames,
        coordinates=np.hstack([bake.coordinates, -other.coordinates]),
        weights=np.hstack([bake.weights, -other.weights]),
        modes=np.concatenate([bake.modes, other.modes]),
        residual_shapes=np.concatenate([bake.residual_shapes, other.residual_shapes]),
        target_names=(),
        static=np.zeros((len(bake.frames), 0)),
    )
    return largest_displacement(difference, to_bind)


def motion_distance(bake: Bake, reference: Bake, to_bind: np.ndarray, areas: np.ndarray) -> float:
    """How far two bakes of the same frames are apart, each about its own mean: RMS over frames and skin, as a fraction
    of that of the reference; 0 if that does not move. areas (V,): of the skin about each vertex; to_bind (3, 3): local
    to metric space.
    """
    pair = bake, reference
    shapes = np.concatenate([shapes for each in pair for shapes in (each.modes, each.residual_shapes)])
    values = [np.hstack([each.coordinates, each.weights]) for each in pair]
    first, second = (value - value.mean(axis=0) for value in values)
    weighted = (np.sqrt(areas)[:, None] * (shapes @ to_bind.T)).reshape(len(shapes), -1)
    products = weighted @ weighted.T

    def square(moved: np.ndarray) -> float:
        return float(np.einsum("fi,ij,fj->", moved, products, moved, optimize=True))

    moves = square(np.hstack([np.zeros_like(first), second]))
    apart = max(square(np.hstack([first, -second])), 0.0)  # rounding may leave less than nothing
    return float(np.sqrt(apart / moves)) if moves > 0.0 else 0.0


def at_rows(bake: Bake, rows: np.ndarray) -> Bake:
    """Some frames of a bake."""
    return replace(
        bake, frames=bake.frames[rows], coordinates=bake.coordinates[rows], weights=bake.weights[rows],
        static=bake.static[rows],
    )  # fmt: skip


def samples_per_frame(bake: Bake) -> int:
    """The number of surfaces that a bake has from one frame to the next."""
    return round(1.0 / (bake.frames[1] - bake.frames[0])) if len(bake.frames) > 1 else 1


def displaced(
    coordinates: np.ndarray, weights: np.ndarray, modes: np.ndarray, residual_shapes: np.ndarray
) -> np.ndarray:
    return np.tensordot(coordinates, modes, 1) + np.tensordot(weights, residual_shapes, 1)


@dataclass(frozen=True)
class Bake:
    """A simulated shot in modal form, in local space.

    surface = vertices + modes . coordinates + residual_shapes . weights.

    frames (F,): numbers, or with fractions between the whole ones; coordinates (F, r), weights (F, J), modes (r, V, 3),
    residual_shapes (J, V, 3): what the cage cannot carry of each target's shape. target_names (J,). static (F, r): the
    coordinates of only the targets' shapes, without motion. node_modes (r, n, 3): the modes of the cage's nodes, bind
    space, for what else moves with the tissue. key_names (r + J,): of the shape keys that modes and residual shapes
    become; empty: numbered, and by the targets.
    """

    frames: np.ndarray
    coordinates: np.ndarray
    weights: np.ndarray
    modes: np.ndarray
    residual_shapes: np.ndarray
    target_names: tuple[str, ...]
    static: np.ndarray
    node_modes: np.ndarray | None = None
    key_names: tuple[str, ...] = ()

    def displacement(self, index: int) -> np.ndarray:
        """Displacement (V, 3) of the bound surface at frame number `index`, local space."""
        return np.tensordot(self.coordinates[index], self.modes, 1) + np.tensordot(
            self.weights[index], self.residual_shapes, 1
        )
