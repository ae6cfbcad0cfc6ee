# SPDX-License-Identifier: GPL-3.0-or-later
"""Every fault of tests/faults.toml has a test that is marked with its id, and a row on docs/reliability.md."""

import ast
import re
import tomllib
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[2]
FAULTS = {
    name: fault
    for group in tomllib.loads((ROOT / "tests" / "faults.toml").read_text(encoding="utf-8")).values()
    for name, fault in group.items()
}


def marked(source: str) -> list[str]:
    """The ids of all `pytest.mark.fault(...)` in a test file, which is not imported."""
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
    marks = [call for call in calls if ast.unparse(call.func) == "pytest.mark.fault"]
    return [ast.literal_eval(argument) for mark in marks for argument in mark.args]


def test_every_fault_has_a_test_and_every_mark_is_a_fault():
    """A mark names each of its faults once, at the test that shows it."""
    files = [path for folder in ("engine", "addon") for path in (ROOT / "tests" / folder).rglob("test_*.py")]
    shown = Counter(name for path in files for name in marked(path.read_text(encoding="utf-8")))
    assert [name for name in FAULTS if not shown[name]] == []
    assert [name for name in shown if name not in FAULTS] == []


def test_marks_are_found():
    source = '@pytest.mark.fault("M01", "M02")\ndef test_a(): pass\npytest.param(1, marks=pytest.mark.fault("K01"))\n'
    assert marked(source) == ["M01", "M02", "K01"]


def test_faults_are_described():
    assert all({"fault", "expected"} <= set(fault) <= {"fault", "expected", "elsewhere"} for fault in FAULTS.values())
    makefile = (ROOT / "evidence/Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"^([a-z-]+):", makefile, re.MULTILINE))
    elsewhere = [fault["elsewhere"] for fault in FAULTS.values() if "elsewhere" in fault]
    assert elsewhere and all(re.match(r"`make -C evidence ([a-z-]+)`", text)[1] in targets for text in elsewhere)


def test_the_page_has_a_row_for_each():
    page = (ROOT / "docs" / "reliability.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\w\d\d) \| (.+?) \| (.+?) \|", page, re.MULTILINE)
    assert rows == [(name, fault["fault"], fault["expected"]) for name, fault in FAULTS.items()]
