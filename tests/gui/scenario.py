# SPDX-License-Identifier: GPL-3.0-or-later
"""What an artist does with a fresh rigged arm, click by click, in a Blender window: run by tools/gui_test.py."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS), str(TESTS / "gui"), str(TESTS / "addon")]

import driver  # noqa: E402
import openings  # noqa: E402

parts = ["repository", "first_bake", "judging", "authoring", "trying", "baking", "files", "menus"]
if (driver.WORK / "character.blend").exists():
    parts.append("character")
else:
    driver.measure("Character", "skipped: there is no ../shared/assets/mh_male_53bones.blend")
for part in parts:
    importlib.import_module(part)


@driver.step("Whether all has been opened that opens")
def all_opened():
    yield from driver.drawn()
    openings.check()


driver.run()
