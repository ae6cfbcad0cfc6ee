# SPDX-License-Identifier: GPL-3.0-or-later
"""The characters of ../shared, for tests and for pages measured on them. They are not published with the project."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

ASSETS = Path(__file__).resolve().parents[3] / "shared" / "assets"
BY = "[CC BY 4.0](https://creativecommons.org/licenses/by/4.0/)"
CREDITS = {  # for the captions of their pictures, as their licenses ask
    "CesiumMan_notexture.glb": f"*Cesium Man*, © 2017 Cesium, {BY}; its textures, which carry a trademark, are "
    "removed.",
    "Fox.glb": f"*Fox*: mesh by PixelMannen, CC0; rig and animation by @tomkranis, {BY}; conversion to glTF by "
    f"@AsoboStudio and @scurest, {BY}.",
    "KayKit_": "*KayKit* characters by Kay Lousberg (kaylousberg.com), CC0.",
    "mh_": "Bodies derived from the MakeHuman project (makehumancommunity.org), CC0. Some of their clips use data "
    "obtained from mocap.cs.cmu.edu. The database was created with funding from NSF EIA-0196217.",
    "RobotExpressive.glb": "*RobotExpressive* by Tomás Laulhé (Quaternius) with modifications by Don McCurdy, CC0.",
}
OTHERS = "by Quaternius (quaternius.com), CC0, or by this project."
CHANGED = "The pictures show them as simulated and rendered here."


def require(page: str, files: Iterable[str], folder: Path = ASSETS) -> None:
    """End the program, with an error, where files of the folder are missing."""
    missing = [file for file in dict.fromkeys(files) if not (folder / file).exists()]
    if missing:
        sys.exit(
            f"{page}: ../shared/assets lacks {', '.join(missing)}. These characters are not published with Dynamorph. "
            "'Where the characters are from' in docs/attribution.md says how to get them. Nothing was written."
        )


def attribution(files) -> str:
    """Who made these files, as a list in Markdown; files: their names."""
    names = list(files)
    lines = [text for begin, text in CREDITS.items() if any(name.startswith(begin) for name in names)]
    others = f"All others {OTHERS}" if lines else f"All {OTHERS}"
    return "\n".join(f"- {text}" for text in (*lines, others, CHANGED))
