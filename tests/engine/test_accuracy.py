# SPDX-License-Identifier: GPL-3.0-or-later
"""What docs/accuracy.md is made of: errors of motions that are known, and the page of figures that are made up."""

import json
import math
from pathlib import Path

import accuracy
import motion_error
import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
MASS = np.array([1.0, 3.0])
SWING = np.sin(np.linspace(0, 2 * np.pi, 24, endpoint=False))[:, None, None] * np.ones((1, 2, 3))
FIRST, SECOND = {"first": np.array([True, False])}, {"second": np.array([False, True])}


def test_error_is_relative_to_the_motion_about_its_mean():
    reference = 5.0 + SWING  # the constant part is no motion
    found = motion_error.errors(1.1 * SWING - 7.0, reference, MASS, FIRST, reference)
    assert found["error"] == pytest.approx(0.1)
    assert found["regions"]["first"] == pytest.approx(0.1)


def test_error_counts_by_mass_and_by_region():
    motion = SWING * np.array([1.0, 1.2])[:, None]
    found = motion_error.errors(motion, SWING, MASS, FIRST | SECOND, SWING)
    assert found["error"] == pytest.approx(0.2 * math.sqrt(0.75))
    assert found["regions"] == {"first": pytest.approx(0.0), "second": pytest.approx(0.2)}


def test_error_is_relative_to_the_dynamic_motion_alone():
    found = motion_error.errors(3.1 * SWING, 3.0 * SWING, MASS, {}, 0.5 * SWING)
    assert found["error"] == pytest.approx(0.2)


def test_nothing_is_said_of_what_does_not_move_or_diverges():
    still = SWING * np.array([0.0, 1.0])[:, None]
    found = motion_error.errors(SWING, still, MASS, FIRST, still)
    assert found["regions"]["first"] is None
    assert motion_error.errors(np.full_like(SWING, np.nan), SWING, MASS, {}, SWING)["error"] is None


def test_regions_by_bones():
    weights = np.array([[0.6, 0.4, 0.0], [0.1, 0.9, 0.0], [0.0, 0.2, 0.8]])  # the last column: no bone
    regions = motion_error.by_bones(weights, ("spine_01", "Thigh_L"))
    assert regions["torso"].tolist() == [True, False, False]
    assert regions["legs"].tolist() == [False, True, False]
    assert not regions["arms"].any()
    with pytest.raises(ValueError, match="wing"):
        motion_error.by_bones(weights, ("spine_01", "wing"))


def test_regions_by_thickness():
    regions = motion_error.by_thickness(np.array([0.1, 0.2, 0.4, 0.9, 1.0]))
    assert regions["thick"].tolist() == [False, False, False, True, True]
    assert (regions["thin"] == ~regions["thick"]).all()


# The page ------------------------------------------------------------------------------------------------------------


def reduced(basis, detail, error, microseconds, torso=0.1):
    """The figures of a reduced model with the same error in two clips but for a tenth of it."""
    clip = {"microseconds": microseconds, "iterations": 1.0, "unconverged": 0}
    regions = dict.fromkeys(motion_error.REGIONS, torso)
    clips = {"walk": clip | {"error": error, "regions": regions},
             "jump": clip | {"error": error and 1.1 * error, "regions": regions}}  # fmt: skip
    return {"basis": basis, "detail": detail, "coordinates": detail, "clips": clips}


def character(name, *rows):
    """The figures of a character as accuracy_shots.py writes them."""
    clip = {"frames": [1, 48], "substeps": 5, "moves": 0.01, "largest": 0.04, "microseconds": 8000.0,
            "iterations": 2.0, "unconverged": 0, "regions": dict.fromkeys(motion_error.REGIONS, 0.02)}  # fmt: skip
    return {
        "title": accuracy.SUBJECTS[name].title, "material_model": "STABLE_STVK", "frequency": 3.5,
        "targets": 1, "nodes": 2000, "default": ["MODES", 20], "dofs": 6000, "clips": {"walk": clip, "jump": clip},
        "rows": list(rows),
        "commit": "Measured at commit `0123456` (2026-01-01)", "machine": "a machine", "blender": "4.5", "jobs": 1,
    }  # fmt: skip


SMALL, LARGE = reduced("MODES", 20, 0.3, 30.0), reduced("MODES", 60, 0.1, 400.0, torso=0.2)
NEW, DIVERGING = reduced("RESPONSES", 120, 0.08, 140.0), reduced("RESPONSES", 220, None, 140.0)


@pytest.fixture
def everything():
    """All characters alike, but that one of the MakeHuman bodies is slower and one refuses a row."""
    refused = {"basis": "RESPONSES", "detail": 40, "clips": {}, "refused": "too few"}
    found = {name: character(name, SMALL, LARGE, NEW, DIVERGING) for name in accuracy.SUBJECTS}
    found["mh_chubby"] = character("mh_chubby", SMALL, LARGE, reduced("RESPONSES", 120, 0.12, 149.0), DIVERGING)
    found["herbert"]["rows"].append(refused)
    return found


def test_best_detail_is_fast_enough_for_every_body(everything):
    group = accuracy.of_group(everything, accuracy.MAKEHUMAN)
    assert accuracy.best(group, "MODES", 150.0) == ("MODES", 20)
    assert accuracy.best(group, "MODES", 450.0) == ("MODES", 60)
    assert accuracy.best(group, "RESPONSES", 130.0) is None
    assert accuracy.best(group, "RESPONSES", 150.0) == ("RESPONSES", 120)  # 220 diverges
    assert accuracy.mean_error(group, ("RESPONSES", 120)) == pytest.approx(0.105)
    assert accuracy.worst_error(group, ("RESPONSES", 120)) == pytest.approx(0.132)


def test_goals_say_what_is_missed(everything):
    lines = accuracy.goals_table(everything).splitlines()[2:]
    cells = {tuple(line.strip("| ").split(" | ")[k] for k in (0, 2)): line.split(" | ")[3:] for line in lines}
    modes, responses = cells["MakeHuman, mean", "≤ 150 µs"]
    assert modes == "**31.5 %** (20, 30 µs)"
    assert responses == "10.5 % (120, 149 µs) |"
    assert cells["MakeHuman, worst", "≤ 150 µs"][1].startswith("13.2 %")
    assert cells["MakeHuman, torso", "≤ 150 µs"][1].startswith("10.0 %")
    assert cells["animals, worst", "≤ 150 µs"][1].startswith("**8.8 %**")
    assert cells["MakeHuman, worst", "≤ 450 µs"][0].startswith("11.0 %")


def test_page_shows_all_characters(everything, tmp_path):
    everything = json.loads(json.dumps(everything))  # as they are stored
    text = accuracy.page(everything)
    assert all(f"### {found['title']}" in text for found in everything.values())
    assert "Measured at commit `0123456` (2026-01-01)" in text
    assert "**vibration modes, 20** | 20 | 30.0 | 1.00 | 30.0 % | 33.0 %" in text  # the default
    assert "diverges" in text
    assert "bone responses, 40: refused, “too few”" in text
    accuracy.draw(everything, tmp_path / "plot.svg")
    assert "<svg" in (tmp_path / "plot.svg").read_text()


def test_page_without_responses(everything, tmp_path):
    """An extension that knows no such basis has rows of modes alone."""
    for found in everything.values():
        found["rows"] = [SMALL, LARGE]
    assert "MakeHuman, mean | ≤ 12% | ≤ 150 µs | **31.5 %** (20, 30 µs) | - |" in accuracy.goals_table(everything)
    accuracy.draw(everything, tmp_path / "plot.svg")
