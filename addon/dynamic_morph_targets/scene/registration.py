# SPDX-License-Identifier: GPL-3.0-or-later
"""Classes that Blender is to know. What takes them back works from any point, also when Blender took only some."""

from __future__ import annotations

from collections.abc import Callable

import bpy


def of_classes(classes) -> tuple[Callable[[], None], Callable[[], None]]:
    """(register, unregister) of a module that has classes."""

    def register():
        for each in classes:
            bpy.utils.register_class(each)

    def unregister():
        for each in reversed(classes):
            if each.is_registered:
                bpy.utils.unregister_class(each)

    return register, unregister
