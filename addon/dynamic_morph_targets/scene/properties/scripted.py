# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings that no panel has a field for, because their defaults suit nearly every body: sample scenes and scripts set
them.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy
from bpy.app.translations import pgettext_iface as iface_

SCRIPTED = {  # where each of them is
    "hold": "model",
    "pin_radius": "model",
    "basis": "model",
    "fit_to_shot": "model",
    "material_model": "model",
    "blending": "model",
    "integrator": "simulation",
}


def changed(obj: bpy.types.Object) -> Iterator[tuple[str, str]]:
    """Those of the soft skin `obj` that differ from their defaults, and what a panel says of each."""
    for name in SCRIPTED:
        prop, value = _prop(obj, name), getattr(_owner(obj, name), name)
        if value != prop.default:
            label = iface_(prop.name, prop.translation_context)
            yield name, iface_("Set by a script: {name}: {value}").format(name=label, value=_shown(prop, value))


def reset(obj: bpy.types.Object, name: str) -> None:
    """Set one of them back to its default."""
    setattr(_owner(obj, name), name, _prop(obj, name).default)


def _owner(obj: bpy.types.Object, name: str) -> bpy.types.PropertyGroup:
    return getattr(obj.dynamorph, SCRIPTED[name])


def _prop(obj: bpy.types.Object, name: str) -> bpy.types.Property:
    return _owner(obj, name).bl_rna.properties[name]


def _shown(prop: bpy.types.Property, value: Any) -> str:
    if prop.type == "ENUM":
        return iface_(prop.enum_items[value].name)
    return iface_("on") if prop.type == "BOOLEAN" else f"{value:.3g}"  # none of them is on at first
