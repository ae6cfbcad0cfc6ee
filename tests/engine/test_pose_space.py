# SPDX-License-Identifier: GPL-3.0-or-later
"""Weights and distances in pose space, as the add-on asks for them."""

from dataclasses import replace

import dynamorph
import numpy as np
import pytest
from dynamic_morph_targets.core.character import Character, Skeleton, Target, TargetSet
from dynamic_morph_targets.core.motion import posing
from dynamic_morph_targets.core.settings import Material


def hinged(*angles):
    """Local transforms (1 bone) of a hinge, (S, 1, 4, 4)."""
    out = np.tile(np.eye(4), (len(angles), 1, 1, 1))
    cosine, sine = np.cos(angles), np.sin(angles)
    out[:, 0, 1, 1], out[:, 0, 1, 2], out[:, 0, 2, 1], out[:, 0, 2, 2] = cosine, -sine, sine, cosine
    return out


def elbow(radius=0.0):
    """A character of one bone with targets at 0 and 1 rad; nothing else of it is needed here."""

    def target(name, angle, reach=0.0):
        return Target(name, np.zeros((0, 3)), ("bone",), hinged(angle)[0], np.eye(4), Material(), reach)

    empty = np.zeros(0)
    targets = (target("straight", 0.0), target("flexed", 1.0, radius))
    skeleton = Skeleton(("bone",), np.array([-1]), np.eye(4)[None])
    return Character("arm", *[empty] * 5, skeleton, (TargetSet("arm", targets, empty),))


def test_a_radius_fades_its_target_out():
    angles = np.array([1.0, 1.2, 1.3, 1.4, 1.9, 0.5])
    free = posing.pose_space(elbow()).weights(hinged(*angles))
    limited = posing.pose_space(elbow(0.4)).weights(hinged(*angles))
    np.testing.assert_allclose(free[:, 1], [1, 1, 1, 1, 1, 0.5], atol=1e-12)
    np.testing.assert_allclose(limited[:, 1], [1, 1, 0.5, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(limited.sum(axis=1), 1.0, atol=1e-12)


def test_distances_are_angles():
    space = posing.pose_space(elbow())
    np.testing.assert_allclose(space.distances(hinged(0.25, -0.5, 3.0)), [[0.25, 0.75], [0.5, 1.5], [3.0, 2.0]])


def test_a_negative_radius_is_refused():
    character = elbow()
    target_set = character.target_sets[0]
    bad = replace(target_set, targets=(target_set.targets[0], replace(target_set.targets[1], fade_out_angle=-1.0)))
    with pytest.raises(ValueError, match="radius must be"):
        posing.pose_space(replace(character, authored_sets=(bad,)))


def test_threads_cannot_be_fewer_than_none():
    with pytest.raises(ValueError, match="expected 0, for all cores"):
        dynamorph.set_threads(-1)
    dynamorph.set_threads(0)
