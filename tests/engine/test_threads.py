# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine makes the same bytes whatever the number of threads."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import dynamorph
import numpy as np
import pytest
import test_physics

CORES = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()


def digest() -> str:
    """Of a basis, its polynomials, and steps of both models, on a bar that several chunks of work share."""
    found = hashlib.sha256()
    full, _, _ = test_physics.sculpted(dynamorph.Law.STVK, dynamorph.Blending.EVEN, False, cells=(16, 4, 4))
    basis = dynamorph.make_basis(full, 12).U
    tables = dynamorph.reduce(full, basis)
    for array in (basis, *tables.lame_lambda, *tables.lame_mu):
        found.update(np.ascontiguousarray(array).tobytes())
    reduced, _, _ = test_physics.sculpted(dynamorph.Law.STVK, dynamorph.Blending.EVEN, True, cells=(16, 4, 4))
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
@pytest.mark.parametrize("module", ["test_threads", "test_responses"])
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
