# SPDX-License-Identifier: GPL-3.0-or-later
"""Which objects stop a soft skin, and that they are read as Blender evaluates them."""

from pathlib import Path

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core.errors import SceneError
from bl_ext.user_default.dynamic_morph_targets.core.motion.colliders import ColliderTrack
from bl_ext.user_default.dynamic_morph_targets.scene import animation
from bl_ext.user_default.dynamic_morph_targets.scene.motion import colliders, rig_motion
from builders import BOX, add_key, make_box, rig_of


@pytest.fixture
def arm_with_collision(soft_arm):
    soft_arm.dynamorph.collision.use = True
    return soft_arm


def tracks(obj, start=1, end=3, substeps=2) -> dict[str, ColliderTrack]:
    samples = rig_motion.sample_rig(obj, start, end, substeps)
    return {track.name: track for track in samples.tracks if isinstance(track, ColliderTrack)}


def interpolate(obj, kind):
    """All its animation, from key to key."""
    data = obj.animation_data
    for curve in animation.curves(data.action, data.action_slot):
        for point in curve.keyframe_points:
            point.interpolation = kind


def assert_is_where_blender_has_it(obj, found: ColliderTrack, frames=(1, 2, 3), substeps=2):
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
        world = np.array(evaluated.matrix_world)
        points = np.array([vertex.co for vertex in evaluated.to_mesh().vertices]) @ world[:3, :3].T + world[:3, 3]
        assert np.abs(found.points((frame - frames[0]) * substeps) - points).max() < 1e-5 * np.abs(points).max()
    bpy.context.scene.frame_set(1)


# Which objects --------------------------------------------------------------------------------------------------------


def names(obj) -> list[str]:
    return [other.name for other in colliders.colliders(obj)]


def test_nothing_collides_before_it_is_turned_on(soft_arm):
    make_box()
    assert names(soft_arm) == []
    assert tracks(soft_arm) == {}


def test_what_has_collision_stops_the_skin(arm_with_collision):
    make_box("Second")
    make_box("First")
    make_box("Without", collision=False)
    hidden, muted = make_box("Hidden"), make_box("Muted")
    hidden.hide_viewport = True
    muted.modifiers["Collision"].show_viewport = False
    make_box("Elsewhere")
    bpy.context.scene.collection.objects.unlink(bpy.data.objects["Elsewhere"])
    bpy.context.view_layer.update()
    assert names(arm_with_collision) == ["First", "Second"]


def test_a_collection_limits_them(arm_with_collision):
    make_box("Out")
    inside, below = bpy.data.collections.new("Furniture"), bpy.data.collections.new("Chairs")
    bpy.context.scene.collection.children.link(inside)
    inside.children.link(below)
    inside.objects.link(make_box("Bench"))
    below.objects.link(make_box("Chair"))
    arm_with_collision.dynamorph.collision.collection = inside
    assert names(arm_with_collision) == ["Bench", "Chair"]
    bpy.data.collections.remove(inside)  # which leaves no limit
    assert "Out" in names(arm_with_collision)


@pytest.mark.fault("X11")
def test_the_body_and_what_moves_with_it_is_left_out(arm_with_collision):
    obj = arm_with_collision
    obj.modifiers.new("Collision", "COLLISION")
    attached, skinned, bound, following = make_box("Shoe"), make_box("Shirt"), make_box("Button"), make_box("Follower")
    obj.dynamorph.attachments.add().object = attached
    skinned.modifiers.new("Armature", "ARMATURE").object = rig_of(obj)
    bound.modifiers.new("Bound", "SURFACE_DEFORM").target = obj
    following.dynamorph.follows = obj
    make_box("Prop").parent = rig_of(obj)  # which it may well touch
    make_box("Colored").modifiers.new("Colors", "DATA_TRANSFER").object = obj  # which does not move it
    assert names(obj) == ["Colored", "Prop"]


ASSETS = Path(bpy.utils.system_resource("DATAFILES")) / "assets/nodes/geometry_nodes_dynamics_assets.blend"


@pytest.mark.skipif(not ASSETS.exists(), reason="this Blender has no Collider asset")
def test_the_collider_asset_stops_the_skin_with_its_friction(arm_with_collision):
    with bpy.data.libraries.load(str(ASSETS), link=False) as (_, wanted):
        wanted.node_groups = ["Collider"]
    made = make_box("Bench", collision=False)
    modifier = made.modifiers.new("Collider", "NODES")
    modifier.node_group = wanted.node_groups[0]
    assert names(arm_with_collision) == ["Bench"]
    found = tracks(arm_with_collision)["Bench"]
    assert found.friction == pytest.approx(0.2)  # as the asset comes
    socket = next(item for item in modifier.node_group.interface.items_tree if item.name == "Friction")
    getattr(modifier.properties.inputs, socket.identifier).value = 0.75
    assert tracks(arm_with_collision)["Bench"].friction == pytest.approx(0.75)
    assert_is_where_blender_has_it(made, found)
    modifier.show_viewport = False
    assert names(arm_with_collision) == []


# Reading --------------------------------------------------------------------------------------------------------------


def test_an_animated_object_is_rigid(arm_with_collision):
    made = make_box()
    made.scale = (0.5, 1.0, -2.0)
    for frame, angle in ((1, 0.0), (3, 1.0)):
        made.rotation_euler.z, made.location.x = angle, angle
        made.keyframe_insert("rotation_euler", frame=frame)
        made.keyframe_insert("location", frame=frame)
    found = tracks(arm_with_collision)["Box"]
    assert len(found.transforms) == 5 and len(found.shapes) == 1
    assert_is_where_blender_has_it(made, found)


def test_substeps_are_read_between_the_frames(arm_with_collision):
    made = make_box()
    for frame, place in ((1, 0.0), (3, 1.0)):
        made.location.x = place
        made.keyframe_insert("location", frame=frame)
    interpolate(made, "LINEAR")
    found = tracks(arm_with_collision)["Box"]
    assert found.transforms[:, 1, 0, 3] == pytest.approx([0.0, 0.25, 0.5, 0.75, 1.0], abs=1e-6)
    assert found.transforms[:, 0, 0, 3] == pytest.approx([0.0, 0.0, 0.25, 0.5, 0.75], abs=1e-6)


def test_modifiers_and_shape_keys_deform_it(arm_with_collision):
    keyed, bent = make_box("Keyed"), make_box("Bent")
    keyed.shape_key_add(name="Basis")
    key = add_key(keyed, "Grown", BOX)
    bend = bent.modifiers.new("Bend", "SIMPLE_DEFORM")
    bend.deform_method = "TWIST"
    bent.modifiers.move(1, 0)
    for frame, amount in ((1, 0.0), (3, 1.0)):
        key.value, bend.angle = amount, amount
        key.keyframe_insert("value", frame=frame)
        bend.keyframe_insert("angle", frame=frame)
    found = tracks(arm_with_collision)
    for made in (keyed, bent):
        assert len(found[made.name].shapes) == 5
        assert_is_where_blender_has_it(made, found[made.name])


@pytest.mark.fault("X08")
def test_a_prop_in_a_hand_follows_its_bone(arm_with_collision):
    made = make_box()
    made.parent, made.parent_type, made.parent_bone = rig_of(arm_with_collision), "BONE", "lower"
    found = tracks(arm_with_collision)["Box"]
    assert len(found.shapes) == 1
    assert np.ptp(found.transforms[:, 1], axis=0).max() > 0.01
    assert_is_where_blender_has_it(made, found)


def test_blenders_own_settings_count(arm_with_collision):
    made = make_box()
    made.collision.cloth_friction, made.collision.use_culling = 3.0, True
    for frame, on in ((1, True), (2, False), (3, True)):
        made.collision.use = on
        made.collision.keyframe_insert("use", frame=frame)
    found = tracks(arm_with_collision)["Box"]
    assert found.one_sided
    assert found.friction == pytest.approx([0.3] * 5)
    assert found.active.tolist() == [True, True, False, False, True]
    arm_with_collision.dynamorph.collision.use_friction = True
    arm_with_collision.dynamorph.collision.friction = 0.8
    assert tracks(arm_with_collision)["Box"].friction == pytest.approx([0.8] * 5)


def test_lengths_are_meters_whatever_the_unit(arm_with_collision):
    make_box(location=(0.0, 2.0, 0.0))
    bpy.context.scene.unit_settings.scale_length = 0.01
    found = tracks(arm_with_collision)["Box"]
    assert found.points(0).mean(axis=0) == pytest.approx([0.0, 0.02, 0.0], abs=1e-6)
    assert np.ptp(found.points(0), axis=0) == pytest.approx([0.01] * 3, rel=1e-4)


def test_reading_leaves_no_trace(arm_with_collision):
    made = make_box()
    before = {kind: len(getattr(bpy.data, kind)) for kind in ("objects", "meshes", "scenes")}
    tracks(arm_with_collision)
    assert {kind: len(getattr(bpy.data, kind)) for kind in before} == before
    assert [scene.name for scene in made.users_scene] == [bpy.context.scene.name]


# What is wrong --------------------------------------------------------------------------------------------------------


@pytest.mark.fault("X06")
def test_a_curve_that_is_not_a_number_is_refused(arm_with_collision):
    made = make_box()
    made.location.x = np.nan
    with pytest.raises(SceneError, match="'Box' collides, but has values that are not numbers at frame"):
        tracks(arm_with_collision)


@pytest.mark.fault("X12")
def test_an_object_without_faces_is_refused(arm_with_collision):
    make_box().data.clear_geometry()
    with pytest.raises(SceneError, match="'Box' collides but has no faces"):
        tracks(arm_with_collision)


@pytest.mark.fault("X12")
def test_faces_that_come_later_are_refused(arm_with_collision):
    made = make_box()
    array = made.modifiers.new("Array", "ARRAY")
    made.modifiers.move(1, 0)
    for frame, count in ((1, 1), (2, 4)):
        array.count = count
        array.keyframe_insert("count", frame=frame)
    interpolate(made, "CONSTANT")
    with pytest.raises(SceneError, match="'Box' collides, but its faces change at frame 2"):
        tracks(arm_with_collision)


@pytest.mark.fault("X13")
def test_rigid_bodies_and_cloth_are_refused_before_they_are_baked(arm_with_collision):
    made = make_box()
    made.modifiers.new("Cloth", "CLOTH")
    with pytest.raises(SceneError, match="'Box' collides and is simulated by modifier 'Cloth'"):
        tracks(arm_with_collision)
    made.modifiers.remove(made.modifiers["Cloth"])
    bpy.ops.rigidbody.world_add()
    bpy.context.view_layer.objects.active = made
    bpy.ops.rigidbody.object_add()
    with pytest.raises(SceneError, match="'Box' collides and is moved by Rigid Body"):
        tracks(arm_with_collision)
    made.rigid_body.type = "PASSIVE"
    assert tracks(arm_with_collision)


@pytest.mark.fault("X10")
@pytest.mark.parametrize("lost", ["object", "modifier"])
def test_what_is_removed_while_it_is_read_is_named(arm_with_collision, lost):
    made = make_box()
    sampling = rig_motion.RigSampling(arm_with_collision, 1, 20, 5)
    assert not sampling.advance(arm_with_collision, 0.0)
    if lost == "object":
        bpy.data.objects.remove(made)
    else:
        made.modifiers.clear()
    with pytest.raises(SceneError, match="'Box' or its Collision was removed"):
        sampling.advance(arm_with_collision)
