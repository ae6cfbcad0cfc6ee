# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds the playground (docs/playground.md) into build/playground: python tools/playground.py

Needs the engine in build/cmake, Blender's Python module, and Emscripten; takes about 4 minutes. It keeps what
is up to date: the WebAssembly by ninja, a model while it is newer than its scene, the add-on and the engine. It writes
the table of sizes in docs/playground.md, and fails where a file is over its budget.
"""

from __future__ import annotations

import gzip
import itertools
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.append(str(ROOT / "evidence"))
from measured import write_between  # noqa: E402

WEB, SCENES, BUILD = ROOT / "site/playground", ROOT / "sample_blends", ROOT / "build"
OUT = BUILD / "playground"
SCRIPTS = ("playground.mjs", "engine.mjs", "picture.mjs")
PAGE = ("index.html", "style.css", *SCRIPTS)
PLATFORM = Path("/usr/share/emscripten/cmake/Modules/Platform/Emscripten.cmake")  # of Debian's package
KILOBYTE = 1000
DOCS, BEGIN, END = ROOT / "docs" / "playground.md", "<!-- sizes -->", "<!-- /sizes -->"
BUDGETS = {"playground.wasm.gz": 350, "cylinder.dynamorph.gz": 450, "scripts": 10}  # kB, compressed by gzip


def tool(name: str) -> str:
    """A program of the environment, or else of the system."""
    found = shutil.which(name, path=Path(sys.executable).parent) or shutil.which(name)
    if not found:
        raise SystemExit(f"The playground needs {name}. On Debian: apt-get install emscripten cmake ninja-build")
    return found


def compile_engine(folder: Path, *options: str) -> Path:
    """The folder in which site/playground/CMakeLists.txt is built."""
    environment = os.environ | {"NODE_PATH": "/usr/share/nodejs"}  # Debian's modules, for a Node that is not Debian's
    configure = [tool("cmake"), "-S", WEB, "-B", folder, "-G", "Ninja", f"-DCMAKE_MAKE_PROGRAM={tool('ninja')}"]
    for command in ([*configure, "--log-level=WARNING", *options], [tool("cmake"), "--build", folder]):
        subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)
    return folder


def webassembly() -> bytes:
    tool("em++")
    folder = compile_engine(BUILD / "wasm", f"-DCMAKE_TOOLCHAIN_FILE={PLATFORM}")
    return (folder / "playground.wasm").read_bytes()


def native() -> Path:
    """The same program for this machine, with the engine of build/cmake."""
    prefix = BUILD / "engine"
    install = [tool("cmake"), "--install", BUILD / "cmake", "--component", "engine", "--prefix", prefix]
    subprocess.run(install, check=True, stdout=subprocess.DEVNULL)
    return compile_engine(BUILD / "native", f"-DCMAKE_PREFIX_PATH={prefix}") / "playground"


def export(scene: str, name: str, path: str) -> None:
    """Build the model of an object of a sample scene, and write it as the format Soft Skin. In a process of its own."""
    import bpy
    import dynamic_morph_targets
    from dynamic_morph_targets.run.bake import batch, export_actions, job

    dynamic_morph_targets.register()
    bpy.ops.wm.open_mainfile(filepath=str(SCENES / scene))
    obj = bpy.data.objects[name]
    batch.run_all(batch.Batch([job.Job(obj, "BUILD")], "BUILD"))
    export_actions.export(obj, "SOFT_SKIN", Path(path), (1, 1))


def model(described: dict) -> Path:
    """The file of one of site/playground/models.json."""
    path, scene = BUILD / "soft_skins" / f"{described['file']}.dynamorph", SCENES / described["scene"]
    makers = (ROOT / "addon").rglob("*.py"), (BUILD / "cmake" / "python").rglob("*.so")
    newest = max(each.stat().st_mtime for each in itertools.chain([scene], *makers))
    if not path.exists() or path.stat().st_mtime < newest:
        print(f"building the model of {scene.name}", flush=True)
        path.parent.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, __file__, scene.name, described["object"], path]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return path


def fixed_motion(program: Path, path: Path, sliders: list[dict], frames: int) -> dict:
    """What the native engine computes, with the instruction set that all processors have."""
    command = [program, path, str(frames), json.dumps(sliders)]
    environment = os.environ | {"DYNAMORPH_ISA": "baseline"}
    printed = subprocess.run(command, check=True, env=environment, stdout=subprocess.PIPE, text=True).stdout.split()
    return {"hash": printed[0], "coordinates": [float(each) for each in printed[1:]]}


def kilobytes(*paths: Path) -> float:
    """Of files together, as a server sends them."""
    sizes = [
        len(data if path.suffix == ".gz" else gzip.compress(data, 9)) for path in paths if (data := path.read_bytes())
    ]
    return sum(sizes) / KILOBYTE


def sizes() -> dict[str, float]:
    """kB of what the page loads."""
    found = {path.name: kilobytes(path) for path in sorted(OUT.glob("*.gz"))}
    return found | {"scripts": kilobytes(*(OUT / name for name in SCRIPTS))}


def write_table() -> None:
    """The table of docs/playground.md."""
    rows = [f"| `{name}` | {size:.0f} kB | {BUDGETS.get(name, '')} |" for name, size in sizes().items()]
    table = "\n".join(["| file | size, compressed | budget, kB |", "|---|---|---|", *rows])
    write_between(DOCS, BEGIN, END, table)
    print(table)


def main() -> None:
    OUT.mkdir(parents=True, exist_ok=True)
    (OUT / "playground.wasm.gz").write_bytes(gzip.compress(webassembly(), 9, mtime=0))
    described, program = json.loads((WEB / "models.json").read_text()), native()
    for each in described["models"]:
        path = model(each)
        (OUT / f"{path.name}.gz").write_bytes(gzip.compress(path.read_bytes(), 9, mtime=0))
        each["native"] = fixed_motion(program, path, each["sliders"], described["frames"])
    (OUT / "models.json").write_text(json.dumps(described))
    for name in PAGE:
        shutil.copy(WEB / name, OUT)
    write_table()
    over = [name for name, limit in BUDGETS.items() if sizes()[name] > limit]
    if over:
        raise SystemExit(f"over budget: {', '.join(over)}")


if __name__ == "__main__":
    export(*sys.argv[1:]) if len(sys.argv) == 4 else main()
