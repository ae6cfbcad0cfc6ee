# SPDX-License-Identifier: GPL-3.0-or-later
"""What docs/how_long.md and the table of docs/comparison.md say of figures that are made up."""

from pathlib import Path

import pytest

pytest.importorskip("dynamorph", reason="needs the engine")
pytest.importorskip("matplotlib", reason="needs what draws the plots")
ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def pages():
    """Both modules, which are made for processes of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BLENDER_USER_RESOURCES", "")  # which they set
        import comparison
        import how_long

        yield how_long, comparison


def test_settings_are_factors_of_the_defaults(pages):
    how_long, _ = pages
    defaults = dict.fromkeys(("whole", "bake", "simulate", "live_frame", "bake_bytes"), 2.0)
    assert how_long.setting_row("Detail 240", defaults | {"bake": 5.0}, defaults) == [
        "Detail 240", "1 times", "2.5 times", "1 times", "1 times", "1 times"
    ]  # fmt: skip


def test_a_busy_machine_is_named(pages):
    how_long, _ = pages
    assert "load 3.2" in how_long.busy(3.2)
    assert how_long.busy(0.1) == ""


def test_a_way_that_does_not_end_has_no_figures(pages):
    _, comparison = pages
    way = comparison.Way("Cloth", lambda limb: None)
    assert comparison.row(way, None)[:3] == ["Cloth", "defaults", f"over {comparison.LONGEST}"]


def test_a_limb_that_hardens_moves_less(pages):
    _, comparison = pages
    found = {"seconds": 1.6, "kept": 0.5, "off": 0.002, "straight": 0.03, "flexed": 0.002, "bytes": 2**20}
    cells = comparison.row(comparison.Way("Cloth", lambda limb: None), found)
    assert cells[2:] == ["1.6", "10", "50%", "2.0 mm", "30.0 mm", "2.0 mm", "15.0", "1.0 MB"]
