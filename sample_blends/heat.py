# SPDX-License-Identifier: GPL-3.0-or-later
"""How far the skin moves, as colors that Workbench shows: their legend, pictures beside each other, and loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import bpy
import numpy as np
from contact_sheet import FAINT, INK, PAPER
from PIL import Image, ImageDraw, ImageFont

COLORS = {0.0: (0.55, 0.56, 0.58), 0.25: (0.16, 0.42, 0.72), 0.5: (0.2, 0.65, 0.3), 0.75: (0.95, 0.8, 0.15),
          1.0: (0.85, 0.1, 0.05)}  # fmt: skip  # of shares
BAR = (120, 14)  # pixels of the legend's colors
GAP, HEAD, FOOT = 6, 30, 30  # pixels between panes, above and below them
QUALITY = 80  # of WebP, at most 100


def paint(
    mesh, shares: np.ndarray, colors: Mapping[float, Sequence[float]] = COLORS, shade: np.ndarray | float = 1.0
) -> None:
    """Colors of shares (V,), as the color attribute that Workbench shows; by default gray at 0 and red from 1. shade:
    how bright they are, 1 as in the legend, (V,) or for all.
    """
    shown = np.ones((len(shares), 4), np.float32)
    for channel in range(3):
        shown[:, channel] = shade * np.interp(shares, list(colors), [color[channel] for color in colors.values()])
    attribute = mesh.color_attributes.get("Heat") or mesh.color_attributes.new("Heat", "FLOAT_COLOR", "POINT")
    attribute.data.foreach_set("color", shown.ravel())
    mesh.color_attributes.active_color = attribute


def draw_legend(draw: ImageDraw.ImageDraw, left: int, top: int, text: str) -> None:
    """The colors from gray to red, and what they mean."""
    width, height = BAR
    for x in range(width):
        color = [np.interp(x / width, list(COLORS), values) ** (1 / 2.2) for values in np.transpose([*COLORS.values()])]
        draw.line((left + x, top, left + x, top + height), tuple(round(255 * part) for part in color))
    draw.text((left + width + 8, top), text, FAINT, ImageFont.load_default(13))


def beside(pictures: Sequence[Image.Image], titles: Sequence[str], legend: str) -> Image.Image:
    """Pictures of one size side by side below their titles, and above the legend of their colors, if there is one."""
    width, height = pictures[0].size
    foot = FOOT if legend else 0
    sheet = Image.new("RGB", (len(pictures) * (width + GAP) - GAP, HEAD + height + foot), PAPER)
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(16)
    for k, (picture, title) in enumerate(zip(pictures, titles, strict=True)):
        sheet.paste(picture, (k * (width + GAP), HEAD))
        draw.text((k * (width + GAP) + 4, 6), title, INK, font)
    if legend:
        draw_legend(draw, 4, HEAD + height + 8, legend)
    return sheet


def save_loop(pictures: Sequence[Image.Image], path: Path) -> None:
    """Write pictures as a WebP that repeats, in the scene's frames per second."""
    render = bpy.context.scene.render
    pictures[0].save(
        path, save_all=True, append_images=pictures[1:], loop=0, quality=QUALITY, method=4,
        duration=round(1000 * render.fps_base / render.fps),
    )  # fmt: skip
