# SPDX-License-Identifier: GPL-3.0-or-later
"""`make bakes`: docs/bakes.md and its pictures, from characters of ../shared. No number is typed here.

The figures are kept in docs/bakes.json: a section keeps its figures until it is measured again.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from project import ROOT

from assets import require
from bench import machine
from measured import measured_at
from performance_page import grid

PAGE = ROOT / "docs" / "bakes.md"
FIGURES = PAGE.with_suffix(".json")
FARM = ROOT / "build" / "farm" / "farm.json"
LOGS = ROOT / "build" / "reports"
PYTHONS = ROOT / ".venv"
CHARACTERS = ("mh_shoulder_arm_4bones.blend", "mh_male_53bones.blend", "Fox.glb", "Quaternius_Trex.glb")
IMAGES = "images/bakes"
SAME = 1e-6  # body sizes: surfaces nearer than this are one

PAGE_TEXT = """# Bakes, measured

This page measures how exactly a bake shows what was simulated: in every output format, as a loop, over many frames,
after being killed, at other frame rates and on a farm. `make -C evidence bakes` measures and writes this page, its
pictures and [bakes.json](bakes.json); nothing on it is written by hand. Sections keep their figures until they are
measured again: `make -C evidence bakes sections="loops kills"` measures these two.

{commits}

*Body sizes*: of the diagonal of the box around the body at rest. On a person with a size of 2 m, an error of 1e-3 is 2
mm, and one of 1e-6 is 2 micrometers, which nobody can see. Errors are far larger than that only where you ask for fewer
keys. Who made the characters: [Attribution](attribution.md).

"""


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("sections", nargs="*", metavar="SECTION", help=f"of {', '.join(SECTIONS)}; default: all")
    chosen = arguments.parse_args().sections or list(SECTIONS)
    if unknown := set(chosen) - set(SECTIONS):
        arguments.error(f"no such section: {', '.join(sorted(unknown))}")
    require("bakes", CHARACTERS)
    figures = json.loads(FIGURES.read_text(encoding="utf-8")) if FIGURES.exists() else {}
    for section in chosen:
        last = figures.get(section, {})
        if found := SECTIONS[section].measure(section, last):
            figures[section] = last | found
            figures.setdefault("commits", {})[section] = found.get("commit", measured_at(PAGE.name))
        FIGURES.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
        print(f"bakes: {section} measured", flush=True)
    parts = [section.show(figures[name]) for name, section in SECTIONS.items() if figures.get(name)]
    opening = PAGE_TEXT.format(commits=by_commit(figures["commits"]))
    PAGE.write_text(opening + "\n".join(parts).rstrip() + "\n", encoding="utf-8")
    print(f"written to {PAGE.relative_to(ROOT)}")
    return 0


def by_commit(commits: dict[str, str]) -> str:
    """Which sections were measured when; commits: by section."""
    sections: dict[str, list[str]] = {}
    for section, commit in commits.items():
        sections.setdefault(commit, []).append(section.replace("_", " "))
    return "\n".join(f"{commit}: {', '.join(names)}." for commit, names in sections.items())


# Measuring ------------------------------------------------------------------------------------------------------------


def measured(section: str, _last: dict, python: Path | str = sys.executable) -> dict:
    """A section by bakes.py, in a process of its own, whose output goes to a log."""
    LOGS.mkdir(parents=True, exist_ok=True)
    log = LOGS / f"bakes_{section}.log"
    with tempfile.TemporaryDirectory() as folder, log.open("w") as output:
        file = Path(folder) / "figures.json"
        command = [python, Path(__file__).with_name("bakes.py"), section, file]
        if subprocess.run(command, stdout=output, stderr=subprocess.STDOUT, check=False).returncode:
            sys.exit(f"bakes: {section} failed, see {log.relative_to(ROOT)}")
        return json.loads(file.read_text()) | {"machine": machine()}


def in_each_blender(section: str, last: dict) -> dict:
    """By version of Blender."""
    found = [measured(section, last, python) for python in sorted(PYTHONS.glob("3.*/bin/python"))]
    return {each["blender"]: each for each in found}


def of_farm(_section: str, last: dict) -> dict:
    """What `make -C evidence farm-demo` has measured; empty if it was not run here, or on a busy machine when the last
    was not."""
    found = json.loads(FARM.read_text(encoding="utf-8")) if FARM.exists() else {}
    if not found or (last.get("quiet") and not found["quiet"]):
        return {}
    return found | {"machine": machine()}


# Showing --------------------------------------------------------------------------------------------------------------


def where(found: dict) -> str:
    return f"Blender {found['blender']}; {found['machine']}.\n"


def share(value: float | None) -> str:
    """Of something: two digits."""
    return "-" if value is None else f"{value:.1e}" if value else "0"


def megabytes(count: float) -> str:
    return f"{count / 2**20:,.1f} MB" if count < 100 * 2**20 else f"{count / 2**20:,.0f} MB"


def more(count: float) -> str:
    return f"{megabytes(abs(count))} {'more' if count >= 0 else 'less'}"


def kilobytes(count: float) -> str:
    return f"{count / 1024:,.0f} kB"


ROUND_TRIPS = """## Round trips

The shoulder with its arm, {vertices:,} vertices of {size:.2f} m, over {frames} frames with {modes} modes and two
targets. One bake in each form, read back by something else where there is another reader, and compared with the
surface that the engine computed, skinned by NumPy. *Error*: the largest distance of a vertex over all frames, in body
sizes. *Seconds*: to write it, without the simulation. Each version of Blender has a process of its own.

{forms}
### How many keys

{budgets} The last row has every mode and every target. *Said* is the error that the bake reports, and *shown* the error
of Blender's evaluated mesh.

{where}"""


def show_round_trips(by_version: dict) -> str:
    found = list(by_version.values())
    newest = found[-1]
    versions = [f"Blender {version.split()[0]}" for version in by_version]

    def errors(kind: str, k: int) -> list[str]:
        return [share(each[kind][k]["error"]) for each in found]

    forms = [
        (row["form"], row["reader"], *errors("forms", k), *(kilobytes(each["forms"][k]["bytes"]) for each in found),
         *(f"{each['forms'][k]['seconds']:.2f}" for each in found))
        for k, row in enumerate(newest["forms"])
    ]  # fmt: skip
    head = [f"{what}, {version}" for what in ("error", "bytes", "seconds") for version in versions]
    budgets = [
        (str(row["keys"]), share(row["said"]), *errors("budgets", k), kilobytes(row["bytes"]))
        for k, row in enumerate(newest["budgets"])
    ]
    return ROUND_TRIPS.format(
        vertices=newest["vertices"],
        size=newest["size"],
        frames=newest["budgets"][0]["frames"],
        modes=newest["modes"],
        forms=grid(("form", "read by", *head), forms),
        budgets=grid(("keys", "said", *(f"shown, {v}" for v in versions), "bytes"), budgets),
        where=f"Blender {' and '.join(by_version)}; {newest['machine']}.\n",
    )


LOOPS = """## Walks that loop

These are walk cycles as their artists made them, carried forward or around a circle, on soft bodies. *Loop* looks for
the motion that ends as it began. *Without*: how far the last frame is from the first without it. *In place*, *in
velocity* (a frame): what is left with it, by the engine; *shown*: in place, by Blender's evaluated mesh, as seen by
somebody who moves along. *Simulated on*: what is left where the cycle is simulated {repeated} times one after the other
instead. All in body sizes.

![Where a walk begins again, without and with Loop]({images}/seam.png)

{table}
{closed} of {count} close to {same:g}. {open}

![A point of the fox over two and a half cycles, seams in yellow]({images}/motion.svg)

Some bodies, like the T-rex's, find no steady motion by themselves. The loop is found nevertheless:

![The gap pass by pass]({images}/passes.svg)

{where}"""


def show_loops(found: dict) -> str:
    rows = [
        (walk["name"], f"{walk['stiffness'] / 1000:.0f} kPa", f"{walk['frames'][0]} to {walk['frames'][1]}",
         f"{walk['travel']:g}" + (f", {walk['turn']:g}°" if walk["turn"] else ""), share(walk["swing"]),
         share(walk["without"]), share(walk["gap"]), share(walk["velocity_gap"]), share(walk["shown"]),
         share(walk["repeated"]), str(walk["passes"]), f"{walk['seconds']:.2f}")
        for walk in found["walks"]
    ]  # fmt: skip
    still_open = [walk for walk in found["walks"] if walk["reported"] > SAME]
    head = ("", "stiffness", "frames", "travels", "skin moves", "without", "in place", "in velocity", "shown",
            "simulated on", "passes", "seconds")  # fmt: skip
    return LOOPS.format(
        images=IMAGES,
        repeated=found["repeated"],
        table=grid(head, rows),
        count=len(rows),
        closed=len(rows) - len(still_open),
        same=SAME,
        open=" ".join(f"*{walk['name']}* warns: {' '.join(walk['warnings'])}." for walk in still_open),
        where=where(found),
    )


LONG = """## Long bakes

A MakeHuman body of {vertices:,} vertices and {bones} bones runs; baked by the command line to a few shape keys (modes)
and to point caches (PC2), its clothes along with it. *Memory*: the most that the whole process had; to open the file
with its model takes {opened}. A shot is read and simulated in stretches of {stretch:,} frames, so that only the result
grows with it.

{table}
From {before:,} to {last:,} frames a bake to shape keys takes {modes} memory, {keyframes} of it for the keyframes
alone; one to point caches takes {caches}, and writes {file}.

{where}"""


def show_long(found: dict) -> str:
    bakes = found["bakes"]
    rows = [
        (f"{bake['format']}, {bake['frames']:,} frames", megabytes(bake["memory"]), f"{bake['keyframes']:,}",
         megabytes(bake["keyframe_bytes"]), megabytes(bake["file"]) if bake["file"] else "",
         f"{bake['seconds']:.0f}", f"{bake['frames'] / bake['seconds']:.0f}")
        for bake in bakes
    ]  # fmt: skip

    def growth(kind: str, what: str) -> float:
        *_, before, last = (bake[what] for bake in bakes if bake["format"] == kind)
        return last - before

    return LONG.format(
        vertices=found["vertices"],
        bones=found["bones"],
        opened=megabytes(found["opened"]),
        table=grid(("", "memory", "keyframes", "their size", "file", "seconds", "frames a second"), rows),
        stretch=found["stretch"],
        before=bakes[-2]["frames"],
        last=bakes[-1]["frames"],
        modes=more(growth("modes", "memory")),
        keyframes=megabytes(growth("modes", "keyframe_bytes")),
        caches=more(growth("pc2", "memory")),
        file=more(growth("pc2", "file")),
        where=where(found),
    )


KILLS = """## Killed

A bake of {frames:,} frames with `--cache-dir`, ended {count} times by `kill -9` at random moments and started again
each time. It resumed after as many frames as it had kept: {kept}.

| | |
| --- | --- |
| kills survived | {survived} of {count} |
| hash of the result as undisturbed | {hash} |
| number of steps as undisturbed | {steps} |
| unfinished bakes left in the folder | {unfinished} |
| parts of files left by kills while they were written | {part} |

{where}"""


def show_kills(found: dict) -> str:
    same, kept = found["same"], found["kept"]
    return KILLS.format(
        frames=found["frames"],
        count=len(kept),
        survived=len(kept) if all(same.values()) else 0,
        kept=", ".join(f"{frame:,}" for frame in kept),
        hash=f"{yes(same['hash'])} (`{found['hash'][:12]}`)",
        steps=yes(same["steps"]),
        **found["left"],
        where=where(found),
    )


def yes(true: bool) -> str:
    return "yes" if true else "no"


TIMES = """## Frame rates

A soft bar on a foot that sways and tilts for a second. *Error*: the largest difference from steps of
{finest:.2f} ms, of the largest coordinate. Where steps are as long ({same}) the frame rates
differ by {apart}. These are the default steps, and off by {off} with BDF2.

{table}
![Error and length of steps]({images}/order.svg)

{where}"""


def show_times(found: dict) -> str:
    rows = [
        (f"{row['integrator']}, {row['fps']} fps", *map(share, row["errors"]), f"{row['order']:.2f}")
        for row in found["errors"]
    ]
    fps, substeps = found["finest"]
    return TIMES.format(
        finest=1000.0 / (fps * substeps),
        same=", ".join(f"{n} at {fps} fps" for fps, n in found["same_steps"]),
        apart=share(found["apart"]),
        off=share(found["off"]),
        table=grid(("", *(f"{n} substeps" for n in found["substeps"]), "order"), rows),
        images=IMAGES,
        where=where(found),
    )


FARM_TEXT = """## Farm

Shots of two characters in two variants on Slurm, by `make -C evidence farm-demo`: *tasks* are checks, builds, bakes and
one that collects. In the last run a bake and a whole node are killed, so its wall time includes the lost work and the
wait until the loss is noticed. {times}

{table}
{versions}; {machine}.
"""
BUSY = "The machine had other work, so times are left out."


def show_farm(found: dict) -> str:
    rows, quiet = [], found["quiet"]
    for run in found["runs"]:
        faults = run["faults"]
        survived = sum(fault["survived"] for fault in faults.values())
        at = [
            f"{name}: begun on {fault['nodes'][0]}, resumed on {fault['nodes'][-1]} after {fault['resumed']} of "
            f"{run['frames']} frames"
            for name, fault in faults.items()
        ]
        rows.append(
            (run["name"], str(run["nodes"]), str(sum(run["tasks"].values())), str(run["tasks"].get("Bake", 0)),
             f"{run['seconds']:.0f} s" if quiet else "-", f"{run['speed_up']:.2f}" if quiet else "-",
             "; ".join(at) or "none",
             f"{survived} of {len(faults)}" if faults else "", yes(run["hashes_equal"]))
        )  # fmt: skip
    head = ("run", "nodes", "tasks", "bakes", "wall time", "speed-up", "faults", "survived", "same hashes")
    versions = ", ".join(f"{name} {version}" for name, version in found["versions"].items())
    return FARM_TEXT.format(
        table=grid(head, rows), versions=versions, machine=found["machine"], times="" if quiet else BUSY
    )


@dataclass(frozen=True)
class Section:
    """measure(name, last figures) -> figures, which take the place of the last; show(figures) -> Markdown."""

    measure: Callable[[str, dict], dict]
    show: Callable[[dict], str]


SECTIONS = {
    "round_trips": Section(in_each_blender, show_round_trips),
    "loops": Section(measured, show_loops),
    "long": Section(measured, show_long),
    "kills": Section(measured, show_kills),
    "times": Section(measured, show_times),
    "farm": Section(of_farm, show_farm),
}

if __name__ == "__main__":
    sys.exit(main())
