# SPDX-License-Identifier: GPL-3.0-or-later
"""What artists install: the zips of `make extension` and the folder of `make repository`, packed from a copy of the
sources, and used in an empty Blender that finds nothing else of ours."""

import functools
import http.server
import json
import os
import re
import shutil
import subprocess
import sys
import threading
import tomllib
import zipfile
from pathlib import Path

import pytest
import wheels

ROOT = Path(__file__).parents[3]
SAMPLE = ROOT / "sample_blends" / "bulging_cylinder.blend"
SOURCES = (
    "addon",
    "cpp/bindings/dynamorph",
    "tools",
    "CHANGELOG.md",
    "CMakeLists.txt",
    "LICENSE",
    "LICENSES.md",
    "pyproject.toml",
)
VERSIONED = (
    "addon/dynamic_morph_targets/blender_manifest.toml", "addon/pyproject.toml", "pyproject.toml", "CHANGELOG.md"
)  # fmt: skip
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
NEXT = re.sub(r"\d+$", lambda patch: str(int(patch[0]) + 1), VERSION)
TAGS = {name: platform.tag for name, platform in wheels.PLATFORMS.items()}

# Packing -------------------------------------------------------------------------------------------------------------


def make_project(folder, version=VERSION):
    """A copy of what packing needs, where it writes into a dist/ of its own."""
    for name in SOURCES:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy2
        copy(ROOT / name, folder / name)
    for name in VERSIONED:
        raise_version(folder / name, version)
    (folder / ".venv").symlink_to(ROOT / ".venv")
    (folder / "build").mkdir()
    (folder / "build/cmake").symlink_to(ROOT / "build/cmake")
    (folder / "dist/wheels").mkdir(parents=True)
    return folder


def raise_version(path, version):
    text = path.read_text()
    for before in ('\nversion = "', "dynamorph==", "\n## "):
        text = text.replace(before + VERSION, before + version)
    path.write_text(text)


def package(project, *arguments):
    """Runs the packaging script of a project, which must succeed."""
    run = run_package(project, *arguments)
    assert run.returncode == 0, run.stdout + run.stderr
    return run.stdout


def run_package(project, *arguments):
    command = [sys.executable, project / "tools" / "package.py", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def remake(wheel, folder, old, new):
    """The wheel with another version or platform in its name and its metadata. Returns its path."""
    made = folder / wheel.name.replace(old, new)
    with zipfile.ZipFile(wheel) as source, zipfile.ZipFile(made, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if ".dist-info/" in name:
                content = content.replace(old.encode(), new.encode())
            target.writestr(name.replace(old, new), content)
    return made


def manifest_of(archive):
    with zipfile.ZipFile(archive) as files:
        return tomllib.loads(files.read("blender_manifest.toml").decode())


def wheels_in(archive):
    with zipfile.ZipFile(archive) as files:
        return {Path(name).name for name in files.namelist() if name.endswith(".whl")}


@pytest.fixture(scope="module")
def native(tmp_path_factory):
    """A project with the zip for this machine, and what it was made of in build/native_wheels."""
    project = make_project(tmp_path_factory.mktemp("native"))
    package(project, "extension", "native")
    return project


@pytest.fixture(scope="module")
def archive(native):
    (found,) = native.glob("dist/*.zip")
    return found


@pytest.fixture(scope="module")
def platform(archive):
    """Blender's name of this machine's platform."""
    (name,) = manifest_of(archive)["platforms"]
    return name


@pytest.fixture
def built(native):
    """The engine's wheels for this machine, one for each Python."""
    return sorted(native.glob("build/native_wheels/*.whl"))


def tag_of(wheel):
    return wheel.stem.split("-")[-1]


@pytest.fixture(scope="module")
def everywhere(native, tmp_path_factory):
    """A project with wheels for every platform, which are all this machine's but for their names and metadata."""
    project = make_project(tmp_path_factory.mktemp("everywhere"))
    for wheel in native.glob("build/native_wheels/*.whl"):
        for tag in TAGS.values():
            remake(wheel, project / "dist/wheels", tag_of(wheel), tag)
    return project


def test_zip_holds_the_add_on_and_a_wheel_for_this_python(archive):
    with zipfile.ZipFile(archive) as files:
        names = files.namelist()
    assert {"blender_manifest.toml", "__init__.py", "LICENSE", "LICENSES.md"} <= set(names)
    assert {"translations/de.json", "translations/fr.json"} <= set(names)
    tag = f"cp{sys.version_info.major}{sys.version_info.minor}"
    assert any(name.startswith("wheels/dynamorph-") and tag in name for name in names)
    assert not [name for name in names if "__pycache__" in name or name.endswith((".o", ".a"))]


def test_there_is_a_zip_for_each_platform_and_one_for_all(everywhere):
    (everywhere / "dist/wheels" / f"dynamic_morph_targets-{VERSION}-py3-none-any.whl").touch()  # is not packed
    table = package(everywhere, "extension")
    found = {path.name for path in everywhere.glob("dist/*.zip")}
    split = {name: f"dynamic_morph_targets-{VERSION}-{name.replace('-', '_')}.zip" for name in TAGS}
    whole = f"dynamic_morph_targets-{VERSION}.zip"
    assert found == {whole, *split.values()}
    assert [Path(line.split()[0]).name for line in table.splitlines()] == [*map(split.get, sorted(split)), whole]
    packed = {path.name for path in everywhere.glob("dist/wheels/dynamorph-*.whl")}
    assert wheels_in(everywhere / "dist" / whole) == packed
    assert manifest_of(everywhere / "dist" / whole)["platforms"] == sorted(TAGS)
    for name, tag in TAGS.items():
        archive = everywhere / "dist" / split[name]
        assert wheels_in(archive) == {wheel for wheel in packed if tag in wheel}
        generated = manifest_of(archive)["build"]["generated"]
        assert generated["platforms"] == [name]
        assert {Path(wheel).name for wheel in generated["wheels"]} == wheels_in(archive)


@pytest.fixture(scope="module")
def repository(everywhere):
    """The folder that a server offers, for every platform."""
    folder = everywhere / "dist/repository"
    folder.mkdir()
    (folder / "dynamic_morph_targets-0.0.0-linux_x64.zip").touch()  # from another time
    package(everywhere, "repository")
    return folder


def test_repository_holds_one_zip_for_each_platform_and_its_index(repository):
    index = json.loads((repository / "index.json").read_text())
    archives = {entry["archive_url"].removeprefix("./"): entry for entry in index["data"]}
    assert {path.name for path in repository.iterdir()} == {"index.json", "index.html", *archives}
    assert sorted(entry["platforms"] for entry in index["data"]) == [[name] for name in sorted(TAGS)]
    assert {entry["version"] for entry in index["data"]} == {VERSION}
    for name, entry in archives.items():
        assert entry["archive_size"] == (repository / name).stat().st_size
        assert manifest_of(repository / name)["build"]["generated"]["platforms"] == entry["platforms"]


def test_a_repository_of_some_platforms(everywhere, repository, tmp_path):
    kept = tmp_path / "repository"
    repository.rename(kept)
    table = package(everywhere, "repository", "windows-x64", "linux-arm64")
    packed = [Path(line.split()[0]).name for line in table.splitlines()]
    assert packed == [f"dynamic_morph_targets-{VERSION}-{name}.zip" for name in ("linux_arm64", "windows_x64")]
    shutil.rmtree(repository)
    kept.rename(repository)
    assert "unknown platforms: beos" in run_package(everywhere, "repository", "beos").stderr


def refusal(project):
    run = run_package(project, "repository")
    assert run.returncode != 0 and not run.stdout and not (project / "dist/repository").exists()
    return run.stderr


def test_without_wheels_it_says_what_makes_them(tmp_path):
    assert "Run `make wheels` first" in refusal(make_project(tmp_path))


def test_wheels_of_another_version_are_refused(tmp_path, built):
    project = make_project(tmp_path)
    shutil.copy2(built[0], project / "dist/wheels")
    old = remake(built[0], project / "dist/wheels", VERSION, "0.0.0")
    message = refusal(project)
    assert (
        f"This is version {VERSION}" in message
        and f"dist/wheels/{old.name}" in message
        and built[0].name not in message
    )


def test_two_wheels_for_one_platform_are_refused(tmp_path, built, platform):
    project = make_project(tmp_path)
    shutil.copy2(built[0], project / "dist/wheels")
    other = remake(built[0], project / "dist/wheels", tag_of(built[0]), TAGS[platform])
    message = refusal(project)
    assert "Delete one of them" in message and all(
        f"dist/wheels/{wheel.name}" in message for wheel in (built[0], other)
    )


def test_wheels_for_no_platform_of_blender_are_refused(tmp_path, built):
    project = make_project(tmp_path)
    remake(built[0], project / "dist/wheels", tag_of(built[0]), "freebsd_14_0_amd64")
    assert "freebsd_14_0_amd64.whl is for none of Blender's platforms" in refusal(project)


@pytest.mark.parametrize("name", VERSIONED)
def test_versions_rise_together(tmp_path, built, name):
    project = make_project(tmp_path)
    shutil.copy2(built[0], project / "dist/wheels")
    raise_version(project / name, NEXT)
    message = refusal(project)
    assert "not of one version" in message and f"{name}: {NEXT}" in message


# Installing ----------------------------------------------------------------------------------------------------------

BLENDER = """
import atexit, os, sys
from pathlib import Path
atexit.register(os._exit, 0)  # the extension that bpy 4.5 refers to is gone by then: it may wait forever
folder, *arguments = sys.argv[1:]
os.environ["BLENDER_USER_RESOURCES"] = folder
ours = ("dynamorph", "dynamic_morph_targets")
sys.path = [path for path in sys.path if not any(Path(path, name).is_dir() for name in ours)]
import bpy

def bake(sample):
    import dynamorph
    assert dynamorph.__file__.startswith(folder), dynamorph.__file__
    bpy.ops.wm.open_mainfile(filepath=sample)
    limb = bpy.data.objects["Limb"]
    bpy.context.view_layer.objects.active = limb
    limb.dynamorph.simulation.use_scene_range = False
    limb.dynamorph.simulation.frame_end = 5
    assert bpy.ops.dynamorph.bake() == {"FINISHED"}
    modes = [key.name for key in limb.data.shape_keys.key_blocks if key.name.startswith("Dynamorph Mode")]
    assert len(modes) == limb.dynamorph.model.modes, modes
    print("baked with", os.path.relpath(dynamorph.__file__, folder))

def add_repository(url):
    preferences = bpy.context.preferences
    preferences.system.use_online_access = True
    repos = preferences.extensions.repos
    while repos:  # Blender's own are on the internet
        repos.remove(repos[0])
    repos.new(name="Served", module="served", remote_url=url)
    sync()

def sync():
    assert bpy.ops.extensions.repo_sync(repo_index=0) == {"FINISHED"}

def install():
    bpy.ops.extensions.package_install(repo_index=0, pkg_id="dynamic_morph_targets", enable_on_install=True)

def installed():
    "The versions of the extension and of the wheel."
    import tomllib
    from importlib.metadata import version
    manifest = Path(folder, "extensions/served/dynamic_morph_targets/blender_manifest.toml")
    return tomllib.loads(manifest.read_text())["version"], version("dynamorph")

def left():
    return [path for path in Path(folder).rglob("*") if path.name.startswith(("dynamorph", "dynamic_morph"))]
"""


def in_blender(script, folder, *arguments):
    """What a script prints in a Blender whose preferences and extensions are in `folder`."""
    run = subprocess.run(
        [sys.executable, "-u", "-c", f"{BLENDER}{script}print('done')", folder, *arguments],
        env=os.environ | {"no_proxy": "127.0.0.1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.stdout.endswith("done\n"), run.stdout + run.stderr
    return run.stdout


INSTALL_FROM_DISK = """
archive, sample = arguments
bpy.ops.extensions.package_install_files(filepath=archive, repo="user_default", enable_on_install=True)
bake(sample)
bpy.ops.preferences.addon_disable(module="bl_ext.user_default.dynamic_morph_targets")
"""


def test_installs_from_disk_and_bakes_with_the_bundled_engine(archive, tmp_path):
    assert "baked with" in in_blender(INSTALL_FROM_DISK, tmp_path, archive, SAMPLE)


@pytest.fixture
def served(tmp_path):
    """A folder that is a link, to what is served; and its index's URL."""

    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    folder = tmp_path / "served"
    handler = functools.partial(Handler, directory=folder)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever).start()
        yield folder, f"http://127.0.0.1:{server.server_port}/index.json"
        server.shutdown()


INSTALL_AND_UPDATE = """
url, sample, served, newer, old_version, new_version = arguments
add_repository(url)
install()
assert installed() == (old_version, old_version), installed()
bake(sample)

import dynamorph
written = Path(dynamorph.__file__).stat().st_mtime_ns
assert bpy.ops.extensions.package_upgrade_all() == {"CANCELLED"}  # there is nothing to update
os.remove(served)
os.symlink(newer, served)
sync()
assert bpy.ops.extensions.package_upgrade_all() == {"FINISHED"}
assert installed() == (new_version, new_version), installed()
assert Path(dynamorph.__file__).stat().st_mtime_ns > written
try:
    bake(sample)
except RuntimeError as error:
    assert "restart Blender" in str(error), error
else:
    raise AssertionError("baked with the engine that was replaced")
bpy.ops.wm.save_userpref()
"""

BAKE_AND_UNINSTALL = """
sample, new_version = arguments
bpy.ops.wm.read_userpref()  # which Blender does as it starts, and the bpy wheel does not
assert installed() == (new_version, new_version), installed()
bake(sample)
bpy.ops.extensions.package_uninstall(repo_index=0, pkg_id="dynamic_morph_targets")
assert "bl_ext.served.dynamic_morph_targets" not in bpy.context.preferences.addons
assert not left(), left()
"""


@pytest.mark.fault("V02")
def test_installs_updates_and_uninstalls_from_a_repository(repository, built, served, tmp_path):
    folder, url = served
    folder.symlink_to(repository)
    newer = make_project(tmp_path / "newer", NEXT)
    for wheel in built:
        remake(wheel, newer / "dist/wheels", VERSION, NEXT)
    package(newer, "repository")
    user = tmp_path / "user"
    in_blender(INSTALL_AND_UPDATE, user, url, SAMPLE, folder, newer / "dist/repository", VERSION, NEXT)
    assert "baked with" in in_blender(BAKE_AND_UNINSTALL, user, SAMPLE, NEXT)


REFUSED = """
archive, url = arguments
bpy.ops.extensions.package_install_files(filepath=archive, repo="user_default", enable_on_install=True)
add_repository(url)
install()
assert not left(), left()
"""


def test_zip_for_another_platform_is_refused(built, platform, served, tmp_path):
    folder, url = served
    project = make_project(tmp_path / "other")
    other = "windows-x64" if platform != "windows-x64" else "linux-x64"
    for wheel in built:
        remake(wheel, project / "dist/wheels", tag_of(wheel), TAGS[other])
    package(project, "repository")
    (archive,) = project.glob("dist/repository/*.zip")
    folder.symlink_to(project / "dist/repository")
    message = in_blender(REFUSED, tmp_path / "user", archive, url)
    assert f"This platform ({platform}) isn't one of ({other})" in message
    assert '"dynamic_morph_targets", found but not compatible with this system' in message
