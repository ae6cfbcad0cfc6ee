# SPDX-License-Identifier: GPL-3.0-or-later
"""Herbert on a bench: he dives across a bench on his belly, flops on the floor behind it and slides to a stop. Bench
and floor have Blender's Collision. Meters; he goes along +X.
"""

from __future__ import annotations

from pathlib import Path

import bpy
import herbert
import herbert_sets as sets
import numpy as np
from herbert_action import quaternions
from herbert_skeleton import SIDES, SPINE, Skeleton, about, arm_turns, finger_turns
from makehuman import LICENSE
from stage import (
    add_box,
    add_material,
    add_touched_skin,
    look_through_camera,
    paint_for_workbench,
    place,
    save_scene,
    set_up_scene,
    write_curves,
)  # fmt: skip

FPS, FRAMES, STEPS = 24, 84, 20  # STEPS: of the flight, a frame
BENCH_HEIGHT, BENCH = 0.2, (-0.24, 0.24)  # and where it is along his way
START, SPEED = (-0.85, 0.10), (2.8, 0.6)  # of the pelvis: along, above the bench without a dent; forward, up
GRAVITY, FRICTION = 9.81, 0.2
SPRING, DAMPING = 26.0, 0.7  # below the belly, radians per second; 15 mm deep at rest
BELLY = 0.25  # from the pelvis to the skin of the belly in front

README = """Herbert on a bench

Herbert dives across a bench on his belly, flops on the floor and slides to a stop. Bench and floor have Blender's
Collision; he has Quality Full, so that both flatten the belly.

Select Herbert, press Bake in the Dynamorph tab, then Play.
"""


# --- His way ----------------------------------------------------------------------------------------------------------


def flight() -> tuple[np.ndarray, np.ndarray]:
    """The pelvis (F, 2), along and up, on a damped spring below the belly; and how long (F,) the last touch is ago,
    seconds, infinite before the first.
    """
    step = 1 / (FPS * STEPS)
    x, z = START[0], START[1] + BENCH_HEIGHT + BELLY
    ahead, up = SPEED
    path, since, touched = [], [], np.inf
    for k in range(FRAMES * STEPS):
        if k % STEPS == 0:
            path.append((x, z))
            since.append(touched)
        sunk = BELLY + (BENCH_HEIGHT if x < BENCH[1] + 0.1 else 0.0) - z
        push = max(SPRING**2 * sunk - 2 * DAMPING * SPRING * up, 0.0) if sunk > 0 else 0.0
        touched = 0.0 if push and touched > 0.15 else touched + step
        up += (push - GRAVITY) * step
        ahead = max(ahead - FRICTION * push * step * (x > BENCH[1]), 0.0)
        x, z = x + ahead * step, z + up * step
    return np.array(path), np.array(since)


def pose(bones: Skeleton, path: np.ndarray, since: np.ndarray) -> dict[str, np.ndarray]:
    """The turns (F, 3, 3) of the bones: stretched out, face forward, and rocking after each touch."""
    rock = np.exp(-since / 0.3) * np.sin(2 * np.pi * since / 0.5, where=np.isfinite(since), out=np.zeros(len(since)))
    turns = {"pelvis": about(0, 90 - 5 * rock)}
    turns |= {bone: about(0, -4 - 3 * rock) for bone in SPINE}
    turns |= {bone: about(0, -22 + 8 * rock) for bone in ("neck_01", "head")}
    for side in SIDES:
        still = np.ones(len(path))
        turns |= arm_turns(bones, side, 150 * still - 14 * rock, 30 * still, 12 * still)
        turns |= finger_turns(bones, side, 4 * still)
        turns |= {f"thigh_{side}": about(0, 10 + 9 * rock), f"calf_{side}": about(0, 26 - 22 * rock)}
        turns |= {f"foot_{side}": about(0, 45 * still)}
    return turns


def animate(rig: bpy.types.Object, path: np.ndarray, turns: dict[str, np.ndarray]) -> None:
    root = rig.data.bones["pelvis"]
    places = np.stack([np.zeros(len(path)), -path[:, 0], path[:, 1]], 1)
    local = (places - np.array(root.head_local)) @ np.array(root.matrix_local.to_3x3())
    curves = {'pose.bones["pelvis"].location': local}
    for name, turn in turns.items():
        rest = np.array(rig.data.bones[name].matrix_local.to_3x3())
        curves[f'pose.bones["{name}"].rotation_quaternion'] = quaternions(rest.T @ turn @ rest)
    write_curves(rig, "Flop", curves)


# --- The scene --------------------------------------------------------------------------------------------------------


def add_gymnasium() -> list[bpy.types.Object]:
    """The bench and the floor, which stop him, and what stands around."""
    wood, metal = add_material("Bench", (0.72, 0.42, 0.16), 0.45), add_material("Steel", (0.35, 0.40, 0.44), 0.3)
    plaster, panels = add_material("Plaster", (0.55, 0.60, 0.52), 0.8), add_material("Panels", (0.16, 0.26, 0.22), 0.5)
    floor = add_box("Floor", (-6, -4, -0.2), (8, 3.2, 0), add_material("Parquet", (0.42, 0.22, 0.09), 0.3))
    bench = add_box("Bench", (BENCH[0], -0.9, BENCH_HEIGHT - 0.05), (BENCH[1], 0.9, BENCH_HEIGHT), wood)
    for y in (-0.7, 0.62):
        add_box("Leg", (BENCH[0] + 0.04, y, 0), (BENCH[1] - 0.04, y + 0.08, BENCH_HEIGHT - 0.05), metal)
    add_box("Wall", (-6, 3.2, -0.1), (8, 3.4, 6), plaster)
    add_box("Panels", (-6, 3.1, -0.1), (8, 3.25, 0.9), panels)
    return [bench, floor]


def add_camera(path: np.ndarray) -> None:
    """It follows him."""
    data = bpy.data.cameras.new("Camera")
    data.lens = 60
    offset = np.array([0.25, -4.4, 0.75])
    way = sets.smoothed(np.column_stack([path[:, 0], np.zeros(len(path)), np.full(len(path), 0.4)]), 0.3 * FPS)
    camera = place(bpy.data.objects.new("Camera", data), way[0] + offset, way[0] + [0.05, 0, 0])
    write_curves(camera, "Camera", {"location": way + offset})
    bpy.context.scene.camera = camera
    look_through_camera()


def make(path: Path) -> None:
    human = herbert.figure()
    bones = herbert.rest_bones(human)
    set_up_scene(README, FRAMES, LICENSE)
    rig = herbert.add_rig(bones)
    body = herbert.add_body(human, bones, rig)
    body.shape_key_clear()
    herbert.add_face(human, rig)
    way, since = flight()
    animate(rig, way, pose(bones, way, since))
    colliders = add_gymnasium()
    sets.add_light()
    add_camera(way)
    paint_for_workbench()
    add_touched_skin(body, colliders)
    for collider in colliders:
        collider.collision.cloth_friction = 10 * FRICTION  # polished wood
    body.dynamorph.firmness_group = herbert.FIRMNESS
    save_scene(path)
