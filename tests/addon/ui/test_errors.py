# SPDX-License-Identifier: GPL-3.0-or-later
"""One tree of errors for the artist. Whatever else is raised is a bug: a traceback in the log, and a sentence."""

import inspect
import logging
import sys
import types

import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import engine, errors, logger
from bl_ext.user_default.dynamic_morph_targets.run import live
from bl_ext.user_default.dynamic_morph_targets.ui import base as ui_base
from bl_ext.user_default.dynamic_morph_targets.ui.overlays import viewport as overlays_viewport
from bl_ext.user_default.dynamic_morph_targets.write.bake import writer
from builders import fingerprint, refused
from installed import MODULE

LOGGER = "dynamic_morph_targets"


def bugs(caplog):
    """The types of the errors whose tracebacks were logged."""
    return [record.exc_info[0] for record in caplog.records if record.name == LOGGER]


def test_all_errors_of_the_extension_are_one_tree(addon):
    base = errors.DynamorphError
    ours = {
        kind
        for name, module in list(sys.modules.items())
        if name.startswith(MODULE)
        for kind in vars(module).values()
        if inspect.isclass(kind) and issubclass(kind, Exception) and kind.__module__.startswith(MODULE)
    }
    assert len(ours) > 10 and [kind for kind in ours if not issubclass(kind, base)] == []
    assert not issubclass(base, ValueError)


def test_the_artist_sees_these_alone(addon):
    expected = engine.expected_errors()
    assert {errors.DynamorphError, OSError, MemoryError} <= set(expected)
    for bug in (ValueError, TypeError, KeyError, RuntimeError, AttributeError, ReferenceError):
        assert not issubclass(bug, expected)
    dynamorph = pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    assert issubclass(dynamorph.Error, expected)


@pytest.mark.parametrize("bug", [ValueError("shapes (3,) (4,)"), TypeError("no"), KeyError("mesh"), RuntimeError("x")])
def test_a_bug_in_a_button_is_logged_and_reported(soft_arm, stand_in, caplog, bug):
    bpy.ops.dynamorph.bake()
    before = fingerprint(soft_arm)
    stand_in.fail = bug
    refused(bpy.ops.dynamorph.bake, rf"Dynamorph failed \({type(bug).__name__}: .*This is a bug")
    assert bugs(caplog) == [type(bug)] and fingerprint(soft_arm) == before


@pytest.mark.fault("C08")
def test_what_is_expected_is_reported_and_not_logged(soft_arm, stand_in, caplog):
    stand_in.fail = errors.SceneError("'Arm': the tissue is too soft")
    refused(bpy.ops.dynamorph.bake, "^Error: 'Arm': the tissue is too soft")
    stand_in.fail = OSError(28, "No space left on device")
    refused(bpy.ops.dynamorph.bake, "No space left on device")
    stand_in.fail = MemoryError()
    refused(bpy.ops.dynamorph.bake, "not enough memory.*lower Cage Nodes")
    assert bugs(caplog) == []


def test_a_bug_while_keys_are_written_leaves_none(soft_arm, stand_in, monkeypatch, caplog):
    before = fingerprint(soft_arm)
    monkeypatch.setattr(writer, "add_curve", lambda *_args: [][1])
    refused(bpy.ops.dynamorph.bake, "IndexError.*This is a bug")
    assert bugs(caplog) == [IndexError] and fingerprint(soft_arm) == before


def test_a_bug_before_a_button_acts_is_one_too(soft_arm, monkeypatch, caplog):
    def broken(_obj):
        raise AttributeError("reconcile")

    monkeypatch.setattr(ui_base, "reconcile", broken)
    refused(bpy.ops.dynamorph.capture_pose, "AttributeError.*This is a bug")
    assert bugs(caplog) == [AttributeError]


def edited(obj):
    """After this, Live tries again."""
    obj.update_tag()
    bpy.context.view_layer.update()


def test_live_logs_a_bug_once_and_says_it(soft_arm, monkeypatch, caplog):
    scene = bpy.context.scene
    monkeypatch.setattr(live, "simulation_settings", lambda *_args: {}["speed"])
    for _ in range(5):
        scene.frame_set(scene.frame_current + 1)
        live.follow(soft_arm, scene)
        edited(soft_arm)
    live.follow(soft_arm, scene)
    assert "KeyError: 'speed'" in live.problem(soft_arm) and bugs(caplog) == [KeyError]
    edited(soft_arm)
    error = errors.SceneError("'Arm' is hidden")
    monkeypatch.setattr(live, "simulation_settings", lambda *_args: (_ for _ in ()).throw(error))
    live.follow(soft_arm, scene)
    assert live.problem(soft_arm) == "'Arm' is hidden" and bugs(caplog) == [KeyError]


def test_overlays_log_a_bug_once(viewport, soft_arm, monkeypatch, caplog):
    overlays = overlays_viewport
    state = types.SimpleNamespace(**dict.fromkeys(("depth_test_set", "depth_mask_set", "blend_set"), lambda _: None))
    monkeypatch.setattr(overlays, "gpu", types.SimpleNamespace(state=state))
    monkeypatch.setattr(overlays, "painted", lambda *_args: 1 / 0)
    for _ in range(3):
        viewport.draw("POST_VIEW")
    assert bugs(caplog) == [ZeroDivisionError]
    asked = []

    def refuse(*args):
        asked.append(args)
        raise errors.SceneError("no model")

    monkeypatch.setattr(overlays, "painted", refuse)
    viewport.draw("POST_VIEW")
    assert asked and bugs(caplog) == [ZeroDivisionError]


def test_there_is_one_logger(addon):
    assert logger.logger is logging.getLogger(LOGGER)
