# SPDX-License-Identifier: GPL-3.0-or-later
"""Character -> tetrahedra around its skin, and what they inherit from it. Never touches bpy."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass

import dynamorph
import numpy as np

from .scene_data import Character

Progress = Callable[[float, str], bool]

GRID = 2.0**-13  # body sizes: finer, the last digits of coordinates, which a scale changes, would change the mesh
HELD = 0.05  # nodes softer than this in the Soft group are free


@dataclass(frozen=True)
class Volume:
    """The flesh before the targets: n nodes, m tets, S target sets, B bones. Bind space, metres.

    embedding: of the V surface vertices; fill (m,) filled fraction; stiffness (m,) painted factor; shares (m, S);
    pinned (n,) bool; node_weights (n, B + 1); summary: what is to be told of it.
    """

    mesh: dynamorph.TetMesh
    embedding: dynamorph.Embedding
    fill: np.ndarray
    stiffness: np.ndarray
    shares: np.ndarray
    pinned: np.ndarray
    node_weights: np.ndarray
    summary: dict


def volume(character: Character, mesh: dynamorph.TetMesh | None, stages: Stages) -> Volume:
    """The tetrahedra of a character; mesh: those of an earlier build that serve again.

    Raises dynamorph.Error with advice when the skin cannot be filled or nothing holds it.
    """
    surface = character.vertices @ character.to_bind.T
    with stages("Meshing", 0.30) as report:
        if mesh is None:
            mesh = _tetrahedra(character, surface, report)
    with stages("Embedding", 0.05) as report:
        embedding = dynamorph.embed(mesh, surface)
        fill = dynamorph.fill_fractions(mesh, surface, character.triangles, progress=report)
        stiffness, weights, softness, shares = _inherited(character, mesh, embedding)
        pinned = _pinned(character, mesh, surface) | (softness < HELD)
    if not pinned.any():
        raise dynamorph.Error(f"'{character.name}': no part of the cage is held by a bone: raise Bone Pinning")
    summary = {"nodes": len(mesh.nodes), "tets": len(mesh.tets), "pinned": int(pinned.sum())}
    return Volume(mesh, embedding, fill, stiffness, shares, pinned, weights, summary)


def _tetrahedra(character: Character, surface: np.ndarray, report) -> dynamorph.TetMesh:
    settings = character.settings
    grid = GRID * 2.0 ** np.floor(np.log2(np.linalg.norm(np.ptp(surface, axis=0))))
    _, _, mesh = dynamorph.mesh_body(
        np.round(surface / grid) * grid,
        character.triangles,
        settings.cage_nodes,
        bones=np.round(character.bone_segments / grid) * grid,
        held=settings.pin_radius,
        progress=report,
    )
    return mesh


def _inherited(character: Character, mesh: dynamorph.TetMesh, embedding: dynamorph.Embedding) -> tuple:
    """What the skin passes on: stiffness (m,) and shares (m, S) of the tets, weights (n, B + 1) and softness (n,)."""
    # Stiffness is interpolated as a ratio: exactly one where nothing is painted, and no further than painted.
    painted = np.log(character.stiffness)
    shares = [target_set.share for target_set in character.target_sets]
    values = np.column_stack([painted, character.weights, character.softness, *shares])
    at_nodes = dynamorph.extend_to_nodes(mesh, embedding, values)
    stiffness = np.exp(at_nodes[:, 0].clip(painted.min(), painted.max()))[mesh.tets].mean(axis=1)
    weights, softness, shares = np.split(at_nodes[:, 1:].clip(0.0), np.cumsum([character.weights.shape[1], 1]), axis=1)
    shares = shares[mesh.tets].mean(axis=1)
    weights /= weights.sum(axis=1, keepdims=True)
    return stiffness, weights, softness[:, 0], shares / shares.sum(axis=1, keepdims=True)


def _pinned(character: Character, mesh: dynamorph.TetMesh, surface: np.ndarray) -> np.ndarray:
    """The nodes (n,) that the bones hold."""
    heads, tails = character.bone_segments[:, 0], character.bone_segments[:, 1]
    return dynamorph.pinned(mesh, surface, character.triangles, heads, tails, character.settings.pin_radius)


class Stages:
    """Times the stages of a build and maps each one's own 0..1 to a part of the whole, which their shares sum to."""

    def __init__(self, progress: Progress | None, whole: float = 1.0):
        self.progress = progress
        self.whole = whole
        self.done = 0.0
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, message: str, share: float):
        began, start = time.perf_counter(), self.done

        def report(fraction: float) -> bool:
            done = (start + share * fraction) / self.whole
            going_on = self.progress is None or self.progress(done, message)
            if not going_on:
                raise dynamorph.Cancelled("cancelled")
            return True

        report(0.0)
        yield report
        self.seconds[message.lower()] = time.perf_counter() - began
        self.done += share
