# SPDX-License-Identifier: GPL-3.0-or-later
"""What moves a skin in Blender and not in a bake is named: drivers, handlers of others, keyed settings."""

import functools
import math

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene import animation
from bl_ext.user_default.dynamic_morph_targets.scene.check import checks
from bl_ext.user_default.dynamic_morph_targets.scene.motion import read_poses
from bl_ext.user_default.dynamic_morph_targets.scene.remembered import opened
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from builders import rig_of, skinning_of, soon

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")


def notes_of(obj):
    return [note.text for note in checks.notes(skinning_of(obj))]


# Drivers -------------------------------------------------------------------------------------------------------------


def sway():
    return math.sin(bpy.context.scene.frame_current / 3)


def calls_sway():
    return 2.0 * sway()


def pure(angle):
    return math.sin(angle)


@pytest.fixture
def namespace():
    known = bpy.app.driver_namespace
    added = {"sway": sway, "calls_sway": calls_sway, "pure": pure, "inner": lambda: sway()}
    known.update(added)
    yield
    for name in added:
        del known[name]


@pytest.mark.parametrize(
    "expression",
    ["sin(bpy.context.scene.frame_current / 3)", "sway() + 0 * frame", "calls_sway()", "inner()", "pure(sway())"],
)
@pytest.mark.parametrize("owner", ["bone", "data", "parent"])
def test_a_driver_that_asks_blender_is_named(scene, soft_arm, namespace, expression, owner):
    rig = rig_of(soft_arm)
    if owner == "parent":
        rig.parent = bpy.data.objects.new("Root", None)
        scene.collection.objects.link(rig.parent)
        driven, driver = rig.parent, rig.parent.driver_add("location", 0).driver
    elif owner == "data":
        rig.data["sway"] = 0.0
        driven, driver = rig.data, rig.data.driver_add('["sway"]').driver
    else:
        driven, driver = rig, rig.pose.bones["lower"].driver_add("rotation_euler", 0).driver
    driver.expression = expression
    (text,) = notes_of(soft_arm)
    assert text.startswith(f"A driver of '{driven.name}', \"{expression}\", asks Blender by Python")


def test_a_muted_driver_is_none(soft_arm):
    curve = rig_of(soft_arm).pose.bones["lower"].driver_add("rotation_euler", 0)
    curve.driver.expression, curve.mute = "sin(bpy.context.scene.frame_current / 3)", True
    assert notes_of(soft_arm) == []


def test_of_many_drivers_the_first_of_each_kind_is_named(scene, soft_arm, namespace):
    lower = rig_of(soft_arm).pose.bones["lower"]
    for index in range(2):
        lower.driver_add("rotation_euler", index).driver.expression = "sway() + 0 * frame"
        driver = lower.driver_add("location", index).driver
        for name in ("a", "b"):
            variable = driver.variables.new()
            variable.name, variable.targets[0].id_type = name, "SCENE"
            variable.targets[0].id, variable.targets[0].data_path = scene, "gravity[2]"
        driver.expression = "a + b"
    assert [text.split(",")[0] for text in notes_of(soft_arm)] == [
        "A driver of 'Arm Rig' reads 'gravity[2]' of the scene",
        "A driver of 'Arm Rig'",
    ]


@pytest.mark.parametrize("expression", ["0.1 * sin(frame)", "pure(frame)", "clamp(frame, 0, 1)", "lambda (", ""])
def test_other_drivers_are_not(soft_arm, namespace, expression):
    rig_of(soft_arm).pose.bones["lower"].driver_add("rotation_euler", 0).driver.expression = expression
    assert notes_of(soft_arm) == []


# Handlers of others --------------------------------------------------------------------------------------------------


@pytest.fixture
def still(soft_arm):
    """The soft arm, coarse, whose rig no keys move."""
    soft_arm.dynamorph.model.cage_nodes, soft_arm.dynamorph.model.modes = 200, 6
    rig_of(soft_arm).animation_data_clear()
    return soft_arm


def spring(scene, *_):
    bpy.data.objects["Arm Rig"].pose.bones["lower"].rotation_euler.x = 0.6 * math.sin(scene.frame_current / 3)


def harmless(scene, *_):
    scene["seen"] = scene.frame_current


@pytest.fixture
def called(request):
    """Adds a handler of the test's choice until its end."""

    def add(when, handler):
        handlers = getattr(bpy.app.handlers, when)
        handlers.append(handler)
        request.addfinalizer(lambda: handlers.remove(handler))

    return add


def displaced(obj):
    return [text for text in notes_of(obj) if "is not where the bake" in text]


def play(scene):
    for frame in range(1, 21):
        scene.frame_set(frame)


@pytest.mark.parametrize("when", ["frame_change_pre", "frame_change_post"])
@pytest.mark.parametrize("handler, told", [(spring, True), (harmless, False)])
def test_bones_that_a_handler_moves_are_named_once_the_bake_is_played(scene, still, called, when, handler, told):
    called(when, handler)
    scene.frame_set(7)
    batch.run(Job(still, "BAKE"))
    assert scene.frame_current == 7 and displaced(still) == []
    play(scene)
    found = displaced(still)
    assert len(found) == told
    if told:
        assert found[0].startswith("'lower' is not where the bake of 'Arm' has it: bake again.")
        assert "handler moves it when the frame changes (test_unfollowed)" in found[0]
        getattr(bpy.app.handlers, when).remove(spring)  # as after Bake Action
        batch.run(Job(still, "BAKE"))
        play(scene)
        getattr(bpy.app.handlers, when).append(spring)
        assert displaced(still) == []


def moved_by(name):
    def handler(scene, *_):
        bpy.data.objects[name].location.x = 0.2 * scene.frame_current

    return handler


@pytest.mark.parametrize("name", ["Arm Rig", "Root", "Arm"])
def test_objects_that_a_handler_moves_are_named(scene, still, called, name):
    rig = rig_of(still)
    rig.parent = bpy.data.objects.new("Root", None)
    scene.collection.objects.link(rig.parent)
    called("frame_change_post", moved_by(name))
    batch.run(Job(still, "BAKE", frames=(2, 7)))
    play(scene)
    assert displaced(still)[0].startswith(f"'{'Arm Rig' if name == 'Root' else name}' is not where the bake")


def test_a_motion_that_repeats_is_seen(scene, still, called):
    called("frame_change_pre", lambda scene, *_: turn(still, 0.5 * math.sin(scene.frame_current * math.pi / 4)))
    batch.run(Job(still, "BAKE"))
    play(scene)
    assert len(displaced(still)) == 1


# What no hash tells --------------------------------------------------------------------------------------------------


def turn(obj, angle):
    rig_of(obj).pose.bones["lower"].rotation_euler.x = angle


def easing(rig):
    lower = rig.pose.bones["lower"]
    for frame, angle in ((1, 0.0), (20, 1.0)):
        lower.rotation_euler.x = angle
        lower.keyframe_insert("rotation_euler", frame=frame)
    point = animation.curves(rig.animation_data.action, rig.animation_data.action_slot)[0].keyframe_points[0]
    point.interpolation = "BACK"
    return lambda: setattr(point, "back", 9.0)


def expression(rig):
    driver = rig.pose.bones["lower"].driver_add("rotation_euler", 0).driver
    driver.expression = "frame / 20"
    return lambda: setattr(driver, "expression", "frame / 10")


def constraint(rig):
    limit = rig.pose.bones["lower"].constraints.new("LIMIT_ROTATION")
    turn_keyed(rig)
    limit.use_limit_x, limit.influence = True, 0.0
    return lambda: setattr(limit, "influence", 1.0)


def turn_keyed(rig):
    for frame, angle in ((1, 0.0), (20, 1.0)):
        rig.pose.bones["lower"].rotation_euler.x = angle
        rig.pose.bones["lower"].keyframe_insert("rotation_euler", frame=frame)


def goal(rig):
    empty = bpy.data.objects.new("Goal", None)
    bpy.context.scene.collection.objects.link(empty)
    empty.location = (0.0, -1.0, 1.0)
    track = rig.pose.bones["lower"].constraints.new("TRACK_TO")
    track.target, track.track_axis, track.up_axis = empty, "TRACK_Y", "UP_Z"
    return lambda: setattr(empty, "location", (1.0, 1.0, 1.0))


def unkeyed(rig):
    return lambda: setattr(rig.pose.bones["lower"], "rotation_euler", (0.5, 0.0, 0.0))


def inherited(rig):
    turn_keyed(rig)
    rig.pose.bones["upper"].rotation_euler.y = 0.8
    return lambda: setattr(rig.data.bones["lower"], "use_inherit_rotation", False)


def armature_data(rig):
    rig.data["turn"] = 0.0
    for frame, value in ((1, 0.0), (20, 1.0)):
        rig.data["turn"] = value
        rig.data.keyframe_insert('["turn"]', frame=frame)
    driver = rig.pose.bones["lower"].driver_add("rotation_euler", 0).driver
    variable = driver.variables.new()
    variable.name, variable.targets[0].id_type = "turn", "ARMATURE"
    variable.targets[0].id, variable.targets[0].data_path = rig.data, '["turn"]'
    driver.expression = "turn"
    curve = animation.curves(rig.data.animation_data.action, rig.data.animation_data.action_slot)[0]
    return lambda: setattr(curve.keyframe_points[1], "co", (20.0, 3.0))


@pytest.mark.parametrize("kind", [easing, expression, constraint, goal, unkeyed, inherited, armature_data])
def test_a_motion_that_changed_is_named_once_it_is_shown(scene, still, kind):
    change = kind(rig_of(still))
    batch.run(Job(still, "BAKE"))
    play(scene)
    assert displaced(still) == []
    change()
    play(scene)
    (text,) = displaced(still)
    assert text.startswith("'lower' is not where the bake of 'Arm' has it: bake again") and "a driver or" in text
    batch.run(Job(still, "BAKE"))
    play(scene)
    assert displaced(still) == []


class Spring:
    def angle(self):
        return math.sin(bpy.context.scene.frame_current / 3)


@pytest.mark.parametrize("function", [functools.partial(sway), Spring().angle], ids=["partial", "method"])
def test_a_driver_that_stands_still_in_the_bake_is_named(scene, still, function):
    bpy.app.driver_namespace["hidden"] = function
    try:
        rig_of(still).pose.bones["lower"].driver_add("rotation_euler", 0).driver.expression = "hidden() + 0 * frame"
        batch.run(Job(still, "BAKE"))
        play(scene)
        assert "a driver or something else moves it" in displaced(still)[0]
    finally:
        del bpy.app.driver_namespace["hidden"]


def test_a_pose_that_keys_bring_back_is_none(scene, still):
    rig = rig_of(still)
    rig.pose.bones["upper"].keyframe_insert("rotation_euler", frame=1)
    rig.pose.bones["upper"].rotation_euler.y = 0.3
    batch.run(Job(still, "BAKE"))
    assert rig.pose.bones["upper"].rotation_euler.y == pytest.approx(0.3)
    play(scene)
    assert displaced(still) == []


def test_a_rig_in_rest_position_is_not_looked_at(scene, still):
    turn_keyed(rig_of(still))
    batch.run(Job(still, "BAKE"))
    rig_of(still).data.pose_position = "REST"
    play(scene)
    assert displaced(still) == []


def test_keys_that_are_edited_later_are_not_taken_for_a_handler_s(scene, still, called):
    called("frame_change_pre", harmless)
    batch.run(Job(still, "BAKE"))
    lower = rig_of(still).pose.bones["lower"]
    with soon():
        for frame, angle in ((1, 0.0), (20, 1.0)):
            lower.rotation_euler.x = angle
            lower.keyframe_insert("rotation_euler", frame=frame)
        bpy.context.view_layer.update()
        play(scene)
    assert displaced(still) == [] and staleness.outdated(still)
    play(scene)
    assert displaced(still) == []


def test_of_a_long_bake_the_first_frames_are_kept(scene, still, monkeypatch):
    count = len(rig_of(still).data.bones) + 2
    monkeypatch.setattr(read_poses, "KEPT", 48 * count * 5)
    batch.run(Job(still, "BAKE", frames=(3, 20)))
    frames = opened.read_poses[still.session_uid].frames
    assert list(frames) == [3, 4, 5, 6, 7] and frames[3].shape == (count, 3, 4)


# Settings ------------------------------------------------------------------------------------------------------------


FOLLOWED = (
    "dynamorph.targets[0].stiffness",
    "dynamorph.targets[0].amount",
    "dynamorph.channels[0].value",
    "dynamorph.grips[0].strength",
    "dynamorph.simulation.amount",
    "dynamorph.collision.distance",
    "dynamorph.collision.friction",
)


def properties_in(group):
    """(group, name) of all properties in a group, with an element in each list."""
    for name, prop in group.bl_rna.properties.items():
        value = getattr(group, name)
        if prop.type == "COLLECTION" and not value:
            value.add()
        if prop.type not in {"COLLECTION", "POINTER"}:
            yield group, name
        elif isinstance(prop.fixed_type, bpy.types.PropertyGroup):
            yield from properties_in(value[0] if prop.type == "COLLECTION" else value)


def keyed(obj, path):
    """Keys as in a file of a version that let every property have them; they want 3."""
    assert obj.keyframe_insert(FOLLOWED[0], frame=1)
    (curve,) = animation.played(obj.animation_data)
    curve.data_path, curve.keyframe_points[0].co[1] = path, 3.0


def driven(obj, path):
    curve = obj.driver_add(FOLLOWED[0])
    curve.data_path, curve.driver.expression = path, "3 + 0 * frame"


@pytest.mark.parametrize("animate", ["keyframe_insert", "driver_add"])
def test_only_what_a_simulation_follows_can_be_animated(soft_arm, animate):
    found, properties = [], list(properties_in(soft_arm.dynamorph))
    for group, name in (*properties, *properties_in(bpy.context.window_manager.dynamorph)):
        try:
            assert getattr(group, animate)(name)
            found.append(group.path_from_id(name))
        except TypeError as error:
            assert "not animatable" in str(error)
    assert len(properties) > 130 and sorted(found) == sorted(FOLLOWED)
    assert notes_of(soft_arm) == []


@pytest.mark.parametrize("animate", [keyed, driven])
@pytest.mark.parametrize(
    "path, label",
    [
        ("dynamorph.targets[0].poisson", "Poisson's Ratio"),
        ("dynamorph.simulation.substeps", "Substeps Per Frame"),
        ("dynamorph.simulation.gravity", "Gravity"),
        ("dynamorph.collision.use_friction", "Override Friction"),
        ("dynamorph.model.cage_nodes", "Cage Nodes"),
    ],
)
def test_a_setting_that_is_animated_stays_and_is_named(scene, soft_arm, animate, path, label):
    before = soft_arm.path_resolve(path)
    animate(soft_arm, path)
    scene.frame_set(5)
    assert soft_arm.path_resolve(path) == before
    (text,) = notes_of(soft_arm)
    assert text.startswith(f"'Arm': keys and drivers of {label} have no effect")


def test_a_bake_says_so_after_the_keys_are_gone(still):
    keyed(still, "dynamorph.simulation.gravity")
    batch.run(Job(still, "BAKE"))
    still.animation_data_clear()
    assert "keys and drivers of Gravity have no effect" in still.dynamorph.bake.warnings
    batch.run(Job(still, "BAKE"))
    assert "Gravity" not in still.dynamorph.bake.warnings


def test_what_animates_an_element_that_is_gone_is_named_by_its_path(soft_arm):
    driven(soft_arm, "dynamorph.targets[1].stiffness")
    soft_arm.dynamorph.targets.remove(1)
    assert any("dynamorph.targets[1].stiffness" in text for text in notes_of(soft_arm))
    assert np.isfinite(soft_arm.dynamorph.targets[0].stiffness)
