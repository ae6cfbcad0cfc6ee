# SPDX-License-Identifier: GPL-3.0-or-later
"""A full disk, a lost network: any write, fsync, rename or open of a command may fail, and nothing is lost."""

import pytest
import shim

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

COMMANDS = ("build", "bake", "save", "pc2", "cache", "gltf", "fbx", "alembic", "usd", "raw")
UNTIL_TRANSACTIONS = {
    name: f"until exports and saves are transactions: {why}"
    for name, why in {
        "build": "Blender moves the earlier .blend away before the new one is in its place",
        "bake": "as build",
        "save": "as build",
        "pc2": "as build",
        "cache": "as build",
        "gltf": "exit code 2 on a full disk, and a traceback as the message",
        "fbx": "as gltf",
        "alembic": "the process aborts on a full disk",
        "usd": "success on a full disk, and the earlier file is lost",
    }.items()
}


def marked(name: str):
    why = UNTIL_TRANSACTIONS.get(name)
    return pytest.param(name, marks=pytest.mark.xfail(strict=shim.ALL, reason=why)) if why else name


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return shim.compiled(tmp_path_factory.mktemp("shim"))


@pytest.mark.fault("C06", "F13")
@pytest.mark.parametrize("name", [marked(name) for name in COMMANDS])
def test_any_call_may_fail(library, name):
    found = shim.attacked(library, "files.py", name, 0 if shim.ALL else 1)
    print(found["calls"])
    assert found["wrong"] == []
    assert found["calls"]["write"][0] and found["calls"]["rename"][0]
