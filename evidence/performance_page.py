# SPDX-License-Identifier: GPL-3.0-or-later
"""`make bench-docs`: docs/performance.md and its plots from what `make bench` measured. No number is typed here."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence

from project import ROOT

import bench
import plots
import table

REPORT = ROOT / "build" / "reports" / "bench.json"
PAGE = ROOT / "docs" / "performance.md"
IMAGES = "images/performance"
CACHES = {16: "first cache", 256: "second cache", 3072: "third cache", 24576: "most of the third", 262144: "memory"}
MODES = (8, 12, 19, 30, 40, 60)
BAKES = ("bake[63-False]", "bake[125-False]", "bake[250-False]", "bake[500-False]", "bake[250-True]")
STAGES = {
    "pose evaluation": "Blender poses the rig",
    "read the rig": "read the rig",
    "engine": "engine",
    "simulate, but for the engine": "prepare, skin matrices, report",
    "write keys": "write keys",
    "extract": "read the mesh",
}

OPENING = """# Performance

This page is for developers: it gives the cost of each part of the engine and of the pipeline. For the time that a
character takes an artist, and the settings that change it, see [How long](how_long.md). `make -C evidence bench`
measures; `make -C evidence bench-docs` writes this page and its plots from `build/reports/bench.json`. Only the goals
and the comparison with VegaFEM are written by hand; they are in `evidence/table.py`.

A goal is what the project asks of itself on this machine. Where it is missed, everything works, only more slowly than
hoped: *measured / goal* says by how much.

The solid has {dofs:,.0f} degrees of freedom, 4 bones and materials of 100 to 300 kPa; a step is one Newton iteration of
1/60 s with the bones moving. Work on one core is measured in processor time; of repeated runs, the fastest counts.

{missed}

{commit}. Machine: {machine}.
"""

PRECOMPUTE = """*Basis, polynomials, inertia* begins with the tetrahedra of this solid and uses all cores. The
precompute of the sample scene *Shoulder* in [results.md](results.md) takes many times as long, because it begins with
the skin, runs on one core, and fits its modes to the shot: before the polynomials that it keeps, it makes a model of
twice as many modes and rehearses the shot with that. There its stages are listed one by one.
"""

VEGA = """## Against VegaFEM 3.1

How many times as long as this engine VegaFEM 3.1 takes, with its own BLAS: measured once, side by side in one run on
one machine (AMD EPYC, 2 cores, one thread), on solids with the same number of degrees of freedom; `make -C evidence
bench` does not run it. Where VegaFEM is faster, the ratio is bold. VegaFEM has neither targets nor a rig with the
inertia of moving bones. Its plain step is therefore compared twice: with one iteration of ours, which is the same work,
and with a whole
step, which has all that a bake needs. """

PEAKS = """## The machine

Measured in the same run, one core. *Operations*: multiplications and additions a second, vectorized and fused where
the machine can. *Read*: a plain sum over data of that size.
"""

COST = """## What a reduced StVK step costs

Energy, force and tangent are polynomials of the r coordinates (docs/theory.md). With p = r (r + 1) / 2 pairs of modes
a blended table holds p + p r + p (p + 1) / 2 coefficients: r⁴ / 8 for large r. One evaluation of force and tangent

- reads each coefficient once: *bytes*, as the engine stores them;
- multiplies and adds for 2 p r + 2 p² *operations*, since a coefficient of the symmetric quartic part serves two
  rows.

Whichever takes longer at the machine's peak is the *bound*: bytes at the bandwidth of the cache that they fit in, or
operations in double precision. A solve adds r³ / 3 operations, and blending reads and adds one table for each target
that acts.
"""

STEP = """*Rest* is the step without one evaluation and the blend: skin frame, inertia, solve and update, and a second
evaluation where the step makes one.
"""

RIG = """## Rig: bones and nodes

The weights of three targets at the rig's pose, the skin frame and the inertia of the moving bones in 20 modes: this is
the cost of a step besides the elastic forces, whatever the material model. As in the MakeHuman body, two fifths of the
bones carry tissue that the modes move, three per node. {nodes}
"""

PIPELINE = """## Pipeline

The MakeHuman body with {bones} bones, {targets} targets and {modes} modes of StVK, {substeps} substeps a frame.
Milliseconds of the fastest of several bakes; the time to pose the rig is Blender's own.
"""


CLICK = """## From the click to Live

A user waits for *Add Soft Skin*, the build that follows by itself, and *Live* until its first frame. Each run is in a
process that has just opened the character. Live begins with a draft of few modes; *whole model* is when it goes on with
all of them. Seconds of the median of {runs} runs; those of the processor count all cores and the process of the mesher.
*Stroke*: from the end of a stroke of Firmness to Live. *Bake*: the first one of 250 frames; *rig* is the part of it
that reads the rig. *Rigify* is the human of its metarig with a face, skinned with automatic weights.{before}
"""
BEFORE = " *Before*: at commit `{}`, in the same run, in turn."


def main() -> int:
    if not REPORT.exists():
        sys.exit("bench-docs: run make -C evidence bench first")
    measured = json.loads(REPORT.read_text())
    engine, pipeline = measured["engine"], measured["pipeline"]
    dofs = engine["full_step/linear"]["dofs"]
    page = [OPENING.format(dofs=dofs, missed=missed_goals(measured), **measured)]
    page += [grid(table.HEAD, table.rows(measured)), PRECOMPUTE, VEGA, *against_vega(), PEAKS, peaks(engine)]
    page += [COST, costs(engine), STEP, parts(engine), f"![Growth with modes and targets]({IMAGES}/step.svg)\n"]
    page += [RIG.format(nodes=growth_with_nodes(engine)), f"![Growth with bones and nodes]({IMAGES}/rig.svg)\n"]
    draw_step(engine)
    draw_rig(engine)
    if clicks := measured.get("clicks"):
        before = BEFORE.format(measured["before"]) if measured["before"] else ""
        page += [CLICK.format(runs=bench.CLICKS, before=before), waits(clicks, bool(before))]
        page += [f"![Stages from the click to Live]({IMAGES}/click.svg)\n"]
        draw_clicks(clicks)
    if pipeline:
        page += [about_pipeline(pipeline), bakes(pipeline), f"![Growth with frames]({IMAGES}/bake.svg)\n"]
        draw_bake(pipeline)
    PAGE.write_text("\n".join(page).rstrip() + "\n", encoding="utf-8")
    print(f"written to {PAGE.relative_to(ROOT)}")
    return 0


def grid(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def missed_goals(measured: dict) -> str:
    """A sentence that names the goals which are missed."""
    missed = table.missed(measured)
    if not missed:
        return "All goals are reached."
    listed = "".join(f"\n- {work}" for work in missed)
    return f"These goals are missed, and bold in the table:\n{listed}"


def against_vega() -> list[str]:
    """The ratios by number of modes, and the others."""
    head = ("VegaFEM 3.1", "this engine", *(f"r = {r}" for r in table.VEGA_MODES))
    by_modes = [(theirs, ours, *map(times, ratios)) for theirs, ours, ratios in table.VEGA_BY_MODES]
    others = [(theirs, ours, times(ratio)) for theirs, ours, ratio in table.VEGA_OTHERS]
    return [grid(head, by_modes), grid(("VegaFEM 3.1", "this engine", "VegaFEM takes"), others)]


def times(ratio: float) -> str:
    """How many times as long VegaFEM takes, bold where that is less."""
    return f"{ratio:g} times" if ratio >= 1 else f"**{ratio:g} times**"


# The machine ----------------------------------------------------------------------------------------------------------


def peaks(engine: dict) -> str:
    rates = [(f"operations, {name}", f"{engine[f'operations/bytes:{size}']['per_second'] / 1e9:.0f} G/s")
             for name, size in (("single precision", 4), ("double precision", 8))]  # fmt: skip
    for size, cache in CACHES.items():
        rate = engine[f"bandwidth/kB:{size}"]["per_second"]
        rates.append((f"read, {size:,} kB ({cache})", f"{rate / 1e9:.0f} GB/s"))
    return grid(("", "peak"), rates)


def bandwidth(engine: dict, size: float) -> float:
    """Bytes a second of a read of `size` bytes again and again."""
    measured = next((kb for kb in CACHES if 1024 * kb >= size), max(CACHES))
    return engine[f"bandwidth/kB:{measured}"]["per_second"]


# Reduced steps --------------------------------------------------------------------------------------------------------


def sized(work: str, r: int, targets: int = 1) -> str:
    return f"{work}/targets:{targets}/r:{r}"


def bound(engine: dict, r: int) -> tuple[float, float]:
    """Seconds that one evaluation's bytes and operations take at the machine's peak."""
    pairs = r * (r + 1) / 2
    size = engine[sized("linearize", r)]["bytes"]
    operations = 2 * pairs * r + 2 * pairs**2
    return size / bandwidth(engine, size), operations / engine["operations/bytes:8"]["per_second"]


def costs(engine: dict) -> str:
    rows = []
    for r in MODES:
        found, limits = engine[sized("linearize", r)], bound(engine, r)
        size, seconds = found["bytes"], found["seconds"]
        rows.append((str(r), f"{found['coefficients']:,.0f}", f"{size / 1024:,.0f} kB",
                     *(us(limit) for limit in limits), us(seconds), f"{100 * max(limits) / seconds:.0f} %",
                     f"{size / seconds / 1e9:.0f} GB/s"))  # fmt: skip
    head = ("r", "coefficients", "bytes", "bytes at peak", "operations at peak", "measured", "of the bound", "read at")
    return grid(head, rows)


def parts(engine: dict) -> str:
    rows = []
    for targets, r in ((1, 12), (1, 19), (1, 30), (1, 60), (6, 12), (6, 19), (6, 30), (6, 60)):
        step, blend, force = (engine[sized(work, r, targets)]["seconds"] for work in ("step", "blend", "linearize"))
        converged = engine[sized("converged_step", r, targets)]
        cells = (us(step), us(blend), us(force), us(step - blend - force))
        rows.append((f"{targets}, r = {r}", *cells, us(converged["seconds"]), f"{converged['iterations']:.1f}"))
    head = ("targets", "step", "blend", "force and tangent", "rest", "step to convergence", "iterations")
    return grid(head, rows)


def draw_step(engine: dict) -> None:
    drawing, axes = plots.figure(3)
    limits = {r: 1e6 * max(bound(engine, r)) for r in MODES}
    curves = {
        "step": (MODES, [1e6 * engine[sized("step", r)]["seconds"] for r in MODES]),
        "force and tangent": (MODES, [1e6 * engine[sized("linearize", r)]["seconds"] for r in MODES]),
        "their bound": (MODES, list(limits.values())),
        "with solve and update": (MODES, [1e6 * engine[sized("iteration", r)]["seconds"] for r in MODES]),
    }
    plots.draw(axes[0], "Reduced StVK, one target", curves, "modes", "µs", marker="o", ms=4)
    counts = (1, 2, 3, 6, 12)
    curves = {
        name: (counts, [1e6 * engine[sized(work, 19, j)]["seconds"] for j in counts])
        for name, work in (("step", "step"), ("blend", "blend"))
    }
    plots.draw(axes[1], "Targets, all active, r = 19", curves, "targets", "µs", marker="o", ms=4)
    curves = {"polynomials of a target": (MODES, [engine[f"polynomials/r:{r}"]["seconds"] for r in MODES])}
    plots.draw(axes[2], "Precompute", curves, "modes", "s", marker="o", ms=4)
    for panel in (axes[0], axes[2]):
        plots.logarithmic(panel)
    from_zero(axes[1])
    plots.save(drawing, ROOT / "docs" / IMAGES / "step.svg")


# The rig --------------------------------------------------------------------------------------------------------------


def rig_steps(engine: dict, fixed: str, x: str) -> tuple[list[float], list[float]]:
    """Counter `x` and microseconds of the rig's steps whose name holds `fixed`."""
    found = [result for name, result in engine.items() if name.startswith("rig/") and fixed in name]
    points = sorted((result[x], 1e6 * result["seconds"]) for result in found)
    return [at for at, _ in points], [time for _, time in points]


def growth_with_nodes(engine: dict) -> str:
    nodes, times = rig_steps(engine, "chain:21/", "nodes")
    bones = engine["rig/chain:21/nodes:2000"]["bones"]
    return (
        f"With {bones:.0f} bones {nodes[-1] / nodes[0]:.0f} times the nodes take {times[-1] / times[0]:.1f} times as "
        f"long ({us(1e-6 * times[0])} and {us(1e-6 * times[-1])})."
    )


def draw_rig(engine: dict) -> None:
    drawing, axes = plots.figure(2)
    by_bones = rig_steps(engine, "nodes:2000", "bones")
    by_nodes = rig_steps(engine, "chain:21/", "nodes")
    plots.draw(axes[0], "Bones, 2,000 nodes", {"inertia and weights": by_bones}, "bones", "µs", marker="o", ms=4)
    bones = engine["rig/chain:21/nodes:2000"]["bones"]
    plots.draw(axes[1], f"Nodes, {bones:.0f} bones", {"inertia and weights": by_nodes}, "nodes", "µs", marker="o", ms=4)
    for panel in axes:
        from_zero(panel)
    plots.save(drawing, ROOT / "docs" / IMAGES / "rig.svg")


# The click ------------------------------------------------------------------------------------------------------------


def waits(clicks: dict, compared: bool) -> str:
    """A row for each character."""
    columns = {"wall": "Live, s", "cpu": "of the processor", "whole": "whole model, s", "stroke": "stroke, s",
               "bake": "bake, s", "rig": "rig, s"}  # fmt: skip
    head = ("character", "vertices", "bones", *columns.values())
    rows = []
    for name, runs in clicks.items():
        now, then = runs["now"], runs.get("before")
        row = (name, f"{now['vertices']:,}", f"{now['bones']:,}", *(f"{now[column]:.2f}" for column in columns))
        rows.append(row)
        if compared:
            rows.append(("before", "", "", *(f"{then[column]:.2f}" for column in columns)))
    return grid(head, rows)


def draw_clicks(clicks: dict) -> None:
    drawing, axes = plots.figure(1)
    stages = list(dict.fromkeys(stage for runs in clicks.values() for stage in runs["now"]["stages"]))
    parts = {stage: [runs["now"]["stages"].get(stage, 0.0) for runs in clicks.values()] for stage in stages}
    plots.stacked(axes[0], "From the click to Live", list(clicks), parts, "s")
    plots.save(drawing, ROOT / "docs" / IMAGES / "click.svg")


# The pipeline ---------------------------------------------------------------------------------------------------------


def about_pipeline(pipeline: dict) -> str:
    return PIPELINE.format(**pipeline[table.BAKE])


def bakes(pipeline: dict) -> str:
    rows = []
    for name in BAKES:
        bake = pipeline[name]
        stages = bake["stages"]
        ours = stages["total"] - stages["pose evaluation"]
        rows.append((f"{bake['frames']} frames, {bake['vertices']:,} vertices",
                     *(f"{1000 * stages[stage]:.0f}" for stage in STAGES), f"{1000 * ours:.0f}"))  # fmt: skip
    return grid(("", *STAGES.values(), "all but Blender's"), rows)


def draw_bake(pipeline: dict) -> None:
    drawing, axes = plots.figure(1)
    made = [pipeline[name] for name in BAKES if pipeline[name]["vertices"] == pipeline[table.BAKE]["vertices"]]
    frames = [bake["frames"] for bake in made]
    curves = {label: (frames, [1000 * bake["stages"][stage] for bake in made]) for stage, label in STAGES.items()}
    plots.draw(axes[0], "Bake, 4 substeps", curves, "frames", "ms", marker="o", ms=4)
    from_zero(axes[0])
    plots.save(drawing, ROOT / "docs" / IMAGES / "bake.svg")


def from_zero(panel) -> None:
    """With room for the legend above the curves."""
    panel.set_ylim(0, 1.4 * panel.dataLim.ymax)


def us(seconds: float) -> str:
    return f"{table.number(1e6 * seconds)} µs"


if __name__ == "__main__":
    sys.exit(main())
