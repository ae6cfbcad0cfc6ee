# SPDX-License-Identifier: GPL-3.0-or-later
"""What the figures claim, as numbers. Pure functions of arrays: NumPy, and Blender's mathutils for collisions.

V vertices, T triangles with outward normals, F frames; meters, seconds, world space unless said otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree

CHUNK = 2_000_000  # points times triangles in one piece of the winding number: bounds memory
PADDING = 16  # samples of a spectrum to one of the signal
FAR = 1e6  # meters
OUTWARD = 0.5  # cosine above which a way leads out through a triangle rather than along it


# The skin in motion ---------------------------------------------------------------------------------------------------


def posed(vertices: np.ndarray, weights: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """World positions (V, 3) of bind-space vertices (V, 3) under skin weights (V, B) and bones (B, 3, 4)."""
    blended = np.tensordot(weights, matrices, 1)
    return np.einsum("vij,vj->vi", blended[:, :, :3], vertices) + blended[:, :, 3]


def static_shapes(character, weights: np.ndarray) -> np.ndarray:
    """The blended shapes of a character's targets (..., V, 3), local space, at weights (..., T)."""
    return np.tensordot(weights, np.array([target.shape for target in character.targets]), 1)


def own_motion(character, bake) -> np.ndarray:
    """How far a baked skin is from the blended shapes of the targets (F, V), meters."""
    static = static_shapes(character, bake.weights)
    return np.array([np.linalg.norm(bake.displacement(k) - shape, axis=1) for k, shape in enumerate(static)])


def patch_displacement(motion: np.ndarray, patch: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Mean displacement (F,) of a patch's vertices along a unit direction; motion (F, V, 3), patch: indices or mask."""
    return motion[:, patch].mean(axis=1) @ direction


def amplitude(signal: np.ndarray) -> float:
    """Half the way from the lowest to the highest value of a signal (F,)."""
    return float(np.ptp(signal) / 2)


def spectrum(signal: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """(frequencies in Hz, amplitudes in the signal's unit) of samples (F,) taken `rate` times a second.

    Without the mean, through a Hann window scaled so that a steady sine shows its amplitude; padded with zeros, which
    draws the same spectrum finely.
    """
    window = np.hanning(len(signal))
    size = PADDING * len(signal)
    amplitudes = np.abs(np.fft.rfft((signal - signal.mean()) * window, size)) * 2 / window.sum()
    return np.fft.rfftfreq(size, 1 / rate), amplitudes


def dominant_frequency(signal: np.ndarray, rate: float) -> float:
    """Where the spectrum peaks, in Hz; what has fewer than two periods in the window is drift."""
    frequencies, amplitudes = spectrum(signal, rate)
    swings = frequencies >= 2 * rate / len(signal)
    return float(frequencies[swings][amplitudes[swings].argmax()])


# Size -----------------------------------------------------------------------------------------------------------------


def volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    """Volume inside a surface, cubic meters. Each hole of an open one is closed by a fan round its own center."""
    corners = vertices[triangles]
    closed = [corners]
    for loop in boundary_loops(triangles):
        rim = vertices[loop]
        center = np.broadcast_to(rim.mean(axis=0), rim.shape)
        closed.append(np.stack([np.roll(rim, -1, axis=0), rim, center], axis=1))
    a, b, c = np.concatenate(closed).transpose(1, 0, 2)
    return float(np.einsum("ti,ti->", a, np.cross(b, c)) / 6)


def boundary_loops(triangles: np.ndarray) -> list[list[int]]:
    """The holes of a surface: vertices in the order of the triangles' own edges. Holes that touch may come as one."""
    edges = {(int(t[k]), int(t[k - 2])) for t in triangles for k in range(3)}
    after = {begin: end for begin, end in edges if (end, begin) not in edges}
    loops = []
    while after:
        loop = [next(iter(after))]
        while loop[-1] in after:
            loop.append(after.pop(loop[-1]))
        loops.append(loop[:-1])
    return loops


def region(triangles: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """The triangles all of whose vertices are inside; inside (V,) bool."""
    return triangles[inside[triangles].all(axis=1)]


def girth(vertices: np.ndarray, triangles: np.ndarray, point: np.ndarray, normal: np.ndarray) -> float:
    """Length of the line in which a plane cuts the surface."""
    height = (vertices - point) @ normal
    crossing = triangles[np.ptp(np.sign(height[triangles]), axis=1) > 0]
    ends = []
    for k in range(3):  # the edges that change sides: two of each triangle
        begin, end = crossing[:, k], crossing[:, k - 2]
        change = (height[begin] >= 0) != (height[end] >= 0)
        t = np.where(change, height[begin] / np.where(change, height[begin] - height[end], 1), np.nan)
        ends.append(vertices[begin] + t[:, None] * (vertices[end] - vertices[begin]))
    ends = np.array(ends)
    lengths = [np.linalg.norm(ends[k] - ends[k - 2], axis=1) for k in range(3)]
    return float(np.nansum(lengths))


def depth(vertices: np.ndarray, patch: np.ndarray, axis: np.ndarray) -> float:
    """Extent of a patch along a unit axis, such as that of a chest from front to back."""
    along = vertices[patch] @ axis
    return float(np.ptp(along))


# Self-intersection ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Intersections:
    """pairs: of triangles that intersect and share no vertex. depth: how far a vertex is buried, at most, meters."""

    pairs: int
    depth: float


def self_intersections(vertices: np.ndarray, triangles: np.ndarray) -> Intersections:
    """Where a skin (V, 3), (T, 3) passes through itself, closed or nearly so.

    A vertex is buried when the skin's winding number there exceeds 1: its own sheet gives between 0 and 1, each part of
    the body that it is inside of one more. Its depth is the distance to the nearest point of buried skin to which the
    straight way leads out, for there it leaves the part that it is in.
    """
    tree = BVHTree.FromPolygons(vertices.tolist(), triangles.tolist())
    pairs = np.array([pair for pair in tree.overlap(tree) if pair[0] < pair[1]], int).reshape(-1, 2)
    first, second = triangles[pairs[:, 0]], triangles[pairs[:, 1]]
    pairs = pairs[(first[:, :, None] != second[:, None, :]).all(axis=(1, 2))]
    rim = np.unique(triangles[pairs])
    buried = _buried(vertices, triangles, rim)
    outside = np.setdiff1d(rim, buried)
    if not len(buried):
        return Intersections(len(pairs), 0.0)
    there = np.isin(triangles, buried).any(axis=1)
    there[pairs] = True
    skin = BVHTree.FromPolygons(vertices.tolist(), triangles[there].tolist())
    depths = np.array([_way_out(skin, vertices[v]) for v in buried] + [0.0] * len(outside))
    # None is deeper than another by more than the way between: in the corner of a fold none may lead straight out.
    known = vertices[np.concatenate([buried, outside])]
    ways = np.linalg.norm(vertices[buried, None] - known, axis=2)
    return Intersections(len(pairs), float((ways + depths).min(axis=1).max()))


def winding_numbers(points: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """How often the surface encloses each point (P, 3): the solid angles of its triangles over 4 pi; (P,)."""
    numbers = np.empty(len(points))
    step = max(1, CHUNK // len(triangles))
    for begin in range(0, len(points), step):
        a, b, c = (vertices[triangles[:, k]] - points[begin : begin + step, None] for k in range(3))
        la, lb, lc = (np.linalg.norm(x, axis=2) for x in (a, b, c))
        below = la * lb * lc + _dot(a, b) * lc + _dot(b, c) * la + _dot(c, a) * lb
        numbers[begin : begin + step] = np.arctan2(_dot(a, np.cross(b, c)), below).sum(axis=1) / (2 * np.pi)
    return numbers


def _dot(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i->...", x, y)


def _buried(vertices: np.ndarray, triangles: np.ndarray, front: np.ndarray) -> np.ndarray:
    """Indices of the buried vertices. front: those of intersecting triangles, from which a buried patch is reached."""
    seen = np.zeros(len(vertices), bool)
    buried = [front[:0]]
    while len(front):
        seen[front] = True
        deep = front[winding_numbers(vertices[front], vertices, triangles) > 1]
        buried.append(deep)
        touched = np.zeros(len(vertices), bool)
        touched[triangles[np.isin(triangles, deep).any(axis=1)]] = True
        front = np.flatnonzero(touched & ~seen)
    return np.concatenate(buried)


def _way_out(skin: BVHTree, vertex: np.ndarray) -> float:
    """Distance from a buried vertex to where the straight way leads out through `skin`; FAR where none does."""
    origin = Vector(vertex)
    hits = skin.find_nearest_range(origin, FAR)
    return min((d for point, normal, _, d in hits if d > 0 and (point - origin).dot(normal) > OUTWARD * d), default=FAR)
