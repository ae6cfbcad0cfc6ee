# SPDX-License-Identifier: GPL-3.0-or-later
"""The kept model file, model.dynamorph, in the current version of the format: `make golden` writes it.

tests/engine/test_model_file.py opens it, so that no change of the format goes unnoticed. Its character is a bar that
bends by two bones and bulges, small, but with something in every array that a model can have.
"""

from __future__ import annotations

from pathlib import Path

import dynamorph
import numpy as np
import scenes
from dynamic_morph_targets.core.character import Character, Skeleton, Target, TargetSet
from dynamic_morph_targets.core.model.build import build
from dynamic_morph_targets.core.model.model import Model
from dynamic_morph_targets.core.settings import Material, ModelSettings
from dynamic_morph_targets.io import model_file

KEPT = Path(__file__).with_name("model.dynamorph")
LENGTH, JOINT = 0.8, 0.4  # meters


def bar() -> Character:
    vertices, faces = scenes.tube(rings=17, around=12, radius=0.08, length=LENGTH)
    every = np.ones(len(vertices))
    rest = np.tile(np.eye(4), (2, 1, 1))
    rest[1, 2, 3] = JOINT
    shapes = {"Neutral": 0 * vertices, "Bulge": scenes.bulge(vertices, center=0.6, width=0.1, amount=0.02).round(6)}
    targets = tuple(
        Target(name, shape, ("lower", "upper") if shape.any() else (), rest, np.eye(4), Material())
        for name, shape in shapes.items()
    )
    return Character(
        name="Bar",
        vertices=vertices,
        triangles=np.array([[f[0], f[k], f[k + 1]] for f in faces for k in range(1, len(f) - 1)], np.int32),
        to_bind=np.eye(3),
        weights=np.column_stack([scenes.two_bone_weights(vertices, JOINT, 0.1), 0 * every]),
        firmness=0.5 + 0.4 * vertices[:, 2] / LENGTH,
        bone_segments=np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, JOINT]], [[0.0, 0.0, JOINT], [0.0, 0.0, LENGTH]]]),
        skeleton=Skeleton(("lower", "upper"), np.array([-1, 0]), rest),
        authored_sets=(TargetSet("Bar", targets, every),),
        settings=ModelSettings(modes=16, cage_nodes=120),
    )


def settled(model: Model) -> np.ndarray:
    """Where the skin (V, 3) of `bar` hangs under its own weight along x, at half of its bulge."""
    character = bar()
    engine = model.engine(character)
    simulation = dynamorph.Simulation(engine, 1.0, tolerance=1e-10, max_iterations=100)
    gravity = np.zeros_like(character.vertices)
    gravity[:, 0] = 0.1  # N at each vertex
    coordinates, report = simulation.solve_static(np.tile(np.eye(3, 4), (3, 1, 1)), [0.5, 0.5], model.on_nodes(gravity))
    if not report.converged:
        raise RuntimeError("the bar does not settle")
    return model.surface(engine.displacement(coordinates))


if __name__ == "__main__":
    KEPT.write_bytes(model_file.pack(*build(bar()).to_arrays()))
    print(f"kept: {KEPT.name}, {KEPT.stat().st_size} bytes")
