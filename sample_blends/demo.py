# SPDX-License-Identifier: GPL-3.0-or-later
"""`make demo`: bake the bulging cylinder, save it, and picture it beside plain skinning and a single material.

Runs what the Bake button runs. Writes out/bulging_cylinder_baked.blend and out/bulging_cylinder.png.
"""

from __future__ import annotations

import argparse
import sys
import time
import traceback
from pathlib import Path

try:
    import bpy
    import dynamic_morph_targets
    import numpy as np
    from contact_sheet import Row, compose, only_python, quiet, render, save
    from dynamic_morph_targets.__main__ import leave
    from dynamic_morph_targets.cli import record
    from dynamic_morph_targets.core import engine
    from dynamic_morph_targets.run import batch, job
    from dynamic_morph_targets.write.bake.writer import free
    from measures import static_shapes
except ImportError as error:
    sys.exit(f"demo: {error}. `make demo` installs and builds everything first; see README.md for doing it by hand.")

ROOT = Path(__file__).resolve().parents[1]
SCENE = ROOT / "sample_blends" / "bulging_cylinder.blend"
BAKED = "bulging_cylinder_baked.blend"
SHEET = "bulging_cylinder.png"

LIMB = "Limb"
FRAMES = {
    16: "bent back",
    32: "half bent",
    44: "flexed",
    55: "pushed flexed",
    91: "just stopped",
    123: "pushed straight",
}
SWINGS = {
    "pushed flexed": (46, 56),
    "pushed straight": (114, 124),
    "shaken flexed": (66, 80),
    "shaken straight": (136, 150),
}
CELL = (264, 204)


def run(out: Path, draft: bool) -> None:
    print(f"opening {shown(SCENE)}")
    with quiet():
        bpy.ops.wm.open_mainfile(filepath=str(SCENE))
    bpy.context.preferences.filepaths.save_version = 0  # no backup beside the baked file
    limb = bpy.data.objects[LIMB]

    print("baking dynamic morph targets")
    dmt = bake(job.Job(limb, goal="BAKE"))
    out.mkdir(exist_ok=True)
    with quiet():
        bpy.ops.wm.save_as_mainfile(filepath=str(out / BAKED), copy=True, compress=True)
    print(f"saved {shown(out / BAKED)}")
    began = time.perf_counter()
    rows = [row("Dynamic morph targets", "shape and stiffness follow the pose", draft, dmt)]
    rendering = time.perf_counter() - began

    print("baking a single material")
    limb.dynamorph.model.method = "SINGLE"
    single = bake(job.Job(limb, goal="BAKE"))
    began = time.perf_counter()
    rows.insert(0, row("Single material", "the neutral target alone: the same softness in every pose", draft, single))
    free(limb)
    rows.insert(0, row("Plain skinning", "no simulation", draft))
    rendering += time.perf_counter() - began

    columns = [f"{frame}: {event}" for frame, event in FRAMES.items()]
    sheet = compose("Bulging cylinder", "The same frames; under the pictures, the targets' weights", columns, rows)
    save(sheet, out / SHEET)
    print(f"saved {shown(out / SHEET)} (rendered in {rendering:.0f} s)")
    print_table({"single material": single, "DMT": dmt})


def bake(job: job.Job) -> job.Job:
    batch.run(job, record.ProgressPrinter())
    for warning in job.warnings:
        print(f"{job.name}: warning: {warning}")
    return job


def row(name: str, about: str, draft: bool, job: job.Job | None = None) -> Row:
    """Render the scene as it is now. Cycles looks better, Workbench is five times as fast."""
    print(f"rendering {name.lower()}", flush=True)
    pictures = render(list(FRAMES), CELL, "BLENDER_WORKBENCH" if draft else "CYCLES")
    return Row(name, about, pictures, [weights_at(job, frame) for frame in FRAMES])


def weights_at(job: job.Job | None, frame: int) -> str:
    if job is None:
        return ""
    weights = job.outcome.bake.weights[frame - job.input.settings.frame_start]
    return ", ".join(
        f"{name} {w:.2f}" for name, w in zip(job.outcome.bake.target_names, weights, strict=True) if w > 0.005
    )


def swing(job: job.Job, first: int, last: int) -> float:
    """How far the skin leaves the pose's own static shape between two frames, at most; meters."""
    apart = 0.0
    for k in range(first - job.input.settings.frame_start, last - job.input.settings.frame_start + 1):
        static = static_shapes(job.outcome.character, job.outcome.bake.weights[k])
        apart = max(apart, np.linalg.norm(job.outcome.bake.displacement(k) - static, axis=1).max())
    return float(apart)


def print_table(variants: dict[str, job.Job]) -> None:
    """One column for each variant, every figure measured in this run."""
    made = {name: job.outcome.model.summary for name, job in variants.items()}
    lines = [(label, [str(getattr(made[name], key)) for name in variants]) for label, key in
             (("DOF", "dofs"), ("modes", "modes"), ("targets", "targets"))]  # fmt: skip
    lines.append(("precompute", [f"{sum(made[name].seconds.values()):.2f} s" for name in variants]))
    lines.append(("steps per second", [f"{job.outcome.report['steps_per_second']:.0f}" for job in variants.values()]))
    for label, (first, last) in SWINGS.items():
        lines.append((f"swing, {label}", [f"{1000 * swing(job, first, last):.1f} mm" for job in variants.values()]))
    lines.append(("", [""] * len(variants)))
    stages = {name: {**made[name].seconds, **job.progress.seconds} for name, job in variants.items()}
    for name in variants:
        del stages[name]["build"]  # its own stages are listed
    for stage in next(reversed(stages.values())):
        lines.append((stage, [f"{stages[name].get(stage, 0.0):.2f} s" for name in variants]))
    lines.append(("bake, in all", [f"{sum(job.progress.seconds.values()):.2f} s" for job in variants.values()]))

    settings = next(iter(variants.values())).input.settings
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
    try:
        code = main()
    except BaseException:  # Blender 4.5 might never end by itself
        traceback.print_exc()
        code = 1
    leave(code)
