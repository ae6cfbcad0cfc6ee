# SPDX-License-Identifier: GPL-3.0-or-later
"""One part of what an artist does with a rigged arm, click by click, in a window: run by evidence/gui_test.py."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / folder) for folder in ("tests", "evidence/window", "tests/addon")]

import bpy  # noqa: E402
import driver  # noqa: E402
import editors  # noqa: E402
import openings  # noqa: E402

importlib.import_module(driver.PART)
if editors.ADDON in bpy.context.preferences.addons:  # an earlier part has installed it
    openings.watch()
driver.run()
