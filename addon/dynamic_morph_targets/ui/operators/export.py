# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons that write a character to another format, and list beforehand what that format leaves out."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import bpy
from bpy.app.handlers import persistent
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import EnumProperty, StringProperty
from bpy.types import Operator
from bpy_extras.io_utils import ExportHelper

from ...core import errors, states
from ...core.message import translated
from ...io import paths
from ...run.bake import export_actions
from ...scene import events, skin
from ...scene.registration import of_classes
from ...scene.remembered import opened
from ...write.display import comparison
from ...write.export import exports, losses
from .. import widgets
from ..base import SoftSkinOperator, listed, report_errors, reported
from .jobs import JobOperator

LINE = 60  # characters per line of a pop-up
FORMATS = [
    (key, each.label, each.description, number)
    for number, (key, each) in enumerate(exports.FORMATS.items())
    if each.is_available
]
SKINS = [item for item in FORMATS if exports.FORMATS[item[0]].skins]


def _has_name(filepath: str) -> bool:
    """Whether it is not empty or a folder's."""
    return not filepath.endswith(("/", "\\")) and bool(filepath)


def draw_losses(layout: bpy.types.UILayout, lost: Iterable[str], width: int | None = None) -> None:
    for text in lost:
        widgets.draw_message(layout, text, width=width)


class DYNAMORPH_OT_export_check(SoftSkinOperator, Operator):
    """List everything that the format will not show as Blender does"""

    bl_idname = "dynamorph.export_check"
    bl_label = "Export Check"
    bl_options = {"REGISTER"}

    format: EnumProperty(name="Format", description="File format of the export", items=FORMATS)

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        disabled_reason = super().disabled_reason(context)
        if disabled_reason:
            return disabled_reason
        settings = skin.mesh_in(context).dynamorph
        return "" if settings.bake.exists or settings.model.content_id else "Press Bake first"

    def apply(self, obj: bpy.types.Object) -> None:
        exports.check_bake(obj, self.format)
        lost = list(losses.losses(obj, self.format))
        label = exports.FORMATS[self.format].label
        if not lost:
            self.report({"INFO"}, rpt_("{format} will show everything of '{name}'").format(format=label, name=obj.name))
        elif bpy.app.background:
            self.warn(lost)
        else:  # the status bar would show the last alone
            window = bpy.context.window_manager
            window.popup_menu(lambda menu, _: draw_losses(menu.layout, lost, LINE), title=label, icon="ERROR")


class DYNAMORPH_OT_export(SoftSkinOperator, ExportHelper, Operator):
    """Write the character to a file for other programs: its bake, one clip per Action, or the soft skin itself"""

    bl_idname = "dynamorph.export"
    bl_label = "Export Bake"
    bl_options = {"REGISTER"}

    filename_ext = ""
    check_extension = None

    format: EnumProperty(name="Format", description="File format of the export", items=FORMATS)
    clips: EnumProperty(
        name="Clips", description="Which animations the file contains",
        items=(
            ("SCENE", "Scene", "One animation: the bake over the frames of the scene", 0),
            (
                "ACTIONS", "One for Each Action",
                "One animation for each Action of the armature, each simulated on its own",
                1,
            ),
        ),
    )  # fmt: skip
    filter_glob: StringProperty(
        name="Filter", description="Pattern of the files that are shown", options={"HIDDEN"},
        default=";".join(f"*{each.suffix}" for each in exports.FORMATS.values()),
    )  # fmt: skip

    @classmethod
    def disabled_reason(cls, context: bpy.types.Context) -> str:
        disabled_reason = super().disabled_reason(context)
        if not disabled_reason and comparison.is_plain(skin.mesh_in(context)):
            return "Plain skinning is shown and would be exported: press Show Soft Skin first"
        return disabled_reason

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return report_errors(self, self._ask, context, event)

    def _ask(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser if there is something to write. Raises ExportError."""
        _look_again()
        obj = skin.mesh_in(context)
        if exports.FORMATS[self.format].skins and obj.dynamorph.model.content_id and not obj.dynamorph.bake.exists:
            self.clips = "ACTIONS"  # which needs no bake
        else:
            exports.check_bake(obj, self.format)
        if not _has_name(self.filepath):  # type: ignore[has-type]  # a property of ExportHelper
            name = paths.clean_name(skin.mesh_in(context).name)
            self.filepath = str(Path(bpy.data.filepath).with_name(name)) if bpy.data.filepath else name
        self.filepath = str(self.path())
        return super().invoke(context, event)

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.prop(self, "format")
        if exports.FORMATS[self.format].skins:
            layout.prop(self, "clips")
        lost = _shown_losses(skin.mesh_in(context).session_uid, self.format, self.chosen_clips)
        draw_losses(layout, lost)

    def check(self, _context: bpy.types.Context) -> bool:
        """The file name follows the format."""
        if not _has_name(self.filepath):
            return False  # the artist is about to type it
        path = str(self.path())
        changed, self.filepath = path != self.filepath, path
        return changed

    @property
    def chosen_clips(self) -> str:
        return self.clips if exports.FORMATS[self.format].skins else "SCENE"

    def apply(self, obj: bpy.types.Object) -> set[str]:
        path = self.path()
        if self.chosen_clips == "ACTIONS":  # it takes a while, so it is a job of its own
            return self._start_actions(path)
        scene = bpy.context.scene
        export_actions.export(obj, self.format, path, (scene.frame_start, scene.frame_end))
        report_export(self, obj, path)
        return {"FINISHED"}

    def path(self) -> Path:
        """Where the file goes. Raises ExportError."""
        if not _has_name(self.filepath):
            raise errors.ExportError("There is no file name: type one")
        absolute = bpy.path.abspath(self.filepath)  # Windows would take // for the name of a server
        return exports.named(Path(absolute), self.format)

    def _start_actions(self, path: Path) -> set[str]:
        try:
            bpy.ops.dynamorph.export_actions("INVOKE_DEFAULT", format=self.format, filepath=str(path))
        except RuntimeError as error:  # what it reported
            raise errors.ExportError(reported(error)) from error
        return {"FINISHED"}


class DYNAMORPH_OT_export_actions(JobOperator, Operator):
    """Simulate the soft skin for each Action of the armature, and write all of them as clips of one file"""

    bl_idname = "dynamorph.export_actions"
    bl_label = "Export Actions"
    bl_options = {"REGISTER", "INTERNAL"}
    goal = "EXPORT_ACTIONS"

    format: EnumProperty(name="Format", description="File format of the clips", items=SKINS)
    filepath: StringProperty(name="File Path", description="File to which the clips are written", subtype="FILE_PATH")

    def _batch(self, obj: bpy.types.Object) -> export_actions.ActionsExport:
        return export_actions.ActionsExport(obj, self.format, Path(self.filepath))

    def _done(self, batch: export_actions.ActionsExport) -> set[str]:
        obj = batch.jobs[0].target()
        for warning in batch.warnings:
            self.report({"WARNING"}, translated(warning, rpt_))
        report_export(self, obj, batch.path, [clip.name for clip in batch.clips])
        return {"FINISHED"}


@states.cached(opened, 16)
def _shown_losses(session_uid: int, format: str, clips: str) -> tuple[str, ...]:
    """What the file browser says of an export, whenever it draws: it takes all weights of the meshes to know."""
    return tuple(losses.losses(skin.find(session_uid), format, clips))


@persistent
def _look_again(*_args: object) -> None:
    """depsgraph_update_post and others: something was edited."""
    _shown_losses.cache_clear()


HANDLERS = dict.fromkeys(("depsgraph_update_post", "undo_post", "redo_post", "load_pre"), _look_again)


def report_export(operator: bpy.types.Operator, obj: bpy.types.Object, path: Path, clips: Sequence[str] = ()) -> None:
    """What was lost, unless the dialog has said it, and where the file is; clips: the names of those of Actions."""
    lost = () if operator.options.is_invoke else losses.losses(obj, operator.format, "ACTIONS" if clips else "SCENE")
    for text in lost:
        operator.report({"WARNING"}, translated(text, rpt_))
    text = rpt_("'{name}' written as '{file}': {clips}" if clips else "'{name}' written as '{file}'")
    operator.report({"INFO"}, text.format(name=obj.name, file=path.name, clips=listed(clips)))


def draw_in_file_menu(menu: bpy.types.Menu, _context: bpy.types.Context) -> None:
    """In File > Export, below Blender's own formats."""
    menu.layout.operator_context = "INVOKE_DEFAULT"  # ask for the file also where a shortcut has called the menu
    menu.layout.operator("dynamorph.export", text="Soft Skin")


_register, _unregister = of_classes((DYNAMORPH_OT_export_check, DYNAMORPH_OT_export, DYNAMORPH_OT_export_actions))


def register() -> None:
    _register()
    bpy.types.TOPBAR_MT_file_export.append(draw_in_file_menu)
    events.add(HANDLERS)


def unregister() -> None:
    events.remove(HANDLERS)
    bpy.types.TOPBAR_MT_file_export.remove(draw_in_file_menu)
    _unregister()
