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
