# SPDX-License-Identifier: GPL-3.0-or-later
"""`make bench`: where the time of a real bake goes. 250 frames of the MakeHuman body, 4 substeps, 20 modes, StVK.

Also bakes half the frames, to show how each stage grows. Prints medians of a few runs; writes
build/reports/bench.json.
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

import dynamic_morph_targets  # noqa: E402
import real_character  # noqa: E402
from dynamic_morph_targets import jobs  # noqa: E402

RUNS = 5
FRAMES = 250
STAGES = ("sample rig", "simulate", "store model", "write keys")


def measure(body, frames: int) -> dict[str, float]:
    """Seconds of each stage and milliseconds of engine a frame: medians of RUNS bakes."""
    runs = []
    for _ in range(RUNS):
        job = jobs.Job(body, bake=True, frames=(1, frames), substeps=4)
        jobs.run(job)
        engine = 1000 * job.report["engine_seconds"] / (frames - 1)
        runs.append({**{stage: job.seconds.get(stage, 0.0) for stage in STAGES}, "engine, ms a frame": engine})
    return {name: statistics.median(run[name] for run in runs) for name in runs[0]}


def main() -> int:
    if not real_character.CHARACTER.exists():
        print("bench: skipped, ../shared/assets is not here")
        return 0
    dynamic_morph_targets.register()
    try:
        body = real_character.open_character("cmu_131_03_hop")
        body.dynamorph.model.law = "STVK"
        build = jobs.Job(body, bake=False)
        jobs.run(build)
        columns = {f"{frames} frames": measure(body, frames) for frames in (FRAMES // 2, FRAMES)}
    finally:
        dynamic_morph_targets.unregister()

    summary = build.model.summary
    print(f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}; medians of {RUNS} bakes")
    print(f"{len(build.character.vertices)} vertices, {summary['nodes']} nodes, {summary['dofs']} DOF, "
          f"{summary['modes']} modes, {summary['targets']} targets, StVK, 4 substeps")  # fmt: skip
    for stage, seconds in summary["seconds"].items():
        print(f"  build: {stage:<16}{seconds:8.3f} s")
    print(f"  {'':<21}" + "".join(f"{name:>14}" for name in columns))
    for stage in next(iter(columns.values())):
        print(f"  {stage:<21}" + "".join(f"{column[stage]:14.3f}" for column in columns.values()))
    report = ROOT / "build" / "reports" / "bench.json"
    report.parent.mkdir(parents=True, exist_ok=True)
    report.write_text(json.dumps({"build": summary, "bake": columns}, indent=1))
    print(f"written to {report.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
