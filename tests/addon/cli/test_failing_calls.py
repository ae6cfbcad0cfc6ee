# SPDX-License-Identifier: GPL-3.0-or-later
"""A full disk, a lost network: any write, fsync, rename or open of a command may fail, and nothing is lost."""

import bpy
import long_runs
import pytest
import shim

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

COMMANDS = ("build", "bake", "save", "pc2", "cache", "gltf", "fbx", "alembic", "usd", "raw")


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return shim.compiled(tmp_path_factory.mktemp("shim"))


@pytest.mark.fault("C06", "F13")
@pytest.mark.parametrize("name", COMMANDS)
def test_any_call_may_fail(library, name):
    found = shim.attacked(library, "files.py", name, 0 if shim.ALL else 1)
    if shim.ALL:
        long_runs.keep("faults", f"{name}, Blender {bpy.app.version_string}", **found)
    assert found["wrong"] == []
    assert found["calls"]["write"][0] and found["calls"]["rename"][0]
