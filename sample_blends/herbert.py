# SPDX-License-Identifier: GPL-3.0-or-later
"""Herbert: a cartoon swimmer of 46 bones, skinny and flabby upright, stiff and bulged when he tucks. He dives from a
springboard, then runs into a wall. The motion is in herbert_motion.py, the places in herbert_sets.py. Meters.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import bpy
import herbert_motion as motion
import herbert_sets as sets
import numpy as np
from herbert_action import animate
from herbert_skeleton import SPINE, Skeleton
from makehuman import LICENSE, Human, Rig, target
from mathutils import Matrix
from stage import (
    add_lathe,
    add_material,
    add_mesh,
    add_shape_keys,
    add_soft_skin,
    add_vertex_groups,
    assign,
    save_scene,
    set_up_scene,
    smoothstep,
)  # fmt: skip

# MakeHuman's targets; {s} stands for left and right.
BODY = {
    "macrodetails/caucasian-male-young": 1.0,
    "macrodetails/universal-male-young-averagemuscle-minweight": 0.45,
    "macrodetails/universal-male-young-minmuscle-averageweight": 0.55,
    "head/head-scale-horiz-incr": 0.6, "head/head-round": 0.8, "head/head-fat-incr": 1.2,
    "chin/chin-width-incr": 1.0, "neck/neck-scale-vert-decr": 0.5,
    "ears/{s}-ear-scale-incr": 0.8, "ears/{s}-ear-wing-incr": 0.8,
    "hands/{s}-hand-scale-incr": 1.5, "hands/{s}-hand-fingers-diameter-incr": 2.4,
    "feet/{s}-foot-scale-incr": 1.0, "feet/{s}-foot-scale-vert-incr": 0.8,
    "stomach/stomach-pregnant-incr": 0.5, "stomach/stomach-tone-decr": 0.6,
    "torso/torso-vshape-decr": 1.0, "torso/torso-scale-horiz-incr": 0.5, "torso/torso-scale-depth-incr": 0.7,
    "hip/hip-scale-depth-incr": 0.3, "hip/hip-scale-horiz-incr": 0.4,
    "legs/upperlegs-height-decr": 1.2, "legs/lowerlegs-height-decr": 0.8,
}  # fmt: skip
BIG_HEAD = 1.55
# Fingers need no tips of their own in a cartoon; and the pelvis is the root. 53 bones become 46.
DROPPED = {"Root": ""} | {f"{f}_03_{s}": f"{f}_02_{s}" for f in ("middle", "ring", "pinky") for s in "lr"}

TUCK = {
    "stomach/stomach-pregnant-incr": 1.25,
    "macrodetails/universal-male-young-averagemuscle-maxweight": 1.1,
    "macrodetails/universal-male-young-averagemuscle-averageweight": -1.1,
    "legs/{s}-upperleg-fat-incr": 0.9,
    "buttocks/buttocks-volume-incr": 0.9,
}
FIRMNESS = "Firmness"  # vertex group: 0.5 as the targets are, 1 held by the bones
HELD = 0.0, 0.05, 0.2  # softness: the bones hold the skin below, and leave it as it is above
SOFT_BONES = ("pelvis", "spine_01", "spine_02", "spine_03", "thigh_l", "thigh_r")

# Stiffness in Pa and the two Rayleigh dampings of each target.
FLABBY = {"stiffness": 18e3, "mass_damping": 2.0, "stiffness_damping": 0.013}
HALF = {"stiffness": 60e3, "mass_damping": 2.0, "stiffness_damping": 0.005}
STIFF = {"stiffness": 180e3, "mass_damping": 2.0, "stiffness_damping": 0.002}
# Stable StVK, because in the full model plain StVK turns more than twice as many tetrahedra inside out. Forces are the
# source's blending, and here look the same as even: the targets lie along one bend.
MODEL = {
    "basis": "MODES",
    "material_model": "STABLE_STVK",
    "solver": "REDUCED",
    "blending": "FORCES",
    "modes": 12,
    "fit_to_shot": True,
    "cage_nodes": 600,
}

SKIN = (0.80, 0.44, 0.30)
RED, CREAM, NAVY = (0.62, 0.035, 0.03), (0.86, 0.80, 0.66), (0.02, 0.04, 0.14)
STRIPE = 0.105  # meters from one red stripe to the next

README = """Herbert

A cartoon swimmer of 46 bones. Two shots stand one after the other on the timeline; each has its own camera, which the
timeline's markers switch on. Press Play for both.

  frames   1-127  Dive   walk, hurdle, board, somersault, into the water
  frames 128-218  Wall   a run, a wall, and the impact
To work on one of them set the scene's frame range to it.
Self Collision is on: in the tuck (frame 91) the belly meets the thighs.

Three dynamic morph targets, placed by the bend of the spine alone, so that walking and running leave the belly soft:
  Neutral    upright: skinny and flabby, swinging at about 3 Hz
  Half tuck  firmer and fuller
  Tuck       the fetal pose: bulged, and ten times as stiff

Select Herbert, press Bake in the Dynamorph tab, and watch the belly: at the landing on the board (frame 61), in the
throw (73), in the tuck (87-95, where it is hard), when he opens out (100), and at the wall (176).
"""


# --- The figure as arrays ---------------------------------------------------------------------------------------------


def both_sides(names: dict[str, float]) -> dict[str, float]:
    """Targets named with {s} become a left and a right one."""
    return {name.format(s=side): weight for name, weight in names.items() for side in "lr"}


def figure() -> Human:
    """MakeHuman's body as a cartoon: a big head on slim limbs."""
    human = Human.load(both_sides(BODY))
    vertices = human.vertices
    neck = human.joint(Rig("game_engine").bones["head"]["head"])
    head = smoothstep((vertices[:, 2] - neck[2] + 0.05) / 0.09) * smoothstep((0.2 - abs(vertices[:, 0])) / 0.05)
    return replace(human, vertices=vertices + head[:, None] * (BIG_HEAD - 1) * (vertices - neck))


def rest_bones(human: Human) -> Skeleton:
    bones = {name: bone for name, bone in Rig("game_engine").bones.items() if name not in DROPPED}
    return Skeleton(
        {name: human.joint(bone["head"]) for name, bone in bones.items()},
        {name: human.joint(bone["tail"]) for name, bone in bones.items()},
        {name: DROPPED.get(bone["parent"], bone["parent"]) for name, bone in bones.items()},
    )


def skin_weights(vertices: int) -> dict[str, np.ndarray]:
    weights = Rig("game_engine").weights(vertices)
    for dropped, heir in DROPPED.items():
        if dropped in weights:
            weights[heir] = weights[heir] + weights.pop(dropped)
    return weights


def softness(weights: dict[str, np.ndarray], bones: Skeleton, vertices: np.ndarray) -> np.ndarray:
    """(V,): trunk and thighs are soft; shoulders, knees and all beyond them are held."""
    soft = sum(weights[bone] for bone in SOFT_BONES) / sum(weights.values())
    below_shoulders = (bones.heads["upperarm_l"][2] - 0.02 - vertices[:, 2]) / 0.08
    above_knees = (vertices[:, 2] - bones.heads["calf_l"][2] - 0.06) / 0.08
    return smoothstep(2 * soft - 0.6) * smoothstep(below_shoulders) * smoothstep(above_knees)


def sculpt(used: np.ndarray, soft: np.ndarray, quads: np.ndarray) -> dict[str, np.ndarray]:
    """The two shapes (V, 3) of the body's vertices, nothing where the skin is held."""
    tuck = sum(weight * target(name) for name, weight in both_sides(TUCK).items())[used] * soft[:, None]
    tuck = smooth(tuck, quads, 60) * smoothstep(3 * soft)[:, None]
    return {"Half tuck": 0.45 * tuck, "Tuck": tuck}


def smooth(shape: np.ndarray, quads: np.ndarray, rounds: int) -> np.ndarray:
    """Displacements (V, 3) averaged over neighbors again and again: the coarse cage follows a smooth sculpt."""
    edges = np.concatenate([quads[:, [k, (k + 1) % 4]] for k in range(4)])
    neighbors = np.bincount(edges.ravel(), minlength=len(shape))[:, None]
    for _ in range(rounds):
        total = np.zeros_like(shape)
        np.add.at(total, edges[:, 0], shape[edges[:, 1]])
        np.add.at(total, edges[:, 1], shape[edges[:, 0]])
        shape = total / neighbors
    return shape


def suit_edge(vertices: np.ndarray, weights: dict[str, np.ndarray], bones: Skeleton) -> np.ndarray:
    """(V,): about the distance in meters from the edge of the swimsuit, positive on the suit."""
    x, _, z = vertices.T
    trunk = ("pelvis", "spine", "clavicle", "neck", "thigh", "calf")
    sleeves = sum(weights[bone] for bone in weights if not bone.startswith(trunk))
    neck = bones.heads["neck_01"][2]
    neckline = 0.1 * (np.hypot(x / 0.098, (z - neck - 0.02) / 0.14) - 1)
    straps = np.where(z > neck - 0.115, 0.014, np.inf)  # of the trim's color
    return np.min(
        [straps, z - 0.46, neckline, neck - 0.01 - z, 0.12 * (0.42 - sleeves / sum(weights.values()))], axis=0
    )


def colors(vertices: np.ndarray, edge: np.ndarray) -> np.ndarray:
    """(V, 4) linear RGBA of skin and suit, for views that do not run the material."""
    stripes = smoothstep(0.5 + 2 * np.sin(vertices[:, 2] * 2 * math.pi / STRIPE))[:, None]
    suit = stripes * RED + (1 - stripes) * CREAM
    worn = smoothstep(edge / 0.012 + 0.5)[:, None]
    trim = worn * (1 - smoothstep((edge - 0.014) / 0.008))[:, None]
    color = worn * suit + (1 - worn) * SKIN
    return np.column_stack([(1 - trim) * color + trim * NAVY, np.ones(len(color))])


# --- The figure in Blender --------------------------------------------------------------------------------------------


def add_rig(bones: Skeleton) -> bpy.types.Object:
    rig = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    bpy.context.scene.collection.objects.link(rig)
    rig.rotation_euler.z = math.pi / 2  # he goes along +X
    rig.data.display_type = "STICK"
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    stored = Rig("game_engine").bones
    for name, parent in bones.parents.items():
        bone = rig.data.edit_bones.new(name)
        bone.head, bone.tail, bone.roll = bones.heads[name], bones.tails[name], stored[name]["roll"]
        bone.parent = rig.data.edit_bones[parent] if parent else None
    bpy.ops.object.mode_set(mode="OBJECT")
    return rig


def skin_material() -> bpy.types.Material:
    """Skin, and the striped suit drawn from the mesh's attributes, so that its edges are sharp on a coarse mesh."""
    material = add_material("Herbert", SKIN, 0.45, subsurface=0.15)
    nodes, links = material.node_tree.nodes, material.node_tree.links

    def attribute(name):
        node = nodes.new("ShaderNodeAttribute")
        node.attribute_name = name
        return node.outputs["Fac"]

    def compute(operation, a, b=0.0):
        node = nodes.new("ShaderNodeMath")
        node.operation = operation
        for socket, value in zip(node.inputs, (a, b), strict=False):
            if isinstance(value, float):
                socket.default_value = value
            else:
                links.new(value, socket)
        return node.outputs[0]

    def mix(factor, *colors):
        node = nodes.new("ShaderNodeMixRGB")
        links.new(factor, node.inputs[0])
        for socket, color in zip(node.inputs[1:], colors, strict=True):
            if isinstance(color, tuple):
                socket.default_value = (*color, 1)
            else:
                links.new(color, socket)
        return node.outputs[0]

    edge = attribute("Suit edge")
    wave = compute("SINE", compute("MULTIPLY", attribute("Height"), 2 * math.pi / STRIPE))
    suit = mix(compute("GREATER_THAN", wave, 0.0), CREAM, RED)
    trimmed = mix(compute("GREATER_THAN", edge, 0.018), NAVY, suit)
    color = mix(compute("GREATER_THAN", edge, 0.0), SKIN, trimmed)
    links.new(color, nodes["Principled BSDF"].inputs["Base Color"])
    return material


def skin(obj: bpy.types.Object, rig: bpy.types.Object) -> None:
    obj.parent = rig
    obj.modifiers.new("Armature", "ARMATURE").object = rig


def add_body(human: Human, bones: Skeleton, rig: bpy.types.Object) -> bpy.types.Object:
    used, corners = np.unique(human.faces["body"], return_inverse=True)
    vertices = human.vertices[used]
    quads = corners.reshape(-1, 4)
    body = add_mesh("Herbert", vertices, quads, skin_material())
    weights = {bone: column[used] for bone, column in skin_weights(len(human.vertices)).items()}
    edge = suit_edge(vertices, weights, bones)
    for name, values in (("Suit edge", edge), ("Height", vertices[:, 2])):
        body.data.attributes.new(name, "FLOAT", "POINT").data.foreach_set("value", values.astype(np.float32))
    body.data.color_attributes.new("Color", "BYTE_COLOR", "POINT").data.foreach_set(
        "color", colors(vertices, edge).astype(np.float32).ravel()
    )
    soft = softness(weights, bones, vertices)
    add_vertex_groups(body, weights | {FIRMNESS: np.interp(soft, HELD, [1.0, 0.975, 0.5])})
    add_shape_keys(body, vertices, sculpt(used, soft, quads))
    skin(body, rig)
    finer = body.modifiers.new("Subdivision", "SUBSURF")
    finer.levels, finer.render_levels = 0, 1
    return body


def wear(obj: bpy.types.Object, rig: bpy.types.Object) -> bpy.types.Object:
    """Something that the head carries."""
    add_vertex_groups(obj, {"head": np.ones(len(obj.data.vertices))})
    skin(obj, rig)
    return obj


def transform(obj: bpy.types.Object, matrix: Matrix) -> bpy.types.Object:
    obj.data.transform(matrix)
    return obj


def add_tube(name: str, path, radii, material) -> bpy.types.Object:
    """A tube around points (P, 3) with a radius at each, drawn in the plane of X and Z."""
    path, radii = np.asarray(path, float), np.asarray(radii, float)
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    side = np.cross(along, [0, 1, 0])
    angle = np.arange(12) * math.pi / 6
    rings = path[:, None] + radii[:, None, None] * (
        np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * np.array([0, -1, 0])
    )
    ring, here = np.meshgrid(np.arange(len(path) - 1), np.arange(12), indexing="ij")
    after = (here + 1) % 12
    quads = np.stack([ring * 12 + here, ring * 12 + after, (ring + 1) * 12 + after, (ring + 1) * 12 + here], -1)
    return add_mesh(name, rings.reshape(-1, 3), quads.reshape(-1, 4), material)


def ball(name: str, material) -> bpy.types.Object:
    angle = np.linspace(-math.pi / 2, math.pi / 2, 25)
    return add_lathe(name, np.stack([np.cos(angle).clip(0), np.sin(angle)], 1), material, 32)


def add_face(human: Human, rig: bpy.types.Object) -> None:
    """Round eyes with heavy lids, a ball of a nose, a moustache, brows, and a bathing cap."""
    hair = add_material("Hair", (0.10, 0.035, 0.012), 0.55)
    eyes = [human.vertices[np.unique(human.faces[f"helper-{s}-eye"])].mean(axis=0) for s in "lr"]
    face = np.mean(eyes, axis=0)
    body = human.vertices[np.unique(human.faces["body"])]
    middle = body[(abs(body[:, 0]) < 0.02) & (abs(body[:, 2] - face[2]) < 0.09)]
    nose = middle[middle[:, 1].argmin()]

    add_eyes(eyes, hair, rig)
    red = add_material("Nose", (0.82, 0.30, 0.22), 0.4, subsurface=0.15)
    place = Matrix.Translation(nose - [0, 0.008, 0]) @ Matrix.Diagonal((0.038, 0.036, 0.033, 1))
    wear(transform(ball("Nose", red), place), rig)
    t = np.linspace(-1, 1, 33)
    out = abs(t)
    swoosh = nose + np.stack(
        [0.125 * t, 0.012 + 0.075 * t * t, -0.048 - 0.022 * np.sin(math.pi * out) + 0.045 * out**4], 1
    )
    thick = 0.004 + 0.023 * np.sin(math.pi * (0.9 * out + 0.08)) * (1 - 0.5 * out)
    wear(add_tube("Moustache", swoosh, thick, hair), rig)
    add_cap(body, face, rig, add_material("Cap", RED, 0.25), add_material("Band", CREAM, 0.3))


def add_eyes(eyes: list[np.ndarray], hair, rig: bpy.types.Object) -> None:
    white, dark = add_material("Eye", (0.9, 0.9, 0.87), 0.15), add_material("Pupil", (0.01, 0.008, 0.006), 0.1)
    lid = add_material("Lid", SKIN, 0.5)
    t = np.linspace(0, 1, 9)
    for side, eye in zip((1, -1), eyes, strict=True):
        place = Matrix.Translation((eye[0] * 1.05, eye[1] - 0.012, eye[2] + 0.012))
        eyeball = ball("Eye", white)
        eyeball.data.materials.append(dark)
        for polygon in eyeball.data.polygons:
            polygon.material_index = int(polygon.center.z > 0.90)
        ahead = Matrix.Rotation(math.pi / 2 - 0.05, 4, "X")
        wear(transform(eyeball, place @ ahead @ Matrix.Scale(0.044, 4)), rig)
        dome = [(math.cos(a), math.sin(a)) for a in np.linspace(0.02, math.pi / 2, 12)]
        half_shut = Matrix.Rotation(-0.38, 4, "X") @ Matrix.Rotation(0.14 * side, 4, "Y")
        wear(transform(add_lathe("Eyelid", dome, lid, 32), place @ half_shut @ Matrix.Scale(0.0475, 4)), rig)
        brow = np.stack([side * (0.018 + 0.062 * t), 0.03 * t * t - 0.055, 0.016 * np.sin(2.6 * t) + 0.056], 1)
        brow += [0, eye[1], eye[2]]
        wear(add_tube("Brow", brow, 0.0105 * np.sin(math.pi * (0.08 + 0.84 * t)) ** 0.6, hair), rig)


def add_cap(skull: np.ndarray, face: np.ndarray, rig: bpy.types.Object, cap, band) -> None:
    """A dome with a rolled rim over the skull: an ellipsoid just larger, cut from above the brows to the nape."""
    narrow = skull[(skull[:, 2] > face[2] - 0.02) & (abs(skull[:, 0]) < 0.13)]  # without the ears
    low, high = narrow.min(axis=0), narrow.max(axis=0)
    center = np.array([0, (low[1] + high[1]) / 2, face[2] + 0.035])
    radii = 1.13 * np.array([0.138, (high[1] - low[1]) / 2, high[2] - center[2]])
    angle = np.linspace(0.10, math.pi / 2, 20)
    rim = [(1.0, 0.07), (1.03, 0.05), (1.045, 0.08), (1.03, 0.115)]
    dome = add_lathe("Cap", [*rim, *zip(np.cos(angle), np.sin(angle), strict=True)], cap)
    dome.data.materials.append(band)
    for polygon in dome.data.polygons:
        polygon.material_index = int(0.42 < polygon.center.z < 0.58 or polygon.center.z < 0.115)
    place = Matrix.Translation(center) @ Matrix.Rotation(-0.30, 4, "X") @ Matrix.Diagonal((*radii, 1))
    wear(transform(dome, place), rig)


def make(path: Path) -> None:
    human = figure()
    bones = rest_bones(human)
    shots = {name: shot(bones) for name, shot in motion.SHOTS.items()}
    set_up_scene(README, sum(len(shot.times) for shot in shots.values()), LICENSE)
    rig = add_rig(bones)
    body = add_body(human, bones, rig)
    add_face(human, rig)
    timeline = animate(rig, bones, shots)
    sets.add_sets(shots, timeline)
    add_soft_skin(body, FLABBY, {"Half tuck": (timeline.half_tuck, HALF), "Tuck": (timeline.tuck, STIFF)})
    for soft_target in body.dynamorph.targets[1:]:
        soft_target.set_bones(SPINE)
    assign(body.dynamorph.model, MODEL)
    body.dynamorph.firmness_group = FIRMNESS
    collision = body.dynamorph.collision
    collision.use, collision.use_self, collision.bake_full = True, True, False  # in the tuck, belly and thighs meet
    save_scene(path)
