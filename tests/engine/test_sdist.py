# SPDX-License-Identifier: GPL-3.0-or-later
"""What the sdist holds, and what building from it says where something is missing. It is not compiled here."""

import hashlib
import subprocess
import sys
import tarfile
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MAKE = "from scikit_build_core.build import build_sdist; import sys; build_sdist(sys.argv[1])"
PIN = "tetgen==1.2.3 --hash=sha256:" + hashlib.sha256(b"as pinned").hexdigest()


def cmake(*arguments: str | Path) -> subprocess.CompletedProcess:
    tool = Path(sys.executable).with_name("cmake")
    if not tool.exists():
        pytest.skip("cmake is not installed beside this Python")
    return subprocess.run([tool, *arguments], capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory) -> Path:
    """The folder of an unpacked sdist."""
    pytest.importorskip("scikit_build_core")
    folder = tmp_path_factory.mktemp("sdist")
    run = subprocess.run([sys.executable, "-c", MAKE, folder], cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    (archive,) = folder.glob("dynamorph-*.tar.gz")
    assert archive.stat().st_size < 1.5e6
    with tarfile.open(archive) as files:
        files.extraction_filter = getattr(tarfile, "data_filter", None)  # Debian 12's Python 3.11.2 has none
        files.extractall(folder)
    return folder / archive.name.removesuffix(".tar.gz")


def test_sdist_holds_what_builds_the_engine_and_nothing_else(unpacked):
    tracked = subprocess.run(["git", "ls-files", "cpp"], cwd=ROOT, capture_output=True, text=True, check=False)
    if tracked.returncode:
        pytest.skip("needs a git checkout")
    found = {path.relative_to(unpacked).as_posix() for path in unpacked.rglob("*") if path.is_file()}
    (tetgen,) = {name for name in found if name.startswith("build/")}
    assert Path(tetgen).parent == Path("build/tetgen")
    assert found - {tetgen} == {
        *tracked.stdout.split(),
        *("pyproject.toml", "CMakeLists.txt", "PKG-INFO", "tools/tetgen.txt"),
        *("README.md", "CHANGELOG.md", "LICENSE", "LICENSES.md"),
    }


def test_metadata_names_the_license_files(unpacked):
    lines = (unpacked / "PKG-INFO").read_text().splitlines()
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert {f"Version: {version}", "License-File: LICENSE", "License-File: LICENSES.md"} <= set(lines)
    assert "License-Expression: GPL-3.0-or-later" in lines


def test_unpacked_sdist_configures_without_a_network(unpacked, tmp_path):
    """With a pip that fails: TetGen's sources came along."""
    settings = ["-DDYNAMORPH_PYTHON=OFF", f"-DDYNAMORPH_PYTHONS={fake_pip(tmp_path, 'exit 1')}"]
    run = cmake("-S", unpacked, "-B", tmp_path / "build", *settings)
    assert run.returncode == 0, run.stderr
    assert list((unpacked / "build/tetgen").glob("tetgen-*/src/tetgen.cxx"))


def test_missing_headers_are_named_as_debian_packages(unpacked, tmp_path):
    """All in one message, before anything is fetched or compiled."""
    hide = [f"-DCMAKE_IGNORE_PREFIX_PATH={prefix}" for prefix in ["/usr;/usr/local"]]
    run = cmake("-S", unpacked, "-B", tmp_path, "-DDYNAMORPH_PYTHON=OFF", *hide)
    assert run.returncode != 0
    message = " ".join(run.stderr.split())
    assert "apt-get install libeigen3-dev libspectra-dev libcgal-dev nlohmann-json3-dev." in message
    assert message.count("CMake Error") == 1


# TetGen's sources, where they did not come along ----------------------------------------------------------------------


def fake_pip(folder: Path, script: str) -> Path:
    """In the place of a Python: `python -m pip download ... -d FOLDER` runs `script` with the folder as $folder."""
    python = folder / "python"
    python.write_text(f'#!/bin/bash\nfolder="${{@: -1}}"\nmkdir -p "$folder"\n{script}\n')
    python.chmod(0o755)
    return python


def fetch(project: Path, script: str) -> subprocess.CompletedProcess:
    (project / "tools").mkdir()
    (project / "tools/tetgen.txt").write_text(f"# A comment.\n{PIN}\n")
    settings = (f"-DPROJECT_SOURCE_DIR={project}", f"-Dpython={fake_pip(project, script)}")
    return cmake(*settings, "-P", ROOT / "cpp/cmake/tetgen.cmake")


def test_offline_the_message_says_what_to_put_where(tmp_path):
    run = fetch(tmp_path, "exit 1")
    message = " ".join(run.stderr.split())
    assert run.returncode != 0
    assert "take tetgen-1.2.3.tar.gz from https://pypi.org/project/tetgen/1.2.3/#files" in message
    assert f"to {tmp_path}/build/tetgen" in message
    assert hashlib.sha256(b"as pinned").hexdigest() in message


def test_another_file_than_the_pinned_one_is_refused(tmp_path):
    run = fetch(tmp_path, 'printf "something else" >"$folder/tetgen-1.2.3.tar.gz"')
    assert run.returncode != 0
    assert "is not the file pinned in tools/tetgen.txt" in " ".join(run.stderr.split())
