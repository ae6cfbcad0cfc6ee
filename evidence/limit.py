# SPDX-License-Identifier: GPL-3.0-or-later
"""`make limit`: docs/limit.md and its curves, what the limits of the motion do in clips of ../shared, and cost."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from project import ROOT

from accuracy_shots import Shot, dynamic_morph_targets, quiet, read_shot  # isort: split

import bpy
import characters
import dynamorph
import numpy as np
import plots
from assets import require
from believable_bake import choose_clip
from bench import machine
from dynamic_morph_targets.core.geometry import diagonal
from dynamic_morph_targets.core.model.model import Model
from dynamic_morph_targets.core.motion import simulate
from dynamic_morph_targets.core.motion.simulate import build_for
from measured import measured_at
from performance_page import grid

PAGE, CURVES = ROOT / "docs/limit.md", "images/limit/curves_{}.svg"
CLIPS = {
    "zoo/Anglerfish.glb": "Out_Of_Water",
    "zoo/Blobfish.glb": "Out_Of_Water",
    "zoo/Husky.glb": "Gallop",
    "zoo/Cow.glb": "Death",
    "mh_male_53bones.blend": "gen_jump",
    "mh_chubby_53bones.blend": "cmu_131_02_walk",
}
RATE = 480  # steps a second at most: the finest, and its divisors below
SLOWER = (1, 2, 4, 8)  # so many times fewer steps: 480 to 60 a second where the frame rate divides them
LIKE, ROUNDS = 0.08, 5  # asked: how alike motions of different steps are; rounds in which steps are timed
COST = 1.3  # asked: of a step with limits that nobody comes near, over one without
PANELS = 3  # in a row
TRIED = (
    {}, {"stretch": 0.3}, {"stretch": 0.5}, {"edges_between": 100}, {"edges_between": 800},
)  # fmt: skip  # LimitConstants of the engine: as they are, then one changed at a time

PAGE_TEXT = """# The motion's limits, measured

This page shows why the skin of a character that is thrown about does not fly off, and what that costs. The motion of
soft tissue is limited in two ways ([theory](theory.md)): where a bone drives tissue faster than it can follow, the load
is held back, and tissue that still comes near the largest distance (**Max Displacement**) is pulled back. `make -C
evidence limit` measures it on characters made elsewhere, after one click, and writes this page.

The clips are chosen to be extreme. A fish that thrashes out of the water is held back in nearly every step and keeps a
small part of its unlimited motion, because all of it would carry the skin far away from the bones; a walk keeps nearly
everything. If your character moves less than you want, raise *Max Displacement* or choose another *Feel*.

{commit}; {machine}; one thread.

## The worst vertex

The plots show the offset of the vertex that goes farthest without limits, along its main axis, in percent of the body's
size.

{curves}
## How often they act, and what they cost

*Held back*: share of the steps in which the load of some bone is held back. *Pulled*: share of the steps in which
anything is pulled back. *Without*: microseconds a step without limits. The last two columns divide the time of a step
with limits by that of a step without: first in frames in which nothing is pulled (goal: {cost:g}), then in frames in
which every step pulls. Each frame counts with the fastest of {rounds} rounds, and the median over the frames is shown.

{costs}
## The constants

The table changes one constant of `LimitConstants` (motion_limit.hpp) at a time. It gives the share of the unlimited
motion that is kept (the projection of the limited motion onto it), the 99.9th percentile of the displacement in the
worst frame in percent of size, and the 0.1th percentile of the edges' lengths over those at rest in the bind pose, in
the worst frame. Motion capture should be kept, and displacements should stay below 5 %, edges above 0.6. A smaller
*stretch* takes most from gallops and jumps; a larger one keeps a little more, but lets edges be squeezed more. Fewer
*edges between* show on the anglerfish, whose skin gives way between few edges; more of them change a point or two.

{constants}
## The step

The same clip with steps that are 2, 4 and 8 times as long as the shortest: largest displacement and RMS motion of the
whole skin, over those with the shortest. Asked: within {like:.0%} of one. The differences in the rows without limits
come only from the time stepping.

{steps}"""


@dataclass(frozen=True)
class Played:
    """offsets (F, V, 3): of a shot from the targets' shapes, bind space, of the body's size."""

    offsets: np.ndarray

    @property
    def farthest(self) -> float:
        return float(np.linalg.norm(self.offsets, axis=2).max())

    @property
    def motion(self) -> float:
        return float(np.sqrt(((self.offsets - self.offsets.mean(axis=0)) ** 2).sum(axis=2).mean()))


def main() -> int:
    require("limit", CLIPS)
    dynamic_morph_targets.register()
    dynamorph.set_threads(1)
    panels, costs, steps, tried = [], [], [], []
    for asset, clip in CLIPS.items():
        with quiet():
            body, shot, model = opened(asset, clip)
        title = f"{Path(asset).stem.replace('_', ' ')}, {clip}"
        panels.append((title, curves(shot, model)))
        costs.append([title, *cost(shot, model)])
        tried.append((title, trades(shot, model)))
        with quiet():
            fine = finest(body, clip, shot)
        steps.append([title, *step_lengths(fine, model)])
        steps.append([f"{title}, without limits", *step_lengths(without_limits(fine), model)])
        print(f"limit: {title}", flush=True)
    PAGE.write_text(
        PAGE_TEXT.format(
            commit=measured_at(PAGE.name),
            machine=machine(),
            rounds=ROUNDS,
            cost=COST,
            like=LIKE,
            curves="\n".join(drawn(panels)),
            costs=grid(["", "held back", "pulled", "without", "not pulled, over that", "pulled, over that"], costs),
            constants=grid(["", *(title for title, _ in tried)], constants_table([cells for _, cells in tried])),
            steps=grid(["", "shortest, a second", *(f"{k} times as long" for k in SLOWER[1:])], steps),
        ).rstrip()
        + "\n",
        encoding="utf-8",
    )
    print(f"written to {PAGE.relative_to(ROOT)}")
    return 0


# Shots ----------------------------------------------------------------------------------------------------------------


def opened(asset: str, clip: str) -> tuple[object, Shot, Model]:
    """The character after Add Soft Skin and Build, the liveliest part of the clip, and its model."""
    characters.open_file(characters.ASSETS / asset)
    body = characters.largest_skinned()
    (action,) = [each.name for each in bpy.data.actions if each.name.split("|")[-1] == clip]
    choose_clip(characters.armature_of(body), action)
    bpy.context.view_layer.objects.active = body
    bpy.ops.dynamorph.add_soft_skin()
    bpy.ops.dynamorph.build()  # which sets the stiffness that gives the Bounce
    shot = read_shot(body, clip)
    return body, shot, build_for(shot.character, None, None)


def finest(body, clip: str, shot: Shot) -> Shot:
    """The same shot in at most RATE steps a second, as many a frame as SLOWER divides."""
    most = max(SLOWER)
    body.dynamorph.simulation.substeps = most * max(int(RATE / shot.settings.fps) // most, 1)
    return read_shot(body, clip)


def without_limits(shot: Shot) -> Shot:
    return replace(shot, settings=replace(shot.settings, max_displacement=0.0, max_thickness=0.0))


def played(shot: Shot, model: Model) -> Played:
    moving = simulate.Shot(model, shot.character, shot.settings)
    moving.play(shot.rig)
    bake, _ = moving.bake(exact=True)
    to_bind = shot.character.to_bind.T
    offsets = np.tensordot(bake.coordinates - bake.static, bake.modes @ to_bind, 1)
    return Played(offsets / diagonal(shot.character.vertices @ to_bind))


def stepped(shot: Shot, model: Model) -> list[dict]:
    """What each frame's steps report."""
    frames = simulate.simulate(model, shot.character, shot.rig, shot.settings)
    return [frame.steps for frame in frames if frame.steps.steps]


# Figures --------------------------------------------------------------------------------------------------------------


def curves(shot: Shot, model: Model) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    free, limited = played(without_limits(shot), model), played(shot, model)
    worst = int(np.linalg.norm(free.offsets, axis=2).max(axis=0).argmax())
    path = free.offsets[:, worst] - free.offsets[:, worst].mean(axis=0)
    axis = np.linalg.svd(path, full_matrices=False)[2][0]
    frames = shot.settings.frames
    return {
        "without limits": (frames, 100.0 * free.offsets[:, worst] @ axis),
        "as it is": (frames, 100.0 * limited.offsets[:, worst] @ axis),
    }


def drawn(panels: list) -> Iterator[str]:
    """Draws so many panels in a row; the lines that show them."""
    for row, first in enumerate(range(0, len(panels), PANELS), 1):
        part = panels[first : first + PANELS]
        drawing, axes = plots.figure(len(part), 2.6)
        for panel, (title, lines) in zip(axes, part, strict=True):
            plots.draw(panel, title, lines, "frame", "% of size")
        plots.save(drawing, PAGE.parent / CURVES.format(row))
        yield f"![{part[0][0]} to {part[-1][0]}]({CURVES.format(row)})\n"


def cost(shot: Shot, model: Model) -> list[str]:
    free, limited = [], []
    for _ in range(ROUNDS):
        free.append(microseconds(stepped(without_limits(shot), model)))
        reports = stepped(shot, model)
        limited.append(microseconds(reports))
    without = np.min(free, axis=0)
    ratios = np.min(limited, axis=0) / without
    pulled = np.array([each.pulled / each.steps for each in reports])
    held = np.mean([each.excess > 0.4 for each in reports])
    parts = [f"{np.median(ratios[which]):.2f}" if which.any() else "-" for which in (pulled == 0, pulled == 1)]
    return [f"{held:.0%}", f"{pulled.mean():.0%}", f"{np.median(without):.0f} µs", *parts]


def microseconds(reports: list[dict]) -> list[float]:
    return [1e6 * each.seconds / each.steps for each in reports]


def trades(shot: Shot, model: Model) -> list[str]:
    """For each of TRIED: kept, displacement, edges."""
    free = played(without_limits(shot), model).offsets
    character = shot.character
    rest = character.vertices @ character.to_bind.T
    ends = np.unique(np.sort(character.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    before = np.linalg.norm(rest[ends[:, 0]] - rest[ends[:, 1]], axis=1)
    ends, before = ends[before > 1e-4 * diagonal(rest)], before[before > 1e-4 * diagonal(rest)]
    cells = []
    for constants in TRIED:
        with limited_by(constants):
            offsets = played(shot, model).offsets
        kept = (offsets * free).sum() / (free**2).sum()
        far = max(np.quantile(np.linalg.norm(frame, axis=1), 0.999) for frame in offsets)
        moved = (rest + offset * diagonal(rest) for offset in offsets)
        edges = min(
            np.quantile(np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1) / before, 0.001)
            for points in moved
        )
        cells.append(f"{kept:.2f}, {100.0 * far:.1f} %, {edges:.2f}")
    return cells


@contextmanager
def limited_by(constants: dict) -> Iterator[None]:
    """Limits with other constants than the engine's own."""
    own = dynamorph.MotionLimit
    dynamorph.MotionLimit = partial(own, **constants)
    yield
    dynamorph.MotionLimit = own


def constants_table(columns: list[list[str]]) -> list[list[str]]:
    names = [", ".join(f"{name.replace('_', ' ')} {value:g}" for name, value in each.items()) for each in TRIED]
    return [[name or "as it is", *cells] for name, *cells in zip(names, *columns, strict=True)]


def step_lengths(fine: Shot, model: Model) -> list[str]:
    """Largest displacement and RMS motion with longer steps, over those with the shortest; bold: not alike."""
    best = played(fine, model)
    cells = []
    for times in SLOWER[1:]:
        settings = replace(fine.settings, substeps=fine.settings.substeps // times)
        coarse = played(replace(fine, settings=settings, rig=fine.rig[::times]), model)
        ratios = coarse.farthest / best.farthest, coarse.motion / best.motion
        cells.append(", ".join(f"{r:.2f}" if abs(r - 1) <= LIKE else f"**{r:.2f}**" for r in ratios))
    return [f"{fine.settings.fps * fine.settings.substeps:.0f}", *cells]


if __name__ == "__main__":
    sys.exit(main())
