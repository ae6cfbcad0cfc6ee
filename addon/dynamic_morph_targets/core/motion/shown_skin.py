# SPDX-License-Identifier: GPL-3.0-or-later
"""The skin as bakes and Live show it. Never touches bpy."""

from __future__ import annotations

import numpy as np

from .. import max_distance
from ..character import Character
from ..model.model import Model


class ShownSkin:
    """Where the points of the skin are, by the cage's nodes and the targets' weights: as in `model`, with less of the
    motion where the Max Distance map is low, and with all of the targets' shapes.

    weights (V, 4): by which the cage's nodes carry each point. residual_shapes (J, V, 3): what they do not carry of the
    targets' shapes, local space.
    """

    def __init__(self, model: Model, character: Character):
        self._model = model
        self.weights, self.residual_shapes = model.embedding_weights, model.residual_shapes
        shown = max_distance.shown(character.max_distance)
        less = shown < 1.0
        if not len(model.tets) or not less.any():
            return
        # The shapes' coordinates move the nodes too, so what is taken away there returns here. Where nothing of the
        # motion shows, that is the sculpt itself, to the last bit.
        self.weights = shown[:, None] * self.weights
        shapes = np.array([target.shape for target in character.targets])
        left = shapes - self.surface(model.displacements)
        self.residual_shapes = np.where(less[:, None], left, self.residual_shapes)

    def surface(self, displacement: np.ndarray) -> np.ndarray:
        """Displacement of the skin (..., V, 3), local space, without the residual shapes, from that of the nodes
        (..., n, 3), bind space.
        """
        return self._model.surface(displacement, self.weights)
