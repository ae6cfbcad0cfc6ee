# SPDX-License-Identifier: GPL-3.0-or-later
"""Small geometry on arrays: sizes, areas, determinants, inverses, welded points, connected parts. NumPy only."""

from __future__ import annotations

import numpy as np


def diagonal(points: np.ndarray) -> float:
    """The diagonal of the bounding box of points (V, 3)."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def triangle_areas(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Areas (T,)."""
    corners = points[triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.linalg.norm(across, axis=1) / 2.0


def vertex_areas(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The area (V,) of the skin around each vertex."""
    return np.bincount(triangles.ravel(), np.repeat(triangle_areas(points, triangles) / 3.0, 3), len(points))


def vertex_normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Normals (V, 3) of a surface at its vertices, weighted by the areas of its triangles (T, 3); of any length."""
    a, b, c = points[triangles].swapaxes(0, 1)
    of_faces = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    return np.column_stack([np.bincount(triangles.ravel(), axis, len(points)) for axis in of_faces.T])


def is_closed(triangles: np.ndarray) -> bool:
    """Whether each edge of a surface (T, 3) belongs to two triangles."""
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    return bool((counts == 2).all())


def signed_volume(points: np.ndarray, triangles: np.ndarray) -> float:
    """The volume inside a closed surface, negative where it is inside out."""
    a, b, c = points[triangles].swapaxes(0, 1)
    return float(np.einsum("tc,tc->", a, np.cross(b, c))) / 6.0


def interpolated(values: np.ndarray, nodes: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """What a cage's nodes carry, (..., n, C), at points (..., P, C): the E u of the engine's `models/skin`, for whole
    bases at once. nodes, weights (P, 4): the corners of each point's tetrahedron and its weights there.
    """
    out = np.empty((*values.shape[:-2], len(nodes), values.shape[-1]))
    corners = np.ascontiguousarray(nodes.T)
    shares = [np.repeat(weights[:, [k]], values.shape[-1], axis=1) for k in range(4)]
    for basis in np.ndindex(values.shape[:-2]):  # one by one they stay in the cache: five times as fast as at once
        np.multiply(shares[0], values[basis].take(corners[0], axis=0), out=out[basis])
        for k in (1, 2, 3):
            out[basis] += shares[k] * values[basis].take(corners[k], axis=0)
    return out


def unique_edges(sides: np.ndarray, count: int) -> np.ndarray:
    """The edges (E, 2) among the sides (S, 2) of elements: each once, with its smaller end first. count: of points."""
    ends = np.sort(sides, axis=1).astype(np.int64)
    numbers = np.unique(ends[:, 0] * count + ends[:, 1])  # one for each edge, which sorts quickly
    return np.stack(np.divmod(numbers, count), axis=1)


def smooth_step(x: np.ndarray, low: float = 0.0, high: float = 1.0) -> np.ndarray:
    """0 below `low`, 1 above `high`, with continuous slope."""
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def invertible(matrices: np.ndarray) -> np.ndarray:
    return np.abs(determinant(matrices[..., :3, :3])) > 1e-12


def determinant(matrices: np.ndarray) -> np.ndarray:
    """Determinants (...) of 3 x 3 matrices (..., 3, 3).

    Written out, like `inverse`, because LAPACK wakes its threads for each matrix of a stack: on a busy machine that
    takes seconds per shot.
    """
    return np.einsum("...i,...i", matrices[..., 0, :], np.cross(matrices[..., 1, :], matrices[..., 2, :]))


def inverse(transforms: np.ndarray) -> np.ndarray:
    """Inverses of linear (..., 3, 3) or affine (..., 4, 4) transforms, which must not be singular."""
    linear = transforms[..., :3, :3]
    next_rows, last_rows = linear[..., [1, 2, 0], :], linear[..., [2, 0, 1], :]
    cofactors = next_rows[..., [1, 2, 0]] * last_rows[..., [2, 0, 1]]
    cofactors -= next_rows[..., [2, 0, 1]] * last_rows[..., [1, 2, 0]]
    determinants = np.einsum("...i,...i", linear[..., 0, :], cofactors[..., 0, :])
    back = cofactors.swapaxes(-1, -2) / determinants[..., None, None]
    if transforms.shape[-1] == 3:
        return back
    out = np.zeros_like(transforms)
    out[..., :3, :3] = back
    out[..., :3, 3] = -np.einsum("...ij,...j->...i", back, transforms[..., :3, 3])
    out[..., 3, 3] = 1.0
    return out


def turned(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Angle (B,), in radians, between the rotations of two arrays of transforms (B, 4, 4)."""

    def rotation(transforms: np.ndarray) -> np.ndarray:
        u, _, vt = np.linalg.svd(transforms[:, :3, :3])
        return u @ vt

    # From the chord, because the arc cosine of the trace is inaccurate for small angles.
    chord = np.linalg.norm(rotation(first) - rotation(second), axis=(1, 2)) / np.sqrt(8.0)
    return 2.0 * np.arcsin(np.clip(chord, 0.0, 1.0))


def connected_parts(elements: np.ndarray, count: int) -> np.ndarray:
    """The part (count,) that each point of a mesh of edges, triangles or tetrahedra (m, k) belongs to: the smallest
    number of its points.
    """
    part = np.arange(count)
    while True:  # each round merges parts that share an element, by their smallest points
        joined = part[elements]
        lowest = np.broadcast_to(joined.min(axis=1, keepdims=True), joined.shape)
        if np.array_equal(joined, lowest):
            return part
        np.minimum.at(part, joined, lowest)
        while not np.array_equal(part, part[part]):
            part = part[part]


# Fraction of a mesh's diagonal; points nearer than this are merged, because imported meshes are split at every seam.
WELD = 1e-6
CARD = 0.01  # of the area of the largest part, below which an open one is a card


def welded(points: np.ndarray) -> np.ndarray:
    """Numbers (V,), from 0, of the distinct places of points (V, 3); the points of a split seam share one."""
    size = diagonal(points) or 1.0
    cells = np.nan_to_num(np.round(points / (WELD * size)))
    cells = (cells - cells.min(axis=0, initial=np.inf)).astype(np.int64)
    rows = cells.max(axis=0, initial=0) + 1
    numbers = (cells[:, 0] * rows[1] + cells[:, 1]) * rows[2] + cells[
        :, 2
    ]  # one number each, because rows take ten times as long
    return np.unique(numbers, return_inverse=True)[1].ravel()


def without_cards(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Those of triangles (T, 3) that may enclose a body: without open parts that are small beside the largest one, as
    the cards of hair, fur, feathers and scales, whether they share points with it or not. Parts are what edges connect.
    """
    corners = np.sort(triangles, axis=1).astype(np.int64)
    edges = corners[:, [0, 0, 1]] * (len(points) + 1) + corners[:, [1, 2, 2]]
    _, number, count = np.unique(edges, return_inverse=True, return_counts=True)
    number = number.reshape(-1, 3)
    part = connected_parts(number, len(count))[number[:, 0]]
    area = np.bincount(part, triangle_areas(points, triangles))
    is_open = np.bincount(part, (count[number] != 2).any(axis=1)) > 0
    return triangles[~(is_open & (area < CARD * area.max(initial=0.0)))[part]]


def loose_parts(points: np.ndarray, elements: np.ndarray) -> np.ndarray:
    """Numbers (V,), from 0, of the parts of points (V, 3) that edges or faces (m, k) and seams connect."""
    place = welded(points)
    part = connected_parts(place[elements], place.max() + 1)
    return np.unique(part[place], return_inverse=True)[1].ravel()
