# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that other code writes, such as Blender's exporters: tried before the work, and put in place when complete.

Never touches bpy. `disk.save` does the same for bytes of our own.
"""

from __future__ import annotations

import errno
import filecmp
import os
import re
import secrets
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from ..core.errors import ExportError
from . import disk

BLOCK = 4096  # bytes that a trial writes: a full disk still takes empty files
# Faults that the messages of other programs name in words. "No such file" is not one: Blender says it of a full disk.
NAMED = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.ESTALE, errno.EROFS, errno.EACCES, errno.EFBIG)
UNREADABLE = "the written data cannot be read back"  # of ours, when nothing else was noticed
WORDS = {os.strerror(number): number for number in NAMED if not os.strerror(number).startswith("Unknown")}  # on Windows
WORDS |= {"iostream error": errno.EIO, UNREADABLE: errno.EIO}  # the first is of Alembic


def try_file(path: Path, size: int = BLOCK) -> None:
    """Find out whether a file of so many bytes can be written in the place of `path`, by writing one beside it; nothing
    of that stays. Raises OSError as writing the file would.
    """
    if "\0" in str(path):
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL), str(path))
    partial = partial_of(path)
    with disk.named(path, partial):
        try:
            if os.path.lexists(path) and path.parent.stat().st_mode & stat.S_ISVTX:
                _check_owner(path)
            if path.exists():
                if not (path.is_file() or path.is_dir()):  # a device, a pipe
                    raise OSError(errno.EINVAL, "Not a file")
                _try_to_open(path)
            with partial.open("xb") as file:
                for start in range(0, size, 2**20):
                    file.write(bytes(min(2**20, size - start)))
                file.flush()
                os.fsync(file.fileno())
        finally:
            disk.discard(partial)


def _check_owner(path: Path) -> None:
    """Raises OSError where only the owner of a file may replace it, as in /tmp."""
    users = os.geteuid()  # Windows has no such folders
    if users not in (0, path.lstat().st_uid, path.parent.stat().st_uid):
        raise OSError(errno.EPERM, os.strerror(errno.EPERM), str(path))


def _try_to_open(path: Path) -> None:
    """Raises OSError for a folder, and for a file that is protected or in use."""
    try:
        path.open("r+b").close()
    except PermissionError as error:
        if os.name == "nt" and path.is_file() and os.access(path, os.W_OK):  # not protected
            raise disk.in_use(path) from error
        raise


def try_folder(folder: Path) -> None:
    """`try_file` for any file in a folder; where it is missing, in the nearest one above that is there. No folder is
    made or removed: another process may begin to write to it at this moment. Raises OSError.
    """
    nearest = _existing(folder)
    if not nearest.is_dir():
        raise OSError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(nearest))
    try_file(nearest / f"{secrets.token_hex(8)}.dynamorph")  # a name that nothing in it has


def check_space(path: Path, size: int) -> None:
    """Raises OSError when so many bytes, an estimate, do not fit into a folder or beside the file that is at `path`."""
    free = shutil.disk_usage(_existing(path if path.is_dir() else path.parent)).free
    if size > free:
        needed = f"about {size / 1e6:.1f} MB are needed, {free / 1e6:.1f} MB are free"
        raise OSError(errno.ENOSPC, f"{os.strerror(errno.ENOSPC)}, {needed}", str(path))


@contextmanager
def replacing(path: Path, in_folder: bool = False) -> Iterator[Path]:
    """Gives a path to write to, with a random name that nobody can have prepared. When the block ends, what is there
    takes the place of `path`; when it raises, nothing is left of it. Until then the earlier file stands.

    in_folder: it is in a folder of its own. Other files that are written there, such as textures, come along to the
    folder of `path`, except those that it has already. Raises OSError, and ExportError when it has another one there.
    """
    remove_abandoned(path)
    partial = partial_of(path)
    written = partial / path.name if in_folder else partial
    with disk.named(path, partial), _printed_of(path, partial):
        try:
            if in_folder:
                partial.mkdir(mode=0o777 if os.name == "nt" else 0o700)  # Windows' rights would go with what is moved
            else:
                partial.open("xb").close()
            yield written
            _sync(written)
            if in_folder:
                _move_others(written, path.parent)
            disk.replace(written, path)
        finally:
            disk.remove(partial)


@contextmanager
def _printed_of(path: Path, partial: Path) -> Iterator[None]:
    """What other code prints in the block of the file that it writes has the name that the file will have."""
    with ExitStack() as ends:
        try:
            sys.stdout.flush()
            printed = ends.enter_context(tempfile.TemporaryFile())
            kept = os.dup(1)
        except (OSError, AttributeError):  # nobody reads it, or there is no room for it
            yield
            return
        os.dup2(printed.fileno(), 1)
        try:
            yield
        finally:
            with suppress(OSError):
                sys.stdout.flush()
            os.dup2(kept, 1)
            os.close(kept)
            printed.seek(0)
            with suppress(OSError):
                os.write(1, printed.read().replace(os.fsencode(partial.name), os.fsencode(path.name)))


@contextmanager
def placed(written: Mapping[Path, Path]) -> Iterator[None]:
    """Files have their names in the block; if it raises, the earlier files have them again. written: name -> where it
    is now. Raises OSError.
    """
    begun: list[tuple[Path, Path]] = []
    try:
        for path, now in written.items():
            earlier = partial_of(path)
            begun.append((path, earlier))
            if path.exists():
                disk.replace(path, earlier)
            disk.replace(now, path)
        yield
    except BaseException:
        for path, earlier in begun:
            if earlier.exists():
                disk.replace(earlier, path)
            elif not written[path].exists():  # it has the place, and there was none before
                disk.discard(path)
        raise
    for _, earlier in begun:
        disk.discard(earlier)


def why_not(path: Path, text: str, size: int = BLOCK) -> OSError | None:
    """The fault of the disk, if it is one, that kept other code from writing `path`: what a trial with so many bytes
    raises, or what the code says in `text`.
    """
    try:
        try_file(path, size)
    except OSError as error:
        return error
    named = [(number, words) for words, number in WORDS.items() if words in text]
    return OSError(*named[0], str(path)) if named else None


def _existing(folder: Path) -> Path:
    """The folder itself, or the nearest one above that is there."""
    return next((each for each in (folder, *folder.parents) if each.exists()), folder)


def partial_of(path: Path) -> Path:
    """A random name beside `path`, with its suffix, which exporters check. What is left there is removed an hour later,
    by the next one that writes `path`; also with the `@` behind it that Blender adds.
    """
    return path.with_name(f"{path.stem}.{secrets.token_hex(8)}.part{path.suffix}")


def remove_abandoned(path: Path) -> None:
    """Remove what processes that were killed have left of `path`."""
    disk.remove_abandoned(path.parent, rf"{re.escape(path.stem)}\.[0-9a-f]{{16}}\.part{re.escape(path.suffix)}@?")


def _sync(path: Path) -> None:
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def _move_others(written: Path, folder: Path) -> None:
    """Move all other files beside `written` to the same place in `folder`; if one cannot be moved, none is. Raises
    ExportError when another file has the place of one.
    """
    moved: list[Path] = []
    parts = [part for part in sorted(written.parent.rglob("*")) if part != written]
    targets = [folder / part.relative_to(written.parent) for part in parts]
    for part, target in zip(parts, targets, strict=True):
        if part.is_file() and target.exists() and not filecmp.cmp(part, target, shallow=False):
            text = "'{file}' is not the file of that name of '{name}': move it, or export to another folder"
            raise ExportError(text, file=target, name=written.name)
    try:
        for part, target in zip(parts, targets, strict=True):
            if part.is_dir():
                target.mkdir(exist_ok=True)
            elif not target.exists():
                disk.replace(part, target)
                moved.append(target)
    except OSError:
        for target in moved:
            disk.discard(target)
        raise
