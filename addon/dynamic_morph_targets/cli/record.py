# SPDX-License-Identifier: GPL-3.0-or-later
"""What a run prints and records: progress, tables and the JSON report."""

from __future__ import annotations

import platform
import tomllib
from pathlib import Path

import bpy

from ..core import baked


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
    manifest = tomllib.loads((Path(__file__).parents[1] / "blender_manifest.toml").read_text(encoding="utf-8"))
    return {
        "dynamorph": manifest["version"],
        "blender": bpy.app.version_string,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
    }


def character_record(job) -> dict:
    """The result of a job for one character."""
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
            "hash": baked.digest(job.result),
            "frames": [job.settings.start, job.settings.end],
            "fps": job.settings.fps,
            "substeps": job.settings.substeps,
            "resumed": len(job.resumed.get("coordinates", ())),
            "max_displacement": baked.reach(job.result, job.character.to_bind),
            **{name: value for name, value in job.report.items() if name != "warnings"},
        }
    return found


def find_model(name: str):
    return bpy.context.scene.objects[name].dynamorph.model


class Progress:
    """Prints a line at each tenth of the work. openjd: at each hundredth, for farms that use Open Job Description."""

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
