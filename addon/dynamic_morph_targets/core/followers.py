# SPDX-License-Identifier: GPL-3.0-or-later
"""What the soft tissue carries along: other meshes, moved by the body's modes. Never touches bpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .baked import Bake
from .character import Follower
from .engine import dynamorph
from .geometry import connected_parts, interpolated
from .model import Model
from .simulate import part_of


def follow(model: Model, bake: Bake, follower: Follower) -> Bake:
    """The same shot for a follower, in the follower's own local space."""
    if follower.members:
        return part_of(bake, follower.members, follower.from_body)
    assert bake.node_modes is not None  # it becomes keys, which have none, only afterward
    modes, residual_shapes = carried(model, bake.node_modes, follower)
    return replace(bake, modes=modes, residual_shapes=residual_shapes)


def carried(model: Model, modes: np.ndarray, follower: Follower) -> tuple[np.ndarray, np.ndarray]:
    """How modes (r, n, 3) of the nodes, bind space, and the model's residual shapes displace a follower of P vertices.

    Returns (r, P, 3) and (J, P, 3) in its local space. Outside the cage, the nearest tetrahedron is extrapolated within
    bounds; the residual shapes are those of the nearest skin.
    """
    residual_shapes = residual_shapes_of(model, follower)
    if not len(model.tets):
        return np.zeros((0, *follower.vertices.shape)), residual_shapes
    nodes, weights = embedded(model, follower)
    bind = interpolated(modes, nodes, weights)
    return bind @ np.linalg.inv(model.to_bind).T @ follower.from_body.T, residual_shapes


def residual_shapes_of(model: Model, follower: Follower) -> np.ndarray:
    """The model's residual shapes (J, P, 3) on a follower of P vertices, in its local space."""
    if follower.members:
        return model.residual_shapes[:, follower.members] @ follower.from_body.T
    assert follower.skin is not None  # it has no `members`
    shapes = np.moveaxis(follower.skin.carry(np.moveaxis(model.residual_shapes, 0, 1)), 1, 0)
    return shapes @ follower.from_body.T


def embedded(model: Model, follower: Follower) -> tuple[np.ndarray, np.ndarray]:
    """The nodes (P, 4) that carry the P vertices of a follower, and their weights (P, 4)."""
    if follower.members:
        return model.embedding_nodes[follower.members], model.embedding_weights[follower.members]
    assert follower.skin is not None  # it has no `members`
    part = connected_parts(model.tets, len(model.nodes))  # attachments may have a cage of their own in the same place
    under = part[model.embedding_nodes[np.unique(follower.skin.corners), 0]]
    used, tets = np.unique(model.tets[np.isin(part[model.tets[:, 0]], under)], return_inverse=True)
    embedding = dynamorph.embed(dynamorph.TetMesh(model.nodes[used], tets.reshape(-1, 4)), follower.vertices)
    return used[embedding.nodes], embedding.weights
