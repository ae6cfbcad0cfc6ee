# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes that cut into a body and do not stop its skin are reported, with a button that lets them collide."""

import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.scene import cuts
from bl_ext.user_default.dynamic_morph_targets.scene.motion import colliders
from builders import make_box, refused, rig_of, soon
from layout import drawn
from mathutils import Matrix

SURFACE = 0.3  # meters, radius of the arm


def messages_of(obj) -> str:
    """The tab, once what it asks about the body has been answered: by a timer in a window."""
    with soon():
        drawn(obj)
    return " ".join(drawn(obj))


@pytest.fixture
def box(soft_arm):
    """A cube of 1 m whose side is 5 cm in the arm, without Collision."""
    return make_box("Crate", location=(SURFACE + 0.45, 0.0, 1.0), collision=False)


def test_what_cuts_the_body_is_reported_and_one_button_lets_it_collide(soft_arm, box):
    assert "'Crate' cuts 'Arm': let it collide" in messages_of(soft_arm)
    assert bpy.ops.dynamorph.fix(problem="COLLIDE") == {"FINISHED"}
    assert [other.name for other in colliders.colliders(soft_arm)] == ["Crate"]
    assert "cuts 'Arm'" not in messages_of(soft_arm)


@pytest.mark.parametrize("use", [False, True])
def test_its_collision_alone_is_not_enough(soft_arm, box, use):
    box.modifiers.new("Collision", "COLLISION")
    soft_arm.dynamorph.collision.use = use
    assert ("'Crate' cuts 'Arm'" in messages_of(soft_arm)) != use


def test_several_are_one_message(soft_arm, box):
    make_box("Plank", location=(-SURFACE - 0.45, 0.0, 1.5), collision=False)
    assert "Crate, Plank cut 'Arm': let them collide" in messages_of(soft_arm)
    bpy.ops.dynamorph.fix(problem="COLLIDE")
    assert len(colliders.colliders(soft_arm)) == 2


def test_a_collection_that_limits_them_gets_it(soft_arm, box):
    furniture = bpy.data.collections.new("Furniture")
    bpy.context.scene.collection.children.link(furniture)
    soft_arm.dynamorph.collision.use, soft_arm.dynamorph.collision.collection = True, furniture
    box.modifiers.new("Collision", "COLLISION")
    assert "'Crate' cuts 'Arm'" in messages_of(soft_arm)
    bpy.ops.dynamorph.fix(problem="COLLIDE")
    assert "Crate" in furniture.objects and "cuts 'Arm'" not in messages_of(soft_arm)


def beside(box, _obj):
    box.location.x += 0.1


def in_its_box_only(box, _obj):
    """Beside a corner of the arm's bounding box, which the round arm leaves empty."""
    box.location = (SURFACE + 0.42, SURFACE + 0.42, 1.0)


def around(box, _obj):
    box.location, box.scale = (0.0, 0.0, 1.0), (10.0, 10.0, 10.0)


def hidden(box, _obj):
    box.hide_set(True)


def a_helper(box, _obj):
    box.display_type = "WIRE"


def on_the_rig(box, obj):
    world = box.matrix_world.copy()
    box.parent, box.parent_type, box.parent_bone = rig_of(obj), "BONE", "lower"
    bpy.context.view_layer.update()
    box.matrix_world = world


def skinned_alike(box, obj):
    box.modifiers.new("Armature", "ARMATURE").object = rig_of(obj)


def attached(box, obj):
    obj.dynamorph.attachments.add().object = box


def the_cage(box, obj):
    obj.dynamorph.model.cage_object = box


def scaled_to_nothing(box, _obj):
    box.scale = (0.0, 0.0, 0.0)


def without_faces(box, _obj):
    box.data.clear_geometry()


def not_a_number(box, _obj):
    box.location.x = float("nan")


@pytest.mark.parametrize(
    "change",
    [beside, in_its_box_only, around, hidden, a_helper, on_the_rig, skinned_alike, attached, the_cage,
     scaled_to_nothing, without_faces, not_a_number],
)  # fmt: skip
def test_what_does_not_cut_it_or_belongs_to_it_is_left_out(soft_arm, box, change):
    change(box, soft_arm)
    bpy.context.view_layer.update()
    assert cuts.cutting(soft_arm) == [] and "cuts 'Arm'" not in messages_of(soft_arm)


def test_modifiers_poses_and_frames_count(soft_arm, box):
    box.location = (0.0, 1.0, 1.3)
    assert "cuts 'Arm'" not in messages_of(soft_arm)
    bpy.context.scene.frame_set(20)  # where the arm is bent to that side
    box.location.y = -1.0
    bpy.context.view_layer.update()
    assert "'Crate' cuts 'Arm'" in messages_of(soft_arm)
    bpy.context.scene.frame_set(1)
    assert "cuts 'Arm'" not in messages_of(soft_arm)
    box.data.transform(Matrix.Scale(2.0, 4))
    box.data.update()
    bpy.context.view_layer.update()
    assert "'Crate' cuts 'Arm'" in messages_of(soft_arm)


def test_drawing_reads_no_mesh_and_looks_once(soft_arm, box, monkeypatch):
    messages_of(soft_arm)
    monkeypatch.setattr(cuts, "cutting", None)
    for _ in range(3):
        assert "'Crate' cuts 'Arm'" in messages_of(soft_arm)


def test_a_fine_mesh_is_thinned_out(soft_arm, box, monkeypatch):
    monkeypatch.setattr(cuts, "LOOKED_AT", 100)
    for modifier, levels in ((box.modifiers.new("Fine", "SUBSURF"), 6),):
        modifier.subdivision_type, modifier.levels = "SIMPLE", levels
    bpy.context.view_layer.update()
    assert cuts.cutting(soft_arm) == [box]


# Instances -----------------------------------------------------------------------------------------------------------


def collection_instance(box):
    kit = bpy.data.collections.new("Set")
    (home,) = box.users_collection
    home.objects.unlink(box)
    kit.objects.link(box)
    instancer = bpy.data.objects.new("Instancer", None)
    instancer.instance_type, instancer.instance_collection = "COLLECTION", kit
    return instancer


def geometry_nodes(box):
    group = bpy.data.node_groups.new("Nodes", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    read, out = group.nodes.new("GeometryNodeObjectInfo"), group.nodes.new("NodeGroupOutput")
    read.inputs["Object"].default_value, read.inputs["As Instance"].default_value = box, True
    group.links.new(read.outputs["Geometry"], out.inputs[0])
    instancer = bpy.data.objects.new("Instancer", bpy.data.meshes.new("Empty"))
    instancer.modifiers.new("Nodes", "NODES").node_group = group
    box.hide_viewport = box.hide_render = True
    instancer.location = box.location
    return instancer


def faces(box):
    instancer = bpy.data.objects.new("Instancer", bpy.data.meshes.new("One"))
    x, y, z = box.location
    instancer.data.from_pydata([(x - 0.1, y, z), (x, y + 0.1, z), (x + 0.1, y, z), (x, y - 0.1, z)], [], [(0, 1, 2, 3)])
    instancer.instance_type = "FACES"
    box.parent, box.location = instancer, (0.0, 0.0, 0.0)
    return instancer


def particles(box):
    """Hair on a small cube where the box was, of small copies of it."""
    instancer = make_box("Instancer", location=(SURFACE, 0.0, 1.0), collision=False)
    bpy.context.scene.collection.objects.unlink(instancer)
    instancer.scale, box.location, box.scale = (0.1, 0.1, 0.1), (5.0, 5.0, 5.0), (0.2, 0.2, 0.2)
    instancer.modifiers.new("Hair", "PARTICLE_SYSTEM")
    hair = instancer.particle_systems[0].settings
    hair.type, hair.count, hair.render_type, hair.instance_object, hair.particle_size = "HAIR", 20, "OBJECT", box, 1.0
    return instancer


@pytest.mark.parametrize("kind", [collection_instance, geometry_nodes, faces, particles])
def test_instances_that_cut_the_body_are_named_with_what_helps(soft_arm, box, kind):
    instancer = kind(box)
    bpy.context.scene.collection.objects.link(instancer)
    soft_arm.dynamorph.collision.use = True
    said = messages_of(soft_arm)
    assert "'Crate' cuts 'Arm', but is an instance by 'Instancer'" in said
    assert "Make Instances Real" in said
    instancer.location.x += 1.0
    bpy.context.view_layer.update()
    cuts.outdate()
    assert "is an instance" not in messages_of(soft_arm)


def test_a_collider_that_is_off_in_viewports_is_named(soft_arm, box):
    box.modifiers.new("Collision", "COLLISION")
    box.hide_viewport = soft_arm.dynamorph.collision.use = True
    text = "'Crate' has Collision, but is disabled in viewports, so it stops nothing"
    assert text in messages_of(soft_arm) and not colliders.colliders(soft_arm)
    box.hide_render = True  # it is in no picture
    assert text not in messages_of(soft_arm)


@pytest.mark.parametrize("driven", [False, True])
def test_a_collider_whose_visibility_is_keyed_is_named(soft_arm, box, driven):
    box.modifiers.new("Collision", "COLLISION")
    soft_arm.dynamorph.collision.use = True
    text = "'Crate' collides, and whether it is disabled in viewports is keyed or driven"
    assert text not in messages_of(soft_arm)
    box.driver_add("hide_viewport") if driven else box.keyframe_insert("hide_viewport", frame=1)
    assert text in messages_of(soft_arm)


@pytest.mark.parametrize("kind, words", [("CURVE", "is no mesh: convert it"), ("EMPTY", "make them real first")])
def test_the_button_says_what_a_selected_object_needs(soft_arm, kind, words):
    if kind == "CURVE":
        other = bpy.data.objects.new("Other", bpy.data.curves.new("Other", "CURVE"))
    else:
        other = bpy.data.objects.new("Other", None)
        other.instance_type, other.instance_collection = "COLLECTION", bpy.data.collections.new("Set")
    bpy.context.scene.collection.objects.link(other)
    bpy.context.view_layer.update()
    other.select_set(True)
    refused(bpy.ops.dynamorph.collide, words)
