# SPDX-License-Identifier: GPL-3.0-or-later
"""The shape that a body has in a pose, found by physics (`dynamorph.shape_by_physics`). Never touches bpy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..character import Character
from ..engine import dynamorph
from ..errors import SceneError
from ..geometry import diagonal, inverse
from ..model.build import build_cage
from ..model.hold import BodyThickness
from ..model.model import Model
from .rig_samples import RigSamples

CAGE = 0.3  # of the time, where it has to be built
DEEP = 0.003  # body sizes: skin that is less deep in itself does not show


@dataclass(frozen=True)
class PosedShape:
    """shape (V, 3): displacement of the object's own vertices, local space. overlap: how deep the skin is in itself,
    meters, or 0 where that does not show; overlaps: the bone of the vertex that is deepest. plain: a bone at which
    plain skinning stays, because it cannot be inverted; '' if there is none.
    """

    shape: np.ndarray
    overlap: float
    overlaps: str
    plain: str


def shape_in_pose(
    character: Character,
    path: np.ndarray,
    worlds: tuple[np.ndarray, np.ndarray],
    previous: Model | None,
    report: Callable[[float], object],
) -> PosedShape:
    """path (S, B, 4, 4): local transforms of the bones, from near rest to the pose. worlds: of armature and object
    (4, 4). previous: a model whose cage is used again if it fits. report: called with 0..1. Raises SceneError, and what
    the engine raises.
    """
    if character.probed:
        raise SceneError(
            "'{name}': Shape by Physics needs bones alone to pose the skin: turn off Preserve Volume and bendy bones, "
            "keep one Armature modifier, or sculpt the shape by hand",
            name=character.name,
        )

    def building(fraction: float, _message: str) -> bool:
        report(CAGE * fraction)
        return True

    def shaping(fraction: float) -> bool:
        report(CAGE + (1.0 - CAGE) * fraction)
        return True

    model = build_cage(character, building, previous)
    rig_world, object_world = (np.repeat(world[None], len(path), 0) for world in worlds)
    rig = RigSamples(model.skeleton.pose(path), rig_world, object_world)
    # As seen from bind space, where lengths are meters however armature and object are scaled.
    to_bind = inverse(rig.object_from_bind(model.to_bind))[:, None]
    frames = to_bind[..., :3, :3] @ rig.skin_matrices(model.skeleton, model.to_bind)
    frames[..., 3] += to_bind[..., :3, 3]
    # The body's own mesh alone: clothes and eyes are in it at rest, or it in them.
    own = character.own_vertices
    points, triangles = character.bind_points, character.triangles
    thickness = model.thickness if model.thickness.size else BodyThickness.of(points, triangles).at_skin
    points, triangles = points[own], triangles[(triangles < own.stop).all(axis=1)]
    found = dynamorph.shape_by_physics(
        dynamorph.TetMesh(model.nodes, model.tets), model.fill, model.node_weights, points,
        dynamorph.Embedding(model.embedding_nodes[own], model.embedding_weights[own]),
        character.weights[own].clip(0.0), triangles, thickness[own], list(frames), shaping,
    )  # fmt: skip
    deep = found.overlap > DEEP * diagonal(points)
    return PosedShape(
        found.skin @ np.linalg.inv(model.to_bind).T,
        found.overlap if deep else 0.0,
        _bone(character, found.overlaps) if deep else "",
        _bone(character, int(np.argmax(found.plain))) if found.plain.any() else "",
    )


def _bone(character: Character, vertex: int) -> str:
    """The bone that moves a vertex most; of one that none moves, the object."""
    return (*character.skeleton.names, character.name)[int(np.argmax(character.weights[vertex]))]
