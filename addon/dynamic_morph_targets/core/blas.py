# SPDX-License-Identifier: GPL-3.0-or-later
"""How many threads NumPy's linear algebra has. Its sums, and so the last digits of a model, depend on that."""

from __future__ import annotations

import ctypes
import importlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

NAMES = ("scipy_openblas_set_num_threads64_", "openblas_set_num_threads64_", "openblas_set_num_threads")


def use_one_thread() -> None:
    """For a process of our own, which makes the same bytes as any other then. Nothing happens where NumPy has another
    library than OpenBLAS.
    """
    for library in _libraries():
        for name in NAMES:
            if hasattr(library, name):
                getattr(library, name)(1)
                return


def _libraries() -> Iterator[ctypes.CDLL]:
    """NumPy's module, in which most systems find what it has loaded, and on Windows the files beside NumPy."""
    yield ctypes.CDLL(importlib.import_module("numpy.linalg._umath_linalg").__file__)
    for path in Path(np.__file__).parents[1].glob("numpy.libs/*openblas*.dll"):
        yield ctypes.CDLL(str(path))
