# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs every test that this machine can run, says which it could not, and counts: `make test`."""

from __future__ import annotations

import re
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SUPPORTED = {"3.11": "Blender 4.5 LTS", "3.13": "Blender 5.2 LTS"}
SUITES = ("tests/engine", "tests/addon")  # apart: a crash of Blender does not take the engine's results along


def run_engine_tests() -> Counter:
    """The C++ tests."""
    run = subprocess.run([ROOT / "build/cmake/engine_tests"], capture_output=True, text=True, check=False)
    found = re.search(r"test cases:\s*(\d+)\s*\|\s*(\d+) passed\s*\|\s*(\d+) failed", run.stdout)
    if run.returncode or not found:
        print(run.stdout, run.stderr)
    if not found:
        return Counter(failed=1)
    return Counter(passed=int(found[2]), failed=int(found[3]))


def run_pytest(python: Path, suite: str) -> Counter:
    """One folder of tests under one Python."""
    report = ROOT / "build" / "reports" / f"{python.parent.parent.name}-{Path(suite).name}.xml"
    report.parent.mkdir(parents=True, exist_ok=True)
    report.unlink(missing_ok=True)
    code = subprocess.run(
        [python, "-m", "pytest", "-rs", f"--junitxml={report}", suite], cwd=ROOT, check=False
    ).returncode
    if not report.exists():
        print(f"{suite}: pytest died with exit code {code}")
        return Counter(failed=1)
    totals = Counter()
    for element in ElementTree.parse(report).iter("testsuite"):
        failed, skipped = int(element.get("failures")) + int(element.get("errors")), int(element.get("skipped"))
        totals += Counter(failed=failed, skipped=skipped, passed=int(element.get("tests")) - failed - skipped)
    if code not in (0, 5) and not totals["failed"]:  # 5: no tests in the folder
        print(f"{suite}: all passed, but the process ended with exit code {code}")
        totals["failed"] += 1
    return totals


def describe(counts: Counter) -> str:
    return ", ".join(f"{counts[kind]} {kind}" for kind in ("failed", "passed", "skipped") if counts[kind]) or "no tests"


def main() -> int:
    start = time.monotonic()
    results = {"C++ engine": run_engine_tests()}
    missing = []
    for version, blender in SUPPORTED.items():
        python = ROOT / ".venv" / version / "bin" / "python"
        if not python.exists():
            missing.append(f"Python {version} ({blender}): not run, no Python {version} was found by make setup")
            continue
        for suite in SUITES:
            name = f"Python {version} ({blender}) {suite}"
            print(f"\n{name}", flush=True)
            results[name] = run_pytest(python, suite)
    print()
    for name, counts in results.items():
        print(f"{name}: {describe(counts)}")
    for line in missing:
        print(line)
    total = sum(results.values(), Counter())
    print(f"{f' {describe(total)} in {time.monotonic() - start:.2f}s ':=^80}")
    return 1 if total["failed"] else 0


if __name__ == "__main__":
    sys.exit(main())
