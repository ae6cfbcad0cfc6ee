# SPDX-License-Identifier: GPL-3.0-or-later
"""Input that the engine cannot work with is refused with an error that names it, and never crashes or hangs."""

from __future__ import annotations

import dynamorph
import numpy as np
import pytest
from test_physics import cantilever

LAW, BLENDING = dynamorph.Law.STVK, dynamorph.Blending.EVEN


def reduced(full, basis):
    """The reduced model of one target at rest in a basis (dofs, r)."""
    return dynamorph.ReducedModel(full.body, [rest(full)], dynamorph.reduce(full, basis), BLENDING)


def rest(full, **changed):
    """A target of the neutral shape."""
    shape = np.zeros_like(full.displacement(np.zeros(full.dofs)))
    known = {"displacement": shape, "lame_lambda": 2e4, "lame_mu": 1e4, "density": 1000.0}
    return dynamorph.MorphTarget("rest", **(known | changed))


@pytest.mark.parametrize("stepper", ["full", "reduced", "crowd"])
@pytest.mark.parametrize(
    ("option", "value"),
    [
        *(("h", h) for h in (0.0, -1.0, np.nan, np.inf)),
        *(("tolerance", tolerance) for tolerance in (0.0, -1e-6, 1.0, np.nan)),
        ("max_iterations", 0),
        ("max_iterations", -1),
        ("teleport", -1.0),
        ("teleport", np.nan),
        ("gravity", (0.0, np.nan, 0.0)),
        ("scheme", dynamorph.Scheme(7)),
    ],
)
def test_options_that_no_step_can_be_taken_with(stepper, option, value):
    full, _ = cantilever((2, 1, 1), (0.2, 0.1, 0.1))
    options = {"h": 0.01} | {option: value}
    with pytest.raises(ValueError, match=f"^{option}: "):
        if stepper == "full":
            dynamorph.FullSimulation(full, **options)
        elif stepper == "reduced":
            dynamorph.ReducedSimulation(reduced(full, full.linear_modes(0, 2)[1] * np.sqrt(1000.0)), **options)
        else:
            dynamorph.Crowd(reduced(full, full.linear_modes(0, 2)[1] * np.sqrt(1000.0)), size=3, **options)
