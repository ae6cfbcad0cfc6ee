# SPDX-License-Identifier: GPL-3.0-or-later
"""What Blender is to know of the add-on. What takes it back works from any point, also when Blender took only some."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import bpy

_taken_back: dict[str, list[Callable[[], object]]] = {}  # by module


def of_classes(classes: Sequence[Any]) -> tuple[Callable[[], None], Callable[[], None]]:
    """(register, unregister) of a module that has classes."""

    def register() -> None:
        for each in classes:
            bpy.utils.register_class(each)

    def unregister() -> None:
        for each in reversed(classes):
            if each.is_registered:
                bpy.utils.unregister_class(each)

    return register, unregister


def later(module: str, take_back: Callable[[], object]) -> None:
    """Call this when the module is unregistered."""
    _taken_back.setdefault(module, []).append(take_back)


def take_back(module: str) -> None:
    """What was last is taken back first; a second time there is nothing left to do."""
    left = _taken_back.pop(module, [])
    while left:
        left.pop()()


def draw_in_view(module: str, draw: Callable[[], object], moment: str) -> None:
    """Draw in 3D views until the module is unregistered; moment: POST_VIEW or POST_PIXEL."""
    handle = bpy.types.SpaceView3D.draw_handler_add(draw, (), "WINDOW", moment)
    later(module, partial(bpy.types.SpaceView3D.draw_handler_remove, handle, "WINDOW"))
