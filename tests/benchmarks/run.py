# SPDX-License-Identifier: GPL-3.0-or-later
"""`make bench`: where the time of a real build and bake goes, and how it grows.

The MakeHuman body, 53 bones, 4 substeps, 20 modes, StVK: 250 frames, half of them, and a mesh of four times the
vertices. Prints medians of a few bakes; writes build/reports/bench.json.
"""

import json
import os
import platform
import statistics
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / "addon")]
os.environ["BLENDER_USER_RESOURCES"] = tempfile.mkdtemp(prefix="dynamorph_bench_")  # before bpy is imported

import bpy  # noqa: E402
import dynamic_morph_targets  # noqa: E402
import real_character  # noqa: E402
from dynamic_morph_targets import jobs  # noqa: E402

RUNS = 5
FRAMES = 250
STAGES = ("sample rig", "simulate", "write keys")


def open_body(subdivided: bool):
    body = real_character.open_character("cmu_131_03_hop")
    body.dynamorph.model.law = "STVK"
    if subdivided:
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.ops.mesh.select_all(action="SELECT")
        bpy.ops.mesh.subdivide()
        bpy.ops.object.mode_set(mode="OBJECT")
    return body


def measure(body, frames: int) -> dict[str, float]:
    """Seconds of each stage, medians of RUNS bakes; of the build, which is made once."""
    build = jobs.Job(body, bake=False, rebuild=True)
    jobs.run(build)
    made = build.model.summary
    runs = []
    for _ in range(RUNS):
        job = jobs.Job(body, bake=True, frames=(1, frames), substeps=4)
        jobs.run(job)
        engine = 1000 * job.report["engine_seconds"] / (frames - 1)
        runs.append({**{stage: job.seconds[stage] for stage in STAGES}, "engine, ms a frame": engine})
    return {
        "vertices": len(build.character.vertices),
        "frames": frames,
        **{name: made[name] for name in ("nodes", "dofs", "modes", "targets")},
        **{f"build: {stage}": seconds for stage, seconds in made["seconds"].items()},
        **{name: statistics.median(run[name] for run in runs) for name in runs[0]},
    }


def main() -> int:
    if not real_character.CHARACTER.exists():
        print("bench: skipped, ../shared/assets is not here")
        return 0
    dynamic_morph_targets.register()
    try:
        columns = [measure(open_body(False), FRAMES // 2), measure(open_body(False), FRAMES)]
        columns.append(measure(open_body(True), FRAMES))
    finally:
        dynamic_morph_targets.unregister()

    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    print(f"{machine}; seconds, medians of {RUNS} bakes")
    for name in columns[0]:
        form = "14.3f" if isinstance(columns[0][name], float) else "14"
        print(f"  {name:<21}" + "".join(f"{column[name]:{form}}" for column in columns))
    report = ROOT / "build" / "reports" / "bench.json"
    report.parent.mkdir(parents=True, exist_ok=True)
    report.write_text(json.dumps({"machine": machine, "columns": columns}, indent=1))
    print(f"written to {report.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
