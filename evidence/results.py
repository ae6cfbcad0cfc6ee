# SPDX-License-Identifier: GPL-3.0-or-later
"""`make results`: the thesis's table and figures again, from the sample scenes, and what they claim as numbers.

Writes docs/results.md, docs/results.json and docs/images/results: nothing there is written by hand. A draft, or a part
of it all, goes to out/results instead.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path

from project import ROOT

try:
    import bpy
    import claims
    import dynamic_morph_targets
    import measures
    import numpy as np
    import plots
    import results_page
    from contact_sheet import Row, compose, render, save
    from dynamic_morph_targets.core.result import compare
    from dynamic_morph_targets.core.settings import VARIANTS
    from dynamic_morph_targets.write.bake.writer import free, write_keys
    from heat import draw_legend, paint
    from PIL import ImageDraw
    from subjects import SHAPE, SUBJECTS, SWING, Sheet, Shot, Subject, nearest, open_shot
except ImportError as error:
    sys.exit(f"figures: {error}. `make -C evidence results` installs and builds everything first.")

PARTS = ("table", "claims", "accuracy", "sheets")
CELL = (264, 204)
MATERIAL_MODELS = {"linear": "LINEAR", "StVK": "STVK", "stable StVK": "STABLE_STVK"}
MODES = (4, 8, 12, 16, 20, 30, 40, 60)
FITTED_MODES = (8, 16, 20, 30)  # and the scene's own number
FULL = "DMT full"
ITSELF = FULL + claims.ITSELF
SHOWN_MODES = 40  # shape keys of a full bake that is rendered: what they lose is not seen
TABLE = {
    name: changes for name, changes in VARIANTS.items() if changes.get("material_model") in MATERIAL_MODELS.values()
}
ABOUT = {
    claims.PLAIN: "no simulation",
    "static morphs": "geometric morph targets: the shape follows the pose, nothing moves by itself",
    "single material": "the neutral target alone: the same softness in every pose",
    "pose-dependent shape": "after Capell et al. 2005: the shape follows the pose, the softness does not",
    "DMT reduced": "dynamic morph targets: shape and softness follow the pose; simulated in modes",
    "DMT full": "dynamic morph targets, every node of the cage simulated; colors: how far it is from reduced",
    ITSELF: "the same with Self Collision; colors: how far it is from the row above",
}


MEANS = {  # of the colors of a sheet
    SHAPE: "how far the skin is from plain skinning: gray none, red {red}",
    SWING: "how far the skin is from its pose's own shape: gray none, red {red}",
}
SHOW_SHAPES = (claims.PLAIN, "single material", "DMT reduced", FULL)  # the others have the shapes of DMT
LEGEND = 500, 51  # pixels from the left and the top of a sheet


class Work:
    """One scene's shot and the runs that several parts of the page share, each simulated once."""

    def __init__(self, subject: Subject):
        self.subject = subject
        self.shot = open_shot(subject)
        self.measured = self.shot.part(*subject.measured)

    @cached_property
    def table(self) -> dict[str, compare.Run]:
        """The variants of table 5.1, over the measured frames."""
        return self.measured.runs(TABLE)

    @cached_property
    def shown(self) -> dict[str, compare.Run]:
        """The methods side by side, over the whole shot; without the full model where it is too slow."""
        return self.shot.runs(claims.FAST if self.subject.full else claims.SHOWN)

    @cached_property
    def touching_itself(self) -> tuple[Shot, compare.Run]:
        """The full model with Self Collision, over the whole shot."""
        shot = self.shot.touching_itself()
        return shot, shot.runs({ITSELF: claims.SHOWN[FULL]})[ITSELF]

    @cached_property
    def rows(self) -> dict[str, list[tuple[Shot, compare.Run]]]:
        """What contact sheets show of each simulated method: shots and their runs."""
        rows = {name: [(self.shot, run)] for name, run in self.shown.items()}
        for first, last in self.subject.full:
            shot = self.shot.part(first, last)
            rows.setdefault(FULL, []).append((shot, shot.runs({FULL: claims.SHOWN[FULL]})[FULL]))
        return rows if self.subject.full else {**rows, ITSELF: [self.touching_itself]}

    def beside(self, name: str) -> compare.Run | None:
        """The run over the whole shot from which the colors of a row are told, if they are told from one."""
        return self.shown.get({FULL: "DMT reduced", ITSELF: FULL}.get(name, ""))


# Numbers --------------------------------------------------------------------------------------------------------------


def table(work: Work) -> dict:
    """The figures of table 5.1, over the measured frames."""
    return {name: compare.figures(run, work.shot.character) for name, run in work.table.items()}


def measure_claims(work: Work) -> dict:
    return claims.MEASURE[work.subject.name](work.shot, work.shown)


def accuracy(work: Work) -> dict:
    """Reduced against full by number of modes, linear against StVK, and what a tracked vertex does in detail."""
    full = {key: work.table[f"DMT {material_model} full"] for material_model, key in MATERIAL_MODELS.items()}
    compared = {key: (run.motion, run.static) for key, run in full.items()}
    errors: dict[str, dict] = {}
    shot = work.measured
    for name, run in compare.runs(shot.character, shot.rig, shot.settings, sweep(shot)):
        label, _, modes = name.rpartition(" ")
        error = asdict(compare.motion_error(run.motion, *compared[run.character.settings.material_model]))
        errors.setdefault(label, {})[modes] = error | {"steps_per_second": run.report["steps_per_second"]}
    between = compare.motion_error(compared["LINEAR"][0], *compared["STVK"])
    best = best_possible(full["STVK"], shot, errors)
    also = {f"{first} to {last}": asdict(own_error(work.shot.part(first, last))) for first, last in work.subject.also}
    return {
        "reduced": errors,
        "best": best,
        "linear for StVK": asdict(between),
        "also": also,
        "tracked": tracked(work),
    }


def best_possible(full: compare.Run, shot: Shot, errors: dict) -> dict[str, float]:
    """RMS error, of the total displacement, below which no modes can come that hold the targets' shapes: the rest of
    the motion's singular values."""
    apart = (full.motion - full.static).reshape(len(full.motion), -1)
    energies = np.linalg.eigvalsh(apart @ apart.T)[::-1].clip(0)
    counts = sorted({int(modes) for by_modes in errors.values() for modes in by_modes})
    return {str(m): float(np.sqrt(energies[m - shapes(shot) :].sum() / (full.motion**2).sum())) for m in counts}


def shapes(shot: Shot) -> int:
    """How many sculpted shapes the modes must hold."""
    return sum(bool(target.shape.any()) for target in shot.character.targets)


def own_error(shot: Shot) -> compare.MotionError:
    """Of the scene's own reduced StVK model against the unreduced one."""
    runs = shot.runs(
        {
            "full": {"material_model": "STVK", "solver": "FULL"},
            "reduced": {"material_model": "STVK", "solver": "REDUCED"},
        }
    )
    return compare.motion_error(runs["reduced"].motion, runs["full"].motion, runs["full"].static)


def sweep(shot: Shot) -> dict[str, dict]:
    """Reduced variants by number of modes, which must be more than the sculpted shapes."""
    return {
        f"{material_model}{', fitted' if fitted else ''} {modes}": {
            "material_model": key, "solver": "REDUCED", "fit_to_shot": fitted, "modes": modes
        }
        for material_model, key in MATERIAL_MODELS.items()
        for fitted in ((False, True) if material_model == "StVK" else (False,))
        for modes in (sorted({*FITTED_MODES, shot.character.settings.modes}) if fitted else MODES)
        if modes > shapes(shot)
    }  # fmt: skip


def tracked(work: Work) -> dict:
    """The tracked vertex while it rings, at every step: path in meters along the subject's direction, its spectrum."""
    subject = work.subject
    before, first, last = subject.ringing
    shot = work.shot.part(before, last).every_step()
    free = slice((first - before) * work.shot.settings.substeps, None)
    vertex, direction = subject.tracked(shot.rest), np.array(subject.direction)
    variants = {f"{material_model} {solver}": {"material_model": key, "solver": solver.upper()}
                for material_model, key in MATERIAL_MODELS.items() for solver in ("full", "reduced")}  # fmt: skip
    found = {}
    for name, run in shot.runs(variants).items():
        path = (run.motion - run.static)[free, vertex] @ direction
        frequencies, amplitudes = measures.spectrum(path, shot.settings.fps)
        found[name] = {
            "path": path.tolist(),
            "frequencies": frequencies.tolist(),
            "amplitudes": amplitudes.tolist(),
            "dominant": measures.dominant_frequency(path, shot.settings.fps),
            "amplitude": measures.amplitude(path),
        }
    return {"rate": shot.settings.fps, "variants": found}


# Pictures -------------------------------------------------------------------------------------------------------------


def sheets(work: Work, folder: Path) -> dict[str, str]:
    """The subject's contact sheets: figure -> file name. Each method is baked into the open scene and rendered once, in
    Workbench, with the colors of `heat`."""
    pictures = {}
    for name, parts in {claims.PLAIN: [(work.shot, None)], **work.rows}.items():
        pictures[name] = {}
        for shot, run in parts:
            wear(work, run)
            for sheet in work.subject.sheets:
                seen = [
                    frame for frame in sheet.frames if shot.settings.frame_start <= frame <= shot.settings.frame_end
                ]
                pictures[name] |= {
                    frame: colored(work, sheet, frame, far(work, sheet, shot, run, frame, work.beside(name)))
                    for frame in seen
                }
    files = {}
    for sheet in work.subject.sheets:
        files[sheet.figure] = f"figure_{sheet.figure.replace('.', '_')}.png"
        save(lay_out(work, sheet, pictures), folder / files[sheet.figure], small=True)
    return files


def wear(work: Work, run: compare.Run | None) -> None:
    """The open scene with a run's bake, or as the bones alone move it."""
    obj = bpy.data.objects[work.subject.object]
    if run is None:
        free(obj)
    else:
        kept = slice(SHOWN_MODES)
        write_keys(obj, replace(run.bake, coordinates=run.bake.coordinates[:, kept], modes=run.bake.modes[kept]))


def far(
    work: Work, sheet: Sheet, shot: Shot, run: compare.Run | None, frame: int, beside: compare.Run | None
) -> np.ndarray:
    """What the colors of a frame tell (V,), meters; beside another run, how far it is from that."""
    if run is None:
        return np.zeros(len(work.shot.rest))
    k = shot.index(frame)
    if beside:
        reference = beside.bake.displacement(work.shot.index(frame))
    elif sheet.shows == SWING:
        reference = measures.static_shapes(run.character, run.bake.weights[k])
    else:
        reference = 0.0
    return np.linalg.norm(run.bake.displacement(k) - reference, axis=1)


def colored(work: Work, sheet: Sheet, frame: int, lengths: np.ndarray):
    """The open scene in a frame, colored by lengths (V,) in meters."""
    paint(bpy.data.objects[work.subject.object].data, lengths / sheet.red)
    bpy.context.scene.display.shading.show_shadows = False  # they have teeth on skin that bulges
    shot, point = work.shot, sheet.around.get(frame)
    if point is None:
        middle = shot.middle(frame)
    else:
        middle = shot.world(np.zeros_like(shot.rest), frame)[nearest(point)(shot.rest)]
    return render([frame], CELL, "BLENDER_WORKBENCH", focus={frame: middle}, zoom=sheet.zoom)[0]


def lay_out(work: Work, sheet: Sheet, pictures: dict[str, dict]):
    """A sheet with one row for each method; under each picture of a simulated one, the targets that act there."""
    rows = [
        Row(name, ABOUT[name], [shots[frame] for frame in sheet.frames],
            [acting(work.shot, work.shown.get(name.removesuffix(claims.ITSELF)), frame) for frame in sheet.frames])
        for name, shots in pictures.items() if sheet.shows == SWING or name in SHOW_SHAPES
    ]  # fmt: skip
    columns = [f"{frame}: {event}" for frame, event in sheet.frames.items()]
    made = compose(f"Figure {sheet.figure}: {sheet.title}", work.subject.title, columns, rows)
    means = MEANS[sheet.shows].format(red=f"{1000 * sheet.red:g} mm")
    draw_legend(ImageDraw.Draw(made), *LEGEND, means)
    return made


def acting(shot: Shot, run: compare.Run | None, frame: int) -> str:
    """The targets that act at a frame, but for the neutral ones."""
    if run is None:
        return ""
    weights = run.bake.weights[shot.index(frame)]
    named = zip(run.bake.target_names, weights, strict=True)
    return ", ".join(f"{name} {w:.2f}" for name, w in named if w > 0.05 and not name.startswith("Neutral"))


def overview(works: list[Work], engine: str, folder: Path) -> str:
    """Figure 5.1: every character with reduced dynamic morph targets."""
    rows = []
    for work in works:
        subject = work.subject
        open_shot(subject)
        run = work.shown["DMT reduced"]
        wear(work, run)
        focus = {frame: work.shot.middle(frame) for frame in subject.overview}
        pictures = render(list(subject.overview), CELL, engine, focus=focus, zoom=subject.zoom)
        rows.append(Row(subject.title, "", pictures, [acting(work.shot, run, frame) for frame in subject.overview]))
    sheet = compose("Figure 5.1: dynamic morph targets", "Reduced models", [""] * len(rows[0].pictures), rows)
    save(sheet, folder / "figure_5_1.png", small=True)
    return "figure_5_1.png"


def draw_plots(name: str, found: dict, folder: Path) -> None:
    """The plots of one scene's numbers."""
    if "accuracy" in found:
        draw_accuracy(name, found["accuracy"], folder)
    if "claims" in found:
        drawing = DRAW[name](found["claims"])
        plots.save(drawing, folder / f"{name}_claims.svg")


def draw_accuracy(name: str, found: dict, folder: Path) -> None:
    drawing, axes = plots.figure(3)
    kinds = (("rms_total", "RMS error against full", "RMS"), ("max_total", "Largest error against full", "largest"))
    for panel, (kind, title, of) in zip(axes, kinds, strict=False):
        curves = {
            material_model: (list(map(int, errors)), [100 * e[kind] for e in errors.values()])
            for material_model, errors in found["reduced"].items()
        }
        plots.draw(panel, title, curves, "modes", f"% of the {of} displacement", marker="o", ms=4)
        plots.logarithmic(panel)
    ringing = found["tracked"]["variants"]
    curves = {label: (v["frequencies"], [1000 * a for a in v["amplitudes"]]) for label, v in ringing.items()}
    plots.draw(axes[2], "Spectrum of the tracked point", curves, "Hz", "mm")
    axes[2].set_xlim(0, 25)
    plots.save(drawing, folder / f"{name}_accuracy.svg")


def draw_cylinder(found: dict):
    drawing, axes = plots.figure(2)
    curves = {name: (found["bend"], [1e6 * v for v in gained]) for name, gained in found["bulge"].items()}
    plots.draw(axes[0], "Bulge against pose", curves, "bend of the elbow, degrees", "volume gained, cm³")
    poses = [claims.STRAIGHT, claims.FLEXED]
    give = {name: [1000 * found["give"][name][pose] for pose in poses] for name in found["give"]}
    plots.bars(axes[1], "The same push", poses, give, "the skin gives, mm")
    return drawing


def draw_shoulder(found: dict):
    drawing, axes = plots.figure(3)
    for panel, (way, paths) in zip(axes, found["folds"].items(), strict=False):
        curves = {name: (path["frames"], path["pairs"]) for name, path in paths.items()}
        plots.draw(panel, f"Self-intersection, {way}", curves, "frame", "pairs of triangles")
    rest = found["chest"][claims.PLAIN][0]
    curves = {name: (found["lowering"], [1000 * (d - rest) for d in depths]) for name, depths in found["chest"].items()}
    plots.draw(axes[2], "Chest depth as the arm lowers", curves, "frame", "mm over plain skinning's first")
    return drawing


def draw_herbert(found: dict):
    drawing, axes = plots.figure(3)
    split = len(claims.IN_THE_TUCK)
    for panel, part, title in zip(
        axes, (slice(split), slice(split, None)), ("in the tuck", "after the wall"), strict=False
    ):
        curves = {
            name: (found["frames"][part], [1000 * x for x in out["belly"][part]]) for name, out in found["out"].items()
        }
        plots.draw(panel, f"The belly {title}", curves, "frame", "mm outward")
    poses = [claims.UPRIGHT, claims.TUCKED]
    swings = {name: [1000 * swing[pose] for pose in poses] for name, swing in found["swing"].items()}
    plots.bars(axes[2], "The belly under the same shake", poses, swings, "amplitude, mm")
    return drawing


DRAW = {"bulging_cylinder": draw_cylinder, "shoulder": draw_shoulder, "herbert": draw_herbert}


# The page -------------------------------------------------------------------------------------------------------------


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenes", nargs="+", choices=SUBJECTS, default=list(SUBJECTS), help="default: all")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS, help="parts of the page; default: all")
    parser.add_argument("--draft", action="store_true", help="render with Workbench: faster, plainer")
    parser.add_argument("--page", action="store_true", help="write the page again from docs/results.json")
    args = parser.parse_args()
    if args.page:
        results_page.write_again(ROOT / "docs")
        return 0
    complete = not args.draft and set(args.only) == set(PARTS) and set(args.scenes) == set(SUBJECTS)
    dynamic_morph_targets.register()
    make(args, ROOT / "docs" if complete else ROOT / "out" / "results")
    return 0


def make(args, folder: Path) -> None:
    images = folder / "images" / "results"
    engine = "BLENDER_WORKBENCH" if args.draft else "CYCLES"
    found, pictures, works = {}, {}, []
    for name in args.scenes:
        work = Work(SUBJECTS[name])
        works.append(work)
        found[name] = {}
        for part, measure in (("table", table), ("claims", measure_claims), ("accuracy", accuracy)):
            if part in args.only:
                found[name][part] = timed(f"{name}: {part}", measure, work)
        draw_plots(name, found[name], images)
        if "sheets" in args.only:
            pictures |= timed(f"{name}: contact sheets", sheets, work, images)
    if "sheets" in args.only:
        pictures["5.1"] = timed("overview", overview, works, engine, images)
    results_page.write(folder, compare.machine(), found, pictures)
    print(f"written to {folder.relative_to(ROOT)}")


def timed(what: str, function, *arguments):
    began = time.perf_counter()
    result = function(*arguments)
    print(f"{what}: {time.perf_counter() - began:.0f} s", flush=True)
    return result


if __name__ == "__main__":
    sys.exit(main())
