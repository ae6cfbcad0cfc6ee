# SPDX-License-Identifier: GPL-3.0-or-later
"""The stiffness that gives the natural frequency that the artist requests. Never touches bpy.

A target's frequency is the one that the whole body would have if it were of the target's material. Of one body,

    w0 = 2 pi r sqrt(E / rho)

with one reference r of its shape and of how it is held, so that the neutral target's measurement serves all targets.
"""

from __future__ import annotations

from dataclasses import replace
from math import pi, sqrt

import numpy as np

from ..character import Character, Target
from ..geometry import determinant
from ..model.model import Model
from ..settings import Material
from .fit import checked_patch, full_engine, natural_frequency, target_indices


def reference(model: Model, character: Character) -> float:
    """The undamped frequency of the neutral body in Hz per square root of stiffness (Pa) over density (kg/m^3), in the
    precision in which Blender stores it. Zero without tissue, or if its modes cannot be found.

    Measured with Poisson's ratio alone of each target's material, and without the Firmness map: what it makes softer or
    firmer leaves the rest as it was.
    """
    if not len(model.tets):
        return 0.0

    def standard(_index: int, target: Target) -> Target:
        return replace(target, material=Material(poisson=target.material.poisson))

    model, character = model.unpainted, character.with_targets(standard)
    try:
        omega = natural_frequency(model, full_engine(model, character), 0, checked_patch(model, character, 0, None))
    except RuntimeError:  # raised by the engine
        return 0.0
    return as_stored(omega / (2 * pi) / sqrt(Material.stiffness / Material.density))


def volumes(model: Model, character: Character) -> list[float]:
    """The volume in m^3 of each target's tissue (J,), without the Firmness map."""
    if not len(model.tets):
        return [0.0] * len(character.targets)
    corners = model.nodes[model.tets]
    of_tets = model.fill * determinant(corners[:, 1:] - corners[:, :1]) / 6.0
    found = []
    for s, indices in enumerate(target_indices(character.target_sets)):
        region = float((of_tets * model.region_weights[:, s]).sum())
        found += [float(of_tets.sum()), *[region] * (len(indices) - 1)]
    return found


def calibrated(character: Character, reference: float) -> Character:
    """The character with the stiffness that its targets' frequencies require; reference: of its model, as above."""

    def with_stiffness(_index: int, target: Target) -> Target:
        if not (target.frequency and reference):
            return target
        stiffness = stiffness_for(reference, target.material.density, target.frequency)
        return replace(target, material=replace(target.material, stiffness=stiffness))

    return character.with_targets(with_stiffness)


def stiffness_for(reference: float, density: float, frequency: float) -> float:
    """Young's modulus in Pa, as Blender stores it, with which a body of this reference would swing at `frequency` Hz
    without damping; density in kg/m^3.
    """
    return as_stored(density * (frequency / reference) ** 2)


def as_stored(value: float) -> float:
    """A number in single precision, as Blender stores it: what is simulated is what a file contains."""
    return float(np.float32(value))
