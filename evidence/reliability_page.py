# SPDX-License-Identifier: GPL-3.0-or-later
"""`make reliability`: runs the tests of the faults of tests/faults.toml, and writes docs/reliability.md.

With what the longer runs of TITLES found, which is kept in docs/reliability.json.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tomllib
import xml.etree.ElementTree as ElementTree
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path

from project import ROOT

import long_runs
from bench import machine
from measured import measured_at
from performance_page import grid
from run_tests import SUITES, SUPPORTED, python_of, report_of, run_pytest

PAGE = ROOT / "docs" / "reliability.md"
LONG_RUNS = PAGE.with_suffix(".json")
FAULTS = ROOT / "tests" / "faults.toml"
LARGE = {"DYNAMORPH_FACES": "2000000", "DYNAMORPH_KILLS": "10"}  # unless they say otherwise; more than in `make test`
TEXT = """# Reliability

This page lists what may go wrong in production, and what Dynamorph does about it: with a broken mesh, a full disk, a
killed process or a changed rig. One rule holds for all of them: no result is silently wrong and no work is lost; a
message names the object, the cause and the next step. Each row has tests that are marked with its id, which `make test`
runs with all others. `make -C evidence reliability` runs only these and writes this page; nothing on it is written by
hand. The largest mesh had {faces:,} faces, and one bake was killed {kills} times. What takes longer is [at the
end](#longer-runs).

{commit}. {machine}.

{count} faults: {totals}.
"""
HEAD = "| Id | Fault | What happens | Tests | Result |\n|---|---|---|---|---|"


@dataclass
class Shown:
    """The outcome of the tests of one fault. tests: their names by file; outcomes: how many of each, in all Pythons."""

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
        texts = [f"{text} ({self.outcomes.total()})", *skipped, elsewhere]
        return "<br>".join(tests), "<br>".join(filter(None, texts))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--longer-runs", action="store_true", help="only write what these found, the faults stay")
    if parser.parse_args().longer_runs:
        faults = PAGE.read_text(encoding="utf-8").partition(HEADING)[0].rstrip() + "\n"
        PAGE.write_text(faults + longer_runs(), encoding="utf-8")
        return 0
    found: dict[str, Shown] = defaultdict(Shown)
    failed = 0
    os.environ.update(LARGE | os.environ)
    for version in SUPPORTED:
        for suite in SUITES if python_of(version).exists() else ():
            failed += run_pytest(version, suite, (suite, "-m", "fault"), "faults")["failed"]
            if (report := report_of(version, suite, "faults")).exists():  # not when pytest died
                add_report(found, report)
    groups = tomllib.loads(FAULTS.read_text(encoding="utf-8"))
    PAGE.write_text(page(groups, found) + longer_runs(), encoding="utf-8")
    print(f"written to {PAGE.relative_to(ROOT)}")
    return int(failed > 0)


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
    """All but the longer runs. groups: what tests/faults.toml says."""
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


# Longer runs ---------------------------------------------------------------------------------------------------------

HEADING = "\n## Longer runs\n"
LONGER_TEXT = """
These searches for bugs run for minutes to hours. They break things at random, or one at a time, until something fails.
Each table names the commits at which it was run. A figure in bold under *wrong* or *failures* is a bug that the search
found at that commit, which is what it is for; what was found is listed below the table.
"""
CALLS = ("write", "fsync", "rename", "open", "read")
TITLES = {
    "faults": """Calls that fail: `make -C evidence faults`

Each write, fsync, rename and open of a command fails once, and once with all later ones (no space left, a lost
network); reading where others may have the file on another machine. Afterward the earlier result is as it was or a
whole new one is there, nothing partial is left, the exit code and the message say why, and the same command works.
Shown: calls, and in how many cases one failed.""",
    "allocations": """Memory that is refused: `make -C evidence faults`

Each allocation of a call of the engine fails once, in a process of its own. It must raise a MemoryError or change
nothing, and the same objects must still work afterward. A few are in libraries that end the process there; they are
named in
`tests/engine/test_allocations.py`.""",
    "fuzz": """Random input: `make -C evidence fuzz`

Each input is soon accepted, or refused with an expected error. Inputs that once failed are kept and tried first.""",
    "sanitize": """Sanitizers: `make -C evidence sanitize`

gcc's, with Eigen's and the engine's asserts, which a release build leaves out.""",
    "soak": """Random walks: `make -C evidence soak`

Each walk presses and changes all that an artist can, with undo, files and the add-on turned off and on, in one process.
After each step: no bug was reported, no step took over a minute, and no handler, data, thread, open or partial file was
left.
*Growth*: of the memory, at each new file.""",
    "coverage": """Coverage: `make -C evidence coverage`

This is the part of the sources that the tests run.""",
}


def longer_runs() -> str:
    """Their tables. Each part names the commit at which it last ran."""
    kept = json.loads(LONG_RUNS.read_text(encoding="utf-8")) if LONG_RUNS.exists() else {}
    for command, parts in long_runs.found().items():
        kept[command] = kept.get(command, {}) | parts
    LONG_RUNS.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    text = HEADING + LONGER_TEXT
    for command, title in TITLES.items():
        parts = kept.get(command)
        text += f"\n### {title}\n\n" + (tabulated(command, parts) if parts else "Not run yet.\n")
    return text


def tabulated(command: str, parts: dict[str, dict]) -> str:
    """The figures of one command, and the commits at which they were measured."""
    tables = {
        "faults": of_faults, "allocations": of_allocations, "fuzz": of_fuzz, "sanitize": of_sanitize, "soak": of_soak,
        "coverage": of_coverage,
    }  # fmt: skip
    measured = dict.fromkeys(figures["measured"] for figures in parts.values())
    listed = "".join(f"- {name}: {each}\n" for name, figures in parts.items() for each in figures.get("wrong", ()))
    texts = [tables[command](parts), listed, "".join(f"{each}.\n" for each in measured)]
    return "\n".join(filter(None, texts))


def of_faults(parts: dict[str, dict]) -> str:
    rows = [
        [name, *(f"{each[kind][0]}, {each[kind][1]}" if kind in each else "" for kind in CALLS), wrong(figures)]
        for name, figures in parts.items()
        for each in [figures["calls"]]
    ]
    return grid(["command", *CALLS, "wrong"], rows)


def of_allocations(parts: dict[str, dict]) -> str:
    names = ("allocations", "tried", "refused")
    rows = [
        [name, *(str(figures[each]) for each in names), str(len(figures["crashed"])), wrong(figures)]
        for name, figures in parts.items()
    ]
    return grid(["call", *names, "process ended", "wrong"], rows)


def of_fuzz(parts: dict[str, dict]) -> str:
    rows = [
        [name.removeprefix("test_").replace("_", " "), f"{each['inputs']:,}", f"{each['seconds'] / 60:.0f}",
         failures(each)]
        for name, each in parts.items()
    ]  # fmt: skip
    total = ["all", f"{sum(each['inputs'] for each in parts.values()):,}",
             f"{sum(each['seconds'] for each in parts.values()) / 60:.0f}", ""]  # fmt: skip
    return grid(["input", "tried", "minutes", "failures"], [*rows, total])


def of_sanitize(parts: dict[str, dict]) -> str:
    return grid(["what for, in what", "found"], [[name, failures(each)] for name, each in parts.items()])


def of_soak(parts: dict[str, dict]) -> str:
    rows = [
        [name, f"{each['hours']:.2f}", f"{each['steps']:,}", f"{each['files']:,}", f"{each['memory']:.0f}",
         f"{each['growth']:.2f}", wrong(each)]
        for name, each in parts.items()
    ]  # fmt: skip
    total = ["all", f"{sum(each['hours'] for each in parts.values()):.2f}",
             f"{sum(each['steps'] for each in parts.values()):,}", "", "", "", ""]  # fmt: skip
    return grid(["walk", "hours", "steps", "new files", "memory, MB", "growth, MB", "wrong"], [*rows, total])


def of_coverage(parts: dict[str, dict]) -> str:
    rows = [
        [title, f"{each['lines']:,}", f"{each['lines_run'] / each['lines']:.1%}",
         f"{each['branches_run'] / each['branches']:.1%}"]
        for title, each in parts.items()
    ]  # fmt: skip
    return grid(["", "lines", "run", "branches taken"], rows) + "\n`evidence/coverage.md` has the folders and files.\n"


def failures(figures: dict) -> str:
    return "**found**" if figures["failed"] else "none"


def wrong(figures: dict) -> str:
    return f"**{len(figures['wrong'])}**" if figures["wrong"] else "none"


if __name__ == "__main__":
    sys.exit(main())
