# SPDX-License-Identifier: GPL-3.0-or-later
"""What a bake simulates: its start, how it resumes, loops, and the effect of gains and motion amounts on the modes."""

import re
import time
from dataclasses import replace

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.core.model import build
from bl_ext.user_default.dynamic_morph_targets.core.motion import loops, simulate
from bl_ext.user_default.dynamic_morph_targets.core.motion.baked import digest
from bl_ext.user_default.dynamic_morph_targets.core.motion.player import Frame, Player
from bl_ext.user_default.dynamic_morph_targets.io import cache_dir
from bl_ext.user_default.dynamic_morph_targets.run.bake import bake_input, batch
from bl_ext.user_default.dynamic_morph_targets.run.bake import job as run_job
from bl_ext.user_default.dynamic_morph_targets.scene.check import checks
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from bl_ext.user_default.dynamic_morph_targets.write.bake import influence, reading, writer
from builders import activate, evaluated_points, fingerprint, rig_of, skinning_of

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")


@pytest.fixture
def shot(soft_arm):
    """A coarse arm that was baked: the job with its model, character, rig and settings."""
    soft_arm.dynamorph.model.cage_nodes = 200
    soft_arm.dynamorph.model.modes = 8
    for target in soft_arm.dynamorph.targets:
        target.mass_damping = 6.0  # comes to rest within the tests' few frames
    job = run_job.Job(soft_arm, goal="BAKE")
    batch.run(job)
    return job


def simulated(shot, rig=None, **settings):
    """Coordinates (F, dofs) of the shot, with other settings."""
    rig = rig or shot.computation.rig
    frames = simulate.simulate(
        shot.outcome.model, shot.outcome.character, rig, replace(shot.input.settings, **settings)
    )
    return np.array([frame.coordinates for frame in frames])


def played(player, shot, frames):
    """Coordinates of `frames`, requested one by one as playback does."""
    substeps = shot.input.settings.substeps
    out = []
    for frame in frames:
        first = 1 + (frame - shot.input.settings.frame_start - 1) * substeps
        out.append(player.advance(shot.computation.rig[first : first + substeps], frame).coordinates)
    return np.array(out)


def test_playback_frame_by_frame_is_the_bake(shot):
    player = Player(shot.outcome.model, shot.outcome.character, shot.input.settings)
    begun = player.begin(shot.computation.rig[:2])
    assert begun.number == 1 and np.array_equal(begun.coordinates, shot.outcome.bake.coordinates[0])
    assert np.array_equal(played(player, shot, range(2, 21)), shot.outcome.bake.coordinates[1:])


def test_exchange_goes_on_with_other_materials(shot):
    player = Player(shot.outcome.model, shot.outcome.character, shot.input.settings)
    player.begin(shot.computation.rig[:2])
    before = played(player, shot, range(2, 11))
    same = player.exchange(shot.outcome.character)
    sets = shot.outcome.character.target_sets[0]
    soft = tuple(replace(t, material=replace(t.material, stiffness=2e3)) for t in sets.targets)
    other = player.exchange(replace(shot.outcome.character, authored_sets=(replace(sets, targets=soft),)))
    assert np.array_equal(other.state.coordinates[0], before[-1])
    unchanged, softer = played(same, shot, range(11, 21)), played(other, shot, range(11, 21))
    assert np.allclose(unchanged, shot.outcome.bake.coordinates[10:], rtol=0, atol=1e-9 * np.abs(unchanged).max())
    assert np.abs(softer - unchanged).max() > 0.1 * np.abs(unchanged).max()


def test_static_morph_targets_play_too(shot):
    character = shot.outcome.character.with_settings(method="STATIC")
    player = simulate.Player(build.build(character), character, shot.input.settings)
    assert player.begin(shot.computation.rig[:2]).weights == pytest.approx([1, 0])
    frame = player.advance(shot.computation.rig[-shot.input.settings.substeps :], 2)
    assert frame.weights == pytest.approx([0, 1]) and player.shown(frame).shape == (0,)


def test_gains_scale_the_motion_about_the_targets(shot):
    gains = (0.0, 2.0)
    player = Player(shot.outcome.model, shot.outcome.character, replace(shot.input.settings, gains=gains))
    frame = Frame(9, shot.outcome.bake.coordinates[8], shot.outcome.bake.weights[8], {})
    static = shot.outcome.bake.weights[8] @ shot.outcome.model.target_coordinates(
        shot.outcome.model.engine(shot.outcome.character)
    )
    motion = frame.coordinates - static
    assert np.abs(motion).min() > 0
    assert player.shown(frame) - static == pytest.approx([0.0, 2 * motion[1], *motion[2:]])
    player.amounts.gains = np.zeros(8)
    assert player.shown(frame) == pytest.approx(static)


@pytest.mark.parametrize("change", [{}, {"solver": "FULL", "modes": 3}, {"method": "STATIC"}])
def test_without_motion_a_bake_shows_the_targets_shapes(shot, change):
    """This holds even for an unreduced one, whose few modes are chosen for the motion."""
    character = shot.outcome.character.with_settings(**change)
    bake, _ = simulate.bake(build.build(character), character, shot.computation.rig, shot.input.settings)
    shapes = np.array([target.shape for target in character.targets])
    still = replace(bake, coordinates=bake.static)
    for k in (0, 10, 19):
        expected = np.tensordot(bake.weights[k], shapes, 1)
        assert np.abs(still.displacement(k) - expected).max() < 1e-6 * size(shot)
    if not change:
        assert np.abs(bake.displacement(10) - still.displacement(10)).max() > 1e-3 * size(shot)


def test_gains_are_baked(shot):
    settings = replace(shot.input.settings, gains=(0.0,) * 5 + (0.5,) * 9)
    bake, _ = simulate.bake(shot.outcome.model, shot.outcome.character, shot.computation.rig, settings)
    motion, before = bake.coordinates - bake.static, shot.outcome.bake.coordinates - shot.outcome.bake.static
    assert np.allclose(motion, before * [0, 0, 0, 0, 0, 0.5, 0.5, 0.5])


@pytest.mark.parametrize("change", [{}, {"solver": "FULL", "modes": 40}, {"method": "STATIC"}])
def test_motion_amounts_of_the_targets_say_how_much_shows(shot, change):
    """Each counts fully in its pose; in between, each contributes by its weight."""
    character = shot.outcome.character.with_settings(**change)
    model = build.build(character)

    def motion(*amounts):
        sets = character.target_sets[0]
        targets = tuple(replace(t, motion_amount=value) for t, value in zip(sets.targets, amounts, strict=True))
        shown = replace(character, authored_sets=(replace(sets, targets=targets),))
        assert build.stale_reasons(model, shown) == []
        bake, _ = simulate.bake(model, shown, shot.computation.rig, shot.input.settings)
        return np.tensordot(bake.coordinates - bake.static, bake.modes, 1), bake.weights

    whole, weights = motion(1.0, 1.0)
    largest = np.abs(whole).max(initial=0.0)
    assert weights[0] == pytest.approx([1, 0]) and weights[-1] == pytest.approx([0, 1])
    for amounts in ((0.0, 0.0), (1.0, 0.0), (0.0, 0.7)):
        shown = (weights @ amounts)[:, None, None] * whole
        assert motion(*amounts)[0] == pytest.approx(shown, abs=1e-5 * largest)
    assert largest > 1e-3 * size(shot) or "method" in change


# How it begins -----------------------------------------------------------------------------------------------------


def standing(shot, frames=20):
    """The rig standing in its pose in the middle of the shot, between the targets, where gravity sags the tissue."""
    count = 1 + (frames - 1) * shot.input.settings.substeps
    rig = shot.computation.rig
    middle = rig[len(rig) // 2 :][:1]
    return type(rig)(*(np.repeat(a, count, axis=0) for a in (middle.pose, middle.rig_world, middle.object_world)))


def test_settle_begins_in_balance(shot):
    settled = simulated(shot, standing(shot), initial_state="SETTLED")
    assert np.abs(settled - settled[0]).max() < 1e-6 * np.abs(settled[0]).max()


def test_rest_begins_with_the_targets_shapes_and_then_sags(shot):
    player = Player(
        shot.outcome.model, shot.outcome.character, replace(shot.input.settings, initial_state="REST_SHAPE")
    )
    begun = player.begin(standing(shot))
    assert np.array_equal(begun.coordinates, player.static(begun.weights))
    free, settled = (
        simulated(shot, standing(shot), initial_state="REST_SHAPE"),
        simulated(shot, standing(shot), initial_state="SETTLED"),
    )
    assert np.array_equal(free[0], begun.coordinates)
    assert np.abs(free[-1] - free[0]).max() > 0.1 * np.abs(settled[0] - free[0]).max() > 0


def test_rest_knows_no_motion_before_the_start(shot):
    """A rig that already moves at the start hits tissue that begins at rest, and carries along tissue that settled."""
    rig, still = shot.computation.rig, dict.fromkeys(["gravity"], (0.0, 0.0, 0.0))
    world = np.array(rig.rig_world)
    world[:, 0, 3] += 3.0 * np.arange(len(world)) * shot.input.settings.step  # 3 m/s along x
    moving = replace(standing(shot), rig_world=world, object_world=world)
    rest, settled = (simulated(shot, moving, initial_state=state, **still) for state in ("REST_SHAPE", "SETTLED"))
    assert np.abs(settled - settled[0]).max() < 1e-6
    assert np.abs(rest - rest[0]).max() > 100 * np.abs(settled - settled[0]).max() + 1e-4


# Run-up ------------------------------------------------------------------------------------------------------------


@pytest.fixture
def swaying(shot, soft_arm):
    """The arm whose rig also sways sideways over frames 1 to 60."""
    rig = rig_of(soft_arm)
    soft_arm.parent = rig
    for frame in range(1, 61, 6):
        rig.location.x = 0.15 * np.sin(0.35 * frame)
        rig.keyframe_insert("location", frame=frame)
    return soft_arm


def baked(obj, frames, run_up=0, **job):
    """A job that baked these frames."""
    job = run_job.Job(obj, "BAKE", frames, changes={"run_up": run_up}, **job)
    batch.run(job)
    return job


def test_a_run_up_is_what_came_before(shot, swaying):
    """With the same first frame they agree to the last bit; with a later one, to a hundredth of the motion, as the
    slowest swing dies away in 40 frames.
    """
    bake = baked(swaying, (1, 60)).outcome.bake
    whole, motion = bake.coordinates, np.abs(bake.coordinates - bake.static).max()
    same = baked(swaying, (50, 60), run_up=49)
    assert same.outcome.bake.frames.tolist() == list(range(50, 61))
    assert np.array_equal(same.outcome.bake.coordinates, whole[49:])
    later = baked(swaying, (50, 60), run_up=40).outcome.bake.coordinates
    assert later == pytest.approx(whole[49:], abs=1e-2 * motion)
    alone = baked(swaying, (50, 60)).outcome.bake.coordinates
    assert np.abs(alone[0] - whole[49]).max() > 0.1 * motion


def test_a_run_up_comes_in_chunks_too(shot, swaying, tmp_path, monkeypatch):
    whole = baked(swaying, (50, 60), run_up=20)
    caches = cache_dir.CacheDir(tmp_path)
    monkeypatch.setattr(bake_input, "CHUNK_FRAMES", 7)
    stretched = baked(swaying, (50, 60), run_up=20)
    monkeypatch.setattr(bake_input, "SHORT_CHUNK_FRAMES", 7)
    job = run_job.Job(swaying, "BAKE", (50, 60), cache_dir=caches, changes={"run_up": 20})
    steps = batch.Batch([job], "BAKE").steps()
    next(steps)
    while not (hasattr(job, "computation") and job.computation.shot and job.computation.shot.done == 15):  # two chunks
        next(steps)
    job.progress.canceled = True
    with pytest.raises(errors.Cancelled):
        list(steps)
    resumed = run_job.Job(swaying, "BAKE", (50, 60), cache_dir=caches, changes={"run_up": 20})
    batch.run(resumed)
    assert len(resumed.input.resumed["coordinates"]) >= 8
    for job in (stretched, resumed):
        assert np.array_equal(job.outcome.bake.coordinates, whole.outcome.bake.coordinates)
        assert job.outcome.report["steps"] == whole.outcome.report["steps"] == 30 * job.input.settings.substeps


def test_a_run_up_follows_extrapolated_curves(shot, soft_arm):
    """Tissue that begins at rest is calm when the shot begins, although the rig moves at three meters per second."""
    rig = rig_of(soft_arm)
    soft_arm.parent = rig
    rig.animation_data_clear()
    for frame, x in ((1, 0.0), (9, 1.0)):
        rig.location.x = x
        rig.keyframe_insert("location", frame=frame)
    bag = rig.animation_data.action.layers[0].strips[0].channelbag(rig.animation_data.action_slot)
    for curve in bag.fcurves:
        curve.extrapolation = "LINEAR"
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"
    soft_arm.dynamorph.simulation.initial_state, soft_arm.dynamorph.simulation.gravity = "REST_SHAPE", 0.0
    running, hit = baked(soft_arm, (1, 20), run_up=80), baked(soft_arm, (1, 20))
    traveled = running.computation.rig.object_world[:, 0, 3]
    assert traveled == pytest.approx(np.linspace(-10.0, traveled[-1], len(traveled)), abs=1e-5)
    calm, jolt = (np.abs(job.outcome.bake.coordinates - job.outcome.bake.static).max() for job in (running, hit))
    assert calm < 1e-3 * jolt and jolt > 0.0


# Samples between frames --------------------------------------------------------------------------------------------


def gusty(obj):
    """Wind on the arm that changes with the frames."""
    bpy.ops.object.effector_add(type="WIND", rotation=(0.0, np.pi / 2, 0.0))
    wind = bpy.context.object
    for frame, strength in ((1, 0.0), (10, 200.0), (20, 0.0)):
        wind.field.strength = strength
        wind.field.keyframe_insert("strength", frame=frame)
    activate(obj)


def turned_round(obj):
    obj.dynamorph.simulation.loop = True


@pytest.mark.parametrize("samples", [2, 3])
@pytest.mark.parametrize("change", [lambda obj: None, gusty, turned_round])
def test_samples_between_frames_change_nothing_at_the_frames(shot, soft_arm, change, samples):
    """They agree to the last bit, as the steps have the same length."""
    change(soft_arm)
    whole = baked(soft_arm, (1, 20), substeps=6)
    soft_arm.dynamorph.simulation.samples = samples
    fine = baked(soft_arm, (1, 20), substeps=6)
    assert fine.outcome.bake.frames == pytest.approx(np.arange(19 * samples + 1) / samples + 1)
    for name in ("frames", "coordinates", "weights", "static"):
        assert np.array_equal(getattr(fine.outcome.bake, name)[::samples], getattr(whole.outcome.bake, name)), name
    between = fine.outcome.bake.coordinates[samples // 2 :: samples]
    middle = (whole.outcome.bake.coordinates[1:] + whole.outcome.bake.coordinates[:-1]) / 2
    assert np.abs(between - middle).max() > 1e-3 * np.abs(middle).max()  # they are not merely interpolated
    assert fine.outcome.report["steps"] == whole.outcome.report["steps"]
    assert fine.summary().startswith("20 frames in ")


def test_the_summary_tells_the_time_that_was_waited(shot, soft_arm):
    """Also what Blender did meanwhile."""
    job = run_job.Job(soft_arm, goal="BAKE")
    batch.run(job, tick=lambda _: time.sleep(0.3))
    seconds = float(re.search(r"frames in ([\d.]+)", job.summary())[1])
    assert seconds > sum(job.progress.seconds.values()) + 0.2


def test_substeps_are_rounded_up_to_the_samples(shot, soft_arm):
    soft_arm.dynamorph.simulation.samples = 4
    assert baked(soft_arm, (1, 3)).input.settings.substeps == 8  # of 5
    assert baked(soft_arm, (1, 3), substeps=9).input.settings.substeps == 12
    with pytest.raises(ValueError, match="multiple of samples"):
        replace(shot.input.settings, substeps=5, samples=2)


def test_samples_come_in_chunks_and_have_a_run_up_too(shot, swaying, monkeypatch):
    swaying.dynamorph.simulation.samples = 2
    whole = baked(swaying, (30, 50), run_up=15)
    assert whole.outcome.bake.frames[:3].tolist() == [30.0, 30.5, 31.0] and len(whole.outcome.bake.coordinates) == 41
    monkeypatch.setattr(bake_input, "CHUNK_FRAMES", 4)
    stretched = baked(swaying, (30, 50), run_up=15)
    assert np.array_equal(stretched.outcome.bake.coordinates, whole.outcome.bake.coordinates)
    assert len(stretched.computation.rig) <= 4 * stretched.input.settings.substeps


@pytest.mark.parametrize("done", [2, 5, 20])
def test_samples_resume_where_another_process_stopped(shot, done):
    settings = replace(shot.input.settings, substeps=5, samples=5)
    whole = simulate.Shot(shot.outcome.model, shot.outcome.character, settings)
    whole.play(shot.computation.rig)
    begun, other = (simulate.Shot(shot.outcome.model, shot.outcome.character, settings) for _ in range(2))
    begun.play(shot.computation.rig[: 1 + (done - 1) * 5])
    other.resume(begun.kept(), shot.computation.rig[:1])
    assert settings.reached(other.done) == done
    if not other.is_complete:
        other.play(shot.computation.rig[1 + (done - 1) * 5 :])
    (bake, report), (expected, full) = other.bake(), whole.bake()
    assert np.array_equal(bake.coordinates, expected.coordinates) and report["steps"] == full["steps"]


def test_warnings_name_whole_frames(shot):
    settings = replace(shot.input.settings, samples=shot.input.settings.substeps)
    world = np.array(shot.computation.rig.rig_world)
    world[3 * settings.substeps + 2 :, 0, 3] += 50.0  # a cut between frames 4 and 5
    cut = replace(shot.computation.rig, rig_world=world, object_world=world)
    _, report = simulate.bake(shot.outcome.model, shot.outcome.character, cut, settings)
    assert [text for text in report["warnings"] if "jumps" in text] == [
        "The rig jumps at frame 5: the soft skin was carried along"
    ]


def test_blender_shows_the_samples_at_sub_frames(shot, soft_arm):
    """Blender has keyframes there, for motion blur."""
    soft_arm.dynamorph.simulation.samples = 2
    job = baked(soft_arm, (1, 20))
    rest = shot.outcome.character.vertices
    soft_arm.modifiers["Armature"].show_viewport = False
    for k in (0, 1, 9, 10, 38):
        bpy.context.scene.frame_set(1 + k // 2, subframe=k % 2 / 2)
        assert np.abs(evaluated_points(soft_arm) - rest - job.outcome.bake.displacement(k)).max() < 1e-5 * size(shot)
    swing = (
        job.outcome.bake.displacement(9) - (job.outcome.bake.displacement(8) + job.outcome.bake.displacement(10)) / 2
    ) / size(shot)
    assert np.abs(swing).max() > 1e-4


# Loops -------------------------------------------------------------------------------------------------------------


def cyclic(shot, frames=12, travel=0.0, closed=True):
    """The rig sways and bends once, or nearly once, while it travels along y, in meters."""
    count = 1 + (frames - 1) * shot.input.settings.substeps
    phase = np.linspace(0.0, 1.0 if closed else 0.9, count)
    rig = standing(shot, frames)
    world = np.array(rig.rig_world)
    world[:, 0, 3] += 0.1 * np.sin(2 * np.pi * phase)
    world[:, 1, 3] += travel * np.linspace(0.0, 1.0, count)
    pose = np.array(rig.pose)
    bend = 0.3 * np.sin(2 * np.pi * phase)
    turn = np.zeros((count, 4, 4))
    turn[:, 0, 0] = turn[:, 3, 3] = 1.0
    turn[:, 1, 1] = turn[:, 2, 2] = np.cos(bend)
    turn[:, 2, 1], turn[:, 1, 2] = np.sin(bend), -np.sin(bend)
    pose[:, 1] = pose[:, 1] @ turn
    return replace(rig, pose=pose, rig_world=world, object_world=world)


def looped(shot, rig, **settings):
    frames = (len(rig) - 1) // shot.input.settings.substeps + 1
    settings = replace(
        shot.input.settings, frame_end=shot.input.settings.frame_start + frames - 1, loop=True, **settings
    )
    return simulate.bake(shot.outcome.model, shot.outcome.character, rig, settings)


def size(shot):
    return np.linalg.norm(np.ptp(shot.outcome.character.vertices @ shot.outcome.character.to_bind.T, axis=0))


@pytest.mark.parametrize("travel", [0.0, 1.0])
def test_a_loop_closes(shot, travel):
    rig = cyclic(shot, travel=travel)
    bake, report = looped(shot, rig)
    apart = np.linalg.norm(
        (bake.displacement(11) - bake.displacement(0)) @ shot.outcome.character.to_bind.T, axis=1
    ).max()
    assert apart <= report["gap"] * (1 + 1e-6) and report["gap"] <= 1e-6 * size(shot)
    assert report["warnings"] == [] and report["steps"] == 11 * shot.input.settings.substeps
    once = replace(shot.input.settings, frame_end=shot.input.settings.frame_start + 11)
    single, _ = simulate.bake(shot.outcome.model, shot.outcome.character, rig, once)
    assert np.abs(single.displacement(11) - single.displacement(0)).max() > 10 * report["gap"]


def test_a_loop_whose_motion_is_limited_closes(shot):
    """What the limit keeps of the past, one number a bone, is part of the cycle."""
    rig = cyclic(shot)
    free, _ = looped(shot, rig)
    farthest = max(np.abs(free.displacement(k)).max() for k in range(12)) / size(shot)
    bake, report = looped(shot, rig, max_displacement=0.2 * farthest)
    assert report["gap"] <= 1e-6 * size(shot) and report["warnings"] == []
    assert max(np.abs(bake.displacement(k)).max() for k in range(12)) / size(shot) < 0.5 * farthest


def test_newtons_method_finds_the_same_loop(shot, monkeypatch):
    """The fallback for tissue that is too soft for accelerated passes."""
    rig, settings = cyclic(shot), replace(shot.input.settings, frame_end=12, loop=True)
    found = []
    monkeypatch.setattr(loops, "PLAIN", 1)  # more would find it
    for passes in (40, 0):
        monkeypatch.setattr(loops, "ACCELERATED", passes)
        player = Player(shot.outcome.model, shot.outcome.character, settings)
        frames, gap = loops.cycle(player, rig)
        assert gap <= 1e-6 * size(shot) and loops.PLAIN < player.passes < loops.PASSES  # so that a step was taken
        found.append(np.array([frame.coordinates for frame in frames]))
    assert found[1] == pytest.approx(found[0], abs=1e-4 * np.abs(found[0]).max())


def test_a_loop_closes_in_velocity_too(shot):
    """Undamped tissue passes its starting place long before it does so with the same velocity."""
    rig = cyclic(shot)
    sets = shot.outcome.character.target_sets[0]
    springy = {"stiffness": 1e6, "mass_damping": 0.0, "stiffness_damping": 0.0}
    targets = tuple(replace(t, material=replace(t.material, **springy)) for t in sets.targets)
    character = replace(shot.outcome.character, authored_sets=(replace(sets, targets=targets),))
    settings = replace(shot.input.settings, frame_end=12, loop=True)

    player = Player(shot.outcome.model, character, settings)
    frames, gap = loops.cycle(player, rig)
    assert gap <= 1e-6 * size(shot)
    assert player.passes < loops.PASSES
    substeps = settings.substeps  # the player has advanced by a frame: it plays the same cycle again
    following = list(player.play(rig[1 + substeps :], settings.frames[2:]))
    again = np.array([frame.coordinates for frame in following])
    first = np.array([frame.coordinates for frame in frames])
    assert again == pytest.approx(first[2:], abs=5e-5 * np.abs(first).max())
    assert gap >= player.gap(frames[0], frames[-1])
    settled = next(Player(shot.outcome.model, character, settings).run(rig))
    assert player.gap(settled, frames[0]) > 1e2 * gap


class Map:
    """Stands in for a loop: an affine map of six numbers."""

    def __init__(self, factor):
        random = np.random.default_rng(0)
        turn, _ = np.linalg.qr(random.normal(size=(6, 6)))
        self.matrix, self.shift = factor * turn, random.normal(size=6)
        self.began, self.passes, self.off = np.zeros((1, 6)), 0, np.full(6, np.inf)

    @property
    def is_closed(self):
        return np.abs(self.off).max() < 1e-8

    def __call__(self, began):
        self.passes += 1
        ended = began @ self.matrix + self.shift
        self.off = (ended - began)[0]
        return ended


def test_a_fixed_point_is_found_in_as_many_passes_as_it_has_dimensions():
    """Passes alone would need thousands."""
    loop = Map(0.999)
    assert loops.repeat_accelerated(loop)
    assert loop.passes <= 9


@pytest.mark.parametrize("factor", [0.999, 1.5, 0.0])
def test_newtons_method_finds_fixed_points(factor):
    """Passes alone hardly approach some of them, move away from others, and reach one at once."""
    loop = Map(factor)
    loops.solve_by_newton(loop)
    assert loop.is_closed
    assert loop.passes < 60


@pytest.mark.parametrize("frames", [12, 1])
def test_static_morph_targets_loop_too(shot, frames):
    character = shot.outcome.character.with_settings(method="STATIC")
    settings = replace(shot.input.settings, frame_end=frames, loop=True)
    rig = cyclic(shot, closed=False)[: 1 + (frames - 1) * settings.substeps]
    bake, report = simulate.bake(build.build(character), character, rig, settings)
    assert len(bake.weights) == frames and len(report["warnings"]) == (frames > 1)


def test_a_loop_is_what_many_cycles_approach(shot):
    rig = cyclic(shot, travel=0.5)
    bake, _ = looped(shot, rig)
    cycles = 40
    world = np.concatenate([rig.rig_world[:-1] + c * (rig.rig_world[-1] - rig.rig_world[0]) for c in range(cycles)])
    pose = np.concatenate([rig.pose[:-1]] * cycles)
    long = replace(rig, pose=pose, rig_world=world, object_world=world)[
        : 1 + 11 * cycles * shot.input.settings.substeps
    ]
    long = long[: 1 + (11 * cycles - 1) * shot.input.settings.substeps]
    motion = simulated(shot, long, frame_end=shot.input.settings.frame_start + 11 * cycles - 1)
    assert bake.coordinates[:-1] == pytest.approx(motion[-11:], abs=1e-4 * np.abs(motion).max())


def test_a_loop_closes_whatever_its_targets_hide(shot):
    """Even where the targets hide the motion at the seam it must be periodic, because it shows elsewhere."""
    sets = shot.outcome.character.target_sets[0]
    hidden = tuple(replace(t, motion_amount=k) for k, t in enumerate(sets.targets))
    character = replace(shot.outcome.character, authored_sets=(replace(sets, targets=hidden),))
    rig, settings = (
        cyclic(shot),
        replace(shot.input.settings, frame_end=shot.input.settings.frame_start + 11, loop=True),
    )
    (bake, report), (open_, before) = (
        simulate.bake(shot.outcome.model, each, rig, settings) for each in (character, shot.outcome.character)
    )
    assert report["gap"] == before["gap"]
    assert np.abs(bake.displacement(11) - bake.displacement(0)).max() < 1e-6 * size(shot)
    shown = open_.static + open_.weights[:, 1:] * (open_.coordinates - open_.static)
    assert bake.coordinates == pytest.approx(shown, abs=1e-9)


def test_a_pose_that_is_no_cycle_is_named(shot):
    _, report = looped(shot, cyclic(shot, closed=False))
    assert len(report["warnings"]) == 1 and "off its pose at frame 1: end the loop" in report["warnings"][0]


def test_a_loop_reports_its_passes_and_can_be_canceled(shot):
    dynamorph = pytest.importorskip("dynamorph")
    seen = []

    def progress(fraction, message):
        seen.append((fraction, message))
        return "pass 3" not in message

    settings = replace(shot.input.settings, frame_end=12, loop=True)
    with pytest.raises(dynamorph.Cancelled):
        simulate.bake(shot.outcome.model, shot.outcome.character, cyclic(shot), settings, progress)
    fractions = [fraction for fraction, _ in seen]
    assert fractions == sorted(fractions) and fractions[-1] < 1.0
    assert seen[-1][1] == "Simulating frame 2, pass 3"


# Stretches ---------------------------------------------------------------------------------------------------------


@pytest.mark.fault("A09")
@pytest.mark.parametrize("frames", [1, 3, 7, 19])
def test_a_shot_in_chunks_is_the_shot(soft_arm, shot, frames, monkeypatch):
    """The bytes are the same however long the chunks are; the rig is read again for each."""
    monkeypatch.setattr(bake_input, "CHUNK_FRAMES", frames)
    job = run_job.Job(soft_arm, goal="BAKE")
    batch.run(job)
    for name in ("frames", "coordinates", "weights", "static"):
        assert np.array_equal(getattr(job.outcome.bake, name), getattr(shot.outcome.bake, name)), name
    assert (
        job.outcome.report["steps"] == shot.outcome.report["steps"]
        and job.outcome.report["energy"] == shot.outcome.report["energy"]
    )


@pytest.mark.fault("A09")
@pytest.mark.parametrize("done", [2, 4, 10, 20])
def test_a_shot_resumes_where_another_process_stopped(shot, done):
    substeps = shot.input.settings.substeps
    begun = simulate.Shot(shot.outcome.model, shot.outcome.character, shot.input.settings)
    begun.play(shot.computation.rig[: 1 + (done - 1) * substeps])
    kept = {name: array.copy() for name, array in begun.kept().items()}
    other = simulate.Shot(shot.outcome.model, shot.outcome.character, shot.input.settings)
    other.resume(kept, shot.computation.rig[:1])
    assert other.done == done
    other.play(shot.computation.rig[1 + (done - 1) * substeps :])
    bake, report = other.bake()
    assert np.array_equal(bake.coordinates, shot.outcome.bake.coordinates)
    assert report["steps"] == shot.outcome.report["steps"] and report["iterations"] == shot.outcome.report["iterations"]


# A part of a bake again ----------------------------------------------------------------------------------------------


def shown_at(obj, frames):
    """The mesh (F, V, 3) as Blender shows it, world space."""
    out = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        out.append(evaluated_points(obj))
    return np.array(out)


def rebaked(obj, start, end, **more):
    """The job that bakes these frames into the rest."""
    simulation = obj.dynamorph.simulation
    simulation.use_scene_range, simulation.keep_outside = False, True
    simulation.frame_start, simulation.frame_end = start, end
    job = run_job.Job(obj, goal="BAKE", **more)
    batch.run(job)
    return job


@pytest.mark.fault("A10")
def test_a_range_is_baked_into_the_rest(scene, shot, soft_arm):
    before = shown_at(soft_arm, range(1, 21))
    same = rebaked(soft_arm, 8, 15)
    assert same.outcome.report["seam"] < 1e-5
    assert np.abs(shown_at(soft_arm, range(1, 21)) - before).max() < 1e-5
    assert len(same.outcome.written[0][0].modes) <= len(shot.outcome.bake.modes) + 2

    lower = rig_of(soft_arm).pose.bones["lower"]
    for frame, angle in ((1, 0.0), (10, 0.0), (12, 0.5), (14, 0.0), (20, 0.0)):
        lower.rotation_euler.y = angle
        lower.keyframe_insert("rotation_euler", index=1, frame=frame)
    job = rebaked(soft_arm, 6, 20)
    assert job.input.settings.run_up == 5  # as far back as the bake goes, otherwise one second
    assert staleness.outdated(soft_arm) == []
    mixed = shown_at(soft_arm, range(1, 21))
    assert [float(frame) for frame in reading.read_back(soft_arm).frames] == list(range(1, 21))
    soft_arm.dynamorph.simulation.keep_outside = False
    soft_arm.dynamorph.simulation.frame_start = 1
    batch.run(run_job.Job(soft_arm, goal="BAKE"))
    whole = shown_at(soft_arm, range(1, 21))
    assert np.abs(mixed - whole)[10:].max() < 1e-5
    assert np.abs(mixed - whole)[:10].max() < 0.05 * np.abs(whole - before).max()


def test_frames_that_do_not_adjoin_are_refused(shot, soft_arm):
    words = "frames 40 to 50 are not next to those of the last bake, 1 to 20"
    with pytest.raises(errors.SceneError, match=words):
        rebaked(soft_arm, 40, 50)


def test_a_bake_is_made_longer(shot, soft_arm):
    """It is as if it had been baked in one piece: there is nothing to blend with."""
    rig_of(soft_arm).pose.bones["lower"].rotation_euler.x = 0.5
    rig_of(soft_arm).pose.bones["lower"].keyframe_insert("rotation_euler", frame=30)
    batch.run(run_job.Job(soft_arm, goal="BAKE"))
    assert len(rebaked(soft_arm, 21, 24).outcome.bake.frames) == 24
    longer = shown_at(soft_arm, range(1, 25))
    soft_arm.dynamorph.simulation.frame_start, soft_arm.dynamorph.simulation.keep_outside = 1, False
    batch.run(run_job.Job(soft_arm, goal="BAKE"))
    assert np.abs(longer - shown_at(soft_arm, range(1, 25))).max() < 1e-5


def test_a_range_is_baked_into_another_format(shot, soft_arm, tmp_path):
    before = shown_at(soft_arm, range(1, 21))
    strip = influence.influence_strip(soft_arm)
    strip.influence = 0.0
    influence.show_influence(soft_arm)
    still = shown_at(soft_arm, range(1, 21))
    strip.influence = 1.0
    soft_arm.dynamorph.output.format = "PC2"
    rebaked(soft_arm, 8, 15, folder=tmp_path)
    assert soft_arm.data.shape_keys.key_blocks["flexed"].mute
    assert np.abs(shown_at(soft_arm, range(1, 21)) - before).max() < 1e-5
    setattr(*influence.influence(soft_arm), 0.0)
    influence.show_influence(soft_arm)
    assert np.abs(shown_at(soft_arm, range(1, 21)) - still).max() < 1e-5


def test_values_that_are_not_numbers_are_refused_before_keys_are_made(shot, soft_arm, tmp_path, monkeypatch):
    """They are also refused before the file of a point cache is written."""
    job = run_job
    whole = simulate.Shot.bake

    def spoiled(self, exact=False):
        bake, report = whole(self)
        bake.coordinates[3, 0] = np.nan
        return bake, report

    monkeypatch.setattr(simulate.Shot, "bake", spoiled)
    before = fingerprint(soft_arm)
    for kind in ("MODES", "PC2"):
        soft_arm.dynamorph.output.format, soft_arm.dynamorph.output.keys = kind, 4
        with pytest.raises(errors.SelfCheckError, match="'Arm': the engine's coordinates are not numbers"):
            batch.run(job.Job(soft_arm, goal="BAKE", folder=tmp_path))
    assert fingerprint(soft_arm) == before
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_loop_without_finite_numbers_ends(bad):
    loop = Map(0.9)
    loop.shift[2] = bad
    assert not loops.repeat_accelerated(loop)
    loops.solve_by_newton(loop)
    assert loop.passes < 20


def test_what_the_other_frames_were_made_from_is_said(shot, soft_arm):
    record = soft_arm.dynamorph.bake
    soft_arm.dynamorph.targets[1].stiffness *= 2.0
    job = rebaked(soft_arm, 8, 15)
    assert any("other frames" in text and "Stiffness" in text for text in job.warnings)
    assert "Stiffness" in record.warnings
    first = record.content_id
    rebaked(soft_arm, 8, 15)
    assert record.content_id != first  # it was made from another bake


def test_a_patch_keeps_samples_alike(shot, soft_arm):
    soft_arm.dynamorph.simulation.samples = 2
    frames = rebaked(soft_arm, 8, 15).outcome.bake.frames
    np.testing.assert_allclose(frames, np.arange(1.0, 20.5, 0.5))


def test_delete_bake_forgets_a_cache_whose_modifier_was_removed(shot, soft_arm, tmp_path):
    soft_arm.dynamorph.output.format = "PC2"
    batch.run(run_job.Job(soft_arm, goal="BAKE", folder=tmp_path))
    soft_arm.modifiers.remove(soft_arm.modifiers[0])
    writer.free(soft_arm)
    assert not soft_arm.dynamorph.bake.exists


def test_a_point_cache_cannot_be_baked_in_parts(shot, soft_arm, tmp_path):
    soft_arm.dynamorph.output.format = "PC2"
    batch.run(run_job.Job(soft_arm, goal="BAKE", folder=tmp_path))
    with pytest.raises(errors.WriteError, match="bake to shape keys first"):
        rebaked(soft_arm, 8, 15, folder=tmp_path)


@pytest.mark.parametrize("preserve_volume", [False, True])
def test_a_point_cache_is_baked_again(shot, soft_arm, tmp_path, preserve_volume):
    """The bake does not depend on the cache that it plays."""
    soft_arm.modifiers["Armature"].use_deform_preserve_volume = preserve_volume
    soft_arm.dynamorph.output.format = "PC2"
    baked = [run_job.Job(soft_arm, goal="BAKE", folder=tmp_path) for _ in range(2)]
    for job in baked:
        batch.run(job)
    assert digest(baked[0].outcome.bake) == digest(baked[1].outcome.bake)
    assert len(list((tmp_path / "dynamorph_caches").iterdir())) == 1
    assert [modifier.type for modifier in soft_arm.modifiers] == ["MESH_CACHE", "ARMATURE"]
    assert not any("'Dynamorph'" in note.text for note in checks.notes(skinning_of(soft_arm)))
    assert staleness.outdated(soft_arm) == []
