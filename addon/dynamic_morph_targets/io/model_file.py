# SPDX-License-Identifier: GPL-3.0-or-later
"""A built model as bytes: named arrays and a JSON description, in the layout that docs/file_format.md has. The engine's
package writes and reads it, for programs without Blender as well.
"""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING

import numpy as np

from ..core.engine import dynamorph
from ..core.errors import ModelFileError

if TYPE_CHECKING:  # for type checkers alone: Blender does not have it
    from typing_extensions import Buffer


def pack(arrays: dict[str, np.ndarray], meta: dict) -> bytes:
    """The model as bytes. meta: anything that JSON can represent. Raises ModelFileError for other content."""
    try:
        return dynamorph.pack_model(arrays, json.dumps(meta, allow_nan=False))
    except (TypeError, ValueError) as error:
        raise ModelFileError("The model cannot be stored: {error}", error=error) from error


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


def _parse(text: str) -> dict:
    try:
        value = json.loads(text)
    except (TypeError, ValueError, RecursionError):
        value = None
    if not isinstance(value, dict):
        raise ModelFileError("The model is damaged: its header is not readable. Build it again")
    return value
