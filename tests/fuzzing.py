# SPDX-License-Identifier: GPL-3.0-or-later
"""Targets for random input: a few examples, the same each time, in `make test`; as many as time allows in `make -C
evidence fuzz`.

What fails there is tried first the next time (build/fuzz). Once fixed it becomes an `@example`, or a file of
tests/fuzz/corpus, which are all tried each time. The model is that of tests/golden.
"""

from __future__ import annotations

import functools
import os
import time
from pathlib import Path

import long_runs
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from hypothesis.database import DirectoryBasedExampleDatabase

ROOT = Path(__file__).resolve().parents[1]
CORPUS = ROOT / "tests" / "fuzz" / "corpus"
GOLDEN = ROOT / "tests" / "golden" / "model.dynamorph"
FOUND = ROOT / "build" / "fuzz"
MINUTES = float(os.environ.get("DYNAMORPH_FUZZ_MINUTES", 0))  # for all targets together
EXAMPLES = int(os.environ.get("DYNAMORPH_FUZZ", 0))  # for each; 0: as the target says
BUILD = os.environ.get("DYNAMORPH_FUZZ_BUILD", "")  # what is special about the engine's
BATCH = 200  # examples from one look at the clock to the next
targets: list[str] = []  # that share the time


def seconds() -> float:
    """The time for each target."""
    return 60.0 * MINUTES / max(len(targets), 1)


def keep(test: str, inputs: int, took: float, failed: bool):
    """What came of a target, for docs/reliability.md. took: seconds."""
    part = f"{test}, {BUILD}" if BUILD else test
    long_runs.keep("fuzz", part, inputs=inputs, seconds=took, failed=failed)


def target(*strategies, examples: int):
    """`hypothesis.given`, for a test that takes random input. examples: in `make test`."""
    searches = MINUTES or EXAMPLES

    def decorate(test):
        tried = 0

        @functools.wraps(test)
        def counted(*args, **given):
            nonlocal tried
            tried += 1
            test(*args, **given)

        once = settings(
            max_examples=EXAMPLES or (BATCH if MINUTES else examples),
            derandomize=not searches,
            database=DirectoryBasedExampleDatabase(FOUND) if searches else None,
            deadline=None,
            phases=[Phase.explicit, Phase.reuse, Phase.generate, Phase.shrink],  # to explain takes minutes
            suppress_health_check=list(HealthCheck),
            print_blob=True,
        )(given(*strategies)(counted))
        targets.append(test.__name__)

        @functools.wraps(once)
        def again(*args, **fixtures):
            began = time.monotonic()
            ends = began + seconds()
            failed = True
            try:
                once(*args, **fixtures)
                while time.monotonic() < ends:
                    once(*args, **fixtures)
                failed = False
            finally:
                keep(test.__name__, tried, time.monotonic() - began, failed)

        return again if MINUTES else once

    return decorate


EDIT = st.tuples(
    st.sampled_from(["cut", "flip", "insert", "remove", "repeat", "set"]), st.floats(0, 1), st.binary(max_size=16)
)


def edited(content: bytes, edits) -> bytes:
    """The bytes after edits of the strategy `EDIT`: (kind, where, bytes)."""
    data = bytearray(content)
    for kind, where, new in edits:
        at, count = round(where * len(data)), len(new)
        if kind == "cut":
            del data[at:]
        elif kind == "flip" and at < len(data):
            data[at] ^= 1 << count % 8
        elif kind == "insert":
            data[at:at] = new
        elif kind == "remove":
            del data[at : at + count]
        elif kind == "repeat":
            data[at:at] = data[max(at - 4 * count, 0) : at]
        elif kind == "set":
            data[at : at + count] = new
    return bytes(data)


def corpus(kind: str) -> list[Path]:
    """The kept files of a kind; there is at least one."""
    found = [GOLDEN] if kind == "model" else sorted((CORPUS / kind).iterdir())
    assert found
    return found
