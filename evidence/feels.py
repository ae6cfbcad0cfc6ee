# SPDX-License-Identifier: GPL-3.0-or-later
"""`make feels`: docs/feels.md and its picture, the presets of Feel on six bodies of ../shared, side by side.

python evidence/feels.py               bakes all of them and writes the page
python evidence/feels.py ASSET FOLDER  one body: FOLDER gets figures.json and a picture for each preset
"""

from __future__ import annotations

import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from project import ROOT

import believable_bake
import bpy
import characters
import numpy as np
from assets import require
from believable_bake import aim, belongs, click, render, seen
from believable_measure import (
    baked_keys,
    displacement,
    flicker,
    quantiles,
    rest,
    show,
    swings,
    triangles_of,
    vertex_areas,
)
from contact_sheet import Row, compose, quiet, save
from dynamic_morph_targets.core.geometry import diagonal
from dynamic_morph_targets.core.material.feel import FEELS
from dynamic_morph_targets.core.result import judge
from measured import measured_at
from performance_page import grid
from PIL import Image

BODIES = ("mh_chubby_53bones.blend", "mh_male_53bones.blend", "zoo/Woman_Casual.glb", "zoo/Cow.glb", "zoo/Husky.glb",
          "zoo/Blobfish.glb")  # fmt: skip
CACHE = ROOT / "build" / "feels"
PAGE, PICTURE = ROOT / "docs/feels.md", "images/feels/side_by_side.png"
CELL = (330, 260)
PLAIN = "plain"  # the picture of what the bones alone do

PAGE_TEXT = """# Subtle, Natural and Cartoon

Which *Feel* to choose: the three presets on six bodies, side by side. `make -C evidence feels` bakes them and writes
this page.

*Subtle* is for firm, athletic bodies, *Natural*, the default, for average ones, and *Cartoon* swings farther and
longer. The verdicts at the right are those that Blender shows after the bake. The clips are the liveliest of their
files, so a livelier preset may squeeze or press a body too far: take the next calmer preset there, or raise *Bounce*.

{commit}

{settings}
Each body is baked with the liveliest 48 frames of its clips, or a hop and a twist, and shown at the frame in which
*Natural* moves it farthest.

![Six bodies in the presets]({picture})

*Farthest*: the largest displacement, of size. *Alive*: RMS motion of the liveliest tenth of the surface, of size.
*Flicker*: how often the skin's own motion turns from frame to frame, from -1, a slow swing, to 1; see
[Believable](believable.md).

{figures}"""


def main() -> int:
    if sys.argv[1:]:
        return bake(Path(sys.argv[1]), Path(sys.argv[2]))
    require("feels", BODIES)
    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(measured, BODIES))
    write_page(found)
    print(f"written to {PAGE.relative_to(ROOT)}")
    return 0


def measured(body: str) -> dict:
    folder = CACHE / Path(body).stem
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "log.txt").open("w") as log:
        run = [sys.executable, __file__, str(characters.ASSETS / body), str(folder)]
        subprocess.run(run, stdout=log, stderr=subprocess.STDOUT, check=True)
    print(f"feels: {body}", flush=True)
    return json.loads((folder / "figures.json").read_text(encoding="utf-8"))


# One body ------------------------------------------------------------------------------------------------------------


def bake(asset: Path, folder: Path) -> int:
    """Raises what opening and baking raise."""
    believable_bake.dynamic_morph_targets.register()
    with quiet():
        characters.open_file(asset)
    body, scene = characters.largest_skinned(), bpy.context.scene
    rig = characters.armature_of(body)
    found = {"name": asset.stem.replace("_", " "), "seconds": {}} | believable_bake.choose_clip(rig)
    found["clip"] = found["clip"].split("|")[-1]
    if click(body, found) is None:
        raise RuntimeError(found["refused"])
    frames = range(scene.frame_start, scene.frame_end + 1)
    body = next(obj for obj in scene.objects if obj.type == "MESH" and obj.dynamorph.targets)
    shown = [obj for obj in scene.objects if obj.type == "MESH" and obj.visible_get() and belongs(obj, rig)]
    for obj in scene.objects:
        obj.hide_render = obj not in shown and obj.type != "LIGHT"
    scene.display.shading.show_cavity, scene.view_settings.view_transform = True, "Standard"
    bpy.context.view_layer.objects.active = body
    found["feels"] = {}
    for feel in sorted(FEELS, key=lambda each: each != "NATURAL"):  # that one says which frame is shown
        bpy.ops.dynamorph.apply_feel(feel=feel)
        bpy.ops.dynamorph.bake()
        found["feels"][feel], worst = figures(body, scene, frames)
        if feel == "NATURAL":
            found["frame"] = frames[worst]
            scene.frame_set(found["frame"])
            aim(seen(shown), CELL)
            photograph(PLAIN, found["frame"], folder)
        photograph(feel, found["frame"], folder)
    (folder / "figures.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


def figures(body, scene, frames: range) -> tuple[dict, int]:
    """Of the present bake, and the number of the frame with the largest displacement."""
    soft = [obj for obj in scene.objects if baked_keys(obj)]
    points = [rest(obj) for obj in soft]
    motion = displacement(soft, frames) / diagonal(np.concatenate(points))
    areas = np.concatenate([vertex_areas(each, triangles_of(obj)) for each, obj in zip(points, soft, strict=True)])
    far, moves = np.linalg.norm(motion, axis=2), swings(motion)
    lively = moves >= quantiles(moves, areas, [0.9])[0]
    found = {
        "farthest": float(far.max()),
        "alive": float(np.sqrt((areas * moves**2)[lively].sum() / areas[lively].sum())),
        "flicker": flicker(motion, areas),
        "verdict": judge.parsed(body.dynamorph.bake.verdict).text,
    }
    return found, int(far.max(axis=1).argmax())


def photograph(name: str, frame: int, folder: Path) -> None:
    show(plain=name == PLAIN)
    render([frame], CELL, "BLENDER_WORKBENCH")[0].save(folder / f"{name}.png")
    show(plain=False)


# The page ------------------------------------------------------------------------------------------------------------


def write_page(bodies: list[dict]) -> None:
    rows = []
    for found in bodies:
        folder = CACHE / found["name"].replace(" ", "_")
        pictures = [Image.open(folder / f"{name}.png").convert("RGB") for name in (PLAIN, *FEELS)]
        notes = ["", *(f"farthest {found['feels'][feel]['farthest']:.1%}" for feel in FEELS)]
        rows.append(Row(found["name"], f"{found['clip']}, frame {found['frame']}", pictures, notes))
    columns = ("bones alone", *(feel.label for feel in FEELS.values()))
    save(
        compose("Feel", "At the frame in which Natural moves farthest", columns, rows),
        PAGE.parent / PICTURE,
        small=True,
    )
    settings = [
        [
            feel.label,
            f"{feel.frequency:g} Hz",
            f"{feel.damping_ratio:g}",
            f"{feel.max_displacement:g}",
            f"{feel.max_thickness:g}",
        ]
        for feel in FEELS.values()
    ]
    measured_figures = [
        [found["name"], found["clip"], FEELS[feel].label, f"{each['farthest']:.3f}", f"{each['alive']:.4f}",
         f"{each['flicker']:+.2f}", each["verdict"]]
        for found in bodies for feel, each in ((feel, found["feels"][feel]) for feel in FEELS)
    ]  # fmt: skip
    titles = ["", "Bounce", "damping ratio", "Max Displacement", "Of Thickness"]
    PAGE.write_text(
        PAGE_TEXT.format(
            commit=measured_at(PAGE.name),
            settings=grid(titles, settings),
            picture=PICTURE,
            figures=grid(["", "clip", "", "farthest", "alive", "flicker", "verdict"], measured_figures),
        ),
        encoding="utf-8",
    )


if __name__ == "__main__":
    sys.exit(main())
