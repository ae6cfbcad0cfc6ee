# SPDX-License-Identifier: GPL-3.0-or-later
"""Clothes, eyes and other pieces of a character: other meshes that the flesh carries along, and parts of the mesh."""

import bpy
import numpy as np
import pytest
import scenes
from builders import activate, evaluated_points, keys_of, make_mesh, part, refused, rig_of, skinned
from mathutils import Matrix
from robustness import bake, coarse

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

OPS = bpy.ops.dynamorph


def skin(obj, rig, weights):
    """Vertex groups of the arm's bones with these weights (V, 2), and an Armature modifier."""
    for bone, column in zip(["upper", "lower"], weights.T, strict=True):
        group = obj.vertex_groups.new(name=bone)
        for index in np.flatnonzero(column):
            group.add([int(index)], float(column[index]), "REPLACE")
    obj.modifiers.new("Armature", "ARMATURE").object = rig


def make_sleeve(arm, name="Sleeve", away=1.1):
    """A tube a little wider than the arm, whose object has a place, a turn and a size of its own."""
    vertices, faces = scenes.tube()
    weights = scenes.two_bone_weights(vertices)
    vertices = np.asarray(vertices) * [away, away, 1.0]
    world = Matrix.Translation((0.3, -0.2, 0.1)) @ Matrix.Rotation(0.7, 4, "X") @ Matrix.Diagonal((2.0, 2.0, 0.5, 1.0))
    back = np.array(world.inverted())
    sleeve = make_mesh(bpy.context.scene, name, vertices @ back[:3, :3].T + back[:3, 3], faces)
    sleeve.matrix_world = world
    skin(sleeve, rig_of(arm), weights)
    bpy.context.view_layer.update()
    return sleeve


def add_piece(obj, piece, choice="WITH_BODY"):
    item = obj.dynamorph.pieces.add()
    item.object, item.name, item.choice = piece, piece.name, choice
    return item


@pytest.fixture
def dressed(soft_arm):
    """The soft arm and its sleeve, which is a piece of it."""
    sleeve = make_sleeve(coarse(soft_arm))
    add_piece(soft_arm, sleeve)
    activate(soft_arm)
    return soft_arm, sleeve


def motion(obj, frames=(1, 9, 20)):
    shown = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        shown.append(evaluated_points(obj))
    return np.array(shown)


# Other meshes ------------------------------------------------------------------------------------------------------


def test_a_sleeve_shows_what_the_flesh_around_it_does(dressed):
    """Blender's sleeve is the embedded displacement, skinned by the sleeve's own weights."""
    arm, sleeve = dressed
    stiff = motion(sleeve)
    job = bake(arm)
    assert sleeve.dynamorph.follows == arm and len(sleeve.dynamorph.bake.keys) == len(arm.dynamorph.bake.keys)
    (follower,) = job.followers
    modes = np.moveaxis(job.result.node_modes, 0, 1)
    engine = pytest.importorskip("dynamorph")
    embedding = engine.embed(engine.TetMesh(job.model.nodes, job.model.tets), follower.vertices)
    bind = embedding.interpolate(modes.reshape(len(modes), -1)).reshape(len(follower.vertices), -1, 3)
    character = part("extract").character(arm)
    weights = scenes.two_bone_weights(scenes.tube()[0])
    weights = np.hstack([weights, 1.0 - weights.sum(axis=1, keepdims=True)])
    corners, shares = follower.skin.corners, follower.skin.weights
    for frame, shown, before in zip((1, 9, 20), motion(sleeve), stiff, strict=True):
        moved = np.einsum("k,pkc->pc", job.result.coordinates[frame - 1], bind)
        details = np.tensordot(job.result.weights[frame - 1], job.result.details, 1)
        moved += np.einsum("pc,pcx->px", shares, details[corners]) @ character.to_bind.T
        local = (follower.vertices + moved) @ np.linalg.inv(character.to_bind).T
        worn = part("scene_data").Character(**{**vars(character), "vertices": local, "weights": weights})
        expected = skinned(worn, job.rig[(frame - 1) * job.settings.substeps :][:1])[0]
        assert np.abs(shown - expected).max() < 1e-5
        assert frame == 1 or np.abs(shown - before).max() > 0.01


def test_a_piece_that_is_the_skin_itself_stays_on_it(soft_arm):
    """The same surface as an object of its own: also the details of a coarse cage are there."""
    twin = make_sleeve(coarse(soft_arm), away=1.0)
    add_piece(soft_arm, twin)
    bake(soft_arm)
    assert np.abs(motion(twin) - motion(soft_arm)).max() < 1e-5


@pytest.mark.parametrize("change", [{"solver": "FULL", "modes": 3}, {"method": "STATIC"}])
def test_with_other_methods(soft_arm, change):
    twin = make_sleeve(coarse(soft_arm), away=1.0)
    add_piece(soft_arm, twin)
    for name, value in change.items():
        setattr(soft_arm.dynamorph.model, name, value)
    bake(soft_arm)
    assert np.abs(motion(twin) - motion(soft_arm)).max() < 1e-5
