# SPDX-License-Identifier: GPL-3.0-or-later
"""The hashes of the golden motion for each version, in motion.json: `make golden`.

A hash is of the bytes that one compiler's engine computes with one instruction set; tests/cpp/step/test_golden.cpp
prints it. tests/engine/test_golden.py compares with those of this version, so that no motion changes unnoticed; what a
released version has made is never written again.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
KEPT = Path(__file__).with_suffix(".json")
SETS = ("baseline", "avx2", "avx512")
sys.path += [str(ROOT / "tools"), str(ROOT / "evidence")]

import measured  # noqa: E402
import version  # noqa: E402

# C++ tests that may be there, and what runs them.
PROGRAMS = {
    "build/cmake/engine_tests": (),
    "build/wheels/linux-x64/engine_tests": (),
    "build/wheels/linux-arm64/engine_tests": ("qemu-aarch64", "-L", str(ROOT / "build/wheels/arm/3.11")),
    "build/wheels/windows-x64/engine_tests.exe": ("wine",),
}


def hashes(*program: Path | str) -> dict[str, str]:
    """System, compiler and instruction set -> hash, for the sets that the processor has and the program knows."""
    found = {}
    for each in SETS:
        run = subprocess.run(
            [*map(str, program), "--test-case=golden motion"], capture_output=True, text=True, check=False,
            env=os.environ | {"DYNAMORPH_ISA": each, "WINEDEBUG": "-all"},
        )  # fmt: skip
        found |= dict(re.findall(r"^golden bytes, (.*): ([0-9a-f]{16})\r?$", run.stdout, re.MULTILINE))
    return found


def main() -> int:
    (now,) = set(version.found()["pyproject.toml"])
    known = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.exists() else {}
    if measured.git("tag", "--list", f"v{now}"):
        print(f"golden: {now} is released, and what it computes stays as it is: open the next one with make version")
        return 1
    made = known.setdefault(now, {})
    for path, emulator in PROGRAMS.items():
        if not (ROOT / path).exists() or (emulator and not shutil.which(emulator[0])):
            print(f"golden: left out: {path}")
            continue
        for built, value in hashes(*emulator, ROOT / path).items():
            print(f"{built}: {value}{'' if made.get(built, value) == value else f', before: {made[built]}'}")
            made[built] = value
    KEPT.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
