# SPDX-License-Identifier: GPL-3.0-or-later
"""`make believable`: docs/believable.md and its pictures, every character of ../shared after one click. No number is
typed here.

    python tests/benchmarks/believable.py --only "Cow Fox" --sheet out.png

Each character is baked and measured by believable_bake.py in a process of its own, and once more with another clip
where the bones alone fold edges away. The findings stay in build/believable/NAME; the page is made from them.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / folder) for folder in ("addon", "tests/addon", "sample_blends", "tools")]

from characters import ASSETS, attribution  # noqa: E402
from contact_sheet import Row, compose, save  # noqa: E402
from dynamic_morph_targets.__main__ import leave  # noqa: E402
from measured import measured_at  # noqa: E402
from performance_page import grid  # noqa: E402
from PIL import Image  # noqa: E402
from run import machine  # noqa: E402

CACHE = ROOT / "build" / "believable"
PAGE = ROOT / "docs" / "believable.md"
IMAGES = "images/believable"
ROWS = 8  # of a contact sheet
LONGEST = 900  # seconds that a character may take
ASKED = 0.95  # of the characters are to pass
APART = 0.15  # of the finest cage's motion, that of the coarsest
SHAKEN = 0.005  # body sizes: what is shaken less need not move
HARD = ("Leela", "Mech_Rae", "RobotExpressive")  # nothing of them is soft
NOTHING_SOFT = "nothing soft"  # is in what the add-on says of them
GOAL = (5000, 5.0)  # vertices, and seconds from the click to the baked clip
LEAST_STRETCH = 0.6
UNFOLDED = "unfolded"  # to believable_bake.py, and the folder of what it finds
CONVERGENCE = ROOT / "docs" / "convergence.json"
NONE = "-"
COLUMNS = ("bones alone", "baked", "blue 1 % of size, green 3 %, yellow 5 %, red 10 %")

PAGE_TEXT = """# Believable from the first click

How characters, nearly all of them made elsewhere, look after *Add Soft Skin* and *Bake*, with no other setting. `make
believable` measures and writes this page; nothing on it is written by hand.

{commit}. Blender {blender}; {machine}; {jobs} characters at a time.

Each file is imported or opened, and its largest skinned mesh selected. The clip is the liveliest of the file's, at most
{frames} frames of it; where none moves the character, it hops twice and turns by 60° within a quarter of a second. The
saved .blend is measured from Blender's evaluated meshes, in every frame.

## Summary

**{passed} of {count} characters pass all limits ({share:.0%}; asked: {asked:.0%}).**{broken}
In {folded} of the others the bones alone shorten edges beyond the limit, where a joint folds: no soft skin can repair
that. **With the liveliest clip in which they do not, {passed_unfolded} of {count} pass.**

{limits}
*Size*: diagonal of the box around the character at rest. Figures of a frame are of its worst one. *Displacement*: how
far the skin is from where the bones alone have it, before they move it. *Over thickness*: 99th percentile of the
displacement divided by the local thickness. *Stretch*: length of edges, compared with plain skinning. *Flipped*: share
of the surface that turns over. *Inverted*: share of the cage's volume that turns inside out. *Thin parts*: how much the
thinnest fifth of the surface moves, compared with the thickest. *Seam*: gap between meshes that touch at rest. *Alive*:
motion of the liveliest tenth of the surface, and the share of it that moves at least a tenth as much; asked where the
clip shakes the character by {shaken:g} of its size. Wholly hard characters ({hard}) must be
refused with "nothing soft found". *Stretch, least, bones alone*: the same figure of plain skinning, which may make an
edge vanish where a joint folds; soft tissue does not lengthen what the bones alone shorten too much.

## Characters

Values that miss their limit are bold.

{table}
{others}### Where the bones fold no edges away

The characters whose edges the bones alone shorten too much, in their liveliest clip without that. Where there is none,
they hop and twist.

{unfolded}
## Seconds

From the click to the baked clip, by stage. Bold: more than {goal_seconds:g} s with up to {goal_vertices:,} vertices.

{seconds}
## Pictures

The frame of the largest displacement.

{pictures}
{convergence}## Attribution

{attribution}
- Sources and licenses: [Attribution](attribution.md).
"""

CONVERGENCE_TEXT = """## The cage converges

The MakeHuman man after one click, {frames} frames of his liveliest clip, without reduction, in cages of more and more
nodes. *Apart*: RMS over the surface of the motion about its mean less that of the finest cage, as a part of the RMS of
the latter. A build gives each cage the stiffness with which the body swings at {frequency:.3g} Hz;
*stiffness kept* is the coarsest cage's in all. Asked: {asked:.0%} for the coarsest.

{commit}.

{table}
"""


@dataclass(frozen=True)
class Limit:
    """A figure of a bake and its limits. moving: asked only where the clip shakes the character."""

    key: str
    title: str
    low: float = -float("inf")
    high: float = float("inf")
    moving: bool = False
    none_over: bool = False  # asked of all characters

    def value(self, found: dict) -> float | None:
        return found.get(self.key, found["measured"].get(self.key))

    def asked(self, found: dict) -> bool:
        return self.value(found) is not None and not (self.moving and (found["measured"]["shaken"] or 0.0) < SHAKEN)

    def is_within(self, found: dict) -> bool:
        return not self.asked(found) or self.low <= self.value(found) <= self.high

    def range(self) -> str:
        if self.low > -float("inf") and self.high < float("inf"):
            return f"{self.low:g} to {self.high:g}"
        return f"≤ {self.high:g}" if self.high < float("inf") else f"≥ {self.low:g}"


LIMITS = (
    Limit("disp_max", "largest displacement", high=0.1, none_over=True),
    Limit("disp_p999", "displacement", high=0.05),
    Limit("over_thickness", "over thickness", high=0.7),
    Limit("stretch_lo", "stretch, least", low=LEAST_STRETCH),
    Limit("stretch_hi", "stretch, most", high=1.6),
    Limit("flipped", "flipped", high=0.001),
    Limit("inverted", "inverted", high=0.001),
    Limit("thin_moves", "thin parts", high=0.3),
    Limit("seam", "seam", high=1e-6),
    Limit("alive", "alive", low=0.002, high=0.03, moving=True),
    Limit("alive_area", "alive area", low=0.1, moving=True),
)
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
    arguments = parser.parse_args()
    if not ASSETS.is_dir():
        print("believable: there is no ../shared/assets: nothing is written")
        return 0
    chosen = find(arguments.only.split())
    if not chosen:
        parser.error(f"no character's name begins with {arguments.only}")
    if not arguments.page:
        with ThreadPoolExecutor(arguments.jobs) as pool:
            for found in pool.map(lambda asset: measure(asset, arguments.jobs), chosen):
                print(line(found), flush=True)
                if again := kept_unfolded(found):
                    print(f"  {line(again)}", flush=True)
    results = [found for asset in chosen if (found := kept(asset))]
    print(closing(results))
    if arguments.sheet:
        draw(results, arguments.sheet, small=False)
        return 0
    everything = [found for asset in find([]) if (found := kept(asset))]
    if len(everything) < len(find([])):
        print(f"believable: {len(find([])) - len(everything)} characters were never measured: no page is written")
        return 0
    write_page(everything)
    print(f"written to {PAGE.relative_to(ROOT)}")
    return 0


# Measuring ------------------------------------------------------------------------------------------------------------


def find(beginnings: Sequence[str]) -> list[Path]:
    """The characters' files, by name."""
    files = [*ASSETS.glob("*.blend"), *ASSETS.glob("*.glb"), *ASSETS.glob("zoo/*.glb")]
    wanted = tuple(beginning.lower() for beginning in beginnings) or ("",)
    return sorted((file for file in files if file.stem.lower().startswith(wanted)), key=lambda file: file.stem.lower())


def kept(asset: Path) -> dict | None:
    """What was found of a character when it was last measured."""
    return figures_in(CACHE / asset.stem)


def kept_unfolded(found: dict) -> dict | None:
    """The same in a clip in which the bones fold no edges away, where they do in the liveliest."""
    return figures_in(CACHE / found["name"] / UNFOLDED)


def figures_in(folder: Path) -> dict | None:
    figures = folder / "figures.json"
    return json.loads(figures.read_text(encoding="utf-8")) if figures.exists() else None


def measure(asset: Path, jobs: int) -> dict:
    """One character, and once more where the bones alone fold edges away."""
    folder = CACHE / asset.stem
    shutil.rmtree(folder, ignore_errors=True)
    found = measure_once(asset, jobs, folder)
    if "stretch_lo" in failures(found) and found["plain_stretch_lo"] < LEAST_STRETCH:
        measure_once(asset, jobs, folder / UNFOLDED, UNFOLDED)
    return found


def measure_once(asset: Path, jobs: int, folder: Path, *how: str) -> dict:
    """In a process of its own that may crash, with its output in a log."""
    folder.mkdir(parents=True)
    command = [sys.executable, Path(__file__).with_name("believable_bake.py"), asset, folder, *how]
    with (folder / "log.txt").open("w") as log:
        try:
            code = subprocess.run(
                command, stdout=log, stderr=subprocess.STDOUT, timeout=LONGEST, check=False
            ).returncode
            failure = f"its process ended with {code}"
        except subprocess.TimeoutExpired:
            failure = f"it takes over {LONGEST} s"
    found = figures_in(folder) or {"file": asset.name, "error": failure}
    found |= {"name": asset.stem, "commit": measured_at(PAGE.name), "machine": machine(), "jobs": jobs}
    (folder / "figures.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return found


# Judging --------------------------------------------------------------------------------------------------------------


def is_baked(found: dict) -> bool:
    return "measured" in found


def failures(found: dict) -> list[str]:
    """What is wrong with a character, by the limits' keys. A wholly hard one must be refused as such."""
    if found["name"] in HARD:
        return [] if NOTHING_SOFT in found.get("refused", "").lower() else ["hard"]
    if not is_baked(found):
        return ["refused" if "refused" in found else "error"]
    return [limit.key for limit in LIMITS if not limit.is_within(found)]


def passes_unfolded(found: dict) -> bool:
    """Whether a character passes, in another clip where the bones alone fold edges away in its liveliest."""
    return not failures(kept_unfolded(found) or found)


def line(found: dict) -> str:
    """What is printed of a character."""
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
    unfolded = sum(passes_unfolded(found) for found in results)
    return (
        f"{passed} of {len(results)} characters pass all limits, {unfolded} where the bones fold no edges away; "
        f"missed: {missed or 'none'}"
    )


def shown(limit: Limit, found: dict) -> str:
    value = limit.value(found)
    return NONE if value is None else f"{value:.2g}" if value < 1.0 else f"{value:.2f}"


# The page -------------------------------------------------------------------------------------------------------------


def write_page(everything: list[dict]) -> None:
    soft = [found for found in everything if found["name"] not in HARD]
    baked = [found for found in everything if is_baked(found)]
    passed = sum(not failures(found) for found in everything)
    broken = [found["name"] for found in soft if is_baked(found) and not LIMITS[0].is_within(found)]
    unfolded = [again for found in everything if (again := kept_unfolded(found))]
    page = PAGE_TEXT.format(
        passed_unfolded=sum(passes_unfolded(found) for found in everything),
        unfolded=characters_table([found for found in unfolded if is_baked(found)])
        + others([found for found in unfolded if not is_baked(found)]),
        folded=len(unfolded),
        commit="; ".join(dict.fromkeys(found["commit"] for found in everything)),
        blender=everything[0]["blender"],
        machine="; ".join(dict.fromkeys(found["machine"] for found in everything)),
        jobs=max(found["jobs"] for found in everything),
        frames=48,
        passed=passed,
        count=len(everything),
        share=passed / len(everything),
        asked=ASKED,
        broken=f" Over {LIMITS[0].high:g} of size: {', '.join(broken)}." if broken else "",
        limits=limits_table([found for found in baked if found in soft]),
        shaken=SHAKEN,
        hard=", ".join(HARD),
        table=characters_table(baked),
        others=others([found for found in everything if not is_baked(found)]),
        goal_vertices=GOAL[0],
        goal_seconds=GOAL[1],
        seconds=seconds_table(baked),
        pictures=pictures(baked),
        convergence=convergence(),
        attribution=attribution(found["file"] for found in everything),
    )
    PAGE.write_text(page.rstrip() + "\n", encoding="utf-8")


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
        measured, (first, last) = found["measured"], found["frames"]
        about = (f"{measured['vertices']:,}", str(measured["meshes"]), f"{clip(found)}, {last - first + 1}",
                 f"{measured['shaken']:.3f}")  # fmt: skip
        cells = (bold(shown(limit, found), not limit.is_within(found)) for limit in LIMITS)
        rows.append((title(found), *about, *cells, f"{found['plain_stretch_lo']:.2f}"))
    return grid(("", "vertices", "meshes", "clip, frames", "shaken", *(limit.title for limit in LIMITS),
                 "stretch, least, bones alone"), rows)  # fmt: skip


def title(found: dict) -> str:
    return found["name"].replace("_", " ")


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


def pictures(baked: list[dict]) -> str:
    """Contact sheets, and the text that shows them."""
    folder = PAGE.parent / IMAGES
    for old in folder.glob("*.png"):
        old.unlink()
    lines = []
    for number, first in enumerate(range(0, len(baked), ROWS), 1):
        part = baked[first : first + ROWS]
        draw(part, folder / f"characters_{number}.png", small=True)
        names = f"{part[0]['name']} to {part[-1]['name']}".replace("_", " ")
        lines.append(f"![{names}]({IMAGES}/characters_{number}.png)\n")
    return "\n".join(lines)


def draw(results: list[dict], path: Path, small: bool) -> None:
    """Plain, baked and heat map of each character, one below the other."""
    rows = []
    for found in filter(is_baked, results):
        images = [Image.open(CACHE / found["name"] / f"{name}.png") for name in ("plain", "baked", "heat")]
        wrong = [limit for limit in LIMITS if limit.key in failures(found)]
        about = ", ".join(f"{limit.title} {shown(limit, found)}" for limit in wrong) or "passes"
        if "hard" in failures(found):
            about = "is wholly hard and not recognized"
        notes = (f"{clip(found)}, frame {found['worst_frame']}", "", f"at most {found['measured']['disp_max']:.1%}")
        rows.append(Row(title(found), about, images, notes))
    if rows:
        save(compose("One click", "At the frame of the largest displacement", COLUMNS, rows), path, small)


if __name__ == "__main__":
    leave(main())
