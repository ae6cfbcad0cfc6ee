# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows that several sections of the panels share."""

from __future__ import annotations

import textwrap

import bpy
from bpy.app.translations import pgettext_iface as iface_

LINE = 34  # characters that fit into the sidebar at its default width
LETTER, BORDERS = 6.5, 58  # pixels at a resolution scale of 1: of a character, and of icon and margins


def characters() -> int:
    """How many fit into a line of the region that is drawn."""
    region = bpy.context.region
    if region is None:
        return LINE
    return max(16, int((region.width / bpy.context.preferences.system.ui_scale - BORDERS) / LETTER))


def draw_problem(layout, problem, icon: str):
    row = layout.row()
    draw_message(row, problem.text, icon=icon, width=characters() - 10 * bool(problem.fix))
    if problem.fix:
        button = row.column()
        button.alignment = "RIGHT"
        button.operator("dynamorph.fix").problem = problem.fix


def draw_message(layout, text: str, icon="ERROR", width: int | None = None):
    """Text, translated unless it was formatted, and broken into lines, because labels do not wrap."""
    column = layout.column(align=True)
    for i, line in enumerate(textwrap.wrap(iface_(text), width or characters())):
        column.label(text=line, icon="BLANK1" if i else icon, translate=False)
