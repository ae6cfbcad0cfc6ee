# SPDX-License-Identifier: GPL-3.0-or-later
"""The graph of the targets' weights over the frames, in the 3D viewport."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import bpy
import gpu
import numpy as np

from ...core import states
from ...core.motion import target_weights
from ...run.tools import weight_curves
from ...scene import skin
from ...scene.remembered import opened
from .gpu_drawing import (
    MARGIN,
    PADDING,
    SQUARE,
    TEXT,
    draw,
    draw_lines,
    draw_rectangle,
    draw_text,
    is_shown,
    make_batch,
    pixels,
    text_width,
)

HEIGHT = 120.0  # of the graph; this and the other lengths are in pixels at a resolution scale of 1
NARROW = 160.0  # than this a graph is not worth drawing
HUES = (4, 1, 3, 6, 0, 5, 2, 7)  # of them, so that neighbors in the list differ


def free_rectangle(region: bpy.types.Region, others: Iterable[bpy.types.Region]) -> tuple[float, float, float, float]:
    """Left, bottom, right and top of what the regions over `region` leave of it, in its own pixels."""
    left, bottom, right, top = 0.0, 0.0, region.width, region.height
    for other in others:
        begin, end = other.x - region.x, other.x - region.x + other.width
        low, high = other.y - region.y, other.y - region.y + other.height
        over = begin < region.width and end > 0 and low < region.height and high > 0
        if not over or min(other.width, other.height) <= 1:  # beside it, or hidden
            continue
        if other.alignment == "LEFT":
            left = max(left, end)
        elif other.alignment == "RIGHT":
            right = min(right, begin)
        elif other.alignment == "BOTTOM":
            bottom = max(bottom, high)
        elif other.alignment == "TOP":
            top = min(top, low)
    return left, bottom, right, top


def runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of each run of True in (F,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(int(begin), int(end) - 1) for begin, end in edges.reshape(-1, 2)]


def curve_colors(shown: target_weights.TargetWeights, theme: bpy.types.Theme) -> dict[int, tuple[float, ...]]:
    """A color for each curve that is drawn, by index of its target: of neutral targets the text's."""
    hues = [tuple(theme.collection_color[hue].color) for hue in HUES]
    colors, others = {}, 0
    for _, targets in shown.by_set():
        colors[targets.start] = tuple(theme.user_interface.wcol_box.text)
        for target in targets[1:]:
            colors[target] = hues[others % len(hues)]
            others += 1
    return colors


@states.cached(opened, 2)
def graph_batches(shown: target_weights.TargetWeights) -> tuple[dict[int, gpu.types.GPUBatch], gpu.types.GPUBatch]:
    """Curves by index of their target, and the frames outside: x in frames from the first, y in weight."""
    frames = np.arange(len(shown.weights), dtype=np.float32)
    curves = {
        target: make_batch("LINE_STRIP", np.column_stack([frames, shown.weights[:, target], 0.0 * frames]))
        for _, targets in shown.by_set()
        for target in targets
    }
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]], np.float32)
    quads = [np.zeros((0, 3), np.float32)]
    for first, last in runs(shown.outside.any(axis=1)):
        begin, end = max(first - 0.5, 0.0), min(last + 0.5, len(frames) - 1.0)
        quads.append(np.column_stack([begin + (end - begin) * corners[:, 0], corners[:, 1], np.zeros(6)]))
    return curves, make_batch("TRIS", np.concatenate(quads))


def draw_graph() -> None:
    """POST_PIXEL."""
    context = bpy.context
    obj = skin.mesh_in(context)
    first = next(region for region in context.area.regions if region.type == "WINDOW")
    if not context.window_manager.dynamorph.target_weights or not is_shown(context, obj) or context.region != first:
        return
    known = weight_curves.drawn(obj)
    if known is None or len(known[1].weights) < 2:
        return
    others = [region for region in context.area.regions if region.type != "WINDOW"]
    left, bottom, right, top = free_rectangle(context.region, others)
    margin, height = pixels(MARGIN), pixels(HEIGHT)
    if right - left > pixels(NARROW) and top - bottom > 2 * height:
        _draw_graph_in(left + margin, bottom + margin, right - margin, bottom + margin + height, *known)


def _draw_graph_in(
    left: float,
    bottom: float,
    right: float,
    top: float,
    shot: weight_curves.RigPoses,
    shown: target_weights.TargetWeights,
) -> None:
    context = bpy.context
    theme = context.preferences.themes[0]
    box, colors = theme.user_interface.wcol_box, curve_colors(shown, theme)
    draw_rectangle(left, bottom, right, top, (*box.inner[:3], 0.85))
    pad, line = pixels(PADDING), pixels(TEXT + 4.0)
    x, y, width, height = left + pad, bottom + pad + line, right - left - 2 * pad, top - bottom - 2 * (pad + line)
    frames = shot.end - shot.start
    curves, outside = graph_batches(shown)
    with gpu.matrix.push_pop():
        gpu.matrix.translate((x, y, 0.0))
        gpu.matrix.scale((width / frames, height, 1.0))
        draw(outside, "UNIFORM_COLOR", (*theme.user_interface.wcol_state.warning[:3], 0.2))
        for target, batch in curves.items():
            draw_lines(batch, (*colors[target], 1.0), 1.5)
        now = context.scene.frame_current_final - shot.start
        if 0 <= now <= frames:
            playhead = make_batch("LINES", np.array([[now, 0.0, 0.0], [now, 1.0, 0.0]]))
            draw_lines(playhead, theme.user_interface.wcol_regular.inner_sel, 2.0)
    _draw_legend(x, top - line, right - pad, shown, colors, box.text)
    draw_text(str(shot.start), x, bottom + pad, box.text)
    draw_text(str(shot.end), right - pad - text_width(str(shot.end)), bottom + pad, box.text)


def _draw_legend(
    x: float,
    y: float,
    right: float,
    shown: target_weights.TargetWeights,
    colors: dict[int, tuple[float, ...]],
    text_color: Sequence[float],
) -> None:
    """Names with their colors from left to right, as far as there is room; the neutral target's once."""
    names = [target.name for target_set in shown.sets for target in target_set.targets]
    again = [targets.start for _, targets in shown.by_set()[1:]]
    square, space = pixels(SQUARE), pixels(4.0)
    for target in (target for target in colors if target not in again):
        end = x + square + space + text_width(names[target])
        if end > right:
            return
        draw_rectangle(x, y, x + square, y + square, (*colors[target], 1.0))
        draw_text(names[target], x + square + space, y, text_color)
        x = end + 3 * space
