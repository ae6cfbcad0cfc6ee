# SPDX-License-Identifier: GPL-3.0-or-later
"""The section Collision and its buttons."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.run import remembered
from bl_ext.user_default.dynamic_morph_targets.scene.motion import colliders, run_settings
from builders import activate, evaluated_points, make_box, make_mesh, refused, rig_of
from layout import drawn

PHYSICS = "DYNAMORPH_PT_physics"


def select(*objects):
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj in objects)


def names(obj) -> list[str]:
    return [other.name for other in colliders.colliders(obj)]


def test_selected_meshes_collide_with_one_click(soft_arm, capfd):
    first, second = make_box("Ball", collision=False), make_box("Bench")
    second.collision.use = False
    select(soft_arm, first, second)
    assert bpy.ops.dynamorph.collide() == {"FINISHED"}
    assert soft_arm.dynamorph.collision.use and names(soft_arm) == ["Ball", "Bench"]
    assert first.collision.use and second.collision.use
    assert [modifier.type for modifier in second.modifiers] == ["COLLISION"]  # and no second one
    assert "'Arm' collides with Ball, Bench" in capfd.readouterr().out


def test_the_armature_may_be_active(soft_arm):
    box = make_box(collision=False)
    activate(rig_of(soft_arm))
    select(box, rig_of(soft_arm))
    bpy.ops.dynamorph.collide()
    assert names(soft_arm) == ["Box"]


def test_without_others_selected_the_button_is_gray(soft_arm):
    select(soft_arm)
    refused(bpy.ops.dynamorph.collide, "Select other mesh objects too")


def test_the_sidebar_has_the_button_while_something_else_is_selected(soft_arm):
    shown = lambda: "dynamorph.collide" in drawn(soft_arm)  # noqa: E731
    ball, shirt = make_box("Ball", collision=False), make_box("Shirt", collision=False)
    soft_arm.dynamorph.attachments.add().object = shirt
    select(soft_arm, shirt)
    assert not shown()
    select(soft_arm, ball)
    assert shown()
    bpy.ops.dynamorph.collide()
    assert not shown()


@pytest.mark.fault("X11")
def test_what_belongs_to_the_body_is_refused(soft_arm):
    shirt = make_box("Shirt", collision=False)
    soft_arm.dynamorph.attachments.add().object = shirt
    select(soft_arm, shirt)
    refused(bpy.ops.dynamorph.collide, "'Shirt' belongs to 'Arm'")
    assert not soft_arm.dynamorph.collision.use and not shirt.modifiers


def test_they_join_the_collection_that_limits_them(soft_arm):
    furniture = bpy.data.collections.new("Furniture")
    bpy.context.scene.collection.children.link(furniture)
    soft_arm.dynamorph.collision.collection = furniture
    box = make_box(collision=False)
    select(soft_arm, box)
    bpy.ops.dynamorph.collide()
    assert names(soft_arm) == ["Box"] and "Box" in furniture.objects


@pytest.mark.parametrize("unit", [1.0, 0.01])
def test_a_floor_is_below_the_skin_as_it_stands(soft_arm, unit):
    bpy.context.scene.unit_settings.scale_length = unit
    rig_of(soft_arm).location.z = 0.7
    bpy.context.scene.frame_set(20)
    bpy.ops.dynamorph.add_floor()
    assert names(soft_arm) == ["Floor"] and soft_arm.dynamorph.collision.use
    skin, floor = evaluated_points(soft_arm), evaluated_points(bpy.data.objects["Floor"])
    assert floor[:, 2] == pytest.approx(np.full(4, skin[:, 2].min()), abs=1e-5)
    assert (floor.min(axis=0)[:2] < skin.min(axis=0)[:2]).all() and (floor.max(axis=0)[:2] > skin.max(axis=0)[:2]).all()
    bpy.context.view_layer.update()
    normal = bpy.data.objects["Floor"].data.polygons[0].normal
    assert tuple(normal) == pytest.approx((0.0, 0.0, 1.0))


def test_the_section_says_what_collides(soft_arm):
    assert "No object has Collision yet" not in drawn(soft_arm, PHYSICS)
    soft_arm.dynamorph.collision.use = True
    assert "No object has Collision yet" in drawn(soft_arm, PHYSICS)
    make_box()
    assert "Collides with: Box" in drawn(soft_arm, PHYSICS)


def test_a_bake_without_dents_is_mentioned_with_a_fix(soft_arm):
    collision, model = soft_arm.dynamorph.collision, soft_arm.dynamorph.model
    model.quality = "REDUCED"
    assert "in Reduced Quality" not in " ".join(drawn(soft_arm))
    collision.use = True
    assert "'Arm' collides in Reduced Quality" in " ".join(drawn(soft_arm))
    bpy.ops.dynamorph.fix(problem="FULL_QUALITY")
    assert model.quality == "AUTOMATIC" and "in Reduced Quality" not in " ".join(drawn(soft_arm))


@pytest.mark.parametrize(
    ("quality", "solver", "bake_full"),
    [("AUTOMATIC", "REDUCED", True), ("REDUCED", "REDUCED", False), ("FULL", "FULL", True)],
)
def test_quality_is_one_question(soft_arm, quality, solver, bake_full):
    """What scripts and files have set says the same as what the panel asks."""
    collision, model = soft_arm.dynamorph.collision, soft_arm.dynamorph.model
    assert model.quality == "AUTOMATIC"
    model.quality = quality
    assert (model.solver, collision.bake_full) == (solver, bake_full)
    model.quality = "AUTOMATIC"
    model.solver, collision.bake_full = solver, bake_full
    assert model.quality == quality
    shown = drawn(soft_arm, PHYSICS)
    assert "quality" in shown and not {"solver", "bake_full"} & set(shown)


def test_full_quality_keeps_whether_dents_are_full(soft_arm):
    """A file that was Full and becomes Reduced by a script is baked as before it."""
    collision, model = soft_arm.dynamorph.collision, soft_arm.dynamorph.model
    model.quality = "REDUCED"
    model.quality = "FULL"
    assert not collision.bake_full
    model.solver = "REDUCED"
    assert model.quality == "REDUCED"


def test_a_body_that_stops_itself_is_baked_in_full_quality(soft_arm):
    collision = soft_arm.dynamorph.collision
    collision.use_self = True

    def settings():
        return run_settings.simulation_settings(soft_arm, bpy.context.scene)

    assert not settings().self_collision and run_settings.bake_solver(soft_arm) == "REDUCED"
    collision.use = True
    assert settings().self_collision and run_settings.bake_solver(soft_arm) == "FULL"
    assert settings().self_friction == 0.0
    collision.use_friction, collision.friction = True, 0.25
    assert settings().self_friction == 0.25
    assert "No object has Collision yet" not in " ".join(drawn(soft_arm, PHYSICS))


def test_the_quality_of_a_bake_is_said_before_it_with_its_time(soft_arm, monkeypatch):
    settings = soft_arm.dynamorph
    settings.collision.use = True
    assert "Quality" not in " ".join(drawn(soft_arm))  # nothing collides yet
    make_box()
    said = "Colliding bodies are baked in Full Quality, which takes"
    assert f"{said} less than a minute" in " ".join(drawn(soft_arm))
    assert " ".join(drawn(soft_arm, PHYSICS)).count("less than a minute") == 1
    monkeypatch.setitem(remembered.work.seconds, soft_arm.session_uid, 1.5)  # as the last bake measured
    assert f"{said} about 2 min" in " ".join(drawn(soft_arm))  # 19 frames of 5 steps
    settings.simulation.use_scene_range, settings.simulation.frame_end = False, 201
    assert f"{said} about 25 min" in " ".join(drawn(soft_arm))
    settings.model.quality = "REDUCED"
    assert "are baked in" not in " ".join(drawn(soft_arm))
    settings.model.quality = "FULL"
    assert "Full Quality" not in " ".join(drawn(soft_arm))


def test_what_cannot_collide_is_among_the_messages(soft_arm):
    soft_arm.dynamorph.collision.use = True
    make_box().modifiers.new("Cloth", "CLOTH")
    assert "is simulated by modifier 'Cloth'" in " ".join(drawn(soft_arm))


def test_a_linked_object_is_refused(soft_arm, tmp_path):
    path = str(tmp_path / "library.blend")
    other = make_mesh(bpy.context.scene, "Linked", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    bpy.data.libraries.write(path, {other})
    bpy.data.objects.remove(other)
    with bpy.data.libraries.load(path, link=True) as (_, linked):
        linked.objects = ["Linked"]
    bpy.context.scene.collection.objects.link(linked.objects[0])
    bpy.context.view_layer.update()
    select(soft_arm, linked.objects[0])
    refused(bpy.ops.dynamorph.collide, "'Linked' is linked")
