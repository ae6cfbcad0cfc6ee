# SPDX-License-Identifier: GPL-3.0-or-later
"""Which way the engine's files depend on each other: no circle, and no include of a folder that comes later."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# A file may include files of its own folder and of those before it.
REDUCED = ["reduced/modes", "reduced/responses", "reduced/inertia", "reduced"]
FOLDERS = ["core", "simd", "mesh", "elastic", "pose", "models", *REDUCED, "contact", "step", "file", "bindings"]
INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"', re.MULTILINE)


def includes_of(cpp: Path) -> dict[Path, list[Path]]:
    """The files that each file below `cpp` includes; files that are not there (TetGen's) do not count."""
    files = [path for path in sorted(cpp.rglob("*")) if path.suffix in (".hpp", ".cpp")]
    found = {}
    for path in files:
        named = INCLUDE.findall(path.read_text(encoding="utf-8"))
        candidates = [folder / name for name in named for folder in (path.parent, cpp)]
        found[path] = [candidate for candidate in candidates if candidate in files]
    return found


def folder_of(path: Path, cpp: Path) -> str:
    """`reduced/modes` for cpp/dynamorph/reduced/modes/basis.hpp, `bindings` for all that is below cpp/bindings."""
    top, *below = path.relative_to(cpp).parent.parts
    return "/".join(below) if top == "dynamorph" else top


def arrows_back(cpp: Path) -> list[str]:
    """Includes of a file in a later folder, and files in a folder that FOLDERS does not name."""
    wrong = []
    for path, included in includes_of(cpp).items():
        if folder_of(path, cpp) not in FOLDERS:
            wrong.append(f"{path.relative_to(cpp)} is in no known folder")
            continue
        place = FOLDERS.index(folder_of(path, cpp))
        later = [other for other in included if folder_of(other, cpp) in FOLDERS[place + 1 :]]
        wrong += [f"{path.relative_to(cpp)} includes {other.relative_to(cpp)}" for other in later]
    return wrong


def circle(cpp: Path) -> list[str]:
    """The files of one circle of includes, in order, or none."""
    graph = includes_of(cpp)
    done: set[Path] = set()

    def search(path: Path, way: list[Path]) -> list[Path]:
        if path in way:
            return [*way[way.index(path) :], path]
        if path in done:
            return []
        for other in graph[path]:
            if found := search(other, [*way, path]):
                return found
        done.add(path)
        return []

    for path in graph:
        if found := search(path, []):
            return [str(each.relative_to(cpp)) for each in found]
    return []


def test_includes_point_one_way():
    assert arrows_back(ROOT / "cpp") == []
    assert circle(ROOT / "cpp") == []


def test_every_folder_is_looked_at():
    """The test above would pass if it found no file or no include."""
    graph = includes_of(ROOT / "cpp")
    assert {folder_of(path, ROOT / "cpp") for path in graph} >= {"core", "mesh", "models", "step", "bindings"}
    assert all(graph[path] for path in graph if path.suffix == ".cpp")


def test_the_page_names_the_same_order():
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert " → ".join(FOLDERS) in re.sub(r"\s+", " ", page)


GOOD = {
    "dynamorph/core/types.hpp": "",
    "dynamorph/mesh/cage.hpp": '#include "dynamorph/core/types.hpp"\n',
    "dynamorph/reduced/modes/basis.hpp": "",
    "dynamorph/reduced/reduced_model.hpp": '#include "dynamorph/reduced/modes/basis.hpp"\n',
    "dynamorph/mesh/cage.cpp": '#include "dynamorph/mesh/cage.hpp"\n#include "tetgen.h"\n#include <vector>\n',
    "bindings/arrays.hpp": '#include "dynamorph/mesh/cage.hpp"\n',
    "bindings/bind_mesh.cpp": '#include "arrays.hpp"\n',
}


@pytest.mark.parametrize(
    ("path", "text", "back", "round_trip"),
    [
        ("bindings/more.cpp", '#include "arrays.hpp"\n', [], []),
        (
            "dynamorph/core/types.hpp",
            '  #  include "dynamorph/mesh/cage.hpp"\n',
            ["dynamorph/core/types.hpp includes dynamorph/mesh/cage.hpp"],
            ["dynamorph/mesh/cage.hpp", "dynamorph/core/types.hpp", "dynamorph/mesh/cage.hpp"],
        ),
        (
            "dynamorph/core/threads.cpp",
            '#include "dynamorph/mesh/cage.hpp"\n',
            ["dynamorph/core/threads.cpp includes dynamorph/mesh/cage.hpp"],
            [],
        ),
        (
            "dynamorph/step/teleport.cpp",
            '#include "bindings/arrays.hpp"\n',
            ["dynamorph/step/teleport.cpp includes bindings/arrays.hpp"],
            [],
        ),
        (
            "bindings/arrays.hpp",
            '#include "arrays.hpp"\n',
            [],
            ["bindings/arrays.hpp", "bindings/arrays.hpp"],
        ),
        (
            "dynamorph/reduced/modes/basis.cpp",
            '#include "dynamorph/reduced/reduced_model.hpp"\n',
            ["dynamorph/reduced/modes/basis.cpp includes dynamorph/reduced/reduced_model.hpp"],
            [],
        ),
        ("dynamorph/misc/junk.hpp", "", ["dynamorph/misc/junk.hpp is in no known folder"], []),
        ("dynamorph/loose.hpp", "", ["dynamorph/loose.hpp is in no known folder"], []),
    ],
)
def test_wrong_trees_are_found(tmp_path, path, text, back, round_trip):
    for name, content in {**GOOD, path: text}.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(content, encoding="utf-8")
    assert arrows_back(tmp_path) == back
    found = circle(tmp_path)
    assert set(found) == set(round_trip) and len(found) == len(round_trip)
