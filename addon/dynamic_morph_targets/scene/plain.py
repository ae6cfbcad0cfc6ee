# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of property groups as plain data, fit for JSON, and back."""

from __future__ import annotations


def plain(group, skip=()) -> dict:
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


def fits(prop, value) -> bool:
    """Whether a property of a group, or each number of an array, takes the value unchanged."""
    if prop.type == "BOOLEAN":
        return type(value) is bool
    if prop.type == "ENUM":
        return is_text(value) and value in prop.enum_items
    if prop.type == "STRING":
        return is_text(value)
    # Comparing refuses NaN, infinity and integers too long for a float as well.
    return type(value) in ((int,) if prop.type == "INT" else (int, float)) and prop.hard_min <= value <= prop.hard_max


def is_text(value) -> bool:
    """Whether Blender can store it: text without lone surrogates and zeros."""
    try:
        return isinstance(value, str) and b"\0" not in value.encode()
    except UnicodeEncodeError:
        return False


def wanted(prop, count: int) -> str:
    """What `fits` accepts, in words; count: of an array, otherwise 0."""
    if prop.type in ("BOOLEAN", "STRING"):
        return {"BOOLEAN": "true or false", "STRING": "a text"}[prop.type]
    if prop.type == "ENUM":
        return f"one of {', '.join(prop.enum_items.keys())}"
    if count:
        return f"{count} numbers"
    whole = "whole " if prop.type == "INT" else ""
    return f"a {whole}number from {prop.hard_min:.6g} to {prop.hard_max:.6g}"
