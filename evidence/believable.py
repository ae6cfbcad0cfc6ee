# SPDX-License-Identifier: GPL-3.0-or-later
"""`make believable`: docs/believable.md and its pictures, every character of ../shared after one click. No number is
typed here.

    python evidence/believable.py --only "Cow Fox" --sheet out.png
    python evidence/believable.py --before REVISION

Each character is baked and measured by believable_bake.py in a process of its own, with the liveliest of its clips and
with an everyday one. The findings stay in build/believable/NAME, in a folder for each; the page is made from them.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from project import ROOT

import numpy as np
from assets import ASSETS, attribution, require
from bench import machine
from characters import SHOTS
from contact_sheet import Row, compose, save
from measured import measured_at
from performance_page import grid
from PIL import Image

CACHE = ROOT / "build" / "believable"
PAGE = ROOT / "docs" / "believable.md"
IMAGES = "images/believable"
BAKES = ("liveliest", "everyday")  # clips, and the folders of what is found
ROWS = 8  # of a contact sheet
QUALITY = 70  # of the strips' WebP, at most 100
LONGEST = 900  # seconds that a character may take
ASKED = 0.95  # of the bakes are to pass
APART = 0.15  # of the finest cage's motion, that of the coarsest
SHAKEN = 0.005  # body sizes: what is shaken less need not move
HARD = ("Cyberpunk_Enemy_Large", "Leela", "Mech_Rae", "RobotExpressive")  # machines: nothing of them is soft
NOTHING_SOFT = "nothing soft"  # is in what the add-on says of them
GOAL = (5000, 5.0)  # vertices, and seconds from the click to the baked clip
MORE_FLICKER = 0.1  # than that of the bones alone
CONVERGENCE = ROOT / "docs" / "convergence.json"
NONE = "-"
COLUMNS = ("bones alone", "baked", "blue 1 % of size, green 3 %, yellow 5 %, red 10 %")

PAGE_TEXT = """# Believable from the first click

This page judges how characters look after *Add Soft Skin* and *Bake* with no other setting: the skin should move, stay
near the animation, and neither tremble nor tear nor turn inside out. Nearly all of these characters were made
elsewhere. `make -C evidence believable` measures and writes this page; nothing on it is written by hand.

**How to read it.** Each character is baked with two clips, and every bake is judged by its worst frame against all the
limits in the summary. A bake that misses one of them is not broken: it plays and can be saved, but in at least one
frame you can find edges that are squeezed too far, a thin part that swings, or a tremble. The goals are the
project's own, and each miss is bold so that it is not forgotten. In Blender the *verdict* after a bake tells you
about most of the same faults, and [Troubleshooting](troubleshooting.md) says what to change.

{commit}. Blender {blender}; {machine}; {jobs} characters at a time.

Each file is imported or opened, and its largest skinned mesh selected. It is baked with two clips, at most {frames}
frames of each: the liveliest of the file's, and an everyday one: a walk, a run or the like by its name, otherwise the
calmest. Where none moves the character, it hops twice and turns by 60° within a quarter of a second. The saved .blend
is measured from Blender's evaluated meshes, in every frame.

## Summary

**{passed} of {count} bakes of {characters} characters pass all limits ({share:.0%}; goal: {asked:.0%}).**
{broken} Flicker counts how often the skin's own motion turns, not how far it goes: in a calm walk that motion
is a small fraction of the body's size, and so is the tremble.

{limits} *Size*: diagonal of the box around the character at rest. Figures of a frame are of its worst one.
*Displacement*: how far the skin is from where plain skinning puts it, before the bones move it. *Over thickness*: 99th
percentile of the displacement divided by the local thickness, from the skin through all that is there: an eye, or the
root of a fin, counts as the body that it is sunk into, a pocket as the coat that it lies on, and a sheet has no
thickness. *Stretch*: length of edges, compared with plain skinning. *Stretch, least, of the bones' own*: divided by the
same figure of plain skinning, because the bones alone may make an edge vanish where a joint folds. *Flipped*: share of
the surface that turns over. *Inverted*: share of the cage's volume that turns inside out. *Thin parts*: how much the
thinnest fifth of the surface moves, compared with the thickest, if that is at least twice as thick. *Hands and feet*:
how much they move, compared with the torso, where arms and legs are found by their bones' names. *Seam*: gap between
meshes that touch at rest. *Alive*: motion of the liveliest tenth of the surface, and the share of it that moves at
least a tenth as much; counted where the clip shakes the thickest fifth of the character by {shaken:g} of its size, so a
clip that moves only the wings does not count. *Flicker*: how often the skin's own motion turns from frame to frame: a
slow swing is near -1, a swing of a quarter of the frame rate 0, up and down at every other frame 1; it may be above 0
where that of the bones alone in the world is, and then {more_flicker:g} above it. Wholly hard characters ({hard}) must
be refused with "nothing soft found".

Without a limit: *jitter*, the share of the acceleration's power above 0.35 of the frame rate, and the same at 24 frames
a second; *between frames*, the largest distance over the limit of the place where it is, at any step; *held back*, the
bone whose load exceeded the limit of its tissue most, and by which factor; *pulled*, the share of the steps in which
anything was pulled back.

## Characters

A row for each bake; the columns are explained above. Values that miss their limit are bold. Lengths are fractions of
the character's size, so 0.03 of a person with a size of 2 m is 60 mm.

{table}
{others}## Seconds

From the click to the baked clip, by stage. Bold: more than {goal_seconds:g} s with up to {goal_vertices:,} vertices.

{seconds}
## Pictures

The liveliest clip, at the frame of the largest displacement.

{pictures}
### Frame after frame

These are five consecutive frames around that one. The camera follows the place of the largest displacement as only the
bones move it.

{strips}
{convergence}## Attribution

{attribution}
- Sources and licenses: [Attribution](attribution.md).
"""

CONVERGENCE_TEXT = """## The cage converges

This section tests whether a finer cage would move differently. It hardly does where *apart* is small: the default of
about 2,000 nodes is then enough, and more **Cage Nodes** are for slim parts and small sculpts.

The MakeHuman man after one click, {frames} frames of his liveliest clip, without reduction, in cages of more and more
nodes. *Apart*: RMS over the surface of the motion about its mean less that of the finest cage, as a part of the RMS of
the latter. A build gives each cage the stiffness with which the body swings at {frequency:.3g} Hz;
*stiffness kept* is the coarsest cage's in all. Goal: {asked:.0%} for the coarsest.

{commit}.

{table}
"""


@dataclass(frozen=True)
class Limit:
    """A figure of a bake and its limits. bones: the same figure of the bones alone; what exceeds that by at most `more`
    is within the limits too. moving: asked only where the clip shakes the character."""

    key: str
    title: str
    low: float = -float("inf")
    high: float = float("inf")
    bones: str = ""
    more: float = 0.0
    moving: bool = False
    none_over: bool = False  # asked of all bakes

    def value(self, found: dict) -> float | None:
        return found.get(self.key, found["measured"].get(self.key))

    def asked(self, found: dict) -> bool:
        return self.value(found) is not None and not (self.moving and (found["measured"]["shaken"] or 0.0) < SHAKEN)

    def is_within(self, found: dict) -> bool:
        high = max(self.high, found["measured"][self.bones] + self.more) if self.bones else self.high
        return not self.asked(found) or self.low <= self.value(found) <= high

    def range(self) -> str:
        if self.low > -float("inf") and self.high < float("inf"):
            return f"{self.low:g} to {self.high:g}"
        more = f", or {self.more:g} above the bones' own" if self.bones else ""
        return f"≤ {self.high:g}{more}" if self.high < float("inf") else f"≥ {self.low:g}"


LIMITS = (
    Limit("disp_max", "largest displacement", high=0.1, none_over=True),
    Limit("disp_p999", "displacement", high=0.05),
    Limit("over_thickness", "over thickness", high=0.7),
    Limit("stretch_kept", "stretch, least, of the bones' own", low=0.6),
    Limit("stretch_hi", "stretch, most", high=1.6),
    Limit("flipped", "flipped", high=0.001),
    Limit("inverted", "inverted", high=0.001),
    Limit("thin_moves", "thin parts", high=0.3),
    Limit("ends_move", "hands and feet", high=0.5),
    Limit("seam", "seam", high=1e-6),
    Limit("alive", "alive", low=0.002, high=0.03, moving=True),
    Limit("alive_area", "alive area", low=0.1, moving=True),
    Limit("flicker", "flicker", high=0.0, bones="flicker_plain", more=MORE_FLICKER, none_over=True),
)
BESIDE = {  # figures without a limit
    "stretch_lo": "stretch, least",
    "plain_stretch_lo": "stretch, least, bones alone",
    "flicker_plain": "flicker, bones alone",
    "jitter": "jitter",
    "jitter_24": "jitter at 24 a second",
}
STAGES = {  # as jobs and builds call them
    "open": "open",
    "add": "add",
    "sample rig": "read the rig",
    "build": "build",
    "build: meshing": "meshing",
    "build: embedding": "embedding",
    "build: modes": "modes",
    "build: polynomials": "polynomials",
    "measure": "measure",
    "judge": "judge",
    "simulate": "simulate",
    "write keys": "write keys",
    "click to baked": "click to baked",
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", default="", help="characters, by the beginnings of their names; default: all")
    parser.add_argument("--sheet", type=Path, help="write their contact sheet there, and no page")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="characters at a time")
    parser.add_argument("--page", action="store_true", help="write the page from what was measured before")
    parser.add_argument(
        "--before", metavar="REVISION", help="compare how alive they are with the page of this revision"
    )
    arguments = parser.parse_args()
    require("believable", (*(shot.file for shot in SHOTS.values()), "zoo"))
    chosen = find(arguments.only.split())
    if not chosen:
        parser.error(f"no character's name begins with {arguments.only}")
    if arguments.before:
        print(comparison(arguments.before, [bakes[0] for asset in chosen if (bakes := kept(asset))]))
        return 0
    if not arguments.page:
        with ThreadPoolExecutor(arguments.jobs) as pool:
            for bakes in pool.map(lambda asset: measure(asset, arguments.jobs), chosen):
                print(*map(line, bakes), sep="\n", flush=True)
    results = [found for asset in chosen for found in kept(asset)]
    print(closing(results))
    if arguments.sheet:
        draw(results, arguments.sheet, small=False)
        draw_strips(results, arguments.sheet.with_name(f"{arguments.sheet.stem}_strips.png"))
        return 0
    everything = [kept(asset) for asset in find([])]
    if missing := everything.count([]):
        print(f"believable: {missing} characters were never measured: no page is written")
        return 0
    write_page([found for bakes in everything for found in bakes])
    print(f"written to {PAGE.relative_to(ROOT)}")
    return 0


# Measuring ------------------------------------------------------------------------------------------------------------


def find(beginnings: Sequence[str]) -> list[Path]:
    """The characters' files, by name."""
    files = [*ASSETS.glob("*.blend"), *ASSETS.glob("*.glb"), *ASSETS.glob("zoo/*.glb")]
    wanted = tuple(beginning.lower() for beginning in beginnings) or ("",)
    return sorted((file for file in files if file.stem.lower().startswith(wanted)), key=lambda file: file.stem.lower())


def kept(asset: Path) -> list[dict]:
    """What was found of a character when it was last measured: of the liveliest clip, and of the everyday one."""
    files = [CACHE / asset.stem / bake / "figures.json" for bake in BAKES]
    return [json.loads(file.read_text(encoding="utf-8")) for file in files if file.exists()]


def measure(asset: Path, jobs: int) -> list[dict]:
    """One character, with its liveliest clip and, if there is one and it is not hard, with an everyday clip."""
    folder = CACHE / asset.stem
    shutil.rmtree(folder, ignore_errors=True)
    found = [measure_once(asset, jobs, folder / BAKES[0])]
    if is_baked(found[0]) and found[0]["everyday"]:
        found.append(measure_once(asset, jobs, folder / BAKES[1], found[0]["everyday"]))
    return found


def measure_once(asset: Path, jobs: int, folder: Path, *clip: str) -> dict:
    """In a process of its own that may crash, with its output in a log."""
    folder.mkdir(parents=True)
    command = [sys.executable, Path(__file__).with_name("believable_bake.py"), asset, folder, *clip]
    with (folder / "log.txt").open("w") as log:
        try:
            code = subprocess.run(
                command, stdout=log, stderr=subprocess.STDOUT, timeout=LONGEST, check=False
            ).returncode
            failure = f"its process ended with {code}"
        except subprocess.TimeoutExpired:
            failure = f"it takes over {LONGEST} s"
    figures = folder / "figures.json"
    found = json.loads(figures.read_text(encoding="utf-8")) if figures.exists() else {"error": failure}
    found |= {
        "file": asset.name,
        "name": asset.stem,
        "bake": folder.name,
        "commit": measured_at(PAGE.name),
        "machine": machine(),
        "jobs": jobs,
    }
    figures.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return found


# Judging --------------------------------------------------------------------------------------------------------------


def is_baked(found: dict) -> bool:
    return "measured" in found


def failures(found: dict) -> list[str]:
    """What is wrong with a bake, by the limits' keys. A wholly hard one must be refused as such."""
    if found["name"] in HARD:
        return [] if NOTHING_SOFT in found.get("refused", "").lower() else ["hard"]
    if not is_baked(found):
        return ["refused" if "refused" in found else "error"]
    return [limit.key for limit in LIMITS if not limit.is_within(found)]


def line(found: dict) -> str:
    """What is printed of a bake."""
    wrong = ", ".join(failures(found)) or "passes"
    if not is_baked(found):
        return f"{found['name']}: {wrong}: {found.get('refused', found.get('error'))}"
    figures = " | ".join(f"{limit.title} {shown(limit, found)}" for limit in LIMITS if limit.value(found) is not None)
    return f"{found['name']}: {wrong} | {clip(found)} | {figures} | {found['seconds']['click to baked']:.1f} s"


def closing(results: list[dict]) -> str:
    passed = sum(not failures(found) for found in results)
    misses = dict.fromkeys(("error", "refused", "hard", *(limit.key for limit in LIMITS)), 0)
    for found in results:
        for key in failures(found):
            misses[key] += 1
    missed = ", ".join(f"{key} {count}" for key, count in misses.items() if count)
    return f"{passed} of {len(results)} bakes pass all limits; missed: {missed or 'none'}"


def shown(limit: Limit, found: dict) -> str:
    return number(limit.value(found))


def number(value: float | None) -> str:
    return NONE if value is None else f"{value:.2g}" if abs(value) < 1.0 else f"{value:.2f}"


# Earlier --------------------------------------------------------------------------------------------------------------


def comparison(revision: str, lively: list[dict]) -> str:
    """How alive each character is in its liveliest clip, over what the page of a revision of git says, line by line."""
    command = ["git", "show", f"{revision}:{PAGE.relative_to(ROOT).as_posix()}"]
    before = rows_of(subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout)
    lines, ratios = [], []
    for found in lively:
        old = before.get(title(found))
        if old and is_baked(found):
            was, now = float(old["alive"]), found["measured"]["alive"]
            ratios.append(now / was)
            played = clip_and_frames(found)
            other = "" if old["clip, frames"] == played else f", with another clip: {old['clip, frames']} -> {played}"
            lines.append(f"{title(found)}: {ratios[-1]:.2f} ({was:.2g} -> {now:.2g}){other}")
        elif old or is_baked(found):
            lines.append(f"{title(found)}: baked only {'before' if old else 'now'}")
    return "\n".join([*lines, f"median of {len(ratios)}: {np.median(ratios):.2f}" if ratios else "nothing to compare"])


def rows_of(page: str) -> dict[str, dict[str, str]]:
    """The first row of each character in a page's table of them: the cells by their column's title."""
    table = page.partition("## Characters\n")[2].partition("\n#")[0]
    head, _, *rows = ([cell.strip(" *") for cell in line.strip("|").split(" | ")] for line in table.splitlines()
                      if line.startswith("|"))  # fmt: skip
    found: dict[str, dict[str, str]] = {}
    for cells in rows:
        found.setdefault(cells[0], dict(zip(head, cells, strict=True)))
    return found


# The page -------------------------------------------------------------------------------------------------------------


def write_page(everything: list[dict]) -> None:
    baked = [found for found in everything if is_baked(found)]
    soft = [found for found in baked if found["name"] not in HARD]
    lively = [found for found in baked if found["bake"] == BAKES[0]]
    passed = sum(not failures(found) for found in everything)
    page = PAGE_TEXT.format(
        commit="; ".join(dict.fromkeys(found["commit"] for found in everything)),
        blender=everything[0]["blender"],
        machine="; ".join(dict.fromkeys(found["machine"] for found in everything)),
        jobs=max(found["jobs"] for found in everything),
        frames=48,
        passed=passed,
        count=len(everything),
        share=passed / len(everything),
        asked=ASKED,
        characters=len({found["name"] for found in everything}),
        broken=" ".join(map(partial(broken, soft), filter(lambda limit: limit.none_over, LIMITS))),
        limits=limits_table(soft),
        shaken=SHAKEN,
        hard=", ".join(HARD),
        table=characters_table(baked),
        others=others([found for found in everything if not is_baked(found)]),
        goal_vertices=GOAL[0],
        goal_seconds=GOAL[1],
        more_flicker=MORE_FLICKER,
        seconds=seconds_table(lively),
        pictures=pictures(lively),
        strips=strips(lively),
        convergence=convergence(),
        attribution=attribution(found["file"] for found in everything),
    )
    PAGE.write_text(page.rstrip() + "\n", encoding="utf-8")


def broken(baked: list[dict], limit: Limit) -> str:
    """Which bakes miss a limit that is asked of all, in a sentence."""
    names = [f"{title(found)} ({clip(found)})" for found in baked if not limit.is_within(found)]
    return f"**{limit.title.capitalize()}, missed by: {', '.join(names)}.**" if names else (
        f"None misses the limit of the {limit.title}.")  # fmt: skip


def limits_table(baked: list[dict]) -> str:
    """How many of those that are asked are within each limit."""
    rows = []
    for limit in LIMITS:
        asked = [found for found in baked if limit.asked(found)]
        within = sum(limit.is_within(found) for found in asked)
        needed = 1.0 if limit.none_over else ASKED
        share = f"{within / len(asked):.0%}" if asked else NONE
        rows.append((limit.title, limit.range(), f"{within} of {len(asked)}",
                     share if not asked or within >= needed * len(asked) else f"**{share}**"))  # fmt: skip
    return grid(("", "limit", "within it", "share"), rows)


def characters_table(baked: list[dict]) -> str:
    rows = []
    for found in baked:
        measured = found["measured"]
        about = (f"{measured['vertices']:,}", str(measured["meshes"]), clip_and_frames(found),
                 f"{measured['shaken']:.3f}")  # fmt: skip
        cells = (bold(shown(limit, found), not limit.is_within(found)) for limit in LIMITS)
        beside = (number(measured[key]) for key in BESIDE)
        rows.append((title(found), *about, *cells, *beside, f"{found['between_frames']:.2f}", held_back(found),
                     f"{found['pulled']:.0%}"))  # fmt: skip
    return grid(("", "vertices", "meshes", "clip, frames", "shaken", *(limit.title for limit in LIMITS),
                 *BESIDE.values(), "between frames", "held back", "pulled"), rows)  # fmt: skip


def held_back(found: dict) -> str:
    held = found["held"]
    return f"{held['bone']}, {held['excess']:.1f}" if held["excess"] > 1.0 else NONE


def title(found: dict) -> str:
    return found["name"].replace("_", " ")


def clip_and_frames(found: dict) -> str:
    first, last = found["frames"]
    return f"{clip(found)}, {last - first + 1}"


def clip(found: dict) -> str:
    return found["clip"].rpartition("|")[2]


def bold(text: str, wrong: bool) -> str:
    return f"**{text}**" if wrong else text


def others(unbaked: list[dict]) -> str:
    """Those that were not baked, as a list."""
    lines = []
    for found in unbaked:
        recognized = ": recognized as wholly hard" if not failures(found) else ", **not baked**"
        said = " ".join(found.get("refused", found.get("error", "")).split())
        lines.append(f"- {title(found)}{recognized}. “{said}”\n")
    return "".join([*lines, "\n"]) if lines else ""


def seconds_table(baked: list[dict]) -> str:
    stages = [stage for stage in STAGES if any(stage in found["seconds"] for found in baked)]
    rows = []
    for found in sorted(baked, key=lambda found: found["measured"]["vertices"]):
        seconds = [f"{found['seconds'][stage]:.2f}" if stage in found["seconds"] else NONE for stage in stages]
        slow = found["measured"]["vertices"] <= GOAL[0] and found["seconds"]["click to baked"] > GOAL[1]
        rows.append((title(found), f"{found['measured']['vertices']:,}",
                     str(found["measured"]["frames"]), *seconds[:-1], bold(seconds[-1], slow)))  # fmt: skip
    return grid(("", "vertices", "frames", *(STAGES[stage] for stage in stages)), rows)


def convergence() -> str:
    """The section of what convergence.py has found."""
    if not CONVERGENCE.exists():
        return ""
    found = json.loads(CONVERGENCE.read_text(encoding="utf-8"))
    rows = [
        (f"{row['nodes']:,}", f"{row['tets']:,}", f"{row['stiffness'] / 1000:.2f} kPa",
         f"{1000 * row['own_size']:.1f} mm", f"{row['own']:.1%}", f"{row['fixed']:.1%}", f"{row['seconds']:.0f}")
        for row in found
    ]  # fmt: skip
    rows[-1] = (*rows[-1][:4], NONE, NONE, rows[-1][6])
    head = ("nodes", "tetrahedra", "stiffness", "motion, RMS", "apart", "apart, stiffness kept", "seconds")
    return CONVERGENCE_TEXT.format(
        frames=found[0]["frames"], frequency=found[0]["frequency"], asked=APART, commit=found[0]["commit"],
        table=grid(head, rows),
    )  # fmt: skip


def pictures(lively: list[dict]) -> str:
    """Contact sheets, and the text that shows them."""
    for old in (PAGE.parent / IMAGES).glob("characters_*"):
        old.unlink()
    return sheets(lively, "characters", "png", partial(draw, small=True))


def strips(lively: list[dict]) -> str:
    for old in (PAGE.parent / IMAGES).glob("strips_*"):
        old.unlink()
    return sheets(lively, "strips", "webp", draw_strips)


def sheets(lively: list[dict], name: str, suffix: str, drawn: Callable[[list[dict], Path], None]) -> str:
    """So many characters in each; the text that shows them."""
    lines = []
    for number, first in enumerate(range(0, len(lively), ROWS), 1):
        part = lively[first : first + ROWS]
        drawn(part, PAGE.parent / IMAGES / f"{name}_{number}.{suffix}")
        lines.append(f"![{title(part[0])} to {title(part[-1])}]({IMAGES}/{name}_{number}.{suffix})\n")
    return "\n".join(lines)


def draw(results: list[dict], path: Path, small: bool) -> None:
    """Plain, baked and heat map of each bake, one below the other."""
    rows = []
    for found in filter(is_baked, results):
        notes = (f"{clip(found)}, frame {found['worst_frame']}", "", f"at most {found['measured']['disp_max']:.1%}")
        rows.append(Row(title(found), about(found), images(found, ("plain", "baked", "heat")), notes))
    if rows:
        save(compose("One click", "At the frame of the largest displacement", COLUMNS, rows), path, small)


def draw_strips(results: list[dict], path: Path) -> None:
    """Five consecutive frames of each bake, one below the other."""
    rows = []
    for found in filter(is_baked, results):
        frames = found["strip"]
        notes = [f"frame {frame}: {far:.1%}" for frame, far in zip(frames, found["strip_displacements"], strict=True)]
        names = [f"strip_{number}" for number in range(1, len(frames) + 1)]
        rows.append(Row(f"{title(found)}, {clip(found)}", about(found), images(found, names), notes))
    if rows:
        sheet = compose("Frame after frame", "Around the largest displacement", [""] * len(rows[0].notes), rows)
        sheet.save(path, quality=QUALITY, method=6)


def about(found: dict) -> str:
    """What is wrong with a bake, for its pictures."""
    if "hard" in failures(found):
        return "is wholly hard and not recognized"
    wrong = [limit for limit in LIMITS if limit.key in failures(found)]
    return ", ".join(f"{limit.title} {shown(limit, found)}" for limit in wrong) or "passes"


def images(found: dict, names: Sequence[str]) -> list[Image.Image]:
    return [Image.open(CACHE / found["name"] / found["bake"] / f"{name}.png") for name in names]


if __name__ == "__main__":
    sys.exit(main())
