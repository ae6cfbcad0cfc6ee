# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings from plain data into property groups, and names for new ones."""

from __future__ import annotations

from collections.abc import Collection

import bpy

from ..scene.plain import plain
from ..scene.properties.target_properties import as_computed


def assign(group: bpy.types.PropertyGroup, values: dict) -> None:
    """The inverse of `plain`. Writes only what differs; names that the group does not have are skipped."""
    with as_computed():  # whether a stiffness was set by hand is one of the values
        for name, value in values.items():
            if name in group.bl_rna.properties and plain(group).get(name) != value:
                setattr(group, name, value)


def free_name(taken: Collection[str], stem: str) -> str:
    """The first of "stem 1", "stem 2", ... that is not taken."""
    return next(name for number in range(1, len(taken) + 2) if (name := f"{stem} {number}") not in taken)
