# SPDX-License-Identifier: GPL-3.0-or-later
"""Bends an arm of two bones, whose muscle bulges and stiffens, and writes its skin:

    python arm.py SKIN.obj [MODEL.dynamorph]

MODEL is what examples/cpp reads. It needs the packages dynamorph and NumPy, but not Blender. Units are SI.
"""

import sys
from pathlib import Path

import dynamorph
import numpy as np

if len(sys.argv) not in (2, 3):
    print("usage: python arm.py SKIN.obj [MODEL.dynamorph]", file=sys.stderr)
    sys.exit(2)

# The skin: a tube along x with closed ends. Any triangles will do.
RINGS, AROUND = 31, 16
x, angle = np.meshgrid(np.linspace(0, 0.6, RINGS), np.arange(AROUND) * 2 * np.pi / AROUND, indexing="ij")
tube = np.stack([x, 0.05 * np.cos(angle), 0.05 * np.sin(angle)], axis=2).reshape(-1, 3)
vertices = np.vstack([tube, [[0, 0, 0], [0.6, 0, 0]]])
triangles = []
for i in range(0, len(tube) - AROUND, AROUND):
    for a, b in zip(range(AROUND), [*range(1, AROUND), 0], strict=True):
        triangles += [(i + a, i + b, i + a + AROUND), (i + b, i + b + AROUND, i + a + AROUND)]
for a, b in zip(range(AROUND), [*range(1, AROUND), 0], strict=True):
    triangles += [(b, a, len(tube)), (len(tube) - AROUND + a, len(tube) - AROUND + b, len(tube) + 1)]
triangles = np.array(triangles)

# The bones: an upper arm and a forearm that turns about y at the elbow.
ELBOW = np.array([0.3, 0, 0])
bones_at_rest = np.array([[[0, 0, 0], ELBOW], [ELBOW, [0.6, 0, 0]]])  # heads and tails


def bone_weights(points):
    forearm = np.clip((points[:, 0] - 0.25) / 0.1, 0, 1)
    return np.column_stack([1 - forearm, forearm])


def pose(bend):
    """The bones' local transforms (2, 4, 4), in which poses are compared, and bind to world space (2, 3, 4)."""
    local, to_world = np.tile(np.eye(4), (2, 1, 1)), np.tile(np.eye(3, 4), (2, 1, 1))
    turn = np.array([[np.cos(bend), 0, -np.sin(bend)], [0, 1, 0], [np.sin(bend), 0, np.cos(bend)]])
    local[1, :3, :3] = to_world[1, :, :3] = turn
    to_world[1, :, 3] = ELBOW - turn @ ELBOW
    return local, to_world


# The body: tetrahedra around the skin, pinned to the bones inside.
mesh = dynamorph.mesh_body(vertices, triangles, 500, bones=bones_at_rest)[2]
fill = dynamorph.fill_fractions(mesh, vertices, triangles)
pinned = dynamorph.pinned(mesh, vertices, triangles, bones_at_rest[:, 0], bones_at_rest[:, 1], 0.4)
painted, region = np.ones(len(mesh.tets)), np.ones((len(mesh.tets), 1))  # neither softer parts nor several regions
parts = (mesh, fill, painted, region, pinned, bone_weights(mesh.nodes))
body = dynamorph.SoftBody(*parts)

# Two targets: what the muscle is like when the arm is straight, and when it is bent.
bulge = np.zeros_like(vertices)
bulge[:, 2] = 0.02 * np.exp(-(((vertices[:, 0] - 0.15) / 0.06) ** 2)) * (vertices[:, 2] > 0)
embedding = dynamorph.embed(mesh, vertices)
shapes = body.extend_shapes(embedding, np.array([0 * bulge, bulge]))
tissue = {"poisson": 0.4, "density": 1000, "stiffness_damping": 0.005}
relaxed = dynamorph.MorphTarget("relaxed", shapes[0], young=15e3, **tissue)  # Pa
flexed = dynamorph.MorphTarget("flexed", shapes[1], young=60e3, **tissue)
straight, bent = 0, np.radians(100)
space = dynamorph.PoseSpace([dynamorph.TargetSet([1], ["relaxed", "flexed"], [pose(straight)[0], pose(bent)[0]])])

# The reduced model: 20 modes instead of every node.
STABLE, EVEN = dynamorph.MaterialModel.STABLE_STVK, dynamorph.Blending.EVEN
full = dynamorph.FullModel(body, [relaxed, flexed], STABLE, EVEN)
tables = dynamorph.reduce(full, dynamorph.make_basis(full, 20))
model = dynamorph.ReducedModel(body, [relaxed, flexed], tables, EVEN)

# The shot: the arm bends in half a second, and the muscle swings for another second.
bends = np.interp(np.arange(181) / 120, [0, 0.5], [straight, bent])
local, bones = (np.array(poses) for poses in zip(*map(pose, bends), strict=True))
weights = space.weights(local)
simulation = dynamorph.Simulation(model, 1 / 120, gravity=(0, 0, -9.81))
simulation.start(bones[0], bones[1], weights[0])
report = simulation.advance(bones[1:], weights[1:])

# The skin in the world. The tetrahedra carry the bulge but for a residual.
residual_shapes = np.array([0 * bulge, bulge - embedding.interpolate(shapes[1])])
skin = dynamorph.Skin(model, vertices, embedding, bone_weights(vertices), residual_shapes)
points = skin.positions(bones[-1], weights[-1], simulation.coordinates)
print(f"{len(points)} points after {report.steps} steps, converged: {report.converged}")
lines = [f"v {x} {y} {z}\n" for x, y, z in points] + [f"f {i} {j} {k}\n" for i, j, k in triangles + 1]
Path(sys.argv[1]).write_text("".join(lines))

if len(sys.argv) == 3:
    packed = dynamorph.pack_soft_skin(
        *parts,
        targets=[relaxed, flexed],
        tables=tables,
        embedding=embedding,
        bone_names=["upper arm", "forearm"],
        residual_shapes=residual_shapes,
    )
    Path(sys.argv[2]).write_bytes(packed)
