# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's logger: it gets bugs with their traceback; the artist gets a sentence."""

from __future__ import annotations

import logging
import traceback

from .message import Message

logger = logging.getLogger("dynamic_morph_targets")  # prints to the console unless a user configures it
_logged: set[tuple] = set()  # kinds and places of the bugs that `log_once` has logged


def log_bug(error: BaseException) -> None:
    """Log an error that nobody expected, with its traceback."""
    logger.error("An unexpected error", exc_info=error)


def log_once(error: BaseException) -> None:
    """The same, for what is tried again and again: an error of one kind from one place is logged once."""
    where = traceback.extract_tb(error.__traceback__)[-1:]
    bug = type(error), *((frame.filename, frame.lineno) for frame in where)
    if bug not in _logged:
        _logged.add(bug)
        log_bug(error)


def bug_sentence(error: BaseException) -> str:
    """What the artist reads of an error that nobody expected."""
    return Message(
        "Dynamorph failed ({kind}: {error}). This is a bug: please report it, with the traceback in the system console",
        kind=type(error).__name__,
        error=error,
    )
