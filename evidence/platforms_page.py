# SPDX-License-Identifier: GPL-3.0-or-later
"""`make platforms`: tries what `make wheels` made as far as one Linux machine goes, and writes docs/platforms.md.

Windows' C++ tests run under Wine and those of ARM under QEMU; the Linux wheels are loaded by every Python that Blender
has, that of ARM by Debian's Python under QEMU. Nothing runs macOS here.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from project import ROOT

import numpy as np
import wheels
from measured import measured_at

PAGE = ROOT / "docs/platforms.md"
REPORT = ROOT / "build/reports/platforms.json"
GCC = ROOT / "build/cmake"  # what `make build` compiled
ARM = wheels.WORK / "arm"  # Debian's Python for ARM, by version
# Debian's packages of an ARM Python with all that it loads here; what a suite does not have is left out.
ARM_PACKAGES = (
    "python{0}-minimal", "libpython{0}-minimal", "libpython{0}-stdlib", "libc6", "libgcc-s1", "libstdc++6", "zlib1g",
    "libexpat1", "libffi8", "libssl3", "libssl3t64", "libbz2-1.0", "liblzma5", "libsqlite3-0", "libuuid1", "libzstd1",
)  # fmt: skip
TESTS = ("test_physics.py", "test_responses.py", "test_pose_space.py", "test_meshing.py", "test_model_file.py")
ARM_TESTS = ("test_pose_space.py",)  # QEMU is slow, and knows no children of the same Python
AGAIN = ("linux-x64", "windows-x64")  # compiled twice
PAIRS = 5
EMULATORS = {"linux-x64": (), "linux-arm64": ("qemu-aarch64", "-L", ARM / "3.11"), "windows-x64": ("wine",)}
BLENDERS = {"3.11": "4.5", "3.13": "5.2", "3.14": "Debian's 5.2"}
# Arguments: the engine's folder, the add-on's, a .blend, and what to write: a .blend with a model, or all positions.
BAKE = """
import os, sys
engine, addon, source, path = sys.argv[1:]
sys.path[:0] = [engine, addon]
import bpy, dynamorph, numpy as np
import dynamic_morph_targets
assert dynamorph.__file__.startswith(engine), dynamorph.__file__
dynamic_morph_targets.register()
bpy.ops.wm.open_mainfile(filepath=source)
obj = bpy.data.objects["Limb"]
bpy.context.view_layer.objects.active = obj
if path.endswith(".blend"):
    assert bpy.ops.dynamorph.build() == {"FINISHED"}
    bpy.ops.wm.save_as_mainfile(filepath=path)
else:
    assert bpy.ops.dynamorph.bake() == {"FINISHED"}
    found = []
    for frame in range(bpy.context.scene.frame_start, bpy.context.scene.frame_end + 1):
        bpy.context.scene.frame_set(frame)
        mesh = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        points = np.empty(3 * len(mesh.vertices), np.float32)
        mesh.vertices.foreach_get("co", points)
        found.append(points)
    np.save(path, found)
"""


def run(*command, **options) -> str:
    """Output of a command that must succeed."""
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False, **options)
    if done.returncode:
        sys.exit(f"{done.stdout[-6000:]}{done.stderr[-3000:]}\nplatforms: failed: {' '.join(map(str, command))[:300]}")
    return done.stdout + done.stderr


# C++ -----------------------------------------------------------------------------------------------------------------


def cpp_tests(program: Path, emulator: tuple = ()) -> dict:
    """Counts of the C++ tests, and how far the golden motion is from that of the page's machine."""
    out = run(*emulator, program, env=os.environ | {"WINEDEBUG": "-all"})
    passed = re.search(r"test cases: +\d+ \| +(\d+) passed \| +(\d+) failed", out)
    golden = re.findall(r"golden motion, \w+: largest difference (\S+)", out)
    return {"passed": int(passed[1]), "failed": int(passed[2]), "golden": max(map(float, golden))}


# Python --------------------------------------------------------------------------------------------------------------


def unpacked(wheel: Path) -> Path:
    folder = wheels.WORK / "unpacked" / wheel.stem
    shutil.rmtree(folder, ignore_errors=True)
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    return folder


def pytest_counts(out: str) -> dict:
    found = dict(re.findall(r"(\d+) (passed|failed|skipped)", out.splitlines()[-1])[::-1]) if out else {}
    return {name: int(count) for count, name in found.items()}


def tests_in_blender(python: str, engine: Path) -> dict:
    """Tests of the engine with that of a wheel, in the Python that has Blender's module."""
    interpreter = ROOT / f".venv/{python}/bin/python"
    environment = os.environ | {"PYTHONPATH": f"{engine}:{ROOT / 'addon'}:{ROOT / 'tests'}"}
    tests = [ROOT / "tests/engine" / name for name in TESTS]
    out = run(interpreter, "-m", "pytest", *tests, cwd=ROOT, env=environment)
    return pytest_counts(out)


def arm_python(python: str) -> Path:
    """Debian's Python for ARM with NumPy and what tests need, unpacked once into a folder of its own."""
    folder = ARM / python
    if (folder / "site").exists():
        return folder
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    with tempfile.TemporaryDirectory() as temporary:
        for package in ARM_PACKAGES:
            name = package.format(python)
            try:
                files = wheels.apt(Path(temporary), wheels.SUITES[python], "arm64", "download", name)
            except SystemExit:
                continue  # a library that has another name in this suite
            run("dpkg-deb", "-x", next(files.glob(f"{name}_*.deb")), folder)
    if not (folder / "lib").exists():  # a link that a package of the system makes
        (folder / "lib").symlink_to("usr/lib")
    packages = ("numpy", "pytest", "hypothesis", "scipy")
    tag = ("--platform", "manylinux_2_28_aarch64", "--platform", "manylinux2014_aarch64", "--python-version", python)
    pip = (ROOT / f".venv/{python}/bin/python", "-m", "pip", "install", "--quiet", "--only-binary=:all:")
    run(*pip, *tag, "--target", folder / "site", *packages)
    return folder


def tests_on_arm(python: str, engine: Path) -> dict:
    """Some of the engine's tests by Debian's Python for ARM, under QEMU."""
    folder = arm_python(python)
    paths = (engine, folder / "site", ROOT / "addon", ROOT / "tests")
    environment = os.environ | {"PYTHONPATH": ":".join(map(str, paths)), "QEMU_LD_PREFIX": str(folder)}
    tests = [ROOT / "tests/engine" / name for name in ARM_TESTS]
    interpreter = folder / f"usr/bin/python{python}"
    return pytest_counts(run("qemu-aarch64", interpreter, "-m", "pytest", *tests, cwd=ROOT, env=environment))


def bake_difference(python: str, engine: Path) -> float:
    """Largest difference of the sample's bake from that of gcc's engine, by the largest displacement of a vertex.

    Both from one model: another compiler's library sorts otherwise, which gives another cage.
    """
    bake = (ROOT / f".venv/{python}/bin/python", "-c", BAKE)
    with tempfile.TemporaryDirectory() as temporary:
        folder, addon = Path(temporary), ROOT / "addon"
        run(*bake, GCC / "python", addon, ROOT / "sample_blends/bulging_cylinder.blend", folder / "model.blend")
        run(*bake, GCC / "python", addon, folder / "model.blend", folder / "gcc.npy")
        run(*bake, engine, addon, folder / "model.blend", folder / "zig.npy")
        expected, found = np.load(folder / "gcc.npy"), np.load(folder / "zig.npy")
    return float(np.abs(found - expected).max() / np.abs(expected - expected[0]).max())


# Compiled again -----------------------------------------------------------------------------------------------------


def compiled_again() -> dict[str, bool]:
    """Wheel -> whether another folder, a clone, made it with the same bytes. It does not when there was a commit since,
    whose time it has.
    """
    with tempfile.TemporaryDirectory() as temporary:
        clone = Path(temporary) / "elsewhere"
        run("git", "clone", "--quiet", ROOT, clone)
        shutil.copytree(wheels.WORK / "python", clone / "build/wheels/python")  # Python's headers
        run(sys.executable, clone / "tools/wheels.py", "--platforms", *AGAIN, "--pythons", "3.11")
        found = [wheels.wheel_path(name, "3.11") for name in AGAIN]
        return {each.name: each.read_bytes() == (clone / each.relative_to(ROOT)).read_bytes() for each in found}


# Speed ---------------------------------------------------------------------------------------------------------------


def compile_benchmarks() -> tuple[Path, Path]:
    """engine_benchmarks by gcc and by zig, which needs Google Benchmark compiled by zig, too."""
    cmake = wheels.TOOLS / "cmake"
    run(cmake, GCC, "-DDYNAMORPH_BENCHMARKS=ON", "--log-level=WARNING")
    run(cmake, "--build", GCC, "--target", "engine_benchmarks", "--", "--quiet")
    folder, installed = wheels.WORK / "linux-x64", wheels.WORK / "benchmark/installed"
    environment = wheels.zig_environment()
    if not installed.exists():
        sources = wheels.apt(
            wheels.WORK / "benchmark", "bookworm", "amd64", "source", "--download-only", "libbenchmark-dev"
        )
        run(
            "tar",
            "-xf",
            next(sources.glob("*.orig.tar.?z")),
            "--one-top-level=source",
            "--strip-components=1",
            cwd=sources,
        )
        options = {
            "CMAKE_CXX_COMPILER": folder / "zig-c++", "CMAKE_AR": folder / "zig-ar", "CMAKE_BUILD_TYPE": "Release",
            "CMAKE_RANLIB": folder / "zig-ranlib", "CMAKE_MAKE_PROGRAM": wheels.TOOLS / "ninja",
            "BENCHMARK_ENABLE_TESTING": "OFF", "BENCHMARK_ENABLE_WERROR": "OFF", "CMAKE_INSTALL_PREFIX": installed,
            "CMAKE_CXX_FLAGS": "-w -fno-sanitize=undefined",
        }  # fmt: skip
        build = wheels.WORK / "benchmark/build"
        words = [f"-D{key}={value}" for key, value in options.items()]
        run(cmake, "-S", sources / "source", "-B", build, "-G", "Ninja", *words, env=environment)
        run(cmake, "--build", build, "--target", "install", env=environment)
    run(cmake, folder, "-DDYNAMORPH_BENCHMARKS=ON", f"-DCMAKE_PREFIX_PATH={installed}", "--log-level=WARNING",
        env=environment)  # fmt: skip
    run(cmake, "--build", folder, "--target", "engine_benchmarks", "--", "--quiet", env=environment)
    return GCC / "engine_benchmarks", folder / "engine_benchmarks"


def seconds(program: Path) -> dict[str, float]:
    """Seconds of each row of the benchmarks."""
    out = run(program, "--benchmark_min_time=0.05", "--benchmark_format=json")
    rows = json.loads(out[out.index("{") : out.rindex("}") + 1])["benchmarks"]
    scale = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1}
    clock = {row["name"]: "real_time" if "/real_time" in row["name"] else "cpu_time" for row in rows}
    return {row["name"]: row[clock[row["name"]]] * scale[row["time_unit"]] for row in rows}


def speeds() -> dict[str, dict]:
    """Row -> time of gcc's build, s, and the ratios zig : gcc of pairs of runs one after the other."""
    gcc, zig = compile_benchmarks()
    pairs = [(seconds(gcc), seconds(zig)) for _ in range(PAIRS)]
    return {
        row: {
            "gcc": min(pair[0][row] for pair in pairs),
            "ratios": sorted(pair[1][row] / pair[0][row] for pair in pairs),
        }
        for row in pairs[0][0]
        if not row.startswith(("operations", "bandwidth"))  # of the machine
    }


# The page ------------------------------------------------------------------------------------------------------------

TEXT = """# Platforms

This page lists what is compiled for which system, and how far it was tested. `make wheels` compiles everything on one
Linux machine, with zig {zig}; `make -C evidence platforms` tries it on that machine and writes this page; nothing on it
is written by hand.

{commit}.

{table}
- *Imports*: the module loads nothing but what the system and Python bring, and exports nothing but itself; auditwheel
  finds no symbol of the C library that is newer than glibc 2.28.
- *Golden motion*: the C++ test of that name compares a motion from the basis to the last step with numbers that were
  stored on x86-64 with gcc; the largest difference, divided by the largest displacement. gcc's own is {golden:.0e}.
- *Same bake*: `sample_blends/bulging_cylinder.blend` baked in Blender with this wheel and with gcc's engine from one
  model; the largest difference of a vertex, divided by the largest displacement of one.
- *Compiled again* in another folder, a clone. {again}
- Windows: no Windows Python runs here, so the module is checked by what it imports and exports, and its engine by the
  C++ tests under Wine. macOS: nothing runs here; the module is checked by what it imports and exports.

## Speed

{speed}"""

SPEED = """{commit}. The Linux engine that zig compiled against the one that gcc compiled: {pairs} pairs of runs of the
benchmarks, one after the other; the median of the ratios and their range. Over all rows the median is {median:.2f}.

{table}"""
NO_SPEED = "Not measured yet: `make -C evidence platforms` does it after everything else.\n"


def grid(header: list[str], rows: list[list[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def tests_text(found: dict) -> str:
    said = []
    if "cpp" in found:
        where = {"linux-x64": "here", "linux-arm64": "QEMU", "windows-x64": "Wine"}[found["platform"]]
        said.append(f"C++ {found['cpp']['passed']} of {found['cpp']['passed'] + found['cpp']['failed']} ({where})")
    if "tests" in found:
        where = f"in bpy {BLENDERS[found['python']]}" if found["platform"] == "linux-x64" else "QEMU"
        said.append(f"Python {found['tests'].get('passed', 0)} ({where})")
    return ", ".join(said) or "-"


def page(report: dict) -> str:
    rows = []
    for found in report["wheels"]:
        cpp, loaded = found.get("cpp"), "yes" if "tests" in found else "-"
        name = [found["platform"], found["python"], BLENDERS[found["python"]], f"{found['MB']:.1f}", found["zip"]]
        golden, bake = (
            f"{cpp['golden']:.0e}" if cpp else "-",
            (f"{found['bake']:.0e}" if found["bake"] else "equal") if "bake" in found else "-",
        )
        rows.append([*name, "yes", loaded, tests_text(found), golden, bake])
    header = ["platform", "Python", "Blender", "wheel, MB", "zip, MB", "compiled, imports checked", "loaded",
              "tests passed", "golden motion", "same bake"]  # fmt: skip
    return TEXT.format(
        zig=report["zig"], commit=report["commit"], golden=report["gcc"]["golden"],
        again=again_text(report), table=grid(header, rows), speed=speed_text(report),
    )  # fmt: skip


def again_text(report: dict) -> str:
    if not report["again"]:
        return "Not compared yet."
    said = [f"`{name}` has {'the same' if same else '**other**'} bytes" for name, same in report["again"].items()]
    return f"{report['again_at']}: {', '.join(said)}."


def speed_text(report: dict) -> str:
    speed = report["speed"]
    if not speed:
        return NO_SPEED
    rows = []
    for row, each in speed.items():
        ratios, gcc = each["ratios"], f"{1e6 * each['gcc']:.3g}"
        rows.append([f"`{row}`", gcc, f"{statistics.median(ratios):.2f}", f"{ratios[0]:.2f} to {ratios[-1]:.2f}"])
    median = statistics.median(statistics.median(each["ratios"]) for each in speed.values())
    return SPEED.format(
        commit=report["speed_at"],
        pairs=PAIRS,
        median=median,
        table=grid(["row", "gcc, us", "zig : gcc", "range"], rows),
    )


def measure() -> dict:
    known = json.loads(REPORT.read_text(encoding="utf-8")) if REPORT.exists() else {}
    run(ROOT / "tools/setup.sh", "platforms", "bench")
    found: dict = {"commit": measured_at(PAGE.name), "zig": wheels.zig("version").strip()}
    found["gcc"] = cpp_tests(GCC / "engine_tests")
    arm_python("3.11")  # the C library of the C++ tests
    rows = []
    for name, platform in wheels.PLATFORMS.items():
        program = wheels.WORK / name / ("engine_tests.exe" if platform.system == "Windows" else "engine_tests")
        cpp = cpp_tests(program, EMULATORS[name]) if name in EMULATORS else None
        print(name, cpp or "", flush=True)
        for python in wheels.pythons_of(name):
            wheel = wheels.wheel_path(name, python)
            wheels.check(wheel, name, python)
            archive = next(ROOT.glob(f"dist/*-{wheels.version()}-{name.replace('-', '_')}.zip"), None)
            row = {"platform": name, "python": python, "MB": wheel.stat().st_size / 1e6,
                   "zip": f"{archive.stat().st_size / 1e6:.1f}" if archive else "-"}  # fmt: skip
            if cpp:
                row["cpp"] = cpp
            if name == "linux-x64" and (ROOT / f".venv/{python}").exists():
                engine = unpacked(wheel)
                row |= {"tests": tests_in_blender(python, engine), "bake": bake_difference(python, engine)}
            if name == "linux-arm64" and (ROOT / f".venv/{python}").exists():
                row["tests"] = tests_on_arm(python, unpacked(wheel))
            print(row, flush=True)
            rows.append(row)
    return found | {
        "wheels": rows,
        "again": {},
        "again_at": "",
        "speed": known.get("speed", {}),
        "speed_at": known.get("speed_at", ""),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--keep-speed", action="store_true", help="do not measure the speed again")
    parser.add_argument("--speed-alone", action="store_true", help="measure nothing else again, on a quiet machine")
    args = parser.parse_args()
    if args.speed_alone:
        if not REPORT.exists():
            sys.exit("platforms: nothing was measured yet: make -C evidence platforms without speed=1 first")
        found = json.loads(REPORT.read_text(encoding="utf-8"))
    else:
        found = measure()
        write(found)
        found |= {"again": compiled_again(), "again_at": measured_at(PAGE.name)}
        write(found)
        if not all(found["again"].values()):
            sys.exit("platforms: a wheel has other bytes when it is compiled again")
    if not args.keep_speed:
        found |= {"speed": speeds(), "speed_at": measured_at(PAGE.name)}
        write(found)


def write(found: dict) -> None:
    REPORT.parent.mkdir(parents=True, exist_ok=True)
    REPORT.write_text(json.dumps(found, indent=1), encoding="utf-8")
    PAGE.write_text(page(found), encoding="utf-8")


if __name__ == "__main__":
    main()
