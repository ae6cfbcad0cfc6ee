# SPDX-License-Identifier: GPL-3.0-or-later
"""The open scene saved as a .blend, completely or not at all.

Blender writes it without compression: when it compresses, it goes on after a write that failed, without the parts that
were in it, and reports success. What it wrote is read back, and compressed here. Without compression, too, it may say
that there is no such file, or whatever failed before, when the disk is full.
"""

from __future__ import annotations

import os
import shutil
import struct
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy

from ..io import disk, outputs

try:
    import zstandard  # which Blender brings
except ImportError:
    zstandard = None

ZSTANDARD = b"\x28\xb5\x2f\xfd"  # with which a compressed file begins
FRAME = 2**20  # bytes that are compressed together, as by Blender
TABLE, TABLE_END = 0x184D2A5E, 0x8F92EAB1  # marks of the list of frames, with which Blender finds its way in the file


def save(path: Path):
    """Save a copy, which is the open file itself if that has this path. Like Blender, keep earlier versions as .blend1
    and so on, as many as the preferences say, and compress it if the open file is compressed, or a new file would be.
    Raises OSError.
    """
    with _earlier_versions(path), outputs.replacing(path) as partial:
        try:
            _write(partial)
            said = damage(partial)
        except RuntimeError as fault:
            said = str(fault).strip().removeprefix("Error: ")
        if said:
            text = f"'{path}' cannot be saved: Blender could not write all of it ({said})"
            raise outputs.why_not(path, said, _size()) or OSError(text)
        if zstandard and _is_compressed():
            _compress(partial)


def damage(path: Path) -> str:
    """What Blender says when it cannot find all parts of a .blend, one after the other."""
    try:
        with bpy.data.libraries.load(str(path)):
            return ""
    except OSError as error:
        return str(error).strip().replace(path.name, "the file")


def _write(path: Path):
    """Raises RuntimeError with what Blender says, and OSError."""
    written = _beside(path)  # what Blender renames in the end; if it cannot, it does not say why
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True, compress=False)
    except RuntimeError:
        if not written.exists():
            raise
        written.replace(path)
    finally:
        disk.discard(written)


def _beside(path: Path) -> Path:
    return Path(f"{path}@")


def _size() -> int:
    """How many bytes the file takes, of which Blender leaves no trace when they do not fit."""
    with tempfile.TemporaryDirectory(dir=bpy.app.tempdir) as folder:
        blend = Path(folder) / "size.blend"
        try:
            _write(blend)
        except RuntimeError:  # no room here either
            return outputs.BLOCK
        return blend.stat().st_size


def _is_compressed() -> bool:
    if not bpy.data.filepath:
        return bpy.context.preferences.filepaths.use_file_compression
    try:
        with Path(bpy.data.filepath).open("rb") as file:
            return file.read(4) == ZSTANDARD
    except OSError:  # it was deleted
        return False


def _compress(path: Path):
    """In place. Raises OSError."""
    small, frames = _beside(path), []
    try:
        with path.open("rb") as source, small.open("xb") as target:
            while content := source.read(FRAME):
                compressed = zstandard.compress(content)
                target.write(compressed)
                frames.append((len(compressed), len(content)))
            target.write(struct.pack("<II", TABLE, 8 * len(frames) + 9))
            target.writelines(struct.pack("<II", *frame) for frame in frames)
            target.write(struct.pack("<IBI", len(frames), 0, TABLE_END))
        small.replace(path)
    finally:
        disk.discard(small)


@contextmanager
def _earlier_versions(path: Path) -> Iterator[None]:
    """What is at `path` becomes its first earlier version when the block ends, and nothing changes when it raises.

    Meanwhile Blender keeps none itself, which would be of the file that it writes to.
    """
    preferences = bpy.context.preferences.filepaths
    count, preferences.save_version = preferences.save_version, 0
    earlier = _beside(outputs.partial_of(path))
    try:
        if count and path.exists():
            try:
                os.link(path, earlier)
            except OSError:  # not every file system has links
                shutil.copy2(path, earlier)
        yield
        if count and earlier.exists():
            versions = [Path(f"{path}{number}") for number in range(1, count + 1)]
            for older, newer in zip(versions[:0:-1], versions[-2::-1], strict=True):
                if newer.exists():
                    disk.replace(newer, older)
            disk.replace(earlier, versions[0])
    finally:
        preferences.save_version = count
        disk.discard(earlier)
