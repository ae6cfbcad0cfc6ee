# SPDX-License-Identifier: GPL-3.0-or-later
"""Modifiers above the Armature are applied to a mesh with shape keys, and nothing that shows or moves changes."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.scene.check import checks
from builders import add_key, evaluated_points, keys_of, refused, rig_of, skinning_of

OPS = bpy.ops.dynamorph
SIZE = 1e-4  # meters; keys are stored in single precision


def first(obj, kind, **values):
    """A new first modifier."""
    modifier = obj.modifiers.new(kind.title(), kind)
    for name, value in values.items():
        setattr(modifier, name, value)
    obj.modifiers.move(len(obj.modifiers) - 1, 0)
    return modifier


def problems_of(obj):
    return [problem.text for problem in checks.problems(skinning_of(obj))]


def shown(obj):
    scene = bpy.context.scene
    found = []
    for frame in (1, 9, 20):
        scene.frame_set(frame)
        found.append(evaluated_points(obj))
    return np.array(found)


@pytest.fixture
def lively(arm):
    """The arm, whose key 'flexed' an Action moves and 'smile' a driver; a third is relative to the second and has a
    value; and a vertex group without weights is locked.
    """
    keys = keys_of(arm)
    block = keys.key_blocks["flexed"]
    for frame, value in ((1, 0.0), (20, 1.0)):
        block.value = value
        block.keyframe_insert("value", frame=frame)
    keys.key_blocks["smile"].driver_add("value").driver.expression = "0.02 * frame"
    add_key(arm, "corrective", np.tile([0.0, 0.01, 0.02], (len(arm.data.vertices), 1)))
    keys.key_blocks["corrective"].relative_key, keys.key_blocks["corrective"].value = block, 0.5
    arm.vertex_groups.new(name="locked").lock_weight = True
    return arm


def state(obj):
    keys = keys_of(obj)
    blocks = [(each.name, each.value, each.relative_key.name, each.mute, each.slider_max) for each in keys.key_blocks]
    animation = keys.animation_data
    drivers = [(curve.data_path, curve.driver.expression) for curve in animation.drivers]
    groups = [(group.name, group.lock_weight) for group in obj.vertex_groups]
    return keys.session_uid, blocks, animation.action.name, drivers, groups, obj.vertex_groups.active_index


@pytest.mark.parametrize(
    "kind, values",
    [
        ("MIRROR", {"use_axis": (False, True, False), "use_mirror_merge": False}),
        ("SUBSURF", {"levels": 1}),
        ("WELD", {"merge_threshold": 1e-5}),
        ("ARRAY", {"count": 2, "use_relative_offset": False, "use_constant_offset": True}),
        ("SOLIDIFY", {"thickness": 0.001}),  # along normals, which are not linear in the keys
        ("BEVEL", {"width": 0.01}),
        ("DECIMATE", {"decimate_type": "UNSUBDIV", "iterations": 0}),
        ("MULTIRES", {}),
    ],
)
def test_what_shows_stays_and_keys_keep_all_that_they_have(lively, kind, values):
    first(lively, kind, **values)
    before, had = shown(lively), state(lively)
    assert OPS.add_soft_skin() == {"FINISHED"}
    assert [f"'Arm': modifier '{kind.title()}' comes before the Armature: apply it"] == problems_of(lively)[:1]
    assert OPS.fix(problem="APPLY") == {"FINISHED"}
    assert [modifier.type for modifier in lively.modifiers] == ["ARMATURE"]
    after = shown(lively)
    assert after.shape == before.shape == (3, len(lively.data.vertices), 3)
    np.testing.assert_allclose(after, before, atol=SIZE)
    assert state(lively) == had


def weights_by(obj, kind):
    """All weights of the arm as a modifier makes them, none in the mesh. Returns the modifier."""
    everything = list(range(len(obj.data.vertices)))
    if kind == "DATA_TRANSFER":
        proxy = bpy.data.objects.new("Proxy", obj.data.copy())
        bpy.context.scene.collection.objects.link(proxy)
        for name in ("upper", "lower"):
            obj.vertex_groups[name].remove(everything)
        return first(
            obj, kind, object=proxy, use_vert_data=True, data_types_verts={"VGROUP_WEIGHTS"},
            layers_vgroup_select_src="ALL", layers_vgroup_select_dst="NAME", vert_mapping="NEAREST",
        )  # fmt: skip
    obj.vertex_groups["lower"].remove(everything)
    if kind == "VERTEX_WEIGHT_EDIT":
        return first(obj, kind, vertex_group="lower", use_add=True, default_weight=0.5, add_threshold=0.0)
    if kind == "VERTEX_WEIGHT_MIX":
        return first(obj, kind, vertex_group_a="lower", default_weight_a=0.5, mix_set="ALL", mix_mode="ADD")
    return first(obj, kind, vertex_group="upper", target=rig_of(obj), proximity_mode="OBJECT", max_dist=2.0)


@pytest.mark.parametrize(
    "kind", ["DATA_TRANSFER", "VERTEX_WEIGHT_EDIT", "VERTEX_WEIGHT_MIX", "VERTEX_WEIGHT_PROXIMITY"]
)
def test_weights_that_a_modifier_makes_are_put_into_the_mesh(arm, kind):
    before = shown(arm)
    name = weights_by(arm, kind).name
    before = shown(arm)
    assert OPS.add_soft_skin() == {"FINISHED"}
    assert f"'Arm': modifier '{name}' makes bone weights that the mesh does not have: apply it" in problems_of(arm)
    OPS.fix(problem="APPLY")
    np.testing.assert_allclose(shown(arm), before, atol=SIZE)
    assert not any("makes bone weights" in text for text in problems_of(arm))


def test_weights_that_move_no_skin_are_left_alone(soft_arm):
    soft_arm.vertex_groups.new(name="mask")
    first(soft_arm, "VERTEX_WEIGHT_EDIT", vertex_group="mask")
    assert not any("weights" in text for text in problems_of(soft_arm))


def test_what_only_renders_show_is_applied_too(soft_arm):
    first(soft_arm, "ARRAY", count=3).show_viewport = False
    had = len(soft_arm.data.vertices)
    OPS.fix(problem="APPLY")
    assert [modifier.type for modifier in soft_arm.modifiers] == ["ARMATURE"]
    assert len(soft_arm.data.vertices) == 3 * had


def test_deforming_modifiers_above_go_along_and_others_stay(soft_arm):
    first(soft_arm, "MIRROR", use_axis=(False, True, False), use_mirror_merge=False)
    first(soft_arm, "CAST", factor=0.2)
    hidden = first(soft_arm, "SUBSURF")
    hidden.show_viewport = hidden.show_render = False
    before = shown(soft_arm)
    OPS.fix(problem="APPLY")
    assert [modifier.type for modifier in soft_arm.modifiers] == ["SUBSURF", "ARMATURE"]
    np.testing.assert_allclose(shown(soft_arm), before, atol=SIZE)


def test_muted_keys_and_those_with_a_group_keep_their_shapes(soft_arm):
    """As all targets are while a bake plays."""
    count = len(soft_arm.data.vertices)
    group = soft_arm.vertex_groups.new(name="half")
    for index in range(count):
        group.add([index], index / count, "REPLACE")
    keys = keys_of(soft_arm).key_blocks
    for name in ("muted", "masked"):
        add_key(soft_arm, name, np.tile([0.1, 0.0, 0.2], (count, 1)))
        keys[name].value = 1.0
    keys["masked"].vertex_group = "half"
    first(soft_arm, "MIRROR", use_axis=(False, True, False), use_mirror_merge=False)
    before = shown(soft_arm)
    keys["muted"].mute = soft_arm.hide_viewport = True
    OPS.fix(problem="APPLY")
    assert keys["muted"].mute and keys["masked"].vertex_group == "half"
    keys["muted"].mute = soft_arm.hide_viewport = False
    np.testing.assert_allclose(shown(soft_arm), before, atol=SIZE)


def test_the_colors_that_show_and_render_stay(soft_arm):
    colors = soft_arm.data.attributes
    for name in ("One", "Two"):
        colors.new(name, "FLOAT_COLOR", "POINT")
    colors.active_color_name, colors.default_color_name = "One", "Two"
    first(soft_arm, "SUBSURF")
    OPS.fix(problem="APPLY")
    colors = soft_arm.data.attributes
    assert (colors.active_color_name, colors.default_color_name) == ("One", "Two")


def decimated(obj):
    first(obj, "DECIMATE", ratio=0.5)
    add_key(obj, "bent", np.random.default_rng(1).normal(0.0, 0.1, (len(obj.data.vertices), 3)))
    return "'Arm': modifier 'Decimate' gives shape key 'flexed' other vertices or faces than the Basis.*below the Arm"


def keyed(obj):
    modifier = first(obj, "ARRAY")
    modifier.keyframe_insert("count", frame=1)
    return "'Arm': modifier 'Array' is animated.*delete its keyframes"


def driven(obj):
    first(obj, "CAST").driver_add("factor")
    first(obj, "MIRROR")
    obj.modifiers.move(0, 1)
    return "'Arm': modifier 'Cast' is animated.*delete its keyframes"


def welded_in_one_key(obj):
    first(obj, "WELD", merge_threshold=1e-4)
    points = np.array([vertex.co for vertex in obj.data.vertices])
    add_key(obj, "closed", np.where(np.arange(len(points))[:, None] == 1, points[0] - points[1], 0.0))
    return "'Arm': modifier 'Weld' merges other vertices of shape key 'closed' .* turn its merging off"


def shared(obj):
    first(obj, "MIRROR")
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("Other", obj.data))
    return "Mesh 'Arm' is shared by other objects.*single-user"


def after_another_armature(obj):
    obj.modifiers.new("Mirror", "MIRROR")
    obj.modifiers.new("Second", "ARMATURE").object = rig_of(obj)
    return "'Arm': modifier 'Mirror' comes after Armature modifier 'Armature'.*move it above"


@pytest.mark.parametrize("spoil", [decimated, keyed, driven, welded_in_one_key, shared, after_another_armature])
def test_what_cannot_be_applied_says_why_and_stays(soft_arm, spoil):
    words = spoil(soft_arm)
    names, count = soft_arm.modifiers.keys(), len(soft_arm.data.vertices)
    objects, meshes = len(bpy.data.objects), len(bpy.data.meshes)
    refused(OPS.fix, words, problem="APPLY")
    assert soft_arm.modifiers.keys() == names and len(soft_arm.data.vertices) == count
    assert (len(bpy.data.objects), len(bpy.data.meshes)) == (objects, meshes)
