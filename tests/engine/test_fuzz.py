# SPDX-License-Identifier: GPL-3.0-or-later
"""Random input for what reads files and for the engine: taken, or refused with an error that is expected; no crash."""

import time

import dynamorph as dm
import numpy as np
import pytest
import scenes
from dynamic_morph_targets.core.errors import FitError, ModelFileError
from dynamic_morph_targets.core.material import oscillation
from dynamic_morph_targets.io import model_file
from dynamorph import _mesher
from fuzzing import EDIT, corpus, edited, target
from hypothesis import example
from hypothesis import strategies as st

EDITS = st.lists(EDIT, min_size=1, max_size=5)
REFUSALS = (ValueError, TypeError, OverflowError, dm.Error)  # of a caller's mistake, or of the data


# Files -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", corpus("model"), ids=lambda path: path.name)
def test_kept_models(path):
    unpack(path.read_bytes())


@target(st.sampled_from(corpus("model")), EDITS, examples=200)
def test_edited_models(path, edits):
    """No edit goes unnoticed: every byte is under a hash."""
    before = path.read_bytes()
    after = edited(before, edits)
    assert after == before or not unpack(after)


def unpack(content: bytes) -> bool:
    try:
        model_file.unpack(content)
    except ModelFileError as error:
        assert str(error)
        return False
    return True


@pytest.mark.parametrize("path", corpus("csv"), ids=lambda path: path.name)
def test_kept_tables(path, tmp_path):
    read_table(path)


@target(st.sampled_from(corpus("csv")), EDITS, examples=100)
def test_edited_tables(tmp_path_factory, path, edits):
    """Of measurements, for `fit`."""
    table = tmp_path_factory.getbasetemp() / "table.csv"
    table.write_bytes(edited(path.read_bytes(), edits))
    read_table(table)


def read_table(path):
    try:
        rows = oscillation.read_columns(path, (2, 3, 4, 6))
        if rows.shape[1] < 6:
            oscillation.oscillation(rows[:, 0], rows[:, 1:])
    except FitError as error:
        assert str(error)


# Meshes ------------------------------------------------------------------------------------------------------------

NUMBER = st.one_of(
    st.integers(-2, 2).map(float), st.floats(-2, 2), st.sampled_from([np.nan, np.inf, 1e300, -1e300, 1e-320, 0.0])
)


def points(most: int):
    return st.lists(st.tuples(NUMBER, NUMBER, NUMBER), max_size=most).map(lambda p: np.array(p, float).reshape(-1, 3))


def faces(corners: int, most: int):
    row = st.tuples(*[st.integers(-1, 12)] * corners)
    return st.lists(row, max_size=most).map(lambda rows: np.array(rows, np.int32).reshape(-1, corners))


@target(points(12), faces(3, 20), examples=100)
def test_any_triangles_are_closed_or_refused(vertices, triangles):
    try:
        closed, of_closed, _ = dm.closed_surface(vertices, triangles)
    except REFUSALS as error:
        assert str(error)
        return
    assert np.isfinite(closed).all()
    edges = of_closed[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, counts = np.unique(edges[:, 0].astype(np.int64) * (len(closed) + 1) + edges[:, 1], return_counts=True)
    _, backward = np.unique(edges[:, 1].astype(np.int64) * (len(closed) + 1) + edges[:, 0], return_counts=True)
    np.testing.assert_array_equal(counts, backward)  # each edge as often in one direction as in the other


@target(points(12), faces(4, 12), points(6), examples=100)
def test_any_points_are_embedded_or_refused(nodes, tets, inside):
    try:
        embedding = dm.embed(dm.TetMesh(nodes, tets), inside)
    except REFUSALS as error:
        assert str(error)
        return
    assert ((embedding.nodes >= 0) & (embedding.nodes < len(nodes))).all()
    np.testing.assert_allclose(embedding.weights.sum(axis=1), 1.0, atol=1e-6)


# Bindings ------------------------------------------------------------------------------------------------------------


class Prepared:
    """Valid arguments of the engine's functions, on a bar and a tube."""

    def __init__(self):
        nodes, tets = scenes.bar((3, 1, 1), (0.4, 0.1, 0.1))
        mesh, ones, pinned = dm.TetMesh(nodes, tets), np.ones(len(tets)), nodes[:, 0] < 1e-9
        body = dm.SoftBody(mesh, ones, ones, ones[:, None], pinned, np.ones((len(nodes), 1)))
        material = {
            "lame_lambda": 1e4, "lame_mu": 1e4, "density": 1e3, "mass_damping": 1.0, "stiffness_damping": 1e-3
        }  # fmt: skip
        shape = np.where(pinned[:, None], 0.0, 0.01 * nodes)
        targets = [dm.MorphTarget(name, each, **material) for name, each in (("a", 0.0 * shape), ("b", shape))]
        even = dm.Blending.EVEN
        full = dm.FullModel(body, targets, dm.MaterialModel.STABLE_STVK, even)
        basis = dm.make_basis(full, 3)
        tables = dm.reduce(full, basis.U)
        reduced = dm.ReducedModel(body, targets, tables, even)
        bones, weights = np.eye(3, 4)[None], np.array([0.5, 0.5])
        poses = np.repeat(np.eye(4)[None], 2, 0)
        poses[1, 1:3, 1:3] = [[0.6, -0.8], [0.8, 0.6]]
        skin, polygons = scenes.tube(5, 6)
        triangles = np.array([[f[0], f[k], f[k + 1]] for f in polygons for k in range(1, len(f) - 1)], np.int32)
        cage = dm.TetMesh(*_mesher.tetrahedralize(skin, triangles, 60))
        heads, tails = np.array([[0.0, 0.0, 0.2]]), np.array([[0.0, 0.0, 1.8]])
        embedding = dm.embed(mesh, 0.9 * nodes)
        space = dm.PoseSpace([dm.TargetSet([1], ["a", "b"], [np.repeat(np.eye(4)[None], 2, 0), poses])])

        def stepped(kind, model, step, first, second, given, more):
            simulation = kind(model, step)
            simulation.start(first, second, given)
            return simulation.advance(second[None], more), simulation.coordinates

        at_rest, motion = np.zeros(full.dofs), [0.01, bones, bones, weights, weights[None]]
        self.calls = {
            "TetMesh": (lambda a, b: dm.TetMesh(a, b).volumes, [nodes, tets]),
            "Embedding": (lambda a, b: dm.Embedding(a, b).interpolate(nodes), [embedding.nodes, embedding.weights]),
            "SoftBody": (
                lambda *a: dm.FullModel(
                    dm.SoftBody(mesh, *a), targets, dm.MaterialModel.STVK, even
                ).energy(weights, at_rest),
                [ones, ones, ones[:, None], pinned, np.ones((len(nodes), 1))],
            ),
            "MorphTarget": (
                lambda d, *m: dm.FullModel(
                    body, [targets[0], dm.MorphTarget("b", d, *m)], dm.MaterialModel.STABLE_STVK, even
                ).linearize(weights, at_rest),
                [shape, 1e4, 1e4, 1e3, 1.0, 1e-3],
            ),
            "extend_shapes": (lambda s: body.extend_shapes(embedding, s), [np.zeros((2, len(nodes), 3))]),
            "full energy": (full.energy, [weights, at_rest]),
            "linearize": (full.linearize, [weights, at_rest]),
            "reduced energy": (reduced.energy, [weights, np.zeros(reduced.dofs)]),
            "reduce": (lambda u: dm.reduce(full, u).lame_mu, [basis.U]),
            "make_basis": (lambda r: dm.make_basis(full, r).U, [3]),
            "PoseSpace": (space.weights, [poses[None]]),
            "TargetSet": (lambda a, b: dm.TargetSet([1], ["a", "b"], [a, b]), [poses, poses]),
            "full step": (lambda *a: stepped(dm.Simulation, full, *a), motion),
            "reduced step": (lambda *a: stepped(dm.Simulation, reduced, *a), motion),
            "fill_fractions": (lambda *a: dm.fill_fractions(cage, *a), [skin, triangles]),
            "symmetric_like": (lambda *a: dm.symmetric_like(cage, *a).volumes, [skin, triangles]),
            "pinned": (lambda *a: dm.pinned(cage, *a), [skin, triangles, heads, tails, 0.4]),
            "points_on_bones": (dm.points_on_bones, [skin, triangles, skin, triangles, heads, tails, 0.4]),
            "MeshCut": (lambda *a: dm.MeshCut(cage, *a).cut().volumes, [skin, triangles]),
            "extend_to_nodes": (lambda v: dm.extend_to_nodes(mesh, embedding, v), [np.ones((len(nodes), 2))]),
        }  # fmt: skip


PREPARED = Prepared()
WILD = [np.nan, np.inf, -np.inf, 1e300, 1e154, 5e-324, -1.0, 0.0, 2.0**31, 2.0**63]
SPOILERS = {
    "wild": lambda a, at, value: _with(a, at, value),
    "empty": lambda a, *_: a[:0],
    "no columns": lambda a, *_: a[..., :0],
    "fewer": lambda a, *_: a[:-1],
    "more": lambda a, *_: np.concatenate([a, a[-1:]]),
    "narrower": lambda a, *_: a[..., :-1],
    "flat": lambda a, *_: a.ravel(),
    "deeper": lambda a, *_: a[None],
    "scalar": lambda _a, _at, value: np.array(value),
    "fortran": lambda a, *_: np.asfortranarray(a),
    "strided": lambda a, *_: np.repeat(a, 2, 0)[::2],
    "single": lambda a, *_: a.astype(np.float32),
    "zero": lambda a, *_: np.zeros_like(a),
    "scaled": lambda a, at, _value: a.astype(float) * 10.0 ** (320 * at - 160),
    "text": lambda a, *_: a.astype(str),
    "objects": lambda a, *_: a.astype(object),
    "complex": lambda a, *_: a.astype(complex) + 1j,
    "none": lambda *_: None,
}


def _with(array, at, value):
    spoiled = np.array(array, float)
    if spoiled.size:
        spoiled.flat[min(int(at * spoiled.size), spoiled.size - 1)] = value
    if array.dtype.kind == "i" and np.isfinite(spoiled).all() and np.abs(spoiled).max(initial=0) < 2.0**63:
        return spoiled.astype(np.int64)
    return spoiled


SPOIL = st.tuples(
    st.integers(0, 4), st.sampled_from(sorted(SPOILERS)), st.floats(0, 1), st.sampled_from(WILD)
)  # argument, how, where, value


@pytest.mark.filterwarnings("ignore")  # NumPy's, of such numbers
@target(st.sampled_from(sorted(PREPARED.calls)), st.lists(SPOIL, min_size=1, max_size=2), examples=400)
@example("MeshCut", [(0, "scaled", 0.515625, 0.0)])  # took all memory
def test_any_argument_is_taken_or_refused(name, spoils):
    """A crash ends this process, a wrong exception fails; what is taken ends soon."""
    call, arguments = PREPARED.calls[name]
    spoiled = list(arguments)
    for which, how, at, value in spoils:
        which %= len(spoiled)
        given = np.asarray(spoiled[which])
        if given.ndim == 0:
            spoiled[which] = value
        elif given.dtype.kind in "fib":
            spoiled[which] = SPOILERS[how](given, at, value)
    began = time.monotonic()
    try:
        call(*spoiled)
    except REFUSALS as error:
        assert str(error)
    assert time.monotonic() - began < 20.0
