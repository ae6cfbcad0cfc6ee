# SPDX-License-Identifier: GPL-3.0-or-later
"""Which nodes of a cage are pinned to bones, where these hold it. Never touches bpy."""

from __future__ import annotations

import numpy as np

from ..character import Character
from ..engine import dynamorph
from ..geometry import connected_parts, diagonal

PINNED = 0.95  # nodes that are rigid, or painted to be held, by more than this are pinned
ON_A_LINE = 1e-6  # of the cage's size; pins across which a body is no wider are on a line


def pinned(character: Character, mesh: dynamorph.TetMesh, surface: np.ndarray) -> np.ndarray:
    """The nodes (n,) that the bones pin."""
    heads, tails = character.bone_segments[:, 0], character.bone_segments[:, 1]
    return dynamorph.pinned(mesh, surface, character.triangles, heads, tails, character.settings.pin_radius)


def all_pinned(
    character: Character,
    mesh: dynamorph.TetMesh,
    embedding: dynamorph.Embedding,
    weights: np.ndarray,
    by_bones: np.ndarray,
    firm: np.ndarray,
) -> tuple[np.ndarray, list[str]]:
    """All pinned nodes (n,), and a warning for each loose part of the mesh, which is pinned as a whole.

    weights (n, B + 1): of the bones at the nodes; by_bones (n,): which the bones pin; firm (n,): how rigid the nodes
    are, or painted to be held. Raises dynamorph.Error with advice when nothing holds the cage.
    """
    found = by_bones | (firm > PINNED)
    adrift = _adrift(mesh, found)
    if sum(map(len, adrift)) == len(mesh.nodes):
        raise dynamorph.Error(
            f"'{character.name}': {_cause(character, weights[found])}: raise Bone Pinning, set Hold to Thickness, or "
            "paint Firmness with 1 where it is attached"
        )
    warnings = [_adrift_warning(character, embedding, nodes, found) for nodes in adrift]
    for nodes in adrift:
        found[nodes] = True
    return found, warnings


def _adrift(mesh: dynamorph.TetMesh, pinned: np.ndarray) -> list[np.ndarray]:
    """The nodes of each part of the mesh that could move or turn without resistance, because its pins are at a point or
    on a line, or there are none.
    """
    part = connected_parts(mesh.tets, len(mesh.nodes))
    near = ON_A_LINE * diagonal(mesh.nodes)
    return [
        np.flatnonzero(part == root) for root in np.unique(part) if _width(mesh.nodes[pinned & (part == root)]) <= near
    ]


def _width(points: np.ndarray) -> float:
    """Of points (k, 3) across the line that fits them best; 0 for fewer than three."""
    return float(np.linalg.svd(points - points.mean(axis=0))[1][1]) if len(points) > 2 else 0.0


def _cause(character: Character, pins: np.ndarray) -> str:
    """Why the whole cage could move. pins (k, B + 1): weights of the pinned nodes."""
    if not len(pins):
        return "no part of the cage is pinned to a bone"
    bone = [*character.skeleton.names, "the object"][pins.sum(axis=0).argmax()]
    return f"the cage is pinned to '{bone}' only along a line, about which it could turn"


def _adrift_warning(character: Character, embedding: dynamorph.Embedding, nodes: np.ndarray, pinned: np.ndarray) -> str:
    on_it = np.isin(embedding.nodes[:, 0], nodes) & embedding.weights.any(axis=1)
    bone = [*character.skeleton.names, "the object"][character.weights[on_it].sum(axis=0).argmax()]
    how = "is pinned only along a line" if pinned[nodes].any() else "is pinned to no bone"
    return (
        f"A part of {int(on_it.sum())} vertices at '{bone}' {how}, so it moves rigidly with its bones: paint the "
        "Firmness with 1 where it is attached"
    )
