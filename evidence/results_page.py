# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/results.md and results.json from what `make results` measured. Every number in a sentence comes from there."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import project  # noqa: F401

from claims import BENDING, FLEXED, IN_THE_TUCK, PLAIN, STRAIGHT, TUCKED, UPRIGHT
from measured import measured_at
from subjects import SUBJECTS

IMAGES = "images/results"
TABLE_COLUMNS = {
    "linear full": "Lin.", "linear reduced": "Red. Lin.", "StVK full": "StVK", "StVK reduced": "Red. StVK",
    "stable StVK full": "Stable StVK (default)", "stable StVK reduced": "Red. stable StVK (default)",
}  # fmt: skip
CLOSE = 0.05  # RMS error, relative to the motion, up to which two motions are called alike

OPENING = """# Results

This page tests the claims of the thesis that introduced dynamic morph targets (N. Galoppo, chapter 5). It repeats the
thesis's table and figures with the scenes in `sample_blends`, and gives each claim as a number: a limb bulges and
hardens as it bends, a shoulder folds without passing through itself, and a belly swings, except in the tuck of a dive.
`make -C evidence results` writes this page, its pictures and [results.json](results.json); nothing here is written by
hand. We did not have the thesis's pictures, so which of its figures shows what is our interpretation.

The methods are those of *Advanced > Detail > Method* and of the command line: *plain skinning* (only the bones),
*static morphs* (geometric morph targets), *single material* (only the neutral target), *pose-dependent shape* (the
shape follows the pose, the material does not, after Capell et al. 2005), and *DMT*, dynamic morph targets.

Errors compare the skin's displacement before the bones move it, over all vertices and frames: the RMS distance from the
reference in percent of its RMS displacement, and the largest in percent of its largest. *Total* displacement is from
the neutral shape; *dynamic* is from the targets' blended shapes, and is the stricter measure. *Fitted* modes are chosen
from a rehearsal of the shot. *At best* is a lower bound, from the singular values of the full motion: no choice of the
same number of modes that contain the targets' shapes has a smaller error.

{commit}.
"""

ABOUT_ACCURACY = """This section shows how many modes a scene needs. Rows with few modes show where the error begins to
fall: the scenes themselves use modes that are fitted to the shot, which need far fewer. An error near 100% of the
dynamic motion says that so few modes miss nearly all of it.
"""


def write(folder: Path, machine: str, found: dict, pictures: dict[str, str]) -> None:
    """results.md and results.json in `folder`. found: scene -> part -> numbers; pictures: figure -> file name."""
    commit = measured_at("results.md")
    write_page(folder, machine, found, pictures, commit)
    stored = {"machine": machine, "commit": commit, "scenes": found, "pictures": pictures}
    (folder / "results.json").write_text(as_json(stored), encoding="utf-8")


def write_again(folder: Path) -> None:
    """results.md from the results.json in `folder`: nothing is measured."""
    stored = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    write_page(folder, stored["machine"], stored["scenes"], stored["pictures"], stored["commit"])


def write_page(folder: Path, machine: str, found: dict, pictures: dict[str, str], commit: str) -> None:
    """results.md; commit: the sentence that names it."""
    page = [OPENING.format(commit=commit)]
    page += section("Table 5.1", table(machine, tables)) if (tables := parts(found, "table")) else []
    if "5.1" in pictures:
        page.append(picture("5.1", pictures))
    for name, measured in found.items():
        subject = SUBJECTS[name]
        messages = [picture(sheet.figure, pictures) for sheet in subject.sheets if sheet.figure in pictures]
        if "claims" in measured:
            messages += TELL[name](measured["claims"])
            messages.append(f"![Claims]({IMAGES}/{name}_claims.svg)\n")
        page += section(subject.title, messages) if messages else []
    page += section("Reduced against full, linear against StVK", accuracy(a)) if (a := parts(found, "accuracy")) else []
    folder.mkdir(parents=True, exist_ok=True)
    text = "\n\n".join(map(wrapped, "\n".join(page).rstrip().split("\n\n")))
    (folder / "results.md").write_text(text + "\n", encoding="utf-8")


def wrapped(block: str) -> str:
    """A paragraph in lines of at most 120 characters; whatever else there is as it is."""
    return block if block.startswith(("#", "|", "!", "-")) else textwrap.fill(block, 120, break_on_hyphens=False)


def as_json(stored: dict) -> str:
    """Indented, but each list of numbers on one line."""
    lists = r"\[\s+([^][{}]*?)\s+\]"
    return re.sub(lists, lambda found: f"[{' '.join(found[1].split())}]", json.dumps(stored, indent=1)) + "\n"


def parts(found: dict, part: str) -> dict:
    return {name: measured[part] for name, measured in found.items() if part in measured}


def section(title: str, lines: Iterable[str]) -> list[str]:
    return [f"## {title}\n", *lines]


def picture(figure: str, pictures: dict[str, str]) -> str:
    return f"![Figure {figure}]({IMAGES}/{pictures[figure]})\n"


def grid(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def mm(length: float) -> str:
    return f"{1000 * length:.1f} mm"


def percent(fraction: float) -> str:
    return f"{100 * fraction:.1f} %"


# Table 5.1 ------------------------------------------------------------------------------------------------------------


def table(machine: str, tables: dict[str, dict]) -> list[str]:
    columns = shown_columns(tables)
    head = ("", "bones", "DOF", "modes", "targets", *columns.values(), "precompute")
    rows = []
    for name, measured in tables.items():
        variants, subject = measured, SUBJECTS[name]
        dmt = variants["DMT StVK reduced"]
        speeds = [without_with(variants, kind) for kind in columns]
        counts = [subject.thesis["bones"], str(dmt["dofs"]), str(dmt["modes"]), str(dmt["targets"])]
        rows.append((f"**{subject.title}**", *counts, *speeds, f"{sum(dmt['precompute'].values()):.2f} s"))
        then = subject.thesis
        counts = [then[key] for key in ("bones", "dofs", "modes", "targets")]
        rows.append(("thesis", *counts, *(then.get(kind, "") for kind in columns), f"{then['precompute']} s"))
    note = f"""\
Steps a second *without → with* dynamic morph targets: frames a second at one step a frame, nothing drawn. *Without*
means only the neutral target. Medians over the frames of a bake; {machine}. The thesis measured on a 2.4 GHz Core 2
Duo. *Targets* counts the neutral target once; the shoulder's region at the elbow is simulated with one of its own.
"""
    return [grid(head, rows), note, *marginal(tables), *precompute(tables)]


def shown_columns(tables: dict[str, dict]) -> dict[str, str]:
    """The kinds of models that every scene was measured with, and their titles."""
    return {
        kind: title
        for kind, title in TABLE_COLUMNS.items()
        if all(f"{material} {kind}" in found for found in tables.values() for material in ("single", "DMT"))
    }


def precompute(tables: dict[str, dict]) -> list[str]:
    """What the precompute of each scene consists of."""
    seconds = {name: measured["DMT StVK reduced"]["precompute"] for name, measured in tables.items()}
    stages = dict.fromkeys(stage for found in seconds.values() for stage in found)
    rows = [
        (SUBJECTS[name].title, *(f"{found[stage]:.2f} s" if stage in found else "" for stage in stages),
         f"{sum(found.values()):.2f} s")
        for name, found in seconds.items()
    ]  # fmt: skip
    note = """\
Precompute is the time for the reduced StVK model with all targets, from the skin to the polynomials, on one core. The
scenes fit their modes to the shot. *Rehearsal* is what that takes: an unreduced simulation of the shot, or, for the
shoulder, the polynomials of 40 modes and a simulation in these. [performance.md](performance.md) prints a shorter time
for a shoulder of this size, because that one begins with the tetrahedra, rehearses nothing and uses all cores.
"""
    return [grid(("precompute", *stages, "together"), rows), note]


def without_with(variants: dict, kind: str) -> str:
    return " → ".join(f"{variants[f'{material} {kind}']['steps_per_second']:,.0f}" for material in ("single", "DMT"))


def marginal(tables: dict[str, dict]) -> list[str]:
    """What the targets cost: time of a step with them over that without."""
    columns = shown_columns(tables)
    head = ("time of a step, with targets / without", *columns.values())
    rows = []
    for name, measured in tables.items():
        speed = {n: v["steps_per_second"] for n, v in measured.items()}
        rows.append((SUBJECTS[name].title, *(f"{speed[f'single {k}'] / speed[f'DMT {k}']:.2f}" for k in columns)))
    return [grid(head, rows)]


# What the figures claim -----------------------------------------------------------------------------------------------


def tell_cylinder(found: dict) -> list[str]:
    straight = min(range(len(BENDING)), key=lambda k: abs(found["bend"][k]))
    half = min(range(len(BENDING)), key=lambda k: abs(found["bend"][k] - 50))
    columns = {"bent back": 0, "straight": straight, "half bent": half, "flexed": -1}
    head = ("volume gained over the straight limb, cm³", *(f"{c}, {found['bend'][k]:.0f}°" for c, k in columns.items()))
    volumes = [
        (name, *(f"{1e6 * gained[k]:+.0f}" for k in columns.values())) for name, gained in found["bulge"].items()
    ]
    head_give = ("", "give, straight", "give, flexed", "ratio", "shaken straight", "shaken flexed", "ratio")
    pushed = []
    for name, give in found["give"].items():
        swing = found["swing"][name]
        pushed.append((name, *pair(give), *pair(swing)))
    flexed = {name: gained[-1] for name, gained in found["bulge"].items()}
    dmt, lost = flexed["DMT full"], flexed[PLAIN]
    ratios = {name: give[STRAIGHT] / give[FLEXED] for name, give in found["give"].items() if give[FLEXED]}
    return [
        f"Flexed, plain skinning loses {-1e6 * lost:.0f} cm³ of the limb's volume; dynamic morph targets gain "
        f"{1e6 * dmt:.0f} cm³.\n",
        grid(head, volumes),
        "*Give* is how far the skin at rest yields to the same push (the scene's wind), in its direction; "
        f"*shaken* is the farthest that it leaves its shape. Straight, the limb gives {ratios['DMT full']:.1f} times "
        f"as far as flexed with dynamic morph targets, {ratios['pose-dependent shape']:.2f} times with a "
        "pose-dependent shape; static morphs do not react.\n",
        grid(head_give, pushed),
    ]


def tell_shoulder(found: dict) -> list[str]:
    head = ["self-intersection"]
    for way in found["folds"]:
        head += [f"{way}: pairs", "depth", "frames with any"]
    rows = []
    for name in found["chest"]:
        row = [name]
        for paths in found["folds"].values():
            path = paths[name]
            hit = sum(1 for pairs in path["pairs"] if pairs)
            row += [str(max(path["pairs"])), mm(max(path["depth"])), f"{hit} of {len(path['frames'])}"]
        rows.append(row)
    grown = {name: depths[-1] - depths[0] for name, depths in found["chest"].items()}
    head_chest = ("", "chest depth, arm lowered", "change since raised", "biceps shaken, relaxed", "flexed", "ratio")
    chest = []
    for name, depths in found["chest"].items():
        swing = found["swing"].get(name, {})
        shaken = pair(swing, "relaxed", FLEXED) if swing else ("", "", "")
        chest.append((name, mm(depths[-1]), f"{1000 * grown[name]:+.1f} mm", *shaken))
    return [
        "The table counts intersecting pairs of triangles that share no vertex, and gives the depth of the deepest "
        "vertex in another part of the skin, at worst on the whole path of each fold. Only one target has a folded "
        "elbow; it serves both folds.\n",
        grid(head, rows),
        f"From raised to lowered arm, the depth of the chest changes by {1000 * grown[PLAIN]:+.1f} mm with plain "
        f"skinning and {1000 * grown['DMT reduced']:+.1f} mm with dynamic morph targets.\n",
        grid(head_chest, chest),
    ]


def tell_herbert(found: dict) -> list[str]:
    tuck, wall = slice(len(IN_THE_TUCK)), slice(len(IN_THE_TUCK), None)
    head = ("outward", "belly in the tuck: least", "most", "back in the tuck: least", "most",
            "belly after the wall: least", "most", "back after the wall: least", "most")  # fmt: skip
    rows = []
    for name, out in found["out"].items():
        spans = [out[patch][part] for part in (tuck, wall) for patch in ("belly", "back")]
        rows.append((name, *(mm(end) for span in spans for end in (min(span), max(span)))))
    head_swing = ("the belly under the same shake", UPRIGHT, TUCKED, "ratio")
    return [
        "This is how far the belly and the back stand out from where plain skinning puts them, frames "
        f"{found['frames'][tuck][0]} to {found['frames'][tuck][-1]} and {found['frames'][wall][0]} to "
        f"{found['frames'][wall][-1]}.\n",
        grid(head, rows),
        "This is half the distance that the belly swings about its shape when the body is shaken by the same "
        "centimeter at 4 Hz, in the first and in the tucked pose.\n",
        grid(head_swing, [(name, *pair(swing, UPRIGHT, TUCKED)) for name, swing in found["swing"].items()]),
        "This is the largest number of vertices of trunk and thighs that are inside each other in the tuck, "
        "away from the joint. The scene has Self Collision on; all other rows of this page are without it, as in the "
        "thesis.\n",
        grid(("", "inside"), [(name, str(count)) for name, count in found["inside"].items()]),
    ]


def pair(by_pose: dict[str, float], soft: str = STRAIGHT, stiff: str = FLEXED) -> tuple[str, str, str]:
    """Two lengths and their ratio."""
    ratio = by_pose[soft] / by_pose[stiff] if by_pose[stiff] > 1e-9 else None
    return mm(by_pose[soft]), mm(by_pose[stiff]), f"{ratio:.1f}" if ratio else "-"


TELL: dict[str, Callable[[dict], list[str]]] = {
    "bulging_cylinder": tell_cylinder,
    "shoulder": tell_shoulder,
    "herbert": tell_herbert,
}


# Accuracy -------------------------------------------------------------------------------------------------------------


def accuracy(found: dict[str, dict]) -> list[str]:
    messages = [ABOUT_ACCURACY]
    for name, measured in found.items():
        subject = SUBJECTS[name]
        first, last = subject.measured
        messages.append(f"### {subject.title}, frames {first} to {last}\n")
        messages.append(f"![Accuracy]({IMAGES}/{name}_accuracy.svg)\n")
        messages += [
            errors(measured["reduced"], measured["best"]),
            *verdicts(measured, int(subject.thesis["modes"])),
            ringing(measured["tracked"]),
        ]
    return messages


def errors(reduced: dict[str, dict], best: dict[str, float]) -> str:
    kinds = ("RMS total", "RMS dynamic", "max dynamic")
    head = (
        "modes",
        *(f"{material_model}: {kind}" for material_model in reduced for kind in kinds),
        "StVK, at best: RMS total",
    )
    rows = []
    for modes in sorted({m for by_modes in reduced.values() for m in by_modes}, key=int):
        row = [str(modes)]
        for by_modes in reduced.values():
            error = by_modes.get(modes)
            row += [percent(error[k]) if error else "" for k in ("rms_total", "rms_dynamic", "max_dynamic")]
        rows.append([*row, percent(best[modes])])
    return grid(head, rows)


def verdicts(measured: dict, thesis_modes: int) -> list[str]:
    lines = []
    for material_model, by_modes in measured["reduced"].items():
        enough = next((m for m, e in by_modes.items() if e["rms_total"] <= CLOSE), None)
        most, last = list(by_modes.items())[-1]
        if enough:
            verdict = f"reduced is within {percent(CLOSE)} RMS of full from {enough} modes"
        else:
            verdict = f"with {most} modes reduced is still {percent(last['rms_total'])} RMS from full"
        lines.append(f"- {material_model}: {verdict}; the thesis used {thesis_modes} modes.")
    lines += [
        f"- Frames {frames}: with the scene's own modes reduced StVK is {percent(e['rms_total'])} RMS from full "
        f"({percent(e['rms_dynamic'])} of the dynamic motion)."
        for frames, e in measured["also"].items()
    ]
    apart = measured["linear for StVK"]
    alike = "as good as" if apart["rms_total"] <= CLOSE else "no substitute for"
    lines.append(
        f"- Linear DMT is {alike} StVK here: {percent(apart['rms_total'])} RMS apart, {mm(apart['max'])} at most "
        f"({percent(apart['rms_dynamic'])} of the dynamic motion).\n"
    )
    return lines


def ringing(tracked: dict) -> str:
    head = ("tracked point", "dominant frequency", "amplitude")
    rows = [(n, f"{v['dominant']:.2f} Hz", mm(v["amplitude"])) for n, v in tracked["variants"].items()]
    return grid(head, rows)
