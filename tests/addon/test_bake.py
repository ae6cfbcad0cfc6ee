# SPDX-License-Identifier: GPL-3.0-or-later
"""What a bake simulates: how it begins, how it is resumed, loops, and which modes count how much."""

from dataclasses import replace

import numpy as np
import pytest
from builders import part

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")


@pytest.fixture
def shot(soft_arm):
    """A coarse arm that was baked: the job with its model, character, rig and settings."""
    soft_arm.dynamorph.model.cage_nodes = 200
    soft_arm.dynamorph.model.modes = 8
    job = part("jobs").Job(soft_arm, goal="BAKE")
    part("jobs").run(job)
    return job


def simulated(shot, rig=None, **settings):
    """Coordinates (F, dofs) of the shot, with other settings."""
    simulate = part("simulate")
    frames = simulate.simulate(shot.model, shot.character, rig or shot.rig, replace(shot.settings, **settings))
    return np.array([frame.coordinates for frame in frames])


def played(player, shot, frames):
    """Coordinates of `frames`, asked for one by one as playback does."""
    substeps = shot.settings.substeps
    out = []
    for frame in frames:
        first = 1 + (frame - shot.settings.start - 1) * substeps
        out.append(player.advance(shot.rig[first : first + substeps], frame).coordinates)
    return np.array(out)


def test_playback_frame_by_frame_is_the_bake(shot):
    player = part("simulate").Player(shot.model, shot.character, shot.settings)
    begun = player.begin(shot.rig[:2])
    assert begun.number == 1 and np.array_equal(begun.coordinates, shot.result.coordinates[0])
    assert np.array_equal(played(player, shot, range(2, 21)), shot.result.coordinates[1:])


def test_exchange_goes_on_with_other_materials(shot):
    simulate = part("simulate")
    player = simulate.Player(shot.model, shot.character, shot.settings)
    player.begin(shot.rig[:2])
    before = played(player, shot, range(2, 11))
    same = player.exchange(shot.character)
    sets = shot.character.target_sets[0]
    soft = tuple(replace(t, material=replace(t.material, stiffness=2e3)) for t in sets.targets)
    other = player.exchange(replace(shot.character, target_sets=(replace(sets, targets=soft),)))
    assert np.array_equal(other._simulation.state[0][0], before[-1])
    unchanged, softer = played(same, shot, range(11, 21)), played(other, shot, range(11, 21))
    assert np.allclose(unchanged, shot.result.coordinates[10:], rtol=0, atol=1e-9 * np.abs(unchanged).max())
    assert np.abs(softer - unchanged).max() > 0.1 * np.abs(unchanged).max()


def test_static_morph_targets_play_too(shot):
    build, simulate = part("jobs").engine()
    character = shot.character.with_settings(method="STATIC")
    player = simulate.Player(build.build(character), character, shot.settings)
    assert player.begin(shot.rig[:2]).weights == pytest.approx([1, 0])
    frame = player.advance(shot.rig[-shot.settings.substeps :], 2)
    assert frame.weights == pytest.approx([0, 1]) and player.shown(frame).shape == (0,)


def test_gains_scale_the_motion_about_the_targets(shot):
    simulate = part("simulate")
    gains = (0.0, 2.0)
    player = simulate.Player(shot.model, shot.character, replace(shot.settings, gains=gains))
    frame = simulate.Frame(9, shot.result.coordinates[8], shot.result.weights[8], {})
    dry = shot.result.weights[8] @ shot.model.target_coordinates(shot.model.engine(shot.character))
    motion = frame.coordinates - dry
    assert np.abs(motion).min() > 0
    assert player.shown(frame) - dry == pytest.approx([0.0, 2 * motion[1], *motion[2:]])
    player.gains = np.zeros(8)
    assert player.shown(frame) == pytest.approx(dry)


# How it begins -----------------------------------------------------------------------------------------------------


def held(shot, frames=20):
    """The rig held at its pose in the middle of the shot, between the targets, where gravity sags the flesh."""
    count = 1 + (frames - 1) * shot.settings.substeps
    middle = shot.rig[len(shot.rig) // 2 :][:1]
    return type(shot.rig)(*(np.repeat(a, count, axis=0) for a in (middle.pose, middle.rig_world, middle.object_world)))


def test_settle_begins_in_balance(shot):
    settled = simulated(shot, held(shot), begin="SETTLE")
    assert np.abs(settled - settled[0]).max() < 1e-6 * np.abs(settled[0]).max()


def test_rest_begins_with_the_targets_shapes_and_then_sags(shot):
    player = part("simulate").Player(shot.model, shot.character, replace(shot.settings, begin="REST"))
    begun = player.begin(held(shot))
    assert np.array_equal(begun.coordinates, player.dry(begun.weights))
    free, settled = simulated(shot, held(shot), begin="REST"), simulated(shot, held(shot), begin="SETTLE")
    assert np.array_equal(free[0], begun.coordinates)
    assert np.abs(free[-1] - free[0]).max() > 0.1 * np.abs(settled[0] - free[0]).max() > 0
    calmed = simulated(shot, held(shot), begin="REST", preroll=200)
    assert calmed[0] == pytest.approx(settled[0], abs=1e-3 * np.abs(settled[0] - free[0]).max())


def test_rest_knows_no_motion_before_the_start(shot):
    """A rig that already moves at the start hits flesh that begins at rest, and carries along flesh that settled."""
    rig, still = shot.rig, dict.fromkeys(["gravity"], (0.0, 0.0, 0.0))
    world = np.array(rig.rig_world)
    world[:, 0, 3] += 3.0 * np.arange(len(world)) * shot.settings.step  # 3 m/s along x
    moving = replace(held(shot), rig_world=world, object_world=world)
    rest, settled = (simulated(shot, moving, begin=begin, **still) for begin in ("REST", "SETTLE"))
    assert np.abs(settled - settled[0]).max() < 1e-6
    assert np.abs(rest - rest[0]).max() > 100 * np.abs(settled - settled[0]).max() + 1e-4
