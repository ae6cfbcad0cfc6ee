# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiles in build/cmake by ninja, and says how far it is: python tools/compile.py JOBS THEN [TARGET ...]

Nothing to compile, nothing said. A terminal sees each step in one line, a log every tenth of them. THEN: what make goes
on with. Without a target it compiles everything.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path

BUILD = Path(__file__).resolve().parent.parent / "build" / "cmake"
STEP = re.compile(r"\[(\d+)/(\d+)\] .*?([^/ ]+)$")
GLOBS = "Re-checking globbed directories..."
IDLE = "ninja: no work to do."


def time_left(seconds: float) -> str:
    return "less than a minute left" if seconds < 60 else f"about {seconds / 60:.0f} min left"


def run_ninja(jobs: str, targets: list[str]) -> int:
    """Compiles what it can, even where something fails. Returns ninja's exit code."""
    ninja = Path(sys.executable).with_name("ninja")
    clear = "\r\033[K" if sys.stdout.isatty() else ""
    begin, tenth, uncalled = time.monotonic(), 0, 0
    run = subprocess.Popen(
        [ninja, "-j", jobs, "-k", "0", *targets],
        cwd=BUILD, env=os.environ | {"NINJA_STATUS": "[%f/%t] "}, stdout=subprocess.PIPE, text=True, errors="replace",
    )  # fmt: skip
    for line in map(str.rstrip, run.stdout):
        step = STEP.match(line)
        if line.endswith(GLOBS):
            uncalled = 1  # ninja counts the run of CMake that it might have needed
        elif step:
            done, steps = int(step[1]), int(step[2]) - uncalled
            left = time_left((time.monotonic() - begin) / done * (steps - done))
            if clear:
                print(f"{clear}compiling: [{done}/{steps}] {step[3].removesuffix('.o')}, {left}", end="", flush=True)
            elif 10 * done // steps > tenth:
                print(f"compiling: [{done}/{steps}], {left}", flush=True)
            tenth = 10 * done // steps
        elif line != IDLE:
            print(f"{clear}{line}", flush=True)
    if clear and tenth:
        print()
    return run.wait()


def main() -> int:
    jobs, then, *targets = sys.argv[1:]
    if not (BUILD / ".ninja_log").exists():
        after = f"; then make {then} goes on" if then else ""
        print(f"compiling the engine for the first time, which takes some minutes{after}", flush=True)
    try:
        return run_ninja(jobs, targets)
    except KeyboardInterrupt:  # ninja gets it, too
        return 130


if __name__ == "__main__":
    sys.exit(main())
