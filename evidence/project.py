# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the project is. Importing this makes its sources, the tests' helpers and the tools importable."""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [
    str(ROOT / folder)
    for folder in ("addon", "tests", "tests/addon", "tests/addon/cli", "tests/engine", "sample_blends", "tools")
]
