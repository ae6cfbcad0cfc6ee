# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs every test that this machine can run, says which ones it could not run, and counts: `make test`."""

from __future__ import annotations

import re
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SUPPORTED = {"3.11": "Blender 4.5 LTS", "3.13": "Blender 5.2 LTS"}
COUNTED = ("-o", "console_output_style=count")
ROW = re.compile(r"([.sxXFE]*)(?: *\[ *(\d+)/(\d+)\])?")  # of pytest: a letter for each test, how many were done
# In separate processes: a crash of Blender does not lose the engine's results.
SUITES = ("tests/engine", "tests/addon")
WEB = "tests/web"  # once, in the environment of the website, if there is one


def say(text: str) -> None:
    """One text at a time: two Pythons are tested at once."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def run_engine_tests() -> Counter:
    """The C++ tests."""
    run = subprocess.run([ROOT / "build/cmake/engine_tests"], capture_output=True, text=True, check=False)
    found = re.search(r"test cases:\s*(\d+)\s*\|\s*(\d+) passed\s*\|\s*(\d+) failed", run.stdout)
    if run.returncode or not found:
        print(run.stdout, run.stderr)
    if not found:
        return Counter(failed=1)
    return Counter(passed=int(found[2]), failed=int(found[3]))


def report_of(version: str, suite: str, name: str = "tests") -> Path:
    """Where pytest writes the outcome of each test. name: of the run; the last one counts."""
    return ROOT / "build" / "reports" / f"{name}-{version}-{Path(suite).name}.xml"


def follow(lines: Iterable[str], say: Callable[[str], None]) -> Iterator[str]:
    """Says how far a run of pytest is, at every twentieth, and at once what fails. Yields the other lines.
    lines: of a run with the options `COUNTED`."""
    lines, failed, twentieth = iter(lines), 0, 0
    for line in lines:
        if line.startswith("FAILED "):  # by tests/conftest.py
            say(line.rstrip())
        elif row := ROW.fullmatch(line.rstrip("\n")):
            failed += sum(row[1].count(letter) for letter in "FE")
            done, tests = int(row[2] or 0), int(row[3] or 1)
            if 20 * done // tests > twentieth:
                twentieth = 20 * done // tests
                say(f"{100 * done // tests} %, {done} of {tests} tests, {failed} failed")
        else:
            yield line
            if line.startswith("==="):  # the tests are over
                yield from lines


def run_pytest(version: str, suite: str, *arguments: str, name: str = "tests") -> Counter:
    """One folder of tests under one Python. Says how far it is, what has failed at once, and the rest when all is done.
    name: as in `report_of`."""
    report = report_of(version, suite, name)
    report.parent.mkdir(parents=True, exist_ok=True)
    report.unlink(missing_ok=True)
    run = subprocess.Popen(
        [python_of(version), "-m", "pytest", "-rs", *COUNTED, f"--junitxml={report}", *arguments, suite],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace",
    )  # fmt: skip
    rest = "".join(follow(run.stdout, lambda text: say(f"Python {version} {suite}: {text}")))
    code = run.wait()
    say(f"\n{version}, {suite}\n{rest}")
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


def python_of(version: str) -> Path:
    return ROOT / ".venv" / version / "bin" / "python"


def run_python(version: str) -> dict[str, Counter]:
    """Every suite under one Python, by name."""
    return {f"Python {version} ({SUPPORTED[version]}) {suite}": run_pytest(version, suite) for suite in SUITES}


def main() -> int:
    start = time.monotonic()
    print("The engine's C++ tests", flush=True)
    results = {"C++ engine": run_engine_tests()}
    print(f"C++ engine: {describe(results['C++ engine'])}", flush=True)
    found = [version for version in SUPPORTED if python_of(version).exists()]
    missing = [
        f"Python {version} ({blender}): not run, no Python {version} was found by make setup"
        for version, blender in SUPPORTED.items()
        if version not in found
    ]
    print(f"Tests under Python {' and '.join(found)}: each folder says more of what failed when it is done", flush=True)
    with ThreadPoolExecutor() as pool:
        for of_version in pool.map(run_python, found):
            results |= of_version
    results[WEB] = run_pytest("site" if python_of("site").exists() else found[0], WEB)
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
