# SPDX-License-Identifier: GPL-3.0-or-later
"""The goals and the measurements: the rows of `make bench`'s table. And how VegaFEM 3.1 compares, as data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

UNITS = {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "times": 1.0, "of the bandwidth": 1.0}


@dataclass(frozen=True)
class Row:
    """One line: work, and goal in `unit`; measure(engine, pipeline and clicks) in seconds or as it is."""

    work: str
    unit: str
    goal: float | None
    measure: Callable[[dict, dict], float]
    most: bool = True  # the goal is an upper bound

    def value(self, measured: dict) -> float | None:
        """In `unit`; None when it was not measured."""
        try:
            others = measured["pipeline"] | measured.get("clicks", {})
            return self.measure(measured["engine"], others) / UNITS[self.unit]
        except KeyError:
            return None

    def cells(self, measured: dict) -> tuple[str, ...] | None:
        value = self.value(measured)
        if value is None:
            return None
        bound = "≤" if self.most else "≥"
        against = number(value / self.goal) if self.goal else ""
        return (
            self.work,
            f"{bound} {number(self.goal)} {self.unit}" if self.goal else "",
            f"{number(value)} {self.unit}",
            f"**{against}**, missed" if self.misses(measured) else against,
        )

    def misses(self, measured: dict) -> bool:
        """Whether it was measured and does not reach its goal."""
        value = self.value(measured)
        if value is None or not self.goal:
            return False
        return value > self.goal if self.most else value < self.goal


HEAD = ("work", "goal", "measured", "measured / goal")


def seconds(name: str) -> Callable[[dict, dict], float]:
    return lambda engine, _: engine[name]["seconds"]


def step(r: int, targets: int = 1, work: str = "step") -> Callable[[dict, dict], float]:
    return seconds(f"{work}/targets:{targets}/r:{r}")


def ratio(above: Callable, below: Callable) -> Callable[[dict, dict], float]:
    return lambda engine, pipeline: above(engine, pipeline) / below(engine, pipeline)


BAKE = "bake[250-False]"
# From the click to Live. Character -> its file in ../shared/assets; none: a fixture.
CLICKED = {"Fox": "Fox.glb", "Shiba Inu": "zoo/ShibaInu.glb", "MakeHuman": "mh_male_53bones.blend", "Rigify": None}


def click(name: str, what: str = "wall") -> Callable[[dict, dict], float]:
    return lambda _, clicks: clicks[name]["now"][what]


def beyond_reading(name: str) -> Callable[[dict, dict], float]:
    return lambda _, clicks: clicks[name]["now"]["bake"] - clicks[name]["now"]["rig"]


def outside_pose_evaluation(_, pipeline: dict) -> float:
    stages = pipeline[BAKE]["stages"]
    return stages["total"] - stages["pose evaluation"]


def added_to_a_frame(_, pipeline: dict) -> float:
    measured = pipeline["live_with_many_keys"]
    return measured["whole"] - measured["without"]


def fraction_of_bandwidth(engine: dict, _) -> float:
    """Of what a plain read of the same bytes takes."""
    surface = engine["surface/vertices:13000/r:20"]
    return surface["bytes"] / surface["seconds"] / engine["bandwidth/kB:3072"]["per_second"]


ROWS = [
    Row("polynomials of a target, r = 12", "s", None, seconds("polynomials/r:12")),
    Row("polynomials of a target, r = 19", "s", 0.08, seconds("polynomials/r:19")),
    Row("polynomials of a target, r = 30", "s", 0.35, seconds("polynomials/r:30")),
    Row("polynomials of a target, r = 60", "s", 4, seconds("polynomials/r:60")),
    Row("basis, polynomials, inertia: 6 targets, r = 19, all cores", "s", 1.5, seconds("precompute")),
    Row("cage, tetrahedra, embedding: 13k vertices, 2k nodes", "s", 3, lambda _, p: p["meshing"]["seconds"]),
    Row("force, tangent, solve, update, StVK, one target, r = 12", "µs", 2, step(12, work="iteration")),
    Row("force, tangent, solve, update, StVK, one target, r = 19", "µs", 5, step(19, work="iteration")),
    Row("force, tangent, solve, update, StVK, one target, r = 30", "µs", 25, step(30, work="iteration")),
    Row("force, tangent, solve, update, StVK, one target, r = 60", "µs", 300, step(60, work="iteration")),
    Row(
        "StVK iteration with 6 targets and a new pose each time / with one, r = 19",
        "times",
        1.3,
        ratio(step(19, 6, "iteration"), step(19, work="iteration")),
    ),
    Row("whole step with its rig, to convergence, r = 19", "µs", 10, step(19, work="converged_step")),
    Row(
        "whole step with 6 targets and a new pose each time / with one, r = 19",
        "times",
        1.3,
        ratio(step(19, 6, "converged_step"), step(19, work="converged_step")),
    ),
    Row("linear: blend, force, solve, update, 6 targets, r = 19", "µs", 3, seconds("linear_iteration/targets:6")),
    Row("whole linear step with its rig, 6 targets, r = 19", "µs", None, seconds("linear_step/targets:6")),
    Row("solve in 20 modes and 100 responses", "µs", None, seconds("solve_with_points/rows:0")),
    Row("the same with 10 rows of points of the skin", "µs", None, seconds("solve_with_points/rows:10")),
    Row("the same with 100 rows", "µs", None, seconds("solve_with_points/rows:100")),
    Row("full linear step, 6 targets, 4,899 DOF", "ms", 4, seconds("full_step/linear")),
    Row("full StVK step, 6 targets, 4,899 DOF, all cores", "ms", 16, seconds("full_step/stvk_all_cores")),
    Row("rig of 53 bones: inertia, weights, r = 20, 500 nodes", "µs", 10, seconds("rig/chain:21/nodes:500")),
    Row("the same, 8,000 nodes", "µs", 10, seconds("rig/chain:21/nodes:8000")),
    Row("weights of 6 targets at a pose", "µs", None, seconds("pose_weights/chain:21/targets:6")),
    Row("surface, 13k vertices of 20 modes", "of the bandwidth", None, fraction_of_bandwidth, most=False),
    Row("bake of 250 frames of 4 substeps: engine", "ms", 50, lambda _, p: p[BAKE]["stages"]["engine"]),
    Row("the same, all but Blender's pose evaluation", "s", 1, outside_pose_evaluation),
    Row("from the click to Live, Shiba Inu, 4k vertices", "s", 0.75, click("Shiba Inu")),
    Row("from the click to Live, MakeHuman, 13k vertices", "s", 1.5, click("MakeHuman")),
    Row("from the click to Live, Rigify", "s", 2.5, click("Rigify")),
    Row("from a stroke of Firmness to Live, MakeHuman", "s", 0.5, click("MakeHuman", "stroke")),
    Row(
        "first bake of 250 frames, 120 modes, all but reading the rig, MakeHuman",
        "s",
        0.3,
        beyond_reading("MakeHuman"),
    ),
    Row("step of 120 modes without limits, MakeHuman", "µs", 70, click("MakeHuman", "step")),
    Row("live: our share of a frame, 4 substeps", "ms", 2, lambda _, p: p["live"]["median"]),
    Row("live: a frame with Blender's evaluation", "ms", None, lambda _, p: p["live"]["whole"]),
    Row("live with 200 driven keys: what it adds to a frame", "ms", 2.5, added_to_a_frame),
    Row("live: from another stiffness to its frame", "ms", None, lambda _, p: p["live_change"]["median"]),
]


# How VegaFEM 3.1 compares: its time divided by that of this engine.
VEGA_MODES = (12, 19, 30, 60)
VEGA_BY_MODES = [
    # (VegaFEM's work, this engine's work, a ratio for each of VEGA_MODES)
    ("polynomials of a material", "polynomials of a target", (56, 65, 91, 303)),
    ("one iteration of a reduced StVK step", "one iteration of a reduced StVK step", (2.1, 2.1, 2.2, 7.4)),
    ("its plain step, which is one iteration without a rig", "whole step with its rig, to convergence",
     (0.46, 0.53, 0.65, 2.3)),
]  # fmt: skip
VEGA_OTHERS = [
    ("basis: modes and their derivatives", "basis", 9.4),
    ("full linear step", "full linear step, 6 targets", 2.4),
    ("full linear step", "full linear step, one target", 5.5),
    ("full StVK step", "full StVK step, 6 targets", 13.6),
    ("full StVK step", "full StVK step, one target", 20),
    ("full corotational step", "full StVK step", 2.3),
]


def number(value: float) -> str:
    """Three digits."""
    if value >= 1000:
        return f"{float(f'{value:.3g}'):,.0f}"
    return f"{value:.3g}"


def rows(measured: dict) -> list[tuple[str, ...]]:
    """What was measured, as cells under HEAD."""
    return [cells for row in ROWS if (cells := row.cells(measured))]


def missed(measured: dict) -> list[str]:
    """The works that do not reach their goal."""
    return [row.work for row in ROWS if row.misses(measured)]


def as_text(measured: dict) -> str:
    lines = [HEAD, *rows(measured)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(HEAD))]
    padded = [
        [
            cell.ljust(width) if k == 0 else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(line, widths, strict=True))
        ]
        for line in lines
    ]
    return "\n".join([measured["machine"], "", *("  ".join(line).rstrip() for line in padded)])
