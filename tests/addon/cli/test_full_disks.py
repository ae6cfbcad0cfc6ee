# SPDX-License-Identifier: GPL-3.0-or-later
"""Disks that are full, folders that cannot be written to, and names that cannot be: what was there before stays,
nothing incomplete is left, and the message and the exit code say whether trying again helps.
"""

import errno
import json
import os
import re
import struct
import subprocess
import sys
import time
from dataclasses import replace

import bpy
import numpy as np
import pytest
import round_trips
from bl_ext.user_default.dynamic_morph_targets.core import errors
from bl_ext.user_default.dynamic_morph_targets.core.result import keys
from bl_ext.user_default.dynamic_morph_targets.io import disk as io_disk
from bl_ext.user_default.dynamic_morph_targets.io import outputs, point_cache, report_page, whole
from bl_ext.user_default.dynamic_morph_targets.run.bake import export_actions
from bl_ext.user_default.dynamic_morph_targets.scene.read import mesh_data
from bl_ext.user_default.dynamic_morph_targets.write.bake import writer
from bl_ext.user_default.dynamic_morph_targets.write.export import blend_file, exports, losses, process
from builders import activate, fingerprint, hand_made_bake
from built import SmallModel
from test_command_line import run, shot  # noqa: F401
from test_kills import environment

# Files that Blender's exporters in Python leave open when the disk is full fail again when they are forgotten.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")

FRAMES = 1, 20
FORMATS = tuple(exports.FORMATS)
EARLIER = b"an earlier file" * 100
built = SmallModel()
ROOM = 10  # KB that are free on a full disk: for a trial, not for a result
FULL = "No space left on device"


def mounted(kind, folder, *options):
    """Mount something on a folder, which the test needs root for."""
    if not sys.platform.startswith("linux"):
        pytest.skip("mounts a file system, which needs Linux")
    done = subprocess.run(["mount", *kind, *options, str(folder)], capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"mounts a file system, which needs root: {done.stderr.strip()}")


@pytest.fixture
def disk(tmp_path):
    """A disk of 300 KB of its own."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted(("-t", "tmpfs"), folder, "-o", "size=300k", "tmpfs")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


@pytest.fixture
def read_only(tmp_path):
    """A folder that even root cannot write to."""
    folder = tmp_path / "protected"
    folder.mkdir()
    (folder / "earlier").write_bytes(EARLIER)
    mounted(("--bind",), folder, str(folder))
    subprocess.run(["mount", "-o", "remount,ro,bind", str(folder)], check=True)
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def fill(disk, room=ROOM):
    """Leave so many KB."""
    free = os.statvfs(disk).f_bavail * os.statvfs(disk).f_frsize
    (disk / "ballast").write_bytes(bytes(free - 1024 * room))


def names(folder):
    return sorted(file.name for file in folder.iterdir() if file.name != "ballast")


@pytest.fixture
def baked(soft_arm):
    built.give(soft_arm)
    writer.write_keys(soft_arm, hand_made_bake(soft_arm))
    return soft_arm


def path_of(key, folder):
    return folder / f"Arm{exports.FORMATS[key].suffix}"


def export(obj, path, key):
    export_actions.export(obj, key, path, FRAMES)


def full(error):
    return error.value.errno == errno.ENOSPC


# Exports -------------------------------------------------------------------------------------------------------------


@pytest.mark.fault("F12")
@pytest.mark.parametrize("key", FORMATS)
def test_an_export_that_does_not_fit_is_refused_before_it_is_written(baked, disk, monkeypatch, key):
    path = path_of(key, disk)
    path.write_bytes(EARLIER)
    fill(disk)
    monkeypatch.setitem(exports.FORMATS, key, replace(exports.FORMATS[key], write=None))
    with pytest.raises(OSError, match=rf"{FULL}, about 0.\d MB are needed, 0.0 MB are free.*{path.name}") as error:
        export(baked, path, key)
    assert full(error) and errors.is_transient(error.value)
    assert path.read_bytes() == EARLIER and names(disk) == [path.name]


@pytest.mark.fault("F12")
@pytest.mark.parametrize("key", FORMATS)
def test_a_disk_that_fills_while_an_export_is_written(baked, disk, monkeypatch, key):
    path = path_of(key, disk)
    monkeypatch.setattr(outputs, "check_space", lambda *_args: None)
    export(baked, path, key)
    earlier, before = path.read_bytes(), fingerprint(baked)
    fill(disk)
    with pytest.raises(OSError, match=FULL) as error:
        export(baked, path, key)
    assert full(error) and error.value.filename == str(path)
    assert path.read_bytes() == earlier and names(disk) == [path.name]
    assert fingerprint(baked) == before and not bpy.data.collections
    (disk / "ballast").unlink()
    export(baked, path, key)
    assert names(disk) == [path.name] and len(path.read_bytes()) == pytest.approx(len(earlier), abs=100)


def test_the_button_says_which_file_and_what_to_do(baked, disk, monkeypatch):
    activate(baked)
    monkeypatch.setattr(outputs, "check_space", lambda *_args: None)
    for key in ("GLTF", "ALEMBIC"):
        path = path_of(key, disk)
        (disk / "ballast").unlink(missing_ok=True)
        fill(disk)
        with pytest.raises(RuntimeError) as error:
            bpy.ops.dynamorph.export(format=key, filepath=str(path))
        assert str(error.value) == f"Error: '{path}': {FULL}. Free some space, or choose another folder\n"
        assert names(disk) == []


@pytest.mark.fault("F10")
@pytest.mark.parametrize("key", FORMATS)
def test_a_file_of_the_artist_is_never_taken_for_a_partial_one(baked, tmp_path, key):
    """Of whichever name, and wherever a link leads."""
    path, own = path_of(key, tmp_path), tmp_path / "own"
    own.write_bytes(EARLIER)
    partial = path.with_name(f"Arm.part{path.suffix}")
    partial.symlink_to(own)
    old = path.with_name(f"Arm.old.part{path.suffix}")
    old.write_bytes(EARLIER)
    os.utime(old, (0, 0))
    path.symlink_to(own)
    export(baked, path, key)
    assert own.read_bytes() == old.read_bytes() == EARLIER and partial.is_symlink()
    assert not path.is_symlink() and path.stat().st_size > len(EARLIER)
    assert names(tmp_path) == sorted(file.name for file in (path, own, partial, old))


def test_what_a_killed_process_left_is_removed_after_an_hour(baked, tmp_path):
    left = [tmp_path / f"Arm.{digit * 16}.part.glb" for digit in "ab"]
    left[0].write_bytes(EARLIER)
    left[1].mkdir()
    (left[1] / "Arm.glb").write_bytes(EARLIER)
    export(baked, tmp_path / "Arm.glb", "GLTF")
    assert all(file.exists() for file in left)
    for file in left:
        os.utime(file, (time.time() - 4000.0,) * 2)
    export(baked, tmp_path / "Arm.glb", "GLTF")
    assert names(tmp_path) == ["Arm.glb"]


CRASH = "import os; os.abort()"
NOTHING = "import os; os._exit(0)"
RUBBISH = """
import json, sys
from pathlib import Path
sys.argv[1:] = sys.argv[-1:]
source = Path({child!r}).read_text().replace("getattr(bpy.ops.wm, f\\"{{job['format']}}_export\\")", "rubbish")
def rubbish(filepath, **_options):
    Path(filepath).write_bytes(b"rubbish" * 1000)
exec(compile(source, "child", "exec"))
"""


@pytest.mark.parametrize("key", ["ALEMBIC", "USD"])
@pytest.mark.parametrize(
    "script, words",
    [
        (
            CRASH,
            "^'Arm' could not be exported to '{path}' .*crashed with code -6.: try again, or choose",
        ),
        (NOTHING, "^'Arm' could not be exported to '{path}' .*wrote nothing"),
        (RUBBISH, "^'{path}': the written data cannot be read back. Check the disk"),
    ],
)
def test_an_exporter_that_crashes_or_writes_rubbish(baked, tmp_path, monkeypatch, key, script, words):
    path = path_of(key, tmp_path)
    path.write_bytes(EARLIER)
    child = tmp_path / "child.py"
    child.write_text(script.format(child=str(process.CHILD)) if script == RUBBISH else script)
    monkeypatch.setattr(process, "CHILD", child)
    with pytest.raises((errors.ExportError, OSError)) as error:
        export(baked, path, key)
    assert re.search(words.format(path=path), errors.sentence(error.value))
    assert errors.is_transient(error.value) == (script == RUBBISH)
    assert path.read_bytes() == EARLIER and names(tmp_path) == [path.name, "child.py"]


@pytest.mark.fault("C08")
def test_an_exporter_that_is_killed_for_its_memory(baked, tmp_path, monkeypatch):
    child = tmp_path / "child.py"
    child.write_text("import os, signal; os.kill(os.getpid(), signal.SIGKILL)")
    monkeypatch.setattr(process, "CHILD", child)
    with pytest.raises(MemoryError):
        export(baked, tmp_path / "Arm.abc", "ALEMBIC")
    assert names(tmp_path) == ["child.py"]


def test_a_full_temporary_folder_is_named(baked, disk, tmp_path):
    files = bpy.context.preferences.filepaths
    before, files.temporary_directory = files.temporary_directory, str(disk)
    try:
        if not bpy.app.tempdir.startswith(str(disk)):
            pytest.skip("this Blender keeps its temporary folder")
        fill(disk)
        with pytest.raises(OSError, match="temporary folder.*free some space there") as error:
            export(baked, tmp_path / "Arm.abc", "ALEMBIC")
        assert errors.is_transient(error.value) and names(tmp_path) == ["disk"]
    finally:
        (disk / "ballast").unlink(missing_ok=True)
        files.temporary_directory = before


def test_the_scene_of_the_window_is_exported(baked, tmp_path):
    """Not the first one of the file, and as it is now, not as it was saved."""
    scene = bpy.context.scene
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    bpy.data.scenes.new("A").frame_end = 3
    scene.name = "Z"
    baked.location.x += 2.0
    exact = round_trips.shown("Arm", range(1, 21))
    path = tmp_path / "Arm.abc"
    export(baked, path, "ALEMBIC")
    assert bpy.data.filepath == str(tmp_path / "shot.blend") and b"shot.blend" in path.read_bytes()
    found = round_trips.ALEMBIC(path, "Arm", range(1, 21))
    assert round_trips.farthest(found, exact) < 1e-5


@pytest.mark.parametrize("key", ["ALEMBIC", "USD"])
def test_files_that_the_scene_needs_are_found_from_the_copy(baked, tmp_path, key):
    """A point cache with a path relative to the .blend, and a character that is linked from another file."""
    points = mesh_data.rest_points(baked)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "asset.blend"))
    bake, cache = hand_made_bake(baked), tmp_path / "arm.pc2"
    io_disk.save(cache, point_cache.point_cache(bake, points))
    writer.write_keys(baked, keys.targets_alone(bake), cache=cache)
    assert baked.modifiers[0].filepath == "//arm.pc2"
    exact, path = round_trips.shown("Arm", range(1, 21)), tmp_path / path_of(key, tmp_path)
    export(baked, path, key)
    bpy.ops.wm.save_mainfile()
    load = getattr(bpy.ops.wm, {"ALEMBIC": "alembic_import", "USD": "usd_import"}[key])

    def found():
        round_trips.imported(load, path)
        return round_trips.shown("Arm", range(1, 21))

    assert round_trips.farthest(found(), exact) < 1e-5
    path.unlink()
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    with bpy.data.libraries.load(str(tmp_path / "asset.blend"), link=True, relative=True) as (_, wanted):
        wanted.objects = ["Arm", "Arm Rig"]
    for obj in wanted.objects:
        bpy.context.scene.collection.objects.link(obj)
    export(bpy.data.objects["Arm"], path, key)
    assert round_trips.farthest(found(), exact) < 1e-5


def test_scripts_of_the_file_do_not_run_in_the_child(baked, tmp_path):
    text = bpy.data.texts.new("script.py")
    text.from_string(f"open({str(tmp_path / 'ran')!r}, 'w')")
    text.use_module = True
    export(baked, tmp_path / "Arm.usdc", "USD")
    assert names(tmp_path) == ["Arm.usdc"] and text.use_module


@pytest.mark.parametrize("trusted", [False, True])
@pytest.mark.parametrize("preferred", [False, True])
def test_drivers_of_an_untrusted_file_do_not_run_in_the_child(baked, tmp_path, trusted, preferred):
    """Not even of an object that only renders show: Blender does not know then that it keeps one from running."""
    ran, saved = tmp_path / "ran", tmp_path / "shot.blend"
    files = bpy.context.preferences.filepaths
    hidden = bpy.data.objects.new("Hidden", baked.data.copy())
    bpy.context.scene.collection.objects.link(hidden)
    hidden.hide_viewport = True
    wrapped = bpy.data.objects.new("Wrapped", baked.data.copy())
    bpy.context.scene.collection.objects.link(wrapped)
    wrap = wrapped.modifiers.new("Shrinkwrap", "SHRINKWRAP")
    wrap.target, wrap.show_viewport = hidden, False
    wrapped.parent = baked.parent = bpy.data.objects["Arm Rig"]
    driver = hidden.driver_add("location", 0).driver
    driver.expression = f"float(bool(__import__('pathlib').Path({str(ran)!r}).touch()))"
    bpy.ops.wm.save_as_mainfile(filepath=str(saved))
    ran.unlink(missing_ok=True)
    before = files.use_scripts_auto_execute
    try:
        files.use_scripts_auto_execute = preferred
        bpy.ops.wm.open_mainfile(filepath=str(saved), use_scripts=trusted)
        ran.unlink(missing_ok=True)
        data = bpy.context.scene.animation_data
        export(bpy.data.objects["Arm"], tmp_path / "Arm.usdc", "USD")
    finally:
        files.use_scripts_auto_execute = before
    assert ran.exists() == trusted
    assert bpy.context.scene.animation_data == data and "dynamorph_probe" not in bpy.context.scene


def test_what_add_ons_say_as_the_child_starts_is_no_fault(baked, tmp_path, monkeypatch):
    child = tmp_path / "child.py"
    child.write_text(f"import sys; print('Failed writing', file=sys.stderr); sys.argv[0] = {str(process.CHILD)!r}\n"
                     f"import runpy; runpy.run_path({str(process.CHILD)!r}, run_name='__main__')")  # fmt: skip
    monkeypatch.setattr(process, "CHILD", child)
    export(baked, tmp_path / "Arm.usdc", "USD")
    assert names(tmp_path) == ["Arm.usdc", "child.py"]


@pytest.mark.parametrize("key", ["ALEMBIC", "USD"])
def test_positions_that_are_not_numbers_are_no_fault_of_the_disk(baked, tmp_path, key):
    other = bpy.data.objects.new("Cloth", baked.data.copy())
    other.shape_key_clear()
    bpy.context.scene.collection.objects.link(other)
    other.parent = baked.find_armature()
    other.modifiers.new("Armature", "ARMATURE").object = baked.find_armature()
    other.data.vertices[0].co.x = float("nan")
    with pytest.raises(errors.ExportError, match="positions that are not numbers") as error:
        export(baked, path_of(key, tmp_path), key)
    assert not errors.is_transient(error.value) and names(tmp_path) == []


@pytest.fixture
def textured(baked, tmp_path):
    """The arm with a picture on it."""
    image = bpy.data.images.new("skin", 8, 8)
    image.filepath_raw, image.file_format = str(tmp_path / "skin.png"), "PNG"
    image.save()
    material = bpy.data.materials.new("Skin")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    picture = nodes.new("ShaderNodeTexImage")
    picture.image = image
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    material.node_tree.links.new(picture.outputs["Color"], shader.inputs["Base Color"])
    baked.data.materials.append(material)
    return baked


def test_textures_come_along_with_usd_or_not_at_all(textured, tmp_path, monkeypatch):
    folder = tmp_path / "out"
    folder.mkdir()
    path = folder / "Arm.usdc"
    with monkeypatch.context() as patch:
        patch.setattr(process, "FAILED", "")  # every export seems to have failed
        with pytest.raises(errors.ExportError):
            export(textured, path, "USD")
    assert names(folder) == []
    export(textured, path, "USD")
    assert names(folder) == ["Arm.usdc", "textures"] and names(folder / "textures") == ["skin.png"]
    export(textured, path, "USD")
    picture, before = (folder / "textures" / "skin.png").read_bytes(), path.read_bytes()
    (folder / "textures" / "skin.png").write_bytes(EARLIER)  # of another character, or of before it was painted
    with pytest.raises(errors.ExportError, match="skin.png' is not the file of that name of 'Arm.usdc'"):
        export(textured, path, "USD")
    assert (folder / "textures" / "skin.png").read_bytes() == EARLIER and path.read_bytes() == before
    assert names(folder) == ["Arm.usdc", "textures"]
    (folder / "textures" / "skin.png").write_bytes(picture)
    round_trips.imported(bpy.ops.wm.usd_import, path, import_textures_mode="IMPORT_NONE")
    (image,) = (image for image in bpy.data.images if image.source == "FILE")
    assert bpy.path.abspath(image.filepath) == str(folder / "textures" / "skin.png")


def test_pictures_that_are_not_saved_are_named(textured):
    """They are in no copy of the scene."""
    image = bpy.data.images["skin"]
    assert list(losses.losses(textured, "USD")) == []
    image.pixels[0] = 1.0
    assert image.is_dirty
    (text,) = losses.losses(textured, "USD")
    assert text == "Image 'skin' has changes that are not saved: USD is written without them. Save the image first"
    assert list(losses.losses(textured, "ALEMBIC")) == []


def test_an_incomplete_file_is_recognized(baked, tmp_path):
    for key in ("GLTF", "FBX"):
        export(baked, path_of(key, tmp_path), key)
    files = [file for file in tmp_path.iterdir() if file.suffix in whole.CHECKS]
    assert len(files) == 2
    for file in files:
        content = file.read_bytes()
        assert whole.is_whole(file)
        lengths = {0, 1, 8, 12, 20, len(content) - 1, *np.random.default_rng(1).integers(0, len(content) - 40, 200)}
        for length in map(int, lengths):
            file.write_bytes(content[:length])
            assert not whole.is_whole(file), (file.suffix, length)


@pytest.mark.parametrize("compress", [False, True])
def test_a_blend_without_a_part_is_recognized(baked, tmp_path, compress):
    """As it is when one of Blender's writes has failed: when it compresses it goes on, otherwise it stops there."""
    path, damage = tmp_path / "shot.blend", blend_file.damage
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True, compress=compress)
    content = path.read_bytes()
    assert not damage(path)
    for first, last in np.sort(np.random.default_rng(1).integers(0, len(content) - 1000, (100, 2))).tolist():
        for kept in (content[:first], *([content[:first] + content[last + 1 :]] if compress else [])):
            path.write_bytes(kept)
            assert damage(path), (first, last)


# The command line: found before the work, and the right exit code ----------------------------------------------------


def bake(shot, *more):  # noqa: F811
    return "bake", shot, "--object", "Arm", *more


def outputs_in(folder):
    """Command lines whose results go to a folder, with the options that a result needs."""
    return {
        "--output": ["-o", folder / "baked.blend"],
        "--report": ["-o", folder.parent / "baked.blend", "--report", folder / "report.json"],
        "--cache-dir": ["-o", folder.parent / "baked.blend", "--cache-dir", folder / "cache"],
        "--output-file": ["--format", "usd", "--output-file", folder / "arm.usdc"],
        "point cache": ["--format", "pc2", "-o", folder.parent / "b.blend", "--output-file", folder / "arm.pc2"],
    }


OUTPUTS = ["--output", "--report", "--cache-dir", "--output-file", "point cache"]


@pytest.mark.fault("F11")
@pytest.mark.parametrize("option", OUTPUTS)
def test_a_read_only_folder_is_found_before_the_work(shot, run, stand_in, read_only, option):  # noqa: F811
    code, _, message = run(*bake(shot, *outputs_in(read_only)[option]))
    assert code == 2 and "Read-only file system. Choose a folder" in message and str(read_only) in message
    assert "Traceback" not in message and message.count("error:") == 1
    assert stand_in.built == 0 and names(read_only) == ["earlier"]


@pytest.mark.parametrize("option", OUTPUTS)
def test_a_full_disk_is_found_before_the_work(shot, run, stand_in, disk, option):  # noqa: F811
    fill(disk, room=0)
    code, _, message = run(*bake(shot, *outputs_in(disk)[option]))
    assert code == 75 and f"{FULL}. Free some space" in message and "try again" in message
    assert "Traceback" not in message and message.count("error:") == 1
    assert stand_in.built == 0 and set(names(disk)) <= {"cache"}


@pytest.mark.parametrize("option", OUTPUTS)
@pytest.mark.parametrize("name, words", [("a folder", "This is a folder"), ("n" * 300, "File name too long. Choose")])
def test_a_name_that_no_file_can_have_is_found_before_the_work(shot, run, stand_in, tmp_path, option, name, words):  # noqa: F811
    arguments = outputs_in(tmp_path)[option]
    last = arguments[-1].with_name(f"{name}{arguments[-1].suffix}")
    if name == "a folder" and option != "--cache-dir":
        last.mkdir()
    elif name == "a folder":
        last.write_bytes(EARLIER)
        words = "Part of this path is a file"
    code, _, message = run(*bake(shot, *arguments[:-1], last))
    assert code == 2 and words in message and "Traceback" not in message
    assert stand_in.built == 0


def test_outputs_of_other_commands_are_tried_too(shot, run, read_only, monkeypatch):  # noqa: F811
    words = "Read-only file system"
    monkeypatch.setattr(report_page, "read", None)
    for arguments in (
        ("report", shot, "--object", "Arm", "--json", read_only / "figures.json"),
        ("collect", shot.parent, "-o", read_only / "page.html"),
        ("check", shot, "--object", "Arm", "--report", read_only / "report.json"),
        ("delete-bake", shot, "--object", "Arm", "-o", read_only / "freed.blend"),
    ):
        code, _, message = run(*arguments)
        assert code == 2 and words in message and "Traceback" not in message, arguments


def test_a_protected_file_is_not_replaced(shot, run, stand_in, tmp_path):  # noqa: F811
    """Its folder can be written to, but not the file itself."""
    output = tmp_path / "baked.blend"
    output.write_bytes(EARLIER)
    mounted(("--bind",), output, str(output))
    try:
        subprocess.run(["mount", "-o", "remount,ro,bind", str(output)], check=True)
        code, _, message = run(*bake(shot, "-o", output))
        assert code == 2 and "Read-only" in message and stand_in.built == 0
    finally:
        subprocess.run(["umount", "--lazy", str(output)], check=True)
    assert output.read_bytes() == EARLIER


@pytest.mark.parametrize("key", ["alembic", "usd"])
def test_a_read_only_temporary_folder_is_found_before_the_work(shot, run, stand_in, key):  # noqa: F811
    """These are written from a copy of the scene that is put there."""
    folder = bpy.app.tempdir
    mounted(("--bind",), folder, folder)
    try:
        subprocess.run(["mount", "-o", "remount,ro,bind", folder], check=True)
        code, _, message = run(*bake(shot, "--format", key))
        assert code == 2 and folder in message and "Read-only file system" in message and "Traceback" not in message
        assert stand_in.built == 0 and names(shot.parent) == [shot.name]
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)


def test_the_export_on_a_full_disk_is_reported_before_the_work(shot, run, stand_in, disk):  # noqa: F811
    fill(disk)
    code, _, message = run(*bake(shot, "--format", "alembic", "--output-file", disk / "arm.abc"))
    assert code == 75 and re.search(rf"arm.abc': {FULL}, about 0.1 MB are needed.*try again", message)
    assert stand_in.built == 0 and names(disk) == []


def test_point_caches_that_do_not_fit_are_reported_before_the_work(shot, run, stand_in, disk):  # noqa: F811
    fill(disk)
    more = ("--format", "pc2", "--output-file", disk / "arm.pc2", "-o", shot.parent / "baked.blend")
    code, _, message = run(*bake(shot, *more))
    assert code == 75 and re.search(rf"{FULL}, about 0.1 MB are needed", message)
    assert stand_in.built == 0 and names(disk) == []


@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize("where", ["--in-place", "-o"])
def test_a_blend_on_a_full_disk(shot, run, stand_in, disk, where, compress):  # noqa: F811
    """Blender 4.5 and 5.2 replace the file by a part of it and report success, when they compress."""
    files = bpy.context.preferences.filepaths
    before, files.use_file_compression = files.use_file_compression, compress
    try:
        bpy.ops.wm.save_as_mainfile(filepath=str(disk / "shot.blend"), compress=True)
        earlier = (disk / "shot.blend").read_bytes()
        fill(disk, room=30)
        output = disk / "baked.blend"
        source, target = (disk / "shot.blend", [where]) if where == "--in-place" else (shot, [where, output])
        report = shot.parent / "report.json"
        code, _, message = run(*bake(source, *target, "--report", report))
    finally:
        files.use_file_compression = before
    assert code == 75 and f"{FULL}. Free some space" in message and "No such file" not in message
    assert (disk / "shot.blend").read_bytes() == earlier and names(disk) == ["shot.blend"]
    assert FULL in json.loads(report.read_text())["error"]


def test_earlier_versions_of_a_blend_are_kept(shot, run, stand_in):  # noqa: F811
    files = bpy.context.preferences.filepaths
    before, files.save_version = files.save_version, 2
    try:
        contents = [shot.read_bytes()]
        for _ in range(3):
            os.utime(shot, (1e9, 1e9))  # no old file is one that a process has left
            assert run("build", shot, "--object", "Arm", "--in-place")[0] == 0
            contents.append(shot.read_bytes())
        assert files.save_version == 2
    finally:
        files.save_version = before
    assert names(shot.parent) == [shot.name, f"{shot.name}1", f"{shot.name}2"]
    assert [shot.with_name(f"{shot.name}{number}").read_bytes() for number in ("", 1, 2)] == contents[:0:-1]


@pytest.mark.parametrize("replaced", [False, True])
def test_what_a_killed_process_left_is_an_earlier_version_at_the_next_start(shot, run, stand_in, replaced):  # noqa: F811
    """It was killed before it had replaced the file, or after that."""
    left = shot.with_name(f"{shot.stem}.{'0123456789abcdef'}.earlier.blend")
    if replaced:
        left.write_bytes(b"the version before")
    else:
        os.link(shot, left)
    run("build", shot, "--object", "Nobody", "--in-place")  # which ends before it saves
    assert not left.exists()
    assert shot.with_name(f"{shot.name}1").exists() == replaced
    if replaced:
        assert shot.with_name(f"{shot.name}1").read_bytes() == b"the version before"


def test_a_save_that_fails_leaves_the_earlier_versions(soft_arm, tmp_path, monkeypatch):
    path, files, disk = tmp_path / "shot.blend", bpy.context.preferences.filepaths, io_disk
    before, files.save_version = files.save_version, 2
    try:
        for _ in range(3):
            blend_file.save(path)
        contents = {name: (tmp_path / name).read_bytes() for name in names(tmp_path)}
        assert list(contents) == ["shot.blend", "shot.blend1", "shot.blend2"]
        replace_file = disk.replace

        def refuse(new, target):
            if target == path:
                raise OSError(errno.ESTALE, os.strerror(errno.ESTALE), str(target))
            replace_file(new, target)

        monkeypatch.setattr(disk, "replace", refuse)
        with pytest.raises(OSError, match=os.strerror(errno.ESTALE)):
            blend_file.save(path)
    finally:
        files.save_version = before
    assert {name: (tmp_path / name).read_bytes() for name in names(tmp_path)} == contents


@pytest.mark.parametrize("held", ["shot.blend1", "shot.blend2"])
def test_no_version_is_lost_when_another_program_holds_one(soft_arm, tmp_path, monkeypatch, held):
    path, files, disk = tmp_path / "shot.blend", bpy.context.preferences.filepaths, io_disk
    before, files.save_version = files.save_version, 2
    try:
        for _ in range(3):
            blend_file.save(path)
        replace_file, contents = disk.replace, [(tmp_path / name).read_bytes() for name in names(tmp_path)]

        def refuse(new, target):
            if held in (new.name, target.name):
                raise io_disk.in_use(target)
            replace_file(new, target)

        monkeypatch.setattr(disk, "replace", refuse)
        soft_arm.location.x = 7
        blend_file.save(path)
    finally:
        files.save_version = before
    assert [(tmp_path / f"shot.blend{n}").read_bytes() for n in (3, 1, 2)] == contents
    with bpy.data.libraries.load(str(path)) as (found, _):
        assert "Arm" in found.objects
    assert len(names(tmp_path)) == 4


@pytest.mark.parametrize("compress", [False, True])
def test_a_saved_file_is_compressed_as_it_was(soft_arm, tmp_path, compress):
    """With the list of frames by which Blender finds its way."""
    path = tmp_path / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=compress)
    theirs = path.read_bytes()
    blend_file.save(path)
    ours = path.read_bytes()
    assert names(tmp_path) == ["shot.blend", "shot.blend1"]
    assert (ours[:4] == theirs[:4]) and abs(len(ours) - len(theirs)) < 0.1 * len(theirs)
    if compress:
        zstandard = pytest.importorskip("zstandard")
        count, _, mark = struct.unpack("<IBI", ours[-9:])
        frames = struct.unpack(f"<{2 * count}I", ours[-9 - 8 * count : -9])
        assert mark == struct.unpack("<IBI", theirs[-9:])[2] and sum(frames[::2]) + 8 * count + 17 == len(ours)
        with zstandard.ZstdDecompressor().stream_reader(ours, read_across_frames=True) as content:
            assert len(content.read()) == sum(frames[1::2])
    bpy.ops.wm.open_mainfile(filepath=str(path))
    assert len(bpy.data.objects["Arm"].dynamorph.targets) == 2
    bpy.ops.wm.save_mainfile()  # as the artist does next
    assert path.read_bytes()[:4] == theirs[:4]


# Messages ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ENOSPC", "EIO", "ESTALE", "EDQUOT", "EINTR", "EAGAIN", "ETIMEDOUT", "EBUSY"])
def test_faults_that_may_pass(shot, run, stand_in, name):  # noqa: F811
    number = getattr(errno, name)
    stand_in.fail = OSError(number, os.strerror(number), "/share/model")
    code, _, message = run(*bake(shot, "--in-place"))
    assert (
        code == 75
        and f"error: '/share/model': {os.strerror(number)}. " in message
        and message.endswith(": try again\n")
    )


@pytest.mark.parametrize("name", ["EROFS", "ENOENT", "EACCES", "EPERM", "ENAMETOOLONG", "EISDIR", "ENOTDIR"])
def test_faults_that_stay(shot, run, stand_in, name):  # noqa: F811
    number = getattr(errno, name)
    stand_in.fail = OSError(number, os.strerror(number), "/share/model")
    code, _, message = run(*bake(shot, "--in-place"))
    assert code == 2 and f"error: '/share/model': {os.strerror(number)}. " in message and "again" not in message


def test_a_model_file_names_itself_when_the_disk_is_full(addon, disk):
    path = disk / "model.dynamorph"
    path.write_bytes(EARLIER)
    fill(disk)
    with pytest.raises(OSError, match=FULL) as error:
        io_disk.save(path, bytes(100_000))
    assert error.value.filename == str(path) and path.read_bytes() == EARLIER and names(disk) == [path.name]


def test_a_folder_that_is_missing_is_neither_made_nor_removed(addon, tmp_path):
    """Another process may begin to write there at this moment."""
    outputs.try_folder(tmp_path / "caches" / "one")
    assert names(tmp_path) == []
    (tmp_path / "caches").mkdir()
    outputs.try_folder(tmp_path / "caches")
    assert names(tmp_path) == ["caches"] and names(tmp_path / "caches") == []
    (tmp_path / "dynamorph").mkdir()  # where the wheels may be installed
    outputs.try_folder(tmp_path / "models")


@pytest.mark.parametrize("name", ["out", "shot.blend1"])
def test_a_blend_of_another_name(shot, run, stand_in, tmp_path, name):  # noqa: F811
    output = shot.rename(tmp_path / name)
    assert run("build", output, "--object", "Arm", "--in-place")[0] == 0
    bpy.ops.wm.open_mainfile(filepath=str(output))
    assert "Arm" in bpy.data.objects


def test_a_temporary_folder_that_all_share_is_not_emptied(tmp_path):
    """Blender takes it where it cannot make one of its own."""
    shared = tmp_path / "shared"
    shared.mkdir()
    mounted(("-t", "tmpfs"), shared, "-o", "nr_inodes=3", "tmpfs")
    try:
        (shared / "show").mkdir()
        (shared / "show" / "take").write_bytes(EARLIER)
        command = [sys.executable, "-m", "dynamic_morph_targets", "info", "nowhere.blend"]
        done = subprocess.run(command, env=environment() | {"TMPDIR": str(shared)}, capture_output=True, check=False)
        assert done.returncode == 2 and (shared / "show" / "take").read_bytes() == EARLIER
    finally:
        subprocess.run(["umount", "--lazy", str(shared)], check=True)
