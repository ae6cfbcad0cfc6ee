# SPDX-License-Identifier: GPL-3.0-or-later
"""Skinning that is more than a sum of bone matrices: the engine gets what Blender shows."""

from dataclasses import replace
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors as core_errors
from bl_ext.user_default.dynamic_morph_targets.core import settings
from bl_ext.user_default.dynamic_morph_targets.core.motion import loops, simulate
from bl_ext.user_default.dynamic_morph_targets.core.motion.player import Player
from bl_ext.user_default.dynamic_morph_targets.core.result import compare
from bl_ext.user_default.dynamic_morph_targets.run import live, remembered
from bl_ext.user_default.dynamic_morph_targets.run.bake import bake_input
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch as run_batch
from bl_ext.user_default.dynamic_morph_targets.run.bake import job as run_job
from bl_ext.user_default.dynamic_morph_targets.scene import animation, references, skinning
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.scene.read.probe import Probe
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from builders import activate, add_key, evaluated_points, rig_of, skinning_of
from mathutils import Matrix
from test_extract import constrained, masked, mirrored, moved_and_scaled, not_deforming, parented_and_animated
from test_with_engine import scaled_and_traveling

FRAMES = 1, 7, 20


# Rigs --------------------------------------------------------------------------------------------------------------


def preserve_volume(obj):
    obj.modifiers["Armature"].use_deform_preserve_volume = True


def twisting(obj):
    """A forearm that twists by 140 degrees."""
    preserve_volume(obj)
    bone = rig_of(obj).pose.bones["lower"]
    for frame, angle in ((1, 0.0), (20, 2.5)):
        bone.rotation_euler.y = angle
        bone.keyframe_insert("rotation_euler", frame=frame)


def growing(obj):
    twisting(obj)
    bone = rig_of(obj).pose.bones["lower"]
    for frame, scale in ((1, (1.0, 1.0, 1.0)), (20, (1.4, 1.0, 0.8))):
        bone.scale = scale
        bone.keyframe_insert("scale", frame=frame)


def bendy(obj):
    rig = rig_of(obj)
    activate(rig)
    bpy.ops.object.mode_set(mode="EDIT")
    rig.data.edit_bones["lower"].use_connect = True  # so that both bend where they meet
    bpy.ops.object.mode_set(mode="OBJECT")
    activate(obj)
    for bone in rig.data.bones:
        bone.bbone_segments = 8
    rig.pose.bones["lower"].bbone_curveinx = 0.4
    rig.pose.bones["upper"].bbone_rollout = 0.8


def bendy_and_twisting(obj):
    bendy(obj)
    twisting(obj)


def with_second_armature(obj):
    """A bone of another armature, which travels, moves the end."""
    rig = rig_of(obj).copy()
    rig.data, rig.name = rig.data.copy(), "Second Rig"
    rig.data.bones["upper"].name, rig.data.bones["lower"].name = "root", "tip"
    rig.animation_data_clear()
    bpy.context.scene.collection.objects.link(rig)
    for frame, angle in ((1, 0.0), (20, 0.6)):
        rig.pose.bones["tip"].rotation_euler.z = angle
        rig.pose.bones["tip"].keyframe_insert("rotation_euler", frame=frame)
        rig.location.x = 0.02 * frame
        rig.keyframe_insert("location", frame=frame)
    obj.vertex_groups.new(name="tip").add(list(range(200, 272)), 0.4, "REPLACE")
    obj.modifiers.new("Second", "ARMATURE").object = rig
    return obj.modifiers["Second"]


def two_armatures(obj):
    with_second_armature(obj).use_deform_preserve_volume = True


def unrelated_armature_first(obj):
    """An armature without bones for this mesh places no targets, wherever it stands."""
    second = with_second_armature(obj)
    obj.vertex_groups.remove(obj.vertex_groups["tip"])
    obj.modifiers.move(obj.modifiers.find(second.name), 0)


def hybrid(obj):
    """The usual mix of linear and dual quaternion skinning: one armature twice, by a painted mask."""
    twisting(obj)
    obj.modifiers["Armature"].use_deform_preserve_volume = False
    second = obj.modifiers.new("Second", "ARMATURE")
    second.object, second.use_deform_preserve_volume, second.use_multi_modifier = rig_of(obj), True, True
    mask = obj.vertex_groups.new(name="Twist")
    for index in range(60, 272):
        mask.add([index], index / 272, "REPLACE")
    second.vertex_group = "Twist"


def five_bones(obj):
    """More bones at a vertex than an exporter would keep."""
    rig = rig_of(obj)
    activate(rig)
    bpy.ops.object.mode_set(mode="EDIT")
    for i in range(3):
        bone = rig.data.edit_bones.new(f"muscle {i}")
        bone.head, bone.tail, bone.parent = (0.1 * i, 0.1, 0.5), (0.1 * i, 0.1, 1.5), rig.data.edit_bones["lower"]
    bpy.ops.object.mode_set(mode="OBJECT")
    activate(obj)
    for i in range(3):
        obj.vertex_groups.new(name=f"muscle {i}").add(list(range(272)), 0.1 + 0.1 * i, "REPLACE")
        bone = rig.pose.bones[f"muscle {i}"]
        bone.rotation_mode, bone.rotation_euler = "XYZ", (0.1 * i, 0.3, -0.2 * i)


def groups_without_bones(obj):
    group = obj.vertex_groups.new(name="Clothes")
    group.add(list(range(272)), 0.7, "REPLACE")


def locked_groups(obj):
    for group in obj.vertex_groups:
        group.lock_weight = True


def zero_weights(obj):
    """Vertices without groups, with weights of zero, and with weights that Blender ignores."""
    for group in obj.vertex_groups:
        group.remove([3, 4, 5])
        group.add([6, 7], 0.0, "REPLACE")
        group.add([8, 9], 3e-5, "REPLACE")
    obj.vertex_groups["upper"].add([40], 0.2, "REPLACE")  # the sum is not one


def both(first, second):
    def change(obj):
        first(obj)
        second(obj)

    change.__name__ = f"{first.__name__}, {second.__name__}"
    return change


LINEAR = [
    five_bones, groups_without_bones, locked_groups, zero_weights, masked, not_deforming, moved_and_scaled,
    mirrored,
]  # fmt: skip
QUATERNIONS = [
    preserve_volume, twisting, growing, two_armatures, unrelated_armature_first, hybrid,
    *(both(twisting, change) for change in (*LINEAR, parented_and_animated, constrained)),
]  # fmt: skip
BENDY = [bendy, bendy_and_twisting, both(bendy, moved_and_scaled), both(bendy, zero_weights)]


def skin_probe(obj, displacement=0.0):
    """A probe of the vertices instead of nodes, displaced (V, 3) in local space; their places in bind space."""
    character = extract.character(obj)
    rest = (character.vertices + displacement) @ character.to_bind.T
    everything = SimpleNamespace(
        nodes=rest, free=np.ones(len(rest), bool), to_bind=character.to_bind, at_nodes=lambda values: values
    )
    return Probe(obj, everything, character), rest


def moved(transforms, bind) -> np.ndarray:
    """World positions (..., n, 3) of points in bind space."""
    return np.einsum("...nij,nj->...ni", transforms[..., :3], bind) + transforms[..., 3]


def displace(obj, displacement):
    """Show the mesh displaced (V, 3), local space."""
    rest = mesh_data.rest_points(obj)
    block = add_key(obj, "displaced", 0.0)
    block.points.foreach_set("co", (rest + displacement).astype(np.float32).ravel())
    block.value = 1.0


def flesh_motion(obj) -> np.ndarray:
    """Displacements (V, 3) as large as those of soft tissue, local space."""
    return np.random.default_rng(3).normal(0.0, 0.03, (len(obj.data.vertices), 3))


# The probe ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("change", [*LINEAR, *QUATERNIONS, *BENDY], ids=lambda change: change.__name__)
def test_the_probe_is_posed_as_blender_poses_the_mesh(scene, soft_arm, change):
    change(soft_arm)
    bpy.context.view_layer.update()
    probe, rest = skin_probe(soft_arm)
    samples = rig_motion.sample_rig(soft_arm, 1, 20, 1, probe)
    posed = moved(samples.nodes.transforms(samples.object_world), rest)
    for frame in FRAMES:
        scene.frame_set(frame)
        theirs = evaluated_points(soft_arm)
        assert np.abs(posed[frame - 1] - theirs).max() < 1e-6 * np.ptp(theirs, axis=0).max()


@pytest.mark.parametrize("change", [*LINEAR, *QUATERNIONS], ids=lambda change: change.__name__)
def test_displaced_tissue_is_carried_as_blender_carries_it(scene, soft_arm, change):
    """For weights that are fixed the transform is exact, however far from rest."""
    change(soft_arm)
    motion = flesh_motion(soft_arm)
    probe, rest = skin_probe(soft_arm)
    samples = rig_motion.sample_rig(soft_arm, 1, 20, 1, probe)
    to_bind = extract.character(soft_arm).to_bind
    posed = moved(samples.nodes.transforms(samples.object_world), rest + motion @ to_bind.T)
    displace(soft_arm, motion)
    for frame in FRAMES:
        scene.frame_set(frame)
        theirs = evaluated_points(soft_arm)
        assert np.abs(posed[frame - 1] - theirs).max() < 1e-5 * np.ptp(theirs, axis=0).max()


@pytest.mark.parametrize("parented", [False, True])
def test_target_poses_are_read_where_the_armature_stands(soft_arm, parented):
    """Live begins at any frame with one probe; while the mesh moves along, they are read once."""
    twisting(soft_arm)
    rig = rig_of(soft_arm)
    soft_arm.parent = rig if parented else None
    for frame, x in ((1, 0.0), (20, 0.7)):
        rig.location.x, rig.rotation_euler.z = x, x
        rig.keyframe_insert("location", frame=frame)
        rig.keyframe_insert("rotation_euler", frame=frame)
    (first, later), fresh = (
        [rig_motion.sample_rig(soft_arm, frame, frame, 1, probe).target_nodes for frame in frames]
        for probe, frames in ((skin_probe(soft_arm)[0], (1, 15)), (skin_probe(soft_arm)[0], (15,)))
    )
    np.testing.assert_allclose(later.points, fresh[0].points, atol=1e-5)
    assert (first is later) == parented


def test_bendy_bones_carry_tissue_to_first_order(scene, soft_arm):
    """The bend at a vertex depends on where it is: the error is the square of the displacement."""
    bendy(soft_arm)
    rig_of(soft_arm).location.z = -0.04  # no vertex is where two segments meet: there the derivative jumps
    motion = flesh_motion(soft_arm)
    probe, rest = skin_probe(soft_arm)
    samples = rig_motion.sample_rig(soft_arm, 20, 20, 1, probe)
    transforms = samples.nodes.transforms(samples.object_world)[0]
    scene.frame_set(20)
    displace(soft_arm, np.zeros_like(motion))
    still, errors = evaluated_points(soft_arm), []
    for factor in (1.0, 0.1):
        displace(soft_arm, factor * motion)
        soft_arm.data.shape_keys.key_blocks[-2].value = 0.0
        shown = evaluated_points(soft_arm)
        error = np.sqrt(np.mean((moved(transforms, rest + factor * motion) - shown) ** 2))
        errors.append(error / np.sqrt(np.mean((shown - still) ** 2)))
    assert errors[0] < 0.1 and errors[1] < 0.4 * errors[0]
    soft_arm.data.shape_keys.key_blocks[-1].value = 0.0
    # Probed at the displaced points, so nothing is approximated.
    probe, there = skin_probe(soft_arm, 0.1 * motion)
    samples = rig_motion.sample_rig(soft_arm, 20, 20, 1, probe)
    assert np.abs(moved(samples.nodes.transforms(samples.object_world)[0], there) - shown).max() < 1e-5


def test_probing_in_slices_is_the_same_and_leaves_nothing_after_them(soft_arm):
    twisting(soft_arm)
    kinds = "scenes", "objects", "meshes", "armatures", "actions"
    before = [len(getattr(bpy.data, kind)) for kind in kinds]
    probe, _ = skin_probe(soft_arm)
    sampling = rig_motion.RigSampling(soft_arm, 1, 20, 2)
    sampling.probe = probe
    while not sampling.advance(soft_arm, 0.0):
        pass
    assert [len(getattr(bpy.data, kind)) for kind in kinds] == before
    at_once = rig_motion.sample_rig(soft_arm, 1, 20, 2, probe)
    np.testing.assert_array_equal(sampling.samples().nodes.points, at_once.nodes.points)
    np.testing.assert_array_equal(sampling.samples().target_nodes.points, at_once.target_nodes.points)
    assert at_once[5:7].nodes.points.shape == (2, 4, 272, 3) and len(at_once[5:7].target_nodes.points) == 2


@pytest.mark.parametrize("inherit", ["FULL", "ALIGNED", "NONE"])
def test_captured_poses_are_taken_again(scene, soft_arm, inherit):
    """A target's pose includes the effect of constraints and of what bones inherit; the copy of the rig that takes it
    has neither.
    """
    twisting(soft_arm)
    rig = rig_of(soft_arm)
    rig.data.bones["lower"].inherit_scale = inherit
    rig.data.bones["lower"].use_inherit_rotation = inherit != "NONE"
    rig.pose.bones["upper"].rotation_euler.z, rig.pose.bones["upper"].scale.x = 0.4, 1.2
    limit = rig.pose.bones["lower"].constraints.new("LIMIT_ROTATION")
    limit.use_limit_y, limit.max_y, limit.owner_space = True, 1.0, "LOCAL"
    scene.frame_set(20)
    soft_arm.dynamorph.active_target_index = 1
    bpy.ops.dynamorph.capture_pose()
    probe, rest = skin_probe(soft_arm)
    samples = rig_motion.sample_rig(soft_arm, 20, 20, 1, probe)
    at_targets = moved(samples.target_nodes.transforms(np.repeat(samples.object_world, 2, axis=0)), rest)
    assert np.abs(at_targets[1] - evaluated_points(soft_arm)).max() < 1e-5
    assert [c.type for c in rig.pose.bones["lower"].constraints] == ["LIMIT_ROTATION"]


# Bakes -------------------------------------------------------------------------------------------------------------


@pytest.fixture
def small_arm(soft_arm):
    """The arm with a coarse cage, so that it builds in a second."""
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    soft_arm.dynamorph.model.cage_nodes = 200
    soft_arm.dynamorph.model.modes = 8
    return soft_arm


def run(obj, **options):
    job = run_job.Job(obj, **{"goal": "BAKE", **options})
    run_batch.run(job)
    return job


@pytest.mark.fault("R01")
@pytest.mark.parametrize(
    "change", [twisting, growing, hybrid, two_armatures, bendy, both(twisting, scaled_and_traveling)],
    ids=lambda change: change.__name__,
)  # fmt: skip
def test_blender_shows_what_the_engine_computed(scene, small_arm, change):
    """Check that Blender shows the skin, displaced by the bake, where a probe says that the engine has it."""
    change(small_arm)
    job = run(small_arm)
    assert np.abs(job.outcome.bake.coordinates).max() > 0 and job.outcome.report["inverted"] == 0
    for k in (0, 6, 19):
        displacement = job.outcome.bake.displacement(k)
        probe, there = skin_probe(small_arm, displacement if change is bendy else 0.0)
        samples = rig_motion.sample_rig(small_arm, k + 1, k + 1, 1, probe)
        if change is not bendy:
            there = there + displacement @ job.outcome.character.to_bind.T
        scene.frame_set(k + 1)
        shown = evaluated_points(small_arm)
        posed = moved(samples.nodes.transforms(samples.object_world)[0], there)
        round_off = 1e-7 * np.abs(shown).max()  # far from the origin Blender has no more digits
        assert np.abs(posed - shown).max() < 1e-5 * np.ptp(shown, axis=0).max() + round_off


@pytest.mark.parametrize("change", [lambda obj: None, twisting], ids=["bones", "twisting"])
def test_modifiers_before_the_armature_stay_with_a_note(scene, small_arm, change):
    """They bend what the shape keys make of the mesh, which is what the bake writes."""
    change(small_arm)
    cage = bpy.data.objects.new("Cage", bpy.data.lattices.new("Cage"))
    scene.collection.objects.link(cage)
    cage.scale, cage.location.z = (2.0, 2.0, 4.0), 1.0
    for point in cage.data.points[:4]:
        point.co_deform.x += 0.05
    kinds = "LATTICE", "CORRECTIVE_SMOOTH"
    for place, kind in enumerate(kinds):
        small_arm.modifiers.new(kind.title(), kind)
        small_arm.modifiers.move(len(small_arm.modifiers) - 1, place)
    small_arm.modifiers["Lattice"].object = cage
    job = run(small_arm)
    notes = [text for text in job.warnings if "before the Armature is not simulated" in text]
    assert len(notes) == 2 and [modifier.type for modifier in small_arm.modifiers] == [*kinds, "ARMATURE"]
    scene.frame_set(12)
    with_both = evaluated_points(small_arm)
    baked = references.key_points(small_arm.data.shape_keys.reference_key) + job.outcome.bake.displacement(11)
    bpy.ops.dynamorph.delete_bake()
    displace(small_arm, baked - job.outcome.character.vertices)
    assert np.abs(evaluated_points(small_arm) - with_both).max() < 1e-5
    small_arm.modifiers["Lattice"].show_viewport = False
    assert np.abs(evaluated_points(small_arm) - with_both).max() > 1e-3


def test_the_nodes_move_with_the_skin(scene, small_arm):
    """Transforms of the nodes, carried to the skin, put it about where Blender does."""
    twisting(small_arm)
    job = run(small_arm)
    player = Player(job.outcome.model, job.outcome.character, job.input.settings)
    skin = player.posing.skin
    frames = player.posing.frames(job.computation.rig[-1:])
    scene.frame_set(20)
    small_arm.data.shape_keys.key_blocks.foreach_set("mute", [True] * len(small_arm.data.shape_keys.key_blocks))
    apart = np.linalg.norm(skin.posed(frames[0]) - evaluated_points(small_arm), axis=1)[skin.known]
    assert skin.known.sum() > 150 and np.median(apart) < 0.02 and apart.max() < 0.2


@pytest.mark.parametrize("solver", ["REDUCED", "FULL"])
def test_on_plain_bones_both_ways_are_one(small_arm, monkeypatch, solver):
    small_arm.dynamorph.model.solver = solver
    small_arm.dynamorph.simulation.frame_end = 8
    small_arm.dynamorph.simulation.use_scene_range = False
    monkeypatch.setattr(skinning.Skinning, "beyond_bones", "a test")
    dense = run(small_arm)
    monkeypatch.undo()
    plain = run(small_arm)
    assert dense.computation.rig.nodes is not None and plain.computation.rig.nodes is None and plain.input.reasons == []
    apart = [np.abs(dense.outcome.bake.displacement(k) - plain.outcome.bake.displacement(k)).max() for k in range(8)]
    moved_by = max(np.abs(plain.outcome.bake.displacement(k)).max() for k in range(8))
    assert moved_by > 0.01 and max(apart) < 2e-6


def test_a_target_is_balanced_against_gravity_in_its_own_pose(small_arm):
    twisting(small_arm)
    bpy.context.scene.frame_set(20)
    small_arm.dynamorph.active_target_index = 1
    bpy.ops.dynamorph.capture_pose()
    job = run(small_arm)
    assert any(job.input.settings.gravity)
    still = replace(job.input.settings, frame_start=20, frame_end=20)
    balanced, _ = simulate.bake(job.outcome.model, job.outcome.character, job.computation.rig[-1:], still)
    shape = job.outcome.character.targets[1].shape
    assert np.abs(balanced.displacement(0) - shape).max() < 1e-5
    without = replace(job.computation.rig[-1:], target_nodes=None)
    with pytest.raises(ValueError, match="sampled without the nodes"):
        simulate.bake(job.outcome.model, job.outcome.character, without, still)


def test_a_loop_a_jump_and_wind(scene, small_arm):
    """Everything that depends on where the skin is, which the bones do not determine here."""
    twisting(small_arm)
    rig = rig_of(small_arm)
    small_arm.parent = rig
    for frame, x in ((1, 0.0), (9, 0.0), (10, 50.0), (20, 50.0)):
        rig.location.x = x
        rig.keyframe_insert("location", frame=frame)
    wind = bpy.data.objects.new("Wind", None)
    scene.collection.objects.link(wind)
    activate(wind)
    bpy.ops.object.forcefield_toggle()
    wind.field.type, wind.field.strength = "WIND", 40.0
    activate(small_arm)
    job = run(small_arm)
    assert any("rig jumps at frame 10" in text for text in job.warnings)
    assert max(np.abs(job.outcome.bake.displacement(k)).max() for k in range(20)) < 0.5
    player = Player(job.outcome.model, job.outcome.character, job.input.settings)
    player.begin(job.computation.rig[:2])
    rest = job.outcome.character.vertices @ job.outcome.character.to_bind.T
    assert loops.pose_gap(player, job.computation.rig[:1]) < 1e-12 and loops.pose_gap(player, job.computation.rig) > 0.1
    assert player.posing.skinned(job.computation.rig[:1])[0] == pytest.approx(rest[player.posing.skin.known], abs=1e-5)
    frames = player.posing.frames(job.computation.rig[:1])[0]
    moved = player.engine.displacement(player.state.coordinates[0])
    push = player.posing.skin.push(job.computation.rig.fields, 0, frames, moved)
    assert push.sum(axis=0)[2] == pytest.approx(40.0 * player.posing.skin.areas.sum(), rel=1e-6)
    small_arm.dynamorph.simulation.loop = True
    assert "gap" in run(small_arm).outcome.report


def test_bones_scaled_to_zero_keep_their_size(small_arm):
    twisting(small_arm)
    bone = rig_of(small_arm).pose.bones["lower"]
    for frame, scale in ((1, 1.0), (8, 1.0), (9, 0.0), (12, 0.0), (13, 1.0)):
        bone.scale = (scale, scale, scale)
        bone.keyframe_insert("scale", frame=frame)
    job = run(small_arm)
    assert any("Bones scaled to zero keep their last size" in text for text in job.warnings)
    assert max(np.abs(job.outcome.bake.displacement(k)).max() for k in range(20)) < 1.0


def test_the_bake_is_outdated_by_the_modifiers_and_the_model_is_not(small_arm):
    run(small_arm)
    assert staleness.outdated(small_arm) == []
    preserve_volume(small_arm)
    assert staleness.outdated(small_arm) == ["Armature modifiers changed"]
    job = run(small_arm)
    assert job.input.reasons == [] and staleness.outdated(small_arm) == []
    rig_of(small_arm).data.bones["lower"].bbone_segments = 4
    assert staleness.outdated(small_arm) == ["Armature modifiers changed"]


def test_the_animation_of_every_armature_counts(small_arm):
    two_armatures(small_arm)
    names = [name for name, _ in animation.animation(skinning_of(small_arm))]
    assert names == ["Arm Rig", "Arm", "Second Rig"]


def test_a_cage_is_made_before_the_rig_is_read_and_serves_the_model(small_arm):
    preserve_volume(small_arm)
    batch = run_batch
    job = run_job.Job(small_arm, "BAKE")
    seen = []
    batch.run(job, lambda work: seen.append(work.fraction))
    assert seen == sorted(seen) and "meshing" not in job.outcome.model.summary.seconds
    stages = {"build", "sample rig", "measure", "simulate", "judge", "make keys", "store model", "write keys"}
    assert set(job.progress.seconds) == stages
    for goal in ("BUILD", "BAKE"):
        again = run_job.Job(small_arm, goal)
        again.read()
        assert not again.needs_cage
    assert again.input.reasons == []


def test_canceled_while_the_cage_is_made(small_arm, apart):
    preserve_volume(small_arm)
    errors, job = core_errors, run_job
    batch = run_batch.Batch([job.Job(small_arm, "BAKE")], "BAKE")
    steps = batch.steps(0.0)
    while "cage" not in batch.message:
        next(steps)
    batch.cancel()
    with pytest.raises(errors.Cancelled):
        list(steps)
    batch.stop()
    assert small_arm.dynamorph.model.content_id == ""


@pytest.mark.parametrize("method", ["STATIC", "SINGLE", "SHAPE"])
def test_other_methods(small_arm, method):
    twisting(small_arm)
    small_arm.dynamorph.model.method = method
    job = run(small_arm)
    assert (job.computation.rig.nodes is None) == (method == "STATIC")
    assert np.isfinite(job.outcome.bake.displacement(19)).all()


def test_a_body_in_two_cages(small_arm):
    """The nodes that were read are those of the model, although several cages are rebuilt."""
    twisting(small_arm)
    small_arm.vertex_groups.new(name="End").add(list(range(170, 272)), 1.0, "REPLACE")
    piece = small_arm.dynamorph.attachments.add()
    piece.group, piece.attached_by = "End", "OWN_CAGE"
    job = run(small_arm)
    assert (
        len(job.computation.rig.nodes.rest) == job.outcome.model.free.sum()
        and np.abs(job.outcome.bake.displacement(12)).max() > 0.0
    )


@pytest.mark.parametrize("basis", ["MODES", "RESPONSES"])
def test_a_shot_in_chunks_is_the_whole_shot(small_arm, monkeypatch, basis):
    twisting(small_arm)
    small_arm.dynamorph.model.basis = basis
    whole = run(small_arm).outcome.bake
    monkeypatch.setattr(bake_input, "SHORT_CHUNK_FRAMES", 6)
    job = run(small_arm)
    assert len(job.computation.rig) < 40 and np.abs(job.outcome.bake.coordinates - whole.coordinates).max() < 1e-9


def test_methods_are_compared(small_arm):
    twisting(small_arm)
    job = run_job.Job(small_arm, "BAKE", frames=(1, 3), whole=True, stored=False)
    rig = run_batch.read_rig(job)
    variants = {name: settings.VARIANTS[name] for name in ("DMT StVK reduced", "DMT StVK full")}
    found = compare.compare(job.input.character, rig, job.input.settings, variants)["variants"]
    assert found["DMT StVK reduced"]["steps"] > 0 and found["DMT StVK reduced"]["error"]["rms_total"] < 1.0


def test_modes_are_fitted_to_a_shot(small_arm):
    twisting(small_arm)
    small_arm.dynamorph.model.fit_to_shot = True
    assert run(small_arm, goal="BUILD").outcome.model.summary.fitted == (1, 20)


# Live --------------------------------------------------------------------------------------------------------------


def test_playback_is_the_bake(scene, small_arm):
    both(twisting, bendy)(small_arm)
    job = run(small_arm)
    bpy.ops.dynamorph.delete_bake()
    scene.frame_set(1)
    bpy.ops.dynamorph.live()
    block = small_arm.data.shape_keys.key_blocks["Dynamorph Live"]
    for k in range(20):
        scene.frame_set(k + 1)
        assert live.problem(small_arm) == ""
        shown = references.key_points(block) - job.outcome.character.vertices
        assert np.abs(shown - job.outcome.bake.displacement(k)).max() < 2e-6
    scene.frame_set(20)
    small_arm.dynamorph.active_target_index = 1
    bpy.ops.dynamorph.capture_pose()  # is probed again
    scene.frame_set(21)
    assert live.problem(small_arm) == ""


def test_previews(scene, small_arm):
    twisting(small_arm)
    run(small_arm, goal="BUILD")
    scene.frame_set(12)
    for button in (lambda: bpy.ops.dynamorph.shake_test(kind="HOP"), bpy.ops.dynamorph.play_mode):
        assert button() == {"FINISHED"}
    samples = rig_motion.sample_present(small_arm, skin_probe(small_arm)[0])
    away = samples.moved(np.array([Matrix.Translation((0, 0, z)) for z in (0.0, 2.0)]))
    first, second = away.nodes.transforms(away.object_world)
    assert (second - first)[..., 3] == pytest.approx(np.tile([0.0, 0.0, 2.0], (272, 1)), abs=1e-6)
    assert (second - first)[..., :3] == pytest.approx(0.0)


def test_another_way_of_skinning_counts_at_once(scene, small_arm):
    """Live asks Blender for the nodes as soon as bones no longer determine them."""
    run(small_arm, goal="BUILD")
    bpy.ops.dynamorph.live()
    session = remembered.live.sessions[small_arm.session_uid]
    assert session.tissue.probe is None
    small_arm.modifiers["Armature"].use_deform_preserve_volume = True
    bpy.context.view_layer.update()
    scene.frame_set(2)
    session = remembered.live.sessions[small_arm.session_uid]
    assert session.tissue.probe is not None and live.problem(small_arm) == ""
