# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/performance.md says which goals are missed, and where VegaFEM is faster."""

from pathlib import Path

import pytest

pytest.importorskip("matplotlib", reason="needs what draws the plots")
import performance_page
import table

ROOT = Path(__file__).parents[2]
STEP = "converged_step/targets:1/r:19"
WHOLE_STEP = "whole step with its rig, to convergence, r = 19"


def measured(seconds: float) -> dict:
    return {"engine": {STEP: {"seconds": seconds}}, "pipeline": {}}


def cells_of(work: str, of: dict) -> tuple[str, ...]:
    return next(row for row in table.rows(of) if row[0] == work)


def test_a_missed_goal_is_named_and_bold():
    assert cells_of(WHOLE_STEP, measured(15e-6)) == (WHOLE_STEP, "≤ 10 µs", "15 µs", "**1.5**, missed")
    assert table.missed(measured(15e-6)) == [WHOLE_STEP]
    assert f"- {WHOLE_STEP}" in performance_page.missed_goals(measured(15e-6))


def test_a_goal_that_is_reached_is_not():
    assert cells_of(WHOLE_STEP, measured(5e-6))[-1] == "0.5"
    assert WHOLE_STEP not in performance_page.missed_goals(measured(5e-6))


def test_where_vegafem_is_faster_its_ratio_is_bold():
    by_modes, _ = performance_page.against_vega()
    assert "| **0.46 times** | **0.53 times** | **0.65 times** | 2.3 times |" in by_modes


def test_the_page_shows_each_ratio():
    page = (ROOT / "docs" / "performance.md").read_text("utf-8")
    assert all(grid in page for grid in performance_page.against_vega())
