# SPDX-License-Identifier: GPL-3.0-or-later
"""What the 3D viewport draws of the hands on a soft skin: where each pulls, and how firmly."""

from __future__ import annotations

import bpy
import gpu
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d

from ...run import remembered
from ...scene import registration, skin
from ...scene.read import mesh_data
from .gpu_drawing import draw_lines, draw_points, draw_text, is_shown, make_batch, pixels
from .viewport import quietly


def hands_on(context: bpy.types.Context) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Of each hand on the soft skin of the context: the place that it holds, now, and the place to which it pulls that,
    (3,) each, world space; newtons.
    """
    obj, current = skin.mesh_in(context), remembered.live.hands
    if current is None or not current.holds or not is_shown(context, obj) or not current.is_of(obj):
        return []
    points, unit = mesh_data.shown_points(obj, context.view_layer.depsgraph), skin.unit_scale()
    found = []
    for hold in current.holds.values():
        pulls = hold.goal + hold.offsets - points[hold.vertices]
        share = hold.stiffness / hold.stiffness.sum()
        newtons = float(np.linalg.norm(unit * (hold.stiffness @ pulls)))
        found.append((hold.goal - share @ pulls, hold.goal, newtons))
    return found


def _draw_hands() -> None:
    """POST_VIEW."""
    color = bpy.context.preferences.themes[0].user_interface.gizmo_primary
    for place, goal, _ in hands_on(bpy.context):
        gpu.state.depth_test_set("NONE")
        draw_lines(make_batch("LINES", np.array([place, goal])), (*color, 0.9), 2.0)
        draw_points(make_batch("POINTS", np.array([place, goal])), (*color, 0.9), 6.0)


def _draw_forces() -> None:
    """POST_PIXEL."""
    context = bpy.context
    text = context.preferences.themes[0].user_interface.wcol_box.text
    for _, goal, newtons in hands_on(context):
        at = location_3d_to_region_2d(context.region, context.region_data, goal)
        if at is not None:  # not behind the view
            draw_text(f"{newtons:.3g} N", at.x + pixels(10.0), at.y, text)


def register() -> None:
    if not bpy.app.background:
        for draw, moment in ((_draw_hands, "POST_VIEW"), (_draw_forces, "POST_PIXEL")):
            registration.draw_in_view(__name__, quietly(draw), moment)


def unregister() -> None:
    registration.take_back(__name__)
