# SPDX-License-Identifier: GPL-3.0-or-later
"""A simple human, 1.8 m tall in a T-pose, on an armature whose bones any table names: for rig_families.py."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import bpy
import figures
import numpy as np
from builders import activate, add_key, make_mesh
from mathutils import Matrix, Vector

FRAMES = 16
SHARPNESS = 6  # weights fall with this power of the distance from a bone
INFLUENCES = 4  # bones of a vertex
# Each role: the role that it hangs on, head, tail and radius, meters; of limbs the left side. It faces -Y.
HUMAN = {
    "hips": ("", (0, 0, 0.95), (0, 0, 1.05), 0.12),
    "spine": ("hips", (0, 0, 1.05), (0, 0, 1.2), 0.11),
    "chest": ("spine", (0, 0, 1.2), (0, 0, 1.42), 0.12),
    "neck": ("chest", (0, 0, 1.42), (0, 0, 1.53), 0.055),
    "head": ("neck", (0, -0.01, 1.53), (0, -0.01, 1.74), 0.095),
    "shoulder": ("chest", (0.03, 0, 1.4), (0.16, 0, 1.41), 0.06),
    "upper_arm": ("shoulder", (0.16, 0, 1.41), (0.42, 0, 1.41), 0.05),
    "lower_arm": ("upper_arm", (0.42, 0, 1.41), (0.66, 0, 1.41), 0.042),
    "hand": ("lower_arm", (0.66, 0, 1.41), (0.82, 0, 1.41), 0.038),
    "thigh": ("hips", (0.11, 0, 0.93), (0.11, 0, 0.5), 0.075),
    "shin": ("thigh", (0.11, 0, 0.5), (0.11, 0.01, 0.1), 0.055),
    "foot": ("shin", (0.11, 0.01, 0.1), (0.11, -0.12, 0.04), 0.045),
    "toe": ("foot", (0.11, -0.12, 0.04), (0.11, -0.2, 0.04), 0.035),
}
CENTER, LIMBS = tuple(HUMAN)[:5], tuple(HUMAN)[5:]
EYES = ((0.035, -0.09, 1.66), (-0.035, -0.09, 1.66))
TEETH = (0.0, -0.08, 1.6)
NECKLINE = 1.5  # height, meters: where families cut the head from the body
WAIST, COLLAR = 1.0, 1.36  # of a shirt


@dataclass(frozen=True)
class Bone:
    """parent: a name or ''; head, tail: meters; radius: for the weights, 0 of a bone that moves no skin."""

    parent: str
    head: tuple
    tail: tuple
    radius: float = 0.0


@dataclass(frozen=True)
class Family:
    """How a family names and places the human.

    rig, body: names of the objects. center, limbs: a word for each role of CENTER and LIMBS, names joined by + where
    several bones share its length; * stands for the side. head: the bone that should be found as the head. above: bones
    over the hips, the topmost first; beside: the trunk hangs on them, as the hips do. twists: of a role, bones that
    hang on the first and carry the same skin. more: other bones. hop: the bone that moves the whole body; without one
    the hips. swing: the bones that turn the arms; without them the first of each. scale, turned: of the armature
    object, which the bones undo; body_scale: of the mesh objects on it.
    """

    rig: str
    body: str
    center: str
    limbs: str
    sides: tuple[str, str]
    head: str = "head"
    above: str = ""
    beside: bool = False
    twists: dict[str, str] = field(default_factory=dict)
    more: dict[str, Bone] = field(default_factory=dict)
    hop: str = ""
    swing: str = ""
    scale: float = 1.0
    turned: float = 0.0
    body_scale: float = 1.0


@dataclass
class Figure:
    """A human of a family. points (V, 3): of the whole skin, world, meters; face: the mesh that has the head, where
    that is not the body; others: mesh objects by name.
    """

    family: Family
    rig: object
    bones: dict[str, Bone]
    points: np.ndarray
    faces: list
    body: object = None
    face: object = None
    others: dict = field(default_factory=dict)

    def whole(self, modifier="Armature"):
        """The whole skin as the body."""
        self.body = self.add(self.family.body, self.points, self.faces, modifier=modifier)
        return self.body

    def add(self, name: str, points, faces, weights=None, modifier="Armature"):
        """A mesh on the armature: points (V, 3) world; weights (V, B) of the bones that move skin, by distance if
        none are given.
        """
        scale = self.family.body_scale
        place = self.rig.matrix_world @ Matrix.Scale(scale, 4)
        obj = make_mesh(bpy.context.scene, name, points @ np.array(place.inverted())[:3, :3].T, faces)
        obj.parent, obj.scale = self.rig, (scale,) * 3
        weights = weights_of(points, self.bones) if weights is None else weights
        for bone, column in zip(skinning(self.bones), weights.T, strict=True):
            if column.any():
                group = obj.vertex_groups.new(name=bone)
                for index in np.flatnonzero(column):
                    group.add([int(index)], float(column[index]), "REPLACE")
        obj.modifiers.new(modifier, "ARMATURE").object = self.rig
        self.others[name] = obj
        bpy.context.view_layer.update()
        return obj

    def part(self, name: str, keep: np.ndarray, offset=0.0):
        """The faces of the skin with all corners among `keep` (V,), as a mesh of its own, `offset` meters outside."""
        faces = [face for face in self.faces if keep[face].all()]
        used = np.unique(np.concatenate(faces))
        number = np.zeros(len(self.points), int)
        number[used] = np.arange(len(used))
        points = self.points + offset * normals(self.points, self.faces)
        weights = weights_of(self.points[used], self.bones)
        return self.add(name, points[used], [number[face].tolist() for face in faces], weights)

    def head_and_body(self, face: str, body: str):
        """Two meshes that share points at the neckline."""
        above = self.points[:, 2] > NECKLINE
        shared = np.zeros(len(above), bool)
        for corners in self.faces:
            shared[corners] |= above[corners].any() and not above[corners].all()
        return self.part(face, above), self.part(body, ~above | shared)

    def on_bone(self, name: str, bone: str, points, faces):
        """A mesh that one bone carries."""
        carried = np.tile([each == bone for each in skinning(self.bones)], (len(points), 1)).astype(float)
        return self.add(name, points, faces, carried)

    def eyes(self, name: str, bone=""):
        """Both, on the head or another bone."""
        (left, faces), (right, _) = (figures.ball(center, 0.012) for center in EYES)
        both = [*faces, *([corner + len(left) for corner in face] for face in faces)]
        return self.on_bone(name, bone or self.family.head, np.concatenate([left, right]), both)

    def shirt(self, name: str):
        height = self.points[:, 2]
        return self.part(name, (height > WAIST) & (height < COLLAR), offset=0.012)

    def constrain(self, bone: str, kind: str, target: str, **values):
        """A constraint between two bones of the armature."""
        made = self.rig.pose.bones[bone].constraints.new(kind)
        made.target, made.subtarget = self.rig, target
        for name, value in values.items():
            setattr(made, name, value)


def humanoid(family: Family) -> Figure:
    """The family's armature, without meshes."""
    bones = bones_of(family)
    return Figure(family, armature(family, bones), bones, *skin())


# The skin ------------------------------------------------------------------------------------------------------------


@cache
def skin() -> tuple[np.ndarray, list]:
    """Points (V, 3) and faces of a closed body about HUMAN."""
    return around([(Vector(head), Vector(tail), radius) for _, head, tail, radius in both_sides().values()])


def around(segments) -> tuple[np.ndarray, list]:
    """Points (V, 3) and faces of one closed surface about bones: (head, tail, radius) of each."""
    ball = bpy.data.metaballs.new("Skin")
    obj = bpy.data.objects.new("Skin", ball)
    bpy.context.scene.collection.objects.link(obj)
    ball.resolution = 0.03
    for head, tail, radius in segments:
        for along in np.linspace(0.0, 1.0, 2 + int((tail - head).length / (0.7 * radius))):
            element = ball.elements.new()
            element.co, element.radius = head.lerp(tail, along), 1.6 * radius
    bpy.context.view_layer.update()
    mesh = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    points = np.array([vertex.co for vertex in mesh.vertices])
    faces = [list(face.vertices) for face in mesh.polygons]
    bpy.data.objects.remove(obj)
    bpy.data.metaballs.remove(ball)
    return points, faces


def both_sides() -> dict[tuple[str, int], tuple]:
    """HUMAN with both sides of the limbs: by role and side, which is 1, -1 or 0."""
    return {
        (role, side): (parent, *(np.array(end) * (side or 1, 1, 1) for end in (head, tail)), radius)
        for role, (parent, head, tail, radius) in HUMAN.items()
        for side in ((0,) if role in CENTER else (1, -1))
    }


def normals(points: np.ndarray, faces) -> np.ndarray:
    """Unit normals (V, 3)."""
    sums = np.zeros(points.shape)
    for face in faces:
        a, b, c = points[face[:3]]
        sums[face] += np.cross(b - a, c - a)
    return sums / np.linalg.norm(sums, axis=1, keepdims=True)


def skinning(bones: dict[str, Bone]) -> list[str]:
    """The bones that move skin."""
    return [name for name, bone in bones.items() if bone.radius]


def weights_of(points: np.ndarray, bones: dict[str, Bone]) -> np.ndarray:
    """(V, B) of the bones that move skin, by the distance from each in multiples of its radius."""
    nearness = np.empty((len(points), len(skinning(bones))))
    for column, name in zip(nearness.T, skinning(bones), strict=True):
        head, tail = np.array(bones[name].head), np.array(bones[name].tail)
        along = ((points - head) @ (tail - head) / ((tail - head) @ (tail - head))).clip(0.0, 1.0)
        distance = np.linalg.norm(points - head - along[:, None] * (tail - head), axis=1)
        column[:] = (distance / bones[name].radius + 1e-3) ** -SHARPNESS
    nearness[nearness < np.sort(nearness, axis=1)[:, -INFLUENCES, None]] = 0.0
    nearness /= nearness.sum(axis=1, keepdims=True)
    nearness[nearness < 0.01] = 0.0
    return nearness / nearness.sum(axis=1, keepdims=True)


# The armature --------------------------------------------------------------------------------------------------------


def bones_of(family: Family) -> dict[str, Bone]:
    """All bones of the family, parents before children."""
    names = dict(zip((*CENTER, *LIMBS), [*family.center.split(), *family.limbs.split()], strict=True))
    bones, top = {}, ""
    for name in family.above.split():
        at_hips = family.beside and name == family.above.split()[-1]
        height = 0.9 if at_hips else 0.0  # a root is on the ground
        bones[name] = Bone(top, (0, 0, height), (0, 0, height + 0.05))
        top = name
    for (role, side), (parent, head, tail, radius) in both_sides().items():
        word = family.sides[side < 0]
        chain, twists = (text.replace("*", word) for text in (names[role], family.twists.get(role, "")))
        above = names[parent].replace("*", word).split("+")[-1] if parent else top
        if role == "spine" and family.beside:
            above = top
        bones |= in_a_row(chain.split("+"), above, head, tail, radius)
        first = chain.split("+")[0]
        bones |= {
            name: replaced(bone, first) for name, bone in in_a_row(twists.split(), "", head, tail, radius).items()
        }
    return bones | family.more


def in_a_row(names: list[str], parent: str, head, tail, radius: float) -> dict[str, Bone]:
    """Bones that share a length, each the parent of the next."""
    ends = [tuple(end) for end in np.linspace(head, tail, len(names) + 1)]
    parents = [parent, *names]
    return {name: Bone(parents[k], ends[k], ends[k + 1], radius) for k, name in enumerate(names)}


def replaced(bone: Bone, parent: str) -> Bone:
    return Bone(parent, bone.head, bone.tail, bone.radius)


def armature(family: Family, bones: dict[str, Bone]):
    """The armature object with these bones, in object mode."""
    rig = bpy.data.objects.new(family.rig, bpy.data.armatures.new(family.rig))
    bpy.context.scene.collection.objects.link(rig)
    rig.matrix_world = Matrix.Rotation(family.turned, 4, "X") @ Matrix.Scale(family.scale, 4)
    bpy.context.view_layer.update()
    back = rig.matrix_world.inverted()
    activate(rig)
    bpy.ops.object.mode_set(mode="EDIT")
    for name, bone in bones.items():
        made = rig.data.edit_bones.new(name)
        made.head, made.tail = back @ Vector(bone.head), back @ Vector(bone.tail)
        made.parent = rig.data.edit_bones[bone.parent] if bone.parent else None
        made.use_deform = bool(bone.radius)
    bpy.ops.object.mode_set(mode="OBJECT")
    return rig


def animate(figure: Figure):
    """Keyframes: the whole body hops, the arms swing."""
    scene, rig, family = bpy.context.scene, figure.rig, figure.family
    hop = rig.pose.bones[family.hop or family.center.split()[0].split("+")[0]]
    swing = family.swing or family.limbs.split()[1].split("+")[0]
    for frame, height in ((1, 0.0), (5, 0.12), (9, -0.05), (13, 0.0)):
        up = rig.matrix_world.to_3x3().inverted() @ Vector((0, 0, height))  # armature space
        hop.location = hop.bone.matrix_local.to_3x3().inverted() @ up
        hop.keyframe_insert("location", frame=frame)
    for side, sign in zip(family.sides, (1, -1), strict=True):
        bone = rig.pose.bones[swing.replace("*", side)]
        bone.rotation_mode = "XYZ"
        for frame, angle in ((1, 0.0), (8, 0.8), (13, 0.1)):
            bone.rotation_euler = (0, 0, sign * angle)
            bone.keyframe_insert("rotation_euler", frame=frame)
    scene.frame_start, scene.frame_end = 1, FRAMES
    scene.frame_set(1)


# Shape keys ----------------------------------------------------------------------------------------------------------


def add_shape(obj, name: str, value: float, displacement=0.0):
    """A shape key that has this value without being animated. displacement: (V, 3), the mesh's space."""
    if not obj.data.shape_keys:
        obj.shape_key_add(name="Basis", from_mix=False)
    block = add_key(obj, name, displacement)
    block.value = value
    return block


def fuller(obj, amount: float) -> np.ndarray:
    """A displacement (V, 3) in the mesh's space: `amount` meters outward at the belly and the thighs."""
    to_world = np.array(obj.matrix_world)
    points = np.array([vertex.co for vertex in obj.data.vertices]) @ to_world[:3, :3].T + to_world[:3, 3]
    outward = normals(points, [list(face.vertices) for face in obj.data.polygons])
    near = np.exp(-(((points[:, 2] - 1.0) / 0.2) ** 2))
    return amount * near[:, None] * outward @ np.linalg.inv(to_world[:3, :3]).T
