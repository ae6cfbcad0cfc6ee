# SPDX-License-Identifier: GPL-3.0-or-later
"""A built model stored with its object, or dropped."""

from __future__ import annotations

from array import array
from pathlib import Path

import bpy

from .. import preferences
from ..core import engine, errors
from ..core.errors import SceneError
from ..io import model_file
from ..scene.character import extract
from ..scene.skin import attached_meshes
from ..scene.store import staleness
from ..scene.store.model_store import PACKED, blend_folder, stale_part, stale_reasons
from .reconcile import reconcile

PACK_LIMIT = 32 * 2**20  # larger models go into a file


def model_path(name: str, packed: bytes, folder: Path | None = None) -> Path | None:
    """The file for a packed model of the object `name` that is too large for the .blend; None for one that is not.

    folder: of the .blend that the model belongs to; by default of the open one. Raises SceneError when there is none.
    Files are named by their content: a copy of the object shares its file, and a new build never overwrites one that
    another .blend may use.
    """
    if len(packed) <= PACK_LIMIT:
        return None
    folders = preferences.model_folders(folder or blend_folder())
    if not folders:
        raise SceneError(
            "The model of '{name}' is large ({size:.0f} MB) and goes into a file beside the .blend: save the .blend "
            "first",
            name=name,
            size=len(packed) / 2**20,
        )
    return folders[0] / f"{model_file.content_id(packed)}.dynamorph"


def keep_model(obj: bpy.types.Object, packed: bytes, file: Path | None = None) -> None:
    """Note a packed model with `obj`: in the .blend, or that it is in a file, which must be there already."""
    obj.pop(PACKED, None)
    if file is None:
        obj[PACKED] = _as_numbers(packed)  # exporters of Blender's own crash on bytes with zeros in them
    obj.dynamorph.model.content_id = model_file.content_id(packed)
    for each in (obj, *attached_meshes(obj)):  # Blender 5 saves what an override notes where the linked object has it
        each.dynamorph.bake.cache = each.dynamorph.bake.cache


def _as_numbers(packed: bytes) -> array:
    numbers = array("i", [len(packed)])
    numbers.frombytes(packed + bytes(-len(packed) % numbers.itemsize))
    return numbers


def fit_modes(obj: bpy.types.Object, count: int) -> None:
    """List the modes of a new model; modes that existed before keep their gain."""
    modes = obj.dynamorph.modes
    while len(modes) > count:
        modes.remove(len(modes) - 1)
    while len(modes) < count:
        modes.add().name = f"Mode {len(modes) + 1:02d}"
    obj.dynamorph.active_mode_index = min(obj.dynamorph.active_mode_index, max(count - 1, 0))


def forget_model(obj: bpy.types.Object) -> None:
    """Delete the model in the .blend. A file stays, because another .blend may use it."""
    obj.pop(PACKED, None)
    record = obj.dynamorph.model
    record.content_id = record.summary = record.cage = record.stale = record.warnings = record.built = ""


def show_stale(obj: bpy.types.Object) -> None:
    """Examine the mesh, and make the panel say why the model and the bake of `obj` are out of date."""
    reconcile(obj)
    stale, part = "", ""
    changes = staleness.model_changes(obj)
    try:
        character = extract.character(obj)
        reasons = stale_reasons(obj, character)
        part = stale_part(obj, character) if reasons else ""
        stale = "" if changes else "; ".join(reasons)  # otherwise they say enough
        staleness.look_at_map(obj, character)
    except engine.expected_errors() as error:
        stale = "" if changes else errors.sentence(error)
    record = obj.dynamorph.model
    if (record.stale, record.stale_part) != (stale, part):
        record.stale, record.stale_part = stale, part
