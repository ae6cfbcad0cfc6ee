# SPDX-License-Identifier: GPL-3.0-or-later
"""`make comparison`: the table of docs/comparison.md that was run here: sample_blends/bulging_cylinder.blend, baked by
Dynamorph and simulated by Blender's own ways. No number is typed here.

    python evidence/comparison.py        runs each way in a process of its own, and writes the table
    python evidence/comparison.py WAY    one way in this process: prints JSON

Blender's ways get what an artist would give them: the limb with its sculpted shapes, blended by its pose, as the shape
that they are held to. Everything else is as it comes. What is measured is what Blender shows.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import fresh_blender  # noqa: F401
from project import ROOT

import bpy
import dynamic_morph_targets
import numpy as np
from believable_measure import triangles_of, world_points
from bench import machine
from claims import FLEXED, SHAKEN, STRAIGHT
from collision_press import HELD, dynamics_assets, set_socket
from contact_sheet import quiet
from dynamic_morph_targets.run.bake import batch
from dynamic_morph_targets.run.bake.job import Job
from how_long import busy
from measured import measured_at, write_between
from measures import volume
from performance_page import grid

PAGE = ROOT / "docs" / "comparison.md"
SCENE = ROOT / "sample_blends" / "bulging_cylinder.blend"
BEGIN, END = "<!-- run here -->", "<!-- end of run here -->"
FIRST, LAST = 1, 160  # frames
STILL = 65  # frame at which the limb is flexed and has come to rest after the first push
BENT, FALLS = 40, 86  # frames between which it is flexed
TURN = 5  # frames in which what is keyed by pose changes before and after them
GRIPPED = "Held"  # vertex group: 1 where the stand grips the limb
LONGEST = 600  # seconds that a way may take
NONE = "-"


@dataclass(frozen=True)
class Way:
    """A way to simulate the limb. set_up(limb) makes Blender simulate it, or bakes it; settings: what is not as it
    comes, for the table."""

    title: str
    set_up: Callable[[bpy.types.Object], None]
    settings: str = "defaults"


def main() -> int:
    if len(sys.argv) > 1:
        return measure(sys.argv[1])
    if bpy.app.version < (5, 2):
        raise SystemExit("comparison: needs the dynamics nodes of Blender 5.2, and so Python 3.13")
    found, load = {}, os.getloadavg()[0]
    for name in WAYS:
        command = [sys.executable, __file__, name]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=LONGEST)
        except subprocess.TimeoutExpired:
            found[name] = None
            continue
        if done.returncode:
            sys.exit(f"comparison: {name}: {done.stdout}{done.stderr}")
        found[name] = json.loads(done.stdout.strip().rpartition("\n")[2])
        print(f"comparison: {name}: {found[name]}", flush=True)
    write(found, load)
    print(f"written to {PAGE.relative_to(ROOT)}")
    return 0


# One way --------------------------------------------------------------------------------------------------------------


def measure(name: str) -> int:
    """Print what one way does as JSON: seconds, bytes, meters, and parts of the sculpted volume."""
    dynamic_morph_targets.register()
    with quiet(), tempfile.TemporaryDirectory() as folder:
        bpy.ops.wm.open_mainfile(filepath=str(SCENE))
        limb = bpy.data.objects["Limb"]
        bpy.context.view_layer.objects.active = limb
        limb.dynamorph.model.method = "STATIC"  # the sculpted shapes alone, blended by the pose
        batch.run(Job(limb, "BAKE"))
        sculpted, _ = played(limb)
        before = saved(folder)
        began = time.perf_counter()
        WAYS[name].set_up(limb)
        prepared = time.perf_counter() - began
        shown, played_for = played(limb)
        found = {"seconds": prepared + played_for, "bytes": saved(folder) - before, "blender": bpy.app.version_string}
    apart, triangles = shown - sculpted, triangles_of(limb)
    straight, flexed = (volume(sculpted[frame - FIRST], triangles) for frame in (FIRST, STILL))
    found["vertices"] = len(limb.data.vertices)
    found["off"] = float(np.linalg.norm(apart[STILL - FIRST], axis=1).max())
    found["kept"] = (volume(shown[STILL - FIRST], triangles) - straight) / (flexed - straight)
    for pose, (first, last) in SHAKEN.items():
        swing = apart[first - FIRST : last + 1 - FIRST] - apart[first - 1 - FIRST]
        found[pose] = float(np.linalg.norm(swing, axis=2).max())
    print(json.dumps(found))
    return 0


def played(limb: bpy.types.Object) -> tuple[np.ndarray, float]:
    """The limb in each frame (F, V, 3), world, and the seconds that Blender took to evaluate them."""
    points, seconds = [], 0.0
    for frame in range(FIRST, LAST + 1):
        began = time.perf_counter()
        bpy.context.scene.frame_set(frame)
        seconds += time.perf_counter() - began
        points.append(world_points(limb))
    return np.array(points), seconds


def saved(folder: str) -> int:
    """The size of the file if it is saved."""
    path = Path(folder) / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True, compress=False)
    return path.stat().st_size


def held(limb: bpy.types.Object, softly: float = HELD) -> str:
    """A vertex group that holds the limb to its shapes, by so much but where the stand grips it."""
    firmness = limb.vertex_groups["Firmness"].index
    group = limb.vertex_groups.new(name=GRIPPED)
    for vertex in limb.data.vertices:
        firm = next((each.weight for each in vertex.groups if each.group == firmness), 0.5)
        group.add([vertex.index], softly + (1.0 - softly) * (2.0 * firm - 1.0), "REPLACE")
    return group.name


def ours(solver: str) -> Callable[[bpy.types.Object], None]:
    def bake(limb: bpy.types.Object) -> None:
        limb.dynamorph.model.method, limb.dynamorph.model.solver = "DYNAMIC", solver
        batch.run(Job(limb, "BAKE", rebuild=True))

    return bake


def soft_body(limb: bpy.types.Object) -> bpy.types.SoftBodySettings:
    modifier = limb.modifiers.new("Softbody", "SOFT_BODY")
    modifier.point_cache.frame_end = LAST
    settings = modifier.settings
    settings.vertex_group_goal, settings.goal_default = held(limb), 1.0
    settings.goal_spring, settings.goal_friction = 0.9, 1.0
    settings.mass, settings.use_edges = 0.1, False
    return settings


def soft_body_by_pose(limb: bpy.types.Object) -> None:
    key_by_pose(soft_body(limb), "goal_spring", 0.9, 0.99)


def cloth(limb: bpy.types.Object, softly: float = HELD) -> bpy.types.ClothSettings:
    modifier = limb.modifiers.new("Cloth", "CLOTH")
    modifier.point_cache.frame_end = LAST
    settings = modifier.settings
    settings.vertex_group_mass, settings.use_dynamic_mesh = held(limb, softly), True
    return settings


def cloth_by_pose(limb: bpy.types.Object) -> None:
    key_by_pose(cloth(limb, 0.4), "pin_stiffness", 0.1, 10.0)


def key_by_pose(settings: bpy.types.bpy_struct, name: str, straight: float, flexed: float) -> None:
    values = {FIRST: straight, BENT - TURN: straight, BENT: flexed, FALLS: flexed, FALLS + TURN: straight}
    for frame, value in values.items():
        setattr(settings, name, value)
        settings.keyframe_insert(name, frame=frame)


def cloth_dynamics(limb: bpy.types.Object) -> None:
    modifier = limb.modifiers.new("Cloth Dynamics", "NODES")
    (modifier.node_group,) = dynamics_assets("Cloth Dynamics (Experimental)")
    set_socket(modifier, "Pin Group", held(limb, 0.9))
    for name in ("Stretchiness", "Bendiness"):
        set_socket(modifier, name, 1.0)


WAYS = {
    "reduced": Way("Dynamorph, Reduced Quality", ours("REDUCED"), "as in the file"),
    "full": Way("Dynamorph, Full Quality", ours("FULL"), "as in the file"),
    "soft_body": Way("Soft Body", soft_body, "Goal Stiffness 0.9, Damping 1, Mass 0.1, Edges off"),
    "soft_body_by_pose": Way("Soft Body", soft_body_by_pose, "the same, Goal Stiffness keyed to 0.99 where flexed"),
    "cloth": Way("Cloth", cloth, "Dynamic Mesh on"),
    "cloth_by_pose": Way(
        "Cloth", cloth_by_pose, "Dynamic Mesh on, pinned by 0.4, Pin Stiffness 0.1, keyed to 10 where flexed"
    ),
    "cloth_dynamics": Way(
        "Cloth Dynamics (experimental)", cloth_dynamics, "Stretchiness and Bendiness 1, pinned by 0.9"
    ),
}


# The page -------------------------------------------------------------------------------------------------------------


def write(found: dict[str, dict | None], load: float) -> None:
    """Put the table between the marks of the page. Raises ValueError without them."""
    head = ("", "settings", "seconds", "ms a frame", "bulge kept", "off by", "shaken straight", "shaken flexed",
            "straight / flexed", "file")  # fmt: skip
    table = grid(head, [row(WAYS[name], each) for name, each in found.items()])
    one = next(each for each in found.values() if each)
    about = (
        f"{measured_at(PAGE.name)}. Blender {one['blender']}; {machine()}; {one['vertices']:,} vertices, "
        f"{LAST + 1 - FIRST} frames. {busy(load)}"
    )
    write_between(PAGE, BEGIN, END, f"{about.rstrip()}\n\n{table}")


def row(way: Way, found: dict | None) -> list[str]:
    if not found:
        return [way.title, way.settings, f"over {LONGEST}", *[NONE] * 7]
    return [
        way.title,
        way.settings,
        f"{found['seconds']:.1f}",
        f"{1000 * found['seconds'] / (LAST + 1 - FIRST):.0f}",
        f"{found['kept']:.0%}",
        *(f"{1000 * found[name]:.1f} mm" for name in ("off", STRAIGHT, FLEXED)),
        f"{found[STRAIGHT] / found[FLEXED]:.1f}",
        f"{found['bytes'] / 2**20:.1f} MB",
    ]


if __name__ == "__main__":
    sys.exit(main())
