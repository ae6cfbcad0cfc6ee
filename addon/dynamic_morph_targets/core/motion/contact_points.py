# SPDX-License-Identifier: GPL-3.0-or-later
"""The points of a skin that can touch something: its vertices, and points of its edges and faces where these are large,
so that nothing slips between them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from ..character import Character
from ..geometry import diagonal, signed_volume, vertex_normals
from ..model.model import Model

SPACING = 0.01  # between points of the skin, at most, of the body's size
PARTS = 100  # of an edge, at most
HALVED = 12  # times, the size of a grid's cells,
CELLS = 2**HALVED + 1  # of which so many lie along an axis, at most


@dataclass(frozen=True)
class ContactPoints:
    """P points of a skin. vertices (P, 3): the corners of each, the nearest first; weights (P, 3): of these in the
    point, summing to one; a vertex is its own corner thrice. rest, normals (P, 3): bind space, meters and unit, out of
    the body.
    """

    vertices: np.ndarray
    weights: np.ndarray
    rest: np.ndarray
    normals: np.ndarray

    def __getitem__(self, chosen: np.ndarray) -> ContactPoints:
        return ContactPoints(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def at_most(self, count: int) -> ContactPoints:
        """So many of them, spread over the skin."""
        return self[spread(self.rest, self.normals, count)]

    def of(self, values: np.ndarray) -> np.ndarray:
        """Values (P, ...) of the points, from those of the vertices (V, ...)."""
        return np.einsum("pk,pk...->p...", self.weights, values[self.vertices])

    def least(self, values: np.ndarray) -> np.ndarray:
        """The least of the values (V,) of each point's corners."""
        return values[self.vertices].min(axis=1)


def contact_points(model: Model, character: Character) -> ContactPoints:
    """All points of the soft skin that a model moves."""
    rest = character.bind_points
    soft = character.soft_triangles
    outward = -1.0 if signed_volume(rest, soft) < 0.0 else 1.0  # some meshes are inside out
    normals = outward * vertex_normals(rest, character.triangles)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-300)
    vertices, weights = mixed(rest, character.coincident[soft])  # of vertices at one place, one
    places, facing = (np.einsum("pk,pkc->pc", weights, values[vertices]) for values in (rest, normals))
    moves = model.free[model.embedding_nodes[vertices]].any(axis=(1, 2))
    return ContactPoints(vertices, weights, places, facing)[moves & facing.any(axis=1)]


def mixed(rest: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`ContactPoints.vertices` and their weights: the vertices of triangles (T, 3), and points of the edges and faces.
    rest (V, 3): meters.
    """
    spacing, own = SPACING * diagonal(rest), np.unique(triangles)
    found = [(np.repeat(own[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (len(own), 1)))]
    found += _of_edges(rest, triangles, spacing)
    found += _of_faces(rest, triangles, spacing)
    vertices, weights = (np.concatenate(parts) for parts in zip(*found, strict=True))
    order = np.argsort(-weights, axis=1, kind="stable")
    return np.take_along_axis(vertices, order, axis=1), np.take_along_axis(weights, order, axis=1)


def spread(points: np.ndarray, normals: np.ndarray, count: int) -> np.ndarray:
    """Indices of at most `count` of the points (P, 3) that are spread over a surface: of each cell of a grid, and each
    of six directions of the normals (P, 3), so that both sides of something thin have some, the outermost: it touches
    first.
    """
    if len(points) <= count:
        return np.arange(len(points))
    rows = np.arange(len(points))
    axis = np.abs(normals).argmax(axis=1)
    sign = np.sign(normals[rows, axis])
    side = 2 * axis + (sign > 0.0)
    inward = np.argsort(-sign * points[rows, axis], kind="stable")
    low, high = 0.0, diagonal(points)  # of a cell
    found = np.zeros(0, np.int64)
    for _ in range(HALVED):
        size = 0.5 * (low + high)
        cells = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
        one_number = ((cells[:, 0] * CELLS + cells[:, 1]) * CELLS + cells[:, 2]) * 6 + side
        _, first = np.unique(one_number[inward], return_index=True)
        if len(first) > count:
            low = size
        else:
            high, found = size, inward[first]
    return np.sort(found)


def _parts(lengths: np.ndarray, spacing: float) -> np.ndarray:
    """Of edges of these lengths, so that no part is longer than the spacing."""
    return np.clip(np.ceil(lengths / max(spacing, 1e-300)), 1, PARTS).astype(int)


def _of_edges(rest: np.ndarray, triangles: np.ndarray, spacing: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Corners (p, 3) and their weights (p, 3) of points between the ends of the edges, for each number of parts."""
    edges = np.unique(np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    parts = _parts(np.linalg.norm(rest[edges[:, 1]] - rest[edges[:, 0]], axis=1), spacing)
    for count in np.unique(parts[parts > 1]):
        own, along = edges[parts == count], np.arange(1, count) / count
        weights = np.column_stack([1.0 - along, along, 0.0 * along])
        yield np.repeat(own[:, [0, 1, 1]], len(along), axis=0), np.tile(weights, (len(own), 1))


def _of_faces(rest: np.ndarray, triangles: np.ndarray, spacing: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The same of points within the triangles."""
    sides = np.linalg.norm(rest[np.roll(triangles, -1, axis=1)] - rest[triangles], axis=2)
    parts = _parts(sides.max(axis=1, initial=0.0), spacing)
    for count in np.unique(parts[parts > 2]):
        own = triangles[parts == count]
        steps = np.array([(i, j, count - i - j) for i in range(1, count) for j in range(1, count - i)])
        yield np.repeat(own, len(steps), axis=0), np.tile(steps / count, (len(own), 1))
