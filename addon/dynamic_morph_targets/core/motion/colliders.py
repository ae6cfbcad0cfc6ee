# SPDX-License-Identifier: GPL-3.0-or-later
"""What the skin touches, as plain data: surfaces that move, and perhaps deform, over the samples of a rig. NumPy
only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry import is_closed, loose_parts, winding_numbers
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


ASKED = 20  # points of the skin, by which a collider is found to be around it


def turned_to_face(track: ColliderTrack, skin: np.ndarray) -> np.ndarray | None:
    """The triangles (T, 3) of a closed collider in which the whole skin is, as in a room: those around it face it. None
    of any other. skin (V, 3): world space, at the first sample.
    """
    points, transform = track.shapes[track.shape[0, 1]], track.transforms[0, 1]
    world = track.points(0)
    if (skin.min(axis=0) < world.min(axis=0)).any() or (skin.max(axis=0) > world.max(axis=0)).any():
        return None
    if not is_closed(track.triangles) or not np.linalg.det(transform[:, :3]):
        return None
    asked = skin[np.linspace(0, len(skin) - 1, ASKED).astype(int)]
    asked = np.linalg.solve(transform[:, :3], (asked - transform[:, 3]).T).T
    triangles, part = track.triangles.copy(), loose_parts(points, track.triangles)[track.triangles[:, 0]]
    around = False
    for each in range(part.max() + 1):
        windings = winding_numbers(points, triangles[part == each], asked)
        if (np.abs(windings) < 0.5).any():
            continue
        around = True
        if windings.mean() > 0.0:
            triangles[part == each] = triangles[part == each][:, ::-1]
    return triangles if around else None
