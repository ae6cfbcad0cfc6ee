# SPDX-License-Identifier: GPL-3.0-or-later
"""How far the skin moves, as colors that Workbench shows, and their legend."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from contact_sheet import FAINT
from PIL import ImageDraw, ImageFont

COLORS = {0.0: (0.55, 0.56, 0.58), 0.25: (0.16, 0.42, 0.72), 0.5: (0.2, 0.65, 0.3), 0.75: (0.95, 0.8, 0.15),
          1.0: (0.85, 0.1, 0.05)}  # fmt: skip  # of shares
BAR = (120, 14)  # pixels of the legend's colors


def paint(mesh, shares: np.ndarray, colors: Mapping[float, Sequence[float]] = COLORS) -> None:
    """Colors of shares (V,), as the color attribute that Workbench shows; by default gray at 0 and red from 1."""
    shown = np.ones((len(shares), 4), np.float32)
    for channel in range(3):
        shown[:, channel] = np.interp(shares, list(colors), [color[channel] for color in colors.values()])
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
