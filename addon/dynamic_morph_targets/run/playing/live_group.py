# SPDX-License-Identifier: GPL-3.0-or-later
"""Bodies in Live that press on each other: their sessions take their steps together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from ...core.motion.coupling import Coupling
from ...core.motion.grab import Grab
from ...core.motion.player import Frame, Player
from ...core.motion.rig_samples import RigSamples
from .tissue import Tissue


class Member(Protocol):
    """What a group asks of a `session.Session`."""

    tissue: Tissue
    rig: Any
    grabs: dict[int, Grab]

    @property
    def last_simulated(self) -> int | None: ...
    def fits_colliders(self, samples: RigSamples) -> bool: ...
    def keep(self, number: int, frame: Frame) -> None: ...
    def rewind_alone(self) -> None: ...
    def join(self, group: LiveGroup) -> None: ...


class LiveGroup:
    """Sessions: one alone, or those whose bodies press on each other. names: of their objects, ascending. garments:
    (clothes, body), names of those that lie on others.
    """

    def __init__(self, sessions: Sequence[Member], names: Sequence[str], garments: Sequence[tuple[str, str]] = ()):
        self.sessions, self.names, self.garments = sessions, tuple(names), tuple(garments)
        self._coupling: Coupling | None = None  # of the players that took the last step together

    def is_as(self, other: LiveGroup) -> bool:
        """Whether both have the same members."""
        mine, its = ((each.sessions, each.names, each.garments) for each in (self, other))
        return mine == its

    def advance(self, last: int) -> None:
        """One frame on, with those whose last simulated frame this is and whose colliders are still the same."""
        sessions, rigs = [], []
        for session in self.sessions:
            if session.last_simulated == last:
                rig = session.rig.after(session.tissue.skin.object.find(), last)[1:]
                if session.fits_colliders(rig):
                    sessions.append(session)
                    rigs.append(rig)
        players = [session.tissue.player for session in sessions]
        for session, player in zip(sessions, players, strict=True):
            if player.hand:
                player.hand.pull([*session.grabs.values()])
        if len(players) == 1:
            sessions[0].keep(last + 1, players[0].advance(rigs[0], last + 1))
            return
        if self._coupling is None or self._coupling.players != players:
            self._coupling = Coupling(players, self._worn(sessions))
        for frames in self._coupling.play(rigs, [last + 1]):
            for session, frame in zip(sessions, frames, strict=True):
                session.keep(last + 1, frame)

    def _worn(self, sessions: Sequence[Member]) -> list[tuple[Player, Player]]:
        """The players of clothes and bodies among these sessions."""
        by_name = dict(zip(self.names, self.sessions, strict=True))
        pairs = [[by_name[name] for name in names] for names in self.garments]
        return [(on.tissue.player, of.tissue.player) for on, of in pairs if on in sessions and of in sessions]
