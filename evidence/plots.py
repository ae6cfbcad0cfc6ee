# SPDX-License-Identifier: GPL-3.0-or-later
"""The plots of the results page: one look, one color for each method, SVG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

COLORS = {
    "plain skinning": "#8a8f98",
    "static morphs": "#c9a227",
    "single material": "#d1495b",
    "pose-dependent shape": "#8f5bb5",
    "DMT reduced": "#00798c",
    "DMT full": "#1f4e79",
    "linear": "#d1495b",
    "StVK": "#00798c",
    "stable StVK": "#1f4e79",
}
STYLE = {
    "font.family": "DejaVu Sans", "font.size": 9, "axes.titlesize": 10, "axes.titleweight": "bold",
    "axes.titlelocation": "left", "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
    "grid.color": "#e4e6ea", "axes.edgecolor": "#8a8f98", "axes.labelcolor": "#30343b", "xtick.color": "#5a606b",
    "ytick.color": "#5a606b", "legend.frameon": False, "lines.linewidth": 1.8, "svg.hashsalt": "dynamorph",
}  # fmt: skip

Curves = Mapping[str, tuple[Sequence[float], Sequence[float]]]  # label -> x, y


def figure(panels: int, height: float = 3.0):
    """A row of panels: the figure and its axes."""
    plt.rcParams.update(STYLE)
    drawing, axes = plt.subplots(1, panels, figsize=(4.6 * panels, height), layout="constrained", squeeze=False)
    return drawing, axes[0]


def draw(axes, title: str, curves: Curves, x: str, y: str, **style) -> None:
    """Curves with their legend; a label that starts with the name of a method takes its color."""
    for label, (xs, ys) in curves.items():
        color = next((c for name, c in COLORS.items() if label.startswith(name)), None)
        dashed = label.endswith(("full", "fitted"))
        axes.plot(xs, ys, label=label, color=color, linestyle="--" if dashed else "-", **style)
    axes.set_title(title)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.legend(fontsize=8)


def logarithmic(axes, *, x: bool = False) -> None:
    """A logarithmic y axis with ordinary numbers, and with x that one too."""
    for axis in (axes.yaxis, axes.xaxis) if x else (axes.yaxis,):
        axes.set(**{f"{axis.axis_name}scale": "log"})
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_locator(NullLocator())


def bars(axes, title: str, groups: Sequence[str], heights: Mapping[str, Sequence[float]], y: str) -> None:
    """A bar for each method in every group."""
    width = 0.8 / len(heights)
    for k, (label, values) in enumerate(heights.items()):
        places = [g - 0.4 + (k + 0.5) * width for g in range(len(groups))]
        axes.bar(places, values, width, label=label, color=COLORS[label])
    axes.set_xticks(range(len(groups)), groups)
    axes.grid(visible=False, axis="x")
    axes.set_axisbelow(True)
    axes.set_title(title)
    axes.set_ylabel(y)
    axes.set_ylim(0, 1.5 * max(max(values) for values in heights.values()))  # room for the legend
    axes.legend(fontsize=8, ncols=2)


def stacked(axes, title: str, groups: Sequence[str], parts: Mapping[str, Sequence[float]], y: str) -> None:
    """A bar for each group, of its parts."""
    below = [0.0] * len(groups)
    colors = plt.get_cmap("viridis")
    for k, (label, values) in enumerate(parts.items()):
        axes.bar(groups, values, 0.6, bottom=below, label=label, color=colors(k / max(len(parts) - 1, 1)))
        below = [a + b for a, b in zip(below, values, strict=True)]
    axes.grid(visible=False, axis="x")
    axes.set_axisbelow(True)
    axes.set_title(title)
    axes.set_ylabel(y)
    axes.legend(fontsize=8, reverse=True)


def save(drawing, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    drawing.savefig(path, metadata={"Date": None})
    plt.close(drawing)
