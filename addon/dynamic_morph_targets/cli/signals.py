# SPDX-License-Identifier: GPL-3.0-or-later
"""Signals that end a command: Ctrl-C, and a scheduler's."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from types import FrameType

_RAISED: ContextVar[list[int]] = ContextVar("raised")  # in the present block


class Preempted(BaseException):
    """A scheduler needs the machine for something else."""


@contextmanager
def raised() -> Iterator[None]:
    """They raise KeyboardInterrupt and Preempted in the block. Blender swallows the first Ctrl-C unless a handler of
    Python is in place.
    """
    token = _RAISED.set([])
    before = _handle(_raise)
    try:
        yield
    finally:
        _RAISED.reset(token)
        for number, handler in before.items():
            if handler is not None:  # otherwise it is Blender's own, set in C, and Blender ends here anyway
                signal.signal(number, handler)


@contextmanager
def delayed() -> Iterator[None]:
    """Within `raised`: they wait until the block has ended."""
    check()
    caught: list[int] = []
    _handle(lambda number, _frame: caught.append(number))
    try:
        yield
    finally:
        _handle(_raise)
    if caught:
        _raise(caught[0], None)


@contextmanager
def propagated() -> Iterator[None]:
    """Within `raised`: signals leave the block as exceptions, even if Blender has swallowed them."""
    try:
        yield
    except Exception:
        check()
        raise
    check()


def check() -> None:
    """Raise once more what has come while Blender called Python: a handler, a driver, an operator. It prints what these
    raise, and goes on.
    """
    if raised := _RAISED.get([]):
        raise _error(raised[0])


def ignore() -> None:
    """Within `raised`: nothing happens from now on."""
    _handle(signal.SIG_IGN)


def _handle(handler: Callable[[int, FrameType | None], object] | signal.Handlers) -> dict:
    """Schedulers end a process by Ctrl-Break on Windows, where SIGTERM cannot be caught."""
    stops = signal.SIGINT, getattr(signal, "SIGBREAK", signal.SIGTERM)
    return {number: signal.signal(number, handler) for number in stops}


def _raise(number: int, _frame: FrameType | None) -> None:
    """Only once: another one would end what the first one has led to."""
    ignore()
    _RAISED.get().append(number)
    raise _error(number)


def _error(number: int) -> BaseException:
    return KeyboardInterrupt() if number == signal.SIGINT else Preempted()
