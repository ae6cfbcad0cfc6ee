# SPDX-License-Identifier: GPL-3.0-or-later
"""What an artist does with a fresh rigged arm, click by click, in a Blender window: run by tools/gui_test.py."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS), str(TESTS / "gui"), str(TESTS / "addon")]

import driver  # noqa: E402

for part in ("first_bake", "authoring"):
    importlib.import_module(part)

driver.run()
