# SPDX-License-Identifier: GPL-3.0-or-later
"""Random setups and command lines: taken, or refused with a sentence; never a bug."""

import json
from contextlib import chdir
from pathlib import Path

import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.cli import main
from bl_ext.user_default.dynamic_morph_targets.core import engine, errors
from bl_ext.user_default.dynamic_morph_targets.write.authoring import setups
from builders import make_arm, make_soft
from fuzzing import EDIT, edited, target
from hypothesis import strategies as st

EDITS = st.lists(EDIT, min_size=1, max_size=3)
PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**70), 2**70) | st.floats() | st.text(max_size=8)
    | st.sampled_from(["", "Basis", "flexed", "lower", "\ud800", "\0"]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=6,
)  # fmt: skip


@pytest.fixture(scope="module")
def soft(addon):
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    return make_soft(make_arm(bpy.context.scene))


@pytest.fixture(scope="module")
def saved(soft, tmp_path_factory) -> Path:
    """The file of a setup."""
    path = tmp_path_factory.mktemp("setups") / "saved.json"
    assert bpy.ops.dynamorph.save_setup(filepath=str(path)) == {"FINISHED"}
    return path


def load(path: Path, obj):
    """Apply a setup as the button does."""
    try:
        setups.apply(obj, setups.read(path))
    except engine.expected_errors() as error:
        assert errors.sentence(error)


@target(EDITS, examples=60)
def test_setups_of_edited_bytes(soft, saved, tmp_path_factory, edits):
    setup = tmp_path_factory.getbasetemp() / "setup.json"
    setup.write_bytes(edited(saved.read_bytes(), edits))
    load(setup, soft)


def places(data, way=()):
    """The way to each value in nested lists and dictionaries."""
    yield way
    for key, value in data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ():
        yield from places(value, (*way, key))


@target(st.floats(0, 1, exclude_max=True), PLAIN, examples=60)
def test_setups_with_another_value(soft, saved, tmp_path_factory, where, value):
    data = json.loads(saved.read_text(encoding="utf-8"))
    ways = list(places(data))[1:]
    *way, last = ways[int(where * len(ways))]
    inner = data
    for key in way:
        inner = inner[key]
    inner[last] = value
    setup = tmp_path_factory.getbasetemp() / "setup.json"
    setup.write_text(json.dumps(data), encoding="utf-8")
    load(setup, soft)


COMMANDS = ("check", "bake", "build", "report", "fit", "shape", "collect", "delete-bake", "info", "nonsense")
WORDS = (
    "--object", "Arm", "--all", "-o", "{folder}/out.blend", "--in-place", "--frames", "1", "3", "-1", "--substeps",
    "--report", "{folder}/report.json", "--set", "flexed.stiffness=1e4", "flexed.x=1", "=", "--format", "gltf", "pc2",
    "--output-file", "{folder}/a.glb", "{folder}/nowhere/a.glb", "--cache-dir", "{folder}/caches", "--modes",
    "--cage-nodes", "1e400", "nan", "--loop", "--no-loop", "--clips", "actions", "--methods", "--json", "--target",
    "--collision", "--collection", "--no-bake-full",
    "flexed", "--oscillation", "{folder}", "{folder}/none.csv", "--expect", "--progress", "openjd", "--help", "--", "",
    " ", "\ud800", "a\0b", "x" * 300, "{shot}",
)  # fmt: skip


@pytest.fixture(scope="module")
def shot(addon, tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    obj = make_soft(make_arm(bpy.context.scene))
    obj.dynamorph.model.cage_nodes, obj.dynamorph.model.modes = 60, 3
    bpy.context.scene.frame_end = 3
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "shot.blend"))
    with chdir(folder):  # a word may be taken as the name of a file to write
        yield folder / "shot.blend"


@target(st.sampled_from(COMMANDS), st.booleans(), st.lists(st.sampled_from(WORDS), max_size=7), examples=60)
def test_command_lines(shot, command, named, words):
    arguments = [command, *(["{shot}"] if named else []), *words]
    given = [each.format(shot=shot, folder=shot.parent) for each in arguments]
    assert main.main(given, opens_file=True) in (0, 2, 75)
