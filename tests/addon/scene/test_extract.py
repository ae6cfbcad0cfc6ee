# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine gets what Blender shows: skinning, rig motion, shapes; and unusable input is refused."""

import bpy
import numpy as np
import pytest
import scenes
from bl_ext.user_default.dynamic_morph_targets.core import errors, geometry
from bl_ext.user_default.dynamic_morph_targets.core.motion import rig_samples
from bl_ext.user_default.dynamic_morph_targets.scene import animation
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion
from builders import (
    activate,
    add_key,
    evaluated_points,
    make_arm,
    make_mesh,
    make_rig,
    make_soft,
    rig_of,
    skinned,
    warnings_of,
)
from costs import cost
from mathutils import Matrix


def place(obj, location=(0.0, 0.0, 0.0), rotation=(0.0, 0.0, 0.0), scale=(1.0, 1.0, 1.0)):
    obj.location, obj.rotation_euler, obj.scale = location, rotation, scale


def moved_and_scaled(obj):
    place(obj, (0.3, -0.2, 0.1), (0.2, 0.1, 0.5), (1.2, 0.8, 2.0))
    place(rig_of(obj), (0.1, 0.2, -0.3), (0.1, 0.4, 0.2), (0.01, 0.01, 0.01))


def mirrored(obj):
    place(obj, scale=(-1.0, 1.0, 1.5))
    place(rig_of(obj), scale=(1.0, -2.0, 1.0))


def parented_and_animated(obj):
    rig = rig_of(obj)
    obj.parent = rig
    obj.matrix_parent_inverse = Matrix.Rotation(0.3, 4, "X") @ Matrix.Scale(1.3, 4, (1, 0, 0))  # with shear
    place(rig, rotation=(0.3, 0.2, 0.1), scale=(1.0, 2.0, 1.0))
    for frame in (1, 20):
        rig.location.x = frame * 0.1
        rig.keyframe_insert("location", frame=frame)
        obj.rotation_euler.y = frame * 0.02
        obj.keyframe_insert("rotation_euler", frame=frame)


def constrained(obj):
    leader = bpy.data.objects.new("Leader", None)
    bpy.context.scene.collection.objects.link(leader)
    for frame in (1, 20):
        leader.rotation_euler.z = frame * 0.05
        leader.keyframe_insert("rotation_euler", frame=frame)
    obj.constraints.new("COPY_ROTATION").target = leader
    follow = rig_of(obj).pose.bones["upper"].constraints.new("COPY_ROTATION")
    follow.target = leader


def unnormalized_and_unweighted(obj):
    obj.vertex_groups["upper"].add(list(range(40)), 0.2, "REPLACE")
    obj.vertex_groups["upper"].remove([3, 4, 5])
    obj.vertex_groups["lower"].remove([3, 4, 5])


def masked(obj):
    group = obj.vertex_groups.new(name="Mask")
    group.add(list(range(150)), 0.6, "REPLACE")
    obj.modifiers["Armature"].vertex_group = "Mask"
    obj.modifiers["Armature"].invert_vertex_group = True


def not_deforming(obj):
    rig_of(obj).data.bones["upper"].use_deform = False


@pytest.mark.fault("M19", "M20")
@pytest.mark.parametrize(
    "change",
    [
        lambda obj: None, moved_and_scaled, mirrored, parented_and_animated, constrained, unnormalized_and_unweighted,
        masked, not_deforming,
    ],
    ids=lambda change: change.__name__,
)  # fmt: skip
def test_own_skinning_equals_the_armature_modifier(scene, soft_arm, change):
    change(soft_arm)
    bpy.context.view_layer.update()
    samples = rig_motion.sample_rig(soft_arm, 1, 20, 1)
    ours = skinned(extract.character(soft_arm), samples)
    for frame in (1, 7, 20):
        scene.frame_set(frame)
        theirs = evaluated_points(soft_arm)
        assert np.abs(ours[frame - 1] - theirs).max() < 1e-5 * np.ptp(theirs, axis=0).max()


@pytest.mark.parametrize(
    "change", [lambda obj: None, parented_and_animated, constrained], ids=["plain", "parented", "constrained"]
)
def test_samples_equal_the_users_scene_and_leave_it_alone(scene, soft_arm, change):
    change(soft_arm)
    scene.render.fps, scene.render.frame_map_new = 30, 50
    rig = rig_of(soft_arm)
    scene.frame_set(13)
    rig.pose.bones["upper"].rotation_euler.y = 0.7  # a pose that is not keyed yet
    before = (len(bpy.data.scenes), len(bpy.data.objects), len(bpy.data.collections))
    samples = rig_motion.sample_rig(soft_arm, 3, 6, 4)
    assert (len(bpy.data.scenes), len(bpy.data.objects), len(bpy.data.collections)) == before
    assert scene.frame_current == 13 and bpy.context.scene == scene and bpy.context.object == soft_arm
    assert rig.pose.bones["upper"].rotation_euler.y == pytest.approx(0.7)
    assert len(samples) == 13
    for i in range(len(samples)):
        scene.frame_set(3 + i // 4, subframe=(i % 4) / 4)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        evaluated = rig.evaluated_get(depsgraph)
        np.testing.assert_allclose(samples.rig_world[i], evaluated.matrix_world, atol=1e-6)
        np.testing.assert_allclose(samples.object_world[i], soft_arm.evaluated_get(depsgraph).matrix_world, atol=1e-6)
        for b, bone in enumerate(("upper", "lower")):
            np.testing.assert_allclose(samples.pose[i, b], evaluated.pose.bones[bone].matrix, atol=1e-6)


def test_sampling_in_slices_is_the_same_and_leaves_nothing_after_them(soft_arm):
    before = (len(bpy.data.scenes), len(bpy.data.objects))
    sampling, slices = rig_motion.RigSampling(soft_arm, 1, 20, 4), 1
    while not sampling.advance(soft_arm, 0.0):
        slices += 1
        assert sampling.done == slices - 1 and sampling.frame == 1 + (slices - 1) // 4
    assert slices == 77 and (len(bpy.data.scenes), len(bpy.data.objects)) == before
    at_once = rig_motion.sample_rig(soft_arm, 1, 20, 4)
    np.testing.assert_array_equal(sampling.samples().pose, at_once.pose)
    np.testing.assert_array_equal(sampling.samples().object_world, at_once.object_world)


def test_sampling_notices_what_changed_between_slices(soft_arm):
    sampling = rig_motion.RigSampling(soft_arm, 1, 20, 4)
    sampling.advance(soft_arm, 0.0)
    rig_of(soft_arm).data.bones["lower"].name = "forearm"
    with pytest.raises(errors.SceneError, match="'Arm' or something that moves it changed while it was being read"):
        sampling.advance(soft_arm, 0.0)


def test_sampling_never_evaluates_the_mesh(scene, soft_arm, monkeypatch):
    """A driver inside the mesh's modifiers would run if Blender evaluated them."""
    calls = []
    bpy.app.driver_namespace["dynamorph_test"] = lambda: calls.append(1) or 1.0
    curve = soft_arm.modifiers.new("Cast", "CAST").driver_add("factor")
    curve.driver.expression = "dynamorph_test() + 0 * frame"
    scene.frame_set(2)
    assert calls
    calls.clear()
    rig_motion.sample_rig(soft_arm, 1, 5, 1)
    evaluated_by_sampling = len(calls)
    assert evaluated_by_sampling == 0


def test_character_arrays(soft_arm):
    character = extract.character(soft_arm)
    vertices, _ = scenes.tube()
    np.testing.assert_allclose(character.vertices, vertices, atol=1e-6)
    assert character.triangles.shape[1] == 3 and character.triangles.max() < len(vertices)
    np.testing.assert_allclose(character.weights.sum(axis=1), 1.0)
    np.testing.assert_allclose(character.to_bind, np.eye(3))
    np.testing.assert_array_equal(character.firmness, 0.5)
    neutral, flexed = character.targets
    assert (neutral.name, flexed.name) == ("Neutral", "flexed")
    np.testing.assert_array_equal(neutral.shape, 0.0)
    np.testing.assert_allclose(flexed.shape, scenes.bulge(vertices), atol=1e-6)
    assert flexed.bones == ("lower",)
    angle = geometry.turned(neutral.local, flexed.local)
    np.testing.assert_allclose(angle, [0.0, np.pi / 2], atol=1e-5)


def test_shape_is_relative_to_its_key_times_its_group(soft_arm):
    vertices, _ = scenes.tube()
    blocks = soft_arm.data.shape_keys.key_blocks
    blocks["flexed"].relative_key = blocks["smile"]
    blocks["flexed"].value = 0.3  # has no effect: the shape is that at 1
    group = soft_arm.vertex_groups.new(name="Half")
    group.add(list(range(100)), 0.5, "REPLACE")
    blocks["flexed"].vertex_group = "Half"
    expected = scenes.bulge(vertices) - scenes.bulge(vertices, center=1.6, amount=-0.05)
    expected[:100] *= 0.5
    expected[100:] = 0.0
    np.testing.assert_allclose(extract.character(soft_arm).targets[1].shape, expected, atol=1e-6)


def test_shape_ignores_a_group_that_is_gone(soft_arm):
    soft_arm.data.shape_keys.key_blocks["flexed"].vertex_group = "Half"
    shape = extract.character(soft_arm).targets[1].shape
    np.testing.assert_allclose(shape, scenes.bulge(scenes.tube()[0]), atol=1e-6)


def test_animated_scale_does_not_make_a_character_depend_on_the_frame(scene, soft_arm):
    for frame, size in ((1, 1.0), (20, 2.0)):
        soft_arm.scale = (size, size, size)
        soft_arm.keyframe_insert("scale", frame=frame)
    found = []
    for frame in (1, 20):
        scene.frame_set(frame)
        found.append(extract.character(soft_arm).to_bind)
    np.testing.assert_array_equal(found, [np.eye(3), np.eye(3)])


def test_transforms_that_are_not_numbers_are_named(scene, soft_arm):
    bone = rig_of(soft_arm).pose.bones["lower"]
    bone.location.x = np.nan
    with pytest.raises(errors.SceneError, match="'lower'.*not a number at frame"):
        rig_motion.sample_rig(soft_arm, 1, 20, 2)
    scene.frame_set(12)
    with pytest.raises(errors.SceneError, match="'lower'.*not a number at frame 12"):
        rig_motion.current_pose(soft_arm)


@pytest.mark.fault("A11")
@pytest.mark.parametrize("value", [np.inf, 1e38, 1e20])
@pytest.mark.parametrize("path", ["scale", "location"])
def test_an_animation_that_overflows_is_refused_with_the_bone_and_the_frame(scene, soft_arm, path, value):
    """Blender limits an infinite one to the largest number that it has."""
    bone = rig_of(soft_arm).pose.bones["lower"]
    for frame in (1, 4, 5):
        bone.keyframe_insert(path, index=1, frame=frame)
    played = rig_of(soft_arm).animation_data
    curves = animation.curves(played.action, played.action_slot)
    curve = next(each for each in curves if each.data_path.endswith(path) and each.array_index == 1)
    for point in curve.keyframe_points:
        point.interpolation = "CONSTANT"
    curve.keyframe_points[1].co.y = value
    text = r"'lower' is moved or scaled by more than 1e\+15 at frame 4"
    with pytest.raises(errors.SceneError, match=text):
        rig_motion.sample_rig(soft_arm, 1, 20, 2)
    scene.frame_set(4)
    with pytest.raises(errors.SceneError, match=text):
        rig_motion.current_pose(soft_arm)


def test_an_armature_that_vanishes_is_refused_with_the_frame(soft_arm):
    rig = rig_of(soft_arm)
    rig.scale = (1.0, 1.0, 1.0)
    rig.keyframe_insert("scale", frame=1)
    rig.scale = (0.0, 0.0, 0.0)
    rig.keyframe_insert("scale", frame=9)
    with pytest.raises(errors.SceneError, match="is scaled to zero at frame 9"):
        rig_motion.sample_rig(soft_arm, 1, 12, 2)


@pytest.mark.fault("A13")
def test_an_armature_that_grows_from_nothing_has_the_size_it_grows_to(scene, soft_arm):
    """Its own frames can be baked; those where it is nothing are refused with the frame."""
    grown = extract.character(soft_arm).to_bind
    soft_arm.parent = rig = rig_of(soft_arm)
    for frame, size in ((1, 0.0), (6, 1.0)):
        rig.scale = (size,) * 3
        rig.keyframe_insert("scale", frame=frame)
    scene.frame_set(1)
    assert extract.character(soft_arm).to_bind == pytest.approx(grown, rel=0.02, abs=1e-9)
    rig_motion.sample_rig(soft_arm, 3, 12, 2)
    with pytest.raises(errors.SceneError, match="is scaled to zero at frame 1"):
        rig_motion.sample_rig(soft_arm, 1, 12, 2)


def test_to_bind_does_not_depend_on_rotation(soft_arm):
    soft_arm.scale = (2.0, 0.5, 0.01)
    found = []
    for angle in (0.0, 0.3, 1.7):
        soft_arm.rotation_euler = (angle, 2 * angle, -angle)
        bpy.context.view_layer.update()
        found.append(extract.character(soft_arm).to_bind)
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])
    np.testing.assert_allclose(found[0], np.diag([2.0, 0.5, 0.01]))


def test_captured_pose_counts_constraints(scene, soft_arm):
    """matrix_basis would be the identity here."""
    follow = rig_of(soft_arm).pose.bones["upper"].constraints.new("LIMIT_ROTATION")
    follow.use_limit_x, follow.min_x, follow.max_x, follow.owner_space = True, 0.5, 1.0, "LOCAL"
    scene.frame_set(1)
    _, local, _ = rig_motion.current_pose(soft_arm)
    angles = geometry.turned(local, np.tile(np.eye(4), (2, 1, 1)))
    np.testing.assert_allclose(angles, [0.5, 0.0], atol=1e-5)


@pytest.mark.fault("R03")
def test_collapsed_bones_keep_their_size(scene, soft_arm):
    bone = rig_of(soft_arm).pose.bones["lower"]
    for frame, size in ((9, 1.0), (10, 0.0), (12, 0.0), (13, 1.0)):
        bone.scale = (size, size, size)
        bone.keyframe_insert("scale", frame=frame)
    samples = rig_motion.sample_rig(soft_arm, 1, 20, 1)
    kept, warnings = rig_samples.keep_collapsed(samples, extract.character(soft_arm).skeleton)
    assert len(warnings) == 1 and "'lower'" in warnings[0] and "3 of 20" in warnings[0]
    np.testing.assert_allclose(kept.pose[9:12, 1], np.tile(kept.pose[8, 1], (3, 1, 1)), atol=1e-12)
    np.testing.assert_array_equal(kept.pose[12:], samples.pose[12:])
    assert np.isfinite(extract.character(soft_arm).skeleton.local_transforms(kept.pose)).all()


@pytest.mark.parametrize("first", [1, 9, 10])
def test_collapsed_bones_follow_their_parents(scene, soft_arm, first):
    """As they last did, as far as that is known: first, and at rest otherwise."""
    rig = rig_of(soft_arm)
    upper, lower = rig.pose.bones["upper"], rig.pose.bones["lower"]
    rig.animation_data_clear()
    lower.rotation_euler.x = 0.4
    for frame, size in ((9, 1.0), (10, 0.0)):
        lower.scale = (size, size, size)
        lower.keyframe_insert("scale", frame=frame)
    for frame, angle in ((9, 0.0), (20, 1.0)):
        upper.rotation_euler.y = angle
        upper.keyframe_insert("rotation_euler", frame=frame)
    skeleton = extract.character(soft_arm).skeleton
    before = rig_motion.sample_rig(soft_arm, 9, 9, 1).pose[0]
    samples = rig_motion.sample_rig(soft_arm, first, 20, 1)
    for known in (None, before):
        kept, _ = rig_samples.keep_collapsed(samples, skeleton, known)
        bent = 0.4 if first < 10 or known is not None else 0.0
        angles = geometry.turned(skeleton.local_transforms(kept.pose)[:, 1], np.tile(np.eye(4), (len(kept), 1, 1)))
        np.testing.assert_allclose(angles, bent, atol=1e-5)
        np.testing.assert_array_equal(kept.pose[:, 0], samples.pose[:, 0])


# What is refused: each message must name these words --------------------------------------------------------------


def no_armature(obj):
    obj.modifiers.clear()


def empty_armature_modifier(obj):
    obj.modifiers["Armature"].object = None


def two_armatures(obj):
    obj.modifiers.new("Second", "ARMATURE").object = rig_of(obj)


def preserve_volume(obj):
    obj.modifiers["Armature"].use_deform_preserve_volume = True


def envelopes(obj):
    obj.modifiers["Armature"].use_bone_envelopes = True


def bendy(obj):
    rig_of(obj).data.bones["lower"].bbone_segments = 4


def no_length(obj):
    rig = rig_of(obj)
    activate(rig)
    bpy.ops.object.mode_set(mode="EDIT")
    rig.data.edit_bones["lower"].tail = rig.data.edit_bones["lower"].head + Matrix.Identity(3)[2] * 5e-6
    bpy.ops.object.mode_set(mode="OBJECT")


def rest_position(obj):
    rig_of(obj).data.pose_position = "REST"


def no_groups(obj):
    obj.vertex_groups.clear()


def absolute_keys(obj):
    obj.data.shape_keys.use_relative = False


def no_keys(obj):
    obj.shape_key_clear()


def only_neutral(obj):
    obj.dynamorph.targets.remove(1)
    obj.dynamorph.model.method = "STATIC"


def only_muted(obj):
    obj.dynamorph.targets[1].mute = True
    obj.dynamorph.model.method = "STATIC"


def key_removed(obj):
    obj.shape_key_remove(obj.data.shape_keys.key_blocks["flexed"])


def not_a_number(obj):
    for index in (3, 5, 8, 13, 21, 34):
        obj.data.shape_keys.key_blocks["flexed"].points[index].co.x = np.nan


def same_pose(obj):
    bpy.context.scene.frame_set(20)
    bpy.ops.dynamorph.add_target(key="smile")


def neutral_pose(obj):
    bpy.context.scene.frame_set(1)
    bpy.ops.dynamorph.add_target(key="smile")


def bone_removed(obj):
    rig = rig_of(obj)
    activate(rig)
    bpy.ops.object.mode_set(mode="EDIT")
    rig.data.edit_bones.remove(rig.data.edit_bones["lower"])
    bpy.ops.object.mode_set(mode="OBJECT")


def basis_removed(obj):
    obj.shape_key_remove(obj.data.shape_keys.reference_key)


def same_pose_of_the_bones_that_count(obj):
    """Another bone tells the poses apart, but it places no target."""
    same_pose(obj)
    pose = obj.dynamorph.targets[2].pose["upper"]
    pose.local = np.array(Matrix.Rotation(0.5, 4, "X")).ravel()


def hidden_modifier(obj):
    obj.modifiers["Armature"].show_viewport = False


def no_soft_skin(obj):
    obj.dynamorph.targets.clear()


def rig_nowhere(obj):
    rig_of(obj).location.x = np.nan
    bpy.context.view_layer.update()


def subdivided_first(obj):
    obj.modifiers.new("Subdivision", "SUBSURF")
    obj.modifiers.move(1, 0)


def edit_mode(obj):
    activate(obj)
    bpy.ops.object.mode_set(mode="EDIT")


def firmness_removed(obj):
    obj.dynamorph.firmness_group = "Firm"


def no_faces(obj):
    obj.data.clear_geometry()


def zero_scale(obj):
    obj.scale = (1, 1, 0)
    bpy.context.view_layer.update()


@pytest.mark.fault("P07", "R02")
@pytest.mark.parametrize(
    "spoil, words",
    [
        (no_armature, "'Arm' has no Armature modifier"),
        (empty_armature_modifier, "'Arm' has no Armature modifier"),
        (envelopes, "'Arm'.*turn Bone Envelopes off"),
        (no_length, "'lower'.*no length"),
        (rest_position, "'Arm Rig'.*rest position"),
        (no_groups, "'Arm' has no vertex group"),
        (absolute_keys, "'Arm' uses absolute shape keys: turn on Relative"),
        (no_keys, "'Arm' has no shape keys"),
        (only_neutral, "'Arm' has no targets, so nothing moves with the Method Static"),
        (only_muted, "'Arm': all targets are muted, so nothing moves with the Method Static"),
        (key_removed, "'Arm'.*'flexed' is gone"),
        (not_a_number, "'Arm'.*'flexed'.*vertices 3, 5, 8, 13, 21:"),
        (same_pose, "'flexed' and 'smile' have the same pose"),
        (neutral_pose, "'smile' has no bones.*Capture Pose"),
        (bone_removed, "bone 'lower' of target 'flexed' is gone|'lower'"),
        (subdivided_first, "'Subdivision' comes before the Armature: apply it"),
        (edit_mode, "'Arm' is in Edit Mode"),
        (firmness_removed, "'Arm'.*'Firm'.*gone"),
        (no_faces, "'Arm' has no faces"),
        (zero_scale, "'Arm' is scaled to zero"),
        (basis_removed, "'Arm': target 'flexed' has become the Basis"),
        (same_pose_of_the_bones_that_count, "'flexed' and 'smile' have the same pose"),
        (hidden_modifier, "'Arm'.*'Armature' is disabled in viewports"),
        (no_soft_skin, "'Arm' is no soft skin.*Add Soft Skin"),
        (rig_nowhere, "'Arm Rig' has a transform that is not a number"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_refused(soft_arm, spoil, words):
    spoil(soft_arm)
    with pytest.raises(errors.SceneError, match=words):
        extract.character(soft_arm)


def test_refused_without_mesh(scene):
    rig = make_rig(scene)
    with pytest.raises(errors.SceneError, match="'Rig' is not a mesh"):
        extract.character(rig)


def test_ignored_modifiers_are_named(soft_arm):
    soft_arm.modifiers.new("Squeeze", "CAST")
    soft_arm.modifiers.move(1, 0)
    soft_arm.modifiers.new("Subdivision", "SUBSURF")
    soft_arm.show_only_shape_key = True
    warnings = warnings_of(soft_arm)
    assert len(warnings) == 2 and "'Squeeze'" in warnings[0] and "unpin" in warnings[1]


@pytest.mark.fault("M04")
@pytest.mark.parametrize("scale, size", [(1e-7, "e-07 m"), (100.0, " m long")])
def test_implausible_sizes_are_named(soft_arm, scale, size):
    soft_arm.scale = (scale, scale, scale)
    bpy.context.view_layer.update()
    (warning,) = warnings_of(soft_arm)
    assert "'Arm' is" in warning and size in warning and "check the scale" in warning


def test_two_characters_do_not_interfere(scene, soft_arm):
    before = extract.character(soft_arm)
    other = make_soft(make_arm(scene, "Leg"), keys=("smile",))
    other.dynamorph.targets[0].stiffness = 5.0
    assert [target.name for target in extract.character(other).targets] == ["Neutral", "smile"]
    after = extract.character(soft_arm)
    assert [t.name for t in after.targets] == [t.name for t in before.targets]
    assert after.targets[0].material == before.targets[0].material


def test_large_mesh_is_read_fast(scene):
    """Ten times as many vertices take about ten times as long, and no vertex takes long."""
    small, large = long_tube(scene, 40), long_tube(scene, 400)
    character = extract.character
    assert character(large).weights.shape == (40_000, 3)
    taken = cost(lambda: character(large), times=3)
    assert taken < 30 * cost(lambda: character(small), times=3)
    assert taken < 10 * cost(lambda: [[(g.group, g.weight) for g in v.groups] for v in large.data.vertices], times=3)


def long_tube(scene, rings):
    """A soft skin with a target and 100 vertices per ring."""
    rig = make_rig(scene)
    vertices, faces = scenes.tube(rings=rings, around=100)
    obj = make_mesh(scene, "Long", vertices, faces)
    obj.shape_key_add(name="Basis")
    add_key(obj, "flexed", scenes.bulge(vertices))
    for bone in ("upper", "lower"):
        obj.vertex_groups.new(name=bone).add(list(range(len(vertices))), 0.5, "REPLACE")
    obj.modifiers.new("Armature", "ARMATURE").object = rig
    activate(obj)
    bpy.ops.dynamorph.add_soft_skin()
    rig.pose.bones["lower"].rotation_euler.x = 1.0
    bpy.context.view_layer.update()
    bpy.ops.dynamorph.add_target(key="flexed")
    return obj
