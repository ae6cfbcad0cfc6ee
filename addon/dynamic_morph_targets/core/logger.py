# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's logger: it gets bugs with their traceback; the artist gets a sentence."""

from __future__ import annotations

import logging
import traceback
from functools import cache

from .message import Message

logger = logging.getLogger("dynamic_morph_targets")  # prints to the console unless a user configures it


def log_bug(error: BaseException) -> None:
    """Log an error that nobody expected, with its traceback."""
    logger.error("An unexpected error", exc_info=error)


def log_once(error: BaseException) -> None:
    """The same, for what is tried again and again: an error of one kind from one place is logged once."""
    where = traceback.extract_tb(error.__traceback__)[-1:]
    if _is_new(type(error), *((frame.filename, frame.lineno) for frame in where)):
        log_bug(error)


def _is_new(*bug: object) -> bool:
    """Whether `log_once` has not logged it: of this kind, from this place."""
    known = _known.cache_info().currsize
    _known(*bug)
    return _known.cache_info().currsize > known


@cache
def _known(*_bug: object) -> None: ...


def bug_sentence(error: BaseException) -> str:
    """What the artist reads of an error that nobody expected."""
    return Message(
        "Dynamorph failed ({kind}: {error}). This is a bug: please report it, with the traceback in the system console",
        kind=type(error).__name__,
        error=error,
    )
