# SPDX-License-Identifier: GPL-3.0-or-later
"""Shakes a soft ball around a rigid core for a second and writes its final shape: python wobble.py ball.obj

Needs the packages dynamorph and trimesh, but not Blender.
"""

import sys

import dynamorph
import numpy as np
import trimesh

ball = trimesh.creation.icosphere(subdivisions=3, radius=0.1)  # meters
mesh = dynamorph.mesh_body(ball.vertices, ball.faces, 400)[2]
core = np.linalg.norm(mesh.nodes, axis=1) < 0.04
whole, one_bone = np.ones(len(mesh.tets)), np.ones((len(mesh.nodes), 1))
body = dynamorph.SoftBody(mesh, whole, whole, whole[:, None], core, one_bone)
jelly = dynamorph.MorphTarget(
    "jelly", np.zeros_like(mesh.nodes), lame_lambda=28.6e3, lame_mu=7.14e3, density=1000, stiffness_damping=0.01
)
full = dynamorph.FullModel(body, [jelly], dynamorph.MaterialModel.STABLE_STVK, dynamorph.Blending.EVEN)
tables = dynamorph.reduce(full, dynamorph.make_basis(full, 20).U)
model = dynamorph.ReducedModel(body, [jelly], tables, dynamorph.Blending.EVEN)

simulation = dynamorph.ReducedSimulation(model, 1 / 120, gravity=(0, 0, -9.81))
bones = np.tile(np.eye(3, 4), (121, 1, 1, 1))  # steps, bones: bind space to world space
bones[:, 0, 0, 3] = 0.02 * np.sin(0.2 * np.arange(121))  # meters, along x
simulation.start(bones[0], bones[1], np.ones(1))
print(simulation.advance(bones[1:], np.ones((120, 1))))

displacement = model.displacement(simulation.coordinates)  # of the nodes
skin = dynamorph.embed(mesh, ball.vertices)
ball.vertices += np.einsum("va,vac->vc", skin.weights, displacement[skin.nodes])
ball.export(sys.argv[1])
