# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that a command line names: nothing is written over what it reads, or over what somebody saved meanwhile."""

import errno
import json
import os
import signal
from pathlib import Path

import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.cli import commands, main
from bl_ext.user_default.dynamic_morph_targets.io import disk
from bl_ext.user_default.dynamic_morph_targets.write.export import blend_file
from test_command_line import run, shot  # noqa: F401


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["check", "{shot}", "--report", "{shot}"], "the .blend and --report are the same file"),
        (["bake", "{shot}", "--in-place", "--report", "{link}"], "the .blend and --report are the same file"),
        (["bake", "{shot}", "-o", "{folder}/x.json", "--report", "{folder}/y/../x.json"], "-o and --report are"),
        (["bake", "{shot}", "-o", "{folder}/x.glb", "--format", "gltf", "--output-file", "{folder}/x.glb"],
         "x.glb: the name of a Blender file ends in .blend"),
        (["bake", "{shot}", "--in-place", "--format", "pc2", "--output-file", "{folder}/x.pc2", "--report",
          "{folder}/x.pc2"], "--report and --output-file are the same"),
        (["report", "{shot}", "--json", "{shot}"], "the .blend and --json are the same file"),
        (["fit", "{shot}", "--target", "flexed", "--oscillation", "{csv}", "-o", "{csv}"],
         "-o and --oscillation are the same"),
        (["collect", "{folder}", "-o", "{folder}/x.json"], "-o and the .json beside -o are the same"),
    ],
)  # fmt: skip
def test_no_file_is_named_twice(shot, run, stand_in, arguments, words):  # noqa: F811
    folder = shot.parent
    link, csv = folder / "link.blend", folder / "swing.csv"
    link.symlink_to(shot)
    csv.write_text("0,0,0,0\n")
    (folder / "y").mkdir()
    before = {path: path.read_bytes() for path in (shot, csv)}
    chosen = () if arguments[0] == "collect" else ("--object", "Arm")
    code, _, errors = run(*(a.format(shot=shot, folder=folder, link=link, csv=csv) for a in arguments), *chosen)
    assert code == 2 and words in errors and stand_in.built == 0
    assert {path: path.read_bytes() for path in before} == before
    assert sorted(path.name for path in folder.iterdir()) == sorted([shot.name, "link.blend", "swing.csv", "y"])


def test_a_page_does_not_replace_a_report(shot, run):  # noqa: F811
    folder = shot.parent / "reports"
    assert run("check", shot, "--object", "Arm", "--report", folder / "shot.json")[0] == 0
    before = (folder / "shot.json").read_bytes()
    code, _, errors = run("collect", folder, "-o", folder / "shot.html")
    assert code == 2 and "report shot" in errors
    assert [(path.name, path.read_bytes()) for path in folder.iterdir()] == [("shot.json", before)]
    assert run("collect", folder, "-o", folder / "all.html")[0] == 0
    assert run("collect", folder, "-o", folder / "all.html")[0] == 0  # its own .json is none


@pytest.mark.parametrize("kind", ["another user's", "a pipe"])
def test_a_report_that_is_refused_is_not_written(shot, run, monkeypatch, kind):  # noqa: F811
    report = shot.parent / "report.json"
    if kind == "a pipe":
        os.mkfifo(report)
    else:
        report.write_text("mine")
        shot.parent.chmod(0o1777)  # as /tmp
        monkeypatch.setattr(os, "geteuid", lambda: report.stat().st_uid + 1)
    code, _, errors = run("check", shot, "--object", "Arm", "--report", report)
    assert code == 2 and "report.json" in errors
    assert report.is_fifo() or report.read_text() == "mine"


def test_what_was_saved_during_a_bake_stays(shot, run, stand_in, monkeypatch):  # noqa: F811
    work = commands.work_on

    def work_beside(*arguments):
        shot.write_bytes(b"an hour of work")
        return work(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(commands, "work_on", work_beside)
        code, _, errors = run("bake", shot, "--object", "Arm", "--in-place")
    assert code == 75 and "was saved by another program meanwhile" in errors
    assert shot.read_bytes() == b"an hour of work"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("moment", ["replace", "print_table", "record"])
def test_a_signal_once_the_file_is_replaced(shot, run, stand_in, monkeypatch, number, moment):  # noqa: F811
    """It waits for the earlier version, and the message is right."""
    where = {"replace": disk, "print_table": commands, "record": main}[moment]
    before, work = shot.read_bytes(), getattr(where, moment)

    def interrupted(*arguments):
        done = work(*arguments)
        if moment != "replace" or arguments[-1] == shot:
            os.kill(os.getpid(), number)
        return done

    monkeypatch.setattr(bpy.context.preferences.filepaths, "save_version", 1)
    with monkeypatch.context() as patch:
        patch.setattr(where, moment, interrupted)
        code, _, errors = run("bake", shot, "--object", "Arm", "--in-place", "--report", shot.parent / "r.json")
    report = json.loads((shot.parent / "r.json").read_text())
    if moment == "record":
        assert code == 0
    else:
        assert code == {signal.SIGINT: 130, signal.SIGTERM: 75}[number] and "it was saved before" in errors
    assert report["exit_code"] == code
    assert Path(f"{shot}1").read_bytes() == before != shot.read_bytes()


def test_an_earlier_version_that_a_killed_process_left_is_kept(shot, run, stand_in, monkeypatch):  # noqa: F811
    before = shot.read_bytes()
    replace = disk.replace

    class Killed(BaseException):
        pass

    def killed(new, path):
        if path.suffix == ".blend1":
            raise Killed
        replace(new, path)

    monkeypatch.setattr(bpy.context.preferences.filepaths, "save_version", 2)
    with monkeypatch.context() as patch:
        patch.setattr(disk, "replace", killed)
        with pytest.raises(Killed):
            run("bake", shot, "--object", "Arm", "--in-place")
    baked = shot.read_bytes()
    assert baked != before and not Path(f"{shot}1").exists()
    monkeypatch.setattr(disk, "ABANDONED", -1.0)
    assert run("delete-bake", shot, "--object", "Arm", "--in-place")[0] == 0
    assert [Path(f"{shot}{number}").read_bytes() for number in (1, 2)] == [baked, before]
    assert not list(shot.parent.glob("*.earlier.*"))


def test_a_file_of_a_newer_blender_is_not_replaced(shot, run, stand_in, monkeypatch):  # noqa: F811
    version = bpy.app.version_string.split(".")
    content = bytearray(shot.read_bytes())
    monkeypatch.setattr(main, "bpy", Newer())
    code, _, errors = run("bake", shot, "--object", "Arm", "--in-place")
    assert code == 2 and f"was saved by Blender 99.0, and {version[0]}.{version[1]} keeps only a part of it" in errors
    assert shot.read_bytes() == content


class Newer:
    """bpy, as if the open file came from a version that is not out yet."""

    def __getattr__(self, name):
        return (
            self
            if name == "data"
            else (99, 0, 0)
            if name == "version"
            else getattr(bpy.data, name, None) or getattr(bpy, name)
        )


def test_python_in_a_file_is_reported_or_runs(shot, run, stand_in):  # noqa: F811
    driver = bpy.data.objects["Arm Rig"].driver_add("location", 2).driver
    driver.expression = "sum([frame, 1.0])"  # more than Blender's own simple expressions
    bpy.ops.wm.save_mainfile()
    output = shot.parent / "baked.blend"
    warning = "warning: The file has Python"
    assert warning in run("bake", shot, "--object", "Arm", "-o", output)[2]
    assert warning not in run("bake", shot, "--object", "Arm", "-o", output, "--enable-autoexec")[2]


@pytest.mark.parametrize("fails", [False, True])
def test_a_point_cache_changes_with_the_blend_that_plays_it(shot, run, stand_in, monkeypatch, fails):  # noqa: F811
    """As when one character of several is refused, or the disk is full in the end."""
    cache = shot.parent / "Arm.pc2"
    bake = ("bake", shot, "--object", "Arm", "--in-place", "--format", "pc2", "--output-file", cache)
    assert run(*bake)[0] == 0
    before, blend = cache.read_bytes(), shot.read_bytes()
    there = sorted(path.name for path in shot.parent.iterdir())
    with monkeypatch.context() as patch:
        save = blend_file.save

        def save_then(path):
            assert cache.read_bytes() != before
            if fails:
                raise OSError(errno.ENOSPC, "No space left", str(path))
            save(path)

        patch.setattr(blend_file, "save", save_then)
        code, _, errors = run(*bake, "--frames", 1, 5)
    assert code == (75 if fails else 0), errors
    assert (cache.read_bytes() == before) == fails == (shot.read_bytes() == blend)
    assert {path.name for path in shot.parent.iterdir()} - set(there) <= {"shot ü.blend2"}


def test_a_point_cache_that_is_gone_is_reported(shot, run):  # noqa: F811
    cache = shot.parent / "Arm.pc2"
    assert run("bake", shot, "--object", "Arm", "--in-place", "--format", "pc2", "--output-file", cache)[0] == 0
    assert "bake state: up to date" in run("info", shot, "--object", "Arm")[1]
    content = cache.read_bytes()
    for spoiled in (content[:-4], None):
        cache.unlink() if spoiled is None else cache.write_bytes(spoiled)
        assert "bake state: the point cache 'Arm.pc2' of 'Arm' is missing or" in run("info", shot, "--object", "Arm")[1]
    cache.write_bytes(content)
    assert "bake state: up to date" in run("info", shot, "--object", "Arm")[1]


def test_an_older_version_pushes_out_no_newer_one(soft_arm, tmp_path, monkeypatch):
    """That a killed process has left, and that is found when there are newer ones."""
    path, save = tmp_path / "shot.blend", blend_file.save
    monkeypatch.setattr(bpy.context.preferences.filepaths, "save_version", 2)
    left = tmp_path / f"shot.{'0' * 16}.earlier.blend"
    left.write_bytes(b"old")
    os.utime(left, (1.0, 1.0))
    path.write_bytes(b"newer")
    Path(f"{path}1").write_bytes(b"new")
    save(path)
    assert [Path(f"{path}{number}").read_bytes() for number in (1, 2)] == [b"newer", b"new"] and not left.exists()
    Path(f"{path}2").unlink()
    left.write_bytes(b"old")
    os.utime(left, (1.0, 1.0))
    Path(f"{path}1").unlink()
    save(path)
    assert Path(f"{path}1").exists() and Path(f"{path}2").read_bytes() == b"old" and not left.exists()


def test_a_clash_of_other_files_is_reported(shot, run, stand_in):  # noqa: F811
    report = shot.parent / "reports" / ".." / "r.json"
    (shot.parent / "reports").mkdir()
    assert run("bake", shot, "--object", "Arm", "-o", shot, "--report", report)[0] == 2
    assert "--in-place" in json.loads(report.read_text())["error"]
    assert run("check", shot, "--object", "Arm", "--report", shot.parent / "reports" / ".." / "new" / "r.json")[0] == 0
    assert (shot.parent / "new" / "r.json").exists()


def test_a_point_cache_that_is_in_use_leaves_all_as_it_was(shot, run, stand_in, monkeypatch):  # noqa: F811
    """As on Windows, when another Blender plays it."""
    cache = shot.parent / "Arm.pc2"
    bake = ("bake", shot, "--object", "Arm", "--in-place", "--format", "pc2", "--output-file", cache)
    assert run(*bake)[0] == 0
    before, replace = (cache.read_bytes(), shot.read_bytes()), disk.replace

    def refuse(new, path):
        if path == cache and ".part." in new.name and new.read_bytes() != before[0]:
            raise disk.in_use(path)
        replace(new, path)

    with monkeypatch.context() as patch:
        patch.setattr(disk, "replace", refuse)
        code, _, errors = run(*bake, "--frames", 1, 5)
    assert code == 75 and "another program has it open" in errors
    assert (cache.read_bytes(), shot.read_bytes()) == before
    assert not list(shot.parent.glob("*.part.*"))
