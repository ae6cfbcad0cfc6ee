# SPDX-License-Identifier: GPL-3.0-or-later
"""The writer of the format of our own: a whole soft skin."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import bpy

from ...core.errors import ExportError, ModelFileError
from ...io import soft_skin_file
from ...scene.motion import run_settings
from ...scene.motion.rig_motion import sample_present
from ...scene.skin import attached_meshes
from ...scene.skinning import Skinning
from ...scene.store.model_store import current_model, stored_model
from ..actions import Clip


def write_soft_skin(
    obj: bpy.types.Object, _collection: str, path: Path, _frames: tuple[int, int], _takes: Sequence[Clip]
) -> None:
    model, character = current_model(obj)
    gravity = run_settings.simulation_settings(obj, bpy.context.scene).gravity
    path.write_bytes(soft_skin_file.packed(model, character, sample_present(obj), gravity))


def check_soft_skin(obj: bpy.types.Object) -> None:
    """Refuse what the engine cannot pose or step by itself. Raises ExportError."""
    model = obj.dynamorph.model
    if model.method == "STATIC":
        raise ExportError(
            "'{name}': with Method Static there is no motion for a soft skin file: choose another Method", name=obj.name
        )
    if model.solver != "REDUCED":
        raise ExportError(
            "'{name}': a soft skin file has the modes of Reduced Quality: set Quality to Reduced", name=obj.name
        )
    for mesh in (obj, *attached_meshes(obj)):
        beyond = Skinning.of(mesh).beyond_bones
        if beyond:
            raise ExportError(
                "'{name}' is skinned with {beyond}, but programs that read a soft skin file know only plain bones: "
                "remove that first",
                name=mesh.name,
                beyond=beyond,
            )


def model_size(obj: bpy.types.Object) -> int:
    """The bytes of the stored model, which a soft skin file has too; 0 where it is not built yet."""
    try:
        return len(stored_model(obj) or b"")
    except ModelFileError:
        return 0  # it is built first, or refused
