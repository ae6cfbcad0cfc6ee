# SPDX-License-Identifier: GPL-3.0-or-later
"""After a build in a window the panel shows how far the reduced motion of a hop is from Full Quality."""

import os
import time
from dataclasses import replace
from functools import partial

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.cli import main
from bl_ext.user_default.dynamic_morph_targets.core import errors, geometry
from bl_ext.user_default.dynamic_morph_targets.core.motion import rig_samples, simulate
from bl_ext.user_default.dynamic_morph_targets.core.settings import SimulationSettings
from bl_ext.user_default.dynamic_morph_targets.run import remembered
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch, expected_error
from bl_ext.user_default.dynamic_morph_targets.run.work.answering import GENTLE
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion
from bl_ext.user_default.dynamic_morph_targets.write import storage
from builders import activate
from layout import drawn
from pressed import Pressed, in_window

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")


@pytest.fixture
def coarse(soft_arm, monkeypatch):
    """The soft arm with a coarse cage and few modes, in what takes itself for a window; nothing was measured before."""
    in_window(monkeypatch)
    monkeypatch.setattr(remembered.work, "errors", {})
    model = soft_arm.dynamorph.model
    model.cage_nodes, model.basis, model.modes = 200, "MODES", 12
    yield soft_arm
    expected_error.cancel()
    batch.stop()


def build(obj, operator="DYNAMORPH_OT_build"):
    """Press the button: what it built is measured from now on."""
    pressed = Pressed(obj, operator=operator)
    assert pressed.result == {"FINISHED"}
    return pressed.operator.batch.jobs[0]


def wait():
    """Until the measurement has ended and the timer has noticed."""
    while expected_error.look() is not None:
        time.sleep(0.01)


def measured(obj) -> float | None:
    build(obj)
    wait()
    return expected_error.known(obj)


def said(obj) -> str:
    return " ".join(drawn(obj))


def test_the_panel_shows_it_after_a_build(coarse):
    assert "Expected error" not in said(coarse)
    build(coarse)
    wait()
    error = expected_error.known(coarse)
    assert 0.01 < error < 1.0
    assert f"Expected error: {100 * error:.0f} % of the motion" in said(coarse)


def test_it_is_how_far_two_simulated_hops_are_apart(coarse):
    """By hand: two parabolas of 0.12 body sizes, of half a second each, from 0.1 s on."""
    bpy.context.scene.frame_set(7)  # in the pose that shows
    job = build(coarse)
    wait()
    settings = SimulationSettings(0, 30, 24.0, 5, gravity=(0.0, 0.0, bpy.context.scene.gravity.z))
    character = job.outcome.character
    seconds = np.arange(151) / 120.0 - 0.1
    phase = np.where((seconds > 0.0) & (seconds < 1.0), seconds % 0.5 / 0.5, 0.0)
    size = np.linalg.norm(np.ptp(character.vertices @ character.to_bind.T, axis=0))
    still = rig_motion.sample_rig(coarse, 7, 7, 1)
    lifted = np.tile(np.eye(4), (151, 1, 1))
    lifted[:, 2, 3] = 0.48 * size * phase * (1.0 - phase)
    rig = rig_samples.RigSamples(
        np.tile(still.pose, (151, 1, 1, 1)), lifted @ still.rig_world, lifted @ still.object_world
    )

    def motion(solver):
        model = job.outcome.model.with_settings(replace(character.settings, solver=solver))
        frames = list(simulate.simulate(model, character, rig, settings))
        engine = model.engine(character)
        nodes = np.array([engine.displacement(frame.coordinates) for frame in frames])
        skin = model.surface(nodes) @ character.to_bind.T
        return skin - skin.mean(axis=0)

    reduced, final = motion("REDUCED"), motion("FULL")
    areas = geometry.vertex_areas(character.vertices @ character.to_bind.T, character.triangles)
    apart, moved = (np.einsum("fvc,v->", each**2, areas) for each in (reduced - final, final))
    assert expected_error.known(coarse) == pytest.approx(np.sqrt(apart / moved), rel=1e-3)


def test_more_modes_have_a_smaller_one(coarse):
    few = measured(coarse)
    coarse.dynamorph.model.modes = 40
    assert expected_error.known(coarse) is None  # it was that of the model with few
    assert measured(coarse) < few / 2


def test_a_bake_measures_what_it_built(coarse):
    build(coarse, "DYNAMORPH_OT_bake")
    wait()
    assert "Expected error" in said(coarse) and coarse.dynamorph.bake.off_full < 0


@pytest.mark.parametrize(
    "change",
    [
        lambda obj: setattr(obj.dynamorph.targets[0], "stiffness", 5e4),
        lambda obj: setattr(obj.dynamorph.simulation, "integrator", "EULER"),
        lambda obj: setattr(obj.dynamorph.model, "solver", "FULL"),
        lambda obj: storage.forget_model(obj),
    ],
    ids=["material", "integrator", "quality", "no model"],
)
def test_it_is_that_of_the_present_settings(coarse, change):
    measured(coarse)
    change(coarse)
    assert "Expected error" not in said(coarse)


def test_the_shot_and_what_is_shown_of_it_do_not_matter(coarse):
    error = measured(coarse)
    coarse.dynamorph.simulation.frame_end, coarse.dynamorph.simulation.amount = 99, 0.3
    coarse.dynamorph.simulation.fields, coarse.dynamorph.output.format = 0.0, "PC2"
    assert expected_error.known(coarse) == error


def test_what_is_known_is_not_measured_again(coarse):
    measured(coarse)
    build(coarse, "DYNAMORPH_OT_bake")
    assert not remembered.work.measuring and "Expected error" in said(coarse)


def instead(monkeypatch, work):
    """Let measurements do this, which another process knows too."""
    begin = expected_error.Measurement.__init__

    def begin_other(measurement, job):
        begin(measurement, job)
        measurement.work = work

    monkeypatch.setattr(expected_error.Measurement, "__init__", begin_other)


@pytest.fixture
def endless(monkeypatch):
    """Measurements that go on until they are canceled."""
    instead(monkeypatch, partial(time.sleep, 1000.0))
    return expected_error


def test_the_panel_says_that_it_is_measured(coarse, endless):
    build(coarse)
    assert endless.look() == endless.TICK
    assert "Expected error: measuring..." in said(coarse)


@pytest.mark.parametrize(
    "end",
    [
        lambda obj: Pressed(obj, ["ESC"]),
        lambda _obj: bpy.ops.wm.read_homefile(use_empty=True),
        lambda _obj: expected_error.cancel(),
    ],
    ids=["next job", "other file", "canceled"],
)
def test_it_stops_for_what_matters_more(coarse, endless, end, caplog):
    build(coarse)
    endless.look()
    child = remembered.work.child
    end(coarse)
    assert child.ended and not remembered.work.measuring and not remembered.work.errors and not caplog.records


@pytest.mark.parametrize(
    "end",
    [
        lambda obj: setattr(obj.dynamorph.targets[0], "stiffness", 5e4),
        lambda obj: storage.forget_model(obj),  # as undoing the build does
        lambda obj: bpy.data.objects.remove(obj),
    ],
    ids=["changed", "undone", "deleted"],
)
def test_it_stops_when_its_object_is_another(coarse, endless, end):
    build(coarse)
    endless.look()
    child = remembered.work.child
    end(coarse)
    wait()
    assert child.ended and not remembered.work.measuring and not remembered.work.errors


def test_all_others_go_first(coarse, monkeypatch):
    if not hasattr(os, "nice"):
        pytest.skip("this system has other priorities")
    instead(monkeypatch, partial(os.nice, 0))
    build(coarse)
    wait()
    assert expected_error.known(coarse) == os.nice(0) + GENTLE


@pytest.mark.parametrize("logged, raises", [(0, partial(os.listdir, "/there/is/no/such")), (1, partial(int, "a bug"))])
def test_an_error_disturbs_nobody(coarse, monkeypatch, caplog, logged, raises):
    instead(monkeypatch, raises)
    build(coarse)
    wait()
    assert "Expected error" not in said(coarse) and len(caplog.records) == logged


def test_a_rig_that_cannot_be_read_is_not_measured(coarse, monkeypatch):
    def refuse(*_args):
        raise errors.SceneError("flat")

    monkeypatch.setattr(rig_motion, "sample_present", refuse)
    build(coarse)
    assert not remembered.work.measuring and coarse.dynamorph.model.content_id


def test_without_a_window_nothing_is_measured(soft_arm):
    soft_arm.dynamorph.model.cage_nodes = 200
    activate(soft_arm)
    assert bpy.ops.dynamorph.build() == bpy.ops.dynamorph.bake() == {"FINISHED"}
    assert not remembered.work.measuring and "Expected error" not in said(soft_arm)


def test_large_cages_and_what_has_no_modes_are_not_measured(coarse, monkeypatch):
    monkeypatch.setattr(expected_error, "LARGEST", 100)
    assert measured_nothing(coarse)
    monkeypatch.undo()
    coarse.dynamorph.model.method = "STATIC"
    assert measured_nothing(coarse)


def measured_nothing(obj) -> bool:
    build(obj)
    return not remembered.work.measuring


def test_skins_that_blender_poses_are_measured_too(coarse):
    coarse.modifiers["Armature"].use_deform_preserve_volume = True
    assert measured(coarse) > 0.01


def test_a_file_keeps_it(coarse, tmp_path, monkeypatch, capfd):
    error = measured(coarse)
    file = tmp_path / "shot.blend"
    assert coarse.dynamorph.model.expected_from == ""  # not before it is saved: undo would lose it
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    remembered.work.errors.clear()
    bpy.ops.wm.open_mainfile(filepath=str(file))
    assert expected_error.known(bpy.data.objects["Arm"]) == pytest.approx(error)
    assert main.main(["info", str(file)], opens_file=True) == 0
    assert f"expected error: {100 * error:.0f} % of the motion" in capfd.readouterr().out
