# SPDX-License-Identifier: GPL-3.0-or-later
"""What a weight of the Firmness map does: docs/theory.md."""

import numpy as np
import pytest
from dynamic_morph_targets.core import firmness

WEIGHTS = np.linspace(0.0, 1.0, 1001)


def test_three_weights_that_an_artist_knows():
    np.testing.assert_allclose(firmness.stiffness(np.array([0.0, 0.25, 0.7, 0.9, 1.0])), [0.25, 0.5, 2.0, 4.0, 4.0])
    assert firmness.stiffness(np.array([firmness.NEUTRAL])) == [1.0]  # to the last bit


def test_the_bones_take_over_where_the_stiffness_ends():
    np.testing.assert_array_equal(firmness.held(np.array([0.0, 0.5, 0.9, 1.0])), [0.0, 0.0, 0.0, 1.0])
    assert firmness.held(np.array([0.95])) == pytest.approx([0.5])


def test_soft_paint_frees_what_is_held_by_itself():
    np.testing.assert_array_equal(firmness.kept(np.array([0.0, 0.25, 0.5, 1.0])), [0.0, 0.5, 1.0, 1.0])


@pytest.mark.parametrize("rises", [firmness.stiffness, firmness.held, firmness.kept])
def test_firmness_rises_without_a_jump(rises):
    steps = np.diff(rises(WEIGHTS))
    assert (steps >= 0.0).all() and steps.max() < 0.05
