# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a built model is stored: in the .blend, or in a file beside it."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ... import preferences
from ...core import errors
from ...core.character import Character
from ...core.errors import SceneError
from ...core.message import joined
from ...core.model import build
from ...core.model.model import CAGE, Model, first_part
from ...io import model_file
from ..character import extract
from ..properties.target_properties import DynamorphTarget
from ..remembered import opened

MOST = 4  # models that are kept in memory

PACKED = "dynamorph_model"  # custom property of the Object: the model's bytes, as whole numbers after their count


def stored_model(obj: bpy.types.Object) -> bytes | None:
    """The packed model of `obj`, or None. Raises ModelFileError when it should exist but does not."""
    packed = obj.get(PACKED)
    if packed is not None:
        return _as_bytes(obj.name, packed)
    content_id = obj.dynamorph.model.content_id
    if not content_id:
        return None
    folders = preferences.model_folders(blend_folder())
    paths = [folder / f"{content_id}.dynamorph" for folder in folders]
    # The id comes from a .blend that may not be trusted: it must not lead out of the folder.
    path = next(filter(Path.is_file, paths), None) if re.fullmatch("[0-9a-f]{32}", content_id) else None
    if path is None:
        places = " and ".join(f"'{folder}'" for folder in folders) or "beside the .blend"
        raise errors.ModelFileError(
            "The model of '{name}' is missing (looked for in {places}): put it back or build again",
            name=obj.name,
            places=places,
        )
    return path.read_bytes()


def _as_bytes(name: str, numbers: object) -> bytes:
    """The inverse of `_as_numbers`; name: of the object. Raises ModelFileError."""
    try:
        numbers = np.asarray(numbers, "<i4")
        count, packed = int(numbers[0]), numbers[1:].tobytes()
        if not 0 <= len(packed) - count < 4:
            raise ValueError
    except (TypeError, ValueError, IndexError):
        raise errors.ModelFileError("The model of '{name}' is damaged: build it again", name=name) from None
    return packed[:count]


def load_model(obj: bpy.types.Object) -> Any:
    """The built model of `obj`, or None. Raises ModelFileError."""
    content_id = obj.dynamorph.model.content_id
    if not content_id:
        return None
    remember(obj, opened.models.get((obj.session_uid, content_id)) or _loaded(obj))
    return opened.models[obj.session_uid, content_id]


def remember(obj: bpy.types.Object, model: Model) -> None:
    """Keep in memory what is stored as the model of `obj`, so that nobody has to read and check it again."""
    key = obj.session_uid, obj.dynamorph.model.content_id
    opened.models.pop(key, None)
    opened.models[key] = model
    while len(opened.models) > MOST:
        del opened.models[next(iter(opened.models))]


def _loaded(obj: bpy.types.Object) -> Model:
    content = stored_model(obj)
    assert content is not None  # the object has a content id
    try:
        return Model.from_arrays(*model_file.unpack(content))
    except errors.ModelFileError as error:
        if PACKED in obj:
            raise errors.ModelFileError("'{name}': {error}", name=obj.name, error=errors.sentence(error)) from error
        file = f"{obj.dynamorph.model.content_id}.dynamorph"
        text = "'{name}', file '{file}': {error}"
        raise errors.ModelFileError(text, name=obj.name, file=file, error=errors.sentence(error)) from error


def stale_reasons(obj: bpy.types.Object, character: Character) -> list[str]:
    """Why the model of `obj` must be built (again); empty when it is up to date."""
    try:
        model = load_model(obj)
    except errors.ModelFileError as error:
        return [errors.sentence(error)]
    return ["not built yet"] if model is None else build.stale_reasons(model, character)


def stale_part(obj: bpy.types.Object, character: Character) -> str:
    """The first part of the model of `obj` that a build makes (again)."""
    try:
        model = load_model(obj)
    except errors.ModelFileError:
        model = None
    return CAGE if model is None else first_part(build.changes(model, character))


def current_model(obj: bpy.types.Object) -> tuple[Model, Character]:
    """(model, character) of an object whose model is up to date, to be simulated as Quality says. Raises SceneError."""
    return _current(obj, extract.character(obj))


def _current(obj: bpy.types.Object, character: Character) -> tuple[Model, Character]:
    reasons = stale_reasons(obj, character)
    if reasons:
        raise SceneError(
            "The model of '{name}' is out of date ({why}): press Build Model first",
            name=obj.name,
            why=joined("; ", reasons),
        )
    return load_model(obj).with_settings(character.settings), character


def live_model(obj: bpy.types.Object) -> tuple[Model, Character]:
    """`current_model` for Live, which shows the Firmness map as it is painted, without a build, and drafts."""
    if obj.session_uid in opened.drafts:
        draft, of_draft = opened.drafts[obj.session_uid]
        return draft.with_settings(replace(draft.settings, solver=obj.dynamorph.model.solver)), of_draft
    character, model = extract.character(obj), None
    with suppress(errors.ModelFileError):  # `_current` says so
        model = load_model(obj)
    if model is None or not build.only_paint_changed(model, character):
        return _current(obj, character)
    return build.repainted(model, character).with_settings(character.settings), character


def fit_input(obj: bpy.types.Object, target: DynamorphTarget) -> tuple[Model, Character, int]:
    """The input of the fits in core/material/fit: (model, character, index there) of one of the object's targets.

    Raises SceneError unless the model is up to date.
    """
    model, character = current_model(obj)
    index = index_in(character, obj, target)
    if index is None:
        raise SceneError(
            "Target '{name}' is not in the model: it is muted, or the Method leaves it out", name=target.name
        )
    return model, character, index


def index_in(character: Character, obj: bpy.types.Object, target: DynamorphTarget) -> int | None:
    """The index of one of the object's targets among those of the simulated character; None if it is not there."""
    names = [each.name for each in character.targets]
    first = 0 if target == obj.dynamorph.targets[0] else 1  # a shape key may be called like the neutral target
    return names.index(target.name, first) if target.name in names[first:] else None


def blend_folder() -> Path | None:
    return Path(bpy.data.filepath).parent if bpy.data.filepath else None
