# SPDX-License-Identifier: GPL-3.0-or-later
"""What a mesh was like before a bake replaced another, so that it can be put back if the replacement fails."""

from __future__ import annotations

from array import array
from typing import Any

import bpy
import numpy as np

from ...scene import animation
from ...scene.properties.target_properties import as_computed
from ...scene.skin import cache_modifier
from ...scene.store.model_store import PACKED

MEASURED = ("bounce_reference", "poisson_reference", "volume")  # stored, though presets do not save them
CACHE_FIELDS = (
    "cache_format", "filepath", "frame_start", "frame_scale", "show_in_editmode", "show_viewport", "show_render",
)  # fmt: skip


class Before:
    """The settings, the model, the shape keys' states and the point cache of a mesh object as they are now.

    The replacement removes no shape key, Action or modifier before it can no longer fail; what it adds to the keys is
    taken back by `NewBake.take_back`.
    """

    def __init__(self, obj: bpy.types.Object):
        self._obj = obj
        self._settings = _values(obj.dynamorph)
        self._packed = _copied(obj.get(PACKED))
        self._keys = {name: (block.mute, block.value) for name, block in animation.keys_of(obj).items()}
        self._modifiers = obj.modifiers.keys()
        modifier = cache_modifier(obj)
        self._cache = modifier and modifier.name
        self._cache_fields = {name: getattr(modifier, name) for name in CACHE_FIELDS} if modifier else {}
        self._is_driven = bool(modifier) and _is_driven(modifier)

    def restore(self) -> None:
        """Put it back."""
        obj = self._obj
        for name in set(obj.modifiers.keys()) - set(self._modifiers):
            obj.modifiers[name].driver_remove("factor")
            obj.modifiers.remove(obj.modifiers[name])
        if self._cache:
            modifier = obj.modifiers[self._cache]
            _put(modifier, self._cache_fields)
            if not self._is_driven:
                modifier.driver_remove("factor")
        with as_computed():  # whether a stiffness was set by hand is one of the values
            _put(obj.dynamorph, self._settings)
        for name, (mute, value) in self._keys.items():
            _put(animation.keys_of(obj)[name], {"mute": mute, "value": value})
        if self._packed is not None:
            obj[PACKED] = self._packed
        else:
            obj.pop(PACKED, None)


def _values(group: bpy.types.PropertyGroup) -> dict:
    """What is stored in a property group, with the groups and lists within it, by name."""
    values: dict = {}
    for name, prop in group.bl_rna.properties.items():
        if name == "rna_type":
            continue
        value = getattr(group, name)
        if prop.type == "COLLECTION":
            values[name] = [_values(each) for each in value]
        elif isinstance(value, bpy.types.PropertyGroup):
            values[name] = _values(value)
        elif name in MEASURED or not (prop.is_readonly or prop.is_skip_save):
            values[name] = tuple(value) if getattr(prop, "is_array", False) else value
    return values


def _put(group: bpy.types.bpy_struct, values: dict) -> None:
    """The inverse of `_values`; writes only what differs."""
    for name, before in values.items():
        value = getattr(group, name)
        if isinstance(before, dict):
            _put(value, before)
        elif isinstance(before, list):
            _put_list(value, before)
        elif (tuple(value) if isinstance(before, tuple) else value) != before:
            setattr(group, name, before)


def _put_list(items: bpy.types.bpy_prop_collection, before: list[dict]) -> None:
    while len(items) > len(before):
        items.remove(len(items) - 1)
    while len(items) < len(before):
        items.add()
    for item, values in zip(items, before, strict=True):
        _put(item, values)


def _copied(packed: Any) -> Any:
    """A custom property's value, which may be damaged and then be anything, that stays when the property goes."""
    if hasattr(packed, "typecode"):
        return array(packed.typecode, np.asarray(packed).tobytes())
    return packed.to_dict() if hasattr(packed, "to_dict") else packed


def _is_driven(modifier: bpy.types.Modifier) -> bool:
    data = modifier.id_data.animation_data
    return bool(data and data.drivers.find(modifier.path_from_id("factor")))
