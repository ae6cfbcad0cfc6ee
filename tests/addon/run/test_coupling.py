# SPDX-License-Identifier: GPL-3.0-or-later
"""Two arms side by side come together: both give way, in bakes and in Live alike."""

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.cli import main
from bl_ext.user_default.dynamic_morph_targets.core import records
from bl_ext.user_default.dynamic_morph_targets.core.errors import Cancelled, SceneError
from bl_ext.user_default.dynamic_morph_targets.core.motion import baked
from bl_ext.user_default.dynamic_morph_targets.run import live as live_module
from bl_ext.user_default.dynamic_morph_targets.run import remembered
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.run.work import task
from bl_ext.user_default.dynamic_morph_targets.scene.motion import colliders
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from builders import activate, evaluated_points, make_arm, rig_of
from built import BuiltOnce
from layout import drawn

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

PHYSICS = "DYNAMORPH_PT_physics"
RADIUS, HEIGHT, SIZE = 0.3, 1.0, 2.18  # meters: of an arm, of the place where they touch, and an arm's diagonal
OVERLAP, FRAMES = 0.05, 12  # how deep they are in each other, and by which frame
built = BuiltOnce()


def make_half(scene, name):
    """An arm with Soft Skin and Collision, built, whose armature stands still."""
    obj = make_arm(scene, name=name, rings=41, around=32)
    rig = rig_of(obj)
    rig.animation_data_clear()
    rig.pose.bones["lower"].rotation_euler.x = 0.0
    obj.parent = rig
    activate(obj)
    bpy.ops.dynamorph.add_soft_skin()
    settings = obj.dynamorph
    settings.model.cage_nodes, settings.model.modes, settings.simulation.gravity = 600, 40, 0.0
    built.give(obj, 10)
    settings.collision.use = True
    obj.modifiers.new("Collision", "COLLISION")
    return obj


@pytest.fixture
def arms(scene):
    """The right one crosses the left one."""
    left, right = make_half(scene, "Left"), make_half(scene, "Right")
    rig = rig_of(right)
    rig.rotation_euler.x = 0.5 * np.pi
    for frame, distance in ((1, 2 * RADIUS + 0.02), (FRAMES - 4, 2 * RADIUS - OVERLAP)):
        rig.location = (distance, HEIGHT, HEIGHT)
        rig.keyframe_insert("location", frame=frame)
    scene.frame_end = FRAMES
    scene.frame_set(1)
    return left, right


def bake_all(*objects):
    jobs = [Job(obj, "BAKE") for obj in objects]
    batch.run_all(batch.Batch(jobs, "BAKE_ALL"))
    return jobs


def sides(*objects) -> list[float]:
    """How far to the right the left one goes at the last frame where they cross, and how far to the left the others."""
    bpy.context.scene.frame_set(FRAMES)
    out = []
    for sign, obj in zip((1.0, -1.0), objects, strict=True):
        points = evaluated_points(obj)
        near = np.linalg.norm(points[:, 1:] - [0.0, HEIGHT], axis=1) < 0.03
        facing = sign * (points[near, 0] - RADIUS + 0.5 * OVERLAP) < 0.2
        out.append(sign * float((sign * points[near, 0][facing]).max()))
    return out


@pytest.mark.parametrize("quality", ["FULL", "REDUCED"])
def test_both_give_way_in_one_bake(arms, quality):
    """Each by half of what they would be in each other by, and nothing is out of date."""
    for obj in arms:
        obj.dynamorph.collision.bake_full = quality == "FULL"
    jobs = bake_all(*arms)
    assert {job.outcome.model.settings.solver for job in jobs} == {quality}
    left, right = sides(*arms)
    assert right - left > -0.002 * SIZE
    assert min(RADIUS - left, right - RADIUS + OVERLAP) > 0.3 * OVERLAP
    assert all(not staleness.outdated(obj) for obj in arms)
    for obj in arms:
        obj.dynamorph.collision.use = False
    bake_all(*arms)
    left, right = sides(*arms)
    assert right - left < -0.9 * OVERLAP


def test_the_order_does_not_matter(arms):
    found = []
    for objects in (arms, arms[::-1]):
        bake_all(*objects)
        bpy.context.scene.frame_set(FRAMES)
        found.append([evaluated_points(obj) for obj in arms])
    for first, second in zip(*found, strict=True):
        assert np.abs(first - second).max() < 1e-6 * SIZE


def test_the_command_line_bakes_them_together(arms, tmp_path):
    shot, baked = tmp_path / "shot.blend", tmp_path / "baked.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(shot))
    assert main.main(["bake", str(shot), "--all", "-o", str(baked)], opens_file=True) == 0
    bpy.ops.wm.open_mainfile(filepath=str(baked))
    for name, other in (("Left", "Right"), ("Right", "Left")):
        record = bpy.data.objects[name].dynamorph.bake
        assert records.bake_inputs(record.inputs)["together"] == [other]


def test_a_change_of_one_makes_both_out_of_date(arms):
    bake_all(*arms)
    left, right = arms
    left.dynamorph.targets[0].density *= 1.5
    assert staleness.outdated(left)
    rig_of(right).location.y += 0.1
    rig_of(right).keyframe_insert("location", index=1, frame=1)
    staleness.look_at_colliders(left)
    assert "'Right' moved" in staleness.outdated(left)


def test_the_button_lets_both_press_on_each_other(scene):
    left, right = make_half(scene, "Left"), make_half(scene, "Right")
    rig_of(right).location.x = 2.5 * RADIUS
    for obj in (left, right):
        obj.dynamorph.collision.use = False
        obj.modifiers.remove(obj.modifiers["Collision"])
        obj.select_set(True)
    activate(left)
    assert not colliders.pressed(left)
    bpy.ops.dynamorph.collide()
    assert colliders.pressed(left) == [right] and colliders.pressed(right) == [left]
    assert "Presses on: Right. Bake All bakes them together" in " ".join(drawn(left, PHYSICS))


def test_baked_alone_it_meets_the_other_as_it_stands(arms):
    left, right = arms
    job = Job(left, "BAKE")
    batch.run(job)
    assert "together" not in job.outcome.inputs and not right.dynamorph.bake.exists
    gone, standing = sides(*arms)
    assert standing == pytest.approx(RADIUS - OVERLAP, abs=1e-3) and gone < standing + 0.002 * SIZE


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda settings: setattr(settings.simulation, "substeps", 3), "Substeps"),
        (lambda settings: setattr(settings.simulation, "speed", 0.5), "Speed"),
        (lambda settings: setattr(settings.simulation, "loop", True), "loop"),
        (lambda settings: setattr(settings.simulation, "integrator", "EULER"), "Integrator"),
        (lambda settings: setattr(settings.collision, "bake_full", False), "Quality"),
    ],
)
def test_what_cannot_be_simulated_together_is_refused(arms, change, reason):
    change(arms[1].dynamorph)
    with pytest.raises(SceneError, match=f"'Left' and 'Right' press on each other, but .*{reason}"):
        bake_all(*arms)
    assert not any(obj.dynamorph.bake.exists for obj in arms)


def test_a_body_that_touches_nothing_is_refused(arms):
    right = arms[1]
    right.vertex_groups.new(name="All").add(range(len(right.data.vertices)), 1.0, "REPLACE")
    right.dynamorph.excluded_group = "All"
    with pytest.raises(SceneError, match="'Right' touches nothing: take a part of it out of Exclude"):
        bake_all(*arms)
    live_module.turn_on(arms[0], bpy.context.scene)
    live_module.turn_on(right, bpy.context.scene)
    played(*arms, last=2)
    assert "touches nothing" in live_module.problem(arms[0]) + live_module.problem(right)


def test_another_process_simulates_both_to_the_last_byte(arms, monkeypatch):
    here = [baked.digest(job.outcome.bake) for job in bake_all(*arms)]
    monkeypatch.setattr(task, "worker_for", task.Child)
    assert [baked.digest(job.outcome.bake) for job in bake_all(*arms)] == here


@pytest.mark.parametrize("fails", [0, 1])
def test_where_one_fails_the_other_does_not_wait(arms, monkeypatch, fails):
    jobs = [Job(obj, "BAKE") for obj in arms]
    work = batch.Batch(jobs, "BAKE_ALL")
    for _ in work.read():
        pass

    def wrong(*_args):
        raise SceneError("as asked")

    monkeypatch.setattr(jobs[fails].computation, "take", wrong)
    with pytest.raises(SceneError, match="as asked"):
        for _ in work.compute():
            pass
    work.stop()


def test_both_stop_where_it_is_canceled(arms, apart):
    jobs = [Job(obj, "BAKE") for obj in arms]
    work = batch.Batch(jobs, "BAKE_ALL")
    with pytest.raises(Cancelled):
        for _ in work.steps():
            if any("Simulating" in str(job.progress.message) for job in jobs):
                work.cancel()
    work.stop()
    assert not any(obj.dynamorph.bake.exists for obj in arms)


def live(obj) -> live_module.Session:
    return remembered.live.sessions[obj.session_uid]


def played(*objects, last=FRAMES) -> list[np.ndarray]:
    """Where Live shows the skins at the last frame."""
    for frame in range(1, last + 1):
        bpy.context.scene.frame_set(frame)
    return [evaluated_points(obj) for obj in objects]


@pytest.fixture
def live_arms(arms):
    for obj in arms:
        live_module.turn_on(obj, bpy.context.scene)
    yield arms
    for obj in arms:
        if live_module.is_on(obj):
            live_module.turn_off(obj)


def test_both_give_way_in_live_as_in_a_bake(live_arms):
    shown = played(*live_arms)
    for obj in live_arms:
        live_module.turn_off(obj)
        obj.dynamorph.collision.bake_full = False
    bake_all(*live_arms)
    bpy.context.scene.frame_set(FRAMES)
    for obj, points in zip(live_arms, shown, strict=True):
        assert np.abs(evaluated_points(obj) - points).max() < 1e-3 * SIZE  # a bake has fewer keys than modes


def test_what_changes_one_changes_both_in_live(live_arms):
    left, right = live_arms
    played(*live_arms)
    bpy.context.scene.frame_set(FRAMES - 2)
    left.dynamorph.targets[0].density *= 2.0
    bpy.context.scene.frame_set(FRAMES - 1)
    assert live(left).last_simulated == live(right).last_simulated == FRAMES - 1


def test_when_one_leaves_live_the_other_meets_it_as_it_stands(live_arms):
    left, right = live_arms
    played(*live_arms)
    assert live(left).group.names == ("Left", "Right")
    live_module.turn_off(right)
    played(left)
    assert live(left).group.names == ("Left",)
    gone, standing = sides(*live_arms)
    assert standing == pytest.approx(RADIUS - OVERLAP, abs=1e-3) and gone < standing + 0.005 * SIZE
    live_module.turn_on(right, bpy.context.scene)
    played(*live_arms)
    assert live(left).group.names == ("Left", "Right")


def test_a_new_name_changes_nothing_in_live(live_arms):
    left, right = live_arms
    shown = played(*live_arms)
    right.name = "Another"
    again = played(*live_arms)
    assert live(left).group.names == ("Another", "Left")
    for first, second in zip(shown, again, strict=True):
        assert np.abs(first - second).max() < 1e-6 * SIZE


def test_with_other_substeps_they_do_not_press_on_each_other_in_live(live_arms):
    left, right = live_arms
    right.dynamorph.simulation.substeps = 3
    played(*live_arms, last=3)
    assert live(left).group.names == ("Left",)
    assert not live_module.problem(left) and not live_module.problem(right)
