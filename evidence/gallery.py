# SPDX-License-Identifier: GPL-3.0-or-later
"""`make gallery`: docs/gallery.md and its moving pictures, the sample scenes and some characters of ../shared, and in
dist/gallery each scene's .blend before and after the bake. No number is typed here but what red stands for in them.

    python evidence/gallery.py --only "Husky bulging"

Each is filmed by gallery_loop.py in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from project import ROOT

from assets import ASSETS, attribution
from bench import machine
from measured import measured_at

PAGE = ROOT / "docs" / "gallery.md"
IMAGES = "images/gallery"
FILMED = ROOT / "build" / "gallery"
BLENDS = ROOT / "dist" / "gallery"
LARGEST = 600e3  # bytes of a loop
BUSY = (os.cpu_count() or 1) + 2.0  # processes that wait for a core; filming is one or two of them
NONE = "-"

# What the panes of a scene differ in: the section of the page.
TARGETS, COLLISION, SELF_COLLISION, QUALITY = "targets", "collision", "self-collision", "quality"


@dataclass(frozen=True)
class Loop:
    """One moving picture, and in `about` what it shows: a sample scene with its soft object, what its panes differ in,
    the first and the last frame and the motion that is red, meters; or a character's file of ../shared/assets, whose
    largest motion is red. recipe: the page of docs/recipes that makes it.
    """

    name: str
    title: str
    about: str
    recipe: str
    body: str = ""
    differs: str = ""
    frames: tuple[int, int] = (1, 1)
    red: float = 0.0
    file: str = ""


LOOPS = {
    loop.name: loop
    for loop in (
        Loop(
            "bulging_cylinder", "Bulging cylinder", "Bent, a limb bulges as it was sculpted and hardly moves when it "
            "is pushed and shaken; straight, it is soft again.", "bulge", "Limb", TARGETS, (28, 150), 0.012,
        ),
        Loop(
            "shoulder", "Shoulder", "The elbow folds with the arm raised: a single material lets the biceps run into "
            "the forearm, and the target *Folded* does not.", "bulge", "Shoulder", TARGETS, (38, 104), 0.008,
        ),
        Loop(
            "herbert", "Herbert", "Herbert's belly swings while he is upright, and is stiff in the tuck of his dive.",
            "firm_parts", "Herbert", TARGETS, (56, 108), 0.04,
        ),
        Loop(
            "rolling_ball", "Rolling ball", "A ball falls on a belly, dents it and rolls over it.", "collision",
            "Torso", COLLISION, (1, 84), 0.03,
        ),
        Loop(
            "herbert_bench", "Herbert on a bench", "Herbert slides over a bench on his belly, and flops on the floor.",
            "collision", "Herbert", COLLISION, (1, 40), 0.08,
        ),
        Loop(
            "pressed_cylinder", "Pressed cylinder", "A hand presses a soft limb twice, and pulls at its skin.",
            "collision", "Limb", COLLISION, (1, 72), 0.02,
        ),
        Loop(
            "folded_limb", "Folded limb", "A limb folds until its halves flatten each other instead of passing through "
            "each other.", "collision", "Limb", SELF_COLLISION, (1, 84), 0.02,
        ),
        Loop(
            "grabbed_belly", "Grabbed belly", "A hand pulls a belly up and aside and lets it go, as *Record Drags* "
            "recorded it.", "grab", "Torso", QUALITY, (1, 72), 0.05,
        ),
        Loop("Husky", "Husky", "A dog gallops, and its soft body follows.", "jiggle", file="zoo/Husky.glb"),
        Loop("Velociraptor", "Velociraptor", "A dinosaur jumps and lands.", "jiggle", file="zoo/Velociraptor.glb"),
        Loop("Dolphin", "Dolphin", "A dolphin hops and twists.", "jiggle", file="zoo/Dolphin.glb"),
        Loop("Woman_Witch", "Woman, witch", "A witch hops and twists in her clothes.", "jiggle",
             file="zoo/Woman_Witch.glb"),
        Loop("Blobfish", "Blobfish", "A blobfish flops out of the water.", "jiggle", file="zoo/Blobfish.glb"),
    )
}  # fmt: skip

PAGE_TEXT = """# Gallery

Colors show the soft tissue's own motion: how far the skin is from where the bones and the targets' sculpted shapes put
it. `make -C evidence gallery` films these loops and writes this page.

A link beside each loop leads to the recipe that makes it. Each scene comes as two files: one ready to bake, and one
baked, which plays at once. `make -C evidence gallery` writes both to `dist/gallery`, and a release has them as
downloads. The scenes are CC0.

The tables give what was baked, and the seconds that building the model and baking took, from nothing, on this machine:
{machine}. A missing time means that the machine had other work.

{commit}.

## Single material and dynamic morph targets

{targets}
## Collision

The scenes of this section and of the next two are baked with *Quality* Full.

{collision}
## Self-collision

{selfcollision}
## Grab

The same drags in both qualities: *Full* follows the hand more closely than *Reduced*.

{quality}
## Characters

Each character is shown after *Add Soft Skin* and *Bake*, with no other setting, beside plain skinning. The clips are
the liveliest of their files. The characters' files are not published with this project; [Attribution](attribution.md)
says where they come from. All characters that were tried, with their figures: [Believable](believable.md).

{characters}
## Attribution

{attribution}
- Sources and licenses: [Attribution](attribution.md).
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", default="", help="loops, by the beginnings of their names; default: all")
    parser.add_argument("--page", action="store_true", help="write the page from what was filmed before")
    arguments = parser.parse_args()
    beginnings = tuple(begin.lower() for begin in arguments.only.split()) or ("",)
    chosen = [loop for loop in LOOPS.values() if loop.name.lower().startswith(beginnings)]
    if not chosen:
        parser.error(f"no loop's name begins with {arguments.only}")
    if not arguments.page:
        absent = [loop for loop in chosen if loop.file and not (ASSETS / loop.file).exists()]
        for loop in chosen:
            if loop not in absent:
                print(film(loop), flush=True)
        if absent:
            names = ", ".join(loop.file for loop in absent)
            print(f"gallery: left out, because ../shared/assets lacks them: {names}. See docs/attribution.md")
    missing = [name for name in LOOPS if not (FILMED / f"{name}.json").exists()]
    if missing:
        print(f"gallery: {', '.join(missing)} not filmed yet: no page is written")
        return int(arguments.page)
    PAGE.write_text(page(), encoding="utf-8")
    print(f"written to {PAGE.relative_to(ROOT)}")
    return 0


def film(loop: Loop) -> str:
    """One loop, and its text."""
    FILMED.mkdir(parents=True, exist_ok=True)
    with (FILMED / f"{loop.name}.log").open("w") as output:
        command = [sys.executable, Path(__file__).with_name("gallery_loop.py"), loop.name, FILMED, BLENDS]
        subprocess.run(command, stdout=output, stderr=subprocess.STDOUT, check=True)
    facts = FILMED / f"{loop.name}.json"
    about = {"commit": measured_at(PAGE.name), "machine": machine(), "load": os.getloadavg()[0]}
    found = json.loads(facts.read_text(encoding="utf-8")) | about
    facts.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    made = FILMED / f"{loop.name}.webp"
    picture = PAGE.parent / IMAGES / made.name
    picture.parent.mkdir(parents=True, exist_ok=True)
    picture.write_bytes(made.read_bytes())
    size = made.stat().st_size
    return f"{loop.name}: {size / 1e6:.2f} MB{', too large' if size > LARGEST else ''}"


def page() -> str:
    found = {name: json.loads((FILMED / f"{name}.json").read_text(encoding="utf-8")) for name in LOOPS}
    files = [loop.file.rpartition("/")[2] for loop in LOOPS.values() if loop.file]
    sections = {differs: section(found, differs) for differs in (TARGETS, COLLISION, SELF_COLLISION, QUALITY, "")}
    return PAGE_TEXT.format(
        commit="; ".join(dict.fromkeys(each["commit"] for each in found.values())),
        machine="; ".join(dict.fromkeys(each["machine"] for each in found.values())),
        targets=sections[TARGETS],
        collision=sections[COLLISION],
        selfcollision=sections[SELF_COLLISION],
        quality=sections[QUALITY],
        characters=sections[""],
        attribution=attribution(files),
    )


def section(found: dict[str, dict], differs: str) -> str:
    return "\n".join(about(loop, found[loop.name]) for loop in LOOPS.values() if loop.differs == differs)


def about(loop: Loop, found: dict) -> str:
    """Of one loop: its title, what it shows, its picture, what was baked, and its files."""
    if loop.body:
        shown = {title: f"{1000 * most:.3g} mm" for title, most in found["farthest"].items()}
        # Collision moves the skin elsewhere, not farther: a comparison would mislead.
        farthest = (
            [*shown.values()][-1]
            if loop.differs in (COLLISION, SELF_COLLISION)
            else "; ".join(f"{title} {most}" for title, most in shown.items())
        )
        files = f"`{loop.name}.blend`, baked `{loop.name}_baked.blend`"
    else:
        farthest = f"{found['farthest']:.1%} of the body's size, in *{found['clip'].rpartition('|')[2]}*"
        files = "not published"
    values = {
        "Vertices": f"{found['vertices']:,}",
        "Targets": found["targets"],
        "Detail": found["detail"],
        "Frames": found["baked"],
        "Build": seconds(found, "build"),
        "Bake": seconds(found, "bake"),
        "Files": files,
    }
    return (
        f"### {loop.title}\n\n{loop.about} [Recipe](recipes/{loop.recipe}.md)\n\n"
        f"![{loop.title}]({IMAGES}/{loop.name}.webp)\n\n"
        f"| {' | '.join(values)} |\n|{' --- |' * len(values)}\n| {' | '.join(map(str, values.values()))} |\n\n"
        f"The tissue moves by at most: {farthest}.\n"
    )


def seconds(found: dict, stage: str) -> str:
    """Nothing where the machine had so much other work that they would mislead."""
    return f"{found[stage]:.2g} s" if found["load"] < BUSY else NONE


if __name__ == "__main__":
    sys.exit(main())
