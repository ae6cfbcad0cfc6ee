# SPDX-License-Identifier: GPL-3.0-or-later
"""The compiled engine, imported when it is first used, so that a missing one leaves an add-on that can say so."""

from __future__ import annotations

from functools import lru_cache
from types import ModuleType

from .errors import NativeMissing, SelfCheckError


def engine() -> tuple[ModuleType, ModuleType]:
    """The modules that need the compiled engine: (build, simulate). Raises NativeMissing.

    Imported here and not at the top, so that a missing wheel leaves an add-on that can say so.
    """
    try:
        import dynamorph  # noqa: F401
    except Exception as error:  # a wheel for another system fails in many ways
        raise NativeMissing(
            f"The engine cannot be loaded ({error}). Install the Dynamorph extension made for this Blender and system "
            "from its .zip, or with pip the package 'dynamorph', and restart"
        ) from error

    from . import build, simulate

    return build, simulate


@lru_cache(maxsize=1)
def engine_problem() -> str:
    """Why the engine cannot be loaded, or ''."""
    try:
        engine()
    except NativeMissing as error:
        return str(error)
    return ""


def expected_errors() -> tuple[type[Exception], ...]:
    """The exceptions whose message is meant for the artist."""
    return (NativeMissing, SelfCheckError, ValueError, OSError, *engine_errors())


def engine_errors() -> tuple[type[Exception], ...]:
    try:
        import dynamorph
    except Exception:
        return ()
    return (dynamorph.Error,)


def tell_threads(count: int) -> None:
    import dynamorph

    if hasattr(dynamorph, "set_threads"):  # the engine may be older than the add-on
        dynamorph.set_threads(count)
