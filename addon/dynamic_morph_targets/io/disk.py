# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that are written completely or not at all, also where a file that is open cannot be replaced. No bpy."""

from __future__ import annotations

import errno
import os
import re
import secrets
import shutil
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..core.errors import FileInUseError, WriteError

ABANDONED = 3600.0  # seconds after which an incomplete file is abandoned
PATIENCE = 1.0  # seconds for a virus scanner or an indexer to let go of a file
IN_USE = (5, 32, 33)  # codes of Windows: access denied, and a file or a part of it is locked
LONGEST_PATH = 259  # characters, on Windows as it is installed


def save(path: str | os.PathLike[str], content: bytes | Iterable[bytes]) -> None:
    """Writes the file completely or not at all: a crash leaves the old file or the new one. Raises OSError, WriteError
    for a path that is too long.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    remove_abandoned(path.parent, rf"{re.escape(path.name)}\.[0-9a-f]{{16}}\.part")
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(8)}.part")  # with the permissions of a new file
    with named(path, temporary):
        try:
            write(temporary, content)
            replace(temporary, path)
        except BaseException:
            discard(temporary)
            raise


def write(path: Path, content: bytes | Iterable[bytes]) -> None:
    """Writes a file that is not there yet, in a folder that is: a crash leaves a part of it. Raises OSError."""
    with path.open("xb") as file:
        file.writelines([content] if isinstance(content, bytes) else content)
        file.flush()
        os.fsync(file.fileno())


def remove_abandoned(folder: Path, pattern: str) -> None:
    """Remove what processes that were killed have left in a folder. pattern: of its names, a regular expression."""
    ours = re.compile(pattern)
    with suppress(OSError):
        for left in [each for each in folder.iterdir() if ours.fullmatch(each.name)]:
            with suppress(OSError):
                if time.time() - left.lstat().st_mtime > ABANDONED:
                    remove(left)


def remove(path: Path) -> None:
    """Delete a file, or a folder with everything in it, that is not needed any more."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        discard(path)


@contextmanager
def named(path: Path, temporary: Path) -> Iterator[None]:
    """Makes errors of a file that is written to another path, in a folder that is there, name the path that the user
    knows. Raises WriteError for one that is too long.
    """
    try:
        yield
    except FileInUseError:
        raise
    except OSError as error:
        if isinstance(error, FileNotFoundError) and len(str(temporary)) > LONGEST_PATH:
            raise WriteError("The path '{path}' is too long: choose a folder with a shorter one", path=path) from error
        if error.errno and (not error.filename or str(error.filename).startswith(str(temporary))):
            error.filename, error.filename2 = str(path), None
        raise


def replace(new: Path, path: Path) -> None:
    """Give a complete file the name `path`, in place of the file that has it, also after a power failure. Raises
    OSError.

    Windows refuses this while any program has one of the two open, if only for a moment.
    """
    ends = time.monotonic() + PATIENCE
    while True:
        try:
            new.replace(path)
            return _sync(path.parent)
        except PermissionError as error:
            if getattr(error, "winerror", None) not in IN_USE:
                raise
            if time.monotonic() > ends:
                raise in_use(path) from error
        time.sleep(0.05)


def in_use(path: Path) -> FileInUseError:
    """The error for a file that Windows does not let be replaced."""
    text = "'{path}' cannot be replaced: another program has it open, or it is read-only. Close it there and try again"
    return FileInUseError(text, path=path)


def _sync(folder: Path) -> None:
    """Make renames in a folder last, where the system can."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    with suppress(OSError):  # some file systems cannot
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def read(path: Path) -> bytes:
    """The content of a file, and not of a pipe or a device, which may never end. Raises OSError."""
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "Not a file", str(path))
    return path.read_bytes()


def discard(path: Path) -> None:
    """Delete a file that is not needed any more, if it exists. One that another program has open stays."""
    with suppress(OSError):
        path.unlink()
