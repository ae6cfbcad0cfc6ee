# SPDX-License-Identifier: GPL-3.0-or-later
"""Which way the extension's modules depend on each other, and how large they may be. Reads the source, not Blender."""

from __future__ import annotations

import ast
from pathlib import Path

PACKAGE = Path(__file__).parents[3] / "addon" / "dynamic_morph_targets"
# A module may import those of its own folder and of those before it. The package's own files come last.
FOLDERS = [
    "core", "core/model", "core/material", "core/motion", "core/result", "io", "preferences",
    "scene", "scene/properties", "scene/read", "scene/check", "scene/motion", "scene/cuts",
    "scene/character", "scene/store",
    "write", "write/bake", "write/authoring", "write/display", "write/export",
    "run", "run/work", "run/bake", "run/playing", "run/live", "run/tools",
    "ui", "ui/operators", "ui/overlays", "ui/panels", "cli", "",
]  # fmt: skip
WITHOUT_BLENDER = {"core", "io"}
LONGEST_MODULE, LONGEST_CLASS = 420, 210  # lines
BLENDER = {"bpy", "bpy_extras", "bmesh", "mathutils", "gpu", "blf"}


def modules(package: Path) -> dict[str, ast.Module]:
    """The syntax of each module by its place, such as scene/character/extract."""
    return {
        path.relative_to(package).with_suffix("").as_posix(): ast.parse(path.read_text(encoding="utf-8"))
        for path in sorted(package.rglob("*.py"))
    }


def folder_of(module: str) -> str:
    return module if module in FOLDERS else module.rpartition("/")[0]


def imported_by(module: str, tree: ast.Module, known) -> set[str]:
    """The package's modules that one imports, anywhere in it."""
    here, found = module.split("/")[:-1], set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = here[: len(here) - node.level + 1] + (node.module.split(".") if node.module else [])
            named = ["/".join([*base, alias.name]) for alias in node.names]
            found |= {name if name in known else "/".join(base) for name in named}
    return found & set(known)


def graph_of(package: Path) -> dict[str, set[str]]:
    found = modules(package)
    return {module: imported_by(module, tree, found) for module, tree in found.items()}


def arrows_back(graph: dict[str, set[str]]) -> list[str]:
    def place(module):
        return FOLDERS.index(folder_of(module))

    return [f"{module} imports {other}" for module in graph for other in graph[module] if place(other) > place(module)]


def circle(graph: dict[str, set[str]]) -> list[str]:
    """The modules of one circle of imports, in order, or none."""
    done = set()

    def search(module, way):
        if module in way:
            return [*way[way.index(module) :], module]
        if module not in done:
            for other in sorted(graph[module]):
                if found := search(other, [*way, module]):
                    return found
            done.add(module)
        return []

    return next(filter(None, (search(module, []) for module in graph)), [])


def test_imports_run_one_way():
    graph = graph_of(PACKAGE)
    assert len(graph) > 80 and arrows_back(graph) == []
    assert circle(graph) == []


def test_a_circle_and_an_arrow_back_are_found(tmp_path):
    for name, text in {
        "core/shape": "from ..io import files",
        "io/files": "def save():\n    from ..core.shape import Shape",
    }.items():
        path = tmp_path / f"{name}.py"
        path.parent.mkdir()
        path.write_text(text)
    graph = graph_of(tmp_path)
    assert arrows_back(graph) == ["core/shape imports io/files"]
    assert circle(graph) == ["core/shape", "io/files", "core/shape"]


def of_blender(tree: ast.Module) -> set[str]:
    """Which of Blender's own modules one imports."""
    names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module}
    return BLENDER & {name.split(".")[0] for name in names}


def test_core_and_io_do_without_blender():
    for module, tree in modules(PACKAGE).items():
        if module.split("/")[0] in WITHOUT_BLENDER:
            assert not of_blender(tree), module


def test_one_module_imports_the_compiled_engine():
    """So the others load without it, and its absence is reported in one way."""
    for module, tree in modules(PACKAGE).items():
        types = [node for each in ast.walk(tree) if is_type_checking(each) for node in ast.walk(each)]
        named = {
            name
            for node in ast.walk(tree)
            if node not in types and isinstance(node, ast.Import | ast.ImportFrom)
            for name in ([alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module])
            if not getattr(node, "level", 0)
        }
        assert "dynamorph" not in named or module == "core/engine", module


def is_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def test_what_a_job_s_thread_computes_does_without_blender():
    """Neither the module nor anything that it imports may import Blender."""
    graph, found = graph_of(PACKAGE), modules(PACKAGE)
    reached, ahead = set(), {"run/work/computation", "run/work/answering"}
    while ahead:
        module = ahead.pop()
        reached.add(module)
        ahead |= graph[module] - reached
        assert not of_blender(found[module]), module
    assert len(reached) > 20


def test_modules_and_classes_are_of_a_size_to_be_read():
    for module, tree in modules(PACKAGE).items():
        lines = len((PACKAGE / f"{module}.py").read_text(encoding="utf-8").splitlines())
        assert lines <= LONGEST_MODULE, module
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                assert node.end_lineno - node.lineno + 1 <= LONGEST_CLASS, f"{module}: {node.name}"
