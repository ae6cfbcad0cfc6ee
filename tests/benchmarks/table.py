# SPDX-License-Identifier: GPL-3.0-or-later
"""The goals, the times of VegaFEM 3.1, and the measurements: the rows of `make bench`'s table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

UNITS = {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "times": 1.0, "characters": 1.0, "of the bandwidth": 1.0}


@dataclass(frozen=True)
class Row:
    """One line: work, goal and reference in `unit`; measure(engine, pipeline) in seconds or as it is.

    reference: of VegaFEM 3.1 with its own BLAS build, one thread; None where it has no such row.
    """

    work: str
    unit: str
    goal: float | None
    reference: float | None
    measure: Callable[[dict, dict], float]
    most: bool = True  # the goal is an upper bound

    def value(self, measured: dict) -> float | None:
        """In `unit`; None when it was not measured."""
        try:
            return self.measure(measured["engine"], measured["pipeline"]) / UNITS[self.unit]
        except KeyError:
            return None

    def cells(self, measured: dict) -> tuple[str, ...] | None:
        value = self.value(measured)
        if value is None:
            return None
        bound = "≤" if self.most else "≥"
        against = value / self.goal if self.goal else None
        return (
            self.work,
            f"{bound} {number(self.goal)} {self.unit}" if self.goal else "",
            f"{number(value)} {self.unit}",
            _against(against, self.most) if against else "",
            f"{number(self.reference)} {self.unit}" if self.reference else "",
            f"{number(self.reference / value)} times" if self.reference else "",
        )


def _against(ratio: float, most: bool) -> str:
    """Measured / goal, bold when it misses the goal."""
    missed = ratio > 1.0 if most else ratio < 1.0
    return f"**{number(ratio)}**" if missed else number(ratio)


HEAD = ("work", "goal", "measured", "measured / goal", "reference", "faster")


def seconds(name: str) -> Callable[[dict, dict], float]:
    return lambda engine, _: engine[name]["seconds"]


def step(r: int, targets: int = 1, work: str = "step") -> Callable[[dict, dict], float]:
    return seconds(f"{work}/targets:{targets}/r:{r}")


def ratio(above: Callable, below: Callable) -> Callable[[dict, dict], float]:
    return lambda engine, pipeline: above(engine, pipeline) / below(engine, pipeline)


BAKE = "bake[250-False]"


def outside_pose_evaluation(_, pipeline: dict) -> float:
    stages = pipeline[BAKE]["stages"]
    return stages["total"] - stages["pose evaluation"]


def fraction_of_bandwidth(engine: dict, _) -> float:
    """Of what a plain read of the same bytes takes."""
    surface = engine["surface/vertices:13000/r:20"]
    return surface["bytes"] / surface["seconds"] / engine["bandwidth/kB:3072"]["per_second"]


def characters_at_30_fps(work: str) -> Callable[[dict, dict], float]:
    """How many are stepped in 1/30 s, when there are so many that their states do not fit in the caches."""

    def count(engine: dict, _) -> float:
        crowd = engine[f"{work}/characters:5120"]
        return crowd["characters"] / crowd["seconds"] / 30

    return count


ROWS = [
    Row("polynomials of a target, r = 12", "s", None, 1.7, seconds("polynomials/r:12")),
    Row("polynomials of a target, r = 19", "s", 0.08, 7.3, seconds("polynomials/r:19")),
    Row("polynomials of a target, r = 30", "s", 0.35, 33, seconds("polynomials/r:30")),
    Row("polynomials of a target, r = 60", "s", 4, 1390, seconds("polynomials/r:60")),
    Row("whole precompute, 6 targets, r = 19, all cores", "s", 1.5, None, seconds("precompute")),
    Row("cage, tetrahedra, embedding: 13k vertices, 2k nodes", "s", 3, None, lambda _, p: p["meshing"]["seconds"]),
    Row("force, tangent, solve, update, StVK, one target, r = 12", "µs", 2, 4.7, step(12, work="iteration")),
    Row("force, tangent, solve, update, StVK, one target, r = 19", "µs", 5, 17, step(19, work="iteration")),
    Row("force, tangent, solve, update, StVK, one target, r = 30", "µs", 25, 89, step(30, work="iteration")),
    Row("force, tangent, solve, update, StVK, one target, r = 60", "µs", 300, 3000, step(60, work="iteration")),
    Row(
        "the same with 6 targets and a new pose each time / one, r = 19",
        "times",
        1.3,
        None,
        ratio(step(19, 6, "iteration"), step(19, work="iteration")),
    ),
    Row("whole step with its rig, to convergence, r = 19", "µs", None, None, step(19, work="converged_step")),
    Row(
        "the same with 6 targets and a new pose each time / one, r = 19",
        "times",
        None,
        None,
        ratio(step(19, 6, "converged_step"), step(19, work="converged_step")),
    ),
    Row("linear: blend, force, solve, update, 6 targets, r = 19", "µs", 3, None, seconds("linear_iteration/targets:6")),
    Row("whole linear step with its rig, 6 targets, r = 19", "µs", None, None, seconds("linear_step/targets:6")),
    Row("full linear step, 6 targets, 4,899 DOF", "ms", 4, 13.7, seconds("full_step/linear")),
    Row("full StVK step, 6 targets, 4,899 DOF, all cores", "ms", 16, 128, seconds("full_step/stvk_all_cores")),
    Row("rig of 53 bones: inertia, weights, r = 20, 500 nodes", "µs", 10, None, seconds("rig/chain:21/nodes:500")),
    Row("the same, 8,000 nodes", "µs", 10, None, seconds("rig/chain:21/nodes:8000")),
    Row("weights of 6 targets at a pose", "µs", None, None, seconds("pose_weights/chain:21/targets:6")),
    Row("surface, 13k vertices of 20 modes", "of the bandwidth", None, None, fraction_of_bandwidth, most=False),
    Row("bake of 250 frames of 4 substeps: engine", "ms", 50, None, lambda _, p: p[BAKE]["stages"]["engine"]),
    Row("the same, all but Blender's pose evaluation", "s", 1, None, outside_pose_evaluation),
    Row("live: our share of a frame, 4 substeps", "ms", 2, None, lambda _, p: p["live"]["median"]),
    Row("live: a frame with Blender's evaluation", "ms", None, None, lambda _, p: p["live"]["whole"]),
    Row("live: from another stiffness to its frame", "ms", None, None, lambda _, p: p["live_change"]["median"]),
    Row("crowd at 30 fps on one core", "characters", 5000, None, characters_at_30_fps("crowd"), most=False),
    Row(
        "crowd / one by one",
        "times",
        3,
        None,
        ratio(characters_at_30_fps("crowd"), characters_at_30_fps("one_by_one")),
        most=False,
    ),
]


def number(value: float) -> str:
    """Three digits."""
    if value >= 1000:
        return f"{float(f'{value:.3g}'):,.0f}"
    return f"{value:.3g}"


def rows(measured: dict) -> list[tuple[str, ...]]:
    """What was measured, as cells under HEAD."""
    return [cells for row in ROWS if (cells := row.cells(measured))]


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
