# SPDX-License-Identifier: GPL-3.0-or-later
"""`make rigs`: the table of docs/rigs.md, from a human of each rig family (tests/addon/rig_families.py) and from files
of ../shared that belong to a family. Nothing in it is typed here.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from project import ROOT

# isort: split
from installed import MODULE, leave  # before bpy

# isort: split
import addon_utils  # of bpy
import bpy
import characters
import numpy as np
import rig_families
import soft_parts
from assets import require
from bench import machine
from bl_ext.user_default.dynamic_morph_targets.scene.check import body_checks
from bl_ext.user_default.dynamic_morph_targets.scene.skinning import Skinning
from bl_ext.user_default.dynamic_morph_targets.ui import messages
from builders import shown
from contact_sheet import quiet
from measured import measured_at, write_between

PAGE = ROOT / "docs" / "rigs.md"
BEGIN, END = "<!-- tried -->", "<!-- end of tried -->"
FIXTURE = "rig_families.py"
SCALP = 0.06  # of the height: the uppermost skin, which belongs to the head
HEAD = ("family", "file", "skin", "bones (deforming)", "click", "build", "bake", "head held", "head moves",
        "skin moves", "parts", "in *Messages*")  # fmt: skip
FILES = {  # of ../shared/assets: the family, and the clip and frames that are played
    "mh_male_53bones.blend": ("MPFB", "gen_jump", (18, 34)),
    "mh_chubby_53bones.blend": ("MPFB", "gen_run_in_place", (40, 56)),
}


@dataclass
class Tried:
    """A character before the click. face: the mesh with its head."""

    body: object
    face: object


def main() -> int:
    require("rigs", FILES)
    assert addon_utils.enable(MODULE, default_set=True) is not None
    rows = []
    for family, file, opened in everything():
        rows.append((family, file, *measured(opened)))
        print(" | ".join(rows[-1]), flush=True)
    write(rows)
    print(f"written to {PAGE.relative_to(ROOT)}")
    return 0


def everything() -> list[tuple[str, str, Callable[[], Tried]]]:
    """Each family and file, and how to open it."""
    found = [(family, FIXTURE, partial(of_family, family)) for family in rig_families.FAMILIES]
    return found + [(family, file, partial(of_file, file, *shot)) for file, (family, *shot) in FILES.items()]


def of_family(family: str) -> Tried:
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    figure = rig_families.make(family)
    return Tried(figure.body, figure.face or figure.body)


def of_file(file: str, clip: str, frames: tuple[int, int]) -> Tried:
    characters.open_file(characters.ASSETS / file)
    scene, body = bpy.context.scene, characters.largest_skinned()
    scene.frame_start, scene.frame_end = frames
    characters.play(characters.armature_of(body), bpy.data.actions[clip])
    scene.frame_set(scene.frame_start)
    bpy.context.view_layer.objects.active = body
    return Tried(body, body)


def measured(opened: Callable[[], Tried]) -> tuple[str, ...]:
    """The cells of a row after family and file; of what fails the last one says why."""
    with quiet():
        tried = opened()
        body, rig = tried.body, Skinning.of(tried.body).rig
        plain = shown([body, tried.face])
    about = (f"{len(body.data.vertices):,}", f"{len(rig.data.bones)} ({len(Skinning.of(body).bones(rig))})")
    seconds, failed, said = [], "", []
    for press in (bpy.ops.dynamorph.add_soft_skin, bpy.ops.dynamorph.build, bpy.ops.dynamorph.bake):
        began = time.perf_counter()
        try:
            with quiet():
                press()
        except RuntimeError as error:
            traceback.print_exc()
            failed = str(error).removeprefix("Error: ").strip()
            break
        seconds.append(f"{time.perf_counter() - began:.1f} s")
        body_checks.look(body)  # as a timer does in a window
        said += [problem.text for problem, _ in messages.messages(body)]
    seconds += [""] * (3 - len(seconds))
    if failed:
        return (*about, *seconds, body.dynamorph.model.head or "none", "", "", "", f"**{failed}**")
    with quiet():
        skin, face = (after - before for after, before in zip(shown([body, tried.face]), plain, strict=True))
    assert np.isfinite(skin).all(), body.name
    height = plain[1][0, :, 2]
    moves = farthest(skin), farthest(face[:, height > height.max() - SCALP * np.ptp(plain[0][0, :, 2])])
    with quiet():
        parts = soft_parts.found_right(body, list(dict.fromkeys([body, tried.face])))
    found = f"{len(parts)} of {len(soft_parts.PLACES)}"
    head = body.dynamorph.model.head or "none"
    return (*about, *seconds, head, moves[1], moves[0], found, "; ".join(dict.fromkeys(said)))


def farthest(moved: np.ndarray) -> str:
    return f"{1000 * np.linalg.norm(moved, axis=2).max():.0f} mm"


def write(rows: list[tuple[str, ...]]) -> None:
    """Put the table between the marks of the page. Raises ValueError without them."""
    lines = [HEAD, ("---",) * 2 + ("---:",) * 5 + ("---",) + ("---:",) * 3 + ("---",)]
    lines += [[cell.replace("|", "\\|") for cell in row] for row in rows]
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    about = f"{measured_at(PAGE.name)}. Blender {bpy.app.version_string}, {machine()}."
    write_between(PAGE, BEGIN, END, f"{about}\n\n{table}")


if __name__ == "__main__":
    leave(main())
