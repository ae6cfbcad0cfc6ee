# SPDX-License-Identifier: GPL-3.0-or-later
"""One moving picture, for gallery.py: a sample scene or a character beside itself, colored by how far the tissue moves.

    python evidence/gallery_loop.py NAME FOLDER BLENDS

NAME: of gallery.LOOPS. FOLDER gets NAME.webp, and NAME.json with what the page says of it; BLENDS a scene's NAME.blend
and NAME_baked.blend.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import project  # noqa: F401
import fresh_blender  # noqa: F401

import believable_bake
import believable_measure
import bpy
import characters
import dynamic_morph_targets
import numpy as np
from contact_sheet import quiet, render
from dynamic_morph_targets.core.geometry import diagonal
from dynamic_morph_targets.run.bake import batch
from dynamic_morph_targets.run.bake.job import Job
from gallery import COLLISION, LOOPS, QUALITY, SELF_COLLISION, TARGETS, Loop
from heat import beside, paint, save_loop
from measures import own_motion
from PIL import Image
from portrait import aim
from stage import paint_for_workbench
from subjects import FOLDER, SUBJECTS

PANE = (400, 310)
FOLLOWS = 12  # frames before and after one in which the middle of what is soft counts
DISSOLVED = 6  # frames in which a scene's end becomes its beginning
# What the panes of a scene show: title -> setting.
WAYS = {
    TARGETS: {"single material": "SINGLE", "dynamic morph targets": "DYNAMIC"},
    COLLISION: {"without collision": False, "with collision": True},
    SELF_COLLISION: {"without self-collision": False, "with self-collision": True},
    QUALITY: {"Reduced": "REDUCED", "Full": "FULL"},
}


def main() -> int:
    loop, folder, blends = LOOPS[sys.argv[1]], Path(sys.argv[2]), Path(sys.argv[3])
    dynamic_morph_targets.register()
    panes, found = scene_panes(loop, blends) if loop.body else character_panes(loop)
    folder.mkdir(parents=True, exist_ok=True)
    legend = f"the soft tissue's own motion: gray none, red {found['red']}"
    pictures = [beside(shown, list(panes), legend) for shown in zip(*panes.values(), strict=True)]
    save_loop(dissolved(pictures) if loop.body else pictures, folder / f"{loop.name}.webp")
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


def scene_panes(loop: Loop, blends: Path) -> tuple[Panes, dict]:
    """A sample scene in two ways, each built and baked from nothing. blends: the folder for the second one's files."""
    subject = SUBJECTS.get(loop.name)
    first, last = loop.frames
    panes, farthest, found = {}, {}, {}
    blends.mkdir(parents=True, exist_ok=True)
    for title, way in WAYS[loop.differs].items():
        with quiet():
            bpy.ops.wm.open_mainfile(filepath=str(FOLDER / f"{loop.name}.blend"))
        bpy.context.preferences.filepaths.save_version = 0  # no backup beside the file
        obj = bpy.data.objects[loop.body]
        choose(obj, loop.differs, way)
        with quiet():
            save_copy(blends / f"{loop.name}.blend")
            job = Job(obj, "BAKE")
            batch.run(job, lambda *_: True)
            save_copy(blends / f"{loop.name}_baked.blend")
        paint_for_workbench()
        bpy.context.scene.view_settings.view_transform = "Standard"  # colors as in the legend
        bpy.context.scene.view_settings.look = "None"
        motion = own_motion(job.outcome.character, job.outcome.bake)
        motion = motion[first - job.input.settings.frame_start :][: last + 1 - first]
        panes[title] = list(film([Soft(obj, motion)], range(first, last + 1), loop.red, subject.zoom if subject else 1))
        farthest[title] = float(motion.max())
        found = {"vertices": len(obj.data.vertices)} | figures(job)
    return panes, found | {"farthest": farthest, "red": f"{1000 * loop.red:.3g} mm"}


def choose(obj, differs: str, way) -> None:
    """Set a soft skin up in one way of WAYS."""
    if differs == TARGETS:
        obj.dynamorph.model.method = way
    elif differs == QUALITY:
        obj.dynamorph.model.solver = way
    else:
        obj.dynamorph.collision.use = way


def save_copy(path: Path) -> None:
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True, compress=True)


def figures(job: Job) -> dict:
    """What was baked, and in how many seconds."""
    made, seconds = job.outcome.model.summary, dict(job.progress.seconds)
    build = seconds.pop("build")
    full = job.input.solver == "FULL"
    return {
        "targets": made.targets,
        "detail": f"unreduced, {made.dofs:,} degrees of freedom" if full else f"{made.modes} modes",
        "baked": len(job.input.settings.frames),
        "build": build,
        "bake": sum(seconds.values()),
    }


# Characters -----------------------------------------------------------------------------------------------------------


def character_panes(loop: Loop) -> tuple[Panes, dict]:
    """A character with plain skinning, and after one click and one bake."""
    with quiet():
        characters.open_file(characters.ASSETS / loop.file)
    body = characters.largest_skinned()
    rig = characters.armature_of(body)
    found = believable_bake.choose_clip(rig) | {"file": Path(loop.file).name, "seconds": {}}
    done = believable_bake.click(body, found)
    if done is None:
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
    vertices = sum(len(each.obj.data.vertices) for each in soft)
    found |= {"vertices": vertices, "farthest": farthest / size, "red": f"{farthest / size:.1%} of the body's size"}
    return panes, found | figures(done)


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
    display = bpy.context.scene.display
    display.render_aa = "5"  # takes half the time of 8
    display.shading.color_type, display.shading.show_shadows = "VERTEX", False  # shadows have teeth on skin that bulges
    middles = np.array([points_in(frame, soft).mean(axis=0) if zoom < 1 else np.zeros(3) for frame in frames])
    for k, frame in enumerate(frames):
        bpy.context.scene.frame_set(frame)
        for each in soft:
            paint(each.obj.data, each.motion[k] / red)
        focus = middles[max(k - FOLLOWS, 0) : k + FOLLOWS + 1].mean(axis=0)
        yield render([frame], PANE, "BLENDER_WORKBENCH", focus={frame: focus}, zoom=zoom)[0]


def dissolved(pictures: Sequence[Image.Image]) -> list[Image.Image]:
    """A loop without a jump: its last pictures become the first ones, which begin it after that."""
    mixed = [Image.blend(pictures[k - DISSOLVED], pictures[k], (k + 1) / (DISSOLVED + 1)) for k in range(DISSOLVED)]
    return [*pictures[DISSOLVED:-DISSOLVED], *mixed]


if __name__ == "__main__":
    sys.exit(main())
