# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tests run of the sources, lines and branches: evidence/coverage.md, by `make coverage`.

    .venv/coverage/bin/python evidence/coverage_page.py PYTHON [TESTS...]
    .venv/coverage/bin/python evidence/coverage_page.py --page

PYTHON runs the tests. With TESTS, such as tests/engine, those alone are run, and the page goes to build/coverage.
--page writes the page of the last run again. Why a file is below LOW, tests/not_covered.toml says.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from collections import Counter, defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

from project import ROOT

import long_runs
from measured import measured_at

OUT = ROOT / "build" / "coverage"
PAGE = ROOT / "evidence/coverage.md"
CPP, PYTHON = ("cpp/dynamorph", "cpp/bindings"), ("addon/dynamic_morph_targets", "cpp/bindings/dynamorph")
WHY = ROOT / "tests" / "not_covered.toml"  # file: why it is below LOW
COMMIT = OUT / "commit"  # of the last run
LOW = 0.8  # files below it are listed
TESTS = ("tests/engine", "tests/addon")
# Those that look at the compiled engine itself, which counters change.
LEFT_OUT = tuple(f"--ignore=tests/engine/test_{name}.py" for name in ("examples", "instruction_sets"))
STEPS = "*golden*,*inertia*"  # C++ tests that run what is compiled for each instruction set
# Data at the end of the processes that the tests start, and of those that end at once, too; not of another Python, for
# which the package coverage is not compiled.
STARTS = f"""import sys

if sys.version_info[:2] == {sys.version_info[:2]}:
    import coverage

    coverage.process_startup()
"""
SETTINGS = f"""
[run]
branch = true
parallel = true
patch = _exit
source = {",".join(str(ROOT / folder) for folder in PYTHON)}
data_file = {OUT / "python" / "data"}
"""


@dataclass
class Covered:
    """How much of a file, or of several, the tests have run."""

    lines: int = 0
    lines_run: int = 0
    branches: int = 0
    branches_run: int = 0

    def __add__(self, other: Covered) -> Covered:
        return Covered(
            self.lines + other.lines,
            self.lines_run + other.lines_run,
            self.branches + other.branches,
            self.branches_run + other.branches_run,
        )

    @property
    def is_low(self) -> bool:
        return bool(self.lines) and self.lines_run < LOW * self.lines

    def cells(self) -> str:
        return f"{self.lines} | {share(self.lines_run, self.lines)} | {share(self.branches_run, self.branches)}"


def share(run: int, of: int) -> str:
    return f"{100 * run / of:.0f} %" if of else ""


def run(*command, **environment) -> int:
    return subprocess.run([*map(str, command)], cwd=ROOT, env=os.environ | environment, check=False).returncode


def build(python: Path) -> None:
    """The engine with counters, in a folder of its own."""
    tools = python.parent
    version = subprocess.check_output(
        [python, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"], text=True
    ).strip()
    # Threads count too; Eigen does not, which would take most of the time.
    flags = f"-O1 -g1 --coverage -fprofile-update=atomic -fprofile-filter-files={ROOT}/cpp/.*"
    configured = run(
        tools / "cmake", "-S", ".", "-B", OUT / "cpp", "-G", "Ninja", f"-DCMAKE_MAKE_PROGRAM={tools / 'ninja'}",
        "-DDYNAMORPH_TESTS=ON", f"-DDYNAMORPH_PYTHONS={python}", "-DCMAKE_BUILD_TYPE=None",
        f"-DCMAKE_CXX_FLAGS={flags}", "-DDYNAMORPH_WERROR=OFF", "--log-level=WARNING",
    )  # fmt: skip
    targets = ("--target", "engine_tests", f"core_{version}")
    if configured or run(tools / "cmake", "--build", OUT / "cpp", "-j", os.cpu_count(), *targets, "--", "--quiet"):
        sys.exit("coverage: the engine cannot be built")


def test(python: Path, tests: list[str]) -> None:
    """Run the C++ tests and each folder of the others; what fails is seen there, but covers what it ran."""
    for counts in (OUT / "cpp").rglob("*.gcda"):
        counts.unlink()
    shutil.rmtree(OUT / "python", ignore_errors=True)
    (OUT / "python").mkdir(parents=True)
    COMMIT.write_text(measured_at("evidence/coverage.md"))
    settings, start = OUT / "settings", OUT / "start"
    settings.write_text(SETTINGS)
    start.mkdir(exist_ok=True)
    (start / "sitecustomize.py").write_text(STARTS)  # which every Python imports
    package = start / "coverage"  # alone: pip of another Python fails with the other packages of this one
    package.unlink(missing_ok=True)
    package.symlink_to(Path(sysconfig.get_path("purelib"), "coverage"))
    run(OUT / "cpp" / "engine_tests", "--no-version")
    for instructions in ("baseline", "avx2"):  # the first took the best that the processor has
        run(OUT / "cpp" / "engine_tests", "--no-version", f"-tc={STEPS}", DYNAMORPH_ISA=instructions)
    paths = (start, OUT / "cpp/python", ROOT / "addon")
    environment = {"PYTHONPATH": os.pathsep.join(map(str, paths)), "COVERAGE_PROCESS_START": str(settings)}
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for each in folders(tests):
            pool.submit(run, python, "-m", "pytest", "-q", each, *LEFT_OUT, **environment)
    run(sys.executable, "-m", "coverage", "combine", f"--rcfile={settings}", "--quiet")


def folders(tests: list[str]) -> list[str]:
    """The folders with tests, those with most files first, and the files that are named: each runs in a process of its
    own.
    """
    found = dict.fromkeys(tests, 0)
    for each in tests:
        inside = Counter(path.parent.relative_to(ROOT).as_posix() for path in (ROOT / each).rglob("test_*.py"))
        if inside:
            del found[each]
            found.update(inside)
    return sorted(found, key=lambda each: -found[each])


def of_cpp() -> dict[str, Covered]:
    """The coverage by file. Branches that only an exception takes do not count: nearly each call has one."""
    report = OUT / "cpp.json"
    filters = [word for folder in CPP for word in ("--filter", f"{folder}/")]
    options = ("--exclude-throw-branches", "--merge-lines", "--gcov-suspicious-hits-threshold", 10**15)
    if run(sys.executable, "-m", "gcovr", "--root", ".", *filters, *options, "--json-summary", report, OUT / "cpp"):
        sys.exit("coverage: gcovr failed")
    names = ("line_total", "line_covered", "branch_total", "branch_covered")
    found = json.loads(report.read_text())["files"]
    return {file["filename"]: Covered(*(file[name] for name in names)) for file in found}


def of_python() -> dict[str, Covered]:
    report = OUT / "python.json"
    if run(sys.executable, "-m", "coverage", "json", f"--rcfile={OUT / 'settings'}", "--quiet", "-o", report):
        sys.exit("coverage: coverage json failed")
    names = ("num_statements", "covered_lines", "num_branches", "covered_branches")
    found = json.loads(report.read_text())["files"]
    return {name: Covered(*(file["summary"][key] for key in names)) for name, file in found.items()}


def table(title: str, found: dict[str, Covered]) -> str:
    """A row for each folder, and the files that are low."""
    folders: dict[str, Covered] = defaultdict(Covered)
    for name, covered in found.items():
        folders[str(Path(name).parent)] += covered
    rows = [f"| `{folder}` | {covered.cells()} |" for folder, covered in sorted(folders.items())]
    rows.append(f"| all | {sum(found.values(), Covered()).cells()} |")
    head = "| | lines | run | branches taken |\n|---|---:|---:|---:|"
    why = tomllib.loads(WHY.read_text(encoding="utf-8"))
    low = [
        f"| `{name}` | {covered.cells()} | {why.get(name, '**nobody has said**')} |"
        for name, covered in sorted(found.items())
        if covered.is_low
    ]
    head_low = "| | lines | run | branches taken | why |\n|---|---:|---:|---:|---|"
    below = "\n".join(
        [f"Files below {100 * LOW:.0f} % of their lines:\n", head_low, *low]
        if low
        else [f"No file is below {100 * LOW:.0f} %."]
    )
    return f"## {title}\n\n{head}\n" + "\n".join(rows) + f"\n\n{below}\n"


def page(tests: list[str]) -> str:
    found = {"Engine, C++": of_cpp(), "Extension and bindings, Python": of_python()}
    if tests == list(TESTS):
        for title, files in found.items():
            long_runs.keep("coverage", title, **asdict(sum(files.values(), Covered())))
    tables = "\n".join(table(title, files) for title, files in found.items())
    stamp = COMMIT.read_text()
    origin = f"Generated by `make -C evidence coverage`.\n{stamp}".rstrip() + "." * bool(stamp)
    ran = ", ".join(f"`{each}`" for each in tests)
    return f"""# Coverage

How much of the sources runs in tests. {origin}

In the C++ tests, some of them with each instruction set, and in {ran}, with the processes that these start. What
the window test, the wheels and the benchmarks run is not counted, and of C++ no branch that only an exception takes.

{tables}"""


def main() -> int:
    python, *tests = sys.argv[1:]
    if python != "--page":
        build(ROOT / python)
        test(ROOT / python, tests or list(TESTS))
    path = OUT / PAGE.name if tests else PAGE
    path.write_text(page(tests or list(TESTS)), encoding="utf-8")
    print(f"written to {path.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
