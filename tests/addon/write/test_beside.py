# SPDX-License-Identifier: GPL-3.0-or-later
"""Side by side: a copy of the soft skin with plain skinning, or with the bake of the other settings."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.scene import skin
from bl_ext.user_default.dynamic_morph_targets.ui.overlays import viewport as overlays_viewport
from bl_ext.user_default.dynamic_morph_targets.write.bake import writer
from bl_ext.user_default.dynamic_morph_targets.write.display import beside as display_beside
from builders import evaluated_points, fingerprint, hand_made_bake, refused
from layout import drawn
from test_attachments import add_attachment, make_sleeve
from test_nla import smile
from test_outputs import written

OPS = bpy.ops.dynamorph
FRAMES = (1, 9, 20)


@pytest.fixture
def baked(soft_arm):
    writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    return soft_arm


def beside(obj):
    """The empty that shows the copy."""
    return display_beside.find(obj)


def standing(obj) -> dict[str, np.ndarray]:
    """World positions (V, 3) of what the viewport shows beside `obj`, by the mesh that it is a copy of, in a frame."""
    depsgraph, shown = bpy.context.evaluated_depsgraph_get(), {}
    for instance in depsgraph.object_instances:
        if instance.is_instance and instance.parent.original == beside(obj) and instance.object.type == "MESH":
            points = np.array([vertex.co for vertex in instance.object.data.vertices])
            world = np.array(instance.matrix_world)
            shown[instance.object.original.name.partition(".")[0]] = points @ world[:3, :3].T + world[:3, 3]
    return shown


def shown_beside(obj, name="Arm") -> np.ndarray:
    """The same of one mesh over the frames, moved back onto the body."""
    points = []
    for frame in FRAMES:
        bpy.context.scene.frame_set(frame)
        points.append(standing(obj)[name] - np.array(beside(obj).location))
    return np.array(points)


def shown(obj) -> np.ndarray:
    points = []
    for frame in FRAMES:
        bpy.context.scene.frame_set(frame)
        points.append(evaluated_points(obj))
    return np.array(points)


def far(first, second) -> float:
    return float(np.abs(first - second).max())


def names(obj) -> tuple[str, str]:
    return overlays_viewport.names_beside(obj, beside(obj))


def test_plain_skinning_stands_beside_a_bake(soft_arm):
    plain = shown(soft_arm)
    writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    soft, before = shown(soft_arm), fingerprint(soft_arm)
    objects = {"objects": ["Arm", "Arm Beside", "Arm Rig", "Arm.001"]}
    assert OPS.compare_beside() == {"FINISHED"}
    assert far(shown_beside(soft_arm), plain) < 1e-5 < far(soft, plain) and far(shown(soft_arm), soft) < 1e-6
    assert fingerprint(soft_arm) == before | objects and names(soft_arm) == ("Bake A", "Bones Only")
    assert "pressed: " in drawn(soft_arm)
    OPS.compare_beside()
    assert beside(soft_arm) is None and fingerprint(soft_arm) == before
    assert not bpy.data.collections and len(bpy.data.meshes) == 1 and len(bpy.data.actions) == 2


def test_the_copy_is_to_be_looked_at_only(baked):
    bpy.context.scene.frame_set(9)
    OPS.compare_beside()
    empty = beside(baked)
    away = np.array(empty.location)
    assert (standing(baked)["Arm"] @ away).min() > (evaluated_points(baked) @ away).max(), "they overlap"
    assert empty.hide_select and empty.hide_render
    assert [obj.name for obj in bpy.context.scene.objects if obj.type == "MESH"] == ["Arm"]
    assert skin.soft_skins(bpy.data.objects) == [baked] and skin.shown_attachments(baked) == []


def test_the_bake_of_the_other_settings_stays_beside(baked, stand_in):
    OPS.compare_beside()
    first = shown(baked)
    OPS.bake()
    assert names(baked) == ("Bake A", "Bones Only"), "the same settings: there is nothing to compare"
    writer.write_keys(baked, hand_made_bake(baked))
    OPS.swap_slot()
    OPS.bake()
    assert names(baked) == ("Bake B", "Bake A")
    assert far(shown_beside(baked), first) < 1e-5 < far(shown(baked), first)
    second = shown(baked)
    OPS.swap_slot()
    OPS.delete_bake()
    assert names(baked) == ("Bones Only", "Bake B") and far(shown_beside(baked), second) < 1e-5
    assert OPS.compare_beside.poll() and "dynamorph.compare_beside" in drawn(baked)
    OPS.compare_beside()
    assert not OPS.compare_beside.poll() and "dynamorph.compare_beside" not in drawn(baked)
    assert [action.name for action in bpy.data.actions if action.name.startswith("Dynamorph")] == []


def test_a_point_cache_stays_beside(soft_arm, tmp_path):
    written(soft_arm, hand_made_bake(soft_arm), tmp_path, format="PC2")
    first = shown(soft_arm)
    OPS.show_plain()
    OPS.compare_beside()
    OPS.swap_slot()
    OPS.delete_bake()
    assert names(soft_arm) == ("Bones Only", "Bake A")
    assert far(shown_beside(soft_arm), first) < 1e-5 < far(shown(soft_arm), first)


def test_what_follows_stands_beside_too(soft_arm):
    sleeve = make_sleeve(soft_arm)
    add_attachment(soft_arm, sleeve)
    plain = shown(sleeve)
    writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    writer.write_keys(sleeve, hand_made_bake(sleeve), skin=soft_arm)
    OPS.compare_beside()
    assert far(shown_beside(soft_arm, "Sleeve"), plain) < 1e-5 < far(shown(sleeve), plain)
    OPS.compare_beside()
    assert {obj.name for obj in bpy.data.objects if obj.type == "MESH"} == {"Arm", "Sleeve"}


def test_undo(baked):
    bpy.ops.ed.undo_push(message="baked")
    OPS.compare_beside()
    bpy.ops.ed.undo_push(message="beside")
    bpy.ops.ed.undo()
    assert beside(bpy.data.objects["Arm"]) is None
    bpy.ops.ed.redo()
    arm = bpy.data.objects["Arm"]
    assert names(arm) == ("Bake A", "Bones Only") and "Arm" in standing(arm)


def test_a_file_is_saved_without_the_copy(baked, stand_in, tmp_path):
    plain = fingerprint(baked)
    OPS.compare_beside()
    OPS.swap_slot()
    OPS.bake()  # the copy's Action is that of the bake that was
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    assert names(baked) == ("Bake B", "Bake A") and "Arm" in standing(baked), "it goes on after saving"
    assert not any(action.is_runtime_data for action in bpy.data.actions)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "arm.blend"))
    arm = bpy.data.objects["Arm"]
    assert beside(arm) is None and len(bpy.data.meshes) == 1 and not bpy.data.collections
    assert [a.name for a in bpy.data.actions if not a.users] == [] and fingerprint(arm) != plain
    assert sorted(obj.name for obj in bpy.data.objects) == ["Arm", "Arm Rig"]
    OPS.compare_beside()
    assert names(arm) == ("Bake B", "Bones Only")


def test_a_file_saved_automatically_loses_the_copy_when_it_is_opened(baked, tmp_path, monkeypatch):
    OPS.compare_beside()
    monkeypatch.setattr(display_beside, "leave_out_of_file", list)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    monkeypatch.undo()
    for block in (*bpy.data.objects, *bpy.data.meshes, *bpy.data.collections):
        assert not block.is_runtime_data
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "arm.blend"))
    assert sorted(obj.name for obj in bpy.data.objects) == ["Arm", "Arm Rig"] and len(bpy.data.meshes) == 1


def test_the_copy_of_a_deleted_body_goes_when_the_file_is_saved(baked, tmp_path):
    OPS.compare_beside()
    bpy.ops.object.select_all(action="DESELECT")
    baked.select_set(True)
    bpy.ops.object.delete()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    assert [obj.type for obj in bpy.context.scene.objects] == ["ARMATURE"] and not bpy.data.collections


@pytest.mark.parametrize("saved", [True, False])
def test_what_is_deleted_while_it_stands_there_is_not_taken_for_a_copy(baked, tmp_path, saved):
    """Two eyes have one mesh, which the other one keeps."""
    left = make_sleeve(baked, "Left")
    right = left.copy()
    right.name = "Right"
    bpy.context.scene.collection.objects.link(right)
    for eye in (left, right):
        add_attachment(baked, eye, "RIGID")
    OPS.compare_beside()
    bpy.context.scene.collection.objects.unlink(left)
    if saved:
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "shot.blend"))
    else:
        OPS.compare_beside()
    assert bpy.data.objects["Right"].type == "MESH" and bpy.data.objects["Right"].data.vertices


def test_an_action_of_the_artist_s_stays_whose_strip_was_deleted_meanwhile(baked):
    keys = smile(baked)
    OPS.compare_beside()
    track = keys.animation_data.nla_tracks[1]
    track.strips.remove(track.strips["Smile"])
    OPS.compare_beside()
    assert "Smile" in bpy.data.actions


def test_when_there_is_nothing_to_compare(soft_arm):
    assert not OPS.compare_beside.poll() and "dynamorph.compare_beside" not in drawn(soft_arm)
    writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    soft_arm.hide_viewport = True
    refused(OPS.compare_beside, "'Arm' is hidden: show it")
    soft_arm.hide_viewport = False
    bpy.ops.object.mode_set(mode="EDIT")
    refused(OPS.compare_beside, "Edit Mode")
    assert beside(soft_arm) is None and [obj.name for obj in bpy.data.objects if obj.type == "EMPTY"] == []


def test_a_turned_view_puts_it_to_its_right(baked, viewport, monkeypatch):
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    eye = area.spaces.active.region_3d
    eye.view_rotation = (0.5, 0.5, 0.5, 0.5)  # from the right: its right is +Y
    with bpy.context.temp_override(window=window, area=area):
        OPS.compare_beside()
    along = np.array(beside(baked).location)
    assert np.abs(along[[0, 2]]).max() < 1e-5 < along[1]
    texts = []
    monkeypatch.setattr(overlays_viewport, "draw_rectangle", lambda *_args: None)
    monkeypatch.setattr(overlays_viewport, "draw_text", lambda text, *_args: texts.append(text))
    viewport.draw("POST_PIXEL")
    assert texts == ["Bake A", "Bones Only"]
