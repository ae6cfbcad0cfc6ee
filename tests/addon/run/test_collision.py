# SPDX-License-Identifier: GPL-3.0-or-later
"""A ball is pressed into the arm: the skin gives way where it is touched, in bakes and in Live alike."""

import os

import bmesh
import bpy
import characters
import numpy as np
import pytest
import real_character
from bl_ext.user_default.dynamic_morph_targets.core.errors import SceneError
from bl_ext.user_default.dynamic_morph_targets.core.motion import baked, contact
from bl_ext.user_default.dynamic_morph_targets.io.cache_dir import CacheDir
from bl_ext.user_default.dynamic_morph_targets.run import live as run_live
from bl_ext.user_default.dynamic_morph_targets.run import remembered
from bl_ext.user_default.dynamic_morph_targets.run.bake import bake_input, batch, full_comparison
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.run.playing.tissue import Tissue
from bl_ext.user_default.dynamic_morph_targets.run.tools import preview
from bl_ext.user_default.dynamic_morph_targets.scene import animation
from bl_ext.user_default.dynamic_morph_targets.scene.remembered import opened
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store, staleness
from bl_ext.user_default.dynamic_morph_targets.ui.overlays import viewport as overlays
from bl_ext.user_default.dynamic_morph_targets.write import reconcile, storage
from bl_ext.user_default.dynamic_morph_targets.write.authoring import setups
from builders import activate, add_key, evaluated_points, make_arm, make_ball, make_box, rig_of, soon
from built import BuiltOnce
from layout import drawn

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

RADIUS, HEIGHT, SURFACE, SIZE = 0.2, 1.0, 0.3, 2.18  # meters: of the ball, of its place, of the arm, and its diagonal
PRESSED, FRAMES = 0.04, 16  # how deep it is pressed, and by which frame it rests
built = BuiltOnce()


def still_arm(scene, **size):
    """An arm that does not move, with Soft Skin."""
    obj = make_arm(scene, **size)
    rig_of(obj).animation_data_clear()
    rig_of(obj).pose.bones["lower"].rotation_euler.x = 0.0
    scene.frame_end = FRAMES
    activate(obj)
    bpy.ops.dynamorph.add_soft_skin()
    return obj


@pytest.fixture
def arm(scene):
    """A still arm with a fine skin, built, and a ball that is pressed into its side."""
    obj = still_arm(scene, rings=61, around=48)
    settings = obj.dynamorph
    settings.model.cage_nodes, settings.model.modes, settings.simulation.gravity = 400, 60, 0.0
    built.give(obj, 10)
    ball = make_ball(radius=RADIUS)
    for frame, depth in ((1, -0.02), (FRAMES // 2, PRESSED)):
        ball.location = (SURFACE + RADIUS - depth, 0.0, HEIGHT)
        ball.keyframe_insert("location", frame=frame)
    scene.frame_set(1)
    settings.collision.use = True
    activate(obj)
    return obj


def bake(obj, **options):
    job = Job(obj, goal="BAKE", **options)
    batch.run(job)
    return job


def shown(obj, frames=range(1, FRAMES + 1)) -> np.ndarray:
    """Where Blender shows the skin (F, V, 3)."""
    found = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        found.append(evaluated_points(obj))
    return np.array(found)


def depths(points: np.ndarray, frames=range(1, FRAMES + 1)) -> list[float]:
    """How deep the skin is in the ball at each frame, meters."""
    out = []
    for frame, skin in zip(frames, points, strict=True):
        bpy.context.scene.frame_set(frame)
        center = np.array(bpy.data.objects["Ball"].matrix_world.translation)
        out.append(RADIUS - float(np.linalg.norm(skin - center, axis=1).min()))
    return out


@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
def test_the_skin_makes_room_for_a_ball(arm, solver):
    arm.dynamorph.collision.bake_full = solver == "FULL"
    rest = evaluated_points(arm)
    job = bake(arm)
    assert job.outcome.model.settings.solver == solver and (", Full Quality" in job.summary()) == (solver == "FULL")
    points = shown(arm)
    found = depths(points)
    print(solver, [round(1000 * depth, 2) for depth in found], job.outcome.report["iterations"])
    assert max(found) < 0.002 * SIZE
    assert np.linalg.norm(points[-1] - rest, axis=1).max() > 0.9 * PRESSED  # it is touched at all
    far = np.linalg.norm(rest - [SURFACE, 0.0, HEIGHT], axis=1) > 0.8
    arm.dynamorph.collision.use = False
    bake(arm)
    without = shown(arm)
    assert np.abs(without - rest).max() < 1e-4
    # Global modes alone make no dent: they move what is far away too.
    assert np.abs(points[-1] - without[-1])[far].max() < (0.1 if solver == "FULL" else 0.35) * PRESSED
    assert job.outcome.verdict.touched.left_inside == () and job.outcome.verdict.contact_texts == []


def test_a_ball_that_swells_dents_it_too(arm):
    """By a shape key, and as much by its scale."""
    ball = bpy.data.objects["Ball"]
    ball.animation_data_clear()
    ball.location.x = SURFACE + RADIUS + 0.01
    points = np.array([vertex.co for vertex in ball.data.vertices])
    ball.shape_key_add(name="Basis")
    key, swollen = add_key(ball, "Swollen", 0.25 * points), 1.25
    bakes = []
    for owner, path, values in ((key, "value", (0.0, 1.0)), (ball, "scale", ((1.0,) * 3, (swollen,) * 3))):
        for frame, value in zip((1, FRAMES // 2), values, strict=True):
            setattr(owner, path, value)
            owner.keyframe_insert(path, frame=frame)
        bake(arm)
        bakes.append(shown(arm))
        center = np.array(ball.matrix_world.translation)
        assert swollen * RADIUS - np.linalg.norm(bakes[-1][-1] - center, axis=1).min() < 0.002 * SIZE
        assert np.abs(bakes[-1][-1] - bakes[-1][0]).max() > 0.03
        ball.shape_key_clear()
    assert np.abs(bakes[0] - bakes[1]).max() < 1e-3


def test_live_shows_what_a_reduced_bake_does(arm):
    arm.dynamorph.collision.bake_full = False
    bake(arm)
    expected = shown(arm)
    bpy.ops.dynamorph.delete_bake()
    bpy.ops.dynamorph.live()
    assert np.abs(shown(arm) - expected).max() < 2e-3 * PRESSED + 1e-3 * np.abs(expected - expected[0]).max()


def test_live_plays_on_where_an_exporter_has_just_removed_an_object(arm, scene):
    """Blender's view layer has None there until it is updated, which a new frame does only after the handlers."""
    bpy.ops.dynamorph.live()
    mesh = bpy.data.meshes.new("Temporary")
    temporary = bpy.data.objects.new("Temporary", mesh)
    scene.collection.objects.link(temporary)
    bpy.context.view_layer.update()
    bpy.data.objects.remove(temporary)
    assert None in bpy.context.view_layer.objects[:]
    scene.frame_set(2)
    assert run_live.is_on(arm) and run_live.problem(arm) == ""


def test_chunks_and_another_process_give_the_same_bake(arm, monkeypatch, tmp_path):
    whole = baked.digest(bake(arm).outcome.bake)
    monkeypatch.setattr(bake_input, "CHUNK_FRAMES", 4)
    assert baked.digest(bake(arm).outcome.bake) == whole
    monkeypatch.setattr(bake_input, "SHORT_CHUNK_FRAMES", 5)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    killed = Job(arm, goal="BAKE", cache_dir=CacheDir(tmp_path))
    steps = batch.Batch([killed], "BAKE").steps()
    next(steps)
    while not (hasattr(killed, "computation") and killed.computation.shot and killed.computation.shot.done > 5):
        next(steps)
    resumed = bake(arm, cache_dir=CacheDir(tmp_path))
    assert len(resumed.input.resumed["coordinates"]) > 5
    assert baked.digest(resumed.outcome.bake) == whole


@pytest.mark.parametrize("travels", [False, True])
def test_a_loop_closes(arm, travels):
    ball, rig = bpy.data.objects["Ball"], rig_of(arm)
    ball.animation_data_clear()
    for frame, depth in ((1, -PRESSED), (6, PRESSED), (11, PRESSED), (FRAMES, -PRESSED)):
        ball.location.x = SURFACE + RADIUS - depth
        ball.keyframe_insert("location", frame=frame)
    if travels:
        ball.parent = arm.parent = rig
        for frame in (1, FRAMES):
            rig.location.y = frame / FRAMES
            rig.keyframe_insert("location", frame=frame)
    arm.dynamorph.simulation.loop = True
    job = bake(arm)
    assert job.outcome.report["gap"] < 1e-6 * SIZE and job.warnings == []
    assert job.outcome.verdict.displacement > 0.5 * PRESSED / SIZE


def test_a_bake_is_in_full_quality_with_the_model_that_live_has(arm):
    model = arm.dynamorph.model
    built = model.content_id, model.built
    job = bake(arm)
    assert job.input.reasons == [] and job.input.solver == "FULL" and job.outcome.packed is None
    assert (model.content_id, model.built, model.solver) == (*built, "REDUCED")
    assert staleness.outdated(arm) == [] and staleness.model_age(arm) == []
    assert arm.dynamorph.bake.off_full < 0.0
    digest = baked.digest(job.outcome.bake)
    arm.dynamorph.collision.bake_full = False
    assert staleness.outdated(arm) == ["Quality changed"]
    model.solver = "FULL"
    assert staleness.outdated(arm) == []
    assert baked.digest(bake(arm).outcome.bake) == digest


def test_a_model_that_a_full_bake_builds_serves_live(arm):
    arm.dynamorph.model.modes = 50
    job = bake(arm)
    assert job.input.reasons and job.input.solver == "FULL"
    assert model_store.load_model(arm).settings.solver == "REDUCED"
    bpy.ops.dynamorph.live()
    assert np.abs(play(arm, 1, FRAMES) - evaluated_points(arm)).max() < 1.0
    assert remembered.live.sessions[arm.session_uid].tissue.model.settings.solver == "REDUCED"


def test_what_touches_nothing_is_baked_as_chosen(arm):
    bpy.data.objects["Ball"].modifiers.clear()
    bpy.context.view_layer.update()
    assert bake(arm).input.solver == "REDUCED"
    arm.dynamorph.collision.use = False
    assert staleness.outdated(arm) == ["Collision changed"]


def test_the_comparison_has_both_qualities(arm):
    bake(arm)
    comparison = full_comparison.FullComparison(arm)
    batch.run_all(comparison)
    assert [job.outcome.model.settings.solver for job in comparison.jobs] == ["REDUCED", "FULL"]
    assert arm.dynamorph.bake.off_full > 0.01


def test_objects_pass_through_what_is_excluded(arm):
    rest = evaluated_points(arm)
    group = arm.vertex_groups.new(name="Untouched")
    group.add(np.flatnonzero(np.linalg.norm(rest - [SURFACE, 0.0, HEIGHT], axis=1) < 0.25).tolist(), 0.5, "REPLACE")
    bake(arm)
    with soon():
        arm.dynamorph.excluded_group = "Untouched"
    assert staleness.outdated(arm) == ["Exclude changed"]
    bake(arm)
    assert np.abs(shown(arm) - rest).max() < 1e-4
    assert staleness.outdated(arm) == []
    group.add(range(len(rest)), 0.49, "REPLACE")  # of which nothing is excluded
    storage.show_stale(arm)
    assert staleness.outdated(arm) == ["Exclude changed"]
    bake(arm)
    assert max(depths(shown(arm))) < 0.002 * SIZE
    arm.dynamorph.collision.use = False
    bake(arm)
    arm.dynamorph.excluded_group = ""
    assert staleness.outdated(arm) == []  # nothing collides


def test_the_group_is_kept_and_followed(arm):
    arm.vertex_groups.new(name="Untouched").add([0], 1.0, "REPLACE")
    arm.dynamorph.excluded_group = "Untouched"
    reconcile.reconcile(arm)
    arm.vertex_groups["Untouched"].name = "Mouth"
    reconcile.reconcile(arm)
    assert arm.dynamorph.excluded_group == "Mouth"
    setup = setups.of_object(arm)
    arm.dynamorph.excluded_group = ""
    setups.apply(arm, setup)
    assert arm.dynamorph.excluded_group == "Mouth"
    arm.vertex_groups.remove(arm.vertex_groups["Mouth"])
    with pytest.raises(SceneError, match="'Arm'.*'Mouth' of Exclude is gone"):
        bake(arm)


def test_without_colliders_it_changes_nothing(arm):
    bpy.data.objects["Ball"].modifiers.clear()
    bpy.context.view_layer.update()
    on = baked.digest(bake(arm).outcome.bake)
    arm.dynamorph.collision.use = False
    assert baked.digest(bake(arm).outcome.bake) == on


def test_what_the_bones_take_too_deep_is_reported(arm):
    ball = bpy.data.objects["Ball"]
    ball.animation_data_clear()
    for frame, place in ((1, 0.6), (6, 0.15), (10, 0.15), (15, 0.6)):
        ball.location.x = place
        ball.keyframe_insert("location", frame=frame)
    job = bake(arm)
    (text,) = job.outcome.verdict.contact_texts
    assert text.startswith("Bone '") and "mm too deep into 'Ball' at frames" in text
    assert text in job.warnings and "too deep into 'Ball'" in " ".join(drawn(arm))
    bpy.ops.dynamorph.delete_bake()
    bpy.ops.dynamorph.live()
    points = shown(arm)
    assert "too deep into 'Ball'" in " ".join(drawn(arm))
    assert np.isfinite(points).all() and np.abs(points - points[0]).max() < 0.5 * SIZE


def test_what_the_skin_gives_way_to_is_not_too_deep(arm):
    """Deeper than where contact begins to fade, but in the end outside."""
    ball = bpy.data.objects["Ball"]
    ball.animation_data_clear()
    for frame, place in ((1, 0.52), (10, 0.27)):
        ball.location.x = place
        ball.keyframe_insert("location", frame=frame)
    job = bake(arm)
    assert max(depths(shown(arm))) < 0.002 * SIZE
    assert job.outcome.verdict.contact_texts == []


def test_each_that_is_too_deep_is_reported_and_the_advice_is_about_what_presses(arm):
    ball, other = bpy.data.objects["Ball"], make_ball("Other", radius=RADIUS)
    ball.animation_data_clear()
    places = {ball: (0.6, 0.16, 0.6, 0.6), other: (-0.6, -0.6, -0.6, -0.14)}
    for each, along in places.items():
        for frame, place in zip((1, 5, 9, 14), along, strict=True):
            each.location = (place, 0.0, HEIGHT)
            each.keyframe_insert("location", frame=frame)
    arm.dynamorph.simulation.max_displacement = 0.001
    job = bake(arm)
    names = [each.collider for each in job.outcome.verdict.touched.left_inside]
    assert names == ["Other", "Ball"] and len(job.outcome.verdict.contact_texts) == 2
    text = f"{job.outcome.verdict.text}, where objects press it: move them away, raise Distance (Collision), or paint"
    assert job.warnings[-1].startswith(text)
    assert "dynamorph.stiffen" not in drawn(arm)


def test_a_collider_without_size_is_reported_with_its_frames(arm):
    ball = bpy.data.objects["Ball"]
    for frame, place, size in ((1, 0.6, 1.0), (9, SURFACE, 0.0), (13, 0.6, 1.0)):
        ball.scale, ball.location.x = (size,) * 3, place
        ball.keyframe_insert("scale", frame=frame)
        ball.keyframe_insert("location", frame=frame)
    for curve in animation.curves(ball.animation_data.action, ball.animation_data.action_slot):
        for point in curve.keyframe_points:
            point.interpolation = "CONSTANT"
    job = bake(arm)
    text = "'Ball' does not stop anything at frames 9 to 13, because it is scaled to zero there"
    assert job.outcome.verdict.contact_texts == [text] and text in job.warnings
    assert " ".join(drawn(arm)).count("'Ball' does not stop anything at frames 9 to") == 1  # in Result
    bpy.ops.dynamorph.delete_bake()
    bpy.ops.dynamorph.live()
    play(arm, 1, FRAMES)
    assert "'Ball' does not stop anything at frames 9 to" in " ".join(drawn(arm))


# Bad starts ----------------------------------------------------------------------------------------------


def begins_inside(ball):
    ball.location.x = SURFACE


def jumps_in(ball):
    for frame, place in ((1, 3.0), (6, SURFACE + 0.1), (12, -3.0)):
        ball.location.x = place
        ball.keyframe_insert("location", frame=frame)
    interpolate(ball, "CONSTANT")


def surrounds_the_arm(ball):
    bpy.context.scene.frame_end = 5  # each step takes long
    ball.location, ball.scale = (0.0, 0.0, HEIGHT), (10.0, 10.0, 10.0)


def is_hidden_by_its_scale(ball):
    for frame, size in ((1, 1.0), (5, 0.0), (10, 1.0)):
        ball.scale = (size,) * 3
        ball.keyframe_insert("scale", frame=frame)


def is_a_plane_through_the_middle(ball):
    ball.data.clear_geometry()
    ball.data.from_pydata([(-2, -2, 0), (2, -2, 0), (2, 2, 0), (-2, 2, 0)], [], [(0, 1, 2, 3)])
    ball.location = (0.0, 0.0, HEIGHT)


def hangs_on_the_rig(ball):
    ball.parent, ball.parent_type, ball.parent_bone = rig_of(bpy.data.objects["Arm"]), "BONE", "lower"


def interpolate(obj, kind):
    """All its animation, from key to key."""
    for curve in animation.curves(obj.animation_data.action, obj.animation_data.action_slot):
        for point in curve.keyframe_points:
            point.interpolation = kind


@pytest.fixture
def ball(arm):
    """The ball, which stands beside the arm."""
    ball = bpy.data.objects["Ball"]
    ball.animation_data_clear()
    ball.location = (SURFACE + 2.0 * RADIUS, 0.0, HEIGHT)
    return ball


BAD_PLACES = [
    pytest.param(begins_inside, marks=pytest.mark.fault("X01")),
    pytest.param(surrounds_the_arm, marks=pytest.mark.fault("X01")),
    pytest.param(jumps_in, marks=pytest.mark.fault("X02")),
    pytest.param(is_a_plane_through_the_middle, marks=pytest.mark.fault("X04")),
    pytest.param(is_hidden_by_its_scale, marks=pytest.mark.fault("X05")),
    pytest.param(hangs_on_the_rig, marks=pytest.mark.fault("X08")),
]


@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
@pytest.mark.parametrize("change", BAD_PLACES)
def test_a_bad_place_neither_explodes_nor_stops_the_bake(arm, ball, change, solver):
    change(ball)
    arm.dynamorph.collision.bake_full = solver == "FULL"
    rest = evaluated_points(arm)
    job = bake(arm)
    moved = np.linalg.norm(shown(arm) - rest, axis=2).max()
    assert moved < 0.2 * SIZE
    assert not any("converge" in warning for warning in job.warnings)


@pytest.mark.fault("X01")
@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
def test_what_begins_inside_gets_out(arm, ball, solver):
    ball.location.x = SURFACE + RADIUS - PRESSED
    arm.dynamorph.collision.bake_full = solver == "FULL"
    bake(arm)
    assert max(depths(shown(arm))[FRAMES // 2 :]) < 0.002 * SIZE


@pytest.mark.fault("X01")
@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
def test_settled_in_a_ball_it_begins_dented_and_stays(arm, ball, solver):
    """In its rest shape it begins as the bones put it."""
    ball.location.x = SURFACE + RADIUS - PRESSED
    arm.dynamorph.collision.bake_full = solver == "FULL"
    rest = evaluated_points(arm)
    bake(arm)
    points = shown(arm)
    assert max(depths(points)) < 0.002 * SIZE
    assert np.linalg.norm(points[0] - rest, axis=1).max() > 0.9 * PRESSED
    assert np.linalg.norm(np.diff(points, axis=0), axis=2).max() < 0.05 * PRESSED
    arm.dynamorph.simulation.initial_state = "REST_SHAPE"
    bake(arm)
    assert np.abs(shown(arm, [1])[0] - rest).max() < 1e-4


@pytest.mark.fault("X02")
def test_a_ball_that_jumps_in_is_met_where_it_is(arm, ball):
    """It is not swept along the way from there, and leaves nothing behind when it jumps away."""
    for frame, place in ((1, -3.0), (4, SURFACE + RADIUS - PRESSED), (12, 3.0)):
        ball.location.x = place
        ball.keyframe_insert("location", frame=frame)
    interpolate(ball, "CONSTANT")
    arm.dynamorph.model.solver = "FULL"
    rest = evaluated_points(arm)
    bake(arm)
    points = shown(arm)
    assert max(depths(points)[8:]) < 0.002 * SIZE
    dent = points[10] - rest
    place = np.linalg.norm(dent, axis=1).argmax()
    assert dent[place, 0] < -0.9 * PRESSED and rest[place, 0] > 0.9 * SURFACE
    assert np.abs(points[2] - rest).max() < 1e-3 * SIZE


@pytest.mark.fault("X03")
@pytest.mark.parametrize("radius, place", [(0.2, 0.45), (0.2, 0.48), (0.15, 0.4)])
def test_a_ball_that_jumps_to_the_other_side_does_not_take_the_skin_along(arm, ball, radius, place):
    ball.scale = (radius / RADIUS,) * 3
    ball.animation_data_clear()
    for frame, x in ((1, place), (7, -place)):
        ball.location.x = x
        ball.keyframe_insert("location", frame=frame)
    interpolate(ball, "CONSTANT")
    bake(arm)
    points = shown(arm)
    assert np.abs(points[6:] - points[0]).max() < radius


def test_a_thin_plate_at_three_meters_a_second_takes_the_skin_along(arm, ball):
    thickness, front = 0.005 * SIZE, SURFACE - PRESSED
    ball.data.clear_geometry()
    x, y = 0.5 * thickness, 0.5
    corners = [(a, b, c) for a in (-x, x) for b in (-y, y) for c in (-y, y)]
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    ball.data.from_pydata(corners, [], sides)
    speed = 3.0 / (bpy.context.scene.render.fps / bpy.context.scene.render.fps_base)  # meters a frame
    for frame, place in ((4, front + 2.0 * speed), (6, front)):
        ball.location.x = place + 0.5 * thickness
        ball.keyframe_insert("location", frame=frame)
    interpolate(ball, "LINEAR")
    arm.dynamorph.model.solver = "FULL"
    bake(arm)
    points = shown(arm)
    near = np.abs(points[..., 2] - HEIGHT) < 0.4
    assert (points[..., 0][5:] * near[5:]).max() < front + 0.0015 * SIZE
    assert np.abs(points[-1] - points[0]).max() > 0.9 * PRESSED


@pytest.mark.fault("X04")
@pytest.mark.parametrize("solver", ["REDUCED", "FULL"])
def test_a_blade_does_not_slip_between_vertices(scene, solver):
    """Of a skin whose rings are 0.3 m apart: a blade of 2 cm presses between two of them."""
    obj = still_arm(scene, rings=8, around=8)
    settings = obj.dynamorph
    settings.model.cage_nodes, settings.model.solver, settings.simulation.gravity = 600, solver, 0.0
    settings.collision.use, settings.collision.bake_full = True, False
    blade = make_box("Blade")
    blade.scale = (0.3, 1.0, 0.02)
    corner = np.abs(evaluated_points(obj)[:, 0]).max()
    for frame, depth in ((1, -0.02), (FRAMES // 2, PRESSED)):
        blade.location = (corner + 0.15 - depth, 0.0, 1.0)
        blade.keyframe_insert("location", frame=frame)
    activate(obj)
    bake(obj)
    scene.frame_set(FRAMES)
    edges = evaluated_points(obj)[np.array([edge.vertices for edge in obj.data.edges])]
    along = np.linspace(0.0, 1.0, 50)[:, None, None]
    points = ((1.0 - along) * edges[:, 0] + along * edges[:, 1]).reshape(-1, 3)
    inside = points[np.abs(points[:, 2] - 1.0) < 0.01]
    assert len(inside)
    assert inside[:, 0].max() - (corner - PRESSED) < 0.15 * PRESSED


def test_a_plane_through_the_body_is_reported(arm, ball):
    is_a_plane_through_the_middle(ball)
    job = bake(arm)
    (text,) = job.outcome.verdict.contact_texts
    assert text.startswith("Bone '") and "too deep into 'Ball' at frames" in text


@pytest.mark.fault("X05")
@pytest.mark.parametrize("solver", ["FULL", "REDUCED"])
def test_a_ball_that_is_scaled_to_zero_stops_nothing_meanwhile(arm, ball, solver):
    ball.location.x = SURFACE + RADIUS - PRESSED
    for frame, size in ((1, 1.0), (8, 0.0), (FRAMES, 0.0)):
        ball.scale = (size,) * 3
        ball.keyframe_insert("scale", frame=frame)
    interpolate(ball, "CONSTANT")
    arm.dynamorph.collision.bake_full = solver == "FULL"
    rest = evaluated_points(arm)
    bake(arm)
    moved = np.linalg.norm(shown(arm) - rest, axis=2).max(axis=1)
    assert 0.9 * PRESSED < moved[6] < 0.2 * SIZE and moved[-1] < 0.5 * moved[6]


@pytest.mark.fault("X06")
@pytest.mark.parametrize("what", ["curve", "vertex"])
def test_a_collider_that_is_not_a_number_is_refused(arm, ball, what):
    if what == "curve":
        for frame, place in ((1, 1.0), (6, 2.0)):
            ball.location.x = place
            ball.keyframe_insert("location", frame=frame)
        for curve in animation.curves(ball.animation_data.action, ball.animation_data.action_slot):
            curve.keyframe_points[1].co.y = np.nan
    else:
        ball.data.vertices[3].co.x = np.nan
    with pytest.raises(SceneError, match="'Ball' collides, but has values that are not numbers at frame"):
        bake(arm)


def faces_inward(shape):
    bmesh.ops.reverse_faces(shape, faces=shape.faces)


def has_a_hole(shape):
    bmesh.ops.delete(shape, geom=[face for face in shape.faces if face.normal.x > 0.9], context="FACES")


def is_half_open(shape):
    bmesh.ops.delete(shape, geom=[face for face in shape.faces if face.normal.x > 0.3], context="FACES")


def has_fins(shape):
    """Triangles that stand on its edges, so that these have three."""
    for edge in list(shape.edges)[::40]:
        middle = 0.5 * (edge.verts[0].co + edge.verts[1].co)
        shape.faces.new((*edge.verts, shape.verts.new(0.5 * middle)))


def faces_both_ways(shape):
    bmesh.ops.reverse_faces(shape, faces=list(shape.faces)[::2])


def is_split(shape):
    bmesh.ops.split_edges(shape, edges=shape.edges)


@pytest.mark.fault("X07")
@pytest.mark.parametrize("change", [faces_inward, has_a_hole, is_half_open, has_fins, faces_both_ways, is_split])
def test_a_faulty_mesh_stops_the_skin_like_a_clean_one(arm, ball, change):
    shape = bmesh.new()
    shape.from_mesh(ball.data)
    change(shape)
    shape.to_mesh(ball.data)
    shape.free()
    press_slowly(ball)
    bake(arm)
    assert max(depths(shown(arm))) < 0.002 * SIZE


def press_slowly(ball):
    for frame, depth in ((1, -0.02), (FRAMES // 2, PRESSED)):
        ball.location.x = SURFACE + RADIUS - depth
        ball.keyframe_insert("location", frame=frame)


@pytest.mark.fault("X09")
@pytest.mark.parametrize("inward", [False, True])
@pytest.mark.parametrize("one_sided", [False, True])
def test_a_room_around_the_body_is_met_from_inside(arm, ball, inward, one_sided):
    """One wall presses on it, and the others leave it alone."""
    bpy.data.objects.remove(ball)
    room = make_box("Room")
    room.scale, room.collision.use_culling = (4.0, 4.0, 4.0), one_sided
    if inward:
        room.data.flip_normals()
    for frame, depth in ((1, -0.02), (FRAMES // 2, PRESSED)):
        room.location = (SURFACE - depth - 2.0, 0.0, 1.0)
        room.keyframe_insert("location", frame=frame)
    bake(arm)
    beyond = []
    for frame, points in enumerate(shown(arm), 1):
        bpy.context.scene.frame_set(frame)
        beyond.append(points[:, 0].max() - room.matrix_world.translation.x - 2.0)
    assert max(beyond) < 0.003 * SIZE
    assert np.abs(shown(arm, [FRAMES])[0] - shown(arm, [1])[0]).max() < 2.0 * PRESSED


def test_very_many_faces_stop_the_skin_like_few(arm, ball):
    """As many as DYNAMORPH_FACES says: two million in `make -C evidence reliability`."""
    around = round(np.sqrt(int(os.environ.get("DYNAMORPH_FACES", "20000")) / 2.0))
    turn, polar = np.meshgrid(np.arange(around) * 2.0 * np.pi / around, np.linspace(0.0, np.pi, around + 1))
    points = RADIUS * np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), -np.cos(polar)], axis=-1)
    index = np.arange(around * (around + 1)).reshape(around + 1, around)
    following = np.roll(index, -1, axis=1)
    lower = np.stack([index[:-1], following[:-1], following[1:]], axis=-1)
    upper = np.stack([index[:-1], following[1:], index[1:]], axis=-1)
    ball.data.clear_geometry()
    ball.data.from_pydata(points.reshape(-1, 3).tolist(), [], np.concatenate([lower, upper]).reshape(-1, 3).tolist())
    press_slowly(ball)
    arm.dynamorph.model.solver = "FULL"
    bake(arm, substeps=1)
    assert max(depths(shown(arm))) < 0.002 * SIZE


def test_a_moved_ball_outdates_the_bake(arm):
    bake(arm)
    assert staleness.outdated(arm) == []
    bpy.data.objects["Ball"].parent = rig_of(arm)
    staleness.look_at_colliders(arm)
    assert staleness.outdated(arm) == ["'Ball' moved"]


# Live ----------------------------------------------------------------------------------------------------


def play(obj, first, last):
    for frame in range(first, last + 1):
        bpy.context.scene.frame_set(frame)
    assert run_live.problem(obj) == ""
    return evaluated_points(obj)


def test_reduced_quality_dents_where_it_is_pressed(arm):
    """Six tenths of the dent are asked of its patches; the rest is what they are too coarse for."""
    rest, dents = evaluated_points(arm), []
    for full in (True, False):
        arm.dynamorph.collision.bake_full = full
        bake(arm)
        dents.append(shown(arm)[-1] - rest)
        bpy.ops.dynamorph.delete_bake()
    full, few = dents
    near = np.linalg.norm(full, axis=1) > 0.1 * np.linalg.norm(full, axis=1).max()
    assert np.linalg.norm((few - full)[near]) < 0.6 * np.linalg.norm(full[near])


def test_local_responses_do_not_depend_on_when_live_began(arm):
    """They are kept while the artist changes the material."""
    found = []
    for poisson in (0.4, 0.3):
        opened.models.clear()  # it has none yet
        arm.dynamorph.targets[0].poisson = poisson
        found.append(Tissue(arm, bpy.context.scene).player.collision.dents)
    assert found[0].size
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("solver", ["REDUCED", "FULL"])
def test_a_job_makes_what_live_needs_for_collisions(arm, solver, monkeypatch):
    """So that turning Live on does not hold the window. What it shows is the same."""
    arm.dynamorph.model.solver = solver

    def first_frames():
        run_live.turn_on(arm, bpy.context.scene)
        found = []
        for frame in range(1, 6):
            bpy.context.scene.frame_set(frame)
            found.append(evaluated_points(arm))
        run_live.turn_off(arm)
        return np.array(found)

    alone = first_frames()
    opened.models.clear()  # it is read again, and has nothing yet
    assert run_live.must_prepare(arm)
    arm.dynamorph.collision.use = False
    assert not run_live.must_prepare(arm)
    arm.dynamorph.collision.use = True
    batch.run(Job(arm, "BUILD", drafts=True))
    assert not run_live.must_prepare(arm)
    given, make = [], contact.dynamorph.Contact

    def noted(*arguments):
        given.append(arguments[-1])  # what was found before
        return make(*arguments)

    monkeypatch.setattr(contact.dynamorph, "Contact", noted)
    np.testing.assert_array_equal(first_frames(), alone)
    assert given and all(found is not None for found in given)


@pytest.mark.parametrize("hangs", [False, True])
def test_a_shake_test_meets_what_stands_there(arm, hangs):
    ball = bpy.data.objects["Ball"]
    ball.animation_data_clear()
    ball.location.x = SURFACE + RADIUS - PRESSED
    if hangs:
        ball.parent = rig_of(arm)
    bpy.context.view_layer.update()
    moved = []
    for use in (False, True):
        arm.dynamorph.collision.use = use
        tissue = Tissue(arm, bpy.context.scene)
        samples, _ = preview.shaken(arm, tissue, "TWIST", seconds=0.3)
        tissue.player.begin(samples)
        substeps = tissue.player.settings.substeps
        *_, last = tissue.player.play(samples[1:], range(2, 2 + (len(samples) - 1) // substeps))
        moved.append(tissue.points(tissue.values(last)).reshape(-1, 3))
    pressed = np.linalg.norm(moved[1] - moved[0], axis=1)
    assert pressed.max() == 0.0 if hangs else pressed.max() > 0.5 * PRESSED


def test_live_follows_an_edit_of_the_balls_mesh(arm):
    bpy.ops.dynamorph.live()
    before = play(arm, 1, FRAMES)
    mesh = bpy.data.objects["Ball"].data
    for vertex in mesh.vertices:
        vertex.co *= 0.5
    mesh.update()
    bpy.context.view_layer.update()
    after = play(arm, 1, FRAMES)
    assert np.abs(after - before).max() > 0.5 * PRESSED


@pytest.mark.fault("X10")
def test_live_goes_on_when_a_collider_comes_or_goes(arm):
    bpy.ops.dynamorph.live()
    pressed = play(arm, 1, FRAMES)
    bpy.data.objects.remove(bpy.data.objects["Ball"])
    bpy.context.view_layer.update()
    free = play(arm, FRAMES + 1, 3 * FRAMES)
    assert np.abs(free - pressed).max() > 0.5 * PRESSED
    make_ball(radius=0.1)
    play(arm, 3 * FRAMES + 1, 3 * FRAMES + 3)


@pytest.fixture
def contact_points(viewport, monkeypatch):
    """Returns what *Show Contact* draws now: points (n, 3) by color, green and red."""
    found = {}
    monkeypatch.setattr(overlays, "make_batch", lambda kind, points: points)
    monkeypatch.setattr(
        overlays, "draw_points", lambda points, color, size: found.update({"gr"[color[0] > color[1]]: points})
    )

    def draw() -> dict:
        found.clear()
        viewport.draw("POST_VIEW")
        return {{"g": "green", "r": "red"}[color]: points for color, points in found.items()}

    yield draw
    bpy.context.window_manager.dynamorph.contact = False


@pytest.mark.parametrize("baked", [False, True])
def test_contact_is_drawn_where_the_skin_that_shows_touches_something(arm, contact_points, scene, baked):
    ball, display = bpy.data.objects["Ball"], bpy.context.window_manager.dynamorph
    if baked:
        bake(arm)
    else:
        bpy.ops.dynamorph.live()
    play(arm, 1, FRAMES)
    assert contact_points() == {}
    display.contact = True
    drawn_points = contact_points()
    away = np.linalg.norm(drawn_points["green"] - np.array(ball.matrix_world.translation), axis=1)
    assert drawn_points.keys() == {"green"} and np.abs(away - RADIUS).max() < 0.004 * SIZE
    arm.vertex_groups.new(name="Passes").add(range(len(arm.data.vertices)), 1.0, "REPLACE")
    arm.dynamorph.excluded_group = "Passes"
    assert contact_points() == {}


def test_skin_that_is_inside_all_the_same_is_drawn_red(arm, contact_points):
    """With the bones alone nothing gives way; the ball is stretched and turned."""
    ball = bpy.data.objects["Ball"]
    ball.animation_data_clear()
    ball.location, ball.scale, ball.rotation_euler = (SURFACE, 0.0, HEIGHT), (2.0, 1.0, 0.5), (0.3, 0.4, 0.0)
    bpy.context.view_layer.update()
    bpy.context.window_manager.dynamorph.contact = True
    deep = np.array(contact_points()["red"])
    shape = np.array(ball.matrix_world)
    skin = evaluated_points(arm)
    own = (skin - shape[:3, 3]) @ np.linalg.inv(shape[:3, :3]).T
    inside = skin[np.linalg.norm(own, axis=1) < 0.93 * RADIUS]
    away = np.linalg.norm((deep - shape[:3, 3]) @ np.linalg.inv(shape[:3, :3]).T, axis=1)
    assert len(inside) > 20 and away.max() < RADIUS
    assert np.linalg.norm(inside[:, None] - deep, axis=2).min(axis=1).max() < 1e-5


def test_turning_it_on_in_live_counts_from_the_next_frame_on(arm):
    arm.dynamorph.collision.use = False
    bpy.ops.dynamorph.live()
    free = play(arm, 1, FRAMES // 2)
    arm.dynamorph.collision.use = True
    pressed = play(arm, FRAMES // 2 + 1, FRAMES)
    assert np.abs(pressed - free).max() > 0.5 * PRESSED


def test_a_firm_head_that_is_pressed_throws_nothing_about(addon):
    """Few modes move a head only by moving all else far: in Reduced Quality it gives way by itself, or not at all."""
    dog = real_character.CHARACTER.parent / "zoo/Husky.glb"
    if not dog.exists():
        pytest.skip("needs ../shared/assets/zoo/Husky.glb")
    characters.open_file(dog)
    obj = characters.largest_skinned()
    rig = characters.armature_of(obj)
    rig.animation_data_clear()
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = 1, FRAMES
    activate(obj)
    bpy.ops.dynamorph.add_soft_skin()
    bpy.context.scene.frame_set(1)
    points = evaluated_points(obj)
    size = np.linalg.norm(np.ptp(points, axis=0))
    nose = points[points[:, 1].argmin()]
    ball = make_ball(radius=0.05 * size)
    for frame, depth in ((1, -0.02), (FRAMES // 2, 0.03)):
        ball.location = nose - np.array([0.0, (0.05 - depth) * size, 0.0])
        ball.keyframe_insert("location", frame=frame)
    obj.dynamorph.collision.use, obj.dynamorph.collision.bake_full = True, False
    activate(obj)
    job = bake(obj)
    assert job.outcome.model.settings.solver == "REDUCED"
    assert job.outcome.verdict.displacement < 0.05 and job.outcome.verdict.inverted < 0.001
