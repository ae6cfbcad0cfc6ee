# SPDX-License-Identifier: GPL-3.0-or-later
"""The sections that show the skin in motion without keyframes, and beside something else."""

from __future__ import annotations

import bpy

from ...run.bake import expected_error, full_comparison
from ...scene import skin
from ...write.display import beside, comparison
from ..widgets import draw_message


def draw_shake_test(layout: bpy.types.UILayout, _context: bpy.types.Context, _obj: bpy.types.Object) -> None:
    row = layout.row(align=True)
    for kind in ("STOMP", "TWIST", "HOP"):
        row.operator("dynamorph.shake_test", text=kind.capitalize()).kind = kind


def draw_compare(layout: bpy.types.UILayout, _context: bpy.types.Context, obj: bpy.types.Object) -> None:
    """Plain skinning, another set of settings, a copy beside the body, and Full Quality."""
    plain = comparison.is_plain(obj)
    text = "Show Soft Skin" if plain else "Show Plain Skinning"
    layout.operator("dynamorph.show_plain", text=text, icon="HIDE_OFF" if plain else "HIDE_ON", depress=plain)
    row = layout.row(align=True)
    slot, other = ("A", "B") if obj.dynamorph.live.slot == "A" else ("B", "A")
    row.operator("dynamorph.swap_slot", text=f"Swap to {other}", icon="UV_SYNC_SELECT")
    row.operator("dynamorph.copy_slot", text=f"Copy {slot} to {other}", icon="COPYDOWN")
    shown = beside.find(obj) is not None
    if shown or skin.is_shown_on(obj):
        layout.operator("dynamorph.compare_beside", icon="MOD_MIRROR", depress=shown)
    if not full_comparison.disabled_reason(obj):
        layout.operator("dynamorph.compare_full", icon="VIEWZOOM")
    for text in filter(None, (full_comparison.summary(obj), expected_error.summary(obj))):
        draw_message(layout, text, icon="INFO")
