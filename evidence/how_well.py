# SPDX-License-Identifier: GPL-3.0-or-later
"""`make how-well`: docs/how_well.md, the main figures of the measurement pages with five loops of the gallery. It
measures nothing: run it after such a page was measured again.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass

from project import ROOT

from gallery import IMAGES, LOOPS
from measured import LINE
from performance_page import grid

DOCS = ROOT / "docs"
PAGE = DOCS / "how_well.md"


@dataclass(frozen=True)
class Figure:
    """A figure of a page. what: it is, to an artist; row: how the first row with it begins, its cells joined by " | ",
    below the heading that begins with `below`; text: with the titles of columns in braces for their cells, {title 2}
    for the second column of a title.
    """

    what: str
    page: str
    row: str
    text: str
    below: str = ""


SOFT_BODY = "Soft Body | the same, Goal Stiffness keyed"
FIRST_BAKE = "first bake of 250 frames, 120 modes"
FIGURES = (
    Figure("A limb, stiff where it is flexed: how far a shake moves it straight, and flexed", "comparison",
           "Dynamorph, Reduced Quality", "{shaken straight}, {shaken flexed}"),
    Figure("The same with Blender's Soft Body, stiffness keyed by hand", "comparison", SOFT_BODY,
           "{shaken straight}, {shaken flexed}"),
    Figure("Clips of characters, most made elsewhere, that do not flicker", "believable", "flicker", "{within it}"),
    Figure("Error of Reduced Quality on a MakeHuman body, of the swing", "accuracy", "bone responses, 120", "{mean}",
           "MakeHuman, male"),
    Figure("Error of baked shape keys in Blender, of the body's size", "bakes", "Shape Keys",
           "{error, Blender 4.5.15}", "Round trips"),
    Figure("A ball pressed into a belly: how deep it shows, of the body's size", "collision",
           "mh chubby 53bones", "{at rest 2} % (below zero: not at all)"),
    Figure("The same on a low-poly head, the Husky's", "collision", "Husky", "{at rest 2} %"),
    Figure("A body that folds up: points inside it, without and with Self Collision", "collision",
           "mh chubby 53bones, Full", "{inside, without / with}"),
    Figure("From the click to Live, 13,000 vertices", "performance", "from the click to Live, MakeHuman",
           "{measured} (goal {goal})"),
    Figure("A bake of 250 frames, without reading the rig", "performance", FIRST_BAKE, "{measured} (goal {goal})"),
    Figure("What Live adds to a frame", "performance", "live: our share of a frame", "{measured} (goal {goal})"),
    Figure("Memory of Blender with 50,000 vertices", "how_long", "50,000", "{memory}"),
)  # fmt: skip
SHOWN = ("Husky", "bulging_cylinder", "herbert", "rolling_ball", "grabbed_belly")

TEXT = """# How well it works

The colors show how far the skin is from where the bones and the sculpted shapes put it: the motion that Dynamorph adds.
Each loop is in the [gallery](gallery.md), with its file and its recipe.

{loops}

## In numbers

These are from the [measurements](measurements.md). Those pages say how and on which machine each was measured, and
name every goal that is missed and every character that fails. With the defaults,
{believable}. [What it cannot do](limitations.md) lists what no figure shows.

{figures}
[How long it takes](how_long.md) has times for characters like yours, and [Comparison](comparison.md) other ways to move
soft parts. `make -C evidence how-well` writes this page.
"""


def main() -> int:
    PAGE.write_text(text(), encoding="utf-8")
    print(f"written to {PAGE.relative_to(ROOT)}")
    return 0


def text() -> str:
    """The page. Raises ValueError where a page has not what this one shows."""
    loops = "\n\n".join(f"{LOOPS[name].about}\n\n![{LOOPS[name].title}]({IMAGES}/{name}.webp)" for name in SHOWN)
    passed = re.search(r"\d+ of \d+ bakes of \d+ characters pass all limits", read("believable"))
    if not passed:
        raise ValueError("believable.md does not say how many bakes pass all limits")
    rows = [(figure.what, value(figure), f"[{date(figure.page)}]({figure.page}.md)") for figure in FIGURES]
    figures = grid(["", "", "measured"], rows)
    return TEXT.format(loops=loops, believable=passed[0], figures=figures)


def read(page: str) -> str:
    return (DOCS / f"{page}.md").read_text(encoding="utf-8")


def date(page: str) -> str:
    """When a page was measured: the latest of its dates."""
    return max(found[2] for found in LINE.finditer(read(page)))


def value(figure: Figure) -> str:
    titles, below = [], not figure.below
    for line in read(figure.page).splitlines():
        below = below or line.lstrip("# ").startswith(figure.below)
        if not line.startswith("|"):
            titles = []
        elif not titles:
            titles = cells(line)
        elif below and line.replace("*", "").startswith(f"| {figure.row}"):
            return filled(figure.text, titles, cells(line))
    raise ValueError(f"{figure.page}.md has no row '{figure.row}'")


def filled(text: str, titles: list[str], row: list[str]) -> str:
    return re.sub(r"\{(.+?)\}", lambda found: row[column(titles, found[1])], text)


def cells(line: str) -> list[str]:
    return [cell.strip(" *") for cell in line.strip()[1:-1].split("|")]


def column(titles: list[str], name: str) -> int:
    title, second = (name.removesuffix(" 2"), 1) if name.endswith(" 2") else (name, 0)
    return [k for k, each in enumerate(titles) if each == title][second]


if __name__ == "__main__":
    sys.exit(main())
