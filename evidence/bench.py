# SPDX-License-Identifier: GPL-3.0-or-later
"""`make bench`: measures the engine, the pipeline and the first click, prints them against their goals, writes
build/reports/bench.json. A checkout that is named, and built, is measured beside this one.

Of repeated runs the fastest counts: other work on the machine only ever adds.
"""

from __future__ import annotations

import json
import os
import platform
import re
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from project import ROOT

import numpy as np
import table
from measured import git, measured_at

REPORT = ROOT / "build" / "reports" / "bench.json"
ENGINE = ROOT / "build" / "cmake" / "engine_benchmarks"
SOLID = ROOT.parent / "shared" / "meshes" / "shoulder.npz"
REPETITIONS = 5
CLICKS = 5  # of each character, each in a process of its own
COUNTERS = ("per_second", "bytes", "coefficients", "iterations", "dofs", "bones", "nodes")


def main() -> int:
    measured = {
        "machine": machine(),
        "commit": measured_at("performance.md"),
        "engine": measure_engine(),
        "pipeline": measure_pipeline(),
        "clicks": measure_clicks(),
        "before": git("-C", sys.argv[1], "log", "-1", "--format=%h", "--abbrev=7") if sys.argv[1:] else "",
    }
    REPORT.parent.mkdir(parents=True, exist_ok=True)
    REPORT.write_text(json.dumps(measured, indent=1))
    print(table.as_text(measured))
    print(f"written to {REPORT.relative_to(ROOT)}")
    return 0


def machine() -> str:
    model = platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        models = [line.split(":")[1].strip() for line in cpuinfo.read_text().splitlines() if "model name" in line]
        model = f"{models[0]}, {model}" if models else model
    return f"{model}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"


def measure_engine() -> dict[str, dict]:
    """Benchmark -> its fastest repetition: {"seconds", counters}."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "engine.json"
        arguments = [
            f"--benchmark_repetitions={REPETITIONS}",
            "--benchmark_min_time=0.1",
            f"--benchmark_out={report}",
            "--benchmark_out_format=json",
        ]
        if SOLID.exists():
            arguments.insert(0, write_solid(Path(folder) / "solid"))
        subprocess.run([ENGINE, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)
        return fastest(json.loads(report.read_text())["benchmarks"])


def write_solid(path: Path) -> Path:
    """The shoulder's mesh as engine.cpp reads it."""
    with np.load(SOLID) as stored:
        nodes, tets, pins = stored["V"], stored["T"].astype(np.int32), stored["fixed"].astype(np.int32)
    counts = np.array([len(nodes), len(tets), len(pins)], np.int32)
    path.write_bytes(b"".join(np.ascontiguousarray(array).tobytes() for array in (counts, nodes, tets, pins)))
    return path


def fastest(runs: list[dict]) -> dict[str, dict]:
    units = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0}
    found: dict[str, dict] = {}
    for run in runs:
        if run["run_type"] != "iteration":
            continue
        name = re.sub("/(iterations:.*|process_time|real_time)", "", run["run_name"])
        clock = "real_time" if run["run_name"].endswith("real_time") else "cpu_time"
        seconds = run[clock] * units[run["time_unit"]]
        if name not in found or seconds < found[name]["seconds"]:
            found[name] = {"seconds": seconds, **{key: run[key] for key in COUNTERS if key in run}}
    return found


def measure_pipeline() -> dict[str, dict]:
    """Test -> {"seconds", what it noted besides}; empty without the character."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "pipeline.json"
        tests = Path(__file__).with_name("test_pipeline.py")
        command = [sys.executable, "-m", "pytest", "-q", f"--benchmark-json={report}", "--benchmark-quiet", tests]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        if done.returncode:
            print(done.stdout, done.stderr)
            raise SystemExit(done.returncode)
        if not report.exists() or not report.stat().st_size:
            print("bench: no pipeline, ../shared/assets is not here")
            return {}
        runs = json.loads(report.read_text())["benchmarks"]
    return {
        run["name"].removeprefix("test_"): {
            "seconds": run["stats"]["min"],
            "median": run["stats"]["median"],
            **run["extra_info"],
        }
        for run in runs
    }


def measure_clicks() -> dict[str, dict[str, dict]]:
    """Character -> "now", and "before" of another checkout -> the run with the median of all times; each in turn. Only
    the characters that are here.
    """
    checkouts = {"now": ROOT} | ({"before": Path(sys.argv[1])} if sys.argv[1:] else {})
    found: dict[str, dict[str, dict]] = {}
    for name, file in table.CLICKED.items():
        if file and not (ROOT.parent / "shared" / "assets" / file).exists():
            print(f"bench: ../shared/assets has no {file}: it is left out")
            continue
        runs: dict[str, list[dict]] = {which: [] for which in checkouts}
        for _ in range(CLICKS):
            for which, checkout in checkouts.items():
                runs[which].append(clicked(name, checkout))
        found[name] = {which: median(each) for which, each in runs.items()}
    return found


def clicked(name: str, checkout: Path) -> dict:
    command = [sys.executable, Path(__file__).with_name("first_click.py"), name, checkout]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        print(done.stdout, done.stderr)
        raise SystemExit(done.returncode)
    return json.loads(done.stdout.strip().rpartition("\n")[2])


def median(runs: list[dict]) -> dict:
    """The run of the median time, with the median of the processor times."""
    in_order = sorted(runs, key=lambda run: run["wall"])
    return in_order[len(runs) // 2] | {"cpu": statistics.median(run["cpu"] for run in runs)}


if __name__ == "__main__":
    sys.exit(main())
