# SPDX-License-Identifier: GPL-3.0-or-later
"""Docstrings and comments name only what exists: `module.name`, `Class.member`. Reads the source, not Blender."""

import ast
import re
import tokenize
from collections import defaultdict
from pathlib import Path

PACKAGE = Path(__file__).parents[3] / "addon" / "dynamic_morph_targets"
NAMED = re.compile(r"`(\w+(?:\.\w+)+)(?:\(\))?`")
ELSEWHERE = {"bpy", "dynamorph", "np", "mathutils", "bpy_extras", "Object", "bone", "pose_bone"}  # of others


def names_in(body) -> dict[str, dict]:
    """What statements define, by name; of a class its members, and what its methods set."""
    found = {}
    for node in body:
        if isinstance(node, ast.ClassDef):
            found[node.name] = names_in(node.body) | set_in(node) | {name_of(base): {} for base in node.bases}
        elif isinstance(node, ast.FunctionDef):
            found[node.name] = {}
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found |= {each.id: {} for target in targets for each in ast.walk(target) if isinstance(each, ast.Name)}
        elif isinstance(node, ast.If | ast.Try):
            found |= names_in([*node.body, *node.orelse])
    return found


def name_of(base) -> str:
    return base.id if isinstance(base, ast.Name) else ""


def set_in(node) -> dict[str, dict]:
    """The attributes of self that a class sets."""
    attributes = (each for each in ast.walk(node) if isinstance(each, ast.Attribute) and name_of(each.value) == "self")
    return {each.attr: {} for each in attributes if isinstance(each.ctx, ast.Store)}


def texts(path: Path):
    """(line, text) of a module's docstrings and comments."""
    with tokenize.open(path) as file:
        for token in tokenize.generate_tokens(file.readline):
            if token.type == tokenize.COMMENT or (token.type == tokenize.STRING and token.string.startswith('"""')):
                yield token.start[0], token.string


def wrong_names(package: Path) -> list[str]:
    """Names in docstrings and comments that lead nowhere, with their places."""
    modules = {path: names_in(ast.parse(path.read_text(encoding="utf-8")).body) for path in package.rglob("*.py")}
    known = defaultdict(dict)  # modules and classes, by name
    for path, names in modules.items():
        known[path.stem] |= names
        for name, members in names.items():
            if name[0].isupper():
                known[name] |= members
    wrong = []
    for path in sorted(modules):
        for line, text in texts(path):
            for dotted in NAMED.findall(text):
                first, *rest = dotted.split(".")
                if first in ELSEWHERE or rest[-1] in ("py", "cpp", "hpp", "md", "json", "toml"):
                    continue
                if not leads_somewhere(known, first, rest):
                    wrong.append(f"{path.relative_to(package).as_posix()}:{line}: `{dotted}`")
    return wrong


def leads_somewhere(known: dict[str, dict], first: str, rest: list[str]) -> bool:
    """Whether a dotted name is that of a module or class, and its members."""
    if first not in known:
        return False
    if not rest:
        return True
    bases = [name for name in known[first] if name in known and name[:1].isupper() and name != first]
    return (rest[0] in known[first] and (len(rest) == 1 or leads_somewhere(known, rest[0], rest[1:]))) or any(
        leads_somewhere(known, base, rest) for base in bases if first[:1].isupper()
    )


def test_what_docstrings_and_comments_name_exists():
    assert wrong_names(PACKAGE) == []


def test_a_name_that_leads_nowhere_is_found(tmp_path):
    (tmp_path / "shape.py").write_text(
        'class Shape:\n    """As `shape.area`."""\n\n    size: int\n\n\ndef area(): ...\n'
    )
    (tmp_path / "other.py").write_text("x = 1  # `Shape.size`, `Shape.volume`, `shape.gone`, `nothing.at_all`\n")
    wrong = ["Shape.volume", "shape.gone", "nothing.at_all"]
    assert wrong_names(tmp_path) == [f"other.py:1: `{name}`" for name in wrong]
