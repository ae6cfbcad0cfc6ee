# SPDX-License-Identifier: GPL-3.0-or-later
"""Players of one soft skin share what takes long to make; another skin never gets it."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from dataclasses import replace
from functools import partial

import dynamorph
import numpy as np
import pytest
from dynamic_morph_targets.core.model.build import build
from dynamic_morph_targets.core.motion.player import Player
from dynamic_morph_targets.core.motion.prepared import forget, prepared
from dynamic_morph_targets.core.motion.rig_samples import RigSamples
from dynamic_morph_targets.core.settings import Material, SimulationSettings
from test_build import bar

SETTINGS = SimulationSettings(max_displacement=0.05)


@pytest.fixture(scope="module")
def model():
    return build(bar())


def test_the_same_skin_shares(model):
    first = Player(model, bar(), SETTINGS)
    read_again = replace(deepcopy(model), summary=replace(model.summary, modes=0))
    other = Player(read_again, bar(), replace(SETTINGS, gravity=(0.0, 0.0, -9.81), frame_end=9))
    assert other.engine is first.engine and other.simulation is not first.simulation
    forget()
    assert Player(model, bar(), SETTINGS).engine is not first.engine


def softer():
    return bar(material=Material(stiffness=1e4, poisson=0.0))


def moved():
    vertices = bar().vertices.copy()
    vertices[7, 1] = np.nextafter(vertices[7, 1], 1.0)
    return replace(bar(), vertices=vertices)


@pytest.mark.parametrize(
    "other",
    [
        lambda model: (model, softer(), SETTINGS),
        lambda model: (model, moved(), SETTINGS),
        lambda model: (model, replace(bar(), attachments=("another",)), SETTINGS),
        lambda model: (replace(model, stiffness=1.1 * model.stiffness), bar(), SETTINGS),
        lambda model: (model, bar(), replace(SETTINGS, max_thickness=0.3)),
    ],
    ids=["material", "vertex", "attachment", "map", "limit"],
)
def test_another_skin_does_not(model, other):
    assert prepared(*other(model)) is not prepared(model, bar(), SETTINGS)


def test_other_constants_do_not(model, monkeypatch):
    """As docs/limit.md compares them."""
    first = prepared(model, bar(), SETTINGS)
    monkeypatch.setattr(dynamorph, "MotionLimit", partial(dynamorph.MotionLimit, stretch=0.8))
    other = prepared(model, bar(), SETTINGS)
    assert other.limit is not first.limit and prepared(model, bar(), SETTINGS) is other


def test_what_limits_look_at_goes_along_to_other_processes(model, monkeypatch):
    """And what another material, or another quality, has there is looked for again."""
    found = []

    def limit(*args, tissue):
        found.append(tissue is not None)
        return dynamorph._core.MotionLimit(*args, tissue=tissue)

    monkeypatch.setattr(dynamorph, "MotionLimit", limit)
    built = replace(model)
    prepared(built, bar(), SETTINGS)
    there, character = pickle.loads(pickle.dumps((built, bar())))
    first, other = prepared(built, bar(), SETTINGS), prepared(there, character, replace(SETTINGS, max_displacement=0.1))
    prepared(there, softer(), SETTINGS)
    prepared(there.with_settings(replace(model.settings, solver="FULL")), character, SETTINGS)
    assert found == [False, True, False, False]
    assert other.limit is not first.limit and other.limit.frequency == first.limit.frequency


def test_only_the_latest_are_kept(model):
    first = prepared(model, bar(), SETTINGS)
    for limit in (0.1, 0.2):
        prepared(model, bar(), replace(SETTINGS, max_displacement=limit))
    assert prepared(model, bar(), SETTINGS) is not first


def test_players_may_share_it_in_any_thread(model):
    """Two at once move as one alone, to the last byte."""
    settings = replace(SETTINGS, frame_end=8)
    steps = 1 + 7 * settings.substeps
    world = np.tile(np.eye(4), (steps, 1, 1))
    world[:, 0, 3] = 0.05 * np.sin(np.arange(steps))
    rig = RigSamples(np.tile(np.eye(4), (steps, 1, 1, 1)), world, world)
    first, *both = players = [Player(model, bar(), settings) for _ in range(3)]
    assert len({id(player.engine) for player in players}) == 1
    alone = [frame.coordinates for frame in first.run(rig)]
    assert np.abs(alone).max() > 1e-3  # meters
    with ThreadPoolExecutor() as pool:
        for frames in pool.map(lambda player: list(player.run(rig)), both):
            np.testing.assert_array_equal([frame.coordinates for frame in frames], alone)
