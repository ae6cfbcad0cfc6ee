# SPDX-License-Identifier: GPL-3.0-or-later
"""One part of what an artist does with a rigged arm, click by click, in a window: run by tools/gui_test.py."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS), str(TESTS / "gui"), str(TESTS / "addon")]

import bpy  # noqa: E402
import driver  # noqa: E402
import editors  # noqa: E402
import openings  # noqa: E402

importlib.import_module(driver.PART)
if editors.ADDON in bpy.context.preferences.addons:  # an earlier part has installed it
    openings.watch()
driver.run()
