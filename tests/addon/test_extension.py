# SPDX-License-Identifier: GPL-3.0-or-later
"""The zip that artists install: built, installed into an empty Blender and baked with, by its own bundled engine."""

import fcntl
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

INSTALL_AND_BAKE = """
import os, sys
archive, folder, sample, *ours = sys.argv[1:]
os.environ["BLENDER_USER_RESOURCES"] = folder
sys.path = [path for path in sys.path if path not in ours]  # as on the artist's machine
import bpy
bpy.ops.extensions.package_install_files(filepath=archive, repo="user_default", enable_on_install=True)
import dynamorph
assert dynamorph.__file__.startswith(folder), dynamorph.__file__
bpy.ops.wm.open_mainfile(filepath=sample)
limb = bpy.data.objects["Limb"]
bpy.context.view_layer.objects.active = limb
limb.dynamorph.simulation.use_scene_range = False
limb.dynamorph.simulation.end = 5
assert bpy.ops.dynamorph.bake() == {"FINISHED"}
modes = [key.name for key in limb.data.shape_keys.key_blocks if key.name.startswith("Dynamorph Mode")]
assert len(modes) == limb.dynamorph.model.modes, modes
bpy.ops.preferences.addon_disable(module="bl_ext.user_default.dynamic_morph_targets")
print("baked with", os.path.relpath(dynamorph.__file__, folder))
"""


@pytest.fixture(scope="module")
def archive():
    with (ROOT / "build" / "packing.lock").open("w") as lock:  # `make test` runs two Pythons at once
        fcntl.flock(lock, fcntl.LOCK_EX)
        packing = subprocess.run(
            [sys.executable, ROOT / "tools" / "package.py", "extension"], capture_output=True, text=True, check=False
        )
        assert packing.returncode == 0, packing.stdout + packing.stderr
        yield next((ROOT / "dist").glob("dynamic_morph_targets-*.zip"))


def test_zip_holds_the_add_on_and_a_wheel_for_this_python(archive):
    with zipfile.ZipFile(archive) as files:
        names = files.namelist()
        manifest = tomllib.loads(files.read("blender_manifest.toml").decode())
    assert {"blender_manifest.toml", "__init__.py", "LICENSE", "LICENSES.md"} <= set(names)
    assert {"translations/de.json", "translations/fr.json"} <= set(names)
    tag = f"cp{sys.version_info.major}{sys.version_info.minor}"
    assert any(name.startswith("wheels/dynamorph-") and tag in name for name in names)
    assert manifest["platforms"] == ["linux-x64"]
    assert not [name for name in names if "__pycache__" in name or name.endswith((".o", ".a"))]


def test_installs_and_bakes_with_the_bundled_engine(archive, tmp_path):
    ours = [ROOT / "build" / "cmake" / "python", ROOT / "addon"]
    sample = ROOT / "sample_blends" / "bulging_cylinder.blend"
    run = subprocess.run(
        [sys.executable, "-c", INSTALL_AND_BAKE, archive, tmp_path, sample, *ours],
        capture_output=True,
        text=True,
        check=False,
    )
    assert "baked with" in run.stdout, run.stdout + run.stderr
    assert run.returncode == 0
