# SPDX-License-Identifier: GPL-3.0-or-later
"""The artist's hand in a soft skin that is live: what it pulls, and that nothing else changes."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core.errors import SceneError
from bl_ext.user_default.dynamic_morph_targets.run import live, remembered
from bl_ext.user_default.dynamic_morph_targets.run.tools import grabbing
from bl_ext.user_default.dynamic_morph_targets.scene import events
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.ui.operators import grab
from bl_ext.user_default.dynamic_morph_targets.ui.overlays import hands
from builders import KEPT, evaluated_points, rig_of
from built import BuiltOnce

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")


RIGHT = np.array([1.0, 0.0, 0.0])
built = BuiltOnce()


@pytest.fixture
def live_arm(soft_arm, scene):
    """The soft arm with a coarse model, live at its first frame."""
    settings = soft_arm.dynamorph
    settings.model.cage_nodes, settings.model.modes, settings.simulation.gravity = 200, 8, 0.0
    built.give(soft_arm, 8)
    scene.frame_set(1)
    bpy.ops.dynamorph.live()
    yield soft_arm
    grabbing.end()


def shown(obj) -> np.ndarray:
    return mesh_data.shown_points(obj, bpy.context.evaluated_depsgraph_get()).astype(np.float64)


def softest(obj) -> np.ndarray:
    """A place on the skin that moves well: the widest side, between the joints."""
    points = shown(obj)
    return points[points[:, 0].argmax()]


def held_at(obj, place, led=0.0):
    """The hands, and the number of one that holds the skin there and leads it so far to the right, meters."""
    hand = grabbing.begin(obj)
    number = hand.take(place, shown(obj))
    if led:
        hand.lead(number, place + led * RIGHT)
    return hand, number


def ticks(hand, count):
    return [(hand.tick(), shown(bpy.context.object))[1] for _ in range(count)]


@pytest.mark.parametrize("solver", ["REDUCED", "FULL"])
def test_the_skin_follows_the_hand_and_rings_when_it_lets_go(live_arm, solver):
    live_arm.dynamorph.model.solver = solver
    live.refresh(live_arm)
    before, place = shown(live_arm), softest(live_arm)
    size = np.linalg.norm(np.ptp(before, axis=0))
    hand, number = held_at(live_arm, place)
    ticks(hand, 4)
    still = shown(live_arm)
    hand.lead(number, place + 0.04 * size * RIGHT)
    *_, pulled = ticks(hand, 30)
    moved = pulled[hand.holds[0].vertices] - still[hand.holds[0].vertices]
    assert 0.2 < moved[:, 0].mean() / (0.04 * size) < 1.0
    assert np.linalg.norm(pulled - still, axis=1).max() < 0.05 * size  # nothing is thrown about
    hand.let_go(number)
    after = np.array(ticks(hand, 12)) - still
    along = after[:, np.abs(moved).sum(axis=1).argmax(), 0]
    assert along.min() < 0.2 * moved[:, 0].mean()  # it springs back


def test_a_hand_that_goes_far_is_led_only_so_far_and_drags_stay_finite(live_arm):
    place, random = softest(live_arm), np.random.default_rng(3)
    hand, number = held_at(live_arm, place)
    for _ in range(100):
        hand.lead(number, place + random.normal(scale=100.0, size=3))
        hand.tick()
    points = shown(live_arm)
    size = np.linalg.norm(np.ptp(points, axis=0))
    assert np.isfinite(points).all()
    assert np.linalg.norm(hand.holds[0].goal - place) <= grabbing.FARTHEST * size * 1.2


def test_a_slap_leads_the_skin_in_and_lets_go(live_arm):
    place = softest(live_arm)
    hand, number = held_at(live_arm, place)
    still = ticks(hand, 3)[-1]
    hand.slap(number, -RIGHT)
    vertices = hand.holds[0].vertices
    along = (np.array(ticks(hand, 14)) - still)[:, vertices, 0].mean(axis=1)
    assert along[:4].min() < 0.0 < along[4:].max()  # in, and out again
    assert not hand.holds


def test_what_time_brings_next_discards_what_happened_while_it_stood(live_arm, scene):
    scene.frame_set(2)
    expected = shown(live_arm)
    scene.frame_set(1)
    place = softest(live_arm)
    hand, number = held_at(live_arm, place, 0.3)
    ticks(hand, 5)
    hand.let_go(number)
    grabbing.end()
    scene.frame_set(2)
    np.testing.assert_array_equal(shown(live_arm), expected)


def test_a_hand_acts_in_the_frames_that_follow(live_arm, scene):
    scene.frame_set(2)
    free = shown(live_arm)
    scene.frame_set(1)
    place = softest(live_arm)
    hand, number = held_at(live_arm, place, 0.1)
    scene.frame_set(2)
    assert (shown(live_arm) - free)[hand.holds[0].vertices, 0].mean() > 0.0


def test_letting_go_of_all_shows_what_live_has(live_arm):
    before, place = shown(live_arm), softest(live_arm)
    hand, number = held_at(live_arm, place, 0.1)
    ticks(hand, 10)
    hand.let_go_of_all()
    assert hand.tick()  # it rings
    grabbing.end()
    np.testing.assert_array_equal(shown(live_arm), before)


def test_a_hand_that_holds_still_rests_until_it_is_led_on(live_arm):
    place = softest(live_arm)
    hand, number = held_at(live_arm, place, 0.05)
    *_, before, after = ticks(hand, 200)
    np.testing.assert_array_equal(before, after)
    hand.lead(number, place + 0.1 * RIGHT)
    assert np.abs(ticks(hand, 3)[-1] - after).max() > 1e-4


def test_a_copy_begins_again_where_the_rig_moves_otherwise_and_ends_with_its_model(live_arm, scene):
    before, place = shown(live_arm), softest(live_arm)
    hand, number = held_at(live_arm, place, 0.05)
    ticks(hand, 3)
    rig = rig_of(live_arm)
    rig.animation_data_clear()
    rig.pose.bones["lower"].rotation_euler.x = 1.0
    bpy.context.view_layer.update()
    scene.frame_set(1)
    moved = ticks(hand, 3)[-1]
    assert np.abs(moved - before).max() > 0.3
    remembered.live.sessions.pop(live_arm.session_uid)
    assert not hand.tick()
    assert grabbing.begin(live_arm) is not hand  # Live goes on, and so can a new hand


def test_a_hand_in_slow_motion_pulls_as_far_and_lets_go_as_calmly(live_arm):
    """What hardly moves from frame to frame is not at rest then."""
    found = []
    for each in (1.0, 0.03):
        live_arm.dynamorph.simulation.speed = each
        bpy.context.scene.frame_set(1)
        still, place = shown(live_arm), softest(live_arm)
        hand, number = held_at(live_arm, place)
        ticks(hand, 4)
        hand.lead(number, place + 0.05 * RIGHT)
        frames = round(24 / each)  # a second
        *_, pulled = ticks(hand, frames)
        hand.let_go(number)
        assert sum(1 for _ in range(9 * frames) if hand.tick()) < 9 * frames
        found.append((np.abs(pulled - still).max(), np.abs(shown(live_arm) - still).max()))
        grabbing.end()
    (held, left), (held_slowly, left_slowly) = found
    assert held > 0.01 and held_slowly == pytest.approx(held, rel=0.3)
    assert left_slowly < 0.02 * held and left < 0.02 * held


@pytest.mark.parametrize("where, busy", [(events, "is_scrubbing"), (live, "is_away")])
def test_the_hand_waits_for_what_live_waits_for(live_arm, monkeypatch, where, busy):
    place = softest(live_arm)
    hand, number = held_at(live_arm, place, 0.1)
    before = shown(live_arm)
    monkeypatch.setattr(where, busy, lambda *_: True)
    np.testing.assert_array_equal(ticks(hand, 3)[-1], before)
    assert hand.tick()


def test_dead_parts_and_skin_that_is_not_live_are_refused(live_arm):
    with pytest.raises(SceneError, match="This part is rigid"):
        held_at(live_arm, shown(live_arm).max(axis=0) + 10.0)
    bpy.ops.dynamorph.live()
    with pytest.raises(SceneError, match="press Live Soft Skin first"):
        held_at(live_arm, softest(live_arm))


def test_the_hand_is_drawn_with_its_force(live_arm, viewport, monkeypatch):
    drawn = []
    monkeypatch.setattr(hands, "make_batch", lambda kind, points: points)
    monkeypatch.setattr(hands, "draw_lines", lambda points, *_: drawn.append(points))
    monkeypatch.setattr(hands, "draw_points", lambda *_: None)
    monkeypatch.setattr(hands, "draw_text", lambda text, *_: drawn.append(text))
    monkeypatch.setattr(hands, "pixels", lambda length: length)
    monkeypatch.setattr("gpu.state.depth_test_set", lambda _value: None, raising=False)
    viewport.draw("POST_VIEW")
    assert drawn == []
    place = softest(live_arm)
    hand, number = held_at(live_arm, place, 0.1)
    ticks(hand, 10)
    viewport.draw("POST_VIEW")
    viewport.draw("POST_PIXEL")
    line, text = drawn
    at, goal = line
    assert np.allclose(goal, place + 0.1 * RIGHT) and at[0] < goal[0]
    assert text.endswith(" N") and float(text[:-2]) > 0.0


def test_nothing_is_left_in_the_file(live_arm):
    def blocks():
        return {
            name: sorted(each.name for each in getattr(bpy.data, name) if not each.name.startswith(KEPT))
            for name in ("objects", "meshes", "shape_keys")
        }

    before, points = blocks(), evaluated_points(live_arm)
    place = softest(live_arm)
    hand, number = held_at(live_arm, place, 0.1)
    ticks(hand, 5)
    grabbing.end()
    bpy.ops.dynamorph.live()
    assert blocks() == before
    assert np.abs(evaluated_points(live_arm) - points).max() < 0.05


def test_a_hand_that_is_left_is_let_go_by_escape(live_arm):
    assert not bpy.ops.dynamorph.let_go.poll()
    hand, number = held_at(live_arm, softest(live_arm), led=0.05)
    ticks(hand, 2)
    assert bpy.ops.dynamorph.let_go.poll() and bpy.ops.dynamorph.let_go() == {"FINISHED"}
    assert number not in hand.holds and not bpy.ops.dynamorph.let_go.poll()
    keys = [(name, how["type"]) for name, how, _ in grab.DYNAMORPH_TOOL_grab_object.bl_keymap]
    assert ("dynamorph.let_go", "ESC") in keys
