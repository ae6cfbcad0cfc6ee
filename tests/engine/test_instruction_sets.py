# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of each instruction set: chosen as asked for, apart in the binary, and equal in what they do."""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
import sys
from pathlib import Path

import dynamorph
import numpy as np
import pytest
import test_layout
import test_physics

SETS = ["baseline", "avx2", "avx512"] if platform.machine() in ("x86_64", "AMD64") else ["baseline"]
ROOT = Path(__file__).parents[2]
BUILD = Path(dynamorph._core.__file__).resolve().parents[2]  # of CMake, where the compiled module lies
TESTS = BUILD / "engine_tests"
# Source files of the C++ tests that run kernels.
WITH_KERNELS = "*/elastic/*,*/models/*,*/reduced/*,*/step/*,*/simd/*"
# Symbols with many copies; the linker keeps one, perhaps that for another instruction set.
MERGED = set("WwVvui")
OUTSIDE = re.compile(r"^(mem(cpy|set|move)|sqrtf?|_GLOBAL_OFFSET_TABLE_|__stack_chk_fail)$")


def run(*command, instruction_set=None, **variables):
    environment = {key: value for key, value in os.environ.items() if key != "DYNAMORPH_ISA"} | variables
    if instruction_set is not None:
        environment["DYNAMORPH_ISA"] = instruction_set
    return subprocess.run([str(word) for word in command], env=environment, capture_output=True, text=True, check=False)


def available():
    """The instruction sets of this processor: the best one has all before it."""
    found = run(sys.executable, "-c", "import dynamorph; print(dynamorph.instruction_set())")
    return SETS[: SETS.index(found.stdout.strip()) + 1]


def shared_symbols(listing: str, instruction_set: str) -> list[str]:
    """What `nm -C` lists of a kernel object that another object could have, too."""
    wrong = []
    for line in listing.splitlines():
        kind, name = re.match(r"^[0-9a-f ]{16} (\S) (.*)$", line).groups()
        own = name.startswith(f"dynamorph::{instruction_set}::")
        foreign = kind in "TDBR" and not own
        if kind in MERGED or foreign or (kind == "U" and not OUTSIDE.match(name)):
            wrong.append(line)
    return wrong


def test_the_check_finds_shared_symbols():
    good = "0000000000000000 T dynamorph::avx2::dot(double)\n                 U memset\n0000000000000008 r .LC1\n"
    assert shared_symbols(good, "avx2") == []
    for bad in (
        "0000000000000000 W Eigen::Matrix<double, 3, 1>::Matrix()",
        "0000000000000000 V vtable for std::exception",
        "0000000000000000 u std::piecewise_construct",
        "0000000000000000 T dynamorph::baseline::dot(double)",
        "0000000000000000 T dynamorph::weigh(double)",
        "                 U std::__throw_length_error(char const*)",
    ):
        assert shared_symbols(good + bad, "avx2") == [bad]


def test_kernels_include_no_library_with_inline_functions():
    graph = test_layout.includes_of(ROOT / "cpp")
    kernels = [path for path in graph if path.name.endswith("_kernels.cpp")]
    assert len(kernels) >= 7
    for kernel in kernels:
        seen = {kernel}
        while more := {other for path in seen for other in graph[path]} - seen:
            seen |= more
        for path in seen:
            others = set(re.findall(r"^\s*#\s*include\s*<([^>]+)>", path.read_text(encoding="utf-8"), re.MULTILINE))
            assert others <= {"stddef.h", "immintrin.h", "arm_neon.h"}, f"{kernel.name} through {path}"


@pytest.mark.parametrize("instruction_set", SETS)
def test_kernels_share_no_inline_function(instruction_set):
    """The linker keeps one copy of an inline function: that of AVX-512 would stop a baseline processor."""
    if shutil.which("nm") is None:
        pytest.skip("nm is not installed")
    objects = sorted((BUILD / "CMakeFiles" / f"dynamorph_{instruction_set}.dir").rglob("*.o"))
    if not objects:
        pytest.skip("the engine was not built here")
    assert len(objects) >= 7
    for path in objects:
        listing = subprocess.run(["nm", "-C", path], capture_output=True, text=True, check=True).stdout
        assert " T dynamorph::" in listing, path
        assert shared_symbols(listing, instruction_set) == [], path


@pytest.mark.parametrize("instruction_set", SETS)
def test_engine_tests_pass_with_each(instruction_set):
    if instruction_set not in available():
        pytest.skip(f"this processor does not have {instruction_set}")
    if not TESTS.exists():
        pytest.skip("the C++ tests were not built")
    found = run(TESTS, f"--source-file={WITH_KERNELS}", instruction_set=instruction_set)
    assert found.returncode == 0, found.stdout + found.stderr
    assert int(re.search(r"(\d+) passed", found.stdout)[1]) >= 20


def qemu():
    """The words that run an x86-64 program on a processor with SSE2 to SSE3 alone."""
    if shutil.which("qemu-x86_64") is None:
        pytest.skip("qemu-x86_64 is not installed: tools/setup.sh emulate")
    if len(SETS) == 1 or not TESTS.exists():
        pytest.skip("not an x86-64, or the C++ tests were not built")
    return ["qemu-x86_64", "-cpu", "core2duo"]


def test_a_processor_without_avx_runs_the_baseline():
    """Whatever instruction it does not have would end the process."""
    small = "*instruction set*,*sums of row products*,*inertia of nodes*,*a force that is not finite*"
    found = run(*qemu(), TESTS, f"--test-case={small}")
    assert found.returncode == 0, found.stdout + found.stderr
    assert int(re.search(r"(\d+) passed", found.stdout)[1]) >= 5


def test_an_instruction_set_that_the_processor_lacks_is_refused():
    found = run(*qemu(), TESTS, "--test-case=*sums of row products*", instruction_set="avx2")
    assert found.returncode == 1  # not by a signal
    assert "DYNAMORPH_ISA: this processor does not have avx2" in found.stdout


def test_a_word_that_is_none_stops_the_import():
    found = run(sys.executable, "-c", "import dynamorph", instruction_set="sse9")
    assert found.returncode == 1
    assert "DYNAMORPH_ISA: expected baseline" in found.stderr and "'sse9'" in found.stderr


def save_motion(path: str) -> None:
    """Coordinates of the full and of the reduced model after some steps of a swinging bar."""
    found = {}
    for reduced in (False, True):
        model, _, _ = test_physics.sculpted(
            dynamorph.MaterialModel.STVK, dynamorph.Blending.EVEN, reduced, cells=(8, 3, 3)
        )
        rig, weights = test_physics.swing(model, 8)
        simulation = test_physics.simulation_of(model)
        simulation.start(rig[0], rig[1], weights[0])
        simulation.advance(rig[1:], weights[1:])
        found[f"reduced{reduced}"] = model.displacement(simulation.coordinates)
    np.savez(path, **found)


@pytest.mark.fault("S02")
def test_instruction_sets_move_alike_and_each_makes_the_same_bytes(tmp_path):
    def motion(instruction_set, name):
        code = f"import test_instruction_sets; test_instruction_sets.save_motion({str(tmp_path / name)!r})"
        path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
        found = run(sys.executable, "-c", code, instruction_set=instruction_set, PYTHONPATH=path)
        assert found.returncode == 0, found.stderr
        with np.load(tmp_path / name) as arrays:
            return dict(arrays)

    expected = motion("baseline", "baseline.npz")
    for instruction_set in available():
        found, again = (motion(instruction_set, f"{instruction_set}{k}.npz") for k in range(2))
        for key, displacement in found.items():
            assert displacement.tobytes() == again[key].tobytes()
            assert np.linalg.norm(displacement - expected[key]) <= 1e-5 * np.linalg.norm(expected[key])
