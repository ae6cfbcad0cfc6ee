# SPDX-License-Identifier: GPL-3.0-or-later
"""Fails the n-th write, fsync, rename, open or read of a command; tests/addon/cli/test_failing_calls.py runs it.

    LD_PRELOAD=fail_nth.so python tests/faults/files.py SAMPLES KINDS COMMAND ...

SAMPLES of each kind of call fail, 0: all. KINDS: of calls, as in write,rename.

The result of an earlier run is there before. After a failure it is as it was, or a whole new one is in its place; no
partial file is left; the exit code and the message say why; and the same command works again.
"""

from __future__ import annotations

import ctypes
import errno
import json
import os
import re
import sys
import tempfile
from pathlib import Path
from random import Random

os.environ["BLENDER_USER_RESOURCES"] = tempfile.mkdtemp(prefix="dynamorph_faults_")  # before bpy is imported

import bpy

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / folder) for folder in ("addon", "tests", "tests/addon")]

import dynamic_morph_targets  # noqa: E402
import numpy as np  # noqa: E402
from builders import make_arm  # noqa: E402
from dynamic_morph_targets.cli import main as command_line  # noqa: E402
from dynamic_morph_targets.io import outputs  # noqa: E402

shim = ctypes.CDLL(os.environ["LD_PRELOAD"])
TRY_AGAIN = 75
# Said of a write that fails once, and of reading: Blender does not say why, and writing finds nothing then.
UNKNOWN = ("Blender could not write all of it", "iostream error", outputs.UNREADABLE)
# In the order of fail_nth.c; reading fails for the cache folder alone, which others may have on another machine.
KINDS = {
    "write": errno.ENOSPC, "fsync": errno.EIO, "rename": errno.ESTALE, "open": errno.ENOSPC, "read": errno.ESTALE
}  # fmt: skip
EXPORTS = {"gltf": ".glb", "fbx": ".fbx", "alembic": ".abc", "usd": ".usdc"}
RESULTS = (".blend", ".pc2", ".dynamorph", *EXPORTS.values())
# Name -> arguments; {folder} is where all that they write goes.
COMMANDS = {
    "build": ("build", "{shot}", "--all", "-o", "{folder}/out.blend"),
    "bake": ("bake", "{shot}", "--all", "-o", "{folder}/out.blend", "--report", "{folder}/report.json"),
    "save": ("delete-bake", "{folder}/own.blend", "--all", "--in-place"),
    "pc2": ("bake", "{shot}", "--all", "-o", "{folder}/out.blend", "--format", "pc2"),
    "cache": ("bake", "{shot}", "--all", "-o", "{folder}/out.blend", "--cache-dir", "{folder}/caches"),
    **{
        name: ("bake", "{shot}", "--all", "--format", name, "--output-file", f"{{folder}}/out{suffix}")
        for name, suffix in EXPORTS.items()
    },
}


class Attack:
    """One command in a folder in which calls fail."""

    def __init__(self, name: str, folder: Path, kinds: list[str]):
        self.folder, self.said = folder / "work", folder / "said.txt"
        self.counter = folder / "counter"
        self.counter.write_bytes(bytes(8 * len(KINDS)))
        self.folder.mkdir()
        shot = folder / "shot.blend"
        save_shot(shot)
        self.arguments = [each.format(shot=shot, folder=self.folder) for each in COMMANDS[name]]
        if name == "save":
            (self.folder / "own.blend").write_bytes(shot.read_bytes())
        self.kinds = [kind for kind in kinds if kind != "read" or name == "cache"]
        assert self.run() == 0, self.said.read_text()
        self.counts = self.counted()  # and from now on there is an earlier result each time
        self.before = self.files()

    def run(self) -> int:
        """The exit code; `said` has what was printed."""
        sys.stdout.flush()
        kept = os.dup(1), os.dup(2)
        with self.said.open("w") as said:
            os.dup2(said.fileno(), 1)
            os.dup2(said.fileno(), 2)
            try:
                return command_line.main(self.arguments, opens_file=True)
            finally:
                sys.stdout.flush()
                for fd, to in zip(kept, (1, 2), strict=True):
                    os.dup2(fd, to)
                    os.close(fd)

    def failing(self, kind: str, n: int, once: bool) -> int:
        """The exit code when the n-th such call fails, or all from it on; 0: none."""
        self.counter.write_bytes(bytes(8 * len(KINDS)))
        given = {
            "FAIL_FOLDER": str(self.folder), "FAIL_CALL": kind, "FAIL_NTH": str(n), "FAIL_ERRNO": str(KINDS[kind]),
            "FAIL_COUNTER": str(self.counter), **({"FAIL_ONCE": "1"} if once else {}),
        }  # fmt: skip
        os.environ.update(given)
        shim.fail_files()
        try:
            return self.run()
        finally:
            for name in given:
                del os.environ[name]
            shim.fail_files()

    def counted(self) -> dict[str, int]:
        """How many calls of each kind the command has."""
        assert self.failing("write", 0, once=True) == 0, self.said.read_text()
        counts = np.frombuffer(self.counter.read_bytes(), np.int64)
        return {kind: int(count) for kind, count in zip(KINDS, counts, strict=True) if kind in self.kinds}

    def files(self) -> dict[str, bytes]:
        files = (path for path in self.folder.rglob("*") if path.is_file())
        return {path.relative_to(self.folder).as_posix(): path.read_bytes() for path in files}

    def put_back(self) -> None:
        """Restores all files, each by itself, as two may have become one (a link)."""
        for name in self.files():
            (self.folder / name).unlink()
        for name, content in self.before.items():
            (self.folder / name).write_bytes(content)

    def wrong(self, code: int, kind: str, once: bool) -> list[str]:
        """What is wrong after a failure, from the exit code, the message and the files that are there."""
        said, files, why = self.said.read_text(errors="replace"), self.files(), os.strerror(KINDS[kind])
        new = sorted(files.keys() - self.before.keys())
        found = [f"left behind: {name}" for name in new if ".part" in name or name.endswith("@")]
        # Not what Blender's own exporters print, nor of a file that they leave open.
        if re.search(r'File ".*dynamic_morph_targets', re.sub(r"Exception ignored in.*\n(.*\n)+?\w+Error", "", said)):
            found.append("a traceback")
        # The earlier result or a new one, as when its report alone failed.
        found += [f"exit code {code}, and {text}" for text in self.incomplete(files)]
        if code == 0:
            return found
        messages = re.findall("dynamorph: (.*)", said)
        if code != TRY_AGAIN:
            found.append(f"exit code {code}: {messages}")
        unknown = (once or kind == "read") and any(each in (messages or [""])[-1] for each in UNKNOWN)
        if not messages or (why.lower() not in messages[-1].lower() and not unknown):
            found.append(f"the message does not say '{why}': {messages}")
        return found

    def incomplete(self, files: dict[str, bytes]) -> list[str]:
        """Of the results, as compared with the earlier ones: missing, short, or what Blender does not open."""
        found = []
        for name, content in self.before.items():
            size = len(files.get(name, b""))
            if files.get(name) == content or not name.endswith(RESULTS):
                continue
            if size < 0.99 * len(content):
                found.append(f"{name} has {size} of {len(content)} bytes")
            elif name.endswith(".blend") and not opens(self.folder / name):
                found.append(f"Blender does not open {name}")
        return found


def save_shot(path: Path) -> None:
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    obj = make_arm(bpy.context.scene)
    bpy.ops.dynamorph.add_soft_skin()
    bpy.context.scene.frame_set(20)
    bpy.ops.dynamorph.add_target(key="flexed")
    obj.dynamorph.model.cage_nodes, obj.dynamorph.model.modes = 60, 3
    bpy.context.scene.frame_set(1)
    bpy.context.scene.frame_end = 4
    bpy.ops.wm.save_as_mainfile(filepath=str(path))


def opens(path: Path) -> bool:
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)  # what is open cannot be looked into
    try:
        with bpy.data.libraries.load(str(path)) as (found, _):
            return "Arm" in found.objects
    except OSError:
        return False


def attacked(name: str, samples: int, kinds: list[str]) -> dict:
    """Of each kind of call how many there are and how many failed, and what was wrong then."""
    tally, wrong = {}, []
    with tempfile.TemporaryDirectory(prefix="dynamorph_faults_") as folder:
        attack = Attack(name, Path(folder), kinds)
        for kind, count in attack.counts.items():
            cases = [(n, once) for n in range(1, count + 1) for once in (True, False)]
            if samples:
                cases = Random(f"{name} {kind}").sample(cases, min(samples, len(cases)))
            tally[kind] = [count, len(cases)]
            for n, once in cases:
                case = f"{name}: {kind} {n}{'' if once else ' and all later ones'}"
                print(case, flush=True)  # the last one is where it crashed
                found = attack.wrong(attack.failing(kind, n, once), kind, once)
                if found:
                    print(attack.said.read_text(errors="replace"))
                wrong += [f"{case}: {each}" for each in found]
                attack.put_back()
        if attack.run():
            wrong.append(f"{name}: it fails afterward: {attack.said.read_text()}")
    return {"calls": tally, "wrong": wrong}


def main(samples: str, kinds: str, *names: str) -> None:
    dynamic_morph_targets.register()
    print(json.dumps({name: attacked(name, int(samples), kinds.split(",")) for name in names}))


if __name__ == "__main__":
    main(*sys.argv[1:])
