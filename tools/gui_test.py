# SPDX-License-Identifier: GPL-3.0-or-later
"""Uses the extension in a real Blender window as an artist would: `make gui-test`.

Debian's Blender is set up once in a folder of its own, build/gui or $DYNAMORPH_GUI. The extension is packed and
installed there each time, and tests/gui/scenario.py clicks through it on a virtual screen. If the set-up is impossible
(not root, no network), the reason is printed, and that counts as success; a later failure does not.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import measured
import package
import wheels
from PIL import Image, ImageChops

ROOT = Path(__file__).resolve().parent.parent
CHROOT = Path(os.environ.get("DYNAMORPH_GUI", ROOT / "build/gui")).resolve()
WORK = ROOT / "build/gui-test"
PAGE = ROOT / "docs/window_test.md"
BEGIN, END = "<!-- measured -->", "<!-- end of measured -->"  # in the page
PICTURES = ROOT / "docs/images/guide"
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
    r"STEP \w+|DROP FILE: .*|[\d:.]+ +operator +\| .*|[\d:.]+ +blend +\| Read blend: .*"
    r"|[\d:.]+ +\| INFO: (Starting glTF|Finished glTF|Primitives created|Extracting primitive).*"
    r"|[\d:.]+ +\| WARNING: Armature must be the parent of skinned mesh.*|Armature is selected by its name.*"
    r"|Writing Preset: '.*'|Repository data: .* not found, sync required!"
    r"|.*(Draco|MeshOptimizer) is not available because library could not be found.*"
    r"|.*WARNING Could not get a list of mounted file-systems.*|Info: Added Remote Repository .*"
    r'|Blender is no longer running, shutting down the downloader process|Warning: locking ".*" failed: lock exists.*'
)
LONGEST = 1800  # seconds that the window may take, on a busy machine

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


def run_scenario() -> dict:
    """What tests/gui/driver.py wrote. Raises Failed."""
    shots, result = WORK / "shots", WORK / "result.json"
    shutil.rmtree(shots, ignore_errors=True)
    shots.mkdir()
    result.unlink(missing_ok=True)
    character = WORK / "character.blend"
    character.unlink(missing_ok=True)
    if CHARACTER.exists():
        shutil.copy(CHARACTER, character)
    width, height = map(str, SCREEN)
    code = enter(
        "blender.log", "timeout", str(LONGEST),
        "xvfb-run", "-a", "-s", f"-screen 0 {width}x{height}x24 +extension GLX -noreset",
        "blender", "--gpu-backend", "opengl", "--enable-event-simulate", "--no-window-focus",
        "--window-geometry", "0", "0", width, height, "--python-exit-code", "1",
        "--python", inside(ROOT / "tests/gui/scenario.py"), "--", inside(WORK),
        LIBGL_ALWAYS_SOFTWARE="1",
    )  # fmt: skip
    found = json.loads(result.read_text()) if result.exists() else {}
    if code or not found.get("ok"):
        print_table(found)
        raise Failed(f"{found.get('error') or f'Blender ended with {code}'}\n{tail('blender.log')}\nPictures: {shots}")
    log = (WORK / "blender.log").read_text(errors="replace")
    unknown = [line for line in log.splitlines() if line.strip() and not KNOWN.fullmatch(line)]
    if unknown:  # panels do not raise: their errors are printed here and nowhere else
        raise Failed("the scenario passed, but Blender printed\n" + "\n".join(unknown)[:3000])
    return found


def compare_threads() -> dict[str, str]:
    """A row for the page: a bake in `blender -b` with one core and one with all. Raises Failed."""
    shot, baked, report = (WORK / name for name in ("threads.blend", "threads_baked.blend", "threads.json"))
    shutil.copy(ROOT / "sample_blends/shoulder.blend", shot)
    install = (
        "--command",
        "extension",
        "install-file",
        "-r",
        "user_default",
        "--enable",
        inside(next(WORK.glob("*.zip"))),
    )
    bake = (inside(shot), "--command", "dynamorph", "bake", "--all", "-o", inside(baked), "--report", inside(report))
    cores = {"one core": "0", "all": f"0-{os.cpu_count() - 1}"}
    found = []
    for log, chosen, command in [("install.log", "0", install), *((f"{n}.log", c, bake) for n, c in cores.items())]:
        report.unlink(missing_ok=True)
        if enter(log, "taskset", "-c", chosen, "blender", "-b", *command):
            raise Failed(f"blender -b failed\n{tail(log)}")
        if command is bake:
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
    before, begin, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not end:
        raise Failed(f"{PAGE.name}: the marks {BEGIN} and {END} are missing")
    rows = "".join(f"| {name} | {value} |\n" for name, value in values.items())
    PAGE.write_text(f"{before}{begin}\n| | |\n|---|---|\n{rows}{end}{after}", encoding="utf-8")
    if measured.has_history():
        measured.stamp(PAGE)


def keep_pictures(names: list[str]):
    """Write the guide's pictures as small files. A picture that looks like the existing one is not replaced."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name in names:
        kept = PICTURES / f"{name}.png"
        with Image.open(WORK / "shots" / f"{name}.png") as shot:
            picture = shot.convert("RGB")
            if picture.height > picture.width:  # a panel
                picture = without_empty_rows(picture)
            small = picture.quantize(128, dither=Image.Dither.NONE)
        if not kept.exists() or differ(small, kept):
            small.save(kept, optimize=True)
            print(f"gui-test: {kept.relative_to(ROOT)}, {kept.stat().st_size / 1024:.0f} kB")


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
    WORK.mkdir(parents=True, exist_ok=True)
    try:
        set_up_blender()
        pack_extension()
        start = time.monotonic()
        found = run_scenario()
        print(f"gui-test: {time.monotonic() - start:.0f} s in Blender")
        found["measured"] |= compare_threads()
        write_measured(found["measured"])
    except CannotRun as reason:
        print(f"gui-test: SKIPPED, {reason}")
        return 0
    except Failed as problem:
        print(f"gui-test: FAILED, {problem}")
        return 1
    print_table(found)
    keep_pictures(found["pictures"])
    return 0


if __name__ == "__main__":
    sys.exit(main())
