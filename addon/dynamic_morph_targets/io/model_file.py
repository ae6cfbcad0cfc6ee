# SPDX-License-Identifier: GPL-3.0-or-later
"""A built model as bytes: named arrays and a JSON description, in the layout of safetensors. No bpy, no pickle.

    8 bytes   length of the header, little-endian
    header    JSON, padded with spaces to a multiple of 8:
                {name: {dtype, shape, data_offsets: [begin, end]}, ...,
                 "__metadata__": {format, version, meta, hashes, header_hash}}
    data      the arrays, little-endian, C order, one after the other without gaps

safetensors checks sizes but not contents, so each array carries its SHA-256, and the header ends with its own, that of
its bytes without the hash and the padding: no byte of the file can change unnoticed. The engine reads it
(cpp/dynamorph/file/model_file.hpp), so that programs in C++ can as well.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..core.engine import dynamorph
from ..core.errors import ModelFileError

if TYPE_CHECKING:  # for type checkers alone: Blender does not have it
    from typing_extensions import Buffer

FORMAT = "dynamorph model"
VERSION = 1
TAGS = {
    "<f8": "F64", "<f4": "F32", "<i8": "I64", "<i4": "I32", "<i2": "I16", "|i1": "I8",
    "<u8": "U64", "<u4": "U32", "<u2": "U16", "|u1": "U8", "|b1": "BOOL",
}  # fmt: skip


def pack(arrays: dict[str, np.ndarray], meta: dict) -> bytes:
    """The model as bytes. meta: anything that JSON can represent. Raises ModelFileError for other content."""
    tensors, hashes, chunks, offset = {}, {}, [], 0
    for name, array in arrays.items():
        array = np.asarray(array)
        little = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<")).reshape(array.shape)
        if little.dtype.str not in TAGS:
            raise ModelFileError(
                "Array '{name}' has type {dtype}: only numbers can be stored", name=name, dtype=array.dtype
            )
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
        raise ModelFileError("The description cannot be stored: {error}", error=error) from error
    return _header_bytes(tensors, text, json.dumps(hashes)) + b"".join(chunks)


def unpack(buffer: Buffer) -> tuple[dict[str, np.ndarray], dict]:
    """The inverse of `pack`: arrays with their own memory, and the description. Raises ModelFileError."""
    try:
        arrays, meta = dynamorph.unpack_model(memoryview(buffer).cast("B"))
    except dynamorph.Error as error:
        raise ModelFileError(str(error)) from error
    return arrays, _parse(meta)


def content_id(packed: bytes) -> str:
    """A name for these bytes that is valid as a file name."""
    return hashlib.sha256(packed).hexdigest()[:32]


def _header_bytes(tensors: Mapping[str, object], meta_text: str, hashes_text: str) -> bytes:
    metadata = {"format": FORMAT, "version": str(VERSION), "meta": meta_text, "hashes": hashes_text, "header_hash": ""}
    text = json.dumps({**tensors, "__metadata__": metadata}).encode()
    closing = b'"}}'
    text = text.removesuffix(closing) + hashlib.sha256(text).hexdigest().encode() + closing
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text


def _parse(text: str) -> dict:
    try:
        value = json.loads(text)
    except (TypeError, ValueError, RecursionError):
        value = None
    if not isinstance(value, dict):
        raise ModelFileError("The model is damaged: its header is not readable. Build it again")
    return value
