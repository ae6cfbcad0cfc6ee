# SPDX-License-Identifier: GPL-3.0-or-later
"""Command line, the same for two callers:

    blender -b shot.blend -c dynamorph bake --object Body -o baked.blend
    python -m dynamic_morph_targets bake shot.blend --object Body -o baked.blend

Exit codes: 0 done, 2 bad input (trying again will not help), 3 the engine's result failed its check, 70 a fault of this
program, 75 a file could not be read or written (a full disk, a lost network: try again), 130 Ctrl-C.

--report writes what came of a command as JSON, also when it fails. Its keys: docs/file_format.md.
"""

from __future__ import annotations

import argparse
import json
import math
import platform
import signal
import sys
import time
import tomllib
import traceback
from dataclasses import asdict, fields
from pathlib import Path

import bpy
import numpy as np

from . import changes, checks, clips, collect, exports, extract, jobs, materials, model_file, properties, share, sinks
from .scene_data import VARIANTS, Material, ModelSettings

COLLECT = "make one page of many reports; fails when one of them is missing or tells of a failure"
# 70 and 75 as EX_SOFTWARE and EX_TEMPFAIL of sysexits.h.
DONE, BAD_INPUT, SELF_CHECK_FAILED, FAULT, TRY_AGAIN, INTERRUPTED = 0, 2, 3, 70, 75, 130
SETTABLE = (*(field.name for field in fields(Material)), "radius", "influence")  # of a target
MODEL_SETTINGS = tuple(field.name for field in fields(ModelSettings))
SIMULATION_SETTINGS = (
    "samples", "scheme", "gravity", "fields", "begin", "preroll", "preroll_pose", "loop", "keep_outside",
)  # fmt: skip
OUTPUT_SETTINGS = ("keys", "every", "tolerance")
SETTINGS = {"model": MODEL_SETTINGS, "simulation": SIMULATION_SETTINGS, "output": OUTPUT_SETTINGS}


class InputError(ValueError):
    """The command line or the file does not say what to do. The message does."""


def main(argv, opens_file: bool = False) -> int:
    """Run one command and return its exit code. opens_file: the .blend is an argument, not the one already open."""
    try:
        args = parser(opens_file).parse_args(argv)
    except SystemExit as stop:  # argparse has printed why; Blender must not be ended by it
        return stop.code if isinstance(stop.code, int) else BAD_INPUT
    # Blender swallows the first Ctrl-C unless Python's own handler is in place.
    handlers = {
        signal.SIGINT: signal.signal(signal.SIGINT, signal.default_int_handler),
        signal.SIGTERM: signal.signal(signal.SIGTERM, _preempted),
    }
    try:
        return _run(args, opens_file)
    finally:
        for number, handler in handlers.items():
            if handler is not None:  # else it is Blender's own, set in C: Blender ends here anyway
                signal.signal(number, handler)
        sys.stdout.flush()


class Preempted(BaseException):
    """A scheduler wants the machine for something else."""


def _preempted(_number, _frame):
    raise Preempted


def _run(args, opens_file: bool) -> int:
    """Run the command, and report what came of it; returns its exit code."""
    args.done, code, error = [], DONE, ""
    try:
        open_file(args, opens_file)
        args.run(args)
    except Preempted:
        code, error = TRY_AGAIN, "stopped by a signal, nothing was saved: run it again, with --share it goes on"
    except KeyboardInterrupt:
        code, error = INTERRUPTED, "interrupted, nothing was saved"
    except jobs.SelfCheckError as failure:
        code, error = SELF_CHECK_FAILED, f"error: {failure}"
    except OSError as failure:
        code, error = TRY_AGAIN, f"error: {failure}: try again"
    except jobs.expected_errors() as failure:
        code, error = BAD_INPUT, f"error: {failure}"
    except Exception as fault:  # of ours: the report is written all the same
        traceback.print_exc()
        code, error = FAULT, f"fault: {type(fault).__name__}: {fault}"
    if error:
        print(f"dynamorph: {error}", file=sys.stderr)
    if getattr(args, "report", None):
        try:
            model_file.save(args.report, json.dumps(record(args, code, error), indent=1).encode() + b"\n")
        except OSError as failure:
            print(f"dynamorph: error: {failure}: try again", file=sys.stderr)
            return code or TRY_AGAIN
    return code


def record(args, code: int, error: str) -> dict:
    """What --report writes."""
    return {
        "versions": versions(),
        "file": Path(bpy.data.filepath).name,
        "characters": [character_record(job) for job in args.done],
        "exit_code": code,
        "error": error,
    }


def versions() -> dict:
    manifest = tomllib.loads((Path(__file__).parent / "blender_manifest.toml").read_text(encoding="utf-8"))
    return {
        "dynamorph": manifest["version"],
        "blender": bpy.app.version_string,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
    }


def character_record(job) -> dict:
    """What a job made, of one character."""
    found = {
        "name": job.name,
        "built": job.reasons,
        "model": find_model(job.name).content_id,
        "summary": job.model.summary,
        "seconds": {stage: round(seconds, 4) for stage, seconds in job.seconds.items()},
        "warnings": job.warnings,
    }
    if job.bake:
        found["bake"] = {
            "made_from": job.content_id(),
            "hash": clips.digest(job.result),
            "frames": [job.settings.start, job.settings.end],
            "fps": job.settings.fps,
            "substeps": job.settings.substeps,
            "resumed": len(job.resumed.get("coordinates", ())),
            "max_displacement": clips.reach(job.result, job.character.to_bind),
            **{name: value for name, value in job.report.items() if name != "warnings"},
        }
    return found


def find_model(name: str):
    return bpy.context.scene.objects[name].dynamorph.model


def parser(opens_file: bool) -> argparse.ArgumentParser:
    root = argparse.ArgumentParser(
        prog="python -m dynamic_morph_targets" if opens_file else "dynamorph",
        description="Dynamic morph targets: soft skin for rigged characters.",
    )
    commands = root.add_subparsers(title="commands", required=True)

    def command(name, run, text, writes=True):
        sub = commands.add_parser(name, help=text, description=text)
        sub.set_defaults(run=run)
        if opens_file:
            sub.add_argument("file", type=Path, help="the .blend to open")
        chosen = sub.add_mutually_exclusive_group(required=writes)
        chosen.add_argument("--object", action="append", metavar="NAME", help="a soft skin; may be repeated")
        chosen.add_argument("--all", action="store_true", help="every soft skin of the file")
        if writes:
            target = sub.add_mutually_exclusive_group(required=name not in ("build", "bake"))
            target.add_argument("-o", "--output", type=Path, metavar="FILE", help="the .blend to write")
            target.add_argument("--in-place", action="store_true", help="overwrite the .blend that was opened")
        return sub

    check = command("check", run_check, "say what is in the way of a build, and what is not likely to be meant", False)
    bake = command("bake", run_job, "simulate, and write shape keys or files; builds first what is out of date")
    bake.set_defaults(goal="BAKE")
    add_shot(bake)
    add_settings(bake, "simulation", SIMULATION_SETTINGS)
    bake.add_argument("--sink", choices=[name.lower() for name in (*sink_names(), *exports.FORMATS)],
                      help="what the bake becomes: modes, frames, pc2 and mdd play it in Blender, the rest are files "
                      "for other programs; default: the object's own setting")  # fmt: skip
    bake.add_argument("--sink-file", metavar="FILE",
                      help=f"the file of such a sink; {sinks.OBJECT} in it is the object's name; default: that name, "
                      "beside the .blend")  # fmt: skip
    bake.add_argument("--clips", choices=("scene", "actions"), default="scene",
                      help="actions, of gltf and fbx: an animation for each Action of the armature, simulated by "
                      "itself in the place of the scene's frames")  # fmt: skip
    add_settings(bake, "output", OUTPUT_SETTINGS)
    build = command("build", run_job, "build models")
    build.set_defaults(goal="BUILD", frames=None, substeps=None, sink=None, sink_file=None, clips="scene")
    for sub in (bake, build):
        add_settings(sub, "model", MODEL_SETTINGS)
        sub.add_argument("--set", action="append", default=[], metavar="TARGET.PROPERTY=VALUE", dest="changes",
                         help="set a target's property first, as Flexed.stiffness=5e4; may be repeated")  # fmt: skip
        sub.add_argument("--share", type=Path, metavar="FOLDER",
                         help="keep models and unfinished bakes there, and go on with those that are")  # fmt: skip
        sub.add_argument("--progress", choices=("text", "openjd"), default="text", help="how to tell of progress")
    for sub in (check, bake, build):
        sub.add_argument("--report", type=Path, metavar="FILE", help="write what came of it as JSON, even if it fails")
    report = command("report", run_report, "simulate by several methods and compare them", writes=False)
    report.add_argument("--methods", nargs="+", choices=VARIANTS, default=list(VARIANTS), metavar="METHOD",
                        help=f"which to compare, each in quotes; all by default: {', '.join(VARIANTS)}")  # fmt: skip
    report.add_argument("--json", type=Path, metavar="FILE", help="also write all figures, in metres and seconds")
    add_shot(report)
    fit = command("fit", run_fit, "set a target's stiffness and damping as measured; its model must be up to date")
    fit.add_argument("--target", required=True, metavar="NAME", help="the target's name")
    measured = fit.add_mutually_exclusive_group(required=True)
    measured.add_argument("--oscillation", type=Path, metavar="CSV", help="a point let go: seconds, x, y, z")
    measured.add_argument(
        "--force-displacement", type=Path, metavar="CSV", help="pushes: newtons x, y, z, metres x, y, z; mesh's axes"
    )
    fit.add_argument("--patch", metavar="GROUP", help="vertex group looked at or pushed; default: the target's region")
    collected = commands.add_parser("collect", help=COLLECT, description=COLLECT)
    collected.set_defaults(run=run_collect)
    collected.add_argument("folder", type=Path, help="with what --report wrote")
    collected.add_argument("--expect", type=int, metavar="N", help="how many reports there should be")
    collected.add_argument("-o", "--page", type=Path, metavar="FILE", required=True,
                           help="the HTML to write, with a .json of the same name beside it")  # fmt: skip
    command("free", run_free, "remove bakes and restore the target keys")
    command("info", run_info, "print what the file holds", writes=False)
    return root


def add_shot(sub):
    sub.add_argument("--frames", type=int, nargs=2, metavar=("START", "END"), help="instead of the file's range")
    sub.add_argument("--substeps", type=int, help="steps a frame; default: the object's own setting (0: automatic)")


def add_settings(sub, part: str, names):
    """Settings of a panel by the same names; what is given is set on the object first."""
    settings = bpy.types.Object.bl_rna.properties["dynamorph"].fixed_type.properties[part].fixed_type.properties
    for name in names:
        setting = settings[name]
        option, text = f"--{name.replace('_', '-')}", setting.description.replace("%", "%%")
        if setting.type == "BOOLEAN":
            sub.add_argument(option, action=argparse.BooleanOptionalAction, help=text)
        elif setting.type == "ENUM":
            sub.add_argument(option, choices=[item.identifier.lower() for item in setting.enum_items], help=text)
        else:
            sub.add_argument(option, type=number(setting), help=text)


def number(setting):
    """A parser of numbers that Blender would not quietly move into the setting's range."""

    def parse(text: str):
        value = {"INT": int, "FLOAT": float}[setting.type](text)
        if not setting.hard_min <= value <= setting.hard_max:
            raise argparse.ArgumentTypeError(f"{text} is not between {setting.hard_min:g} and {setting.hard_max:g}")
        return value

    return parse


def open_file(args, opens_file: bool):
    """Make sure that the .blend is open, and that the result can be written, before any work."""
    if args.run == run_collect:
        return
    if opens_file:
        if not args.file.is_file():
            raise InputError(f"there is no file '{args.file}'")
        try:
            bpy.ops.wm.open_mainfile(filepath=str(args.file.resolve()))
        except RuntimeError as error:
            raise InputError(f"'{args.file}' cannot be opened: {error}") from error
    if not bpy.data.filepath:  # Blender goes on with an empty scene when its file is missing
        raise InputError("no .blend is open: name one that exists before -c")
    output = getattr(args, "output", None)
    if output is None:
        return
    if not output.resolve().parent.is_dir():
        raise InputError(f"there is no folder '{output.resolve().parent}' to write '{output.name}' to")
    if output.resolve() == Path(bpy.data.filepath).resolve():
        raise InputError(f"'{output}' is the file that is open: say --in-place to overwrite it")


def check_substeps(args):
    if args.substeps is not None and args.substeps < 1:
        raise InputError(f"--substeps is {args.substeps}: give 1 or more")


def run_job(args):
    """bake and build."""
    check_substeps(args)
    objects = chosen_objects(args)
    folder = args.output.resolve().parent if args.output else Path(bpy.data.filepath).parent
    files = sink_files(args, objects, folder)
    for obj in objects:  # all that may be refused, before any work
        apply_settings(args, obj)
    shared = share.Share(args.share.resolve()) if args.share else None
    for obj in objects:
        frames = tuple(args.frames) if args.frames else None
        rebuild = args.goal == "BUILD" and shared is None
        goal = "BUILD" if args.clips == "actions" else args.goal  # the clips are simulated as they are written
        job = jobs.Job(obj, goal, frames, args.substeps, folder, rebuild, shared)
        job.cache_files = files
        jobs.run(job, Progress(args.progress == "openjd"))
        if sink_of(args) in exports.FORMATS:
            export(args, obj, job, files[obj.name])
        for reason in job.reasons:
            print(f"{job.name}: built: {reason}")
        if job.rehearsed:
            print(f"{job.name}: {job.rehearsed}")
        for warning in job.warnings:
            print(f"{job.name}: warning: {warning}")
        args.done.append(job)
    seconds = save(args) if args.output or args.in_place else 0.0
    for job in args.done:
        print_table(job, seconds)
        if job.kept:  # it is saved now
            job.kept.unlink(missing_ok=True)


def apply_settings(args, obj):
    """Set on the object what the command line says. Raises InputError."""
    for change in args.changes:
        set_property(obj, change)
    for group, names in SETTINGS.items():
        for name in names:
            if (value := getattr(args, name, None)) is not None:
                setattr(getattr(obj.dynamorph, group), name, value.upper() if isinstance(value, str) else value)
    if args.sink:  # files for other programs are made of the modes
        obj.dynamorph.output.sink = "MODES" if sink_of(args) in exports.FORMATS else sink_of(args)


def sink_of(args) -> str:
    return (args.sink or "").upper()


def sink_names() -> list[str]:
    """What can play a bake in Blender."""
    output = bpy.types.Object.bl_rna.properties["dynamorph"].fixed_type.properties["output"].fixed_type
    return [item.identifier for item in output.properties["sink"].enum_items]


def sink_files(args, objects, folder: Path) -> dict[str, Path]:
    """The files that --sink and --sink-file ask for, by the names of their meshes. Raises InputError, ExportError."""
    if args.goal == "BUILD":
        if not (args.output or args.in_place or args.share):
            raise InputError("say where the model goes: --output, --in-place or --share")
        return {}
    sink = sink_of(args)
    chosen = exports.FORMATS.get(sink)
    if args.clips == "actions" and not (chosen and chosen.skins):
        raise InputError("--clips actions is for --sink gltf and --sink fbx")
    if args.clips == "actions" and args.frames:
        raise InputError("--clips actions takes the frames of each Action: leave --frames out")
    if not (args.output or args.in_place or chosen):
        raise InputError("say where the bake goes: --output or --in-place, or --sink with a file for other programs")
    if args.sink_file and not (chosen or sink in clips.CACHES):
        raise InputError("--sink-file is for a --sink that is a file")
    if not (args.sink_file or chosen):
        return {}
    suffix = chosen.suffix if chosen else f".{sink.lower()}"
    pattern = args.sink_file or str(folder / f"{sinks.OBJECT}{suffix}")
    if Path(pattern).suffix.lower() != suffix:
        raise InputError(f"--sink-file {pattern}: a file of {args.sink} ends in {suffix}")
    meshes = [mesh for obj in objects for mesh in (obj, *(() if chosen else properties.clothes_in(obj)))]
    files = {mesh.name: sinks.file_path(pattern, mesh.name) for mesh in meshes}
    if len(set(files.values())) < len(files):
        raise InputError(f"--sink-file {pattern}: several meshes would share it, put {sinks.OBJECT} in its name")
    for path in files.values():
        if not path.parent.is_dir():
            raise InputError(f"there is no folder '{path.parent}' to write '{path.name}' to")
    for obj in objects if chosen else ():
        exports.check_place(obj, sink, files[obj.name])
    return files


def export(args, obj, job, path: Path):
    """Write the bake for other programs."""
    sink, takes, tick = sink_of(args), args.clips.upper(), Progress(args.progress == "openjd")
    job.warnings += exports.losses(obj, sink, takes)
    first, last = job.result.frames[[0, -1]] if job.bake else (0, 0)
    job.warnings += exports.export(obj, sink, path, (math.ceil(first), math.floor(last)), takes, tick)
    print(f"{job.name}: written to {path.name}")


def set_property(obj, change: str):
    """TARGET.PROPERTY=VALUE, a wedge of a farm; the name of a target may have dots in it. Raises InputError."""
    where, _, text = change.partition("=")
    name, _, field = where.rpartition(".")
    target = obj.dynamorph.targets.get(name)
    if target is None:
        names = ", ".join(target.name for target in obj.dynamorph.targets)
        raise InputError(f"--set {change}: '{obj.name}' has no target named '{name}': it has {names}")
    if field not in SETTABLE:
        raise InputError(f"--set {change}: a target has no '{field}': there are {', '.join(SETTABLE)}")
    try:
        setattr(target, field, number(target.bl_rna.properties[field])(text))
    except (ValueError, argparse.ArgumentTypeError) as error:
        raise InputError(f"--set {change}: {error}") from error


def run_collect(args):
    """Raises CollectError when a bake failed or is missing, after the page is written."""
    reports = collect.read(args.folder)
    wrong = collect.failures(reports, args.expect)
    model_file.save(args.page, collect.page(reports, wrong).encode())
    model_file.save(args.page.with_suffix(".json"), json.dumps({"reports": reports, "wrong": wrong}, indent=1).encode())
    print(f"{len(reports)} reports in {args.page}")
    if wrong:
        raise collect.CollectError("; ".join(wrong))


def run_check(args):
    """Raises InputError when something is in the way."""
    jobs.engine()
    in_the_way = 0
    for obj in chosen_objects(args):
        problems = [problem.text for problem in (*checks.problems(obj), *checks.next_steps(obj))]
        notes = []
        if not problems:
            try:
                notes = extract.warnings(obj, extract.character(obj))
            except jobs.expected_errors() as error:
                problems = [str(error)]
        for kind, texts in (("error", problems), ("warning", notes)):
            for text in texts:
                print(f"{obj.name}: {kind}: {text}")
        if not problems:
            print(f"{obj.name}: can be built")
        in_the_way += len(problems)
    if in_the_way:
        raise InputError(f"{in_the_way} problem{'s' * (in_the_way > 1)} in the way, listed above")


def run_report(args):
    check_substeps(args)
    jobs.engine()  # says what is missing
    from . import report

    found = {}
    for obj in chosen_objects(args):
        job = jobs.Job(obj, "BAKE", frames=tuple(args.frames) if args.frames else None, substeps=args.substeps)
        job.prepare()
        tick = Progress()

        def progress(fraction, message, job=job, tick=tick):
            job.fraction, job.message = fraction, message
            tick(job)
            return True

        variants = {name: VARIANTS[name] for name in args.methods}
        found[obj.name] = report.compare(job.character, job.rig, job.settings, variants, progress)
    for name, compared in found.items():
        print(f"\n{name}\n{report.table(compared)}")
    if args.json:
        args.json.write_text(json.dumps(found, indent=1) + "\n")
        print(f"written to {args.json}")


def run_fit(args):
    path = args.oscillation or args.force_displacement
    if not path.is_file():
        raise InputError(f"there is no file '{path}'")
    rows = materials.read_columns(path, (2, 3, 4) if args.oscillation else (6,))
    if args.oscillation:
        seen = materials.oscillation(rows[:, 0], rows[:, 1:])
        print(f"frequency {seen.frequency:.4g} +- {seen.frequency_error:.2g} Hz")
        print(f"decay {seen.decay:.4g} +- {seen.decay_error:.2g} 1/s, settles in {seen.settle:.3g} s")
    for obj in chosen_objects(args):
        target = obj.dynamorph.targets.get(args.target)
        if target is None:
            raise InputError(f"'{obj.name}' has no target named '{args.target}'")
        if args.patch and args.patch not in obj.vertex_groups:
            raise InputError(f"'{obj.name}' has no vertex group named '{args.patch}'")
        subject = jobs.fit_input(obj, target)
        patch = None
        if args.patch:
            patch = np.zeros(len(subject[1].vertices))
            patch[subject[1].own] = extract.group_weights(obj, [args.patch])[:, 0]
        if args.oscillation:
            fitted = materials.fit_oscillation(*subject, seen.frequency, seen.decay, patch)
        else:
            fitted = materials.fit_force_displacement(*subject, rows[:, :3], rows[:, 3:], patch)
        for name, value in asdict(fitted).items():
            print(f"{obj.name}: {target.name}: {name.replace('_', ' ')} {getattr(target, name):.4g} -> {value:.4g}")
        target.set_material(fitted, by_hand=True)
    save(args)


def run_free(args):
    for obj in chosen_objects(args):
        sinks.check(obj)
        baked = obj.dynamorph.bake
        removed = f"{len(baked.keys)} baked keys" + (" and what plays the point cache" if baked.cache else "")
        sinks.free(obj)
        print(f"{obj.name}: {removed} removed")
    save(args)


def run_info(args):
    for obj in chosen_objects(args):
        settings = obj.dynamorph
        print(f"{obj.name}: {', '.join(target.name for target in settings.targets)}")
        print(f"  model: {settings.model.summary or 'none'}")
        try:
            reasons = "; ".join(jobs.stale_reasons(obj, extract.character(obj))) or "up to date"
        except jobs.expected_errors() as error:
            reasons = str(error)
        print(f"  state: {reasons}")
        if not settings.bake.exists:
            print("  bake: none")
            continue
        print(f"  bake: {len(settings.bake.keys)} keys, {settings.bake.summary}")
        print(f"  bake made from {settings.bake.content_id[:12]}, result {settings.bake.digest[:12]}")
        changes.look_at_animation(obj)
        print(f"  bake state: {'; '.join(changes.outdated(obj)) or 'up to date'}")


def chosen_objects(args) -> list:
    """The objects that --object or --all name."""
    if not args.object:
        found = properties.soft_skins(bpy.context.scene.objects)
        if not found:
            raise InputError(f"scene '{bpy.context.scene.name}' has no soft skin: press Add Soft Skin in Blender first")
        return found
    missing = [name for name in args.object if name not in bpy.context.scene.objects]
    if missing:
        raise InputError(f"scene '{bpy.context.scene.name}' has no object named '{missing[0]}'")
    return [bpy.context.scene.objects[name] for name in args.object]


def save(args) -> float:
    """Save the .blend; returns the seconds it took."""
    began = time.perf_counter()
    path = str(args.output.resolve()) if args.output else bpy.data.filepath
    try:
        bpy.ops.wm.save_as_mainfile(filepath=path, copy=args.output is not None)
    except RuntimeError as error:
        raise OSError(f"'{path}' cannot be saved: {str(error).strip()}") from error
    print(f"saved {args.output or bpy.data.filepath}")
    return time.perf_counter() - began


class Progress:
    """Prints a line at each tenth, not at each tick; openjd: each hundredth, for Open Job Description's farms."""

    def __init__(self, openjd=False):
        self.openjd = openjd
        self.step = 1 if openjd else 10
        self.percent = -1

    def __call__(self, job):
        percent = int(100 * job.fraction) // self.step * self.step
        if percent > self.percent:
            self.percent = percent
            print(f"{job.name}: {percent:3d} %  {job.message}", flush=True)
            if self.openjd:
                print(f"openjd_progress: {percent}\nopenjd_status: {job.name}: {job.message}", flush=True)


def print_table(job, save_seconds: float):
    made = job.model.summary
    rows = [(name, made[name.lower()]) for name in ("Nodes", "DOFs", "Modes", "Targets")]
    if made["seconds"]:  # it was built now
        rows.append(("precompute", f"{sum(made['seconds'].values()):.2f} s"))
    if job.bake:
        rows.append(("frames x substeps", f"{job.settings.end - job.settings.start + 1} x {job.settings.substeps}"))
        rows.append(("steps per second", f"{job.report['steps_per_second']:.0f}"))
        rows.append(("smallest det F", f"{job.report['smallest_det']:.2f}"))
        if "gap" in job.report:
            rows.append(("loop gap", f"{1000 * job.report['gap']:.3g} mm"))
        rows.append(("keys", str(job.report["keys"])))
        if job.report["keys_error"]:
            rows.append(("keys' error", f"{1000 * job.report['keys_error']:.3g} mm"))
        if "seam" in job.report:
            rows.append(("seam", f"{1000 * job.report['seam']:.3g} mm"))
        if "compression_error" in job.report:
            rows.append(("compression error", f"{1000 * job.report['compression_error']:.3g} mm"))
    rows += [(stage, f"{seconds:.2f} s") for stage, seconds in (*job.seconds.items(), ("save", save_seconds))]
    print(f"\n{job.name}")
    for name, value in rows:
        print(f"  {name:<18}{value:>12}")
