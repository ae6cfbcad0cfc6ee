# SPDX-License-Identifier: GPL-3.0-or-later
"""NumPy's linear algebra has one thread where we compute, and stays as it is in Blender."""

import os

import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import blas
from bl_ext.user_default.dynamic_morph_targets.run.child import Child
from bl_ext.user_default.dynamic_morph_targets.run.computation import Errand


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
    assert blas.threads() == before == (before if "OPENBLAS_NUM_THREADS" in os.environ else os.cpu_count())
