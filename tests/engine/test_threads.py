# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine makes the same bytes whatever the number of threads, and what is thrown in one reaches the caller."""

import hashlib
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import dynamorph
import numpy as np
import pytest
import test_physics

ROOT = Path(__file__).parents[2]
EIGEN = "/usr/include/eigen3", "/usr/local/include/eigen3", "/opt/homebrew/include/eigen3"
CORES = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()


def digest() -> str:
    """Of a basis, its polynomials, and steps of both models, on a bar that several chunks of work share."""
    found = hashlib.sha256()
    full, _, _ = test_physics.sculpted(dynamorph.MaterialModel.STVK, dynamorph.Blending.EVEN, False, cells=(16, 4, 4))
    basis = dynamorph.make_basis(full, 12).U
    tables = dynamorph.reduce(full, basis)
    for array in (basis, *tables.lame_lambda, *tables.lame_mu):
        found.update(np.ascontiguousarray(array).tobytes())
    reduced, _, _ = test_physics.sculpted(dynamorph.MaterialModel.STVK, dynamorph.Blending.EVEN, True, cells=(16, 4, 4))
    for model in (full, reduced):
        rig, weights = test_physics.swing(model, 8)
        simulation = test_physics.simulation_of(model)
        simulation.start(rig[0], rig[1], weights[0])
        simulation.advance(rig[1:], weights[1:])
        found.update(simulation.coordinates.tobytes())
    return found.hexdigest()


def run(code, **variables) -> str:
    """What a fresh Python prints that can import the modules of this folder."""
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    environment = {key: value for key, value in os.environ.items() if key != "DYNAMORPH_ISA"}
    environment |= {"PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1"} | variables
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def report(digest, most: int):
    """The digest, and how many threads are there to do the work, limited to `most`."""
    dynamorph.set_threads(most)
    found = digest()
    print(found, len(list(Path("/proc/self/task").iterdir())))


@pytest.mark.fault("S02")
@pytest.mark.skipif(len(CORES) < 2, reason="one core, or a system that does not pin threads")
@pytest.mark.parametrize("module", ["test_threads", "test_responses", "test_motion_limit"])
def test_one_core_and_all_make_the_same_bytes(module):
    def on(cores, most=0) -> tuple[str, int]:
        found, threads = run(
            f"import os; os.sched_setaffinity(0, {set(cores)!r}); import test_threads, {module}; "
            f"test_threads.report({module}.digest, {most})"
        ).split()
        return found, int(threads)

    (alone, one), (limited, few), (together, several) = on([min(CORES)]), on(CORES, 1), on(CORES)
    assert several > one == few  # or nothing was compared
    assert alone == limited == together


THROWN = {"number": "7", "text": '"a text"', "real": "0.5", "stranger": "Stranger{}", "memory": "std::bad_alloc()"}
MODULE = """
#include <pybind11/pybind11.h>
#include <stdexcept>
#include "dynamorph/core/parallel.hpp"
struct Stranger {};
PYBIND11_MODULE(thrower, m) {
  m.def("work", [](const std::string& what) {
    dynamorph::run_tasks(4, {}, [&](int, const dynamorph::ProgressFn&) {
      CASES
    });
  });
}
"""


@pytest.fixture(scope="module")
def thrower(tmp_path_factory):
    """A module that is bound as the engine is, and throws in the engine's worker threads whatever it is asked for."""
    compiler = next(filter(None, map(shutil.which, ("c++", "g++", "clang++"))), None)
    pybind11 = pytest.importorskip("pybind11", reason="needs pybind11, as a build does")
    eigen = next((path for path in map(Path, EIGEN) if path.is_dir()), None)
    if compiler is None or eigen is None or not Path(sysconfig.get_path("include"), "Python.h").exists():
        pytest.skip("needs a C++ compiler, Eigen and the headers of Python")
    folder, cpp = tmp_path_factory.mktemp("thrower"), ROOT / "cpp"
    cases = "".join(f'if (what == "{name}") throw {thrown};\n' for name, thrown in THROWN.items())
    (folder / "thrower.cpp").write_text(MODULE.replace("CASES", cases))
    includes = [f"-I{path}" for path in (cpp, eigen, pybind11.get_include(), sysconfig.get_path("include"))]
    subprocess.run(
        [compiler, "-std=c++17", "-shared", "-fPIC", "-pthread", *includes, folder / "thrower.cpp",
         cpp / "dynamorph/core/parallel.cpp", "-o", folder / f"thrower{sysconfig.get_config_var('EXT_SUFFIX')}"],
        check=True,
    )  # fmt: skip
    return folder


@pytest.mark.fault("C09")
def test_whatever_a_worker_throws_is_an_error_in_python(thrower):
    """Numbers and strangers too, as old C++ libraries throw them; none ends the process."""
    code = f"""
import sys
sys.path.insert(0, {str(thrower)!r})
import thrower
for what in {list(THROWN)}:
    try:
        thrower.work(what)
    except (RuntimeError, MemoryError) as error:
        print(type(error).__name__)
thrower.work("nothing")
"""
    assert run(code).split() == ["RuntimeError"] * 4 + ["MemoryError"]
