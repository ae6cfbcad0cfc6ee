# SPDX-License-Identifier: GPL-3.0-or-later
"""A full disk, a lost network: a write, fsync, rename or open of a command fails, and nothing is lost. Here a few do;
`make -C evidence faults` lets every one fail.
"""

import bpy
import long_runs
import pytest
import shim

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

WRITER = ("bake", "save", "cache")  # all files are written by the same code, and here all kinds of calls fail
FORMATS = ("pc2", "gltf", "fbx", "alembic", "usd")  # have code of their own that writes
KINDS = ("write", "fsync", "rename", "open", "read")


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return shim.compiled(tmp_path_factory.mktemp("shim"))


def attack(library, samples, kinds, *names):
    return shim.attacked(library, "files.py", samples, ",".join(kinds), *names)


def assert_nothing_lost(found):
    assert {name: each["wrong"] for name, each in found.items() if each["wrong"]} == {}
    assert all(each["calls"][kind][0] for each in found.values() for kind in ("write", "rename"))


@pytest.mark.fault("C06", "F13")
def test_any_call_of_the_writer_may_fail(library):
    assert_nothing_lost(attack(library, 1, KINDS, *WRITER))


@pytest.mark.fault("C06", "F13")
def test_what_a_format_writes_may_fail(library):
    assert_nothing_lost(attack(library, 1, ["write", "rename", "open"], *FORMATS))


@pytest.mark.skipif(not shim.ALL, reason="takes 20 minutes: make -C evidence faults")
@pytest.mark.parametrize("name", ["build", "save", *WRITER, *FORMATS])
def test_any_call_may_fail(library, name):
    found = attack(library, 0, KINDS, name)
    long_runs.keep("faults", f"{name}, Blender {bpy.app.version_string}", **found[name])
    assert_nothing_lost(found)
