# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings that are keyed or driven, at the sample times of a rig. Never touches bpy."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import compress
from typing import NamedTuple

import numpy as np

from ..character import Character
from .rig_samples import RigSamples, Track


class Setting(NamedTuple):
    """STIFFNESS or TARGET_AMOUNT of the target of this name ('' for the neutral one), the CHANNEL or GRIP of this
    name, or, without a name, AMOUNT, DISTANCE or FRICTION.
    """

    kind: str
    name: str = ""


@dataclass(frozen=True)
class KeyedSettings(Track):
    """settings (K,), those that are keyed or driven, and all channels and grips; values (S, K): as the artist sees
    them.
    """

    SAMPLED = ("values",)
    settings: tuple[Setting, ...]
    values: np.ndarray

    def without(self, *kinds: str) -> KeyedSettings:
        """Those of other kinds."""
        kept = [each.kind not in kinds for each in self.settings]
        return KeyedSettings(tuple(compress(self.settings, kept)), self.values[:, kept])

    def of(self, *setting: str) -> np.ndarray | None:
        """The values (S,) of a `Setting`; None where it is not keyed."""
        if Setting(*setting) not in self.settings:
            return None
        return self.values[:, self.settings.index(Setting(*setting))]

    def stiffness(self, character: Character) -> np.ndarray | None:
        """How many times as stiff as its material each target is: (S, J). None where no stiffness is keyed."""
        if not any(each.kind == "STIFFNESS" for each in self.settings):
            return None
        out = np.ones((len(self.values), len(character.targets)))
        for j, name in enumerate(character.target_names):
            owner = "" if character.settings.method == "SHAPE" else name  # of the material that the target has
            if (keyed := self.of("STIFFNESS", owner)) is not None:
                out[:, j] = keyed / character.material(j).stiffness
        return out

    def amounts(self, character: Character) -> np.ndarray | None:
        """How much motion is shown, (S, 1 + J): of all, and of each target; NaN where that is not keyed. None where
        none is.
        """
        out = np.full((len(self.values), 1 + len(character.targets)), np.nan)
        known = [self.of("AMOUNT"), *(self.of("TARGET_AMOUNT", name) for name in character.target_names)]
        for column, keyed in enumerate(known):
            if keyed is not None:
                out[:, column] = keyed
        return None if np.isnan(out).all() else out


def amounts_of(rig: RigSamples, character: Character) -> np.ndarray | None:
    """`KeyedSettings.amounts` at each of the samples."""
    keyed = rig.track(KeyedSettings)
    return keyed.amounts(character) if keyed else None


def for_engine(rig: RigSamples, character: Character, size: float) -> tuple[np.ndarray | None, ...]:
    """Stiffness (S, J), distance (S,) in meters and self-friction (S,), as a step takes them; None where they are not
    keyed. size: of the body, meters.
    """
    keyed = rig.track(KeyedSettings)
    if keyed is None:
        return None, None, None
    distance = keyed.of("DISTANCE")
    return keyed.stiffness(character), None if distance is None else distance * size, keyed.of("FRICTION")
