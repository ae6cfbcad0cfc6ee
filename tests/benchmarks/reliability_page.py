# SPDX-License-Identifier: GPL-3.0-or-later
"""`make reliability`: runs the tests of the faults of tests/faults.toml, and writes docs/reliability.md."""

from __future__ import annotations

import os
import sys
import tomllib
import xml.etree.ElementTree as ElementTree
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path

from run import machine

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tools"))

from measured import measured_at  # noqa: E402
from run_tests import SUITES, SUPPORTED, python_of, report_of, run_pytest  # noqa: E402

PAGE = ROOT / "docs" / "reliability.md"
FAULTS = ROOT / "tests" / "faults.toml"
LARGE = {"DYNAMORPH_FACES": "2000000", "DYNAMORPH_KILLS": "10"}  # unless they say otherwise; more than in `make test`
TEXT = """# Reliability

What may go wrong, and what comes of it. The rule for all: never a silent wrong result, never lost work; a message names
the object, the cause and the next step. Each row has tests that are marked with its id, which `make test` runs with all
others. `make reliability` runs these alone and writes this page; nothing on it is written by hand. The largest mesh had
{faces:,} faces, and one bake was killed {kills} times.

{commit}. {machine}.

{count} faults: {totals}.
"""
HEAD = "| Id | Fault | What happens | Tests | Result |\n|---|---|---|---|---|"


@dataclass
class Shown:
    """What came of the tests of one fault. tests: their names by file; outcomes: how many of each, in all Pythons."""

    tests: dict[str, set[str]] = field(default_factory=lambda: defaultdict(set))
    outcomes: Counter[str] = field(default_factory=Counter)
    reasons: set[str] = field(default_factory=set)  # why some were skipped

    @property
    def result(self) -> str:
        """One word: the worst, but for a skip in one Python of what passed in the other."""
        return next((word for word in ("failed", "passed", "skipped") if self.outcomes[word]), "not run")

    def cells(self, elsewhere: str) -> tuple[str, str]:
        """The tests, and what came of them; elsewhere: where more of it is tested."""
        tests = [f"`{file}`: {', '.join(sorted(names))}" for file, names in sorted(self.tests.items())]
        text = self.result if self.result in ("passed", "skipped") else f"**{self.result}**"
        skipped = [f"{self.outcomes['skipped']} skipped: {reason}" for reason in sorted(self.reasons)]
        told = [f"{text} ({self.outcomes.total()})", *skipped, elsewhere]
        return "<br>".join(tests), "<br>".join(filter(None, told))


def main() -> int:
    found: dict[str, Shown] = defaultdict(Shown)
    os.environ.update(LARGE | os.environ)
    for version in SUPPORTED:
        for suite in SUITES if python_of(version).exists() else ():
            run_pytest(version, suite, "-m", "fault", name="faults")
            add_report(found, report_of(version, suite, "faults"))
    groups = tomllib.loads(FAULTS.read_text(encoding="utf-8"))
    PAGE.write_text(page(groups, found), encoding="utf-8")
    print(f"written to {PAGE.relative_to(ROOT)}")
    return int(any(shown.result == "failed" for shown in found.values()))


def add_report(found: dict[str, Shown], report: Path) -> None:
    """What pytest says in a report of the tests that are marked with faults."""
    for case in ElementTree.parse(report).iter("testcase"):
        parts = case.get("classname", "").split(".")  # tests.addon.test_bake
        skip = case.find("skipped")
        failed = case.find("failure") is not None or case.find("error") is not None
        for mark in case.iterfind("properties/property[@name='fault']"):
            shown = found[mark.get("value", "")]
            shown.tests["/".join(parts[1:]) + ".py"].add(case.get("name", "").partition("[")[0])
            shown.outcomes["failed" if failed else "passed" if skip is None else "skipped"] += 1
            if skip is not None:
                shown.reasons.add(skip.get("message", ""))


def page(groups: dict[str, dict[str, dict[str, str]]], found: dict[str, Shown]) -> str:
    """The whole page. groups: what tests/faults.toml says."""
    names = [name for group in groups.values() for name in group]
    totals = Counter(found[name].result for name in names)
    text = TEXT.format(
        commit=measured_at(PAGE.name),
        machine=machine(),
        faces=int(os.environ["DYNAMORPH_FACES"]),
        kills=os.environ["DYNAMORPH_KILLS"],
        count=len(names),
        totals=", ".join(f"{count} {word}" for word, count in totals.most_common()),
    )
    for title, group in groups.items():
        text += f"\n## {title}\n\n{HEAD}\n"
        for name, fault in group.items():
            tests, result = found[name].cells(fault.get("elsewhere", ""))
            text += f"| {name} | {fault['fault']} | {fault['expected']} | {tests} | {result} |\n"
    return text


if __name__ == "__main__":
    sys.exit(main())
