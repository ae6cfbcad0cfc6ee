# SPDX-License-Identifier: GPL-3.0-or-later
"""The programs in examples/ build, run, and give the right results."""

import json
import re
import shutil
import subprocess
import sys
import textwrap
import tomllib
from dataclasses import replace
from pathlib import Path

import dynamorph
import numpy as np
import pytest
import scenes
from dynamic_morph_targets.core.character import Target, TargetSet
from dynamic_morph_targets.core.model.build import build
from dynamic_morph_targets.core.settings import Material
from dynamic_morph_targets.io import model_file
from test_build import bar

ROOT = Path(__file__).resolve().parents[2]
BUILD = Path(dynamorph.__file__).parents[2]  # where the engine that is tested was built
CMAKE = shutil.which("cmake", path=Path(sys.executable).parent) or shutil.which("cmake")

in_build_folder = pytest.mark.skipif(
    not (CMAKE and (BUILD / "CMakeCache.txt").exists()), reason="needs CMake and the build folder of the engine"
)


def run(*command, **options):
    done = tried(*command, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def tried(*command, **options):
    return subprocess.run([*map(str, command)], capture_output=True, text=True, check=False, **options)


def configured(folder, **settings):
    """The C++ example, configured as the engine was."""
    cache = dict(re.findall(r"^(\w+):\w+=(.*)$", (BUILD / "CMakeCache.txt").read_text(), re.MULTILINE))
    kept = {name: cache[name] for name in ("CMAKE_MAKE_PROGRAM", "CMAKE_CXX_COMPILER")}
    options = [f"-D{name}={value}" for name, value in (kept | settings).items()]
    return run(CMAKE, "-S", ROOT / "examples/cpp", "-B", folder, "-G", cache["CMAKE_GENERATOR"], *options)


def muscle(regions=1):
    """A bar that bulges when it flexes, in an object that is scaled; its materials are those of the C++ example.
    regions: 1, or 2 where its upper end is a region of its own, with three targets.
    """
    plain = bar(solver="REDUCED", material_model="STABLE_STVK", cage_nodes=300)
    (neutral,) = plain.target_sets[0].targets
    soft, firm = (Material(young, 0.4, 1000.0, mass_damping=0.0, stiffness_damping=0.005) for young in (20e3, 80e3))

    def target(name, center, amount, material=firm):
        shape = scenes.bulge(plain.vertices, center=center, width=0.15, amount=amount)
        return Target(name, shape, (), neutral.local, neutral.rig_world, material)

    upper = np.clip(plain.vertices[:, 2] / 0.2 - 1.5, 0.0, 1.0) * (regions - 1)
    relaxed = replace(neutral, material=soft)
    sets = [TargetSet("Bar", (relaxed, target("Flexed", 0.4, 0.02)), 1.0 - upper)]
    if regions == 2:
        thicker = (target("Thick", 0.6, 0.01), target("Thicker", 0.6, 0.02))
        sets.append(TargetSet("Upper", (replace(neutral, material=firm), *thicker), upper))
    return replace(plain, to_bind=np.diag([1.0, 1.2, 0.9]), authored_sets=tuple(sets))


@pytest.fixture(scope="module", params=[1, 2])
def shaken(request, tmp_path_factory):
    """(model file, displacement (V, 3) of its surface when Python has stepped it as the C++ example does)."""
    character = muscle(request.param)
    model = build(character)
    path = tmp_path_factory.mktemp("model") / "muscle.dynamorph"
    path.write_bytes(model_file.pack(*model.to_arrays()))
    engine = model.engine(character)
    coordinates, weights = shake(engine, [len(each.targets) for each in character.target_sets], bones=2)
    surface = model.surface(engine.displacement(coordinates))
    return path, surface + np.tensordot(weights, model.residual_shapes, 1)


def shake(engine, sizes, bones):
    """(coordinates, target weights) after the motion of the C++ example. sizes: how many targets each set has."""
    simulation = dynamorph.Simulation(engine, 1 / 120, gravity=(0, 0, -9.81))
    ends = np.cumsum(sizes)
    first, last = (np.isin(np.arange(ends[-1]), chosen).astype(float) for chosen in (ends - sizes, ends - 1))
    steps = np.arange(121)
    moved = np.tile(np.eye(3, 4), (121, bones, 1, 1))
    moved[:, :, 0, 3] = 0.02 * np.sin(0.2 * steps)[:, None]
    weights = first + steps[:, None] / 120 * (last - first)
    simulation.start(moved[0], moved[0], weights[0])
    simulation.advance(moved[1:], weights[1:])
    return simulation.coordinates, weights[-1]


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """The C++ example, which has found the installed engine."""
    folder = tmp_path_factory.mktemp("example")
    run(CMAKE, "--install", BUILD, "--component", "engine", "--prefix", folder / "installed")
    configured(folder / "build", CMAKE_PREFIX_PATH=folder / "installed")
    run(CMAKE, "--build", folder / "build")
    return folder / "build/shake"


@in_build_folder
def test_a_program_in_cpp_moves_as_python_does(program, shaken):
    """Whatever number of targets and sets the model has."""
    path, expected = shaken
    displacement = np.loadtxt(run(program, path).splitlines())
    assert np.abs(expected).max() > 0.01
    np.testing.assert_allclose(displacement, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@in_build_folder
def test_the_program_in_cpp_says_what_it_needs(program, tmp_path):
    for arguments in ([], ["a.dynamorph", "b.dynamorph"]):
        done = tried(program, *arguments)
        assert (done.returncode, done.stdout) == (2, "")
        assert done.stderr.startswith("usage: shake MODEL\n")
    (tmp_path / "other.dynamorph").write_bytes(b"something else, that is long enough")
    for path, reason in ((tmp_path / "missing", "cannot be read"), (tmp_path / "other.dynamorph", "not a Dynamorph")):
        done = tried(program, path)
        assert done.returncode == 1 and done.stderr.startswith("shake: ") and reason in done.stderr


@in_build_folder
def test_installed_headers_need_eigen_alone(tmp_path):
    """And no library but the engine's own is left to be found."""
    run(CMAKE, "--install", BUILD, "--component", "engine", "--prefix", tmp_path)
    headers = list((tmp_path / "include/dynamorph").rglob("*.hpp"))
    assert headers
    for header in headers:
        for line in header.read_text().splitlines():
            if line.startswith("#include") and "/" in line:
                assert line.split()[1].startswith(('"dynamorph/', '"Eigen/', "<Eigen/")), f"{header.name}: {line}"
    assert not list(tmp_path.rglob("_core*"))
    targets = next(tmp_path.rglob("dynamorph-targets.cmake")).read_text()
    assert str(ROOT) not in targets and str(BUILD) not in targets


@in_build_folder
def test_another_version_is_not_found(tmp_path):
    run(CMAKE, "--install", BUILD, "--component", "engine", "--prefix", tmp_path)
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.21)\nproject(other LANGUAGES CXX)\n"
        'find_package(dynamorph 99 QUIET)\nmessage(STATUS "found: ${dynamorph_CONSIDERED_VERSIONS}.")\n'
        "if(dynamorph_FOUND)\n  message(FATAL_ERROR wrong)\nendif()\n"
    )
    found = run(CMAKE, "-S", tmp_path, "-B", tmp_path / "build", f"-DCMAKE_PREFIX_PATH={tmp_path}")
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"found: {version}." in found


@in_build_folder
def test_the_engine_is_part_of_another_project(tmp_path):
    """Configured only: it takes minutes to build. Neither Python nor warnings as errors come along."""
    configured(tmp_path, DYNAMORPH_SOURCE=ROOT, CMAKE_EXPORT_COMPILE_COMMANDS="ON")
    commands = (tmp_path / "compile_commands.json").read_text()
    assert "shake.cpp" in commands and "model_file.cpp" in commands
    assert "-Werror" not in commands and "bindings" not in commands


ARM = ROOT / "examples/python/arm.py"


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """(skin as OBJ, model file, what was printed) of the Python example."""
    folder = tmp_path_factory.mktemp("arm")
    skin, model = folder / "arm.obj", folder / "arm.dynamorph"
    printed = run(sys.executable, ARM, skin, model)
    return skin, model, printed


def test_the_program_in_python_goes_from_nothing_to_skinned_points(arm):
    skin, _, printed = arm
    assert "after 180 steps, converged: True" in printed
    lines = [line.split() for line in skin.read_text().splitlines()]
    points = np.array([line[1:] for line in lines if line[0] == "v"], float)
    triangles = np.array([line[1:] for line in lines if line[0] == "f"], int) - 1
    hand = points[-1]  # its middle was 0.3 m from the elbow, which has turned by 100 degrees
    assert np.linalg.norm(hand - [0.3 + 0.3 * np.cos(np.radians(100)), 0, 0.3 * np.sin(np.radians(100))]) < 0.02
    assert points[:, 2][points[:, 0] < 0.2].max() > 0.06  # the radius is 0.05
    volume = np.einsum(
        "ij,ij->i", points[triangles[:, 0]], np.cross(*np.moveaxis(points[triangles[:, 1:]], 1, 0))
    ).sum()
    assert volume / 6 == pytest.approx(np.pi * 0.05**2 * 0.6, rel=0.15)


def test_the_program_in_python_says_what_it_needs():
    done = tried(sys.executable, ARM)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "usage: python arm.py SKIN.obj [MODEL.dynamorph]\n"


def test_what_the_page_has_in_python_is_of_the_program_or_runs(capsys):
    """What is not quoted is one program of its own, and prints what the page says."""
    page = (ROOT / "docs/python.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    program = textwrap.dedent(ARM.read_text())
    quoted = [block for block in blocks if block in program]
    assert len(quoted) > 6
    names: dict = {}
    for block in blocks:
        if block not in quoted:
            exec(block, names)
    assert capsys.readouterr().out == "".join(re.findall(r"^```text\n(.*?)^```", page, re.MULTILINE | re.DOTALL))


@in_build_folder
def test_a_program_in_cpp_loads_what_python_packed(program, arm):
    _, path, _ = arm
    arrays, description = dynamorph.unpack_model(path.read_bytes())
    displacement = np.loadtxt(run(program, path).splitlines())
    assert json.loads(description)["bone_names"] == ["upper arm", "forearm"]
    mesh = dynamorph.TetMesh(arrays["nodes"], arrays["tets"])
    names = ("fill", "stiffness", "region_weights", "pinned", "node_weights")
    body = dynamorph.SoftBody(mesh, *(arrays[name] for name in names))
    targets = [
        dynamorph.MorphTarget("", shape, young=young, poisson=0.4, density=1000, stiffness_damping=0.005)
        for shape, young in zip(arrays["displacements"], (20e3, 80e3), strict=True)
    ]
    law = dynamorph.MaterialModel.STABLE_STVK
    tables = dynamorph.ReducedTables(law, arrays["basis"], list(arrays["table_lambda"]), list(arrays["table_mu"]))
    engine = dynamorph.ReducedModel(body, targets, tables, dynamorph.Blending.EVEN)
    coordinates, _ = shake(engine, [2], bones=3)
    embedding = dynamorph.Embedding(arrays["embedding_nodes"], arrays["embedding_weights"])
    expected = embedding.interpolate(engine.displacement(coordinates)) + arrays["residual_shapes"][1]
    np.testing.assert_allclose(displacement, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
