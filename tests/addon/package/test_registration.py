# SPDX-License-Identifier: GPL-3.0-or-later
"""A registration that fails leaves nothing behind, wherever it failed; the next one is as good as the first."""

import sys

import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.run import remembered
from bl_ext.user_default.dynamic_morph_targets.run.work import child
from bl_ext.user_default.dynamic_morph_targets.scene import events
from bl_ext.user_default.dynamic_morph_targets.ui.panels import sections
from builders import activate, make_arm, make_soft
from installed import MODULE
from pressed import in_window
from test_undo_and_files import handlers


class Failure(Exception):
    pass


def fail(*_args):
    raise Failure


def classes():
    """The classes of the add-on that Blender knows."""
    kinds = ("Operator", "Panel", "Menu", "UIList", "PropertyGroup", "AddonPreferences", "FileHandler")
    found, pending = [], [getattr(bpy.types, kind) for kind in kinds]
    while pending:
        for kind in pending.pop().__subclasses__():
            pending.append(kind)
            if kind.__module__.startswith(MODULE) and kind.is_registered:
                found.append(kind.__name__)
    return sorted(set(found))


asked = set()  # what timers were to call


def left():
    """All that a registration adds to Blender."""
    events.emit(events.Event.MESH_CHANGED)  # who listens starts a timer
    timers = [look for look in asked if bpy.app.timers.is_registered(look)]
    owners = [owner for owner in (bpy.types.Object, bpy.types.WindowManager) if hasattr(owner, "dynamorph")]
    # Blender has no public name for what was appended to a header or a menu.
    extended = (bpy.types.STATUSBAR_HT_header, bpy.types.TOPBAR_MT_file_export)
    appended = [f for kind in extended for f in kind._dyn_ui_initialize() if f.__module__.startswith(MODULE)]
    return [*classes(), *handlers(), *timers, *owners, *appended]


@pytest.fixture
def timers(addon, monkeypatch):
    """Notes what timers are to call."""
    soon = events.soon
    monkeypatch.setattr(events, "soon", lambda look, seconds: asked.add(look) or soon(look, seconds))


@pytest.fixture
def switched_off(addon, scene, timers):
    """The add-on's package, not registered; at the end it is again."""
    addon.unregister()
    addon.register()  # which also starts a timer
    installed = left()
    addon.unregister()
    assert left() == []
    yield addon
    addon.unregister()
    addon.register()
    assert [type(each) for each in left()] == [type(each) for each in installed] and handlers()


def test_the_next_process_starts_with_the_click_and_ends_when_disabled(addon, scene, monkeypatch):
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    child.dismiss()  # one that a test before has started
    in_window(monkeypatch)
    activate(make_arm(scene))
    assert bpy.ops.dynamorph.add_soft_skin() == {"FINISHED"}
    (spare,) = remembered.work.spare
    assert spare.waits
    addon.unregister()
    addon.register()
    assert spare.ended and remembered.work.spare == []


def test_each_module_may_fail(switched_off, monkeypatch):
    modules = [module for name, module in sys.modules.items() if name.startswith(f"{MODULE}.")]
    registered = [module for module in modules if hasattr(module, "register")]
    assert len(registered) > 15
    for module in registered:
        with monkeypatch.context() as patch:
            patch.setattr(module, "register", fail)
            with pytest.raises(Failure):
                switched_off.register()
        assert left() == [], module
    switched_off.register()
    make_soft(make_arm(bpy.context.scene))


def nth_fails(patch, owner, name, n):
    """Let the n-th call of a function fail; returns how often it was called."""
    original, calls = getattr(owner, name), []

    def counted(*args):
        calls.append(args)
        if len(calls) == n:
            raise Failure
        return original(*args)

    patch.setattr(owner, name, counted)
    return calls


@pytest.mark.parametrize("name", ["register_class", "add", "subscribe"])
def test_each_step_may_fail(switched_off, monkeypatch, name):
    """Each class, and each module's handlers and subscriptions."""
    owner = bpy.utils if name == "register_class" else events
    for n in range(1, 1000):
        with monkeypatch.context() as patch:
            calls = nth_fails(patch, owner, name, n)
            try:
                switched_off.register()
            except Failure:
                assert left() == [], n
        if len(calls) < n:  # no call failed
            break
    assert n > 3 and left()


def test_the_command_line_may_fail(switched_off, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(bpy.utils, "register_cli_command", fail)
        with pytest.raises(Failure):
            switched_off.register()
    assert left() == []


def test_what_cannot_be_taken_back_keeps_nothing_else(switched_off, monkeypatch, caplog):
    """The bug is logged."""
    switched_off.register()
    unregister = sections.unregister
    with monkeypatch.context() as patch:
        patch.setattr(sections, "unregister", fail)
        switched_off.unregister()
    assert [record.exc_info[0] for record in caplog.records] == [Failure]
    assert "DYNAMORPH_OT_bake" not in classes() and handlers() == []
    unregister()
    assert left() == []
