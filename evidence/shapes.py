# SPDX-License-Identifier: GPL-3.0-or-later
"""`make shapes`: docs/shapes.md and its pictures: targets that sculpt themselves, a flex without motion, stiffness that
is keyed, and a hand that pulls a cheek.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import fresh_blender  # noqa: F401
from project import ROOT

import bpy
import claims
import dynamic_morph_targets
import numpy as np
import shapes_cheek
import shapes_joints
import subjects
from bench import machine
from contact_sheet import quiet
from dynamic_morph_targets.core.geometry import smooth_step, turned, vertex_areas, vertex_normals
from dynamic_morph_targets.core.result.compare import Run, Statics
from dynamic_morph_targets.scene.character import extract
from dynamic_morph_targets.scene.motion import rig_motion, run_settings
from heat import beside
from measured import measured_at
from performance_page import grid
from recipes import pictures, steps
from shapes_cheek import over_frames
from shapes_posed import save
from subjects import Shot

PAGE, PICTURES = ROOT / "docs/shapes.md", "images/shapes/{}"
REDUCED, FULL = ({"method": "DYNAMIC", "solver": solver} for solver in ("REDUCED", "FULL"))


PAGE_TEXT = """# Shapes: targets that sculpt themselves and answer any channel

A target is a shape with a material. This page measures where targets do more than follow a pose and a sculptor: physics
shapes a bent joint, a muscle is flexed
and no bone moves, a material changes during a shot, a hand pulls the skin. `make -C evidence shapes` measures it and
writes this page.

{commit}; {machine}.

{sections}"""


def main() -> int:
    commit = measured_at(PAGE.name)
    dynamic_morph_targets.register()
    sections = []
    for section in (shape_section, flex_section, stiffness_section, cheek_section):
        sections.append(section())
        print(f"shapes: {section.__name__}", flush=True)
    text = PAGE_TEXT.format(commit=commit, machine=machine(), sections="\n".join(filter(None, sections)))
    PAGE.write_text(text.rstrip() + "\n", encoding="utf-8")
    print(f"written to {PAGE.relative_to(ROOT)}")
    return 0


def picture(name: str) -> Path:
    return PAGE.parent / PICTURES.format(name)


def read(body: bpy.types.Object) -> Shot:
    """The scene's frames of a body that is set up; nothing asks for its subject."""
    settings = run_settings.simulation_settings(body, bpy.context.scene)
    rig = rig_motion.sample_rig(body, settings.frame_start, settings.frame_end, settings.substeps)
    return Shot(subjects.SHOULDER, extract.character(body), rig, settings)


def bake(shot: Shot, changes: dict[str, str]) -> Run:
    return shot.runs({"": changes})[""]


def in_meters(shot: Shot, displacement: np.ndarray) -> np.ndarray:
    """Local displacements (..., V, 3) in meters, along the axes of bind space."""
    return displacement @ shot.character.to_bind.T


# Shape by Physics -----------------------------------------------------------------------------------------------------


def shape_section() -> str:
    return shapes_joints.section(picture)


# A flex without motion ------------------------------------------------------------------------------------------------

ASKED = 8.0  # times as stiff
PRESSURE = 800.0  # newtons on a square meter, as the wind of the bulging cylinder
LOOK = (22, 45)  # frames of the recipe in which the biceps is relaxed, and tense and at rest
FLEX_TEXT = """## A flex without motion

The arm of the recipe [Flex without moving](recipes/flex.md): no bone moves, and the slider *Tension* goes from 0 to 1.
The biceps bulges by {bulge}. At rest, the skin is off what was sculpted by {off} of that. It is {stiffness:.1f} times
as stiff; asked: {asked:g}.

![The arm, relaxed and tense](images/shapes/flex.jpg)

Beside it are the two limbs of the sample scenes that stand for those of the thesis. They are flexed by their elbow, so
their targets are placed by bones. What differs is that here the bones stand still: the same pose has both shapes and
both materials, and the slider says how much of each.

- *Turn*: of the joint that turns most, from relaxed to flexed.
- *Bulge*: what was sculpted, at the vertex that it moves most. *Off*: the farthest that the skin at rest is from it.
- *Stiffness*: of the flexed target over that of the neutral one.
- *Give*: how far the muscle at rest yields to a push of {pressure:g} N on a square meter, unreduced, and the ratio.
- *Shaken*: how far the same shake moves the muscle off its shape, and the ratio.

The ratios of a push and of a shake are not those of the stiffness alone. The soft tissue around a muscle gives too, a
bulged muscle has another shape than a relaxed one, and a shake stirs the tissue that it is in tune with. In the
shoulder, two sets of targets meet and divide the tissue between them, so that it is off both by a little.

{table}"""


@dataclass(frozen=True)
class Flex:
    """relaxed, flexed: frames at rest; shaken: first and last frame of the same shake, relaxed and flexed; muscle:
    which vertices (V,) of a skin at rest."""

    title: str
    open: Callable[[], Shot]
    relaxed: int
    flexed: int
    target: str
    shaken: tuple[tuple[int, int], tuple[int, int]]
    muscle: Callable[[np.ndarray], np.ndarray]


def biceps(rest: np.ndarray) -> np.ndarray:
    return claims.between(rest, *claims.BICEPS)


def upper_side(rest: np.ndarray) -> np.ndarray:
    """Of the cylinder: where its wind blows."""
    return (np.abs(rest[:, 0] - 0.19) < 0.13) & (rest[:, 2] > 0.0)


def flexed_arm() -> Shot:
    """The recipe's, which is pictured on the way."""
    with quiet():
        body, _ = steps.cook("flex")
        recipe = steps.RECIPES["flex"]
        moved = pictures.motion(body)
        red, _ = pictures.farthest(moved)
        views = [pictures.view(recipe, frame, moved, red) for frame in LOOK]
    titles = [f"frame {frame}: {state}" for frame, state in zip(LOOK, ("relaxed", "tense"), strict=True)]
    legend = f"from plain skinning: gray none, red {1000 * red:.0f} mm"
    save(beside(views, titles, legend), picture("flex.jpg"))
    return read(body)


FLEXES = (
    Flex("Flex without moving", flexed_arm, *LOOK, "Tension", ((10, 23), (46, 59)), biceps),
    Flex("Bulging cylinder", lambda: subjects.open_shot(subjects.CYLINDER), 135, 65, "Flexed", ((136, 150), (66, 80)),
         upper_side),
    Flex("Shoulder", lambda: subjects.open_shot(subjects.SHOULDER), 233, 175, "Folded", ((234, 248), (176, 190)),
         biceps),
)  # fmt: skip


def flex_section() -> str:
    found = [measured_flex(flex) for flex in FLEXES]
    head = ("", "turn", "bulge", "off", f"Stiffness, times (asked: {ASKED:g})", "give, relaxed", "flexed", "ratio",
            "shaken, relaxed", "flexed", "ratio")  # fmt: skip
    rows = [
        [each["title"], f"{each['turn']:.0f}°", mm(each["bulge"]), percent(each["off"] / each["bulge"]),
         f"{each['stiffness']:.1f}", *ratio(each["give"]), *ratio(each["shaken"])]
        for each in found
    ]  # fmt: skip
    first = found[0]
    return FLEX_TEXT.format(
        bulge=mm(first["bulge"]),
        off=percent(first["off"] / first["bulge"]),
        stiffness=first["stiffness"],
        asked=ASKED,
        pressure=PRESSURE,
        table=grid(head, rows),
    )


def measured_flex(flex: Flex) -> dict:
    shot = flex.open()
    muscle = flex.muscle(shot.rest)
    run, k = bake(shot, REDUCED), shot.index(flex.flexed)
    local = shot.character.skeleton.local_transforms(shot.frames.pose[[shot.index(flex.relaxed), k]])
    sculpted = in_meters(shot, run.static[k])
    stiffness = {target.name: target.material.stiffness for target in shot.character.targets}
    return {
        "title": flex.title,
        "turn": np.degrees(turned(*local)).max(),
        "bulge": farthest(sculpted[muscle]),
        "off": farthest(in_meters(shot, run.motion[k]) - sculpted),
        "stiffness": stiffness[flex.target] / stiffness[shot.character.targets[0].name],
        "give": [give(shot, frame, muscle) for frame in (flex.relaxed, flex.flexed)],
        "shaken": [claims.swing(shot, run, *frames, muscle) for frames in flex.shaken],
    }


def give(shot: Shot, frame: int, patch: np.ndarray) -> float:
    """How far a patch (V,) at rest in a frame's pose yields to a pressure, along it, in the mean."""
    part = shot.part(frame - 1, frame)
    run, k = bake(part, FULL), part.index(frame)
    statics, triangles = Statics(run.model, run.character), shot.character.triangles
    weights, bones = run.bake.weights[k], part.bones[k]
    before = part.world(statics.surface(weights), frame)
    areas = vertex_areas(before, triangles) * patch
    inward = -vertex_normals(before, triangles)[patch].sum(axis=0)
    inward /= np.linalg.norm(inward)
    moved = part.world(statics.surface(weights, bones, PRESSURE * areas[:, None] * inward), frame) - before
    return float(areas @ (moved @ inward) / areas.sum())


# Stiffness that is keyed ----------------------------------------------------------------------------------------------

SOFT, FIRM = 15e3, 150e3  # Pa, of the cylinder's relaxed and of its flexed limb
CHANGES = (48, 72)  # frames between which the key goes from the one to the other
LAST, CALM = 120, 40  # the last frame, and how many frames at either end are compared
SHAKE, HERTZ, GROWN = 0.015, 4.0, 18  # of the stand, up and down: meters, and the frame at which it is as much
NEAR = 0.01  # of the largest displacement: what is less apart is alike
STIFFNESS_TEXT = """## Stiffness that is keyed

The straight limb of the sample scene *Bulging cylinder* is shaken up and down by {shake:g} mm, {hertz:g} times a
second. Its neutral target's **Stiffness** is {soft:g} kPa until frame {begins}, and keyed to {firm:g} kPa at frame
{ends}. The same shot is baked twice more, with either stiffness from beginning to end; all in Full Quality.

![How far the limb swings, soft, firm and keyed](images/shapes/stiffness.svg)

The keyed limb begins as the soft one and ends as the firm one: from frame {alike} on, no vertex is farther from it than
{near:.0%} of its largest displacement. *Largest difference*: of any vertex in these frames, over the largest
displacement there of the limb that it is compared with.

{table}"""


def stiffness_section() -> str:
    limb = shaken_limb()
    found = {}
    for name, keys in (
        ("soft", ((1, SOFT),)),
        ("firm", ((1, FIRM),)),
        ("keyed", ((1, SOFT), (CHANGES[0], SOFT), (CHANGES[1], FIRM))),
    ):
        with quiet():
            shot = read(with_stiffness(limb, keys)).every_step()
        found[name] = in_meters(shot, bake(shot, FULL).motion)
    times = 1.0 + shot.settings.frames / ((len(shot.settings.frames) - 1) / (LAST - 1))  # in frames of the scene
    draw_stiffness(times, found)
    ends = {"soft": (1, CALM), "firm": (LAST + 1 - CALM, LAST)}
    rows = []
    for name, (first, last) in ends.items():
        there = (times >= first) & (times <= last)
        most, apart = farthest(found[name][there]), farthest(found["keyed"][there] - found[name][there])
        rows.append([f"{name}, frames {first} to {last}", mm(most), percent(apart / most)])
    apart = np.linalg.norm(found["keyed"] - found["firm"], axis=2).max(axis=1) > NEAR * farthest(found["firm"])
    return STIFFNESS_TEXT.format(
        shake=1000 * SHAKE,
        hertz=HERTZ,
        soft=SOFT / 1000,
        firm=FIRM / 1000,
        begins=CHANGES[0],
        ends=CHANGES[1],
        alike=int(times[apart][-1]) + 1,
        near=NEAR,
        table=grid(("compared with", "largest displacement", "largest difference"), rows),
    )


def shaken_limb() -> bpy.types.Object:
    """The cylinder, straight, without wind, on a stand that begins to go up and down."""
    with quiet():
        bpy.ops.wm.open_mainfile(filepath=str(subjects.CYLINDER.path))
        bpy.data.objects.remove(bpy.data.objects["Push"])
        limb, scene = bpy.data.objects[subjects.CYLINDER.object], bpy.context.scene
        rig = limb.find_armature()
        rig.animation_data_clear()
        for bone in rig.pose.bones:
            bone.matrix_basis.identity()
        height = rig.location.z
        scene.frame_start, scene.frame_end = 1, LAST
        for frame in np.arange(1.0, LAST + 2.0, 0.25):  # keys that are near make a sine; it goes on after the shot
            swing = np.sin(2 * np.pi * HERTZ * (frame - 1) / scene.render.fps)
            rig.location.z = height + SHAKE * swing * smooth_step(frame, 1, GROWN)
            rig.keyframe_insert("location", index=2, frame=frame)
        scene.frame_set(1)
    return limb


def with_stiffness(limb: bpy.types.Object, keys: Sequence[tuple[int, float]]) -> bpy.types.Object:
    """Key the neutral target's stiffness with (frame, Pa), as pressing I does."""
    limb.animation_data_clear()
    for frame, value in keys:
        limb.dynamorph.targets[0].stiffness = value
        limb.dynamorph.targets[0].keyframe_insert("stiffness", frame=frame)
    bpy.context.scene.frame_set(1)
    return limb


def draw_stiffness(times: np.ndarray, found: dict[str, np.ndarray]) -> None:
    """Of the vertex that swings farthest where the limb is soft, up and down."""
    vertex = int(np.abs(found["soft"][..., 2]).max(axis=0).argmax())
    lines = {name: (times, 1000.0 * motion[:, vertex, 2]) for name, motion in found.items()}
    over_frames(picture("stiffness.svg"), "Displacement up", lines, CHANGES, "gray: the stiffness changes")


# A hand that pulls a cheek --------------------------------------------------------------------------------------------

CHEEK_TEXT = """## A hand that pulls a cheek

A [grip](panels/grips.md) holds a cheek of Herbert, of the sample scenes. The small ball is the hand: it touches the
cheek at frame {takes}, pulls until frame {stops}, and lets go after frame {holds}, by keys of **Strength**: {grasp:g},
then 0. The skull is held by the map *Firmness*, and the cheek is soft: {stiffness:g} kPa, a map of {loose:g}. *Max
Displacement* is off, and the quality is Full.

![Frames of the pull](images/shapes/cheek.jpg)

The hand goes {hand}, and the cheek comes along by {pulled}: the skin around holds it back. Let go, it swings {over} to
the other side, and rings at {hertz:.1f} Hz. After {seconds:.1f} s it stays within {rings:.0%} of the pull.

![How far hand and cheek are along the pull](images/shapes/cheek.svg)
"""


def cheek_section() -> str:
    with quiet():
        found = shapes_cheek.measured(picture("cheek.jpg"), picture("cheek.svg"))
    return CHEEK_TEXT.format(
        takes=shapes_cheek.TAKES,
        stops=shapes_cheek.STOPS,
        holds=shapes_cheek.HOLDS,
        grasp=shapes_cheek.GRASP,
        stiffness=shapes_cheek.TISSUE["stiffness"] / 1000.0,
        loose=shapes_cheek.LOOSE,
        rings=shapes_cheek.RINGS,
        hertz=found["hertz"],
        seconds=found["seconds"],
        **{name: mm(found[name]) for name in ("hand", "pulled", "over")},
    )


# Words ----------------------------------------------------------------------------------------------------------------


def farthest(motion: np.ndarray) -> float:
    """The longest of vectors (..., 3)."""
    return float(np.linalg.norm(motion, axis=-1).max())


def mm(meters: float) -> str:
    return f"{1000.0 * meters:.1f} mm"


def percent(part: float) -> str:
    """Two digits, and no more than a thousandth."""
    return f"{100.0 * part:.2g}%" if part >= 1e-5 else "less than 0.001%"


def ratio(pair: Sequence[float]) -> list[str]:
    """Both, and how many times the first is the second."""
    return [*map(mm, pair), f"{pair[0] / pair[1]:.1f}"]


if __name__ == "__main__":
    sys.exit(main())
