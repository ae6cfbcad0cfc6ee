# SPDX-License-Identifier: GPL-3.0-or-later
"""How well a posed skin keeps clear of itself, how much it encloses, and a picture of two of its states, for shapes.py.

V vertices, T triangles with outward normals; meters. Arrays: NumPy, and Blender's mathutils for distances.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

import bpy
import numpy as np
from contact_sheet import render
from dynamic_morph_targets.core.geometry import connected_parts, diagonal, vertex_normals
from heat import beside, paint
from mathutils import Vector
from mathutils.bvhtree import BVHTree
from mathutils.geometry import closest_point_on_tri
from mathutils.interpolate import poly_3d_calc
from PIL import Image
from portrait import FROM, aim

CELL = (480, 480)  # pixels of a state
LARGEST, QUALITIES = 80_000, (90, 84, 76, 66)  # bytes of a picture; of JPEG, the first that is small enough
SIDES = [[0, 1], [1, 2], [2, 0]]  # of a triangle


# A skin in itself -----------------------------------------------------------------------------------------------------


def intersecting_pairs(
    points: np.ndarray, triangles: np.ndarray, rest: np.ndarray, far: float | np.ndarray
) -> np.ndarray:
    """Pairs (k, 2) of triangles of a skin (V, 3), (T, 3) that intersect and have no vertex in common.

    rest (V, 3), far or (T,): only pairs whose centers are farther apart there than `far` of both; nearer ones belong to
    one crease.
    """
    tree = BVHTree.FromPolygons(points.tolist(), triangles.tolist(), all_triangles=True)
    pairs = np.array([pair for pair in tree.overlap(tree) if pair[0] < pair[1]], int).reshape(-1, 2)
    first, second = triangles[pairs.T]
    centers = rest[triangles].mean(axis=1)
    ways = np.linalg.norm(centers[pairs[:, 0]] - centers[pairs[:, 1]], axis=1)
    apart = (first[:, :, None] != second[:, None, :]).all(axis=(1, 2))
    return pairs[apart & (ways > np.broadcast_to(far, len(triangles))[pairs].max(axis=1))]


def deepest(points: np.ndarray, triangles: np.ndarray, pairs: np.ndarray) -> float:
    """How deep a vertex of intersecting triangles is behind the other side, at most; 0 without pairs (k, 2).

    The other side of a vertex: the triangles that cross its own ones, and their neighbors, as far as these are not its
    own neighbors as well. Only skin that is crossed counts: between larger overlaps the depth is more.
    """
    normals = vertex_normals(points, triangles)
    around: dict[int, set[int]] = defaultdict(set)
    for number, corners in enumerate(triangles.tolist()):
        for corner in corners:
            around[corner].add(number)

    def neighbors(chosen: Iterable[int]) -> set[int]:
        return {near for number in chosen for corner in triangles[number].tolist() for near in around[corner]}

    crossed: dict[int, set[int]] = defaultdict(set)
    for one, other in np.concatenate([pairs, pairs[:, ::-1]]).tolist():
        for corner in triangles[one].tolist():
            crossed[corner].add(other)
    depth = 0.0
    for vertex, others in crossed.items():
        other_side = neighbors(others) - neighbors(around[vertex])
        depth = max(depth, behind(points[vertex], points, normals, triangles[sorted(other_side | others)]))
    return depth


def behind(point: np.ndarray, points: np.ndarray, normals: np.ndarray, triangles: np.ndarray) -> float:
    """How far a point (3,) is behind the nearest of these triangles (t, 3); below zero in front of it. normals (V, 3):
    those of the vertices, which have one sign on both sides of an edge."""
    place, nearest, distance = Vector(point), None, np.inf
    for corners in triangles.tolist():
        found = closest_point_on_tri(place, *(Vector(points[corner]) for corner in corners))
        if (way := (found - place).length) < distance:
            nearest, distance = (corners, found), way
    corners, found = nearest
    shares = poly_3d_calc([Vector(points[corner]) for corner in corners], found)
    return float(np.copysign(distance, (np.asarray(found) - point) @ (np.array(shares) @ normals[corners])))


# What a skin encloses -------------------------------------------------------------------------------------------------


def volume_of(points: np.ndarray, triangles: np.ndarray, keep: np.ndarray) -> float:
    """Volume inside the triangles (T, 3) that `keep` (T,) selects, cubic meters. A fan around the center of each rim
    closes it; rims that touch are one."""
    kept = triangles[keep]
    sides = kept[:, SIDES].reshape(-1, 2)
    numbers, back = (begin * len(points) + end for begin, end in (sides.T, sides.T[::-1]))
    rims = sides[~np.isin(numbers, back)]
    begins, ends = rims.T
    part = connected_parts(rims, len(points))[begins]
    counts = np.maximum(np.bincount(part, minlength=len(points)), 1)
    centers = np.column_stack([np.bincount(part, axis, len(points)) / counts for axis in points[begins].T])
    fans = np.stack([points[ends], points[begins], centers[part]], axis=1)
    corners = np.concatenate([points[kept], fans]) - points[kept].mean(axis=(0, 1))
    a, b, c = corners.swapaxes(0, 1)
    return abs(float(np.einsum("ti,ti->", a, np.cross(b, c)))) / 6.0


# Two states beside each other -----------------------------------------------------------------------------------------


def side_by_side(
    path: Path,
    states: dict[str, np.ndarray],
    triangles: np.ndarray,
    *,
    shares: Sequence[np.ndarray] | None = None,
    legend: str = "",
    near: np.ndarray | None = None,
    seen_from: Collection[float] = FROM,
    cell: tuple[int, int] = CELL,
) -> None:
    """Write a picture (JPEG) of states of a skin, title -> vertices (V, 3), by one camera. It opens an empty scene.

    shares: for each state how much its vertices (V,) differ from gray to red, which `legend` tells. near: which
    vertices (V,) the camera has in its picture, in all states; by default all. seen_from: from where it looks.
    """
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)  # keeps the add-on
    scene = bpy.context.scene
    shading = scene.display.shading
    shading.light, shading.color_type, shading.show_cavity = "STUDIO", "VERTEX", True
    scene.view_settings.view_transform, scene.view_settings.look = "Standard", "None"
    kept, direction = slice(None) if near is None else near, Vector(seen_from).normalized()
    aim(np.concatenate([points[kept] for points in states.values()]), cell, direction)
    back = diagonal(np.concatenate(list(states.values())))  # so far back that nothing in front is cut off
    scene.camera.location += back * direction
    scene.camera.data.clip_end += 2.0 * back
    pictures = []
    for number, points in enumerate(states.values()):
        mesh = bpy.data.meshes.new("State")
        mesh.from_pydata(points.tolist(), [], triangles.tolist())
        mesh.shade_smooth()
        paint(mesh, np.zeros(len(points)) if shares is None else shares[number])
        shown = bpy.data.objects.new("State", mesh)
        scene.collection.objects.link(shown)
        pictures.append(render([scene.frame_current], cell, "BLENDER_WORKBENCH")[0])
        bpy.data.objects.remove(shown)
    save(beside(pictures, list(states), legend), path)


def save(picture: Image.Image, path: Path) -> None:
    """Write a JPEG of at most LARGEST bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    for quality in QUALITIES:
        picture.save(path, quality=quality, optimize=True)
        if path.stat().st_size <= LARGEST:
            return
    raise ValueError(f"{path.name}: more than {LARGEST} bytes")
