# SPDX-License-Identifier: GPL-3.0-or-later
"""One moving picture, for gallery.py: a sample scene or a character beside itself, colored by how far the tissue moves.

    python tests/benchmarks/gallery_loop.py NAME FOLDER

NAME: of gallery.LOOPS. FOLDER gets NAME.webp, and NAME.json with what the page says of it.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

os.environ["BLENDER_USER_RESOURCES"] = tempfile.mkdtemp(prefix="dynamorph_gallery_")  # before bpy is imported
ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / folder) for folder in ("addon", "tests/addon", "sample_blends", "tools")]

import believable_bake  # noqa: E402
import believable_measure  # noqa: E402
import bpy  # noqa: E402
import characters  # noqa: E402
import dynamic_morph_targets  # noqa: E402
import numpy as np  # noqa: E402
from contact_sheet import INK, PAPER, quiet, render  # noqa: E402
from dynamic_morph_targets.__main__ import leave  # noqa: E402
from dynamic_morph_targets.core.geometry import diagonal  # noqa: E402
from dynamic_morph_targets.run import batch  # noqa: E402
from dynamic_morph_targets.run.job import Job  # noqa: E402
from gallery import LOOPS, Loop  # noqa: E402
from heat import draw_legend, paint  # noqa: E402
from measures import static_shapes  # noqa: E402
from PIL import Image, ImageDraw, ImageFont  # noqa: E402
from portrait import aim  # noqa: E402
from subjects import FOLDER, SUBJECTS  # noqa: E402

PANE = (400, 310)
GAP, HEAD, FOOT = 6, 30, 30  # pixels between panes, above and below them
FOLLOWS = 12  # frames before and after one in which the middle of what is soft counts
QUALITY = 80  # of WebP, at most 100


def main() -> int:
    loop, folder = LOOPS[sys.argv[1]], Path(sys.argv[2])
    dynamic_morph_targets.register()
    panes, found = scene_panes(loop) if loop.scene else character_panes(loop)
    folder.mkdir(parents=True, exist_ok=True)
    pictures = [beside(shown, list(panes), found["red"]) for shown in zip(*panes.values(), strict=True)]
    scene = bpy.context.scene
    pictures[0].save(
        folder / f"{loop.name}.webp", save_all=True, append_images=pictures[1:], loop=0, quality=QUALITY, method=6,
        duration=round(1000 * scene.render.fps_base / scene.render.fps),
    )  # fmt: skip
    (folder / f"{loop.name}.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


Panes = dict[str, list[Image.Image]]  # title -> a picture for each frame


@dataclass(frozen=True)
class Soft:
    """What is soft in the scene, and how far it is in each frame (F, V) from where the bones and targets put it, in
    meters."""

    obj: bpy.types.Object
    motion: np.ndarray


# Sample scenes --------------------------------------------------------------------------------------------------------


def scene_panes(loop: Loop) -> tuple[Panes, dict]:
    """A sample scene with a single material beside dynamic morph targets, or without collision beside with it."""
    with quiet():
        bpy.ops.wm.open_mainfile(filepath=str(FOLDER / f"{loop.scene}.blend"))
    if loop.touched:
        obj, zoom = bpy.data.objects[loop.touched], 1.0
        settings, name = obj.dynamorph.collision, "use"
        ways: dict = {"without collision": False, "with collision": True}
    else:
        subject = SUBJECTS[loop.scene]
        obj, zoom = bpy.data.objects[subject.object], subject.zoom
        settings, name = obj.dynamorph.model, "method"
        ways = {"single material": "SINGLE", "dynamic morph targets": "DYNAMIC"}
    first, last = loop.frames
    panes, farthest = {}, {}
    for title, way in ways.items():
        setattr(settings, name, way)
        with quiet():
            job = Job(obj, "BAKE")
            batch.run(job, lambda *_: True)
        motion = dynamic(job)[first - job.input.settings.frame_start :][: last + 1 - first]
        panes[title] = list(film([Soft(obj, motion)], range(first, last + 1), loop.red, zoom))
        farthest[title] = float(motion.max())
    return panes, {"farthest": farthest, "frames": [first, last], "red": f"{1000 * loop.red:.3g} mm"}


def dynamic(job: Job) -> np.ndarray:
    """How far the skin is from the blended shapes of the targets (F, V), meters."""
    static = static_shapes(job.outcome.character, job.outcome.bake.weights)
    return np.array([np.linalg.norm(job.outcome.bake.displacement(k) - static[k], axis=1) for k in range(len(static))])


# Characters -----------------------------------------------------------------------------------------------------------


def character_panes(loop: Loop) -> tuple[Panes, dict]:
    """A character with plain skinning, and after one click and one bake."""
    with quiet():
        characters.open_file(characters.ASSETS / loop.file)
    body = characters.largest_skinned()
    rig = characters.armature_of(body)
    found = believable_bake.choose_clip(rig) | {"file": Path(loop.file).name, "seconds": {}}
    if believable_bake.click(body, found) is None:
        raise SystemExit(f"{loop.name}: {found['refused']}")
    first, last = found["frames"]
    frames = range(first, last + 1)
    scene = bpy.context.scene
    soft = [Soft(obj, believable_bake.displacements(obj, frames)) for obj in scene.objects
            if believable_measure.baked_keys(obj)]  # fmt: skip
    size = diagonal(np.concatenate([believable_measure.rest(each.obj) for each in soft]))
    show_alone(rig)
    aim(np.concatenate([points_in(frame, soft) for frame in frames]), PANE)
    scene.display.shading.show_cavity = True
    scene.view_settings.view_transform = "Standard"
    farthest = max(float(each.motion.max()) for each in soft)
    panes = {}
    for title, plain in (("plain skinning", True), ("after one click", False)):
        believable_measure.show(plain=plain)
        moving = [Soft(each.obj, (not plain) * each.motion) for each in soft]
        panes[title] = list(film(moving, frames, farthest))
    return panes, found | {"farthest": farthest / size, "red": f"{farthest / size:.1%} of the body's size"}


def show_alone(rig) -> None:
    """Hide what does not belong to the rig."""
    for obj in bpy.context.scene.objects:
        seen = obj.type == "MESH" and obj.visible_get() and believable_bake.belongs(obj, rig)
        obj.hide_render = not seen and obj.type != "LIGHT"
        if seen:
            paint(obj.data, np.zeros(len(obj.data.vertices)))  # what is not soft is gray


def points_in(frame: int, soft: Sequence[Soft]) -> np.ndarray:
    """Where the soft meshes are in a frame (V, 3), world."""
    bpy.context.scene.frame_set(frame)
    return np.concatenate([believable_measure.world_points(each.obj) for each in soft])


# Pictures -------------------------------------------------------------------------------------------------------------


def film(soft: Sequence[Soft], frames: range, red: float, zoom: float = 1.0) -> Iterator[Image.Image]:
    """Every frame through the scene's camera, colored by the motion. red: the motion that is red, meters; zoom: the
    part of the picture around what is soft, which it follows without what shakes it."""
    shading = bpy.context.scene.display.shading
    shading.color_type, shading.show_shadows = "VERTEX", False  # shadows have teeth on skin that bulges
    middles = np.array([points_in(frame, soft).mean(axis=0) for frame in frames])
    for k, frame in enumerate(frames):
        bpy.context.scene.frame_set(frame)
        for each in soft:
            paint(each.obj.data, each.motion[k] / red)
        focus = middles[max(k - FOLLOWS, 0) : k + FOLLOWS + 1].mean(axis=0)
        yield render([frame], PANE, "BLENDER_WORKBENCH", focus={frame: focus}, zoom=zoom)[0]


def beside(pictures: Sequence[Image.Image], titles: Sequence[str], red: str) -> Image.Image:
    """Panes side by side below their titles, and the colors' legend."""
    width, height = PANE
    sheet = Image.new("RGB", (len(pictures) * (width + GAP) - GAP, HEAD + height + FOOT), PAPER)
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(16)
    for k, (picture, title) in enumerate(zip(pictures, titles, strict=True)):
        sheet.paste(picture, (k * (width + GAP), HEAD))
        draw.text((k * (width + GAP) + 4, 6), title, INK, font)
    draw_legend(draw, 4, HEAD + height + 8, f"the soft tissue's own motion: gray none, red {red}")
    return sheet


if __name__ == "__main__":
    leave(main())
