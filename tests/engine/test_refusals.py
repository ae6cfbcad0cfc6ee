# SPDX-License-Identifier: GPL-3.0-or-later
"""Input that the engine cannot work with is refused with an error that names it, and never crashes or hangs."""

from __future__ import annotations

import math

import dynamorph
import numpy as np
import pytest
from dynamic_morph_targets.core.settings import Material
from scenes import bar
from test_hold import held_bar
from test_physics import cantilever

MATERIAL_MODEL, BLENDING = dynamorph.MaterialModel.STVK, dynamorph.Blending.EVEN


def reduced(full):
    """A reduced model of one target at rest."""
    return dynamorph.ReducedModel(full.body, [rest(full)], dynamorph.reduce(full, unit_modes(full, 2)), BLENDING)


def unit_modes(full, k):
    """The k lowest modes (dofs, k) of the first target, orthonormal in the mass for unit density."""
    return full.linear_modes(0, k)[1] * np.sqrt(1000.0)


def rest(full, **changed):
    """A target of the neutral shape."""
    shape = np.zeros_like(full.displacement(np.zeros(full.dofs)))
    known = {"displacement": shape, "lame_lambda": 2e4, "lame_mu": 1e4, "density": 1000.0}
    return dynamorph.MorphTarget("rest", **(known | changed))


@pytest.mark.fault("P02")
@pytest.mark.parametrize("stepper", ["full", "reduced"])
@pytest.mark.parametrize(
    ("option", "value"),
    [
        *(("h", h) for h in (0.0, -1.0, np.nan, np.inf)),
        *(("tolerance", tolerance) for tolerance in (0.0, -1e-6, 1.0, 5e-324, np.nan)),
        ("max_iterations", 0),
        ("max_iterations", -1),
        ("teleport", -1.0),
        ("teleport", np.nan),
        ("gravity", (0.0, np.nan, 0.0)),
        ("integrator", dynamorph.Integrator(7)),
    ],
)
def test_options_that_no_step_can_be_taken_with(stepper, option, value):
    full, _ = cantilever((2, 1, 1), (0.2, 0.1, 0.1))
    options = {"h": 0.01} | {option: value}
    with pytest.raises(ValueError, match=f"^{option}: "):
        if stepper == "full":
            dynamorph.Simulation(full, **options)
        else:
            dynamorph.Simulation(reduced(full), **options)


def test_poses_that_take_no_bytes_are_counted_first():
    """A billion poses of no bone would take all memory."""
    full, _ = cantilever((2, 1, 1), (0.2, 0.1, 0.1))
    made = dynamorph.Simulation(reduced(full), 0.01)
    with pytest.raises(ValueError, match=r"bones: expected shape \(1, 1, 3, 4\), got \(1099511627776, 0, 3, 4\)"):
        made.balance_targets(np.zeros((2**40, 0, 3, 4)))


# Models ------------------------------------------------------------------------------------------------------------


@pytest.mark.fault("P01")
@pytest.mark.parametrize("solver", ["full", "reduced"])
@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"set": 7}, "in set 7, there are 1"),
        ({"set": -1}, "in set -1, there are 1"),
        ({"displacement": np.zeros((3, 3))}, "displacement: expected 36 rows, got 9"),
        ({"displacement": np.full((12, 3), np.nan)}, "not finite"),
        ({"displacement": np.ones((12, 3))}, "displaces pinned nodes"),
        ({"lame_mu": 0.0}, "needs finite stiffness and density above zero"),
        ({"density": np.inf}, "needs finite stiffness and density above zero"),
        (dict(zip(("lame_lambda", "lame_mu"), Material(poisson=0.4999).lame(), strict=True)), "ratio above 0.495"),
    ],
)
def test_targets_that_no_model_can_have(solver, changed, message):
    full, _ = cantilever((2, 1, 1), (0.2, 0.1, 0.1), material_model=MATERIAL_MODEL)
    tables = dynamorph.reduce(full, unit_modes(full, 2))
    with pytest.raises((ValueError, dynamorph.Error), match=message):
        if solver == "full":
            dynamorph.FullModel(full.body, [rest(full, **changed)], MATERIAL_MODEL, BLENDING)
        else:
            dynamorph.ReducedModel(full.body, [rest(full, **changed)], tables, BLENDING)


def test_a_model_needs_a_target_and_known_laws():
    full, _ = cantilever((2, 1, 1), (0.2, 0.1, 0.1), material_model=MATERIAL_MODEL)
    tables = dynamorph.reduce(full, unit_modes(full, 2))
    with pytest.raises(ValueError, match="targets: at least one"):
        dynamorph.FullModel(full.body, [], MATERIAL_MODEL, BLENDING)
    none = dynamorph.ReducedTables(MATERIAL_MODEL, tables.basis, [], [])
    with pytest.raises(ValueError, match="targets: at least one"):
        dynamorph.ReducedModel(full.body, [], none, BLENDING)
    with pytest.raises(ValueError, match="material_model: "):
        dynamorph.FullModel(full.body, [rest(full)], dynamorph.MaterialModel(7), BLENDING)
    with pytest.raises(ValueError, match="blending: "):
        dynamorph.FullModel(full.body, [rest(full)], MATERIAL_MODEL, dynamorph.Blending(7))
    with pytest.raises(ValueError, match="blending: "):
        dynamorph.ReducedModel(full.body, [rest(full)], tables, dynamorph.Blending(7))
    unknown = dynamorph.ReducedTables(dynamorph.MaterialModel(7), tables.basis, tables.lame_lambda, tables.lame_mu)
    with pytest.raises(ValueError, match="material_model: "):
        dynamorph.ReducedModel(full.body, [rest(full)], unknown, BLENDING)


@pytest.mark.parametrize(
    "call",
    [
        lambda full: dynamorph.FullModel(None, [rest(full)], MATERIAL_MODEL, BLENDING),
        lambda full: dynamorph.ReducedModel(None, [rest(full)], dynamorph.reduce(full, unit_modes(full, 2)), BLENDING),
        lambda full: dynamorph.Simulation(None, 0.01),
        lambda full: dynamorph.Simulation(None, 0.01),
    ],
)
def test_none_is_no_model_and_no_body(call):
    full, _ = cantilever((2, 1, 1), (0.2, 0.1, 0.1))
    with pytest.raises(TypeError):
        call(full)


def test_tables_have_to_be_finite():
    full, _ = cantilever((2, 1, 1), (0.2, 0.1, 0.1), material_model=MATERIAL_MODEL)
    tables = dynamorph.reduce(full, unit_modes(full, 2))
    wrong = dynamorph.ReducedTables(
        MATERIAL_MODEL, tables.basis, tables.lame_lambda, [np.nan * table for table in tables.lame_mu]
    )
    with pytest.raises(ValueError, match="tables: of 'rest' must be finite"):
        dynamorph.ReducedModel(full.body, [rest(full)], wrong, BLENDING)


# Bases -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", ["reduce", "model"])
def test_a_basis_without_modes_or_of_another_body(place):
    full, _ = cantilever((2, 1, 1), (0.2, 0.1, 0.1), material_model=MATERIAL_MODEL)
    good = unit_modes(full, 2)
    for basis, message in (
        (good[:, :0], "basis: expected at least one mode"),
        (good[3:], "basis: expected 24 rows, got 21"),
        (np.nan * good, "basis: must be finite"),
        (full.linear_modes(0, 2)[1], "basis: is not orthonormal"),  # in the mass for the target's density
        (good[:, [0, 0]], "basis: is not orthonormal"),
        (good * (1.0 + 1e-8), "basis: is not orthonormal"),
    ):
        with pytest.raises(ValueError, match=message):
            use(full, [rest(full)], basis, place)
    use(full, [rest(full)], good * (1.0 + 1e-10), place)


@pytest.mark.parametrize("place", ["reduce", "model"])
def test_a_basis_that_loses_a_target_s_shape(place):
    full, shape, *_ = held_bar(MATERIAL_MODEL, BLENDING)
    targets = [rest(full), rest(full, displacement=shape)]
    use(full, targets, dynamorph.make_basis(full, 8).U, place)
    with pytest.raises(ValueError, match="basis: cannot hold the shape of 'rest'"):
        use(full, targets, unit_modes(full, 8), place)


def test_a_shape_that_is_nearly_another_s_may_lose_what_is_left():
    """Bases leave out what is 1e-9 of the largest shape, which of a small target may be more than 1e-6."""
    full, shape, *_ = held_bar(MATERIAL_MODEL, BLENDING)
    basis = dynamorph.make_basis(full, 8).U
    small = 1e-4 * shape + 1e-9 * np.abs(shape).max() * np.random.default_rng(0).normal(size=shape.shape)
    use(full, [rest(full), rest(full, displacement=shape), rest(full, displacement=small)], basis, "reduce")


def use(full, targets, basis, place):
    """Reduces a model of these targets in a basis, or loads tables that claim to be of it."""
    model = dynamorph.FullModel(full.body, targets, MATERIAL_MODEL, BLENDING)
    if place == "reduce":
        return dynamorph.reduce(model, basis)
    r = basis.shape[1]
    coefficients = sum(math.comb(r + k - 1, k) for k in (2, 3, 4))
    zeros = [np.zeros(coefficients) for _ in targets]
    tables = dynamorph.ReducedTables(MATERIAL_MODEL, basis, zeros, zeros)
    return dynamorph.ReducedModel(full.body, targets, tables, BLENDING)


# Meshes ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("far", [1e101, 1e155, 1e300])
def test_a_point_whose_distances_cannot_be_computed(far):
    nodes, tets = bar((2, 1, 1), (0.2, 0.1, 0.1))
    mesh = dynamorph.TetMesh(nodes, tets)
    for point in ([far, 0.0, 0.0], [0.0, -far, 0.0]):
        with pytest.raises(dynamorph.Error, match="vertex too far away"):
            dynamorph.embed(mesh, [point])
    with pytest.raises(ValueError, match="nodes: expected finite coordinates within"):
        dynamorph.TetMesh(nodes * far, tets)


def test_a_point_far_away_is_carried_with_a_constant_offset():
    nodes, tets = bar((2, 1, 1), (0.2, 0.1, 0.1))
    embedding = dynamorph.embed(dynamorph.TetMesh(nodes, tets), [[9e99, 0.0, 0.0]])
    assert embedding.distances == pytest.approx([9e99])
    assert embedding.weights.sum() == pytest.approx(1.0) and embedding.weights.min() >= -0.5 - 1e-9


def test_bones_that_cannot_be_divided():
    nodes, tets = bar((2, 2, 2), (0.2, 0.2, 0.2))
    vertices, triangles = box()
    skin = (vertices, triangles, vertices, triangles)
    for end in (np.nan, np.inf):
        with pytest.raises(ValueError, match="heads, tails: expected finite"):
            dynamorph.points_on_bones(*skin, [[0.1, 0.1, 0.1]], [[end, 0.0, 0.0]], 0.5)
        with pytest.raises(ValueError, match="heads, tails: expected finite"):
            dynamorph.pinned(dynamorph.TetMesh(nodes, tets), *skin[:2], [[0.1, 0.1, 0.1]], [[end, 0.0, 0.0]], 0.5)
    with pytest.raises(dynamorph.Error, match="Check the scale of the bones"):
        dynamorph.points_on_bones(*skin, [[0.1, 0.1, 0.1]], [[1e12, 0.0, 0.0]], 0.5)
    none = np.zeros((0, 3), int)
    assert len(dynamorph.points_on_bones(vertices, none, *skin[2:], [[0.1, 0.1, 0.1]], [[0.1, 0.1, 0.2]], 0.5)) == 0


@pytest.mark.parametrize(
    ("indices", "message"),
    [
        (lambda t: t + 2**32, "triangles: expected indices up to 2147483647, got 4294967296 to 4294967303"),
        (lambda t: t - 2**32, "triangles: expected indices up to 2147483647, got -4294967296"),
        (lambda t: t.astype(np.uint64) + np.uint64(2**63), "triangles: expected indices up to 2147483647"),
        (lambda t: t + 0.5, "triangles: expected integers, got float64"),
        (lambda t: t.astype(float), "triangles: expected integers, got float64"),
        (lambda t: t.astype(np.float32), "triangles: expected integers, got float32"),
        (lambda t: t > 3, "triangles: expected integers, got bool"),
        (lambda t: t + 8, "triangles: expected vertex indices from 0 to 7, got 8 to 15"),
        (lambda t: t - 1, "triangles: expected vertex indices from 0 to 7, got -1 to 6"),
        (lambda t: t[:, :2], r"triangles: expected shape \(any, 3\), got \(12, 2\)"),
    ],
)
def test_indices_are_not_wrapped_or_cut_off(indices, message):
    vertices, triangles = box()
    with pytest.raises(ValueError, match=message):
        dynamorph.closed_surface(vertices, indices(triangles))


def test_indices_of_every_integer_type_are_taken():
    vertices, triangles = box()
    expected = dynamorph.closed_surface(vertices, triangles)[1]
    for kind in (np.int8, np.uint8, np.int16, np.uint32, np.int64, np.uint64, ">i4"):
        assert np.array_equal(dynamorph.closed_surface(vertices, triangles.astype(kind))[1], expected)
    assert np.array_equal(dynamorph.closed_surface(vertices, triangles.tolist())[1], expected)
    assert np.array_equal(dynamorph.closed_surface(vertices, np.asfortranarray(triangles))[1], expected)


def test_indices_of_tetrahedra_and_embeddings():
    nodes, tets = bar((2, 1, 1), (0.2, 0.1, 0.1))
    with pytest.raises(ValueError, match="tets: expected indices up to"):
        dynamorph.TetMesh(nodes, tets + 2**32)
    with pytest.raises(ValueError, match="tets: expected integers"):
        dynamorph.TetMesh(nodes, tets + 0.0)
    with pytest.raises(ValueError, match="nodes: expected indices up to"):
        dynamorph.Embedding(np.zeros((1, 4), np.int64) + 2**32, np.full((1, 4), 0.25))


def test_the_cut_of_a_mesh_without_tetrahedra():
    empty = dynamorph.TetMesh(np.zeros((0, 3)), np.zeros((0, 4), int))
    with pytest.raises(ValueError, match="mesh: expected at least one tet"):
        dynamorph.MeshCut(empty, *box())


@pytest.mark.parametrize("count", [3, 2**31 - 1])
def test_cages_that_would_take_for_ever(count):
    with pytest.raises(ValueError, match=f"target_vertices: expected 4 to 1000000, got {count}"):
        dynamorph.make_cage_surface(*box(), count)


def box():
    """A cube of 0.2 m: vertices (8, 3), outward triangles (12, 3)."""
    vertices = 0.2 * np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return vertices, np.array([[q[0], *pair] for q in quads for pair in (q[1:3], q[2:4])])
