# SPDX-License-Identifier: GPL-3.0-or-later
"""What the sample scenes share: meshes, materials, lights, camera, and the add-on's own buttons. Meters."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import bmesh
import bpy
import numpy as np
from mathutils import Vector

LICENSE = """CC0 1.0 Universal

To the extent possible under law, the authors of Dynamorph have waived all copyright and related or neighboring rights
to this scene: meshes, shape keys, rig, animation, materials and lights.
https://creativecommons.org/publicdomain/zero/1.0/
"""

BEZIER, CONSTANT = 2, 0  # interpolation of keys, as F-curves store it
SMOOTH, CORNER = 1, 2  # handles of keys: automatic, vector


def smoothstep(t):
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


def bump(x, center, width):
    return np.exp(-(((x - center) / width) ** 2))


def add_mesh(name: str, vertices, faces, *materials) -> bpy.types.Object:
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(np.asarray(vertices).tolist(), [], np.asarray(faces).tolist())
    mesh.polygons.foreach_set("use_smooth", [True] * len(mesh.polygons))
    for material in materials:
        mesh.materials.append(material)
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def capsule(length: float, radius: float, fillet: float, across: int, along: int) -> tuple[np.ndarray, np.ndarray]:
    """A tube of quads along +X, its ends rounded by `fillet`: vertices (V, 3) and quads (Q, 4).

    The surface of a box of `across` x `across` x `along` cells, mapped to a tube with round ends; so the ends have no
    pole, where smooth shading would show a star.
    """
    faces = []
    for axis, (u, v) in enumerate(((1, 2), (2, 0), (0, 1))):
        size = np.array([across, across, along])
        for side in (0, size[axis]):
            i, j = (g.ravel() for g in np.meshgrid(np.arange(size[u]), np.arange(size[v]), indexing="ij"))
            corners = np.empty((len(i), 4, 3), int)
            corners[..., axis] = side
            corners[..., u] = i[:, None] + [0, 1, 1, 0]
            corners[..., v] = j[:, None] + [0, 0, 1, 1]
            faces.append(corners if side else corners[:, ::-1])
    cells, quads = np.unique(np.concatenate(faces).reshape(-1, 3), axis=0, return_inverse=True)

    u, v = (2.0 * cells[:, :2] / across - 1).T
    ring = np.maximum(abs(u), abs(v))  # 1 on the side, 0 at the middle of an end
    u, v = np.tan(u * math.pi / 4), np.tan(v * math.pi / 4)  # even steps around the circle
    around = np.stack([u, v], 1) / np.maximum(np.hypot(u, v), 1e-12)[:, None]
    # Along an end, from the middle out: a flat disc, then a quarter circle.
    flat = radius - fillet
    arc = flat + fillet * math.pi / 2
    turn = np.clip((ring * arc - flat) / fillet, 0, math.pi / 2)
    x = fillet + (length - 2 * fillet) * cells[:, 2] / along
    x += np.where(cells[:, 2] == 0, -1, 1) * fillet * np.cos(turn)
    out = np.minimum(ring * arc, flat) + fillet * np.sin(turn)
    return np.column_stack([x, out[:, None] * around]), quads.reshape(-1, 4)


def add_box(name: str, low, high, material) -> bpy.types.Object:
    low, high = np.asarray(low, float), np.asarray(high, float)
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    box = add_mesh(name, low + corners * (high - low), faces, material)
    box.data.polygons.foreach_set("use_smooth", [False] * 6)
    bevel = box.modifiers.new("Bevel", "BEVEL")
    bevel.width, bevel.segments = min(0.02, 0.3 * float((high - low).min())), 2
    return box


def add_ball(name: str, radius: float, *materials) -> bpy.types.Object:
    shape = bmesh.new()
    bmesh.ops.create_uvsphere(shape, u_segments=36, v_segments=18, radius=radius)
    ball = add_mesh(name, [], [], *materials)
    shape.to_mesh(ball.data)
    shape.free()
    ball.data.polygons.foreach_set("use_smooth", [True] * len(ball.data.polygons))
    return ball


def add_lathe(name: str, outline, material, segments: int = 48) -> bpy.types.Object:
    """Turn an outline of (radius, z) points, from the bottom's middle to the top's, around Z."""
    outline = np.array(outline)
    angle = np.arange(segments) * 2 * math.pi / segments
    rings = outline[:, None, :1] * np.stack([np.cos(angle), np.sin(angle)], 1)
    vertices = np.concatenate([rings, np.broadcast_to(outline[:, None, 1:], (*rings.shape[:2], 1))], 2)
    ring, here = np.meshgrid(np.arange(len(outline) - 1), np.arange(segments), indexing="ij")
    after = (here + 1) % segments
    quads = np.stack([ring * segments + here, ring * segments + after,
                      (ring + 1) * segments + after, (ring + 1) * segments + here], -1)  # fmt: skip
    return add_mesh(name, vertices.reshape(-1, 3), quads.reshape(-1, 4), material)


def add_material(name: str, color, roughness: float, color_attribute: str = "", subsurface: float = 0.0):
    material = bpy.data.materials.new(name)
    material.diffuse_color = (*color, 1)
    material.roughness = roughness
    material.use_nodes = True
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*color, 1)
    shader.inputs["Roughness"].default_value = roughness
    shader.inputs["Subsurface Weight"].default_value = subsurface
    shader.inputs["Subsurface Radius"].default_value = (1.0, 0.35, 0.2)
    shader.inputs["Subsurface Scale"].default_value = 0.02
    if color_attribute:
        attribute = material.node_tree.nodes.new("ShaderNodeVertexColor")
        attribute.layer_name = color_attribute
        attribute.location = (-250, 200)
        material.node_tree.links.new(attribute.outputs["Color"], shader.inputs["Base Color"])
    return material


def place(obj: bpy.types.Object, location, aim) -> bpy.types.Object:
    """Put a light or camera at `location`, looking at `aim`."""
    bpy.context.scene.collection.objects.link(obj)
    obj.location = location
    obj.rotation_euler = (Vector(aim) - Vector(location)).to_track_quat("-Z", "Y").to_euler()
    return obj


def add_studio(middle) -> None:
    """A backdrop, and three lights on the place `middle`."""
    sweep = np.linspace(0, math.pi / 2, 13)
    ys = np.concatenate([[-4], 1.1 + 0.7 * np.sin(sweep), [1.8]])
    zs = np.concatenate([[0], 0.7 - 0.7 * np.cos(sweep), [4]])
    vertices = [(x, y, z) for y, z in zip(ys, zs, strict=True) for x in (-5, 5)]
    faces = [(2 * k, 2 * k + 1, 2 * k + 3, 2 * k + 2) for k in range(len(ys) - 1)]
    add_mesh("Backdrop", vertices, faces, add_material("Backdrop", (0.20, 0.22, 0.28), 0.8))
    for name, location, power, size, color in (
        ("Key", (-0.5, -1.4, 1.9), 34, 0.7, (1.0, 0.95, 0.88)),
        ("Fill", (1.8, -1.2, 0.7), 9, 1.2, (0.80, 0.90, 1.0)),
        ("Rim", (0.9, 1.0, 1.4), 26, 0.5, (1.0, 0.97, 0.92)),
    ):
        light = bpy.data.lights.new(name, "AREA")
        light.energy, light.size, light.color = power, size, color
        place(bpy.data.objects.new(name, light), location, middle)


def add_camera(location, aim, lens: float) -> None:
    """The scene's. lens: millimeters."""
    camera = bpy.data.cameras.new("Camera")
    camera.lens = lens
    bpy.context.scene.camera = place(bpy.data.objects.new("Camera", camera), location, aim)


def set_up_scene(readme: str, frames: int, license: str = LICENSE) -> bpy.types.Scene:
    """An empty scene that renders well with Workbench at once, and with Cycles when asked."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)  # keeps the add-on
    scene = bpy.context.scene
    scene.render.fps = 24
    scene.frame_start, scene.frame_end = 1, frames
    scene.render.resolution_x, scene.render.resolution_y = 960, 740
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 64
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.look = "AgX - Medium High Contrast"
    shading = scene.display.shading
    shading.light, shading.color_type = "STUDIO", "VERTEX"
    shading.show_shadows = shading.show_cavity = True
    world = bpy.data.worlds.new("World")
    world.use_nodes = True
    background = world.node_tree.nodes["Background"]
    background.inputs["Color"].default_value = (0.75, 0.85, 1.0, 1)
    background.inputs["Strength"].default_value = 0.35
    scene.world = world
    for name, text in (("LICENCE", license), ("README", readme)):
        bpy.data.texts.new(name).write(text)
    look_through_camera()
    return scene


def look_through_camera() -> None:
    """Every 3D viewport opens on the scene, with the sidebar that holds the Dynamorph tab."""
    for screen in bpy.data.screens:
        for area in screen.areas:
            if area.type == "VIEW_3D":
                view = area.spaces.active
                view.region_3d.view_perspective = "CAMERA"
                view.show_region_ui = True
                view.shading.color_type = "VERTEX"


def paint_for_workbench() -> None:
    """Give every mesh that has no colors of its own those of its materials: Workbench shows vertex colors here."""
    meshes = {obj.data for obj in bpy.context.scene.objects if obj.type == "MESH" and not obj.data.color_attributes}
    for mesh in meshes:
        colors = np.array([material.diffuse_color for material in mesh.materials])
        indices, corners = (np.empty(len(mesh.polygons), np.int32) for _ in range(2))
        mesh.polygons.foreach_get("material_index", indices)
        mesh.polygons.foreach_get("loop_total", corners)
        attribute = mesh.color_attributes.new("Color", "BYTE_COLOR", "CORNER")
        attribute.data.foreach_set("color", np.repeat(colors[indices], corners, axis=0).astype(np.float32).ravel())


def assign(group: bpy.types.PropertyGroup, values: dict) -> None:
    for name, value in values.items():
        setattr(group, name, value)


def add_straight_rig(names: Sequence[str], heads: Sequence[float], tip: float) -> bpy.types.Object:
    """A chain of bones along +X. Turning them about their own X bends the chain toward +Z."""
    rig = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    bpy.context.scene.collection.objects.link(rig)
    rig.show_in_front = True
    rig.data.display_type = "STICK"
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    parent = None
    for name, head, tail in zip(names, heads, [*heads[1:], tip], strict=True):
        bone = rig.data.edit_bones.new(name)
        bone.head, bone.tail = (head, 0, 0), (tail, 0, 0)
        bone.align_roll((0, 0, 1))
        bone.parent, bone.use_connect = parent, parent is not None
        parent = bone
    bpy.ops.object.mode_set(mode="OBJECT")
    for bone in rig.pose.bones:
        bone.rotation_mode = "XYZ"
    return rig


def add_vertex_groups(obj: bpy.types.Object, groups: dict[str, np.ndarray]) -> None:
    """groups: name -> weights (V,); vertices of no weight stay out of the group."""
    for name, column in groups.items():
        group = obj.vertex_groups.new(name=name)
        for v in np.flatnonzero(column > 1e-4):
            group.add([int(v)], float(column[v]), "REPLACE")


def add_shape_keys(obj: bpy.types.Object, vertices: np.ndarray, shapes: dict[str, np.ndarray]) -> None:
    """A Basis and one key for each displacement (V, 3), at value 0."""
    obj.shape_key_add(name="Basis", from_mix=False)
    for name, shape in shapes.items():
        key = obj.shape_key_add(name=name, from_mix=False)
        key.value = 0  # Blender 5 creates keys at 1
        key.points.foreach_set("co", (vertices + shape).astype(np.float32).ravel())


def add_soft_skin(obj: bpy.types.Object, neutral: dict, targets: dict[str, tuple[int, dict]]) -> None:
    """Author dynamic morph targets with the add-on's own buttons.

    neutral: properties of the neutral target, captured at rest; targets: shape key -> (frame of its pose, properties).
    """
    bpy.context.view_layer.objects.active = obj
    obj.select_set(True)
    bpy.ops.dynamorph.add_soft_skin()
    settings = obj.dynamorph
    settings.model.hold = "BONES"  # as the thesis pins its tissue
    settings.model.hold_head = False
    while settings.attachments:
        bpy.ops.dynamorph.remove_attachment()
    settings.simulation.max_displacement = settings.simulation.max_thickness = 0.0
    for name, (frame, properties) in targets.items():
        bpy.context.scene.frame_set(frame)
        bpy.ops.dynamorph.add_target(key=name)
        assign(obj.dynamorph.active_target, properties)
    assign(obj.dynamorph.targets[0], neutral)
    bpy.context.scene.frame_set(1)


def add_touched_skin(obj: bpy.types.Object, colliders: Sequence[bpy.types.Object]) -> None:
    """A soft skin as the add-on's own buttons make it, that these objects stop; in Full Quality, for dents."""
    bpy.context.view_layer.objects.active = obj
    bpy.ops.dynamorph.add_soft_skin()
    for other in colliders:
        other.select_set(True)
    if colliders:
        bpy.ops.dynamorph.collide()
    bpy.ops.object.select_all(action="DESELECT")
    obj.select_set(True)
    obj.dynamorph.model.solver = "FULL"


def write_curves(
    owner: bpy.types.ID,
    name: str,
    curves: dict[str, np.ndarray],
    cuts: Iterable[int] = (),
    corners: Iterable[int] = (),
) -> None:
    """An action with a key on every frame: smooth, but for `corners` and for jumps after the frames of `cuts`.

    curves: data path -> values (F,) or (F, channels). What never changes gets a single key.
    """
    action = bpy.data.actions.new(name)
    animation = owner.animation_data_create()
    animation.action = action
    animation.action_slot = action.slots.new(owner.id_type, owner.name)
    channels = action.layers.new("Layer").strips.new(type="KEYFRAME").channelbag(animation.action_slot, ensure=True)
    for path, values in curves.items():
        values = np.asarray(values, np.float32)
        for index, column in enumerate(values.reshape(len(values), -1).T):
            column = column if np.ptp(column) > 1e-6 else column[:1]
            frames = np.arange(1, len(column) + 1)
            curve = channels.fcurves.new(path, index=index)
            curve.keyframe_points.add(len(column))
            curve.keyframe_points.foreach_set("co", np.column_stack([frames, column]).astype(np.float32).ravel())
            jumps, bends = np.isin(frames, list(cuts)), np.isin(frames, list(corners))
            keys = {"interpolation": np.where(jumps, CONSTANT, BEZIER)}
            keys |= {f"handle_{side}_type": np.where(bends, CORNER, SMOOTH) for side in ("left", "right")}
            for field, kinds in keys.items():
                curve.keyframe_points.foreach_set(field, kinds.astype(np.int32))
            curve.update()


def save_scene(path: Path) -> None:
    bpy.context.preferences.filepaths.save_version = 0
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True)
