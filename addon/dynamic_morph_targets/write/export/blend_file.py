# SPDX-License-Identifier: GPL-3.0-or-later
"""The open scene saved as a .blend, completely or not at all.

Blender writes it without compression: when it compresses, it goes on after a write that failed, without the parts that
were in it, and reports success. What it wrote is read back, and compressed here. Without compression, too, it may say
that there is no such file, or whatever failed before, when the disk is full.
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
import struct
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path

import bpy

from ...io import disk, outputs

try:
    import zstandard  # which Blender brings
except ImportError:
    zstandard = None  # type: ignore[assignment]

ZSTANDARD = b"\x28\xb5\x2f\xfd"  # with which a compressed file begins
FRAME = 2**20  # bytes that are compressed together, as by Blender
TABLE, TABLE_END = 0x184D2A5E, 0x8F92EAB1  # marks of the list of frames, with which Blender finds its way in the file
FLAGS, COMPRESSED = 48, 2  # where the block of global settings has flags, and the one that Blender saves by


def save(path: Path) -> None:
    """Save a copy, which is the open file itself if that has this path. Like Blender, keep earlier versions as .blend1
    and so on, as many as the preferences say, and compress it if the open file is compressed, or a new file would be.
    A link, as to the latest version of a shot, is followed. Raises OSError.
    """
    if path.is_symlink():
        path = Path(os.path.realpath(path))
    keep_abandoned(path)
    with _blender_keeping_none() as versions:
        earlier = path.with_name(f"{path.stem}.{secrets.token_hex(8)}.earlier{path.suffix}")
        try:
            with outputs.replacing(path) as partial:
                _write_whole(partial, path)
                if versions and path.exists():
                    _link(path, earlier)
        except BaseException:
            disk.discard(earlier)
            raise
        if earlier.exists():
            _keep(earlier, path, versions)


def damage(path: Path) -> str:
    """What Blender says when it cannot find all parts of a .blend, one after the other."""
    try:
        with bpy.data.libraries.load(str(path)):
            return ""
    except OSError as error:
        return str(error).strip().replace(path.name, "the file")


def _write_whole(partial: Path, path: Path) -> None:
    """Write what takes the place of `path`. Raises OSError."""
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


def _write(path: Path) -> None:
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
    """How many bytes the file takes. Blender does not say when they do not fit."""
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


def _compress(path: Path) -> None:
    """Compress the file in place. Raises OSError."""
    small = _beside(path)
    frames: list[tuple[int, int]] = []  # sizes, compressed and not
    try:
        with path.open("rb") as source, small.open("xb") as target:
            while content := source.read(FRAME):
                if not frames:
                    content = _marked(content)
                compressed = zstandard.compress(content)
                target.write(compressed)
                frames.append((len(compressed), len(content)))
            target.write(struct.pack("<II", TABLE, 8 * len(frames) + 9))
            target.writelines(struct.pack("<II", *frame) for frame in frames)
            target.write(struct.pack("<IBI", len(frames), 0, TABLE_END))
        small.replace(path)
    finally:
        disk.discard(small)


def _marked(content: bytes) -> bytes:
    """The first part of a file, with settings that say that it is compressed: by them Blender saves it again."""
    large = content[7:9].isdigit()  # as from Blender 5.0 on
    at, head, (form, size_at) = (int(content[7:9]), 32, ("<q", 16)) if large else (12, 24, ("<i", 4))
    while at + head + FLAGS < len(content):
        if content[at : at + 4] == b"GLOB":
            at += head + FLAGS
            return content[:at] + bytes([content[at] | COMPRESSED]) + content[at + 1 :]
        at += head + struct.unpack_from(form, content, at + size_at)[0]
    return content


@contextmanager
def _blender_keeping_none() -> Iterator[int]:
    """Gives how many earlier versions of a file the preferences keep. Meanwhile Blender keeps none itself, which would
    be of the file that it writes to.
    """
    preferences = bpy.context.preferences.filepaths
    versions, preferences.save_version = preferences.save_version, 0
    try:
        yield versions
    finally:
        preferences.save_version = versions


def _link(path: Path, name: Path) -> None:
    """Give a file a second name, under which it stays when it is replaced. Raises OSError."""
    try:
        os.link(path, name)
    except OSError:  # not every file system has links
        shutil.copy2(path, name)


def keep_abandoned(path: Path) -> None:
    """`_keep` for what a process that was killed before has left; of what it had not replaced yet, nothing."""
    versions = bpy.context.preferences.filepaths.save_version
    ours = re.compile(rf"{re.escape(path.stem)}\.[0-9a-f]{{16}}\.earlier{re.escape(path.suffix)}")
    with suppress(OSError):
        for left in sorted(path.parent.iterdir()):
            if ours.fullmatch(left.name):
                names = [Path(f"{path}{number}") for number in range(1, versions + 1)]
                newer = [name for name in names if name.exists() and name.stat().st_mtime >= left.stat().st_mtime]
                if left.samefile(path) or (names and newer == names):
                    disk.discard(left)
                elif names:
                    _keep(left, path, versions, len(newer))


def _keep(earlier: Path, path: Path, versions: int, newer: int = 0) -> None:
    """Make what was at `path` its first earlier version, or one after `newer` of them, and each after it the next one;
    if one of them cannot be replaced, as when another program has it open, a version more. Raises OSError.
    """
    names = [Path(f"{path}{number}") for number in range(newer + 1, versions + 1)]
    try:
        for older, later in zip(names[:0:-1], names[-2::-1], strict=True):
            if later.exists():
                disk.replace(later, older)
        disk.replace(earlier, names[0])
    except OSError:
        others = (Path(f"{path}{number}") for number in count(1))
        _link(earlier, next(each for each in others if not os.path.lexists(each)))
        disk.discard(earlier)
