# SPDX-License-Identifier: GPL-3.0-or-later
"""Material presets and fits, as buttons and on the command line."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.cli import main
from bl_ext.user_default.dynamic_morph_targets.core.material import fit as fit_module
from bl_ext.user_default.dynamic_morph_targets.core.material import presets
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store
from builders import refused
from pressed import invoked

OPS = bpy.ops.dynamorph


def material(target):
    return pytest.approx(vars(target.material()), rel=1e-6)


def test_a_preset_changes_the_selected_target_alone(soft_arm):
    neutral, flexed = soft_arm.dynamorph.targets
    before = material(neutral)
    soft_arm.dynamorph.active_target_index = 1
    for key, preset in presets.PRESETS.items():
        assert OPS.apply_material(preset=key) == {"FINISHED"}
        assert vars(preset.material) == material(flexed)
    assert vars(neutral.material()) == before


def test_presets_show_their_source():
    items = OPS.apply_material.get_rna_type().properties["preset"].enum_items
    assert items["FAT"].name == "Fat"
    assert all(len(item.description) > 50 for item in items)


def test_a_preset_is_undone(soft_arm):
    bpy.ops.ed.undo_push(message="before")
    before = material(soft_arm.dynamorph.targets[0])
    soft_arm.dynamorph.active_target_index = 0
    OPS.apply_material(preset="SKIN")
    bpy.ops.ed.undo_push(message="skin")
    bpy.ops.ed.undo()
    assert vars(bpy.data.objects["Arm"].dynamorph.targets[0].material()) == before


def test_without_a_target_or_a_model_there_is_nothing_to_set(soft_arm):
    assert not OPS.fit_material.poll()
    soft_arm.dynamorph.active_target_index = 9
    refused(OPS.apply_material, "Select a target", preset="FAT")


def built(obj):
    """The soft arm with a coarse cage, so that it builds in a second."""
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    obj.dynamorph.model.cage_nodes = 200
    obj.dynamorph.model.modes = 8
    OPS.build()
    return obj


@pytest.fixture
def built_arm(soft_arm):
    soft_arm.dynamorph.active_target_index = 1
    return built(soft_arm)


def test_fit_bounce(built_arm):
    material_fit = fit_module
    target = built_arm.dynamorph.targets[1]
    poisson, density, content = target.poisson, target.density, built_arm.dynamorph.model.content_id
    assert OPS.fit_material.poll() and OPS.fit_material(frequency=4.0, settle_time=0.75) == {"FINISHED"}
    now = material_fit.bounce(*model_store.fit_input(built_arm, target))
    assert (now.frequency, now.settle) == pytest.approx((4.0, 0.75), rel=1e-4)
    assert (target.poisson, target.density) == (poisson, density)
    assert model_store.stale_reasons(built_arm, extract.character(built_arm)) == []
    assert built_arm.dynamorph.model.content_id == content  # no new build


def test_the_dialog_begins_with_the_bounce_as_it_is(built_arm):
    asked = []

    def dialog(operator):
        asked.append((operator.frequency, operator.settle_time))
        return {"CANCELLED"}

    target = built_arm.dynamorph.targets[1]
    assert invoked(built_arm, "DYNAMORPH_OT_fit_material", invoke_props_dialog=dialog) == {"CANCELLED"}
    now = fit_module.bounce(*model_store.fit_input(built_arm, target))
    assert asked == [pytest.approx((now.frequency, now.settle), rel=1e-6)]


def test_a_fit_needs_a_model_of_the_present_body(built_arm):
    before = material(built_arm.dynamorph.targets[1])
    built_arm.data.shape_keys.key_blocks["flexed"].points[0].co.x += 0.1
    refused(OPS.fit_material, "shape of 'flexed' changed.*press Build Model first")
    assert vars(built_arm.dynamorph.targets[1].material()) == before


def test_a_muted_target_has_no_bounce(scene, soft_arm):
    scene.frame_set(10)
    OPS.add_target(key="smile")
    soft_arm.dynamorph.targets[1].mute = True
    built(soft_arm)
    assert OPS.fit_material() == {"FINISHED"}  # 'smile' is selected
    soft_arm.dynamorph.active_target_index = 1
    refused(OPS.fit_material, "'flexed' is not in the model: it is muted")


# The command line --------------------------------------------------------------------------------------------------


@pytest.fixture
def fit(built_arm, tmp_path, capfd):
    """Fits the numbers of a CSV file on the command line; returns exit code, output, errors."""

    def fit(kind, rows, *arguments, names="", target="flexed"):
        if kind == "--oscillation":
            rows = np.column_stack(rows)
        table, output = tmp_path / "points.csv", tmp_path / "fitted.blend"
        np.savetxt(table, rows, delimiter=",", header=names, comments="")
        capfd.readouterr()
        where = ("--object", "Arm", "--target", target, "-o", output)
        code = main.main(["fit", kind, str(table), *map(str, where), *arguments])
        return code, *capfd.readouterr()

    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    return fit


def test_a_tracked_point_is_fitted(built_arm, fit, tmp_path):
    times = np.arange(0.0, 3.0, 1 / 60)
    along = 100.0 + np.exp(-2.0 * times) * np.cos(2 * np.pi * 3.0 * times)
    code, out, _ = fit("--oscillation", (times, along), names="t,x")
    assert code == 0 and "frequency 3 +-" in out and "flexed: stiffness 2e+04 ->" in out
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "fitted.blend"))
    obj = bpy.data.objects["Arm"]
    now = fit_module.bounce(*model_store.fit_input(obj, obj.dynamorph.targets[1]))
    assert (now.frequency, now.decay) == pytest.approx((3.0, 2.0), rel=1e-3)


def test_pushes_are_fitted(built_arm, fit):
    built_arm.vertex_groups.new(name="tip").add(range(240, 272), 1.0, "REPLACE")
    pushes = np.array([[1.0, 0, 0, 0.01, 0, 0], [0, 1.0, 0, 0, 0.01, 0]]) * [20, 20, 20, 1, 1, 1]
    before = built_arm.dynamorph.targets[1].stiffness
    code, out, err = fit("--force-displacement", pushes, "--vertex-group", "tip")
    assert (code, err) == (0, "") and built_arm.dynamorph.targets[1].stiffness != before


def test_what_the_command_line_refuses(fit, tmp_path):
    times = np.arange(0.0, 3.0, 1 / 60)
    record = (times, np.cos(20.0 * times))
    for words, answer in (
        ("no target named 'nope'", fit("--oscillation", record, target="nope")),
        ("no vertex group named 'nope'", fit("--oscillation", record, "--vertex-group", "nope")),
        ("no oscillation", fit("--oscillation", (times, np.random.default_rng(0).normal(size=len(times))))),
        ("expected 2 or 3 or 4 numbers", fit("--oscillation", [times] * 5)),
        ("expected 6 numbers", fit("--force-displacement", np.ones((3, 5)))),
    ):
        assert answer[0] == 2 and words in answer[2]
    assert not (tmp_path / "fitted.blend").exists()
