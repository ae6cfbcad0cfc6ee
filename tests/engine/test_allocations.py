# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory that is refused at any allocation of the engine: MemoryError, and the same objects serve on."""

import sys

import long_runs
import pytest
import shim

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

# Calls that may end the process at some of their allocations, and whose fault it is.
CRASHES = {
    "basis": "Eigen 3.4 frees a matrix twice whose new size is refused",
    "response_basis": "as basis",
    "model_file": "nlohmann's JSON allocates while it is destroyed",
}


@pytest.mark.fault("C08")
def test_every_allocation_of_the_engine_may_fail(tmp_path):
    found = shim.attacked(shim.compiled(tmp_path), "allocations.py", 0 if shim.ALL else 6)
    if shim.ALL:
        for name, of_call in found.items():
            long_runs.keep("allocations", f"{name}, Python {sys.version_info[0]}.{sys.version_info[1]}", **of_call)
    assert len(found) > 20
    for name, of_call in found.items():
        assert of_call["wrong"] == [], name
        assert len(of_call["crashed"]) <= (0.05 * of_call["allocations"] if name in CRASHES else 0), name
        assert of_call["refused"] >= 0.9 * of_call["tried"] - 1, name  # a few are optional
