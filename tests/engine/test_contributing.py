# SPDX-License-Identifier: GPL-3.0-or-later
"""What a contributor reads is true: recipes name files that exist, and `make help` lists all targets."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = [ROOT, ROOT / "addon/dynamic_morph_targets", ROOT / "cpp/dynamorph"]  # that paths are relative to


def named_files(text: str) -> set[str]:
    """All `path/to/file` of a page that are not commands."""
    return set(re.findall(r"`([\w*][^`\s]*/[^`\s]+\.\w+)`", text))


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/architecture.md"])
def test_named_files_exist(page):
    names = named_files((ROOT / page).read_text(encoding="utf-8"))
    assert len(names) > 10
    assert [name for name in sorted(names) if not any(any(folder.glob(name)) for folder in FOLDERS)] == []


def test_help_lists_every_target_with_a_text():
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    targets = re.search(r"^\.PHONY: ((?:.*\\\n)*.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    shown = subprocess.run(["make", "help"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    described = dict(re.findall(r"^make (\S+)\n((?:    .+\n)+)", shown, re.MULTILINE))
    assert set(described) == set(targets[1].replace("\\\n", " ").split())


def test_setup_refuses_a_group_that_it_does_not_have():
    if shutil.which("bash") is None:
        pytest.skip("bash is not installed")
    run = subprocess.run(["bash", ROOT / "tools/setup.sh", "nonsense"], capture_output=True, text=True, check=False)
    assert run.returncode == 2 and "bench, coverage, emulate, farm, openjd, platforms and wheels" in run.stderr


PYTHON = """#!/bin/bash
# In the place of a Python: makes environments that are like itself, installs nothing.
case "$*" in
  "-m venv "*) mkdir -p "$3/bin" && cp "$0" "$3/bin/python" ;;
  *purelib*) dirname "$0" ;;
esac
"""


@pytest.mark.parametrize("groups, installed", [([], False), (["openjd"], True), (["farm"], True)])
def test_setup_installs_what_few_need_where_it_is_named(tmp_path, groups, installed):
    if shutil.which("bash") is None:
        pytest.skip("bash is not installed")
    programs = {"packages/dpkg-query": "#!/bin/bash\necho -n installed\n"}
    for version in ("3.11", "3.13"):
        programs[f".venv/{version}/bin/python"] = PYTHON
    for name, text in programs.items():
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)
    shutil.copytree(ROOT / "tools", tmp_path / "tools")
    search = f"{tmp_path / 'packages'}:{os.environ['PATH']}"
    subprocess.run(
        ["bash", tmp_path / "tools/setup.sh", *groups],
        env=os.environ | {"PATH": search},
        capture_output=True,
        check=True,
    )
    assert (tmp_path / "build/openjd/requirements.txt").exists() == installed
