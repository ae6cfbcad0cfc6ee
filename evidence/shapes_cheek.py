# SPDX-License-Identifier: GPL-3.0-or-later
"""A hand pulls Herbert's cheek and lets go, for shapes.py: the scene, a strip of its frames, and a plot."""

from __future__ import annotations

from pathlib import Path

import bpy
import measures
import numpy as np
import plots
import subjects
from contact_sheet import render
from dynamic_morph_targets.core.geometry import smooth_step
from heat import beside, paint
from mathutils import Vector
from portrait import aim
from recipes import cast, pictures, steps
from shapes_posed import save
from stage import add_ball, add_material, add_vertex_groups, assign, paint_for_workbench

CHEEK = (0.115, -0.125, 1.455)  # of Herbert: where the hand takes hold, meters
PULL = (0.058, -0.037, -0.007)  # the hand's way
GRASP = 5.0  # Strength of its grip
TAKES, PULLS, STOPS, HOLDS, GONE = 6, 8, 20, 23, 24  # frames: it holds the cheek, goes, stands, holds still, lets go
FILM = 60  # frames
LOOSE, AROUND, BORDER = 0.1, 0.06, 0.12  # Firmness of the cheek, and the distances in which it rises to 1, meters
TISSUE = {"stiffness": 1e3, "mass_damping": 2.0, "stiffness_damping": 0.002}
RINGS = 0.05  # of the pull: what is less is over
FACE = (1.45, 1.57)  # heights of what is in the picture, meters
CELL, SEEN_FROM = (300, 270), (0.32, -1.0, 0.12)
WIDE, SPAN = 8.0, "#e4e6ea"  # of a plot: inches across, color of a span of frames


def measured(strip: Path, plot: Path) -> dict[str, float]:
    """hand, pulled, over: how far hand and cheek go along the pull, and the cheek to the other side, meters; hertz,
    seconds: at which it rings, and for how long. Writes both pictures."""
    body, hand = scene_of_pull()
    points = pictures.played([body])[body.name]
    vertex, way = subjects.nearest(CHEEK)(points[0]), np.array(PULL) / np.linalg.norm(PULL)
    along = (points[:, vertex] - points[0, vertex]) @ way
    film(strip, body, hand, np.linalg.norm(points - points[0], axis=2), along)
    frames, start = np.arange(1, FILM + 1), place_of(hand, TAKES)
    held = frames[TAKES - 1 :]
    lines = {
        "the hand": (held, [1000.0 * (place_of(hand, frame) - start) @ way for frame in held]),
        "the cheek": (frames, 1000.0 * along),
    }
    over_frames(plot, "Distance along the pull", lines, (TAKES, GONE), "gray: the hand holds the cheek")
    free, rate = along[GONE - 1 :], bpy.context.scene.render.fps
    ringing = np.flatnonzero(np.abs(free) > RINGS * along[HOLDS - 1])
    return {
        "hand": float(np.linalg.norm(PULL)),
        "pulled": float(along[HOLDS - 1]),
        "over": float(-free.min()),
        "hertz": measures.dominant_frequency(free, rate),
        "seconds": float((ringing[-1] + 1) / rate),
    }


def over_frames(path: Path, title: str, lines: plots.Curves, span: tuple[int, int], note: str) -> None:
    """A plot in millimeters over frames, some of which are marked."""
    drawing, axes = plots.figure(1, 2.6)
    drawing.set_figwidth(WIDE)
    axes[0].axvspan(*span, color=SPAN, zorder=0)
    plots.draw(axes[0], title, lines, f"frame; {note}", "mm")
    plots.save(drawing, path)


def scene_of_pull() -> tuple[bpy.types.Object, bpy.types.Object]:
    """Herbert's head, baked, and the hand that pulls it."""
    body, scene = cast.herbert(cast.stand, "Stand"), bpy.context.scene
    for name in ("Moustache", "Floor"):
        bpy.data.objects.remove(bpy.data.objects[name])
    cast.delete(body, ~cast.belongs(body, cast.HEAD_BONES, (0.0, 9.0)))
    steps.Hands().add_soft_skin(body)
    settings, points = body.dynamorph, steps.shown(body)
    place = points[subjects.nearest(CHEEK)(points)]
    firmness = smooth_step(np.linalg.norm(points - place, axis=1), AROUND, BORDER)
    add_vertex_groups(body, {"Firmness": LOOSE + (1.0 - LOOSE) * firmness})
    settings.firmness_group = "Firmness"
    settings.model.hold_head, settings.model.solver = False, "FULL"
    settings.simulation.max_displacement = settings.simulation.max_thickness = 0.0
    assign(settings.targets[0], TISSUE)
    hand = add_ball("Hand", 0.013, add_material("Hand", (0.95, 0.62, 0.08), 0.4))
    paint_for_workbench()
    for frame, away in ((1, (0.08, -0.08, 0.0)), (TAKES, (0.0, 0.0, 0.0)), (PULLS, (0.0, 0.0, 0.0)), (STOPS, PULL)):
        hand.location = place + away
        hand.keyframe_insert("location", frame=frame)
    scene.frame_end = FILM
    scene.frame_set(TAKES)
    cast.activate(body, hand)
    steps.OPS.attach()
    for frame, strength in ((TAKES - 1, 0.0), (TAKES, GRASP), (HOLDS, GRASP), (GONE, 0.0)):
        settings.grips[0].strength = strength
        settings.grips[0].keyframe_insert("strength", frame=frame)
    steps.OPS.bake()
    return body, hand


def place_of(obj: bpy.types.Object, frame: int) -> np.ndarray:
    bpy.context.scene.frame_set(frame)
    return np.array(obj.matrix_world.translation)


def film(path: Path, body: bpy.types.Object, hand: bpy.types.Object, moved: np.ndarray, along: np.ndarray) -> None:
    """A strip of frames: held, pulled, and the first swing to the other side and back. moved (F, V), along (F,)."""
    over = GONE + int(along[GONE - 1 : GONE + 5].argmin())
    back = over + int(along[over - 1 : over + 5].argmax())
    shown = {TAKES: "taken", (PULLS + STOPS) // 2: "pulled", HOLDS: "held", over: "let go", back: "swings back"}
    shading, view = bpy.context.scene.display.shading, bpy.context.scene.view_settings
    shading.color_type, shading.show_cavity, view.view_transform, view.look = "VERTEX", True, "Standard", "None"
    points, views = steps.shown(body), []
    face = points[(points[:, 2] > FACE[0]) & (points[:, 2] < FACE[1])]
    aim(np.concatenate([face, [place_of(hand, HOLDS)]]), CELL, Vector(SEEN_FROM).normalized())
    for frame in shown:
        paint(body.data, moved[frame - 1] / moved.max())
        views += render([frame], CELL, "BLENDER_WORKBENCH")
    legend = f"the skin's own motion: gray none, red {1000 * moved.max():.0f} mm"
    titles = [f"frame {frame}: {what}" for frame, what in shown.items()]
    save(beside(views, titles, legend), path)
