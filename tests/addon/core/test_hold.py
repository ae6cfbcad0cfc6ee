# SPDX-License-Identifier: GPL-3.0-or-later
"""What the automatic hold makes of a body with a blunt bump and a long rod, which is thicker."""

import numpy as np
import pytest

dynamorph = pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
from bl_ext.user_default.dynamic_morph_targets.core import geometry  # noqa: E402
from bl_ext.user_default.dynamic_morph_targets.core.model import hold  # noqa: E402

SPACING, BUMP, ROD, HALF = 0.08, 0.2, 0.3, 0.8  # of the grid; radii of the bump and the rod; of the trunk


def body():
    """A cube with a half ball on its right side and a rod on its left one, as tets of a grid, and its surface."""
    centers = np.stack(np.meshgrid(*3 * [(np.arange(-37, 37) + 0.5) * SPACING], indexing="ij"), axis=-1)
    x, across = centers[..., 0], np.hypot(centers[..., 1], centers[..., 2])
    trunk = np.abs(centers).max(axis=-1) < HALF
    bump = (np.linalg.norm(centers - [HALF, 0.0, 0.0], axis=-1) < BUMP) & (x > 0.0)
    rod = (across < ROD) & (x < 0.0) & (x > -2.9)
    cells = np.argwhere(trunk | bump | rod)
    corners = np.array(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij")).reshape(3, 8).T
    numbers, of_cell = np.unique((cells[:, None] + corners).reshape(-1, 3), axis=0, return_inverse=True)
    of_cell = of_cell.reshape(-1, 8)
    kuhn = [[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7], [0, 5, 4, 7]]
    tets = of_cell[:, kuhn].reshape(-1, 4)
    nodes = (numbers - 37) * SPACING
    faces = tets[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return dynamorph.TetMesh(nodes, tets), nodes, faces[first[count == 1]]


@pytest.fixture(scope="module")
def held():
    """How firmly each node is held, and the nodes."""
    mesh, nodes, surface = body()
    zeros, bones = np.zeros(len(nodes)), np.ones((len(nodes), 1))
    depths = hold.depths(mesh, hold.BodyThickness.of(nodes, surface)).with_lent(mesh, bones)
    found = hold.hold(mesh, depths, zeros, zeros + 0.5, np.ones(len(mesh.tets)))
    return found, nodes


def test_a_blunt_bump_on_thick_tissue_is_soft(held):
    found, nodes = held
    assert np.median(found.phi[nodes[:, 0] > HALF + 0.5 * BUMP]) < 0.2


def test_a_rod_is_held_away_from_it(held):
    found, nodes = held
    assert found.phi[nodes[:, 0] < -2.5].min() > 0.9


@pytest.mark.fault("M21")
def test_cards_on_the_skin_are_not_its_thickness():
    """Feathers, fur, scales: open, small, each with a corner on the skin. Clothes are as large as the body, and count;
    so does what is closed.
    """
    mesh, nodes, surface = body()
    roots = nodes[np.unique(surface)[::3]]
    size = 0.05 * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.3], [0.3, 1.0, 0.0]])
    points = np.concatenate([nodes, (roots[:, None] + size).reshape(-1, 3)])
    cards = len(nodes) + np.arange(3 * len(roots)).reshape(-1, 3)
    both = np.concatenate([surface, cards])
    assert np.array_equal(geometry.without_cards(points, both), surface)
    shared = np.concatenate([surface, np.column_stack([np.unique(surface)[::3], cards[:, 1:]])])
    assert np.array_equal(geometry.without_cards(points, shared), surface)
    ball = cards[0, 0] + np.array([[0, 1, 2], [0, 2, 1]])
    for whole in (surface, np.concatenate([surface, ball]), surface[: len(surface) // 2]):
        assert np.array_equal(geometry.without_cards(points, whole), whole)


def test_the_thickness_that_is_lent_falls_off_with_the_distance(held):
    mesh, nodes, surface = body()
    own = dynamorph.Thickness(nodes, surface).at(nodes)[0][mesh.tets] @ hold.QUADRATURE.T
    x = nodes[mesh.tets, 0] @ hold.QUADRATURE.T
    bones = np.ones((len(nodes), 1))
    lent = hold.with_lent(mesh, bones, own)
    assert (lent >= own).all()
    assert (lent <= hold.LENT * own).all()
    far, near = x < -2.6, (x < -HALF - 0.2) & (x > -HALF - 0.4)
    assert lent[far].max() == pytest.approx(own[far].max(), rel=0.01)  # that of the rod
    assert (lent / own)[near].max() > 1.15


def test_no_thickness_is_lent_to_what_another_bone_moves():
    """An arm, and half of it on the border."""
    mesh, nodes, surface = body()
    own = dynamorph.Thickness(nodes, surface).at(nodes)[0][mesh.tets] @ hold.QUADRATURE.T
    arm = np.clip((-HALF - nodes[:, 0]) / 0.1, 0.0, 1.0)
    one, two = (hold.with_lent(mesh, bones, own) for bones in (np.ones((len(nodes), 1)), np.stack([arm, 1 - arm], 1)))
    x = nodes[mesh.tets, 0] @ hold.QUADRATURE.T
    beyond = x < -HALF - 0.2
    assert (two <= one).all()
    assert np.median(two[beyond] / own[beyond]) < 1.1
    np.testing.assert_array_equal(two[x > HALF], one[x > HALF])  # the bump
