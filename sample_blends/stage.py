# SPDX-License-Identifier: GPL-3.0-or-later
"""What the sample scenes share: meshes, materials, lights, camera, and the add-on's own buttons. Meters."""

from __future__ import annotations

import math
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

LICENSE = """CC0 1.0 Universal

To the extent possible under law, the authors of Dynamorph have waived all copyright and related or neighboring rights
to this scene: meshes, shape keys, rig, animation, materials and lights.
https://creativecommons.org/publicdomain/zero/1.0/
"""


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


def assign(group: bpy.types.PropertyGroup, values: dict) -> None:
    for name, value in values.items():
        setattr(group, name, value)


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


def save_scene(path: Path) -> None:
    bpy.context.preferences.filepaths.save_version = 0
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True)
