# SPDX-License-Identifier: GPL-3.0-or-later
"""Files are written whole or not at all, also where Windows locks them. Windows is faked."""

import errno
import os
import time
from pathlib import Path

import pytest
from dynamic_morph_targets.core.errors import FileInUseError, WriteError
from dynamic_morph_targets.io import disk, outputs

SHARING_VIOLATION = 32


@pytest.mark.fault("C06", "F12")
def test_save_replaces_whole_files_only(tmp_path, monkeypatch):
    path = tmp_path / "models" / "ü model.dynamorph"
    disk.save(path, b"old")
    monkeypatch.setattr(disk.os, "fsync", lambda _handle: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError):
        disk.save(path, b"new")
    assert path.read_bytes() == b"old"
    monkeypatch.undo()
    disk.save(path, b"new")
    assert path.read_bytes() == b"new"
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_a_file_has_the_rights_of_any_other(tmp_path):
    """Whoever shares the folder may read it."""
    (tmp_path / "other").touch()
    disk.save(tmp_path / "model", [b"a", b"b"])
    assert (tmp_path / "model").stat().st_mode == (tmp_path / "other").stat().st_mode
    assert (tmp_path / "model").read_bytes() == b"ab" and len(list(tmp_path.iterdir())) == 2


@pytest.mark.fault("C05")
def test_what_a_killed_process_left_is_cleared(tmp_path):
    """An hour later: until then somebody may be writing it."""
    names = (f"model.{'1' * 16}.part", f"model.{'2' * 16}.part", f"other.{'1' * 16}.part", "model.old.part")
    for name in names:
        (tmp_path / name).touch()
    for name in (names[0], *names[2:]):
        os.utime(tmp_path / name, (0, 0))
    disk.save(tmp_path / "model", b"a")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["model", *names[1:]])


def test_another_user_s_file_in_a_folder_like_tmp_is_refused_before_the_work(tmp_path, monkeypatch):
    """Only its owner may replace it there."""
    path = tmp_path / "a.glb"
    path.touch()
    tmp_path.chmod(0o1777)
    outputs.try_file(path)
    monkeypatch.setattr(os, "geteuid", lambda: path.stat().st_uid + 1)
    with pytest.raises(OSError, match="a.glb") as error:
        outputs.try_file(path)
    assert error.value.errno == errno.EPERM
    outputs.try_file(tmp_path / "b.glb")
    tmp_path.chmod(0o777)
    outputs.try_file(path)


# Windows -------------------------------------------------------------------------------------------------------------


@pytest.fixture
def refuse(monkeypatch):
    """refuse(name, code, times): a method of Path fails as often as that, as it does on Windows; returns its calls."""

    def refuse(name, code, times):
        really, calls = getattr(Path, name), []

        def refused(path, *arguments, **options):
            calls.append(path)
            if len(calls) > times:
                return really(path, *arguments, **options)
            error = PermissionError(13, "in use", str(path))
            if code:
                error.winerror = code
            raise error

        monkeypatch.setattr(Path, name, refused)
        return calls

    return refuse


@pytest.mark.parametrize("code", [5, SHARING_VIOLATION, 33])
def test_a_file_that_is_in_use_for_a_moment_is_replaced(tmp_path, refuse, code):
    path = tmp_path / "model"
    disk.save(path, b"old")
    calls = refuse("replace", code, times=3)
    disk.save(path, b"new")
    assert path.read_bytes() == b"new" and len(calls) == 4
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_stays_in_use_is_named_with_the_remedy(tmp_path, refuse):
    path = tmp_path / "model"
    disk.save(path, b"old")
    refuse("replace", SHARING_VIOLATION, times=1000)
    began = time.monotonic()
    with pytest.raises(
        FileInUseError, match="model' cannot be replaced: another program.*Close it.*try again"
    ) as raised:
        disk.save(path, b"new")
    assert 0.5 < time.monotonic() - began < 5.0
    assert isinstance(raised.value, OSError)  # worth another try, to a render farm
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]


def test_a_folder_without_the_right_to_write_is_not_waited_for(tmp_path, refuse):
    calls = refuse("replace", None, times=1000)
    with pytest.raises(PermissionError, match="in use"):
        disk.save(tmp_path / "model", b"new")
    assert len(calls) == 1


def test_a_part_that_cannot_be_deleted_does_not_hide_why_it_is_one(tmp_path, refuse, monkeypatch):
    refuse("unlink", SHARING_VIOLATION, times=1)
    monkeypatch.setattr(disk.os, "fsync", lambda _handle: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        disk.save(tmp_path / "model", b"new")


def test_discard_leaves_what_is_in_use(tmp_path, refuse):
    path = tmp_path / "unfinished"
    path.touch()
    refuse("unlink", SHARING_VIOLATION, times=1)
    disk.discard(path)
    assert path.exists()
    disk.discard(path)
    assert not path.exists()
    disk.discard(path)


@pytest.mark.fault("F08")
def test_a_path_too_long_for_windows_is_named(tmp_path, monkeypatch):
    folder = tmp_path / ("deep" * 30) / ("deeper" * 20)

    def refused(path, *_arguments):
        raise FileNotFoundError(2, "The system cannot find the path specified", str(path))

    monkeypatch.setattr(Path, "open", refused)
    with pytest.raises(WriteError, match="model' is too long: choose a folder"):
        disk.save(folder / "model", b"new")
    with pytest.raises(FileNotFoundError):
        disk.save(tmp_path / "model", b"new")
