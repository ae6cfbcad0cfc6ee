# SPDX-License-Identifier: GPL-3.0-or-later
"""Write the sample scenes: python make_samples.py [FOLDER] [SCENE ...]. Default: all, next to this file."""

from __future__ import annotations

import sys
from pathlib import Path

import bulging_cylinder
import dynamic_morph_targets
import folded_limb
import grabbed_belly
import herbert
import herbert_bench
import pressed_cylinder
import rolling_ball
import shoulder

SCENES = {
    "bulging_cylinder": bulging_cylinder,
    "folded_limb": folded_limb,
    "grabbed_belly": grabbed_belly,
    "herbert": herbert,
    "herbert_bench": herbert_bench,
    "pressed_cylinder": pressed_cylinder,
    "rolling_ball": rolling_ball,
    "shoulder": shoulder,
}

if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent
    dynamic_morph_targets.register()
    for name in sys.argv[2:] or SCENES:
        SCENES[name].make(folder / f"{name}.blend")
