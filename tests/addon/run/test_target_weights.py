# SPDX-License-Identifier: GPL-3.0-or-later
"""How much each target counts, now and over the frames; the drawing of that and of the cage; the artist's units."""

import types
from math import degrees, pi, radians

import bpy
import gpu
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import engine, states
from bl_ext.user_default.dynamic_morph_targets.core.material import fit
from bl_ext.user_default.dynamic_morph_targets.core.material.feel import FEELS
from bl_ext.user_default.dynamic_morph_targets.core.motion import posing
from bl_ext.user_default.dynamic_morph_targets.run import remembered
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.tools import heat, weight_curves
from bl_ext.user_default.dynamic_morph_targets.run.work import task
from bl_ext.user_default.dynamic_morph_targets.scene import events, plain
from bl_ext.user_default.dynamic_morph_targets.scene.character import extract
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.scene.remembered import opened
from bl_ext.user_default.dynamic_morph_targets.scene.store import model_store
from bl_ext.user_default.dynamic_morph_targets.ui.overlays import gpu_drawing
from bl_ext.user_default.dynamic_morph_targets.ui.overlays import graph as overlays_graph
from bl_ext.user_default.dynamic_morph_targets.ui.overlays import viewport as overlays_viewport
from builders import activate, add_key, evaluated_points, rig_of
from layout import drawn
from mathutils import Matrix
from pressed import in_window

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

OPS = bpy.ops.dynamorph


def now(obj):
    return weight_curves.weights_now(obj, bpy.context.evaluated_depsgraph_get())


def over(obj, start=1, end=20):
    reading = task.Task(obj, "", weight_curves.reading(obj.session_uid, start, end))
    batch.run_all(reading)
    return reading.result


def bend_of(frame):
    """Radians at the elbow of `make_arm`."""
    curve = rig_of(bpy.data.objects["Arm"]).animation_data.action.layers[0].strips[0].channelbags[0].fcurves
    return next(c for c in curve if c.array_index == 0).evaluate(frame)


# Weights -----------------------------------------------------------------------------------------------------------


def test_the_pose_now(scene, soft_arm):
    """The linear kernel between two targets: weight and distance follow the angle."""
    for frame in (1, 7, 20):
        scene.frame_set(frame)
        found, angle = now(soft_arm), bend_of(frame)
        np.testing.assert_allclose(found.weights, [[1 - angle / (pi / 2), angle / (pi / 2)]], atol=1e-5)
        np.testing.assert_allclose(found.nearest, [[min(angle, pi / 2 - angle)]], atol=1e-5)
        assert found.limits == pytest.approx([1.1 * pi / 4]) and not found.outside.any()


def test_what_an_artist_changes_shows_at_once(scene, soft_arm):
    flexed = soft_arm.dynamorph.targets[1]
    scene.frame_set(12)
    between = now(soft_arm).weights[0, 1]
    assert 0.3 < between < 0.9
    flexed.fade_out_angle = radians(10.0)
    assert now(soft_arm).weights[0, 1] == 0.0
    flexed.fade_out_angle = 0.0
    assert now(soft_arm).weights[0, 1] == between
    soft_arm.dynamorph.active_target_index = 1
    OPS.capture_pose()
    assert now(soft_arm).weights[0, 1] == pytest.approx(1.0)
    flexed.mute = True
    assert now(soft_arm).weights.tolist() == [[1.0]]
    flexed.mute = False
    rig_of(soft_arm).data.bones["lower"].name = "forearm"
    bpy.context.view_layer.update()
    assert now(soft_arm).weights[0, 1] == pytest.approx(1.0)


def test_it_is_what_a_bake_uses(scene, soft_arm):
    """The same weights as the simulation's, with a region and a radius, at every frame."""
    scene.frame_set(10)
    OPS.add_target(key="smile")
    soft_arm.dynamorph.targets[2].region = "upper"
    soft_arm.dynamorph.targets[1].fade_out_angle = radians(60.0)
    character = extract.character(soft_arm)
    pose = rig_motion.sample_rig(soft_arm, 1, 20, 1).pose
    expected = posing.pose_space(character).weights(character.skeleton.local_transforms(pose))
    found = over(soft_arm)
    np.testing.assert_array_equal(found.weights, expected)
    assert [target_set.name for target_set in found.sets] == ["Arm", "upper"]
    assert found.by_set() == [(0, range(0, 2)), (1, range(2, 4))]
    for frame in (1, 6, 20):
        scene.frame_set(frame)
        np.testing.assert_allclose(now(soft_arm).weights[0], expected[frame - 1], atol=1e-6)


def test_poses_that_cannot_be_told_apart_are_named(scene, soft_arm):
    scene.frame_set(20)
    OPS.add_target(key="smile")
    with pytest.raises(Exception, match="'flexed' and 'smile' have the same pose") as error:
        now(soft_arm)
    assert isinstance(error.value, engine.expected_errors())
    assert "have the same pose" in " ".join(drawn(soft_arm))


# Over the frames ---------------------------------------------------------------------------------------------------


def test_curves_reach_over_the_frames_and_leave_the_scene_alone(scene, soft_arm):
    scene.frame_set(5)
    known = {kind: sorted(thing.name for thing in getattr(bpy.data, kind)) for kind in ("scenes", "objects", "actions")}
    found = over(soft_arm, 3, 18)
    angles = np.array([bend_of(frame) for frame in range(3, 19)])
    np.testing.assert_allclose(found.weights[:, 1], angles / (pi / 2), atol=1e-5)
    assert scene.frame_current == 5
    assert known == {kind: sorted(t.name for t in getattr(bpy.data, kind)) for kind in known}


def test_what_is_drawn_follows_poses_without_looking_at_the_frames_again(soft_arm, monkeypatch):
    remembered.live.poses.clear()
    assert weight_curves.drawn(soft_arm) is None
    first = over(soft_arm)
    monkeypatch.setattr(rig_motion, "RigSampling", None)
    shot, shown = weight_curves.drawn(soft_arm)
    assert shown is first and (shot.start, shot.end) == (1, 20)
    soft_arm.dynamorph.targets[1].fade_out_angle = radians(30.0)
    assert not np.array_equal(weight_curves.drawn(soft_arm)[1].weights, first.weights)
    rig = rig_of(soft_arm)
    activate(rig)
    bpy.ops.object.mode_set(mode="EDIT")
    rig.data.edit_bones["lower"].roll = 0.3
    bpy.ops.object.mode_set(mode="OBJECT")
    assert weight_curves.drawn(soft_arm) is None  # its poses are of another skeleton


@pytest.fixture
def later(addon, monkeypatch):
    """later(): what is left to timers, until there is no more; without a window nothing calls them."""
    asked = {}
    monkeypatch.setattr(events, "soon", lambda look, _seconds: asked.setdefault(look))

    def later():
        while asked:
            look, _ = asked.popitem()
            while look() is not None:
                pass

    return later


@pytest.fixture
def graph(scene, later):
    """The weights over the frames are drawn meanwhile."""
    display = bpy.context.window_manager.dynamorph
    with pytest.MonkeyPatch.context() as patch:
        in_window(patch)
        display.target_weights = True
    yield display
    display.target_weights = False


@pytest.fixture
def read(monkeypatch):
    """The ranges of frames that are read."""
    ranges = []

    class Sampling(rig_motion.RigSampling):
        def __init__(self, obj, start, end, substeps):
            super().__init__(obj, start, end, substeps)
            ranges.append((start, end))

    monkeypatch.setattr(rig_motion, "RigSampling", Sampling)
    return ranges


def bend(obj, angle, frame):
    """Key the elbow and let Blender tell its handlers."""
    bone = rig_of(obj).pose.bones["lower"]
    bone.rotation_euler.x = angle
    bone.keyframe_insert("rotation_euler", frame=frame)
    bpy.context.view_layer.update()


def test_the_graph_follows_edits(scene, soft_arm, graph, later, read):
    later()
    bent = bend_of(10) / (pi / 2)
    assert read == [(1, 20)] and weight_curves.drawn(soft_arm)[1].weights[9, 1] == pytest.approx(bent, abs=1e-5)
    bpy.context.view_layer.update()
    later()
    assert len(read) == 1  # reading them was not an edit
    scene.frame_end = 21
    bpy.context.view_layer.update()
    later()
    assert read[1:] == [(1, 21)]
    bend(soft_arm, pi / 2, 10)
    assert weight_curves.drawn(soft_arm)[1].weights[9, 1] == pytest.approx(bent, abs=1e-5)
    later()
    assert read[2:] == [(1, 21)] and weight_curves.drawn(soft_arm)[1].weights[9, 1] == pytest.approx(1.0, abs=1e-5)


def test_without_a_graph_a_button_reads_the_frames(soft_arm, later, read):
    bend(soft_arm, pi / 2, 10)
    later()
    assert read == []
    assert OPS.update_target_weights() == {"FINISHED"} and read == [(1, 20)]
    assert weight_curves.drawn(soft_arm)[1].weights[9, 1] == pytest.approx(1.0, abs=1e-5)


def test_frames_are_read_a_few_at_a_time(scene, soft_arm):
    whole = over(soft_arm).weights
    remembered.live.poses.clear()
    reading, turns = weight_curves.Reading(soft_arm, 1, 20), 1
    while not reading.advance(soft_arm, 0.0):
        assert weight_curves.drawn(soft_arm) is None  # not before all is read
        turns += 1
    assert turns == 20
    np.testing.assert_array_equal(weight_curves.drawn(soft_arm)[1].weights, whole)


def test_what_keeps_the_frames_from_being_read_is_shown(soft_arm, graph, later, read):
    rig = rig_of(soft_arm)
    rig.scale = (0.0, 0.0, 0.0)
    rig.keyframe_insert("scale", frame=7)
    bpy.context.view_layer.update()
    for _ in range(3):
        later()
        bpy.context.view_layer.update()
    assert len(read) == 1  # it is not tried again and again
    assert "scaled to zero" in " ".join(drawn(soft_arm))


def test_frames_outside_and_the_pose_to_add(scene, soft_arm, capfd):
    """With targets at 0 and 30 degrees of a bend to 90, the outside begins at 30 + 16.5."""
    soft_arm.dynamorph.active_target_index = 1
    frame = next(f for f in range(1, 21) if bend_of(f) > radians(30.0))
    scene.frame_set(frame)
    OPS.capture_pose()
    captured, found = bend_of(frame), over(soft_arm)
    np.testing.assert_allclose(found.limits, 0.55 * captured, rtol=1e-5)
    expected = [bend_of(f) - captured > 0.55 * captured for f in range(1, 21)]
    assert found.outside[:, 0].tolist() == expected and 3 < sum(expected) < 15
    assert found.worst() == (19, 0)
    assert OPS.find_uncovered_pose() == {"FINISHED"}
    assert scene.frame_current == 20
    away = degrees(pi / 2 - captured)
    text = f"Frame 20: {away:.0f} degrees from any target of Arm. New from Pose adds one here"
    assert text in capfd.readouterr().out
    assert any(text.startswith(f"Uncovered: {away:.0f}°") for text in drawn(soft_arm))
    OPS.capture_pose()
    assert OPS.find_uncovered_pose() == {"FINISHED"}
    assert "no pose is uncovered" in capfd.readouterr().out
    assert not any(text.startswith("Uncovered") for text in drawn(soft_arm))


def test_a_pose_is_suggested_where_there_is_a_target(arm):
    OPS.add_soft_skin()
    assert not OPS.find_uncovered_pose.poll() and OPS.update_target_weights.poll()


def test_bones_scaled_to_zero_do_not_spoil_the_curves(soft_arm):
    bone = rig_of(soft_arm).pose.bones["upper"]
    bone.scale = (1.0, 1.0, 1.0)
    bone.keyframe_insert("scale", frame=9)
    bone.scale = (0.0, 0.0, 0.0)
    bone.keyframe_insert("scale", frame=10)
    assert np.isfinite(over(soft_arm).weights).all()


# The panel ---------------------------------------------------------------------------------------------------------


def test_bars_in_the_panel(scene, soft_arm):
    scene.frame_set(20)
    assert {"Neutral  0.00", "flexed  1.00", "target_weights", "dynamorph.find_uncovered_pose"} <= set(drawn(soft_arm))
    scene.frame_set(10)
    OPS.add_target(key="smile")
    soft_arm.dynamorph.targets[2].region = "lower"
    texts = drawn(soft_arm)
    assert {"Arm", "lower", "smile  1.00"} <= set(texts)
    soft_arm.dynamorph.targets.clear()
    assert "dynamorph.find_uncovered_pose" not in drawn(soft_arm)


def test_the_sidebar_is_drawn_again_at_the_next_frame_only_where_bars_are(scene, soft_arm, monkeypatch):
    calls = []
    monkeypatch.setattr(events, "redraw", calls.append)
    scene.frame_set(2)  # bars may have been drawn before
    calls.clear()
    scene.frame_set(3)
    assert not calls
    drawn(soft_arm)
    for frame in (4, 5):
        scene.frame_set(frame)
    assert calls == [events.PANELS]


# Overlays ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def built_arm(soft_arm):
    """The soft arm with a coarse cage, so that it builds in a second."""
    soft_arm.dynamorph.model.cage_nodes = 200
    soft_arm.dynamorph.model.modes = 8
    soft_arm.dynamorph.active_target_index = 1
    OPS.build()
    return soft_arm


def test_the_surface_of_tetrahedra():
    edges = overlays_viewport.surface_edges(np.array([[0, 1, 2, 3], [1, 2, 3, 4]]))
    assert edges.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [1, 4], [2, 3], [2, 4], [3, 4]]
    around = np.array([[4, 0, 1, 2], [4, 0, 1, 3], [4, 0, 2, 3], [4, 1, 2, 3]])  # four about node 4
    assert overlays_viewport.surface_edges(around).max() == 3


def test_the_cage_is_posed_as_the_mesh_is(scene, built_arm):
    """The mesh's vertices lie in the tetrahedra: nodes move as its skin does where one bone has all the weight."""
    overlays = overlays_viewport
    rig_of(built_arm).location = (1.0, 2.0, 3.0)
    rig_of(built_arm).scale = (1.5, 1.5, 1.5)
    scene.frame_set(20)
    model = model_store.load_model(built_arm)
    cage = overlays.cage_of(model)
    assert len(cage.rest) < len(model.nodes)
    bones = overlays.skin_matrices(built_arm, bpy.context.evaluated_depsgraph_get())
    posed = cage.posed(bones)
    pose = rig_of(built_arm).evaluated_get(bpy.context.evaluated_depsgraph_get())
    for name, column in (("upper", 0), ("lower", 1)):
        alone = cage.weights[:, column] > 0.9999
        bone = pose.pose.bones[name]
        moved = np.array(pose.matrix_world @ bone.matrix @ bone.bone.matrix_local.inverted())
        there = np.array(rig_of(built_arm).matrix_world.inverted() @ built_arm.matrix_world)
        expected = cage.rest[alone] @ (moved @ there)[:3, :3].T + (moved @ there)[:3, 3]
        assert alone.any()
        np.testing.assert_allclose(posed[alone], expected, atol=2e-3)
    points = evaluated_points(built_arm)
    assert (posed.min(axis=0) < points.min(axis=0) + 0.05).all() and (
        posed.max(axis=0) > points.max(axis=0) - 0.05
    ).all()


@pytest.mark.parametrize("hold", ["THICKNESS", "BONES"])
def test_the_cage_shows_what_is_held(soft_arm, hold):
    model = soft_arm.dynamorph.model
    model.hold, model.cage_nodes, model.modes = hold, 200, 8
    OPS.build_cage()
    built = model_store.load_model(soft_arm)
    cage = overlays_viewport.cage_of(built)
    assert 0 < len(cage.held) < len(cage.rest)
    shown = {tuple(point) for point in cage.rest[cage.held].tolist()}
    firm = built.pinned.astype(bool) if hold == "BONES" else built.hold > 0.5
    assert shown == {tuple(point) for point in built.nodes[firm].astype(np.float32).tolist()}


def test_in_edit_mode_the_cage_is_at_rest(scene, built_arm):
    overlays = overlays_viewport
    scene.frame_set(20)
    built_arm.location = (0.5, 0.0, 0.0)
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        bones = overlays.skin_matrices(built_arm, bpy.context.evaluated_depsgraph_get())
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
    cage = overlays.cage_of(model_store.load_model(built_arm))
    np.testing.assert_allclose(cage.posed(bones), cage.rest + np.array([0.5, 0.0, 0.0]), atol=1e-5)


def test_no_cage_of_another_skeleton(built_arm):
    activate(rig_of(built_arm))
    bpy.ops.object.mode_set(mode="EDIT")
    rig_of(built_arm).data.edit_bones.new("more").tail = (0, 0, 1)
    bpy.ops.object.mode_set(mode="OBJECT")
    assert overlays_viewport.skin_matrices(built_arm, bpy.context.evaluated_depsgraph_get()) is None


def test_the_graph_keeps_clear_of_what_lies_over_the_viewport():
    def region(x, y, width, height, alignment="NONE"):
        return types.SimpleNamespace(x=x, y=y, width=width, height=height, alignment=alignment)

    view = region(100, 50, 800, 600)
    over_it = [
        region(100, 100, 50, 400, "LEFT"),
        region(700, 50, 200, 600, "RIGHT"),
        region(100, 624, 800, 26, "TOP"),
        region(100, 50, 800, 30, "BOTTOM"),
        region(100, 50, 1, 600, "RIGHT"),  # hidden
        region(100, 650, 800, 26, "BOTTOM"),  # the header above it, where nothing overlaps
        region(120, 60, 200, 90, "FLOAT"),
    ]
    assert overlays_graph.free_rectangle(view, over_it) == (50, 30, 600, 574)
    assert overlays_graph.free_rectangle(view, []) == (0, 0, 800, 600)


def test_runs_of_frames():
    runs = overlays_graph.runs
    assert runs(np.array([True, True, False, True])) == [(0, 1), (3, 3)]
    assert runs(np.zeros(3, bool)) == [] and runs(np.ones(3, bool)) == [(0, 2)]


def test_each_curve_has_its_own_color(scene, soft_arm):
    for frame, name in zip(range(3, 19, 2), "abcdefgh", strict=True):
        add_key(soft_arm, name, np.zeros((len(soft_arm.data.vertices), 3)))
        scene.frame_set(frame)
        OPS.add_target(key=name)
    colors = overlays_graph.curve_colors(now(soft_arm), bpy.context.preferences.themes[0])
    assert list(colors) == list(range(10))
    assert len({colors[target] for target in range(9)}) == 9


SIDE_VIEW = Matrix(((0, 80, 0, 200), (0, 0, 80, 20), (80, 0, 0, 0), (0, 0, 0, 1)))  # 80 pixels for a unit


@pytest.fixture
def picture(monkeypatch, viewport):
    """picture(moment, view): what is drawn then, (rows up, columns, 4) bytes; Blender 5 can without a window.

    view: from the world to pixels.
    """
    if not hasattr(gpu, "init"):
        pytest.skip("this Blender draws in a window only")
    try:
        gpu.init()
    except SystemError as error:
        pytest.skip(f"no graphics context without a screen: {error}")

    for module in (gpu_drawing, overlays_graph, overlays_viewport):  # without a window there is no resolution
        monkeypatch.setattr(module, "pixels", lambda length: length)

    def picture(moment, view=None):
        width, height = viewport.region.width, viewport.region.height
        target = gpu.types.GPUOffScreen(width, height)
        with target.bind():
            gpu.state.active_framebuffer_get().clear(color=(0.0, 0.0, 0.0, 0.0), depth=1.0)
            gpu.matrix.load_matrix(view or Matrix.Identity(4))
            gpu.matrix.load_projection_matrix(
                Matrix(((2 / width, 0, 0, -1), (0, 2 / height, 0, -1), (0, 0, 1e-3, 0), (0, 0, 0, 1)))
            )
            viewport.draw(moment)
            pixels = gpu.state.active_framebuffer_get().read_color(0, 0, width, height, 4, 0, "UBYTE")
        target.free()
        return np.array(pixels.to_list(), np.uint8).reshape(height, width, 4)

    yield picture
    states.reset(opened)


def free(viewport):
    """Left, bottom, right and top of what headers and toolbars leave of the view."""
    return (int(side) for side in overlays_graph.free_rectangle(viewport.region, viewport.others))


def near(pixels, color, by=40):
    return (np.abs(pixels[..., :3].astype(int) - np.round(np.array(color[:3]) * 255)) < by).all(axis=-1)


def test_the_graph_is_drawn(scene, soft_arm, viewport, picture, graph):
    overlay_graph = overlays_graph
    soft_arm.dynamorph.active_target_index = 1
    scene.frame_set(8)
    OPS.capture_pose()
    over(soft_arm)
    known = weight_curves.drawn(soft_arm)
    whole = picture("POST_PIXEL")
    left, bottom, right, _ = free(viewport)
    around = np.zeros(whole.shape[:2], bool)
    around[bottom + 8 : bottom + 128, left + 8 : right - 8] = True
    assert whole[around].any() and not whole[~around].any()
    pixels = whole[bottom + 8 : bottom + 128, left + 8 : right - 8]  # of the graph, with a margin of 6
    theme, width = bpy.context.preferences.themes[0], pixels.shape[1]
    flexed, neutral = (overlay_graph.curve_colors(known[1], theme)[target] for target in (1, 0))
    curve = near(pixels, flexed, 70)[18:102]
    columns = np.flatnonzero(curve.any(axis=0))
    assert columns.min() < 20 and columns.max() > width - 20
    top, low = curve[:, -30:-10].nonzero()[0].mean(), curve[:, 10:20].nonzero()[0].mean()
    assert top > low + 60  # rows go up
    assert near(pixels, neutral, 70)[18:102, 10:20].nonzero()[0].mean() > 70
    inside, outside = (pixels[60, 6 + int((width - 12) * at / 19)].astype(int) for at in (2.5, 16.5))
    assert (outside[0] - inside[0] > 10) and known[1].outside[-1, 0] and not known[1].outside[3, 0]
    playhead = near(pixels, theme.user_interface.wcol_regular.inner_sel)[22:98].sum(axis=0)
    assert playhead.max() > 60 and abs(playhead.argmax() - (6 + (width - 12) * 7 / 19)) < 3


def test_the_cage_is_drawn(scene, built_arm, picture):
    overlays, display = overlays_viewport, bpy.context.window_manager.dynamorph
    scene.frame_set(20)
    assert not picture("POST_VIEW", SIDE_VIEW).any()
    display.cage = True
    pixels = picture("POST_VIEW", SIDE_VIEW)
    display.cage = False
    theme = bpy.context.preferences.themes[0]
    lines = near(pixels, theme.view_3d.bone_pose, 110) & pixels.any(axis=-1)  # they are transparent
    points = near(pixels, theme.collection_color[overlays.HELD_COLOR].color)
    assert lines.sum() > 500 and points.sum() > 100
    bones = overlays.skin_matrices(built_arm, bpy.context.evaluated_depsgraph_get())
    posed = overlays.cage_of(model_store.load_model(built_arm)).posed(bones)
    columns = np.flatnonzero(lines.any(axis=0))
    assert abs(columns.min() - (200 + 80 * posed[:, 1].min())) < 4
    assert abs(columns.max() - (200 + 80 * posed[:, 1].max())) < 4


def test_the_surface_is_drawn_as_hot_as_it_moves(scene, soft_arm, picture, monkeypatch):
    """Before the mesh itself, at the place where it is shown."""
    scene.frame_set(20)
    values = np.linspace(0.0, 1.2, len(soft_arm.data.vertices))  # along the arm
    moved = {soft_arm.session_uid: values}
    monkeypatch.setattr(heat, "displacements", lambda _obj: moved)
    bpy.context.window_manager.dynamorph.heat = True
    pixels = picture("POST_VIEW", SIDE_VIEW)
    points = mesh_data.shown_points(soft_arm, bpy.context.evaluated_depsgraph_get())
    columns, rows = np.flatnonzero(pixels.any(axis=(0, 2))), np.flatnonzero(pixels.any(axis=(1, 2)))
    assert abs(columns.min() - (200 + 80 * points[:, 1].min())) < 3
    assert abs(rows.max() - (20 + 80 * points[:, 2].max())) < 3
    assert near(pixels, heat.RAMP[0]).sum() > 50 and near(pixels, heat.RAMP[2]).sum() > 50
    assert near(pixels, heat.BEYOND).sum() > 50
    moved[soft_arm.session_uid] = values[1:]  # of another mesh
    assert not picture("POST_VIEW", SIDE_VIEW).any()
    bpy.context.window_manager.dynamorph.heat = False


def test_the_legend_of_the_surface_is_drawn(scene, soft_arm, viewport, picture, monkeypatch):
    overlays = overlays_viewport
    monkeypatch.setattr(heat, "displacements", lambda _obj: {})
    bpy.context.window_manager.dynamorph.heat = True
    whole = picture("POST_PIXEL")
    bpy.context.window_manager.dynamorph.heat = False
    _, _, right, top = free(viewport)
    right, top = int(right - overlays.GIZMOS), top - 8
    left = int(right - overlays.LEGEND)
    assert not whole[:, :left].any() and not whole[:, right:].any() and not whole[top:].any()
    pixels = whole[:, left:right]
    assert pixels[top - 10].any(axis=-1).all() and not pixels[: top - 70].any()
    cold, hot = (np.flatnonzero(near(pixels, heat.RAMP[k]).any(axis=0)).mean() for k in (0, 4))
    assert cold < 40 and hot > 120


def test_what_cannot_be_drawn_is_not(soft_arm, viewport, graph, monkeypatch):
    """Outside a 3D view the callbacks fail inside."""
    display = bpy.context.window_manager.dynamorph
    display.cage = display.heat = True
    for state in ("depth_test_set", "depth_mask_set", "blend_set"):
        monkeypatch.setattr(f"gpu.state.{state}", lambda _value: None, raising=False)
    assert len(viewport.callbacks) == 8
    for draw, arguments, _moment in viewport.callbacks:
        draw(*arguments)
    display.cage = display.heat = False


# The artist's units --------------------------------------------------------------------------------------------------


def bounce(obj, target):
    return fit.bounce(*model_store.fit_input(obj, target))


def test_bounce_is_that_of_the_whole_body(built_arm):
    """It is shown and set without the model, and agrees with the model's motion where all of it is of one material."""
    content = built_arm.dynamorph.model.content_id
    neutral, flexed = built_arm.dynamorph.targets
    flexed.set_material(neutral.material())
    measured = bounce(built_arm, neutral).frequency
    for target in (neutral, flexed):
        assert target.bounce == pytest.approx(measured, rel=1e-5)
        settle, proportion = target.settle_time, target.mass_damping / target.stiffness_damping
        target.bounce = 4.0
        assert target.bounce == pytest.approx(4.0, rel=1e-5)
        assert target.settle_time == pytest.approx(settle, rel=1e-4)
        assert target.mass_damping / target.stiffness_damping == pytest.approx(proportion, rel=1e-5)
        assert target.by_hand
    assert bounce(built_arm, neutral).frequency == pytest.approx(4.0, rel=1e-3)
    assert built_arm.dynamorph.model.content_id == content and not built_arm.dynamorph.model.stale


def test_stiffness_over_density_goes_as_the_square_of_the_frequency(built_arm):
    neutral, flexed = built_arm.dynamorph.targets
    for target in (neutral, flexed):
        target.mass_damping = target.stiffness_damping = 0.0
    flexed.density = 700.0
    neutral.bounce, flexed.bounce = 3.0, 7.5
    ratio = flexed.stiffness / flexed.density * neutral.density / neutral.stiffness
    assert ratio == pytest.approx((7.5 / 3.0) ** 2, rel=1e-6)


def stored(obj):
    """Every property of every target, but how many shape keys there are: a bake adds some."""
    return [
        {name: value for name, value in plain.plain(target).items() if name != "key_count"} | {"volume": target.volume}
        for target in obj.dynamorph.targets
    ]


def shown(obj):
    return [(target.bounce, target.settle_time, target.mass) for target in obj.dynamorph.targets]


@pytest.mark.parametrize("region", ["", "lower"])
@pytest.mark.parametrize("key", ["NATURAL", "CARTOON", ""])
def test_builds_live_and_bakes_leave_targets_as_they_are(soft_arm, key, region):
    """And what is shown is what was typed."""
    skin = soft_arm.dynamorph
    skin.model.cage_nodes, skin.model.modes, skin.simulation.frame_end = 200, 8, 5
    skin.simulation.use_scene_range = False
    neutral, flexed = skin.targets
    flexed.region = region
    if key:
        OPS.apply_feel(feel=key)
    OPS.build()
    flexed.bounce, neutral.settle_time = 14.0, 3.0
    flexed.settle_time, flexed.density = 0.15, 850.0
    neutral.density = 500.0
    before, seen = stored(soft_arm), shown(soft_arm)
    if key:
        assert (neutral.bounce, neutral.settle_time) == pytest.approx((FEELS[key].frequency, 3.0), rel=1e-4)
    assert (flexed.bounce, flexed.settle_time) == pytest.approx((14.0, 0.15), rel=1e-4)
    for change in (OPS.build, OPS.bake, OPS.build, OPS.bake):
        skin.model.stale = "anything"  # it builds, whether it has to or not
        assert change() == {"FINISHED"}
        assert stored(soft_arm) == before and shown(soft_arm) == seen
    OPS.live()
    bpy.context.scene.frame_set(3)
    OPS.live()
    assert stored(soft_arm) == before and shown(soft_arm) == seen


def test_what_was_set_by_hand_holds_on_another_cage(built_arm):
    """The bounce with the stiffness that it then takes, and a stiffness as it is."""
    neutral, flexed = built_arm.dynamorph.targets
    neutral.bounce, flexed.stiffness = 5.0, 4e4
    settle, stiffness = neutral.settle_time, neutral.stiffness
    built_arm.dynamorph.model.cage_nodes = 500
    OPS.build()
    assert (neutral.bounce, neutral.settle_time) == pytest.approx((5.0, settle), rel=1e-6)
    assert flexed.stiffness == 4e4 and neutral.stiffness != stiffness
    assert bounce(built_arm, neutral).frequency == pytest.approx(5.0, rel=1e-3)


def test_density_follows_what_was_set(built_arm):
    neutral, flexed = built_arm.dynamorph.targets
    neutral.bounce, flexed.stiffness = 5.0, 4e4
    settle, stiffness, slow = neutral.settle_time, neutral.stiffness, flexed.bounce
    neutral.density, flexed.density = 500.0, 4000.0
    assert (neutral.bounce, neutral.settle_time) == pytest.approx((5.0, settle), rel=1e-6)
    assert neutral.stiffness == pytest.approx(stiffness / 2, rel=1e-6)
    assert flexed.stiffness == 4e4 and flexed.bounce < slow


def test_strongly_damped_tissue_keeps_what_was_typed(built_arm):
    """Its bounce, seen, is far below that without damping, and a second build does not find another one."""
    target = built_arm.dynamorph.targets[0]
    target.bounce = 14.0
    for bounce_, settle in ((1.0, 0.1), (2.0, 0.05), (8.0, 3.0)):
        target.bounce, target.settle_time = bounce_, settle
        target.bounce = bounce_
        OPS.build()
        assert (target.bounce, target.settle_time) == pytest.approx((bounce_, settle), rel=1e-3)


def test_settle_time_is_in_seconds_whatever_the_frame_rate(scene, built_arm):
    target = built_arm.dynamorph.targets[0]
    proportion, stiffness = target.mass_damping / target.stiffness_damping, target.stiffness
    target.settle_time = 1.25
    assert bounce(built_arm, target).settle == pytest.approx(1.25, rel=1e-3)
    assert target.mass_damping / target.stiffness_damping == pytest.approx(proportion, rel=1e-5)
    assert target.stiffness == stiffness
    scene.render.fps = 60
    assert target.settle_time == pytest.approx(1.25, rel=1e-3)


def test_what_damping_forbids(built_arm):
    target = built_arm.dynamorph.targets[1]
    target.settle_time = 0.01
    critical = bounce(built_arm, target)
    assert critical.frequency < 0.1 and target.settle_time > 0.01
    target.mass_damping, target.stiffness_damping = 200.0, 0.02  # it creeps at any stiffness
    settle = target.settle_time
    built_arm.dynamorph.active_target_index = 1
    assert target.bounce == 0.0 and "Damped too much to swing" in drawn(built_arm)
    target.bounce = 3.0  # it is no longer overdamped, and settles as late
    assert target.bounce == pytest.approx(3.0, rel=1e-3) and target.settle_time == pytest.approx(settle, rel=1e-3)
    target.mass_damping = target.stiffness_damping = 0.0
    assert target.settle_time == pytest.approx(1e5)
    target.settle_time = 0.8
    assert target.settle_time == pytest.approx(0.8, rel=1e-3)


def test_mass_is_density_times_volume(scene, soft_arm):
    soft_arm.dynamorph.targets[1].region = "lower"
    soft_arm.dynamorph.model.cage_nodes = 300
    soft_arm.dynamorph.model.modes = 8
    OPS.build()
    neutral, flexed = soft_arm.dynamorph.targets
    assert neutral.mass == pytest.approx(1000.0 * volume_of(soft_arm), rel=0.05)
    assert 0.3 * neutral.mass < flexed.mass < 0.7 * neutral.mass
    stiffness, before = flexed.stiffness, flexed.bounce
    flexed.mass = 4 * flexed.mass
    assert flexed.density == pytest.approx(4000.0, rel=1e-5) and flexed.stiffness == stiffness
    flexed.mass_damping = flexed.stiffness_damping = 0.0
    assert flexed.bounce < 0.55 * before
    assert neutral.density == 1000.0


def test_mass_is_in_the_unit_that_blender_shows(scene, built_arm):
    """Blender multiplies what it shows by the cube of the unit scale."""
    target = built_arm.dynamorph.targets[0]
    kilograms = target.mass
    scene.unit_settings.scale_length = 0.01
    assert 0.01**3 * target.mass == pytest.approx(kilograms, rel=1e-5)
    target.mass = 2.0 * target.mass
    scene.unit_settings.scale_length = 1.0
    assert target.mass == pytest.approx(2.0 * kilograms, rel=1e-5)


def volume_of(obj):
    """The volume of the closed mesh, by the divergence theorem."""
    character = extract.character(obj)
    a, b, c = character.vertices[character.triangles].swapaxes(0, 1)
    return abs(np.einsum("ij,ij->", a, np.cross(b, c))) / 6.0


def test_before_a_build_settle_time_and_mass_are_grayed(soft_arm):
    target = soft_arm.dynamorph.targets[1]
    assert not target.is_measured and (target.settle_time, target.mass) == (0.0, 0.0)
    material = target.material()
    target.settle_time, target.mass = 20.0, 1.0
    assert target.material() == material
    assert "Measured by the next build" in drawn(soft_arm)


@pytest.mark.parametrize("neutral", [0.0, 3.0])
def test_the_bounce_of_a_new_target_is_typed_before_the_build(soft_arm, neutral):
    """Whether the neutral one has a stiffness in pascals or a frequency."""
    settings = soft_arm.dynamorph
    settings.model.cage_nodes, settings.model.modes = 300, 8
    if neutral:
        settings.targets[0].bounce = neutral
    target = settings.targets[1]
    stiffness = target.stiffness
    target.bounce = 6.0
    settle = target.settle_time
    assert target.bounce == pytest.approx(6.0) and target.stiffness == stiffness
    OPS.build()
    assert (target.bounce, target.settle_time) == pytest.approx((6.0, settle), rel=1e-5)
    assert target.stiffness != stiffness and target.by_hand
    assert settings.targets[0].bounce == pytest.approx(neutral, rel=1e-5) or not neutral
    target.bounce = 5.0
    assert target.bounce == pytest.approx(5.0, rel=1e-5)


def test_after_a_build_until_poisson_s_ratio_changes(built_arm):
    """That of the neutral target: it is the body that was measured."""
    assert "Measured by the next build" not in drawn(built_arm)
    neutral, flexed = built_arm.dynamorph.targets
    flexed.poisson = 0.3
    assert neutral.is_measured and flexed.is_measured
    neutral.poisson = 0.3
    assert not neutral.is_measured and not flexed.is_measured and "Measured by the next build" in drawn(built_arm)
    built_arm.dynamorph.model.method = "SINGLE"
    OPS.build()
    assert neutral.is_measured and flexed.is_measured and flexed.mass == 0.0


def test_undo(built_arm):
    stiffness = built_arm.dynamorph.targets[1].stiffness
    bpy.ops.ed.undo_push(message="before")
    built_arm.dynamorph.targets[1].bounce = 9.0
    bpy.ops.ed.undo_push(message="bounce")
    bpy.ops.ed.undo()
    target = bpy.data.objects["Arm"].dynamorph.targets[1]
    assert target.stiffness == stiffness and target.is_measured
    bpy.ops.ed.redo()
    assert bpy.data.objects["Arm"].dynamorph.targets[1].bounce == pytest.approx(9.0, rel=1e-4)


def test_they_are_kept_in_the_file_but_not_in_setups(built_arm, tmp_path):
    before = built_arm.dynamorph.targets[1].bounce
    names = set(plain.plain(built_arm.dynamorph.targets[1]))
    assert "stiffness" in names and not names & {
        "bounce",
        "settle_time",
        "mass",
        "volume",
    }
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "arm.blend"))
    assert bpy.data.objects["Arm"].dynamorph.targets[1].bounce == before > 0.0
