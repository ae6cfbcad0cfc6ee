# SPDX-License-Identifier: GPL-3.0-or-later
"""A bake as other keys. NumPy only, never bpy.

Surfaces are in the mesh object's local space, before skinning. A bake's surface = vertices + modes . coordinates +
residual_shapes . weights.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..geometry import smooth_step
from ..motion.baked import Bake, at_rows, displaced, distance, surfaces
from ..settings import OutputSettings

NOISE = 1e-5  # of the largest displacement by a shape; smaller errors come from keys in float32


# As other keys -----------------------------------------------------------------------------------------------------


def as_keys(bake: Bake, output: OutputSettings, to_bind: np.ndarray) -> tuple[Bake, float]:
    """The bake as the shape keys that `output` requires, and the largest error of the surface, meters; to_bind as for
    `baked.largest_displacement`. A point cache has keys only for what shows without it.
    """
    if output.format == "PC2":
        return targets_alone(bake), 0.0
    if not output.keys:
        return bake, 0.0
    fewer = with_fewer_keys(bake, output.keys)
    return fewer, distance(bake, fewer, to_bind)


def with_fewer_keys(bake: Bake, budget: int | None = None) -> Bake:
    """The `budget` shapes that are best for this shot; None: as few as reproduce all of it.

    Best means least squares over all frames and vertices, of the motion and of the targets' shapes without it (SVD).
    The residual shapes of the targets are then part of the modes.
    """
    shapes = np.concatenate([bake.modes, bake.residual_shapes])
    if (budget is not None and budget >= len(shapes)) or not shapes.any():
        return bake
    shapes = shapes.reshape(len(shapes), -1)
    # Orthonormal combinations of the shapes by their Gram matrix: there are few shapes and many vertices.
    squares, axes = np.linalg.eigh(shapes @ shapes.T)
    kept = squares > 1e-14 * squares[-1]
    lengths, axes = np.sqrt(squares[kept]), axes[:, kept]
    dynamic = np.hstack([bake.coordinates, bake.weights])
    static = np.hstack([bake.static, bake.weights])
    _, _, best = np.linalg.svd(np.vstack([dynamic, static]) @ axes * lengths, full_matrices=False)
    best = best[:budget]
    onto = axes * lengths @ best.T  # (r + J, budget)
    modes = best / lengths @ axes.T @ shapes
    coordinates, without = dynamic @ onto, static @ onto
    if budget is None:
        reached = np.abs(np.vstack([coordinates, without])).max(axis=0) * np.abs(modes).max(axis=1)
        seen = reached > NOISE * reached.max()
        coordinates, without, modes = coordinates[:, seen], without[:, seen], modes[seen]
    return replace(
        bake,
        coordinates=coordinates,
        static=without,
        weights=np.zeros((len(bake.frames), 0)),
        modes=modes.reshape(-1, *bake.modes.shape[1:]),
        residual_shapes=np.zeros((0, *bake.modes.shape[1:])),
        node_modes=None,
        key_names=(),
    )


def united(bakes: list[Bake], to_body: list[np.ndarray]) -> Bake:
    """One bake of the meshes of a body, which have the same frames, mesh after mesh; to_body (3, 3) each: for
    displacements in a mesh's local space. Keys with the same name are merged; their values are the same in every mesh.
    """
    names = list(dict.fromkeys(name for bake in bakes for name in bake.key_names))
    counts = [bake.modes.shape[1] for bake in bakes]
    modes, rows = np.zeros((len(names), sum(counts), 3)), np.zeros((2, len(bakes[0].frames), len(names)))
    for bake, turn, end in zip(bakes, to_body, np.cumsum(counts), strict=True):
        places = [names.index(name) for name in bake.key_names]
        modes[places, end - bake.modes.shape[1] : end] = bake.modes @ turn.T
        rows[:, :, places] = bake.coordinates, bake.static
    residual_shapes = np.zeros((0, sum(counts), 3))
    return replace(
        bakes[0],
        coordinates=rows[0],
        static=rows[1],
        modes=modes,
        residual_shapes=residual_shapes,
        key_names=tuple(names),
    )


def splice(bake: Bake, patch: Bake, fade: float, to_bind: np.ndarray) -> tuple[Bake, float]:
    """A bake whose frames between the first and the last of `patch` are those of the patch, and the largest distance of
    the two where they meet, meters.

    The patch fades in and out within `fade` frames, at most a quarter of it, where the bake also has frames. Both are
    of one mesh; their modes may differ. Residual shapes become modes. to_bind: as for `largest_displacement`.
    """
    (begin, end), (first, last) = bake.frames[[0, -1]], patch.frames[[0, -1]]
    frames = np.concatenate([bake.frames[bake.frames < first], patch.frames, bake.frames[bake.frames > last]])
    inside = (frames >= first) & (frames <= last)
    share = inside.astype(float)  # of the patch
    fade = min(fade, (last - first) / 4.0)
    if fade and begin < first < end:
        share *= smooth_step((frames - first) / min(fade, end - first))
    if fade and begin < last < end:
        share *= smooth_step((last - frames) / min(fade, last - begin))
    share[~inside] = 0.0

    def mixed(of_bake: np.ndarray, of_patch: np.ndarray) -> np.ndarray:
        old = np.column_stack([np.interp(frames, bake.frames, column) for column in of_bake.T])
        new = np.zeros((len(frames), of_patch.shape[1]))
        new[inside] = of_patch
        return np.hstack([(1.0 - share)[:, None] * old, share[:, None] * new])

    both = Bake(
        frames=frames,
        coordinates=mixed(np.hstack([bake.coordinates, bake.weights]), np.hstack([patch.coordinates, patch.weights])),
        weights=np.zeros((len(frames), 0)),
        modes=np.concatenate([bake.modes, bake.residual_shapes, patch.modes, patch.residual_shapes]),
        residual_shapes=np.zeros((0, *bake.modes.shape[1:])),
        target_names=patch.target_names,
        static=mixed(np.hstack([bake.static, bake.weights]), np.hstack([patch.static, patch.weights])),
    )
    return with_fewer_keys(both), _apart(bake, patch, to_bind)


def _apart(bake: Bake, patch: Bake, to_bind: np.ndarray) -> float:
    """The largest distance between a bake and those ends of a patch that are within it, meters."""
    within = (patch.frames[[0, -1]] > bake.frames[0]) & (patch.frames[[0, -1]] < bake.frames[-1])
    ends = np.array([0, len(patch.frames) - 1])[within]
    if not len(ends):
        return 0.0
    rows = np.hstack([bake.coordinates, bake.weights])
    at = np.column_stack([np.interp(patch.frames[ends], bake.frames, column) for column in rows.T])
    r = bake.coordinates.shape[1]
    moved = displaced(at[:, :r], at[:, r:], bake.modes, bake.residual_shapes)
    off = (moved - next(surfaces(at_rows(patch, ends), 0.0))) @ to_bind.T
    return float(np.linalg.norm(off, axis=2).max())


def targets_alone(bake: Bake) -> Bake:
    """The targets' shapes as residual shapes, without motion. If the bake does not distinguish them, their blend."""
    no_coordinates = np.zeros((len(bake.frames), 0))
    if not bake.weights.shape[1]:
        still = with_fewer_keys(replace(bake, coordinates=bake.static))
        residual_shapes, weights = still.modes, still.static
        names = tuple(f"Dynamorph Shape {k + 1:02d}" for k in range(len(residual_shapes)))
    else:
        onto_modes, *_ = np.linalg.lstsq(bake.weights, bake.static, rcond=None)
        residual_shapes, weights = np.tensordot(onto_modes, bake.modes, 1) + bake.residual_shapes, bake.weights
        names = tuple(f"Dynamorph Target {name}" for name in bake.target_names)
    modes = np.zeros((0, *bake.modes.shape[1:]))
    return replace(
        bake,
        coordinates=no_coordinates,
        static=no_coordinates,
        weights=weights,
        modes=modes,
        residual_shapes=residual_shapes,
        key_names=names,
    )
