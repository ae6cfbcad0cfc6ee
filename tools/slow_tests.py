# SPDX-License-Identifier: GPL-3.0-or-later
"""Which tests are slow: writes tests/slow.txt from what the last `make test` measured.

`make quick` leaves them out, and `make test` runs those that only compute under one Python. tests/conftest.py marks
them, and measures the processor seconds of each test and of the processes that it starts.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LIST = ROOT / "tests" / "slow.txt"
LIMIT = 0.5  # processor seconds of a test function, with all its parameters
SHARING = 20.0  # of a file: its tests share what takes long, which counts for the first of them, so all are slow
HEADING = (
    f"# Processor seconds of test functions that take {LIMIT:g}, or whose file takes {SHARING:g}: tools/slow_tests.py\n"
)


def listed() -> dict[str, float]:
    """Seconds by name, as `tests/engine/test_build.py::test_all`."""
    lines = LIST.read_text(encoding="utf-8").splitlines()
    return {name: float(seconds) for seconds, name in (line.split() for line in lines if not line.startswith("#"))}


def measured() -> Counter[str]:
    """The same of all test functions of the last `make test`, under the first Python in .venv."""
    version = min(path.parts[-3] for path in ROOT.glob(".venv/3.*/bin/python"))
    found: Counter[str] = Counter()
    for report in (ROOT / "build/reports").glob(f"tests-{version}-*.xml"):
        for case in ElementTree.parse(report).iter("testcase"):
            test = f"{case.get('classname', '').replace('.', '/')}.py::{case.get('name', '').partition('[')[0]}"
            seconds = [float(each.get("value", 0)) for each in case.iterfind("properties/property[@name='cpu']")]
            found[test] += sum(seconds)
    return found


def missing() -> list[str]:
    """Tests that the list should have by the last `make test`: on a busy machine they take up to twice as long."""
    known = listed()
    return [name for name, seconds in measured().items() if seconds > 3 * LIMIT and name not in known]


def main() -> None:
    found = measured()
    files: Counter[str] = Counter()
    for name, seconds in found.items():
        files[name.partition("::")[0]] += seconds
    slow = {
        name: seconds
        for name, seconds in found.items()
        if seconds >= LIMIT or files[name.partition("::")[0]] >= SHARING
    }
    lines = [f"{seconds:.1f} {name}\n" for name, seconds in sorted(slow.items())]
    LIST.write_text(HEADING + "".join(lines), encoding="utf-8")
    print(f"{LIST.relative_to(ROOT)}: {len(slow)} test functions, {sum(slow.values()):.0f} processor seconds")


if __name__ == "__main__":
    main()
