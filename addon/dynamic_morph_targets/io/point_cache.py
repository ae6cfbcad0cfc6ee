# SPDX-License-Identifier: GPL-3.0-or-later
"""A bake as the bytes of a point cache (PC2). Never touches bpy."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..core.motion.baked import Bake, samples_per_frame, surfaces


def point_cache(bake: Bake, vertices: np.ndarray) -> Iterator[bytes]:
    """The surface at each frame as PC2, the point cache of the Mesh Cache modifier: header, then frames."""
    yield b"POINTCACHE2\0"
    yield np.array([1, len(vertices)], "<i4").tobytes()
    yield np.array([bake.frames[0], 1.0 / samples_per_frame(bake)], "<f4").tobytes()
    yield np.array([len(bake.frames)], "<i4").tobytes()
    for chunk in surfaces(bake, vertices):
        yield chunk.astype("<f4").tobytes()
