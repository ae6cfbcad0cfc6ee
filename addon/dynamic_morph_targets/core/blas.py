# SPDX-License-Identifier: GPL-3.0-or-later
"""How many threads NumPy's linear algebra has. Its sums, and so the last digits of a model, depend on that; and its
threads wait for each other by spinning, which takes the processor from whatever else computes.
"""

from __future__ import annotations

import ctypes
import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

PREFIXES = ("scipy_openblas", "openblas")
SUFFIXES = ("64_", "")


def use_one_thread() -> None:
    """For a process of our own, which makes the same bytes as any other then. Nothing happens where NumPy has another
    library than OpenBLAS.
    """
    if call := _function("set"):
        call(1)


@contextmanager
def one_thread() -> Iterator[None]:
    """The same for a while, in a process that is not ours."""
    before = threads()
    use_one_thread()
    try:
        yield
    finally:
        if before and (call := _function("set")):
            call(before)


def threads() -> int:
    """How many threads it has; 0 where that is not known."""
    call = _function("get")
    return call() if call else 0


def _function(verb: str) -> Any:
    """OpenBLAS's function that sets or gets the number of threads, or None."""
    names = [f"{prefix}_{verb}_num_threads{suffix}" for prefix in PREFIXES for suffix in SUFFIXES]
    found = (getattr(library, name) for library in _libraries() for name in names if hasattr(library, name))
    return next(found, None)


def _libraries() -> Iterator[ctypes.CDLL]:
    """NumPy's module, in which most systems find what it has loaded, and on Windows the files beside NumPy."""
    yield ctypes.CDLL(importlib.import_module("numpy.linalg._umath_linalg").__file__)
    for path in Path(np.__file__).parents[1].glob("numpy.libs/*openblas*.dll"):
        yield ctypes.CDLL(str(path))
