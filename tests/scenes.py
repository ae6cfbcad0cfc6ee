# SPDX-License-Identifier: GPL-3.0-or-later
"""Small scenes as plain arrays, shared by tests and benchmarks. NumPy only."""

from __future__ import annotations

import itertools

import numpy as np

PINNED = {"hold": "BONES", "basis": "MODES"}  # settings of a model that is pinned to its bones, as in the thesis


def tube(rings: int = 17, around: int = 16, radius: float = 0.3, length: float = 2.0):
    """A closed tube along z from 0 to `length`: vertices (V, 3), quads and caps as lists of vertex indices."""
    z, angle = np.meshgrid(np.linspace(0.0, length, rings), np.arange(around) * 2 * np.pi / around, indexing="ij")
    vertices = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1).reshape(-1, 3)
    index = np.arange(rings * around).reshape(rings, around)
    after = np.roll(index, -1, axis=1)
    quads = np.stack([index[:-1], after[:-1], after[1:], index[1:]], axis=-1).reshape(-1, 4)
    return vertices, [*quads.tolist(), index[0, ::-1].tolist(), index[-1].tolist()]


def two_bone_weights(vertices: np.ndarray, joint: float = 1.0, blend: float = 0.3) -> np.ndarray:
    """Weights (V, 2) of an upper and a lower bone that meet at height `joint`, smooth over +-`blend`."""
    t = np.clip((vertices[:, 2] - joint) / (2 * blend) + 0.5, 0.0, 1.0)
    lower = t * t * (3 - 2 * t)
    return np.stack([1 - lower, lower], axis=1)


def bulge(vertices: np.ndarray, center: float = 0.6, width: float = 0.25, amount: float = 0.1) -> np.ndarray:
    """A muscle's bulge (V, 3): outward from the z axis, round the height `center`."""
    outward = vertices * [1.0, 1.0, 0.0]
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-12)
    return outward * (amount * np.exp(-(((vertices[:, 2] - center) / width) ** 2)))[:, None]


def bar(cells: tuple[int, int, int], size: tuple[float, float, float]):
    """A box of tetrahedra along x from the origin, six a cell: nodes (n, 3), tets (m, 4)."""
    axes = [np.linspace(0.0, length, count + 1) for count, length in zip(cells, size, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    index = np.arange(len(nodes)).reshape([count + 1 for count in cells])
    corner = np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), axis=-1).reshape(-1, 3)
    tets = []
    for order in itertools.permutations(range(3)):
        path = np.zeros((4, 3), int)
        for step, axis in enumerate(order):
            path[step + 1] = path[step]
            path[step + 1, axis] += 1
        tet = np.stack([index[tuple((corner + offset).T)] for offset in path], axis=1)
        odd = np.linalg.det(path[1:] - path[0]) < 0
        tets.append(tet[:, [0, 2, 1, 3]] if odd else tet)
    return nodes, np.concatenate(tets)
