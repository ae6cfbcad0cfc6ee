# SPDX-License-Identifier: GPL-3.0-or-later
"""Stiffness, Amount, and Distance and Friction of Collision may change over a shot: in bakes and in Live alike."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core.errors import SceneError
from bl_ext.user_default.dynamic_morph_targets.core.motion.keyed import KeyedSettings
from bl_ext.user_default.dynamic_morph_targets.io.cache_dir import CacheDir
from bl_ext.user_default.dynamic_morph_targets.run import live as run_live
from bl_ext.user_default.dynamic_morph_targets.run.bake import bake_input, batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene import animation, keyed
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from bl_ext.user_default.dynamic_morph_targets.write.authoring import setups, targets
from builders import make_ball, rig_of
from built import BuiltOnce
from test_live import play

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

SOFT, FIRM = 4e3, 4e4  # Pa
built = BuiltOnce()


@pytest.fixture
def arm(soft_arm):
    """The soft arm with a coarse model, built, which bends over 20 frames and sags under gravity."""
    settings = soft_arm.dynamorph
    settings.model.cage_nodes, settings.model.modes = 200, 12
    built.give(soft_arm, 12)
    for target in settings.targets:
        target.stiffness = SOFT
    settings.simulation.max_thickness = settings.simulation.max_displacement = 0.0
    return soft_arm


def key(owner, name, *pairs, interpolation="LINEAR"):
    """Key a property of an object's settings with (frame, value)."""
    obj, path = owner.id_data, owner.path_from_id(name)
    before = getattr(owner, name)
    for frame, value in pairs:
        setattr(owner, name, value)
        owner.keyframe_insert(name, frame=frame)
    for curve in animation.curves(obj.animation_data.action, obj.animation_data.action_slot):
        for point in curve.keyframe_points if curve.data_path == path else ():
            point.interpolation = interpolation
    setattr(owner, name, before)
    bpy.context.scene.frame_set(1)


def key_stiffness(obj, *pairs, **options):
    for target in obj.dynamorph.targets:
        key(target, "stiffness", *pairs, **options)


def set_stiffness(obj, value):
    for target in obj.dynamorph.targets:
        target.stiffness = value


def baked(obj, **options):
    """Displacements (F, V, 3) of a bake that is not written."""
    job = Job(obj, goal="BAKE", stored=False, **options)
    batch.run(job)
    bake = job.outcome.bake
    return np.array([bake.displacement(k) for k in range(len(bake.frames))])


def apart(one, other):
    """The largest distance, relative to the largest displacement."""
    return np.abs(one - other).max() / np.abs(other).max()


@pytest.mark.parametrize("limit", [0.0, 0.1])
@pytest.mark.parametrize("solver", ["REDUCED", "FULL"])
def test_a_stiffness_that_is_keyed_is_one_that_is_set(arm, solver, limit):
    """With the limit of the motion, too: it follows."""
    arm.dynamorph.model.solver, arm.dynamorph.simulation.max_displacement = solver, limit
    soft = baked(arm)
    set_stiffness(arm, FIRM)
    firm = baked(arm)
    set_stiffness(arm, SOFT)
    key_stiffness(arm, (1, FIRM))
    assert apart(soft, firm) > 0.02
    assert apart(baked(arm), firm) < 1e-4


def test_a_material_that_changes_goes_from_one_bake_to_the_other(arm):
    """A shot that lasts: at its end the skin hangs as in the bake that was firm from the beginning."""
    for curve in animation.curves(rig_of(arm).animation_data.action, rig_of(arm).animation_data.action_slot):
        for point in curve.keyframe_points:  # it bends, and holds still
            point.co.x = min(point.co.x, 8.0)
    for target in arm.dynamorph.targets:
        target.mass_damping = 15.0
    bpy.context.scene.frame_end = 60
    soft = baked(arm)
    key_stiffness(arm, (1, SOFT), (10, FIRM), interpolation="CONSTANT")
    changing = baked(arm)
    arm.animation_data_clear()
    set_stiffness(arm, FIRM)
    firm = baked(arm)
    assert apart(soft[-1], firm[-1]) > 0.05
    np.testing.assert_allclose(changing[:9], soft[:9], atol=1e-4 * np.abs(soft).max())
    assert np.abs(changing[-1] - firm[-1]).max() < 0.1 * np.abs(soft[-1] - firm[-1]).max()


def test_a_keyed_stiffness_does_not_depend_on_the_steps(arm):
    """At 240 and 384 steps a second it is as near to 120 as without keys."""

    def spread():
        found = [baked(arm, substeps=count) for count in (5, 10, 16)]
        return max(apart(each, found[-1]) for each in found)

    alone = spread()
    key_stiffness(arm, (1, SOFT), (20, FIRM))
    assert spread() < max(1.5 * alone, 0.01)


@pytest.mark.parametrize("solver", ["REDUCED", "FULL"])
def test_live_shows_what_a_bake_does(arm, solver):
    arm.dynamorph.model.solver = solver
    key_stiffness(arm, (1, SOFT), (20, FIRM))
    key(arm.dynamorph.simulation, "amount", (1, 0.2), (20, 1.0))
    rest = extract.character(arm).vertices
    expected = rest + baked(arm)
    bpy.ops.dynamorph.live()
    shown = play(arm, range(1, 21))
    assert np.abs(shown - expected).max() < 1e-5
    now = run_live.remembered.live.sessions[arm.session_uid]
    assert (now.first, now.last, now.rig_changes) == (1, 20, 0)  # nothing began again
    np.testing.assert_allclose(play(arm, range(10, 21)), shown[9:], atol=1e-6)  # and what is known shows again


def test_an_amount_that_is_keyed_scales_what_shows(arm):
    """That of all motion, and that of a target, which counts in its pose."""
    still, whole = [], baked(arm)
    for target in arm.dynamorph.targets:
        target.amount = 0.0
    still = baked(arm)
    for target in arm.dynamorph.targets:
        target.amount = 1.0
    key(arm.dynamorph.simulation, "amount", (1, 0.0), (11, 1.0))
    part = np.clip(np.arange(20) / 10.0, 0.0, 1.0)[:, None, None]
    np.testing.assert_allclose(baked(arm), still + part * (whole - still), atol=1e-6)
    arm.animation_data_clear()
    arm.dynamorph.simulation.amount = 1.0
    for target in arm.dynamorph.targets:
        key(target, "amount", (1, 1.0), (11, 0.0))
    np.testing.assert_allclose(baked(arm), whole + part * (still - whole), atol=1e-6)


def test_distance_and_friction_are_those_of_each_step(arm):
    """A ball that stands still pushes the skin away as its Distance grows."""
    collision = arm.dynamorph.collision
    ball = make_ball(radius=0.2)
    ball.location = (0.5 + 0.02, 0.0, 0.7)
    rig_of(arm).animation_data_clear()
    rig_of(arm).pose.bones["lower"].rotation_euler.x = 0.0
    arm.dynamorph.simulation.gravity = 0.0
    collision.use, collision.use_friction = True, True
    key(collision, "distance", (1, 0.0), (5, 0.0), (15, 0.04))
    key(collision, "friction", (1, 0.0), (20, 1.9))
    samples = rig_motion.sample_rig(arm, 1, 20, 5)
    assert isinstance(samples.track(KeyedSettings), KeyedSettings)
    (ball_track,) = [track for track in samples.tracks if getattr(track, "name", "") == "Ball"]
    np.testing.assert_allclose(ball_track.friction, np.linspace(0.0, 1.9, 96), atol=1e-6)
    for full in (False, True):
        collision.bake_full = full
        moved = np.abs(baked(arm)).max(axis=(1, 2))
        assert moved[3] < 2e-3
        assert moved[-1] > 0.02


def test_nothing_depends_on_the_frame_that_shows(arm):
    key_stiffness(arm, (1, SOFT), (20, FIRM))
    key(arm.dynamorph.simulation, "amount", (1, 0.2), (20, 1.0))
    bpy.ops.dynamorph.bake()
    first = baked(arm)
    bpy.context.scene.frame_set(17)
    staleness.look_at_animation(arm)
    assert staleness.outdated(arm) == []
    np.testing.assert_array_equal(baked(arm), first)


def test_a_setup_has_the_values_of_the_first_keys(arm):
    key_stiffness(arm, (1, SOFT), (20, FIRM))
    key(arm.dynamorph.simulation, "amount", (5, 0.25), (20, 1.0))
    setups_of = []
    for frame in (1, 17):
        bpy.context.scene.frame_set(frame)
        setups_of.append(setups.of_object(arm))
    assert setups_of[0] == setups_of[1]
    assert setups_of[0]["targets"][1]["stiffness"] == SOFT and setups_of[0]["simulation"]["amount"] == 0.25


def test_undo_brings_keys_back(arm):
    first = baked(arm)
    bpy.ops.ed.undo_push(message="as it was")
    key_stiffness(arm, (1, SOFT), (20, FIRM))
    bpy.ops.ed.undo_push(message="keyed")
    changing = baked(arm)
    bpy.ops.ed.undo()
    np.testing.assert_array_equal(baked(bpy.data.objects["Arm"]), first)
    bpy.ops.ed.redo()
    np.testing.assert_array_equal(baked(bpy.data.objects["Arm"]), changing)


def test_an_edited_key_outdates_a_bake(arm):
    key_stiffness(arm, (1, SOFT), (20, FIRM))
    bpy.ops.dynamorph.bake()
    animation.curves(arm.animation_data.action, arm.animation_data.action_slot)[0].keyframe_points[1].co.y = 2 * FIRM
    staleness.look_at_animation(arm)
    assert any("animation of" in text for text in staleness.outdated(arm))


def test_a_key_on_what_was_set_outdates_a_bake(arm):
    bpy.ops.dynamorph.bake()
    key(arm.dynamorph.targets[0], "stiffness", (1, SOFT))
    assert any("Stiffness" in text for text in staleness.outdated(arm))


def test_a_bounce_does_not_replace_keys(arm):
    """A build computes the stiffness from Bounce, where that was set; not of a target whose stiffness is keyed."""
    neutral = arm.dynamorph.targets[0]
    neutral.bounce = 5.0
    key(neutral, "stiffness", (1, SOFT))
    assert extract.character(arm).targets[0].material.stiffness == SOFT
    neutral.frequency = 9.0
    bpy.ops.dynamorph.build()
    assert neutral.stiffness == pytest.approx(SOFT)


def test_drivers_count_like_keys(arm):
    rig_of(arm)["tension"] = 1.0
    rig_of(arm).update_tag()
    set_stiffness(arm, FIRM)
    firm = baked(arm)
    set_stiffness(arm, SOFT)
    for target in arm.dynamorph.targets:
        driver = target.driver_add("stiffness").driver
        variable = driver.variables.new()
        variable.name = "tension"
        variable.targets[0].id, variable.targets[0].data_path = rig_of(arm), '["tension"]'
        driver.expression = f"{SOFT} + tension * {FIRM - SOFT}"
    assert apart(baked(arm), firm) < 1e-4
    bpy.ops.dynamorph.bake()
    assert staleness.outdated(arm) == []
    rig_of(arm)["tension"] = 0.5  # what a driver reads
    assert any("Stiffness" in text for text in staleness.outdated(arm))


def test_what_does_not_play_is_not_keyed(arm):
    """A curve or a driver that is muted: the value counts, and is recorded."""
    key_stiffness(arm, (1, FIRM))
    driver = arm.dynamorph.simulation.driver_add("amount")
    driver.driver.expression = "0.5"
    assert len(keyed.settings(arm)) == 3
    for curve in (*animation.curves(arm.animation_data.action, arm.animation_data.action_slot), driver):
        curve.mute = True
    assert keyed.settings(arm) == []
    set_stiffness(arm, SOFT)
    bpy.ops.dynamorph.bake()
    set_stiffness(arm, FIRM)
    assert any("Stiffness" in text for text in staleness.outdated(arm))


def test_a_driver_may_read_any_data(arm):
    """A collection's property, a bone, a shape key's value. Live follows when an artist changes what it reads."""
    collection = bpy.data.collections.new("Settings")
    bpy.context.scene.collection.children.link(collection)
    collection["tension"] = 1.0
    key_block = arm.data.shape_keys.key_blocks["smile"]
    for target, source, path in zip(
        arm.dynamorph.targets,
        (collection, arm.data.shape_keys),
        ('["tension"]', 'key_blocks["smile"].value'),
        strict=True,
    ):
        driver = target.driver_add("stiffness").driver
        variable = driver.variables.new()
        variable.name, variable.targets[0].id_type = "tension", "COLLECTION" if source == collection else "KEY"
        variable.targets[0].id, variable.targets[0].data_path = source, path
        driver.expression = f"{SOFT} + tension * {FIRM - SOFT}"
    bpy.context.view_layer.update()
    rest = extract.character(arm).vertices
    bpy.ops.dynamorph.live()
    np.testing.assert_allclose(play(arm, range(1, 21)), rest + baked(arm), atol=1e-5)
    key_block.value = 0.5
    arm.data.shape_keys.key_blocks["smile"].mute = True
    bpy.context.view_layer.update()
    np.testing.assert_allclose(play(arm, range(1, 21)), rest + baked(arm), atol=1e-5)


def test_a_copy_keeps_the_keys_of_its_original(arm):
    """Blender lets both have one Action. A target that one of them loses is still keyed in the other."""
    bpy.ops.dynamorph.add_target(key="smile")
    key(arm.dynamorph.targets[2], "stiffness", (1, FIRM))
    copied = arm.copy()
    copied.data = arm.data.copy()
    bpy.context.scene.collection.objects.link(copied)
    assert copied.animation_data.action == arm.animation_data.action
    targets.remove(copied, 1)
    assert [each.setting.name for each in keyed.settings(copied)] == ["smile"]
    assert [each.setting.name for each in keyed.settings(arm)] == ["smile"]


def test_a_comparison_is_of_what_was_simulated(arm):
    """Not of how much of it shows: with an Amount that is keyed, the error is that without."""
    bpy.ops.dynamorph.bake()
    bpy.ops.dynamorph.compare_full()
    expected = arm.dynamorph.bake.off_full
    key(arm.dynamorph.simulation, "amount", (1, 0.1))
    bpy.ops.dynamorph.bake()
    bpy.ops.dynamorph.compare_full()
    assert arm.dynamorph.bake.off_full == pytest.approx(expected, rel=1e-3)


def test_what_a_driver_reads_of_a_place_counts(arm):
    """An object that nothing moves: where it stands is part of what the bake was made from."""
    empty = bpy.data.objects.new("Tension", None)
    bpy.context.scene.collection.objects.link(empty)
    driver = arm.dynamorph.targets[0].driver_add("stiffness").driver
    variable = driver.variables.new()
    variable.name, variable.type = "high", "TRANSFORMS"
    variable.targets[0].id, variable.targets[0].transform_type = empty, "LOC_Z"
    driver.expression = f"{SOFT} * (1.0 + high)"
    bpy.context.view_layer.update()
    bpy.ops.dynamorph.bake()
    assert staleness.outdated(arm) == []
    empty.location.z = 2.0
    assert any("Stiffness" in text for text in staleness.outdated(arm))


def test_a_driver_that_does_not_work_is_refused(arm):
    driver = arm.dynamorph.targets[1].driver_add("stiffness").driver
    driver.expression = "1e4 + unknown"
    bpy.context.view_layer.update()
    with pytest.raises(SceneError, match=r"the driver of targets\[1\].stiffness does not work"):
        rig_motion.sample_rig(arm, 1, 20, 5)


def test_the_method_shape_has_the_material_of_the_neutral_target(arm):
    arm.dynamorph.model.method = "SHAPE"
    bpy.ops.dynamorph.build()
    set_stiffness(arm, FIRM)
    firm = baked(arm)
    set_stiffness(arm, SOFT)
    soft = baked(arm)
    key(arm.dynamorph.targets[1], "stiffness", (1, FIRM))
    assert apart(baked(arm), soft) < 1e-9
    arm.animation_data_clear()
    set_stiffness(arm, SOFT)
    key(arm.dynamorph.targets[0], "stiffness", (1, FIRM))
    assert apart(baked(arm), firm) < 1e-4


def test_a_loop_says_when_its_ends_are_keyed_differently(arm):
    for curve in animation.curves(rig_of(arm).animation_data.action, rig_of(arm).animation_data.action_slot):
        for point in curve.keyframe_points:
            point.co.y = 0.0
    arm.dynamorph.simulation.loop = True
    key(arm.dynamorph.simulation, "amount", (1, 0.0), (20, 1.0))
    job = Job(arm, goal="BAKE", stored=False)
    batch.run(job)
    assert any("have other values at frame 20 than at frame 1" in text for text in job.outcome.warnings)


def test_keys_follow_their_targets_into_a_setup(arm):
    """A setup may have the targets in another order."""
    bpy.ops.dynamorph.add_target(key="smile")
    key(arm.dynamorph.targets[2], "stiffness", (1, FIRM))
    setup = setups.of_object(arm)
    setup["targets"][1:] = setup["targets"][:0:-1]
    setups.apply(arm, setup)
    assert [target.name for target in arm.dynamorph.targets][1:] == ["smile", "flexed"]
    assert [each.setting.name for each in keyed.settings(arm)] == ["smile"]


def test_what_is_no_number_is_refused(arm):
    key_stiffness(arm, (1, SOFT), (6, FIRM), interpolation="CONSTANT")
    curve = animation.curves(arm.animation_data.action, arm.animation_data.action_slot)[1]
    curve.keyframe_points[1].co.y = np.nan
    with pytest.raises(SceneError, match=r"targets\[1\].stiffness is not a number at frame 6"):
        rig_motion.sample_rig(arm, 1, 20, 5)


def test_a_bake_resumes_with_what_is_keyed(arm, tmp_path, monkeypatch):
    key_stiffness(arm, (1, SOFT), (20, FIRM))
    key(arm.dynamorph.simulation, "amount", (1, 0.2), (20, 1.0))
    monkeypatch.setattr(bake_input, "SHORT_CHUNK_FRAMES", 6)
    expected = baked(arm, cache_dir=CacheDir(tmp_path / "whole"))
    stopped = batch.Batch([Job(arm, goal="BAKE", stored=False, cache_dir=CacheDir(tmp_path))], "BAKE")
    for _ in stopped.steps(0.0):
        if list(tmp_path.glob("*.unfinished")):
            break
    stopped.stop()
    resumed = Job(arm, goal="BAKE", stored=False, cache_dir=CacheDir(tmp_path))
    batch.run(resumed)
    assert 5 < len(resumed.input.resumed["coordinates"]) < 20
    bake = resumed.outcome.bake
    found = np.array([bake.displacement(k) for k in range(len(bake.frames))])
    np.testing.assert_allclose(found, expected, atol=1e-9)
