# SPDX-License-Identifier: GPL-3.0-or-later
"""Random walks over all that an artist can press and change, in one process: `make -C evidence soak`.

    python tests/addon/soak.py --minutes 5
    python tests/addon/soak.py --seed 7 --steps 240      the first 240 steps of the walk with that seed again

After each step nothing unexpected was raised, the add-on's handlers are there once, and nothing was left: no temporary
data, thread, open file or partial file. At each new file the memory is compared. The log says what was done, each step
before it is taken, and has all that Blender printed.
"""

from __future__ import annotations

import argparse
import ctypes
import faulthandler
import gc
import math
import os
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter
from pathlib import Path
from random import Random

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).resolve().parent
sys.path[:0] = map(str, (ROOT / "addon", ROOT / "tests", HERE, *filter(Path.is_dir, HERE.iterdir())))

from installed import MODULE, leave  # noqa: E402, I001 - before bpy

import addon_utils  # noqa: E402 - of bpy
import bpy  # noqa: E402
import long_runs  # noqa: E402
import numpy as np  # noqa: E402
from bl_ext.user_default.dynamic_morph_targets.cli import commands  # noqa: E402
from bl_ext.user_default.dynamic_morph_targets.run.work import child  # noqa: E402
from bl_ext.user_default.dynamic_morph_targets.write.export import exports  # noqa: E402
from builders import activate, make_arm, make_soft, soon  # noqa: E402
from pressed import Pressed  # noqa: E402
from test_undo_and_files import handlers  # noqa: E402

OPS = bpy.ops.dynamorph
LOG = ROOT / "build" / "soak.txt"
LONGEST = 60.0  # seconds for a step
CHAPTER = 30  # steps from one new file to the next
WARM = 20  # new files until Blender and Python have what they keep; the memory is judged after as many more
GROWTH = 0.5  # MB for each new file after that
# Most that a step may ask for, so that a walk takes many: (of the group, the property) -> highest value.
CHEAP = {
    ("model", "cage_nodes"): 250, ("model", "modes"): 8, ("simulation", "substeps"): 8, ("simulation", "samples"): 3,
}  # fmt: skip


class Walk:
    """One walk: what it draws depends on the seed and on what Blender shows alone, so that it can be repeated."""

    def __init__(self, seed: int, folder: Path, log):
        self.random, self.folder, self.log = Random(seed), folder, log
        self.steps = 0
        self.memory = []  # MB at each new file
        self.installed = handlers()
        self.files = open_files()

    def say(self, text: str):
        self.log.write(f"{self.steps:5d}  {text}\n")
        self.log.flush()

    def one_of(self, choices):
        """Any of them, None of none. Their order must not depend on chance."""
        return self.random.choice(choices) if choices else None

    def mesh(self):
        """The mesh that the artist works on: the active one, or else any."""
        meshes = [obj for obj in bpy.context.scene.objects if obj.type == "MESH"]
        active = bpy.context.object
        return active if active in meshes and self.random.random() < 0.8 else self.one_of(meshes)

    def step(self) -> list[str]:
        """Do something, and return what is wrong then."""
        self.steps += 1
        if self.steps % CHAPTER == 1:
            do = new_file
        else:
            (do,) = self.random.choices(list(STEPS), STEPS.values())
        make_cheap()
        orphans, before = unused_data(), Path(self.log.name).stat().st_size
        began = time.monotonic()
        faulthandler.dump_traceback_later(2 * LONGEST, exit=True, file=self.log)
        with soon():
            do(self)
        faulthandler.cancel_dump_traceback_later()
        if do not in (new_file, press):
            orphans = unused_data()  # only what a button leaves counts
        wrong = [f"it took {time.monotonic() - began:.0f} s"] if time.monotonic() - began > LONGEST else []
        return wrong + self.printed(before) + self.left(orphans)

    def printed(self, before: int) -> list[str]:
        """Tracebacks among what Blender and Python have printed since the log was so long."""
        sys.stderr.flush()
        with Path(self.log.name).open("rb") as log:
            log.seek(before)
            printed = log.read().decode(errors="replace")
        return ["a traceback was printed"] if "Traceback" in printed or "This is a bug" in printed else []

    def left(self, orphans: set) -> list[str]:
        """What is there and should not be."""
        now, expected = (Counter(each) for each in (handlers(), self.installed))
        found = {
            "handlers": sorted((now - expected) + (expected - now)),  # too often, or missing
            "unused data": sorted(unused_data() - orphans),
            "scenes": [scene.name for scene in bpy.data.scenes if scene != bpy.context.scene],
            "threads": [thread.name for thread in threading.enumerate() if thread.name.startswith("dynamorph")],
            "open files": sorted(self.opened()),
            "partial files": [path.name for path in self.folder.rglob("*.part*")],
        }
        return [f"{what}: {', '.join(map(str, names))}" for what, names in found.items() if names]

    def opened(self) -> set[str]:
        """Files that are still open. A process that waits for work has one, until it ends by itself."""
        child.dismiss()
        return open_files() - self.files


# What there is -----------------------------------------------------------------------------------------------------


def unused_data() -> set[tuple[str, str]]:
    """The data blocks that nothing uses, which Blender forgets when it saves."""
    kinds = ("actions", "armatures", "collections", "materials", "meshes", "objects", "shape_keys", "textures")
    return {(kind, each.name) for kind in kinds for each in getattr(bpy.data, kind) if not each.users}


def open_files() -> set[str]:
    found = set()
    for link in Path("/proc/self/fd").iterdir():
        try:
            path = str(link.readlink())
        except OSError:  # the one that lists them
            continue
        if path.startswith("/") and not path.startswith(("/dev", "/proc")):
            found.add(path)
    return found


def memory() -> float:
    """MB that the process holds, without what the C library could give back."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def growth(memory: list[float]) -> float:
    """MB for each new file, after the first few: the median of the slopes between all pairs, which a step does not
    move.
    """
    late = memory[WARM:]
    slopes = [(b - a) / (j - i) for i, a in enumerate(late) for j, b in enumerate(late) if i < j]
    return float(np.median(slopes)) if len(late) > WARM else 0.0


def make_cheap():
    for obj in bpy.data.objects:
        for (group, name), most in CHEAP.items():
            settings = getattr(obj.dynamorph, group)
            if getattr(settings, name) > most:
                setattr(settings, name, most)


# Steps -------------------------------------------------------------------------------------------------------------


def go_to(walk: Walk, obj):
    """Make the object the active one; as in a window, another one leaves its mode first."""
    if bpy.context.object != obj:
        set_mode(walk, "OBJECT")
    activate(obj)


def attempt(walk: Walk, operator, *args, **settings):
    """Call an operator; what it refuses in a sentence is no failure."""
    try:
        operator(*args, **settings)
    except RuntimeError as refusal:
        walk.say(f"refused: {str(refusal).strip()}")


def value_for(walk: Walk, prop, names: list[str]):
    """Any value that the interface lets an artist choose for a property. names: what texts may be."""
    if getattr(prop, "is_array", False):
        return [value_for_number(walk, prop) for _ in range(prop.array_length)]
    if prop.type == "BOOLEAN":
        return walk.random.random() < 0.5
    if prop.type == "ENUM":
        return walk.one_of([item.identifier for item in prop.enum_items]) or prop.default
    if prop.type in ("INT", "FLOAT"):
        return value_for_number(walk, prop)
    return walk.one_of([*names, "", "No Such Name"])


def value_for_number(walk: Walk, prop):
    """Most often near the default, at times an end of the slider."""
    low, high = prop.soft_min, prop.soft_max
    near = prop.default or 1.0
    value = walk.random.choice([low, high, near, near * 10.0 ** walk.random.uniform(-1, 1)])
    value = min(max(value, low), high)
    return round(value) if prop.type == "INT" else value


def names_in(obj) -> list[str]:
    """All names that the add-on may be given: of keys, groups, bones, objects."""
    keys = obj.data.shape_keys.key_blocks.keys() if obj.data.shape_keys else []
    bones = [bone.name for armature in bpy.data.armatures for bone in armature.bones]
    return [*keys, *bones, *obj.vertex_groups.keys(), *bpy.data.objects.keys()]


def file_for(walk: Walk, name: str, settings: dict) -> str:
    """A file for a button to read or write, which may be there already."""
    if name == "load_preset":
        presets = sorted(Path(os.environ["BLENDER_USER_RESOURCES"]).glob("scripts/presets/**/*.py"))
        return str(walk.one_of(presets) or "")
    suffix = exports.FORMATS[settings.setdefault("format", "GLTF")].suffix if "export" in name else ".json"
    return str(walk.folder / f"file {walk.random.randrange(3)}{suffix}")


def press(walk: Walk):
    """Any button of the add-on that can be pressed."""
    obj = walk.mesh()
    if obj is None:
        return
    go_to(walk, obj)
    name = walk.one_of([name for name in sorted(dir(OPS)) if getattr(OPS, name).poll()])
    if name is None:
        return
    operator, settings = getattr(OPS, name), {}
    for prop in operator.get_rna_type().properties:
        if prop.identifier == "rna_type" or prop.is_readonly:
            continue
        if walk.random.random() < 0.7:
            settings[prop.identifier] = value_for(walk, prop, names_in(obj))
    if "filepath" in operator.get_rna_type().properties:
        settings["filepath"] = file_for(walk, name, settings)
    if name == "load_preset":  # one of a menu
        settings["menu_idname"] = walk.one_of(["DYNAMORPH_PT_material_presets", "DYNAMORPH_PT_setup_presets"])
    walk.say(f"{name} {settings}")
    attempt(walk, operator, "EXEC_DEFAULT", True, **settings)


def press_and_cancel(walk: Walk):
    """A job in a window, which Esc cancels."""
    obj = walk.mesh()
    if obj is None:
        return
    go_to(walk, obj)
    name = walk.one_of([name for name in ("bake", "bake_all", "build") if getattr(OPS, name).poll()])
    if name:
        walk.say(f"{name}, canceled")
        attempt(walk, Pressed, obj, ["ESC"], f"DYNAMORPH_OT_{name}")


def change_setting(walk: Walk):
    obj = walk.mesh()
    if obj is None or not obj.dynamorph.targets:
        return
    settings = commands.SETTINGS
    group = walk.one_of(["target", *settings])
    owner = walk.one_of(list(obj.dynamorph.targets)) if group == "target" else getattr(obj.dynamorph, group)
    name = walk.one_of(commands.SETTABLE if group == "target" else settings[group])
    value = value_for(walk, owner.bl_rna.properties[name], names_in(obj))
    walk.say(f"{obj.name}: {group}.{name} = {value}")
    if (group, name) in CHEAP:
        value = min(value, CHEAP[group, name])
    setattr(owner, name, value)
    bpy.ops.ed.undo_push(message="change")


def frame(walk: Walk):
    """A jump, or some frames of playback."""
    scene = bpy.context.scene
    first, count = walk.random.randint(-2, 24), walk.random.choice([1, 1, 6])
    walk.say(f"frames {first} to {first + count - 1}")
    for each in range(first, first + count):
        scene.frame_set(each)


def pose(walk: Walk):
    rigs = [obj for obj in bpy.context.scene.objects if obj.type == "ARMATURE" and obj.pose.bones]
    rig = walk.one_of(rigs)
    if rig is None:
        return
    bone = walk.one_of(list(rig.pose.bones))
    at, angle = walk.random.randint(1, 20), walk.random.uniform(-1.5, 1.5)
    walk.say(f"{rig.name}: {bone.name} turns to {angle:.2f} at {at}")
    bone.rotation_euler[walk.random.randrange(3)] = angle
    bone.keyframe_insert("rotation_euler", frame=at)
    bpy.ops.ed.undo_push(message="pose")


def parts_of(walk: Walk) -> tuple[str, list]:
    """A kind of thing that has a name, and all of them in the scene."""
    meshes = [obj for obj in bpy.context.scene.objects if obj.type == "MESH"]
    rigs = [obj for obj in bpy.context.scene.objects if obj.type == "ARMATURE"]
    keys = [obj.data.shape_keys for obj in meshes if obj.data.shape_keys]
    kinds = {
        "object": list(bpy.context.scene.objects),
        "bone": [bone for rig in rigs for bone in rig.data.bones],
        "key": [block for each in keys for block in each.key_blocks],
        "group": [group for obj in meshes for group in obj.vertex_groups],
        "modifier": [modifier for obj in meshes for modifier in obj.modifiers],
        "action": list(bpy.data.actions),
    }
    kind = walk.one_of(list(kinds))
    return kind, kinds[kind]


def rename(walk: Walk):
    kind, parts = parts_of(walk)
    each = walk.one_of(parts)
    if each is not None:
        name = f"{kind} {walk.random.randrange(100)}" + walk.one_of(["", ".L", " ü", ".001", '"'])
        walk.say(f"{kind} '{each.name}' becomes '{name}'")
        each.name = name
        bpy.ops.ed.undo_push(message="rename")


def delete(walk: Walk):
    kind, parts = parts_of(walk)
    each = walk.one_of(parts)
    if each is None:
        return
    walk.say(f"{kind} '{each.name}' is deleted")
    owner = each.id_data
    if kind == "object":
        bpy.data.objects.remove(each)
    elif kind == "action":
        bpy.data.actions.remove(each)
    elif kind == "bone":
        delete_bone(walk, owner, each.name)
    elif kind == "key":
        next(obj for obj in bpy.data.objects if obj.data == owner.user).shape_key_remove(each)
    elif kind == "group":
        owner.vertex_groups.remove(each)
    else:
        owner.modifiers.remove(each)
    bpy.ops.ed.undo_push(message="delete")


def delete_bone(walk: Walk, armature, name: str):
    rig = next((obj for obj in bpy.context.scene.objects if obj.data == armature), None)
    if rig is None:
        return
    go_to(walk, rig)
    if set_mode(walk, "EDIT"):
        armature.edit_bones.remove(armature.edit_bones[name])
        set_mode(walk, "OBJECT")


def set_mode(walk: Walk, mode: str) -> bool:
    """Whether the active object is in that mode then."""
    obj = bpy.context.object
    if obj is not None and obj.mode != mode and bpy.ops.object.mode_set.poll():
        attempt(walk, bpy.ops.object.mode_set, mode=mode)
    return obj is None or obj.mode == mode


def edit(walk: Walk):
    """Another mode, or a mesh whose vertices were moved."""
    obj = walk.mesh()
    if obj is None:
        return
    go_to(walk, obj)
    mode = walk.one_of(["OBJECT", "OBJECT", "EDIT", "SCULPT", "WEIGHT_PAINT"])
    walk.say(f"{obj.name}: {mode}")
    if set_mode(walk, mode) and mode == "OBJECT" and len(obj.data.vertices):
        obj.data.vertices[0].co.x += walk.random.uniform(-0.05, 0.05)
        obj.data.update()
    bpy.ops.ed.undo_push(message="edit")


def undo(walk: Walk):
    back = walk.random.random() < 0.7
    operator = bpy.ops.ed.undo if back else bpy.ops.ed.redo
    walk.say("undo" if back else "redo")
    if operator.poll():
        attempt(walk, operator)


def save(walk: Walk):
    path = walk.folder / f"shot{walk.random.randrange(3)}.blend"
    walk.say(f"save {path.name}")
    attempt(walk, bpy.ops.wm.save_as_mainfile, filepath=str(path), copy=walk.random.random() < 0.3)


def load(walk: Walk):
    path = walk.one_of(sorted(walk.folder.glob("*.blend")))
    if path:
        walk.say(f"load {path.name}")
        attempt(walk, bpy.ops.wm.open_mainfile, filepath=str(path))
        bpy.ops.ed.undo_push(message="load")


def new_file(walk: Walk):
    """Another empty file, where the memory is compared, and a character in it."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    walk.memory.append(memory())
    walk.say(f"new file: {walk.memory[-1]:.1f} MB")
    add_character(walk)


def add_character(walk: Walk):
    if len(bpy.context.scene.objects) > 6:
        return
    name = f"Arm {walk.random.randrange(10)}"
    walk.say(f"another character: {name}")
    obj = make_arm(bpy.context.scene, name)
    if walk.random.random() < 0.9:
        make_soft(obj)
        obj.dynamorph.model.cage_nodes, obj.dynamorph.model.modes = 120, 5
    bpy.context.scene.frame_end = 12
    bpy.ops.ed.undo_push(message="character")


def duplicate(walk: Walk):
    obj = walk.mesh()
    if obj is None or len(bpy.context.scene.objects) > 6:
        return
    copy = obj.copy()
    if walk.random.random() < 0.5:
        copy.data = obj.data.copy()
    bpy.context.scene.collection.objects.link(copy)
    copy.select_set(True)
    walk.say(f"'{obj.name}' is duplicated as '{copy.name}'")
    bpy.ops.ed.undo_push(message="duplicate")


def turn_off_and_on(walk: Walk):
    """The add-on; sometimes a file is loaded in between."""
    walk.say("the add-on is turned off")
    addon_utils.disable(MODULE)
    if handlers():
        raise AssertionError(f"handlers without the add-on: {handlers()}")
    if walk.random.random() < 0.3:
        load(walk)
    walk.say("and on")
    addon_utils.enable(MODULE)


STEPS = {
    press: 40, press_and_cancel: 2, change_setting: 12, frame: 10, pose: 5, rename: 5, delete: 3, edit: 4, undo: 10,
    save: 3, load: 2, add_character: 2, duplicate: 2, turn_off_and_on: 1,
}  # fmt: skip


# The command ---------------------------------------------------------------------------------------------------------


def redirect(stream: int, log) -> int:
    """Let what is written to a stream go to the log, also by Blender; returns where it went before."""
    before = os.dup(stream)
    os.dup2(log.fileno(), stream)
    return before


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    length = parser.add_mutually_exclusive_group(required=True)
    length.add_argument("--minutes", type=float, default=math.inf)
    length.add_argument("--steps", type=int, default=math.inf)
    parser.add_argument("--seed", type=int, default=time.time_ns() % 10**6)
    parser.add_argument("--log", type=Path, default=LOG)
    args = parser.parse_args()
    args.log.parent.mkdir(parents=True, exist_ok=True)
    args.log.unlink(missing_ok=True)
    with args.log.open("a") as log, tempfile.TemporaryDirectory(prefix="dynamorph_soak_") as folder:
        terminal = os.fdopen(redirect(1, log), "w", buffering=1)
        redirect(2, log)
        faulthandler.enable(log)
        print(f"soak: seed {args.seed}; {args.log} has the steps", file=terminal)
        assert addon_utils.enable(MODULE, default_set=True)
        walk, began = Walk(args.seed, Path(folder), log), time.monotonic()
        wrong = walk_on(walk, args.steps, began + 60.0 * args.minutes)
        if args.log == LOG:
            long_runs.keep(
                "soak", f"seed {args.seed}", steps=walk.steps, files=len(walk.memory), wrong=wrong,
                hours=(time.monotonic() - began) / 3600.0, memory=walk.memory[-1], growth=growth(walk.memory),
            )  # fmt: skip
        print(
            f"soak: {walk.steps} steps, {len(walk.memory)} files, memory {walk.memory[-1]:.0f} MB, which grows by "
            f"{growth(walk.memory):.2f} MB with each file",
            file=terminal,
        )
        for text in wrong:
            print(f"soak: after step {walk.steps}: {text}", file=terminal)
        if wrong:
            print(f"soak: again: make -C evidence soak seed={args.seed} steps={walk.steps}", file=terminal)
    return 1 if wrong else 0


def walk_on(walk: Walk, steps: float, until: float) -> list[str]:
    """Until something is wrong, or for so many steps, or until that time; what is wrong."""
    wrong = []
    while not wrong and walk.steps < steps and time.monotonic() < until:
        try:
            wrong = walk.step()
        except Exception as error:
            traceback.print_exc()
            wrong = [f"{type(error).__name__}: {error}"]
    if growth(walk.memory) > GROWTH:
        wrong.append("the memory grows")
    return wrong


if __name__ == "__main__":
    leave(main())
