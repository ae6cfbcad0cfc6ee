# SPDX-License-Identifier: GPL-3.0-or-later
"""How long a work still takes, estimated from how its fraction has grown so far. Never touches bpy.

The rate is that of the recent past, the last quarter of the time but at least `RECENT` seconds, because the parts of a
job are not equally fast. What is shown counts down with the clock and drifts toward the estimate, so that it never
jumps.
"""

from __future__ import annotations

from collections import deque

FIRST = 1.0  # seconds of work before there is an estimate
LEAST = 0.03  # the part of the work that must be done before
RECENT = 3.0  # seconds
SLOWEST = 2.0  # times slower than on the average of all the time
DRIFT = 3.0  # seconds in which the shown time makes up for most of its error, fewer near the end
PAUSE = 0.05  # seconds between two points of the history


class TimeLeft:
    """seconds: the time left, or None while nothing can be said. It is given the fraction now and then."""

    def __init__(self) -> None:
        self.seconds: float | None = None
        self._history: deque[tuple[float, float]] = deque()  # (seconds, fraction), the recent ones
        self._began = (0.0, 0.0)
        self._last = 0.0

    def learn(self, now: float, fraction: float) -> None:
        """now: seconds of a clock that never goes back; fraction: of the work that is done, 0 to 1."""
        if not self._history or fraction < self._history[-1][1]:  # the work has begun again
            self._history.clear()
            self._began, self._last, self.seconds = (now, fraction), now, None
        elif now - self._history[-1][0] < PAUSE and fraction < 1.0:
            return
        self._history.append((now, fraction))
        estimate = self._estimate(now, fraction)
        since, self._last = now - self._last, now
        if estimate is None or self.seconds is None:
            self.seconds = estimate
            return
        expected = max(self.seconds - since, 0.0)
        estimate = min(estimate, 2.0 * expected + 1.0)
        self.seconds = expected + (estimate - expected) * min(since / min(DRIFT, 0.2 * expected + since), 0.5)

    def _estimate(self, now: float, fraction: float) -> float | None:
        elapsed, done = now - self._began[0], fraction - self._began[1]
        recent = max(RECENT, 0.25 * elapsed)
        while len(self._history) > 2 and self._history[1][0] <= now - recent:
            self._history.popleft()
        if fraction >= 1.0 or elapsed < FIRST or done < LEAST:
            return None
        then, before = self._history[0]
        rate = max((fraction - before) / (now - then), done / elapsed / SLOWEST)  # it may stand still
        return (1.0 - fraction) / rate


def clock(seconds: float) -> str:
    """The time as a clock shows it: 0:07, 12:34, 1:02:03. Counted up, so that it ends at 0:01."""
    minutes, rest = divmod(max(int(-(-seconds // 1)), 1), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
