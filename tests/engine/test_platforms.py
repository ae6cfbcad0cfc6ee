# SPDX-License-Identifier: GPL-3.0-or-later
"""What differs between Linux, macOS and Windows and is not tested where it is used: the other systems are faked."""

import builtins
import importlib
import platform
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
from dynamic_morph_targets.core import engine
from dynamic_morph_targets.core.errors import EngineNotFoundError, sentence
from dynamic_morph_targets.io import paths

# Names of files -------------------------------------------------------------------------------------------------------


@pytest.mark.fault("F08")
@pytest.mark.parametrize(
    ("name", "cleaned"),
    [
        ("Body", "Body"),
        ('a<b>c:d"e/f\\g|h?i*j', "a_b_c_d_e_f_g_h_i_j"),
        ("Body. ", "Body__"),
        ("..", "__"),
        ("tab\tnew\nline", "tab_new_line"),
        ("身体", "身体"),
        ("CON", "CON_"),
        ("nul", "nul_"),
        ("Com1", "Com1_"),
        ("LPT9", "LPT9_"),
        ("CON.blend", "CON_blend"),
        ("Console", "Console"),
        ("x" * 255, "x" * 63),
        ("\U0001f9cc" * 63, "\U0001f9cc" * 45),
    ],
)
def test_a_name_of_blenders_names_a_file_on_every_system(name, cleaned):
    assert paths.clean_name(name) == cleaned


@pytest.mark.parametrize(("system", "shared"), [("linux", False), ("darwin", True), ("win32", True)])
def test_upper_and_lower_case_name_one_file_except_on_linux(monkeypatch, system, shared):
    monkeypatch.setattr(sys, "platform", system)
    assert paths.is_shared([Path("/out/Körper.abc"), Path("/out/KÖRPER.abc")]) == shared
    assert paths.is_shared([Path("/out/Ko\u0308rper.abc"), Path("/out/K\u00f6rper.abc")]) == shared
    assert paths.is_shared([Path("/out/Body.abc"), Path("/out/Body.abc")])
    assert not paths.is_shared([Path("/out/Body.abc"), Path("/out/Shirt.abc")])


def test_the_drive_of_a_path_stays_as_it_was_given(tmp_path, monkeypatch):
    """Windows says for a network drive which server it is, if asked: no path could be relative to its letter then."""
    monkeypatch.setattr(Path, "resolve", lambda path, strict=False: Path("//server/share", path.name))
    assert paths.file_path(str(tmp_path / "{object}.glb"), "Arm") == tmp_path / "Arm.glb"
    monkeypatch.chdir(tmp_path)
    assert paths.file_path("{object}.glb", "Arm") == tmp_path / "Arm.glb"


# An engine that cannot be loaded --------------------------------------------------------------------------------------


@pytest.fixture
def loader_message(monkeypatch, tmp_path):
    """loader_message(error, system, machine): what a system says whose loader fails so, with wheels for others."""

    def loader_message(error, system, machine="x86_64", wheels=()):
        really = builtins.__import__

        def fails(name, *args, **options):
            if name == "dynamorph":
                raise error
            return really(name, *args, **options)

        for wheel in wheels:
            (tmp_path / "wheels").mkdir(exist_ok=True)
            (tmp_path / "wheels" / wheel).touch()
        with monkeypatch.context() as patch:
            patch.setattr(builtins, "__import__", fails)
            patch.setattr(platform, "system", lambda: system)
            patch.setattr(platform, "machine", lambda: machine)
            patch.setattr(engine, "__file__", str(tmp_path / "core" / "engine.py"))
            with pytest.raises(EngineNotFoundError) as refused:
                engine.load()
        return sentence(refused.value)

    return loader_message


WITHOUT_ENGINE = """
import importlib, pkgutil, sys
sys.modules["dynamorph"] = None
import dynamic_morph_targets.core as core, dynamic_morph_targets.io as io
for package in (core, io):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        importlib.import_module(module.name)
from dynamic_morph_targets.core import errors
from dynamic_morph_targets.core.model import cage
try:
    cage.dynamorph.embed
except errors.EngineNotFoundError as error:
    print(errors.sentence(error))
"""


def test_every_module_loads_without_the_engine_and_says_what_is_missing_when_it_is_used():
    done = subprocess.run([sys.executable, "-c", WITHOUT_ENGINE], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("The engine cannot be loaded on ")


PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"


def test_a_missing_engine_says_for_which_systems_it_is_there(loader_message):
    wheels = (
        "dynamorph-0.1.0-cp311-cp311-win_amd64.whl",
        "dynamorph-0.1.0-cp313-cp313-manylinux_2_27_x86_64.manylinux_2_28_x86_64.whl",
    )
    text = loader_message(ModuleNotFoundError("No module named 'dynamorph'"), "Darwin", "arm64", wheels)
    assert text == (
        f"The engine cannot be loaded on Darwin arm64 with Python {PYTHON} (No module named 'dynamorph'). This "
        "extension has it for cp311 win_amd64, cp313 manylinux_2_27_x86_64. Install the Dynamorph extension made for "
        "this Blender and system from its .zip, or with pip the package 'dynamorph', and restart"
    )
    bare = loader_message(ModuleNotFoundError("No module named 'dynamorph'"), "Windows", "AMD64")
    assert bare.startswith(f"The engine cannot be loaded on Windows AMD64 with Python {PYTHON} (No module")


@pytest.mark.fault("V01")
@pytest.mark.parametrize(
    ("system", "error", "remedy"),
    [
        ("Windows", "DLL load failed while importing _core: Das angegebene Modul wurde nicht gefunden.",
         "virus scanner.*for this processor"),
        ("Windows", "DLL load failed while importing _core: %1 is not a valid Win32 application.", "this processor"),
        ("Darwin", "dlopen(_core.so, 0x0002): tried: '_core.so' (code signature not valid for use in process)",
         "macOS blocks it: choose Open Anyway"),
        ("Darwin", "dlopen(_core.so, 2): (library load disallowed by system policy)", "macOS blocks it"),
        ("Darwin", "dlopen: (mach-o file, but is an incompatible architecture (have 'arm64', need 'x86_64'))",
         "made for this Blender and system"),
        ("Linux", "/lib/x86_64-linux-gnu/libc.so.6: version `GLIBC_2.28' not found", "glibc 2.28 or newer"),
        ("Linux", "Error loading shared library ld-linux-x86-64.so.2: No such file", "glibc 2.28 or newer"),
        ("Linux", "wrong ELF class: ELFCLASS32", "made for this Blender and system"),
        ("Linux", "_core.so: failed to map segment from shared object", "Memory is short: close other programs"),
        ("Linux", "_core.so: cannot allocate memory in static TLS block", "made for this Blender and system"),
    ],
)  # fmt: skip
def test_each_loader_error_comes_with_its_remedy(loader_message, system, error, remedy):
    text = loader_message(ImportError(error), system)
    assert error in text and text.startswith(f"The engine cannot be loaded on {system}")
    _, _, advice = text.partition(error)
    assert re.search(remedy, advice), text


@pytest.mark.fault("V02")
def test_an_engine_from_before_an_update_asks_for_a_restart(monkeypatch):
    """Blender replaces the extension's modules and the files of the engine, but a compiled module stays in memory."""
    dynamorph = pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    with monkeypatch.context() as patch:
        patch.setattr(dynamorph, "__version__", "0.1.0")
        patch.setattr(metadata, "version", lambda _name: "0.2.0")
        with pytest.raises(EngineNotFoundError, match="earlier version is still loaded: restart Blender"):
            importlib.reload(engine).load()
    importlib.reload(engine).load()


@pytest.mark.fault("V03")
def test_an_engine_that_another_add_on_has_brought(monkeypatch):
    """Blender has one folder for the wheels of all extensions."""
    dynamorph = pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")
    with monkeypatch.context() as patch:
        patch.setattr(dynamorph, "__version__", "7.0.0")
        patch.setattr(metadata, "version", lambda _name: "7.0.0")
        ours = importlib.reload(engine).addon_version()
        with pytest.raises(
            EngineNotFoundError, match=f"version 7.0.0, but this extension has {ours}: disable the add-on"
        ):
            engine.load()
    importlib.reload(engine).load()
