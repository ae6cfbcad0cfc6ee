# SPDX-License-Identifier: GPL-3.0-or-later
"""`make gallery`: docs/gallery.md and its moving pictures, the sample scenes and some characters of ../shared. No
number is typed here but what red stands for in the scenes.

    python tests/benchmarks/gallery.py --only "Husky bulging"

Each is filmed by gallery_loop.py in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests/addon"), str(ROOT / "tools")]

from characters import attribution  # noqa: E402
from measured import measured_at  # noqa: E402

PAGE = ROOT / "docs" / "gallery.md"
IMAGES = "images/gallery"
FILMED = ROOT / "build" / "gallery"
ASSETS = ROOT.parent / "shared" / "assets"
LARGEST = 3e6  # bytes of a loop


@dataclass(frozen=True)
class Loop:
    """One moving picture: a sample scene's name, with the first and the last frame and the motion that is red in
    meters, or a character's file of ../shared/assets, whose largest motion is red. touched: the soft object of a scene
    with colliders.
    """

    name: str
    title: str
    red: float = 0.0
    scene: str = ""
    touched: str = ""
    frames: tuple[int, int] = (1, 1)
    file: str = ""
    about: str = ""


LOOPS = {
    loop.name: loop
    for loop in (
        Loop(
            "bulging_cylinder", "Bulging cylinder", 0.012, scene="bulging_cylinder", frames=(28, 150),
            about="Bent, the limb bulges as it was sculpted and is stiff; straight, it is as soft as before. It is "
            "pushed and shaken in both poses.",
        ),
        Loop(
            "shoulder", "Shoulder", 0.008, scene="shoulder", frames=(38, 104),
            about="The elbow folds with the arm raised. A single material lets the biceps run into the forearm; the "
            "target *Folded* does not.",
        ),
        Loop(
            "herbert", "Herbert", 0.04, scene="herbert", frames=(56, 108),
            about="The dive. In the tuck, Herbert's belly is skinny and stiff; upright, it swings.",
        ),
        Loop(
            "rolling_ball", "Rolling ball", 0.05, scene="rolling_ball", touched="Torso", frames=(1, 72),
            about="A ball falls on a belly, and rolls over it.",
        ),
        Loop(
            "herbert_bench", "Herbert on a bench", 0.08, scene="herbert_bench", touched="Herbert", frames=(1, 40),
            about="Herbert slides over a bench on his belly, and flops on the floor.",
        ),
        Loop(
            "pressed_cylinder", "Pressed cylinder", 0.03, scene="pressed_cylinder", touched="Limb", frames=(1, 72),
            about="A hand presses the soft limb twice, and pulls at its skin.",
        ),
        Loop("Husky", "Husky", file="zoo/Husky.glb"),
        Loop("Velociraptor", "Velociraptor", file="zoo/Velociraptor.glb"),
        Loop("Dolphin", "Dolphin", file="zoo/Dolphin.glb"),
        Loop("Woman_Witch", "Woman, witch", file="zoo/Woman_Witch.glb"),
        Loop("Blobfish", "Blobfish", file="zoo/Blobfish.glb"),
    )
}  # fmt: skip

PAGE_TEXT = """# Gallery

`make gallery` films these loops and writes this page. Colors show the soft tissue's own motion: how far the skin is
from where the bones and the targets' sculpted shapes put it.

{commit}.

## Sample scenes

A single material beside dynamic morph targets. The scenes are in `sample_blends`.

{scenes}
## Collision

Without and with *Collision*, in Full Quality. These scenes are in `sample_blends`, too.

{collision}
## Characters

*Add Soft Skin* and *Bake*, with no other setting, beside plain skinning. The clips are the liveliest of their files.
All characters that were tried, with their figures: [Believable](believable.md).

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
        for loop in chosen:
            if loop.scene or ASSETS.is_dir():
                print(film(loop), flush=True)
            else:
                print(f"{loop.name}: skipped, there is no ../shared/assets")
    missing = [name for name in LOOPS if not (FILMED / f"{name}.json").exists()]
    if missing:
        print(f"gallery: {', '.join(missing)} not filmed yet: no page is written")
        return 0
    PAGE.write_text(page(), encoding="utf-8")
    print(f"written to {PAGE.relative_to(ROOT)}")
    return 0


def film(loop: Loop) -> str:
    """One loop, and its text."""
    FILMED.mkdir(parents=True, exist_ok=True)
    with (FILMED / f"{loop.name}.log").open("w") as output:
        command = [sys.executable, Path(__file__).with_name("gallery_loop.py"), loop.name, FILMED]
        subprocess.run(command, stdout=output, stderr=subprocess.STDOUT, check=True)
    facts = FILMED / f"{loop.name}.json"
    found = json.loads(facts.read_text(encoding="utf-8")) | {"commit": measured_at(PAGE.name)}
    facts.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    made = FILMED / f"{loop.name}.webp"
    picture = PAGE.parent / IMAGES / made.name
    picture.parent.mkdir(parents=True, exist_ok=True)
    picture.write_bytes(made.read_bytes())
    size = made.stat().st_size
    return f"{loop.name}: {size / 1e6:.2f} MB{', too large' if size > LARGEST else ''}"


def page() -> str:
    found = {name: json.loads((FILMED / f"{name}.json").read_text(encoding="utf-8")) for name in LOOPS}
    files = [each["file"] for each in found.values() if "file" in each]
    return PAGE_TEXT.format(
        commit="; ".join(dict.fromkeys(each["commit"] for each in found.values())),
        scenes=about_all(found, lambda loop: loop.scene and not loop.touched),
        collision=about_all(found, lambda loop: loop.touched),
        characters=about_all(found, lambda loop: loop.file),
        attribution=attribution(files),
    )


def about_all(found: dict[str, dict], chosen: Callable[[Loop], object]) -> str:
    return "\n".join(about(loop, found[loop.name]) for loop in LOOPS.values() if chosen(loop))


def about(loop: Loop, found: dict) -> str:
    """Of one loop: its title, its picture, and what it shows."""
    first, last = found["frames"]
    if loop.scene:
        farthest = "; ".join(f"{title} {1000 * most:.3g} mm" for title, most in found["farthest"].items())
    else:
        farthest = f"{found['farthest']:.1%} of the body's size, in *{found['clip'].rpartition('|')[2]}*"
    texts = f"{loop.about} " if loop.about else ""
    return (
        f"### {loop.title}\n\n![{loop.title}]({IMAGES}/{loop.name}.webp)\n\n"
        f"{texts}Frames {first} to {last}; the tissue moves by at most: {farthest}.\n"
    )


if __name__ == "__main__":
    sys.exit(main())
