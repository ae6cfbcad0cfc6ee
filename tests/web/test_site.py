# SPDX-License-Identifier: GPL-3.0-or-later
"""The website: all pages are in its navigation, no link in it is dead, and it loads nothing from another host."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

ROOT = Path(__file__).parents[2]
HTML = ROOT / "build/site/html"
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
    assert "measurements" in listed
    measurements = (ROOT / "docs/measurements.md").read_text("utf-8")
    below |= set(re.findall(r"^- \[.+\]\((\w+)\.md\)", measurements, re.MULTILINE))
    assert not pages - below - listed


@pytest.fixture(scope="module")
def site() -> dict[Path, Page]:
    """Every page that `make site` has built."""
    if not (HTML / "index.html").exists():
        pytest.skip("needs the website: make site")
    return {path: Page(path) for path in HTML.rglob("*.html")}


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
    styles = (HTML / "_static").rglob("*.css")
    assert not others
    assert not [path.name for path in styles if re.search(r"url\(['\"]?(https?:)?//", path.read_text("utf-8"))]


@pytest.mark.parametrize(
    ("word", "page"), [("firmness", "panels/firmness"), ("mixamo", "recipes/mixamo"), ("posespace", "python")]
)
def test_search_finds(site, word, page):
    index = json.loads((HTML / "searchindex.js").read_text("utf-8").removeprefix("Search.setIndex(").removesuffix(")"))
    terms = [*index["terms"].items(), *index["titleterms"].items()]
    found = [places for term, places in terms if word.startswith(term) and len(term) > 3]
    pages = {number for places in found for number in ([places] if isinstance(places, int) else places)}
    assert page in {index["docnames"][number] for number in pages}
