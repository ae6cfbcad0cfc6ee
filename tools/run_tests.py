# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs every test that this machine can run, says which ones it could not run, and counts: `make test`. With --quick,
those under one Python that are not slow or whose files have changed: `make quick`.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import slow_tests

ROOT = Path(__file__).resolve().parent.parent
SUPPORTED = {"3.11": "Blender 4.5 LTS", "3.13": "Blender 5.2 LTS"}
COUNTED = ("-o", "console_output_style=count")
ROW = re.compile(r"([.sxXFE]*)(?: *\[ *(\d+)/(\d+)\])?")  # of pytest: a letter for each test, how many were done
# In separate processes, one on each core: a crash of Blender does not lose the others' results. Those that take longest
# come first.
ADDON = ("run", "samples", "ui", "write", "core", "cli", "package", "scene", "io")
SUITES = ("tests/engine", *(f"tests/addon/{folder}" for folder in ADDON))
# What only computes does the same under each Python, so one tests it. Under the others, the engine's module is tried.
SMOKE = ("tests/engine/test_package.py", "tests/engine/test_physics.py", "tests/engine/test_model_file.py")
COMPUTES = ("tests/addon/run", "tests/addon/samples", "tests/addon/core")
# Nor does it matter under which Python a call or a process of the writer fails.
FAULTS = ("tests/addon/cli/test_failing_calls.py", "tests/addon/cli/test_kills.py")
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


def run_pytest(version: str, suite: str, arguments: tuple[str, ...], name: str = "tests") -> Counter:
    """Some tests of a folder under one Python. Says how far it is, what has failed at once, and the rest when all is
    done. arguments: of pytest; name: as in `report_of`."""
    report = report_of(version, suite, name)
    report.parent.mkdir(parents=True, exist_ok=True)
    report.unlink(missing_ok=True)
    run = subprocess.Popen(
        [python_of(version), "-m", "pytest", "-rs", *COUNTED, f"--junitxml={report}", *arguments],
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


def runs(found: list[str]) -> list[tuple[str, str, tuple[str, ...]]]:
    """(Python, suite, options of pytest) of `make test`."""
    first, *others = found
    all_tests = [(first, suite, (suite,)) for suite in SUITES]
    for version in others:
        all_tests.append((version, "tests/engine", SMOKE))
        for suite in SUITES[1:]:
            fewer = ("-m", "not slow") if suite in COMPUTES else tuple(f"--ignore={file}" for file in FAULTS)
            all_tests.append((version, suite, (suite, *fewer)))
    return sorted(all_tests, key=lambda each: SUITES.index(each[1]))


def changed() -> list[str]:
    """Paths of what is not committed, or else of the last commit."""

    def listed(*command: str) -> list[str]:
        run = subprocess.run(["git", *command], cwd=ROOT, capture_output=True, text=True, check=False)
        return run.stdout.split("\0")[:-1]

    now = [*listed("diff", "-z", "--name-only", "HEAD"), *listed("ls-files", "-z", "--others", "--exclude-standard")]
    return now or listed("diff", "-z", "--name-only", "HEAD~", "HEAD")


def quick_runs(version: str, paths: list[str]) -> list[tuple[str, str, tuple[str, ...]]]:
    """(Python, suite, options of pytest) of `make quick`: a file's tests have its name."""
    names = {f"test_{Path(path).stem.removeprefix('test_')}.py" for path in paths}
    quick = f"--quick={' '.join(sorted(names))}"
    return [(version, suite, (suite, quick)) for suite in SUITES]


def left_out(paths: list[str]) -> str:
    """What `make quick` leaves to `make test`."""
    stems = {Path(path).stem.removeprefix("test_") for path in paths}
    files = [Path(name.partition("::")[0]) for name in slow_tests.listed()]
    left = Counter(file.stem.removeprefix("test_") for file in files)
    left = Counter({stem: count for stem, count in left.items() if stem not in stems})
    most = ", ".join(f"{stem} {count}" for stem, count in left.most_common(12))
    return (
        f"Left to make test: the other Pythons, and {left.total()} slow tests (tests/slow.txt), most of them of {most}"
    )


def run_all(jobs: list[tuple[str, str, tuple[str, ...]]], name: str = "tests") -> dict[str, Counter]:
    """The C++ tests and these, by Python and suite: what came of each. name: as in `report_of`."""
    results = {}
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        in_cpp = pool.submit(run_engine_tests)
        for (version, suite, _), counts in zip(jobs, pool.map(lambda job: run_pytest(*job, name), jobs), strict=True):
            results[f"Python {version} ({SUPPORTED[version]}) {suite}"] = counts
        results["C++ engine"] = in_cpp.result()
    return results


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    start = time.monotonic()
    found = [version for version in SUPPORTED if python_of(version).exists()]
    missing = [
        f"Python {version} ({blender}): not run, no Python {version} was found by make setup"
        for version, blender in SUPPORTED.items()
        if version not in found
    ]
    if quick:
        paths = changed()
        missing = [left_out(paths)]
        results = run_all(quick_runs(found[0], paths), "quick")
    else:
        print(
            f"Tests under Python {' and '.join(found)}: each folder says more of what failed when it is done",
            flush=True,
        )
        results = run_all(runs(found))
        results[WEB] = run_pytest("site" if python_of("site").exists() else found[0], WEB, (WEB,))
        if slow := slow_tests.missing():
            missing.append(f"tests/slow.txt is out of date, run tools/slow_tests.py: {', '.join(sorted(slow)[:5])}")
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
