# SPDX-License-Identifier: GPL-3.0-or-later
"""How far the skin moves, as colors that Workbench shows, and their legend."""

from __future__ import annotations

import numpy as np
from contact_sheet import FAINT
from PIL import ImageDraw, ImageFont

COLORS = ((0.55, 0.56, 0.58), (0.16, 0.42, 0.72), (0.2, 0.65, 0.3), (0.95, 0.8, 0.15), (0.85, 0.1, 0.05))  # 0 to 1
BAR = (120, 14)  # pixels of the legend's colors


def paint(mesh, shares: np.ndarray) -> None:
    """Colors of shares (V,), gray at 0 and red from 1, as the color attribute that Workbench shows."""
    colors = np.ones((len(shares), 4), np.float32)
    for channel, values in enumerate(np.transpose(COLORS)):
        colors[:, channel] = np.interp(shares, np.linspace(0, 1, len(COLORS)), values)
    attribute = mesh.color_attributes.get("Heat") or mesh.color_attributes.new("Heat", "FLOAT_COLOR", "POINT")
    attribute.data.foreach_set("color", colors.ravel())
    mesh.color_attributes.active_color = attribute


def draw_legend(draw: ImageDraw.ImageDraw, left: int, top: int, text: str) -> None:
    """The colors from gray to red, and what they mean."""
    width, height = BAR
    stops = np.linspace(0, 1, len(COLORS))
    for x in range(width):
        color = [np.interp(x / width, stops, values) ** (1 / 2.2) for values in np.transpose(COLORS)]
        draw.line((left + x, top, left + x, top + height), tuple(round(255 * part) for part in color))
    draw.text((left + width + 8, top), text, FAINT, ImageFont.load_default(13))
