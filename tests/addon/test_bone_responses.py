# SPDX-License-Identifier: GPL-3.0-or-later
"""Models with bone responses, as new soft skins have them: build, Live's player, bake, setups and files from before."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from builders import activate, evaluated_points, part

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
    job = part("job").Job(skin, goal="BAKE")
    part("batch").run(job)
    return job


def displacement(bake) -> np.ndarray:
    return np.array([bake.displacement(k) for k in range(len(bake.frames))])


def off(motion, reference) -> float:
    """RMS of the difference, of the reference's motion about its mean."""
    moving = reference - reference.mean(axis=0)
    return np.linalg.norm(motion - motion.mean(axis=0) - moving) / np.linalg.norm(moving)


def test_new_soft_skins_have_them_and_files_from_before_keep_theirs(arm, soft_arm):
    model = soft_arm.dynamorph.model
    assert (model.basis, model.modes) == ("MODES", 20)  # with_pins, the settings from before
    bpy.ops.object.select_all(action="DESELECT")
    activate(arm)
    fresh = arm.copy()
    fresh.data = arm.data.copy()
    bpy.context.scene.collection.objects.link(fresh)
    while fresh.dynamorph.targets:
        fresh.dynamorph.targets.remove(0)
    activate(fresh)
    bpy.ops.dynamorph.add_soft_skin()
    assert (fresh.dynamorph.model.basis, fresh.dynamorph.model.modes) == ("RESPONSES", 120)


def test_a_sixth_is_tabulated_and_the_targets_fit_in(baked):
    model = baked.model
    assert model.basis.shape[1] == 10 and model.modes.shape[1] == 60
    assert model.summary["modes"] == 60 and model.summary["tabulated"] == 10
    assert len(baked.request.target.find().dynamorph.modes) == 10  # gains are of those
    few = baked.character.with_settings(modes=4)
    built = part("build").build(few)
    assert built.basis.shape[1] >= 2 and built.responses.shape[1] >= 1


def test_playback_frame_by_frame_is_the_simulation(baked):
    simulate, substeps = part("simulate"), baked.settings.substeps
    whole = list(simulate.simulate(baked.model, baked.character, baked.computation.rig, baked.settings))
    player = part("player").Player(baked.model, baked.character, baked.settings)
    assert np.array_equal(player.begin(baked.computation.rig[:2]).coordinates, whole[0].coordinates)
    for k, frame in enumerate(whole[1:]):
        played = player.advance(baked.computation.rig[1 + k * substeps : 1 + (k + 1) * substeps], int(frame.number))
        assert np.array_equal(played.coordinates, frame.coordinates)


def test_a_bake_has_fewer_keys_and_shows_the_same_to_a_thousandth(skin, baked):
    """As Blender evaluates it."""
    simulate = part("simulate")
    exact, _ = simulate.Shot.bake(played(baked), exact=True)
    assert len(exact.modes) == 60 and len(baked.result.modes) < 25
    assert off(displacement(baked.result), displacement(exact)) < 1.5e-3
    assert np.allclose(baked.result.static @ baked.result.modes.reshape(len(baked.result.modes), -1),
                       exact.static @ exact.modes.reshape(60, -1), atol=1e-9)  # fmt: skip
    scene, key = bpy.context.scene, skin.data.shape_keys
    assert len(key.key_blocks) < 30
    scene.frame_set(10)
    moved = evaluated_points(skin)
    player = part("player").Player(baked.model, baked.character, baked.settings)
    assert np.isfinite(moved).all() and player.size > 0


def played(job):
    shot = part("simulate").Shot(job.model, job.character, job.settings)
    shot.play(job.computation.rig)
    return shot


def test_it_is_closer_to_unreduced_than_the_modes_of_before(baked):
    """The same shot, in the same cage."""
    simulate, build = part("simulate"), part("build")

    def motion(**changes):
        character = baked.character.with_settings(**changes)
        model = build.build(character, previous=baked.model)
        bake, _ = simulate.bake(model, character, baked.computation.rig, baked.settings)
        return displacement(bake)

    full = motion(solver="FULL", modes=len(baked.settings.frames))
    responses, modes = motion(), motion(basis="MODES", modes=20)
    assert off(responses, full) < 0.5 * off(modes, full) and off(responses, full) < 0.12


def test_targets_are_exact(baked):
    """At rest in its pose the skin has the sculpted shape."""
    engine = baked.model.engine(baked.character)
    shapes = baked.model.target_coordinates(engine)
    for j in range(len(shapes)):
        weights = np.eye(len(shapes))[j]
        _, force, stiffness = engine.linearize(weights, shapes[j])
        assert np.linalg.norm(np.linalg.solve(stiffness, force)) < 1e-6 * np.linalg.norm(shapes[1])
        assert engine.displacement(shapes[j]) == pytest.approx(baked.model.displacements[j], abs=1e-7)


def test_materials_change_without_a_build(baked):
    build = part("build")
    stiffer = baked.character.with_materials(
        lambda _index, target: replace(target.material, stiffness=4.0 * target.material.stiffness)
    )
    assert build.stale_reasons(baked.model, stiffer) == []
    rebuilt = build.build(stiffer, previous=baked.model)
    simulate = part("simulate")
    quick, slow = (
        displacement(simulate.bake(model, stiffer, baked.computation.rig, baked.settings)[0])
        for model in (baked.model, rebuilt)
    )
    assert off(quick, slow) < 1e-3


def test_a_model_with_them_is_stored_and_read(baked):
    model_file, model = part("model_file"), part("model")
    arrays, meta = baked.model.to_arrays()
    h = baked.model.responses.shape[1]
    assert arrays["response_mu"].dtype == np.float64 and arrays["response_mu"].shape[1] == h
    assert arrays["coupling_mu"].dtype == np.float32 and arrays["coupling_mu"].shape[1] == h * 10 * 11 // 2
    read = model.Model.from_arrays(*model_file.unpack(model_file.pack(arrays, meta)))
    for name in model.RESPONSE_ARRAYS:
        assert np.array_equal(getattr(read, name), getattr(baked.model, name))
    older = {name: array for name, array in arrays.items() if name not in model.RESPONSE_ARRAYS}
    assert not model.Model.from_arrays(older, meta).responses.size


def test_a_model_whose_coupling_is_in_double_is_simulated_as_before(baked):
    model, simulate = part("model"), part("simulate")
    arrays, meta = baked.model.to_arrays()
    for lame in ("lambda", "mu"):
        arrays[f"response_{lame}"] = np.hstack([arrays[f"response_{lame}"], arrays.pop(f"coupling_{lame}")])
    older = model.Model.from_arrays(arrays, meta)
    first, second = (
        list(simulate.simulate(each, baked.character, baked.computation.rig, baked.settings))[-1].coordinates
        for each in (baked.model, older)
    )
    assert np.array_equal(first, second)


def test_a_setup_from_before_has_the_modes_of_before(skin):
    setups = part("setups")
    setup = setups.of_object(skin)
    assert setup["model"]["basis"] == "RESPONSES"
    del setup["model"]["basis"]
    setup["model"]["modes"] = 15
    setups.apply(skin, setup)
    assert (skin.dynamorph.model.basis, skin.dynamorph.model.modes) == ("MODES", 15)
