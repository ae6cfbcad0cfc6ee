# SPDX-License-Identifier: GPL-3.0-or-later
"""What the process of a `Child` does: it answers calls. Only modules without bpy are imported."""

from __future__ import annotations

import contextlib
import faulthandler
import itertools
import os
import pickle
import queue
import shutil
import sys
import threading
import time
import traceback
from pathlib import Path
from typing import Any

from ...core import blas, engine
from .child import IDLE, Answer, Lasting, read, write

OFTEN = 0.05  # seconds from one report to the next
GENTLE = 10  # how nice a process is that nobody waits for


def main() -> None:
    """Answer the calls whose numbers come by standard input, after the folder in which they are. The end of that says
    that Blender has ended, or does not need this any more.
    """
    faulthandler.enable()
    blas.use_one_thread()
    engine.load().prepare_mesher()
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=_hear, args=[lines], daemon=True).start()  # only it hears while an engine's call runs
    try:
        folder = Path(lines.get(timeout=IDLE))
    except queue.Empty:
        engine.load().dismiss_mesher()
        os._exit(0)
    answerer = _Answerer(folder)
    while True:
        answerer.answer(int(lines.get()))


def _hear(lines: queue.SimpleQueue[str]) -> None:
    """In a thread of the process."""
    folder = ""
    for line in sys.stdin:
        folder = folder or line.rstrip("\n")
        lines.put(line.rstrip("\n"))
    engine.load().dismiss_mesher()
    if folder:
        shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


class _Answerer:
    """The object in this process, made of the file `begin` in a folder, and its answers."""

    def __init__(self, folder: Path):
        self._folder = folder
        self._numbers = itertools.count()  # of lasting reports
        self._reported = 0.0  # when the last passing one was written
        self._object: Any = None

    def answer(self, number: int) -> None:
        """Write what the call of this number returns, or raises."""
        try:
            name, args = _all(read(self._folder / f"{number}.call"))
            answer = False, getattr(self._made(), name)(*args)
        except BaseException as error:  # raised again where the call came from
            error.add_note("in the process that computes:\n" + traceback.format_exc())
            answer = True, error
        file = self._folder / f"{number}.answer"
        try:
            _all(write(file, answer))
        except (TypeError, AttributeError, pickle.PicklingError):  # it cannot be sent
            _all(write(file, (True, RuntimeError(f"{answer[1]!r}"))))

    def _made(self) -> Any:
        if self._object is None:
            kind, args, threads, gentle = _all(read(self._folder / "begin"))
            engine.use_threads(threads)
            if gentle:
                _give_way()
            self._object = kind(*args, self._news)
        return self._object

    def _news(self, news: Any) -> None:
        """Report what the object has to say: at once what lasts, now and then what the next report replaces."""
        if isinstance(news, Lasting):
            _all(write(self._folder / f"{next(self._numbers)}.news", news))
        elif time.monotonic() - self._reported > OFTEN:
            self._reported = time.monotonic()
            unfinished = self._folder / "news.part"
            unfinished.write_bytes(pickle.dumps(news))
            with contextlib.suppress(PermissionError):  # Windows, while it is read
                unfinished.replace(self._folder / "news")


def _give_way() -> None:
    """Let all other processes go first."""
    if hasattr(os, "nice"):
        os.nice(GENTLE)
    elif sys.platform == "win32":
        import ctypes

        ctypes.windll.kernel32.SetPriorityClass(ctypes.windll.kernel32.GetCurrentProcess(), 0x40)  # IDLE


def _all(steps: Answer) -> Any:
    """What a generator returns at its end."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value
