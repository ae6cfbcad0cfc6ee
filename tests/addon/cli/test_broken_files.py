# SPDX-License-Identifier: GPL-3.0-or-later
"""Faults of files, of cache folders and of the installation that nothing else here is about: see tests/faults.toml."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.cli import main
from bl_ext.user_default.dynamic_morph_targets.io import cache_dir, disk
from builders import evaluated_points, make_arm
from robustness import OPS, bake, coarse
from test_kills import environment

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")


@pytest.fixture
def skin(soft_arm):
    return coarse(soft_arm)


@pytest.fixture
def shot(skin, tmp_path):
    """A saved file with a soft skin, whose bake takes a fraction of a second."""
    skin.dynamorph.simulation.substeps = 1
    path = tmp_path / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def run(*arguments):
    return main.main([str(argument) for argument in arguments], opens_file=True)


# Names -------------------------------------------------------------------------------------------------------------


@pytest.mark.fault("F08")
@pytest.mark.parametrize("name", ["Ünï 日本語 🦊", "con", "two words. ", "..", "a/b\\c:d", "x" * 63])
def test_any_name_of_an_object_names_its_files(shot, tmp_path, name):
    """In a folder with such a name, too."""
    bpy.data.objects["Arm"].name = name
    folder = tmp_path / "Ünï côdé 🦊, two words"
    folder.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "shot.v2 .blend"))
    name = bpy.context.object.name  # Blender may have shortened it
    assert run("bake", bpy.data.filepath, "--object", name, "--format", "pc2", "--in-place") == 0
    bpy.ops.wm.open_mainfile(filepath=bpy.data.filepath)
    obj = bpy.data.objects[name]
    cache = Path(bpy.path.abspath(obj.modifiers[0].filepath))
    assert cache.is_file() and cache.parent.parent == folder
    bpy.context.scene.frame_set(1)
    first = evaluated_points(obj)
    bpy.context.scene.frame_set(12)
    assert np.abs(evaluated_points(obj) - first).max() > 1e-3


@pytest.mark.fault("F08")
def test_a_name_that_no_file_can_have_is_refused(shot, capfd):
    before = shot.read_bytes()
    output = shot.with_name("x" * 300 + ".blend")
    assert run("bake", shot, "--object", "Arm", "-o", output) != 0
    assert "Traceback" not in capfd.readouterr().err
    assert shot.read_bytes() == before and not output.parent.joinpath(output.name[:100]).exists()


# Links -------------------------------------------------------------------------------------------------------------


@pytest.mark.fault("F10")
def test_what_a_link_leads_to_stays(shot, tmp_path):
    """Files of a bake that are replaced, cleared, or deleted when they are done: only ever the link itself."""
    theirs = tmp_path / "theirs"
    theirs.write_bytes(b"precious")
    old = tmp_path / "old"
    old.mkdir()
    for link in (old / "model.0123456789abcdef.part", old / "model"):
        link.symlink_to(theirs)
        os.utime(link, (0, 0), follow_symlinks=False)
    os.utime(theirs, (0, 0))  # an hour old: what is abandoned is cleared
    disk.save(old / "model", b"ours")
    assert (old / "model").read_bytes() == b"ours" and not (old / "model").is_symlink()
    assert [path.name for path in old.iterdir()] == ["model"]
    link = tmp_path / "unfinished"
    link.symlink_to(theirs)
    disk.discard(link)
    assert not link.is_symlink() and theirs.read_bytes() == b"precious"


@pytest.mark.fault("F09", "F10")
def test_delete_bake_deletes_no_files(shot, tmp_path):
    """So that a .blend cannot make it delete others: the path of its cache may lead anywhere."""
    theirs = tmp_path / "theirs.pc2"
    theirs.write_bytes(b"precious")
    obj = bpy.data.objects["Arm"]
    obj.dynamorph.output.format = "PC2"
    bake(obj, folder=tmp_path)
    caches = list(tmp_path.rglob("*-*.pc2"))
    obj.modifiers[0].filepath = "//../../" + theirs.name
    obj.dynamorph.bake.cache = f"../../{theirs}"
    OPS.delete_bake()
    assert theirs.read_bytes() == b"precious" and len(caches) == 1 and caches[0].is_file()


# Folders that processes share ----------------------------------------------------------------------------------------


@pytest.mark.fault("B04", "C04")
def test_tasks_that_start_at_once_on_one_folder(shot, tmp_path):
    """Each would build the same model and keep the same bake: all succeed, with the same bytes."""
    caches, reports = tmp_path / "caches", [tmp_path / f"{k}.json" for k in range(3)]
    command = [sys.executable, "-m", "dynamic_morph_targets", "bake", shot, "--object", "Arm", "--cache-dir", caches]
    tasks = [
        subprocess.Popen(
            [*command, "-o", report.with_suffix(".blend"), "--report", report],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=environment(),
        )
        for report in reports
    ]  # fmt: skip
    for task in tasks:
        _, errors = task.communicate(timeout=300)
        assert task.returncode == 0, errors
    made = [json.loads(report.read_text())["characters"][0] for report in reports]
    assert len({(each["model"], each["bake"]["hash"]) for each in made}) == 1
    assert [path.suffix for path in caches.iterdir()] == [".dynamorph"]


@pytest.mark.fault("B04")
def test_writers_of_one_file_do_not_disturb_each_other(tmp_path):
    """Fifty at once: at any time there is one whole file, and in the end nothing else."""
    path = tmp_path / "model"
    contents = [bytes([k]) * 100_000 for k in range(50)]
    code = (
        "import sys; from dynamic_morph_targets.io import disk\n"
        "for k in map(int, sys.argv[2:]): disk.save(sys.argv[1], bytes([k]) * 100_000)"
    )
    writers = [
        subprocess.Popen([sys.executable, "-c", code, path, *map(str, range(k, 50, 5))], env=environment())
        for k in range(5)
    ]
    disk.save(path, contents[0])
    while any(writer.poll() is None for writer in writers):
        assert path.read_bytes() in contents
    assert [writer.returncode for writer in writers] == [0] * 5
    assert path.read_bytes() in contents and list(tmp_path.iterdir()) == [path]


@pytest.mark.fault("F13")
@pytest.mark.parametrize("code", [5, 116])  # EIO; ESTALE, which a network share says that has lost the file
def test_a_cache_folder_that_fails_in_the_middle_of_a_bake(shot, tmp_path, monkeypatch, capfd, code):
    """The farm is asked to try again, and the file is as it was."""
    before, calls = shot.read_bytes(), []

    def lost(_cache_dir, path, *_arguments):
        calls.append(path)
        raise OSError(code, os.strerror(code), str(path))

    monkeypatch.setattr(cache_dir.CacheDir, "keep", lost)
    assert run("bake", shot, "--object", "Arm", "--cache-dir", tmp_path / "caches", "--in-place") == 75
    assert os.strerror(code) in capfd.readouterr().err
    assert calls and shot.read_bytes() == before
    assert not list((tmp_path / "caches").glob("*.part"))


# Versions ----------------------------------------------------------------------------------------------------------


@pytest.mark.fault("V04")
def test_settings_of_a_newer_version_survive(skin, tmp_path):
    """Blender keeps what this version does not know, and so does a bake."""
    groups = {"": skin.dynamorph, "model": skin.dynamorph.model, "targets[1]": skin.dynamorph.targets[1]}
    for group in groups.values():
        group["of_the_future"] = 3.5
    path = str(tmp_path / "newer.blend")
    for _ in range(2):
        bpy.ops.wm.save_as_mainfile(filepath=path)
        bpy.ops.wm.open_mainfile(filepath=path)
        bake(bpy.data.objects["Arm"])
    kept = bpy.data.objects["Arm"].dynamorph
    assert [(kept.path_resolve(path) if path else kept)["of_the_future"] for path in groups] == [3.5] * 3


@pytest.mark.fault("V06")
def test_nothing_asks_for_the_network(scene, monkeypatch, tmp_path):
    def refuse(*_arguments, **_options):
        raise AssertionError("a socket was asked for")

    for name in ("connect", "connect_ex", "bind", "sendto"):
        monkeypatch.setattr(socket.socket, name, refuse, raising=False)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)
    obj = make_arm(scene)
    OPS.add_soft_skin()
    coarse(obj)
    assert OPS.bake() == {"FINISHED"}
    assert OPS.export(format="GLTF", filepath=str(tmp_path / "arm.glb")) == {"FINISHED"}
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
