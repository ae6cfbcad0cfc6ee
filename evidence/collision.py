# SPDX-License-Identifier: GPL-3.0-or-later
"""`make collision`: docs/collision.md and its pictures: a ball is pressed into characters of ../shared, characters
fold up, two press on each other, and a hand holds one.

    python evidence/collision.py --page   the page from what was measured before
    python evidence/collision.py --ours   measures all but Blender's own ways again
    python evidence/collision.py --peers  measures Blender's own ways alone

Every way to simulate a character runs in a process of its own (collision_press.py, collision_fold.py); its findings
stay in build/collision.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from project import ROOT

import collision_fold
import collision_grab
import collision_pair
import collision_press
import numpy as np
from assets import ASSETS, require
from bench import machine
from collision_press import DRAGS, LAST, RESTS
from contact_sheet import Row, compose, save
from dynamic_morph_targets.core.motion.contact import OWN_SAMPLES
from measured import measured_at
from performance_page import grid
from PIL import Image

CACHE, PAGE, PICTURES = ROOT / "build/collision", ROOT / "docs/collision.md", "images/collision/{}.png"
CHARACTERS = ("mh_male_53bones.blend", "mh_chubby_53bones.blend", "zoo/Cow.glb", "zoo/Husky.glb", "zoo/Blobfish.glb",
              "zoo/Woman_Casual.glb", "zoo/Space_Enemy_Large.glb")  # fmt: skip
OURS = ("full", "full_0", "reduced", "off")
PEERS = ("soft_body", "cloth", "cloth_dynamics")
PEERS_BODY = "mh_chubby_53bones.blend"
FOLDED = (ASSETS / "mh_chubby_53bones.blend", ASSETS / "mh_male_53bones.blend", ROOT / "sample_blends/herbert.blend")
WAYS_TO_FOLD = {"full_none": "as the bones say", "full_self": "Self Collision", "reduced_self": "Reduced"}
PAIR = (ASSETS / "mh_chubby_53bones.blend", ASSETS / "mh_male_53bones.blend")
WAYS_TO_MEET = {"full_alone": "each alone", "full_together": "together", "reduced_together": "Reduced"}
LONGEST = 600  # seconds that one may take
MOVING, RESTING = 0.0015, 0.0011  # of size, with Distance 0: asked of the penetration
ITERATIONS = 10  # a step, asked with both rounds of friction
LEFT, SNAP, SHARE = 0.05, 0.005, 0.46  # asked: of the points inside, of size, of a step
STILL = {"full": 0.002, "reduced": 0.005}  # asked, of size
MORE = 10.0  # microseconds, asked
DENT = 0.001  # of size: what is shallower is none
NONE = "-"

PAGE_TEXT = """# Contact, measured

This page measures how well [Collision](panels/collision.md) keeps objects, the body's own skin, other bodies and your
hand out of each other, and what it costs. `make -C evidence collision` measures it and writes this page.

Depths are in percent of the body's size: 0.1% of a person with a size of 2 m is 2 mm. Goals that are missed are bold.

{commit}; {machine}; two at a time.

## Characters

A ball with Blender's Collision, of {radius:.0%} of the body's size, is pressed {deep:.1%} into the thickest part of a
character's front and dragged {dragged:.0%} over it, with friction {friction:g}.

After one click, in Full Quality. *Depth*: of the deepest vertex in the ball, in percent of size, from Blender's
evaluated meshes; below zero it is outside. Asked without Distance: at most {moving:.2%} while the ball moves, and
{resting:.2%} at rest; with the default Distance, none. *Iterations*: of Newton's method in a step, both rounds of
friction included; asked: {iterations}. *Step*: milliseconds, in Full and in Reduced Quality. *Reduced*: RMS difference
of the dent in Reduced Quality, over the dent, while the ball rests and at the end of its drag; asked: 60 %. It is about
100 % where a body is so firm that it is not pushed.

{figures}
![Characters, pressed]({pressed})

## Self Collision

The same characters fold up, with hips by 95 degrees, knees by 125 and elbows by 95, in {folds} steps of 1/96 s, without
friction. *Inside*: of {points:,} points, those of thigh and torso that are inside each other, away from the joint, by
the winding number; asked: at most 3 of the first character's, and {left:.0%} of the others'. *Worst step*: the farthest
that Self Collision alone moves a point in one step, in percent of size; asked: {snap}. *Still*: the largest second
difference of a point in the frames after it has stopped; asked: {still} in Full and in Reduced Quality.
*Step*: milliseconds, the median; *its part*: of a step with it, asked: {share:.0%} in Full Quality. *Finding*: what
it adds to the first steps, in which next to nothing touches, with {own_points:,} points that may; in Reduced Quality
mostly the search; asked: 1.4 ms a frame for 3,000. Knees that are folded this far are crushed by skinning itself: they
are reported, not pushed apart.

{folded}
![Characters, folded]({folded_picture})

## Two bodies

The first two characters meet in {comes} steps of 1/96 s, until their torsos would be in each other by {overlap:.0%} of
the first one's size, and stand for {stands}. *Inside*: of {points:,} points of each, those of the torso that are inside
the other. *Deepest*: in percent of size. *Force*: between them at the end; each contact pushes both sides with one
number, so that the forces are opposite. *Order*: the largest distance of a point if the other one comes first, over
size. *Step*: milliseconds of both bodies, each alone and together, the median.

{pair}
![Two characters, pressed on each other, cut in the middle]({pair_picture})

## A hand

The second character stands still in Live. Microseconds of a step, medians of {rounds} frames each, in turns: without a
hand, with one that holds nothing, and with one that holds the softest place of the skin; asked: 10 more. A negative
figure is noise of the measurement. The goal is strict: at 24 frames a second, a frame has 41,667 microseconds.

{grab}

## Beside what Blender has

Blender's Soft Body and Cloth are made for other tasks, which [Comparison](comparison.md) lists. Here they get this one.
The same ball and the same body ({peer_body}, {vertices:,} vertices). Soft Body, Cloth and Cloth Dynamics (of Blender
5.2, experimental) as they come, with all of the body held at {held:g}: they are shells and do not simulate volume.
Depth as above; seconds for {last} frames, ours with the build of the model.

{peers}"""


def main() -> int:
    require("collision", CHARACTERS)
    if "--page" not in sys.argv:
        peers = [] if "--ours" in sys.argv else [(PEERS_BODY, way) for way in PEERS]
        ours = [] if "--peers" in sys.argv else [(body, way) for body in CHARACTERS for way in OURS]
        if peers and ours:
            shutil.rmtree(CACHE, ignore_errors=True)
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(lambda each: measure(*each), peers + ours))
            folds = [] if "--peers" in sys.argv else [(path, quality) for path in FOLDED for quality in STILL]
            list(pool.map(lambda each: measure_fold(*each), folds))
            list(pool.map(measure_pair, [] if "--peers" in sys.argv else STILL))
        for quality in [] if "--peers" in sys.argv else STILL:  # one at a time: these are microseconds
            measure_grab(quality)
    write_page()
    print(f"written to {PAGE.relative_to(ROOT)}")
    return 0


def measure(body: str, way: str) -> None:
    newest = sorted((ROOT / ".venv").glob("3.*/bin/python"))[-1]  # of Blender too
    python = newest if way == "cloth_dynamics" else sys.executable
    run(body, way, [python, collision_press.__file__, ASSETS / body, CACHE / name_of(body), way])


def measure_fold(path: Path, quality: str) -> None:
    command = [sys.executable, collision_fold.__file__, path, CACHE / name_of(path.name), quality]
    run(path.name, f"fold_{quality}", command)


def measure_pair(quality: str) -> None:
    run("pair", f"pair_{quality}", [sys.executable, collision_pair.__file__, *PAIR, CACHE / "pair", quality])


def measure_grab(quality: str) -> None:
    run("grab", f"grab_{quality}", [sys.executable, collision_grab.__file__, PAIR[0], CACHE / "grab", quality])


def run(body: str, way: str, command: list) -> None:
    folder = CACHE / name_of(body)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{way}.json").unlink(missing_ok=True)
    with (folder / f"{way}.log").open("w") as log:
        try:
            subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, timeout=LONGEST, check=False)
        except subprocess.TimeoutExpired:
            log.write(f"takes over {LONGEST} s\n")
    print(f"collision: {body}, {way}", flush=True)


def name_of(body: str) -> str:
    return body.rpartition("/")[2].partition(".")[0]


def found(body: str, way: str) -> dict | None:
    """What was measured; None if it did not end."""
    path = CACHE / name_of(body) / f"{way}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None


# The page -------------------------------------------------------------------------------------------------------------


def write_page() -> None:
    rows, pictures = [], []
    for body in CHARACTERS:
        full, bare, off = (found(body, way) for way in ("full", "full_0", "off"))
        title = name_of(body).replace("_", " ")
        if not (full and bare and off):
            rows.append([title, *["did not end"] * 8])
            continue
        rows.append([
            title,
            percent(bare["moving"], MOVING), percent(bare["resting"], RESTING),
            percent(full["moving"], 0.0), percent(full["resting"], 0.0),
            bold(f"{full['iterations']:.1f}", full["iterations"] > ITERATIONS),
            f"{full['microseconds'] / 1000:.1f} / {found(body, 'reduced')['microseconds'] / 1000:.1f}",
            f"{off['keys']} / {full['keys']}",
            reduced(body),
        ])  # fmt: skip
        images = [Image.open(CACHE / name_of(body) / f"{way}_{k}.png").convert("RGB")
                  for way, k in (("off", 1), ("full", 1), ("full", 2), ("reduced", 1))]  # fmt: skip
        pictures.append(Row(title, "", images, [""] * len(images)))
    columns = ("no collision", f"frame {RESTS}", f"dragged, frame {DRAGS}", f"Reduced, frame {RESTS}")
    path = PAGE.parent / PICTURES.format("pressed")
    path.parent.mkdir(parents=True, exist_ok=True)
    save(compose("Collision", "A ball pressed into the belly", columns, pictures), path, small=True)
    titles = ["", "depth, Distance 0, moving", "at rest", "depth, moving", "at rest", "iterations", "step, ms",
              "keys without / with", "Reduced"]  # fmt: skip
    PAGE.write_text(
        PAGE_TEXT.format(
            commit=measured_at(PAGE.name), machine=machine(), radius=collision_press.RADIUS, deep=collision_press.DEEP,
            dragged=collision_press.DRAGGED, friction=collision_press.FRICTION, moving=MOVING, resting=RESTING,
            iterations=ITERATIONS, figures=grid(titles, rows), pressed=PICTURES.format("pressed"),
            folds=collision_fold.FOLDS, points=collision_fold.POINTS, left=LEFT, snap=f"{SNAP:.1%}",
            still=" and ".join(f"{each:.1%}" for each in STILL.values()), share=SHARE,
            own_points=OWN_SAMPLES, folded=folded(), folded_picture=PICTURES.format("folded"),
            overlap=collision_pair.OVERLAP, comes=collision_pair.COMES, stands=collision_pair.STANDS,
            pair=pair(), pair_picture=PICTURES.format("pair"), rounds=collision_grab.ROUNDS, grab=grab(),
            peer_body=name_of(PEERS_BODY).replace("_", " "), vertices=found(PEERS_BODY, "full")["vertices"],
            held=collision_press.HELD, last=LAST, peers=peers(),
        ).rstrip() + "\n",
        encoding="utf-8",
    )  # fmt: skip


def folded() -> str:
    """The table of those that fold up; it makes their picture."""
    rows, pictures = [], []
    for path in FOLDED:
        title = name_of(path.name).replace("_", " ")
        for quality in STILL:
            rows.append([f"{title}, {quality.title()}", *folded_figures(path, quality)])
        images = [Image.open(CACHE / name_of(path.name) / f"fold_{way}.png").convert("RGB") for way in WAYS_TO_FOLD]
        pictures.append(Row(title, "", images, [""] * len(images)))
    sheet = compose("Self Collision", "Hips folded by 95 degrees", tuple(WAYS_TO_FOLD.values()), pictures)
    save(sheet, PAGE.parent / PICTURES.format("folded"), small=True)
    return grid(
        [
            "",
            "inside, without / with",
            "worst step, %",
            "still, %",
            "step, ms, without / with",
            "its part",
            "finding, ms",
        ],
        rows,
    )


def folded_figures(path: Path, quality: str) -> list[str]:
    each = found(path.name, f"fold_{quality}")
    if not each:
        return ["did not end"] * 6
    bare, own = each["none"], each["self"]
    part = 1.0 - bare["milliseconds"] / own["milliseconds"]
    most = 3 if path == FOLDED[0] else LEFT * bare["inside"]
    return [
        f"{bare['inside']} / {bold(str(own['inside']), own['inside'] > most)}",
        percent(each["alone"], SNAP), percent(own["still"], STILL[quality]),
        f"{bare['milliseconds']:.1f} / {own['milliseconds']:.1f}",
        bold(f"{part:.0%}", quality == "full" and part > SHARE),
        f"{own['apart'] - bare['apart']:.2f}",
    ]  # fmt: skip


def pair() -> str:
    """The table of the two that press on each other; it makes their picture."""
    rows = []
    for quality in STILL:
        each = found("pair", f"pair_{quality}")
        if not each:
            rows.append([quality.title(), *["did not end"] * 6])
            continue
        alone, both = each["alone"], each["together"]
        rows.append([
            quality.title(), f"{alone['inside']} / {both['inside']}",
            f"{100 * alone['deepest']:.2f} / {100 * both['deepest']:.2f}",
            f"{each['force']:.0f}",
            f"{each['order']:.0e}", f"{both['iterations']:.1f}",
            f"{alone['milliseconds']:.1f} / {both['milliseconds']:.1f}",
        ])  # fmt: skip
    images = [Image.open(CACHE / "pair" / f"pair_{way}.png").convert("RGB") for way in WAYS_TO_MEET]
    row = Row("", "", images, [""] * len(images))
    sheet = compose("Two bodies", "Belly on belly, cut in the middle", tuple(WAYS_TO_MEET.values()), [row])
    save(sheet, PAGE.parent / PICTURES.format("pair"), small=True)
    return grid(
        [
            "",
            "inside, alone / together",
            "deepest, %",
            "force, N",
            "order",
            "iterations",
            "step, ms, alone / together",
        ],
        rows,
    )


def grab() -> str:
    rows = []
    for quality in STILL:
        each = found("grab", f"grab_{quality}")
        if not each:
            rows.append([quality.title(), *["did not end"] * 3])
            continue
        more = [each[way] - each["none"] for way in ("idle", "holds")]
        rows.append([quality.title(), f"{each['none']:.0f}", *(bold(f"{extra:+.0f}", extra > MORE) for extra in more)])
    return grid(["", "none", "holds nothing", "holds"], rows)


def reduced(body: str) -> str:
    """How far the dent in Reduced Quality is from that in Full Quality: when the ball rests, and after its drag."""
    if not found(body, "reduced"):
        return NONE
    return " / ".join(_off(body, shown) for shown in (0, 1))


def _off(body: str, shown: int) -> str:
    full, few, off = (np.load(CACHE / name_of(body) / f"{way}.npy")[shown] for way in ("full", "reduced", "off"))
    dent = full - off
    if np.linalg.norm(dent, axis=1).max() < DENT * found(body, "full")["size"]:
        return NONE  # the ball has left the body
    near = np.linalg.norm(dent, axis=1) > 0.1 * np.linalg.norm(dent, axis=1).max()
    share = np.sqrt(((few - full)[near] ** 2).sum() / (dent[near] ** 2).sum())
    return bold(f"{share:.0%}", share > 0.6)


def peers() -> str:
    rows = []
    for way, title in (("full", "Dynamorph, Full"), ("reduced", "Dynamorph, Reduced"), ("soft_body", "Soft Body"),
                       ("cloth", "Cloth"), ("cloth_dynamics", "Cloth Dynamics")):  # fmt: skip
        each = found(PEERS_BODY, way)
        cells = [f"{100 * each['moving']:.3f}", f"{100 * each['resting']:.3f}", f"{each['seconds']:.0f}"] if each else [
            NONE, NONE, f"over {LONGEST}"]  # fmt: skip
        rows.append([title, *cells])
    return grid(["", "depth, moving, %", "at rest, %", "seconds"], rows)


def percent(value: float, limit: float) -> str:
    return bold(f"{100 * value:.3f}", value > limit)


def bold(text: str, wrong: bool) -> str:
    return f"**{text}**" if wrong else text


if __name__ == "__main__":
    sys.exit(main())
