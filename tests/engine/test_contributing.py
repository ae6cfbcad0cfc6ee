# SPDX-License-Identifier: GPL-3.0-or-later
"""What a contributor reads is true: recipes name files that exist, `make help` lists all targets, and what takes long
says how far it is.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import run_tests

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


def sources() -> str:
    """All of them, and what they are made and tested with."""
    folders = ("cpp", "addon", "tests", "evidence", "tools", "sample_blends")
    paths = [path for folder in folders for path in (ROOT / folder).rglob("*")]
    return "\n".join(
        path.read_text(encoding="utf-8") for path in paths if path.suffix in (".py", ".hpp", ".cpp", ".json")
    )


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/architecture.md"])
def test_named_identifiers_exist(page):
    """Those of a recipe's step in one of the files that it names, all others anywhere."""
    text, everything, wrong = (ROOT / page).read_text(encoding="utf-8"), sources(), []
    names = 0
    for step in re.split(r"\n\n|\n(?=\d+\. |- |\| )", re.sub(r"```.*?```", "", text, flags=re.DOTALL)):
        recipe = re.match(r"\d+\. ", step)
        files = [
            path for name in named_files(step if recipe else "") for folder in FOLDERS for path in folder.glob(name)
        ]
        within = "\n".join(path.read_text(encoding="utf-8") for path in files) if files else everything
        for name in re.findall(r"`([A-Za-z]\w*(?:_\w+|[A-Z]\w*))(?:\(\))?`", step):
            names += 1
            if not re.search(rf"\b{name}\b", within) and name not in str(files):
                wrong.append(f"{name} in {[path.name for path in files] or 'any source'}")
    assert names > 10
    assert wrong == []


def targets(folder: str) -> set[str]:
    """What a Makefile can make."""
    makefile = (ROOT / folder / "Makefile").read_text(encoding="utf-8")
    return set(re.search(r"^\.PHONY: ((?:.*\\\n)*.*)$", makefile, re.MULTILINE)[1].replace("\\\n", " ").split())


@pytest.mark.parametrize("folder, lines", [(".", 50), ("evidence", 80)])
def test_help_lists_every_target_with_a_text(folder, lines):
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    command = ["make", "--no-print-directory", "-C", folder, "help"]
    shown = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert set(re.findall(r"^([a-z-]+) +\w", shown, re.MULTILINE)) == targets(folder)
    assert shown.count("\n") <= lines


def test_few_things_are_made_in_the_root():
    assert len(targets(".")) <= 20


def test_what_pages_say_to_make_can_be_made():
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "evidence").glob("*.md"),
             *(ROOT / ".github/workflows").glob("*.yml")]  # fmt: skip
    text = "\n".join(page.read_text(encoding="utf-8") for page in pages)
    said = set(re.findall(r"(?:`|^ *)make\s+(?:-C\s+(evidence)\s+)?([a-z]+(?:-[a-z]+)*)", text, re.MULTILINE))
    assert len(said) > 20
    assert [(folder, name) for folder, name in said if name not in targets(folder or ".")] == []


def test_make_alone_is_make_help():
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    alone, listed = (
        subprocess.run(["make", *goal], cwd=ROOT, capture_output=True, text=True, check=True).stdout
        for goal in ([], ["help"])
    )
    assert alone == listed


def test_setup_refuses_a_group_that_it_does_not_have():
    if shutil.which("bash") is None:
        pytest.skip("bash is not installed")
    run = subprocess.run(["bash", ROOT / "tools/setup.sh", "nonsense"], capture_output=True, text=True, check=False)
    assert run.returncode == 2 and "bench, coverage, emulate, farm, openjd, platforms, site and wheels" in run.stderr


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


def test_setup_says_once_for_which_blender_there_is_no_python(tmp_path):
    if shutil.which("bash") is None:
        pytest.skip("bash is not installed")
    (tmp_path / "packages").mkdir()
    for name, text in (("dpkg-query", "#!/bin/bash\necho -n installed\n"), ("python3.98", PYTHON)):
        (tmp_path / "packages" / name).write_text(text)
        (tmp_path / "packages" / name).chmod(0o755)
    shutil.copytree(ROOT / "tools", tmp_path / "tools")
    setup = tmp_path / "tools/setup.sh"
    setup.write_text(setup.read_text(encoding="utf-8").replace("3.11", "3.98").replace("3.13", "3.99"))
    environment = os.environ | {"PATH": f"{tmp_path / 'packages'}:{os.environ['PATH']}"}
    command = ["bash", setup]
    said = [
        subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout for _ in range(2)
    ]
    assert "no Python 3.99 (with headers and venv), which Blender 5.2 LTS has" in said[0]
    assert said[1] == ""


RULES = """rule make
  command = touch $out
rule fail
  command = echo why; false
"""


@pytest.mark.parametrize("broken", [False, True])
def test_compiling_says_how_far_it_is_and_nothing_when_all_is_done(tmp_path, broken):
    if not Path(sys.executable).with_name("ninja").exists():
        pytest.skip("ninja is not installed beside this Python")
    (tmp_path / "build/cmake").mkdir(parents=True)
    steps = [f"build step{k}: make" for k in range(40)] + ["build last: fail"] * broken
    (tmp_path / "build/cmake/build.ninja").write_text(RULES + "\n".join(steps) + "\n")
    shutil.copytree(ROOT / "tools", tmp_path / "tools")
    command = [sys.executable, tmp_path / "tools/compile.py", "2", "demo"]
    runs = [subprocess.run(command, capture_output=True, text=True, check=False) for _ in range(2)]
    lines = runs[0].stdout.splitlines()
    assert lines[0] == "compiling the engine for the first time, which takes some minutes; then make demo goes on"
    assert (
        len([line for line in lines if re.fullmatch(r"compiling: \[\d+/4[01]\], less than a minute left", line)]) == 10
    )
    if broken:
        assert "why" in lines and runs[0].returncode and runs[1].returncode
    else:
        assert len(lines) == 11 and [run.returncode for run in runs] == [0, 0]
        assert runs[1].stdout == ""


TESTS = """
import pytest
@pytest.mark.parametrize("n", range(200))
def test_some(n):
    assert n != 20
"""


def test_tests_say_how_far_they_are_and_what_failed_at_once(tmp_path):
    """As `make test` reads it from a pipe."""
    shutil.copy(ROOT / "tests/conftest.py", tmp_path)
    (tmp_path / "test_it.py").write_text(TESTS)
    command = [sys.executable, "-m", "pytest", "-q", *run_tests.COUNTED, tmp_path]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    said = []
    rest = "".join(run_tests.follow(run.stdout.splitlines(keepends=True), said.append))
    assert said[0] == "FAILED test_it.py::test_some[20]"
    assert said[-1] == "100 %, 200 of 200 tests, 1 failed"
    assert "assert 20 != 20" in rest and "1 failed, 199 passed" in rest
