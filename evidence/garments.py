# SPDX-License-Identifier: GPL-3.0-or-later
"""`make garments`: docs/garments.md and its pictures: eight garments, each a soft body of its own cage on a soft body.

    python evidence/garments.py            the page
    python evidence/garments.py NAME CLIP QUALITY FILE     one bake, in a process of its own: FILE gets its figures

A garment is cut from the body's own skin, or lies around it, and is thick enough to have a cage. Both are baked
together, and how deep the garment is in the body is measured in every frame from Blender's evaluated meshes.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import project  # noqa: F401
import fresh_blender  # noqa: F401
from project import ROOT

import bpy
import builders
import characters
import dynamic_morph_targets
import numpy as np
from bench import machine
from builders import evaluated_points, make_mesh, shown
from contact_sheet import quiet, render
from dynamic_morph_targets.scene.check import checks
from dynamic_morph_targets.scene.read import mesh_data
from dynamic_morph_targets.scene.read.source import Source
from mathutils import Vector
from measured import measured_at
from measures import winding_numbers
from PIL import Image
from portrait import aim

PAGE, PICTURE, WORK = ROOT / "docs/garments.md", ROOT / "docs/images/garments.jpg", ROOT / "build/garments"
CHUBBY, MALE = "mh_chubby_53bones.blend", "mh_male_53bones.blend"
CLIPS = {  # of each body: frames of its actions
    "jump": ("gen_jump", "gen_jump", (18, 42)),
    "run": ("gen_run_in_place", "gen_run_in_place", (40, 60)),
    "walk": ("cmu_131_02_walk", "cmu_131_01_walk", (40, 64)),
}
ARMS = ("upperarm", "lowerarm", "hand", "index", "middle", "ring", "pinky", "thumb")
GAP, THICK = 0.004, 0.012  # meters: between a garment and the skin, and through it
LIMITS = {"FULL": 0.2, "REDUCED": 0.5}  # percent of the body's size: no vertex is deeper
CELL = (300, 340)
TEXT = """# Clothes on soft bodies

Clothes with *Own Cage* are soft bodies that lie on another one ([Attachments](panels/attachments.md)). This page puts
eight of them on two soft bodies, which jump, run and walk, and measures how deep they get into the skin.
`make -C evidence garments` measures it and writes this page.

{commit}; {machine}; two at a time.

The bodies are from MakeHuman ([attribution](attribution.md)). Each garment is cut from the body's skin, {gap:g} mm
outside and {thick:g} mm thick, or, as skirt and cape, lies around it. Both are as *Add Soft Skin* makes them, with
*Collision* on, and are baked together. *Bones*: how deep the garment's deepest vertex is in the body where the bones
alone move both, in percent of the body's size, in the worst frame of a clip: an arm is pressed into the side of a
shirt, a thigh into the other one, and the bones leave no room there. *Deepest*: the same of the bake, of the vertices
that the bones alone leave outside of all parts of the body in that frame, from Blender's evaluated meshes; asked: at
most {full:g} in Full Quality and {reduced:g} in Reduced. *Deeper*: the share of these vertices in all frames that are
deeper than that. Values that are too large are bold.

{count} of {all} bakes keep every vertex within the limit.

| Garment | Clip | Bones | Reduced, deepest | Deeper | Full, deepest | Deeper |
| --- | --- | ---: | ---: | ---: | ---: | ---: |
{rows}

![The garments, each in the frame in which it is deepest, in Reduced Quality](images/garments.jpg)
"""


@dataclass(frozen=True)
class Body:
    """A skin at rest in its own space, meters. points, normals (V, 3); weights (V, B) of the bones `names`."""

    points: np.ndarray
    normals: np.ndarray
    faces: list[list[int]]
    weights: np.ndarray
    names: list[str]

    def on(self, *bones: str) -> np.ndarray:
        """The share (V,) of the skin on bones whose names begin so."""
        return self.weights[:, [name.startswith(bones) for name in self.names]].sum(axis=1)

    @property
    def height(self) -> np.ndarray:
        """Of each vertex, from the soles, 0, to the crown, 1."""
        return self.points[:, 2] / self.points[:, 2].max()


# Garments: points, faces, and weights (V, B) ------------------------------------------------------------------------

Made = tuple[np.ndarray, list[list[int]], np.ndarray]


def shell(body: Body, keep: np.ndarray, gap: float = GAP) -> Made:
    """The faces of the skin whose corners are all kept."""
    faces = [face for face in body.faces if keep[face].all()]
    used, numbers = np.unique(np.concatenate(faces), return_inverse=True)
    faces = np.split(numbers, np.cumsum([len(face) for face in faces])[:-1])
    points, normals = body.points[used], body.normals[used]
    return thick(points + gap * normals, normals, [face.tolist() for face in faces], body.weights[used])


def around(body: Body, top: float, bottom: float, angles: np.ndarray, wide: float) -> Made:
    """A cloth that hangs around the body between two heights: rings of ellipses around what is there, wider by `wide`
    meters at the bottom. angles: at which it has points, closed where they go around.
    """
    rings, columns = np.linspace(top, bottom, 16), len(angles)
    points = []
    for k, height in enumerate(rings):
        there = (np.abs(body.height - height) < 0.02) & (body.on(*ARMS) < 0.1)
        half = np.abs(body.points[there, 0]).max(), 0.5 * np.ptp(body.points[there, 1])
        middle, more = body.points[there, 1].mean(), 0.02 + wide * k / len(rings)
        across, along = np.sin(angles) * (half[0] + more), middle + np.cos(angles) * (half[1] + more)
        points.append(np.column_stack([across, along, np.full(columns, height * body.points[:, 2].max())]))
    outward = np.array(points) - np.mean(points, axis=1, keepdims=True)
    outward /= np.linalg.norm(outward, axis=2, keepdims=True)
    grid = np.arange(len(rings) * columns).reshape(len(rings), columns)
    grid = np.column_stack([grid, grid[:, :1]]) if np.ptp(angles) > 6.0 else grid
    faces = np.stack([grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:], grid[:-1, :-1]], axis=-1).reshape(-1, 4)
    inner = outside(body, np.concatenate(points))
    nearest = np.linalg.norm(inner[:, None] - body.points[None], axis=2).argmin(axis=1)
    return thick(inner, outward.reshape(-1, 3), faces[:, ::-1].tolist(), body.weights[nearest])


def thick(inner: np.ndarray, outward: np.ndarray, faces: list[list[int]], weights: np.ndarray) -> Made:
    """A surface, its copy THICK outside, and what closes both along their borders. faces: counterclockwise from
    outside.
    """
    count, sides = len(inner), {(a, b) for face in faces for a, b in zip(face, [*face[1:], face[0]], strict=True)}
    closed = [[v + count for v in face] for face in faces] + [face[::-1] for face in faces]
    closed += [[a, b, b + count, a + count] for a, b in sides if (b, a) not in sides]
    return np.concatenate([inner, inner + THICK * outward]), closed, np.tile(weights, (2, 1))


def outside(body: Body, points: np.ndarray) -> np.ndarray:
    """Points (N, 3), those that are nearer than GAP to the skin, or in it, moved out."""
    for _ in range(3):
        nearest = np.linalg.norm(points[:, None] - body.points[None], axis=2).argmin(axis=1)
        normals = body.normals[nearest]
        above = np.einsum("ij,ij->i", points - body.points[nearest], normals)
        points = points + (GAP - above).clip(0.0)[:, None] * normals
    return points


GARMENTS: dict[str, tuple[str, Callable[[Body], Made]]] = {
    "shirt": (CHUBBY, lambda b: shell(b, (b.on("spine", "clavicle", "upperarm", "pelvis") > 0.5) & (b.height > 0.5))),
    "trousers": (CHUBBY, lambda b: shell(b, (b.on("thigh", "calf", "pelvis") > 0.5) & (b.height < 0.57))),
    "belt": (CHUBBY, lambda b: shell(b, (b.on("spine", "pelvis") > 0.5) & (np.abs(b.height - 0.57) < 0.035))),
    "bra": (CHUBBY, lambda b: shell(b, (b.on("spine", "clavicle") > 0.6) & (np.abs(b.height - 0.72) < 0.045))),
    "coat": (
        MALE,
        lambda b: shell(
            b, (b.on("spine", "clavicle", "upperarm", "lowerarm", "pelvis") > 0.5) & (b.height > 0.48), 0.01
        ),
    ),
    "glove": (MALE, lambda b: shell(b, b.on("hand_l", "lowerarm_l") > 0.6)),
    "skirt": (MALE, lambda b: around(b, 0.58, 0.36, np.linspace(0.0, 2.0 * np.pi, 41)[:-1], 0.06)),
    "cape": (MALE, lambda b: around(b, 0.8, 0.3, np.linspace(-1.2, 1.2, 24), 0.08)),
}


# One bake -----------------------------------------------------------------------------------------------------------


def bake_one(name: str, clip: str, quality: str, file: Path) -> int:
    """Writes the figures to the file and, beside it, a picture of the deepest frame."""
    dynamic_morph_targets.register()
    source, made = GARMENTS[name]
    with quiet():
        characters.open_file(characters.ASSETS / source)
        body = characters.largest_skinned()
        rig, scene = characters.armature_of(body), bpy.context.scene
        characters.play(rig, bpy.data.actions[CLIPS[clip][source == MALE]])
        scene.frame_start, scene.frame_end = CLIPS[clip][2]
        for other in [obj for obj in scene.objects if obj.type == "MESH" and obj != body]:
            bpy.data.objects.remove(other)
        garment = dressed(body, rig, name, made)
        for obj in (garment, body):
            bpy.context.view_layer.objects.active = obj
            bpy.ops.dynamorph.add_soft_skin()
        for obj, other in ((body, garment), (garment, body)):
            next(each for each in obj.dynamorph.attachments if each.object == other).attached_by = "OWN_CAGE"
            obj.dynamorph.collision.use, obj.dynamorph.model.quality = True, quality
        plain = shown([garment, body])
        bpy.ops.dynamorph.bake_all()
    size = np.linalg.norm(np.ptp(mesh_data.rest_points(body), axis=0))
    triangles = mesh_data.mesh_triangles(body.data)
    deepest = 100.0 * depths(*shown([garment, body]), triangles) / size
    room = has_room(*plain, triangles, deepest > LIMITS[quality])
    figures = {
        "bones": 100.0 * depths(*plain, triangles).max() / size,
        "deepest": deepest[room].max(),
        "deeper": float((deepest[room] > LIMITS[quality]).mean()),
    }
    deepest = np.where(room, deepest, -np.inf)
    file.write_text(json.dumps(figures) + "\n", encoding="utf-8")
    worst = scene.frame_start + int(deepest.max(axis=1).argmax())
    scene.frame_set(worst)
    aim(np.concatenate([evaluated_points(obj) for obj in (body, garment)]), CELL, Vector((0.7, -1.0, 0.25)))
    for other in scene.objects:
        other.hide_render = other not in (body, garment, rig)
    with quiet():
        render([worst], CELL, samples=4)[0].save(file.with_suffix(".png"))
    return 0


def dressed(body, rig, name: str, made: Callable[[Body], Made]):
    """The garment as a mesh on the body's armature."""
    source = Source.of(checks.skinned(body))
    mesh, names = body.data, list(source.skeleton.names)
    normals = np.array([vertex.normal for vertex in mesh.vertices])
    faces = [list(polygon.vertices) for polygon in mesh.polygons]
    points, polygons, weights = made(Body(source.points, normals, faces, source.weights[:, :-1], names))
    garment = make_mesh(bpy.context.scene, name, points, polygons)
    garment.parent, garment.matrix_parent_inverse = body.parent, body.matrix_parent_inverse.copy()
    garment.matrix_world = body.matrix_world.copy()
    for bone, column in zip(names, weights.T, strict=True):
        if column.any():
            group = garment.vertex_groups.new(name=bone)
            for vertex in np.flatnonzero(column).tolist():
                group.add([vertex], float(column[vertex]), "REPLACE")
    garment.modifiers.new("Armature", "ARMATURE").object = rig
    bpy.context.view_layer.update()
    return garment


def depths(garment: np.ndarray, body: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """How deep the garment's vertices (F, V, 3) are in the body (F, W, 3): (F, V), meters; negative outside."""
    faces = triangles.tolist()
    return np.array([builders.depths(points, skin, faces) for points, skin in zip(garment, body, strict=True)])


def has_room(garment: np.ndarray, body: np.ndarray, triangles: np.ndarray, asked: np.ndarray) -> np.ndarray:
    """Which vertices (F, V) of the garment are in no part of the body where the bones alone move both, by the winding
    number: a vertex that is in an arm may be in front of the nearest skin. Those that are not asked for have room.
    """
    room = np.ones(asked.shape, bool)
    for frame in np.flatnonzero(asked.any(axis=1)):
        wanted = asked[frame]
        room[frame, wanted] = winding_numbers(garment[frame, wanted], body[frame], triangles) < 0.5
    return room


# The page -----------------------------------------------------------------------------------------------------------


def main() -> int:
    if sys.argv[1:]:
        return bake_one(*sys.argv[1:4], Path(sys.argv[4]))
    commit = measured_at(PAGE.name)
    WORK.mkdir(parents=True, exist_ok=True)
    wanted = [(name, clip, q) for name in GARMENTS for clip in CLIPS for q in LIMITS]
    with ThreadPoolExecutor(2) as pool:
        found = dict(zip(wanted, pool.map(lambda each: in_process(*each), wanted), strict=True))
    rows, kept = [], 0
    for name in GARMENTS:
        for clip in CLIPS:
            cells = [name, clip, f"{found[name, clip, 'FULL']['bones']:.2f}"]
            for quality, most in reversed(LIMITS.items()):
                one = found[name, clip, quality]
                within = one["deepest"] <= most
                kept += within
                deepest = f"{one['deepest']:.2f}"
                cells += [deepest if within else f"**{deepest}**", f"{100 * one['deeper']:.2f}%"]
            rows.append(f"| {' | '.join(cells)} |")
    pictures = [Image.open(WORK / f"{name}_{worst_clip(found, name)}_REDUCED.png") for name in GARMENTS]
    show(pictures)
    text = TEXT.format(
        commit=commit, machine=machine(), gap=1e3 * GAP, thick=1e3 * THICK, full=LIMITS["FULL"],
        reduced=LIMITS["REDUCED"], count=kept, all=2 * len(rows), rows="\n".join(rows),
    )  # fmt: skip
    PAGE.write_text(text, encoding="utf-8")
    print(f"written to {PAGE.relative_to(ROOT)}")
    return 0


def worst_clip(found: dict, name: str) -> str:
    return max(CLIPS, key=lambda clip: found[name, clip, "REDUCED"]["deepest"])


def in_process(name: str, clip: str, quality: str) -> dict:
    """Raises RuntimeError where the bake fails."""
    file = WORK / f"{name}_{clip}_{quality}.json"
    run = subprocess.run(
        [sys.executable, __file__, name, clip, quality, file], capture_output=True, text=True, check=False
    )
    if run.returncode:
        raise RuntimeError(f"{name}, {clip}, {quality}: {run.stderr.strip()[-800:]}")
    print(f"{name}, {clip}, {quality}: {file.read_text().strip()}", flush=True)
    return json.loads(file.read_text(encoding="utf-8"))


def show(pictures: Sequence[Image.Image]) -> None:
    """Four beside each other, two rows."""
    sheet = Image.new("RGB", (4 * CELL[0], 2 * CELL[1]))
    for k, picture in enumerate(pictures):
        sheet.paste(picture, (k % 4 * CELL[0], k // 4 * CELL[1]))
    sheet.save(PICTURE, quality=85)


if __name__ == "__main__":
    sys.exit(main())
