# SPDX-License-Identifier: GPL-3.0-or-later
"""What helps to paint Firmness: holding selected bones, blurring, mirroring, and its colors in the viewport."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.run.tools import heat
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from bl_ext.user_default.dynamic_morph_targets.ui.overlays import viewport
from builders import activate, make_mesh, refused, rig_of, select_bones
from layout import drawn

OPS = bpy.ops.dynamorph


def weights(obj, name) -> np.ndarray:
    return mesh_data.group_weights(obj, [name])[:, 0]


def paint(obj, name, values):
    group = obj.vertex_groups.get(name) or obj.vertex_groups.new(name=name)
    for vertex, value in enumerate(values):
        group.add([vertex], float(value), "REPLACE")


def points(obj) -> np.ndarray:
    return np.array([vertex.co for vertex in obj.data.vertices])


@pytest.fixture
def painted_arm(soft_arm):
    """The arm in Weight Paint on a new map."""
    OPS.paint_firmness()
    return soft_arm


# Hold Selected Bones -------------------------------------------------------------------------------------------------


def test_selected_bones_hold_their_skin(soft_arm):
    """With a border of a few edges, over which firmness falls."""
    select_bones(soft_arm, "lower")
    assert OPS.hold_bones() == {"FINISHED"}
    assert soft_arm.dynamorph.firmness_group == "Firmness"
    firm, lower, height = weights(soft_arm, "Firmness"), weights(soft_arm, "lower"), points(soft_arm)[:, 2]
    assert (firm[lower >= 0.5] == 1.0).all() and (firm[height < 0.3] == 0.5).all()
    rings = np.array([firm[height == z].mean() for z in np.unique(height)])
    assert (np.diff(rings) >= 0.0).all() and np.ptp(firm[height == height[0]]) == 0.0
    border = (rings > 0.505) & (rings < 0.995)
    assert 2 <= border.sum() <= 8 and np.abs(np.diff(rings)).max() < 0.28


def test_painting_ends_with_the_armature_active(soft_arm):
    """Without Lock Object Modes, the artist may click it meanwhile; it stays active."""
    bpy.ops.dynamorph.paint_firmness()
    assert soft_arm.mode == "WEIGHT_PAINT"
    activate(rig_of(soft_arm))
    bpy.ops.dynamorph.paint_firmness()
    assert soft_arm.mode == "OBJECT" and bpy.context.object == rig_of(soft_arm)


@pytest.mark.parametrize("of_bone", [False, True])
def test_a_new_map_takes_no_group_that_is_there(soft_arm, of_bone):
    """Neither what the artist keeps in a group called Firmness, nor the skin weights of such a bone."""
    if of_bone:
        rig_of(soft_arm).data.bones["lower"].name = "Firmness"
    else:
        paint(soft_arm, "Firmness", 0.25 + 0.0 * points(soft_arm)[:, 2])
        soft_arm.dynamorph.firmness_group = ""
    before = weights(soft_arm, "Firmness")
    select_bones(soft_arm, "Firmness" if of_bone else "lower")
    OPS.hold_bones()
    assert soft_arm.dynamorph.firmness_group == "Firmness 1" and np.array_equal(weights(soft_arm, "Firmness"), before)


def test_a_locked_map_stays_as_it_is(painted_arm):
    select_bones(painted_arm, "lower")
    painted_arm.vertex_groups["Firmness"].lock_weight = True
    before = weights(painted_arm, "Firmness")
    refused(OPS.hold_bones, "vertex group 'Firmness' is locked")
    refused(OPS.mirror_firmness, "vertex group 'Firmness' is locked")
    assert np.array_equal(weights(painted_arm, "Firmness"), before)


def test_what_is_firm_already_stays_so(soft_arm):
    paint(soft_arm, "Mine", 0.75 + 0.0 * points(soft_arm)[:, 2])
    soft_arm.dynamorph.firmness_group = "Mine"
    select_bones(soft_arm, "lower")
    OPS.hold_bones()
    firm, lower = weights(soft_arm, "Mine"), weights(soft_arm, "lower")
    assert "Firmness" not in soft_arm.vertex_groups and firm.min() == pytest.approx(0.75)
    assert (firm[lower >= 0.5] == 1.0).all()


def test_bones_are_held_while_painting(painted_arm):
    select_bones(painted_arm, "upper")
    bpy.ops.ed.undo_push(message="painting")
    OPS.hold_bones()
    assert painted_arm.mode == "WEIGHT_PAINT" and weights(painted_arm, "Firmness").max() == 1.0
    bpy.ops.ed.undo_push(message="held")
    bpy.ops.ed.undo()
    assert weights(bpy.data.objects["Arm"], "Firmness").max() == 0.5


def test_held_bones_make_the_model_old(soft_arm):
    soft_arm.dynamorph.model.cage_nodes, soft_arm.dynamorph.model.modes = 200, 8
    OPS.build()
    select_bones(soft_arm, "lower")
    OPS.hold_bones()
    assert staleness.model_age(soft_arm)


def test_bones_that_hold_nothing(soft_arm):
    refused(OPS.hold_bones, "Select in Pose Mode the bones of 'Arm Rig' that hold the skin of 'Arm'")
    select_bones(soft_arm, "lower")
    rig_of(soft_arm).data.bones["lower"].use_deform = False
    refused(OPS.hold_bones, r"The selected bones \(lower\) move no bone that deforms 'Arm'")
    assert "Firmness" not in soft_arm.vertex_groups


# Blur and Mirror -----------------------------------------------------------------------------------------------------


def test_blender_blurs_the_map(painted_arm):
    """As the button calls it; other groups stay."""
    height, lower = points(painted_arm)[:, 2], weights(painted_arm, "lower")
    paint(painted_arm, "Firmness", height > 1.0)
    assert "object.vertex_group_smooth" in drawn(painted_arm)
    bpy.ops.object.vertex_group_smooth(group_select_mode="ACTIVE", factor=0.5, repeat=2)
    soft = weights(painted_arm, "Firmness")
    near = np.abs(height - 1.0) < 0.2
    assert soft[near].min() > 0.01 and soft[near].max() < 0.99 and set(soft[np.abs(height - 1.0) > 0.5]) == {0.0, 1.0}
    np.testing.assert_array_equal(weights(painted_arm, "lower"), lower)


@pytest.mark.parametrize("to, kept", [("RIGHT", 1.0), ("LEFT", -1.0)])
def test_a_side_is_copied_to_the_other(painted_arm, to, kept):
    at, lower = points(painted_arm), weights(painted_arm, "lower")
    values = np.round(0.4 + at[:, 0] + 0.1 * at[:, 2], 3)
    paint(painted_arm, "Firmness", values)
    OPS.mirror_firmness(to=to)
    expected = np.round(0.4 + kept * np.abs(at[:, 0]) + 0.1 * at[:, 2], 3)
    np.testing.assert_allclose(weights(painted_arm, "Firmness"), expected, atol=1e-3)
    np.testing.assert_array_equal(weights(painted_arm, "lower"), lower)


def test_mirroring_is_undone(soft_arm):
    assert not OPS.mirror_firmness.poll()
    OPS.paint_firmness()
    paint(soft_arm, "Firmness", points(soft_arm)[:, 0] > 0.1)
    bpy.ops.ed.undo_push(message="painted")
    OPS.mirror_firmness(to="RIGHT")
    assert (weights(soft_arm, "Firmness") == (np.abs(points(soft_arm)[:, 0]) > 0.1)).all()
    bpy.ops.ed.undo_push(message="mirrored")
    bpy.ops.ed.undo()
    arm = bpy.data.objects["Arm"]
    assert (weights(arm, "Firmness") == (points(arm)[:, 0] > 0.1)).all()


def test_a_vertex_without_a_mirror_image_keeps_its_weight(painted_arm, capfd):
    painted_arm.data.shape_keys.reference_key.points[5].co.x -= 0.05
    values = (points(painted_arm)[:, 0] > 0.0).astype(float)
    paint(painted_arm, "Firmness", values)
    OPS.mirror_firmness(to="RIGHT")
    assert weights(painted_arm, "Firmness")[5] == values[5]
    assert "2 vertices have no mirror image" in capfd.readouterr().out


def test_a_mesh_without_two_sides(scene, painted_arm):
    for point in painted_arm.data.shape_keys.reference_key.points:
        point.co.x += 3.0
    refused(OPS.mirror_firmness, "'Arm' is not symmetric about its X axis")


def test_the_tools_of_a_map(soft_arm):
    assert "dynamorph.hold_bones" in drawn(soft_arm) and "dynamorph.mirror_firmness" not in drawn(soft_arm)
    OPS.paint_firmness()
    assert {"paint.weight_set", "object.vertex_group_smooth", "dynamorph.mirror_firmness"} <= set(drawn(soft_arm))


# Firmness in the viewport --------------------------------------------------------------------------------------------


def test_the_map_colors_the_skin(soft_arm):
    display, context = bpy.context.window_manager.dynamorph, bpy.context
    display.heat = True
    display.firmness = True
    assert not display.heat
    with pytest.raises(errors.SceneError, match="has no model: press Build Model, or Paint"):
        viewport.painted(context, soft_arm)
    OPS.paint_firmness()
    values, title, texts = viewport.painted(context, soft_arm)
    assert (title, texts) == ("Firmness", ["soft", "unchanged", "held"]) and (values[soft_arm.session_uid] == 0.5).all()
    paint(soft_arm, "Firmness", points(soft_arm)[:, 2] > 1.0)
    context.view_layer.update()
    shown = viewport.painted(context, soft_arm)[0][soft_arm.session_uid]
    np.testing.assert_array_equal(shown, points(soft_arm)[:, 2] > 1.0)
    display.heat = True
    assert not display.firmness
    display.heat = False


def test_what_is_held_by_itself_is_red_too(soft_arm):
    soft_arm.dynamorph.model.cage_nodes, soft_arm.dynamorph.model.modes = 300, 8
    soft_arm.dynamorph.model.hold, soft_arm.dynamorph.model.method = "THICKNESS", "SINGLE"
    OPS.build()
    (held,) = heat.firmness(soft_arm).values()
    assert held.shape == (len(soft_arm.data.vertices),) and 0.5 <= held.min() < held.max() <= 1.0
    OPS.paint_firmness()
    paint(soft_arm, "Firmness", np.ones(len(held)))
    bpy.context.view_layer.update()
    assert (heat.firmness(soft_arm)[soft_arm.session_uid] == 1.0).all()
    paint(soft_arm, "Firmness", 0.25 + 0.0 * held)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(heat.firmness(soft_arm)[soft_arm.session_uid], held - 0.25, atol=1e-6)


def test_legends_have_values(soft_arm, monkeypatch):
    display = bpy.context.window_manager.dynamorph
    monkeypatch.setattr(heat, "displacements", lambda _obj: {})
    soft_arm.dynamorph.simulation.max_displacement = 0.05
    display.heat = True
    assert viewport.painted(bpy.context, soft_arm)[1:] == ("Displacement, of Size", ["0", "2.50%", "5.00%"])
    display.heat = False
    assert viewport.painted(bpy.context, soft_arm) is None


def test_another_mesh_is_refused(scene, painted_arm):
    bpy.ops.object.mode_set(mode="OBJECT")
    activate(make_mesh(scene, "Plane", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)]))
    assert not OPS.hold_bones.poll() and not OPS.mirror_firmness.poll()


@pytest.mark.fault("G07")
def test_a_mesh_that_is_edited_on_another_object_is_refused(scene, soft_arm):
    """Blender itself crashes when it enters Weight Paint on it."""
    other = soft_arm.copy()
    scene.collection.objects.link(other)
    bpy.context.view_layer.objects.active = other
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.context.view_layer.objects.active = soft_arm
    soft_arm.dynamorph.active_target_index = 1
    for press in (
        OPS.paint_firmness,
        OPS.sculpt_target,
    ):
        with pytest.raises(RuntimeError, match="is in Edit Mode on another object: leave it there first"):
            press()
    assert soft_arm.mode == "OBJECT" and other.mode == "EDIT"
    bpy.context.view_layer.objects.active = other
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.context.view_layer.objects.active = soft_arm
    assert OPS.paint_firmness() == {"FINISHED"}
