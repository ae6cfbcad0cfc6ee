# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of a motion is shown: all of it, mode by mode, and region by region. Never touches bpy."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..character import Character
from ..model.model import Model
from ..settings import SimulationSettings


class Amounts:
    """Scales the motion about the targets' shapes when it is shown. The simulation does not depend on it.

    amount: of all motion; gains (dofs,) of the modes; motion_amounts (J,) of the targets. shapes (J, dofs): the
    targets' shapes in coordinates, of width zero for static morph targets. modes (3 free, dofs): displacement of the
    free nodes by each coordinate of a reduced model.
    """

    def __init__(
        self, model: Model, character: Character, shapes: np.ndarray, modes: np.ndarray, settings: SimulationSettings
    ):
        self._model, self._modes = model, modes
        self._sizes = [len(target_set.targets) for target_set in character.target_sets]
        self._shapes = shapes
        self.follow(settings, np.array([target.motion_amount for target in character.targets]))

    def follow(self, settings: SimulationSettings, motion_amounts: np.ndarray) -> None:
        """Show the motion by these settings and amounts from now on."""
        self.amount, self.motion_amounts = settings.amount, motion_amounts
        self.gains = np.ones(self._shapes.shape[1])
        if self._model.settings.solver == "REDUCED":
            known = min(len(settings.gains), len(self.gains))
            self.gains[:known] = settings.gains[:known]

    def shown(self, coordinates: np.ndarray, weights: np.ndarray, keyed: np.ndarray | None = None) -> np.ndarray:
        """Coordinates (..., dofs) at the targets' weights (..., J), with the amount, the gains and the motion amounts.
        keyed (..., 1 + J): as of `KeyedSettings.amounts`.

        In the region of a set the motion has the mean amount of its targets, by their weights, which sum to one.
        """
        amounts = np.append(self.amount, self.motion_amounts)
        if keyed is not None:
            amounts = np.where(np.isnan(keyed), amounts, keyed)
        amount, motion_amounts = amounts[..., :1], amounts[..., 1:]
        coordinates = self.with_gains(coordinates, weights, amount)
        if not len(self.gains) or (motion_amounts == 1.0).all():
            return coordinates
        still = weights @ self._shapes
        begins = np.cumsum([0, *self._sizes[:-1]])
        means = np.add.reduceat(weights * motion_amounts, begins, axis=-1)
        parts = self._in_regions(coordinates - still)
        return still + sum(mean[..., None] * part for mean, part in zip(np.moveaxis(means, -1, 0), parts, strict=True))

    def with_gains(
        self, coordinates: np.ndarray, weights: np.ndarray, amount: np.ndarray | float | None = None
    ) -> np.ndarray:
        """Like `shown`, but without the motion amounts of the targets. amount (..., 1): instead of that of all."""
        amount = self.amount if amount is None else amount
        return coordinates + (amount * self.gains - 1.0) * (coordinates - weights @ self._shapes)

    def _in_regions(self, motion: np.ndarray) -> list[np.ndarray]:
        """Each set's part of a motion (..., dofs); they sum to it."""
        if len(self._sizes) == 1:
            return [motion]
        if self._model.settings.solver == "FULL":
            return [motion * weights for weights in self._region_weights]
        return [motion @ part for part in self._region_parts]

    @cached_property
    def _region_weights(self) -> np.ndarray:
        """The weight of each free node in each set, repeated for each axis: (S, 3 free)."""
        model = self._model
        corners, around = model.tets.ravel(), np.repeat(model.region_weights, 4, axis=0)
        total = np.array([np.bincount(corners, weights, len(model.nodes)) for weights in around.T])
        return np.repeat((total / total.sum(axis=0).clip(1e-300))[:, model.free], 3, axis=1)

    @cached_property
    def _region_parts(self) -> list[np.ndarray]:
        """For each set the (r, r) matrix that projects a motion onto the part of it that lies in its region, by least
        squares.
        """
        back = np.linalg.pinv(self._modes)
        return [(back @ (weights[:, None] * self._modes)).T for weights in self._region_weights]
