# SPDX-License-Identifier: GPL-3.0-or-later
"""Default paths of the files of a bake. Never touches bpy."""

from __future__ import annotations

import re
from pathlib import Path

CACHE_FOLDER = "dynamorph_caches"  # beside the .blend
OBJECT = "{object}"  # in the name of a file that each mesh has one of


UNSAFE = re.compile(r"[\x00-,./:-@[-^`{-\xfe]")  # in the names of files, as bpy.path.clean_name has them


def clean_name(name: str) -> str:
    """The result of `bpy.path.clean_name`, for threads, which must not call it."""
    return UNSAFE.sub("_", name)


def file_path(file: str, name: str) -> Path:
    """The file of an object: a path in which `OBJECT` is replaced by the object's name."""
    return Path(file.replace(OBJECT, clean_name(name))).resolve()


def cache_path(folder: Path, name: str, content: str, sink: str) -> Path:
    """The path of a point cache. It is named by a hash of its content, so that no file changes that another .blend
    plays.
    """
    return file_path(str(folder / CACHE_FOLDER / f"{OBJECT}-{content[:12]}.{sink.lower()}"), name)
