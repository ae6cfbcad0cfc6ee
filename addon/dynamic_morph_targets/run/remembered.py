# SPDX-License-Identifier: GPL-3.0-or-later
"""What is remembered of the work that is computed, and of what moves on the screen. Objects by Object.session_uid.

Never touches bpy, and imports none of the modules whose objects it holds: they import it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from ..core import states


@dataclass
class Work:
    """running: whose progress the panels draw. spare: a process that waits for work, at most one. leaving: processes
    that have done theirs. errors: those of
    models that were measured, by what they depend on; measuring: what is measured one after the other by `steps`, the
    first now, in `child`. seconds: of a step in the last bake in Full Quality.
    """

    running: Any = None
    spare: list[Any] = field(default_factory=list)
    leaving: list[Any] = field(default_factory=list)
    errors: dict[str, float] = field(default_factory=dict)
    measuring: list[Any] = field(default_factory=list)
    child: Any = None
    steps: Iterator[None] = ()  # type: ignore[assignment]
    seconds: dict[int, float] = field(default_factory=dict)


@dataclass
class Live:
    """sessions: of those that play. problems: why one does not, and what was stated then. suspended: left alone,
    because a preview shows something else with their live key. hidden: their live key is hidden while the file is
    saved. frozen: they stood still in the last render. any_live: whether one is live; None: not known yet. asleep:
    whether nobody has looked yet for what is live. ahead: meshes that show points which their key has not yet.

    preview, hands: those that run. colliders: the engine's, of what touches, with the shape and faces that it was made
    of. poses: of armatures over the frames; reading: one that is read for the graph; bars_drawn: since the last change
    of frame.
    """

    sessions: dict[int, Any] = field(default_factory=dict)
    problems: dict[int, tuple[str, tuple[str, ...]]] = field(default_factory=dict)
    suspended: set[int] = field(default_factory=set)
    hidden: list[int] = field(default_factory=list)
    frozen: set[int] = field(default_factory=set)
    any_live: bool | None = None
    asleep: bool = True
    ahead: dict[int, Any] = field(default_factory=dict)
    preview: Any = None
    hands: Any = None
    colliders: dict[int, tuple] = field(default_factory=dict)
    poses: dict[int, Any] = field(default_factory=dict)
    reading: Any = None
    bars_drawn: bool = False


work = states.of(Work)
live = states.of(Live)
