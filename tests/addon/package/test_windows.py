# SPDX-License-Identifier: GPL-3.0-or-later
"""What differs on Windows inside Blender and is not tested where it is used. Windows is faked."""

import types
from pathlib import Path, PureWindowsPath

import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.scene import skin
from bl_ext.user_default.dynamic_morph_targets.ui.operators import export
from bl_ext.user_default.dynamic_morph_targets.write.bake import cache_player, writer
from bl_ext.user_default.dynamic_morph_targets.write.export import exports
from builders import hand_made_bake
from pressed import invoked


@pytest.fixture
def cached(soft_arm, tmp_path):
    """cached(): the modifier that plays a point cache beside a saved .blend."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))

    def cached():
        writer.write_keys(soft_arm, hand_made_bake(soft_arm, range(1, 5)), cache=tmp_path / "caches" / "Arm.pc2")
        return soft_arm.modifiers[0]

    return cached


def test_the_path_of_a_cache_has_slashes_that_all_systems_take(cached, monkeypatch):
    monkeypatch.setattr(cache_player, "os", types.SimpleNamespace(sep="\\"))
    monkeypatch.setattr(bpy.path, "relpath", lambda path: f"//caches\\{Path(path).name}")
    assert cached().filepath == "//caches/Arm.pc2"


def test_a_cache_on_another_drive_has_its_whole_path(cached, monkeypatch, tmp_path):
    def refused(_path):
        raise ValueError("path is on mount 'C:', start on mount 'D:'")

    monkeypatch.setattr(bpy.path, "relpath", refused)
    assert cached().filepath == str(tmp_path / "caches" / "Arm.pc2")


@pytest.mark.parametrize("path", ["//caches\\Arm.pc2", "C:\\shots\\Arm.pc2", "\\\\server\\shots/Arm.pc2", "Arm.pc2"])
def test_a_cache_that_windows_has_written_is_found_on_every_system(soft_arm, cached, path):
    modifier = cached()
    modifier.filepath = path
    assert skin.cache_modifier(soft_arm) == modifier
    modifier.filepath = path.replace("Arm", "Leg")
    assert skin.cache_modifier(soft_arm) is None


def test_the_dialogs_offer_names_that_windows_takes(soft_arm, tmp_path, monkeypatch):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    monkeypatch.setattr(exports, "check_bake", lambda *_args: None)
    soft_arm.name = "Aux"
    asked = []
    for name in ("DYNAMORPH_OT_export", "DYNAMORPH_OT_save_setup"):
        invoked(soft_arm, name, fileselect_add=lambda operator: asked.append(Path(operator.filepath).name))
    assert [name.partition(".")[0] for name in asked] == ["Aux_", "Aux_"]


def test_two_slashes_are_the_folder_of_the_blend_and_not_a_server(soft_arm, tmp_path, monkeypatch):
    """As Windows has it: a path of its own can tell one from the other no more."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    monkeypatch.setattr(bpy.path, "abspath", lambda path: path.replace("//", "D:\\shots\\"))
    monkeypatch.setattr(export, "Path", PureWindowsPath)
    button = types.SimpleNamespace(filepath="//arm.glb", format="FBX")
    kind = export.DYNAMORPH_OT_export
    button.path = types.MethodType(kind.path, button)
    assert kind.check(button, bpy.context)
    assert button.filepath == "D:\\shots\\arm.fbx"
