# SPDX-License-Identifier: GPL-3.0-or-later
"""Writers of the formats of our own: the raw clip of a bake, and a whole soft skin."""

from __future__ import annotations

from pathlib import Path

import bpy

from ...core.errors import ExportError
from ...io import point_cache, soft_skin_file
from ...scene import identity, run_settings
from ...scene.model_store import current_model
from ...scene.rig_motion import sample_present
from ..bake import reading


def write_raw(obj, _collection: str, path: Path, _frames, _takes):
    """One row per frame, whatever the bake's samples are, because players count frames."""
    render = bpy.context.scene.render
    path.write_bytes(point_cache.raw(reading.read_back(obj), identity.body_points(obj), render.fps / render.fps_base))


def write_soft_skin(obj, _collection: str, path: Path, _frames, _takes):
    model, character = current_model(obj)
    gravity = run_settings.simulation_settings(obj, bpy.context.scene).gravity
    path.write_bytes(soft_skin_file.packed(model, character, sample_present(obj), gravity))


def check_soft_skin(obj):
    """Refuse what the engine cannot pose or step by itself. Raises ExportError, SceneError, ModelFileError."""
    model, character = current_model(obj)
    if model.settings.solver != "REDUCED" or model.settings.method == "STATIC":
        raise ExportError(
            "'{name}': a soft skin file has the modes of a reduced model: set Quality to Reduced, and build again",
            name=obj.name,
        )
    if character.probed:
        raise ExportError(
            "'{name}' is skinned in a way that other programs cannot repeat: turn off Preserve Volume and the like in "
            "its Armature modifier",
            name=obj.name,
        )
