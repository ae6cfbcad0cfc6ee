# SPDX-License-Identifier: GPL-3.0-or-later
"""A bake as the bytes of point caches: PC2 and raw arrays. Never touches bpy."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator

import numpy as np

from ..core.motion.baked import Bake, samples_per_frame, surfaces

ALIGNMENT = 64  # alignment of the arrays in a clip, so that a program can use them in place
PADDING_FIELD = 0xD935  # tag of a ZIP entry's extra field, as zipalign writes it


def point_cache(bake: Bake, vertices: np.ndarray) -> Iterator[bytes]:
    """The surface at each frame as PC2, the point cache of the Mesh Cache modifier: header, then frames."""
    yield b"POINTCACHE2\0"
    yield np.array([1, len(vertices)], "<i4").tobytes()
    yield np.array([bake.frames[0], 1.0 / samples_per_frame(bake)], "<f4").tobytes()
    yield np.array([len(bake.frames)], "<i4").tobytes()
    for chunk in surfaces(bake, vertices):
        yield chunk.astype("<f4").tobytes()


def raw(bake: Bake, vertices: np.ndarray, fps: float) -> bytes:
    """The bake as the bytes of a .npz of float32 arrays, which runtime/dynamorph.h plays. docs/file_format.md.

    The same bake makes the same bytes.
    """
    arrays = {
        "vertices": vertices,
        "modes": bake.modes,
        "residual_shapes": bake.residual_shapes,
        "coordinates": bake.coordinates,
        "weights": bake.weights,
        "static_coordinates": bake.static,
        "frames": bake.frames,
        "fps": [fps],
    }
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            npy = io.BytesIO()
            np.lib.format.write_array(npy, np.ascontiguousarray(array, "<f4"), version=(1, 0), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy")  # 1980, because the current time would change the bytes
            padding = -(buffer.tell() + 30 + len(entry.filename) + 4) % ALIGNMENT
            entry.extra = PADDING_FIELD.to_bytes(2, "little") + padding.to_bytes(2, "little") + bytes(padding)
            archive.writestr(entry, npy.getvalue())
    return buffer.getvalue()
