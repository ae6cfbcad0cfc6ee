# SPDX-License-Identifier: GPL-3.0-or-later
"""Packages into dist/: `wheel` (native wheels and the add-on's pure-Python wheel) or `extension` (Blender's zip)."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ADDON = ROOT / "addon" / "dynamic_morph_targets"
DIST = ROOT / "dist"
PLATFORMS = {"linux_x86_64": "linux-x64", "linux_aarch64": "linux-arm64"}  # a wheel's tag: Blender's name


def pythons() -> list[Path]:
    return sorted(ROOT.glob(".venv/3.*/bin/python"))


def build_wheel(python: Path, source: Path, folder: Path, *options: str) -> None:
    """The wheel of `source` for one Python, by tools from its own environment."""
    command = [python, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps"]
    subprocess.run([*command, "--no-build-isolation", *options, "-w", folder, source], check=True)


def build_native_wheels(folder: Path) -> list[Path]:
    """One wheel for each Python, of the modules that `make build` compiled."""
    shutil.rmtree(folder, ignore_errors=True)  # every wheel in the folder would be packed
    for python in pythons():
        build_wheel(python, ROOT, folder, f"--config-settings=cmake.define.DYNAMORPH_PREBUILT={ROOT / 'build/cmake'}")
    return sorted(folder.glob("*.whl"))


def make_wheels() -> None:
    for wheel in build_native_wheels(ROOT / "build/wheels"):
        shutil.copy2(wheel, DIST)
    build_wheel(pythons()[0], ROOT / "addon", DIST)


def make_extension() -> None:
    stage = stage_extension(ROOT / "build/extension")
    build_native_wheels(stage / "wheels")
    archive = pack_extension(stage, DIST)
    print(f"{archive.relative_to(ROOT)} for {', '.join(python.parent.parent.name for python in pythons())}")


def stage_extension(stage: Path) -> Path:
    """A copy of the add-on, still without wheels; those belong in `stage`/wheels."""
    shutil.rmtree(stage, ignore_errors=True)
    shutil.copytree(ADDON, stage, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("LICENSE", "LICENSES.md"):
        shutil.copy2(ROOT / name, stage)
    return stage


def pack_extension(stage: Path, folder: Path) -> Path:
    """The staged add-on, with its wheels named in the manifest, as a zip in `folder`; by Blender's own tool."""
    wheels = sorted((stage / "wheels").glob("*.whl"))
    manifest = stage / "blender_manifest.toml"
    platforms = sorted({PLATFORMS[wheel.stem.split("-")[-1]] for wheel in wheels})
    lines = "".join(f'  "./wheels/{wheel.name}",\n' for wheel in wheels)
    text = re.sub(r"^wheels *= *\[.*?\]\n", "", manifest.read_text(), flags=re.MULTILINE | re.DOTALL)
    # Before the first table: a key below one would belong to it.
    head, table, rest = text.partition("\n[")
    manifest.write_text(f"{head.rstrip()}\nplatforms = {json.dumps(platforms)}\nwheels = [\n{lines}]\n{table}{rest}")

    archive = folder / f"dynamic_morph_targets-{tomllib.loads(manifest.read_text())['version']}.zip"
    blender_extension("build", "--source-dir", stage, "--output-filepath", archive)
    blender_extension("validate", archive)
    return archive


def blender_extension(*arguments: str | Path) -> None:
    """Blender's `extension` command, run from the bpy wheel."""
    python = pythons()[-1]
    path = "lib/*/site-packages/bpy/*/scripts/addons_core/bl_pkg/cli/blender_ext.py"
    tool = next(python.parent.parent.glob(path))
    run = subprocess.run([python, tool, *arguments], capture_output=True, text=True, check=False)
    if run.returncode:
        sys.exit(run.stdout + run.stderr)


if __name__ == "__main__":
    DIST.mkdir(exist_ok=True)
    {"wheel": make_wheels, "extension": make_extension}[sys.argv[1]]()
