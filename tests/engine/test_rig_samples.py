# SPDX-License-Identifier: GPL-3.0-or-later
"""What is known beside a rig is sliced, joined and kept still together with it."""

from __future__ import annotations

import numpy as np
import pytest
from dynamic_morph_targets.core.motion.rig_samples import ForceField, PosedNodes, RigSamples

POINTS = np.array([[0.0, 0.0, 1.0], [0.5, 0.0, 0.0]])


def numbered(count: int, first: float = 0.0) -> RigSamples:
    """Samples of a rig of two bones, a wind and three nodes, each numbered by its sample."""
    times = first + np.arange(count, dtype=float)
    world = np.tile(np.eye(4), (count, 1, 1))
    world[:, 0, 3] = times
    wind = ForceField("WIND", False, 0.0, 0.0, 100.0, world, times)
    nodes = PosedNodes(np.zeros((3, 3)), 0.01, np.tile(times.astype(np.float32)[:, None, None, None], (1, 4, 3, 3)))
    return RigSamples(np.tile(world[:, None], (1, 2, 1, 1)), world, world, (wind, nodes), nodes[:1])


def times_of(samples: RigSamples) -> list[list[float]]:
    """Which samples each part has."""
    (wind,), nodes = samples.fields, samples.nodes
    return [list(part) for part in (samples.pose[:, 1, 0, 3], samples.rig_world[:, 0, 3], samples.object_world[:, 0, 3],
                                    wind.world[:, 0, 3], wind.strength, nodes.points[:, 2, 1, 0])]  # fmt: skip


@pytest.mark.parametrize("taken", [slice(2, 5), slice(None, None, 3), slice(4, None), slice(0, 0)])
def test_a_slice_takes_the_same_samples_of_everything(taken):
    expected = list(np.arange(7.0)[taken])
    assert times_of(numbered(7)[taken]) == [expected] * 6
    assert len(numbered(7)[taken]) == len(expected)


def test_joined_samples_follow_each_other_in_everything():
    assert times_of(numbered(2).concatenate(numbered(3, 10.0))) == [[0.0, 1.0, 10.0, 11.0, 12.0]] * 6


def test_samples_of_rigs_with_other_fields_are_not_joined():
    with pytest.raises(ValueError, match="shorter"):
        numbered(2).concatenate(RigSamples(numbered(1).pose, *[np.eye(4)[None]] * 2))


def test_a_rig_that_is_moved_leaves_the_wind_where_it_is():
    transforms = np.tile(np.eye(4), (3, 1, 1))
    transforms[:, 2, 3] = [0.0, 1.0, 2.0]
    moved = numbered(4, 5.0).moved(transforms)
    assert times_of(moved) == [[5.0] * 3] * 6
    assert list(moved.rig_world[:, 2, 3]) == list(moved.object_world[:, 2, 3]) == [0.0, 1.0, 2.0]
    assert np.array_equal(moved.fields[0].pull(2, POINTS), numbered(4, 5.0).fields[0].pull(0, POINTS))
    assert moved.target_nodes is not None
