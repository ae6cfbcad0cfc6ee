# SPDX-License-Identifier: GPL-3.0-or-later
"""One motion, whatever the frame rate: with smaller steps all converge to it, at the order of their integrator."""

from dataclasses import replace

import numpy as np
import pytest
from dynamic_morph_targets.core.model.build import build
from dynamic_morph_targets.core.motion import simulate
from dynamic_morph_targets.core.motion.rig_samples import RigSamples
from dynamic_morph_targets.core.settings import Material, SimulationSettings
from test_build import bar

SECONDS = 1.0
TISSUE = Material(stiffness=3e4, poisson=0.3, mass_damping=2.0, stiffness_damping=0.002)


def swaying_bar(blending="EVEN"):
    """A reduced bar of stable StVK, and what it does when its foot sways: coordinates (F, r) at the frames."""
    settings = replace(bar().settings, material_model="STABLE_STVK", solver="REDUCED", blending=blending)
    character = replace(bar(material=TISSUE), settings=settings)
    model = build(character)

    def run(fps, substeps, integrator="BDF2"):
        times = np.arange(round(SECONDS * fps) * substeps + 1) / (fps * substeps)
        world = np.tile(np.eye(4), (len(times), 1, 1))
        world[:, 0, 3] = 0.05 * (1.0 - np.cos(2.0 * np.pi * 1.5 * times))  # begins at rest
        turn = 0.3 * (1.0 - np.cos(2.0 * np.pi * times))
        world[:, 0, 0] = world[:, 2, 2] = np.cos(turn)
        world[:, 0, 2], world[:, 2, 0] = np.sin(turn), -np.sin(turn)
        rig = RigSamples(np.tile(np.eye(4), (len(times), 1, 1, 1)), world, world)
        end = round(SECONDS * fps)
        settings = SimulationSettings(0, end, fps, substeps, integrator, (0.0, 0.0, -9.81), initial_state="REST_SHAPE")
        return np.array([frame.coordinates for frame in simulate.simulate(model, character, rig, settings)])

    return run


@pytest.fixture(scope="module")
def swaying():
    return swaying_bar()


def test_the_frame_rate_does_not_matter_where_the_steps_are_as_long(swaying):
    ends = [swaying(fps, substeps)[:: fps // 6] for fps, substeps in ((24, 5), (30, 4), (60, 2), (120, 1))]
    scale = np.abs(ends[0]).max()
    for other in ends[1:]:
        assert other == pytest.approx(ends[0], abs=1e-6 * scale)


def test_sums_in_single_precision_add_up_to_nothing(swaying):
    """With even blending a step sums small changes in single precision, with forces blending all in double. One target
    makes both the same model.
    """
    in_double = swaying_bar("FORCES")
    for substeps in (5, 512):
        exact = in_double(24, substeps)
        assert swaying(24, substeps) == pytest.approx(exact, abs=1e-6 * np.abs(exact).max())


@pytest.mark.parametrize("integrator, order", [("BDF2", 2.0), ("EULER", 1.0)])
def test_steps_converge_to_one_motion(swaying, integrator, order):
    exact = swaying(24, 512)
    scale = np.abs(exact).max()
    for fps in (24, 30, 60):
        errors = [np.abs(swaying(fps, n, integrator)[:: fps // 6] - exact[::4]).max() / scale for n in (16, 32, 64)]
        measured = np.log2(np.array(errors[:-1]) / errors[1:])
        assert measured[-1] == pytest.approx(order, abs=0.3)
    assert errors[-1] < 0.02
