# SPDX-License-Identifier: GPL-3.0-or-later
"""A bake is out of date when a collider moved, changed, came or went, and says which; not while the shot plays."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.run.tools import watch
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from builders import BOX, add_key, make_box, soon


@pytest.fixture
def baked(soft_arm, stand_in):
    """The arm, baked with a box beside it that moves and deforms."""
    soft_arm.dynamorph.collision.use = True
    box = make_box()
    parent = bpy.data.objects.new("Carrier", None)
    bpy.context.scene.collection.objects.link(parent)
    box.parent = parent
    box.shape_key_add(name="Basis")
    key = add_key(box, "Grown", BOX)
    box.modifiers.new("Bend", "SIMPLE_DEFORM")
    for frame, amount in ((1, 0.0), (20, 1.0)):
        box.rotation_euler.z = key.value = amount
        box.keyframe_insert("rotation_euler", frame=frame)
        key.keyframe_insert("value", frame=frame)
        box.collision.keyframe_insert("use", frame=frame)
    bpy.context.scene.frame_set(1)
    bpy.ops.dynamorph.bake()
    assert looked(soft_arm) == []
    return soft_arm


def looked(obj) -> list[str]:
    staleness.look_at_colliders(obj)
    return staleness.outdated(obj)


@pytest.fixture
def box(baked):
    return bpy.data.objects["Box"]


def test_another_frame_is_no_change(baked, scene):
    scene.frame_set(12)
    assert looked(baked) == []


@pytest.mark.parametrize("name", ["location", "scale", "delta_location"])
def test_what_is_moved_is_named_until_it_is_back(baked, box, name):
    before = getattr(box, name).copy()
    getattr(box, name)[1] += 0.1
    assert looked(baked) == ["'Box' moved"]
    setattr(box, name, before)
    assert looked(baked) == []


def test_its_parents_its_constraints_and_its_animation_move_it(baked, box):
    box.parent.location.x += 1.0
    assert looked(baked) == ["'Box' moved"]
    box.parent.location.x -= 1.0
    box.constraints.new("LIMIT_LOCATION")
    assert looked(baked) == ["'Box' moved"]
    box.constraints.clear()
    assert looked(baked) == []
    box.rotation_euler.z = 0.3
    box.keyframe_insert("rotation_euler", frame=7)
    assert looked(baked) == ["'Box' moved"]


def sculpt(box):
    box.data.shape_keys.key_blocks["Grown"].points[0].co.x += 0.1


def bend(box):
    box.modifiers["Bend"].angle += 0.1


def another_friction(box):
    box.collision.cloth_friction = 2.0


def fade(box):
    key = box.data.shape_keys.key_blocks["Grown"]
    key.value = 0.2
    key.keyframe_insert("value", frame=7)


@pytest.mark.parametrize("change", [sculpt, bend, another_friction, fade])
def test_what_has_another_shape_is_named(baked, box, change):
    change(box)
    assert looked(baked) == ["'Box' changed"]


def test_an_edited_mesh_is_another_shape(soft_arm, stand_in):
    soft_arm.dynamorph.collision.use = True
    mesh = make_box().data
    bpy.ops.dynamorph.bake()
    mesh.vertices[0].co.x -= 0.1
    assert looked(soft_arm) == ["'Box' changed"]


@pytest.mark.fault("X10")
def test_what_comes_and_goes_is_named_at_once(baked, box):
    second = make_box("Second")
    assert staleness.outdated(baked) == ["'Second' collides now"]
    bpy.data.objects.remove(second)
    box.modifiers.remove(box.modifiers["Collision"])
    bpy.context.view_layer.update()
    assert staleness.outdated(baked) == ["'Box' does not collide any more"]


def test_settings_of_the_body_are_named(baked):
    collision = baked.dynamorph.collision
    collision.distance *= 2.0
    assert looked(baked) == ["Distance changed"]
    collision.distance /= 2.0
    collision.friction = 0.9  # which is not used
    assert looked(baked) == []
    collision.use_friction = True
    assert looked(baked) == ["Override Friction changed"]
    collision.use_friction = False
    collision.use_self = True
    assert looked(baked) == ["Self Collision changed"]
    collision.use_self = False
    collision.use = False
    assert looked(baked) == ["Collision changed"]
    collision.distance *= 2.0  # which is not used now
    assert looked(baked) == ["Collision changed"]


def test_a_body_without_collision_does_not_care(soft_arm, stand_in):
    bpy.ops.dynamorph.bake()
    make_box()
    soft_arm.dynamorph.collision.distance *= 2.0
    assert looked(soft_arm) == []
    soft_arm.dynamorph.collision.use = True
    assert looked(soft_arm) == ["Collision changed"]


def test_edits_are_looked_at_soon(baked, box):
    with soon():
        box.parent.location.x += np.pi
        bpy.context.view_layer.update()
    assert staleness.outdated(baked) == ["'Box' moved"]
    assert watch.PATIENCE


def test_a_bake_is_up_to_date_after_loading(baked, tmp_path):
    path = str(tmp_path / "shot.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    assert looked(bpy.data.objects["Arm"]) == []
