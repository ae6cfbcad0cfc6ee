# SPDX-License-Identifier: GPL-3.0-or-later
"""A ball presses a character's belly and drags over it, for collision.py: by this add-on, and by Blender's own.

    python evidence/collision_press.py ASSET FOLDER WAY

FOLDER gets WAY.json, positions in WAY.npy, and WAY_1.png to WAY_3.png. WAY: full, full_0 (with Distance 0), reduced,
off (no collision), soft_body, cloth or cloth_dynamics (Blender 5.2).
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import project  # noqa: F401
import fresh_blender  # noqa: F401

import believable_measure
import bpy
import characters
import dynamic_morph_targets
import numpy as np
from contact_sheet import quiet, render
from dynamic_morph_targets.core.geometry import diagonal, signed_volume, vertex_normals
from dynamic_morph_targets.run.bake import batch
from dynamic_morph_targets.run.bake.job import Job
from mathutils import Vector
from portrait import aim

RADIUS, AWAY, DEEP, DRAGGED = 0.05, 0.02, 0.025, 0.08  # of the body's size: the ball, and its way
TOUCHES, RESTS, DRAGS, LAST = 12, 24, 48, 60  # frames at which it is deepest, begins to drag, stops, and the last one
FRICTION = 0.3
THICK = 0.97  # quantile of the thickness from which tissue counts as the belly
NEAR = 2.0  # radii of the ball around its middle that count as the dent
HELD = 0.8  # of a peer's tissue: goal or pin weights
CELL = (300, 300)
SHOWN = (RESTS, DRAGS, LAST)


def main() -> int:
    asset, folder, way = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]
    folder.mkdir(parents=True, exist_ok=True)
    dynamic_morph_targets.register()
    with quiet():
        characters.open_file(asset)
        body = standing()
        ball, size = with_ball(body)
        found = {"name": asset.stem, "way": way, "size": size, "vertices": len(body.data.vertices)}
        began = time.perf_counter()
        found |= WAYS[way](body)
        positions, depths = played(body, ball)
        found["seconds"] = time.perf_counter() - began
    found["moving"] = float(depths[:DRAGS].max() / size)
    found["resting"] = float(max(depths[RESTS - 1], depths[LAST - 1]) / size)
    np.save(folder / f"{way}.npy", positions[[frame - 1 for frame in SHOWN]])
    photograph(body, ball, folder, way)
    (folder / f"{way}.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


# The scene ------------------------------------------------------------------------------------------------------------


def standing():
    """The largest skinned mesh, at rest; other meshes are hidden."""
    body = characters.largest_skinned()
    rig = characters.armature_of(body)
    rig.animation_data_clear()
    for bone in rig.pose.bones:
        bone.matrix_basis.identity()
    if body.data.shape_keys:
        body.data.shape_keys.animation_data_clear()
        for key in body.data.shape_keys.key_blocks:
            key.value = 0.0
    for obj in bpy.context.scene.objects:
        if obj.type == "MESH" and obj != body:
            obj.hide_viewport = obj.hide_render = True
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, LAST
    scene.frame_set(1)
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.view_layer.objects.active = body
    body.select_set(True)
    return body


def with_ball(body) -> tuple:
    """A ball with Blender's Collision and its keys, and the body's size (world units)."""
    points, triangles = believable_measure.world_points(body), believable_measure.triangles_of(body)
    size = diagonal(points[np.unique(triangles)])
    thickness = believable_measure.thickness(points, triangles, size)
    belly = np.flatnonzero(thickness >= np.nanquantile(thickness, THICK))
    place = belly[points[belly, 1].argmin()]  # the most in front: characters look along -Y
    outward = -1.0 if signed_volume(points, triangles) < 0.0 else 1.0
    normal = outward * vertex_normals(points, triangles)[place]
    normal /= np.linalg.norm(normal)
    up = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
    up = up / np.linalg.norm(up) if np.linalg.norm(up) > 0.1 else np.cross(normal, [1.0, 0.0, 0.0])
    bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24, radius=RADIUS * size)
    ball = bpy.context.object
    ball.modifiers.new("Collision", "COLLISION")
    ball.collision.cloth_friction = 10.0 * FRICTION
    pressed = points[place] + (RADIUS - DEEP) * size * normal
    way = {1: points[place] + (RADIUS + AWAY) * size * normal, TOUCHES: pressed, RESTS: pressed,
           DRAGS: pressed + DRAGGED * size * up, LAST: pressed + DRAGGED * size * up}  # fmt: skip
    for frame, location in way.items():
        ball.location = location
        ball.keyframe_insert("location", frame=frame)
    bpy.context.view_layer.objects.active = body
    return ball, float(size)


def played(body, ball) -> tuple[np.ndarray, np.ndarray]:
    """The body in each frame (F, V, 3), world, and how deep its deepest vertex is in the ball (F,); outside below 0."""
    positions, depths = [], []
    for frame in range(1, LAST + 1):
        bpy.context.scene.frame_set(frame)
        positions.append(believable_measure.world_points(body))
        shown = ball.evaluated_get(bpy.context.evaluated_depsgraph_get())
        inverse = shown.matrix_world.inverted()  # the ball is not scaled
        center, radius = np.array(shown.matrix_world.translation), 0.5 * shown.dimensions.z
        depths.append(-2.0 * radius)
        for point in positions[-1][np.linalg.norm(positions[-1] - center, axis=1) < 2.0 * radius]:
            _, place, normal, _ = shown.closest_point_on_mesh(inverse @ Vector(point))
            depths[-1] = max(depths[-1], (place - inverse @ Vector(point)).dot(normal))
    return np.array(positions), np.array(depths)


def photograph(body, ball, folder: Path, way: str) -> None:
    scene = bpy.context.scene
    scene.display.shading.show_cavity, scene.view_settings.view_transform = True, "Standard"
    scene.frame_set(DRAGS)
    reach = 3.5 * RADIUS * diagonal(believable_measure.world_points(body))
    corners = np.array(ball.matrix_world.translation) + reach * np.array(
        [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    )
    aim(corners, CELL)
    for number, frame in enumerate(SHOWN, 1):
        render([frame], CELL, "BLENDER_WORKBENCH")[0].save(folder / f"{way}_{number}.png")


# Ways to simulate it --------------------------------------------------------------------------------------------------


def ours(solver: str, use: bool = True, distance: float | None = None):
    def simulate(body) -> dict:
        bpy.ops.dynamorph.add_soft_skin()
        body.dynamorph.model.solver = solver
        body.dynamorph.collision.use, body.dynamorph.collision.bake_full = use, solver == "FULL"
        if distance is not None:
            body.dynamorph.collision.distance = distance
        job = Job(body, goal="BAKE")
        batch.run(job)
        report, verdict = job.outcome.report, job.outcome.verdict
        return {
            "iterations": report["iterations"] / report["steps"],
            "microseconds": 1e6 * report["engine_seconds"] / report["steps"],
            "simulating": job.progress.seconds["simulate"],
            "keys": len(believable_measure.baked_keys(body)),
            "warnings": job.warnings,
            "verdict": verdict.text,
        }

    return simulate


def soft_body(body) -> dict:
    modifier = body.modifiers.new("Softbody", "SOFT_BODY")
    modifier.settings.goal_default = HELD
    modifier.point_cache.frame_end = LAST
    return {}


def cloth(body) -> dict:
    modifier = body.modifiers.new("Cloth", "CLOTH")
    group = body.vertex_groups.new(name="Held")
    group.add(range(len(body.data.vertices)), HELD, "REPLACE")
    modifier.settings.vertex_group_mass = group.name
    modifier.point_cache.frame_end = LAST
    return {}


def cloth_dynamics(body) -> dict:
    """The asset of Blender 5.2, whose colliders have a modifier of their own."""
    dynamics, collider = dynamics_assets("Cloth Dynamics (Experimental)", "Collider")
    ball = bpy.data.objects["Sphere"]
    ball.modifiers.clear()
    ball.modifiers.new("Collider", "NODES").node_group = collider
    set_socket(ball.modifiers[0], "Friction", FRICTION)
    effectors = bpy.data.collections.new("Effectors")
    effectors.objects.link(ball)
    group = body.vertex_groups.new(name="Held")
    group.add(range(len(body.data.vertices)), HELD, "REPLACE")
    modifier = body.modifiers.new("Cloth Dynamics", "NODES")
    modifier.node_group = dynamics
    set_socket(modifier, "Pin Group", group.name)
    set_socket(modifier, "Effectors Collection", effectors)
    return {}


def dynamics_assets(*names: str) -> list[bpy.types.NodeTree]:
    """Node groups of the assets that Blender 5.2 brings along."""
    assets = Path(bpy.utils.system_resource("DATAFILES")) / "assets/nodes/geometry_nodes_dynamics_assets.blend"
    with bpy.data.libraries.load(str(assets), link=False) as (_, wanted):
        wanted.node_groups = list(names)
    return wanted.node_groups


def set_socket(modifier, name: str, value) -> None:
    """Set an input of a modifier with nodes: a value, or the name of an attribute."""
    items = modifier.node_group.interface.items_tree
    found = next(item for item in items if item.item_type == "SOCKET" and item.in_out == "INPUT" and item.name == name)
    socket = getattr(modifier.properties.inputs, found.identifier)
    if isinstance(value, str):
        socket.type, socket.attribute_name = "ATTRIBUTE", value
    else:
        socket.value = value


WAYS = {
    "full": ours("FULL"),
    "full_0": ours("FULL", distance=0.0),
    "reduced": ours("REDUCED"),
    "off": ours("FULL", use=False),
    "soft_body": soft_body,
    "cloth": cloth,
    "cloth_dynamics": cloth_dynamics,
}

if __name__ == "__main__":
    sys.exit(main())
