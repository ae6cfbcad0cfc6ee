# SPDX-License-Identifier: GPL-3.0-or-later
"""Walk cycles that travel, baked with and without Loop: what gap remains where they begin again, and its pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import radians

from project import ROOT

import bpy
import characters
import numpy as np
import plots
from builders import evaluated_points
from contact_sheet import Row, compose, quiet, render, save
from dynamic_morph_targets.core.geometry import diagonal
from dynamic_morph_targets.core.motion import loops, player
from dynamic_morph_targets.core.motion.player import Player
from dynamic_morph_targets.run.bake import batch, job
from dynamic_morph_targets.run.bake.job import Job
from mathutils import Matrix, Vector
from PIL import Image

IMAGES = ROOT / "docs" / "images" / "bakes"
CELL = (390, 230)  # pixels of a picture
REPEATED = 30  # cycles that are played one after the other without Loop
LOOP, OPEN, FAINT, SEAM = "#00798c", "#d1495b", "#8a8f98", "#c9a227"  # colors of curves


@dataclass(frozen=True)
class Walk:
    """A cycle of a character that travels by so many body sizes meanwhile, along a circle if it turns (degrees)."""

    shot: characters.Shot
    travel: float
    turn: float = 0.0


FOX = characters.Shot("Fox.glb", "Walk", (0, 17), scale=0.01, stiffness=6e4)
TREX = characters.Shot("Quaternius_Trex.glb", "Armature|TRex_Walk", (0, 33), scale=0.2, stiffness=4e5)
WALKS = {
    "Fox": Walk(FOX, 0.6),
    "Fox, in a circle": Walk(FOX, 0.6, 30.0),
    "Fox, softer": Walk(replace(FOX, stiffness=4e4), 0.6),
    "T-rex": Walk(TREX, 0.5),
    "T-rex, in a circle": Walk(TREX, 0.5, -30.0),
}
PICTURED = "Fox"
ENDLESS = "T-rex"  # its body finds no steady motion by itself


@dataclass(frozen=True)
class Baked:
    """job: the bake; pictures: of its first and its last frame; apart: meters between them as Blender shows them."""

    job: job.Job
    pictures: list[Image.Image]
    apart: float


def looped(name: str) -> dict:
    """One of WALKS, baked with and without Loop. Lengths are in sizes of the body's."""
    walk = WALKS[name]
    with quiet():
        body = characters.open_shot(walk.shot)
    path = set_off(body, walk)
    without, closed = (bake(body, path, loop) for loop in (False, True))
    job = closed.job
    motion, size = job.outcome.bake.coordinates, job.computation.shot.player.size
    steps = np.diff(motion, axis=0)
    gone_on = job.computation.shot.player.state.coordinates[0]
    onward = gone_on - motion[-1]  # the step from the last frame to where the loop has gone on
    cycles, gaps = repeat(job)
    found = {
        "name": name,
        "frames": walk.shot.frames,
        "travel": walk.travel,
        "turn": walk.turn,
        "stiffness": walk.shot.stiffness,
        "swing": max(length(job, row) for row in motion),
        "without": length(job, without.job.outcome.bake.coordinates[-1] - without.job.outcome.bake.coordinates[0]),
        "gap": length(job, motion[-1] - motion[0]),
        "velocity_gap": length(job, onward - steps[0]),  # a frame
        "shown": closed.apart / size,
        "reported": job.outcome.report["gap"] / size,
        "passes": job.computation.shot.player.passes,
        "repeated": gaps[-1],
        "seconds": job.outcome.report["seconds"],
        "warnings": job.outcome.report["warnings"],
    }
    if name == PICTURED:
        draw_seam(without, closed)
        draw_motion(job, without.job.outcome.bake.coordinates, cycles)
    if name == ENDLESS:
        draw_passes(job, gaps)
    return found


def length(job, coordinates: np.ndarray) -> float:
    """How far coordinates (r,) displace a vertex at most, in sizes of the body."""
    moved = np.tensordot(coordinates, job.outcome.bake.modes, 1) @ job.outcome.character.to_bind.T
    return float(np.linalg.norm(moved, axis=1).max()) / job.computation.shot.player.size


def set_off(body, walk: Walk):
    """Let the character go forward, or on a circle, at a steady pace; returns the empty that carries it."""
    scene = bpy.context.scene
    root = body
    while root.parent:
        root = root.parent
    angle, travel = radians(walk.turn), walk.travel * diagonal(evaluated_points(body))
    center = Vector((travel / angle, 0.0, 0.0)) if angle else Vector()
    path = bpy.data.objects.new("Path", None)
    scene.collection.objects.link(path)
    root.parent, root.matrix_parent_inverse = path, Matrix.Translation(-center)
    bpy.context.preferences.edit.keyframe_new_interpolation_type = "LINEAR"
    for frame, share in zip(walk.shot.frames, (0.0, 1.0), strict=True):
        path.rotation_euler.z = share * angle
        path.location = center if angle else Vector((0.0, -share * travel, 0.0))  # these characters look along -y
        path.keyframe_insert("location", frame=frame)
        path.keyframe_insert("rotation_euler", frame=frame)
    scene.frame_set(walk.shot.frames[0])
    return path


def bake(body, path, loop: bool) -> Baked:
    body.dynamorph.simulation.loop = loop
    batch.run(Job(body, "BAKE"))
    job = Job(body, "BAKE", stored=False)  # in all coordinates; shape keys have only as many as show the motion
    batch.run(job)
    ends, surfaces = (job.input.settings.frame_start, job.input.settings.frame_end), []
    for frame in ends:
        bpy.context.scene.frame_set(frame)
        back = np.array(path.matrix_world.inverted())
        surfaces.append(evaluated_points(body) @ back[:3, :3].T + back[:3, 3])
    apart = np.linalg.norm(surfaces[1] - surfaces[0], axis=1).max()
    return Baked(job, photographs(body, path, ends), float(apart))


def repeat(job) -> tuple[np.ndarray, list[float]]:
    """The cycle again and again without Loop: coordinates (REPEATED, F, r), and how far the end of each is from its
    beginning, in sizes of the body.
    """
    settings = replace(job.input.settings, loop=False)
    player = Player(job.outcome.model, job.outcome.character, settings)
    first, cycles, gaps = player.begin(job.computation.rig), [], []
    for _ in range(REPEATED):
        frames = [first, *player.play(job.computation.rig[1:], settings.simulated[1:])]
        cycles.append([frame.coordinates for frame in frames])
        gaps.append(player.gap(frames[0], frames[-1]) / player.size)
        first = loops.begin_again(player, job.computation.rig, frames[-1])
    return np.array(cycles), gaps


class Watched(player.Player):
    """Notes the gaps that a loop is judged by: in place, and a frame later."""

    gaps: tuple[float, ...] = ()

    def gap(self, first, second) -> float:
        found = super().gap(first, second)
        self.gaps += (found / self.size,)
        return found


# Pictures -------------------------------------------------------------------------------------------------------------


def photographs(body, path, frames) -> list[Image.Image]:
    """The body from aside at these frames, by a camera that goes along."""
    scene = bpy.context.scene
    for obj in scene.objects:
        obj.hide_render = obj != body
    scene.frame_set(frames[0])
    points = evaluated_points(body)
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(np.linalg.norm(high - low))
    side = Vector((1.0, -0.3, 0.2)).normalized()
    camera = bpy.data.objects.new("Picture", bpy.data.cameras.new("Picture"))
    scene.collection.objects.link(camera)
    camera.data.type, camera.data.ortho_scale, camera.data.clip_end = "ORTHO", 0.9 * size, 10.0 * size
    camera.matrix_basis = Matrix.Translation(Vector(0.5 * (low + high)) + 3.0 * size * side)
    camera.matrix_basis @= side.to_track_quat("Z", "Y").to_matrix().to_4x4()
    camera.parent, camera.matrix_parent_inverse = path, path.matrix_world.inverted()
    scene.camera = camera
    scene.world = scene.world or bpy.data.worlds.new("World")
    scene.world.color = (0.8, 0.8, 0.8)
    scene.display.shading.color_type = "SINGLE"
    scene.view_settings.view_transform = "Standard"
    return render(frames, CELL, "BLENDER_WORKBENCH")


def overlaid(first: Image.Image, last: Image.Image) -> Image.Image:
    """Both in one: gray where they are the same, red where the body is in the first alone, cyan where in the last."""
    one, other = first.convert("L"), last.convert("L")
    return Image.merge("RGB", (other, one, one))


def draw_seam(without: Baked, closed: Baked):
    ends = without.job.input.settings.frame_start, without.job.input.settings.frame_end
    rows = [
        Row(name, f"{1000 * baked.apart:.3g} mm apart", [*baked.pictures, overlaid(*baked.pictures)],
            [""] * 3)
        for name, baked in (("Without Loop", without), ("With Loop", closed))
    ]  # fmt: skip
    columns = [f"Frame {ends[0]}, the first", f"Frame {ends[1]}, the last", "Both: the first red, the last cyan"]
    about = "Its first and last frame, the same pose a step further on; the camera goes along"
    save(compose("A walk cycle where it begins again", about, columns, rows), IMAGES / "seam.png", small=True)


def draw_motion(job, without: np.ndarray, cycles: np.ndarray):
    """The point that swings the most, over two and a half cycles."""
    bake, to_bind = job.outcome.bake, job.outcome.character.to_bind
    surface = np.tensordot(bake.coordinates, bake.modes, 1) @ to_bind.T
    vertex = int(surface.std(axis=0).sum(axis=1).argmax())
    _, _, axes = np.linalg.svd(surface[:, vertex] - surface[:, vertex].mean(axis=0))
    swing = 1000.0 * bake.modes[:, vertex] @ to_bind.T @ axes[0]  # (r,): mm along the way that it swings most
    frames = np.arange(len(surface))
    times = np.concatenate([frames + turn * frames[-1] for turn in range(3)]) / job.input.settings.fps
    shown = times <= 2.5 * frames[-1] / job.input.settings.fps
    curves = {
        "with Loop, played on and on": np.tile(bake.coordinates, (3, 1)),
        "without Loop, played on and on": np.tile(without, (3, 1)),
        "without Loop, simulated on and on": np.concatenate(cycles[:3]),
    }
    curves = {name: (times[shown], (rows @ swing)[shown]) for name, rows in curves.items()}
    drawing, (panel,) = plots.figure(1, 3.2)
    drawing.set_size_inches(7.4, 3.2)
    plots.draw(panel, "The point that swings the most", curves, "s", "mm", marker="o", ms=2.5)
    styles = ((LOOP, "-", 2.4), (OPEN, "-", 1.4), (FAINT, "--", 1.4))
    for line, (color, style, width) in zip(panel.lines, styles, strict=True):
        line.set(color=color, linestyle=style, linewidth=width)
    for turn in (1, 2):
        panel.axvline(turn * frames[-1] / job.input.settings.fps, color=SEAM, linewidth=0.8)
    low, high = panel.get_ylim()
    panel.set_ylim(low, high + 0.45 * (high - low))  # room for the legend
    panel.legend(fontsize=8, loc="upper left")
    plots.save(drawing, IMAGES / "motion.svg")


def draw_passes(job, gaps: list[float]):
    """How the gap closes pass by pass."""
    watched = Watched(job.outcome.model, job.outcome.character, job.input.settings)
    loops.cycle(watched, job.computation.rig)
    closing = [max(pair) for pair in zip(watched.gaps[::2], watched.gaps[1::2], strict=True)]
    curves = {
        "with Loop": (range(1, len(closing) + 1), closing),
        "without Loop, simulated on and on": (range(1, len(gaps) + 1), gaps),
    }
    drawing, (panel,) = plots.figure(1, 3.2)
    drawing.set_size_inches(7.4, 3.2)
    plots.draw(panel, "Gap where the cycle begins again", curves, "passes", "body sizes", marker="o", ms=3)
    for line, color in zip(panel.lines, (LOOP, OPEN), strict=True):
        line.set_color(color)
    panel.axhline(loops.CLOSED, color=FAINT, linewidth=0.8, linestyle="--")
    panel.set_yscale("log")
    panel.legend(fontsize=8)
    plots.save(drawing, IMAGES / "passes.svg")
