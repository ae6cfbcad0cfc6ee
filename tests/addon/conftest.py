# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on inside the bpy wheel, loaded from its sources as Blender loads an installed extension."""

import sys
from functools import partial
from pathlib import Path

import pytest

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parent)]
installed = pytest.importorskip("installed", reason="needs the bpy wheel")  # before bpy

import addon_utils  # noqa: E402
import bpy  # noqa: E402
from bl_ext.user_default.dynamic_morph_targets.core.model import build  # noqa: E402
from bl_ext.user_default.dynamic_morph_targets.core.motion import simulate  # noqa: E402
from bl_ext.user_default.dynamic_morph_targets.run.work import task  # noqa: E402
from bl_ext.user_default.dynamic_morph_targets.scene.remembered import opened  # noqa: E402
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store  # noqa: E402
from threaded import Threaded  # noqa: E402

EXIT = pytest.StashKey[int]()


def pytest_sessionfinish(session, exitstatus):
    session.config.stash[EXIT] = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config):
    """When all is reported."""
    if bpy.app.version < (5, 0) and EXIT in config.stash:
        config.get_terminal_writer().flush()
        installed.leave(config.stash[EXIT])


@pytest.fixture(scope="session")
def addon():
    """The add-on's package, enabled."""
    module = addon_utils.enable(installed.MODULE, default_set=True)
    assert module is not None
    yield module
    addon_utils.disable(installed.MODULE, default_set=True)


@pytest.fixture
def scene(addon):
    """An empty scene; unlike read_factory_settings this keeps the add-on."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    return bpy.context.scene


@pytest.fixture
def arm(scene):
    """A two-bone arm with a Basis, the keys 'flexed' and 'smile', and a bending animation over frames 1 to 20."""
    from builders import make_arm

    return make_arm(scene)


@pytest.fixture
def soft_arm(arm):
    """The arm as a soft skin: neutral, and 'flexed' captured at a bend of 90 degrees (frame 20)."""
    from builders import make_soft

    return make_soft(arm)


@pytest.fixture
def viewport(scene):
    """A 3D view in which the add-on draws; see viewport.Viewport."""
    from viewport import Viewport

    with Viewport() as viewport:
        yield viewport


@pytest.fixture
def stand_in(addon, monkeypatch):
    """Replaces the engine by one that answers at once; see builders.StandIn."""
    from builders import StandIn

    engine = StandIn()
    for module, names in {build: ("dependencies", "stale_reasons"), simulate: ("build_for", "Shot")}.items():
        for name in names:
            monkeypatch.setattr(module, name, partial(_call, engine, name))
    monkeypatch.setattr(model_store, "Model", engine.Model)
    monkeypatch.setattr(task, "Child", Threaded)
    opened.models.clear()
    return engine


@pytest.fixture
def apart(monkeypatch):
    """Work is computed elsewhere, as in a window, so that a test can do something meanwhile."""
    monkeypatch.setattr(task, "worker_for", lambda *args, **options: task.Child(*args, **options))


def _call(engine, name, *arguments, **options):
    """A function of the stand-in as it is then: tests replace some."""
    return getattr(engine, name)(*arguments, **options)
