# SPDX-License-Identifier: GPL-3.0-or-later
"""Presets, with Blender's own machinery: of materials, next to the measured ones, and of whole setups.

A preset is a small script that sets properties of `bpy.context.object`, which is here the mesh that the buttons are
about even when its armature is active.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from typing import Any

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel
from bpy.props import StringProperty
from bpy.types import Menu, Operator, Panel

from ...core.errors import SceneError
from ...core.material import presets
from ...core.settings import Material
from ...scene import skin
from ...scene.registration import of_classes
from ...scene.skin import mesh_in
from ...write.authoring import setups
from ..base import SoftSkinOperator

SHOT = ("use_scene_range", "frame_start", "frame_end")  # settings that belong to one shot


class SavesPreset(AddPresetBase):
    """Mixin: Blender's operator that adds and removes presets, for the mesh that the buttons are about."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        skin = mesh_in(context)
        if skin is None or not skin.dynamorph.active_target:
            cls.poll_message_set("Select a soft skin, and a target in its list")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        with context.temp_override(object=skin.mesh_in(context)):
            return super().execute(context)


class DYNAMORPH_OT_material_preset(SavesPreset, Operator):
    """Save the selected target's properties as a preset, or remove a preset"""

    bl_idname = "dynamorph.material_preset"
    bl_label = "Add Material Preset"
    preset_menu = "DYNAMORPH_PT_material_presets"
    preset_subdir = "dynamorph/material"
    preset_defines = ("target = bpy.context.object.dynamorph.active_target",)
    preset_values = tuple(f"target.{field.name}" for field in fields(Material))


class DYNAMORPH_OT_setup_preset(SavesPreset, Operator):
    """Save the settings of model and simulation as a preset, or remove a preset. Targets and frames are not included"""

    bl_idname = "dynamorph.setup_preset"
    bl_label = "Add Setup Preset"
    preset_menu = "DYNAMORPH_PT_setup_presets"
    preset_subdir = "dynamorph/setup"
    preset_defines = ("skin = bpy.context.object.dynamorph",)

    @property
    def preset_values(self) -> list[str]:
        skin = bpy.context.object.dynamorph
        simulation = [name for name in setups.authored(skin.simulation) if name not in SHOT]
        return [f"skin.model.{name}" for name in setups.authored(skin.model)] + [
            f"skin.simulation.{name}" for name in simulation
        ]


class DYNAMORPH_OT_load_preset(SoftSkinOperator, Operator):
    """Apply this preset"""

    bl_idname = "dynamorph.load_preset"
    bl_label = "Load Soft Skin Preset"
    bl_options = {"UNDO", "INTERNAL"}  # Blender's own operator for this leaves no undo step

    filepath: StringProperty(name="File", description="The preset's file", subtype="FILE_PATH")
    menu_idname: StringProperty(name="Menu", description="The menu that lists the preset")

    def apply(self, obj: bpy.types.Object) -> None:
        try:
            with bpy.context.temp_override(object=obj):
                bpy.ops.script.execute_preset(filepath=self.filepath, menu_idname=self.menu_idname)
        except RuntimeError as error:  # its file is gone or is not a script
            raise SceneError(str(error).strip()) from error


class PresetList(PresetPanel):
    """Mixin: a pop-up that lists presets, with buttons to remove each and to add one."""

    preset_operator = "dynamorph.load_preset"

    def path_menu(self, folders: Iterable[str], *args: Any, **options: Any) -> None:
        # An empty iterator is true, so Blender does not report missing folders before the first preset is saved.
        Menu.path_menu(self, folders or iter(()), *args, **options)


class DYNAMORPH_PT_material_presets(PresetList, Panel):
    bl_label = "Material Presets"
    preset_subdir = DYNAMORPH_OT_material_preset.preset_subdir
    preset_add_operator = DYNAMORPH_OT_material_preset.bl_idname
    preset_operator_defaults = {"menu_idname": "DYNAMORPH_PT_material_presets"}

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.emboss = "PULLDOWN_MENU"
        column = self.layout.column(align=True)
        for key, preset in presets.PRESETS.items():
            column.operator("dynamorph.apply_material", text=preset.label).preset = key
        self.layout.separator()
        PresetPanel.draw(self, context)


class DYNAMORPH_PT_setup_presets(PresetList, Panel):
    bl_label = "Setup Presets"
    preset_subdir = DYNAMORPH_OT_setup_preset.preset_subdir
    preset_add_operator = DYNAMORPH_OT_setup_preset.bl_idname
    preset_operator_defaults = {"menu_idname": "DYNAMORPH_PT_setup_presets"}


CLASSES = (
    DYNAMORPH_OT_material_preset,
    DYNAMORPH_OT_setup_preset,
    DYNAMORPH_OT_load_preset,
    DYNAMORPH_PT_material_presets,
    DYNAMORPH_PT_setup_presets,
)
register, unregister = of_classes(CLASSES)
