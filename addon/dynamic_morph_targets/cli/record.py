# SPDX-License-Identifier: GPL-3.0-or-later
"""What a run prints and records: progress, tables and the JSON report."""

from __future__ import annotations

import argparse
import platform
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import bpy

from ..core import engine
from ..core.motion import baked
from ..core.time_left import TimeLeft, clock
from ..run.bake.job import Job
from ..run.work.task import Work
from . import signals

FORMAT = 1  # of a report


@dataclass(frozen=True)
class Done:
    """A job that was done. warnings: its own, and those of a file for other programs that was written then. skipped:
    there was nothing to do for it.
    """

    job: Job
    warnings: list[str]
    skipped: bool = False

    @property
    def model_from(self) -> str:
        """Where its model is from: "built" now, the "cache" folder, the "file" that was opened, or "" without one."""
        if self.skipped:
            return ""
        given = self.job.input
        return "cache" if given.cached_model else "built" if given.reasons else "file"


def record(args: argparse.Namespace, code: int, error: str) -> dict:
    """What --report writes."""
    opened = str(args.file.absolute()) if getattr(args, "file", None) else bpy.data.filepath
    return {
        "format": FORMAT,
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
        "host": platform.node(),
        "versions": versions(),
        "command": args.command,
        "file": Path(opened).name,
        "input": opened,
        "written": [str(path) for path in written(args)],
        "characters": [character_record(done) for done in args.done],
        "exit_code": code,
        "error": error,
    }


def written(args: argparse.Namespace) -> list[Path]:
    """The files with results: those for other programs, the .blend, and what belongs to it."""
    found = list(args.exported)
    if args.saved:
        found.append(args.output.absolute() if args.output else Path(bpy.data.filepath))
    for outcome in (done.job.outcome for done in args.done if not done.skipped):
        found += outcome.model_files
        found += [cache for _, cache in outcome.written if cache and args.saved]
    return found


def versions() -> dict:
    return {
        "dynamorph": engine.addon_version(),
        "blender": bpy.app.version_string,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
    }


def character_record(done: Done) -> dict:
    """The result of a job for one character."""
    job = done.job
    found = {"name": job.name, "model_from": done.model_from, "seconds": {}, "warnings": done.warnings}
    if done.skipped:
        return found
    found |= {
        "built": job.input.reasons,
        "model": job.request.target.find().dynamorph.model.content_id,
        "summary": vars(job.outcome.model.summary),
        "seconds": {stage: round(seconds, 4) for stage, seconds in job.progress.seconds.items()},
    }
    if job.input.is_bake:
        found["bake"] = {
            "made_from": job.outcome.content_id,
            "hash": baked.digest(job.outcome.bake),
            "frames": [job.input.settings.frame_start, job.input.settings.frame_end],
            "fps": job.input.settings.fps,
            "speed": job.input.settings.speed,
            "substeps": job.input.settings.substeps,
            "solver": job.input.solver,
            "keyed": list(job.input.keyed),
            "resumed": len(job.input.resumed.get("coordinates", ())),
            "max_displacement": baked.largest_displacement(job.outcome.bake, job.outcome.character.to_bind),
            **{name: value for name, value in job.outcome.report.items() if name != "warnings"},
        }
    return found


class ProgressPrinter:
    """Prints a line at each tenth of the work. openjd: at each hundredth, for farms that use Open Job Description."""

    def __init__(self, openjd: bool = False):
        self.openjd = openjd
        self.step = 1 if openjd else 10
        self.percent = -1
        self.time_left = TimeLeft()

    def __call__(self, work: Work) -> None:
        self.show(work.name, work.fraction, work.message)

    def show(self, name: str, fraction: float, message: str) -> None:
        signals.check()
        self.time_left.learn(time.monotonic(), fraction)
        percent = int(100 * fraction) // self.step * self.step
        if percent > self.percent:
            self.percent = percent
            seconds = self.time_left.seconds
            message = message if seconds is None else f"{clock(seconds)} left  {message}"
            print(f"{name}: {percent:3d} %  {message}", flush=True)
            if self.openjd:
                print(f"openjd_progress: {percent}\nopenjd_status: {name}: {message}", flush=True)


def print_table(job: Job, save_seconds: float) -> None:
    made, report = job.outcome.model.summary, job.outcome.report
    rows = [(name, getattr(made, name.lower())) for name in ("Nodes", "DOFs", "Modes", "Targets")]
    if made.seconds:  # it was built now
        rows.append(("precompute", f"{sum(made.seconds.values()):.2f} s"))
    if job.input.is_bake:
        rows.append(
            (
                "frames x substeps",
                f"{job.input.settings.frame_end - job.input.settings.frame_start + 1} x {job.input.settings.substeps}",
            )
        )
        rows.append(("quality", job.input.solver.capitalize()))
        rows += [("keyed", path) for path in job.input.keyed]
        rows.append(("steps per second", f"{report['steps_per_second']:.0f}"))
        rows.append(("smallest det F", f"{report['smallest_det']:.2f}"))
        if "gap" in report:
            rows.append(("loop gap", f"{1000 * report['gap']:.3g} mm"))
        rows.append(("keys", str(report["keys"])))
        if report["keys_error"]:
            rows.append(("keys' error", f"{1000 * report['keys_error']:.3g} mm"))
        if "seam" in report:
            rows.append(("seam", f"{1000 * report['seam']:.3g} mm"))
        if "off_full" in report:
            rows.append(("off Full Quality", f"{100 * report['off_full']:.1f} %"))
        if "compression_error" in report:
            rows.append(("compression error", f"{1000 * report['compression_error']:.3g} mm"))
    rows += [(stage, f"{seconds:.2f} s") for stage, seconds in (*job.progress.seconds.items(), ("save", save_seconds))]
    print(f"\n{job.name}")
    for name, value in rows:
        print(f"  {name:<18}{value:>12}")
