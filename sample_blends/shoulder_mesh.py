# SPDX-License-Identifier: GPL-3.0-or-later
"""The left shoulder of MakeHuman's muscular man as a bust: a quarter of the torso and the arm, cut and capped.

Everything is in meters, Z up; the man faces -Y, his left arm points to +X.
"""

from __future__ import annotations

from dataclasses import dataclass

import bmesh
import bpy
import makehuman
import numpy as np
from scipy.sparse import csr_array
from stage import smoothstep

BONES = ("chest", "clavicle", "upperarm", "forearm")
CHEST, CLAVICLE, UPPERARM, FOREARM = range(4)
RIG_BONES = ("spine_03", "clavicle_l", "upperarm_l", "lowerarm_l")  # the same in MakeHuman's rig
HAND = ("hand", "thumb", "index", "middle", "ring", "pinky")

MACROS = {
    "macrodetails/caucasian-male-young": 1.0,
    "macrodetails/universal-male-young-maxmuscle-averageweight": 1.0,
    "macrodetails/proportions/male-young-maxmuscle-averageweight-idealproportions": 1.0,
    "arms/l-upperarm-muscle-incr": 0.8,
    "arms/l-upperarm-shoulder-muscle-incr": 0.6,
    "arms/l-lowerarm-muscle-incr": 0.7,
    "torso/torso-muscle-pectoral-incr": 0.3,
}
MUSCLES = {
    "deltoid": "arms/l-upperarm-shoulder-muscle-incr",
    "pectoral": "torso/torso-muscle-pectoral-incr",
    "dorsi": "torso/torso-muscle-dorsi-incr",
}

STRAIGHTEN = np.radians(24)  # MakeHuman's elbow is bent by 46 degrees; a rest pose should be nearer the middle
ELBOW_BLEND = 0.14  # meters of arm over which the elbow's two bones share the skin
SHOULDER_SMOOTHING = 40  # rounds of averaging over neighbors: about a limb's radius
FLANK, NECK = 0.10, 0.01  # where the torso is cut: below the head of spine_03, above that of neck_01
RIM = 0.05  # meters from a cut within which the skin follows the chest ever more
NECK_TILT = (-0.35, -0.25, 1.0)


@dataclass(frozen=True)
class Bust:
    """V vertices, faces, caps (F,): whether a face is a cut's; weights (V, 4) of BONES; joints: name -> (3,).

    hand (V,): 1 on the hand; to_cut (V,): meters to the nearest cut; muscles: name -> (V, 3), how it grows.
    """

    vertices: np.ndarray
    faces: list[list[int]]
    caps: np.ndarray
    weights: np.ndarray
    joints: dict[str, np.ndarray]
    hand: np.ndarray
    to_cut: np.ndarray
    muscles: dict[str, np.ndarray]


def make_bust() -> Bust:
    human = makehuman.Human.load(MACROS)
    rig = makehuman.Rig("game_engine")
    joints = {bone: human.joint(rig.bones[name]["head"]) for bone, name in zip(BONES, RIG_BONES, strict=True)}
    joints |= {name: human.joint(rig.bones[name]["head"]) for name in ("hand_l", "neck_01")}
    weights, hand = bone_weights(rig, len(human.vertices))
    muscles = [makehuman.target(name) for name in MUSCLES.values()]
    columns, quads = refine(np.hstack([human.vertices, weights, hand[:, None], *muscles]), human.faces["body"])
    columns, faces, caps = cut(columns, quads, joints)

    vertices, weights, hand = columns[:, :3], columns[:, 3:7], columns[:, 7]
    muscles = columns[:, 8:].reshape(len(vertices), -1, 3).transpose(1, 0, 2)
    weights = smooth_weights(vertices, faces, weights, joints)
    planes = cut_planes(joints)
    to_cut = np.min([abs((vertices - point) @ normal) for point, normal in planes], axis=0)
    to_cut[weights[:, UPPERARM:].sum(axis=1) > 0.5] = np.inf  # the cuts' planes go on beyond the torso
    weights = chest_alone(weights, 1 - smoothstep(to_cut / RIM))
    vertices, muscles = straighten(vertices, muscles, weights, joints)
    return Bust(vertices, faces, caps, weights, joints, hand, to_cut, dict(zip(MUSCLES, muscles, strict=True)))


def bone_weights(rig: makehuman.Rig, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights (V, 4) of BONES and how much of each vertex is the hand (V,)."""
    weights, hand = np.zeros((count, 4)), np.zeros(count)
    for name, column in rig.weights(count).items():
        of_hand = name.endswith("_l") and name.split("_")[0] in HAND
        bone = FOREARM if of_hand else RIG_BONES.index(name) if name in RIG_BONES else CHEST
        weights[:, bone] += column
        hand += column * of_hand
    total = np.maximum(weights.sum(axis=1), 1e-9)
    return weights / total[:, None], hand / total


def refine(columns: np.ndarray, quads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One step of Catmull and Clark's subdivision for all columns (V, k), positions and what else rides on them."""
    count = len(columns)
    used = np.zeros(count, bool)
    used[quads] = True
    centers = columns[quads].mean(axis=1)
    corners = np.stack([quads, np.roll(quads, -1, axis=1)], axis=-1).reshape(-1, 2)
    edges, edge_of = np.unique(np.sort(corners, axis=1), axis=0, return_inverse=True)
    edge_of = edge_of.reshape(-1, 4)
    sides = np.bincount(edge_of.ravel(), minlength=len(edges))[:, None]
    middles = columns[edges].mean(axis=1)
    around = spread(edge_of, centers, len(edges)) / sides
    edge_points = np.where(sides == 2, 0.5 * (middles + around), middles)

    degree = np.maximum(np.bincount(quads.ravel(), minlength=count), 1)[:, None]
    valence = np.maximum(np.bincount(edges.ravel(), minlength=count), 1)[:, None]
    faces_around = spread(quads, centers, count) / degree
    edges_around = spread(edges, middles, count) / valence
    moved = (faces_around + 2 * edges_around + (degree - 3) * columns) / degree
    closed = used[:, None] & (degree == valence)
    first_edge, first_face = count, count + len(edges)
    fine = np.stack(
        [quads, first_edge + edge_of, np.broadcast_to(np.arange(len(quads))[:, None] + first_face, quads.shape),
         first_edge + np.roll(edge_of, 1, axis=1)], axis=-1
    )  # fmt: skip
    return np.vstack([np.where(closed, moved, columns), edge_points, centers]), fine.reshape(-1, 4)


def spread(corners: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Sums (count, k) of each row of `values` over the corners (n, c) that it belongs to."""
    rows = np.repeat(np.arange(len(corners)), corners.shape[1])
    return csr_array((np.ones(corners.size), (corners.ravel(), rows)), shape=(count, len(corners))) @ values


# --- Cutting ----------------------------------------------------------------------------------------------------------


def cut_planes(joints) -> list[tuple[np.ndarray, np.ndarray]]:
    """Points and outward unit normals: through the middle of the body, below the chest, above the neck's base."""
    tilt = np.array(NECK_TILT) / np.linalg.norm(NECK_TILT)
    return [
        (np.zeros(3), np.array([-1.0, 0, 0])),
        (joints["chest"] - [0, 0, FLANK], np.array([0, 0, -1.0])),
        (joints["neck_01"] + [0, 0, NECK], tilt),
    ]


def cut(columns: np.ndarray, quads: np.ndarray, joints) -> tuple[np.ndarray, list[list[int]], np.ndarray]:
    """Cut at `cut_planes` all but the arm and cap the cuts: columns, faces, caps (F,) bool."""
    mesh = bpy.data.meshes.new("Cut")
    mesh.from_pydata(columns[:, :3].tolist(), [], quads.tolist())
    for k, column in enumerate(columns[:, 3:].T):
        mesh.attributes.new(f"c{k}", "FLOAT", "POINT").data.foreach_set("value", column.astype(np.float32))
    bm = bmesh.new()
    bm.from_mesh(mesh)
    bpy.data.meshes.remove(mesh)
    layers = [bm.verts.layers.float[f"c{k}"] for k in range(columns.shape[1] - 3)]
    for point, normal in cut_planes(joints):
        torso = [f for f in bm.faces if any(v[layers[UPPERARM]] + v[layers[FOREARM]] < 0.5 for v in f.verts)]
        edges = dict.fromkeys(e for f in torso for e in f.edges)  # not a set: its order would change the mesh's
        parts = [*torso, *edges, *dict.fromkeys(v for f in torso for v in f.verts)]
        bmesh.ops.bisect_plane(bm, geom=parts, dist=1e-4, plane_co=point, plane_no=normal, clear_outer=True)
        rim = [e for e in bm.edges if e.is_boundary]
        for face in bmesh.ops.holes_fill(bm, edges=rim, sides=0)["faces"]:
            face.material_index = 1  # later cuts hand it on to the pieces
    bmesh.ops.delete(bm, geom=[v for v in bm.verts if not v.link_faces], context="VERTS")
    bm.verts.index_update()
    out = np.array([[*v.co, *(v[layer] for layer in layers)] for v in bm.verts])
    faces = [[v.index for v in f.verts] for f in bm.faces]
    is_cap = np.array([f.material_index == 1 for f in bm.faces])
    bm.free()
    return out, faces, is_cap


# --- Skinning ---------------------------------------------------------------------------------------------------------


def neighbor_average(faces, count: int) -> csr_array:
    """(V, V): replaces a value by the mean over the vertices that share an edge."""
    pairs = np.array([(a, b) for face in faces for a, b in zip(face, face[1:] + face[:1], strict=True)])
    pairs = np.unique(np.vstack([pairs, pairs[:, ::-1]]), axis=0)
    share = 1.0 / np.bincount(pairs[:, 0], minlength=count)
    return csr_array((share[pairs[:, 0]], (pairs[:, 0], pairs[:, 1])), shape=(count, count))


def along_arm(vertices: np.ndarray, joints) -> np.ndarray:
    """Meters (V,) beyond the plane that halves the elbow."""
    shoulder, elbow, hand = joints["upperarm"], joints["forearm"], joints["hand_l"]
    normal = (elbow - shoulder) / np.linalg.norm(elbow - shoulder) + (hand - elbow) / np.linalg.norm(hand - elbow)
    return (vertices - elbow) @ (normal / np.linalg.norm(normal))


def smooth_weights(vertices, faces, weights, joints) -> np.ndarray:
    """Weights whose change over a joint takes as long as the limb is thick: no target could open a tighter fold."""
    average = neighbor_average(faces, len(vertices))
    arm = weights[:, UPPERARM] + weights[:, FOREARM]
    smooth = np.column_stack([weights[:, :UPPERARM], arm])
    for _ in range(SHOULDER_SMOOTHING):
        smooth = average @ smooth
    below = smoothstep(along_arm(vertices, joints) / ELBOW_BLEND + 0.5)
    smooth = np.column_stack([smooth[:, :UPPERARM], smooth[:, UPPERARM] * (1 - below), smooth[:, UPPERARM] * below])
    return smooth / smooth.sum(axis=1, keepdims=True)


def chest_alone(weights: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Weights that give the chest a `share` (V,) of its own, so that caps stay flat."""
    chest = np.eye(4)[CHEST]
    return weights + share[:, None] * (chest - weights)


def straighten(vertices, muscles, weights, joints):
    """Open the elbow by STRAIGHTEN; `joints` follow."""
    elbow = joints["forearm"]
    turn = rotation(hinge(joints), -STRAIGHTEN)
    blend = np.eye(3) + weights[:, FOREARM, None, None] * (turn - np.eye(3))
    joints["hand_l"] = elbow + turn @ (joints["hand_l"] - elbow)
    return elbow + np.einsum("vij,vj->vi", blend, vertices - elbow), np.einsum("vij,mvj->mvi", blend, muscles)


def hinge(joints) -> np.ndarray:
    """The elbow's axis: turning about it bends the elbow."""
    axis = np.cross(joints["forearm"] - joints["upperarm"], joints["hand_l"] - joints["forearm"])
    return axis / np.linalg.norm(axis)


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rodrigues' formula: the matrix (3, 3) of a turn about a unit axis."""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
