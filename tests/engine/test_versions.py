# SPDX-License-Identifier: GPL-3.0-or-later
"""The version is the same wherever it stands, and `make version` changes it everywhere."""

import re
import shutil
import tomllib
from datetime import UTC, datetime
from pathlib import Path

import pytest
import version

ROOT = Path(__file__).parents[2]


@pytest.fixture
def project(tmp_path) -> Path:
    """A copy of all files that name the version, with two versions in its CHANGELOG."""
    for name in version.PLACES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    (tmp_path / "CHANGELOG.md").write_text("# Changelog\n\n## 0.1.0, unreleased\n\n- One.\n\n## 0.0.9, 2026-01-02\n")
    version.set_all("0.1.0", tmp_path)  # dates it
    return tmp_path


def headings(project: Path) -> list[str]:
    return re.findall("^## (.*)$", (project / "CHANGELOG.md").read_text(), re.MULTILINE)


def today() -> str:
    return str(datetime.now(UTC).date())


def test_all_files_name_the_same_version():
    expected = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert version.found() == {
        **{name: [expected] * len(texts) for name, texts in version.PLACES.items()},
        "CHANGELOG.md": [expected],
    }


def test_the_first_heading_of_the_changelog_is_that_version():
    """CHANGELOG.md has no other section before it, as of changes without a version."""
    text = (ROOT / "CHANGELOG.md").read_text()
    first = re.search("^## .*$", text, re.MULTILINE)
    assert version.HEADING.match(text, first.start())


def test_cmake_reads_the_same_line():
    """CMakeLists.txt takes the first line of pyproject.toml that begins so."""
    lines = [line for line in (ROOT / "pyproject.toml").read_text().splitlines() if line.startswith("version = ")]
    assert len(lines) == 1
    assert 'file(STRINGS pyproject.toml version REGEX "^version = ")' in (ROOT / "CMakeLists.txt").read_text()


def test_a_version_is_opened_and_then_dated(project):
    version.set_all("0.1.1", project)
    assert headings(project) == ["0.1.1, unreleased", f"0.1.0, {today()}", "0.0.9, 2026-01-02"]
    version.set_all("0.2.0", project)  # something in it was not compatible after all
    assert headings(project) == [f"0.2.0, {today()}", f"0.1.0, {today()}", "0.0.9, 2026-01-02"]
    assert {each for versions in version.found(project).values() for each in versions} == {"0.2.0"}
    addon = tomllib.loads((project / "addon/pyproject.toml").read_text())["project"]
    assert "dynamorph==0.2.0" in addon["dependencies"]
    manifest = tomllib.loads((project / "addon/dynamic_morph_targets/blender_manifest.toml").read_text())
    assert (manifest["version"], manifest["schema_version"], manifest["blender_version_min"]) == (
        "0.2.0",
        "1.0.0",
        "4.5.0",
    )


@pytest.mark.parametrize(
    "new, message", [("0.1.0", "was released"), ("0.0.10", "was released"), ("v2", "three numbers")]
)
def test_what_is_no_next_version_changes_nothing(project, new, message):
    before = {path: path.read_bytes() for path in project.rglob("*") if path.is_file()}
    with pytest.raises(ValueError, match=message):
        version.set_all(new, project)
    assert before == {path: path.read_bytes() for path in project.rglob("*") if path.is_file()}
