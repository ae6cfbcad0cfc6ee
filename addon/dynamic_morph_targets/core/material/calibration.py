# SPDX-License-Identifier: GPL-3.0-or-later
"""The stiffness that gives the natural frequency that the artist requests. Never touches bpy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import pi, sqrt

import numpy as np

from ..character import Character, Target
from ..geometry import determinant
from ..model.model import Model
from .fit import checked_patch, full_engine, natural_frequency, target_indices
from .oscillation import stiffness_for


def references(model: Model, character: Character) -> Iterator[tuple[float, float]]:
    """For each target: its undamped bounce in Hz per square root of stiffness over density, and the volume of its
    tissue in m^3. Without the Firmness map: what it makes softer or firmer leaves the rest as it was.

    For another stiffness or density it follows from `swing`, exactly where no other target shares the tissue. Zeros for
    a target without tissue of its own, or whose modes cannot be found.
    """
    if not len(model.tets):
        yield from [(0.0, 0.0)] * len(character.targets)
        return
    model = model.unpainted
    engine = full_engine(model, character)
    corners = model.nodes[model.tets]
    volumes = model.fill * determinant(corners[:, 1:] - corners[:, :1]) / 6.0
    neutral_only = character.settings.method == "SHAPE"
    for s, indices in enumerate(target_indices(character.target_sets)):
        for target in indices:
            neutral = target == indices[0]
            if neutral_only and not neutral:
                yield 0.0, 0.0
                continue
            try:
                omega = natural_frequency(model, engine, target, checked_patch(model, character, target, None))
            except RuntimeError:  # raised by the engine for a sculpt whose modes cannot be found
                omega = 0.0
            material = character.material(target)
            weights = 1.0 if neutral else model.region_weights[:, s]
            yield omega / (2 * pi) / sqrt(material.stiffness / material.density), float((volumes * weights).sum())


def calibrated(character: Character, found: list[tuple[float, float]]) -> Character:
    """The character with the stiffness that its targets' frequencies require; found: its `references`. Targets that the
    artist has not set by hand keep their ratio to the neutral one.
    """
    neutral = character.authored_targets[0]
    before, after = neutral.material.stiffness, _stiffness_of(neutral, found[0][0])
    neutrals = {indices[0] for indices in target_indices(character.authored_sets)}

    def with_stiffness(index: int, target: Target) -> Target:
        stiffness = target.material.stiffness
        if index in neutrals:
            stiffness = after
        elif target.by_hand and index < len(found):  # of the method Single, only the neutral one's
            stiffness = _stiffness_of(target, found[index][0])
        elif target.frequency:
            stiffness *= after / before
        return replace(target, material=replace(target.material, stiffness=as_stored(stiffness)))

    return character.with_targets(with_stiffness)


def as_stored(value: float) -> float:
    """A number in single precision, as Blender stores it: what is simulated is what a file contains."""
    return float(np.float32(value))


def stored(target: Target) -> dict[str, float]:
    """The properties of a target that a build may change, by name."""
    material = target.material
    return {
        "stiffness": material.stiffness,
        "mass_damping": material.mass_damping,
        "stiffness_damping": material.stiffness_damping,
        "frequency": target.frequency,
    }


def _stiffness_of(target: Target, reference: float) -> float:
    if not (target.frequency and reference):
        return target.material.stiffness
    return stiffness_for(reference, target.material, target.frequency)
