# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs the programs of tests/faults, with tests/faults/fail_nth.c preloaded.

DYNAMORPH_FAULTS=all lets every call fail once (`make -C evidence faults`), not a few of each kind.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

FAULTS = Path(__file__).parent / "faults"
ALL = os.environ.get("DYNAMORPH_FAULTS") == "all"


def compiled(folder: Path) -> Path:
    """The preloaded library; skips the test where it cannot be made."""
    compiler = shutil.which("gcc")
    if not (compiler and sys.platform == "linux") or "asan" in os.environ.get("LD_PRELOAD", ""):
        pytest.skip("calls are made to fail with gcc on Linux, without a sanitizer, which replaces malloc itself")
    library = folder / "fail_nth.so"
    warnings = ("-Wall", "-Wextra", "-Werror", "-O1")
    subprocess.run([compiler, "-shared", "-fPIC", *warnings, FAULTS / "fail_nth.c", "-o", library, "-ldl"], check=True)
    return library


def attacked(library: Path, program: str, *arguments) -> dict:
    """What a program of tests/faults found; fails with its last lines when it died."""
    run = subprocess.run(
        [sys.executable, FAULTS / program, *map(str, arguments)],
        env=os.environ | {"LD_PRELOAD": str(library)}, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        errors="replace", check=False,
    )  # fmt: skip
    lines = run.stdout.splitlines()
    assert run.returncode == 0, f"{program} ended with {run.returncode}:\n" + "\n".join(lines[-20:])
    return json.loads(next(line for line in reversed(lines) if line.startswith("{")))
