# SPDX-License-Identifier: GPL-3.0-or-later
"""Temporary data is gone afterward, also after a failure, and the handlers of other add-ons are not called for it."""

import gc
import types
import weakref

import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.core.motion import player
from bl_ext.user_default.dynamic_morph_targets.run import live
from bl_ext.user_default.dynamic_morph_targets.scene import events
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store
from bl_ext.user_default.dynamic_morph_targets.write.authoring import suggest
from bl_ext.user_default.dynamic_morph_targets.write.bake import writer
from builders import evaluated_points, fingerprint, hand_made_bake, refused
from test_targets import drive

HEARD = ("frame_change_pre", "frame_change_post", "depsgraph_update_pre", "depsgraph_update_post")


@pytest.fixture
def heard():
    """The scenes for which another add-on's handlers are called."""
    evaluated = []

    def handler(scene, *_args):
        evaluated.append(scene.name)

    for name in HEARD:
        getattr(bpy.app.handlers, name).append(handler)
    yield evaluated
    for name in HEARD:
        getattr(bpy.app.handlers, name).remove(handler)


def installed():
    return {name: list(getattr(bpy.app.handlers, name)) for name in HEARD}


def test_other_add_ons_hear_nothing_of_a_bake(scene, soft_arm, stand_in, heard):
    before = installed()
    bpy.ops.dynamorph.bake()
    assert set(heard) <= {scene.name} and installed() == before
    stand_in.fail = errors.SceneError("too soft")
    refused(bpy.ops.dynamorph.bake, "too soft")
    assert set(heard) <= {scene.name} and installed() == before
    heard.clear()
    scene.frame_set(7)
    assert heard == [scene.name, scene.name]


def test_handlers_that_are_added_meanwhile_stay(scene, heard):
    """A driver or a property of another add-on may add one, and what is evaluated may fail."""

    def added(*_args):
        pass

    before = installed()
    with pytest.raises(errors.SceneError), events.without_handlers():
        scene.frame_set(9)
        for name in HEARD:
            getattr(bpy.app.handlers, name).append(added)
        raise errors.SceneError("it fails")
    assert heard == [] and installed() == {name: [*handlers, added] for name, handlers in before.items()}
    for name in HEARD:
        getattr(bpy.app.handlers, name).remove(added)


def test_other_add_ons_go_on_hearing_of_playback_with_live(scene, soft_arm, heard):
    """They do although Live, whose handler is called before theirs, reads the armature at many frames."""
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    soft_arm.dynamorph.model.cage_nodes, soft_arm.dynamorph.model.modes = 200, 8
    bpy.ops.dynamorph.build()
    bpy.ops.dynamorph.live()
    for frame in range(2, 6):
        heard.clear()
        scene.frame_set(frame)
        assert live.problem(soft_arm) == "" and heard == [scene.name, scene.name]


def test_other_add_ons_hear_nothing_of_poses_that_are_tried(scene, arm, heard):
    bpy.ops.dynamorph.add_soft_skin()
    drive(arm, "flexed", "a", a=("ROT_X", "lower"))
    bpy.context.view_layer.update()
    heard.clear()
    assert bpy.ops.dynamorph.suggest_targets() == {"FINISHED"}
    assert set(heard) <= {scene.name}


def test_handlers_are_heard_again_after_a_failure(soft_arm, monkeypatch, heard):
    before = installed()
    clock = types.SimpleNamespace(perf_counter=iter([0.0, 0.0]).__next__)  # fails when the second sample is read
    monkeypatch.setattr(rig_motion, "time", clock)
    with pytest.raises(StopIteration):
        rig_motion.sample_rig(soft_arm, 1, 5, 1)
    assert installed() == before and len(bpy.data.scenes) == 1


def test_a_trial_that_cannot_begin_leaves_nothing(arm, monkeypatch):
    bpy.ops.dynamorph.add_soft_skin()
    drive(arm, "flexed", "a", a=("ROT_X", "lower"))
    before = fingerprint(arm)
    context = types.SimpleNamespace(view_layer=bpy.context.view_layer)  # without a scene
    monkeypatch.setattr(suggest, "bpy", types.SimpleNamespace(data=bpy.data, context=context))
    refused(bpy.ops.dynamorph.suggest_targets, "AttributeError")
    assert fingerprint(arm) == before


@pytest.mark.parametrize("tracks", [0, 1])
def test_curves_that_cannot_be_written_leave_nothing(soft_arm, monkeypatch, tracks):
    """The second one, while so many tracks are there already."""
    before, shown = fingerprint(soft_arm), evaluated_points(soft_arm)
    add_curve, calls = writer.add_curve, []

    def fails_later(*args):
        calls.append(len(soft_arm.data.shape_keys.animation_data.nla_tracks))
        if calls.count(tracks) == 2:
            raise MemoryError
        return add_curve(*args)

    monkeypatch.setattr(writer, "add_curve", fails_later)
    with pytest.raises(MemoryError):
        writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    assert fingerprint(soft_arm) == before and (evaluated_points(soft_arm) == shown).all()


def test_a_model_goes_with_its_file(soft_arm, stand_in):
    bpy.ops.dynamorph.build()
    model = weakref.ref(model_store.load_model(soft_arm))
    assert model() is not None
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    gc.collect()
    assert model() is None


@pytest.mark.parametrize("solver", ["REDUCED", "FULL"])
def test_a_simulation_goes_with_its_bake(soft_arm, solver):
    """The engine asks a simulation whether to go on, which must not keep both alive."""
    soft_arm.dynamorph.model.cage_nodes, soft_arm.dynamorph.model.modes = 120, 5
    soft_arm.dynamorph.model.solver = solver
    assert bpy.ops.dynamorph.bake() == {"FINISHED"}
    gc.collect()
    # Not isinstance, which asks the object itself: what Blender has removed meanwhile would crash.
    assert not [each for each in gc.get_objects() if type(each) is player.Player]
