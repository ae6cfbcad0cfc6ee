# SPDX-License-Identifier: GPL-3.0-or-later
"""The open scene saved as a .blend, completely or not at all.

Blender replaces the earlier file by one that cannot be opened, and reports success, when the disk is full and it
compresses; without compression it says that there is no such file.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path

import bpy

from ..io import outputs, whole


def save(path: Path):
    """Save a copy, which is the open file itself if that has this path. Like Blender, keep earlier versions as .blend1
    and so on, as many as the preferences say. Raises OSError.
    """
    with _earlier_versions() as count, outputs.replacing(path) as partial:
        try:
            _write(partial)
            error = "" if whole.is_whole(partial) else "Blender wrote only a part of it"
        except RuntimeError as fault:
            error = str(fault).strip().removeprefix("Error: ")
        if error:
            raise outputs.why_not(path, error, _size()) or OSError(f"'{path}' cannot be saved: {error}")
        _keep_versions(path, count)


def _write(path: Path):
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)


def _size() -> int:
    """How many bytes the file takes, of which Blender leaves no trace when they do not fit."""
    with tempfile.TemporaryDirectory(dir=bpy.app.tempdir) as folder:
        blend = Path(folder) / "size.blend"
        try:
            _write(blend)
        except RuntimeError:  # no room here either
            return outputs.BLOCK
        return blend.stat().st_size


@contextmanager
def _earlier_versions():
    """How many are kept. Meanwhile Blender keeps none itself, which would be of the file that it writes to."""
    preferences = bpy.context.preferences.filepaths
    count, preferences.save_version = preferences.save_version, 0
    try:
        yield count
    finally:
        preferences.save_version = count


def _keep_versions(path: Path, count: int):
    if not count or not path.exists():
        return
    versions = [Path(f"{path}{number}") for number in range(1, count + 1)]
    for older, newer in zip(versions[:0:-1], versions[-2::-1], strict=True):
        if newer.exists():
            newer.replace(older)
    versions[0].unlink(missing_ok=True)
    try:
        os.link(path, versions[0])  # the file itself stays in its place, too
    except OSError:  # not every file system has links
        shutil.copy2(path, versions[0])
