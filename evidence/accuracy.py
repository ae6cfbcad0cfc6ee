# SPDX-License-Identifier: GPL-3.0-or-later
"""`make accuracy`: docs/accuracy.md and its plot, how far reduced motion is from unreduced and what a step takes. No
number is typed here but the goals.

    python evidence/accuracy.py --only "mh_male Cow" --rows MODES:20 RESPONSES:120

Each character is measured by accuracy_shots.py in a process of its own. The figures stay in build/accuracy/NAME.json;
the page is made from them.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from project import ROOT

import plots
from assets import require
from bench import machine
from measured import measured_at
from motion_error import REGIONS, TORSO
from performance_page import grid

CACHE = ROOT / "build" / "accuracy"
PAGE = ROOT / "docs" / "accuracy.md"
PLOT = "images/accuracy/accuracy.svg"
LONGEST = 3600  # seconds that a character may take
FRAMES = 48  # of a clip at most
MODES, RESPONSES, FITTED = "MODES", "RESPONSES", "FITTED"
BASES = {MODES: "vibration modes", RESPONSES: "bone responses", FITTED: "fitted modes"}
COLORS = {MODES: plots.COLORS["single material"], RESPONSES: plots.COLORS["DMT reduced"]}
ROWS = (
    *((MODES, detail) for detail in (12, 20, 30, 40, 60)),
    *((RESPONSES, detail) for detail in (40, 80, 120, 160, 220)),
)
MAKEHUMAN, ANIMALS, OTHERS, SCENES = "MakeHuman", "animals", "other", "sample scenes"
GREEN = "#3aa655"
TIMES, ERRORS = (4.0, 6000.0), (1.0, 120.0)  # what the plot shows, microseconds and percent
DIVERGES = 10.0  # an error that is no figure any more
BUDGET, LARGER_BUDGET = 150.0, 450.0  # microseconds a step
NONE = "-"


@dataclass(frozen=True)
class Subject:
    """A character. file: of ../shared/assets, or the name of a sample scene; clips: with the frame from which they are
    played, by default the liveliest; by_bones: whether the names of its bones say where a region is."""

    title: str
    group: str
    file: str
    clips: dict[str, int] = field(default_factory=dict)
    by_bones: bool = False

    @property
    def is_scene(self) -> bool:
        return self.group == SCENES


SUBJECTS = {
    "mh_male": Subject(
        "MakeHuman, male",
        MAKEHUMAN,
        "mh_male_53bones.blend",
        {"cmu_131_01_walk": 41, "cmu_131_03_hop": 81, "gen_jump": 26, "gen_run_in_place": 21},
        by_bones=True,
    ),
    "mh_chubby": Subject(
        "MakeHuman, chubby",
        MAKEHUMAN,
        "mh_chubby_53bones.blend",
        {"cmu_131_02_walk": 41, "gen_jump": 26, "gen_run_in_place": 21, "gen_flex_and_hit": 31},
        by_bones=True,
    ),
    "Cow": Subject("Cow", ANIMALS, "zoo/Cow.glb"),
    "Velociraptor": Subject("Velociraptor", ANIMALS, "zoo/Velociraptor.glb"),
    "Husky": Subject("Husky", ANIMALS, "zoo/Husky.glb"),
    "Horse": Subject("Horse", ANIMALS, "zoo/Horse.glb"),
    "Woman_Casual": Subject("Woman, casual", OTHERS, "zoo/Woman_Casual.glb"),
    "bulging_cylinder": Subject("Bulging cylinder", SCENES, "bulging_cylinder"),
    "shoulder": Subject("Shoulder", SCENES, "shoulder"),
    "herbert": Subject("Herbert", SCENES, "herbert"),
}


@dataclass(frozen=True)
class Goal:
    """of(figures of a group, row) must be at most `most`, or for the torso at most the mean, with the best Detail of
    which a step takes no more than so many microseconds."""

    title: str
    group: str
    microseconds: float
    of: Callable[[list[dict], tuple[str, int]], float]
    most: float | None

    def limit(self, group: list[dict], row: tuple[str, int]) -> float:
        return mean_error(group, row) if self.most is None else self.most

    def asked(self) -> str:
        return "≤ the mean" if self.most is None else f"≤ {self.most:.0%}"


PAGE_TEXT = """# Accuracy of the reduced model

This page shows what you lose with *Quality: Reduced*, and what you gain. Reduced Quality simulates a number of modes
(**Detail**) instead of every node of the cage, and is many times faster. This page compares its motion with that of
Full Quality, the unreduced model. `make -C evidence accuracy` measures and writes this page and its plot; only the
goals are written by hand.

**What an error means.** The error is relative to the motion of the soft tissue itself, not to the body. An error of 10%
says that, on average, the skin is a tenth of its own swing away from its place in Full Quality: 2 mm where it swings by
20 mm. Reduced Quality keeps the bulk of the motion. It loses local ripples, and exaggerates motion that is larger than
the tissue is thick. Where these matter, bake with *Quality: Full*. Goals that are missed are bold; [decision
4](decisions/0004-where-the-error-of-responses-is.md) explains where the rest of the error comes from, and why a higher
Detail removes little of it.

{commit}.
Blender {blender}; {machine}.
Characters at a time: {jobs}; each on one thread.

Every character is as *Add Soft Skin* and *Bake* leave it, with no other setting; the material model is
{material_model}. It then plays up to {frames} frames of clips that no basis has seen, simulated from the same start
with every node of the cage and with each reduced model. The sample scenes have settings of their own and play the
frames that [Results](results.md) compares; only their *fitted modes* have seen them.

*Vibration modes*: modes and their derivatives, all with tables of the energy. *Bone responses*: what each bone does to
the soft tissue, a sixth with such tables and the rest linearly. *Detail* is the number of all together.

*Error*: RMS of the difference, divided by the RMS of the unreduced dynamic motion, which is the displacement without
the targets' shapes; both about their mean over time, by mass, over all nodes and frames of a clip. Of a part of the
body: the same for its nodes, as a part of their own motion; none where they hardly move. *Step*: microseconds, without
force fields; all steps of a clip in one call of the engine, every model in turn, the median.

## Summary

![Error against the time of a step]({plot})

Lower and further left is better. Lines are means over the clips, shades reach from the best clip to the worst, and the
numbers are *Detail*. Green: the goals at {budget:g} µs a step.

Each goal, with the *Detail* of the least mean error among those whose steps are short enough for every body of the
group. Bold: missed.

{goals}
### Parts of the MakeHuman bodies

With the same choice of *Detail*; means over the clips. Bold: above the mean of the whole. Rows are equal where the
choice is the same.

{regions}
## Characters

Without reduction: the motion, RMS in thousandths of the body's size. *Not converged*: frames with a step that has not,
of all clips. Bold: the defaults.

{characters}Who made the characters: [Attribution](attribution.md).
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--only", default="", help="characters, by the beginnings of their names; default: all")
    parser.add_argument("--keep", action="store_true", help="measure only those that were not measured before")
    parser.add_argument("--rows", nargs="+", type=parsed_row, default=ROWS, help="reduced models, as MODES:20")
    parser.add_argument("--jobs", type=int, default=1, help="characters at a time; more than one distorts the times")
    parser.add_argument("--page", action="store_true", help="write the page from what was measured before")
    arguments = parser.parse_args()
    require("accuracy", (subject.file for subject in SUBJECTS.values() if not subject.is_scene))
    beginnings = tuple(begin.lower() for begin in arguments.only.split()) or ("",)
    chosen = [name for name in SUBJECTS if name.lower().startswith(beginnings)]
    if not chosen:
        parser.error(f"no character's name begins with {arguments.only}")
    if not arguments.page:
        wanted = [name for name in chosen if not (arguments.keep and kept(name))]
        with ThreadPoolExecutor(arguments.jobs) as pool:
            for line in pool.map(lambda name: measure(name, arguments.rows, arguments.jobs), wanted):
                print(line, flush=True)
    found = {name: figures for name in SUBJECTS if (figures := kept(name))}
    if len(found) < len(SUBJECTS):
        print(f"accuracy: {', '.join(SUBJECTS.keys() - found.keys())} not measured yet: no page is written")
        return 0
    draw(found, PAGE.parent / PLOT)
    PAGE.write_text(page(found), encoding="utf-8")
    print(f"written to {PAGE.relative_to(ROOT)}")
    return 0


def parsed_row(text: str) -> tuple[str, int]:
    basis, _, detail = text.partition(":")
    return basis, int(detail)


def measure(name: str, rows: Sequence[tuple[str, int]], jobs: int) -> str:
    """One character in a process of its own, with its output in a log; its text."""
    CACHE.mkdir(parents=True, exist_ok=True)
    file, log = CACHE / f"{name}.json", CACHE / f"{name}.log"
    file.unlink(missing_ok=True)
    command = [sys.executable, Path(__file__).with_name("accuracy_shots.py"), name, file]
    command += [f"{basis}:{detail}" for basis, detail in rows]
    with log.open("w") as output:
        try:
            subprocess.run(command, stdout=output, stderr=subprocess.STDOUT, timeout=LONGEST, check=True)
        except subprocess.SubprocessError as error:
            return f"{name}: {error}, see {log.relative_to(ROOT)}"
    found = kept(name) | {"commit": measured_at(PAGE.name), "machine": machine(), "jobs": jobs}
    file.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    described = (
        f"{label(row)} {percent(mean_error([found], row))} {step(found, row):.0f} µs" for row in rows_of(found)
    )
    return f"{name}: {'; '.join(described)}"


def kept(name: str) -> dict | None:
    """The figures of a character, when it was last measured."""
    file = CACHE / f"{name}.json"
    return json.loads(file.read_text(encoding="utf-8")) if file.exists() else None


# Figures of one character or of several -------------------------------------------------------------------------------


def rows_of(found: dict) -> list[tuple[str, int]]:
    """The reduced models of a character: basis and Detail."""
    return [(row["basis"], row["detail"]) for row in found["rows"]]


def clips(found: dict, row: tuple[str, int]) -> list[dict]:
    """The figures of a reduced model in each clip; none where it was refused."""
    by_row = dict(zip(rows_of(found), found["rows"], strict=True))
    return [] if "refused" in by_row[row] else list(by_row[row]["clips"].values())


def of_group(everything: dict[str, dict], group: str) -> list[dict]:
    return [found for name, found in everything.items() if SUBJECTS[name].group == group]


def common_rows(group: Sequence[dict]) -> list[tuple[str, int]]:
    """The reduced models that every character of a group has; those that one of them refused are left out."""
    built = [[row for row in rows_of(found) if clips(found, row)] for found in group]
    return [row for row in built[0] if all(row in each for each in built)] if built else []


def errors(group: Sequence[dict], row: tuple[str, int], region: str = "") -> list[float]:
    """Of all clips of a group; infinite where the motion is not finite. region: of it alone, if it moves."""
    clip_figures = [clip for found in group for clip in clips(found, row)]
    if region:
        return [clip["regions"][region] for clip in clip_figures if clip["regions"].get(region) is not None]
    return [math.inf if clip["error"] is None else clip["error"] for clip in clip_figures]


def mean_error(group: Sequence[dict], row: tuple[str, int], region: str = "") -> float:
    return mean(errors(group, row, region))


def worst_error(group: Sequence[dict], row: tuple[str, int]) -> float:
    return max(errors(group, row), default=math.nan)


def torso_error(group: Sequence[dict], row: tuple[str, int]) -> float:
    return mean_error(group, row, TORSO)


def mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else math.nan


def step(found: dict, row: tuple[str, int]) -> float:
    """Microseconds a step, the mean over a character's clips."""
    return mean([clip["microseconds"] for clip in clips(found, row)])


def best(group: Sequence[dict], basis: str, microseconds: float) -> tuple[str, int] | None:
    """The row of the least mean error among those whose steps take no longer, for every character of the group."""
    fast = [
        row
        for row in common_rows(group)
        if row[0] == basis and all(step(found, row) <= microseconds for found in group)
    ]
    return min(fast, key=lambda row: mean_error(group, row), default=None)


GOALS = (
    Goal("MakeHuman, mean", MAKEHUMAN, BUDGET, mean_error, 0.12),
    Goal("MakeHuman, worst", MAKEHUMAN, BUDGET, worst_error, 0.16),
    Goal("MakeHuman, torso", MAKEHUMAN, BUDGET, torso_error, None),
    Goal("animals, worst", ANIMALS, BUDGET, worst_error, 0.05),
    Goal("MakeHuman, worst", MAKEHUMAN, LARGER_BUDGET, worst_error, 0.14),
)


# The page -------------------------------------------------------------------------------------------------------------


def page(everything: dict[str, dict]) -> str:
    found = list(everything.values())

    def every(key: str) -> str:
        return "; ".join(dict.fromkeys(str(each[key]) for each in found))

    return (
        PAGE_TEXT.format(
            commit=every("commit"),
            blender=every("blender"),
            machine=every("machine"),
            jobs=max(each["jobs"] for each in found),
            material_model=every("material_model").replace("STABLE_STVK", "stable StVK"),
            frames=FRAMES,
            modes_basis=BASES[MODES],
            responses_basis=BASES[RESPONSES],
            plot=PLOT,
            budget=BUDGET,
            goals=goals_table(everything),
            regions=regions_table(everything),
            characters="".join(about(each) for each in found),
        ).rstrip()
        + "\n"
    )


def goals_table(everything: dict[str, dict]) -> str:
    rows = []
    for goal in GOALS:
        group = of_group(everything, goal.group)
        cells = []
        for basis in (MODES, RESPONSES):
            row = best(group, basis, goal.microseconds)
            if row is None:
                cells.append(NONE)
                continue
            value = goal.of(group, row)
            took = max(step(found, row) for found in group)
            cells.append(f"{bold(percent(value), not value <= goal.limit(group, row))} ({row[1]}, {took:.0f} µs)")
        rows.append((goal.title, goal.asked(), f"≤ {goal.microseconds:g} µs", *cells))
    return grid(("", "error asked", "step", *(BASES[basis] for basis in (MODES, RESPONSES))), rows)


def regions_table(everything: dict[str, dict]) -> str:
    group = of_group(everything, MAKEHUMAN)
    rows = []
    for microseconds in (BUDGET, LARGER_BUDGET):
        for basis in (MODES, RESPONSES):
            if row := best(group, basis, microseconds):
                whole = mean_error(group, row)
                parts = (mean_error(group, row, region) for region in REGIONS)
                rows.append((f"{label(row)}, ≤ {microseconds:g} µs", percent(whole),
                             *(bold(percent(part), part > whole) for part in parts)))  # fmt: skip
    return grid(("", "whole", *REGIONS), rows)


def about(found: dict) -> str:
    """A character's section."""
    moving = found["clips"]
    regions = list(dict.fromkeys(region for clip in moving.values() for region in clip["regions"]))
    over_clips = ("mean", "worst") if len(moving) > 1 else ()
    head = ("", "coordinates", "step, µs", "iterations", *moving, *over_clips, *regions, "not converged")
    rows, refused = [unreduced_cells(found, regions)], []
    for row, figures in zip(rows_of(found), found["rows"], strict=True):
        if "refused" in figures:
            refused.append(f"{label(row)}: refused, “{' '.join(figures['refused'].split())}”\n\n")
            continue
        name = bold(label(row), list(row) == found["default"])
        rows.append((name, str(figures["coordinates"]), *reduced_cells(found, row, regions)))
    hertz = f"{found['frequency']:.3g} Hz, " if found["frequency"] else ""
    frames = ", ".join(f"{name} {clip['frames'][0]} to {clip['frames'][1]}" for name, clip in moving.items())
    return (
        f"### {found['title']}\n\n{found['nodes']:,} nodes, {hertz}targets: {found['targets']}. Frames: {frames}.\n\n"
        f"{grid(head, rows)}\n{''.join(refused)}"
    )


def unreduced_cells(found: dict, regions: Sequence[str]) -> tuple[str, ...]:
    """The first row: how much moves."""
    moving = list(found["clips"].values())
    parts = [mean([clip["regions"][region] for clip in moving if region in clip["regions"]]) for region in regions]
    whole = with_mean_and_worst([clip["moves"] for clip in moving])
    took = mean([clip["microseconds"] for clip in moving])
    return (
        "not reduced",
        f"{found['dofs']:,}",
        f"{took:,.0f}",
        *iterations_between(moving, [f"{1000 * value:.2g} ‰" for value in (*whole, *parts)]),
    )


def reduced_cells(found: dict, row: tuple[str, int], regions: Sequence[str]) -> tuple[str, ...]:
    """Of a reduced model: step, iterations, errors and what has not converged."""
    values = with_mean_and_worst(errors([found], row)) + [mean_error([found], row, region) for region in regions]
    took = step(found, row)
    return (
        f"{took:,.0f}" if took >= 100 else f"{took:.1f}",
        *iterations_between(clips(found, row), map(percent, values)),
    )


def iterations_between(figures: Sequence[dict], cells: Iterable[str]) -> tuple[str, ...]:
    """The cells between the iterations of a step and the frames that have not converged, of all these clips."""
    iterations = mean([clip["iterations"] for clip in figures])
    return (f"{iterations:.2f}", *cells, str(sum(clip["unconverged"] for clip in figures)))


def with_mean_and_worst(values: list[float]) -> list[float]:
    return [*values, mean(values), max(values)] if len(values) > 1 else values


def label(row: tuple[str, int]) -> str:
    return f"{BASES[row[0]]}, {row[1]}"


def percent(value: float) -> str:
    if math.isnan(value):
        return NONE
    return f"{100 * value:.1f} %" if value < DIVERGES else "diverges"


def bold(text: str, wrong: bool) -> str:
    return f"**{text}**" if wrong else text


# The plot -------------------------------------------------------------------------------------------------------------


def draw(everything: dict[str, dict], path: Path) -> None:
    """Error against the time of a step, a panel for each group."""
    panels = {"MakeHuman, two bodies": MAKEHUMAN, "Four animals": ANIMALS, "Sample scenes": SCENES}
    drawing, axes = plots.figure(len(panels), height=4.2)
    for panel, (title, name) in zip(axes, panels.items(), strict=True):
        plots.logarithmic(panel, x=True)
        for basis in COLORS:
            draw_basis(panel, of_group(everything, name), basis)
        if name == ANIMALS:  # no goal is about this one
            for basis in COLORS:
                draw_basis(panel, of_group(everything, OTHERS), basis, "woman, ")
        for goal in GOALS:
            if goal.group == name and goal.microseconds == BUDGET and goal.most:
                panel.fill_between((TIMES[0], BUDGET), ERRORS[0], 100 * goal.most, color=GREEN, alpha=0.15, lw=0)
                about = f"{goal.title.rpartition(' ')[2]} {goal.asked()}"
                panel.text(1.1 * TIMES[0], 100 * goal.most, about, fontsize=7, color=GREEN, va="top")
        panel.set(title=title, xlabel="a step, µs", ylabel="error, %", xlim=TIMES, ylim=ERRORS)
        panel.legend(fontsize=8)
    plots.save(drawing, path)


def draw_basis(panel, group: Sequence[dict], basis: str, beside: str = "") -> None:
    """The mean over a group's clips, in a shade from the best to the worst, as far as nothing diverges. beside: what is
    said of a group that is shown beside that of the panel, by a thin line."""
    rows = [row for row in common_rows(group) if row[0] == basis and worst_error(group, row) < DIVERGES]
    if not rows:
        return
    times = [mean([step(found, row) for found in group]) for row in rows]
    means = [100 * mean_error(group, row) for row in rows]
    if beside:
        panel.plot(times, means, color=COLORS[basis], linestyle=":", lw=1, label=beside + BASES[basis])
        return
    best_and_worst = [[100 * pick(errors(group, row)) for row in rows] for pick in (min, max)]
    panel.fill_between(times, *best_and_worst, color=COLORS[basis], alpha=0.15, lw=0)
    panel.plot(times, means, color=COLORS[basis], marker="o", ms=4, label=BASES[basis])
    for (_, detail), time, value in zip(rows, times, means, strict=True):
        panel.annotate(str(detail), (time, value), (0, 5), textcoords="offset points", ha="center", fontsize=7)


if __name__ == "__main__":
    sys.exit(main())
