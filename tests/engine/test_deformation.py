# SPDX-License-Identifier: GPL-3.0-or-later
"""What displacements do to a skin, against the same measures in NumPy."""

import dynamorph
import numpy as np
import pytest
from scenes import tube

FRAMES, MODES = 11, 5


@pytest.fixture(scope="module")
def skin():
    """A rough tube of two meshes, the second a cuff of it, with a vertex on no triangle; the modes that displace it."""
    random = np.random.default_rng(3)
    vertices, faces = tube(30, 24)
    rest = np.vstack([vertices + 0.002 * random.standard_normal(vertices.shape), [[9.0, 9.0, 9.0]]])
    triangles = np.array([(face[0], face[k], face[k + 1]) for face in faces for k in range(1, len(face) - 1)])
    edges = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    in_cuff = rest[edges[:, 0], 2] > 1.7
    modes = 0.02 * np.sin(np.arange(1, MODES + 1)[:, None, None] * (rest[:, [2]] + random.uniform(0.0, 6.0, 3)))
    modes += 0.004 * random.standard_normal(modes.shape)
    return {
        "rest": rest,
        "triangles": triangles,
        "edges": [edges[~in_cuff], edges[in_cuff]],
        "coordinates": random.standard_normal((FRAMES, MODES)),
        "modes": modes,
    }


@pytest.fixture
def one_thread():
    dynamorph.set_threads(1)
    yield
    dynamorph.set_threads(0)


def quantile(values, weights, share):
    order = np.argsort(values)
    at = np.searchsorted(np.cumsum(weights[order]), share * weights.sum())
    return values[order][min(at, len(values) - 1)]


def oracle(rest, triangles, edges, u):
    """The distances (V,), and the measures of one frame in the order of NAMES."""

    def normals(points):
        a, b, c = points[triangles].swapaxes(0, 1)
        return np.cross(b - a, c - a)

    distance, at_rest = np.linalg.norm(u, axis=1), normals(rest)
    areas = np.linalg.norm(at_rest, axis=1) / 2.0
    around = np.bincount(triangles.ravel(), np.repeat(areas / 3.0, 3), len(rest))
    used, stretch = around > 0.0, []
    for ends in edges:
        lengths, moved = (np.linalg.norm(np.diff(x[ends], axis=1)[:, 0], axis=1) for x in (rest, rest + u))
        stretch.append([quantile(moved / lengths, lengths, share) for share in (0.001, 0.999)])
    flipped = areas[np.einsum("tc,tc->t", normals(rest + u), at_rest) < 0.0].sum() / areas.sum()
    percentile = quantile(distance[used], around[used], 0.999)
    return distance, (distance[used].max(), percentile, np.min(stretch), np.max(stretch), flipped)


NAMES = ("largest", "percentile", "shortest", "longest", "flipped")


def test_it_measures_what_numpy_does(skin):
    found = dynamorph.measure_deformation(**skin)
    displacements = np.tensordot(skin["coordinates"], skin["modes"], 1)
    parts = [oracle(skin["rest"], skin["triangles"], skin["edges"], u) for u in displacements]
    for name, expected in zip(NAMES, np.array([measures for _, measures in parts]).T, strict=True):
        np.testing.assert_allclose(getattr(found, name), expected, rtol=1e-12, err_msg=name)
        assert np.ptp(expected) > 0.0  # or nothing was compared
    np.testing.assert_allclose(found.farthest, np.max([distance for distance, _ in parts], axis=0), rtol=1e-12)
    assert found.farthest[-1] > 0.0


def test_displacements_are_modes_of_an_identity(skin):
    found = dynamorph.measure_deformation(**skin)
    displacements = np.tensordot(skin["coordinates"], skin["modes"], 1)
    same = dynamorph.measure_deformation(**skin | {"coordinates": np.eye(FRAMES), "modes": displacements})
    for name in (*NAMES, "farthest"):
        np.testing.assert_allclose(getattr(same, name), getattr(found, name), rtol=1e-12)


def test_other_threads_and_frames_do_not_change_a_bit(skin, one_thread):
    def measured(rows):
        found = dynamorph.measure_deformation(**skin | {"coordinates": skin["coordinates"][rows]})
        return np.array([getattr(found, name) for name in NAMES]), found.farthest

    frames, farthest = measured(slice(None))
    last, _ = measured(slice(FRAMES - 1, None))
    dynamorph.set_threads(0)
    frames_together, farthest_together = measured(slice(None))
    assert np.array_equal(frames, frames_together) and np.array_equal(farthest, farthest_together)
    assert np.array_equal(last, frames[:, -1:])


def test_a_skin_that_has_nothing_to_measure(skin):
    still = {"coordinates": np.zeros((2, MODES))}
    whole = dynamorph.measure_deformation(**skin | still)
    bare = dynamorph.measure_deformation(**skin | still | {"triangles": np.zeros((0, 3), int), "edges": []})
    for found in (whole, bare):
        assert [getattr(found, name).tolist() for name in NAMES] == [[0, 0], [0, 0], [1, 1], [1, 1], [0, 0]]
    none = dynamorph.measure_deformation(**skin | {"coordinates": np.zeros((0, MODES))})
    assert none.largest.shape == (0,) and not none.farthest.any()


def test_progress_is_reported_and_false_cancels(skin, one_thread):  # many would be done before the first report
    seen = []
    many = skin | {"coordinates": np.tile(skin["coordinates"], (200, 1))}
    dynamorph.measure_deformation(**many, progress=lambda fraction: seen.append(fraction) or True)
    assert seen == sorted(seen) and all(0.0 <= fraction <= 1.0 for fraction in seen)
    with pytest.raises(dynamorph.Cancelled):
        dynamorph.measure_deformation(**many, progress=lambda _: False)


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"edges": [np.array([[0, 0]])]}, "edges: expected finite lengths above zero"),
        ({"edges": [np.array([[0, 9999]])]}, "edges: expected vertex indices from 0"),
        ({"edges": [np.zeros((0, 2), int)]}, "edges: expected at least one"),
        ({"edges": [np.array([[0.0, 1.0]])]}, "edges: expected integers"),
        ({"modes": np.zeros((MODES, 3, 3))}, r"modes: expected shape \(5, 721, 3\), got \(5, 3, 3\)"),
        ({"coordinates": np.full((2, MODES), np.nan)}, "coordinates, modes: the displacements must be finite"),
    ],
)
def test_what_cannot_be_measured_is_refused(skin, changes, words):
    with pytest.raises(ValueError, match=words):
        dynamorph.measure_deformation(**skin | changes)
