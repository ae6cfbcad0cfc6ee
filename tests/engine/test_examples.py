# SPDX-License-Identifier: GPL-3.0-or-later
"""The programs in examples/ build, run, and give the right results."""

import re
import shutil
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import dynamorph
import numpy as np
import pytest
import scenes
import trimesh
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
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, check=False, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def configured(folder, **settings):
    """The C++ example, configured as the engine was."""
    cache = dict(re.findall(r"^(\w+):\w+=(.*)$", (BUILD / "CMakeCache.txt").read_text(), re.MULTILINE))
    kept = {name: cache[name] for name in ("CMAKE_MAKE_PROGRAM", "CMAKE_CXX_COMPILER")}
    options = [f"-D{name}={value}" for name, value in (kept | settings).items()]
    return run(CMAKE, "-S", ROOT / "examples/cpp", "-B", folder, "-G", cache["CMAKE_GENERATOR"], *options)


def muscle():
    """A bar that bulges when it flexes, in an object that is scaled; its materials are those of the C++ example."""

    def material(lame_lambda, lame_mu):
        young = lame_mu * (3 * lame_lambda + 2 * lame_mu) / (lame_lambda + lame_mu)
        poisson = lame_lambda / (2 * (lame_lambda + lame_mu))
        return Material(young, poisson, 1000.0, mass_damping=0.0, stiffness_damping=0.005)

    plain = bar(solver="REDUCED", material_model="STABLE_STVK", cage_nodes=300)
    (one,) = plain.target_sets
    (neutral,) = one.targets
    bulge = scenes.bulge(plain.vertices, center=0.4, width=0.15, amount=0.02)
    relaxed = replace(neutral, material=material(28.6e3, 7.14e3))
    flexed = Target("Flexed", bulge, (), neutral.local, neutral.rig_world, material(114e3, 28.6e3))
    return replace(
        plain,
        to_bind=np.diag([1.0, 1.2, 0.9]),
        authored_sets=(TargetSet("Bar", (relaxed, flexed), one.region_weights),),
    )


@pytest.fixture(scope="module")
def shaken(tmp_path_factory):
    """(model file, displacement (V, 3) of its surface when Python has stepped it as the C++ example does)."""
    character = muscle()
    model = build(character)
    path = tmp_path_factory.mktemp("model") / "muscle.dynamorph"
    path.write_bytes(model_file.pack(*model.to_arrays()))
    engine = model.engine(character)
    simulation = dynamorph.ReducedSimulation(engine, 1 / 120, gravity=(0, 0, -9.81))
    steps = np.arange(121)
    bones = np.tile(np.eye(3, 4), (121, 2, 1, 1))
    bones[:, :, 0, 3] = 0.02 * np.sin(0.2 * steps)[:, None]
    weights = np.column_stack([1 - steps / 120, steps / 120])
    simulation.start(bones[0], bones[0], weights[0])
    simulation.advance(bones[1:], weights[1:])
    surface = model.surface(engine.displacement(simulation.coordinates))
    return path, surface + np.tensordot(weights[-1], model.residual_shapes, 1)


@in_build_folder
def test_a_program_in_cpp_finds_the_installed_engine_and_moves_as_python_does(tmp_path, shaken):
    path, expected = shaken
    run(CMAKE, "--install", BUILD, "--component", "engine", "--prefix", tmp_path / "installed")
    configured(tmp_path / "build", CMAKE_PREFIX_PATH=tmp_path / "installed")
    run(CMAKE, "--build", tmp_path / "build")
    displacement = np.loadtxt(run(tmp_path / "build/shake", path).splitlines())
    assert np.abs(expected).max() > 0.01
    np.testing.assert_allclose(displacement, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


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


def test_a_program_in_python_needs_no_blender(tmp_path):
    out = run(sys.executable, ROOT / "examples/python/wobble.py", tmp_path / "ball.obj")
    assert "'converged': True" in out
    ball = trimesh.load(tmp_path / "ball.obj", process=False)  # its vertices as they are
    still = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    moved = np.linalg.norm(ball.vertices - still.vertices, axis=1)
    assert 0.002 < moved.max() < 0.05
    assert ball.volume == pytest.approx(still.volume, rel=0.1)
