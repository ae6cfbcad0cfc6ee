# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine computes the bytes that are kept for this version."""

import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PROGRAM = ROOT / "build" / "cmake" / "engine_tests"
sys.path.append(str(ROOT / "tests" / "golden"))

import motion  # noqa: E402


@pytest.mark.fault("S02")
@pytest.mark.skipif(not PROGRAM.exists(), reason="needs the C++ tests: make build")
def test_the_same_bytes_as_before():
    """Those of this version, or of the last one that has some. `make golden` replaces them after a change of the
    motion that is meant.
    """
    kept: dict[str, str] = {}
    for of_version in json.loads(motion.KEPT.read_text(encoding="utf-8")).values():
        kept |= of_version
    found = motion.hashes(PROGRAM)
    assert found
    if not found.keys() & kept.keys():
        pytest.skip(f"no hash is kept for {', '.join(found)}")
    assert {built: value for built, value in found.items() if kept.get(built, value) != value} == {}
