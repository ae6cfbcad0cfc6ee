# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons that transfer setups: to and from files, and to other meshes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import BoolProperty, StringProperty
from bpy.types import FileHandler, Operator
from bpy_extras.io_utils import ExportHelper, ImportHelper

from ...core.errors import SetupError
from ...io import paths
from ...run.tools.removal import remove_soft_skin
from ...scene import skin
from ...scene.registration import of_classes
from ...write import storage
from ...write.authoring import setups, transfer
from ..base import SoftSkinOperator, listed, report_errors

FAR = 0.03  # of the source's size; meshes that are farther apart were probably not intended


class DYNAMORPH_OT_save_setup(SoftSkinOperator, ExportHelper, Operator):
    """Save targets, materials, poses and settings of the soft skin to a file. Shapes stay in the .blend"""

    bl_idname = "dynamorph.save_setup"
    bl_label = "Save Setup"
    bl_options = {"REGISTER"}
    filename_ext = ".json"

    filter_glob: StringProperty(name="Filter", description="Files that are shown", default="*.json", options={"HIDDEN"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if not self.filepath:  # type: ignore[has-type]  # a property of ExportHelper
            name = f"{paths.clean_name(skin.mesh_in(context).name)}{self.filename_ext}"
            self.filepath = str(Path(bpy.data.filepath).with_name(name)) if bpy.data.filepath else name
        return super().invoke(context, event)

    def apply(self, obj: bpy.types.Object) -> None:
        path = Path(bpy.path.abspath(self.filepath))
        if path.suffix.lower() != self.filename_ext:  # a script may name any file
            raise SetupError("A setup is a .json, '{file}' is not: choose another name", file=path.name)
        setups.write(path, setups.of_object(obj))
        self.report({"INFO"}, rpt_("Setup of '{name}' saved as '{file}'").format(name=obj.name, file=path.name))


class DYNAMORPH_OT_load_setup(SoftSkinOperator, ImportHelper, Operator):
    """Replace the targets, materials, poses and settings of the mesh with those of a file"""

    bl_idname = "dynamorph.load_setup"
    bl_label = "Load Setup"
    needs_soft_skin = False

    filepath: StringProperty(
        name="File Path", description="The setup to load", subtype="FILE_PATH", options={"HIDDEN", "SKIP_SAVE"}
    )
    filter_glob: StringProperty(name="Filter", description="Files that are shown", default="*.json", options={"HIDDEN"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.filepath:  # it was dropped
            return self.execute(context)
        return super().invoke(context, event)

    def apply(self, obj: bpy.types.Object) -> None:
        path = Path(bpy.path.abspath(self.filepath))
        lacking = setups.apply(obj, setups.read(path))
        if obj.dynamorph.model.content_id:
            storage.show_stale(obj)
        self.report({"INFO"}, rpt_("Setup '{file}' applied to '{name}'").format(name=obj.name, file=path.name))
        report_lacking(self, obj, lacking)  # last: the status bar shows the last alone


class DYNAMORPH_FH_setup(FileHandler):
    """Applies a setup that is dropped onto a 3D viewport or the properties."""

    bl_idname = "DYNAMORPH_FH_setup"
    bl_label = "Dynamorph Setup"
    bl_import_operator = "dynamorph.load_setup"
    bl_file_extensions = ".json"

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        shown = context.area is not None and context.area.type in ("VIEW_3D", "PROPERTIES")
        return shown and DYNAMORPH_OT_load_setup.poll(context)


class DYNAMORPH_OT_copy_to_selected(SoftSkinOperator, Operator):
    """Copy this soft skin to the other selected meshes on the armature, with shapes by the nearest point at rest"""

    bl_idname = "dynamorph.copy_to_selected"
    bl_label = "Copy Soft Skin to Selected"

    replace: BoolProperty(
        name="Replace Soft Skins", description="Replace the soft skins of the other meshes together with their bakes"
    )
    overwrite: BoolProperty(
        name="Overwrite Shapes",
        description="Overwrite shape keys and vertex groups of the same name on the other meshes. Otherwise those are "
        "kept",
    )

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        disabled_reason = super().disabled_reason(context)
        if not disabled_reason and not others(context):
            return "Select the other meshes first, then the soft skin"
        return disabled_reason

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """Ask only where there is something to replace or to overwrite."""
        names = {target.name for target in skin.mesh_in(context).dynamorph.targets}
        for obj in others(context):
            keys = obj.data.shape_keys
            if obj.dynamorph.targets or (keys and names.intersection(keys.key_blocks.keys())):
                return context.window_manager.invoke_props_dialog(self)
        return self.execute(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        return report_errors(self, self._copy, skin.mesh_in(context), others(context))

    def _copy(self, source: bpy.types.Object, others: Sequence[bpy.types.Object]) -> None:
        transfer.check(source, others, self.replace)
        setup, size = setups.of_object(source), transfer.size(source)
        setup["attachments"] = [
            each for each in setup["attachments"] if not each["object"]
        ]  # those follow one soft skin
        copies = [transfer.copy(source, obj) for obj in others]
        for obj, made in zip(others, copies, strict=True):
            if obj.dynamorph.targets:
                remove_soft_skin(obj)
            transfer.write(obj, made, self.overwrite)
            report_lacking(self, obj, setups.apply(obj, setup))
            self._report_distance(source, obj, made.distance, size)

    def _report_distance(self, source: bpy.types.Object, obj: bpy.types.Object, distance: float, size: float) -> None:
        names = {"name": obj.name, "source": source.name, "distance": length(distance)}
        self.report({"INFO"}, rpt_("'{name}': at most {distance} away from '{source}'").format(**names))
        if distance > FAR * size:
            text = rpt_("'{name}' is up to {distance} away from '{source}': check that they stand in the same place")
            self.report({"WARNING"}, text.format(**names))


def others(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The selected meshes that are not the one the buttons are about."""
    active = skin.mesh_in(context)
    return [obj for obj in context.selected_objects if obj.type == "MESH" and obj != active]


def report_lacking(operator: bpy.types.Operator, obj: bpy.types.Object, lacking: dict[str, list[str]]) -> None:
    """One warning about everything that a setup names and `obj` does not have."""
    if lacking:
        quoted = {rpt_(kind): [f"'{name}'" for name in names] for kind, names in lacking.items()}
        what = "; ".join(f"{kind} {listed(names)}" for kind, names in quoted.items())
        operator.report(
            {"WARNING"}, rpt_("Left out, because '{name}' does not have them: {what}").format(name=obj.name, what=what)
        )


def length(meters: float) -> str:
    """A length as the scene's units show it."""
    system = bpy.context.scene.unit_settings.system
    return bpy.utils.units.to_string(system, "LENGTH", meters, precision=3).strip()


CLASSES = (DYNAMORPH_OT_save_setup, DYNAMORPH_OT_load_setup, DYNAMORPH_FH_setup, DYNAMORPH_OT_copy_to_selected)
register, unregister = of_classes(CLASSES)
