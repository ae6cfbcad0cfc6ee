# SPDX-License-Identifier: GPL-3.0-or-later
"""A new soft skin moves in Live with few modes while the others are found, and goes on with all of them."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core.errors import Cancelled, SceneError
from bl_ext.user_default.dynamic_morph_targets.core.model import build
from bl_ext.user_default.dynamic_morph_targets.core.motion import prepared
from bl_ext.user_default.dynamic_morph_targets.io import model_file
from bl_ext.user_default.dynamic_morph_targets.run import live, remembered
from bl_ext.user_default.dynamic_morph_targets.run.tools import preview
from bl_ext.user_default.dynamic_morph_targets.run.tools.first_look import FirstLook
from bl_ext.user_default.dynamic_morph_targets.scene import events, references
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.remembered import opened
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store
from bl_ext.user_default.dynamic_morph_targets.ui.operators import playback
from builders import rig_of
from mathutils import Matrix
from pressed import Pressed

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

SIZE = 2.4  # meters, of the arm


@pytest.fixture
def new_arm(arm, apart):
    """A soft skin that was just added, with a coarse cage and more modes than a draft has."""
    bpy.ops.dynamorph.add_soft_skin()
    model = arm.dynamorph.model
    model.cage_nodes, model.basis, model.modes = 200, "RESPONSES", 80
    arm.dynamorph.simulation.gravity = 0.0
    arm.dynamorph.targets[0].frequency = 1.5
    return arm


def until_it_shows(obj):
    """A first look up to where Live shows the draft, and its steps that are left."""
    work = FirstLook(obj)
    steps = work.steps()
    for _ in steps:
        if work.shows:
            return work, steps
    raise AssertionError("there was no draft")


def shown_at(frame) -> np.ndarray:
    """Points (V, 3) that the live key makes."""
    bpy.context.scene.frame_set(frame)
    return references.key_points(bpy.data.objects["Arm"].data.shape_keys.key_blocks["Dynamorph Live"]).astype(float)


def farthest(first, second) -> float:
    """Fraction of the arm's size."""
    return float(np.linalg.norm(first - second, axis=1).max() / SIZE)


def test_live_goes_on_with_all_modes_where_the_draft_was(new_arm):
    _, steps = until_it_shows(new_arm)
    assert live.is_on(new_arm) and live.problem(new_arm) == "" and not new_arm.dynamorph.model.content_id
    assert remembered.live.sessions[new_arm.session_uid].tissue.modes == build.DRAFT
    played = [shown_at(frame) for frame in range(1, 13)]
    for _ in steps:
        pass
    assert new_arm.dynamorph.model.content_id and live.is_on(new_arm) and live.problem(new_arm) == ""
    assert remembered.live.sessions[new_arm.session_uid].tissue.modes == 80
    after, following = shown_at(12), shown_at(13)
    jump = farthest(played[-1], after)
    before_step, step = farthest(played[-2], played[-1]), farthest(after, following)
    assert 0.2 * before_step < step < 3.0 * before_step  # it swings on
    new_arm.dynamorph.simulation.substeps = 9  # another step: it begins again
    assert jump < 1e-3 and jump < 0.1 * farthest(after, shown_at(12))


def test_the_model_is_that_of_a_plain_build(new_arm):
    plain = build.build(extract.character(new_arm))
    for _ in FirstLook(new_arm).steps():
        pass
    assert model_store.stored_model(new_arm) == model_file.pack(*plain.to_arrays())


def test_nothing_of_a_draft_stays_where_the_build_ends(new_arm):
    work, steps = until_it_shows(new_arm)
    work.cancel()
    with pytest.raises(Cancelled):
        for _ in steps:
            pass
    work.stop()
    assert not live.is_on(new_arm) and not new_arm.dynamorph.model.content_id and not opened.drafts
    assert "Dynamorph Live" not in new_arm.data.shape_keys.key_blocks


def test_a_file_that_is_saved_meanwhile_has_nothing_of_the_draft(new_arm, tmp_path):
    work, _ = until_it_shows(new_arm)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "draft.blend"), copy=True)
    assert live.is_on(new_arm) and not model_store.stored_model(new_arm)
    work.stop()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "draft.blend"))
    (arm,) = (obj for obj in bpy.data.objects if obj.dynamorph.targets)
    assert arm.data.shape_keys.key_blocks.keys() == ["Basis", "flexed", "smile"]
    assert not live.is_on(arm) and not arm.dynamorph.model.content_id and not opened.drafts


def test_a_deleted_soft_skin_has_no_draft(new_arm):
    work, _ = until_it_shows(new_arm)
    bpy.data.objects.remove(new_arm)
    work.stop()
    assert not opened.drafts


def hopping(obj) -> preview.Preview:
    """A preview that has moved the rig, as the hop does."""
    running = preview.begin_preview(obj, bpy.types.DYNAMORPH_OT_shake_test)
    running.show(np.zeros(running.tissue.dofs + 1), Matrix.Translation((0.0, 0.0, 0.3)))
    return running


def test_the_model_is_written_when_the_hop_has_ended(new_arm):
    """Blender stores an undo step then, which must not have the rig where the hop shakes it."""
    work, steps = until_it_shows(new_arm)
    hopping(new_arm)
    while work.message != "Waiting for the test to end":
        next(steps)
    for _ in range(5):
        next(steps)
    assert not new_arm.dynamorph.model.content_id
    preview.end_preview()
    for _ in steps:
        pass
    assert new_arm.dynamorph.model.content_id and live.is_on(new_arm)


def test_a_build_that_ends_in_the_hop_leaves_nothing(new_arm):
    work, steps = until_it_shows(new_arm)
    hopping(new_arm)
    work.cancel()
    with pytest.raises(Cancelled):
        for _ in steps:
            pass
    work.stop()
    assert remembered.live.preview is None and rig_of(new_arm).delta_location.length == 0.0
    assert not live.is_on(new_arm) and "Dynamorph Live" not in new_arm.data.shape_keys.key_blocks


def test_a_draft_keeps_its_bounce_when_settings_change(new_arm):
    """Blender's targets have the stiffness that the draft plays with."""
    work, _ = until_it_shows(new_arm)
    before = remembered.live.sessions[new_arm.session_uid].tissue.character.material(0).stiffness
    new_arm.dynamorph.simulation.gravity = 1.0
    shown_at(2)
    after = remembered.live.sessions[new_arm.session_uid].tissue.character.material(0).stiffness
    assert after == pytest.approx(before, rel=1e-6)
    session = remembered.live.sessions[new_arm.session_uid]
    new_arm.dynamorph.model.solver = "FULL"
    shown_at(3), shown_at(4)
    assert remembered.live.sessions[new_arm.session_uid] is not session and live.problem(new_arm) == ""
    session = remembered.live.sessions[new_arm.session_uid]
    shown_at(5)
    assert remembered.live.sessions[new_arm.session_uid] is session
    work.stop()


def test_a_bounce_that_is_set_while_the_draft_plays_stays(new_arm):
    """And the build makes its stiffness, as it would of one that was there before."""
    _, steps = until_it_shows(new_arm)
    target = new_arm.dynamorph.targets[0]
    before = target.stiffness
    target.bounce = 3.0
    for _ in steps:
        pass
    assert target.bounce == pytest.approx(3.0, rel=1e-5)
    assert target.stiffness == pytest.approx(4.0 * before, rel=0.05)  # of 1.5 Hz; damping changes it a little


def test_a_render_sees_no_draft(new_arm, monkeypatch):
    work = FirstLook(new_arm)
    steps = work.steps()
    next(steps)  # it has read the character
    monkeypatch.setattr(events, "render_runs", lambda: True)
    while work.message != "Waiting for the render to end":
        next(steps)
    assert not work.shows and not live.is_on(new_arm)
    monkeypatch.undo()
    for _ in steps:
        pass
    assert new_arm.dynamorph.model.content_id


def test_it_hops_once_and_as_soon_as_it_shows(new_arm, monkeypatch):
    pressed = []
    monkeypatch.setattr(
        playback, "press", lambda _by, name, **_: pressed.append((name, bool(new_arm.dynamorph.model.content_id)))
    )
    seen = Pressed(new_arm, operator="DYNAMORPH_OT_first_look")
    assert seen.result == {"FINISHED"} and live.is_on(new_arm)
    assert pressed == [("dynamorph.shake_test", False)]


def test_few_modes_need_no_draft(new_arm, monkeypatch):
    new_arm.dynamorph.model.modes = build.DRAFT
    monkeypatch.setattr(playback, "press", lambda *_, **__: None)
    work = FirstLook(new_arm)
    for _ in work.steps():
        assert not work.shows
    assert new_arm.dynamorph.model.content_id


def test_live_begins_again_where_other_nodes_are_pinned(new_arm):
    """The cage stays, but its modes move other nodes."""
    new_arm.dynamorph.model.hold = "BONES"
    bpy.ops.dynamorph.build()
    bpy.ops.dynamorph.live()
    first = shown_at(1)
    group = new_arm.vertex_groups.new(name="Firmness")
    group.add([vertex.index for vertex in new_arm.data.vertices if vertex.co.z > 1.5], 1.0, "REPLACE")
    new_arm.dynamorph.firmness_group = group.name
    bpy.ops.dynamorph.build()
    assert live.is_on(new_arm) and live.problem(new_arm) == ""
    assert np.isfinite(shown_at(2)).all() and farthest(first, shown_at(1)) < 0.1


def test_what_live_cannot_play_is_built_nevertheless(new_arm, monkeypatch):
    """Live says what prevents it when the model is there."""

    def refuse(*_given):
        raise SceneError("Not this one")

    prepared.forget()
    monkeypatch.setattr(prepared, "motion_limit", refuse)
    for _ in FirstLook(new_arm).steps():
        pass
    assert new_arm.dynamorph.model.content_id
