# SPDX-License-Identifier: GPL-3.0-or-later
"""Artists select control bones, as those of Rigify; what is meant are the deforming bones that follow them."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.write.authoring import controls
from builders import activate, rig_of, select_bones

OPS = bpy.ops.dynamorph


@pytest.fixture
def controlled(soft_arm):
    """The arm, whose lower bone copies a control and whose upper one hangs on a control; a goal of IK, and a bone that
    moves nothing.
    """
    rig = rig_of(soft_arm)
    rig.animation_data_clear()
    activate(rig)
    bpy.ops.object.mode_set(mode="EDIT")
    bones = rig.data.edit_bones
    for name, height in (("shoulder", -1.0), ("bend", 1.0), ("goal", 2.0), ("properties", 3.0)):
        made = bones.new(name)
        made.head, made.tail = (0.0, 0.0, height), (0.0, 0.0, height + 1.0)
    bones["upper"].parent = bones["shoulder"]
    bones["bend"].parent = bones["upper"]
    bpy.ops.object.mode_set(mode="POSE")
    for name in ("shoulder", "bend", "goal", "properties"):
        rig.data.bones[name].use_deform = False
        rig.pose.bones[name].rotation_mode = "XYZ"
    copy = rig.pose.bones["lower"].constraints.new("COPY_ROTATION")
    copy.target, copy.subtarget = rig, "bend"
    return soft_arm


@pytest.mark.fault("R09")
@pytest.mark.parametrize(
    ("chosen", "bent", "moved"),
    [
        (["bend"], ["lower"], ["lower"]),
        (["lower"], ["lower"], ["lower"]),
        (["upper", "bend"], ["upper", "lower"], ["upper", "lower"]),
        (["shoulder"], ["shoulder"], ["upper", "lower"]),  # no joint of deforming bones bends
        ([], [], []),
    ],
)
def test_what_follows_the_selected_bones(controlled, chosen, bent, moved):
    select_bones(controlled, *chosen)
    assert sorted(controls.bent_by_selected(controlled)) == sorted(bent)
    assert sorted(controls.moved_by_selected(controlled)) == sorted(moved)


def test_goals_of_inverse_kinematics_bend_what_reaches_for_them(controlled):
    rig = rig_of(controlled)
    lower = rig.pose.bones["lower"]
    lower.constraints.remove(lower.constraints[0])
    reach = lower.constraints.new("IK")
    reach.target, reach.subtarget, reach.chain_count = rig, "goal", 2
    rig.pose.bones["upper"].rotation_euler.x, rig.pose.bones["lower"].rotation_euler.x = 0.5, -1.0
    rig.pose.bones["goal"].location = (0.0, -0.5, 0.3)
    select_bones(controlled, "goal")
    assert controls.bent_by_selected(controlled) == ["upper", "lower"]


def test_the_pose_that_is_not_keyed_yet_stays(controlled):
    rig = rig_of(controlled)
    rig.pose.bones["bend"].rotation_euler = (0.3, 0.1, 0.2)
    rig.pose.bones["bend"].location = (0.0, 0.1, 0.0)
    bpy.context.view_layer.update()
    before = [np.array(bone.matrix) for bone in rig.pose.bones], len(bpy.data.scenes), len(bpy.data.objects)
    select_bones(controlled, "bend")
    assert controls.bent_by_selected(controlled) == ["lower"]
    after = [np.array(bone.matrix) for bone in rig.pose.bones], len(bpy.data.scenes), len(bpy.data.objects)
    np.testing.assert_array_equal(after[0], before[0])
    assert after[1:] == before[1:] and tuple(rig.pose.bones["bend"].rotation_euler) == pytest.approx((0.3, 0.1, 0.2))


def test_bones_that_move_no_skin_hold_none(controlled):
    select_bones(controlled, "properties")
    with pytest.raises(errors.SceneError, match=r"The selected bones \(properties\) move no bone that deforms 'Arm'"):
        controls.moved_by_selected(controlled)


def test_buttons_take_controls(controlled):
    select_bones(controlled, "bend")
    controlled.dynamorph.active_target_index = 1
    OPS.use_selected_bones(extend=False)
    assert controlled.dynamorph.targets[1].bone_names() == ("lower",)
    assert OPS.hold_bones() == {"FINISHED"}
    held = controlled.vertex_groups["Firmness"].index
    assert any(group.group == held and group.weight == 1.0 for v in controlled.data.vertices for group in v.groups)
