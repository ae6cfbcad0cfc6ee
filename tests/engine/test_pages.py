# SPDX-License-Identifier: GPL-3.0-or-later
"""Every page of docs/ that is generated names the commit it was measured at, and those that have aged are listed."""

import re
import subprocess
import warnings
from pathlib import Path

import measured
import pytest

ROOT = Path(__file__).parents[2]
PAGES = [name for name in measured.PAGES if measured.path_of(name).exists()]


def test_pages_are_known():
    """A new page is generated, and then in measured.PAGES, or written by hand, and then in measured.WRITTEN."""
    found = {page.relative_to(measured.DOCS).as_posix() for page in measured.DOCS.rglob("*.md")}
    unknown = {name for name in found if name not in measured.PAGES and not name.startswith(measured.WRITTEN)}
    assert not unknown


@pytest.mark.parametrize("name", PAGES)
def test_generated_pages_name_a_commit(name):
    assert measured.commits(measured.path_of(name))


def test_pictures_of_pages():
    """A picture that a page shows exists, and one of the interface is shown by a page."""
    pages = [ROOT / "README.md", *measured.DOCS.rglob("*.md")]
    picture = re.compile(r"!\[.*?\]\(([^:)]+)\)")
    shown = {(page.parent / path).resolve() for page in pages for path in picture.findall(page.read_text("utf-8"))}
    assert not {path for path in shown if not path.exists()}
    assert not set((measured.DOCS / "images/guide").glob("*.png")) - shown


# Measurements -------------------------------------------------------------------------------------------------------


def test_how_well_it_works_has_the_figures_of_its_pages():
    pytest.importorskip("matplotlib", reason="needs what draws the plots")
    import how_well

    assert how_well.PAGE.read_text(encoding="utf-8") == how_well.text(), "run: make -C evidence how-well"
    assert len(how_well.text().split()) <= 600


MEASURED = re.compile(r"\b\d*[1-9]\d*\.\d+|\b\d+\.\d*[1-9]")  # with decimals: counts may be equal
EQUAL = "Rows are equal where"  # what the text before a table says of those that may be


def tables(text):
    """(title, cells of a row) of each row of each table that does not say that its rows may be equal."""
    found, before = [], ""
    for block in text.split("\n\n"):
        rows = [line.strip()[1:-1].split("|") for line in block.splitlines() if line.startswith("|")]
        if len(rows) > 2 and EQUAL not in before.replace("\n", " "):
            found.append([[cell.strip() for cell in row] for row in rows if not set("".join(row)) <= set("-: ")])
        before = block
    return found


def equal_rows(text):
    """Names of rows with at least three measurements that are all those of the row before or of another one."""
    wrong = []
    for _title, *rows in tables(text):
        seen = {}
        for name, *cells in rows:
            if sum(bool(MEASURED.search(cell)) for cell in cells) >= 3:
                wrong += [f"{seen[tuple(cells)]} and {name}"] if tuple(cells) in seen else []
                seen[tuple(cells)] = name
    return wrong


def goals_alone(text):
    """Names of rows with a goal and without a figure beside it."""
    wrong = []
    for title, *rows in tables(text):
        goals = [column for column, name in enumerate(title) if re.search(r"goal|asked", name.lower())][:1]
        for row in rows if goals else ():
            figures = [cell for column, cell in enumerate(row) if column not in (0, *goals)]
            if row[goals[0]] and not any(re.search(r"\d", cell) for cell in figures):
                wrong.append(row[0])
    return wrong


@pytest.mark.parametrize("name", PAGES)
def test_measurements_make_sense(name):
    """What is varied makes a difference, and a goal has a figure."""
    text = measured.path_of(name).read_text(encoding="utf-8")
    assert (equal_rows(text), goals_alone(text)) == ([], [])


ROWS = (
    "| | a | b | c |",
    "| --- | --- | --- | --- |",
    "| as it is | 0.1 | 1.5 s | 0.2 |",
    "| slack 2 | 0.1 | 1.5 s | 0.2 |",
)
TABLE = "\n".join(ROWS)
GOALS = (
    "| work | goal | measured |\n| --- | --- | --- |\n| one | \u2264 3 s | 2 s |\n| two | \u2264 3 s | |\n| three | | |"
)


def test_what_makes_no_sense_is_found():
    assert equal_rows(TABLE) == ["as it is and slack 2"] and goals_alone(GOALS) == ["two"]
    assert equal_rows(f"{EQUAL} it is so.\n\n{TABLE}") == equal_rows(TABLE.replace("2 | 0.1", "2 | 0.3")) == []


@pytest.mark.filterwarnings("default::UserWarning")
def test_aged_pages_are_listed():
    if not measured.has_history():
        pytest.skip("needs the history of the project")
    aged = [text for name in PAGES if (text := measured.aged(measured.path_of(name)))]
    if aged:
        warnings.warn("pages to be measured again:\n" + "\n".join(aged), UserWarning, stacklevel=1)


# The list itself ---------------------------------------------------------------------------------------------------


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A project with one source and one page; a function that commits what is there."""
    monkeypatch.setattr(measured, "ROOT", tmp_path)
    monkeypatch.setattr(measured, "DOCS", tmp_path / "docs")
    monkeypatch.setattr(measured, "PAGES", {"page.md": ("source", ":!source/panel.py")})
    (tmp_path / "source").mkdir()
    (tmp_path / "docs").mkdir()

    def commit():
        identity = ["-c", "user.name=Test", "-c", "user.email=test@example.org", "-c", "commit.gpgsign=false"]
        for words in (["add", "-A"], [*identity, "commit", "-qm", "Change"]):
            subprocess.run(["git", *words], cwd=tmp_path, check=True, capture_output=True)

    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True, capture_output=True)
    (tmp_path / "source" / "engine.py").write_text("1\n")
    commit()
    return tmp_path, commit


def test_page_ages_with_its_sources(project):
    folder, commit = project
    page = folder / "docs" / "page.md"
    page.write_text(f"# Page\n\n{measured.measured_at('page.md')}.\n")
    commit()
    assert measured.has_history()
    assert measured.aged(page) == ""
    (folder / "source" / "panel.py").write_text("1\n")  # which it does not depend on
    commit()
    assert measured.aged(page) == ""
    (folder / "source" / "engine.py").write_text("2\n")
    assert measured.measured_at("page.md").endswith(" + changes")
    commit()
    assert measured.aged(page).startswith("docs/page.md: commits to its sources since")
    measured.stamp(page)
    commit()
    assert measured.aged(page) == ""


def test_page_of_another_history_is_listed(project):
    folder, _ = project
    page = folder / "docs" / "page.md"
    page.write_text("Measured at commit `0123456` (2026-01-01) + changes.\n")
    assert "not in this history" in measured.aged(page)
    assert "with changes" in measured.aged(page)


def test_without_history_nothing_is_claimed(tmp_path, monkeypatch):
    monkeypatch.setattr(measured, "ROOT", tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert not measured.has_history()
    assert measured.measured_at("results.md") == ""


def test_page_without_a_line_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(measured, "DOCS", tmp_path)
    page = tmp_path / "results.md"
    page.write_text("# Results\n")
    with pytest.raises(ValueError, match="names a commit"):
        measured.stamp(page)
