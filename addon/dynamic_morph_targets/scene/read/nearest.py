# SPDX-License-Identifier: GPL-3.0-or-later
"""Nearest points of a surface. Never touches bpy.

`mathutils` finds the triangle, but its places on a triangle are not good enough: the weights of
`mathutils.interpolate.poly_3d_calc` have single precision and are NaN on a triangle without area, and
`mathutils.geometry.closest_point_on_tri` goes wrong where the corners lie in a line.
"""

from __future__ import annotations

import numpy as np
from mathutils.bvhtree import BVHTree

from ...core.character import SurfaceMap


def nearest(points: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> SurfaceMap:
    """points (P, 3), vertices (V, 3) in one space, all finite; triangles (T, 3), at least one.

    A point that is a vertex of the mesh gets that vertex's values exactly.
    """
    center = vertices.mean(axis=0)  # the tree uses single precision
    tree = BVHTree.FromPolygons((vertices - center).tolist(), triangles.tolist(), all_triangles=True)
    corners = triangles[[tree.find_nearest(point)[2] for point in (points - center).tolist()]]
    weights = _closest(points, vertices[corners])
    return SurfaceMap(corners, weights, _distances(points, vertices[corners], weights))


def _closest(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Barycentric coordinates (P, 3) of the points nearest to (P, 3) on triangles (P, 3, 3)."""
    on_plane, on_edges = _on_plane(points, corners), _on_edges(points, corners)
    # On a triangle with almost no area, those on its plane are arbitrary or NaN.
    nearer = _distances(points, corners, on_plane) <= _distances(points, corners, on_edges)
    return np.where(((on_plane >= 0.0).all(axis=1) & nearer)[:, None], on_plane, on_edges)


def _distances(points: np.ndarray, corners: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.einsum("pc,pcx->px", weights, corners) - points, axis=1)


def _on_plane(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    offset = points - corners[:, 0]
    ff, fs, ss = _dot(first, first), _dot(first, second), _dot(second, second)
    of, os = _dot(offset, first), _dot(offset, second)
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = np.array([ss * of - fs * os, ff * os - fs * of]) / (ff * ss - fs * fs)
        return np.stack([1.0 - u - v, u, v], axis=1)


def _on_edges(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    choices = np.zeros((3, *corners.shape[:2]))
    for k in range(3):
        start, edge = corners[:, k], corners[:, k - 2] - corners[:, k]
        along = np.clip(_dot(points - start, edge) / np.maximum(_dot(edge, edge), 1e-300), 0.0, 1.0)
        choices[k, :, k], choices[k, :, k - 2] = 1.0 - along, along
    distances = np.linalg.norm(np.einsum("kpc,pcx->kpx", choices, corners) - points, axis=-1)
    return choices[distances.argmin(axis=0), np.arange(len(points))]


def _dot(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.einsum("px,px->p", first, second)
