# SPDX-License-Identifier: GPL-3.0-or-later
"""The arithmetic of transforms that every module shares."""

import numpy as np
import pytest
from dynamic_morph_targets.core.character import Skeleton
from dynamic_morph_targets.core.geometry import determinant, inverse


@pytest.fixture
def affine():
    transforms = np.tile(np.eye(4), (5, 7, 1, 1))
    transforms[..., :3, :] += np.random.default_rng(2).normal(0, 0.5, (5, 7, 3, 4))
    return transforms


def test_inverse_and_determinant_are_numpy_s(affine):
    for transforms in (affine, affine[..., :3, :3]):
        identity = np.broadcast_to(np.eye(transforms.shape[-1]), transforms.shape)
        np.testing.assert_allclose(inverse(transforms) @ transforms, identity, atol=1e-10)
    np.testing.assert_allclose(determinant(affine[..., :3, :3]), np.linalg.det(affine[..., :3, :3]), rtol=1e-10)


def test_local_transforms_are_the_identity_at_rest_and_invert_pose(affine):
    rest = affine[0, :3]
    skeleton = Skeleton(("root", "middle", "tip"), np.array([-1, 0, 1]), rest)
    np.testing.assert_allclose(skeleton.local_transforms(rest), np.tile(np.eye(4), (3, 1, 1)), atol=1e-9)
    local = affine[1:, :3]
    np.testing.assert_allclose(skeleton.local_transforms(skeleton.pose(local)), local, atol=1e-8)


def test_only_the_local_transforms_that_are_asked_for():
    rng = np.random.default_rng(3)
    rest, pose = np.tile(np.eye(4), (3, 1, 1)), np.tile(np.eye(4), (2, 3, 1, 1))
    rest[:, :3] += 0.3 * rng.normal(size=(3, 3, 4))
    pose[:, :, :3] += 0.3 * rng.normal(size=(2, 3, 3, 4))
    skeleton = Skeleton(("root", "upper", "lower"), np.array([-1, 0, 1]), rest)
    some, every = skeleton.local_transforms(pose, [0, 2]), skeleton.local_transforms(pose)
    np.testing.assert_allclose(some[:, [0, 2]], every[:, [0, 2]], atol=1e-12)
    np.testing.assert_array_equal(some[:, 1], [np.eye(4)] * 2)
