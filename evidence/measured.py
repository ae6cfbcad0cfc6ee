# SPDX-License-Identifier: GPL-3.0-or-later
"""The commit at which a generated page of docs/ was measured, and which pages have aged since.

python evidence/measured.py                  lists the pages that are out of date
python evidence/measured.py docs/PAGE.md     writes the present commit into a page that has such a line
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from project import ROOT

DOCS = ROOT / "docs"
LINE = re.compile(r"Measured at commit `?([0-9a-f]{7,40})`? \((\d{4}-\d\d-\d\d)\)( \+ changes)?")

INTERFACE = ("ui/*", "cli/*", "preferences.py", "scene/events.py", "run/tools/watch.py")
ENGINE = ("cpp/dynamorph", "cpp/bindings")
ADDON = ("addon/dynamic_morph_targets", *(f":!addon/dynamic_morph_targets/{name}" for name in INTERFACE))
# What each generated page is made from, as git's path specifications.
PAGES = {
    "results.md": (*ENGINE, *ADDON, "sample_blends", "evidence/results.py", "evidence/claims.py",
                   "evidence/plots.py", "evidence/results_page.py", "evidence/subjects.py"),
    "performance.md": (*ENGINE, *ADDON, "evidence/engine.cpp", "evidence/test_pipeline.py", "evidence/first_click.py"),
    "robustness.md": (*ENGINE, *ADDON, "evidence/robustness_page.py", "tests/addon/characters.py"),
    "bakes.md": (*ENGINE, *ADDON, "evidence/bakes.py", "evidence/walks.py"),
    "accuracy.md": (*ENGINE, *ADDON, "evidence/accuracy_shots.py", "evidence/motion_error.py",
                    "sample_blends/*.blend"),
    "believable.md": (*ENGINE, *ADDON, "evidence/believable_bake.py", "evidence/believable_measure.py",
                      "evidence/convergence.py"),
    "panels/feel.md": (*ENGINE, *ADDON, "evidence/feels.py"),
    "collision.md": (*ENGINE, *ADDON, "evidence/collision.py", "evidence/collision_press.py"),
    "garments.md": (*ENGINE, *ADDON, "evidence/garments.py"),
    "choices.md": ("cpp/dynamorph", "evidence/choices.py"),
    "shapes.md": (*ENGINE, *ADDON, "evidence/shapes.py", "evidence/shapes_cheek.py", "evidence/shapes_joints.py",
                  "evidence/shapes_posed.py", "evidence/recipes", "sample_blends/*.blend"),
    "limit.md": (*ENGINE, *ADDON, "evidence/limit.py"),
    "rigs.md": (*ENGINE, *ADDON, "evidence/rigs_page.py", "tests/addon/rig_families.py",
                "tests/addon/human.py"),
    "how_long.md": (*ENGINE, *ADDON, "evidence/how_long.py", "sample_blends/herbert.blend"),
    "comparison.md": (*ENGINE, *ADDON, "evidence/comparison.py", "evidence/collision_press.py",
                      "sample_blends/bulging_cylinder.blend"),
    "gallery.md": (*ENGINE, *ADDON, "evidence/gallery_loop.py", "evidence/subjects.py", "sample_blends"),
    "evidence/coverage.md": ("cpp", "addon/dynamic_morph_targets", "tests/engine", "tests/addon", "tests/cpp",
                    "evidence/coverage_page.py"),
    "farm.md": ("addon/dynamic_morph_targets/cli", "addon/dynamic_morph_targets/io/cache_dir.py", "examples/farm",
                "evidence/farm_demo.py"),
    "materials.md": ("addon/dynamic_morph_targets/core/material/presets.py",),
    "platforms.md": ("cpp", "CMakeLists.txt", "tools/wheels.py", "evidence/platforms_page.py"),
    "reliability.md": (*ENGINE, "addon/dynamic_morph_targets", "tests/faults.toml"),
    "window.md": (*ENGINE, "addon/dynamic_morph_targets", "evidence/gaps.py", "evidence/window/gaps.py"),
    "evidence/window_test.md": (*ENGINE, "addon/dynamic_morph_targets", "evidence/window", "evidence/gui_test.py"),
}  # fmt: skip
PAGES |= {
    f"recipes/{page.name}": (
        *ENGINE,
        *ADDON,
        "evidence/recipes",
        "evidence/recipes_book.py",
        "sample_blends/*.blend",
        "sample_blends/stage.py",
    )
    for page in (DOCS / "recipes").glob("*.md")
    if page.name != "index.md"
}
# Pages that are written by hand, or made from the program itself (evidence/reference.py) or from other pages
# (evidence/how_well.py).
WRITTEN = ("architecture.md", "attribution.md", "command_line.md", "cpp.md", "decisions/", "file_format.md",
           "first_steps.md", "glossary.md", "how_well.md", "install.md", "limitations.md", "measurements.md",
           "panels/", "playground.md", "python.md", "recipes/index.md", "releasing.md", "report.md",
           "scripting.md", "theory.md", "troubleshooting.md", "upgrading.md")  # fmt: skip


def measured_at(page: str) -> str:
    """The line for a page of PAGES that is being written: the commit, and whether its sources have changes beside.

    Without git's history an empty text."""
    head = git("log", "-1", "--format=%h (%cs)", "--abbrev=7")
    if not head:
        return ""
    changed = git("status", "--porcelain", "--", *PAGES[page])
    commit, date = head.split()
    return f"Measured at commit `{commit}` {date}" + (" + changes" if changed else "")


def stamp(page: Path) -> None:
    """Write the present commit into the line that the page has. Raises ValueError without one."""
    text, count = LINE.subn(measured_at(name_of(page)), page.read_text(encoding="utf-8"))
    if not count:
        raise ValueError(f"{page.name}: there is no line that names a commit")
    page.write_text(text, encoding="utf-8")


def write_between(page: Path, begin: str, end: str, text: str) -> None:
    """Put a text between two marks of a page. Raises ValueError without them."""
    before, mark, rest = page.read_text(encoding="utf-8").partition(begin)
    _, closing, after = rest.partition(end)
    if not (mark and closing):
        raise ValueError(f"{page.name}: the marks {begin} and {end} are missing")
    page.write_text(f"{before}{begin}\n{text.strip()}\n{end}{after}", encoding="utf-8")


def name_of(page: Path) -> str:
    """As PAGES names it."""
    page = page.resolve()
    return page.relative_to(DOCS if page.is_relative_to(DOCS) else ROOT).as_posix()


def path_of(name: str) -> Path:
    """Of a page of PAGES."""
    return (ROOT if name.startswith("evidence/") else DOCS) / name


def commits(page: Path) -> list[tuple[str, bool]]:
    """The commits that a page names, and whether there were uncommitted changes."""
    return [(found[1], bool(found[3])) for found in LINE.finditer(page.read_text(encoding="utf-8"))]


def aged(page: Path) -> str:
    """What has changed in a page's sources since it was measured, in one line; empty if nothing has."""
    reasons, last, name = [], "", name_of(page)
    for commit, changes in dict.fromkeys(commits(page)):
        if changes:
            reasons.append(f"measured at {commit} with changes that no commit has")
        if not git("cat-file", "-t", commit):
            reasons.append(f"measured at {commit}, which is not in this history")
        elif since := git("log", "--oneline", "--no-merges", f"{commit}..HEAD", "--", *PAGES[name]).splitlines():
            reasons.append(f"commits to its sources since {commit}: {len(since)}")
            last = f" (last: {since[0]})"
    return f"{page.relative_to(ROOT).as_posix()}: {'; '.join(reasons)}{last}" if reasons else ""


def git(*words: str) -> str:
    """What git prints; empty where it fails, as in an archive of the sources."""
    try:
        run = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    except OSError:
        return ""
    return "" if run.returncode else run.stdout.strip()


def has_history() -> bool:
    """Whether this is a git checkout with all its commits."""
    inside = git("rev-parse", "--show-toplevel")
    return bool(inside) and Path(inside) == ROOT and git("rev-parse", "--is-shallow-repository") == "false"


def main() -> int:
    if len(sys.argv) > 1:
        stamp(Path(sys.argv[1]))
        return 0
    for name in PAGES:
        if path_of(name).exists() and (text := aged(path_of(name))):
            print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
