# SPDX-License-Identifier: GPL-3.0-or-later
"""Soft bodies that press on each other: their players take their steps together. Never touches bpy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..engine import dynamorph
from ..errors import SceneError
from ..geometry import inverse
from ..settings import SimulationSettings
from .player import Frame, Player
from .rig_samples import RigSamples


def refusal(first: tuple[str, SimulationSettings], other: tuple[str, SimulationSettings]) -> str:
    """Why bodies with such a quality, REDUCED or FULL, and settings cannot take their steps together, or ''."""
    (quality, mine), (its_quality, its) = first, other
    if quality != its_quality:
        return "their Quality differs"
    if mine.speed != its.speed:
        return "their Speed differs"
    if (mine.step, mine.substeps, mine.samples) != (its.step, its.substeps, its.samples):
        return "their Substeps Per Frame differ"
    if mine.integrator != its.integrator:
        return "their Integrator differs"
    return ""


class Coupling:
    """Players of bodies with collision, which have begun; no two have a `refusal`, and none has another one as a
    collider. Where one has friction of skin on skin, all have. garments: (clothes, body) of those that lie on others at
    rest. Raises SceneError for a body that cannot touch anything.
    """

    def __init__(self, players: Sequence[Player], garments: Sequence[tuple[Player, Player]] = ()):
        self.players = players
        bodies = []
        for player in players:
            assert player.collision is not None
            if player.collision.own is None:
                raise SceneError(
                    "'{name}' touches nothing: take a part of it out of Exclude", name=player.character.name
                )
            player.collision.others = tuple(each.character.name for each in players)
            bodies.append((player.simulation, player.collision.own))
        worn = [(players.index(one), players.index(body), _to_body(one, body)) for one, body in garments]
        self._engine = dynamorph.Coupling(bodies, max(player.settings.self_friction for player in players), worn)

    def play(self, rigs: Sequence[RigSamples], numbers: Sequence[int] | np.ndarray) -> Iterator[list[Frame]]:
        """As `Player.play`, a frame of each player at a time."""
        for steps in zip(*map(Player.steps, self.players, rigs, [numbers] * len(rigs)), strict=True):
            reports = self._engine.advance([each.motion for each in steps])
            yield [player.taken(*each) for player, *each in zip(self.players, steps, reports, strict=True)]


def _to_body(clothes: Player, body: Player) -> np.ndarray:
    """The bind space of the first to that of the other (3, 4), by the armature that both have."""
    assert clothes.first and body.first
    to_rig = clothes.first.rig_from_bind(clothes.model.to_bind)[0]
    of_body = body.first.rig_from_bind(body.model.to_bind)[0]
    return (inverse(of_body) @ to_rig)[:3]
