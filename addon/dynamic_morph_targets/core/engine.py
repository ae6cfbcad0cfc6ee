# SPDX-License-Identifier: GPL-3.0-or-later
"""The compiled engine, imported when it is first used, so that a missing one leaves an add-on that can say so."""

from __future__ import annotations

import sys
from functools import lru_cache
from types import ModuleType

from .errors import DynamorphError, EngineNotFoundError, sentence

_threads, _told = 0, True  # what the user wants, and whether the engine knows; 0 is its own choice


def engine() -> tuple[ModuleType, ModuleType]:
    """The modules that need the compiled engine: (build, simulate). Raises EngineNotFoundError.

    Imported here and not at the top, so that a missing wheel leaves an add-on that can say so.
    """
    try:
        import dynamorph  # noqa: F401
    except Exception as error:  # a wheel for another system fails in many ways
        raise EngineNotFoundError(
            "The engine cannot be loaded ({error}). Install the Dynamorph extension made for this Blender and system "
            "from its .zip, or with pip the package 'dynamorph', and restart",
            error=error,
        ) from error
    _tell_threads()
    from . import build, simulate

    return build, simulate


@lru_cache(maxsize=1)
def engine_problem() -> str:
    """Why the engine cannot be loaded, or ''."""
    try:
        engine()
    except EngineNotFoundError as error:
        return sentence(error)
    return ""


def expected_errors() -> tuple[type[Exception], ...]:
    """The exceptions that the artist is told of, by `errors.sentence`. All others are bugs."""
    return (DynamorphError, OSError, MemoryError, *engine_errors())


def engine_errors() -> tuple[type[Exception], ...]:
    try:
        import dynamorph
    except Exception:
        return ()
    return (dynamorph.Error,)


def use_threads(count: int) -> None:
    """How many threads the engine takes, from now on or from when it is loaded; 0: as many as there are cores."""
    global _threads, _told
    _threads, _told = count, count == _threads and _told
    if sys.modules.get("dynamorph"):  # None where it is known to be missing
        _tell_threads()


def _tell_threads() -> None:
    """When it is loaded, by whatever uses it first: a job, Live, a fit."""
    global _told
    if not _told:
        import dynamorph

        dynamorph.set_threads(_threads)
        _told = True
