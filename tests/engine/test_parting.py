# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts that touch move separately, parts without pins stay with their bones, attachments with and without a cage."""

from dataclasses import replace

import dynamorph
import numpy as np
import pytest
import scenes
from dynamic_morph_targets.core.character import Character, Skeleton, Target, TargetSet
from dynamic_morph_targets.core.model.build import MESH_DEPENDENCIES, build, build_cage, has_cage, stale_reasons
from dynamic_morph_targets.core.settings import Material, ModelSettings

BONES = np.tile(np.eye(3, 4), (2, 1, 1))


def skin_of(rings):
    """Rings (R, A, 3) of points, joined and closed at both ends by their middles: vertices, outward triangles."""
    index = np.arange(rings[..., 0].size).reshape(rings.shape[:2])
    after, ends = np.roll(index, -1, axis=1), index.size + np.array([[0], [1]])
    middles = [np.broadcast_to(end, index[0].shape) for end in ends]
    corners = [
        (index[:-1], after[:-1], index[1:]),
        (after[:-1], after[1:], index[1:]),
        (middles[0], after[0], index[0]),
        (middles[1], index[-1], after[-1]),
    ]
    triangles = np.concatenate([np.stack(triple, -1).reshape(-1, 3) for triple in corners])
    vertices = np.concatenate([rings.reshape(-1, 3), rings[[0, -1]].mean(axis=1)])
    volume = np.linalg.det(vertices[triangles]).sum()
    return vertices, triangles if volume > 0 else triangles[:, ::-1]


def tube(line, radius, around=12):
    """A tube of round section around points (n, 3) of a line in the x-z plane."""
    line = np.asarray(line, float)
    side = np.cross([0.0, 1.0, 0.0], np.gradient(line, axis=0))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    angle = np.arange(around)[:, None] * 2 * np.pi / around
    return skin_of(line[:, None] + radius * (np.cos(angle) * side[:, None] + np.sin(angle) * [0.0, 1.0, 0.0]))


def ball(radius, center=(0.0, 0.0, 0.0)):
    """Of 222 vertices."""
    latitude, longitude = np.meshgrid(np.arange(1, 12) * np.pi / 12, np.arange(20) * np.pi / 10, indexing="ij")
    ring = np.sin(latitude)
    points = np.stack([ring * np.cos(longitude), ring * np.sin(longitude), np.cos(latitude)], -1)
    vertices, triangles = skin_of(radius * points)
    return vertices + center, triangles


def join(*skins):
    first = np.cumsum([0] + [len(vertices) for vertices, _ in skins])
    triangles = [triangles + start for (_, triangles), start in zip(skins, first, strict=False)]
    return np.concatenate([vertices for vertices, _ in skins]), np.concatenate(triangles)


def fork(gap):
    """A U of 10 cm thick prongs along x, held at its bend."""
    bend = (gap + 0.1) / 2
    reach, turn = np.linspace(1.0, 0.0, 40)[:-1], np.linspace(0.0, np.pi, 9)
    lower = np.stack([reach, 0 * reach, 0 * reach - bend], -1)
    around = np.stack([-0.12 * np.sin(turn), 0 * turn, -bend * np.cos(turn)], -1)
    return tube(np.concatenate([lower, around, (lower * [1, 1, -1])[::-1]]), 0.05)


def character(skin, soft, cage_index=None, **settings):
    """A skin on one bone; soft(vertices) says where it is free."""
    vertices, triangles = skin
    every, at_rest = np.ones(len(vertices)), np.eye(4)[None]
    neutral = Target("Neutral", 0 * vertices, (), at_rest, np.eye(4), Material(stiffness=2e4, poisson=0.3))
    return Character(
        name="Fork",
        vertices=vertices,
        triangles=triangles.astype(np.int32),
        to_bind=np.eye(3),
        weights=np.tile([1.0, 0.0], (len(vertices), 1)),
        rigidity=1.0 - soft(vertices),
        bone_segments=np.full((1, 2, 3), 50.0),
        skeleton=Skeleton(("root",), np.array([-1]), at_rest),
        authored_sets=(TargetSet("Fork", (neutral,), every),),
        settings=ModelSettings(
            **scenes.PINNED | {"material_model": "LINEAR", "solver": "FULL", "cage_nodes": 500, "modes": 8, **settings}
        ),
        cage_index=cage_index,
    )


def held_at_bend(gap, **settings):
    return character(fork(gap), lambda vertices: vertices[:, 0] > 0.02, **settings)


def pushed(model, of, where):
    """Displacement (V, 3) by 1 N sideways (y), spread over the vertices `where`."""
    engine = model.engine(of)
    simulation = dynamorph.Simulation(engine, 1.0, tolerance=1e-10, max_iterations=100)
    force = np.zeros_like(of.vertices)
    force[where, 1] = 1.0 / where.sum()
    coordinates, report = simulation.solve_static(BONES, np.ones(1), model.on_nodes(force))
    assert report.converged
    return model.surface(engine.displacement(coordinates))


# Parts that touch --------------------------------------------------------------------------------------------------


class NoCut:
    """Stands in for `dynamorph.MeshCut`: finds nothing that touches."""

    def __init__(self, mesh, _vertices, _triangles):
        self.glued = np.zeros(len(mesh.tets), bool)


@pytest.mark.parametrize("gap", [0.02, 0.0, -0.02])
def test_one_prong_moves_without_the_other(gap, monkeypatch):
    of, follows = held_at_bend(gap), {}
    for cut in (True, False):
        if not cut:
            monkeypatch.setattr(dynamorph, "MeshCut", NoCut)
        model = build(of)
        tips, lower = of.vertices[:, 0] > 0.9, np.arange(len(of.vertices)) < len(of.vertices) / 2
        moved = np.abs(pushed(model, of, tips & lower))[:, 1]
        follows[cut] = moved[tips & ~lower].mean() / moved[tips & lower].mean()
        if cut:
            assert model.summary.glued["tets"] > 20 and model.summary.glued["split_nodes"] > 0
            assert not model.summary.warnings
    assert follows[False] > 0.5
    assert follows[True] < 0.1  # through the bend, where the prongs are soft and joined


@pytest.mark.parametrize("skin", [fork(0.02), (ball(0.5)[0] * [1.0, 1.0, 0.1], ball(0.5)[1])], ids=["fork", "slab"])
def test_a_skin_whose_faces_look_inward_is_cut_alike(skin):
    """Body and gap are distinguished whichever way the faces look."""
    _, triangles = skin
    both = join(skin, ball(0.1, center=(2.0, 0.0, 0.0)))  # one of its parts is oriented correctly

    def glued(triangles):
        made = character((both[0], triangles), lambda points: np.zeros(len(points)), cage_nodes=400)
        return build_cage(made).summary.glued["tets"]

    part, some = both[1].copy(), both[1].copy()
    part[: len(triangles)] = part[: len(triangles), ::-1]
    some[::5] = some[::5, ::-1]
    for turned in (part, some):
        assert glued(turned) == pytest.approx(glued(both[1]), rel=0.2)  # the wrap is another


def test_a_fork_that_is_open_is_left_as_it_was(monkeypatch):
    of = held_at_bend(0.4)
    with_it = build_cage(of)
    monkeypatch.setattr(dynamorph, "MeshCut", NoCut)
    without = build_cage(of)
    assert with_it.summary.glued == {"tets": 0, "split_nodes": 0}
    for name in ("nodes", "tets", "pinned", "embedding_nodes", "embedding_weights"):
        np.testing.assert_array_equal(getattr(with_it, name), getattr(without, name))


def test_a_cage_that_was_cut_serves_again(monkeypatch):
    of = held_at_bend(0.02)
    cut = build_cage(of)
    monkeypatch.setattr(dynamorph, "Meshing", None)  # must not be needed
    again = build_cage(of, previous=cut)
    np.testing.assert_array_equal(again.nodes, cut.nodes)
    np.testing.assert_array_equal(again.tets, cut.tets)
    assert again.summary.glued == cut.summary.glued


# What nothing holds ------------------------------------------------------------------------------------------------


def test_a_part_that_nothing_holds_stays_with_its_bones():
    skin = join(tube([[x, 0, 0] for x in np.linspace(0, 1, 21)], 0.1), ball(0.15, (0.5, 0.0, 0.6)))
    of = character(skin, lambda vertices: vertices[:, 0] > 0.1)
    model = build(of)
    assert model.summary.held_parts == 1
    (warning,) = model.summary.warnings
    assert "222 vertices at 'root'" in warning and "Firmness with 1" in warning
    afloat = of.vertices[:, 2] > 0.3
    moved = pushed(model, of, of.vertices[:, 0] > 0.9)
    assert np.abs(moved[afloat]).max() == 0 and np.abs(moved[~afloat]).max() > 1e-3


def test_a_body_that_nothing_holds_is_refused():
    skin = tube([[x, 0, 0] for x in np.linspace(0, 1, 21)], 0.1)
    with pytest.raises(dynamorph.Error, match="pinned to a bone: raise Bone Pinning"):
        build(character(skin, lambda vertices: vertices[:, 0] > -1))


def pinned_along_a_bone(*skins):
    """Limbs in cages so coarse that there is room for nodes on the bone of the first, but not around it."""
    of = character(join(*skins), lambda vertices: vertices[:, 0] > -1, cage_nodes=160, pin_radius=0.1)
    return replace(of, bone_segments=np.array([[[0.1, 0.02, 0.01], [0.9, 0.02, 0.01]]]))


def test_a_body_that_could_spin_about_its_bone_is_refused():
    limb = tube([[x, 0, 0] for x in np.linspace(0, 1, 21)], 0.1)
    with pytest.raises(
        dynamorph.Error, match="pinned to 'root' only along a line, about which it could turn: raise Bone"
    ):
        build(pinned_along_a_bone(limb))


def test_a_part_that_could_spin_about_its_bone_stays_with_it():
    limb = tube([[x, 0, 0] for x in np.linspace(0, 1, 21)], 0.1)
    of = pinned_along_a_bone(limb, ball(0.15, (0.5, 0.0, 0.6)))
    of = replace(of, rigidity=np.where(of.vertices[:, 2] > 0.7, 1.0, 0.0))
    model = build(of)
    (warning,) = model.summary.warnings
    assert f"{len(limb[0])} vertices at 'root' is pinned only along a line" in warning
    on_limb = of.vertices[:, 2] < 0.3
    moved = pushed(model, of, ~on_limb)
    assert np.abs(moved[on_limb]).max() == 0 and np.abs(moved[~on_limb]).max() > 1e-4


# Pieces ------------------------------------------------------------------------------------------------------------


def head_with_eye(cage_index, **settings):
    skin = join(ball(0.2), ball(0.05, (0.0, -0.17, 0.05)))
    numbers = np.repeat([0, cage_index], [222, 222])
    return character(skin, lambda vertices: vertices[:, 2] > -0.12, numbers, **settings)


def test_a_rigid_eyeball_stays_put_while_the_head_jiggles():
    of = head_with_eye(-1)
    eye = of.cage_index == -1
    shape = 0.01 * of.vertices
    target = replace(of.target_sets[0].targets[0], name="Bigger", shape=shape)
    sets = (replace(of.target_sets[0], targets=(*of.target_sets[0].targets, target)),)
    model = build(replace(of, authored_sets=sets))
    assert not model.embedding_weights[eye].any()
    np.testing.assert_allclose(model.residual_shapes[1][eye], shape[eye])  # the sculpt shows nevertheless
    moved = pushed(build(of), of, of.vertices[:, 2] > 0.15)
    assert np.abs(moved[eye]).max() == 0 and np.abs(moved[~eye]).max() > 1e-3
    with_it = head_with_eye(0)
    assert np.abs(pushed(build(with_it), with_it, with_it.vertices[:, 2] > 0.15)[eye]).max() > 1e-3


def test_the_cage_leaves_a_rigid_piece_out():
    nose = (0.0, -0.6, 0.0)
    skin = join(ball(0.2), ball(0.1, nose))
    of = character(skin, lambda v: v[:, 2] > -0.1, np.repeat([0, -1], [222, 222]))
    assert np.linalg.norm(build_cage(of).nodes - nose, axis=1).min() > 0.2
    with pytest.raises(dynamorph.Error, match="every part of it is rigid"):
        build_cage(replace(of, cage_index=np.full(444, -1)))


def body_with_belt():
    body = tube([[x, 0, 0] for x in np.linspace(0, 1, 31)], 0.1)
    turn = np.linspace(0, 2 * np.pi, 41)[:-1]
    index, rings = np.arange(160).reshape(40, 4), []
    for x, radius in ((0.45, 0.11), (0.45, 0.14), (0.55, 0.14), (0.55, 0.11)):
        rings.append(np.stack([np.full(40, x), radius * np.cos(turn), radius * np.sin(turn)], -1))
    a, b = np.roll(index, -1, axis=0), np.roll(index, -1, axis=1)
    c = np.roll(a, -1, axis=1)
    belt = (
        np.stack(rings, 1).reshape(-1, 3),
        np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((index, b, a), (b, c, a))]),
    )
    skin = join(body, belt)
    cage_index = np.repeat([0, 1], [len(body[0]), 160])
    # The body is held at its foot, the belt at its top.
    soft = np.where(cage_index == 0, skin[0][:, 0] > 0.05, skin[0][:, 2] < 0.08)
    return character(skin, lambda _: soft, cage_index, cage_nodes=600)


def test_a_belt_in_its_own_cage_does_not_feel_the_body():
    of = body_with_belt()
    model = build(of)
    belt = of.cage_index == 1
    both = np.isin(model.embedding_nodes[belt], model.embedding_nodes[~belt])
    assert not both.any() and model.summary.held_parts == 0
    assert model.summary.nodes == pytest.approx(600, rel=0.35)
    moved = pushed(model, of, of.vertices[:, 0] > 0.95)
    assert np.abs(moved[~belt]).max() > 1e-3 and np.abs(moved[belt]).max() < 1e-12
    sagging = pushed(model, of, belt & (of.vertices[:, 2] < -0.1))
    assert np.abs(sagging[belt]).max() > 1e-4 and np.abs(sagging[~belt]).max() < 1e-12


def test_pieces_are_a_reason_to_build_again():
    of = head_with_eye(0)
    assert "attachments" in MESH_DEPENDENCIES
    model = build_cage(of)
    assert has_cage(model, of) and not has_cage(model, head_with_eye(-1))
    assert "attachments changed" in stale_reasons(model, head_with_eye(-1))


def test_a_triangle_between_pieces_counts_with_the_largest_number():
    of = head_with_eye(0)
    cage_index = of.cage_index.copy()
    cage_index[of.triangles[0, 0]] = -1
    one_rigid = build_cage(replace(of, cage_index=cage_index))
    np.testing.assert_array_equal(one_rigid.nodes, build_cage(of).nodes)
    assert not one_rigid.embedding_weights[of.triangles[0, 0]].any()
