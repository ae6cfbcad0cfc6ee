# SPDX-License-Identifier: GPL-3.0-or-later
"""A folder that processes share: models are built once, bakes are resumed, and nothing is confused."""

import os

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets import preferences
from bl_ext.user_default.dynamic_morph_targets.cli import main, record
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.core.motion import simulate
from bl_ext.user_default.dynamic_morph_targets.io import cache_dir, disk, model_file
from bl_ext.user_default.dynamic_morph_targets.run.bake import bake_input
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch as run_batch
from bl_ext.user_default.dynamic_morph_targets.run.bake import job as run_job
from bl_ext.user_default.dynamic_morph_targets.scene.remembered import opened
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store
from bl_ext.user_default.dynamic_morph_targets.write import storage
from builders import rig_of

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")


@pytest.fixture
def coarse(soft_arm, tmp_path):
    """A saved file with a coarse arm."""
    soft_arm.dynamorph.model.cage_nodes = 200
    soft_arm.dynamorph.model.modes = 8
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    return soft_arm


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "shared"


def baked(obj, folder=None, goal="BAKE"):
    batch = run_batch
    job = run_job.Job(obj, goal, cache_dir=folder and cache_dir.CacheDir(folder))
    batch.run(job)
    return job


def stopped(obj, folder, monkeypatch, stretches):
    """A bake that ends after this many chunks; nothing is written."""
    batch, job = run_batch, run_job
    keep, left = cache_dir.CacheDir.keep, iter(range(stretches - 1, -1, -1))

    def keep_and_stop(self, *args):
        keep(self, *args)
        if not next(left):
            raise InterruptedError

    with monkeypatch.context() as patch:
        patch.setattr(cache_dir.CacheDir, "keep", keep_and_stop)
        with pytest.raises(InterruptedError):
            batch.run(job.Job(obj, "BAKE", cache_dir=cache_dir.CacheDir(folder)))


@pytest.mark.parametrize("changes", [{"basis": "MODES"}, {"basis": "RESPONSES"}, {"solver": "FULL", "cage_nodes": 800}])
def test_a_stopped_bake_is_resumed(coarse, folder, monkeypatch, changes):
    for name, value in changes.items():
        setattr(coarse.dynamorph.model, name, value)
    monkeypatch.setattr(bake_input, "SHORT_CHUNK_FRAMES", 5)
    stopped(coarse, folder, monkeypatch, stretches=2)
    assert len(list(folder.glob("*.unfinished"))) == 1
    job = baked(coarse, folder)
    assert len(job.input.resumed["coordinates"]) == 11  # frames
    assert record.character_record(record.Done(job, job.warnings))["bake"]["resumed"] == 11
    whole = baked(coarse)
    assert np.array_equal(job.outcome.bake.coordinates, whole.outcome.bake.coordinates)
    assert job.outcome.report["steps"] == whole.outcome.report["steps"]


@pytest.mark.fault("F05")
def test_a_bake_with_other_modes_starts_over(coarse, folder, monkeypatch):
    """Models that are built elsewhere from the same scene may have modes with other signs."""
    monkeypatch.setattr(bake_input, "SHORT_CHUNK_FRAMES", 5)
    stopped(coarse, folder, monkeypatch, stretches=2)
    (built,) = folder.glob("*.dynamorph")
    arrays, meta = model_file.unpack(built.read_bytes())
    arrays["basis"][:, 0] *= -1.0
    disk.save(built, model_file.pack(arrays, meta))
    assert not baked(coarse, folder).input.resumed


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("coordinates", lambda found: found[:, :-1]),
        ("weights", lambda found: found[:0]),
        ("weights", lambda found: found[0, 0]),
        ("steps", lambda found: found.astype(np.float32)),
        ("past", lambda found: np.nan * found),
        ("bones", lambda found: found.reshape(-1)),
        ("pose", lambda found: found[:1]),
        (None, lambda found: np.concatenate([found] * 9)),
    ],
)
def test_an_unfinished_bake_that_does_not_fit_starts_over(coarse, folder, monkeypatch, name, wrong):
    """Somebody wrote it with the right hashes."""
    monkeypatch.setattr(bake_input, "SHORT_CHUNK_FRAMES", 5)
    stopped(coarse, folder, monkeypatch, stretches=1)
    (kept,) = folder.glob("*.unfinished")
    arrays, meta = model_file.unpack(kept.read_bytes())
    changed = (name,) if name else ("coordinates", "weights", "steps")  # None: more frames than the shot has
    disk.save(kept, model_file.pack(arrays | {each: wrong(arrays[each]) for each in changed}, meta))
    assert not baked(coarse, folder).input.resumed


def test_a_shared_model_that_does_not_fit_is_built_again(coarse, folder):
    baked(coarse, folder, goal="BUILD")
    storage.forget_model(coarse)
    (built,) = folder.glob("*.dynamorph")
    right = built.read_bytes()
    arrays, meta = model_file.unpack(right)
    disk.save(built, model_file.pack(arrays | {"fill": arrays["fill"][:-1]}, meta))
    baked(coarse, folder, goal="BUILD")
    assert built.read_bytes() == right


@pytest.mark.parametrize("beside", [False, True])
def test_a_model_that_does_not_fit_is_named(coarse, folder, monkeypatch, beside):
    """The mesh or the file, and what to do."""
    if beside:
        monkeypatch.setattr(preferences, "model_folders", lambda _blend: [folder])
    baked(coarse, goal="BUILD")
    arrays, meta = model_file.unpack(model_store.stored_model(coarse))
    packed = model_file.pack(arrays | {"fill": arrays["fill"][:-1]}, meta)
    opened.models.clear()
    file = folder / f"{model_file.content_id(packed)}.dynamorph" if beside else None
    if file:
        disk.save(file, packed)
    storage.keep_model(coarse, packed, file)
    where = rf"'Arm', file '{file.name}'" if beside else "'Arm'"
    with pytest.raises(errors.ModelFileError, match=f"^{where}: .*array 'fill' .*: build it again$"):
        model_store.load_model(coarse)
    coarse.dynamorph.model.content_id = 32 * "0"
    if beside:
        with pytest.raises(errors.ModelFileError, match="^The model of 'Arm' is missing"):
            model_store.load_model(coarse)


@pytest.mark.fault("F05")
def test_a_changed_file_starts_over(coarse, folder, monkeypatch):
    monkeypatch.setattr(bake_input, "SHORT_CHUNK_FRAMES", 5)
    stopped(coarse, folder, monkeypatch, stretches=1)
    rig_of(coarse).pose.bones[0].constraints.new("LIMIT_ROTATION")  # which neither settings nor animation mention
    bpy.ops.wm.save_mainfile()
    assert not baked(coarse, folder).input.resumed


def test_models_are_built_once(coarse, folder, monkeypatch):
    first = baked(coarse, folder, goal="BUILD")
    storage.forget_model(coarse)
    monkeypatch.setattr(simulate, "build_for", None)
    second = baked(coarse, folder, goal="BUILD")
    assert second.input.reasons and np.array_equal(second.outcome.model.basis, first.outcome.model.basis)
    assert second.outcome.reference == first.outcome.reference > 0.0


def test_models_fitted_to_a_shot_are_not_shared(coarse, folder):
    """Otherwise another shot of the same character would get them."""
    coarse.dynamorph.model.fit_to_shot = True
    job = baked(coarse, folder)
    assert job.outcome.model.summary.fitted
    assert not list(folder.glob("*"))


@pytest.mark.parametrize("setting", ["loop", "probed"])
def test_what_cannot_be_resumed_is_baked_all_the_same(coarse, tmp_path, folder, setting):
    if setting == "loop":
        coarse.dynamorph.simulation.loop = True
    else:
        coarse.modifiers["Armature"].use_deform_preserve_volume = True
    bpy.ops.wm.save_mainfile()
    arguments = ["bake", "--object", coarse.name, "--cache-dir", str(folder), "-o", str(tmp_path / "baked.blend")]
    assert main.main(arguments) == 0
    assert not list(folder.glob("*.unfinished"))


def test_a_probed_character_uses_the_nodes_of_the_shared_model(coarse, folder):
    """Its own cage may have other nodes, if another version made it."""
    coarse.modifiers["Armature"].use_deform_preserve_volume = True
    shared = baked(coarse, folder)
    storage.forget_model(coarse)
    (built,) = folder.glob("*.dynamorph")
    arrays, meta = model_file.unpack(built.read_bytes())
    arrays["nodes"] = arrays["nodes"] + 1e-9
    disk.save(built, model_file.pack(arrays, meta))
    job = baked(coarse, folder)
    assert np.allclose(job.outcome.bake.coordinates, shared.outcome.bake.coordinates, atol=1e-4)


def test_an_undo_between_two_chunks_stops_a_bake(coarse, folder, monkeypatch):
    """What was read before the undo belongs to another scene."""
    monkeypatch.setattr(bake_input, "CHUNK_FRAMES", 5)
    job = run_job.Job(coarse, "BAKE")
    batch = run_batch.Batch([job], "BAKE")
    begin_chunk = run_job.Job.begin_chunk

    def undone(self, done):
        batch.undone = done > 0
        return begin_chunk(self, done)

    monkeypatch.setattr(run_job.Job, "begin_chunk", undone)
    with pytest.raises(errors.SceneError, match="was undone"):
        run_batch.run_all(batch)
    assert not coarse.dynamorph.bake.keys


@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_what_never_ends_is_not_read(coarse, folder, kind):
    baked(coarse, folder, "BUILD")
    (model,) = folder.glob("*.dynamorph")
    model.unlink()
    os.mkfifo(model) if kind == "pipe" else model.symlink_to("/dev/zero")
    coarse.dynamorph.model.content_id = ""
    with pytest.raises(OSError, match="Not a file"):
        baked(coarse, folder, "BUILD")
