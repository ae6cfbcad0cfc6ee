# SPDX-License-Identifier: GPL-3.0-or-later
"""Full Quality bakes every node with the model that there is, and a reduced bake is compared with it."""

import json
from dataclasses import replace

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.cli import main
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.core.motion import baked
from bl_ext.user_default.dynamic_morph_targets.run.bake import full_comparison
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from builders import hand_made_bake
from layout import drawn
from robustness import bake

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")


@pytest.fixture
def coarse(soft_arm):
    """The soft arm with a coarse cage and few modes."""
    model = soft_arm.dynamorph.model
    model.cage_nodes, model.basis, model.modes = 200, "MODES", 4
    return soft_arm


def about_mean(bake):
    motion = np.array([bake.displacement(k) for k in range(len(bake.frames))])
    return motion - motion.mean(axis=0)


# Full Quality -----------------------------------------------------------------------------------------------------


def test_final_quality_needs_no_other_build(coarse):
    content_id = bake(coarse).target().dynamorph.model.content_id
    reduced = coarse.dynamorph.bake.digest
    coarse.dynamorph.model.solver = "FULL"
    final = bake(coarse)
    assert final.input.reasons == [] and coarse.dynamorph.model.content_id == content_id
    assert coarse.dynamorph.bake.digest != reduced
    coarse.dynamorph.model.solver = "REDUCED"
    assert bake(coarse).input.reasons == []
    assert coarse.dynamorph.bake.digest == reduced


def test_a_model_built_for_final_quality_keeps_its_cage_when_modes_are_asked_for(coarse):
    coarse.dynamorph.model.solver = "FULL"
    final = bake(coarse)
    assert final.input.reasons == ["there was no model"] and not final.outcome.model.basis.size
    coarse.dynamorph.model.solver = "REDUCED"
    assert staleness.model_changes(coarse) == ["Quality changed"]
    reduced = bake(coarse)
    assert reduced.input.reasons == ["Quality changed"] and reduced.outcome.model.basis.shape[1] == 4
    assert np.array_equal(final.outcome.model.nodes, reduced.outcome.model.nodes)


def test_keys_that_lack_some_of_the_motion_say_so(coarse):
    coarse.dynamorph.model.solver = "FULL"
    job = bake(coarse)
    lost = job.outcome.report["compression_error"]
    assert lost > 0 and f"keys off by at most {1000 * lost:.2g} mm" in job.summary()


def test_a_point_cache_holds_all_of_the_motion(coarse, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    coarse.dynamorph.model.solver, coarse.dynamorph.output.format = "FULL", "PC2"
    job = bake(coarse)
    assert len(job.outcome.bake.modes) > 4 and "off by" not in job.summary()
    assert job.outcome.report["compression_error"] < 1e-5


# Distance ----------------------------------------------------------------------------------------------------------


def test_distance_is_of_the_motion_about_its_mean(soft_arm):
    motion_distance = baked.motion_distance
    reference = hand_made_bake(soft_arm)
    areas = np.random.default_rng(2).uniform(0.5, 1.0, len(soft_arm.data.vertices))
    still = replace(reference, coordinates=0 * reference.coordinates, weights=0 * reference.weights)
    shifted = replace(reference, coordinates=reference.coordinates + 5.0)
    half = replace(reference, coordinates=reference.coordinates / 2, weights=reference.weights / 2)
    for other, expected in ((reference, 0.0), (shifted, 0.0), (half, 0.5), (still, 1.0)):
        assert motion_distance(other, reference, np.eye(3), areas) == pytest.approx(expected, abs=1e-7)
    assert motion_distance(reference, still, np.eye(3), areas) == 0.0


def test_distance_counts_each_vertex_by_its_area(soft_arm):
    reference, other = hand_made_bake(soft_arm), hand_made_bake(soft_arm, seed=3)
    to_bind, areas = np.diag([1.0, 2.0, 3.0]), np.zeros(len(soft_arm.data.vertices))
    areas[7] = 1.0
    apart, moved = (
        (each @ to_bind)[:, 7] for each in (about_mean(other) - about_mean(reference), about_mean(reference))
    )
    expected = np.linalg.norm(apart) / np.linalg.norm(moved)
    assert baked.motion_distance(other, reference, to_bind, areas) == pytest.approx(expected)


# Comparing a bake --------------------------------------------------------------------------------------------------


def compared(obj) -> float:
    assert bpy.ops.dynamorph.compare_full() == {"FINISHED"}
    return obj.dynamorph.bake.off_full


def test_the_panel_says_how_far_a_bake_is_from_final_quality(coarse):
    digest = bake(coarse).target().dynamorph.bake.digest
    assert "dynamorph.compare_full" in drawn(coarse) and "Measured error" not in " ".join(drawn(coarse))
    distance = compared(coarse)
    assert 0.01 < distance < 1.0
    assert f"Measured error: {100 * distance:.1f} % of the motion" in " ".join(drawn(coarse))
    assert coarse.dynamorph.bake.digest == digest  # the bake stays as it was


def test_it_is_the_distance_of_both_bakes(coarse):
    reduced = bake(coarse)
    distance = compared(coarse)
    coarse.dynamorph.model.solver = "FULL"
    coarse.dynamorph.model.modes = 40  # keys: more than there are frames
    final = bake(coarse)
    character = final.outcome.character
    corners = character.vertices[character.triangles]
    sizes = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    areas = np.bincount(character.triangles.ravel(), np.repeat(sizes, 3), len(character.vertices))
    apart, moved = about_mean(reduced.outcome.bake) - about_mean(final.outcome.bake), about_mean(final.outcome.bake)
    expected = np.sqrt(np.einsum("fvc,v->", apart**2, areas) / np.einsum("fvc,v->", moved**2, areas))
    assert distance == pytest.approx(expected, rel=1e-3)


def test_more_modes_are_nearer(coarse):
    bake(coarse)
    few = compared(coarse)
    coarse.dynamorph.model.modes = 30
    bake(coarse)
    assert compared(coarse) < few / 2


def test_the_amount_of_motion_that_shows_does_not_count(coarse):
    bake(coarse)
    distance = compared(coarse)
    coarse.dynamorph.simulation.amount = 0.2
    bake(coarse)
    assert compared(coarse) == pytest.approx(distance)


@pytest.mark.parametrize("forget", [bake, lambda _obj: bpy.ops.dynamorph.delete_bake()])
def test_another_bake_was_not_compared(coarse, forget):
    bake(coarse)
    compared(coarse)
    forget(coarse)
    assert coarse.dynamorph.bake.off_full < 0 and "Measured error" not in " ".join(drawn(coarse))


def test_what_cannot_be_compared(coarse):
    possible = bpy.ops.dynamorph.compare_full.poll
    assert not possible()
    bake(coarse)
    assert possible()
    coarse.dynamorph.targets[0].stiffness *= 2.0
    assert not possible()  # the bake is out of date
    coarse.dynamorph.model.solver = "FULL"
    bake(coarse)
    assert not possible() and "dynamorph.compare_full" not in drawn(coarse)


def test_it_can_be_canceled(coarse):
    bake(coarse)
    comparison = full_comparison.FullComparison(coarse)
    steps = comparison.steps()
    next(steps)
    assert comparison.fraction < 0.5
    comparison.cancel()
    with pytest.raises(errors.Cancelled):
        list(steps)
    comparison.stop()
    assert coarse.dynamorph.bake.off_full < 0


def test_the_command_line_compares_too(coarse, tmp_path, capfd):
    file, report = tmp_path / "shot.blend", tmp_path / "report.json"
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    run = main.main
    command = ["bake", str(file), "--object", "Arm", "--frames", "1", "8", "--report", str(report), "--in-place"]
    assert run([*command, "--compare-full"], opens_file=True) == 0
    off_full = json.loads(report.read_text())["characters"][0]["bake"]["off_full"]
    assert f"off Full Quality{100 * off_full:>18.1f} %"[-8:] in capfd.readouterr().out
    assert bpy.data.objects["Arm"].dynamorph.bake.off_full == pytest.approx(off_full)
    assert run([*command, "--compare-full", "--solver", "full"], opens_file=True) == 2
