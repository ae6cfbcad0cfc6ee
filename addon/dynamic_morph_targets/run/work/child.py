# SPDX-License-Identifier: GPL-3.0-or-later
"""Work in a process of its own: it never blocks Blender's window, and what crashes there takes no scene along.

An object is made there, and its methods are called: each call and its answer are files beside each other in a folder,
and so is what the object reports meanwhile. `Here` does the same in this process, where no window waits. Neither this
module nor what it imports touches bpy.
"""

from __future__ import annotations

import contextlib
import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

import numpy as np

from ...core import blas, engine, logger
from ...core.errors import DynamorphError, ProcessError
from ...core.message import Message
from ..remembered import work

News: TypeAlias = Callable[[Any], None]  # is called with what an object reports
Answer: TypeAlias = Generator[None, None, Any]  # yields until the answer is there, and returns it

PATIENCE = 5.0  # seconds for a process to remove its files
SLICE = 2**25  # bytes that are read or written at once, in about 10 ms
IDLE = 600.0  # seconds after which a process that got no work ends
KILLED = -9  # on Linux, by the kernel when memory is short
# What the artist reads of a process that died twice, and what helps.
CRASHED = (
    "'{name}': the process that computes crashed twice. Nothing was changed. {remedy}",
    "Save the file, start Blender again and try once more. If it stays so, please report it with the messages in the "
    "console",
)
ENDED = (
    "'{name}': the system ended the process that computes twice. Nothing was changed. {remedy}",
    "That happens when memory is short: close other programs, or lower Cage Nodes or Modes",
)


class Here:
    """kind(*args, news): an object in this process, whose calls end when their work is done. heard: gets its news."""

    def __init__(self, kind: Callable[..., Any], *args: Any, heard: News):
        self.object = kind(*args, heard)

    def call(self, name: str, *args: Any) -> Answer:
        """What its method `name` returns, or raises."""
        yield
        with blas.one_thread():
            return getattr(self.object, name)(*args)

    def end(self) -> None:
        """Nothing runs between two calls."""

    def leave(self) -> None:
        """The same."""


class Child:
    """kind(*args, news): an object in a process of its own. All of these are pickled. heard: gets its news, while a
    call waits for its answer. name: of whom it works for. gentle: nobody waits for it.

    When the process dies, another one does its calls once more; when that dies too, ProcessError is raised.
    """

    object = None  # it is elsewhere

    def __init__(self, kind: Callable[..., Any], *args: Any, heard: News, name: str = "", gentle: bool = False):
        self._begin: tuple | None = (kind, args, engine.threads(), gentle)
        self._heard, self._name = heard, name
        self._process = Process() if gentle else take()
        self.folder = Path(tempfile.mkdtemp(prefix="dynamorph-"))
        self._process.tell(str(self.folder))
        self._calls = 0
        self._news = 0  # how many lasting reports were heard
        self._told = 0.0  # when the last passing one was written
        self._died = 0
        self._left = False

    def call(self, name: str, *args: Any) -> Answer:
        """What its method `name` returns, or raises. Raises ProcessError, OSError."""
        if self._begin:
            yield from write(self.folder / "begin", self._begin)
            self._begin = None
        number = self._calls
        yield from write(self.folder / f"{number}.call", (name, args))
        self._calls += 1
        self._process.tell(str(number))
        answer = self.folder / f"{number}.answer"
        while not answer.exists():
            if self._process.ended and not answer.exists():
                self._again()
            yield from self._listen()
            yield
        yield from self._listen()
        raised, result = yield from read(answer)
        answer.unlink()
        if raised:
            raise result
        return result

    @property
    def ended(self) -> bool:
        """Whether the process has."""
        return self._process.ended

    @property
    def pid(self) -> int:
        return self._process.pid

    def end(self) -> None:
        """End the process, whatever it does, and remove its files."""
        if not self._left:
            self._process.end()
            shutil.rmtree(self.folder, ignore_errors=True)

    def leave(self) -> None:
        """Its work is done: let the process remove its files and end, for which nobody waits."""
        self._left = True
        self._process.leave()

    def _listen(self) -> Answer:
        """Pass on what was reported since the last time."""
        while (lasting := self.folder / f"{self._news}.news").exists():
            self._news += 1
            self._heard((yield from read(lasting)))
        passing = self.folder / "news"
        with contextlib.suppress(OSError):  # there is none yet; or Windows, and it is replaced at this moment
            written = passing.stat().st_mtime_ns
            if written != self._told:
                self._told = written
                self._heard(pickle.loads(passing.read_bytes()))

    def _again(self) -> None:
        """Another process does what this one did not end."""
        self._died += 1
        code, said = self._process.code, self._process.said
        self._process.end()
        logger.logger.warning("the process that computes ended with code %s\n%s", code, said)
        if self._died == 2:
            text, remedy = CRASHED if code != KILLED else ENDED
            raise ProcessError(text, name=self._name, remedy=Message(remedy))
        self._process = take()
        for line in (self.folder, *range(self._calls)):
            self._process.tell(str(line))


# Files ---------------------------------------------------------------------------------------------------------------


def write(path: Path, value: Any) -> Answer:
    """Write a value, arrays without a copy, in slices. Raises OSError."""
    arrays: list[pickle.PickleBuffer] = []
    parts = [memoryview(pickle.dumps(value, 5, buffer_callback=arrays.append)), *(each.raw() for each in arrays)]
    unfinished = path.with_name(f"{path.name}.part")
    with unfinished.open("wb") as file:
        file.write(json.dumps([len(part) for part in parts]).encode() + b"\n")
        for done, part in _slices(parts):
            file.write(part)
            if done:
                yield
    unfinished.replace(path)


def read(path: Path) -> Answer:
    """The value that was written, in slices. Raises OSError."""
    with path.open("rb") as file:
        parts = [np.empty(size, np.uint8).data for size in json.loads(file.readline())]
        for done, part in _slices(parts):
            _fill(file, part)
            if done:
                yield
    return pickle.loads(parts[0], buffers=parts[1:])


def _fill(file: BinaryIO, part: memoryview) -> None:
    if file.readinto(part) != len(part):  # type: ignore[attr-defined]  # a file has it
        raise EOFError(f"'{file.name}' is incomplete")


def _slices(parts: list[memoryview]) -> Generator[tuple[bool, memoryview], None, None]:
    """The parts in pieces, and whether so much has gone by that others should have their turn."""
    passed = 0
    for part in parts:
        for first in range(0, len(part), SLICE):
            piece = part[first : first + SLICE]
            passed += len(piece)
            yield passed >= SLICE, piece
            passed %= SLICE


# The process, which may be started before there is work for it --------------------------------------------------------


def prepare() -> None:
    """Start the process of the next `Child` now, because that takes half a second. It ends by itself if it gets no
    work.
    """
    _let_go(wait=False)
    if not (work.spare and work.spare[0].waits):
        _end_spare()
        with contextlib.suppress(DynamorphError):  # `Child` will say so
            work.spare.append(Process())


def dismiss() -> None:
    """End what `prepare` started, and see that those which were left have ended."""
    _let_go(wait=True)
    _end_spare()


def _end_spare() -> None:
    while work.spare:
        work.spare.pop().end()


def _let_go(wait: bool) -> None:
    """Forget the processes that were left and have ended. wait: all of them."""
    for process in [*work.leaving]:
        if wait or process.ended:
            work.leaving.remove(process)
            process.end(PATIENCE)


def take() -> Process:
    """A process that waits for work. Raises ProcessError."""
    if work.spare and work.spare[0].waits:
        return work.spare.pop()
    _end_spare()
    return Process()


class Process:
    """Python without the artist's environment, which runs `main`. Inside Blender it is Blender's own Python. Raises
    ProcessError.
    """

    def __init__(self) -> None:
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - it is closed by `end`
        self._began = time.monotonic()
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}  # with more, a sum has other last digits
        try:
            self._process = subprocess.Popen(
                [sys.executable or "", "-I", "-S", "-X", "utf8", "-c", _program()],
                stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=self._said, bufsize=0, env=environment,
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),  # or Windows would flash a console
            )  # fmt: skip
        except OSError as error:
            self._said.close()
            raise ProcessError(
                "The process that computes cannot be started with '{program}' ({error}). Let the virus scanner allow "
                "this program, or reinstall Blender",
                program=sys.executable,
                error=error,
            ) from error

    def tell(self, line: str) -> None:
        """Write a line to its standard input. If it has ended, that shows soon enough."""
        with _without_sigpipe(), contextlib.suppress(OSError):
            self._process.stdin.write(line.encode() + b"\n")  # type: ignore[union-attr]

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def ended(self) -> bool:
        return self._process.poll() is not None

    @property
    def waits(self) -> bool:
        """Whether it takes work."""
        return not self.ended and time.monotonic() - self._began < IDLE / 2

    @property
    def code(self) -> int | None:
        return self._process.returncode

    @property
    def said(self) -> str:
        """What it wrote about its end."""
        self._said.seek(0)
        return self._said.read().decode("utf-8", "replace")

    def leave(self) -> None:
        """Tell it that nobody needs it any more."""
        self._process.stdin.close()  # type: ignore[union-attr]
        work.leaving.append(self)

    def end(self, patience: float = 0.0) -> None:
        """End it, whatever it does; patience: seconds for it to end by itself."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(patience)
        self._process.kill()
        self._process.wait()
        self._process.stdin.close()  # type: ignore[union-attr]
        self._said.close()


@contextlib.contextmanager
def _without_sigpipe() -> Generator[None, None, None]:
    """Where Python was started without its signal handlers, as in Blender, SIGPIPE would end this process."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGPIPE})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _program() -> str:
    """What the process runs: `answering.main`, in the same package as here. Only modules without bpy are imported."""
    package, folder = __package__.removesuffix(".run.work"), Path(__file__).absolute().parents[2]
    *parents, _ = package.split(".")
    outer = [".".join(parents[: k + 1]) for k in range(len(parents))]
    paths = [str(Path(file).absolute().parents[1]) for file in (str(engine.load().__file__), np.__file__)]
    if not outer:
        paths.append(str(folder.parent))
    return f"""
import sys, types
sys.path[:0] = {paths!r}
for name in {outer!r}:
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].__path__ = [{str(folder.parent)!r}]
from {__package__} import answering, computation  # the second, so that it need not wait for that later
answering.main()
"""


class Lasting:
    """News that are all heard, one after the other. Of others the last counts."""
