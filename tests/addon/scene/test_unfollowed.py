# SPDX-License-Identifier: GPL-3.0-or-later
"""What moves a skin in Blender and not in a bake is named: drivers, handlers of others, keyed settings."""

import math

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene import events
from bl_ext.user_default.dynamic_morph_targets.scene.check import checks
from bl_ext.user_default.dynamic_morph_targets.scene.motion import handler_check
from builders import rig_of, skinning_of

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


@pytest.mark.parametrize("when", ["frame_change_pre", "frame_change_post"])
@pytest.mark.parametrize("handler, told", [(spring, True), (harmless, False)])
def test_bones_that_a_handler_moves_are_named_by_the_bake(scene, still, when, handler, told):
    handlers = getattr(bpy.app.handlers, when)
    handlers.append(handler)
    scene.frame_set(7)
    before = [list(getattr(bpy.app.handlers, name)) for name in events.EVALUATED]
    job = Job(still, "BAKE")
    try:
        batch.run(job)
    finally:
        after = [list(getattr(bpy.app.handlers, name)) for name in events.EVALUATED]
        handlers.remove(handler)
    assert before == after and scene.frame_current == 7
    found = [text for text in still.dynamorph.bake.warnings.split("\n") if "handler" in text]
    assert len(found) == told
    if told:
        assert found[0].startswith("Bone 'lower' of 'Arm Rig' is moved by an add-on's or script's handler (test_unfol")


def test_without_handlers_of_others_the_scene_stays_at_its_frame(scene, still, monkeypatch):
    seen = []
    monkeypatch.setattr(type(scene), "frame_set", lambda *_args, **_more: seen.append(1), raising=False)
    assert handler_check.warnings(still, 1, 20) == [] and not seen


# Settings ------------------------------------------------------------------------------------------------------------


def keyed(obj, path):
    obj.keyframe_insert(path, frame=1)


def driven(obj, path):
    obj.driver_add(path).driver.expression = "1 + 0 * frame"


@pytest.mark.parametrize("animate", [keyed, driven])
@pytest.mark.parametrize(
    "path, label",
    [
        ("dynamorph.targets[0].stiffness", "Stiffness"),
        ("dynamorph.simulation.gravity", "Gravity"),
        ("dynamorph.collision.distance", "Distance"),
        ("dynamorph.model.cage_nodes", "Cage Nodes"),
    ],
)
def test_a_setting_that_is_animated_is_named(soft_arm, animate, path, label):
    animate(soft_arm, path)
    (text,) = notes_of(soft_arm)
    assert text.startswith(f"'Arm': keys and drivers of {label} have no effect")


def test_a_bake_says_so_after_the_keys_are_gone(still):
    keyed(still, "dynamorph.targets[0].stiffness")
    batch.run(Job(still, "BAKE"))
    still.animation_data_clear()
    assert "keys and drivers of Stiffness have no effect" in still.dynamorph.bake.warnings
    batch.run(Job(still, "BAKE"))
    assert "Stiffness" not in still.dynamorph.bake.warnings


def test_what_animates_an_element_that_is_gone_is_named_by_its_path(soft_arm):
    driven(soft_arm, "dynamorph.targets[1].stiffness")
    soft_arm.dynamorph.targets.remove(1)
    assert any("dynamorph.targets[1].stiffness" in text for text in notes_of(soft_arm))
    assert np.isfinite(soft_arm.dynamorph.targets[0].stiffness)
