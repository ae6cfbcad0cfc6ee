# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows that several sections of the panels share."""

from __future__ import annotations

import textwrap
from typing import Any

import bpy
from bpy.app.translations import pgettext_iface as iface_

from ..core.message import translated
from ..core.time_left import clock
from ..run.tools import grabbing
from ..run.work.task import Work
from ..scene.check.problem import Problem

FRAME = 76  # pixels at a UI scale of 1 beside a text: the sidebar's tabs, margins and an icon
CHARACTER = 6.2  # such pixels that a character takes in a line of many wide ones
SHORTEST = 16  # characters of a line, even where fewer fit
DEFAULT = 280  # such pixels: the sidebar's width
VALUE = 8  # characters that make room for a number in its field
ROOM = 28  # characters of a line from which on a region is not narrow
NONE = 2.5  # of Blender's units of width, for a word beside a field
BUTTON = 10  # characters that make room for a button


def draw_problem(layout: bpy.types.UILayout, problem: Problem, icon: str) -> None:
    if problem.fix:
        draw_with_button(layout, problem.text, icon, "dynamorph.fix").problem = problem.fix
    else:
        draw_message(layout, problem.text, icon=icon)


def draw_with_button(
    layout: bpy.types.UILayout, said: str, icon: str, operator: str, **options: Any
) -> bpy.types.OperatorProperties:
    """A message, and beside it the button that changes what it says; returns what takes the operator's settings."""
    row = layout.row()
    draw_message(row, said, icon=icon, width=line_length() - BUTTON)
    button = row.column()
    button.alignment = "RIGHT"
    return button.operator(operator, **options)


def progress_text(work: Work) -> str:
    """How much is done, the time left once it can be estimated, and the present step."""
    seconds = work.time_left.seconds
    text = iface_("{done:.0%}  {message}" if seconds is None else "{done:.0%}  {time} left  {message}")
    return text.format(done=work.fraction, time=clock(seconds or 0.0), message=translated(work.message, iface_))


def draw_message(layout: bpy.types.UILayout, text: str, icon: str = "ERROR", width: int | None = None) -> None:
    """Text, translated, and broken into lines, because labels do not wrap. width: characters, if not what fits."""
    column = layout.column(align=True)
    for i, line in enumerate(textwrap.wrap(translated(text, iface_), width or line_length())):
        column.label(text=line, icon="BLANK1" if i else icon, translate=False)


def is_narrow() -> bool:
    """Whether the region has no room for icons in a row of two buttons, nor for names beside fields."""
    return line_length() < ROOM


def pair(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    """Where to put two buttons: beside each other, if there is room."""
    return layout.column(align=True) if is_narrow() else layout.row(align=True)


def draw_setting(layout: bpy.types.UILayout, owner: bpy.types.bpy_struct, name: str) -> None:
    """A property. Where there is little room, Blender cuts off the names of lists and long ones: these are above."""
    prop = owner.bl_rna.properties[name]
    label = iface_(prop.name, prop.translation_context)
    if is_narrow() and (prop.type in ("ENUM", "POINTER") or len(label) + VALUE > line_length()):
        layout.label(text=label, translate=False)
        layout.prop(owner, name, text="")
    else:
        layout.prop(owner, name)


def draw_limit(layout: bpy.types.UILayout, owner: bpy.types.bpy_struct, name: str) -> None:
    """A limit. The field of a number cannot say that 0 is none."""
    row = layout.row()
    draw_setting(row.column(), owner, name)
    if not getattr(owner, name):
        beside = row.column()
        beside.ui_units_x = NONE
        beside.label(text="none")


def line_length() -> int:
    """How many characters fit into a line of the region that is drawn."""
    region = bpy.context.region
    if region is None:  # there is no window
        return characters(DEFAULT, 1.0)
    return characters(region.width, bpy.context.preferences.system.ui_scale)


def characters(width: float, scale: float) -> int:
    """width: of a region, pixels; scale: of the interface."""
    return max(int((width / scale - FRAME) / CHARACTER), SHORTEST)


def draw_record(layout: bpy.types.UILayout, obj: bpy.types.Object) -> None:
    """What records drags of the skin."""
    layout.operator("dynamorph.record_drags", icon="REC", depress=grabbing.is_recording(obj))
