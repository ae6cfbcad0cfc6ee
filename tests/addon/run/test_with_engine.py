# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on with the real engine: Blender shows what the engine computed, and models become out of date only for a
reason.
"""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch as run_batch
from bl_ext.user_default.dynamic_morph_targets.run.bake import job as run_job
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.remembered import opened
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store
from builders import assert_shows, rig_of
from mathutils import Matrix

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")


@pytest.fixture
def small_arm(soft_arm):
    """The arm with a coarse cage, so that it builds in a second."""
    soft_arm.dynamorph.model.cage_nodes = 200
    soft_arm.dynamorph.model.modes = 8
    return soft_arm


def plain(_obj):
    pass


def scaled_and_traveling(obj):
    """A rig that moves and turns with its mesh as a child, both scaled."""
    rig = rig_of(obj)
    obj.parent = rig
    obj.matrix_parent_inverse = Matrix.Translation((0.1, 0.0, 0.0))
    obj.scale = (1.25, 1.25, 1.1)
    rig.scale = (0.013, 0.013, 0.013)
    for frame in (1, 20):
        rig.location, rig.rotation_euler = (frame, 0.1 * frame, 3.0), (0.1 * frame, 0.05 * frame, 0.2)
        rig.keyframe_insert("location", frame=frame)
        rig.keyframe_insert("rotation_euler", frame=frame)


def mirrored(obj):
    obj.scale = (-1.0, 1.0, 1.0)


def run(obj, **options):
    job = run_job.Job(obj, **options)
    run_batch.run(job)
    return job


@pytest.mark.parametrize("change", [plain, scaled_and_traveling, mirrored])
def test_blender_shows_what_the_engine_computed(small_arm, change):
    change(small_arm)
    bpy.context.view_layer.update()
    job = run(small_arm, goal="BAKE")
    assert np.abs(job.outcome.bake.coordinates).max() > 0
    assert_shows(small_arm, job.outcome.bake)


@pytest.mark.parametrize("change", [plain, scaled_and_traveling, mirrored])
def test_playing_never_makes_a_model_old(scene, small_arm, change):
    change(small_arm)
    small_arm.dynamorph.simulation.use_scene_range = False
    small_arm.dynamorph.simulation.frame_end = 2
    run(small_arm, goal="BUILD")
    for frame in range(1, 21):
        scene.frame_set(frame)
        assert model_store.stale_reasons(small_arm, extract.character(small_arm)) == []


@pytest.mark.parametrize("solver", ["REDUCED", "FULL"])
def test_a_model_that_was_just_built_is_as_the_stored_one(small_arm, solver):
    """Live and bakes take it from memory, without reading and checking it again."""
    small_arm.dynamorph.model.solver = solver
    job = run(small_arm, goal="BAKE")
    kept = model_store.load_model(small_arm)
    assert kept is job.outcome.stored
    opened.models.clear()
    stored = model_store.load_model(small_arm)
    assert stored is not kept and stored.settings == kept.settings and stored.summary.tets == kept.summary.tets
    (arrays, meta), (others, described) = kept.to_arrays(), stored.to_arrays()
    assert meta == described and arrays.keys() == others.keys()
    for name, array in arrays.items():
        np.testing.assert_array_equal(array, others[name])


def test_the_models_that_were_used_last_are_kept(addon, monkeypatch):
    monkeypatch.setattr(model_store, "MOST", 2)
    first, second, third = (
        SimpleNamespace(session_uid=-number, dynamorph=SimpleNamespace(model=SimpleNamespace(content_id="id")))
        for number in (1, 2, 3)
    )
    opened.models.clear()
    model_store.remember(first, "a")
    model_store.remember(second, "b")
    assert model_store.load_model(first) == "a"
    model_store.remember(third, "c")
    monkeypatch.setattr(model_store, "stored_model", lambda obj: pytest.fail("it is read") if obj == first else None)
    assert model_store.load_model(first) == "a"
    with pytest.raises(AssertionError):
        model_store.load_model(second)
    opened.models.clear()


def stiffer(obj):
    obj.dynamorph.targets[1].stiffness = 3e5


def other_pose(obj):
    bpy.context.scene.frame_set(15)
    obj.dynamorph.active_target_index = 1
    bpy.ops.dynamorph.capture_pose()


def renamed(obj):
    obj.data.shape_keys.key_blocks["flexed"].name = "biceps"
    rig_of(obj).data.bones["lower"].name = "forearm"
    obj.name = "Limb"
    bpy.context.view_layer.update()


def blended_otherwise(obj):
    obj.dynamorph.model.blending = "FORCES"


@pytest.mark.parametrize("change", [stiffer, other_pose, renamed, blended_otherwise])
def test_what_never_needs_a_new_model(small_arm, change):
    run(small_arm, goal="BUILD")
    change(small_arm)
    assert run(small_arm, goal="BAKE").input.reasons == []


def sculpted(obj):
    obj.data.shape_keys.key_blocks["flexed"].points[3].co.x += 0.01


def weighted(obj):
    obj.vertex_groups["lower"].add([5], 0.5, "REPLACE")


def scaled(obj):
    obj.scale = (1.0, 1.0, 1.1)
    bpy.context.view_layer.update()


@pytest.mark.parametrize(
    "change, reason",
    [(sculpted, "shape of 'flexed' changed"), (weighted, "skin weights changed"), (scaled, "object scale")],
)
def test_what_needs_one_is_named(small_arm, change, reason):
    run(small_arm, goal="BUILD")
    change(small_arm)
    assert reason in "; ".join(run(small_arm, goal="BAKE").input.reasons)


def test_canceling_the_engine(small_arm):
    job = run_job.Job(small_arm, goal="BAKE")
    batch = run_batch.Batch([job], "BAKE")
    list(batch.read())
    job.progress.canceled = True
    with pytest.raises(errors.Cancelled):
        list(batch.compute())
    assert not small_arm.dynamorph.bake.keys and not small_arm.dynamorph.model.content_id
