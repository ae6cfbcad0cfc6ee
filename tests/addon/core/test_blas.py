# SPDX-License-Identifier: GPL-3.0-or-later
"""NumPy's linear algebra has one thread where we compute, and stays as it is in Blender."""

import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import blas
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.run.work.child import Child
from bl_ext.user_default.dynamic_morph_targets.run.work.computation import Errand


def test_a_process_that_computes_has_one_thread(soft_arm):
    if not blas.threads():
        pytest.skip("NumPy has another library than OpenBLAS")
    np.linalg.svd(np.eye(3))
    before = blas.threads()
    child = Child(Errand, heard=lambda _news: None)
    answer = child.call("run", blas.threads, False)
    try:
        while True:
            next(answer)
    except StopIteration as end:
        assert end.value == 1
    finally:
        child.end()
    assert blas.threads() == before


def test_work_in_this_process_has_one_thread_meanwhile(soft_arm, stand_in, monkeypatch):
    before, seen, build_for = blas.threads(), [], stand_in.build_for
    monkeypatch.setattr(
        stand_in, "build_for", lambda *args, **given: seen.append(blas.threads()) or build_for(*args, **given)
    )
    batch.run(Job(soft_arm, goal="BAKE"))
    assert seen == [1] and blas.threads() == before
    with pytest.raises(KeyError), blas.one_thread():
        raise KeyError
    assert blas.threads() == before
