# SPDX-License-Identifier: GPL-3.0-or-later
"""The website: all pages are in its navigation, no link in it is dead, and it loads nothing from another host."""

import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

ROOT = Path(__file__).parents[2]
PYTHON = ROOT / ".venv/site/bin/python"
LOADED = {("script", "src"), ("img", "src"), ("iframe", "src"), ("source", "src"), ("link", "href")}


class Page(HTMLParser):
    """The anchors of a page, and its links as (tag, attribute, value)."""

    def __init__(self, path: Path):
        super().__init__()
        self.anchors, self.links = set(), []
        self.feed(path.read_text("utf-8"))

    def handle_starttag(self, tag, attrs):
        named = dict(attrs)
        self.anchors |= {named[key] for key in ("id", "name") if named.get(key)}
        self.links += [(tag, key, named[key]) for key in ("href", "src") if named.get(key)]


def test_all_pages_are_in_the_navigation():
    """Also where Sphinx, which refuses others, is not installed."""
    start = (ROOT / "site/index.md").read_text("utf-8")
    listed = {word for block in re.findall(r"```{toctree}\n(.*?)```", start, re.DOTALL) for word in block.split()}
    pages = {page.relative_to(ROOT / "docs").with_suffix("").as_posix() for page in (ROOT / "docs").rglob("*.md")}
    below = {page for page in pages if "/" in page and page.split("/")[0] + "/index" in listed}
    assert not pages - below - listed


@pytest.fixture(scope="module")
def site() -> dict[Path, Page]:
    if not PYTHON.exists() or not shutil.which("doxygen") or not (ROOT / "build/playground").exists():
        pytest.skip("needs what `make site` installs and builds")
    run = subprocess.run([PYTHON, ROOT / "tools/site.py"], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    return {path: Page(path) for path in (ROOT / "build/site/html").rglob("*.html")}


def test_no_link_is_dead(site):
    dead = []
    for path, page in site.items():
        for tag, _, link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            target = target / "index.html" if target.is_dir() else target
            anchor = unquote(parts.fragment)
            if not target.exists() or (anchor and tag == "a" and target in site and anchor not in site[target].anchors):
                dead.append(f"{path.relative_to(ROOT)}: {link}")
    assert not dead


def test_nothing_is_loaded_from_another_host(site):
    others = {
        (path.name, link)
        for path, page in site.items()
        for tag, key, link in page.links
        if (tag, key) in LOADED and urlsplit(link).netloc
    }
    styles = (ROOT / "build/site/html/_static").rglob("*.css")
    assert not others
    assert not [path.name for path in styles if re.search(r"url\(['\"]?(https?:)?//", path.read_text("utf-8"))]


@pytest.mark.parametrize("word", ["PoseSpace", "Firmness", "Simulation"])
def test_search_finds(site, word):
    assert word.lower()[:6] in (ROOT / "build/site/html/searchindex.js").read_text("utf-8").lower()
