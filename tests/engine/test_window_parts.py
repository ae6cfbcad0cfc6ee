# SPDX-License-Identifier: GPL-3.0-or-later
"""`make -C evidence gui-test` in parts: which run, where each begins, and that each ends. The window itself is
faked."""

import json
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
gui_test = pytest.importorskip("gui_test", reason="needs what evidence/gui_test.py imports")


@pytest.fixture
def work(tmp_path, monkeypatch):
    monkeypatch.setattr(gui_test, "WORK", tmp_path)
    monkeypatch.setattr(gui_test, "INSTALLED", tmp_path / "installed")
    (tmp_path / "extension.zip").touch()
    monkeypatch.setattr(gui_test, "inside", lambda path: path)
    return tmp_path


def blender(monkeypatch, code=0, printed="", ok=True):
    """What Blender does in the place of a part: the commands that are asked of it."""
    asked = []

    def enter(log, *command, **_environment):
        asked.append(list(map(str, command)))
        (gui_test.WORK / log).write_text(printed)
        part = asked[-1][-1]
        if ok:
            found = {"ok": True, "measured": {}, "there": [part], "opened": [part]}
            (gui_test.WORK / f"{part}.json").write_text(json.dumps(found))
            (gui_test.WORK / f"{part}.blend").touch()
        return code

    monkeypatch.setattr(gui_test, "enter", enter)
    return asked


def test_every_part_is_a_module_of_steps():
    for part in gui_test.PARTS:
        assert "@step(" in (ROOT / f"evidence/window/{part}.py").read_text(encoding="utf-8")


def test_named_parts_run_in_their_order():
    assert gui_test.chosen_parts(["files", "judging"]) == ["judging", "files"]
    assert set(gui_test.PARTS) - set(gui_test.chosen_parts([])) <= {"character"}
    with pytest.raises(gui_test.Failed, match="there is no part filse"):
        gui_test.chosen_parts(["filse"])


def test_a_part_begins_with_what_the_one_before_it_has_saved(work, monkeypatch):
    with pytest.raises(gui_test.Failed, match="'trying' begins with what 'authoring' leaves"):
        gui_test.start_of("trying")
    (work / "authoring.blend").touch()
    asked = blender(monkeypatch)
    gui_test.run_part("trying")
    assert asked[0][-1] == str(work / "extension.zip")  # it runs alone, so nothing is installed yet
    assert str(work / "authoring.blend") in asked[1] and asked[1][:2] == ["timeout", str(gui_test.PARTS["trying"])]
    gui_test.INSTALLED.touch()
    gui_test.run_part("trying")
    assert len(asked) == 3 and "timeout" in asked[2]
    assert gui_test.start_of("repository") is gui_test.start_of("first_bake") is None


def test_a_part_that_does_not_end_is_named_with_its_limit(work, monkeypatch):
    blender(monkeypatch, code=124, ok=False)
    with pytest.raises(gui_test.Failed, match="part 'repository': it took longer than 300 s"):
        gui_test.run_part("repository")
    assert not (work / "repository.blend").exists()


def test_a_line_that_nobody_knows_fails_the_part(work, monkeypatch):
    blender(monkeypatch, printed="STEP uninstall\nTraceback (most recent call last):\n")
    with pytest.raises(gui_test.Failed, match="part 'repository' passed, but Blender printed\nTraceback"):
        gui_test.run_part("repository")


def test_what_no_part_has_opened_is_named():
    part = {"there": ["panel", "menu"], "opened": ["panel"]}
    gui_test.check_openings([part, {"there": [], "opened": ["menu"]}])
    with pytest.raises(gui_test.Failed, match="never opened: menu"):
        gui_test.check_openings([part])
    with pytest.raises(gui_test.Failed, match="not noted as something that opens: dialog"):
        gui_test.check_openings([part, {"there": [], "opened": ["menu", "dialog"]}])
