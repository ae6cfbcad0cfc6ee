# SPDX-License-Identifier: GPL-3.0-or-later
"""`make feels`: the presets of Feel in docs/panels/feel.md, and a picture of them on six bodies of ../shared.

python evidence/feels.py               bakes all of them and writes into the page
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
from believable_measure import baked_keys, displacement, rest, show
from contact_sheet import Row, compose, quiet, save
from dynamic_morph_targets.core.geometry import diagonal
from dynamic_morph_targets.core.material.feel import FEELS
from measured import measured_at, write_between
from performance_page import grid
from PIL import Image

BODIES = ("mh_chubby_53bones.blend", "mh_male_53bones.blend", "zoo/Woman_Casual.glb", "zoo/Cow.glb", "zoo/Husky.glb",
          "zoo/Blobfish.glb")  # fmt: skip
CACHE = ROOT / "build" / "feels"
PAGE, PICTURE = ROOT / "docs/panels/feel.md", "images/feels/side_by_side.png"
BEGIN, END = "<!-- presets -->", "<!-- end of presets -->"  # in the page
CELL = (330, 260)
PLAIN = "plain"  # the picture of what the bones alone do

TEXT = """{settings}
The clips are the liveliest of their files, so a livelier preset may squeeze or press a body too far: take the next
calmer preset there, or raise *Bounce*. {commit}.

![Six bodies with the bones alone and in the presets](../{picture})
"""


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
    found["farthest"] = {}
    for feel in sorted(FEELS, key=lambda each: each != "NATURAL"):  # that one says which frame is shown
        bpy.ops.dynamorph.apply_feel(feel=feel)
        bpy.ops.dynamorph.bake()
        found["farthest"][feel], worst = farthest(scene, frames)
        if feel == "NATURAL":
            found["frame"] = frames[worst]
            scene.frame_set(found["frame"])
            aim(seen(shown), CELL)
            photograph(PLAIN, found["frame"], folder)
        photograph(feel, found["frame"], folder)
    (folder / "figures.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


def farthest(scene, frames: range) -> tuple[float, int]:
    """The largest displacement of the present bake, of the body's size, and the number of its frame."""
    soft = [obj for obj in scene.objects if baked_keys(obj)]
    far = np.linalg.norm(displacement(soft, frames), axis=2) / diagonal(np.concatenate([rest(obj) for obj in soft]))
    return float(far.max()), int(far.max(axis=1).argmax())


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
        notes = ["", *(f"farthest {found['farthest'][feel]:.1%}" for feel in FEELS)]
        rows.append(Row(found["name"], f"{found['clip']}, frame {found['frame']}", pictures, notes))
    columns = ("bones alone", *(feel.label for feel in FEELS.values()))
    save(
        compose("Feel", "At the frame in which Natural moves farthest", columns, rows),
        ROOT / "docs" / PICTURE,
        small=True,
    )
    settings = [
        [feel.label, f"{feel.frequency:g} Hz", f"{feel.damping_ratio:g}", f"{feel.max_displacement:g}",
         f"{feel.max_thickness:g}"]
        for feel in FEELS.values()
    ]  # fmt: skip
    titles = ["Preset", "Bounce", "Damping ratio", "Max Displacement, of the size", "of the thickness"]
    about = TEXT.format(settings=grid(titles, settings), commit=measured_at("panels/feel.md"), picture=PICTURE)
    write_between(PAGE, BEGIN, END, about)


if __name__ == "__main__":
    sys.exit(main())
