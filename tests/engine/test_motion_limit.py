# SPDX-License-Identifier: GPL-3.0-or-later
"""What the limits of a motion do to it: nothing below half of them, never far beyond, whatever the rig does."""

from __future__ import annotations

import hashlib
import pickle

import dynamorph
import numpy as np
import pytest
from scenes import bar
from scipy.spatial.transform import Rotation

SIZE = (0.8, 0.2, 0.2)
GRAVITY = 9.81
KINDS = ["full", "responses"]


def surface(tets: np.ndarray) -> np.ndarray:
    """The triangles of one tet alone."""
    faces = np.concatenate([tets[:, corners] for corners in ([0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2])])
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]]


class Bar:
    """A bar that its bones hold in the middle, with tissue on both sides: the first bone carries its left half, the
    second its right half. One target, or with `sets` = 2 one in each of two sets that share it. corners: a third and a
    fourth bone carry a corner of each end. These are images of each other, but the first has three times the mass.
    """

    def __init__(
        self,
        kind="responses",
        law=dynamorph.MaterialModel.LINEAR,
        own_transforms=False,
        sets=1,
        stiff=1.0,
        damping=0.004,
        corners=False,
    ):
        self.nodes, tets = bar((12, 3, 3), SIZE)
        mesh, ones = dynamorph.TetMesh(self.nodes, tets), np.ones(len(tets))
        along = self.nodes[:, 0] / SIZE[0]
        self.weights = np.stack([along < 0.5, along >= 0.5], axis=1).astype(float)
        if corners:
            at = [(self.nodes == (x, 0.0, 0.0)).all(axis=1) for x in (0.0, SIZE[0])]
            self.weights = np.column_stack([self.weights * ~(at[0] | at[1])[:, None], *at])
        pinned = np.abs(along - 0.5) < 0.05
        body = dynamorph.SoftBody(
            mesh, ones, ones, np.repeat(ones[:, None] / sets, sets, axis=1), pinned,
            None if own_transforms else self.weights,
        )  # fmt: skip
        material = {"density": 1000.0, "stiffness_damping": damping, "lame_lambda": 4e4, "lame_mu": 3e4}
        targets = [dynamorph.MorphTarget(f"rest {s}", 0 * self.nodes, set=s, **material) for s in range(sets)]
        hard = {name: value * (stiff if "lame" in name else 1.0) for name, value in material.items()}
        targets.append(dynamorph.MorphTarget("hard", 0 * self.nodes, set=0, **hard))
        full = dynamorph.FullModel(body, targets, law, dynamorph.Blending.EVEN)
        self.full = full
        self.model = full
        if kind != "full":
            tables = dynamorph.reduce(full, dynamorph.make_response_basis(full, 10, 30))
            self.model = dynamorph.ReducedModel(body, targets, tables, dynamorph.Blending.EVEN)
        self.neutral = np.array([1.0] * sets + [0.0])
        self.embedding, self.triangles = dynamorph.embed(mesh, self.nodes), surface(tets)
        self.free = ~pinned
        self.own = own_transforms

    def limit(self, distance: float, painted=None, **constants):
        return dynamorph.MotionLimit(
            self.model, self.nodes, self.embedding, self.triangles, self.weights,
            np.full(len(self.nodes), distance), self.weights[self.free] if self.own else None, painted, **constants,
        )  # fmt: skip

    def simulation(self, distance=0.0, h=1 / 120, **options):
        limit = self.limit(distance) if distance else None
        return dynamorph.Simulation(self.model, h, **{"limit": limit, **options})

    def bones(self, frames: np.ndarray) -> np.ndarray:
        """The engine's transforms (S, T, 3, 4) of two bones (S, 2, 3, 4)."""
        return np.einsum("nb,sbij->snij", self.weights[self.free], frames) if self.own else frames

    def run(self, simulation, frames: np.ndarray, weights=None) -> np.ndarray:
        """The largest displacement in each step (S,), from rest."""
        frames, weights = self.bones(frames), self.neutral if weights is None else weights
        simulation.start(frames[0], frames[1], weights)
        out = [0.0]
        for frame in frames[1:]:
            simulation.advance(frame[None], weights[None])
            moved = self.model.displacement(simulation.coordinates)
            out.append(np.linalg.norm(moved, axis=1).max())
        return np.array(out)


def moving(z: np.ndarray, second: np.ndarray | None = None) -> np.ndarray:
    """Both bones (S, 2, 3, 4) at heights z (S,); the second one elsewhere."""
    frames = np.tile(np.eye(3, 4), (len(z), 2, 1, 1))
    frames[:, 0, 2, 3] = z
    frames[:, 1, 2, 3] = z if second is None else second
    return frames


def digest() -> str:
    """Of wild motion that the limits of both kinds hold back: for test_threads.py."""
    found = hashlib.sha256()
    for kind in KINDS:
        made = Bar(kind)
        simulation = made.simulation(0.02)
        made.run(simulation, moving(0.3 * np.sin(np.arange(40) / 3.0)))
        found.update(simulation.coordinates.tobytes() + simulation.excess.tobytes())
    return found.hexdigest()


@pytest.fixture(scope="module")
def limited():
    """Bars by kind, with the distance by which gravity alone would move each."""
    found = {}
    for kind in KINDS:
        made = Bar(kind)
        q, _ = made.simulation(gravity=(0, 0, -GRAVITY)).solve_static(moving(np.zeros(1))[0], made.neutral)
        found[kind] = made, float(np.linalg.norm(made.model.displacement(q), axis=1).max())
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_small_motion_stays_as_it_is_to_the_last_bit(limited, kind):
    made, sag = limited[kind]
    t = np.arange(60) / 120
    frames = moving(0.002 * np.sin(2 * np.pi * 2 * t))
    within, free = (made.simulation(distance, gravity=(0, 0, -0.3 * GRAVITY)) for distance in (4.0 * sag, 0.0))
    for simulation in (within, free):
        made.run(simulation, frames)
    assert 0.0 < within.excess.max() < 0.4
    np.testing.assert_array_equal(within.coordinates, free.coordinates)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [0.3, 1.0, 3.0, 20.0])
def test_a_lasting_load_is_scaled_as_the_formula_says(limited, kind, share):
    """A linear body under gravity, whose static answer is `share` of its limit: it moves by s of that answer."""
    made, sag = limited[kind]
    still = moving(np.zeros(1))[0]
    unlimited, _ = made.simulation(gravity=(0, 0, -GRAVITY)).solve_static(still, made.neutral)
    simulation = made.simulation(2.0 * sag, gravity=(0, 0, -share * GRAVITY))
    simulation.start(still, still, made.neutral)
    excess = simulation.excess
    assert excess[0] == pytest.approx(excess[1], rel=0.05)  # both halves hang alike
    assert excess.max() == pytest.approx(share / 2.0 / 0.9, rel=0.05)  # the percentile is a little below the largest
    scale = np.where(excess <= 0.4, 1.0, (0.4 + 0.6 * np.tanh((excess - 0.4) / 0.6)) / excess).mean()
    found, expected = (
        made.model.displacement(simulation.coordinates),
        share * scale * made.model.displacement(unlimited),
    )
    if share <= 1.0:  # nothing is as far as 0.6 of its distance
        assert np.abs(found - expected).max() < 0.02 * np.abs(expected).max()
    else:  # it is pulled back, too
        assert 0.6 * 2.0 * sag < np.abs(found).max() < 0.9 * np.abs(expected).max() < 1.6 * 2.0 * sag
    simulation.advance(np.repeat(still[None], 400, axis=0), np.repeat(made.neutral[None], 400, axis=0))
    after = made.model.displacement(simulation.coordinates)
    assert np.abs(after - found).max() < 2e-3 * np.abs(found).max()  # it started at rest


@pytest.mark.parametrize("kind", KINDS)
def test_targets_are_free_of_gravity_in_their_own_poses(limited, kind):
    made, sag = limited[kind]
    turned = Rotation.from_euler("x", 70, degrees=True).as_matrix()
    posed = moving(np.zeros(1))[0]
    posed[:, :, :3] = turned
    simulation = made.simulation(0.2 * sag, gravity=(0, 0, -GRAVITY))
    simulation.balance_targets(np.repeat(posed[None], 2, axis=0))
    simulation.start(posed, posed, made.neutral)
    assert np.abs(made.model.displacement(simulation.coordinates)).max() < 1e-6 * sag
    assert simulation.excess.max() < 1e-6
    posed[:, :, :3] = -turned  # upside down: twice gravity, and the limit lets a fifth of a sag through
    posed[:, :, 0] *= -1
    simulation.start(posed, posed, made.neutral)
    assert np.linalg.norm(made.model.displacement(simulation.coordinates), axis=1).max() < 0.35 * sag


@pytest.mark.parametrize("law", [dynamorph.MaterialModel.LINEAR, dynamorph.MaterialModel.STABLE_STVK])
@pytest.mark.parametrize("kind", KINDS)
def test_no_blow_no_resonance_moves_it_far_beyond_its_limit(kind, law):
    made = Bar(kind, law)
    distance, hz = 0.04, made.limit(0.04).frequency / (2 * np.pi)
    t = np.arange(240) / 120
    shaken = {
        "blow": np.where(t > 0.1, 4.0 * (t - 0.1), 0.0),
        "resonance": 0.3 * np.sin(2 * np.pi * hz * t),
        "buzz": 0.2 * np.sin(2 * np.pi * 11.0 * t),
        "glitch": np.where(np.arange(240) == 60, 2.0, 0.0),
    }
    for name, z in shaken.items():
        simulation = made.simulation(distance)
        far = made.run(simulation, moving(z))
        assert 0.3 * distance < far.max() < 2.0 * distance, name
        assert np.isfinite(simulation.coordinates).all()


@pytest.mark.parametrize("hz", [2.0, 4.0, 5.0])
@pytest.mark.parametrize("kind", KINDS)
def test_a_heavy_load_that_oscillates_is_held_back_before_the_skin_is_pulled(kind, hz):
    """The rig shakes a bar of 1.8 Hz far beyond its limit, unevenly, with a linear key on every frame of 24 a second.
    What is let through in spite of that is pulled back in nearly every step, and goes to and fro with the rig.
    """
    made, distance, rate = Bar(kind, damping=0.018), 0.05 * np.linalg.norm(SIZE), 120
    keys = np.arange(49) / 24
    heights = 0.9 / hz * np.sin(2 * np.pi * hz * keys + np.sin(7.0 * keys))
    frames = moving(np.interp(np.arange(2 * rate + 1) / rate, keys, heights))
    simulation, pulled, excess, moved = made.simulation(distance, h=1 / rate), 0, [], []
    simulation.start(frames[0], frames[1], made.neutral)
    for frame in frames[1:]:
        pulled += simulation.advance(frame[None], made.neutral[None]).pulled
        excess.append(simulation.excess.max())
        moved.append(made.model.displacement(simulation.coordinates))
    assert np.median(excess) > 10.0
    assert pulled < 0.5 * len(moved)
    assert np.linalg.norm(moved, axis=2).max() < 1.2 * distance
    change = np.diff(moved[4::5], axis=0)  # from frame to frame
    assert (change[1:] * change[:-1]).sum() > 0.0  # it turns less often than at every other frame


@pytest.mark.parametrize("weight", [0.5, 0.25])
@pytest.mark.parametrize("kind", KINDS)
def test_a_painted_end_stays_nearer_and_the_other_moves_as_it_did(kind, weight):
    """In resonance. The load that a bone's tissue may have is the same, whatever is painted."""
    made = Bar(kind, dynamorph.MaterialModel.STABLE_STVK, damping=0.01)
    distance, hz = 0.04, made.limit(0.04).frequency / (2 * np.pi)
    frames = moving(0.1 * np.sin(2 * np.pi * hz * np.arange(240) / 120))
    painted, other = made.nodes[:, 0] < 0.3 * SIZE[0], made.nodes[:, 0] > 0.7 * SIZE[0]
    moves, excess = [], []
    for weights in (None, np.where(painted, weight, 1.0)):
        simulation, shown = made.simulation(limit=made.limit(distance, weights)), []
        simulation.start(frames[0], frames[1], made.neutral)
        for frame in frames[1:]:
            simulation.advance(frame[None], made.neutral[None])
            shown.append(made.model.displacement(simulation.coordinates))
            excess.append(simulation.excess)
        moves.append(np.array(shown))
    as_it_was, now = moves
    assert np.linalg.norm(as_it_was[:, painted], axis=2).max() > 0.8 * distance
    assert np.linalg.norm(now[:, painted], axis=2).max() < 1.5 * weight * distance
    kept = (as_it_was[:, other] * now[:, other]).sum() / (as_it_was[:, other] ** 2).sum()
    assert kept == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(excess[239:], excess[:239], rtol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_weights_of_one_change_nothing(limited, kind):
    made, sag = limited[kind]
    frames = moving(0.3 * np.sin(2 * np.pi * 5 * np.arange(60) / 120))
    plain, painted = made.simulation(sag), made.simulation(limit=made.limit(sag, np.ones(len(made.nodes))))
    for simulation in (plain, painted):
        made.run(simulation, frames)
    np.testing.assert_array_equal(painted.coordinates, plain.coordinates)


def shortest_in_a_landing(made, limit) -> float:
    """Of the edges along the bar, whose middle is stopped at once; relative to their length."""
    gap = made.nodes[None, :, :] - made.nodes[:, None, :]
    first, second = np.nonzero((np.abs(gap[..., 0] - SIZE[0] / 12) < 1e-9) & (np.abs(gap[..., 1:]) < 1e-9).all(axis=2))
    t = np.arange(60) / 120
    frames = moving(np.zeros(60))
    frames[:, :, 0, 3] = np.where(t > 0.1, 5.0 * (t - 0.1), 0.0)[:, None]
    simulation, lengths = made.simulation(limit=limit), []
    simulation.start(frames[0], frames[1], made.neutral)
    for frame in frames[1:]:
        simulation.advance(frame[None], made.neutral[None])
        moved = made.nodes + made.model.displacement(simulation.coordinates)
        lengths.append(np.linalg.norm(moved[second] - moved[first], axis=1).min() / (SIZE[0] / 12))
    return min(lengths)


@pytest.mark.parametrize("kind", KINDS)
def test_a_landing_does_not_crush_edges(kind):
    made = Bar(kind, dynamorph.MaterialModel.STABLE_STVK)
    assert shortest_in_a_landing(made, None) < 0.3
    assert shortest_in_a_landing(made, made.limit(0.05)) > 0.45


@pytest.mark.parametrize("kind", KINDS)
def test_more_edges_that_are_held_do_not_weaken_the_others(kind):
    made = Bar(kind, dynamorph.MaterialModel.STABLE_STVK)
    few, many = (shortest_in_a_landing(made, made.limit(0.05, edges_between=count)) for count in (50, 1000))
    assert many > few - 0.01


@pytest.mark.parametrize("fault", ["bad frame", "cut"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_of_the_rig_leaves_the_rest_of_a_shot_as_it_was(limited, kind, fault):
    """A bone that is elsewhere for one frame of 24 a second, and a jump of the whole rig that nobody marked."""
    _, sag = limited[kind]
    made = Bar(kind, damping=0.036)  # a fifth of the critical one
    t = np.arange(480) / 120
    sway = 0.03 * np.sin(2 * np.pi * 1.5 * t)
    frames = moving(sway)
    wrong = frames.copy()
    if fault == "cut":
        wrong[180:, :, 0, 3] += 3.0
    else:
        wrong[180:185, 1, :, 3] += [0.5, 0.0, 1.0]
    moves = []
    for each in (frames, wrong):
        simulation, shown = made.simulation(0.5 * sag), []
        simulation.start(each[0], each[1], made.neutral)
        for frame in each[1:]:
            simulation.advance(frame[None], made.neutral[None])
            shown.append(made.model.displacement(simulation.coordinates))
        moves.append(np.array(shown))
    right, faulty = moves
    np.testing.assert_array_equal(faulty[:179], right[:179])
    assert np.linalg.norm(faulty, axis=2).max() < 2.0 * 0.5 * sag
    after = slice(179 + 150, None)  # 2.2 swings later, as 15 frames are at 3.5 Hz
    assert (faulty[after] * right[after]).sum() / (right[after] ** 2).sum() == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("kind", KINDS)
def test_only_the_bone_that_is_driven_too_far_is_held_back(limited, kind):
    made, sag = limited[kind]
    t = np.arange(120) / 120
    calm, wild = 0.002 * np.sin(2 * np.pi * 2 * t), 0.3 * np.sin(2 * np.pi * 6 * t)
    simulation = made.simulation(2.0 * sag)
    made.run(simulation, moving(calm, wild))
    left, right = simulation.excess
    assert right > 1.0 and left < 0.5
    alone = made.simulation()
    made.run(alone, moving(calm, calm))
    ends = made.nodes[:, 0] < 0.3 * SIZE[0]
    with_both, quiet = (made.model.displacement(each.coordinates)[ends] for each in (simulation, alone))
    assert np.abs(with_both - quiet).max() < 0.15 * np.abs(made.model.displacement(simulation.coordinates)).max()


@pytest.mark.parametrize("kind", KINDS)
def test_a_bone_with_hardly_any_tissue_and_a_larger_image(kind):
    """As in a face of many bones: the tissue of one is just enough to have limits, that of its image is not. Where they
    move with the bones beside them, the tissue is that of the bar without them, and its limits are.
    """
    t = np.arange(60) / 120
    frames = moving(0.05 * np.sin(2 * np.pi * 4 * t))
    made, plain = Bar(kind, corners=True), Bar(kind)
    far, free = (made.run(made.simulation(distance), frames[:, [0, 1, 0, 1]]) for distance in (0.02, 0.0))
    without = plain.run(plain.simulation(0.02), frames)
    np.testing.assert_allclose(far, without, atol=0.01 * without.max())
    assert far.max() < 0.04 < 0.2 * free.max()


@pytest.mark.parametrize("jump", [1.0, 3.0, 10.0])
def test_the_peak_of_a_blow_does_not_depend_on_the_step(limited, jump):
    made, sag = limited["responses"]
    peaks = []
    for rate in (60, 120, 240, 480):
        t = np.arange(int(0.6 * rate)) / rate
        frames = moving(np.maximum(t - 0.1, 0.0) * jump * 0.1)
        peaks.append(made.run(made.simulation(0.3 * sag, h=1 / rate), frames).max())
    assert np.ptp(peaks) < 0.08 * np.mean(peaks)


def sudden(kind: str, share: float, rate: int) -> np.ndarray:
    """Both bones (S, 2, 3, 4) of a rig that jumps after 0.1 s, by this share of the bar's size, or its angle."""
    t, size, center = np.arange(int(0.6 * rate)) / rate, np.linalg.norm(SIZE), np.array(SIZE) / 2
    after = np.maximum(t - 0.1, 0.0)
    part = {
        "place": after > 0.0,
        "one bad frame": (after > 0.0) & (after < 1 / 24),
        "one bad step": np.arange(len(t)) == rate // 8,
        "turn": after > 0.0,
        "velocity": 20.0 * after,
        "velocity of turning": 20.0 * after,
    }[kind] * share
    if "turn" not in kind:
        return moving(part * size)
    frames = moving(np.zeros(len(t)))
    frames[..., :3] = Rotation.from_rotvec(np.outer(2.0 * part, [0.0, 1.0, 0.0])).as_matrix()[:, None]
    frames[..., 3] = center - frames[..., :3] @ center
    return frames


@pytest.mark.parametrize("jump", ["place", "one bad frame", "one bad step", "turn", "velocity", "velocity of turning"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_jump_of_the_rig_moves_it_as_without_a_limit_or_less(kind, jump):
    """Alike within 8 % where that is less than half of the limit, and never farther, at every step."""
    made, distance = Bar(kind, damping=0.018), 0.05 * np.linalg.norm(SIZE)  # a fifth of the critical one
    for share in (0.005, 0.015, 0.1):
        for rate in (120, 240, 384):
            frames = sudden(jump, share, rate)
            far, free = (made.run(made.simulation(each, h=1 / rate), frames).max() for each in (distance, 0.0))
            assert far < 1.02 * free and far < 1.5 * distance
            if free < 0.5 * distance:
                assert far == pytest.approx(free, rel=0.08)
    assert free > 1.8 * distance  # so the last share was a large one


@pytest.mark.parametrize("own_transforms", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_a_jump_counts_as_how_far_it_carries_the_skin(kind, own_transforms):
    """In its own step. The second bone jumps aside, and in another bar it turns about the first one's axis."""
    made, distance, way = Bar(kind, own_transforms=own_transforms), 0.03, 0.004
    for turn in (False, True):
        frames = moving(np.zeros(2), np.array([0.0, 0.0 if turn else way]))
        if turn:
            frames[1, 1, :, :3] = Rotation.from_rotvec([0.1, 0.0, 0.0]).as_matrix()
        simulation, bones = made.simulation(distance), made.bones(frames)
        simulation.start(bones[0], bones[0], made.neutral)
        simulation.advance(bones[1:], made.neutral[None])
        first, second = simulation.excess
        carried = np.linalg.norm(made.nodes @ (frames[1, 1, :, :3] - np.eye(3)).T + frames[1, 1, :, 3], axis=1)
        farthest = carried[made.weights[:, 1] > 0.5].max() / distance
        assert first == pytest.approx(0.0, abs=1e-12)
        if turn:  # the 97th percentile of its skin
            assert 0.8 * farthest < second <= farthest * (1 + 1e-12)
        else:
            assert second == pytest.approx(way / distance, rel=1e-12)


def way(t: np.ndarray) -> np.ndarray:
    """Heights of a rig that is moved up and down by smooth keys, meters."""
    frames, heights = (0, 7, 13, 19, 26, 33), (0.0, 0.0, 0.072, 0.0072, 0.0576, 0.0)
    key = np.clip(np.searchsorted(frames, 24 * t, "right") - 1, 0, 4)
    first, last, below, above = (np.take(of, at) for of in (frames, heights) for at in (key, key + 1))
    part = np.clip((24 * t - first) / (last - first), 0.0, 1.0)
    return below + (above - below) * part**2 * (3.0 - 2.0 * part)


@pytest.mark.parametrize("kind", KINDS)
def test_a_linear_key_at_every_frame_moves_it_like_smooth_keys(kind):
    made, distance, rate = Bar(kind, damping=0.018), 0.05 * np.linalg.norm(SIZE), 120
    t = np.arange(2 * rate + 1) / rate
    keys = np.arange(0.0, t[-1] + 1e-9, 1 / 24)
    off = []
    for limit in (distance, 0.0):
        moves = []
        for z in (way(t), np.interp(t, keys, way(keys))):
            simulation = made.simulation(limit, h=1 / rate)
            frames = moving(z)
            simulation.start(frames[0], frames[1], made.neutral)
            shown = []
            for frame in frames[1:]:
                simulation.advance(frame[None], made.neutral[None])
                shown.append(simulation.coordinates)
            moves.append(np.array(shown))
        off.append(np.linalg.norm(moves[0] - moves[1]) / np.linalg.norm(moves[0]))
    assert off[0] < 0.15 and off[1] < 0.03


def test_a_state_resumes_to_the_last_bit(limited):
    made, sag = limited["responses"]
    t = np.arange(80) / 120
    frames = moving(0.3 * np.sin(2 * np.pi * 5 * t))
    whole = made.simulation(sag)
    made.run(whole, frames)
    first, second = made.simulation(sag), made.simulation(sag)
    made.run(first, frames[:40])
    second.state, past = first.state, (first.state.coordinates, first.state.bones)
    for frame in frames[40:]:
        second.advance(frame[None], made.neutral[None])
    np.testing.assert_array_equal(second.coordinates, whole.coordinates)
    np.testing.assert_array_equal(second.state.limit, whole.state.limit)
    second.state = dynamorph.State(*past)  # of a simulation without a limit
    np.testing.assert_array_equal(second.excess, np.zeros(2))
    free = made.simulation()
    free.state = first.state
    assert free.excess.size == 0
    remembered = first.state.limit
    with pytest.raises(ValueError, match="expected the limit of 2 bones, got 3"):
        second.state = dynamorph.State(*past, np.zeros(len(remembered) + 5))
    with pytest.raises(ValueError, match="not one that a simulation had"):
        second.state = dynamorph.State(*past, remembered[1:])
    for wrong in (np.nan, -1.0):
        with pytest.raises(dynamorph.Error, match="excess that is not a finite number"):
            second.state = dynamorph.State(*past, np.append(wrong, remembered[1:]))


@pytest.mark.parametrize("kind", KINDS)
def test_nodes_with_transforms_of_their_own_are_limited_like_their_bones(kind):
    """Skinning that is not linear in the bones' matrices, here with what linear skinning would say."""
    t = np.arange(90) / 120
    frames = moving(0.3 * np.sin(2 * np.pi * 5 * t), 0.1 * np.sin(2 * np.pi * 3 * t))
    far, excess = [], []
    for own in (False, True):
        made, moved = Bar(kind, own_transforms=own), []
        simulation, bones = made.simulation(0.03, gravity=(0, 0, -3.0)), made.bones(frames)
        simulation.start(bones[0], bones[1], made.neutral)
        for frame in bones[1:]:
            simulation.advance(frame[None], made.neutral[None])
            moved.append(np.linalg.norm(made.model.displacement(simulation.coordinates), axis=1).max())
            excess.append(simulation.excess)
        far.append(np.array(moved))
    np.testing.assert_allclose(excess[89:], excess[:89], rtol=1e-6 if kind == "full" else 0.005)
    # The inertia of responses with transforms of their own is summed otherwise: without a limit these are 46 % apart.
    np.testing.assert_allclose(far[1], far[0], atol=(1e-6 if kind == "full" else 0.15) * far[0].max())


def test_forces_on_the_nodes_are_part_of_the_load(limited):
    """Gravity as a force field, against gravity."""
    made, sag = limited["full"]
    mass = np.zeros((len(made.nodes), 3))
    mass[made.free, 2] = made.full.body.volumes.sum(axis=1) * 1000.0 * -4.0 * GRAVITY
    still = moving(np.zeros(1))
    falling = made.simulation(sag, gravity=(0, 0, -4.0 * GRAVITY))
    falling.start(still[0], still[0], made.neutral)
    pushed = made.simulation(sag)
    pushed.start(still[0], still[0], made.neutral)
    for _ in range(1200):  # until its swing has died down
        pushed.advance(still, made.neutral[None], mass)
    assert falling.excess.max() > 1.0
    np.testing.assert_allclose(pushed.excess, falling.excess, rtol=1e-3)
    np.testing.assert_allclose(pushed.coordinates, falling.coordinates, atol=0.02 * np.abs(falling.coordinates).max())


def test_stiffer_targets_and_several_sets_count_with_their_stiffness():
    """What is three times as stiff goes a third as far, so a load exceeds its limit by a third."""
    still = moving(np.zeros(1))[0]
    made = Bar(stiff=3.0)
    simulation = made.simulation(0.02, gravity=(0, 0, -GRAVITY))
    simulation.start(still, still, made.neutral)
    soft = simulation.excess
    simulation.start(still, still, np.array([0.0, 1.0]))
    np.testing.assert_allclose(simulation.excess, soft / 3.0, rtol=1e-6)
    both = Bar(sets=2, stiff=3.0)
    simulation = both.simulation(0.02, gravity=(0, 0, -GRAVITY))
    simulation.start(still, still, both.neutral)
    np.testing.assert_allclose(simulation.excess, soft, rtol=2e-2)
    simulation.start(still, still, np.array([0.0, 1.0, 1.0]))  # half of the tissue is three times as stiff
    np.testing.assert_allclose(simulation.excess, soft / 2.0, rtol=2e-2)


def test_a_report_names_the_bone_that_was_held_back_most(limited):
    made, sag = limited["responses"]
    t = np.arange(60) / 120
    simulation = made.simulation(sag)
    frames = moving(np.zeros(60), 0.3 * np.sin(2 * np.pi * 6 * t))
    simulation.start(frames[0], frames[1], made.neutral)
    report = simulation.advance(frames[1:], np.repeat(made.neutral[None], 59, axis=0))
    assert report.excess_bone == 1 and report.excess > 1.0
    free = made.simulation()
    free.start(frames[0], frames[1], made.neutral)
    assert free.advance(frames[1:], np.repeat(made.neutral[None], 59, axis=0)).excess_bone == -1


@pytest.mark.parametrize("kind", KINDS)
def test_what_was_found_of_a_skin_serves_other_distances_and_processes(kind):
    made = Bar(kind)
    painted = np.linspace(0.3, 1.0, len(made.nodes))
    found = pickle.loads(pickle.dumps(made.limit(1.0, painted).tissue))
    frames = moving(0.3 * np.sin(np.arange(40) / 3.0))
    given, looked_for = (made.simulation(limit=made.limit(0.02, painted, tissue=tissue)) for tissue in (found, None))
    for simulation in (given, looked_for):
        made.run(simulation, frames)
    assert looked_for.excess.max() > 1.0
    np.testing.assert_array_equal(given.coordinates, looked_for.coordinates)
    np.testing.assert_array_equal(given.excess, looked_for.excess)


def test_what_was_found_of_another_skin_is_refused():
    made = Bar("responses")
    good = made.limit(0.02).tissue.__getstate__()
    bone = good[5][0]
    bad = {
        0: (0.0, np.nan),
        1: ([-1, *good[1][1:]], [2**30, *good[1][1:]], good[1][1:]),
        2: (np.full_like(good[2], np.nan), good[2][1:]),
        3: ([2**30, *good[3][1:]], good[3][1:]),
        4: (np.full_like(good[4], np.inf), good[4][1:]),
        5: (good[5][1:], [(bone[0] + 2**30, *bone[1:]), *good[5][1:]], [(*bone[:2], np.nan), *good[5][1:]],
            [(bone[0], np.zeros((1, 2), np.int32), bone[2]), *good[5][1:]]),
    }  # fmt: skip
    for k, parts in bad.items():
        for part in parts:
            other = dynamorph.LimitedTissue.__new__(dynamorph.LimitedTissue)
            other.__setstate__((*good[:k], part, *good[k + 1 :]))
            with pytest.raises(ValueError, match="tissue: it is of another skin"):
                made.limit(0.02, tissue=other)
    for state in ((), good[:5], (*good[:1], "text", *good[2:]), (*good[:5], None)):
        with pytest.raises(ValueError, match="state: it is none of a limited tissue"):
            dynamorph.LimitedTissue.__new__(dynamorph.LimitedTissue).__setstate__(state)
