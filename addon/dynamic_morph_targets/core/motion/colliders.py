# SPDX-License-Identifier: GPL-3.0-or-later
"""What the skin touches, as plain data: surfaces that move, and perhaps deform, over the samples of a rig. NumPy
only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .rig_samples import RigSamples, Track


@dataclass(frozen=True)
class ColliderTrack(Track):
    """A surface that stops the skin, at S sample times, and before each of them at the one before it, so that a slice
    knows where its motion begins. At the first sample of all it stands still.

    name: of its object. triangles (T, 3); topology: tells its faces from others. one_sided: it stops what comes from
    the side of its normals. shapes (K, V, 3): those that it takes, local space; shape (S, 2): which, before and at each
    sample; transforms (S, 2, 3, 4): from there to world space, meters. friction (S,): Coulomb's coefficient. active
    (S,): whether it stops anything on the way to the sample.
    """

    SAMPLED = ("shape", "transforms", "friction", "active")
    name: str
    triangles: np.ndarray
    topology: int
    one_sided: bool
    shapes: np.ndarray
    shape: np.ndarray
    transforms: np.ndarray
    friction: np.ndarray
    active: np.ndarray

    def concatenate(self, other: ColliderTrack) -> ColliderTrack:
        joined = super().concatenate(replace(other, shape=other.shape + len(self.shapes)))
        return replace(joined, shapes=np.concatenate([self.shapes, other.shapes]))

    def still(self, count: int) -> ColliderTrack:
        first = self[:1]
        shape, transforms = (np.repeat(values[:, 1:], 2, axis=1) for values in (first.shape, first.transforms))
        return super(ColliderTrack, replace(first, shape=shape, transforms=transforms)).still(count)

    @property
    def nbytes(self) -> int:
        """Approximate bytes of what grows with the number of samples."""
        return self.shapes.nbytes if len(self.shapes) > 1 else 0

    def points(self, sample: int, side: int = 1) -> np.ndarray:
        """The vertices (V, 3) in world space; side: 1 at the sample, 0 before."""
        transform = self.transforms[sample, side]
        return self.shapes[self.shape[sample, side]] @ transform[:, :3].T + transform[:, 3]


def with_before(values: np.ndarray) -> np.ndarray:
    """(S, ...) -> (S, 2, ...): before and at each sample."""
    return np.stack([np.concatenate([values[:1], values[:-1]]), values], axis=1)


def colliders_of(rig: RigSamples) -> tuple[ColliderTrack, ...]:
    """What stops the skin."""
    return tuple(track for track in rig.tracks if isinstance(track, ColliderTrack))
