# SPDX-License-Identifier: GPL-3.0-or-later
"""What the subcommands do."""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, fields
from itertools import combinations
from pathlib import Path
from types import MappingProxyType

import bpy
import numpy as np

from ..core import engine, errors
from ..core.errors import FileInUseError, InputError
from ..core.material import fit, oscillation
from ..core.result import compare
from ..core.settings import MOST_SUBSTEPS, VARIANTS, Material, ModelSettings
from ..io import cache_dir, disk, outputs, paths, report_page
from ..run.bake import bake_input, batch, export_actions, full_comparison
from ..run.bake.job import Job
from ..scene import skin
from ..scene.character import extract
from ..scene.check import checks
from ..scene.motion import colliders, run_settings
from ..scene.properties.bake_properties import DynamorphCollision, DynamorphOutput, DynamorphSimulation
from ..scene.read import mesh_data
from ..scene.read.source import Source
from ..scene.skinning import Skinning
from ..scene.store import model_store
from ..write.bake import writer
from ..write.export import blend_file, exports, losses, process
from . import collision, names, signals
from .help import without_buttons
from .parsers import number
from .record import Done, ProgressPrinter, print_table

SETTABLE = (*(field.name for field in fields(Material)), "fade_out_angle", "amount")  # properties of a target
# Properties with an option that does more than to set them, or that no number or word can set.
NOT_ALIKE = {
    "use_scene_range", "frame_start", "frame_end", "substeps", "format", "use", "collection", "use_self",
    "use_friction",
}  # fmt: skip
# All other properties of the panels are options of the same name. Of the model's, those that the engine knows.
PANELS = {"simulation": DynamorphSimulation, "collision": DynamorphCollision, "output": DynamorphOutput}
SETTINGS = {"model": tuple(field.name for field in fields(ModelSettings))} | {
    part: tuple(name for name in group.__annotations__ if name not in NOT_ALIKE) for part, group in PANELS.items()
}


def check_substeps(args: argparse.Namespace) -> None:
    if args.substeps is not None and not 0 <= args.substeps <= MOST_SUBSTEPS:
        raise InputError(f"--substeps is {args.substeps}: give 1 to {MOST_SUBSTEPS}, or 0 for automatic")


def run_job(args: argparse.Namespace) -> None:
    """bake and build."""
    check_substeps(args)
    objects = names.objects(args)
    folder = args.output.absolute().parent if args.output else Path(bpy.data.filepath).parent
    files = output_files(args, objects, folder)
    for obj in objects:  # everything that may be refused, before any work
        apply_settings(args, obj)
    beside: dict[Path, Path] = {}  # point caches, and where they are until the .blend is saved
    try:
        for group in colliders.pressing(objects) if simulates(args) else [[obj] for obj in objects]:
            for done in work_on(args, group, folder, files, beside):
                say(done)
                args.done.append(done)
        seconds = save(args, beside) if goes_into_blend(args) else 0.0
    finally:
        for written in beside.values():
            disk.discard(written)
    for job in (done.job for done in args.done if not done.skipped):
        print_table(job, seconds)
        if job.input.kept:  # it is saved now
            disk.discard(job.input.kept)


def work_on(
    args: argparse.Namespace,
    objects: list[bpy.types.Object],
    folder: Path,
    files: dict[str, Path],
    beside: dict[Path, Path],
) -> Iterator[Done]:
    """Build or bake an object, or all that press on each other, and write their files for other programs if that is
    asked for; folder, files: where what is written goes; beside: gets the point caches that wait for the .blend.
    """
    caches = cache_dir.CacheDir(args.cache_dir.absolute()) if args.cache_dir else None
    rebuild = args.goal == "BUILD" and caches is None
    goal = "BAKE" if simulates(args) else "BUILD"
    frames = tuple(args.frames) if args.frames else None
    options = {"rebuild": rebuild, "cache_dir": caches, "cache_files": files}
    jobs = args.jobs = [Job(obj, goal, frames, args.substeps, folder, **options) for obj in objects]
    if args.goal == "BUILD" and not goes_into_blend(args) and fits_shot(objects[0]):  # it would go nowhere
        yield from (Done(job, [without_buttons(bake_input.FITTED)], skipped=True) for job in jobs)
        return
    tick = ProgressPrinter(args.progress == "openjd")
    batch.run_all(batch.Batch(jobs, goal), tick)
    for obj, job in zip(objects, jobs, strict=True):
        beside |= job.outcome.beside
        warnings = [*job.warnings, *_worked(args, obj, job, tick, files)]
        yield Done(job, [without_buttons(text) for text in warnings])


def _worked(
    args: argparse.Namespace, obj: bpy.types.Object, job: Job, tick: ProgressPrinter, files: dict[str, Path]
) -> list[str]:
    """What is to be done with a result; returns warnings."""
    warnings: list[str] = []
    if process.leaves_python_out():
        option = "--enable-autoexec" if hasattr(args, "enable_autoexec") else "-y before -c"
        text = "The file has Python, such as drivers, that did not run, so the motion may be another one"
        warnings.append(f"{text}: say {option} if you trust it")
    if args.compare_full:
        batch.run_all(full_comparison.FullComparison(obj), tick)
        job.outcome.report["off_full"] = obj.dynamorph.bake.off_full
    if format_of(args) in exports.FORMATS:
        first, last = job.outcome.bake.frames[[0, -1]] if job.input.is_bake else (0, 0)
        warnings += export(args, obj, files[obj.name], (math.ceil(first), math.floor(last)))
    return warnings


def goes_into_blend(args: argparse.Namespace) -> bool:
    return bool(args.output or args.in_place)


def fits_shot(obj: bpy.types.Object) -> bool:
    return obj.dynamorph.model.settings().fits_shot


def remedy(args: argparse.Namespace) -> str:
    """What to do after a command that was stopped before it saved anything."""
    inputs = [job.input for job in args.jobs if hasattr(job, "input")]
    if any(each.kept and each.kept.exists() for each in inputs):
        return "run it again, and it resumes"
    hint = ". With --cache-dir it resumes" if any(each.resumable and not each.cache_dir for each in inputs) else ""
    return f"run it again{hint}"


def say(done: Done) -> None:
    name = done.job.name
    if done.model_from == "cache":
        print(f"{name}: the model is from the cache folder")
    elif done.model_from == "built":
        print(f"{name}: built because {'; '.join(done.job.input.reasons)}")
    for file in () if done.skipped else done.job.outcome.model_files:
        print(f"{name}: model written to {file}")
    for warning in done.warnings:
        print(f"{name}: warning: {warning}", file=sys.stderr, flush=True)


def apply_settings(args: argparse.Namespace, obj: bpy.types.Object) -> None:
    """Apply the settings of the command line to the object. Raises InputError."""
    for change in args.changes:
        set_property(obj, change)
    if args.compare_full and not (simulates(args) and args.solver != "full"):
        raise InputError(
            "--compare-full compares a reduced bake: leave out --clips actions, --format soft_skin and --solver full"
        )
    for group, settings in SETTINGS.items():
        for name in settings:
            if (value := getattr(args, name, None)) is not None:
                names.check_not_keyed(obj, f"dynamorph.{group}.{name}", f"--{name.replace('_', '-')}")
                setattr(getattr(obj.dynamorph, group), name, value.upper() if isinstance(value, str) else value)
    collision.apply(args, obj, simulates(args))
    if format_of(args) in exports.FORMATS:
        exports.check_settings(obj, format_of(args))
        obj.dynamorph.output.format = "MODES"  # from which files for other programs are made
    elif args.format:
        obj.dynamorph.output.format = format_of(args)


def simulates(args: argparse.Namespace) -> bool:
    """Whether the command simulates a shot, and not only builds: clips are simulated while they are written, and some
    files for other programs need no bake.
    """
    chosen = exports.FORMATS.get(format_of(args))
    return args.goal == "BAKE" and args.clips != "actions" and (chosen is None or chosen.needs_bake)


def format_of(args: argparse.Namespace) -> str:
    return (args.format or "").upper()


def bake_formats() -> list[str]:
    """The forms in which Blender itself can play a bake."""
    output = bpy.types.Object.bl_rna.properties["dynamorph"].fixed_type.properties["output"].fixed_type
    return [item.identifier for item in output.properties["format"].enum_items]


def output_files(args: argparse.Namespace, objects: list[bpy.types.Object], folder: Path) -> dict[str, Path]:
    """The files that --format and --output-file ask for, by mesh name. Raises InputError, ExportError."""
    if args.goal == "BUILD":
        if not (goes_into_blend(args) or args.cache_dir):
            raise InputError("specify an output: --output, --in-place or --cache-dir")
        return {}
    chosen_format = format_of(args)
    chosen = exports.FORMATS.get(chosen_format)
    if args.clips == "actions" and not (chosen and chosen.skins):
        raise InputError("--clips actions needs --format gltf or --format fbx")
    if args.clips == "actions" and args.frames:
        raise InputError("--clips actions takes the frames of each Action: leave --frames out")
    if not (goes_into_blend(args) or chosen):
        raise InputError("specify an output: --output or --in-place, or --format with a file for other programs")
    if args.output_file and not (chosen or chosen_format == "PC2"):
        raise InputError("--output-file needs a --format that is a file")
    if not (args.output_file or chosen):
        return {}
    suffix = chosen.suffix if chosen else f".{chosen_format.lower()}"
    pattern = str(args.output_file or folder / f"{paths.OBJECT}{suffix}")
    if Path(pattern).suffix.lower() != suffix:
        raise InputError(f"--output-file {pattern}: a file of {args.format} ends in {suffix}")
    meshes = [mesh for obj in objects for mesh in (obj, *(() if chosen else skin.attached_meshes(obj)))]
    files = {mesh.name: paths.file_path(pattern, mesh.name) for mesh in meshes}
    if paths.is_shared(files.values()):
        remedy = "give them names that differ more" if paths.OBJECT in pattern else f"put {paths.OBJECT} in its name"
        raise InputError(f"--output-file {pattern}: several meshes would share it: {remedy}")
    for path in files.values():
        check_folder(path)
        try:
            refuse_shared(named_files(args) | {"--output-file": path})
        except InputError:
            if args.report and paths.is_shared((args.report, path)):
                args.report = None
            raise
        if not chosen:  # otherwise `check_place` does
            outputs.try_file(path)
    scene = bpy.context.scene
    for obj in objects if chosen else ():
        frames = scene.frame_start, scene.frame_end  # of clips the size alone is wanted
        if args.clips != "actions":
            frames = run_settings.frame_range(obj, scene, args.frames)
        exports.check_place(obj, chosen_format, files[obj.name], frames)
    return files


FILES = {
    "file": "the .blend", "output": "-o", "report": "--report", "json": "--json", "page": "-o",
    "oscillation": "--oscillation", "force_displacement": "--force-displacement",
}  # fmt: skip


def named_files(args: argparse.Namespace) -> dict[str, Path]:
    """What a command line reads and writes, by how a message names it."""
    found = {title: getattr(args, name).absolute() for name, title in FILES.items() if getattr(args, name, None)}
    if getattr(args, "page", None):
        found["the .json beside -o"] = args.page.absolute().with_suffix(".json")
    return found


def refuse_shared(files: dict[str, Path]) -> None:
    """Raises InputError when a file would be written that is read, or written twice."""
    for (first, one), (second, other) in combinations(files.items(), 2):
        if not paths.is_shared((one, other)):
            continue
        if (first, second) == (FILES["file"], FILES["output"]):
            raise InputError(f"'{other}' is the file that is open: use --in-place to overwrite it")
        raise InputError(f"{first} and {second} are the same file '{other}': choose another one")


def file_state(path: Path) -> tuple[int, ...] | None:
    """What changes when somebody saves a file; None if there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size


def check_folder(path: Path) -> None:
    if not path.parent.is_dir():
        raise InputError(f"there is no folder '{path.parent}' to write '{path.name}' to")


def export(args: argparse.Namespace, obj: bpy.types.Object, path: Path, frames: tuple[int, int]) -> list[str]:
    """Write the bake, or the clips, for other programs; returns warnings."""
    chosen, clips, tick = format_of(args), args.clips.upper(), ProgressPrinter(args.progress == "openjd")
    warnings = [*losses.losses(obj, chosen, clips), *export_actions.export(obj, chosen, path, frames, clips, tick)]
    args.exported.append(path)
    print(f"{obj.name}: written to {path.name}")
    return warnings


def set_property(obj: bpy.types.Object, change: str) -> None:
    """Apply TARGET.PROPERTY=VALUE, a wedge of a farm. The name of a target may contain dots. Raises InputError."""
    where, _, text = change.partition("=")
    name, _, field = where.rpartition(".")
    target = names.target(obj, name, f"--set {change}")
    if field not in SETTABLE:
        raise InputError(f"--set {change}: a target has no '{field}': there are {', '.join(SETTABLE)}")
    names.check_not_keyed(target.id_data, target.path_from_id(field), f"--set {change}")
    try:
        setattr(target, field, number(target.bl_rna.properties[field])(text))
    except argparse.ArgumentTypeError as error:
        raise InputError(f"--set {change}: {error}") from error


def run_collect(args: argparse.Namespace) -> None:
    """Raises ReportPageError when a bake failed or is missing, after the page is written."""
    reports = report_page.read(args.folder)
    wrong = report_page.failures(reports, args.expect)
    page_json = args.page.with_suffix(".json")
    refuse_shared(
        {"the .json beside -o": page_json} | {f"report {name}": args.folder / f"{name}.json" for name in reports}
    )
    disk.save(args.page, report_page.page(reports, wrong).encode(errors="backslashreplace"))
    disk.save(page_json, json.dumps({"reports": reports, "wrong": wrong}, indent=1).encode())
    print(f"{len(reports)} reports in {args.page}")
    if wrong:
        raise errors.ReportPageError("; ".join(wrong))


def run_check(args: argparse.Namespace) -> None:
    """Raises InputError when something is in the way."""
    engine.load()
    in_the_way = 0
    for obj in names.objects(args):
        skinning = Skinning.of(obj)
        found = *checks.problems(skinning), *colliders.problems(obj), *checks.next_steps(obj)
        problems = [problem.text for problem in found]
        notes = []
        if not problems:
            try:
                source = Source.of(skinning)
                extract.read(source)
                notes = extract.warnings(source)
            except engine.expected_errors() as error:
                problems = [errors.sentence(error)]
        for kind, texts in (("error", problems), ("warning", notes)):
            for text in texts:
                print(f"{obj.name}: {kind}: {without_buttons(text)}")
        if not problems:
            print(f"{obj.name}: can be built")
        in_the_way += len(problems)
    if in_the_way:
        raise InputError(f"{in_the_way} problem{'s' * (in_the_way > 1)} found, listed above: fix them and check again")


def run_report(args: argparse.Namespace) -> None:
    check_substeps(args)
    engine.load()
    found: dict[str, dict] = {}
    for obj in names.objects(args):
        frames = tuple(args.frames) if args.frames else None
        job = Job(obj, "BAKE", frames, args.substeps, whole=True, stored=False)
        rig, tick = batch.read_rig(job), ProgressPrinter()

        def progress(fraction: float, message: str, job: Job = job, tick: ProgressPrinter = tick) -> bool:
            tick.show(job.name, fraction, message)
            return True

        variants = {name: VARIANTS[name] for name in args.methods}
        found[obj.name] = compare.compare(job.input.character, rig, job.input.settings, variants, progress)
    for name, compared in found.items():
        print(f"\n{name}\n{compare.table(compared)}")
    if args.json:
        disk.save(args.json, json.dumps(found, indent=1).encode() + b"\n")
        print(f"written to {args.json}")


def run_fit(args: argparse.Namespace) -> None:
    path = args.oscillation or args.force_displacement
    if not path.is_file():
        raise InputError(f"there is no file '{path}'")
    rows = oscillation.read_columns(path, (2, 3, 4) if args.oscillation else (6,))
    if args.oscillation:
        seen = oscillation.oscillation(rows[:, 0], rows[:, 1:])
        print(f"frequency {seen.frequency:.4g} +- {seen.frequency_error:.2g} Hz")
        print(f"decay {seen.decay:.4g} +- {seen.decay_error:.2g} 1/s, settles in {seen.settle:.3g} s")
    for obj in names.objects(args):
        target = names.target(obj, args.target, "--target")
        names.check_group(obj, args.vertex_group, "--vertex-group")
        model, character, index = model_store.fit_input(obj, target)
        patch = None
        if args.vertex_group:
            patch = np.zeros(len(character.vertices))
            patch[character.own_vertices] = mesh_data.group_weights(obj, [args.vertex_group])[:, 0]
        if args.oscillation:
            fitted = fit.fit_oscillation(model, character, index, seen.frequency, seen.decay, patch)
        else:
            fitted = fit.fit_force_displacement(model, character, index, rows[:, :3], rows[:, 3:], patch)
        for name, value in asdict(fitted).items():
            print(f"{obj.name}: {target.name}: {name.replace('_', ' ')} {getattr(target, name):.4g} -> {value:.4g}")
        target.set_material(fitted, by_hand=True)
    save(args)


def run_delete_bake(args: argparse.Namespace) -> None:
    for obj in names.objects(args):
        writer.check_free(obj)
        baked = obj.dynamorph.bake
        removed = f"{len(baked.keys)} baked keys" + (" and the modifier of the point cache" if baked.cache else "")
        for text in writer.free(obj):
            print(f"{obj.name}: warning: {text}", file=sys.stderr, flush=True)
        print(f"{obj.name}: {removed} removed")
    save(args)


def save(args: argparse.Namespace, beside: Mapping[Path, Path] = MappingProxyType({})) -> float:
    """Save the .blend, and give the files of `beside` their names; returns the seconds it took."""
    began = time.perf_counter()
    if args.in_place and args.opened != file_state(Path(bpy.data.filepath)):
        text = "'{path}' was saved by another program meanwhile: nothing was written. Run it again, or say -o"
        raise FileInUseError(text, path=bpy.data.filepath)
    with signals.delayed():
        with outputs.placed(beside):
            blend_file.save(args.output.absolute() if args.output else Path(bpy.data.filepath))
        args.saved = True
    print(f"saved {args.output or bpy.data.filepath}")
    return time.perf_counter() - began
