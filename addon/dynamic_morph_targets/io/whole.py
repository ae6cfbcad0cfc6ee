# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a file is complete, by its own format: Blender and its exporters do not notice every write that fails.

Never touches bpy, and reads only as much as it takes. Alembic and USD have no such mark: see `write/export_child`.
"""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path

from . import glb

ZSTANDARD, SKIPPABLE, SEEK_TABLE = b"\x28\xb5\x2f\xfd", 8, b"\xb1\xea\x92\x8f"
FBX, FBX_END = b"Kaydara FBX Binary  \0", bytes.fromhex("f85a8c6adef5d97eece90ce3758f290b")


def is_whole(path: Path) -> bool:
    """Whether the file of a format that is known by its suffix ends as it should. Raises OSError."""
    return CHECKS[path.suffix.lower()](path)


def _blend(path: Path) -> bool:
    """Blender compresses a file in frames, whose sizes follow at its end; without compression a block ENDB does."""
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(0)
        if file.read(4) != ZSTANDARD:
            file.seek(max(size - 32, 0))
            end = file.read()
            return b"ENDB" in (end[:4], end[-24:-20])  # the block's header is longer from Blender 5.0 on
        file.seek(max(size - 9, 0))
        count, kind, magic = struct.unpack("<IB4s", file.read(9).rjust(9, b"\0"))
        entry = 12 if kind & 0x80 else 8  # with checksums
        table = SKIPPABLE + count * entry + 9
        if magic != SEEK_TABLE or table > size:
            return False
        file.seek(size - table + SKIPPABLE)
        frames = file.read(count * entry)
    return size == table + sum(struct.unpack_from("<I", frames, at)[0] for at in range(0, len(frames), entry))


def _fbx(path: Path) -> bool:
    with path.open("rb") as file:
        begin = file.read(len(FBX))
        file.seek(max(file.seek(0, 2) - len(FBX_END), 0))
        return begin == FBX and file.read() == FBX_END


def _npz(path: Path) -> bool:
    try:
        with zipfile.ZipFile(path) as archive:
            return archive.testzip() is None
    except zipfile.BadZipFile:
        return False


CHECKS = {".blend": _blend, ".fbx": _fbx, ".glb": glb.is_whole, ".npz": _npz}
