# SPDX-License-Identifier: GPL-3.0-or-later
"""Models with bone responses, as new soft skins have them: build, Live's player, bake, setups and files from before."""

import itertools
from dataclasses import replace

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core.model import build
from bl_ext.user_default.dynamic_morph_targets.core.model import model as model_module
from bl_ext.user_default.dynamic_morph_targets.core.motion import simulate
from bl_ext.user_default.dynamic_morph_targets.core.motion.player import Player
from bl_ext.user_default.dynamic_morph_targets.core.settings import ModelSettings
from bl_ext.user_default.dynamic_morph_targets.io import model_file
from bl_ext.user_default.dynamic_morph_targets.run.bake import bake_input
from builders import assert_shows, evaluated_points, make_arm, rig_of
from robustness import bake

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")


@pytest.fixture
def skin(soft_arm):
    """A coarse arm with a target, and modes as a new soft skin has them, but fewer."""
    model = soft_arm.dynamorph.model
    model.cage_nodes, model.basis, model.modes = 400, "RESPONSES", 60
    return soft_arm


@pytest.fixture
def baked(skin):
    """The job of its bake."""
    return bake(skin)


def displacement(bake) -> np.ndarray:
    return np.array([bake.displacement(k) for k in range(len(bake.frames))])


def off(motion, reference) -> float:
    """RMS of the difference, of the reference's motion about its mean."""
    moving = reference - reference.mean(axis=0)
    return np.linalg.norm(motion - motion.mean(axis=0) - moving) / np.linalg.norm(moving)


def test_new_soft_skins_have_them_and_others_keep_their_modes(soft_arm):
    model = soft_arm.dynamorph.model
    assert (model.basis, model.modes) == ("MODES", 20)  # with_pins
    bpy.ops.object.select_all(action="DESELECT")
    fresh = make_arm(bpy.context.scene, "Fresh")
    bpy.ops.dynamorph.add_soft_skin()
    assert (fresh.dynamorph.model.basis, fresh.dynamorph.model.modes) == ("RESPONSES", 120)


def test_a_sixth_is_tabulated(baked):
    model = baked.outcome.model
    assert (model.basis.shape[1], model.responses.shape[1]) == (10, 50)
    assert (model.summary.modes, model.summary.tabulated) == (60, 10)
    assert len(baked.request.target.find().dynamorph.modes) == 10  # gains are of those


def test_few_modes_are_enough_tabulated_ones_for_the_targets(baked):
    """As many as there are sculpts beside the fewest that there may be, and one response."""
    model = build.build(baked.outcome.character.with_settings(modes=4), previous=baked.outcome.model)
    assert (model.basis.shape[1], model.responses.shape[1]) == (9, 1)
    shape = model.displacements[1][model.free].ravel()
    left = shape - model.basis @ np.linalg.lstsq(model.basis, shape, rcond=None)[0]
    assert np.linalg.norm(left) < 1e-9 * np.linalg.norm(shape)


@pytest.mark.parametrize("modes, tabulated", [(4, 4), (40, 8), (120, 20), (400, 30)])
def test_how_many_are_tabulated(modes, tabulated):
    settings = ModelSettings
    assert settings(modes=modes, basis="RESPONSES").tabulated == tabulated
    assert settings(modes=modes, basis="MODES").tabulated == modes


def test_playback_frame_by_frame_is_the_simulation(baked):
    substeps = baked.input.settings.substeps
    whole = list(
        simulate.simulate(baked.outcome.model, baked.outcome.character, baked.computation.rig, baked.input.settings)
    )
    player = Player(baked.outcome.model, baked.outcome.character, baked.input.settings)
    assert np.array_equal(player.begin(baked.computation.rig[:2]).coordinates, whole[0].coordinates)
    for k, frame in enumerate(whole[1:]):
        played = player.advance(baked.computation.rig[1 + k * substeps : 1 + (k + 1) * substeps], int(frame.number))
        assert np.array_equal(played.coordinates, frame.coordinates)


def test_a_bake_has_fewer_keys_and_shows_the_same_to_a_thousandth(skin, baked):
    exact, _ = played(baked).bake(exact=True)
    assert len(exact.modes) == 60 and len(baked.outcome.bake.modes) < 25
    assert off(displacement(baked.outcome.bake), displacement(exact)) < 1.5e-3
    assert np.allclose(baked.outcome.bake.static @ baked.outcome.bake.modes.reshape(len(baked.outcome.bake.modes), -1),
                       exact.static @ exact.modes.reshape(60, -1), atol=1e-9)  # fmt: skip
    assert len(skin.data.shape_keys.key_blocks) < 30
    assert_shows(skin, baked.outcome.bake)


@pytest.mark.parametrize("changes", [{}, {"solver": "FULL"}], ids=["reduced", "full"])
def test_a_bake_of_what_hardly_moves_has_the_targets_shapes(baked, changes):
    """In the target's pose, where nothing is left of the motion but rounding."""
    character = baked.outcome.character.with_settings(**changes)
    model = baked.outcome.model.with_settings(character.settings)
    held = baked.computation.rig[-1:].moved(np.tile(np.eye(4), (1 + 5 * baked.input.settings.substeps, 1, 1)))
    settings = replace(baked.input.settings, frame_end=6)
    engine = model.engine(character)
    frames = list(simulate.simulate(model, character, held, settings))
    whole = np.array([model.surface(engine.displacement(frame.coordinates)) for frame in frames])
    whole += np.tensordot([frame.weights for frame in frames], model.residual_shapes, 1)
    assert np.abs(whole).max() > 0.05
    bake, _ = simulate.bake(model, character, held, settings)
    assert displacement(bake) == pytest.approx(whole, abs=1e-6 * np.abs(whole).max())


def played(job):
    shot = simulate.Shot(job.outcome.model, job.outcome.character, job.input.settings)
    shot.play(job.computation.rig)
    return shot


def as_it_is(_skin):
    pass


def with_a_region(skin):
    """A second set of targets, of the forearm, and more modes for it."""
    bpy.context.scene.frame_set(20)
    bpy.ops.dynamorph.add_target(key="smile")
    bpy.context.scene.frame_set(1)
    skin.dynamorph.active_target.region = "lower"
    skin.dynamorph.model.modes = 150


def with_preserve_volume(skin):
    """Blender poses the nodes, by dual quaternions."""
    skin.modifiers["Armature"].use_deform_preserve_volume = True


KINDS = pytest.mark.parametrize("change", [as_it_is, with_a_region, with_preserve_volume])


@KINDS
def test_it_is_closer_to_unreduced_than_the_modes_of_before(skin, change):
    """The same shot, in the same cage. How close depends on the cage: the middle one of three counts."""
    change(skin)
    responses, modes = np.median([off_by_basis(skin, change, nodes) for nodes in (570, 600, 630)], axis=0)
    assert responses < 0.5 * modes and responses < 0.12


def off_by_basis(skin, change, nodes: int) -> tuple[float, float]:
    """How far the motion with responses, and that with modes, is from the unreduced one."""
    skin.dynamorph.model.cage_nodes = nodes
    baked = bake(skin)
    assert len(baked.outcome.character.target_sets) == 1 + (change == with_a_region)
    assert baked.outcome.character.probed == (change == with_preserve_volume)

    def motion(**changes):
        character = baked.outcome.character.with_settings(**changes)
        model = build.build(character, previous=baked.outcome.model)
        bake, _ = simulate.bake(model, character, baked.computation.rig, baked.input.settings)
        return displacement(bake)

    full = motion(solver="FULL", modes=len(baked.input.settings.frames))
    return off(motion(), full), off(motion(basis="MODES", modes=20), full)


@KINDS
def test_live_shows_what_the_bake_does(skin, change):
    change(skin)
    bpy.ops.dynamorph.build()
    bpy.ops.dynamorph.live()
    live = shown(skin)
    bpy.ops.dynamorph.live()
    bake(skin)
    assert off(shown(skin), live) < 1.5e-3


def shown(skin) -> np.ndarray:
    """The points of the skin (F, V, 3) that Blender shows, frame after frame."""
    points = []
    for frame in range(1, 21):
        bpy.context.scene.frame_set(frame)
        points.append(evaluated_points(skin))
    return np.array(points)


@pytest.mark.parametrize("change", [as_it_is, with_a_region])
def test_targets_are_exact(skin, change):
    """At rest in its pose the skin has the sculpted shape, whatever the other set shows."""
    change(skin)
    baked = bake(skin)
    engine, sets = baked.outcome.model.engine(baked.outcome.character), baked.outcome.character.target_sets
    shapes = baked.outcome.model.target_coordinates(engine)
    for chosen in itertools.product(*(np.eye(len(target_set.targets)) for target_set in sets)):
        weights = np.concatenate(chosen)
        shape = weights @ shapes
        _, force, stiffness = engine.linearize(weights, shape)
        assert np.linalg.norm(np.linalg.solve(stiffness, force)) < 1e-6 * np.linalg.norm(shapes[1])
        expected = np.tensordot(weights, baked.outcome.model.displacements, 1)
        assert engine.displacement(shape) == pytest.approx(expected, abs=1e-7)


def test_a_loop_closes(skin):
    bone = rig_of(skin).pose.bones["lower"]
    for frame, angle in ((1, 0.0), (10, 1.5), (20, 0.0)):
        bone.rotation_euler.x = angle
        bone.keyframe_insert("rotation_euler", frame=frame)
    skin.dynamorph.simulation.loop = True
    looped = bake(skin)
    moving = displacement(looped.outcome.bake)
    exact, _ = played(looped).bake(exact=True)
    whole = displacement(exact)
    assert (
        looped.outcome.report["gap"] < 1e-6 * np.linalg.norm(skin.dimensions) and not looped.outcome.report["warnings"]
    )
    assert np.abs(whole[-1] - whole[0]).max() <= 1.000001 * looped.outcome.report["gap"]
    moves = np.abs(whole - whole.mean(axis=0)).max()
    assert np.abs(moving[-1] - moving[0]).max() < 2e-3 * moves  # with fewer keys
    skin.dynamorph.simulation.loop = False
    once = displacement(bake(skin).outcome.bake)
    assert np.abs(once[-1] - once[0]).max() > 0.02 * moves


def test_they_are_not_fitted_to_a_shot(skin, baked):
    skin.dynamorph.model.fit_to_shot = True
    job = bake(skin)
    assert job.outcome.model.summary.fitted is None and np.array_equal(
        job.outcome.model.responses, baked.outcome.model.responses
    )
    skin.dynamorph.model.basis = "MODES"
    skin.dynamorph.model.modes = 12
    assert bake(skin).outcome.model.summary.fitted == (1, 20)


def test_a_shot_in_chunks_is_the_whole_shot(skin, baked, monkeypatch):
    monkeypatch.setattr(bake_input, "CHUNK_FRAMES", 6)
    again = bake(skin)
    assert len(again.computation.rig) < len(baked.computation.rig)
    for name in ("coordinates", "modes", "static"):
        assert np.array_equal(getattr(again.outcome.bake, name), getattr(baked.outcome.bake, name)), name


def test_materials_change_without_a_build(baked):
    def stiffened(_index, target):
        return replace(target, material=replace(target.material, stiffness=4.0 * target.material.stiffness))

    stiffer = baked.outcome.character.with_targets(stiffened)
    assert build.stale_reasons(baked.outcome.model, stiffer) == []
    rebuilt = build.build(stiffer, previous=baked.outcome.model)
    quick, slow = (
        displacement(simulate.bake(model, stiffer, baked.computation.rig, baked.input.settings)[0])
        for model in (baked.outcome.model, rebuilt)
    )
    assert off(quick, slow) < 1e-3


def test_a_model_with_them_is_stored_and_read(baked):
    model = model_module
    arrays, meta = baked.outcome.model.to_arrays()
    h = baked.outcome.model.responses.shape[1]
    assert arrays["response_mu"].dtype == np.float64 and arrays["response_mu"].shape[1] == h
    assert arrays["coupling_mu"].dtype == np.float32 and arrays["coupling_mu"].shape[1] == h * 10 * 11 // 2
    read = model.Model.from_arrays(*model_file.unpack(model_file.pack(arrays, meta)))
    for name, array in arrays.items():
        assert np.array_equal(getattr(read, name), array)
