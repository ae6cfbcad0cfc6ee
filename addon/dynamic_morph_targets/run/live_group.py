# SPDX-License-Identifier: GPL-3.0-or-later
"""Bodies in Live that press on each other: their sessions take their steps together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from ..core.motion.coupling import Coupling
from ..core.motion.grab import Grab
from ..core.motion.player import Frame
from ..core.motion.rig_samples import RigSamples
from .tissue import Tissue


class Member(Protocol):
    """What a group asks of a `session.Session`."""

    tissue: Tissue
    rig: Any
    grabs: tuple[Grab, ...]

    @property
    def last_simulated(self) -> int | None: ...
    def fits_colliders(self, samples: RigSamples) -> bool: ...
    def keep(self, number: int, frame: Frame) -> None: ...
    def rewind_alone(self) -> None: ...
    def join(self, group: LiveGroup) -> None: ...


class LiveGroup:
    """Sessions: one alone, or those whose bodies press on each other. names: of their objects, ascending."""

    def __init__(self, sessions: Sequence[Member], names: Sequence[str]):
        self.sessions, self.names = sessions, tuple(names)
        self._coupling: Coupling | None = None  # of the players that took the last step together

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
                player.hand.pull(session.grabs)
        if len(players) == 1:
            sessions[0].keep(last + 1, players[0].advance(rigs[0], last + 1))
            return
        if self._coupling is None or self._coupling.players != players:
            self._coupling = Coupling(players)
        for frames in self._coupling.play(rigs, [last + 1]):
            for session, frame in zip(sessions, frames, strict=True):
                session.keep(last + 1, frame)
