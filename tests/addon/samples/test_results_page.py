# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/results.md has the thesis's material models and the default one, and says what a precompute consists of."""

from dataclasses import replace

import pytest

pytest.importorskip("dynamorph", reason="needs the engine")
pytest.importorskip("matplotlib", reason="needs what draws the plots")
import results
import results_page
import subjects


@pytest.fixture(scope="module")
def found(addon):
    """A few frames of the cylinder, measured with few modes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(results, "MODES", (8,))
        patch.setattr(results, "FITTED_MODES", ())
        work = results.Work(replace(subjects.CYLINDER, measured=(86, 91), ringing=(86, 88, 91)))
        return {"bulging_cylinder": {"table": results.table(work), "accuracy": results.accuracy(work)}}


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
