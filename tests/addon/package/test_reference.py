# SPDX-License-Identifier: GPL-3.0-or-later
"""The pages of the command line and of scripting: their tables are those of the extension, and their examples run."""

import re
import shutil
import sys
from pathlib import Path

import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.cli import main

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
ROOT = Path(__file__).parents[3]
sys.path.append(str(ROOT / "tools"))

import reference  # noqa: E402


def page(name):
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


@pytest.mark.skipif(bpy.app.version[:2] != reference.VERSION, reason="the pages are made with another Blender")
@pytest.mark.parametrize("name", reference.PAGES)
def test_tables_are_up_to_date(scene, name):
    assert reference.renewed(name) == page(name), "run: python tools/reference.py"


def test_every_exit_code_is_explained():
    codes = main.DONE, main.BAD_INPUT, main.SELF_CHECK_FAILED, main.FAULT, main.TRY_AGAIN, main.INTERRUPTED
    assert [int(code) for code in re.findall(r"^\| (\d+) \|", page("command_line.md"), re.MULTILINE)] == [*codes]


def test_common_tasks_are_understood(addon):
    _, tasks = page("command_line.md").split("## Common tasks")
    lines = re.findall(r"^python -m dynamic_morph_targets (.+)$", tasks.split("##")[0], re.MULTILINE)
    assert len(lines) >= 8
    for line in lines:
        assert main.parser(opens_file=True).parse_args(line.split()).run


def test_examples_of_scripting_run(scene, tmp_path, monkeypatch, capsys):
    """In order, as one script."""
    (tmp_path / "sample_blends").mkdir()
    shutil.copy(ROOT / "sample_blends/bulging_cylinder.blend", tmp_path / "sample_blends")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PWD", str(tmp_path))  # where Blender looks
    before = list(bpy.app.handlers.load_post)
    blocks = re.findall(r"^```python\n(.*?)^```", page("scripting.md"), re.MULTILINE | re.DOTALL)
    assert len(blocks) > 12
    names = {}
    for block in blocks:
        exec(compile(block, "docs/scripting.md", "exec"), names)
    said = capsys.readouterr().out
    for text in (
        "['Neutral']",
        "['Bone 3', 'Bone 4']",
        " Hz, settles in",
        "60 frames in",
        "The skin moves most",
        "driven: 1.0",
    ):
        assert text in said
    assert "no shape key 'No such key'" in said and "There is a bake: True" in said
    assert (tmp_path / "limb.glb").stat().st_size > 1e5 and (tmp_path / "limb.npz").stat().st_size > 1e5
    assert bpy.app.handlers.load_post == before
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "sample_blends/bulging_cylinder_baked.blend"))
    assert bpy.data.objects["Limb"].dynamorph.bake.summary.startswith("20 frames")
