# SPDX-License-Identifier: GPL-3.0-or-later
"""The compiled engine, loaded when it is first used, so that an extension without it can say what is missing.

Modules that use it import `dynamorph` from here; they can themselves be imported without it.
"""

from __future__ import annotations

import platform
import re
import sys
import tomllib
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from .errors import DynamorphError, EngineNotFoundError, sentence
from .message import Message, joined

INSTALL = (
    "Install the Dynamorph extension made for this Blender and system from its .zip, or with pip the package "
    "'dynamorph', and restart"
)
# What the loader of a system says -> what helps.
REMEDIES = {
    r"GLIBC|libc\.|ld-linux": "It needs a Linux with glibc 2.28 or newer, as Blender does",
    r"code signature|quarantine|system policy": "macOS blocks it: choose Open Anyway in System Settings > Privacy & "
    "Security, and restart",
    r"DLL load failed": "Let the virus scanner allow it. If that does not help, install the Dynamorph extension made "
    "for this processor, and restart",
    "DYNAMORPH_ISA": "Unset this variable, or name one of these",
    r"map segment|Cannot allocate memory": "Memory is short: close other programs or raise the limit (ulimit -v), "
    "and restart",
}
_threads = 0  # what the user wants; 0 is the engine's own choice


def load() -> ModuleType:
    """The compiled engine's module. Raises EngineNotFoundError."""
    try:
        import dynamorph
    except Exception as error:  # a wheel for another system fails in many ways
        raise EngineNotFoundError(
            "The engine cannot be loaded on {system} with Python {python} ({error}). {remedy}",
            system=f"{platform.system()} {platform.machine()}",
            python=f"{sys.version_info.major}.{sys.version_info.minor}",
            error=error,
            remedy=_remedy(str(error)),
        ) from error
    _check_version()
    if _threads:
        _tell_threads(id(dynamorph), _threads)
    return dynamorph


@lru_cache(maxsize=1)
def _check_version() -> None:
    """Refuse an engine that is not this extension's: no update unloads a compiled module. Raises
    EngineNotFoundError.
    """
    import dynamorph

    if getattr(dynamorph, "__version__", "") != installed_version():
        raise EngineNotFoundError("The engine of an earlier version is still loaded: restart Blender")
    if installed_version() not in ("", addon_version()):
        raise EngineNotFoundError(
            "The engine has version {engine}, but this extension has {addon}: disable the add-on that provides the "
            "other one, install the Dynamorph extension again, and restart Blender",
            engine=installed_version(),
            addon=addon_version(),
        )


class _Engine:
    """Stands for the module `dynamorph`, and loads it when something of it is used."""

    def __getattr__(self, name: str) -> Any:
        return getattr(load(), name)


if TYPE_CHECKING:
    import dynamorph as dynamorph
else:
    dynamorph = _Engine()


def _remedy(error: str) -> Message:
    """What helps against an error of the import, and what this extension has instead."""
    remedy = next((found for pattern, found in REMEDIES.items() if re.search(pattern, error)), INSTALL)
    wheels = (path.stem.split("-") for path in (Path(__file__).parents[1] / "wheels").glob("dynamorph-*.whl"))
    held = sorted(f"{python} {system.partition('.')[0]}" for *_, python, _abi, system in wheels)
    if not held or remedy != INSTALL:
        return Message(remedy)
    return joined(". ", [Message("This extension has it for {systems}", systems=", ".join(held)), Message(remedy)])


def installed_version() -> str:
    """The version of the installed engine; empty when it runs from where it was compiled."""
    try:
        return metadata.version("dynamorph")
    except metadata.PackageNotFoundError:
        return ""


@lru_cache(maxsize=1)
def addon_version() -> str:
    """The version of this extension, which is made for the engine of the same."""
    manifest = Path(__file__).parents[1] / "blender_manifest.toml"
    return str(tomllib.loads(manifest.read_text(encoding="utf-8"))["version"])


@lru_cache(maxsize=1)
def engine_problem() -> str:
    """Why the engine cannot be loaded, or ''."""
    try:
        load()
    except EngineNotFoundError as error:
        return sentence(error)
    return ""


def expected_errors() -> tuple[type[Exception], ...]:
    """The exceptions that `errors.sentence` explains to the artist. All others are bugs."""
    return (DynamorphError, OSError, MemoryError, *engine_errors())


def engine_errors() -> tuple[type[Exception], ...]:
    try:
        import dynamorph
    except Exception:
        return ()
    return (dynamorph.Error,)


def use_threads(count: int) -> None:
    """How many threads the engine takes, from now on or from when it is loaded; 0: as many as there are cores."""
    global _threads
    _threads = count
    if loaded := sys.modules.get("dynamorph"):  # None where it is known to be missing
        _tell_threads(id(loaded), count)


@lru_cache(maxsize=1)
def _tell_threads(_engine: int, count: int) -> None:
    """Once: a script may want another number afterward. _engine: the id of its module."""
    sys.modules["dynamorph"].set_threads(count)


def threads() -> int:
    """The number that `use_threads` was given."""
    return _threads
