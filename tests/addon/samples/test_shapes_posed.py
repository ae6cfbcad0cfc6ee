# SPDX-License-Identifier: GPL-3.0-or-later
"""The measures behind docs/shapes.md, on shapes whose answer is known."""

import numpy as np
import pytest
import scenes
import shapes_posed
from PIL import Image
from test_measures import sphere, tube

SPACING = 0.1


def sheet(origin, across, along, counts):
    """A grid of so many cells, in triangles: vertices (V, 3), triangles (T, 3) with normals across x along."""
    i, j = np.meshgrid(*(np.arange(count + 1) for count in counts), indexing="ij")
    vertices = origin + i.reshape(-1, 1) * across + j.reshape(-1, 1) * along
    number = np.arange(len(vertices)).reshape(i.shape)
    a, b, c, d = (n.ravel() for n in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    return vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def joined(*parts):
    """Several surfaces as one."""
    before = np.cumsum([0, *(len(vertices) for vertices, _ in parts[:-1])])
    return (
        np.concatenate([vertices for vertices, _ in parts]),
        np.concatenate([triangles + first for (_, triangles), first in zip(parts, before, strict=True)]),
    )


def crossing(depth, slope=0.0, aside=0.01):
    """A floor that faces up, and a wall through it that faces +x; its lowest row is so deep below the floor, and the
    next one 0.06 above. `aside`: from the line in which they cross to the floor's next vertices behind the wall.
    """
    floor = sheet(np.array([-1.0, -1.0, 0.0]), np.array([SPACING, 0, 0]), np.array([0, SPACING, 0]), (20, 20))
    up = np.array([slope, 0.0, 1.0])
    wall = sheet(np.array([aside, -1.0, 0.0]) - depth * up, np.array([0, 2.0 / 21, 0]), (depth + 0.06) * up, (21, 6))
    return joined(floor, wall)


def pairs_of(points, triangles, far=0.0):
    return shapes_posed.intersecting_pairs(points, triangles, points, far)


def cross(first, second):
    """Whether an edge of the one triangle passes through the other (3, 3)."""
    for one, other in ((first, second), (second, first)):
        for k in range(3):
            ways = np.stack([other[1] - other[0], other[2] - other[0], one[k] - one[k - 2]], 1)
            u, v, t = np.linalg.solve(ways, one[k] - other[0])
            if u >= 0 and v >= 0 and u + v <= 1 and 0 <= t <= 1:
                return True
    return False


def test_pairs_of_triangles_in_all_places():
    rng = np.random.default_rng(3)
    points = (rng.uniform(size=(80, 1, 3)) + 0.3 * rng.normal(size=(80, 3, 3))).reshape(-1, 3)
    triangles = np.arange(240).reshape(-1, 3)
    expected = [
        (i, j) for i in range(80) for j in range(i + 1, 80) if cross(points[triangles[i]], points[triangles[j]])
    ]
    assert len(expected) > 100
    assert sorted(map(tuple, pairs_of(points, triangles).tolist())) == expected


def test_a_skin_that_does_not_cross_itself_has_no_pairs():
    assert len(pairs_of(*sphere())) == len(pairs_of(*tube())) == 0
    assert shapes_posed.deepest(*sphere(), np.empty((0, 2), int)) == 0.0


def test_pairs_that_are_near_each_other_at_rest_do_not_count():
    points, triangles = crossing(0.03)
    pairs = pairs_of(points, triangles)
    assert len(pairs) and (pairs[:, 0] < 800).all() and (pairs[:, 1] >= 800).all()  # of floor and wall
    rest = points.copy()
    rest[21 * 21 :, 2] += 5.0  # the wall is elsewhere
    each = np.full(len(triangles), 1.0)
    for far in (4.0, 4.0 * each):
        assert np.array_equal(shapes_posed.intersecting_pairs(points, triangles, rest, far), pairs)
    each[pairs[0, 1]] = 9.0
    assert len(shapes_posed.intersecting_pairs(points, triangles, rest, each)) < len(pairs)
    assert len(shapes_posed.intersecting_pairs(points, triangles, rest, 9.0)) == 0


@pytest.mark.parametrize("slope", [0.0, 1.0, 1.5])
@pytest.mark.parametrize("depth", [0.02, 0.05])
def test_depth_of_planes_that_cross(depth, slope):
    """However flat the wall is: straight through the floor, not along the triangles that cross."""
    points, triangles = crossing(depth, slope)
    assert shapes_posed.deepest(points, triangles, pairs_of(points, triangles)) == pytest.approx(depth, rel=1e-4)


def test_depth_counts_on_both_sides():
    """The floor's vertices are behind the wall by more than the wall's below the floor."""
    points, triangles = crossing(0.02, aside=0.07)
    assert shapes_posed.deepest(points, triangles, pairs_of(points, triangles)) == pytest.approx(0.07, rel=1e-4)


def test_depth_of_spheres():
    """Of the vertices whose triangles cross, the deepest one in the other sphere."""
    centers = np.zeros(3), np.array([0.3, 0.1, 1.85])
    points, triangles = joined(*(sphere(center, rings=40, around=60) for center in centers))
    pairs = pairs_of(points, triangles)
    corners = np.unique(triangles[pairs])
    inside = max(float((1.0 - np.linalg.norm(points[corners] - center, axis=1)).max()) for center in centers)
    assert inside > 0.01
    assert shapes_posed.deepest(points, triangles, pairs) == pytest.approx(inside, abs=0.003)  # spheres of facets


def cube():
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    return corners, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])


@pytest.mark.parametrize("away", [0.0, 100.0])
def test_volume_of_a_cube(away):
    """Closed, and without its lid; wherever it is."""
    points, triangles = cube()
    points = 2.0 * points + away
    lid = (points[triangles][:, :, 2] == away + 2.0).all(axis=1)
    assert lid.sum() == 2
    for keep in (np.full(12, True), ~lid):
        assert shapes_posed.volume_of(points, triangles, keep) == pytest.approx(8.0)
    assert shapes_posed.volume_of(points, triangles[:, ::-1], ~lid) == pytest.approx(8.0)


def test_volume_of_a_cylinder_that_is_cut():
    """Twice across: each of both rims is capped in its own plane."""
    points, triangles = tube()
    heights = np.unique(points[:, 2].round(6))
    low, high = heights[2], heights[-4]
    keep = ((points[triangles][:, :, 2] > low - 1e-4) & (points[triangles][:, :, 2] < high + 1e-4)).all(axis=1)
    around = int((np.abs(points[:, 2] - low) < 1e-4).sum())
    radius = np.linalg.norm(points[np.abs(points[:, 2] - low) < 1e-4][:, :2], axis=1).max()
    area = 0.5 * around * radius**2 * np.sin(2 * np.pi / around)
    assert 0 < keep.sum() < len(triangles)
    assert shapes_posed.volume_of(points, triangles, keep) == pytest.approx(area * (high - low))
    assert shapes_posed.volume_of(points + 7.0, triangles, keep) == pytest.approx(area * (high - low))


def test_volume_where_rims_touch():
    """Two cubes without their lids, whose rims meet in a corner: capped as one, it is still closed."""
    first, second = cube(), cube()
    points, triangles = joined(first, (second[0] + [1.0, 1.0, 0.0], second[1]))
    triangles = np.where(triangles == 8 + 1, 7, triangles)  # (1, 1, 1) of both
    keep = ~(points[triangles][:, :, 2] == 1.0).all(axis=1)
    assert keep.sum() == 20
    assert shapes_posed.volume_of(points, triangles, keep) == pytest.approx(2.0)
    assert shapes_posed.volume_of(points + 50.0, triangles, keep) == pytest.approx(2.0)


def test_a_picture_has_both_states(addon, tmp_path):
    vertices, faces = scenes.tube()
    triangles = tube()[1]
    path = tmp_path / "pictures" / "states.jpg"
    shapes_posed.side_by_side(path, {"thin": vertices * [0.4, 0.4, 1.0], "thick": vertices}, triangles, cell=(90, 90))
    with Image.open(path) as picture:
        pixels = np.asarray(picture.convert("L"), int)
    height, width = pixels.shape
    assert width > 180 and height > 90
    left, right = pixels[30:120, :90], pixels[30:120, 96:186]
    seen = [int((np.abs(half - half[2, 2]) > 12).sum()) for half in (left, right)]
    assert 0 < 2 * seen[0] < seen[1]


def test_a_picture_is_small(tmp_path):
    noise = np.random.default_rng(1).integers(0, 255, (1500, 1500, 3), np.uint8)
    with pytest.raises(ValueError, match="more than"):
        shapes_posed.save(Image.fromarray(noise), tmp_path / "noise.jpg")
