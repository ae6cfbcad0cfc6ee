# SPDX-License-Identifier: GPL-3.0-or-later
"""The characters of ../shared, for tests and for pages measured on them. They are not published with the project."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

ASSETS = Path(__file__).resolve().parents[3] / "shared" / "assets"


def require(page: str, files: Iterable[str], folder: Path = ASSETS) -> None:
    """End the program, with an error, where files of the folder are missing."""
    missing = [file for file in dict.fromkeys(files) if not (folder / file).exists()]
    if missing:
        sys.exit(
            f"{page}: ../shared/assets lacks {', '.join(missing)}. These characters are not published with Dynamorph. "
            "'Where the characters are from' in docs/attribution.md says how to get them. Nothing was written."
        )
