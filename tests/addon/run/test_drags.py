# SPDX-License-Identifier: GPL-3.0-or-later
"""Drags that are recorded in Live are an input of the shot: Live, bakes and other processes drag the skin alike."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import records
from bl_ext.user_default.dynamic_morph_targets.core.errors import RecordError
from bl_ext.user_default.dynamic_morph_targets.core.motion.grab import Grab, as_text, from_text
from bl_ext.user_default.dynamic_morph_targets.io.cache_dir import CacheDir
from bl_ext.user_default.dynamic_morph_targets.run import live
from bl_ext.user_default.dynamic_morph_targets.run.bake import bake_input, batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.run.tools import grabbing
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from builders import activate, evaluated_points, refused, rig_of
from built import BuiltOnce

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

RIGHT = np.array([1.0, 0.0, 0.0])
FIRST, LAST = 4, 8  # frames in which a hand drags
built = BuiltOnce()


@pytest.fixture
def arm(soft_arm, scene):
    settings = soft_arm.dynamorph
    settings.model.cage_nodes, settings.model.modes, settings.simulation.gravity = 200, 8, 0.0
    built.give(soft_arm, 8)
    scene.frame_set(1)
    activate(soft_arm)
    yield soft_arm
    grabbing.end()


def shown(obj) -> np.ndarray:
    return mesh_data.shown_points(obj, bpy.context.evaluated_depsgraph_get()).astype(np.float64)


def played(obj, drags=False, last=12) -> list[np.ndarray]:
    """What Live shows at each frame, with a hand that drags the widest side."""
    scene, found, hand, number = bpy.context.scene, [], None, 0
    scene.frame_set(1)
    for frame in range(1, last + 1):
        if drags and frame == FIRST:
            points = shown(obj)
            place = points[points[:, 0].argmax()]
            hand = grabbing.Grabbing(obj)
            number = hand.take(place, points)
        if hand and frame <= LAST:
            hand.lead(number, place + 0.05 * (frame - FIRST + 1) * RIGHT)
        elif hand:
            hand.let_go(number)
        scene.frame_set(frame)
        found.append(evaluated_points(obj))
    return found


def recorded(obj, **options) -> list[np.ndarray]:
    live.turn_on(obj, bpy.context.scene)
    bpy.ops.dynamorph.record_drags()
    assert grabbing.is_recording(obj)
    found = played(obj, drags=True, **options)
    bpy.ops.dynamorph.record_drags()
    assert not grabbing.is_recording(obj)
    return found


def bake(obj, **options) -> list[np.ndarray]:
    live.turn_off(obj)
    obj.dynamorph.simulation.use_scene_range = True
    batch.run(Job(obj, "BAKE", **options))
    found = []
    for frame in range(1, 13):
        bpy.context.scene.frame_set(frame)
        found.append(evaluated_points(obj))
    return found


def apart(first, second) -> float:
    return max(float(np.abs(a - b).max()) for a, b in zip(first, second, strict=True))


def test_they_play_again_in_live_and_in_a_bake(arm):
    live.turn_on(arm, bpy.context.scene)
    without = played(arm)
    live.turn_off(arm)
    dragged = recorded(arm)
    assert apart(dragged, without) > 0.02
    assert apart(played(arm), dragged) < 1e-6
    assert apart(bake(arm), dragged) < 2e-3  # a bake has fewer keys than coordinates
    live.turn_on(arm, bpy.context.scene)
    arm.dynamorph.simulation.use_drags = False
    assert apart(played(arm), without) < 1e-6


def test_a_bake_is_out_of_date_when_they_change(arm):
    recorded(arm)
    bake(arm)
    assert not staleness.outdated(arm)
    arm.dynamorph.simulation.use_drags = False
    assert staleness.outdated(arm) == ["Recorded Drags changed"]
    arm.dynamorph.simulation.use_drags = True
    assert not staleness.outdated(arm)
    bpy.ops.dynamorph.clear_drags()
    assert staleness.outdated(arm) == ["Recorded Drags changed"] and not arm.dynamorph.simulation.drags


def test_the_armature_may_be_active(arm):
    """As in Pose Mode, in which the tool can be used."""
    live.turn_on(arm, bpy.context.scene)
    activate(rig_of(arm))
    assert bpy.ops.dynamorph.record_drags.poll() and not bpy.ops.dynamorph.clear_drags.poll()
    arm.dynamorph.simulation.drags = records.drags_text([])
    assert bpy.ops.dynamorph.clear_drags.poll()


def test_a_second_recording_adds_to_the_first(arm):
    recorded(arm)
    frames = len(from_text(arm.dynamorph.simulation.drags, 10**6))  # of one vertex each: the skin is coarse
    assert frames == LAST - FIRST + 1
    live.turn_off(arm)
    recorded(arm)
    twice = from_text(arm.dynamorph.simulation.drags, 10**6)
    assert len(twice) == frames and len(twice[FIRST].vertices) == 2


def test_chunks_of_a_shot_drag_as_the_whole_does(arm, tmp_path, monkeypatch):
    """Also where another process goes on in the middle of a drag."""
    recorded(arm)
    expected = bake(arm)
    monkeypatch.setattr(bake_input, "SHORT_CHUNK_FRAMES", 5)
    assert apart(bake(arm, cache_dir=CacheDir(tmp_path)), expected) < 1e-6


def test_what_cannot_be_read_is_a_sentence(arm):
    grab = Grab(np.array([3]), np.zeros((1, 3)), np.ones(1))
    assert as_text({}) == "" and from_text("", 10) == {}
    ((frame, found),) = from_text(as_text({7: grab}), 10).items()
    assert frame == 7 and found.vertices.tolist() == [3]
    for text in ("{", as_text({7: grab}).replace("[3]", "[-3]"), as_text({7: grab}).replace("1.0", "-1.0")):
        with pytest.raises(RecordError, match="cannot be read"):
            from_text(text, 10)
    with pytest.raises(RecordError, match="more vertices"):
        from_text(as_text({7: grab}), 3)
    arm.dynamorph.simulation.drags = "{"
    with pytest.raises(RecordError, match="clear them"):
        bake(arm)
    live.turn_off(arm)
    arm.dynamorph.simulation.drags = ""
    refused(bpy.ops.dynamorph.record_drags, "Press Live")
    refused(bpy.ops.dynamorph.clear_drags, "No drags are recorded")
