# SPDX-License-Identifier: GPL-3.0-or-later
"""A soft skin removed, with all that it has made."""

from __future__ import annotations

import bpy

from ...write import storage
from ...write.authoring import regions, targets
from ...write.bake import muting, writer
from .. import live


def remove_soft_skin(obj: bpy.types.Object) -> None:
    """Remove its targets, model and bake; shape keys and settings stay. Raises WriteError."""
    live.turn_off(obj)
    writer.free(obj)
    targets.show_as_before(obj)
    muting.show_target(obj, "")
    left = regions.automatic_regions(obj, obj.dynamorph.targets)
    obj.dynamorph.targets.clear()
    regions.update(obj, left)
    storage.forget_model(obj)
