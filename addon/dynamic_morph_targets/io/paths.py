# SPDX-License-Identifier: GPL-3.0-or-later
"""Default paths of the files of a bake. Never touches bpy."""

from __future__ import annotations

import os
import re
import sys
import unicodedata
from collections.abc import Iterable
from pathlib import Path

CACHE_FOLDER = "dynamorph_caches"  # beside the .blend
OBJECT = "{object}"  # in the name of a file that each mesh has one of
UNSAFE = re.compile(r"[\x00-,./:-@[-^`{-\xfe]")  # in the names of files, as bpy.path.clean_name has them
DEVICE = re.compile(r"con|prn|aux|nul|com\d|lpt\d", re.IGNORECASE)  # Windows would write to it, whatever the suffix
LONGEST_BYTES = 180  # of 255 that most systems take: a hash and a suffix follow
LONGEST = 63  # characters: names in Blender 5 may be as long as the name of a file may be at all


def clean_name(name: str) -> str:
    """A data-block's name as the name of a file, without a suffix, for all systems.

    It is that of `bpy.path.clean_name`, which threads must not call, except for what no file can be named.
    """
    cleaned = UNSAFE.sub("_", name)[:LONGEST].encode()[:LONGEST_BYTES].decode(errors="ignore")
    return f"{cleaned}_" if DEVICE.fullmatch(cleaned) else cleaned


def file_path(file: str, name: str) -> Path:
    """The file of an object: a path in which `OBJECT` is replaced by the object's name."""
    return Path(file.replace(OBJECT, clean_name(name))).absolute()


def is_shared(files: Iterable[Path]) -> bool:
    """Whether two of the paths name one file, or one that would be: through links too, and as all systems but Linux
    take upper and lower case, and the two ways to write an accent, for the same.
    """
    found = [_identity(file) for file in files]
    return len(set(found)) < len(found)


def _identity(file: Path) -> object:
    name = os.path.realpath(file)
    if sys.platform != "linux":
        name = unicodedata.normalize("NFC", name).casefold()
    try:
        there = file.stat()
    except OSError:
        return name
    return (there.st_dev, there.st_ino) if there.st_ino else name  # which some network drives have none of


def cache_path(folder: Path, name: str, content: str) -> Path:
    """The path of a point cache. It is named by a hash of its content, so that no file changes that another .blend
    plays.
    """
    return file_path(str(folder / CACHE_FOLDER / f"{OBJECT}-{content[:12]}.pc2"), name)
