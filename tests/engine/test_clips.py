# SPDX-License-Identifier: GPL-3.0-or-later
"""A bake with fewer keys, and its point caches."""

from dataclasses import replace

import numpy as np
import pytest
from dynamic_morph_targets.core.motion import baked
from dynamic_morph_targets.core.motion.baked import Bake
from dynamic_morph_targets.core.result import keys
from dynamic_morph_targets.io import point_cache


def shot(frames=40, modes=6, targets=3, vertices=50, seed=0) -> tuple[Bake, np.ndarray]:
    """Smooth motion whose modes matter less and less, and the vertices that move."""
    random = np.random.default_rng(seed)
    time = np.linspace(0, 2 * np.pi, frames)[:, None]
    coordinates = 0.5 ** np.arange(modes) * np.sin(time * (1 + np.arange(modes)) + random.uniform(0, 6, modes))
    weights = random.dirichlet(np.ones(targets), frames)
    bake = Bake(
        np.arange(1, frames + 1),
        coordinates,
        weights,
        random.normal(size=(modes, vertices, 3)),
        np.r_[np.zeros((1, vertices, 3)), 0.1 * random.normal(size=(targets - 1, vertices, 3))],
        tuple("abcdef"[:targets]),
        0.1 * coordinates,
    )
    return bake, random.normal(size=(vertices, 3))


def surface(bake, vertices):
    return np.concatenate(list(baked.surfaces(bake, vertices, chunk=7)))


def test_surfaces_are_the_bake_s_own():
    bake, vertices = shot()
    np.testing.assert_allclose(
        surface(bake, vertices), [vertices + bake.displacement(k) for k in range(len(bake.frames))], atol=1e-12
    )


def test_fewer_keys_are_the_best_and_say_how_far_they_are_off():
    bake, vertices = shot()
    exact = surface(bake, 0.0).reshape(len(bake.frames), -1)
    errors = []
    for budget in (1, 2, 4, 8):
        fewer = keys.with_fewer_keys(bake, budget)
        error = baked.distance(bake, fewer, np.eye(3))
        assert len(fewer.modes) + len(fewer.residual_shapes) == budget
        off = np.linalg.norm(surface(bake, vertices) - surface(fewer, vertices), axis=2).max()
        assert error == pytest.approx(off, rel=1e-9)
        errors.append(error)
        both = np.vstack([exact, np.tensordot(bake.static, bake.modes, 1).reshape(exact.shape) + exact
                          - np.tensordot(bake.coordinates, bake.modes, 1).reshape(exact.shape)])  # fmt: skip
        left = np.linalg.svd(both, compute_uv=False)[budget:]
        missed = both - np.vstack([fewer.coordinates, fewer.static]) @ fewer.modes.reshape(budget, -1)
        assert np.linalg.norm(missed) == pytest.approx(np.linalg.norm(left), rel=1e-6, abs=1e-9)
    assert errors == sorted(errors, reverse=True)
    same = keys.with_fewer_keys(bake, 99)
    assert same is bake


@pytest.mark.parametrize("first, last", [(0, 39), (10, 25), (0, 12), (30, 39)])
def test_a_patch_takes_the_place_of_its_frames(first, last):
    """Whatever modes it has: where it is far from its seams it shows, and outside the bake is as it was."""
    bake, vertices = shot()
    other, _ = shot(modes=5, seed=3)
    patch = baked.at_rows(other, np.arange(first, last + 1))
    found, apart = keys.splice(bake, patch, 4.0, 2.0 * np.eye(3))
    np.testing.assert_array_equal(found.frames, bake.frames)
    size = np.abs(surface(bake, 0.0)).max()
    inner = np.arange(first + 4 * (first > 0), last + 1 - 4 * (last < 39))
    outer = np.r_[0:first, last + 1 : 40]
    for rows, source in ((inner, other), (outer, bake)):
        np.testing.assert_allclose(surface(found, vertices)[rows], surface(source, vertices)[rows], atol=1e-4 * size)
        static = [replace(each, coordinates=each.static) for each in (found, source)]
        np.testing.assert_allclose(
            surface(static[0], vertices)[rows], surface(static[1], vertices)[rows], atol=1e-4 * size
        )
    ends = [end for end in (first, last) if 0 < end < 39]
    off = np.linalg.norm(surface(bake, 0.0) - surface(other, 0.0), axis=2)[ends].max(initial=0.0)
    assert apart == pytest.approx(2.0 * off)


def test_a_patch_of_the_same_model_needs_no_more_keys():
    bake, vertices = shot()
    turned, _ = np.linalg.qr(np.random.default_rng(4).normal(size=(6, 6)))
    same = replace(
        bake,
        coordinates=bake.coordinates @ turned,
        static=bake.static @ turned,
        modes=np.tensordot(turned.T, bake.modes, 1),
    )
    found, apart = keys.splice(bake, baked.at_rows(same, np.arange(10, 20)), 2.0, np.eye(3))
    assert apart < 1e-9
    assert (
        len(found.modes) == len(bake.modes) + len(bake.residual_shapes) - 1
    )  # the neutral target has no residual shape
    np.testing.assert_allclose(surface(found, vertices), surface(bake, vertices), atol=1e-4)


def test_point_caches_are_read_back():
    bake, vertices = shot()
    exact = surface(bake, vertices).astype(np.float32)
    pc2 = b"".join(point_cache.point_cache(bake, vertices))
    assert pc2[:12] == b"POINTCACHE2\0"
    assert np.frombuffer(pc2, "<i4", 2, 12).tolist() == [1, len(vertices)]
    assert np.frombuffer(pc2, "<f4", 2, 20).tolist() == [1.0, 1.0]
    assert np.frombuffer(pc2, "<i4", 1, 28).tolist() == [len(exact)]
    np.testing.assert_array_equal(np.frombuffer(pc2, "<f4", offset=32).reshape(exact.shape), exact)
