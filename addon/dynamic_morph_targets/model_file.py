# SPDX-License-Identifier: GPL-3.0-or-later
"""A built model as bytes: named arrays and a JSON description, in the layout of safetensors. No bpy, no pickle.

    8 bytes   length of the header, little-endian
    header    JSON, padded with spaces to a multiple of 8:
                {name: {dtype, shape, data_offsets: [begin, end]}, ...,
                 "__metadata__": {format, version, meta, hashes, header_hash}}
    data      the arrays, little-endian, C order, one after the other without gaps

safetensors checks sizes but not contents, so each array carries its SHA-256, and the header its own. The header must be
exactly what `pack` would write: then no byte of the file can change unnoticed.
"""

from __future__ import annotations

import glob
import hashlib
import json
import math
import os
import secrets
import time
from collections.abc import Iterable
from contextlib import suppress
from itertools import combinations_with_replacement
from pathlib import Path

import numpy as np

FORMAT = "dynamorph model"
VERSION = 4  # 2: target sets; 3: of the tables of a reduced model, the distinct coefficients only; 4: stiffness
OLDEST = 2  # that can be read
MAX_HEADER = 16 * 2**20
ABANDONED = 3600.0  # seconds after which nobody writes to a part of a file any more
DTYPES = {
    "F64": "<f8", "F32": "<f4", "I64": "<i8", "I32": "<i4", "I16": "<i2", "I8": "|i1",
    "U64": "<u8", "U32": "<u4", "U16": "<u2", "U8": "|u1", "BOOL": "|b1",
}  # fmt: skip
TAGS = {dtype: tag for tag, dtype in DTYPES.items()}


class ModelFileError(ValueError):
    """The bytes are not a model that this version can read. The message says why."""


def pack(arrays: dict[str, np.ndarray], meta: dict) -> bytes:
    """The model as bytes. meta: anything JSON can hold. Raises ModelFileError for other content."""
    tensors, hashes, chunks, offset = {}, {}, [], 0
    for name, array in arrays.items():
        array = np.asarray(array)
        little = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<")).reshape(array.shape)
        if little.dtype.str not in TAGS:
            raise ModelFileError(f"Array '{name}' has type {array.dtype}: only numbers can be stored")
        chunk = little.tobytes()
        tensors[name] = {
            "dtype": TAGS[little.dtype.str],
            "shape": list(array.shape),
            "data_offsets": [offset, offset + len(chunk)],
        }
        hashes[name] = hashlib.sha256(chunk).hexdigest()
        chunks.append(chunk)
        offset += len(chunk)
    try:
        text = json.dumps(meta, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ModelFileError(f"The description cannot be stored: {error}") from error
    return _header_bytes(tensors, text, json.dumps(hashes)) + b"".join(chunks)


def unpack(buffer) -> tuple[dict[str, np.ndarray], dict]:
    """The inverse of `pack`: arrays of their own memory, and the description. Raises ModelFileError.

    What an older version wrote comes out as this one would have written it.
    """
    view = memoryview(buffer).cast("B")
    tensors, metadata, begin = _read_header(view)
    data = view[begin:]
    hashes = _parse(metadata["hashes"])
    arrays = {}
    end = 0
    for name, tensor in tensors.items():
        dtype, shape, end = _check_tensor(name, tensor, end, len(data))
        chunk = data[tensor["data_offsets"][0] : end]
        if hashlib.sha256(chunk).hexdigest() != hashes.get(name):
            raise ModelFileError(f"The model is damaged: array '{name}' has changed. Build it again")
        try:
            arrays[name] = np.frombuffer(chunk, dtype).reshape(shape).copy()
        except (ValueError, OverflowError) as error:  # an empty array with absurd dimensions
            raise ModelFileError(f"The model is damaged: array '{name}' has an impossible shape") from error
    if end != len(data):
        raise ModelFileError("The model is damaged: there are bytes after its end. Build it again")
    if metadata["version"] == "2":
        _keep_distinct(arrays)
    if metadata["version"] in ("2", "3") and "tets" in arrays:
        arrays["stiffness"] = np.ones(len(arrays["tets"]))  # nothing could be painted
    return arrays, _parse(metadata["meta"])


def save(path, content: bytes | Iterable[bytes]):
    """Write whole or not at all: a crash leaves the old file or the new one."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    for left in path.parent.glob(f"{glob.escape(path.name)}.*.part"):  # by a process that was killed
        with suppress(OSError):
            if time.time() - left.stat().st_mtime > ABANDONED:
                left.unlink()
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(8)}.part")  # with the rights of any new file
    try:
        with temporary.open("xb") as file:
            file.writelines([content] if isinstance(content, bytes) else content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def content_id(packed: bytes) -> str:
    """A name for these bytes, fit for a file name."""
    return hashlib.sha256(packed).hexdigest()[:32]


def _keep_distinct(arrays: dict[str, np.ndarray]):
    """Of tables in version 2's layout, the coefficients that version 3 stores (table_layout.hpp), bit for bit.

    Version 2 had K0 as pairs i <= j of modes, rows first, then K1 (modes, pairs), then the upper triangle of K2
    (pairs, pairs), rows first.
    """
    modes = arrays["basis"].shape[1] if "basis" in arrays else 0
    pairs = modes * (modes + 1) // 2

    def pair(i, j):
        return i * modes - i * (i - 1) // 2 + j - i

    def chosen(count):
        return np.array(list(combinations_with_replacement(range(modes), count)), int).reshape(-1, count).T

    for name in {"table_lambda", "table_mu"} & set(arrays):
        table = arrays[name]
        if table.shape[-1] <= pairs:  # of the linear law, or none
            continue
        if table.shape[-1] != pairs * (1 + modes) + pairs * (pairs + 1) // 2:
            raise ModelFileError(f"The model is damaged: '{name}' does not fit its {modes} modes. Build it again")
        i, j, m = chosen(3)
        cubic = pairs + m * pairs + pair(i, j)
        i, j, m, n = chosen(4)
        p, q = pair(i, j), pair(m, n)
        quartic = pairs * (1 + modes) + p * pairs - p * (p - 1) // 2 + q - p
        arrays[name] = table[:, np.concatenate([np.arange(pairs), cubic, quartic])]


def _header_bytes(tensors, meta_text, hashes_text, version: str = str(VERSION)) -> bytes:
    metadata = {"format": FORMAT, "version": version, "meta": meta_text, "hashes": hashes_text, "header_hash": ""}
    header = {**tensors, "__metadata__": metadata}
    metadata["header_hash"] = hashlib.sha256(json.dumps(header).encode()).hexdigest()
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text


def _read_header(view):
    """Returns (tensors, metadata, offset of the data)."""
    if len(view) < 8:
        raise ModelFileError("The model is cut off: build it again")
    length = int.from_bytes(view[:8], "little")
    if length > MAX_HEADER:
        raise ModelFileError("This is not a Dynamorph model, or it is damaged: its header has an impossible length")
    if length > len(view) - 8:
        raise ModelFileError("The model is cut off: build it again")
    raw = bytes(view[8 : 8 + length])
    tensors = _parse(raw)
    metadata = tensors.pop("__metadata__", None)
    if not isinstance(metadata, dict) or metadata.get("format") != FORMAT:
        raise ModelFileError("This is not a Dynamorph model")
    version = metadata.get("version")
    if version not in map(str, range(OLDEST, VERSION + 1)):
        raise ModelFileError(
            f"The model has version {version}, this add-on reads {OLDEST} to {VERSION}: update, or build it again"
        )
    try:
        expected = _header_bytes(tensors, metadata["meta"], metadata["hashes"], version)
    except (KeyError, TypeError, ValueError, RecursionError):
        expected = None
    if expected != bytes(view[:8]) + raw:
        raise ModelFileError("The model is damaged: its header has changed. Build it again")
    return tensors, metadata, 8 + length


def _check_tensor(name, tensor, begin, available):
    """Returns (dtype, shape, end) of a table entry that starts at `begin`, within `available` bytes."""
    damaged = ModelFileError(f"The model is damaged: the table entry of array '{name}' is wrong. Build it again")
    if not isinstance(tensor, dict) or set(tensor) != {"dtype", "shape", "data_offsets"}:
        raise damaged
    shape, offsets = tensor["shape"], tensor["data_offsets"]
    if not isinstance(tensor["dtype"], str) or tensor["dtype"] not in DTYPES:
        raise damaged
    if not _counts(shape) or not _counts(offsets) or len(offsets) != 2 or len(shape) > 8:
        raise damaged
    dtype = np.dtype(DTYPES[tensor["dtype"]])
    end = begin + math.prod(shape) * dtype.itemsize
    if offsets != [begin, end] or end > available:
        raise damaged
    return dtype, shape, end


def _counts(value) -> bool:
    return isinstance(value, list) and all(type(n) is int and n >= 0 for n in value)


def _parse(text) -> dict:
    try:
        value = json.loads(text)
    except (TypeError, ValueError, RecursionError):
        value = None
    if not isinstance(value, dict):
        raise ModelFileError("The model is damaged: its header is not readable. Build it again")
    return value
