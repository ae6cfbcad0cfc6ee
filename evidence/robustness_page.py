# SPDX-License-Identifier: GPL-3.0-or-later
"""`make robustness`: docs/robustness.md and its picture, from the characters of ../shared. No number is typed here."""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import fresh_blender  # noqa: F401
from project import ROOT

import believable_measure
import bpy
import characters
import dynamic_morph_targets
import dynamorph
import heat
import numpy as np
import test_defects
from assets import attribution, require
from contact_sheet import Row, compose, quiet, render, save
from dynamic_morph_targets.core.geometry import diagonal
from dynamic_morph_targets.core.material.feel import FEELS
from dynamic_morph_targets.run.bake import batch
from dynamic_morph_targets.scene.read import mesh_data
from mathutils import Vector
from measured import measured_at
from performance_page import grid
from PIL import ImageDraw
from portrait import aim

PAGE = ROOT / "docs" / "robustness.md"
PICTURE = "images/robustness.png"
MESHES = characters.ASSETS.parent / "meshes"
CELL, ACROSS = (250, 210), 6  # pixels of a picture, pictures in a row
RED = 0.1  # body sizes: bakes without limits swing far
SURFACE_NODES = 600
ABSENT = "-"
DEFECTS = {
    "open edges": "open_edges",
    "non-manifold edges": "nonmanifold_edges",
    "flipped faces": "flipped_faces",
    "duplicate faces": "duplicate_faces",
    "degenerate faces": "degenerate_faces",
    "stray vertices": "stray_vertices",
    "loose parts": "components",
}

PAGE_TEXT = """# Robustness

This page builds and bakes meshes and rigs as people find them: with holes, loose parts, flipped faces and imports at
odd scales. Most of the files were made elsewhere. You need not clean up a mesh before you press **Add Soft Skin**: what
is wrong with it is counted, and the cage is built around it.

**This page is about survival, not about looks.** Its bakes are harder on the engine than yours will be: nothing limits
how far the skin moves, and only the bones hold it. That is why the skin of a jumping man leaves the animation by a
large part of his size below. With the defaults, **Max Displacement** keeps the skin within {limit:.0%} of the body's
size; how characters look then is on [Believable](believable.md).

`make -C evidence robustness` measures and writes this page; nothing on it is written by hand.
`tests/addon/package/test_characters.py` asserts for each character, in Blender 4.5 and 5.2, that the bake is finite and
bounded, that Blender shows what the engine computed, and that *Delete Bake* restores the object.
`tests/engine/test_defects.py` damages clean bodies in {kinds} ways and their mixtures; `make -C evidence fuzz` tries
more of them.

{commit}. Blender {blender}, {machine}.

## Characters

The largest skinned mesh of each file as it is opened or imported, made a soft skin of about {nodes} nodes, {substeps}
substeps a frame. Where a file has shape keys some are targets; the others are simulated with a single material.

![Each character with plain skinning, and baked, colored by how far the skin has moved]({picture})

{attribution}
- Sources and licenses: [Attribution](attribution.md).

### Meshes

The table counts the defects that the cage must cope with, after vertices at the same place are merged. The artist's
mesh is not changed.

{defects}
### Cages

*Dihedral angles* are those between faces of a tetrahedron. *Inside*: share of the skin's vertices inside the cage.
*Glued* tetrahedra would join skin that is far apart along the mesh. *Pinned loose parts* of the cage had no bone in
them.

{cages}
### Bakes

*Size*: diagonal of the box around it; *scaled* as *Add Soft Skin* asks for where an import is of no likely size.
*Farthest*: the largest distance of the skin from where the bones alone put it, with nothing to limit it. *Inside out*:
tetrahedra of the cage that are turned inside out in the worst frame, where the unlimited motion presses the tissue
together. *Finite*: no position is infinite or not a number, so that the bake plays and can be saved even then. This is
what the table is for.

{bakes}
## Surfaces

All {surfaces} mesh objects of these files and of `../shared/meshes`, skinned or not, each wrapped and filled with
about {surface_nodes} nodes: {meshed} could be, and {contained} of these cages contain every vertex. The median took
{median:.2f} s, the longest {seconds:.1f} s. Of their dihedral angles {slivers} are under 5°.
{refused}"""


@dataclass
class Tally:
    """What came of meshing many surfaces."""

    seconds: list[float] = field(default_factory=list)
    contained: int = 0
    refused: list[str] = field(default_factory=list)
    angles: list[np.ndarray] = field(default_factory=list)


def main() -> int:
    require("robustness", (shot.file for shot in characters.SHOTS.values()))
    dynamic_morph_targets.register()
    write_page()
    print(f"written to {PAGE.relative_to(ROOT)}")
    return 0


def write_page() -> None:
    defects, cages, bakes, pictures = [], [], [], []
    for name, shot in characters.SHOTS.items():
        with quiet():
            baked = characters.bake(batch, characters.open_shot(shot))
            pictures += portraits(baked)
        defects.append((name, *mesh_row(baked)))
        cages.append((name, *cage_row(baked)))
        clip = shot.clip.rpartition("|")[2]
        size = f"{baked.size:.2f} m" + (f", scaled {shot.scale:g}" if shot.scale != 1.0 else "")
        frames = f"{clip}, {shot.frames[0]} to {shot.frames[1]}"
        bakes.append((name, size, f"{shot.stiffness / 1000:.0f} kPa", frames, *bake_row(baked)))
        print(f"{name}: {' | '.join(cages[-1][1:])} | {' | '.join(bakes[-1][1:])}", flush=True)
    draw(pictures)
    tally = mesh_surfaces()
    page = PAGE_TEXT.format(
        commit=measured_at(PAGE.name),
        limit=FEELS["NATURAL"].max_displacement,
        kinds=len(test_defects.DEFECTS),
        blender=bpy.app.version_string,
        machine=f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        nodes=characters.NODES,
        substeps=characters.SUBSTEPS,
        picture=PICTURE,
        attribution=attribution(shot.file for shot in characters.SHOTS.values()),
        defects=grid(("", "vertices", "faces", *DEFECTS), defects),
        cages=grid(("", "nodes", "tetrahedra", "smallest dihedral angle", "under 5°", "inside", "glued",
                    "pinned loose parts"), cages),
        bakes=grid(("", "size", "stiffness", "clip, frames", "build", "bake", "farthest", "of the size", "inside out",
                    "finite"), bakes),
        surfaces=len(tally.seconds) + len(tally.refused),
        surface_nodes=SURFACE_NODES,
        meshed=len(tally.seconds),
        contained=tally.contained,
        seconds=max(tally.seconds),
        median=float(np.median(tally.seconds)),
        slivers=f"{100 * np.mean(np.concatenate(tally.angles) < 5.0):.2f} %",
        refused="\n".join(["", *(f"- {text}" for text in tally.refused)]),
    )  # fmt: skip
    PAGE.write_text(page.rstrip() + "\n", encoding="utf-8")


# Characters -----------------------------------------------------------------------------------------------------------


def mesh_row(baked: characters.Baked) -> list[str]:
    mesh, found = baked.body.data, baked.job.outcome.model.summary.defects
    counts = [len(mesh.vertices), len(mesh.polygons), *(found.get(key) for key in DEFECTS.values())]
    return [ABSENT if count is None else f"{count:,}" for count in counts]


def cage_row(baked: characters.Baked) -> list[str]:
    model = baked.job.outcome.model
    angles = dihedral_angles(model.nodes, model.tets)
    known = model.summary
    return [
        f"{len(model.nodes):,}",
        f"{len(model.tets):,}",
        f"{angles.min():.1f}°",
        f"{100 * np.mean(angles < 5.0):.2f} %",
        f"{100 * baked.inside.mean():.1f} %",
        str(known.glued.get("tets", ABSENT)),
        str(known.held_parts),
    ]


def bake_row(baked: characters.Baked) -> list[str]:
    job = baked.job
    farthest = np.linalg.norm(baked.displacements, axis=2).max()
    built = job.progress.seconds["build"]
    return [
        f"{built:.2f} s",
        f"{sum(job.progress.seconds.values()) - built:.2f} s",
        f"{1000 * farthest:.0f} mm",
        f"{100 * farthest / baked.size:.1f} %",
        f"{job.outcome.report['inverted']:,}",
        "yes" if np.isfinite(baked.displacements).all() else "no",
    ]


def dihedral_angles(nodes: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """The six (m, 6) of each tetrahedron, degrees."""
    corners = nodes[tets]
    faces = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
    a, b, c = (corners[:, faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    first, second = np.triu_indices(4, 1)
    cosines = -np.einsum("mkc,mkc->mk", normals[:, first], normals[:, second])
    return np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))


# The picture ----------------------------------------------------------------------------------------------------------


def portraits(baked: characters.Baked) -> list:
    """The whole character at the frame where the skin is farthest: as the bones alone have it, and baked, colored by
    how far it is from there."""
    scene = bpy.context.scene
    lengths = np.linalg.norm(baked.displacements, axis=2)
    farthest = int(lengths.max(axis=1).argmax())
    scene.frame_set(int(baked.job.outcome.bake.frames[farthest]))
    shown = [obj for obj in scene.objects if obj.type == "MESH" and obj.parent and obj.visible_get()]
    for obj in scene.objects:
        obj.hide_render = obj not in shown and obj.type != "LIGHT"
        if obj in shown:
            heat.paint(obj.data, np.zeros(len(obj.data.vertices)))
    shares, character = lengths[farthest] / (RED * baked.size), baked.job.outcome.character
    heat.paint(baked.body.data, shares[character.own_vertices])
    for each in character.attachments:
        heat.paint(bpy.data.objects[each.name].data, shares[each.members])
    aim(np.array([obj.matrix_world @ Vector(corner) for obj in shown for corner in obj.bound_box]), CELL)
    pictures = []
    for plain, color in ((True, "MATERIAL"), (False, "VERTEX")):
        believable_measure.show(plain=plain)
        scene.display.shading.color_type = color
        pictures.append(render([scene.frame_current], CELL, "BLENDER_WORKBENCH")[0])
    return pictures


def draw(pictures: list) -> None:
    """pictures: two of each character."""
    names = [f"{name}, {what}" for name in characters.SHOTS for what in ("bones alone", "baked")]
    rows = [
        Row("", "", pictures[first : first + ACROSS], names[first : first + ACROSS])
        for first in range(0, len(names), ACROSS)
    ]
    about = "Each at the frame where its skin is farthest from where the bones alone put it"
    sheet = compose("Nine characters, before and after", about, [""] * ACROSS, rows)
    heat.draw_legend(ImageDraw.Draw(sheet), 720, 51, f"how far: gray none, red {RED:.0%} of the body's size")
    save(sheet, PAGE.parent / PICTURE, small=True)


# Surfaces -------------------------------------------------------------------------------------------------------------


def mesh_surfaces() -> Tally:
    tally = Tally()
    for name, vertices, triangles in surfaces():
        began = time.perf_counter()
        try:
            *_, mesh = dynamorph.mesh_body(vertices, triangles, SURFACE_NODES)
        except dynamorph.Error as error:
            tally.refused.append(f"{name}: {error}")
            continue
        tally.seconds.append(time.perf_counter() - began)
        outside = dynamorph.embed(mesh, vertices[np.unique(triangles)]).distances
        tally.contained += bool(outside.max() < 1e-6 * diagonal(vertices))
        tally.angles.append(dihedral_angles(mesh.nodes, mesh.tets).ravel())
    return tally


def surfaces() -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """(name, vertices (V, 3), triangles (T, 3)) of all there are, meters."""
    for shot in characters.SHOTS.values():
        with quiet():
            characters.open_file(shot.path)
        for obj in bpy.context.scene.objects:
            if obj.type == "MESH" and obj.data.polygons:
                points = np.array([obj.matrix_world @ vertex.co for vertex in obj.data.vertices], float)
                yield f"{shot.file}, {obj.name}", points, mesh_data.mesh_triangles(obj.data)
    for file in sorted(MESHES.glob("*.npz")):
        with np.load(file) as stored:
            yield file.name, stored["V"], boundary(stored["T"])


def boundary(tets: np.ndarray) -> np.ndarray:
    """The faces (T, 3) that belong to one tetrahedron alone."""
    faces = tets[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
    _, first, counts = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[first[counts == 1]]


if __name__ == "__main__":
    sys.exit(main())
