# SPDX-License-Identifier: GPL-3.0-or-later
"""Splits the animation of a binary glTF file into several, one for each part of its time. NumPy only, never bpy.

A .glb is a header, then chunks: JSON, which describes the layout, and bytes. The parts need no other bytes than the
whole, only their own times, which are appended.

Blender's exporter can write several animations itself, but not these: it makes one of every Action or NLA track of an
object, including muted tracks, leaves out what moves without one of its own, and in 4.5 fails on tracks of shape keys.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..core.errors import ExportError

HEADER, CHUNK = "<4sII", "<I4s"  # magic, version, length; length, kind
FLOAT = 5126
SIZES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, FLOAT: 4}  # bytes of a number, by componentType
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def split_animation(data: bytes, parts: Mapping[str, tuple[int, int]], fps: float) -> bytes:
    """The file with its one animation, which has a key at each frame, replaced by one animation per part.

    parts: by name, the first frame and the last, counted from the animation's first. Each begins at time 0.
    """
    document, binary = _chunks(data)
    (whole,) = document["animations"]
    accessors, views = document["accessors"], document["bufferViews"]
    document["animations"] = []
    for name, (first, last) in parts.items():
        times = (np.arange(last - first + 1) / fps).astype("<f4")
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": times.nbytes})
        binary += times.tobytes()
        ends = {"min": [float(times[0])], "max": [float(times[-1])]}
        accessors.append(
            {
                "bufferView": len(views) - 1,
                "componentType": FLOAT,
                "count": len(times),
                "type": "SCALAR",
                **ends,
            }
        )
        shared, samplers = len(accessors) - 1, []
        for sampler in whole["samplers"]:
            output = accessors[sampler["output"]]
            keys = accessors[sampler["input"]]["count"]
            if keys <= last:
                raise ExportError(
                    "The animation has {keys} keys, the clip '{name}' is to end with the {end}th",
                    keys=keys,
                    name=name,
                    end=last + 1,
                )
            each = output["count"] // keys  # values per key; for weights, one per morph target
            size = SIZES[output["componentType"]] * WIDTHS[output["type"]]
            begin = output.get("byteOffset", 0) + first * each * size
            accessors.append({**output, "byteOffset": begin, "count": len(times) * each})
            for bound in ("min", "max"):
                accessors[-1].pop(bound, None)
            samplers.append({**sampler, "input": shared, "output": len(accessors) - 1})
        document["animations"].append({**whole, "name": name, "samplers": samplers})
    document["buffers"][0]["byteLength"] = len(binary)
    return _joined(document, binary)


def is_whole(path: Path) -> bool:
    """Whether the file is as long as it says, and its chunks fill it. Raises OSError."""
    with path.open("rb") as file:
        size, at = file.seek(0, 2), struct.calcsize(HEADER)
        file.seek(0)
        magic, _, length = struct.unpack(HEADER, file.read(at).ljust(at, b"\0"))
        while at < size:
            file.seek(at)
            head = file.read(struct.calcsize(CHUNK))
            at += len(head) + (struct.unpack(CHUNK, head)[0] if len(head) == struct.calcsize(CHUNK) else 0)
    return magic == b"glTF" and size == length == at


def _chunks(data: bytes) -> tuple[dict, bytearray]:
    """The JSON and the bytes of a file as Blender writes it, in two chunks."""
    start = struct.calcsize(HEADER)
    (length, _), begin = struct.unpack_from(CHUNK, data, start), start + struct.calcsize(CHUNK)
    document = json.loads(data[begin : begin + length])
    begin += length + struct.calcsize(CHUNK)
    return document, bytearray(data[begin : begin + document["buffers"][0]["byteLength"]])


def _joined(document: dict, binary: bytearray) -> bytes:
    text = json.dumps(document, separators=(",", ":")).encode()
    body = b""
    for kind, chunk, blank in ((b"JSON", text, b" "), (b"BIN\0", bytes(binary), b"\0")):
        chunk += blank * (-len(chunk) % 4)
        body += struct.pack(CHUNK, len(chunk), kind) + chunk
    return struct.pack(HEADER, b"glTF", 2, struct.calcsize(HEADER) + len(body)) + body
