# SPDX-License-Identifier: GPL-3.0-or-later
"""Packages into dist/: `wheel` (native wheels and the add-on's pure-Python wheel), `extension` (the zips that Blender
installs from disk) or `repository` (the folder that Blender's *Get Extensions* installs and updates from). The last two
pack the engine's wheels of dist/wheels, all or those of the platforms named; with `native`, what `make build` compiled
for this machine."""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

from version import one as version

ROOT = Path(__file__).resolve().parent.parent
ADDON = ROOT / "addon" / "dynamic_morph_targets"
DIST = ROOT / "dist"
PLATFORMS = {  # Blender's name: how the name of a wheel ends
    "linux-x64": "linux*_x86_64",
    "linux-arm64": "linux*_aarch64",
    "macos-x64": "macosx*_x86_64",
    "macos-arm64": "macosx*_arm64",
    "windows-x64": "win_amd64",
    "windows-arm64": "win_arm64",
}


def pythons() -> list[Path]:
    return sorted(ROOT.glob(".venv/3.*/bin/python"))


# Wheels --------------------------------------------------------------------------------------------------------------


def build_wheel(python: Path, source: Path, folder: Path, *options: str) -> None:
    """The wheel of `source` for one Python, by tools from its own environment."""
    command = [python, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps"]
    subprocess.run([*command, "--no-build-isolation", *options, "-w", folder, source], check=True)
    for wheel in folder.glob("*.whl"):
        wheel.chmod(0o644)  # flit makes a file that only its owner can read


def build_native_wheels(folder: Path) -> list[Path]:
    """One wheel for each Python, of the modules that `make build` compiled."""
    shutil.rmtree(folder, ignore_errors=True)  # every wheel in the folder would be packed
    for python in pythons():
        build_wheel(python, ROOT, folder, f"--config-settings=cmake.define.DYNAMORPH_PREBUILT={ROOT / 'build/cmake'}")
    return sorted(folder.glob("*.whl"))


def make_wheels() -> None:
    DIST.mkdir(exist_ok=True)
    wheels = [shutil.copy2(wheel, DIST / wheel.name) for wheel in build_native_wheels(ROOT / "build/native_wheels")]
    build_wheel(pythons()[0], ROOT / "addon", DIST)
    print_table([*wheels, DIST / f"{ADDON.name}-{version()}-py3-none-any.whl"])


def platform_of(wheel: Path) -> str:
    """Blender's name of the platform that a wheel is for."""
    for platform, ending in PLATFORMS.items():
        if wheel.match(f"*{ending}.whl"):
            return platform
    sys.exit(f"{wheel.name} is for none of Blender's platforms: {', '.join(PLATFORMS)}")


def wheels_to_pack(platforms: list[str]) -> list[Path]:
    """The engine's wheels of this version, one for each platform and Python. Exits if that is not what there is."""
    native = "native" in platforms
    folder = ROOT / "build/native_wheels" if native else DIST / "wheels"
    if native:
        build_native_wheels(folder)
    if others := [wheel for wheel in sorted(folder.glob("*.whl")) if wheel.name.split("-")[1] != version()]:
        sys.exit(f"This is version {version()}. Delete the wheels of another one:{listed(others)}")
    wheels: dict[tuple[str, str], Path] = {}
    for wheel in sorted(folder.glob("dynamorph-*.whl")):
        same = wheels.setdefault((platform_of(wheel), wheel.name.split("-")[2]), wheel)
        if same != wheel:
            sys.exit(f"Both wheels are for one platform and Python. Delete one of them:{listed([same, wheel])}")
    chosen = [wheel for (platform, _), wheel in wheels.items() if native or not platforms or platform in platforms]
    if not chosen:
        sys.exit("dist/wheels has no such wheels. Run `make wheels` first, or name this machine: platforms=native")
    return chosen


def listed(paths: list[Path]) -> str:
    return "".join(f"\n  {path.relative_to(ROOT)}" for path in paths)


# Extension -----------------------------------------------------------------------------------------------------------


def make_extension(platforms: list[str]) -> None:
    """One zip for each platform, and one for all of them."""
    stage = stage_extension(ROOT / "build/extension", wheels_to_pack(platforms))
    DIST.mkdir(exist_ok=True)
    archives = pack_platforms(stage, DIST)
    if "native" not in platforms:
        archives.append(pack_extension(stage, DIST))
    print_table(archives)


def make_repository(platforms: list[str]) -> None:
    """A folder for any web server: one zip for each platform, index.json for Blender, index.html for people."""
    stage = stage_extension(ROOT / "build/extension", wheels_to_pack(platforms))
    print_table(fill_repository(stage, DIST / "repository"))


def fill_repository(stage: Path, folder: Path) -> list[Path]:
    """Empties a folder and makes a repository of the staged add-on there. Returns its zips."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    archives = pack_platforms(stage, folder)
    blender_extension("server-generate", "--html", "--repo-dir", folder)
    index = json.loads((folder / "index.json").read_text())
    if {entry["archive_url"] for entry in index["data"]} != {f"./{archive.name}" for archive in archives}:
        sys.exit(f"{folder.relative_to(ROOT)}/index.json does not list the zips beside it")
    return archives


def print_table(archives: list[Path]) -> None:
    for archive in archives:
        with zipfile.ZipFile(archive) as files:
            pythons = sorted({Path(name).name.split("-")[2] for name in files.namelist() if name.endswith(".whl")})
        size = archive.stat().st_size / 1e6
        print(f"{archive.relative_to(ROOT)!s:60} {size:5.1f} MB  {' '.join(pythons)}".rstrip())


def stage_extension(stage: Path, wheels: list[Path]) -> Path:
    """The add-on as it is packed, in the folder `stage`: its manifest names the wheels and their platforms."""
    shutil.rmtree(stage, ignore_errors=True)
    shutil.copytree(ADDON, stage, ignore=shutil.ignore_patterns("__pycache__"))
    (stage / "wheels").mkdir()
    for path in (ROOT / "LICENSE", ROOT / "LICENSES.md"):
        shutil.copy2(path, stage)
    for wheel in wheels:
        shutil.copy2(wheel, stage / "wheels")
    manifest = stage / "blender_manifest.toml"
    platforms = sorted({platform_of(wheel) for wheel in wheels})
    lines = "".join(f'  "./wheels/{wheel.name}",\n' for wheel in wheels)
    text = re.sub(r"^wheels *= *\[.*?\]\n", "", manifest.read_text(), flags=re.MULTILINE | re.DOTALL)
    # Before the first table: a key below one would belong to it.
    head, table, rest = text.partition("\n[")
    manifest.write_text(f"{head.rstrip()}\nplatforms = {json.dumps(platforms)}\nwheels = [\n{lines}]\n{table}{rest}")
    return stage


def pack_extension(stage: Path, folder: Path) -> Path:
    """One zip in `folder` for all platforms of the staged add-on."""
    archive = folder / f"{ADDON.name}-{version()}.zip"
    blender_extension("build", "--source-dir", stage, "--output-filepath", archive)
    blender_extension("validate", archive)
    return archive


def pack_platforms(stage: Path, folder: Path) -> list[Path]:
    """One zip in `folder` for each platform of the staged add-on, with its wheels alone."""
    blender_extension("build", "--split-platforms", "--source-dir", stage, "--output-dir", folder)
    platforms = sorted({platform_of(wheel) for wheel in (stage / "wheels").iterdir()})
    archives = [folder / f"{ADDON.name}-{version()}-{platform.replace('-', '_')}.zip" for platform in platforms]
    for archive in archives:
        blender_extension("validate", archive)
    return archives


def blender_extension(*arguments: str | Path) -> None:
    """Blender's `extension` command, run from the bpy wheel."""
    python = pythons()[-1]
    path = "lib/*/site-packages/bpy/*/scripts/addons_core/bl_pkg/cli/blender_ext.py"
    tool = next(python.parent.parent.glob(path))
    run = subprocess.run([python, tool, *arguments], capture_output=True, text=True, check=False)
    if run.returncode:
        sys.exit(run.stdout + run.stderr)


if __name__ == "__main__":
    makers = {"wheel": lambda _: make_wheels(), "extension": make_extension, "repository": make_repository}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=makers)
    parser.add_argument("platforms", nargs="*", metavar="PLATFORM", help=f"native, {', '.join(PLATFORMS)}")
    arguments = parser.parse_args()
    if unknown := set(arguments.platforms) - {"native", *PLATFORMS}:
        parser.error(f"unknown platforms: {', '.join(sorted(unknown))}")
    makers[arguments.what](arguments.platforms)
