# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line: the same work as the buttons, exit codes, and nothing written unless everything succeeded."""

import io
import json
import math
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import threading
from datetime import UTC, datetime, timedelta
from pathlib import Path

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.cli import help, main
from bl_ext.user_default.dynamic_morph_targets.core import errors as core_errors
from bl_ext.user_default.dynamic_morph_targets.core import memory
from bl_ext.user_default.dynamic_morph_targets.io import disk, paths, report_page
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.scene.motion import rig_motion
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.write import storage
from builders import make_arm, make_ball, make_soft


@pytest.fixture
def shot(scene, soft_arm, tmp_path):
    """A saved file with two soft skins, 'Arm' and 'Leg'."""
    make_soft(make_arm(scene, "Leg"))
    path = tmp_path / "shot ü.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


@pytest.fixture
def run(stand_in, capfd):
    """Runs a command line as `python -m dynamic_morph_targets` does; returns exit code, output, errors."""

    def run(*arguments, opens_file=True):
        capfd.readouterr()
        code = main.main([str(a) for a in arguments], opens_file=opens_file)
        return code, *capfd.readouterr()

    return run


def bake_of(path, name):
    bpy.ops.wm.open_mainfile(filepath=str(path))
    return [key.name for key in bpy.data.objects[name].dynamorph.bake.keys]


@pytest.mark.fault("F18")
@pytest.mark.parametrize(
    "option",
    [("--object", "caf\udce9"), ("--all", "--set", "fl\udcffexed.stiffness=5"), ("--all", "--exclude", "\udcff")],
)
def test_a_name_that_is_not_utf_8_is_refused(shot, run, option):
    """As a shell of another encoding passes it."""
    code, _, said = run("bake", shot, *option, "-o", shot.with_name("o.blend"))
    assert code == 2 and "is not UTF-8, which all names in Blender are" in said


def test_bake_writes_another_file(shot, run, stand_in):
    output = shot.parent / "baked.blend"
    before = shot.read_bytes()
    code, out, _ = run("bake", shot, "--object", "Arm", "--frames", 3, 12, "--substeps", 2, "-o", output)
    assert code == 0
    words = (
        "Arm: built because there was no model",
        "DOFs",
        "precompute",
        "10 x 2",
        "steps per second",
        "sample rig",
        "simulate",
    )
    for word in (*words, "write keys", "save"):
        assert word in out
    assert shot.read_bytes() == before
    assert bake_of(output, "Leg") == []
    assert bake_of(output, "Arm") == ["Dynamorph Mode 01", "Dynamorph Mode 02", "Dynamorph Mode 03"]
    code, out, _ = run("info", output, "--object", "Arm")
    assert code == 0 and "state: up to date" in out and "bake: 3 keys, 10 frames" in out
    code, out, _ = run("delete-bake", output, "--object", "Arm", "--in-place")
    assert code == 0 and "3 baked keys removed" in out
    assert bake_of(output, "Arm") == []


def test_model_settings_by_the_names_of_the_panel(shot, run, stand_in):
    output = shot.parent / "baked.blend"
    settings = (
        "--method",
        "shape",
        "--material-model",
        "stable_stvk",
        "--solver",
        "full",
        "--modes",
        7,
        "--pin-radius",
        0.25,
    )
    code, _, _ = run("bake", shot, "--object", "Arm", *settings, "-o", output)
    assert code == 0
    bpy.ops.wm.open_mainfile(filepath=str(output))
    arm, leg = (bpy.data.objects[name].dynamorph.model.settings() for name in ("Arm", "Leg"))
    assert (arm.method, arm.material_model, arm.solver, arm.modes, arm.pin_radius) == (
        "SHAPE",
        "STABLE_STVK",
        "FULL",
        7,
        0.25,
    )
    assert (leg.method, leg.solver, leg.modes) == ("DYNAMIC", "REDUCED", 20)
    code, _, errors = run("build", shot, "--object", "Arm", "--modes", 0, "-o", output)
    assert code == 2 and "--modes: 0 is not between 1 and 400" in errors


def test_loops_and_what_is_out_of_date(shot, run, stand_in):
    output = shot.parent / "baked.blend"
    code, out, _ = run(
        "bake", shot, "--object", "Arm", "--loop", "--initial-state", "rest_shape", "--gravity", 0.5, "--speed", 0.25,
        "-o", output, "--report", shot.parent / "report.json",
    )  # fmt: skip
    assert json.loads((shot.parent / "report.json").read_text())["characters"][0]["bake"]["speed"] == 0.25
    assert code == 0 and "loop gap" in out and "0.03 mm" in out
    bpy.ops.wm.open_mainfile(filepath=str(output))
    arm = bpy.data.objects["Arm"]
    assert "loop gap 0.03 mm" in arm.dynamorph.bake.summary
    simulation = arm.dynamorph.simulation
    assert (simulation.initial_state, simulation.gravity, simulation.speed) == ("REST_SHAPE", 0.5, 0.25)
    assert "bake state: up to date" in run("info", output, "--object", "Arm")[1]
    assert "files beside the .blend: none" in run("info", output, "--object", "Arm")[1]
    bpy.data.objects["Arm"].dynamorph.targets[1].stiffness = 5e5
    bpy.data.objects["Arm Rig"].keyframe_insert("location", frame=3)
    code, out, _ = run("info", "--object", "Arm", opens_file=False)
    assert 'bake state: Stiffness of "flexed" changed; animation of "Arm Rig" changed' in out


def test_collision_is_turned_on_and_limited(shot, run, stand_in):
    bpy.ops.wm.open_mainfile(filepath=str(shot))
    bpy.context.scene.collection.children.link(bpy.data.collections.new("Furniture"))
    bpy.ops.wm.save_mainfile()
    output, chosen = shot.parent / "baked.blend", ("--object", "Arm", "-o", shot.parent / "baked.blend")

    def collision(*options):
        code, _, errors = run("bake", shot, *chosen, *options)
        assert code == 0, errors
        bpy.ops.wm.open_mainfile(filepath=str(output))
        return bpy.data.objects["Arm"].dynamorph.collision

    found = collision("--collision", "--distance", 0.01)
    assert found.use and found.collection is None and found.distance == pytest.approx(0.01) and not found.use_friction
    found = collision("--self-collision")
    assert found.use and found.use_self and not collision("--no-self-collision").use_self
    found = collision("--collection", "Furniture", "--friction", 0.8)
    assert found.use and found.collection.name == "Furniture"
    assert found.use_friction and found.friction == pytest.approx(0.8)
    assert not collision("--no-collision").use
    assert collision("--collision").bake_full and not collision("--collision", "--no-bake-full").bake_full
    assert not collision("--collision", "--solver", "reduced").bake_full  # that is what is asked for
    assert collision("--collision", "--solver", "reduced", "--bake-full").bake_full
    assert "Full Quality" not in run("bake", shot, *chosen, "--collision")[1]  # nothing collides
    collision("--collision", "--exclude", "upper")
    assert bpy.data.objects["Arm"].dynamorph.excluded_group == "upper"
    code, _, errors = run("bake", shot, *chosen, "--exclude", "Nowhere")
    assert code == 2 and "'Arm' has no vertex group named 'Nowhere'" in errors
    code, _, errors = run("bake", shot, *chosen, "--collection", "Nowhere")
    assert code == 2 and "the file has no collection named 'Nowhere'" in errors
    code, _, errors = run("bake", shot, *chosen, "--collection", "Furniture", "--no-collision")
    assert code == 2 and "leave out --no-collision" in errors


def test_the_quality_of_a_bake_with_collision_is_said_before_it_with_its_time(shot, run, monkeypatch):
    bpy.ops.wm.open_mainfile(filepath=str(shot))
    make_ball()
    bpy.ops.wm.save_mainfile()

    def stop(*_):
        raise core_errors.InputError("stopped before the bake")

    monkeypatch.setattr(batch, "run_all", stop)
    chosen = "--object", "Arm", "--collision", "--in-place"
    code, out, errors = run("bake", shot, *chosen)
    assert code == 2 and "stopped" in errors
    assert "Arm: colliding bodies are baked in Full Quality: less than a minute" in out
    _, out, _ = run("bake", shot, *chosen, "--frames", 1, 9000)
    assert "Arm: colliding bodies are baked in Full Quality: about" in out


def test_all_in_place(shot, run, stand_in):
    assert run("build", shot, "--all", "--in-place")[0] == 0
    assert stand_in.built == 2
    assert run("bake", shot, "--all", "--in-place")[0] == 0
    assert stand_in.built == 2
    assert bake_of(shot, "Arm") and bake_of(shot, "Leg")


@pytest.mark.parametrize("how", ["--in-place", "-o"])
def test_a_link_to_the_latest_version_is_followed(shot, run, stand_in, how):
    link, latest = shot.with_name("latest.blend"), shot.rename(shot.with_name("shot_v012.blend"))
    link.symlink_to(latest.name)
    opened, place = (link, [how]) if how == "--in-place" else (shutil.copy(latest, shot), [how, link])
    assert run("bake", opened, "--object", "Arm", *place)[0] == 0
    assert link.is_symlink() and not latest.is_symlink() and bake_of(latest, "Arm")


def test_a_link_into_another_folder_is_refused(shot, run, stand_in, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    link = tmp_path / "elsewhere" / "shot.blend"
    link.symlink_to(shot)
    before = shot.read_bytes()
    code, _, errors = run("bake", link, "--object", "Arm", "--in-place")
    assert code == 2 and "is a link to a file in another folder" in errors and stand_in.built == 0
    assert link.is_symlink() and shot.read_bytes() == before


def test_inside_blender_the_open_file_is_used(shot, run, tmp_path):
    output = tmp_path / "baked.blend"
    assert run("bake", "--object", "Arm", "-o", output, opens_file=False)[0] == 0
    assert bpy.data.filepath == str(shot)  # the session keeps its own file
    assert bake_of(output, "Arm")


def test_large_models_follow_the_output(shot, run, stand_in, tmp_path, monkeypatch):
    monkeypatch.setattr(storage, "PACK_LIMIT", 100)
    (tmp_path / "out").mkdir()
    assert run("build", shot, "--object", "Arm", "--in-place")[0] == 0
    assert run("bake", shot, "--object", "Arm", "-o", tmp_path / "out" / "baked.blend")[0] == 0
    assert stand_in.built == 1
    assert run("bake", tmp_path / "out" / "baked.blend", "--object", "Arm", "--in-place")[0] == 0
    assert stand_in.built == 1


@pytest.mark.fault("B02")
@pytest.mark.parametrize(
    "arguments, words",
    [
        (["bake", "{shot}", "--object", "Arm"], "specify an output"),
        (["delete-bake", "{shot}", "--object", "Arm"], "--output --in-place is required"),
        (["bake", "{shot}", "-o", "{out}"], "--object --all is required"),
        (
            ["bake", "{shot}", "--object", "Nope", "-o", "{out}"],
            "no object named 'Nope': its soft skins are Arm, Leg\n",
        ),
        (["bake", "{shot}", "--object", "arm", "-o", "{out}"], "Did you mean 'Arm'?"),
        (["bake", "{shot}", "--object", "Arm", "-o", "{shot}.txt"], ".txt: the name of a Blender file ends in .blend"),
        (["info", "{shot}", "--scene", "scen"], "no scene named 'scen': it has Scene. Did you mean 'Scene'?"),
        (["bake", "{shot}.nope", "--object", "Arm", "-o", "{out}"], "there is no file"),
        (["bake", "{shot}", "--object", "Arm", "-o", "{shot}"], "--in-place to overwrite"),
        (["bake", "{shot}", "--object", "Arm", "-o", "{shot}/nowhere/x.blend"], "there is no folder"),
        (["bake", "{shot}", "--object", "Arm", "--substeps", "-1", "-o", "{out}"], "--substeps is -1"),
        (
            ["bake", "{shot}", "--object", "Arm", "--frames", "9", "2", "-o", "{out}"],
            "frame 2 comes before the first 9",
        ),
        (["bake", "{shot}", "--object", "Arm", "--frames", "1", "1048575", "-o", "{out}"], "no frames beyond"),
        (["bake", "{shot}", "--object", "Arm", "--frames", "0", str(10**11), "-o", "{out}"], "no frames beyond"),
        (["bake", "{shot}", "--object", "Arm", "--frames", "-9", "9", "--format", "gltf"], "no frames before 0"),
        (["bake", "{shot}", "--object", "Arm", "--frames", "1", str(10**11), "--format", "usd"], "no frames beyond"),
        (["bake", "{shot}", "--object", "Arm Rig", "-o", "{out}"], "'Arm Rig' is not a mesh"),
        (["bake", "{shot}", "--all", "-o", "/"], "'/' cannot be the name of a file"),
        (["collect", "{shot}", "-o", "/"], "'/' cannot be the name of a file"),
        (["nonsense"], "invalid choice"),
        ([], "required"),
    ],
)
def test_bad_input(shot, run, stand_in, arguments, words):
    output = shot.parent / "out.blend"
    code, _, errors = run(*(a.format(shot=shot, out=output) for a in arguments))
    assert code == 2 and words in errors
    assert not output.exists() and stand_in.built == 0


def test_no_open_file(scene, run):
    """Blender runs the command even if its file does not exist."""
    code, _, errors = run("info", opens_file=False)
    assert code == 2 and "no .blend is open" in errors


def test_not_a_blend(run, tmp_path):
    path = tmp_path / "x.blend"
    path.write_bytes(b"nothing")
    code, _, errors = run("info", path)
    assert code == 2 and "cannot be opened" in errors


def test_no_soft_skin(scene, run, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "empty.blend"))
    code, _, errors = run("info", tmp_path / "empty.blend", "--all")
    assert code == 2 and "no soft skin" in errors


def test_failed_self_check(shot, run, stand_in):
    stand_in.fail = core_errors.SelfCheckError("'Arm': not numbers")
    code, _, errors = run("bake", shot, "--object", "Arm", "--in-place")
    assert code == 3 and "not numbers" in errors
    assert bake_of(shot, "Arm") == []


@pytest.mark.fault("F12")
def test_a_full_disk_may_be_tried_again(shot, run, stand_in):
    stand_in.fail = OSError(28, "No space left on device")
    code, _, errors = run("bake", shot, "--object", "Arm", "--in-place")
    assert code == 75 and "No space left" in errors


def test_the_engines_errors_name_the_object(shot, run, stand_in):
    dynamorph = pytest.importorskip("dynamorph")
    stand_in.fail = dynamorph.Error("The mesh is flat")
    code, _, errors = run("bake", shot, "--object", "Arm", "--in-place")
    assert code == 2 and "'Arm': The mesh is flat" in errors
    stand_in.fail = dynamorph.Error("'Arm': no part is held")
    assert run("bake", shot, "--object", "Arm", "--in-place")[2].count("'Arm'") == 1


@pytest.mark.fault("C02")
@pytest.mark.parametrize(
    "number, code, words",
    [(signal.SIGINT, 130, "interrupted, nothing was saved"), (signal.SIGTERM, 75, "nothing was saved: run it again")],
)
def test_ctrl_c_and_a_scheduler_s_signal(shot, run, stand_in, number, code, words):
    before = signal.signal(number, signal.default_int_handler)  # ignored where the tests run in the background
    stand_in.waits["Arm"] = threading.Event()

    def interrupt():
        assert stand_in.playing.wait(60.0)
        os.kill(os.getpid(), number)

    threading.Thread(target=interrupt).start()
    content = shot.read_bytes()
    try:
        found, _, errors = run("bake", shot, "--object", "Arm", "--in-place")
        assert signal.getsignal(number) is signal.default_int_handler
    finally:
        signal.signal(number, before)
    assert found == code and words in errors
    assert shot.read_bytes() == content


@pytest.mark.fault("C02")
@pytest.mark.parametrize("where", ["handler", "driver", "operator"])
@pytest.mark.parametrize("number, code", [(signal.SIGINT, 130), (signal.SIGTERM, 75)])
def test_a_signal_while_blender_calls_python(shot, run, stand_in, monkeypatch, number, code, where):
    """Blender prints what its handlers, drivers and operators raise, and goes on."""
    before = signal.signal(number, signal.default_int_handler)  # ignored where the tests run in the background
    output = shot.parent / "baked.blend"

    def interrupted(*_arguments, **_options):
        os.kill(os.getpid(), number)
        return 0.0

    @bpy.app.handlers.persistent
    def loaded(*_arguments):
        bpy.app.driver_namespace["interrupted"] = interrupted
        if where == "handler":
            interrupted()

    if where == "driver":
        driver = bpy.data.objects["Arm Rig"].driver_add("location", 0).driver
        driver.expression = "interrupted()"
        bpy.ops.wm.save_mainfile()
    monkeypatch.setattr("io_scene_fbx.export_fbx_bin.save", interrupted)
    bpy.app.handlers.load_post.append(loaded)
    try:
        form = ("--format", "fbx") if where == "operator" else ("-o", output)
        found, _, errors = run("bake", shot, "--object", "Arm", "--enable-autoexec", *form)
    finally:
        bpy.app.handlers.load_post.remove(loaded)
        signal.signal(number, before)
    assert found == code and "nothing was saved" in errors
    assert {path.suffix for path in shot.parent.iterdir()} <= {".blend", ".blend1"} and not output.exists()


def test_ctrl_break_is_how_windows_ends_a_process(shot, run, stand_in, monkeypatch):
    """Another signal stands in for the one that Windows alone has; SIGTERM keeps its handler there."""
    monkeypatch.setattr(signal, "SIGBREAK", signal.SIGUSR1, raising=False)
    before, others = signal.getsignal(signal.SIGUSR1), signal.getsignal(signal.SIGTERM)
    stand_in.waits["Arm"] = threading.Event()

    def press_ctrl_break():
        assert stand_in.playing.wait(60.0)
        os.kill(os.getpid(), signal.SIGUSR1)

    threading.Thread(target=press_ctrl_break).start()
    code, _, errors = run("bake", shot, "--object", "Arm", "--in-place")
    assert code == 75 and "stopped by a signal" in errors
    assert (signal.getsignal(signal.SIGUSR1), signal.getsignal(signal.SIGTERM)) == (before, others)


@pytest.mark.parametrize(("name", "code"), [("FileInUseError", 75), ("WriteError", 2)])
def test_a_report_that_cannot_be_written(shot, run, stand_in, monkeypatch, name, code):
    """As on Windows: its file is in use for long, or has too long a path."""

    def refuse(path, _content):
        raise getattr(core_errors, name)("'{path}' is not for us", path=path)

    monkeypatch.setattr(disk, "save", refuse)
    found, _, errors = run("info", shot, "--object", "Arm")
    assert found == 0, errors
    found, _, errors = run("check", shot, "--object", "Arm", "--report", "a.json")
    assert found == code and "error: 'a.json' is not for us" in errors


def test_a_log_without_the_letters_of_a_name(shot, stand_in, monkeypatch):
    """As a pipe is on Windows."""
    bpy.data.objects["Arm"].name = "身体 ü"
    bpy.ops.wm.save_mainfile()
    log = io.TextIOWrapper(io.BytesIO(), encoding="cp1252")
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", log)
        code = main.main(["info", str(shot)], opens_file=True)
    assert code == 0 and "\\u8eab\\u4f53 ü: Neutral" in log.buffer.getvalue().decode("cp1252")


def test_blenders_own_ctrl_c_handler(shot, run, monkeypatch):
    """A handler that was set in C is None to Python, which does not accept None in return."""
    install = signal.signal
    monkeypatch.setattr(signal, "signal", lambda number, handler: install(number, handler) and None)
    assert run("info", shot)[0] == 0
    install(signal.SIGINT, signal.default_int_handler)


@pytest.mark.parametrize(
    "where, code",
    [(">/dev/full", 75), (">/dev/full 2>&1", 75), (">&-", 0), (">/dev/null 2>&-", 0), ("2>&1 | true", 75)],
)
def test_a_log_that_cannot_be_written(shot, stand_in, where, code):
    """Its disk is full, it is closed, or who reads it has ended: no result is lost, and the report says the same."""
    report = shot.parent / "report.json"
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3] / "addon")}
    command = f'"{sys.executable}" -m dynamic_morph_targets check "{shot}" --all --report "{report}"'
    first, *pipe = where.partition("|")
    script = f"set -o pipefail; {command} {first} {''.join(pipe)}"
    done = subprocess.run(["bash", "-c", script], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == code == json.loads(report.read_text())["exit_code"], done.stderr
    assert "Traceback" not in done.stderr


def test_a_current_folder_that_was_deleted(tmp_path):
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3] / "addon")}
    command = (
        f'cd "{tmp_path}" && rmdir "{tmp_path}" && "{sys.executable}" -m dynamic_morph_targets info /nowhere.blend'
    )
    done = subprocess.run(["bash", "-c", command], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "there is no file '/nowhere.blend'" in done.stderr


def test_an_object_that_is_named_twice(shot, run):
    caches = "--format", "pc2", "--output-file", shot.parent / "arm.pc2"
    assert run("bake", shot, "--object", "Arm", "--object", "Arm", *caches, "-o", shot.parent / "baked.blend")[0] == 0
    assert sorted(path.name for path in shot.parent.iterdir()) == ["arm.pc2", "baked.blend", shot.name]


@pytest.mark.parametrize("arguments, code", [(["-h"], 0), (["info", "nowhere.blend"], 2), (["bake"], 2)])
def test_as_a_python_module(arguments, code):
    """Run in a separate process, to see the exit code that a farm sees."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3] / "addon")}
    command = [sys.executable, "-m", "dynamic_morph_targets", *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr


def test_report_compares_methods_and_writes_no_blend(shot, capfd):
    pytest.importorskip("dynamorph", reason="needs the engine")
    before = {path: path.read_bytes() for path in shot.parent.iterdir()}
    figures = shot.parent / "figures.json"
    short = ["--frames", "1", "6", "--substeps", "2"]
    arguments = ["report", str(shot), "--object", "Arm", *short, "--json", str(figures)]
    chosen = ["static morphs", "DMT linear full", "DMT linear reduced"]
    assert main.main([*arguments, "--methods", *chosen], opens_file=True) == 0
    out = capfd.readouterr().out
    for word in ("Arm", "steps/s", "target miss", "Frames 1 to 6, 2 substeps", *chosen):
        assert word in out
    found = json.loads(figures.read_text())
    assert list(found) == ["Arm"] and list(found["Arm"]["variants"]) == chosen
    assert found["Arm"]["variants"]["DMT linear reduced"]["error"]["rms_total"] < 1
    assert {path: path.read_bytes() for path in shot.parent.iterdir() if path != figures} == before
    assert main.main([*arguments, "--methods", "guessing"], opens_file=True) == 2


# Farms -------------------------------------------------------------------------------------------------------------


def test_check_lists_what_is_in_the_way(shot, run):
    code, out, _ = run("check", shot, "--all")
    assert code == 0 and "Arm: can be built" in out and "Leg: can be built" in out
    bpy.data.objects["Arm"].modifiers["Armature"].use_bone_envelopes = True
    bpy.data.objects["Leg"].dynamorph.targets[1].pose.clear()
    bpy.ops.wm.save_mainfile()
    code, out, errors = run("check", shot, "--all")
    assert code == 2 and "Arm: error: 'Arm' is skinned by bone envelopes" in out and "2 problems found" in errors


def test_wedges_set_what_targets_are_made_of(shot, run, stand_in):
    output = shot.parent / "baked.blend"
    wedge = ("--set", "flexed.stiffness=5e4", "--set", "Neutral.density=900")
    assert run("bake", shot, "--object", "Arm", *wedge, "-o", output)[0] == 0
    bpy.ops.wm.open_mainfile(filepath=str(output))
    neutral, flexed = bpy.data.objects["Arm"].dynamorph.targets
    assert (neutral.density, flexed.stiffness) == (900.0, 5e4) and neutral.stiffness != 5e4


@pytest.mark.parametrize(
    "change, words",
    [
        ("nope.stiffness=1e4", "no target named 'nope': it has Neutral, flexed\n"),
        ("Flexd.stiffness=1", "it has Neutral, flexed. Did you mean 'flexed'?"),
        ("flexed.color=1", "a target has no 'color': there are stiffness"),
        ("flexed.stiffness=soft", "'soft' is no number, such as 20000"),
        ("flexed.stiffness=-4", "-4 is not between 1 and"),
        ("stiffness", "no target named ''"),
    ],
)
def test_wrong_wedges_are_refused(shot, run, change, words):
    code, _, errors = run("bake", shot, "--object", "Arm", "--set", change, "-o", shot.parent / "baked.blend")
    assert code == 2 and words in errors


@pytest.mark.parametrize(
    "words, said",
    [
        (("--sped", "1"), "unrecognized arguments: --sped 1"),
        (("--speed", "soft"), "'soft' is no number, such as 1"),
        (("--modes", "2.5"), "'2.5' is no whole number, such as 120"),
        (("--modes", "1000"), "1000 is not between 1 and 400"),
        (("--format", "obj"), "invalid choice: 'obj'"),
        (("--all",), "not allowed with argument --object"),
    ],
)
def test_a_wrong_option_is_one_line(shot, run, words, said):
    code, out, errors = run("bake", shot, "--object", "Arm", *words, "-o", shot.parent / "baked.blend")
    assert code == 2 and said in errors and errors.count("\n") == 1 and not out


def test_messages_name_commands_instead_of_buttons(shot, run):
    swing, times = shot.parent / "swing.csv", [step / 50 for step in range(200)]
    swing.write_text("\n".join(f"{time},{math.exp(-time) * math.cos(10 * time)},0,0" for time in times))
    code, _, errors = run("fit", shot, "--object", "Arm", "--target", "flexed", "--oscillation", swing, "--in-place")
    assert code == 2 and "run dynamorph build first" in errors and "press" not in errors
    labels = {getattr(bpy.ops.dynamorph, name).get_rna_type().name for name in dir(bpy.ops.dynamorph)}
    assert {button.removeprefix("press ") for button in help.INSTEAD} <= labels | {"Bake"}  # it has a longer label
    assert help.without_buttons("press Bake, or press Baked") == "run dynamorph bake, or press Baked"
    assert help.without_buttons("press Add Soft Skin in Blender first") == "press Add Soft Skin in Blender first"


def test_physics_sculpts_a_target(shot, run):
    sculpted = shot.parent / "sculpted.blend"
    code, out, errors = run("shape", shot, "--object", "Arm", "--target", "flexed", "-o", sculpted)
    assert code == 0 and not errors and f"saved {sculpted}" in out
    shapes = []
    for path in (shot, sculpted):
        bpy.ops.wm.open_mainfile(filepath=str(path))
        shapes.append(mesh_data.target_shape(bpy.data.objects["Arm"], "flexed"))
    assert np.isfinite(shapes[1]).all() and np.abs(shapes[1] - shapes[0]).max() > 1e-3
    for words, said in ((("--target", "Neutral"), "the neutral target"), (("--target", "none"), "has no target named"),
                        (("--target", "flexed", "--frame", 2), "already")):  # fmt: skip
        code, _, errors = run("shape", shot, "--object", "Arm", *words, "-o", sculpted)
        assert code == 2 and said in errors and errors.count("\n") == 1


def test_physics_sculpts_a_new_target_at_a_frame(shot, run):
    bpy.ops.wm.open_mainfile(filepath=str(shot))
    bone = bpy.data.objects["Arm Rig"].pose.bones["lower"]
    for frame, angle in ((1, 0.0), (5, 0.9)):
        bone.rotation_euler.z = angle
        bone.keyframe_insert("rotation_euler", frame=frame)
    bpy.ops.wm.save_as_mainfile(filepath=str(shot))
    arguments = ("shape", shot, "--object", "Arm", "--target", "Bent", "--frame", 5, "-o", shot.parent / "bent.blend")
    code, _, errors = run(*arguments)
    assert code == 0 and not errors
    bpy.ops.wm.open_mainfile(filepath=str(shot.parent / "bent.blend"))
    assert "Bent" in bpy.data.objects["Arm"].dynamorph.targets


@pytest.mark.fault("B01")
def test_reports(shot, run, stand_in):
    path = shot.parent / "report.json"
    bake = ("bake", shot, "--object", "Arm", "-o", shot.parent / "baked.blend", "--report", path)
    assert run(*bake)[0] == 0
    found = json.loads(path.read_text())
    assert found["exit_code"] == 0 and found["error"] == "" and found["file"] == "shot ü.blend"
    assert found["input"] == str(shot) and found["written"] == [str(shot.parent / "baked.blend")]
    assert found["command"] == [str(each) for each in bake] and found["host"] == platform.node()
    age = datetime.now(UTC) - datetime.fromisoformat(found["time"])
    assert timedelta(0) <= age < timedelta(hours=1)
    assert found["versions"]["blender"] == bpy.app.version_string
    (arm,) = found["characters"]
    assert arm["name"] == "Arm" and arm["built"] == ["there was no model"] and len(arm["model"]) == 32
    assert arm["bake"]["frames"] == [1, 20] and arm["bake"]["steps"] == 100 and arm["bake"]["max_displacement"] > 0
    assert run(*bake)[0] == 0
    assert json.loads(path.read_text())["characters"][0]["bake"]["hash"] == arm["bake"]["hash"]
    stand_in.fail = core_errors.SceneError("it went wrong")
    assert run(*bake)[0] == 2
    found = json.loads(path.read_text())
    assert found["exit_code"] == 2 and "it went wrong" in found["error"] and found["characters"] == []


@pytest.mark.fault("B05")
def test_collect_makes_one_page_of_many_bakes(shot, run, stand_in, tmp_path):
    folder = tmp_path / "reports"
    folder.mkdir()
    for name in ("Arm", "Leg"):
        bake = ("bake", shot, "--object", name, "-o", tmp_path / "baked.blend", "--report", folder / f"<{name}>.json")
        assert run(*bake)[0] == 0
    page = tmp_path / "index.html"
    assert run("collect", folder, "--expect", 2, "-o", page)[0] == 0
    text = page.read_text()
    assert "&lt;Arm&gt;" in text and "All went well" in text and text.count("<tr>") == 3
    assert set(json.loads(page.with_suffix(".json").read_text())["reports"]) == {"<Arm>", "<Leg>"}
    code, _, errors = run("collect", folder, "--expect", 3, "-o", page)
    assert code == 2 and "2 reports instead of 3" in errors and "2 reports instead of 3" in page.read_text()
    broken = json.loads((folder / "<Leg>.json").read_text())
    broken["characters"][0]["bake"]["energy"] = float("nan")
    (folder / "<Leg>.json").write_text(json.dumps(broken))
    code, _, errors = run("collect", folder, "-o", page)
    assert code == 2 and "<Leg>: Leg: energy is not a number" in errors
    (folder / "<Leg>.json").write_text("nonsense")
    code, _, errors = run("collect", folder, "-o", page)
    assert code == 2 and "'<Leg>.json' is no report" in errors
    assert run("collect", tmp_path, "-o", tmp_path / "none" / "page.html")[0] == 2


@pytest.fixture
def reports(shot, run, tmp_path):
    """The folder with the report of a bake, and what it holds."""
    path = tmp_path / "reports" / "arm.json"
    path.parent.mkdir()
    assert run("bake", shot, "--object", "Arm", "-o", tmp_path / "baked.blend", "--report", path)[0] == 0
    return path.parent, json.loads(path.read_text())


def ways_into(value, way=()):
    """The keys that lead to each part of JSON data, but not into the contents of `versions` and `summary`."""
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part_of_it in parts:
        yield (*way, key)
        if key not in ("versions", "summary"):
            yield from ways_into(part_of_it, (*way, key))


def test_reports_that_lack_something_are_refused_or_of_no_matter(run, reports, tmp_path):
    folder, report = reports
    (folder / "arm.json").unlink()
    page, read = tmp_path / "page.html", report_page.read
    refused = set()
    for way in ways_into(report):
        for value in (None, "gone", "\ud800", [], {}, [None], 10**400, True, ...):
            changed = json.loads(json.dumps(report))
            holder = changed
            for key in way[:-1]:
                holder = holder[key]
            if value is ...:
                del holder[way[-1]]
            else:
                holder[way[-1]] = value
            (folder / "changed.json").write_text(json.dumps(changed))
            try:
                found = read(folder)
                report_page.page(found, report_page.failures(found))
            except core_errors.ReportPageError:
                refused.add(way[-1])
    assert {"characters", "exit_code", "error", "versions", "name", "seconds", "bake", "frames", "hash"} <= refused
    (folder / "changed.json").write_text(json.dumps({**report, "characters": [{}]}))
    code, _, message = run("collect", folder, "-o", page)
    assert code == 2 and "'changed.json' is no report (something in it is missing or of another kind)" in message
    (folder / "changed.json").write_text(json.dumps({**report, "error": "\ud800"}))
    assert run("collect", folder, "-o", page)[0] == 0 and "\\ud800" in page.read_text()


@pytest.mark.parametrize("depth", [200, 900, 990, 1000, 3000, 10**5])
def test_reports_of_any_depth_are_refused_or_collected(run, reports, tmp_path, depth):
    folder, report = reports
    text = json.dumps({**report, "more": "deep"}).replace('"deep"', "[" * depth + "]" * depth)
    (folder / "arm.json").write_text(text)
    code, _, message = run("collect", folder, "-o", tmp_path / "page.html")
    assert code == 0 if depth == 200 else code in (0, 2) and "fault" not in message


@pytest.mark.parametrize("name", ["", "a\0b", "\ud800"])
@pytest.mark.parametrize("option", ["--report", "--output", "--cache-dir", "--output-file"])
def test_what_cannot_be_the_name_of_a_file(shot, run, stand_in, option, name):
    arguments = ("bake", shot, "--object", "Arm", "--in-place", "--format", "pc2", option, name)
    code, _, message = run(*arguments)
    assert code == 2 and f"argument {option if option != '--output' else '-o/--output'}: " in message
    assert "cannot be the name of a file" in message and stand_in.built == 0


@pytest.mark.parametrize("content", [b"1," + b"9" * 200_000 + b",0", b"1,\x00,2", b"\xff\xfe1,2", b'"1\n' * 50_000])
def test_a_table_that_no_reader_takes(shot, run, tmp_path, content):
    (tmp_path / "track.csv").write_bytes(content)
    arguments = ("fit", shot, "--all", "--in-place", "--target", "flexed", "--oscillation", tmp_path / "track.csv")
    code, _, message = run(*arguments)
    assert code == 2 and "'track.csv': expected 2 or 3 or 4 numbers with commas between them in every line" in message


def test_numbers_that_are_too_large_to_fit_anything(shot, run, tmp_path):
    rows = [f"{frame / 24},{1e308 * (-1) ** frame},0,0" for frame in range(48)]
    (tmp_path / "track.csv").write_text("\n".join(rows))
    arguments = ("fit", shot, "--all", "--in-place", "--target", "flexed", "--oscillation", tmp_path / "track.csv")
    code, _, message = run(*arguments)
    assert code == 2 and "some times or positions are not numbers" in message


@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_a_report_that_never_ends_is_not_read(shot, run, kind):
    report = shot.parent / "report.json"
    os.mkfifo(report) if kind == "pipe" else report.symlink_to("/dev/zero")
    code, _, message = run("collect", shot.parent, "-o", shot.parent / "all.html")
    assert code == 2 and "report.json" in message


def test_a_folder_of_reports_is_not_made_on_the_way_out(shot, run):
    """`..` after a folder that the name of an object would make."""
    victim = shot.parent / "settings.json"
    victim.write_text("mine")
    report = shot.parent / "out" / "shot a" / ".." / ".." / "settings.json"
    code, _, message = run("check", shot, "--object", "Arm", "--report", report)
    assert code == 2 and "there is no folder" in message
    assert victim.read_text() == "mine" and not (shot.parent / "out").exists()


def test_python_of_the_current_folder_is_not_imported(tmp_path):
    for name in ("bpy", "numpy", "shutil", "pathlib"):
        (tmp_path / f"{name}.py").write_text("open('ran', 'w').close()\nraise SystemExit('it ran')")
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3] / "addon")}
    command = [sys.executable, "-m", "dynamic_morph_targets", "info", "nowhere.blend"]
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2 and "there is no file 'nowhere.blend'" in done.stderr
    assert not (tmp_path / "ran").exists()


STORED = [  # group, property and a value that no button sets
    ("model", "modes", -1), ("model", "material_model", 99), ("model", "cage_nodes", 0),
    ("model", "pin_radius", float("nan")),
    ("simulation", "amount", float("nan")), ("simulation", "samples", 0), ("simulation", "substeps", -1),
    ("simulation", "integrator", -1), ("simulation", "gravity", float("inf")), ("output", "format", 1),
    ("target", "stiffness", -1.0), ("target", "poisson", 0.5), ("target", "fade_out_angle", float("nan")),
]  # fmt: skip


@pytest.mark.parametrize("group, name, value", STORED)
def test_values_that_a_stranger_s_file_has_stored_are_refused(shot, run, stand_in, group, name, value):
    """Blender limits what is set, and not what a file has."""
    settings = bpy.data.objects["Arm"].dynamorph
    owner = settings.targets[1] if group == "target" else getattr(settings, group)
    stored = owner.bl_system_properties_get(do_create=True) if hasattr(owner, "bl_system_properties_get") else owner
    stored[name] = value
    bpy.ops.wm.save_mainfile()
    setting = owner.bl_rna.properties[name].name
    for command in (["check"], ["build", "-o", shot.parent / "out.blend"], ["bake", "-o", shot.parent / "out.blend"]):
        code, out, message = run(command[0], shot, "--object", "Arm", *command[1:])
        assert code == 2 and f"'Arm': {setting} " in out + message and "set it again" in out + message
    assert stand_in.built == 0


# What a bake becomes ------------------------------------------------------------------------------------------------


def test_a_format_that_plays_in_blender(shot, run):
    output = shot.parent / "elsewhere" / "baked.blend"
    output.parent.mkdir()
    code, out, errors = run("bake", shot, "--object", "Arm", "--format", "pc2", "-o", output)
    assert code == 0, errors
    bpy.ops.wm.open_mainfile(filepath=str(output))
    modifier = bpy.data.objects["Arm"].modifiers[0]
    assert modifier.filepath.startswith("//dynamorph_caches")
    assert Path(bpy.path.abspath(modifier.filepath)).parent == output.parent / "dynamorph_caches"
    assert Path(bpy.path.abspath(modifier.filepath)).is_file()
    again = shot.parent / "again.blend"
    code, out, errors = run("bake", output, "--object", "Arm", "--format", "modes", "--keys", 2, "-o", again)
    assert code == 0, errors
    assert "keys' error" in out
    assert len(bake_of(again, "Arm")) == 2 and len(bpy.data.objects["Arm"].modifiers) == 1


def test_a_format_that_is_a_file_for_other_programs(shot, run, monkeypatch):
    code, out, errors = run("bake", shot, "--object", "Arm", "--format", "gltf")
    assert code == 0, errors
    assert (shot.parent / "Arm.glb").is_file() and "written to Arm.glb" in out
    code, _, errors = run(
        "bake", shot, "--all", "--format", "pc2", "--output-file", shot.parent / "x.pc2", "-o", "y.blend"
    )
    assert code == 2 and "put {object} in its name" in errors
    monkeypatch.setattr(paths, "clean_name", lambda name: "x")
    code, _, errors = run("bake", shot, "--all", "--format", "gltf")
    assert code == 2 and "several meshes would share it: give them names that differ more" in errors
    monkeypatch.undo()
    files, saved = shot.parent / "{object}.pc2", shot.parent / "y.blend"
    code, _, errors = run("bake", shot, "--all", "--format", "pc2", "--output-file", files, "-o", saved)
    assert code == 0, errors
    assert (shot.parent / "Arm.pc2").is_file() and (shot.parent / "Leg.pc2").is_file()


@pytest.mark.parametrize(
    "arguments, words",
    [
        ([], "specify an output"),
        (["--format", "modes"], "specify an output"),
        (["--format", "modes", "--output-file", "x", "--in-place"], "needs a --format that is a file"),
        (["--format", "usd", "--clips", "actions"], "--clips actions needs --format gltf"),
        (["--format", "gltf", "--clips", "actions", "--frames", "1", "9"], "leave --frames out"),
        (["--format", "gltf", "--output-file", "x.fbx"], "a file of gltf ends in .glb"),
        (["--format", "pc2", "--output-file", "x.cache", "--in-place"], "a file of pc2 ends in .pc2"),
        (["--format", "gltf", "--output-file", "nowhere/x.glb"], "there is no folder"),
    ],
)
def test_a_bake_that_would_go_nowhere(shot, run, stand_in, arguments, words):
    code, _, errors = run("bake", shot, "--object", "Arm", *arguments)
    assert code == 2 and words in errors
    assert stand_in.built == 0


def test_the_help_names_the_options(run):
    code, out, _ = run("bake", "--help")
    assert code == 0 and "--cache-dir" in out and "--initial-state" in out
    assert "delete-bake" in run("--help")[1]


def test_what_one_of_many_refuses_is_found_before_any_work(shot, run, stand_in):
    bpy.ops.wm.open_mainfile(filepath=str(shot))
    bpy.data.objects["Leg"].dynamorph.targets[1].name = "bent"
    bpy.data.objects["Leg"].data.shape_keys.key_blocks["flexed"].name = "bent"
    bpy.ops.wm.save_mainfile()
    code, _, errors = run("bake", shot, "--all", "--set", "flexed.stiffness=2e4", "--in-place")
    assert code == 2 and "'Leg' has no target named 'flexed'" in errors
    assert stand_in.built == 0


@pytest.mark.fault("B01")
def test_a_bug_is_reported(shot, run, stand_in):
    stand_in.fail = ZeroDivisionError("a bug")
    report = shot.parent / "report.json"
    code, _, errors = run("bake", shot, "--object", "Arm", "--in-place", "--report", report)
    assert code == 70 and "ZeroDivisionError: a bug" in errors
    assert json.loads(report.read_text())["exit_code"] == 70


@pytest.mark.fault("B01", "C08")
def test_exit_codes_tell_bugs_from_what_is_expected(shot, run, stand_in):
    bake = ("bake", shot, "--object", "Arm", "-o", shot.parent / "baked.blend")
    for failure, code, words in (
        (core_errors.SceneError("too soft"), 2, "error: too soft"),
        (core_errors.SelfCheckError("not numbers"), 3, "error: not numbers"),
        (ValueError("shapes differ"), 70, "fault: ValueError: shapes differ"),
        (KeyError("mesh"), 70, "Traceback"),
        (OSError(28, "No space left"), 75, "No space left.*try again"),
        (MemoryError(), 75, "not enough memory.*try again"),
    ):
        stand_in.fail = failure
        found, _out, message = run(*bake)
        assert found == code and re.search(words, message), message


def test_too_little_memory_is_found_before_any_work(shot, run, stand_in, monkeypatch):
    sampled = []
    monkeypatch.setattr(rig_motion, "RigSampling", lambda *_: sampled.append(True))
    bake = ("bake", shot, "--object", "Arm", "-o", shot.parent / "baked.blend")
    for most, code, words in ((2.0**20, 2, "GB at most: lower Cage Nodes"), (2.0**40, 75, "are free: close other")):
        monkeypatch.setattr(memory, "room", lambda most=most: memory.Room(most, 2.0**20))
        found, _out, message = run(*bake)
        assert found == code and "'Arm' needs about" in message and words in message
        assert stand_in.built == 0 and not sampled


def test_a_frame_of_a_week_is_refused(shot, run, stand_in):
    """Its time steps would fill the memory."""
    bpy.ops.wm.open_mainfile(filepath=str(shot))
    bpy.context.scene.render.fps, bpy.context.scene.render.fps_base = 1, 1e6
    bpy.ops.wm.save_mainfile()
    bake = ("bake", shot, "--object", "Arm", "-o", shot.parent / "baked.blend")
    code, _, message = run(*bake)
    assert code == 2 and "'Arm': a frame of 1e+06 s takes 120000000 time steps, and 1000 are the most" in message
    assert stand_in.built == 0
    assert run(*bake, "--substeps", 1)[0] == 0
    assert run("info", bake[-1], "--all")[0] == 0
    assert "takes 120000000 time steps" in run(*bake, "--substeps", 0)[2]  # automatic
    for substeps in (-1, 1001, 10**12):
        code, _, message = run(*bake, "--substeps", substeps)
        assert code == 2 and f"--substeps is {substeps}: give 1 to 1000, or 0 for automatic" in message


def test_info_lists_the_files_that_a_scene_needs(shot, run, monkeypatch):
    """No bake deletes such files: the .blend as it was last saved may still use the previous one."""
    monkeypatch.setattr(storage, "PACK_LIMIT", 100)
    for mass_damping in (1, 2):
        change = f"Neutral.mass_damping={mass_damping}"
        bake = ("bake", shot, "--object", "Arm", "--format", "pc2", "--set", change, "--frames", 1, 9 + mass_damping)
        assert run(*bake, "--in-place")[0] == 0
    written = {file.name for file in shot.parent.rglob("*") if file.suffix in (".pc2", ".dynamorph")}
    message = re.search("files beside the .blend: (.*)", run("info", shot, "--object", "Arm")[1])[1].split(", ")
    assert len(written) == 3 and len(message) == 2 and set(message) < written
