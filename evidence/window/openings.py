# SPDX-License-Identifier: GPL-3.0-or-later
"""What of the extension opens: panels, lists, menus, pop-ups, drop-downs, dialogs and file browsers.

The classes are those that the extension has registered, the rest is noted as Blender draws it. All of it must have been
opened when the test ends, so that what is new fails the test until a step opens it.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator

import bpy
import driver
from bpy.types import AddonPreferences, Header, Menu, Operator, Panel, UILayout, UIList
from bpy_extras.io_utils import ExportHelper, ImportHelper
from editors import ADDON

DIALOG = re.compile(r"\b(invoke_(props|search|confirm)\w*|invoke_popup|popup_(menu|menu_pie|popover)|fileselect_add)\(")

there = driver.there


def watch():
    """From now on note what the installed extension draws."""
    for kind in (Panel, Menu, Header, UIList, AddonPreferences):
        for drawn in registered(kind):
            there.add(drawn.__name__)
            _watch(drawn)
    for operator in registered(Operator):
        own = [each for each in operator.__mro__ if each.__module__.startswith(ADDON)]
        if any("draw" in vars(each) for each in own):
            _watch(operator, shown=False)  # its dialog has the operator's name
        opens = any(DIALOG.search(inspect.getsource(each)) for each in own)
        if opens or issubclass(operator, (ExportHelper, ImportHelper)):
            there.add(operator.bl_idname)
            there.update(_asked(operator))
            if any("invoke" in vars(each) for each in operator.__mro__):
                _watch_invoke(operator)


def _asked(operator: type) -> Iterator[str]:
    """The drop-downs of a dialog that Blender lays out by itself."""
    if "invoke_props_dialog" in inspect.getsource(operator) and "draw" not in vars(operator):
        module, name = operator.bl_idname.split(".")
        known = getattr(getattr(bpy.ops, module), name).get_rna_type()
        for field in known.properties:
            if field.type == "ENUM" and not field.is_hidden:
                yield f"{known.identifier}.{field.identifier}"


def registered(kind) -> list[type]:
    return [each for each in kind.__subclasses__() if each.__module__.startswith(ADDON) and each.is_registered]


# While Blender draws -------------------------------------------------------------------------------------------------


def _watch(kind: type, shown=True):
    """shown: whether being drawn counts as being opened."""
    if issubclass(kind, UIList):
        draw_item = kind.draw_item

        def draw(self, context, layout, data, item, icon, active_data, active_name, index):  # Blender counts them
            driver.opened.add(kind.__name__)
            draw_item(self, context, _Layout(layout), data, item, icon, active_data, active_name, index)

        kind.draw_item = draw
        return
    original = kind.draw

    def draw(self, context):
        if shown:
            driver.opened.add(kind.__name__)
            driver.shown.add(kind.__name__)
        original(_Drawn(self), context)

    kind.draw = draw


def _watch_invoke(operator: type):
    """An operator that asks goes on, one that reports an error instead does not."""
    original = operator.invoke

    def invoke(self, context, event):
        result = original(self, context, event)
        if result & {"RUNNING_MODAL", "INTERFACE"}:
            driver.opened.add(operator.bl_idname)
        return result

    operator.invoke = invoke


class _Drawn:
    """A panel, menu or operator that draws, with a layout that notes."""

    def __init__(self, drawn):
        self._original = drawn
        self.layout = _Layout(drawn.layout)

    def __getattr__(self, name):
        return getattr(self._original, name)


class _Layout:
    """One of Blender's layouts, which notes what opens."""

    def __init__(self, layout):
        object.__setattr__(self, "_original", layout)

    def __setattr__(self, name, value):
        setattr(self._original, name, value)

    def __getattr__(self, name):
        value = getattr(self._original, name)
        if not callable(value):
            return value

        def call(*args, **options):
            args = [getattr(arg, "_original", arg) for arg in args]
            made = value(*args, **options)
            _note(name, args)
            return _layouts(made)

        return call


def _layouts(made):
    if isinstance(made, tuple):
        return tuple(map(_layouts, made))
    return _Layout(made) if isinstance(made, UILayout) else made


def _note(name: str, args: list):
    if name == "operator_menu_enum":
        there.add(".".join(args[:2]))
    elif name in ("prop", "prop_search"):
        owner, field = args[:2]
        known = (owner.properties if isinstance(owner, Operator) else owner).bl_rna
        kind = known.properties[field].type
        if kind in ("ENUM", "POINTER") or name == "prop_search":
            there.add(f"{known.identifier}.{field}")
