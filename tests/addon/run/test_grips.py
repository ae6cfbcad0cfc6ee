# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects and bones hold patches of the skin, and drags that are recorded are such: Live, bakes and other processes
pull the skin alike.
"""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core.errors import RecordError, SceneError
from bl_ext.user_default.dynamic_morph_targets.core.motion.grab import Patch, spread
from bl_ext.user_default.dynamic_morph_targets.io.cache_dir import CacheDir
from bl_ext.user_default.dynamic_morph_targets.run import live
from bl_ext.user_default.dynamic_morph_targets.run.bake import bake_input, batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.run.tools import grabbing
from bl_ext.user_default.dynamic_morph_targets.scene import animation
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from bl_ext.user_default.dynamic_morph_targets.write.authoring import grips
from builders import activate, evaluated_points, rig_of
from built import BuiltOnce

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

RIGHT = np.array([1.0, 0.0, 0.0])
FIRST, LAST = 4, 8  # frames in which a hand drags
built = BuiltOnce()


@pytest.fixture
def arm(soft_arm, scene):
    settings = soft_arm.dynamorph
    settings.model.cage_nodes, settings.model.modes, settings.simulation.gravity = 200, 8, 0.0
    built.give(soft_arm, 8)
    scene.frame_set(1)
    activate(soft_arm)
    yield soft_arm
    grabbing.end()


def shown(obj) -> np.ndarray:
    return mesh_data.shown_points(obj, bpy.context.evaluated_depsgraph_get()).astype(np.float64)


def played(obj, drags=False, last=12) -> list[np.ndarray]:
    """What Live shows at each frame, with a hand that drags the widest side."""
    scene, found, hand, number = bpy.context.scene, [], None, 0
    scene.frame_set(1)
    for frame in range(1, last + 1):
        if drags and frame == FIRST:
            points = shown(obj)
            place = points[points[:, 0].argmax()]
            hand = grabbing.Grabbing(obj)
            number = hand.take(place, points)
        if hand and frame <= LAST:
            hand.lead(number, place + 0.05 * (frame - FIRST + 1) * RIGHT)
        elif hand:
            hand.let_go(number)
        scene.frame_set(frame)
        found.append(evaluated_points(obj))
    return found


def recorded(obj, **options) -> list[np.ndarray]:
    live.turn_on(obj, bpy.context.scene)
    bpy.ops.dynamorph.record_drags()
    assert grabbing.is_recording(obj)
    found = played(obj, drags=True, **options)
    bpy.ops.dynamorph.record_drags()
    assert not grabbing.is_recording(obj)
    return found


def bake(obj, **options) -> list[np.ndarray]:
    live.turn_off(obj)
    obj.dynamorph.simulation.use_scene_range = True
    batch.run(Job(obj, "BAKE", **options))
    found = []
    for frame in range(1, 13):
        bpy.context.scene.frame_set(frame)
        found.append(evaluated_points(obj))
    return found


def apart(first, second) -> float:
    return max(float(np.abs(a - b).max()) for a, b in zip(first, second, strict=True))


def test_recorded_drags_play_again_in_live_and_in_a_bake(arm):
    live.turn_on(arm, bpy.context.scene)
    without = played(arm)
    live.turn_off(arm)
    dragged = recorded(arm)
    assert apart(dragged, without) > 0.02
    assert apart(played(arm), dragged) < 1e-6
    assert apart(bake(arm), dragged) < 2e-3  # a bake has fewer keys than coordinates
    live.turn_on(arm, bpy.context.scene)
    arm.dynamorph.grips[0].mute = True
    assert apart(played(arm), without) < 1e-6


def test_a_second_recording_adds_to_the_first(arm):
    recorded(arm)
    live.turn_off(arm)
    recorded(arm)
    first, second = arm.dynamorph.grips
    assert (first.name, second.name) == ("Drag", "Drag 1")
    assert first.object.animation_data and first.object != second.object
    bpy.ops.dynamorph.remove_grip()
    assert [grip.name for grip in arm.dynamorph.grips] == ["Drag"]
    assert len(animation.moved_paths(arm)) == 1  # the keys of the other one's strength are gone


def test_the_armature_may_be_active(arm):
    """As in Pose Mode, in which the tool can be used."""
    live.turn_on(arm, bpy.context.scene)
    activate(rig_of(arm))
    assert bpy.ops.dynamorph.record_drags.poll()


def test_chunks_of_a_shot_drag_as_the_whole_does(arm, tmp_path, monkeypatch):
    """Also where another process goes on in the middle of a drag."""
    recorded(arm)
    expected = bake(arm)
    monkeypatch.setattr(bake_input, "SHORT_CHUNK_FRAMES", 5)
    assert apart(bake(arm, cache_dir=CacheDir(tmp_path)), expected) < 1e-6


@pytest.fixture
def hook(arm):
    """An empty that touches the widest side, and goes 15 cm to the right from frame 4 to 8."""
    points = shown(arm)
    hook = bpy.data.objects.new("Hook", None)
    bpy.context.scene.collection.objects.link(hook)
    place = points[points[:, 0].argmax()]
    for frame, way in ((4, 0.0), (8, 0.15)):
        hook.location = place + way * RIGHT
        hook.keyframe_insert("location", frame=frame)
    bpy.context.scene.frame_set(1)
    hook.select_set(True)
    activate(arm)
    return hook


def held_by(arm) -> int:
    """The vertex that is held most firmly."""
    patch = Patch.of_text(arm.dynamorph.grips[0].patch)
    return int(patch.vertices[patch.share.argmax()])


def without_rig(arm):
    rig_of(arm).animation_data_clear()


@pytest.mark.parametrize("solver", ["REDUCED", "FULL"])
def test_an_object_holds_the_nearest_skin(arm, hook, solver):
    """It takes nothing along while it stands, and pulls the skin when it goes away."""
    without_rig(arm)
    assert bpy.ops.dynamorph.attach() == {"FINISHED"}
    assert [grip.name for grip in arm.dynamorph.grips] == ["Hook"]
    rest, vertex = shown(arm), held_by(arm)
    arm.dynamorph.model.solver = solver
    pulled = bake(arm)
    assert np.abs(pulled[2] - rest).max() < 1e-5
    assert 0.04 < (pulled[-1] - rest)[vertex, 0] < 0.151  # what bones hold gives way less


def test_what_lets_go_rings(arm, hook):
    """Strength is keyed: held up to frame 8, then let go. The skin swings back, beyond where it was."""
    without_rig(arm)
    bpy.ops.dynamorph.attach()
    grip = arm.dynamorph.grips[0]
    for frame, strength in ((8, 1.0), (8.1, 0.0)):
        grip.strength = strength
        grip.keyframe_insert("strength", frame=frame)
    rest, vertex = shown(arm), held_by(arm)
    shot = bake(arm)
    ways = np.array([(points - rest)[vertex, 0] for points in shot])
    assert ways[7] > 0.05 and ways[8:].min() < 0.3 * ways[7]
    live.turn_on(arm, bpy.context.scene)
    assert apart(played(arm), shot) < 2e-3  # a bake has fewer keys than coordinates
    assert not staleness.outdated(arm)


@pytest.mark.parametrize("solver", ["REDUCED", "FULL"])
def test_grips_are_the_same_at_any_step(arm, hook, solver):
    """At 120, 240 and 384 steps a second, with a strength that is keyed."""
    without_rig(arm)
    bpy.ops.dynamorph.attach()
    for frame, strength in ((3, 0.0), (6, 1.0)):
        arm.dynamorph.grips[0].strength = strength
        arm.dynamorph.grips[0].keyframe_insert("strength", frame=frame)
    arm.dynamorph.model.solver, rest, shots = solver, shown(arm), []
    for substeps in (5, 10, 16):
        arm.dynamorph.simulation.substeps = substeps
        shots.append(bake(arm))
    moved = apart(shots[-1], [rest] * len(shots[-1]))
    print([apart(shot, shots[-1]) / moved for shot in shots])
    assert apart(shots[0], shots[2]) < 0.1 * moved and apart(shots[1], shots[2]) < 0.05 * moved


def test_a_weaker_grip_gives_way(arm, hook):
    without_rig(arm)
    bpy.ops.dynamorph.attach()
    arm.dynamorph.model.solver = "FULL"
    rest, vertex, ways = shown(arm), held_by(arm), []
    for strength in (1.0, 0.1, 0.0):
        arm.dynamorph.grips[0].strength = strength
        ways.append((bake(arm)[-1] - rest)[vertex, 0])
    assert ways[0] > 1.2 * ways[1] > 0.01 and abs(ways[2]) < 1e-5


def test_a_bone_holds_a_group(arm):
    """A bone of another armature, in Pose Mode; the patch is the group's, and moves as one piece."""
    rig = bpy.data.objects.new("Hand", bpy.data.armatures.new("Hand"))
    bpy.context.scene.collection.objects.link(rig)
    activate(rig)
    bpy.ops.object.mode_set(mode="EDIT")
    bone = rig.data.edit_bones.new("finger")
    bone.head, bone.tail = (0.4, 0.0, 1.0), (0.5, 0.0, 1.0)
    bpy.ops.object.mode_set(mode="OBJECT")
    points = shown(arm)
    group = arm.vertex_groups.new(name="patch")
    members = np.flatnonzero(np.linalg.norm(points - (0.3, 0.0, 1.0), axis=1) < 0.2)
    group.add(members.tolist(), 1.0, "REPLACE")
    for frame, way in ((1, 0.0), (6, 0.1)):
        rig.pose.bones["finger"].location.y = way
        rig.pose.bones["finger"].keyframe_insert("location", frame=frame)
    bpy.context.scene.frame_set(1)
    without_rig(arm)
    grip = grips.attach(arm, rig, "finger", "patch")
    activate(arm)
    arm.dynamorph.model.solver = "FULL"  # eight modes do not move so small a patch
    assert set(Patch.of_text(grip.patch).vertices) <= set(members) and grip.name == "finger"
    moved = bake(arm)[-1] - points
    assert moved[members, 0].mean() > 0.05 and np.abs(moved[points[:, 2] < 0.3]).max() < 0.02


def test_a_bake_is_out_of_date_when_grips_change(arm, hook):
    bpy.ops.dynamorph.attach()
    bake(arm)
    assert not staleness.outdated(arm)
    grip = arm.dynamorph.grips[0]
    grip.mute = True
    assert any("Hook" in text for text in staleness.outdated(arm))
    grip.mute = False
    grip.strength = 0.5
    assert staleness.outdated(arm) == ['grip "Hook" changed']
    grip.strength = 1.0
    assert not staleness.outdated(arm)
    hook.keyframe_insert("location", frame=11)
    staleness.look_at_animation(arm)
    assert staleness.outdated(arm) == ['animation of "Hook" changed']
    hook.animation_data_clear()
    staleness.look_at_animation(arm)
    bake(arm)
    hook.location.z += 1.0
    assert staleness.outdated(arm) == ['grip "Hook" changed']


def test_attach_here_takes_hold_again(arm, hook):
    """Where the skin is now, so that nothing jumps, and of the vertices of another group."""
    bpy.ops.dynamorph.attach()
    hook.animation_data_clear()
    hook.location.x += 1.0
    bpy.context.view_layer.update()
    bpy.ops.dynamorph.attach_here()
    without_rig(arm)
    rest = shown(arm)
    assert np.abs(bake(arm)[-1] - rest).max() < 1e-5


def test_what_cannot_hold_is_a_sentence(arm, hook):
    with pytest.raises(RuntimeError, match="group 'nobody' is empty or gone"):
        bpy.ops.dynamorph.attach(group="nobody")
    hook.select_set(False)
    with pytest.raises(RuntimeError, match="Select the object that is to hold the skin"):
        bpy.ops.dynamorph.attach()
    hook.select_set(True)
    bpy.ops.dynamorph.attach()
    grip = arm.dynamorph.grips[0]
    patch = grip.patch
    grip.patch = "{"
    with pytest.raises(RecordError, match="press Attach Here"):
        bake(arm)
    grip.patch = patch.replace(f'"count": {len(arm.data.vertices)}', '"count": 9999')
    with pytest.raises(SceneError, match="press Attach Here"):
        bake(arm)
    grip.patch = patch
    bpy.data.objects.remove(hook)
    with pytest.raises(SceneError, match="what holds 'Hook' is gone"):
        bake(arm)


def test_patches_that_are_damaged_are_refused():
    patch = Patch(9, np.array([3, 4]), np.zeros((2, 3)), np.array([0.5, 0.5]), 0.1)
    again = Patch.of_text(patch.text())
    assert again.vertices.tolist() == [3, 4] and again.radius == 0.1
    for old, new in (
        ("[3, 4]", "[3, 9]"),
        ("[3, 4]", "[3]"),
        ("[3, 4]", "[-3, 4]"),
        ("0.1}", "-0.1}"),
        ("0.5, 0.5", "-1, 2"),
    ):
        with pytest.raises(RecordError, match="cannot be read"):
            Patch.of_text(patch.text().replace(old, new))


def test_a_patch_is_spread_over_its_group():
    points = np.linspace(0.0, 1.0, 1001)[:, None] * (1.0, 0.0, 0.0)
    vertices, share = spread(points, np.where(points[:, 0] < 0.5, 1.0, 0.0))
    assert len(vertices) == 24 and points[vertices, 0].max() < 0.5 and share.sum() == pytest.approx(1.0)
    assert np.diff(np.sort(points[vertices, 0])).max() < 0.05
