# SPDX-License-Identifier: GPL-3.0-or-later
"""`make demo`: bake the bulging cylinder, save it, and picture it beside plain skinning and a single material.

Runs what the Bake button runs. Writes to out/: bulging_cylinder_baked.blend, bulging_cylinder.png and
bulging_cylinder.webp, a loop.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

try:
    import bpy
    import dynamic_morph_targets
    import numpy as np
    from contact_sheet import MARGIN, Row, caption, compose, only_python, quiet, render, save
    from dynamic_morph_targets.cli import record
    from dynamic_morph_targets.core import engine
    from dynamic_morph_targets.run.bake import batch
    from dynamic_morph_targets.run.bake.job import Job
    from dynamic_morph_targets.write.bake.writer import free
    from heat import beside, draw_legend, paint, save_loop
    from measures import own_motion
    from PIL import Image, ImageDraw
    from stage import paint_for_workbench
except ImportError as error:
    sys.exit(f"demo: {error}. `make demo` installs and builds everything first; see README.md for doing it by hand.")

ROOT = Path(__file__).resolve().parents[1]
SCENE = ROOT / "sample_blends" / "bulging_cylinder.blend"
BAKED, SHEET, LOOP = "bulging_cylinder_baked.blend", "bulging_cylinder.png", "bulging_cylinder.webp"

LIMB = "Limb"
RED = 0.02  # meters of the tissue's own motion
CELL, PANE = (340, 263), (400, 310)


@dataclass(frozen=True)
class Event:
    """What happens to the limb in a pose, and in which frames, first and last, it moves most."""

    pose: str
    name: str
    frames: tuple[int, int]


EVENTS = (
    Event("flexed", "pushed", (46, 56)),
    Event("relaxed", "pushed", (114, 124)),
    Event("flexed", "shaken", (66, 80)),
    Event("relaxed", "shaken", (136, 150)),
)
# Of the loop, in each pose: a push, and a shake until the relaxed limb is calm. The flexed one then opens, so its last
# frame is repeated.
LOOPED = {
    "flexed": [*range(45, 61), *range(64, 86), *[85] * 5],
    "relaxed": [*range(113, 129), *range(134, 161)],
}


@dataclass(frozen=True)
class Variant:
    """A way to simulate the limb, and how far that moves its skin from where bones and targets put it (F, V), meters,
    from frame 1 on."""

    job: Job
    motion: np.ndarray

    def swing(self, event: Event) -> float:
        """Millimeters, at most."""
        first, last = event.frames
        return 1000 * float(self.motion[first - 1 : last].max())


def run(out: Path, draft: bool) -> None:
    print(f"opening {shown(SCENE)}")
    with quiet():
        bpy.ops.wm.open_mainfile(filepath=str(SCENE))
    bpy.context.preferences.filepaths.save_version = 0  # no backup beside the baked file
    limb = bpy.data.objects[LIMB]

    print("baking dynamic morph targets")
    targets = bake(limb)
    out.mkdir(parents=True, exist_ok=True)
    with quiet():
        bpy.ops.wm.save_as_mainfile(filepath=str(out / BAKED), copy=True, compress=True)
    print(f"saved {shown(out / BAKED)}")
    began = time.perf_counter()
    show_colors(limb)
    frames = [event.frames[0] + peak(targets, event) for event in EVENTS]
    rows = [row("Dynamic morph targets", "hard when flexed, soft when relaxed", limb, frames, draft, targets.motion)]
    film(limb, targets, out / LOOP)
    print(f"saved {shown(out / LOOP)}")
    rendering = time.perf_counter() - began

    print("baking a single material")
    limb.dynamorph.model.method = "SINGLE"
    single = bake(limb)
    began = time.perf_counter()
    rows.insert(0, row("Single material", "as soft when flexed as when relaxed", limb, frames, draft, single.motion))
    free(limb)
    still = np.zeros_like(single.motion)
    rows.insert(0, row("Plain skinning", "the skin only follows the bones", limb, frames, draft, still))
    rendering += time.perf_counter() - began

    picture(rows, frames, out / SHEET)
    print(f"saved {shown(out / SHEET)} (rendered in {rendering:.0f} s)")
    print_table({"single material": single, "targets": targets})
    print(f"\n{in_short(single, targets)}")


def bake(limb: bpy.types.Object) -> Variant:
    job = Job(limb, goal="BAKE")
    batch.run(job, record.ProgressPrinter())
    for warning in job.warnings:
        print(f"{job.name}: warning: {warning}")
    return Variant(job, own_motion(job.outcome.character, job.outcome.bake))


def peak(variant: Variant, event: Event) -> int:
    """How many frames after the event's first one the tissue moves most."""
    first, last = event.frames
    return int(variant.motion[first - 1 : last].max(axis=1).argmax())


# Pictures -------------------------------------------------------------------------------------------------------------


def show_colors(limb: bpy.types.Object) -> None:
    """Both engines show the colors of the motion, as they are in the legend."""
    scene = bpy.context.scene
    scene.view_settings.view_transform, scene.view_settings.look = "Standard", "None"
    scene.display.shading.show_shadows = False  # they have teeth on skin that bulges
    scene.display.render_aa = "5"  # takes half the time of 8
    paint_for_workbench()
    nodes = limb.active_material.node_tree.nodes
    next(node for node in nodes if node.type == "VERTEX_COLOR").layer_name = "Heat"


def row(name: str, about: str, limb: bpy.types.Object, frames: Sequence[int], draft: bool, motion: np.ndarray) -> Row:
    """Render the scene as it is now. Cycles looks better, Workbench is five times as fast."""
    print(f"rendering {name.lower()}", flush=True)
    engine = "BLENDER_WORKBENCH" if draft else "CYCLES"
    pictures = [colored(limb, motion, frame, CELL, engine) for frame in frames]
    for picture, frame in zip(pictures, frames, strict=True):
        caption(picture, f"moves {1000 * motion[frame - 1].max():.1f} mm")
    return Row(name, about, pictures, [""] * len(frames))


def colored(limb: bpy.types.Object, motion: np.ndarray, frame: int, size: tuple[int, int], engine: str) -> Image.Image:
    """The scene at a frame. The limb's bands are darker, so that the eye can follow the skin."""
    bands = np.array([each.color[0] for each in limb.data.color_attributes["Skin"].data])
    paint(limb.data, motion[frame - 1] / RED, shade=np.interp(bands, (bands.min(), bands.max()), (0.7, 1.0)))
    return render([frame], size, engine)[0]


def film(limb: bpy.types.Object, targets: Variant, path: Path) -> None:
    """The flexed limb beside the relaxed one, pushed and shaken alike, as a loop."""
    print("filming the loop", flush=True)
    panes = {}
    for pose, frames in LOOPED.items():
        seen = {frame: colored(limb, targets.motion, frame, PANE, "BLENDER_WORKBENCH") for frame in set(frames)}
        most = max(1000 * float(targets.motion[frame - 1].max()) for frame in frames)
        panes[f"{pose.upper()}: moves {most:.1f} mm at most"] = [seen[frame] for frame in frames]
    save_loop([beside(shown, list(panes), legend()) for shown in zip(*panes.values(), strict=True)], path)


def legend() -> str:
    return f"the soft tissue's own motion: gray none, red {1000 * RED:.0f} mm or more"


def picture(rows: Sequence[Row], frames: Sequence[int], path: Path) -> None:
    """The contact sheet of all methods."""
    columns = [f"{event.pose.upper()} and {event.name} (frame {k})" for event, k in zip(EVENTS, frames, strict=True)]
    sheet = compose("One soft limb, the same push and the same shake in two poses", "", columns, rows)
    draw_legend(ImageDraw.Draw(sheet), MARGIN, MARGIN + 38, legend())
    save(sheet, path)


# Figures --------------------------------------------------------------------------------------------------------------


def in_short(single: Variant, targets: Variant) -> str:
    """What the pictures show, in words."""
    push = {event.pose: event for event in EVENTS if event.name == "pushed"}
    soft, hard, same = targets.swing(push["relaxed"]), targets.swing(push["flexed"]), single.swing(push["flexed"])
    return (
        f"In short: the same push moves the relaxed limb by {soft:.1f} mm and the flexed one by {hard:.1f} mm, "
        f"because the target 'Flexed' is stiffer. With a single material, the flexed limb moves by {same:.1f} mm."
    )


def print_table(variants: dict[str, Variant]) -> None:
    """One column for each variant, every figure measured in this run."""
    made = {name: variant.job.outcome.model.summary for name, variant in variants.items()}
    lines = [(label, [str(getattr(made[name], key)) for name in variants]) for label, key in
             (("degrees of freedom", "dofs"), ("modes", "modes"), ("targets", "targets"))]  # fmt: skip
    for event in EVENTS:
        moved = [f"{variant.swing(event):.1f} mm" for variant in variants.values()]
        lines.append((f"moved by, {event.name} {event.pose}", moved))
    speeds = [f"{variant.job.outcome.report['steps_per_second']:.0f}" for variant in variants.values()]
    lines.append(("steps per second", speeds))
    stages = {name: {**made[name].seconds, **variant.job.progress.seconds} for name, variant in variants.items()}
    for name in variants:
        del stages[name]["build"]  # its own stages are listed
    for stage in next(reversed(stages.values())):
        lines.append((stage, [f"{stages[name].get(stage, 0.0):.2f} s" for name in variants]))
    lines.append(
        ("build and bake, in all", [f"{sum(each.job.progress.seconds.values()):.2f} s" for each in variants.values()])
    )

    settings = next(iter(variants.values())).job.input.settings
    print(f"\n{len(settings.frames)} frames, {settings.substeps} substeps each")
    print(f"{'':<26}" + "".join(f"{name:>18}" for name in variants))
    for label, values in lines:
        print(f"{label:<26}" + "".join(f"{value:>18}" for value in values))


def shown(path: Path) -> Path:
    return path.relative_to(ROOT) if path.is_relative_to(ROOT) else path


def main() -> int:
    parser = argparse.ArgumentParser(description="Bake the bulging cylinder and compare it with simpler methods.")
    parser.add_argument("--draft", action="store_true", help="render with Workbench: faster, plainer")
    parser.add_argument("--out", type=Path, default=ROOT / "out", help="the folder to write to")
    args = parser.parse_args()
    dynamic_morph_targets.register()
    try:
        with only_python():
            run(args.out.resolve(), args.draft)
    except engine.expected_errors() as error:
        print(f"demo: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
