# SPDX-License-Identifier: GPL-3.0-or-later
"""The time left, on histories that are made up: it comes late, is right in the end, and never jumps."""

from itertools import pairwise

import pytest
from bl_ext.user_default.dynamic_morph_targets.core import time_left


def estimates(addon, fraction, seconds):
    """The time left at each tenth of a second of a work with this fraction(time)."""
    left, found = time_left.TimeLeft(), []
    for tick in range(int(10 * seconds) + 1):
        left.learn(0.1 * tick, fraction(0.1 * tick))
        found.append(left.seconds)
    return found


def stages(*parts):
    """The fraction of a work whose parts, (seconds, fraction), follow each other."""

    def fraction(time):
        done = 0.0
        for seconds, part_of_it in parts:
            done += part_of_it * min(max(time, 0.0) / seconds, 1.0)
            time -= seconds
        return done

    return fraction


HISTORIES = {
    "linear": stages((20.0, 1.0)),
    "fast, then slow": stages((4.0, 0.2), (40.0, 0.8)),
    "slow, then fast": stages((20.0, 0.2), (10.0, 0.8)),
    "stalled": stages((8.0, 0.4), (12.0, 0.0), (12.0, 0.6)),
    "in steps": lambda time: int(time / 3.0) * 3.0 / 60.0,
}
SECONDS = {"linear": 20.0, "fast, then slow": 44.0, "slow, then fast": 30.0, "stalled": 32.0, "in steps": 60.0}


@pytest.mark.parametrize("name", HISTORIES)
def test_it_never_jumps(addon, name):
    """Beside the clock it changes in a tenth of a second by 5 %, near the end by half a second."""
    found = [seconds for seconds in estimates(addon, HISTORIES[name], SECONDS[name]) if seconds is not None]
    assert len(found) > 0.8 * 10 * (SECONDS[name] - 4.0)
    for before, after in pairwise(found):
        assert abs(after - (before - 0.1)) <= max(0.05 * before, 0.5), (before, after)


@pytest.mark.parametrize("name", ["linear", "fast, then slow", "stalled", "in steps"])
def test_it_is_right_in_the_end(addon, name):
    """In the last sixteenth of the time, to a third or three seconds."""
    found, seconds = estimates(addon, HISTORIES[name], SECONDS[name]), SECONDS[name]
    for tick in range(int(9.375 * seconds), int(10 * seconds) - 1):
        assert found[tick] == pytest.approx(seconds - 0.1 * tick, rel=0.33, abs=3.0), tick


def test_a_work_that_becomes_eight_times_as_fast(addon):
    """It comes down by half in four seconds, and is never too short."""
    found = estimates(addon, HISTORIES["slow, then fast"], 30.0)
    assert found[240] < 0.5 * found[200] and found[280] < 0.5 * found[240]
    assert all(seconds > 0.1 * (300 - tick) for tick, seconds in enumerate(found[200:300], 200))


def test_a_steady_work_counts_down(addon):
    found = estimates(addon, HISTORIES["linear"], 20.0)
    assert found[50] == pytest.approx(15.0, abs=0.1) and found[150] == pytest.approx(5.0, abs=0.1)


def test_nothing_is_said_too_early_or_when_it_is_done(addon):
    linear = estimates(addon, HISTORIES["linear"], 20.0)
    assert set(linear[:9]) == {None} and linear[12] is not None and linear[-1] is None
    assert set(estimates(addon, lambda time: 0.001 * time, 25.0)) == {None}


def test_a_stall_does_not_make_it_endless(addon):
    found = estimates(addon, HISTORIES["stalled"], 32.0)
    assert found[80] == pytest.approx(12.0, abs=0.2)  # at the stall
    assert found[120] > 12.0 and max(found[80:200]) < 50.0


def test_a_work_that_begins_again_is_estimated_anew(addon):
    """As a rehearsal does."""
    found = estimates(addon, lambda time: time / 10 if time < 9.95 else 0.2 + (time - 10.0) / 50, 40.0)
    assert found[105] is None and found[200] == pytest.approx(30.0, abs=1.0)


@pytest.mark.parametrize(
    "seconds, text", [(0.0, "0:01"), (6.2, "0:07"), (60.0, "1:00"), (754.0, "12:34"), (3723.0, "1:02:03")]
)
def test_as_a_clock(addon, seconds, text):
    assert time_left.clock(seconds) == text
