# SPDX-License-Identifier: GPL-3.0-or-later
"""What a bake can become in Blender: fewer keys, point caches. All show the engine's surface."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors, settings
from bl_ext.user_default.dynamic_morph_targets.core.motion import baked
from bl_ext.user_default.dynamic_morph_targets.core.result.keys import as_keys
from bl_ext.user_default.dynamic_morph_targets.io import paths, point_cache
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.scene.skin import cache_modifier
from bl_ext.user_default.dynamic_morph_targets.write.bake import influence as influence_module
from bl_ext.user_default.dynamic_morph_targets.write.bake import reading, writer
from builders import assert_shows, evaluated_points, fingerprint, hand_made_bake, keys_of, make_mesh

FORMATS = ("MODES", "PC2")


def smooth_bake(obj, frames=range(1, 21), **more):
    """A hand-made bake that moves smoothly; without motion it has the targets' shapes."""
    bake = hand_made_bake(obj, frames, **more)
    time = np.linspace(0.0, 3.0, len(frames))[:, None]
    rng = np.random.default_rng(2)
    modes = len(bake.modes)
    coordinates = 2.0 * 0.5 ** np.arange(modes) * np.sin(time * (1 + np.arange(modes)) + rng.uniform(0, 6, modes))
    weights = np.column_stack([np.cos(time) ** 2, np.sin(time) ** 2])
    return replace(
        bake, coordinates=coordinates, weights=weights, static=weights @ rng.normal(0, 1.0, (2, modes)),
        modes=bake.modes - bake.modes.mean(axis=1, keepdims=True),
    )  # fmt: skip


def dry_of(bake):
    return replace(bake, coordinates=bake.static)


def written(obj, bake, folder, skin=None, to_bind=None, **output):
    """Write the bake as `output` says; returns how far the surface is off, in meters."""
    chosen = settings.OutputSettings(**output)
    keys, off = as_keys(bake, chosen, np.eye(3) if to_bind is None else to_bind)
    cache = None
    if chosen.format == "PC2":
        cache = paths.cache_path(folder, obj.name, baked.digest(bake))
        cache.parent.mkdir(exist_ok=True)
        points = mesh_data.rest_points(obj)
        cache.write_bytes(b"".join(point_cache.point_cache(bake, points)))
    writer.write_keys(obj, keys, skin, cache)
    return off


@pytest.mark.parametrize("kind", FORMATS)
def test_blender_shows_the_surface_with_and_without_the_motion(scene, soft_arm, tmp_path, kind):
    bake = smooth_bake(soft_arm)
    before = fingerprint(soft_arm)
    assert written(soft_arm, bake, tmp_path, format=kind) < 1e-6
    assert_shows(soft_arm, bake)
    bake_influence = influence_module
    owner, name = bake_influence.influence(soft_arm)
    setattr(owner, name, 0.0)
    bake_influence.show_influence(soft_arm)
    assert_shows(soft_arm, dry_of(bake))
    setattr(owner, name, 0.5)
    bake_influence.show_influence(soft_arm)
    assert_shows(soft_arm, replace(bake, coordinates=(bake.coordinates + bake.static) / 2))
    writer.free(soft_arm)
    assert fingerprint(soft_arm) == before
    assert not soft_arm.dynamorph.bake.exists


@pytest.mark.parametrize("second", FORMATS)
@pytest.mark.parametrize("first", FORMATS)
def test_one_takes_the_place_of_another(soft_arm, tmp_path, first, second):
    before = fingerprint(soft_arm)
    written(soft_arm, smooth_bake(soft_arm, seed=1), tmp_path, format=first)
    bake = smooth_bake(soft_arm, seed=2)
    written(soft_arm, bake, tmp_path, format=second)
    assert_shows(soft_arm, bake)
    writer.free(soft_arm)
    assert fingerprint(soft_arm) == before


@pytest.mark.parametrize("keys", [1, 2, 3])
def test_fewer_keys_are_as_far_off_as_is_said(soft_arm, tmp_path, keys):
    bake = smooth_bake(soft_arm, modes=4)
    to_bind = np.diag([2.0, 2.0, 2.0])
    off = written(soft_arm, bake, tmp_path, to_bind=to_bind, keys=keys)
    assert len(soft_arm.dynamorph.bake.keys) == keys
    assert off > 0.0
    seen = 0.0
    for row, frame in enumerate(bake.frames):
        bpy.context.scene.frame_set(int(frame))
        blocks = [block for block in keys_of(soft_arm).key_blocks[1:] if not block.mute]
        shown = sum(block.value * mesh_data.target_shape(soft_arm, block.name) for block in blocks)
        seen = max(seen, np.linalg.norm(2.0 * (shown - bake.displacement(row)), axis=1).max())
    assert seen == pytest.approx(off, rel=1e-3)


@pytest.mark.fault("K05")
def test_ten_thousand_frames_take_as_many_keys_as_twenty(soft_arm, tmp_path):
    counts = []
    for last in (20, 10_000):
        bake = smooth_bake(soft_arm, frames=range(1, last + 1))
        written(soft_arm, bake, tmp_path)
        counts.append(len(soft_arm.dynamorph.bake.keys))
    assert counts[0] == counts[1]
    for row in (0, 4999, 9999):
        assert_shows(soft_arm, baked.at_rows(bake, np.array([row])))


@pytest.mark.parametrize("remapped", [False, True])
def test_point_caches_have_sub_frames(scene, soft_arm, tmp_path, remapped):
    if remapped:
        scene.render.frame_map_old, scene.render.frame_map_new = 100, 200
    frames = np.arange(10.0, 20.25, 0.25)
    bake = smooth_bake(soft_arm, frames)
    written(soft_arm, bake, tmp_path, format="PC2")
    basis = mesh_data.rest_points(soft_arm)
    soft_arm.modifiers["Armature"].show_viewport = False
    for row in (0, 1, 6, 23, 40):
        scene.frame_set(int(frames[row]), subframe=frames[row] % 1.0)
        assert np.abs(evaluated_points(soft_arm) - (basis + bake.displacement(row))).max() < 1e-5


def test_a_cache_goes_before_all_modifiers_and_stays_where_it_is_moved(soft_arm, tmp_path):
    written(soft_arm, smooth_bake(soft_arm), tmp_path, format="PC2")
    modifier = soft_arm.modifiers[0]
    assert modifier.type == "MESH_CACHE"
    modifier.name, modifier.factor = "Mine", 0.25
    written(soft_arm, smooth_bake(soft_arm, seed=5), tmp_path, format="PC2")
    assert [each.type for each in soft_arm.modifiers] == ["MESH_CACHE", "ARMATURE"]
    assert soft_arm.modifiers["Mine"].factor == 0.25
    assert len(list((tmp_path / "dynamorph_caches").iterdir())) == 2  # another file may play the first


def test_what_follows_takes_the_influence_of_the_cache(scene, soft_arm, tmp_path):
    shirt = make_mesh(scene, "Shirt", mesh_data.rest_points(soft_arm) * 1.1, [])
    written(soft_arm, smooth_bake(soft_arm), tmp_path, format="PC2")
    bake = smooth_bake(soft_arm, seed=3)
    written(shirt, bake, tmp_path, skin=soft_arm, format="PC2")
    for factor in (0.0, 1.0):
        soft_arm.modifiers[0].factor = factor
        soft_arm.modifiers[0].keyframe_insert("factor", frame=int(1 + 19 * factor))
    points = mesh_data.rest_points(shirt)
    for row, factor in ((0, 0.0), (19, 1.0)):
        scene.frame_set(row + 1)
        shown = factor * bake.displacement(row) + (1.0 - factor) * dry_of(bake).displacement(row)
        assert np.abs(evaluated_points(shirt) - (points + shown)).max() < 1e-5
    writer.free(soft_arm)
    assert not shirt.modifiers and not (shirt.animation_data and shirt.animation_data.drivers)


def test_keys_that_a_cache_plays_over_are_named(soft_arm):
    bake, blocks = writer, keys_of(soft_arm).key_blocks
    assert bake.overwritten_keys(soft_arm) == []
    blocks["smile"].value = 0.01  # hardly another body
    assert bake.overwritten_keys(soft_arm) == ["smile"]
    blocks["smile"].value = 1.0  # which the cache has
    assert bake.overwritten_keys(soft_arm) == []
    blocks["smile"].keyframe_insert("value", frame=1)
    assert bake.overwritten_keys(soft_arm) == ["smile"]
    blocks["smile"].mute = True
    assert bake.overwritten_keys(soft_arm) == []


@pytest.mark.fault("F14")
def test_a_cache_needs_a_saved_file(soft_arm):
    with pytest.raises(errors.WriteError, match="save the .blend first"):
        writer.check_cache(soft_arm, None)


def test_a_bake_is_read_back_as_it_was_written(soft_arm, tmp_path):
    bake = smooth_bake(soft_arm)
    written(soft_arm, bake, tmp_path)
    found = reading.read_back(soft_arm)
    np.testing.assert_array_equal(found.frames, bake.frames)
    for row in range(len(bake.frames)):
        assert np.abs(found.displacement(row) - bake.displacement(row)).max() < 1e-6
        assert np.abs(dry_of(found).displacement(row) - dry_of(bake).displacement(row)).max() < 1e-6


@pytest.mark.parametrize(("first", "second"), [("MODES", "PC2"), ("PC2", "MODES")])
def test_the_influence_goes_along(scene, soft_arm, tmp_path, first, second):
    """From shape keys to a point cache and back: set, and keyed."""
    bake_influence = influence_module
    written(soft_arm, smooth_bake(soft_arm), tmp_path, format=first)
    owner, name = bake_influence.influence(soft_arm)
    setattr(owner, name, 0.25)
    written(soft_arm, smooth_bake(soft_arm), tmp_path, format=second)
    owner, name = bake_influence.influence(soft_arm)
    assert getattr(owner, name) == 0.25
    for frame, influence in ((1, 0.0), (11, 1.0)):
        setattr(owner, name, influence)
        owner.keyframe_insert(name, frame=frame)
    for kind in (first, second):
        written(soft_arm, smooth_bake(soft_arm), tmp_path, format=kind)
        for frame, influence in ((1, 0.0), (6, 0.5), (11, 1.0), (15, 1.0)):
            scene.frame_set(frame)
            owner, name = bake_influence.influence(soft_arm)
            assert getattr(owner, name) == pytest.approx(influence, abs=1e-6)


def test_a_driver_of_the_influence_that_goes_is_named(soft_arm, tmp_path):
    written(soft_arm, smooth_bake(soft_arm), tmp_path, format="PC2")
    cache_modifier(soft_arm).driver_add("factor").driver.expression = "0.5"
    written(soft_arm, smooth_bake(soft_arm, seed=2), tmp_path, format="PC2")
    assert soft_arm.animation_data.drivers
    new = writer.NewBake(soft_arm, smooth_bake(soft_arm))
    new.add()
    new.show()
    (messages,) = new.remove_old()
    assert "'Arm': the driver of its Influence was removed" in messages


def test_a_curve_of_an_earlier_cache_does_not_move_the_influence_of_the_next(scene, soft_arm, tmp_path):
    bake_influence = influence_module
    written(soft_arm, smooth_bake(soft_arm), tmp_path, format="PC2")
    modifier, name = bake_influence.influence(soft_arm)
    for frame, influence in ((1, 0.0), (11, 1.0)):
        setattr(modifier, name, influence)
        modifier.keyframe_insert(name, frame=frame)
    written(soft_arm, smooth_bake(soft_arm), tmp_path, format="MODES")
    strip, name = bake_influence.influence(soft_arm)
    strip.fcurves.find(name).keyframe_points.clear()
    strip.influence = 0.25
    written(soft_arm, smooth_bake(soft_arm), tmp_path, format="PC2")
    for frame in (1, 11):
        scene.frame_set(frame)
        assert bake_influence.influence(soft_arm)[0].factor == 0.25
