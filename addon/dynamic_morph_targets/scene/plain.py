# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of property groups as plain data, fit for JSON, and back."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import bpy


def plain(group: bpy.types.bpy_struct, skip: Iterable[str] = ()) -> dict:
    """The simple settings of a property group by name, as JSON data: numbers, texts, enums and arrays of numbers.

    Groups and lists within it, values that follow from a built model, and what `skip` names are left out.
    """
    out = {}
    for prop in group.bl_rna.properties:
        computed = prop.is_readonly or prop.is_skip_save
        if prop.identifier in ("rna_type", *skip) or prop.type in ("POINTER", "COLLECTION") or computed:
            continue
        value = getattr(group, prop.identifier)
        out[prop.identifier] = list(value) if getattr(prop, "is_array", False) else value
    return out


def length(prop: bpy.types.Property) -> int:
    """Of a property that is an array, otherwise 0."""
    return getattr(prop, "array_length", 0)


def fits(prop: bpy.types.Property, value: Any) -> bool:
    """Whether a property of a group takes the value unchanged; an array takes a list of as many."""
    kind, count = prop.type, length(prop)
    if count and not (isinstance(value, list) and len(value) == count):
        return False
    values = value if count else [value]
    if kind == "BOOLEAN":
        return all(type(value) is bool for value in values)
    if kind == "ENUM":
        return all(is_text(value) and value in prop.enum_items for value in values)
    if kind == "STRING":
        return all(map(is_text, values))
    low, high, numbers = prop.hard_min, prop.hard_max, (int,) if kind == "INT" else (int, float)
    # Comparing refuses NaN, infinity and integers too long for a float as well.
    return all(type(value) in numbers and low <= value <= high for value in values)


def is_text(value: object) -> bool:
    """Whether Blender can store it: text without lone surrogates and zeros."""
    try:
        return isinstance(value, str) and b"\0" not in value.encode()
    except UnicodeEncodeError:
        return False


def wanted(prop: bpy.types.Property) -> str:
    """What `fits` accepts, in words."""
    if prop.type in ("BOOLEAN", "STRING"):
        return {"BOOLEAN": "true or false", "STRING": "a text"}[prop.type]
    if prop.type == "ENUM":
        return f"one of {', '.join(prop.enum_items.keys())}"
    if length(prop):
        return f"{length(prop)} numbers"
    whole = "whole " if prop.type == "INT" else ""
    return f"a {whole}number from {prop.hard_min:.6g} to {prop.hard_max:.6g}"
