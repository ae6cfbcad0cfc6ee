# SPDX-License-Identifier: GPL-3.0-or-later
"""The hard parts of a character: parts that one bone carries, and heads. NumPy only, never bpy."""

from __future__ import annotations

import itertools
import re

import numpy as np

from ..character import Skeleton
from ..geometry import connected_parts, determinant, loose_parts, triangle_areas, vertex_areas

RIGID = 0.99  # of its weight; a vertex that has more from one bone follows it rigidly
SMALL = 0.02  # of the area of the largest part
THIN = 0.12  # of its width: mean thickness of a part that bends with what it lies on
NEARLY_ALL = 0.95  # of its vertices; more of them follow the bone of a rigid part
COINCIDE = 1e-5  # of the body's size; points nearer than this are at one place
SOFT_SHARE = 0.12  # of the volume of its parts; a wholly hard character has less soft volume
HARD_SHARE = 0.98  # of the area; where more follows one bone each, nothing bends: of soft characters at most 0.65 does
MUCH = 0.1  # of the area; a bone that carries more of a hard thing is a part of it, as a lid is
HARD_NAMES = {"lid", "bottom", "hinge", "spring", "coil", "rotor", "propeller", "wheel", "gear", "piston", "door",
              "skull"}  # fmt: skip  # of bones; words
WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|[^\x00-\x7f]+|\d+")  # of a bone's name
NAMED_HEAD = re.compile(r"(?<![a-z])(head|skull)(?![a-z])|^頭", re.IGNORECASE)  # in MMD's models Japanese
NAMED_SHARE = (0.005, 0.6)  # of the area; a bone with such a name carries more if it is a head
SHARE = (0.03, 0.45)  # the same for a bone without such a name
PART_OF_HEAD = 0.4  # of a head's area, at most, belongs to one bone below it, such as an ear or a jaw
ELONGATED = 3.0  # largest ratio of the widths of a head
NECK = 0.85  # of a head's width; the ring where it begins is narrower
NECK_SHARE = 0.06  # of the area, at most, belongs to the bone of a neck
ON_NECK = 0.5  # how rigid the skin of a neck is
ALIKE = 0.15  # relative difference of a limb from the one on the other side, at most
WHOLLY = 0.8  # of its weight; skin with more from head bones is as rigid as bone


# Points and parts ----------------------------------------------------------------------------------------------------


def coincident(points: np.ndarray, distance: float) -> np.ndarray:
    """For each of the points (V, 3) the index (V,) of the first point at its place: within `distance`, or up to a few
    times as far.
    """
    if not len(points):
        return np.arange(0)
    scaled = (points - points.min(axis=0)) / (2.0 * max(distance, 1e-300))
    pairs = []
    # Two points within that distance are in one cell of at least one of these grids, which are shifted by half a cell.
    for shift in itertools.product((0.0, 0.5), repeat=3):
        cells = np.floor(scaled + shift).astype(np.int64)
        counts = cells.max(axis=0) + 1
        numbers = (cells[:, 0] * counts[1] + cells[:, 1]) * counts[2] + cells[:, 2]
        _, first, place = np.unique(numbers, return_index=True, return_inverse=True)
        pairs.append(np.column_stack([np.arange(len(points)), first[place.ravel()]]))
    pairs = np.concatenate(pairs)
    return connected_parts(pairs[pairs[:, 0] != pairs[:, 1]], len(points))


def part_volumes(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Labels (V,) of the loose parts of a mesh and the volume (P,) of each; an open part is closed from its center."""
    labels = loose_parts(points, triangles)
    count = labels.max(initial=-1) + 1
    sizes = np.bincount(labels, minlength=count)
    middles = np.column_stack([np.bincount(labels, axis, count) / sizes for axis in points.T])
    of_triangles = labels[triangles[:, 0]]
    corners = points[triangles] - middles[of_triangles][:, None]
    return labels, np.abs(np.bincount(of_triangles, determinant(corners) / 6.0, count))


def rigid_parts(labels: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether (P,) each part, except for a few stray vertices, is carried as a whole, and the bone (P,) that
    contributes most: by one bone, or with the same weights everywhere. labels (V,): the part's number; weights (V, B +
    1): the skin's.
    """
    count = labels.max(initial=-1) + 1
    sums = np.zeros((count, weights.shape[1]))
    np.add.at(sums, labels, weights)
    bones = sums.argmax(axis=1)
    sizes = np.bincount(labels, minlength=count)
    one = weights[np.arange(len(labels)), bones[labels]] > RIGID
    same = np.abs(weights - (sums / sizes[:, None])[labels]).max(axis=1, initial=0.0) < 1.0 - RIGID
    nearly_all = [np.bincount(labels, follows, count) >= NEARLY_ALL * sizes for follows in (one, same)]
    return nearly_all[0] | nearly_all[1], bones


def is_machine(skeleton: Skeleton, weights: np.ndarray, points: np.ndarray, triangles: np.ndarray) -> bool:
    """Whether nearly all of a skin follows one bone each, as of a chest with a lid, a drone or a spring, and either a
    bone that carries much of it is called as parts of such things are, or two do and no part follows both. Arguments
    as for `heads`.
    """
    areas = vertex_areas(points, triangles)
    carried = (weights[:, :-1] > RIGID).T @ areas / max(areas.sum(), 1e-300)
    if not carried.sum() > HARD_SHARE:
        return False
    much = [name for name, share in zip(skeleton.names, carried, strict=True) if share > MUCH]
    named = any(word.lower() in HARD_NAMES for name in much for word in WORD.findall(name))
    return named or (len(much) > 1 and bool(rigid_parts(loose_parts(points, triangles), weights)[0].all()))


def thin_parts(points: np.ndarray, triangles: np.ndarray, labels: np.ndarray, largest: float) -> np.ndarray:
    """Which (P,) of the loose parts are thin, and small beside a part of the area `largest`: cards of hair, feathers
    and scales, and straps. labels (V,): the part's number.
    """
    count = labels.max(initial=-1) + 1
    sizes = np.maximum(np.bincount(labels, minlength=count), 1)
    areas = np.bincount(labels[triangles[:, 0]], triangle_areas(points, triangles), count)
    middles = np.column_stack([np.bincount(labels, axis, count) / sizes for axis in points.T])
    off = points - middles[labels]
    corners = off[triangles]
    volumes = np.abs(np.bincount(labels[triangles[:, 0]], determinant(corners) / 6.0, count))
    spread = np.zeros((count, 3, 3))
    np.add.at(spread, labels, off[:, :, None] * off[:, None, :])
    width = np.sqrt(12.0 * np.linalg.eigvalsh(spread / sizes[:, None, None])[:, 1].clip(0.0))
    thickness = 2.0 * volumes / np.maximum(areas, 1e-300)
    return (areas < SMALL * largest) & (thickness < THIN * width)


def joined_to_soft(labels: np.ndarray, rigid: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Which (P,) rigid parts share points with soft ones, or with rigid ones that do.

    labels (V,); rigid (P,) bool; first (V,): see `coincident`.
    """
    cluster = connected_parts(np.column_stack([labels, labels[first]]), len(rigid))
    soft = np.zeros(len(rigid), bool)
    soft[cluster[~rigid]] = True
    return rigid & soft[cluster]


# Heads ---------------------------------------------------------------------------------------------------------------


def heads(skeleton: Skeleton, weights: np.ndarray, points: np.ndarray, triangles: np.ndarray) -> list[int]:
    """The bones that carry a head with everything attached to them: those with such a name, otherwise one that looks
    like a head.

    weights (V, B + 1); points (V, 3) bind space; triangles (T, 3).
    """
    areas = vertex_areas(points, triangles)
    below = skeleton.below
    share = weights[:, :-1].T @ areas / max(areas.sum(), 1e-300) @ below.T
    named = [bone for bone, name in enumerate(skeleton.names) if NAMED_HEAD.search(name.replace("_", " "))]
    named = [bone for bone in named if share[bone] > NAMED_SHARE[0]]
    if not named:
        return _looking_like_heads(skeleton, below, share, weights[:, :-1] @ below.T, points, triangles, areas)
    topmost = [bone for bone in named if not any(below[other, bone] for other in named if other != bone)]
    return [
        bone for bone in topmost if share[bone] <= NAMED_SHARE[1]
    ]  # a character that is almost only a head has none


def head_rigidity(
    skeleton: Skeleton, weights: np.ndarray, points: np.ndarray, triangles: np.ndarray, found: list[int]
) -> np.ndarray:
    """How rigid (V,) the heads on the bones `found` make the skin: 1 on them, less along the neck, 0 beyond. Arguments
    as for `heads`.
    """
    below, areas = skeleton.below, vertex_areas(points, triangles)
    share = weights[:, :-1].T @ areas / max(areas.sum(), 1e-300)
    of_bone = np.zeros(len(skeleton.names))
    for head in found:
        neck = skeleton.parents[head]
        others = share[below[neck] & ~below[head]].sum() if neck >= 0 else 1.0
        if others <= NECK_SHARE:
            of_bone[neck] = max(of_bone[neck], ON_NECK)
        of_bone[below[head]] = 1.0
    return (weights[:, :-1] @ of_bone / WHOLLY).clip(0.0, 1.0)


def _looking_like_heads(
    skeleton: Skeleton,
    below: np.ndarray,
    share: np.ndarray,
    carried: np.ndarray,
    points: np.ndarray,
    triangles: np.ndarray,
    areas: np.ndarray,
) -> list[int]:
    """The bone with the thickest compact blob at the end of a neck without a twin on the other side, if there is one.
    below: see `Skeleton.below`; share (B,), carried (V, B): of the area and of each vertex's weight, including
    descendants.
    """
    candidates = []
    smallest, largest = SHARE[0] * (1.0 - ALIKE), SHARE[1] * (1.0 + ALIKE)  # a twin may be a little smaller, or larger
    for bone in np.flatnonzero((share >= smallest) & (share <= largest) & (skeleton.parents >= 0)):
        widths = _widths(points, areas * (carried[:, bone] > 0.5))
        candidates.append((bone, widths))
    found = []
    for bone, widths in candidates:
        children = np.flatnonzero(skeleton.parents == bone)
        if not SHARE[0] <= share[bone] <= SHARE[1] or (share[children] > PART_OF_HEAD * share[bone]).any():
            continue
        twins = (
            not (below[bone, other] or below[other, bone])
            and abs(share[other] - share[bone]) < ALIKE * share[bone]
            and np.allclose(beside, widths, rtol=ALIKE)
            for other, beside in candidates
        )
        within = carried[:, bone][triangles] > 0.5
        ring = np.unique(triangles[within.any(axis=1) & ~within.all(axis=1)])
        neck = np.linalg.norm(_widths(points, np.bincount(ring, minlength=len(points)))[:2])
        width = np.linalg.norm(widths[1:])
        if widths[0] <= ELONGATED * widths[2] and len(ring) and neck <= NECK * width and not any(twins):
            found.append((width, bone))
    return [int(max(found)[1])] if found else []


def _widths(points: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """Standard deviations (3,) of points (V, 3) with weights (V,) along their principal axes, the largest first."""
    total = mass.sum()
    if total <= 0.0:
        return np.zeros(3)
    centered = points - mass @ points / total
    values = np.linalg.eigvalsh((centered * mass[:, None]).T @ centered / total)
    return np.sqrt(values[::-1].clip(0.0))
