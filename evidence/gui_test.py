# SPDX-License-Identifier: GPL-3.0-or-later
"""Uses the extension in a real Blender window as an artist would: `make gui-test`.

Debian's Blender is set up once in a folder of its own, build/gui or $DYNAMORPH_GUI. The extension is packed and
installed there each time, and evidence/window/scenario.py clicks through it on a virtual screen, in parts: each in a
Blender of its own, which opens what the part before it has saved. `make gui-test parts="judging files"` repeats only
these, from what the last run has left. If the set-up is impossible (not root, no network), the reason is printed, and
that counts as success; a later failure does not."""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

from project import ROOT

import measured
import package
import wheels
from PIL import Image, ImageChops, ImageDraw, ImageFont

CHROOT = Path(os.environ.get("DYNAMORPH_GUI", ROOT / "build/gui")).resolve()
WORK = ROOT / "build/gui-test"
INSTALLED = WORK / "user/extensions/user_default/dynamic_morph_targets"
PAGE = ROOT / "evidence/window_test.md"
BEGIN, END = "<!-- measured -->", "<!-- end of measured -->"  # in the page
PICTURES = ROOT / "docs/images/guide"
DISC, ACCENT = 10, "#d3531b"  # pixels, its radius: of the numbers in pictures, and their color
CHARACTER = ROOT.parent / "shared/assets/mh_male_53bones.blend"  # the last part runs without it, and says so
INSIDE = Path("/mnt/dynamorph")  # this repository, seen from the chroot
SCREEN = (1920, 1080)
MIRROR = "http://deb.debian.org/debian"
PYTHON = "3.14"  # of Debian's Blender
WHEEL_TOOLS = ROOT / ".venv/wheels/bin/python"
PACKAGES = (
    "blender xvfb xauth imagemagick libgl1-mesa-dri "
    "python3-numpy python3-cattr python3-requests python3-urllib3 python3-zstandard"  # what its extensions import
)
# All that Blender may print: the steps, what operators report, the glTF exporter, presets, and what Debian's lacks.
KNOWN = re.compile(
    r"STEP \w+|DROP FILE: .*|[\d:.]+ +operator +\| .*|[\d:.]+ +blend +\| (Read blend|Writing user preferences): .*"
    r"|[\d:.]+ +\| INFO: (Starting glTF|Finished glTF|Primitives created|Extracting primitive).*"
    r"|[\d:.]+ +\| WARNING: Armature must be the parent of skinned mesh.*|Armature is selected by its name.*"
    r"|Info: (Preferences saved|Saved copy as .*)|Writing Preset: '.*'|Repository data: .* not found, sync required!"
    r"|.*(Draco|MeshOptimizer) is not available because library could not be found.*"
    r"|.*WARNING Could not get a list of mounted file-systems.*|Info: Added Remote Repository .*"
    r'|".*@" is not a supported module name, skipping'  # while Blender installs one
    r'|Blender is no longer running, shutting down the downloader process|Warning: locking ".*" failed: lock exists.*'
)
# In their order, with the seconds that each may take: on a busy machine ten times as many as on a free one.
PARTS = {
    "repository": 300, "first_bake": 1200, "grabbing": 900, "judging": 1800, "authoring": 1800, "trying": 1800,
    "colliding": 1200, "baking": 2400, "files": 1200, "menus": 1200, "panels": 2400, "character": 1800,
}  # fmt: skip
INSTALLS = "first_bake"  # the part that installs the extension; later ones find it installed

# Mounts in a namespace of their own: whatever happens, nothing stays mounted in a folder that may be deleted.
# The shell stays: an X server tells nobody that it is ready if its parent is process 1.
ENTER = """
mount -t proc proc "$0/proc"; mount --bind /dev "$0/dev"
mkdir -p "$0$2"; mount --bind "$1" "$0$2"
chroot "$0" /usr/bin/env -i "${@:3}" || exit $?
"""


class CannotRun(Exception):
    """Why there is no window to test in."""


class Failed(Exception):
    """What went wrong."""


def inside(path: Path) -> Path:
    return INSIDE / path.relative_to(ROOT)


def enter(log: str, *command: str | Path, network=False, **environment) -> int:
    """Run a command in the chroot with its output in WORK/`log`; returns its exit code. Its children die with it."""
    variables = {
        "PATH": "/usr/bin:/bin:/usr/sbin:/sbin", "LANG": "C.UTF-8", "HOME": "/root", "XDG_RUNTIME_DIR": "/tmp",
        "DEBIAN_FRONTEND": "noninteractive", "BLENDER_USER_RESOURCES": inside(WORK / "user"), **environment,
    }  # fmt: skip
    if network:
        variables |= {name: os.environ[name] for name in ("http_proxy", "https_proxy") if name in os.environ}
    namespaces = ["--mount", "--pid", "--fork", "--kill-child", *(() if network else ("--net",))]
    run = ["unshare", *namespaces, "bash", "-ec", ENTER, CHROOT, ROOT, INSIDE]
    with (WORK / log).open("w") as output:
        return subprocess.run(
            [*run, *(f"{name}={value}" for name, value in variables.items()), *command],
            stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, check=False,
        ).returncode  # fmt: skip


def tail(log: str, lines=30) -> str:
    return "\n".join((WORK / log).read_text(errors="replace").splitlines()[-lines:])


# Set-up --------------------------------------------------------------------------------------------------------------


def set_up_blender():
    """Debian sid with Blender and a compiler in CHROOT. Raises CannotRun."""
    if os.geteuid() != 0:
        raise CannotRun("a chroot needs root")
    alone = ["unshare", "--mount", "--pid", "--net", "--fork", "true"]
    if not shutil.which("unshare") or subprocess.run(alone, capture_output=True, check=False).returncode:
        raise CannotRun("this process may not create namespaces (unshare)")
    done = CHROOT / "dynamorph-packages"
    if done.exists() and done.read_text() == PACKAGES:
        return
    try:
        urllib.request.urlopen(f"{MIRROR}/dists/sid/Release", timeout=30).close()
    except OSError as error:
        raise CannotRun(f"{MIRROR} cannot be reached ({error})") from error
    print(f"gui-test: setting up Blender in {CHROOT}, which takes some minutes and 2.6 GB", flush=True)
    if not CHROOT.exists():
        if not shutil.which("debootstrap"):
            run_here("apt-get", "-qq", "update")
            run_here("apt-get", "-qq", "install", "-y", "debootstrap")
        run_here("unshare", "--mount", "debootstrap", "--variant=minbase", "sid", CHROOT, MIRROR)
    # A mirror may be behind: then its lists are past their date.
    for command in ("apt-get -o Acquire::Check-Valid-Until=false update",
                    f"apt-get install -y --no-install-recommends {PACKAGES}"):  # fmt: skip
        if enter("packages.log", *command.split(), network=True):
            raise CannotRun(f"Blender could not be installed in {CHROOT}\n{tail('packages.log')}")
    done.write_text(PACKAGES)


def run_here(*command: str | Path):
    """A step of the set-up outside the chroot. Raises CannotRun."""
    try:
        with (WORK / "debootstrap.log").open("w") as log:
            subprocess.run(command, stdout=log, stderr=subprocess.STDOUT, check=True)
    except FileNotFoundError as error:
        raise CannotRun(f"{command[0]} is missing") from error
    except subprocess.CalledProcessError as error:
        hint = f"; remove {CHROOT} to try again" if CHROOT.exists() else ""
        raise CannotRun(f"{' '.join(map(str, command))} failed{hint}\n{tail('debootstrap.log')}") from error


def pack_extension():
    """For a Blender without any user settings: a wheel of the same version would not replace what is there."""
    wheel = wheels.wheel_path("linux-x64", PYTHON)
    run = [WHEEL_TOOLS, ROOT / "tools/wheels.py", "--platforms", "linux-x64", "--pythons", PYTHON]
    if subprocess.run(run, check=False).returncode:
        raise Failed("the engine for Debian's Blender was not compiled")
    for old in WORK.glob("*.zip"):
        old.unlink()
    stage = package.stage_extension(WORK / "extension", [wheel])
    package.pack_extension(stage, WORK)
    package.fill_repository(stage, WORK / "repository")
    shutil.rmtree(WORK / "user", ignore_errors=True)
    (WORK / "user").mkdir()


# The test ------------------------------------------------------------------------------------------------------------


def chosen_parts(named: list[str]) -> list[str]:
    """The parts to run, in their order; none named: all. Raises Failed."""
    unknown = [name for name in named if name not in PARTS]
    if unknown:
        raise Failed(f"there is no part {', '.join(unknown)}, but {', '.join(PARTS)}")
    chosen = [name for name in PARTS if not named or name in named]
    if "character" in chosen and not CHARACTER.exists():
        print("gui-test: without the part 'character': there is no ../shared/assets/mh_male_53bones.blend", flush=True)
        chosen.remove("character")
    return chosen


def install():
    """As the part INSTALLS does it by hand. Raises Failed."""
    archive = inside(next(WORK.glob("*.zip")))
    command = ("blender", "-b", "--command", "extension", "install-file", "-r", "user_default", "--enable", archive)
    if enter("install.log", *command):
        raise Failed(f"the extension could not be installed\n{tail('install.log')}")


def start_of(part: str) -> Path | None:
    """The .blend that a part opens, which an earlier one has saved; None: it begins with an empty Blender. Raises
    Failed.
    """
    names = list(PARTS)
    if names.index(part) <= names.index(INSTALLS):
        return None
    start = WORK / f"{names[names.index(part) - 1]}.blend"
    if not start.exists():
        raise Failed(f"'{part}' begins with what '{start.stem}' leaves: run that first")
    return start


def run_part(part: str) -> dict:
    """What evidence/window/driver.py wrote about a part. Raises Failed."""
    result, log = WORK / f"{part}.json", f"{part}.log"
    start = start_of(part)
    if start and not INSTALLED.exists():
        install()
    for old in (result, WORK / f"{part}.blend"):
        old.unlink(missing_ok=True)
    if part == "character":
        shutil.copy(CHARACTER, WORK / "character_before.blend")
    width, height = map(str, SCREEN)
    code = enter(
        log, "timeout", str(PARTS[part]),
        "xvfb-run", "-a", "-s", f"-screen 0 {width}x{height}x24 +extension GLX -noreset",
        "blender", "--gpu-backend", "opengl", "--enable-event-simulate", "--no-window-focus",
        "--window-geometry", "0", "0", width, height, "--python-exit-code", "1",
        *([inside(start)] if start else []),
        "--python", inside(ROOT / "evidence/window/scenario.py"), "--", inside(WORK), part,
        LIBGL_ALWAYS_SOFTWARE="1",
    )  # fmt: skip
    found = json.loads(result.read_text()) if result.exists() else {}
    if code or not found.get("ok"):
        print_table(found)
        why = f"it took longer than {PARTS[part]} s" if code == 124 else f"Blender ended with {code}"
        raise Failed(f"part '{part}': {found.get('error') or why}\n{tail(log)}\nPictures: {WORK / 'shots'}")
    printed = (WORK / log).read_text(errors="replace").splitlines()
    unknown = [line for line in printed if line.strip() and not KNOWN.fullmatch(line)]
    if unknown:  # panels do not raise: their errors are printed here and nowhere else
        raise Failed(f"part '{part}' passed, but Blender printed\n" + "\n".join(unknown)[:3000])
    return found


def check_openings(results: list[dict]):
    """Nothing is left that no part has opened, and nothing was opened under another name. Raises Failed."""
    there, opened = ({name for found in results for name in found[kind]} for kind in ("there", "opened"))
    if never := sorted(there - opened):
        raise Failed(f"never opened: {', '.join(never)}")
    if unknown := sorted(opened - there):
        raise Failed(f"opened, but not noted as something that opens: {', '.join(unknown)}")


def compare_threads() -> dict[str, str]:
    """A row for the page: a bake in `blender -b` with one core and one with all. Raises Failed."""
    shot, baked, report = (WORK / name for name in ("threads.blend", "threads_baked.blend", "threads.json"))
    shutil.copy(ROOT / "sample_blends/shoulder.blend", shot)
    install()
    bake = (inside(shot), "--command", "dynamorph", "bake", "--all", "-o", inside(baked), "--report", inside(report))
    cores = {"one core": "0", "all": f"0-{os.cpu_count() - 1}"}
    found = []
    for name, chosen in cores.items():
        report.unlink(missing_ok=True)
        if enter(f"{name}.log", "taskset", "-c", chosen, "blender", "-b", *bake):
            raise Failed(f"blender -b failed\n{tail(f'{name}.log')}")
        characters = json.loads(report.read_text(encoding="utf-8"))["characters"]
        found.append([(each["model"], each["bake"]["hash"]) for each in characters])
    if found[0] != found[1]:
        raise Failed(f"blender -b makes other bytes with one core than with all: {found}")
    return {"`blender -b` with one core, and with all": "the same bytes"}


def print_table(found: dict):
    rows = [(step["title"], f"{step['seconds']:5.1f} s, actions: {step['actions']}") for step in found.get("steps", [])]
    rows += found.get("measured", {}).items()
    width = max((len(name) for name, _ in rows), default=0)
    for name, value in rows:
        print(f"{name:{width}}  {value}")


def write_measured(values: dict[str, str]):
    """Write the table of the page, and the commit at which it was measured."""
    rows = [f"| {name} | {value} |" for name, value in values.items()]
    measured.write_between(PAGE, BEGIN, END, "\n".join(["| | |", "|---|---|", *rows]))
    if measured.has_history():
        measured.stamp(PAGE)


def keep_pictures(names: list[str], numbered: dict[str, list]):
    """Write the pages' pictures as small files, with the numbers that explain them. A picture that looks like the
    existing one is not replaced.
    """
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name in names:
        kept = PICTURES / f"{name}.png"
        with Image.open(WORK / "shots" / f"{name}.png") as shot:
            picture = shot.convert("RGB")
            if picture.height > picture.width:  # a panel
                picture = without_empty_rows(picture)
            picture = with_numbers(picture, numbered.get(name, []))
            small = picture.quantize(128, dither=Image.Dither.NONE)
        if not kept.exists() or differ(small, kept):
            small.save(kept, optimize=True)
            print(f"gui-test: {kept.relative_to(ROOT)}, {kept.stat().st_size / 1024:.0f} kB")


def with_numbers(picture: Image.Image, places: list) -> Image.Image:
    """Numbers in discs, from 1 on, at (x, y) of the picture, which gets margins for those beside it."""
    if not places:
        return picture
    margin = 5 * DISC // 2 if any(not 0 <= x < picture.width for x, _ in places) else 0
    wider = Image.new("RGB", (picture.width + 2 * margin, picture.height), picture.getpixel((0, 0)))
    wider.paste(picture, (margin, 0))
    scale = 4  # for smooth edges
    discs = Image.new("RGBA", (wider.width * scale, wider.height * scale))
    draw, font = ImageDraw.Draw(discs), ImageFont.load_default(scale * 1.3 * DISC)
    for number, (x, y) in enumerate(places, 1):
        middle = scale * (x + margin), scale * y
        draw.circle(middle, scale * DISC, fill=ACCENT)
        draw.text(middle, str(number), fill="white", font=font, anchor="mm")
    discs = discs.resize(wider.size, Image.Resampling.LANCZOS)
    wider.paste(discs, mask=discs)
    return wider


def without_empty_rows(picture: Image.Image, margin=10) -> Image.Image:
    """Cut off the uniform rows at the bottom, except for a margin, which also keeps an editor's border."""
    width, height = picture.size
    inner = picture.crop((0, 0, width, height - margin))
    last = inner.crop((0, inner.height - 1, width, inner.height)).resize(inner.size)
    box = ImageChops.difference(inner, last).getbbox()
    return picture.crop((0, 0, width, box[3] + margin)) if box else picture


def differ(picture: Image.Image, path: Path) -> bool:
    """Whether two pictures differ by more than a blinking cursor, or a time that a button shows."""
    with Image.open(path) as other:
        if other.size != picture.size:
            return True
        difference = ImageChops.difference(picture.convert("L"), other.convert("L"))
    changed = sum(difference.histogram()[24:])
    return changed > 0.005 * picture.width * picture.height


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", help=f"which to run, of {', '.join(PARTS)}; all if none is named")
    named = parser.parse_args().parts
    WORK.mkdir(parents=True, exist_ok=True)
    results = []
    try:
        parts = chosen_parts(named)
        set_up_blender()
        pack_extension()
        if not named:
            shutil.rmtree(WORK / "shots", ignore_errors=True)
        (WORK / "shots").mkdir(exist_ok=True)
        for part in parts:
            start = time.monotonic()
            results.append(run_part(part))
            print(f"gui-test: {part}, {time.monotonic() - start:.0f} s in Blender", flush=True)
            print_table(results[-1])
            keep_pictures(results[-1]["pictures"], results[-1]["numbered"])
        if not named:
            check_openings(results)
            measured_values = {name: value for found in results for name, value in found["measured"].items()}
            write_measured(measured_values | compare_threads())
    except CannotRun as reason:
        print(f"gui-test: SKIPPED, {reason}")
        return 0
    except Failed as problem:
        print(f"gui-test: FAILED, {problem}")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
