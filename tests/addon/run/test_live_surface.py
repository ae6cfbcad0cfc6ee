# SPDX-License-Identifier: GPL-3.0-or-later
"""While Blender plays, Live writes to what is evaluated next. Whatever else reads or copies the key gets it all the
same.
"""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.run import remembered
from bl_ext.user_default.dynamic_morph_targets.run.playing import live_surface
from bl_ext.user_default.dynamic_morph_targets.scene import events
from bl_ext.user_default.dynamic_morph_targets.write.display import live_key
from builders import evaluated_points, rig_of
from test_live import live_arm, playing, session, surface  # noqa: F401

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")


@pytest.fixture
def in_playback(playing, monkeypatch):  # noqa: F811
    """As if it played in a window; with a list of the frames for which the key was written."""
    monkeypatch.setattr(events, "is_playing", lambda: True)
    frames, write = [], live_key.write
    monkeypatch.setattr(
        live_key, "write", lambda *given: frames.append(bpy.context.scene.frame_current) or write(*given)
    )
    return playing, frames


def test_playback_shows_the_same_without_a_copy_of_the_keys(in_playback, monkeypatch):
    obj, frames = in_playback
    scene, shown = bpy.context.scene, []
    for frame in range(2, 8):
        scene.frame_set(frame)
        shown.append(evaluated_points(obj))
    assert frames == []
    last = shown[-1]
    live_surface.catch_up()  # as at the end of playback
    assert frames == [7] and farthest_moved(evaluated_points(obj), last) == 0.0
    monkeypatch.setattr(events, "is_playing", lambda: False)
    for frame, points in zip(range(2, 8), shown, strict=True):
        scene.frame_set(frame)
        assert farthest_moved(evaluated_points(obj), points) == 0.0
    assert frames == [7, 2, 3, 4, 5, 6, 7]


def farthest_moved(first, second) -> float:
    return float(np.abs(first - second).max())


def test_an_edit_of_a_key_in_playback_does_not_bring_back_an_old_shape(in_playback):
    """Blender copies the keys then."""
    obj, frames = in_playback
    for frame in range(2, 6):
        bpy.context.scene.frame_set(frame)
    shown = evaluated_points(obj)
    obj.data.shape_keys.key_blocks["smile"].slider_max = 2.0
    bpy.context.view_layer.update()
    bpy.context.view_layer.update()
    assert frames == [5] and farthest_moved(evaluated_points(obj), shown) < 1e-6


@pytest.mark.parametrize("handlers", ["frame_change_pre", "frame_change_post"])
def test_where_others_make_blender_copy_the_keys_they_are_written(in_playback, handlers):
    """Another add-on that sets a key for each frame."""
    obj, frames = in_playback

    def tags(*_):
        obj.data.shape_keys.update_tag()

    getattr(bpy.app.handlers, handlers).append(tags)
    try:
        for frame in range(2, 7):
            bpy.context.scene.frame_set(frame)
            bpy.context.view_layer.update()
    finally:
        getattr(bpy.app.handlers, handlers).remove(tags)
    assert frames[-3:] == [4, 5, 6]
    shown = evaluated_points(obj)
    obj.data.shape_keys.update_tag()
    assert farthest_moved(evaluated_points(obj), shown) == 0.0


def test_what_others_collide_with_is_written(in_playback):
    """They are read in a scene of ours, which has the key itself."""
    obj, frames = in_playback
    obj.modifiers.new("Collision", "COLLISION")
    obj.collision.use = True
    for frame in range(2, 5):
        bpy.context.scene.frame_set(frame)
    assert frames == [2, 3, 4]


def test_another_depsgraph_gets_the_key_itself(in_playback, tmp_path):
    """An export while it plays."""
    obj, frames = in_playback
    for frame in range(2, 5):
        bpy.context.scene.frame_set(frame)
    assert frames == [] and remembered.live.ahead
    obj.select_set(True)
    bpy.ops.wm.alembic_export(filepath=str(tmp_path / "a.abc"), start=5, end=7, as_background_job=False)
    assert frames and not remembered.live.ahead


def test_what_moves_in_live_alone_is_written(in_playback):
    """Where the rig stands nothing else evaluates the mesh."""
    obj, frames = in_playback
    rig_of(obj).animation_data_clear()
    session(obj).rig_changed()
    for frame in (2, 3):
        bpy.context.scene.frame_set(frame)
        bpy.context.view_layer.update()
    frames.clear()
    before = evaluated_points(obj)
    skin, key = session(obj).tissue.skin, surface(obj)
    for frame in (4, 5, 6):
        key[:, 2] += 0.01
        moved = key.astype(np.float32).ravel()
        skin.points = lambda _values, moved=moved: moved
        bpy.context.scene.frame_set(frame)
        bpy.context.view_layer.update()
        assert farthest_moved(evaluated_points(obj), before) == pytest.approx(0.01 * (frame - 3), rel=1e-3)
    assert frames == [4, 5, 6]
