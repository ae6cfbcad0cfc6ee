# SPDX-License-Identifier: GPL-3.0-or-later
"""`make -C evidence gaps`: docs/window.md, how long Blender's window waits for the add-on, with a plot. No number is
typed here. Needs the window of `gui-test`.

    python evidence/gaps.py [--name "before"]   measures, and keeps what it finds under this name beside others
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys

from project import ROOT

import gui_test
import numpy as np
from bench import machine
from gui_test import SCREEN, WORK, enter, inside
from measured import measured_at

VERTICES, FRAMES = 13_000, 120
PAGE = ROOT / "docs" / "window.md"
PLOT = "images/window/gaps.svg"
KEPT = ROOT / "build" / "reports" / "gaps.json"
BEFORE, NOW = "before", "now"

PAGE_TEXT = """# Does Blender's window wait?

Builds, bakes and comparisons are computed by a process of their own ([architecture](architecture.md#the-extension)), so
that Blender's window goes on meanwhile. This page measures the gaps between two turns of the window's event loop while
a character of {vertices:,} vertices becomes a soft skin, is built, shown by *Live*, and baked over {frames} frames. You
feel a gap of 50 ms or more. The window shows panels and no 3D view, because without a graphics card drawing one takes
longer than all else. The row *Panels are drawn* is what such a drawing takes here, with nothing to compute. The memory
is the most during a stage; other processes are the one that computes, its mesher, and one that waits for the next work.

`make -C evidence gaps` measures and writes this page; nothing on it is typed by hand.

{measured}

![Gaps of the window's event loop](images/window/gaps.svg)

{tables}
What is left, by the longest gaps of each stage:

{longest}
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--name", default=NOW, help=f"of what is measured; default: {NOW}")
    parser.add_argument("--page", action="store_true", help="write the page from what was measured before")
    arguments = parser.parse_args()
    kept = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.exists() else {}
    if not arguments.page:
        try:
            kept[arguments.name] = {"measured": f"{measured_at(PAGE.name)}; {machine()}", "stages": measured()}
        except gui_test.CannotRun as reason:
            print(f"gaps: SKIPPED, {reason}")
            return 0
        KEPT.parent.mkdir(parents=True, exist_ok=True)
        KEPT.write_text(json.dumps(kept), encoding="utf-8")
    write_page(kept)
    print(f"written to {PAGE.relative_to(ROOT)}")
    return 0


def measured() -> dict:
    """What evidence/window/gaps.py found. Raises CannotRun, Failed."""
    WORK.mkdir(parents=True, exist_ok=True)
    gui_test.set_up_blender()
    gui_test.pack_extension()
    gui_test.install()
    scene, found = WORK / "gaps.blend", WORK / "gaps.json"
    found.unlink(missing_ok=True)
    subprocess.run([sys.executable, __file__.replace("gaps.py", "gaps_scene.py"), scene, str(VERTICES)], check=True)
    enter(
        "gaps.log",
        "xvfb-run", "-a", "-s", f"-screen 0 {SCREEN[0]}x{SCREEN[1]}x24 +extension GLX -noreset",
        "blender", "--gpu-backend", "opengl", "--no-window-focus", "--window-geometry", "0", "0", "800", "600",
        inside(scene), "--python", inside(ROOT / "evidence/window/gaps.py"), "--", inside(WORK),
        LIBGL_ALWAYS_SOFTWARE="1",
    )  # fmt: skip
    if not found.exists():
        raise gui_test.Failed(f"nothing was measured\n{gui_test.tail('gaps.log')}")
    return json.loads(found.read_text(encoding="utf-8"))


def write_page(kept: dict) -> None:
    tables = "\n".join(
        f"{name.capitalize()}, in milliseconds:\n\n{table(kept[name]['stages'])}" for name in sorted(kept, reverse=True)
    )
    draw(kept)
    text = PAGE_TEXT.format(
        vertices=VERTICES,
        frames=FRAMES,
        measured="\n".join(f"- {name.capitalize()}: {kept[name]['measured']}." for name in sorted(kept, reverse=True)),
        tables=tables,
        longest=longest(kept[NOW]["stages"] if NOW in kept else {}),
    )
    PAGE.write_text(text, encoding="utf-8")


def table(stages: dict) -> str:
    rows = [
        "| | turns | median | 99 % | longest | over 50 ms | Blender, MB | other processes, MB |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for name, found in stages.items():
        gaps = 1000.0 * np.array(found["gaps"])
        half, most = np.percentile(gaps, [50, 99])
        cells = name, len(gaps), *(f"{gap:.0f}" for gap in (half, most, gaps.max())), (gaps > 50).sum()
        memory = (f"{bytes / 2**20:,.0f}" if bytes else "" for bytes in found["memory"])
        rows.append(f"| {' | '.join(map(str, (*cells, *memory)))} |")
    return "\n".join(rows) + "\n"


def longest(stages: dict) -> str:
    lines = []
    for name, found in stages.items():
        named = [f"{1000 * gap:.0f} ms ({doing or 'before it began'})" for gap, doing in found["longest"][:3]]
        lines.append(f"- {name}: {', '.join(named)}")
    return "\n".join(lines)


def draw(kept: dict) -> None:
    import plots

    drawing, axes = plots.figure(len(kept))
    for (name, found), axis in zip(sorted(kept.items()), axes, strict=True):
        for stage in ("Build", "Bake"):
            gaps = np.array(found["stages"][stage]["gaps"])
            axis.plot(np.cumsum(gaps), 1000.0 * gaps, label=stage, linewidth=0.8)
        axis.axhline(50.0, color="#8a8f98", linestyle="--", linewidth=0.8)
        axis.set(title=name.capitalize(), xlabel="seconds", ylabel="gap, ms", ylim=(0.0, None))
        axis.legend(fontsize=8)
    path = PAGE.parent / PLOT
    path.parent.mkdir(parents=True, exist_ok=True)
    drawing.savefig(path)


if __name__ == "__main__":
    sys.exit(main())
