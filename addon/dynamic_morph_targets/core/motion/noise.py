# SPDX-License-Identifier: GPL-3.0-or-later
"""The noise of Blender's Turbulence fields: improved Perlin noise (Perlin 2002) with Blender's own permutation.

Each point i of the lattice of whole numbers has one of sixteen directions g, by a permutation P of 0 to 255: the one of
P(P(P(i_x) + i_y) + i_z). Between the eight about a point x the noise is n(x) = sum_i w(x - i) g_i . (x - i), where w is
a product of the fade curve 6 t^5 - 15 t^4 + 10 t^3, or 1 minus it, along each axis.

Only sums and products: the same bytes on all machines, and however many points are asked for at once. Within a cell
they are of single precision, as Blender's are.
"""

from __future__ import annotations

import numpy as np

OCTAVES = 3  # the k-th is 2^k times as fine and as weak
CHUNK = 4096  # points at once: what is computed between stays in the processor's cache
# As the values of mathutils.noise in Blender 4.5 and 5.2 show it. Twice, so that the sum of two numbers is an index.
_ONCE = bytes.fromhex(
    "a2a0193bf8ebaaeef31c67281ded00de952edc3f3a82354d6cba36d0f60c7932d159f4088b63892fb8b49783f28f18c751146587"
    "482042a880b54013b2227e57bc7f6b9d864cc8db7cd5254e5a557450cdb37abbc3cbb6e2e4ecfd980b96d39e5ca164f18161e1c4"
    "2472498c904b843438ab78ca1f01d79311c158a931f9446dbf339c5f0994a38506c69a1e7b461530272b1b713c5bd66f62ac4fc2"
    "c00eb123a7df47b0776905e9e6e776730ffe6e9b56ef12a537fcaed9038edd10b9cec98dda2abd68179fbed40accd2e8433d70b7"
    "027d99d80d608a042c3e92e5af5307e029a6c5e3f5f74a41266a165e522d21adf091ffea54fa661a4539cf75a488fb5d"
)
PERMUTATION = np.frombuffer(2 * _ONCE, np.uint8).astype(np.intp)
_SIXTEEN = [
    (1, 1, 0), (-1, 1, 0), (1, -1, 0), (-1, -1, 0), (1, 0, 1), (-1, 0, 1), (1, 0, -1), (-1, 0, -1),
    (0, 1, 1), (0, -1, 1), (0, 1, -1), (0, -1, -1), (1, 1, 0), (0, -1, 1), (-1, 1, 0), (0, -1, -1),
]  # fmt: skip
DIRECTIONS = np.array(_SIXTEEN, np.float32)[PERMUTATION & 15].T.copy()  # (3, 512), by what P is asked for last


def turbulence(points: np.ndarray) -> np.ndarray:
    """The force (V, 3), each component from -1 to 1, of a Turbulence field of strength and size 1 at points (V, 3)."""
    out = np.zeros(points.shape)
    for axis in range(3):
        turned = np.roll(points, -axis, axis=1)
        for k in range(OCTAVES):
            out[:, axis] += 0.5**k * perlin(2.0**k * turned)
    return out / sum(0.5**k for k in range(OCTAVES))


def perlin(points: np.ndarray) -> np.ndarray:
    """The noise (V,) at points (V, 3)."""
    out = np.empty(len(points))
    for first in range(0, len(points), CHUNK):
        out[first : first + CHUNK] = _perlin(*points[first : first + CHUNK].T)
    return out


def _perlin(*point: np.ndarray) -> np.ndarray:
    lower = [np.floor(x) for x in point]
    x, y, z = (cell.astype(np.intp) & 255 for cell in lower)
    inside = [(at - cell).astype(np.float32) for at, cell in zip(point, lower, strict=True)]
    away = [(t, t - 1.0) for t in inside]  # from the lattice on both sides, along each axis
    fades = [t * t * t * (t * (6.0 * t - 15.0) + 10.0) for t in inside]
    weights = [(1.0 - fade, fade) for fade in fades]
    out = np.zeros(len(x), np.float32)
    for i in (0, 1):
        plane = PERMUTATION.take(x + i) + y
        for j in (0, 1):
            line = PERMUTATION.take(plane + j) + z
            weight = weights[0][i] * weights[1][j]
            for k in (0, 1):
                g = DIRECTIONS.take(line + k, axis=1)
                along = g[0] * away[0][i] + g[1] * away[1][j] + g[2] * away[2][k]
                out += weight * weights[2][k] * along
    return out
