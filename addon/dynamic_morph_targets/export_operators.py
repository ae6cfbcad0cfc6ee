# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons that write a baked character as a file of another format, and say beforehand what that leaves out."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import EnumProperty, StringProperty
from bpy.types import Operator
from bpy_extras.io_utils import ExportHelper

from . import exports, properties
from .operators import SoftSkinOperator

FORMATS = [(key, each.label, each.description) for key, each in exports.FORMATS.items() if each.is_available]


class BakedOperator(SoftSkinOperator):
    """Mixin: works on a soft skin with a bake."""

    @classmethod
    def obstacle(cls, context):
        obstacle = super().obstacle(context)
        return obstacle or ("" if properties.mesh_in(context).dynamorph.bake.exists else "Press Bake first")


class DYNAMORPH_OT_export_check(BakedOperator, Operator):
    """List what the format will not show as Blender does"""

    bl_idname = "dynamorph.export_check"
    bl_label = "Export Check"
    bl_options = {"REGISTER"}

    format: EnumProperty(name="Format", description="What the bake is to be written as", items=FORMATS)

    def apply(self, obj):
        lost = list(exports.losses(obj, self.format))
        for text in lost:
            self.report({"WARNING"}, text)
        if not lost:
            label = exports.FORMATS[self.format].label
            self.report({"INFO"}, rpt_("{format} will show all of '{name}'").format(format=label, name=obj.name))


class DYNAMORPH_OT_export(BakedOperator, ExportHelper, Operator):
    """Write the baked character, with its armature, over the frames of the scene"""

    bl_idname = "dynamorph.export"
    bl_label = "Export Bake"
    bl_options = {"REGISTER"}

    filename_ext = ""
    check_extension = None

    format: EnumProperty(name="Format", description="What the bake is written as", items=FORMATS)
    filter_glob: StringProperty(
        name="Filter", description="Files that are shown", options={"HIDDEN"},
        default=";".join(f"*{each.suffix}" for each in exports.FORMATS.values()),
    )  # fmt: skip

    def invoke(self, context, event):
        if not self.filepath:
            name = bpy.path.clean_name(properties.mesh_in(context).name)
            self.filepath = str(Path(bpy.data.filepath).with_name(name)) if bpy.data.filepath else name
        self.filepath = str(Path(self.filepath).with_suffix(exports.FORMATS[self.format].suffix))
        return super().invoke(context, event)

    def draw(self, context):
        layout = self.layout
        layout.prop(self, "format")
        column = layout.column()
        for text in exports.losses(properties.mesh_in(context), self.format):
            column.label(text=text, icon="ERROR")

    def check(self, _context):
        """The name follows the format."""
        path = str(Path(self.filepath).with_suffix(exports.FORMATS[self.format].suffix))
        changed, self.filepath = path != self.filepath, path
        return changed

    def apply(self, obj):
        scene = bpy.context.scene
        path = Path(bpy.path.abspath(self.filepath)).with_suffix(exports.FORMATS[self.format].suffix)
        exports.export(obj, self.format, path, (scene.frame_start, scene.frame_end))
        for text in exports.losses(obj, self.format):
            self.report({"WARNING"}, text)
        self.report({"INFO"}, rpt_("'{name}' written as '{file}'").format(name=obj.name, file=path.name))


register, unregister = bpy.utils.register_classes_factory((DYNAMORPH_OT_export_check, DYNAMORPH_OT_export))
