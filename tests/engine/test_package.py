# SPDX-License-Identifier: GPL-3.0-or-later
"""What a programmer meets in the Python package alone: arguments, files, and errors that do not speak of Blender."""

import ast
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import dynamorph
import numpy as np
import pytest
from dynamic_morph_targets.core import errors
from dynamic_morph_targets.core.model.model import Model
from dynamic_morph_targets.core.settings import Material
from scenes import bar

ROOT = Path(__file__).parents[2]
LAW, BLENDING = dynamorph.MaterialModel.STABLE_STVK, dynamorph.Blending.EVEN


def parts(pinned):
    """What a SoftBody of a bar along x is made of. pinned: function of the nodes."""
    nodes, tets = bar((4, 2, 2), (0.4, 0.1, 0.1))
    every = np.ones(len(tets))
    return dynamorph.TetMesh(nodes, tets), every, every, every[:, None], pinned(nodes), np.ones((len(nodes), 1))


def at_one_end(nodes):
    return nodes[:, 0] < 1e-9


def target(nodes, **changed):
    known = {"young": 2e4, "poisson": 0.4, "density": 1000.0}
    return dynamorph.MorphTarget("rest", 0 * nodes, **(known | changed))


def full_model(pinned=at_one_end):
    of_body = parts(pinned)
    return dynamorph.FullModel(dynamorph.SoftBody(*of_body), [target(of_body[0].nodes)], LAW, BLENDING)


# What errors say ------------------------------------------------------------------------------------------------------


def texts_of_the_engine() -> dict[str, str]:
    """What its sources can print, by file: literals of C++, and of Python without docstrings."""
    found = {}
    for path in (ROOT / "cpp/dynamorph").rglob("*.[ch]pp"):
        code = re.sub(r"//.*|#include .*", "", path.read_text(encoding="utf-8"))
        code = re.sub(r'"\s*\n\s*"', "", code)  # literals that follow each other are one
        found[path.name] = "\n".join(re.findall(r'"((?:[^"\\\n]|\\.)*)"', code))
    for path in (ROOT / "cpp/bindings/dynamorph").glob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        said = [node for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)]
        docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        found[path.name] = "\n".join(node.value for node in said if id(node) not in docstrings)
    return found


def test_the_engine_does_not_speak_of_blender():
    words = r"Blender|add-on|Bone Pinning|[Mm]odifier|[Ss]hape key|driver|Mesh >|Cage Nodes|[Aa]rmature|Detail\b|artist"
    wrong = {name: re.findall(f".*(?:{words}).*", text) for name, text in texts_of_the_engine().items()}
    assert {name: lines for name, lines in wrong.items() if lines} == {}


def test_the_artist_reads_what_to_do_in_blender():
    """All that the engine advises and an artist does in another way, or by a button, is in their words."""
    known = "\n".join(texts_of_the_engine().values())
    for advice, remedy in errors.IN_BLENDER.items():
        assert advice in known, advice
        assert remedy in errors.sentence(dynamorph.Error(f"Something is wrong. {advice}"))
    with pytest.raises(dynamorph.Error, match=r"Give it thickness\.$") as refusal:
        dynamorph.closed_surface(np.eye(3), np.array([[0, 1, 2]]))
    assert errors.sentence(refusal.value).endswith("Give it thickness (Solidify modifier, applied).")


def test_tets_that_are_inside_out_are_not_called_flat():
    nodes, tets = bar((1, 1, 1), (0.1, 0.1, 0.1))
    turned = tets[:, [1, 0, 2, 3]]
    with pytest.raises(ValueError, match=r"^tets: tet 0 is inside out: swap two of its indices$"):
        dynamorph.TetMesh(nodes, turned)
    dynamorph.TetMesh(nodes, turned[:, [1, 0, 2, 3]])
    with pytest.raises(ValueError, match=r"^tets: tet 0 is flat$"):
        dynamorph.TetMesh(nodes * [1, 1, 0], tets)


@pytest.mark.parametrize(
    ("pinned", "message"),
    [
        (lambda nodes: np.zeros(len(nodes), bool), "Nothing holds this body"),
        (lambda nodes: np.linalg.norm(nodes[:, 1:] - 0.05, axis=1) < 1e-9, "This body can turn about an axis"),
    ],
)
def test_a_body_that_can_move_freely_has_no_basis(pinned, message):
    """Nodes on a bone's axis hold a body, but it can still spin about them."""
    with pytest.raises(dynamorph.Error, match=f"^{message}.*, or hold the body") as refusal:
        dynamorph.make_basis(full_model(pinned), 13)
    assert errors.sentence(refusal.value).endswith(", raise Bone Pinning, or set Hold to Thickness.")


# Arguments ------------------------------------------------------------------------------------------------------------


def test_a_material_is_given_by_young_and_poisson_or_by_lames_parameters():
    of_body = parts(at_one_end)
    lame_lambda, lame_mu = Material(stiffness=3e4, poisson=0.3).lame()
    nodes = of_body[0].nodes
    given = (
        target(nodes, young=3e4, poisson=0.3),
        dynamorph.MorphTarget("rest", 0 * nodes, lame_lambda=lame_lambda, lame_mu=lame_mu, density=1000.0),
    )
    body = dynamorph.SoftBody(*of_body)
    one, other = (dynamorph.FullModel(body, [each], LAW, BLENDING).linear_modes(0, 4)[0] for each in given)
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"young": 0.0}, "young: expected a finite number of Pa above zero, got 0.0"),
        ({"young": np.nan}, "young: "),
        ({"poisson": 0.5}, "poisson: expected 0 to 0.495, above which tetrahedra lock, got 0.5"),
        ({"poisson": -0.1}, "poisson: "),
        ({"poisson": np.nan}, "poisson: "),
    ],
)
def test_materials_that_there_are_not(wrong, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        target(np.zeros((4, 3)), **wrong)


def test_a_basis_is_reduced_as_its_modes_are():
    full = full_model()
    basis = dynamorph.make_basis(full, 6)
    one, other = (dynamorph.reduce(full, each) for each in (basis, basis.U))
    np.testing.assert_array_equal(one.lame_mu, other.lame_mu)


WITHOUT_SCIPY = """
import sys
sys.modules["scipy"] = None  # as if it were not installed
import numpy as np
from test_package import full_model
full = full_model()
for name, arguments in (("linearize", ([1.0], np.zeros(full.dofs))), ("inertia", (np.eye(3, 4)[None], 1000.0))):
    try:
        getattr(full, name)(*arguments)
    except ImportError as error:
        print(error)
"""


def test_without_scipy_sparse_matrices_say_what_to_install():
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    command = [sys.executable, "-c", WITHOUT_SCIPY]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    said = "The matrices of a FullModel are those of scipy.sparse: install SciPy (pip install scipy)"
    assert run.stdout.splitlines() == [said, said]


# Skins and files ------------------------------------------------------------------------------------------------------


def soft_skin(responses=0):
    """(what its SoftBody is made of, the other arguments of pack_soft_skin) of a bar with two targets."""
    of_body = parts(at_one_end)
    mesh, body = of_body[0], dynamorph.SoftBody(*of_body)
    points = np.random.default_rng(0).uniform(0.0, [0.4, 0.1, 0.1], (200, 3))
    embedding = dynamorph.embed(mesh, points)
    sculpt = np.zeros_like(points)
    sculpt[:, 2] = 0.02 * np.sin(8 * points[:, 0]) * np.cos(40 * points[:, 1])
    shapes = body.extend_shapes(embedding, np.array([0 * sculpt, sculpt]))
    targets = [
        dynamorph.MorphTarget(name, shape, young=young, poisson=0.4, density=1000.0)
        for name, shape, young in zip(("rest", "flexed"), shapes, (2e4, 8e4), strict=True)
    ]
    full = dynamorph.FullModel(body, targets, LAW, BLENDING)
    basis = dynamorph.make_response_basis(full, 5, responses) if responses else dynamorph.make_basis(full, 6)
    others = {
        "targets": targets,
        "tables": dynamorph.reduce(full, basis),
        "embedding": embedding,
        "bone_names": ["root"],
        "residual_shapes": np.array([0 * sculpt, sculpt - embedding.interpolate(shapes[1])]),
    }
    return of_body, others, points, sculpt


def test_a_skin_at_rest_in_a_target_is_the_sculpt_in_the_world():
    of_body, others, points, sculpt = soft_skin()
    model = dynamorph.ReducedModel(dynamorph.SoftBody(*of_body), others["targets"], others["tables"], BLENDING)
    skin = dynamorph.Skin(model, points, others["embedding"], np.ones((len(points), 1)), others["residual_shapes"])
    turned = np.array([[[0.0, -1, 0, 0.3], [1, 0, 0, 0.1], [0, 0, 1, -0.2]]])
    simulation = dynamorph.Simulation(model, 0.01)
    coordinates, report = simulation.solve_static(turned, [0, 1])
    assert report.converged and np.abs(others["residual_shapes"]).max() > 1e-4
    expected = (points + sculpt) @ turned[0, :, :3].T + turned[0, :, 3]
    np.testing.assert_allclose(skin.positions(turned, [0, 1], coordinates), expected, atol=1e-12)


@pytest.mark.parametrize("responses", [0, 6])
def test_a_packed_soft_skin_has_the_arrays_of_every_model_file(responses):
    of_body, others, points, _ = soft_skin(responses)
    arrays, description = dynamorph.unpack_model(dynamorph.pack_soft_skin(*of_body, **others))
    assert sorted(arrays) == sorted(Model.array_names())
    assert json.loads(description) == {
        "settings": {"method": "DYNAMIC", "solver": "REDUCED", "material_model": "STABLE_STVK"},
        "bone_names": ["root"],
    }
    for name, expected in (
        ("nodes", of_body[0].nodes), ("fill", of_body[1]), ("pinned", of_body[4]), ("target_sets", [0, 0]),
        ("displacements", [each.displacement for each in others["targets"]]), ("basis", others["tables"].basis),
        ("residual_shapes", others["residual_shapes"]), ("embedding_nodes", others["embedding"].nodes),
        ("responses", others["tables"].responses), ("parents", [-1]), ("rest", np.eye(4)[None]),
    ):  # fmt: skip
        np.testing.assert_array_equal(arrays[name], expected, err_msg=name)
    np.testing.assert_array_equal(arrays["node_weights"], [[1.0, 0.0]] * len(of_body[0].nodes))  # the last: the object
    if responses:
        together = np.hstack([arrays["response_mu"], arrays["coupling_mu"]])
        np.testing.assert_allclose(together, others["tables"].response_mu, rtol=1e-6, atol=1e-6)
        assert arrays["coupling_mu"].dtype == np.float32 and arrays["relaxation"].shape == (2, responses, 5)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"bone_names": ["root", "tip"]}, "bone_names: expected 1, got 2"),
        ({"residual_shapes": np.zeros((2, 3, 3))}, "residual_shapes: expected shape "),
        ({"parents": [0, 1]}, "parents: expected shape "),
        ({"rest": np.eye(4)}, "rest: expected shape "),
        ({"embedding": dynamorph.Embedding(np.full((1, 4), 999), np.full((1, 4), 0.25))}, "embedding: it belongs to"),
        ({"targets": []}, "targets: at least one is needed"),
    ],
)
def test_a_soft_skin_that_does_not_fit_is_not_packed(changed, message):
    of_body, others, *_ = soft_skin()
    with pytest.raises(ValueError, match=f"^{message}"):
        dynamorph.pack_soft_skin(*of_body, **(others | changed))


def test_only_numbers_are_packed():
    with pytest.raises(ValueError, match=r"^array 'names' has type <U1: only numbers can be stored$"):
        dynamorph.pack_model({"names": np.array(["a"])}, "{}")
