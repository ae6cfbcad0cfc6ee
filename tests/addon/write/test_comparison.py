# SPDX-License-Identifier: GPL-3.0-or-later
"""Plain against soft: the mesh as its rig alone moves it, while the bake or Live stays as it is."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.scene import skin
from bl_ext.user_default.dynamic_morph_targets.write.bake import writer
from bl_ext.user_default.dynamic_morph_targets.write.display import comparison
from builders import evaluated_points, fingerprint, hand_made_bake, refused
from layout import drawn
from test_attachments import add_attachment, make_sleeve
from test_outputs import written

OPS = bpy.ops.dynamorph
SAYS = "Plain skinning is shown:"


def shown(obj, frames=(1, 9, 20)) -> np.ndarray:
    points = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        points.append(evaluated_points(obj))
    return np.array(points)


def says_plain(obj) -> bool:
    return SAYS in " ".join(drawn(obj))


def mutes(obj) -> dict[str, bool]:
    return {block.name: block.mute for block in obj.data.shape_keys.key_blocks}


@pytest.mark.parametrize("kind", ["MODES", "PC2"])
def test_a_bake_is_hidden_and_comes_back(soft_arm, tmp_path, kind):
    soft_arm.data.shape_keys.key_blocks["smile"].value = 0.5
    plain = shown(soft_arm)
    written(soft_arm, hand_made_bake(soft_arm), tmp_path, format=kind)
    soft, before = shown(soft_arm), fingerprint(soft_arm)
    assert not says_plain(soft_arm) and np.abs(soft - plain).max() > 1e-3
    assert OPS.show_plain() == {"FINISHED"}
    assert says_plain(soft_arm) and np.abs(shown(soft_arm) - plain).max() < 1e-6
    assert OPS.show_plain() == {"FINISHED"}
    assert not says_plain(soft_arm) and np.abs(shown(soft_arm) - soft).max() < 1e-6
    assert fingerprint(soft_arm) == before


def test_the_targets_own_keys_count_again(soft_arm):
    flexed = soft_arm.data.shape_keys.key_blocks["flexed"]
    flexed.value = 1.0
    plain = shown(soft_arm)
    writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    assert flexed.mute
    OPS.show_plain()
    assert not flexed.mute and np.abs(shown(soft_arm) - plain).max() < 1e-6
    OPS.show_plain()
    assert flexed.mute
    OPS.show_plain()
    OPS.delete_bake()
    assert not flexed.mute and np.abs(shown(soft_arm) - plain).max() < 1e-6


def test_a_key_that_was_muted_stays_so(soft_arm):
    flexed = soft_arm.data.shape_keys.key_blocks["flexed"]
    flexed.mute = True
    writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    OPS.show_plain()
    assert flexed.mute


def test_a_render_that_left_the_cache_out_still_does(soft_arm, tmp_path):
    written(soft_arm, hand_made_bake(soft_arm), tmp_path, format="PC2")
    modifier = skin.cache_modifier(soft_arm)
    for rendered in (True, False):
        modifier.show_render = rendered
        OPS.show_plain()
        assert not modifier.show_viewport and not modifier.show_render
        OPS.show_plain()
        assert modifier.show_viewport and modifier.show_render == rendered


def test_what_follows_is_hidden_too(soft_arm):
    sleeve = make_sleeve(soft_arm)
    add_attachment(soft_arm, sleeve)
    plain = shown(sleeve)
    writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    writer.write_keys(sleeve, hand_made_bake(sleeve), skin=soft_arm)
    soft = shown(sleeve)
    OPS.show_plain()
    assert np.abs(shown(sleeve) - plain).max() < 1e-6 < np.abs(soft - plain).max()
    OPS.show_plain()
    assert np.abs(shown(sleeve) - soft).max() < 1e-6


def test_a_file_is_saved_soft(soft_arm, tmp_path):
    writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    before = mutes(soft_arm)
    OPS.show_plain()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    assert not says_plain(soft_arm)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "arm.blend"))
    arm = bpy.data.objects["Arm"]
    assert not comparison.is_plain(arm) and mutes(arm) == before


def test_undo(soft_arm):
    writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    bpy.ops.ed.undo_push(message="baked")
    OPS.show_plain()
    bpy.ops.ed.undo_push(message="plain")
    bpy.ops.ed.undo()
    assert not comparison.is_plain(bpy.data.objects["Arm"])
    bpy.ops.ed.redo()
    assert comparison.is_plain(bpy.data.objects["Arm"])


@pytest.mark.parametrize("kind", ["MODES", "PC2"])
def test_another_bake_is_shown_soft(soft_arm, stand_in, tmp_path, kind):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    soft_arm.dynamorph.output.format = kind
    OPS.bake()
    soft = shown(soft_arm)
    OPS.show_plain()
    OPS.bake()
    assert not says_plain(soft_arm) and np.abs(shown(soft_arm) - soft).max() < 1e-6


def test_without_anything_to_hide(soft_arm):
    assert not OPS.show_plain.poll()
    writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    assert OPS.show_plain.poll() and "dynamorph.show_plain" in drawn(soft_arm)
    bpy.ops.object.mode_set(mode="EDIT")
    refused(OPS.show_plain, "Edit Mode")
    bpy.ops.object.mode_set(mode="OBJECT")
    soft_arm.shape_key_clear()
    assert not OPS.show_plain.poll()
    drawn(soft_arm)


def test_plain_skinning_is_not_exported(soft_arm):
    writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    assert OPS.export.poll()
    OPS.show_plain()
    assert not OPS.export.poll()
