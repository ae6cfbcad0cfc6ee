# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene around a soft skin: how its rig is placed, other modifiers, time, motion blur, rendering."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion, run_settings
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store
from bl_ext.user_default.dynamic_morph_targets.write import storage
from builders import activate, evaluated_points, fingerprint, make_soft, rig_of
from mathutils import Matrix
from robustness import OPS, bake, coarse, motion
from test_baking import assert_shows, keys_of
from test_extract import skinned
from test_operators import refused


@pytest.fixture
def skin(soft_arm):
    """A soft arm for the real engine."""
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    return coarse(soft_arm)


# How the rig is placed ---------------------------------------------------------------------------------------------


def parented(obj):
    """Mesh below armature below an empty, as rigs are built; returns the empty."""
    root = bpy.data.objects.new("Root", None)
    bpy.context.scene.collection.objects.link(root)
    obj.parent, rig_of(obj).parent = rig_of(obj), root
    return root


def traveling(obj):
    root = parented(obj)
    for frame, x in ((1, 0.0), (20, 2.0)):
        root.location.x, root.rotation_euler.z = x, x
        root.keyframe_insert("location", frame=frame)
        root.keyframe_insert("rotation_euler", frame=frame)


def in_centimeters(obj, units=100.0):
    """Many exporters write an armature and a mesh 100 times too large, below an object of scale 0.01."""
    root = parented(obj)
    root.scale = (1.0 / units, 1.0 / units, 1.0 / units)
    activate(rig_of(obj))
    bpy.ops.object.mode_set(mode="EDIT")
    for bone in rig_of(obj).data.edit_bones:
        bone.head, bone.tail = units * bone.head, units * bone.tail
    bpy.ops.object.mode_set(mode="OBJECT")
    activate(obj)
    obj.data.transform(Matrix.Scale(units, 4), shape_keys=True)


def stretched(obj):
    parented(obj)
    rig_of(obj).scale = (1.3, 0.8, 1.1)


def mirrored(obj):
    parented(obj).scale = (-1.0, 1.0, 1.0)


def mirrored_rig_alone(obj):
    rig_of(obj).scale = (-1.0, 1.0, 1.0)


def turned_and_mirrored_mesh(obj):
    parented(obj)
    obj.matrix_parent_inverse = Matrix.Rotation(0.4, 4, "Z") @ Matrix.Scale(-1.0, 4, (0, 1, 0))


PLACES = [traveling, in_centimeters, stretched, mirrored, mirrored_rig_alone, turned_and_mirrored_mesh]
PLAYED = range(1, 21)  # frames


@pytest.mark.fault("M16")
@pytest.mark.parametrize("place", PLACES)
def test_placed_rigs(skin, place):
    """Blender shows the engine's surface, skinned by our own arithmetic."""
    place(skin)
    bpy.context.view_layer.update()
    job = bake(skin)
    displacement = np.array([job.outcome.bake.displacement(k) for k in range(20)])
    assert np.isfinite(displacement).all() and np.abs(displacement[10]).max() > 1e-4
    assert_shows(skin, job.outcome.bake)


@pytest.mark.fault("M16")
def test_a_mirrored_character_moves_as_its_mirror_image(skin):
    bake(skin)
    shown = motion(skin)
    mirrored(skin)
    bpy.context.view_layer.update()
    assert bake(skin).input.reasons == []
    assert np.abs(motion(skin) - shown * [-1.0, 1.0, 1.0]).max() < 1e-4


def test_small_units_below_a_small_scale_change_nothing(scene, skin):
    """The scale is a power of two, so nothing is rounded: the cage and the motion in the world are the same.

    The targets' poses, whose sag is balanced, were captured before.
    """
    bake(skin)
    shown = motion(skin)
    in_centimeters(skin, units=128.0)
    scene.frame_set(1)
    assert "mesh changed" in bake(skin).input.reasons
    assert np.abs(motion(skin) - shown).max() < 1e-4


@pytest.mark.parametrize("kind", ["rotation", "scale"])
@pytest.mark.parametrize("pose", ["neutral", "flexed"])
def test_gravity_is_still_balanced_after_a_transform_is_applied(scene, arm, kind, pose):
    """Nothing sags in a target's pose and orientation; another transform of the rig's object does not count as another
    orientation.
    """
    pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    both = (arm, rig_of(arm))
    for each in both:
        each.rotation_euler, each.scale = (0.4, 1.1, 0.3), (0.5, 0.5, 0.5)
    bpy.context.view_layer.update()
    skin = coarse(make_soft(arm))
    scene.frame_set(20 if pose == "flexed" else 1)
    rig_of(arm).animation_data_clear()
    for each in both:
        each.select_set(True)
    bpy.ops.object.transform_apply(location=False, **{name: name == kind for name in ("rotation", "scale")})
    job = bake(skin, frames=(1, 5))
    target = job.outcome.character.targets[pose == "flexed"]
    assert job.outcome.bake.weights[-1, int(pose == "flexed")] == pytest.approx(1.0)
    for k in range(5):
        assert np.abs(job.outcome.bake.displacement(k) - target.shape).max() < 1e-5


# Skinning by more than weights -------------------------------------------------------------------------------------


def envelopes(obj):
    obj.modifiers["Armature"].use_bone_envelopes = True


def envelope_multiply(obj):
    rig_of(obj).data.bones["lower"].use_envelope_multiply = True


@pytest.mark.fault("R01")
@pytest.mark.parametrize(
    "change, words",
    [
        (envelopes, "'Arm' is skinned by bone envelopes: in Armature modifier 'Armature' turn"),
        (envelope_multiply, "Bone 'lower' of 'Arm Rig': turn off Envelope Multiply"),
    ],
)
def test_other_skinning_is_refused_and_nothing_changes(scene, skin, change, words):
    bake(skin)
    change(skin)
    scene.frame_set(1)
    before, model = fingerprint(skin), model_store.stored_model(skin)
    for button in (OPS.bake, OPS.build, OPS.capture_pose, OPS.fit_material):
        refused(button, words)
    assert fingerprint(skin) == before and model_store.stored_model(skin) == model
    storage.show_stale(skin)
    assert words in skin.dynamorph.model.stale
    assert np.isfinite(motion(skin)).all()  # the bake still plays
    assert OPS.delete_bake() == {"FINISHED"}


# Modifiers after the armature --------------------------------------------------------------------------------------


def subdivision(obj):
    obj.modifiers.new("After", "SUBSURF").levels = 1


def mask(obj):
    obj.modifiers.new("After", "MASK").vertex_group = "upper"


def corrective_smooth(obj):
    obj.modifiers.new("After", "CORRECTIVE_SMOOTH")


@pytest.mark.fault("M17")
@pytest.mark.parametrize("add", [subdivision, mask, corrective_smooth])
def test_modifiers_after_the_armature(scene, skin, add):
    plain = bake(skin).outcome.bake
    bare = motion(skin)
    add(skin)
    job = bake(skin)
    assert job.input.reasons == [] and job.warnings == []
    np.testing.assert_array_equal(job.outcome.bake.coordinates, plain.coordinates)
    for i, frame in enumerate((1, 7, 13, 20)):
        scene.frame_set(frame)
        shown = evaluated_points(skin)
        assert np.isfinite(shown).all() and len(shown)
        assert (shown.max(axis=0) < bare[i].max(axis=0) + 0.1).all()
        assert (shown.min(axis=0) > bare[i].min(axis=0) - 0.1).all()
    assert (len(shown) > 272, len(shown) < 272) == (add == subdivision, add == mask)
    skin.modifiers["After"].show_viewport = False
    assert_shows(skin, job.outcome.bake)


# Time --------------------------------------------------------------------------------------------------------------


def test_twice_the_frame_rate_is_the_same_motion(scene, skin):
    """39 frames at 48 per second last as long as 20 at 24, with steps of the same length."""
    curves = rig_of(skin).animation_data.action.layers[0].strips[0].channelbags[0].fcurves
    for curve in curves:
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"
    slow = bake(skin, substeps=10).outcome.bake
    for curve in curves:
        for point in curve.keyframe_points:
            point.co.x = 2.0 * point.co.x - 1.0
        curve.update()
    scene.render.fps = 48
    fast = bake(skin, frames=(1, 39), substeps=5).outcome.bake
    np.testing.assert_allclose(fast.coordinates[::2], slow.coordinates, atol=1e-3 * np.abs(slow.coordinates).max())


@pytest.mark.parametrize("fps, base", [(24, 1.001), (30, 1.0), (60, 1.0), (12, 0.5)])
def test_frame_rates(scene, skin, fps, base):
    scene.render.fps, scene.render.fps_base = fps, base
    settings = run_settings.simulation_settings(skin, scene)
    assert settings.fps == pytest.approx(fps / base)
    assert settings.step == pytest.approx(base / fps / settings.substeps) and settings.step <= 1.01 / 120.0
    assert_shows(skin, bake(skin).outcome.bake)


@pytest.mark.parametrize("speed, fps", [(0.5, 48), (0.25, 96), (2.0, 12)])
def test_a_speed_is_another_frame_rate_of_the_soft_skin(scene, skin, speed, fps):
    """The same frames in another time: to the last bit what a scene with that many frames in a second gives."""
    skin.dynamorph.simulation.speed = speed
    slow = bake(skin)
    assert slow.input.settings.step <= 1.01 / 120.0
    OPS.delete_bake()
    skin.dynamorph.simulation.speed, scene.render.fps = 1.0, fps
    as_fast = bake(skin)
    assert slow.input.settings.substeps == as_fast.input.settings.substeps
    np.testing.assert_array_equal(slow.outcome.bake.coordinates, as_fast.outcome.bake.coordinates)


def test_in_slow_motion_a_swing_takes_more_frames(scene, skin):
    """A body that a rig in uniform motion takes along from rest swings freely: as often in a second as before, and so
    in 1 / Speed as many frames.
    """
    rig, settings = rig_of(skin), skin.dynamorph.simulation
    rig.animation_data_clear()
    rig.pose.bones["lower"].rotation_euler.x = 0.0
    skin.parent = rig
    for frame, x in ((1, 0.0), (2, 0.001)):
        rig.location.x = x
        rig.keyframe_insert("location", frame=frame)
    for curve in rig.animation_data.action.layers[0].strips[0].channelbags[0].fcurves:
        curve.extrapolation, curve.keyframe_points[0].interpolation = "LINEAR", "LINEAR"
    settings.initial_state, settings.gravity, settings.substeps = "REST_SHAPE", 0.0, 10
    for target in skin.dynamorph.targets:
        target.mass_damping, target.stiffness_damping = 1.0, 0.0
    swings = {}
    for speed in (1.0, 0.5, 0.25):
        settings.speed, scene.frame_end = speed, round(60 / speed)
        swing = bake(skin).outcome.bake.coordinates[:, 0]
        spectrum = np.abs(np.fft.rfft(swing - swing.mean(), 64 * len(swing)))
        swings[speed] = spectrum.argmax() / 64 / len(swing)  # per frame
    assert 1.0 < 24.0 * swings[1.0] < 3.0
    assert swings[0.5] == pytest.approx(0.5 * swings[1.0], rel=0.01)
    assert swings[0.25] == pytest.approx(0.25 * swings[1.0], rel=0.01)


def then_live(scene, skin) -> np.ndarray:
    """The motion of a bake, once Live, which is on afterward, has shown the same."""
    bake(skin)
    baked = motion(skin, PLAYED)
    OPS.delete_bake()
    scene.frame_set(1)
    OPS.live()
    assert np.abs(motion(skin, PLAYED) - baked).max() < 1e-5
    return baked


def test_live_in_slow_motion_is_the_bake(scene, skin):
    skin.dynamorph.simulation.speed = 0.5
    baked = then_live(scene, skin)
    skin.dynamorph.simulation.speed = 1.0
    assert np.abs(motion(skin, PLAYED) - baked).max() > 1e-3


@pytest.mark.fault("A08")
@pytest.mark.parametrize("old, new", [(100, 200), (100, 50), (100, 97)])
def test_remapped_time(scene, skin, old, new):
    """Blender plays animation, and so the bake's curves, at another frame than the scene's."""
    before = fingerprint(skin)
    scene.render.frame_map_old, scene.render.frame_map_new = old, new
    job = bake(skin, frames=(-2, 20))
    assert np.abs(np.diff(job.outcome.bake.coordinates, axis=0)).max() > 0
    assert_shows(skin, job.outcome.bake)
    assert OPS.delete_bake() == {"FINISHED"}
    assert fingerprint(skin) == before


def test_live_in_remapped_time_is_the_bake(scene, skin):
    scene.render.frame_map_new = 200
    then_live(scene, skin)


def test_time_remapped_after_the_bake_keeps_rig_and_tissue_together(scene, skin):
    job = bake(skin)
    scene.render.frame_map_new = 200
    for frame in (3, 9, 19):
        scene.frame_set(2 * frame)
        rig = rig_motion.sample_rig(skin, 2 * frame, 2 * frame, 1)
        expected = skinned(extract.character(skin), rig, job.outcome.bake.displacement(frame - 1))[0]
        assert np.abs(evaluated_points(skin) - expected).max() < 2e-5


@pytest.mark.fault("A07")
@pytest.mark.parametrize("frames", [(-10, 5), (-3, -3), (7, 7), (0, 1)])
def test_ranges(skin, frames):
    job = bake(skin, frames=frames)
    assert job.outcome.bake.frames.tolist() == list(range(frames[0], frames[1] + 1))
    assert_shows(skin, job.outcome.bake)


@pytest.mark.fault("A07")
def test_a_range_that_ends_before_it_begins(skin):
    bake(skin)
    keys = fingerprint(skin)["keys"]
    skin.dynamorph.simulation.use_scene_range = False
    skin.dynamorph.simulation.frame_start, skin.dynamorph.simulation.frame_end = -1, -2
    refused(OPS.bake, "last frame -2 comes before the first -1")
    assert fingerprint(skin)["keys"] == keys


@pytest.mark.fault("A05")
def test_sub_frames_lie_in_between(scene, skin):
    job = bake(skin)
    character, samples = extract.character(skin), rig_motion.sample_rig(skin, 1, 20, 4)
    for s in range(len(samples)):
        frame, part_of_it = divmod(s, 4)
        scene.frame_set(1 + frame, subframe=part_of_it / 4)
        before, after = job.outcome.bake.displacement(frame), job.outcome.bake.displacement(min(frame + 1, 19))
        between = before + (after - before) * part_of_it / 4
        assert np.abs(evaluated_points(skin) - skinned(character, samples[s : s + 1], between)[0]).max() < 2e-5


# Rendering ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def film(scene, skin, tmp_path):
    """Renders frames of the arm, a few pixels each, and returns the pictures (F, H, W, 4)."""
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.max_bounces = 4, False, 0
    scene.cycles.use_adaptive_sampling = False
    scene.render.resolution_x = scene.render.resolution_y = 16
    scene.render.film_transparent = True
    scene.render.filepath = str(tmp_path / "shot_")
    scene.render.image_settings.file_format = "PNG"
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale = "ORTHO", 4.0
    camera.matrix_world = Matrix.Translation((5.0, 0.0, 1.0)) @ Matrix.Rotation(np.pi / 2, 4, "Y")
    scene.collection.objects.link(camera)
    scene.camera = camera

    def render(first, last):
        scene.frame_start, scene.frame_end = first, last
        assert bpy.ops.render.render(animation=True) == {"FINISHED"}
        pictures = []
        for frame in range(first, last + 1):
            image = bpy.data.images.load(str(tmp_path / f"shot_{frame:04d}.png"))
            pictures.append(np.array(image.pixels).reshape(16, 16, 4))
            bpy.data.images.remove(image)
        return np.array(pictures)

    return render


def bake_fast(obj):
    """Much motion between frames."""
    rig = rig_of(obj)
    for frame, angle in ((10, 0.0), (11, 1.5)):
        rig.pose.bones["upper"].rotation_euler.x = angle
        rig.pose.bones["upper"].keyframe_insert("rotation_euler", frame=frame)
    return bake(obj)


@pytest.mark.fault("A05")
def test_motion_blur(scene, skin, film):
    """Cycles asks for sub-frames out of order; the bake has no memory that they could spoil."""
    job = bake_fast(skin)
    scene.frame_set(1)
    before = fingerprint(skin)
    sharp = film(10, 11)
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
    blurred = film(10, 11)
    assert (blurred[..., 3] > 0).sum() > (sharp[..., 3] > 0).sum()
    np.testing.assert_array_equal(film(10, 11), blurred)
    scene.frame_set(1)
    assert fingerprint(skin) == before
    assert_shows(skin, job.outcome.bake)


@pytest.mark.fault("A04", "G04")
def test_playing_while_rendering(scene, skin, film):
    """Scripts that change the frame before and after each rendered one do not change what is rendered."""
    job = bake_fast(skin)
    expected = film(9, 11)
    seen = []

    def jump(scene, *_args):
        frame = scene.frame_current
        for other in (20, 1, frame):
            scene.frame_set(other)
        seen.append((frame, keys_of(skin).key_blocks["Dynamorph Mode 01"].value))

    added = (bpy.app.handlers.render_pre, bpy.app.handlers.render_post)
    for handlers in added:
        handlers.append(jump)
    try:
        np.testing.assert_array_equal(film(9, 11), expected)
    finally:
        for handlers in added:
            handlers.remove(jump)
    first = job.outcome.bake.coordinates[:, 0] / np.abs(job.outcome.bake.coordinates[:, 0]).max()
    assert [frame for frame, _ in seen] == [9, 9, 10, 10, 11, 11]
    assert [value for _, value in seen] == pytest.approx([first[frame - 1] for frame, _ in seen], abs=1e-6)
    assert_shows(skin, job.outcome.bake)
