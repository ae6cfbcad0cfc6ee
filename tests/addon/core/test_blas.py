# SPDX-License-Identifier: GPL-3.0-or-later
"""NumPy's linear algebra has one thread where we compute beside Blender, and as many as before afterward."""

import threading

import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import blas
from bl_ext.user_default.dynamic_morph_targets.run import batch
from bl_ext.user_default.dynamic_morph_targets.run.job import Job


@pytest.fixture
def several():
    """How many threads NumPy has, more than one."""
    if not blas.threads():
        pytest.skip("NumPy has another library than OpenBLAS")
    np.linalg.svd(np.eye(3))
    before = blas.threads()
    if before < 2:
        pytest.skip("NumPy has one thread here")
    return before


def test_work_has_one_thread(several):
    with blas.one_thread():
        assert blas.threads() == 1
    assert blas.threads() == several
    with pytest.raises(KeyError), blas.one_thread():
        raise KeyError
    assert blas.threads() == several


def test_who_ends_first_leaves_one_to_the_others(several):
    begun, ends = threading.Event(), threading.Event()

    def work():
        with blas.one_thread():
            begun.set()
            ends.wait()

    other = threading.Thread(target=work)
    other.start()
    begun.wait()
    with blas.one_thread():
        assert blas.threads() == 1
    assert blas.threads() == 1
    ends.set()
    other.join()
    assert blas.threads() == several


def test_a_job_computes_with_one_thread(several, soft_arm, stand_in, monkeypatch):
    seen, build_for = [], stand_in.build_for
    monkeypatch.setattr(
        stand_in, "build_for", lambda *args, **given: seen.append(blas.threads()) or build_for(*args, **given)
    )
    batch.run(Job(soft_arm, goal="BAKE"))
    assert seen == [1] and blas.threads() == several
