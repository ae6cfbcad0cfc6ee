# SPDX-License-Identifier: GPL-3.0-or-later
"""Colliders over the samples of a shot are where Blender has them, and know where they were before."""

from __future__ import annotations

import numpy as np
from dynamic_morph_targets.core.motion.colliders import ColliderTrack, with_before

WEDGE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]])
TRIANGLES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


def turned(angles, scale=(1.0, 1.0, 1.0)) -> np.ndarray:
    """World transforms (S, 4, 4) that turn about z, of an object of that scale."""
    worlds = np.tile(np.eye(4), (len(angles), 1, 1))
    cos, sin = np.cos(angles), np.sin(angles)
    worlds[:, :2, :2] = np.array([[cos, -sin], [sin, cos]]).transpose(2, 0, 1)
    worlds[:, :3, :3] *= np.array(scale)
    worlds[:, 0, 3] = np.arange(len(angles))
    return worlds


def track(worlds, shapes=WEDGE[None], shape=None) -> ColliderTrack:
    count = len(worlds)
    return ColliderTrack(
        "Wedge", TRIANGLES, 7, False, shapes, with_before(np.zeros(count, int) if shape is None else np.array(shape)),
        with_before(worlds[:, :3]), np.arange(count) / 10.0, np.ones(count, bool),
    )  # fmt: skip


def test_it_is_where_its_object_is():
    worlds = turned(np.linspace(0.0, 5.0, 4), (0.5, -2.0, 3.0))
    for sample, world in enumerate(worlds):
        assert np.allclose(track(worlds).points(sample), WEDGE @ world[:3, :3].T + world[:3, 3])


def test_a_deforming_mesh_has_the_shape_of_each_sample():
    shapes = np.array([WEDGE, 1.1 * WEDGE])
    found = track(turned(np.zeros(4)), shapes, [0, 1, 1, 0])
    assert found.shape.tolist() == [[0, 0], [0, 1], [1, 1], [1, 0]]
    assert np.allclose(found.points(1)[1], [2.1, 0.0, 0.0])


def test_each_sample_has_what_was_before_also_in_a_slice():
    found = track(turned([0.0, 0.1, 0.2, 0.3]))
    part = found[2:]
    assert np.array_equal(part.points(0, side=0), found.points(1))
    assert np.array_equal(found.points(0, side=0), found.points(0))


def test_joined_samples_keep_their_shapes():
    first, second = track(turned([0.0, 0.1])), track(turned([0.2, 0.3]), 2.0 * WEDGE[None])
    joined = first.concatenate(second)
    assert len(joined.friction) == 4
    assert [joined.points(sample).tolist() for sample in range(4)] == [
        each.points(sample).tolist() for each in (first, second) for sample in range(2)
    ]


def test_what_is_kept_still_does_not_move():
    found = track(turned([0.0, 0.1, 0.2]))[1:].still(3)
    for sample in range(3):
        for side in (0, 1):
            assert np.array_equal(found.points(sample, side), track(turned([0.0, 0.1, 0.2])).points(1))
