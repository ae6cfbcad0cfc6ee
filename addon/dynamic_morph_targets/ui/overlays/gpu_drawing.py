# SPDX-License-Identifier: GPL-3.0-or-later
"""Batches, colors and texts for what the 3D viewport draws."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import blf
import bpy
import gpu
import numpy as np

MARGIN, PADDING, TEXT, SQUARE = 8.0, 6.0, 11.0, 8.0


def make_batch(kind: str, points: np.ndarray, indices: np.ndarray | None = None) -> gpu.types.GPUBatch:
    """Points (k, 3), joined as `indices` says or one after the other."""
    layout = gpu.types.GPUVertFormat()
    layout.attr_add(id="pos", comp_type="F32", len=3, fetch_mode="FLOAT")
    vertices = gpu.types.GPUVertBuf(layout, len(points))
    vertices.attr_fill("pos", np.ascontiguousarray(points, np.float32))
    if indices is None:
        return gpu.types.GPUBatch(type=kind, buf=vertices)
    return gpu.types.GPUBatch(type=kind, buf=vertices, elem=gpu.types.GPUIndexBuf(type=kind, seq=indices))


def draw(batch: gpu.types.GPUBatch, shader_name: str, color: Sequence[float], **uniforms: Any) -> None:
    shader = gpu.shader.from_builtin(shader_name)
    shader.bind()
    shader.uniform_float("color", color)
    for name, value in uniforms.items():
        shader.uniform_float(name, value)
    gpu.state.blend_set("ALPHA")
    batch.draw(shader)
    gpu.state.blend_set("NONE")


def draw_lines(batch: gpu.types.GPUBatch, color: Sequence[float], width: float) -> None:
    size = gpu.state.viewport_get()[2:]
    draw(batch, "POLYLINE_UNIFORM_COLOR", color, viewportSize=size, lineWidth=pixels(width))


def draw_points(batch: gpu.types.GPUBatch, color: Sequence[float], size: float) -> None:
    gpu.state.program_point_size_set(True)
    draw(batch, "POINT_UNIFORM_COLOR", color, size=pixels(size))
    gpu.state.program_point_size_set(False)


def draw_rectangle(left: float, bottom: float, right: float, top: float, color: Sequence[float]) -> None:
    corners = [(left, bottom, 0), (right, bottom, 0), (left, top, 0), (right, top, 0)]
    draw(make_batch("TRI_STRIP", np.array(corners)), "UNIFORM_COLOR", color)


def draw_text(text: str, x: float, y: float, color: Sequence[float]) -> None:
    blf.size(0, pixels(TEXT))
    blf.color(0, *color, 1.0)
    blf.position(0, x, y, 0.0)
    blf.draw(0, text)


def text_width(text: str) -> float:
    blf.size(0, pixels(TEXT))
    return blf.dimensions(0, text)[0]


def pixels(length: float) -> float:
    """The pixels of a length that is given for a resolution scale of 1."""
    return length * bpy.context.preferences.system.ui_scale


def is_shown(context: bpy.types.Context, obj: bpy.types.Object | None) -> bool:
    """Whether this viewport shows the soft skin `obj`, and overlays."""
    space = context.space_data
    if obj is None or not obj.dynamorph.targets or not space.overlay.show_overlays:
        return False
    return obj.visible_in_viewport_get(space)
