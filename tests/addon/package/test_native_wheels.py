# SPDX-License-Identifier: GPL-3.0-or-later
"""The Python wheels of `make wheels platforms=native`, installed as docs/install.md says, beside what is there."""

import re
import stat
import subprocess
import sys
import tomllib
import zipfile
from email import message_from_bytes
from pathlib import Path

import numpy as np
import pytest
from test_extension import VERSION, make_project, package

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs/install.md").read_text(encoding="utf-8")
MINOR = f"{sys.version_info.major}.{sys.version_info.minor}"


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A project with the wheels in dist/."""
    made = make_project(tmp_path_factory.mktemp("wheels"))
    package(made, "wheel")
    return made


def metadata_of(wheel):
    with zipfile.ZipFile(wheel) as files:
        (name,) = [name for name in files.namelist() if name.endswith(".dist-info/METADATA")]
        return message_from_bytes(files.read(name))


def test_everybody_can_read_the_wheels(project):
    wheels = list(project.glob("dist/*.whl"))
    assert {wheel.name.split("-")[0] for wheel in wheels} == {"dynamorph", "dynamic_morph_targets"}
    assert {stat.S_IMODE(wheel.stat().st_mode) for wheel in wheels} == {0o644}


def test_the_wheels_say_what_they_are(project):
    for wheel in project.glob("dist/*.whl"):
        metadata = metadata_of(wheel)
        assert metadata["Version"] == VERSION and metadata["License-Expression"] == "GPL-3.0-or-later"
        assert metadata["Description-Content-Type"] == "text/markdown"
        assert len(metadata.get_payload().split()) > 20
        urls = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["urls"]
        assert metadata.get_all("Project-URL", []) == [f"{name}, {url}" for name, url in urls.items()]


def test_pip_takes_the_wheels_for_its_python(project, tmp_path):
    """By the commands of the page, in an environment that has NumPy and bpy already."""
    pytest.importorskip("bpy")
    commands = re.findall(r"^dynamorph/bin/(.* dynamic_morph_targets\b.*)$", PAGE, re.MULTILINE)
    assert [command.split()[0] for command in commands] == ["pip", "python"]
    environment = tmp_path / "dynamorph"
    subprocess.run([sys.executable, "-m", "venv", environment], check=True)
    beside = next(environment.glob("lib/python*/site-packages")) / "beside.pth"
    beside.write_text(str(Path(np.__file__).parents[1]))
    for command in commands:
        program, *arguments = command.split()
        command = [environment / "bin" / program, *arguments]
        run = subprocess.run(command, cwd=project, env={}, capture_output=True, text=True, check=False)
        assert run.returncode == 0, run.stdout + run.stderr
    assert "bake" in run.stdout
    modules = sorted(environment.glob("lib/python*/site-packages/dynamorph/*.so"))
    assert [module.name.split(".")[0] for module in modules] == ["_core", "_mesher"]
    assert all(MINOR.replace(".", "") in module.name for module in modules)


def test_the_page_names_the_versions_of_bpy_that_are_tested():
    requirements = (ROOT / "tools/requirements.txt").read_text()
    pinned = re.findall(r'^bpy==(\d+\.\d+)\.\d+; python_version == "(.*)"$', requirements, re.MULTILINE)
    tested = {python: version for version, python in pinned}
    extra = tomllib.loads((ROOT / "addon/pyproject.toml").read_text())["project"]["optional-dependencies"]["bpy"]
    assert extra == [f"bpy=={version}.*; python_version == '{python}'" for python, version in tested.items()]
    for python, version in tested.items():
        assert f'"bpy=={version}.*"' in PAGE and f"python{python}" in PAGE
    workflow = (ROOT / "examples/farm/github_actions.yml").read_text()
    # It has Python 3.13, with the wheels of both in one folder.
    assert set(re.findall(r"pip install bpy==(\d+\.\d+)", workflow)) == {tested["3.13"]}
    assert "whl" not in workflow and workflow.count("--no-index --find-links wheels dynamic_morph_targets") == 2
