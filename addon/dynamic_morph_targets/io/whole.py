# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a file is complete, by its own format: Blender and its exporters do not notice every write that fails.

Never touches bpy, and reads only as much as it takes. Alembic and USD have no such mark: see
`write/export/child`; of .blend files Blender reads all parts: see `write/export/blend_file`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from . import glb

FBX, FBX_END = b"Kaydara FBX Binary  \0", bytes.fromhex("f85a8c6adef5d97eece90ce3758f290b")


def is_whole(path: Path) -> bool:
    """Whether the file of a format that is known by its suffix ends as it should. Raises OSError."""
    return CHECKS[path.suffix.lower()](path)


def _fbx(path: Path) -> bool:
    with path.open("rb") as file:
        begin = file.read(len(FBX))
        file.seek(max(file.seek(0, 2) - len(FBX_END), 0))
        return begin == FBX and file.read() == FBX_END


def _pc2(path: Path) -> bool:
    with path.open("rb") as file:
        head = file.read(32)
    points, frames = np.frombuffer(head.ljust(32, b"\0"), "<i4")[[4, 7]]
    return head[:11] == b"POINTCACHE2" and path.stat().st_size == 32 + 12 * int(points) * int(frames)


CHECKS = {".fbx": _fbx, ".glb": glb.is_whole, ".pc2": _pc2}
