# SPDX-License-Identifier: GPL-3.0-or-later
"""The public addresses stand in pyproject.toml, and wherever else they are shown they are the same."""

import shutil
import tomllib
from pathlib import Path

import address
import pytest

ROOT = Path(__file__).parents[2]
URLS = {"Homepage": "https://site.example/dynamorph", "Repository": "https://code.example/them/dynamorph"}


@pytest.fixture
def project(tmp_path) -> Path:
    """A copy of all files that show an address."""
    for name in ("pyproject.toml", *address.texts({})):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    set_urls(tmp_path, {})
    return tmp_path


def set_urls(project: Path, urls: dict[str, str]) -> None:
    """Puts the addresses into pyproject.toml, and writes the other files."""
    path = project / "pyproject.toml"
    kept = path.read_text("utf-8").replace("[project.urls]\n", "").splitlines()
    kept = [line for line in kept if not line.startswith(tuple(f"{key} = " for key in URLS))]
    kept += ["[project.urls]", *(f'{key} = "{url}"' for key, url in urls.items())]
    path.write_text("\n".join(kept) + "\n", "utf-8")
    address.main(project)


def test_all_files_show_the_addresses_of_pyproject():
    """If not: python tools/address.py"""
    assert [path.name for path, text in address.written(ROOT).items() if path.read_text("utf-8") != text] == []


def test_addresses_that_are_set_are_shown_and_go_again(project):
    before = {name: (project / name).read_text("utf-8") for name in address.texts({})}
    assert not any(url in text for url in URLS.values() for text in before.values())
    set_urls(project, URLS)
    for name in ("README.md", "docs/install.md"):
        text = (project / name).read_text("utf-8")
        assert "`https://site.example/dynamorph/repository/index.json`" in text
        assert "https://code.example/them/dynamorph/releases" in text
    assert "https://code.example/them/dynamorph/issues" in (project / "SUPPORT.md").read_text("utf-8")
    manifest = tomllib.loads((project / "addon/dynamic_morph_targets/blender_manifest.toml").read_text("utf-8"))
    assert manifest["website"] == URLS["Homepage"] and manifest["permissions"]
    assert tomllib.loads((project / "addon/pyproject.toml").read_text("utf-8"))["project"]["urls"] == URLS
    set_urls(project, {})
    assert {name: (project / name).read_text("utf-8") for name in before} == before


def test_a_page_without_its_block_is_refused(project):
    (project / "README.md").write_text("# Dynamorph\n", "utf-8")
    with pytest.raises(ValueError, match=r"README\.md has 0 blocks"):
        address.main(project)
