# SPDX-License-Identifier: GPL-3.0-or-later
"""The picture of a recipe: two views of the same frame side by side, colored by how far the skin moves."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from contact_sheet import quiet, render
from heat import beside, paint
from PIL import Image

from . import cast
from .steps import Recipe, shown

PANE = (400, 400)
THUMB = 160  # pixels
QUALITY = 82  # of WebP, at most 100
BLUR_FRAME = 25  # he falls
SAMPLES = 32  # of Cycles
MAP = {0.0: (0.03, 0.1, 0.8), 0.5: (0.1, 0.6, 0.1), 0.9: (0.95, 0.35, 0.03), 1.0: (0.8, 0.02, 0.01)}  # of Firmness

Motion = dict[str, np.ndarray]  # of each mesh that moves (F, V), meters


def motion(body: bpy.types.Object) -> Motion:
    """Of all baked meshes, at each frame of the scene: how far they are from plain skinning."""
    meshes = [obj for obj in bpy.context.scene.objects if is_baked(obj)]
    baked = played(meshes)
    cast.activate(body)
    bpy.ops.dynamorph.show_plain()
    plain = played(meshes)
    bpy.ops.dynamorph.show_plain()
    return {name: np.linalg.norm(points - plain[name], axis=2) for name, points in baked.items()}


def since(frame: int) -> Motion:
    """Of all baked meshes, at each frame of the scene: how far the skin is from where it was at one of them."""
    found = played([obj for obj in bpy.context.scene.objects if is_baked(obj)])
    k = frame - bpy.context.scene.frame_start
    return {name: np.linalg.norm(points - points[k], axis=2) for name, points in found.items()}


def is_baked(obj: bpy.types.Object) -> bool:
    keys = obj.data.shape_keys if obj.type == "MESH" else None
    return bool(keys and any(key.name.startswith("Dynamorph") for key in keys.key_blocks))


def played(meshes: list[bpy.types.Object]) -> dict[str, np.ndarray]:
    """Where each mesh is at each frame of the scene (F, V, 3)."""
    scene, found = bpy.context.scene, {obj.name: [] for obj in meshes}
    for frame in range(scene.frame_start, scene.frame_end + 1):
        scene.frame_set(frame)
        for obj in meshes:
            found[obj.name].append(shown(obj))
    return {name: np.array(points) for name, points in found.items()}


def farthest(moved: Motion) -> tuple[float, int]:
    """The largest motion, meters, and its frame."""
    most = np.max([each.max(axis=1) for each in moved.values()], axis=0)
    return float(most.max()), bpy.context.scene.frame_start + int(most.argmax())


def view(recipe: Recipe, frame: int, moved: Motion, red: float) -> Image.Image:
    """The scene as it shows, colored by the motion; from `red` meters on it is red."""
    for name, each in moved.items():
        paint(bpy.data.objects[name].data, each[frame - bpy.context.scene.frame_start] / red)
    return rendered(recipe, frame)


def rendered(recipe: Recipe, frame: int, engine: str = "BLENDER_WORKBENCH", samples: int = 1) -> Image.Image:
    shading = bpy.context.scene.display.shading
    shading.color_type, shading.show_shadows, shading.show_cavity = "VERTEX", False, True
    bpy.context.scene.view_settings.view_transform = "Standard"
    bpy.context.scene.view_settings.look = "None"
    return render([frame], PANE, engine, samples, {frame: recipe.focus}, recipe.close)[0]


def views(name: str, recipe: Recipe, folder: Path) -> tuple[list[Image.Image], str]:
    """Both views of what a recipe made, from its files, and what the colors say."""
    if name == "repair":
        return before_and_after(recipe, folder)
    body = open_file(folder / f"{name}_done.blend")
    if name == "motion_blur":
        return blurred(recipe), ""
    moved = since(recipe.since) if recipe.since else motion(body)
    red, frame = farthest(moved)
    frame = recipe.frame or frame
    legend = f"frame {frame}; the skin's own motion: gray none, red {1000 * red:.0f} mm"
    if recipe.since:
        left = rendered(recipe, recipe.since)
    elif name == "firm_parts":
        paint(body.data, firmness(body), MAP)
        left = rendered(recipe, frame)
    else:
        cast.activate(body)
        bpy.ops.dynamorph.show_plain()
        left = rendered(recipe, frame)
        bpy.ops.dynamorph.show_plain()
    if recipe.hidden:
        bpy.data.objects[recipe.hidden].hide_render = True
    return [left, view(recipe, frame, moved, red)], legend


def open_file(path: Path) -> bpy.types.Object:
    """A file of a recipe, and its body."""
    with quiet():
        bpy.ops.wm.open_mainfile(filepath=str(path))
    return next(obj for obj in bpy.context.scene.objects if obj.dynamorph.targets and obj.dynamorph.bake.exists)


def before_and_after(recipe: Recipe, folder: Path) -> tuple[list[Image.Image], str]:
    """The worst frame of the bake that was repaired, then and now, in the same colors."""
    moved = motion(open_file(folder / "repair_start.blend"))
    red, frame = farthest(moved)
    first = view(recipe, frame, moved, red)
    moved = motion(open_file(folder / "repair_done.blend"))
    legend = f"frame {frame}; the skin's own motion: gray none, red {1000 * red:.0f} mm"
    return [first, view(recipe, frame, moved, red)], legend


def firmness(body: bpy.types.Object) -> np.ndarray:
    """The painted map (V,)."""
    index = body.vertex_groups[body.dynamorph.firmness_group].index
    return np.array([next((g.weight for g in each.groups if g.group == index), 0.5) for each in body.data.vertices])


def blurred(recipe: Recipe) -> list[Image.Image]:
    """Cycles without and with motion blur."""
    pictures, render_settings = [], bpy.context.scene.render
    for render_settings.use_motion_blur in (False, True):
        pictures.append(rendered(recipe, BLUR_FRAME, "CYCLES", SAMPLES))
    return pictures


def write(name: str, recipe: Recipe, pictures: list[Image.Image], legend: str, folder: Path) -> None:
    """NAME.webp, and a thumbnail of the right view."""
    sheet = beside(pictures, recipe.panes, legend)
    folder.mkdir(parents=True, exist_ok=True)
    sheet.save(folder / f"{name}.webp", quality=QUALITY, method=6)
    pictures[1].resize((THUMB, THUMB), Image.Resampling.LANCZOS).save(folder / f"{name}_small.webp", quality=QUALITY)
