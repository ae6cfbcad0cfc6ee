# SPDX-License-Identifier: GPL-3.0-or-later
"""Characters of several meshes for the tests: parts whose ends coincide, eyes, helmets, heads."""

import bpy
import numpy as np
import scenes
from builders import activate, make_mesh, make_rig
from mathutils import Matrix

BONES = ("upper", "lower", "hand")


def weights_at(z: np.ndarray) -> np.ndarray:
    """Weights (V, 3) of the bones at heights (V,): they meet at 1 and 1.6."""
    first, second = (scenes.two_bone_weights(np.outer(z, [0, 0, 1]), joint)[:, 1] for joint in (1.0, 1.6))
    return np.stack([1 - first, first * (1 - second), second], axis=1)


def skin(obj, rig, weights, bones=BONES):
    """Vertex groups with the weights (V, B), and an Armature modifier."""
    for bone, column in zip(bones, weights.T, strict=True):
        group = obj.vertex_groups.new(name=bone)
        for index in np.flatnonzero(column):
            group.add([int(index)], float(column[index]), "REPLACE")
    obj.modifiers.new("Armature", "ARMATURE").object = rig
    return obj


def tube_between(bottom: float, top: float, rings: int, closed=(True, True)):
    """A tube along z, with or without caps at its ends."""
    vertices, faces = scenes.tube(rings=rings, length=top - bottom)
    caps = [face for face, is_closed in zip(faces[-2:], closed, strict=True) if is_closed]
    return np.asarray(vertices) + np.array([0.0, 0.0, bottom]), [*faces[:-2], *caps]


def ball(center, radius: float, around: int = 8):
    """A closed ball."""
    angles = np.linspace(0.0, np.pi, around // 2 + 2)[1:-1]
    vertices, faces = scenes.tube(rings=len(angles), around=around, radius=1.0, length=1.0)
    ring = np.asarray(vertices).reshape(len(angles), around, 3)
    ring[..., :2] *= np.sin(angles)[:, None, None]
    ring[..., 2] = -np.cos(angles)[:, None]
    return ring.reshape(-1, 3) * radius + center, faces


def make_figure(scene):
    """A body whose upper half is another mesh on the same rig, with a rigid cap on it that shares points with it, and
    an eye that touches nothing. Returns the objects by name.
    """
    rig = make_rig(scene, "Figure Rig", bones=3)
    points, faces = tube_between(0.0, 1.0, 9, closed=(True, False))
    body = skin(make_mesh(scene, "Body", points, faces), rig, weights_at(points[:, 2]))
    points, faces = tube_between(1.0, 2.0, 8, closed=(False, False))
    world = Matrix.Translation((0.3, -0.2, 0.1)) @ Matrix.Rotation(0.7, 4, "X") @ Matrix.Diagonal((2.0, 2.0, 2.0, 1.0))
    back = np.array(world.inverted())
    top = make_mesh(scene, "Top", points @ back[:3, :3].T + back[:3, 3], faces)
    top.matrix_world = world
    skin(top, rig, weights_at(points[:, 2]))
    points, faces = tube_between(2.0, 2.2, 3, closed=(False, True))
    cap = skin(make_mesh(scene, "Cap", points, faces), rig, np.ones((len(points), 1)), ["hand"])
    points, faces = ball((0.4, 0.0, 1.9), 0.05)
    eye = skin(make_mesh(scene, "Eye", points, faces), rig, np.ones((len(points), 1)), ["hand"])
    for frame, angle in ((1, 0.0), (5, 0.6), (9, 0.0), (13, 0.6)):
        rig.pose.bones["upper"].rotation_euler.x = angle / 2
        rig.pose.bones["lower"].rotation_euler.x = angle
        for bone in ("upper", "lower"):
            rig.pose.bones[bone].keyframe_insert("rotation_euler", frame=frame)
    scene.frame_start, scene.frame_end = 1, 14
    scene.frame_set(1)
    bpy.context.view_layer.update()
    activate(body)
    return {obj.name: obj for obj in (rig, body, top, cap, eye)}
