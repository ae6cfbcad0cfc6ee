# SPDX-License-Identifier: GPL-3.0-or-later
"""The open scene saved as a .blend, completely or not at all.

When it compresses, Blender goes on after a write that failed, without what was in it, and reports success: on a full
disk the file cannot be opened. Without compression it says that there is no such file, or whatever failed before.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path

import bpy

from ..io import disk, outputs


def save(path: Path):
    """Save a copy, which is the open file itself if that has this path. Like Blender, keep earlier versions as .blend1
    and so on, as many as the preferences say. Raises OSError.
    """
    with _earlier_versions() as count, outputs.replacing(path) as partial:
        try:
            _write(partial)
            said = damage(partial)
        except RuntimeError as fault:
            said = str(fault).strip().removeprefix("Error: ")
        if said:
            text = f"'{path}' cannot be saved: Blender could not write all of it ({said})"
            raise outputs.why_not(path, said, _size()) or OSError(text)
        _keep_versions(path, count)


def damage(path: Path) -> str:
    """What Blender says when it cannot find all parts of a .blend, one after the other."""
    try:
        with bpy.data.libraries.load(str(path)):
            return ""
    except OSError as error:
        return str(error).strip()


def _write(path: Path):
    """Raises RuntimeError with what Blender says, and OSError."""
    written = Path(f"{path}@")  # what Blender renames in the end; if it cannot, it does not say why
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    except RuntimeError:
        if not written.exists():
            raise
        written.replace(path)
    finally:
        disk.discard(written)


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
