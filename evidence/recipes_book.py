# SPDX-License-Identifier: GPL-3.0-or-later
"""`make recipes`: follows each recipe of docs/recipes, and writes its files, its picture and the table of its page.

    python evidence/recipes_book.py [NAME ...] [--pictures] [--out FOLDER]

FOLDER, dist/recipes by default, gets NAME_start.blend, as it is before the first step, and NAME_done.blend.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from project import ROOT

import bpy
import dynamic_morph_targets
from bench import machine
from contact_sheet import quiet
from measured import measured_at, write_between
from recipes import pictures, steps

PAGES, PICTURES = ROOT / "docs" / "recipes", ROOT / "docs" / "images" / "recipes"
BEGIN, END = "<!-- made -->", "<!-- end of made -->"
README = """{title}

{about} The page {page} of the documentation has the steps.

{state}
"""
STATES = {
    "start": "This file is as it is before the first step.",
    "done": "This file is as it is after the last step: press Space to play.",
}
SHOWN = {  # settings that the table names where they are not those of a new soft skin
    "model": ("solver", "modes", "cage_nodes"),
    "simulation": ("amount", "max_displacement", "max_thickness", "samples", "loop"),
    "collision": ("use", "use_self"),
    "output": ("format", "keys"),
}


def make(name: str, folder: Path) -> None:
    """Follow a recipe, and write its files and the table of its page."""
    with quiet():
        body, hands = steps.cook(name, started=lambda _body: save(name, "start", folder))
        moved = pictures.motion(body)
        save(name, "done", folder)
        if steps.RECIPES[name].export:
            steps.export(body, folder / f"{name}{steps.RECIPES[name].export}")
    write_table(name, rows(name, folder, body, hands, moved))


def save(name: str, state: str, folder: Path) -> None:
    recipe = steps.RECIPES[name]
    text = bpy.data.texts.get("README") or bpy.data.texts.new("README")
    text.clear()
    text.write(README.format(title=recipe.title, about=recipe.about, page=f"recipes/{name}", state=STATES[state]))
    folder.mkdir(parents=True, exist_ok=True)
    bpy.context.preferences.filepaths.save_version = 0
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / f"{name}_{state}.blend"), copy=True, compress=True)


def rows(name: str, folder: Path, body: bpy.types.Object, hands: steps.Hands, moved: pictures.Motion) -> dict[str, str]:
    """The rows of the page's table."""
    scene, settings = bpy.context.scene, body.dynamorph
    files = sorted(folder.glob(f"{name}*.*"), key=lambda path: (path.suffix != ".blend", "done" in path.stem))
    most, frame = pictures.farthest(moved)
    swings = ((each.name, f"{each.bounce:.3g} Hz" if each.bounce else "overdamped") for each in settings.targets)
    targets = [f"{name} {swing}" for name, swing in swings]
    return {
        "Files": ", ".join(f"`{path.name}` ({path.stat().st_size / 1e6:.1f} MB)" for path in files),
        "Frames": f"{scene.frame_start} to {scene.frame_end}, {scene.render.fps} per second",
        "Vertices": f"{len(body.data.vertices):,}",
        "Bounce": ", ".join(targets),
        "Other settings": ", ".join(changed(settings)) or "those of a new soft skin",
        "*Build Model*, *Bake*": f"{hands.seconds['build']:.1f} s, {hands.seconds['bake']:.1f} s",
        "The skin moves by at most": f"{1000 * most:.0f} mm from plain skinning, at frame {frame}",
    }


def changed(settings: bpy.types.PropertyGroup) -> list[str]:
    """The settings that are not as in a new soft skin, as the interface names them."""
    found = []
    for group, names in SHOWN.items():
        owner = getattr(settings, group)
        for prop in (owner.bl_rna.properties[name] for name in names):
            value = getattr(owner, prop.identifier)
            if prop.type == "ENUM" and value != prop.default:
                found.append(f"*{prop.name}* {prop.enum_items[value].name}")
            elif prop.type == "BOOLEAN" and value != prop.default:
                found.append(f"*{prop.name}* {'on' if value else 'off'}")
            elif prop.type in ("INT", "FLOAT") and abs(value - prop.default) > 1e-6:
                found.append(f"*{prop.name}* {value:.3g}")
    return found


def write_table(name: str, table: dict[str, str]) -> None:
    """Between the marks of the page."""
    lines = ["| | |", "|---|---|", *(f"| {key} | {value} |" for key, value in table.items())]
    made = f"{measured_at(f'recipes/{name}.md')}. Blender {bpy.app.version_string}, {machine()}."
    write_between(PAGES / f"{name}.md", BEGIN, END, "\n".join([made, "", *lines]))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(steps.RECIPES)}; default: all")
    parser.add_argument("--pictures", action="store_true", help="only the pictures, from the files that are there")
    parser.add_argument("--out", type=Path, default=ROOT / "dist" / "recipes", help="the folder of the .blend files")
    args = parser.parse_args()
    dynamic_morph_targets.register()
    for name in args.names or steps.RECIPES:
        folder = args.out.resolve()
        if not args.pictures:
            make(name, folder)
        recipe = steps.RECIPES[name]
        pictures.write(name, recipe, *pictures.views(name, recipe, folder), PICTURES)
        print(f"{name}: done", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
