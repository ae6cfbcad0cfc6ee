# SPDX-License-Identifier: GPL-3.0-or-later
"""A bake on a library override: a point cache, because Blender saves neither the shape keys of a linked mesh nor their
curves.

It saves a modifier that was added, its values, drivers and keyframes, and the properties of the Object that are
overridable, as what is noted about the bake. The cache plays over all shape keys, so that none needs to be muted.
"""

from __future__ import annotations

from pathlib import Path

import bpy

from ...core.errors import WriteError
from ...core.message import Message
from ...core.motion.baked import Bake
from ...scene.skin import cache_modifier
from .cache_player import play_cache
from .removal import remove_modifier


def refused_format(obj: bpy.types.Object, skin: bpy.types.Object | None = None) -> str:
    """Why the bakes of an override would not be saved, or ''. skin: as of `check`."""
    if (skin or obj).dynamorph.output.format == "PC2":
        return ""
    return Message(
        "'{name}' is a library override, which keeps no shape keys: choose the Format Point Cache (PC2), or make "
        "it local",
        name=obj.name,
    )


def check(obj: bpy.types.Object, skin: bpy.types.Object | None = None) -> None:
    """Refuse, before any work, what the bake of an override cannot be written to. Raises WriteError.

    skin: the soft skin that `obj` is to follow, if it is none itself.
    """
    text = refused_format(obj, skin)
    if text:
        raise WriteError(text)
    if obj.mode == "EDIT":
        text = "'{name}' is in Edit Mode: leave it first"
    elif obj.dynamorph.live.key.name:
        text = "'{name}' is live in the file that it is linked from: turn Live off there"
    elif _plays_library_cache(obj):
        text = "'{name}' plays a point cache of the file that it is linked from: delete the bake there"
    elif not _is_noted(obj):
        text = "'{name}' is linked from a file of an earlier version: open that, press Build Model and save it"
    if text:
        raise WriteError(text, name=obj.name)


def is_baked(obj: bpy.types.Object) -> bool:
    """Whether an override has a bake of its own."""
    return cache_modifier(obj) is not None and not _plays_library_cache(obj)


class OverrideBake:
    """A bake of an override that takes the place of another, in the steps of `writer.NewBake`. What they change is what
    `Before.restore` puts back.
    """

    size = 0  # bytes of keys and curves

    def __init__(self, obj: bpy.types.Object, bake: Bake, skin: bpy.types.Object | None, cache: Path | None):
        """Changes nothing yet. Raises WriteError."""
        check(obj, skin)
        assert cache is not None  # the only form
        self._obj, self._bake, self._skin, self._cache = obj, bake, skin, cache

    def add(self) -> None:
        """The cache is a file already."""

    def take_back(self) -> None:
        """There is nothing beside the old bake."""

    def show(self) -> None:
        """Let it be the bake of its object."""
        record = self._obj.dynamorph.bake
        self._obj.dynamorph.follows = self._skin
        play_cache(self._obj, self._cache, self._bake, self._skin)
        record.slot = (self._skin or self._obj).dynamorph.live.slot
        record.summary = record.warnings = record.verdict = ""
        record.off_full = -1.0

    def remove_old(self) -> list:
        """Its modifier plays the new file."""
        return []


def free(obj: bpy.types.Object) -> None:
    """Remove the bake of an override. What its own file shows plays again."""
    if is_baked(obj):
        remove_modifier(obj, cache_modifier(obj))
    reference = obj.override_library.reference
    for name, prop in obj.dynamorph.bake.bl_rna.properties.items():
        if not (prop.is_readonly or prop.type in {"POINTER", "COLLECTION"}):
            setattr(obj.dynamorph.bake, name, getattr(reference.dynamorph.bake, name))
    if reference.dynamorph.follows is None:  # otherwise it follows the override of that one
        obj.dynamorph.follows = None


def _plays_library_cache(obj: bpy.types.Object) -> bool:
    modifier = cache_modifier(obj)
    return modifier is not None and modifier.is_override_data


def _is_noted(obj: bpy.types.Object) -> bool:
    """Whether what is noted about a bake will be saved. Blender 5 saves the properties of a group only where the linked
    object has that group, too.
    """
    reference = obj.override_library.reference
    if bpy.app.version < (5, 0):
        return True
    return "bake" in (reference.bl_system_properties_get() or {}).get("dynamorph", {})
