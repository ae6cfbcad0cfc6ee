# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/results.md has the thesis's material models and the default one, and says what a precompute consists of."""

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("dynamorph", reason="needs the engine")
pytest.importorskip("matplotlib", reason="needs what draws the plots")
sys.path.append(str(Path(__file__).parents[3] / "sample_blends"))
import results_page
import subjects

FIGURES = Path(__file__).parents[3] / "sample_blends" / "figures.py"  # a module of the tests has the same name
SPEC = importlib.util.spec_from_file_location("sample_figures", FIGURES)


@pytest.fixture(scope="module")
def found(addon):
    """A few frames of the cylinder, measured with few modes."""
    figures = importlib.util.module_from_spec(SPEC)
    SPEC.loader.exec_module(figures)
    figures.MODES, figures.FITTED_MODES = (8,), ()
    work = figures.Work(replace(subjects.CYLINDER, measured=(86, 91), ringing=(86, 88, 91)))
    return {"bulging_cylinder": {"table": figures.table(work), "accuracy": figures.accuracy(work)}}


def test_the_default_material_model_is_tabulated(found, tmp_path):
    results_page.write(tmp_path, "this machine", found, {})
    page = (tmp_path / "results.md").read_text("utf-8")
    assert "| StVK | Red. StVK | Stable StVK (default) | Red. stable StVK (default) | precompute |" in page
    assert "stable StVK: RMS dynamic" in page
    assert "| stable StVK reduced |" in page


def test_the_page_lists_the_stages_of_a_precompute(found):
    head, row = results_page.precompute({"bulging_cylinder": found["bulging_cylinder"]["table"]})[0].splitlines()[::2]
    assert head.startswith("| precompute | meshing | embedding ") and head.endswith("| polynomials | together |")
    *stages, together = [float(cell.split(" s")[0]) for cell in row.split(" | ")[1:]]
    assert sum(stages) == pytest.approx(together, abs=0.05)


def test_the_page_can_be_written_again(found, tmp_path):
    results_page.write(tmp_path, "this machine", found, {})
    before = (tmp_path / "results.md").read_text("utf-8")
    (tmp_path / "results.md").unlink()
    results_page.write_again(tmp_path)
    assert (tmp_path / "results.md").read_text("utf-8") == before
