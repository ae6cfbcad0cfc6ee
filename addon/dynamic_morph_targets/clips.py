# SPDX-License-Identifier: GPL-3.0-or-later
"""A bake with fewer keys, and as bytes for other programs. NumPy only, never bpy.

Surfaces are in the mesh object's local space, before skinning. A bake's surface = vertices + modes . coordinates +
details . weights.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from .scene_data import Bake

CHUNK = 64  # frames whose surfaces are made at once: bounds memory
ALIGNMENT = 64  # of the arrays in a clip, so that a program may use them where they are
PADDING_FIELD = 0xD935  # of a ZIP entry's extra fields, as zipalign writes it


def surfaces(bake: Bake, vertices: np.ndarray, chunk: int = CHUNK) -> Iterator[np.ndarray]:
    """The surface at each frame, a few frames (F', V, 3) at a time; vertices (V, 3): the Basis."""
    for first in range(0, len(bake.frames), chunk):
        frames = slice(first, first + chunk)
        yield vertices + _displaced(bake.coordinates[frames], bake.weights[frames], bake.modes, bake.details)


def digest(bake: Bake) -> str:
    """Identifies what was simulated: SHA-256 of all numbers of a bake."""
    found = hashlib.sha256()
    for name in ("frames", "coordinates", "weights", "modes", "details", "dry"):
        array = np.ascontiguousarray(getattr(bake, name))
        found.update(f"{name} {array.dtype.str} {array.shape}".encode())
        found.update(array.tobytes())
    return found.hexdigest()


def reach(bake: Bake, to_bind: np.ndarray) -> float:
    """How far a vertex is displaced from the Basis at most, in metres; to_bind (3, 3): local to metric space."""
    metric = replace(bake, modes=bake.modes @ to_bind.T, details=bake.details @ to_bind.T)
    return max(float(np.linalg.norm(chunk, axis=2).max(initial=0.0)) for chunk in surfaces(metric, 0.0))


def with_fewer_keys(bake: Bake, budget: int) -> tuple[Bake, float]:
    """The `budget` shapes that are best for this shot, and how far the surface is off at most, local units.

    Best: least squares over all frames and vertices, of the motion and of the targets' shapes without it (SVD). The
    details of the targets are then part of the modes.
    """
    shapes = np.concatenate([bake.modes, bake.details])
    shapes = shapes.reshape(len(shapes), -1)
    if budget >= len(shapes):
        return bake, 0.0
    # Orthonormal combinations of the shapes by their Gram matrix: there are few shapes and many vertices.
    squares, axes = np.linalg.eigh(shapes @ shapes.T)
    kept = squares > 1e-14 * squares[-1]
    lengths, axes = np.sqrt(squares[kept]), axes[:, kept]
    wet = np.hstack([bake.coordinates, bake.weights])
    dry = np.hstack([bake.dry, bake.weights])
    _, _, best = np.linalg.svd(np.vstack([wet, dry]) @ axes * lengths, full_matrices=False)
    best = best[:budget]
    onto = axes * lengths @ best.T  # (r + J, budget)
    modes = (best / lengths @ axes.T @ shapes).reshape(-1, *bake.modes.shape[1:])
    fewer = replace(
        bake,
        coordinates=wet @ onto,
        dry=dry @ onto,
        weights=np.zeros((len(bake.frames), 0)),
        modes=modes,
        details=np.zeros((0, *bake.modes.shape[1:])),
    )
    return fewer, distance(bake, fewer)


def distance(bake: Bake, other: Bake) -> float:
    """The largest distance of a vertex between two bakes of the same frames, local units."""
    pairs = zip(surfaces(bake, 0.0), surfaces(other, 0.0), strict=True)
    return max(float(np.linalg.norm(a - b, axis=2).max(initial=0.0)) for a, b in pairs)


def key_frames(bake: Bake, tolerance: float) -> np.ndarray:
    """Indices of the frames between which the surface may be interpolated, off by at most `tolerance`, local units.

    Each span is cut at the frame that is worst in it, until all are good enough (Douglas and Peucker 1973).
    """
    rows = np.hstack([bake.coordinates, bake.weights])
    kept, spans = {0, len(rows) - 1}, [(0, len(rows) - 1)]
    while spans:
        first, last = spans.pop()
        worst, off = _worst_between(bake, rows, first, last)
        if off > tolerance:
            kept.add(worst)
            spans += [(first, worst), (worst, last)]
    return np.array(sorted(kept))


def _worst_between(bake: Bake, rows: np.ndarray, first: int, last: int) -> tuple[int, float]:
    """The frame between two others that is farthest from their interpolation, and how far it is."""
    worst, off = first, 0.0
    for begin in range(first + 1, last, CHUNK):
        frames = np.arange(begin, min(begin + CHUNK, last))
        share = ((frames - first) / (last - first))[:, None]
        residual = rows[frames] - (1.0 - share) * rows[first] - share * rows[last]
        r = bake.coordinates.shape[1]
        moved = _displaced(residual[:, :r], residual[:, r:], bake.modes, bake.details)
        distances = np.linalg.norm(moved, axis=2).max(axis=1)
        if distances.max() > off:
            worst, off = int(frames[distances.argmax()]), float(distances.max())
    return worst, off


def _displaced(coordinates, weights, modes, details) -> np.ndarray:
    return np.tensordot(coordinates, modes, 1) + np.tensordot(weights, details, 1)


# Bytes -------------------------------------------------------------------------------------------------------------


def point_cache(bake: Bake, vertices: np.ndarray) -> Iterator[bytes]:
    """The surface at each frame as PC2, the point cache of the Mesh Cache modifier: header, then frames."""
    yield b"POINTCACHE2\0"
    yield np.array([1, len(vertices)], "<i4").tobytes()
    yield np.array([bake.frames[0], 1.0], "<f4").tobytes()
    yield np.array([len(bake.frames)], "<i4").tobytes()
    for chunk in surfaces(bake, vertices):
        yield chunk.astype("<f4").tobytes()


def motion_designer(bake: Bake, vertices: np.ndarray, fps: float) -> Iterator[bytes]:
    """The surface at each frame as MDD, the point cache of other programs: header, times in seconds, then frames."""
    yield np.array([len(bake.frames), len(vertices)], ">i4").tobytes()
    yield (bake.frames / fps).astype(">f4").tobytes()
    for chunk in surfaces(bake, vertices):
        yield chunk.astype(">f4").tobytes()


def raw(bake: Bake, vertices: np.ndarray, fps: float) -> bytes:
    """The bake as the bytes of a .npz of float32 arrays, which runtime/dynamorph.h plays. docs/file_format.md.

    The same bake makes the same bytes.
    """
    arrays = {
        "vertices": vertices,
        "modes": bake.modes,
        "details": bake.details,
        "coordinates": bake.coordinates,
        "weights": bake.weights,
        "dry": bake.dry,
        "frames": bake.frames,
        "fps": [fps],
    }
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            npy = io.BytesIO()
            np.lib.format.write_array(npy, np.ascontiguousarray(array, "<f4"), version=(1, 0), allow_pickle=False)
            entry = zipfile.ZipInfo(f"{name}.npy")  # of 1980: the time would make other bytes
            padding = -(buffer.tell() + 30 + len(entry.filename) + 4) % ALIGNMENT
            entry.extra = PADDING_FIELD.to_bytes(2, "little") + padding.to_bytes(2, "little") + bytes(padding)
            archive.writestr(entry, npy.getvalue())
    return buffer.getvalue()
