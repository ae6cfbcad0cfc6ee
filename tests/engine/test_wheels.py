# SPDX-License-Identifier: GPL-3.0-or-later
"""What `make wheels` compiles for, and what it tells the linkers. The compiling itself is tried by `make -C evidence
platforms`."""

import importlib.util
import re
import sys
import sysconfig
from pathlib import Path

import pytest
import wheels

ROOT = Path(__file__).parents[2]


def test_tags_of_wheels_are_platforms_of_blender():
    found = importlib.util.find_spec("bpy")
    if found is None:
        pytest.skip("needs the bpy wheel")
    path = next(Path(found.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))
    spec = importlib.util.spec_from_file_location("blender_ext", path)
    blender_ext = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(blender_ext)
    for name, platform in wheels.PLATFORMS.items():
        assert blender_ext.blender_platforms_from_wheel_platform(platform.tag) == [name]


def test_every_supported_python_has_a_wheel_on_each_platform_that_has_its_blender():
    for name in wheels.PLATFORMS:
        expected = {"3.11"} if name == "macos-x64" else {"3.11", "3.13"}
        assert expected <= set(wheels.pythons_of(name))
    assert "3.14" in wheels.pythons_of("linux-x64")  # Debian's own Blender, the window test's


def test_names_of_wheels_are_what_installers_ask_for():
    assert wheels.wheel_path("windows-x64", "3.13").name == f"dynamorph-{wheels.version()}-cp313-cp313-win_amd64.whl"
    for name, platform in wheels.PLATFORMS.items():
        assert wheels.wheel_path(name, "3.11").stem.endswith(platform.tag)


def test_names_of_modules_are_what_python_imports():
    here = sysconfig.get_config_var("EXT_SUFFIX")
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    suffixes = {platform.suffix.format(python.replace(".", "")) for platform in wheels.PLATFORMS.values()}
    assert here in suffixes
    assert wheels.PLATFORMS["windows-x64"].modules("3.13")[1] == "_mesher.cp313-win_amd64.pyd"


def test_exported_names_are_those_of_pythons_headers():
    names = wheels.exported_names(Path(sysconfig.get_path("include")))
    assert {"PyModule_Create2", "PyErr_SetString", "PyExc_ValueError DATA", "PyBaseObject_Type DATA"} <= set(names)
    assert "_PyObject_GC_New" in names and len(names) > 1000
    assert not [name for name in names if "pthread" in name]  # the compiler's own


def test_foreign_libraries_are_told_from_the_systems():
    allowed = wheels.SYSTEM_LIBRARIES
    for system, good in {
        "Linux": "libc.so.6",
        "Windows": "KERNEL32.dll",
        "Darwin": "/usr/lib/libSystem.B.dylib",
    }.items():
        assert re.fullmatch(allowed[system], good)
    assert not re.fullmatch(allowed["Linux"], "libstdc++.so.6")
    assert not re.fullmatch(allowed["Windows"], "libc++.dll")
    assert not re.fullmatch(allowed["Darwin"], "/opt/homebrew/lib/libfoo.dylib")
