# SPDX-License-Identifier: GPL-3.0-or-later
"""The pages of the command line and of scripting: their tables are those of the extension, and their examples run."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.cli import main

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
import reference

ROOT = Path(__file__).parents[3]


def page(name):
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


@pytest.mark.skipif(bpy.app.version[:2] != reference.VERSION, reason="the pages are made with another Blender")
@pytest.mark.parametrize("name", reference.PAGES)
def test_tables_are_up_to_date(scene, name):
    assert reference.renewed(name) == page(name), "run: python evidence/reference.py"


def test_every_exit_code_is_explained():
    codes = main.DONE, main.BAD_INPUT, main.SELF_CHECK_FAILED, main.FAULT, main.TRY_AGAIN, main.INTERRUPTED
    assert [int(code) for code in re.findall(r"^\| (\d+) \|", page("command_line.md"), re.MULTILINE)] == [*codes]


def test_common_tasks_are_understood(addon):
    _, tasks = page("command_line.md").split("## Common tasks")
    lines = re.findall(r"^python -m dynamic_morph_targets (.+)$", tasks.split("##")[0], re.MULTILINE)
    assert len(lines) >= 8
    for line in lines:
        assert main.parser(opens_file=True).parse_args(line.split()).run


LEFT = "print('left:', [each for each in bpy.app.handlers.load_post if each.__module__ == __name__])"


def test_scripting_runs_as_a_script_of_the_wheel(scene, tmp_path):
    """All examples in order, by a process that knows the wheels alone, and that ends."""
    (tmp_path / "sample_blends").mkdir()
    shutil.copy(ROOT / "sample_blends/bulging_cylinder.blend", tmp_path / "sample_blends")
    blocks = re.findall(r"^```python\n(.*?)^```", page("scripting.md"), re.MULTILINE | re.DOTALL)
    assert len(blocks) > 12
    script = tmp_path / "page.py"
    script.write_text("\n".join([*blocks, LEFT]), encoding="utf-8")
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(tmp_path / "user"), "PWD": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, script],
        cwd=tmp_path, env=environment, timeout=300, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    for text in (
        "['Neutral']",
        "['Bone 3', 'Bone 4']",
        " Hz, settles in",
        "60 frames in",
        "The skin moves most",
        "driven: 1.0",
        "no shape key 'No such key'",
        "There is a bake: True",
        "left: []",
    ):
        assert text in done.stdout
    assert (tmp_path / "limb.glb").stat().st_size > 1e5
    assert [path.name for path in (tmp_path / "sample_blends").iterdir()] == ["bulging_cylinder.blend"]
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "baked/bulging_cylinder.blend"))
    assert bpy.data.objects["Limb"].dynamorph.bake.summary.startswith("20 frames")


LAST_LINES = {
    "registered": "",
    "opened": "bpy.ops.wm.open_mainfile(filepath=sample)",
    "baked": "bpy.ops.wm.open_mainfile(filepath=sample); limb = bpy.data.objects['Limb']\n"
    "bpy.context.view_layer.objects.active = limb; limb.dynamorph.simulation.use_scene_range = False\n"
    "limb.dynamorph.simulation.frame_end = 3; bpy.ops.dynamorph.bake()",
    "unregistered": "bpy.ops.wm.open_mainfile(filepath=sample); extension.unregister()",
    "registered again": "extension.unregister(); extension.register(); bpy.ops.wm.open_mainfile(filepath=sample)",
    "failed": "bpy.ops.wm.open_mainfile(filepath=sample); raise SystemExit(3)",
}


@pytest.mark.parametrize("last", LAST_LINES)
def test_a_script_ends(last, tmp_path):
    script = "import sys, bpy, dynamic_morph_targets as extension\nextension.register(); sample = sys.argv[1]\n"
    done = subprocess.run(
        [sys.executable, "-c", script + LAST_LINES[last], ROOT / "sample_blends/bulging_cylinder.blend"],
        env={**os.environ, "TMPDIR": str(tmp_path)}, timeout=120, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == (3 if last == "failed" else 0), done.stderr
    assert not any(tmp_path.iterdir()), "Blender has left its temporary folder"
