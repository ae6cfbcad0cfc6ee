# SPDX-License-Identifier: GPL-3.0-or-later
"""The gallery: its page shows each loop with its recipe, and commands say which characters they lack."""

import re
from pathlib import Path

import assets
import gallery
import pytest
from PIL import Image

ROOT = Path(__file__).parents[3]
PAGE = gallery.PAGE.read_text(encoding="utf-8")


@pytest.mark.parametrize("loop", gallery.LOOPS.values(), ids=lambda loop: loop.name)
def test_the_page_shows_each_loop_with_what_it_needs(loop):
    (shown,) = re.findall(rf"### {loop.title}\n(.*?)(?=\n##|\Z)", PAGE, re.DOTALL)
    assert loop.about in shown
    assert f"(recipes/{loop.recipe}.md)" in shown
    assert (f"`{loop.name}_baked.blend`" in shown) == bool(loop.body)
    picture = gallery.PAGE.parent / gallery.IMAGES / f"{loop.name}.webp"
    assert f"({gallery.IMAGES}/{picture.name})" in shown
    assert picture.stat().st_size <= gallery.LARGEST
    with Image.open(picture) as film:
        assert film.n_frames > 10 and film.info["loop"] == 0


def test_every_scene_of_the_gallery_is_a_sample():
    for loop in gallery.LOOPS.values():
        assert bool(loop.file) != (ROOT / "sample_blends" / f"{loop.name}.blend").exists()


def test_a_page_without_its_characters_is_an_error_that_says_where_to_get_them(tmp_path):
    (tmp_path / "Fox.glb").touch()
    assets.require("believable", ["Fox.glb"], tmp_path)
    with pytest.raises(
        SystemExit, match=r"^believable: .*zoo/Cow\.glb\..*not published.*docs/attribution\.md"
    ) as raised:
        assets.require("believable", ["Fox.glb", "zoo/Cow.glb"], tmp_path)
    assert "Fox" not in str(raised.value)
    assert "## Where the characters are from" in (ROOT / "docs/attribution.md").read_text(encoding="utf-8")
