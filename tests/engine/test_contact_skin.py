# SPDX-License-Identifier: GPL-3.0-or-later
"""Which points of a skin can touch something, and what is reported of a shot."""

from __future__ import annotations

import numpy as np
import pytest
from dynamic_morph_targets.core.geometry import diagonal, is_closed, vertex_normals
from dynamic_morph_targets.core.motion.colliders import ColliderTrack, with_before
from dynamic_morph_targets.core.motion.contact import BITS, Touched, as_bits, collider_of, touched
from dynamic_morph_targets.core.motion.contact_points import SPACING, mixed, spread


class Collision:
    """Stands in for the one of a player: each sample is moved by the bone of its number."""

    def names(self, sample, collider, bones):
        return bones[sample], self.collider(collider)

    def collider(self, number):
        return ["Ball", "Bench"][number]


def sheet(sides: int, height: float) -> np.ndarray:
    x, y = np.meshgrid(np.linspace(0.0, 1.0, sides), np.linspace(0.0, 1.0, sides))
    return np.column_stack([x.ravel(), y.ravel(), np.full(sides**2, height)])


def test_points_are_spread_over_both_sides_of_something_thin():
    points = np.concatenate([sheet(60, 0.0), sheet(60, 0.001)])
    normals = np.repeat([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]], 3600, axis=0)
    found = spread(points, normals, 500)
    assert 300 <= len(found) <= 500
    assert abs((found < 3600).mean() - 0.5) < 0.05
    apart = np.linalg.norm(points[found][:, None] - points[found[found < 3600]], axis=2).min(axis=1)
    assert apart[found >= 3600].max() < 0.1
    from_all = np.linalg.norm(points[:3600, None] - points[found[found < 3600]], axis=2).min(axis=1)
    assert from_all.max() < 0.15


def test_few_points_are_all_taken():
    points = sheet(4, 0.0)
    assert spread(points, np.ones_like(points), 16).tolist() == list(range(16))


def test_no_part_of_a_skin_is_far_from_a_point_of_it():
    """Large faces and slivers, which share an edge."""
    rest = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.3, 1.0, 0.2], [1.0, -0.03, 0.0]])
    triangles = np.array([[0, 1, 2], [1, 0, 3]])
    corners, weights = mixed(rest, triangles)
    points = np.einsum("pk,pkc->pc", weights, rest[corners])
    assert (np.diff(weights, axis=1) <= 0.0).all()  # the nearest corner first
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    assert len(np.unique(points.round(9), axis=0)) == len(points)
    shares = np.random.default_rng(1).dirichlet(np.ones(3), 400)
    for triangle in triangles:
        apart = np.linalg.norm((shares @ rest[triangle])[:, None] - points, axis=2).min(axis=1)
        assert apart.max() < SPACING * diagonal(rest)


def test_a_fine_skin_is_its_vertices():
    rest = np.array([[0.0, 0.0, 0.0], [0.005, 0.0, 0.0], [0.0, 0.005, 0.0], [1.0, 1.0, 1.0]])
    corners, _ = mixed(rest, np.array([[0, 1, 2]]))
    assert corners[:, 0].tolist() == [0, 1, 2]


def test_normals_are_those_of_the_triangles_around():
    points = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]])
    normals = vertex_normals(points, np.array([[0, 1, 2], [0, 3, 1]]))
    assert normals[2].tolist() == [0.0, 0.0, 4.0]
    assert normals[3].tolist() == [0.0, 2.0, 0.0]
    assert normals[0].tolist() == normals[1].tolist() == [0.0, 2.0, 4.0]


def test_a_surface_is_closed_without_a_border():
    tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    assert is_closed(tetrahedron) and not is_closed(tetrahedron[1:])


def found_in(too_deep, collider, unusable=(), contacts=()) -> Touched:
    count = len(too_deep)
    steps = {
        "contacts": np.array(contacts or [0.0] * count),
        "penetration": np.linspace(0.0, 1e-4, count),
        "too_deep": np.array(too_deep, float),
        "too_deep_sample": np.where(np.array(too_deep) > 0.0, 1.0, -1.0),
        "too_deep_collider": np.array(collider, float),
        "unusable_colliders": np.array([as_bits(each) for each in unusable or [()] * count]),
    }
    return touched(np.arange(10.0, 10.0 + count), steps, Collision(), ["hip", "thigh.L"])


def test_the_deepest_place_is_named_with_its_frames():
    found = found_in([0.0, 0.01, 0.03, 0.02, 0.0, 0.02], [-1, 1, 1, 1, -1, 1])
    assert found == Touched(pytest.approx(1e-4), (("thigh.L", "Bench", 0.03, 11, 13),))


def test_another_collider_is_another_place_and_the_worst_is_first():
    found = found_in([0.01, 0.03, 0.02, 0.0], [0, 1, 0, -1])
    assert found.left_inside == (("thigh.L", "Bench", 0.03, 11, 11), ("thigh.L", "Ball", 0.02, 12, 12))
    assert [text.partition(" mm")[0][-2:] for text in found.texts] == ["30", "20"]


def test_the_frames_in_which_something_touches_are_known():
    assert found_in([0.0] * 6, [-1] * 6, contacts=[3.0, 0.0, 0.0, 1.0, 2.0, 0.0]).pressed == ((10, 10), (13, 14))


def test_without_such_a_place_there_is_only_the_penetration():
    assert found_in([0.0, 0.0], [-1, -1]) == Touched(pytest.approx(1e-4))


def test_each_collider_that_stops_nothing_is_named_with_its_frames():
    found = found_in([0.0] * 4, [-1] * 4, [[0], [0, 1], [0, BITS], [0]])
    assert found.unusable == (("Ball", 10, 13), ("Bench", 11, 11))
    assert found.texts == [
        "'Ball' does not stop anything at frames 10 to 13, because it is scaled to zero there",
        "'Bench' does not stop anything at frame 11, because it is scaled to zero there",
    ]


# Rooms ---------------------------------------------------------------------------------------------------------------

CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
FACES = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6],
                  [0, 6, 4], [1, 5, 7], [1, 7, 3]])  # fmt: skip


def room(world: np.ndarray, inward: bool) -> ColliderTrack:
    """Of 4 m, with a crate of half a meter in it, and a thousand crumbs. world (3, 4)."""
    crumbs = [0.001 * CUBE + [0.0, -1.5, 0.0015 * k] for k in range(1000)]
    points = np.concatenate([4.0 * CUBE, 0.5 * CUBE + [1.5, 0.0, 0.0], *crumbs])
    triangles = np.concatenate([FACES[:, ::-1] if inward else FACES, *(FACES + 8 * k for k in range(1, 1002))])
    return ColliderTrack(
        "Room", triangles, 1, False, points[None], with_before(np.zeros(1, int)), with_before(world[None]),
        np.zeros(1), np.ones(1, bool),
    )  # fmt: skip


@pytest.mark.parametrize("inward", [False, True])
@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.0), (2.0, 0.5, 1.0), (-1.0, 1.0, 1.0)])
def test_a_room_faces_the_skin_in_it_and_what_stands_there_does_not(inward, scale):
    track = room(np.column_stack([np.diag(scale), [5.0, 0.0, 0.0]]), inward)
    middle = np.array([0.0, 0.5, -1.72])  # its lowest points are a little in the floor
    skin = (np.random.default_rng(1).uniform(-0.3, 0.3, (500, 3)) + middle) * scale + [5.0, 0.0, 0.0]
    places = [[0.0, 0.5, 0.0], [1.5, 0.0, 0.0], [5.0, 0.0, 0.0], [0.0, 0.0, 2.1]]  # free, in the crate, outside
    distances = collider_of(track, track.shapes[0], skin).signed_distances(np.array(places))
    assert np.sign(distances).tolist() == [1.0, -1.0, -1.0, -1.0]


def test_what_is_only_partly_around_the_skin_is_no_room():
    track = room(np.eye(3, 4), inward=False)
    skin = 0.3 * CUBE + [1.9, 0.0, 0.0]
    outside, inside = collider_of(track, track.shapes[0], skin).signed_distances(np.array([[5.0, 0, 0], [0.0, 0.5, 0]]))
    assert outside > 0.0 > inside
