# SPDX-License-Identifier: GPL-3.0-or-later
"""Command line, the same for two callers:

    blender -b shot.blend -c dynamorph bake --object Body -o baked.blend
    python -m dynamic_morph_targets bake shot.blend --object Body -o baked.blend

Exit codes: 0 done, 2 bad input (trying again will not help), 3 the engine's result failed its check, 70 a bug in this
program, 75 a file could not be read or written, or memory was short (a full disk, a lost network, another process: try
again), 130 Ctrl-C. A file that can never be written (no such folder, no permission) is bad input, and found before the
work.

--report writes the outcome of a command as JSON, even after a failure. Its keys: docs/report.md.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from functools import partial
from pathlib import Path

import bpy

from ..core import engine, errors
from ..core.errors import InputError
from ..core.settings import VARIANTS
from ..io import disk, outputs, paths
from ..write.export import blend_file, exports
from . import collision, names, signals
from .commands import (
    SETTINGS,
    bake_formats,
    check_folder,
    file_state,
    named_files,
    refuse_shared,
    remedy,
    run_check,
    run_collect,
    run_delete_bake,
    run_fit,
    run_job,
    run_report,
)
from .help import Parser, Version, add_parser, epilog, without_buttons
from .info import run_info
from .parsers import file_of, name_of, number, path_of
from .record import record
from .shape import add_shape

COLLECT = "make one page from many reports; fails if one of them is missing or reports a failure"
# 70 and 75 as EX_SOFTWARE and EX_TEMPFAIL of sysexits.h.
DONE, BAD_INPUT, SELF_CHECK_FAILED, FAULT, TRY_AGAIN, INTERRUPTED = 0, 2, 3, 70, 75, 130


def main(argv: Sequence[str], opens_file: bool = False) -> int:
    """Run one command and return its exit code. opens_file: the .blend is an argument, not the one already open."""
    if isinstance(sys.stdout, io.TextIOWrapper):  # a log on Windows may not have all letters of all names
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        args = parser(opens_file).parse_args(argv)
    except SystemExit as end:  # the parser has printed why; Blender must not be ended by it
        return end.code if isinstance(end.code, int) else BAD_INPUT
    args.command = list(argv)
    with signals.raised(), silenced(args.quiet):
        return _run(args, opens_file)


def _run(args: argparse.Namespace, opens_file: bool) -> int:
    """Run the command and write its report; returns its exit code."""
    args.jobs, args.done, args.exported, args.saved = [], [], [], False
    code, error = DONE, ""
    try:
        with signals.propagated():
            open_file(args, opens_file)
            signals.check()
            with names.scene(args):
                args.run(args)
            sys.stdout.flush()  # its disk may be full, too
    except signals.Preempted:
        state = "it was saved before" if args.saved else f"nothing was saved: {remedy(args)}"
        code, error = TRY_AGAIN, f"stopped by a signal, {state}"
    except KeyboardInterrupt:
        code, error = INTERRUPTED, f"interrupted, {'it was saved before' if args.saved else 'nothing was saved'}"
    except errors.SelfCheckError as failure:
        code, error = SELF_CHECK_FAILED, f"error: {failure}"
    except (OSError, MemoryError) as failure:
        code, error = outcome(failure)
    except engine.expected_errors() as failure:
        code, error = BAD_INPUT, f"error: {without_buttons(errors.sentence(failure))}"
    except Exception as fault:  # a bug: the report is written nevertheless
        with suppress(OSError):
            traceback.print_exc()
        code, error = FAULT, f"fault: {type(fault).__name__}: {fault}"
    tell(error)
    if getattr(args, "report", None):
        signals.ignore()  # the work is done, or has failed
        try:
            disk.save(args.report, json.dumps(record(args, code, error), indent=1).encode() + b"\n")
        except (OSError, errors.WriteError) as failure:  # the second for a path that is too long
            unwritten, text = outcome(failure)
            if text != error:
                tell(text)
            return code or unwritten
    return code


@contextmanager
def silenced(quiet: bool) -> Iterator[None]:
    """If it is quiet: nothing is printed to standard output, by Blender neither."""
    try:
        kept = os.dup(1) if quiet else None
        sys.stdout.flush()
    except OSError:  # it is closed, or its disk is full: what is printed next will say so
        kept = None
    if kept is None:
        yield
        return
    with Path(os.devnull).open("w", encoding="utf-8", errors="replace") as nowhere, redirect_stdout(nowhere):
        os.dup2(nowhere.fileno(), 1)
        try:
            yield
        finally:
            os.dup2(kept, 1)
            os.close(kept)


def tell(error: str) -> None:
    """Print it, if there is one and somebody who reads it."""
    with suppress(OSError):
        sys.stdout.flush()
    with suppress(OSError):
        if error:
            print(f"dynamorph: {error}", file=sys.stderr, flush=True)


def outcome(failure: OSError | MemoryError | errors.WriteError) -> tuple[int, str]:
    """The exit code and the message when the system refuses something."""
    text = f"error: {errors.sentence(failure)}"
    if not errors.is_transient(failure):
        return BAD_INPUT, text
    return TRY_AGAIN, text if text.endswith("try again") else f"{text}: try again"


def parser(opens_file: bool) -> argparse.ArgumentParser:
    root = Parser(
        prog="python -m dynamic_morph_targets" if opens_file else "dynamorph",
        description="Dynamic morph targets: soft skin for rigged characters.",
        epilog=epilog("bake", opens_file),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    root.add_argument("--version", action=Version, nargs=0, help="print the versions of Dynamorph and Blender")
    root.set_defaults(quiet=False, scene=None)
    commands = root.add_subparsers(title="commands", required=True)
    command = partial(add_command, commands, opens_file)
    add_report_file(command("check", run_check, "list problems that prevent a build or look unintended", writes=False))
    add_bake(command)
    add_build(command)
    add_report(command)
    add_fit(command)
    add_shape(command)
    add_collect(commands, opens_file)
    command("delete-bake", run_delete_bake, "delete bakes and restore the target keys")
    command("info", run_info, "print the contents of the file", writes=False)
    return root


def add_quiet(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--quiet", action="store_true",
                     help="print nothing but warnings and errors, Dynamorph's and Blender's")  # fmt: skip


def add_command(
    commands: argparse._SubParsersAction,
    opens_file: bool,
    name: str,
    run: Callable[[argparse.Namespace], None],
    text: str,
    writes: bool = True,
) -> argparse.ArgumentParser:
    """A command that works on soft skins of a .blend. writes: it changes the file."""
    sub = add_parser(commands, opens_file, name, text)
    sub.set_defaults(run=run)
    if opens_file:
        sub.add_argument("file", type=path_of, help="the .blend to open")
        sub.add_argument(
            "--enable-autoexec", action="store_true", help="let Python in the .blend, such as drivers, run"
        )
    chosen = sub.add_mutually_exclusive_group(required=writes)
    chosen.add_argument("--object", action="append", type=name_of, metavar="NAME", help="a soft skin; may be repeated")
    chosen.add_argument("--all", action="store_true", help="every soft skin of the scene")
    sub.add_argument("--scene", type=name_of, metavar="NAME", help="the scene of the file, if not the one it shows")
    if writes:
        target = sub.add_mutually_exclusive_group(required=name not in ("build", "bake"))
        target.add_argument("-o", "--output", type=file_of, metavar="FILE", help="the .blend to write")
        target.add_argument("--in-place", action="store_true", help="overwrite the .blend that was opened")
        add_quiet(sub)
    return sub


def add_bake(command: Callable[..., argparse.ArgumentParser]) -> None:
    bake = command("bake", run_job, "simulate, and write shape keys or files; outdated models are built first")
    bake.set_defaults(goal="BAKE")
    add_shot(bake)
    add_settings(bake, "simulation")
    collision.add_options(bake)
    add_settings(bake, "collision")
    bake.add_argument("--format", choices=[name.lower() for name in (*bake_formats(), *exports.FORMATS)],
                      help="the form of the bake: Blender plays modes and pc2, the others are files for "
                      "other programs; default: the object's own setting")  # fmt: skip
    bake.add_argument("--output-file", type=path_of, metavar="FILE",
                      help=f"the file of such a format; {paths.OBJECT} in it stands for the object's name; default: "
                      "that name, beside the .blend")  # fmt: skip
    bake.add_argument("--clips", choices=("scene", "actions"), default="scene",
                      help="which animations a gltf or fbx has: that of the scene's frames, or one per Action of the "
                      "armature, each simulated on its own; default: %(default)s")  # fmt: skip
    add_settings(bake, "output")
    bake.add_argument("--compare-full", action="store_true",
                      help="also say how far the reduced motion is from that of --solver full")  # fmt: skip
    add_model(bake)


def add_build(command: Callable[..., argparse.ArgumentParser]) -> None:
    build = command("build", run_job, "build models")
    build.set_defaults(goal="BUILD", frames=None, substeps=None, format=None, output_file=None, clips="scene",
                       compare_full=False)  # fmt: skip
    add_model(build)


def add_report(command: Callable[..., argparse.ArgumentParser]) -> None:
    report = command("report", run_report, "simulate by several methods and compare them", writes=False)
    report.add_argument("--methods", nargs="+", choices=VARIANTS, default=list(VARIANTS), metavar="METHOD",
                        help=f"which to compare, each in quotes; all by default: {', '.join(VARIANTS)}")  # fmt: skip
    report.add_argument("--json", type=file_of, metavar="FILE", help="also write all figures, in meters and seconds")
    add_shot(report)


def add_fit(command: Callable[..., argparse.ArgumentParser]) -> None:
    fit = command("fit", run_fit, "fit a target's stiffness and damping to a measurement; its model must be up to date")
    fit.add_argument("--target", required=True, type=name_of, metavar="NAME", help="the target's name")
    measured = fit.add_mutually_exclusive_group(required=True)
    measured.add_argument("--oscillation", type=path_of, metavar="CSV",
                          help="a point that swings after its release: seconds, x, y, z")  # fmt: skip
    measured.add_argument("--force-displacement", type=path_of, metavar="CSV",
                          help="pushes: newtons x, y, z, meters x, y, z, in the mesh's axes")  # fmt: skip
    fit.add_argument("--vertex-group", type=name_of, metavar="GROUP",
                     help="vertices observed or pushed; default: the target's region")  # fmt: skip


def add_collect(commands: argparse._SubParsersAction, opens_file: bool) -> None:
    """The command that reads reports instead of a .blend."""
    collected = add_parser(commands, opens_file, "collect", COLLECT)
    add_quiet(collected)
    collected.set_defaults(run=run_collect)
    collected.add_argument("folder", type=path_of, help="the folder with the files of --report")
    collected.add_argument("--expect", type=int, metavar="N", help="how many reports there should be")
    collected.add_argument("-o", "--page", type=file_of, metavar="FILE", required=True,
                           help="the HTML to write, with a .json of the same name beside it")  # fmt: skip


def add_model(sub: argparse.ArgumentParser) -> None:
    """Options of the commands that build models."""
    add_settings(sub, "model")
    sub.add_argument("--set", action="append", default=[], type=name_of, metavar="TARGET.PROPERTY=VALUE",
                     dest="changes", help="set a target's property first, for example Flexed.stiffness=5e4; may be "
                     "repeated")  # fmt: skip
    sub.add_argument("--cache-dir", type=path_of, metavar="FOLDER",
                     help="keep models and unfinished bakes in this folder, and continue from those that it "
                     "has")  # fmt: skip
    sub.add_argument("--progress", choices=("text", "openjd"), default="text",
                     help="how to print progress; default: %(default)s")  # fmt: skip
    add_report_file(sub)


def add_report_file(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("--report", type=file_of, metavar="FILE", help="write the outcome as JSON, even after a failure")


def add_shot(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--frames",
        type=int,
        nargs=2,
        metavar=("START", "END"),
        help="first and last frame, instead of the file's range",
    )
    sub.add_argument(
        "--substeps", type=int, help="time steps per frame; default: the object's own setting (0: automatic)"
    )


def add_settings(sub: argparse.ArgumentParser, part: str) -> None:
    """Options for the settings of a panel. The values that are given are set on the object first."""
    settings = bpy.types.Object.bl_rna.properties["dynamorph"].fixed_type.properties[part].fixed_type.properties
    for name in SETTINGS[part]:
        setting = settings[name]
        option = f"--{name.replace('_', '-')}"
        text = f"{setting.name}. {setting.description}".replace("%", "%%")
        if setting.type == "BOOLEAN":
            sub.add_argument(option, action=argparse.BooleanOptionalAction, help=text, dest=name)
        elif setting.type == "ENUM":
            values = {item.identifier.lower(): item.name for item in setting.enum_items}
            meant = ", ".join(f"{value}: {shown}" for value, shown in values.items())
            sub.add_argument(option, choices=list(values), help=f"{text}. {meant}", dest=name)
        else:
            sub.add_argument(option, type=number(setting), help=text, dest=name)


def open_file(args: argparse.Namespace, opens_file: bool) -> None:
    """Make sure, before any work, that the .blend is open and that the result can be written."""
    report, args.report = getattr(args, "report", None), None  # it is not written unless it can be
    if not opens_file and bpy.data.filepath:
        args.file = Path(bpy.data.filepath)
        args.opened = file_state(args.file)
    files = named_files(args)
    if report:
        for title, path in files.items():
            refuse_shared({title: path, "--report": report})
    try_file(report, makes_folder=True)
    args.report = report
    refuse_shared(files)
    try_outputs(args)
    if args.run == run_collect:
        return
    if opens_file:
        if not args.file.is_file():
            raise InputError(f"there is no file '{args.file}'")
        args.opened = file_state(args.file)
        try:
            trusted = {"use_scripts": True} if args.enable_autoexec else {}  # otherwise the preferences decide
            bpy.ops.wm.open_mainfile(filepath=str(args.file.absolute()), **trusted)
        except RuntimeError as error:
            raise InputError(f"'{args.file}' cannot be opened: {error}") from error
    if not bpy.data.filepath:  # Blender goes on with an empty scene when its file is missing
        raise InputError("no .blend is open: name one that exists before -c")
    if getattr(args, "in_place", False):
        if bpy.data.version[:2] > bpy.app.version[:2]:
            newer, running = (".".join(map(str, version[:2])) for version in (bpy.data.version, bpy.app.version))
            text = f"'{bpy.data.filepath}' was saved by Blender {newer}, and {running} keeps only a part of it"
            raise InputError(f"{text}: use that Blender, or say -o with another file")
        outputs.try_file(Path(bpy.data.filepath))
        blend_file.keep_abandoned(Path(os.path.realpath(bpy.data.filepath)))


def try_outputs(args: argparse.Namespace) -> None:
    """Try all files and folders that the command line names for results. Raises InputError, OSError."""
    output = getattr(args, "output", None)
    if output and output.suffix.lower() != ".blend":
        raise InputError(f"-o {output}: the name of a Blender file ends in .blend")
    blend = Path(args.file) if getattr(args, "in_place", False) else output
    if blend and blend.is_symlink() and blend.resolve().parent != blend.parent.resolve():
        text = "'{blend}' is a link to a file in another folder, which needs others beside it: name the file itself"
        raise InputError(text, blend=blend)
    for name in ("page", "output", "json"):
        try_file(getattr(args, name, None), makes_folder=name == "page")
    if getattr(args, "page", None):
        try_file(args.page.with_suffix(".json"))
    if getattr(args, "cache_dir", None):
        outputs.try_folder(args.cache_dir.absolute())


def try_file(path: Path | None, makes_folder: bool = False) -> None:
    """Try one of them, if it is named."""
    if path is None:
        return
    if makes_folder and _all_there(path.absolute()):
        path.absolute().parent.mkdir(parents=True, exist_ok=True)
    check_folder(path.absolute())
    outputs.try_file(path.absolute())


def _all_there(path: Path) -> bool:
    """Whether each folder before a `..` is there: one that the name of an object would make leads somewhere else."""
    return all(Path(*path.parts[:k]).is_dir() for k, part in enumerate(path.parts) if part == "..")
