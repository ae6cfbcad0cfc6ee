# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on's preferences: what the user wants on this computer, whatever the file."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.props import IntProperty, StringProperty
from bpy.types import AddonPreferences

from .core.engine import installed_version, use_threads

MODEL_FOLDER = "//dynamorph_models"  # beside the .blend


def _threads_changed(chosen: DynamorphPreferences, _context: bpy.types.Context) -> None:
    use_threads(chosen.threads)


class DynamorphPreferences(AddonPreferences):
    """Where large models go and how much of the computer is used."""

    bl_idname = __package__

    model_folder: StringProperty(
        name="Model Folder",
        description="Folder for models that are too large for the .blend. // is the folder of the .blend",
        default=MODEL_FOLDER, subtype="DIR_PATH", options={"PATH_SUPPORTS_BLEND_RELATIVE"},
    )  # fmt: skip
    threads: IntProperty(
        name="Threads", description="How many threads the engine uses. 0 uses as many as there are cores",
        default=0, min=0, max=1024, soft_max=64, update=_threads_changed,
    )  # fmt: skip

    def draw(self, _context: bpy.types.Context) -> None:
        from .core import engine

        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "model_folder")
        layout.prop(self, "threads")
        problem = engine.engine_problem()
        layout.label(text=problem or _engine_version(), icon="ERROR" if problem else "CHECKMARK", translate=False)


def _engine_version() -> str:
    version = installed_version()
    return iface_("Engine: version {version}").format(version=version) if version else iface_("Engine: ready")


def _chosen() -> DynamorphPreferences | None:
    """None when the add-on was registered by a script, without Blender's list of add-ons."""
    addon = bpy.context.preferences.addons.get(__package__)
    return addon and addon.preferences


def model_folders(blend_folder: Path | None) -> list[Path]:
    """Where large models of a .blend in this folder (None: not saved yet) may be; new ones go into the first.

    The .blend may come from somebody with other preferences, so that the default is always one of them.
    """
    chosen = _chosen()
    paths = dict.fromkeys([(chosen and chosen.model_folder) or MODEL_FOLDER, MODEL_FOLDER])
    relative_to = blend_folder and str(blend_folder)
    return [
        Path(bpy.path.abspath(path, start=relative_to)) for path in paths if blend_folder or not path.startswith("//")
    ]


def register() -> None:
    bpy.utils.register_class(DynamorphPreferences)
    chosen = _chosen()
    use_threads(chosen.threads if chosen else 0)


def unregister() -> None:
    if DynamorphPreferences.is_registered:
        bpy.utils.unregister_class(DynamorphPreferences)
