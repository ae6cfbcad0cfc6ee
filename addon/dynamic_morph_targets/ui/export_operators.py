# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons that write a baked character as a file of another format, and say beforehand what that leaves out."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import bpy
from bpy.app.handlers import persistent
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import EnumProperty, StringProperty
from bpy.types import Operator
from bpy_extras.io_utils import ExportHelper

from ..core import errors
from ..run import export_actions
from ..scene import events, skin
from ..scene.registration import of_classes
from ..write import comparison, exports, losses
from . import widgets
from .base import SoftSkinOperator, guarded, listed
from .job_operators import JobOperator

LINE = 60  # letters in one of the file browser's side bar
FORMATS = [(key, each.label, each.description) for key, each in exports.FORMATS.items() if each.is_available]
SKINS = [item for item in FORMATS if exports.FORMATS[item[0]].skins]


def draw_losses(layout, lost):
    for text in lost:
        widgets.draw_message(layout, text, width=LINE)


class BakedOperator(SoftSkinOperator):
    """Mixin: works on a soft skin with a bake."""

    @classmethod
    def obstacle(cls, context):
        obstacle = super().obstacle(context)
        return obstacle or ("" if skin.mesh_in(context).dynamorph.bake.exists else "Press Bake first")


class DYNAMORPH_OT_export_check(BakedOperator, Operator):
    """List what the format will not show as Blender does"""

    bl_idname = "dynamorph.export_check"
    bl_label = "Export Check"
    bl_options = {"REGISTER"}

    format: EnumProperty(name="Format", description="What the bake is to be written as", items=FORMATS)

    def apply(self, obj):
        lost = list(losses.losses(obj, self.format))
        for text in lost:
            self.report({"WARNING"}, text)
        label = exports.FORMATS[self.format].label
        if not lost:
            self.report({"INFO"}, rpt_("{format} will show all of '{name}'").format(format=label, name=obj.name))
        elif not bpy.app.background:  # the status bar shows the last alone
            window = bpy.context.window_manager
            window.popup_menu(lambda menu, _: draw_losses(menu.layout, lost), title=label, icon="ERROR")


class DYNAMORPH_OT_export(SoftSkinOperator, ExportHelper, Operator):
    """Write the baked character with its armature over the scene's frames, or simulated for each Action as a clip"""

    bl_idname = "dynamorph.export"
    bl_label = "Export Bake"
    bl_options = {"REGISTER"}

    filename_ext = ""
    check_extension = None

    format: EnumProperty(name="Format", description="What the bake is written as", items=FORMATS)
    clips: EnumProperty(
        name="Clips", description="Which animations the file has",
        items=(
            ("SCENE", "Scene", "One, the bake over the frames of the scene"),
            ("ACTIONS", "One for Each Action", "One for each Action of the armature, for which the flesh is simulated"),
        ),
    )  # fmt: skip
    filter_glob: StringProperty(
        name="Filter", description="Files that are shown", options={"HIDDEN"},
        default=";".join(f"*{each.suffix}" for each in exports.FORMATS.values()),
    )  # fmt: skip

    @classmethod
    def obstacle(cls, context):
        obstacle = super().obstacle(context)
        if not obstacle and comparison.is_plain(skin.mesh_in(context)):
            return "Plain skinning is shown, which is what would be written: press Show Soft Skin first"
        return obstacle

    def invoke(self, context, event):
        return guarded(self, self._ask, context, event)

    def _ask(self, context, event):
        """Open the file browser, unless there is nothing to be written. Raises ExportError."""
        _look_again()
        obj = skin.mesh_in(context)
        if exports.FORMATS[self.format].skins and obj.dynamorph.model.content_id and not obj.dynamorph.bake.exists:
            self.clips = "ACTIONS"  # which needs no bake
        else:
            exports.check_bake(obj, self.format)
        if not self.filepath:
            name = bpy.path.clean_name(skin.mesh_in(context).name)
            self.filepath = str(Path(bpy.data.filepath).with_name(name)) if bpy.data.filepath else name
        self.filepath = str(exports.named(Path(self.filepath), self.format))
        return super().invoke(context, event)

    def draw(self, context):
        layout = self.layout
        layout.prop(self, "format")
        if exports.FORMATS[self.format].skins:
            layout.prop(self, "clips")
        draw_losses(layout, _shown_losses(skin.mesh_in(context).session_uid, self.format, self.chosen_clips))

    def check(self, _context):
        """The name follows the format."""
        path = str(exports.named(Path(self.filepath), self.format))
        changed, self.filepath = path != self.filepath, path
        return changed

    @property
    def chosen_clips(self) -> str:
        return self.clips if exports.FORMATS[self.format].skins else "SCENE"

    def apply(self, obj):
        path = exports.named(Path(bpy.path.abspath(self.filepath)), self.format)
        if self.chosen_clips == "ACTIONS":  # a job of its own, for it takes a while
            return self._start_actions(path)
        scene = bpy.context.scene
        export_actions.export(obj, self.format, path, (scene.frame_start, scene.frame_end))
        report_export(self, obj, path)
        return {"FINISHED"}

    def _start_actions(self, path: Path):
        try:
            bpy.ops.dynamorph.export_actions("INVOKE_DEFAULT", format=self.format, filepath=str(path))
        except RuntimeError as error:  # what it reported
            raise errors.ExportError(str(error).removeprefix("Error: ").strip()) from error
        return {"FINISHED"}


class DYNAMORPH_OT_export_actions(JobOperator, Operator):
    """Simulate the flesh for each Action of the armature, and write all as clips of one file"""

    bl_idname = "dynamorph.export_actions"
    bl_label = "Export Actions"
    bl_options = {"REGISTER", "INTERNAL"}
    goal = "EXPORT_ACTIONS"

    format: EnumProperty(name="Format", description="What the clips are written as", items=SKINS)
    filepath: StringProperty(name="File Path", description="Where the clips are written", subtype="FILE_PATH")

    def _batch(self, obj):
        return export_actions.ActionsExport(obj, self.format, Path(self.filepath))

    def _done(self, batch):
        obj = batch.jobs[0].target()
        for warning in batch.warnings:
            self.report({"WARNING"}, warning)
        report_export(self, obj, batch.path, [clip.name for clip in batch.clips])
        return {"FINISHED"}


@lru_cache(maxsize=16)
def _shown_losses(session_uid: int, format: str, clips: str) -> tuple[str, ...]:
    """What the file browser says of an export, whenever it draws: it takes all weights of the meshes to know."""
    return tuple(losses.losses(skin.find(session_uid), format, clips))


@persistent
def _look_again(*_args):
    """depsgraph_update_post and others: something was edited."""
    _shown_losses.cache_clear()


HANDLERS = dict.fromkeys(("depsgraph_update_post", "undo_post", "redo_post", "load_pre"), _look_again)


def report_export(operator, obj, path: Path, clips=()):
    """What was lost, and where the file is; clips: the names of those of Actions."""
    for text in losses.losses(obj, operator.format, "ACTIONS" if clips else "SCENE"):
        operator.report({"WARNING"}, text)
    text = rpt_("'{name}' written as '{file}': {clips}" if clips else "'{name}' written as '{file}'")
    operator.report({"INFO"}, text.format(name=obj.name, file=path.name, clips=listed(clips)))


_register, _unregister = of_classes((DYNAMORPH_OT_export_check, DYNAMORPH_OT_export, DYNAMORPH_OT_export_actions))


def register():
    _register()
    events.add(HANDLERS)


def unregister():
    events.remove(HANDLERS)
    _unregister()
