# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tests of robustness share: bakes with a coarse cage, and all the state that a button may change."""

import bpy
import numpy as np
from builders import evaluated_points, fingerprint, part
from test_sinks import keys_of

OPS = bpy.ops.dynamorph


def coarse(obj):
    """A cage that is built in a fraction of a second."""
    obj.dynamorph.model.cage_nodes = 200
    obj.dynamorph.model.modes = 6
    obj.dynamorph.model.pin_radius = 0.5
    return obj


def bake(obj, **options):
    job = part("jobs").Job(obj, goal="BAKE", **options)
    part("jobs").run(job)
    return job


def names(obj):
    return [block.name for block in keys_of(obj).key_blocks]


def motion(obj, frames=(1, 7, 13, 20)):
    """Where Blender shows the mesh at some frames."""
    shown = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        shown.append(evaluated_points(obj))
    return np.array(shown)


def settings(group):
    """All properties of a property group, and of the groups in it, as comparable data."""
    out = {}
    for prop in group.bl_rna.properties:
        value = getattr(group, prop.identifier)
        if prop.identifier == "rna_type":
            continue
        if prop.type == "COLLECTION":
            value = [settings(item) for item in value]
        elif isinstance(value, bpy.types.PropertyGroup):
            value = settings(value)
        elif prop.type == "POINTER":
            value = value and value.name
        elif getattr(prop, "is_array", False):
            value = tuple(value)
        out[prop.identifier] = value
    return out


def state():
    """All that a button of the add-on may change, of every mesh and rig of the scene."""
    out = {"frame": bpy.context.scene.frame_current, "active": bpy.context.object and bpy.context.object.name}
    for obj in bpy.context.scene.objects:
        mine = out[obj.name] = {"mode": obj.mode, "world": [tuple(row) for row in obj.matrix_world]}
        if obj.type == "ARMATURE":
            mine["pose"] = [tuple(map(tuple, bone.matrix_basis)) for bone in obj.pose.bones]
        if obj.type == "MESH":
            mine["settings"] = settings(obj.dynamorph)
            mine["model"] = obj.get(part("jobs").PACKED)
            mine["keys"] = fingerprint(obj) if keys_of(obj) else None
            mine["groups"] = obj.vertex_groups.keys()
            mine["weights"] = [[(g.group, g.weight) for g in vertex.groups] for vertex in obj.data.vertices]
    return out
