# SPDX-License-Identifier: GPL-3.0-or-later
"""The measures behind the figures, on shapes and signals whose answer is known."""

import measures
import numpy as np
import pytest
import scenes
from bl_ext.user_default.dynamic_morph_targets.core.geometry import vertex_areas


def sphere(center=(0.0, 0.0, 0.0), radius=1.0, rings=32, around=48):
    """A closed sphere: vertices (V, 3), outward triangles (T, 3)."""
    polar, angle = np.meshgrid(
        np.linspace(0, np.pi, rings + 1)[1:-1], np.arange(around) * 2 * np.pi / around, indexing="ij"
    )
    side = np.stack([np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar)], -1).reshape(-1, 3)
    vertices = np.concatenate([side, [[0, 0, 1], [0, 0, -1]]]) * radius + center
    index = np.arange(len(side)).reshape(rings - 1, around)
    after = np.roll(index, -1, axis=1)
    quads = np.stack([index[:-1], index[1:], after[1:], after[:-1]], -1).reshape(-1, 4)
    top = [(len(side), a, b) for a, b in zip(index[0], after[0], strict=True)]
    bottom = [(len(side) + 1, b, a) for a, b in zip(index[-1], after[-1], strict=True)]
    return vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]], top, bottom])


def tube(open_ends=False, **shape):
    """The tests' tube in triangles."""
    vertices, faces = scenes.tube(**shape)
    quads = np.array(faces[:-2])
    caps = [] if open_ends else [[cap[0], cap[k], cap[k + 1]] for cap in faces[-2:] for k in range(1, len(cap) - 1)]
    return vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]], np.array(caps, int).reshape(-1, 3)])


def folded(vertices, degrees, stretch):
    """Bend a tube along z into an arc that turns by `degrees` over the middle `stretch` meters, as skinning would."""
    _, _, z = vertices.T
    t = np.clip((z - z.max() / 2) / stretch + 0.5, 0, 1)
    turn = np.radians(degrees) * (t * t * (3 - 2 * t))
    lower, upper = vertices.copy(), vertices - [0, 0, z.max() / 2]
    angle = np.radians(degrees)
    rotation = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    weight = (turn / angle)[:, None]
    return (1 - weight) * lower + weight * (upper @ rotation.T + [0, 0, z.max() / 2])


def test_winding_number_counts_the_parts_around_a_point():
    vertices, triangles = sphere()
    points = np.array([[0.0, 0, 0], [0.3, 0.2, 0.5], [1.5, 0, 0]])
    assert measures.winding_numbers(points, vertices, triangles) == pytest.approx([1, 1, 0], abs=1e-9)
    twice = np.concatenate([vertices, 2 * vertices]), np.concatenate([triangles, triangles + len(vertices)])
    assert measures.winding_numbers(points, *twice) == pytest.approx([2, 2, 1], abs=1e-9)
    assert measures.winding_numbers(vertices[:5], vertices, triangles) == pytest.approx(np.full(5, 0.5), abs=0.05)


def test_a_convex_body_does_not_intersect_itself():
    assert measures.self_intersections(*sphere()) == measures.Intersections(0, 0.0)
    assert measures.self_intersections(*tube()) == measures.Intersections(0, 0.0)


@pytest.mark.parametrize("apart", [1.2, 1.6, 1.9])
def test_two_spheres_are_as_deep_in_each_other_as_geometry_says(apart):
    """The deepest point of one unit sphere lies 2 - apart inside the other."""
    vertices, triangles = sphere()
    other = sphere((0, 0, apart))[0]
    both = np.concatenate([vertices, other]), np.concatenate([triangles, triangles + len(vertices)])
    found = measures.self_intersections(*both)
    assert found.pairs >= 48
    assert found.depth == pytest.approx(2 - apart, abs=0.02)


def test_a_tube_folded_too_far_intersects_and_one_folded_gently_does_not():
    vertices, triangles = tube(rings=81, around=32)
    assert measures.self_intersections(folded(vertices, 60, 1.2), triangles).pairs == 0
    found = measures.self_intersections(folded(vertices, 150, 0.3), triangles)
    assert found.pairs > 50
    assert 0.05 < found.depth < 0.3


def test_depth_grows_with_the_fold():
    vertices, triangles = tube(rings=81, around=32)
    depths = [measures.self_intersections(folded(vertices, angle, 0.3), triangles).depth for angle in (110, 130, 150)]
    assert 0 < depths[0] < depths[1] < depths[2]


def test_volume_of_a_closed_and_of_an_open_surface():
    assert measures.volume(*sphere(radius=0.5, rings=128, around=128)) == pytest.approx(np.pi / 6, rel=2e-3)
    around, radius, length = 16, 0.3, 2.0
    prism = around / 2 * np.sin(2 * np.pi / around) * radius**2 * length
    away = np.array([3.0, 4.0, 5.0])
    vertices, triangles = tube()
    assert measures.volume(vertices + away, triangles) == pytest.approx(prism)
    vertices, triangles = tube(open_ends=True)
    assert sorted(map(len, measures.boundary_loops(triangles))) == [16, 16]
    assert measures.volume(vertices + away, triangles) == pytest.approx(prism)


def test_vertex_areas_add_up_to_the_surface():
    vertices, triangles = sphere(radius=2.0, rings=64, around=96)
    areas = vertex_areas(vertices, triangles)
    assert areas.shape == (len(vertices),) and areas.sum() == pytest.approx(16 * np.pi, rel=2e-3)


def test_region_keeps_whole_triangles():
    vertices, triangles = tube()
    lower = measures.region(triangles, vertices[:, 2] < 1.0 + 1e-9)
    assert measures.volume(vertices, lower) == pytest.approx(measures.volume(vertices, triangles) / 2)


def test_girth_is_the_circumference():
    vertices, triangles = tube(around=64)
    circumference = 64 * 2 * 0.3 * np.sin(np.pi / 64)
    assert measures.girth(vertices, triangles, [0, 0, 0.77], [0, 0, 1]) == pytest.approx(circumference)


def test_depth_of_a_patch_is_its_extent():
    vertices, _ = sphere(radius=0.2)
    assert measures.depth(vertices, vertices[:, 2] > 0, np.array([0.0, 0, 1])) == pytest.approx(0.2, abs=0.005)


def test_posed_is_linear_blend_skinning():
    vertices = np.array([[1.0, 0, 0], [0, 1, 0]])
    still = np.eye(4)[:3]
    raised = np.column_stack([np.eye(3), [0, 0, 2.0]])
    weights = np.array([[1.0, 0], [0.5, 0.5]])
    assert np.allclose(measures.posed(vertices, weights, np.array([still, raised])), [[1, 0, 0], [0, 1, 1]])


def test_patch_displacement_and_amplitude():
    motion = np.zeros((3, 4, 3))
    motion[:, :2, 2] = np.array([[1.0], [3.0], [2.0]])
    along = measures.patch_displacement(motion, np.array([0, 1]), np.array([0.0, 0, 1]))
    assert along.tolist() == [1, 3, 2]
    assert measures.amplitude(along) == 1


def test_spectrum_shows_a_sine_s_frequency_and_amplitude():
    time = np.arange(240) / 120
    signal = 5 + 0.02 * np.sin(2 * np.pi * 7.3 * time)
    assert measures.dominant_frequency(signal, 120) == pytest.approx(7.3, abs=0.05)
    frequencies, amplitudes = measures.spectrum(signal, 120)
    assert frequencies[-1] == 60 and len(frequencies) == len(amplitudes)
    assert amplitudes.max() == pytest.approx(0.02, rel=0.02)
