# SPDX-License-Identifier: GPL-3.0-or-later
"""Where Herbert's two shots happen: a pool with a springboard and, 40 m behind it, a gymnasium wall; the cameras with
their markers, light. World space: he goes along +X.
"""

from __future__ import annotations

import math

import bpy
import herbert_motion as motion
import numpy as np
from herbert_action import APART, Timeline
from herbert_skeleton import Motion
from stage import (
    add_box,
    add_lathe,
    add_material,
    add_mesh,
    look_through_camera,
    paint_for_workbench,
    place,
    write_curves,
)  # fmt: skip

FOLLOW = 0.38  # seconds over which a camera's path is smoothed
SKY = (0.22, 0.52, 1.0)


# --- Cameras ----------------------------------------------------------------------------------------------------------


def add_cameras(shots: dict[str, Motion], timeline: Timeline) -> None:
    """One camera a shot, each following him, and markers that cut from one to the other."""
    scene = bpy.context.scene
    views = {"Dive": ((1.6, -4.7, 0.3), 46), "Wall": ((0.35, -4.6, 0.3), 44)}
    for name, shot in shots.items():
        away = -APART if name == "Wall" else 0
        data = bpy.data.cameras.new(f"{name} camera")
        data.lens = views[name][1]
        offset = np.array(views[name][0])
        path = np.stack([-shot.center[:, 1] + away, np.zeros(len(shot.times)), shot.center[:, 2]], 1)
        path = smoothed(np.clip(path, *limits(name)), FOLLOW * motion.FPS)
        camera = place(bpy.data.objects.new(f"{name} camera", data), path[0] + offset, path[0] + [0.3, 0, 0])
        start = timeline.starts[name]
        extended = np.concatenate([np.repeat(path[:1], start - 1, axis=0), path])
        write_curves(camera, f"{name} camera", {"location": extended + offset})
        marker = scene.timeline_markers.new(name, frame=start)
        marker.camera = camera
    scene.camera = bpy.data.objects["Dive camera"]
    look_through_camera()


def limits(shot: str) -> tuple[list, list]:
    """Where a camera's aim may go: it leaves him before he goes under, and stops before the wall."""
    if shot == "Dive":
        return [-9, 0, 1.0], [2.2, 0, 9]
    return [-99, 0, 0.95], [-APART + 4.9, 0, 0.95]


def smoothed(path: np.ndarray, width: float) -> np.ndarray:
    """A path (F, 3) blurred in time by a Gaussian of `width` frames."""
    reach = int(3 * width)
    kernel = np.exp(-((np.arange(-reach, reach + 1) / width) ** 2))
    padded = np.pad(path, ((reach, reach), (0, 0)), mode="edge")
    return np.stack([np.convolve(column, kernel / kernel.sum(), "valid") for column in padded.T], 1)


# --- Places -----------------------------------------------------------------------------------------------------------


def add_board(times: np.ndarray, material, metal) -> None:
    """The springboard: a cantilever whose bend is a shape key."""
    x = np.concatenate([[-motion.BOARD_LENGTH - 1.2], np.linspace(-motion.BOARD_LENGTH, 0.06, 29)])
    top = np.stack(np.meshgrid(x, [-0.27, 0.27], [-0.055, 0.0], indexing="ij"), -1).reshape(-1, 3)
    top[:, 2] += motion.BOARD_HEIGHT
    ring = np.array([0, 2, 3, 1])
    faces = [(4 * k + a, 4 * k + b, 4 * k + 4 + b, 4 * k + 4 + a)
             for k in range(len(x) - 1) for a, b in zip(ring, np.roll(ring, -1), strict=True)]  # fmt: skip
    faces += [ring[::-1].tolist(), (4 * len(x) - 4 + ring).tolist()]
    board = add_mesh("Board", top, faces, material)
    board.data.polygons.foreach_set("use_smooth", [False] * len(faces))
    bevel = board.modifiers.new("Bevel", "BEVEL")
    bevel.width, bevel.segments = 0.012, 2
    board.shape_key_add(name="Basis", from_mix=False)
    bent = board.shape_key_add(name="Half a meter down", from_mix=False)
    down = top - np.outer(motion.board_bend(np.minimum(top[:, 0], 0.06), 0.5), [0, 0, 1])
    bent.points.foreach_set("co", down.astype(np.float32).ravel())
    bent.value, bent.slider_min = 0, -1
    path = 'key_blocks["Half a meter down"].value'
    write_curves(board.data.shape_keys, "Board", {path: -motion.board_tip(times) / 0.5})
    h = motion.BOARD_HEIGHT - 0.055
    add_box("Fulcrum", (-motion.BOARD_LENGTH - 0.1, -0.33, h - 0.12), (-motion.BOARD_LENGTH + 0.1, 0.33, h), metal)
    for y in (-0.42, 0.42):
        add_box("Post", (-4.5, y - 0.05, 0.1), (-4.38, y + 0.05, h + 1.1), metal)
        add_box("Post", (-3.5, y - 0.05, 0.1), (-3.38, y + 0.05, h), metal)
        add_box("Rail", (-4.5, y - 0.035, h + 1.0), (-3.2, y + 0.035, h + 1.07), metal)
        add_box("Post", (-3.27, y - 0.035, h - 0.1), (-3.2, y + 0.035, h + 1.0), metal)
    add_box("Platform", (-4.6, -0.49, h - 0.22), (-3.15, 0.49, h - 0.12), metal)
    for k in range(8):
        add_box("Rung", (-4.47, -0.42, 0.3 + 0.35 * k), (-4.41, 0.42, 0.34 + 0.35 * k), metal)


def add_pool(times: np.ndarray) -> None:
    tiles = add_material("Tiles", (0.46, 0.42, 0.35), 0.4)
    rim = add_material("Rim", (0.10, 0.30, 0.48), 0.35)
    water = add_material("Water", (0.02, 0.30, 0.38), 0.06)
    ripple(water)
    wood, metal = add_material("Board", (0.80, 0.40, 0.06), 0.5), add_material("Steel", (0.35, 0.40, 0.44), 0.3)
    hedge, far = add_material("Hedge", (0.05, 0.16, 0.05), 0.9), add_material("Far hedge", (0.10, 0.26, 0.12), 0.9)
    add_box("Deck", (-30, -14, -0.3), (-1.0, 16, 0.1), tiles)
    add_box("Deck", (-1.0, 6.0, -0.3), (30, 16, 0.1), tiles)
    add_box("Rim", (-1.0, 5.7, -0.3), (30, 6.0, 0.14), rim)
    add_box("Rim", (-1.3, -14, -0.3), (-1.0, 6.0, 0.14), rim)
    add_mesh("Water", [(-1.0, -14, 0), (30, -14, 0), (30, 5.7, 0), (-1.0, 5.7, 0)], [(0, 1, 2, 3)], water)
    turn = np.linspace(0, math.pi / 2, 9)
    outline = np.stack([np.cos(turn), 1.4 * np.sin(turn)], 1).clip(0)
    bushes = [add_lathe("Bush", outline, material, 24) for material in (hedge, far)]
    for k in range(34):
        bush = bushes[k % 3 > 0].copy()
        bpy.context.scene.collection.objects.link(bush)
        bush.location = (-22 + 1.5 * k, 14.5 + math.sin(1.7 * k), 0)
        bush.scale.z = 1.0 + 0.35 * math.sin(2.4 * k) + 0.2 * math.sin(5.1 * k)
    for bush in bushes:
        bpy.data.objects.remove(bush)
    add_board(times, wood, metal)
    add_splash(times)


def ripple(water: bpy.types.Material) -> None:
    nodes, links = water.node_tree.nodes, water.node_tree.links
    noise, bump = nodes.new("ShaderNodeTexNoise"), nodes.new("ShaderNodeBump")
    noise.inputs["Scale"].default_value = 14
    bump.inputs["Strength"].default_value = 0.25
    links.new(noise.outputs[0], bump.inputs["Height"])
    links.new(bump.outputs["Normal"], nodes["Principled BSDF"].inputs["Normal"])


def add_splash(times: np.ndarray) -> None:
    """A crown of water that rises where he goes in, and falls back."""
    foam = add_material("Splash", (0.60, 0.84, 0.90), 0.1)
    random = np.random.default_rng(7)
    angle, out, up = random.uniform(0, 2 * math.pi, 90), random.uniform(0.5, 1, 90), random.uniform(0.05, 1, 90)
    centers = np.stack([out * np.cos(angle), out * np.sin(angle), up], 1) * [[0.45, 0.45, 1.0]]
    drop = np.array([(0, 0, 1.6), (1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (0, 0, -1)])
    sides = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 1), (5, 2, 1), (5, 3, 2), (5, 4, 3), (5, 1, 4)])
    sizes = random.uniform(0.015, 0.05, 90)
    spray = add_mesh("Splash", (centers[:, None] + sizes[:, None, None] * drop).reshape(-1, 3),
                     (6 * np.arange(90)[:, None, None] + sides).reshape(-1, 3), foam)  # fmt: skip
    spray.modifiers.new("Subdivision", "SUBSURF").levels = 1
    place = motion.jump(np.array(motion.ENTRY), 0)
    since = np.clip(times - motion.ENTRY + 0.06, 0, None)
    wide, high = 0.35 + 1.6 * since, 5.2 * since - motion.GRAVITY * since**2 - 0.02
    here = np.stack([np.full_like(since, place[0] + 0.1), 0 * since, np.where(since > 0, 0, -3.0)], 1)
    write_curves(spray, "Splash", {"scale": np.stack([wide, wide, 1.6 * high], 1), "location": here})


def add_gymnasium() -> None:
    floor, line = add_material("Parquet", (0.42, 0.22, 0.09), 0.3), add_material("Line", (0.75, 0.72, 0.62), 0.4)
    plaster, wood = add_material("Plaster", (0.55, 0.60, 0.52), 0.8), add_material("Panels", (0.16, 0.26, 0.22), 0.5)
    brick, mat = add_material("Brick", (0.36, 0.10, 0.06), 0.8), add_material("Mat", (0.05, 0.13, 0.34), 0.45)
    bricks(brick)
    x = motion.WALL - APART
    add_box("Parquet", (x - 20, -12, -0.2), (x + 4, 4.0, 0), floor)
    for y in (-1.5, 1.7):
        add_box("Line", (x - 20, y - 0.04, -0.1), (x - 0.2, y + 0.04, 0.003), line)
    add_box("Back wall", (x - 20, 3.2, -0.1), (x + 4, 3.4, 6), plaster)
    add_box("Panels", (x - 20, 3.1, -0.1), (x + 4, 3.25, 0.9), wood)
    add_box("Brick wall", (x + 0.12, -1.7, -0.1), (x + 0.6, 3.3, 6), brick)
    add_box("Pillar", (x + 0.06, -2.1, -0.1), (x + 0.7, -1.7, 6), plaster)
    add_box("Mat", (x, -1.6, 0.02), (x + 0.12, 1.6, 2.2), mat)


def bricks(material: bpy.types.Material) -> None:
    nodes, links = material.node_tree.nodes, material.node_tree.links
    where, turn, texture = (nodes.new(f"ShaderNode{kind}") for kind in ("TexCoord", "Mapping", "TexBrick"))
    turn.inputs["Rotation"].default_value = (0, math.pi / 2, math.pi / 2)
    for name, color in (
        ("Color1", (0.40, 0.12, 0.07)),
        ("Color2", (0.30, 0.08, 0.05)),
        ("Mortar", (0.45, 0.42, 0.38)),
    ):
        texture.inputs[name].default_value = (*color, 1)
    texture.inputs["Scale"].default_value = 2.0
    links.new(where.outputs["Object"], turn.inputs["Vector"])
    links.new(turn.outputs[0], texture.inputs["Vector"])
    links.new(texture.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])


def add_light() -> None:
    sun = bpy.data.lights.new("Sun", "SUN")
    sun.energy, sun.angle, sun.color = 3.8, 0.12, (1.0, 0.95, 0.86)
    place(bpy.data.objects.new("Sun", sun), (-3, -6, 8), (0, 0, 0))
    world = bpy.context.scene.world
    world.color = SKY
    background = world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (*SKY, 1)
    background.inputs["Strength"].default_value = 0.7
    display = bpy.context.scene.display  # Workbench, in daylight too
    display.light_direction = (-0.3, 0.85, 0.45)
    display.shading.studio_light, display.shading.shadow_intensity = "paint.sl", 0.3


def add_sets(shots: dict[str, Motion], timeline: Timeline) -> None:
    add_pool(shots["Dive"].times)
    add_gymnasium()
    add_light()
    add_cameras(shots, timeline)
    paint_for_workbench()
