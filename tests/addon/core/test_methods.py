# SPDX-License-Identifier: GPL-3.0-or-later
"""What is chosen in the Model panel or on the command line is simulated: methods, regions, force fields."""

import bpy
import dynamorph
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.core.motion import rig_samples
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene import references
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store, staleness
from builders import activate, add_key, assert_shows, rig_of

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

FULL = {"solver": "FULL"}
METHODS = [{"method": method} for method in ("DYNAMIC", "SHAPE", "SINGLE", "STATIC")]
MATERIAL_MODELS = [
    {"material_model": material_model, **solver}
    for material_model in ("LINEAR", "STVK", "STABLE_STVK")
    for solver in ({}, FULL)
]


@pytest.fixture
def arm(soft_arm):
    """The soft arm with a coarse cage, bent quickly to 'flexed', which is ten times as stiff."""
    soft_arm.dynamorph.model.cage_nodes = 150
    soft_arm.dynamorph.model.modes = 8
    soft_arm.dynamorph.model.pin_radius = 0.8  # a cage pinned along one line could spin about it
    soft_arm.dynamorph.targets["flexed"].stiffness = 10 * soft_arm.dynamorph.targets[0].stiffness
    return soft_arm


@pytest.fixture
def two_regions(arm):
    """The arm with another target at its tip, placed by the first bone alone."""
    rest = references.key_points(arm.data.shape_keys.reference_key)
    add_key(arm, "tip", np.outer(rest[:, 2] > 1.8, [0.05, 0.0, 0.0]))
    tip = arm.vertex_groups.new(name="Tip")
    for index, height in enumerate(rest[:, 2]):
        tip.add([index], float(np.clip(3.0 * height - 4.0, 0.0, 1.0)), "REPLACE")
    rig_of(arm).pose.bones["upper"].rotation_euler.y = 0.8
    activate(arm)
    bpy.ops.dynamorph.add_target(key="tip")
    arm.dynamorph.active_target.region = "Tip"
    arm.dynamorph.active_target.set_bones(["upper"])
    rig_of(arm).pose.bones["upper"].rotation_euler.y = 0.0
    return arm


def run(obj, **settings):
    for name, value in settings.items():
        setattr(obj.dynamorph.model, name, value)
    job = Job(obj, goal="BAKE", substeps=3)
    batch.run(job)
    return job


def displacements(job):
    return np.array([job.outcome.bake.displacement(k) for k in range(len(job.outcome.bake.frames))])


@pytest.mark.parametrize("settings", METHODS + MATERIAL_MODELS, ids=lambda settings: " ".join(settings.values()))
def test_every_method_bakes_what_blender_shows(arm, settings):
    job = run(arm, **settings)
    assert not job.outcome.report["inverted"]
    assert_shows(arm, job.outcome.bake)


def test_full_bakes_tell_what_compression_costs(arm):
    job = run(arm, **FULL)
    moved = np.abs(displacements(job)).max()
    assert 0 <= job.outcome.report["compression_error"] < 0.02 * moved


def test_static_targets_follow_the_pose_alone(arm):
    job = run(arm, method="STATIC")
    shape = job.outcome.character.targets[1].shape
    assert np.allclose(displacements(job), job.outcome.bake.weights[:, 1, None, None] * shape, atol=1e-12)
    assert job.outcome.bake.weights[[0, -1], 1] == pytest.approx([0, 1])
    assert [key.name for key in arm.dynamorph.bake.keys] == ["Dynamorph Detail flexed"]


def test_single_material_does_not_know_the_targets(arm):
    job = run(arm, method="SINGLE")
    assert job.outcome.bake.target_names == ("Neutral",)
    arm.dynamorph.targets["flexed"].stiffness *= 10
    assert np.array_equal(displacements(run(arm)), displacements(job))


def test_single_material_leaves_other_targets_as_they_are(arm):
    """A build that changes the neutral stiffness is no reason to bake again."""
    neutral, flexed = arm.dynamorph.targets
    for target in (neutral, flexed):
        target.bounce = 5.0
    before, stiffness = neutral.stiffness, flexed.stiffness
    run(arm, method="SINGLE")
    assert neutral.stiffness != before and flexed.stiffness == stiffness
    assert [text for text in staleness.outdated(arm) if "flexed" in text] == []


def test_single_material_needs_no_targets(arm):
    bpy.ops.dynamorph.remove_target()
    assert len(arm.dynamorph.targets) == 1
    assert np.abs(displacements(run(arm, method="SINGLE"))).max() > 0


@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
@pytest.mark.parametrize("method", ["DYNAMIC", "SHAPE"])
def test_shape_follows_the_pose_and_stiffness_only_if_dynamic(arm, method, solver):
    """The same push in both target poses: only a pose-dependent shape responds alike, apart from its rotation."""
    job = run(arm, method=method, solver=solver)
    engine = job.outcome.model.engine(job.outcome.character)
    simulation = dynamorph.Simulation(engine, 0.01)
    still = np.repeat(np.eye(3, 4)[None], job.outcome.model.node_weights.shape[1], axis=0)
    push = np.zeros_like(job.outcome.model.nodes)
    push[job.outcome.model.nodes[:, 2] > 1.5, 0] = 1.0
    given = []
    for weights in ([1.0, 0.0], [0.0, 1.0]):
        rest, _ = simulation.solve_static(still, np.array(weights))
        pushed, _ = simulation.solve_static(still, np.array(weights), push, rest)
        given.append(np.abs(engine.displacement(pushed) - engine.displacement(rest)).max())
        assert np.allclose(rest, np.array(weights) @ [engine.target(0), engine.target(1)], atol=1e-9)
    expected = 10.0 if method == "DYNAMIC" else 1.0
    assert given[0] / given[1] == pytest.approx(expected, rel=0.3 if method == "DYNAMIC" else 0.02)


def test_regions_have_weights_of_their_own(two_regions):
    job = run(two_regions)
    assert job.outcome.bake.target_names == ("Neutral", "flexed", "Neutral Tip", "tip")
    assert np.allclose(job.outcome.bake.weights[:, :2].sum(axis=1), 1) and np.allclose(
        job.outcome.bake.weights[:, 2:].sum(axis=1), 1
    )
    assert job.outcome.bake.weights[-1] == pytest.approx([0, 1, 1, 0], abs=1e-6)
    regions = job.outcome.model.region_weights
    assert np.allclose(regions.sum(axis=1), 1)
    centers = job.outcome.model.nodes[job.outcome.model.tets].mean(axis=1)[:, 2]
    assert regions[centers > 1.8, 1].min() > 0.8 and regions[centers < 1.0, 1].max() < 0.2
    assert_shows(two_regions, job.outcome.bake)


@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
def test_targets_are_met_in_both_regions_at_once(two_regions, solver):
    job = run(two_regions, solver=solver)
    engine = job.outcome.model.engine(job.outcome.character)
    still = np.repeat(np.eye(3, 4)[None], job.outcome.model.node_weights.shape[1], axis=0)
    weights = np.array([0.0, 1.0, 0.0, 1.0])
    guess = np.zeros_like(engine.target(0))
    rest, report = dynamorph.Simulation(engine, 0.01).solve_static(still, weights, guess=guess)
    shape = job.outcome.model.surface(engine.displacement(rest)) + np.tensordot(
        weights, job.outcome.model.residual_shapes, 1
    )
    sculpted = np.tensordot(weights, [target.shape for target in job.outcome.character.targets], 1)
    assert report.converged
    assert np.abs(shape - sculpted).max() < 1e-5 * np.abs(sculpted).max()


@pytest.mark.parametrize("solver, leak", [("FULL", 0.05), ("REDUCED", 0.1)])
def test_motion_amount_of_a_target_ends_with_its_region(two_regions, solver, leak):
    """They agree as well as the nodes, or the modes, can represent it."""
    rig_of(two_regions).pose.bones["upper"].rotation_euler.y = 0.8  # the pose of 'tip', all the time
    run(two_regions, solver=solver, modes=40)
    motion = []
    for amount in (1.0, 0.0):
        two_regions.dynamorph.targets["tip"].amount = amount
        job = run(two_regions)
        bake = job.outcome.bake
        motion.append(np.tensordot(bake.coordinates - bake.static, bake.modes, 1))
    assert job.input.reasons == [] and bake.weights[:, 3] == pytest.approx(1.0)
    height = job.outcome.character.vertices[:, 2]
    inside, outside = height > 1.9, height < 1.1
    before, after = (np.sqrt((part**2).mean(axis=2)).max(axis=0) for part in motion)
    assert after[inside].max() < leak * before.max()
    off = np.sqrt(((motion[1] - motion[0]) ** 2).mean(axis=2)).max(axis=0)
    assert off[outside].max() < leak * before.max()
    assert off.max() > 0.9 * before.max()


def test_region_that_is_gone_or_empty_is_refused(two_regions):
    two_regions.vertex_groups.remove(two_regions.vertex_groups["Tip"])
    with pytest.raises(errors.SceneError, match="'Tip' of target 'tip' is gone"):
        extract.character(two_regions)
    two_regions.vertex_groups.new(name="Tip")
    with pytest.raises(errors.SceneError, match="'Tip' of a target's Region is empty"):
        extract.character(two_regions)


def wind(strength):
    bpy.ops.object.effector_add(type="WIND", location=(-3.0, 0.0, 1.5), rotation=(0.0, np.pi / 2, 0.0))
    field = bpy.context.object
    field.field.strength = strength
    return field


def test_wind_pushes_the_skin_along_its_axis(arm):
    rig_of(arm).animation_data_clear()
    bpy.context.scene.gravity = (0, 0, 0)
    field = wind(0.0)
    still = displacements(run(arm))
    assert np.abs(still).max() < 1e-9
    field.field.strength = 100.0
    pushed = displacements(run(arm))[-1]
    largest = np.abs(pushed).max(axis=0)
    assert largest[0] > 1e-3 and largest[0] > 3 * largest[1]
    assert pushed[np.abs(pushed[:, 0]).argmax(), 0] > 0
    arm.dynamorph.simulation.fields = 0.5
    assert displacements(run(arm))[-1] == pytest.approx(0.5 * pushed, abs=0.1 * np.abs(pushed).max())
    arm.dynamorph.simulation.fields = 0.0
    assert np.abs(displacements(run(arm))).max() < 1e-9


def test_fields_fall_off_as_blender_says(scene):
    field = rig_samples.ForceField("FORCE", False, 2.0, 1.0, 4.0, np.eye(4)[None], np.array([8.0]))
    points = np.array([[0.5, 0, 0], [0, 2.0, 0], [0, 0, 4.5]])
    assert np.allclose(field.pull(0, points), [[8.0, 0, 0], [0, 2.0, 0], [0, 0, 0]])


def test_modes_fitted_to_the_shot_follow_it_more_closely(arm):
    """Compared with the simulation of every node; targets take one of the ten modes."""
    full = displacements(run(arm, **FULL, modes=20))
    apart = {}
    for fitted in (False, True):
        job = run(arm, solver="REDUCED", modes=10, fit_to_shot=fitted)
        assert job.outcome.model.summary.modes == 10
        apart[fitted] = np.abs(displacements(job) - full).max()
    assert apart[True] < 0.5 * apart[False]


def test_a_model_is_fitted_to_the_scene_s_range_when_it_is_built(arm):
    arm.dynamorph.model.modes = 6
    arm.dynamorph.model.fit_to_shot = True
    assert bpy.ops.dynamorph.build() == {"FINISHED"}
    model = model_store.load_model(arm)
    assert model.summary.fitted == (1, 20)
    still = model.basis.T @ (np.repeat(model.soft_body().volumes.sum(axis=1), 3)[:, None] * model.basis)
    assert np.allclose(still, np.eye(6), atol=1e-10)
    job = Job(arm, goal="BAKE")
    batch.run(job)
    assert job.input.reasons == []
    flat = rig_samples.ForceField("WIND", True, 1.0, 0.0, np.inf, np.eye(4)[None], np.array([8.0]))
    assert np.allclose(flat.pull(0, np.array([[9.0, 0, 0], [5, 5, 3.0]])), [[0, 0, 8.0], [0, 0, 2.0]])


def test_fields_that_would_act_otherwise_than_shown_are_refused(arm):
    field = wind(100.0)
    field.field.falloff_type = "CONE"
    with pytest.raises(errors.SceneError, match="'Wind'.*Falloff Sphere"):
        run(arm)


def test_a_target_that_changes_its_region_makes_the_model_old(two_regions):
    """This also holds where the order of the shapes does not tell."""
    add_key(two_regions, "as it was", np.zeros((len(two_regions.data.vertices), 3)))
    rig_of(two_regions).pose.bones["upper"].rotation_euler.y = 0.4
    bpy.ops.dynamorph.add_target(key="as it was")
    two_regions.dynamorph.targets.move(3, 2)
    run(two_regions)
    assert model_store.stale_reasons(two_regions, extract.character(two_regions)) == []
    two_regions.dynamorph.targets["as it was"].region = "Tip"
    assert "regions changed" in model_store.stale_reasons(two_regions, extract.character(two_regions))


def test_fewer_modes_than_shapes_are_refused_when_fitted_too(arm):
    with pytest.raises(Exception, match="needs more than 1"):
        run(arm, modes=1, fit_to_shot=True)


def test_a_fitted_model_says_so_in_another_range(arm):
    for name, value in {"modes": 6, "fit_to_shot": True}.items():
        setattr(arm.dynamorph.model, name, value)
    for frames, warned in (((1, 5), False), ((1, 20), True)):
        job = Job(arm, goal="BAKE", frames=frames)
        batch.run(job)
        assert any("fitted to frames 1 to 5" in warning for warning in job.warnings) == warned
