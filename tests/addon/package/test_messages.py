# SPDX-License-Identifier: GPL-3.0-or-later
"""Each message that docs/troubleshooting.md quotes is one that the program prints."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "troubleshooting.md"
ANY = "…"  # a name or a number, in the page and below


def python_texts(source: str):
    """The strings of a module, with what is formatted into them as ANY."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.JoinedStr):
            parts = [part.value if isinstance(part, ast.Constant) else ANY for part in node.values]
            yield "".join(str(part) for part in parts)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield re.sub(r"\{[^}]*\}", ANY, node.value)


def cpp_texts(source: str):
    """The strings of a C++ file; adjacent ones, and those with something added between them, are one."""
    joined = re.sub(r'"\s*"', "", source)
    joined = re.sub(r'"\s*\+[^";]*\+\s*"', ANY, joined)
    return re.findall(r'"((?:[^"\\\n]|\\.)*)"', joined)


def quoted():
    """The messages in the first column of the page's tables of messages."""
    _, messages = PAGE.read_text(encoding="utf-8").split("## Before the first build")
    return re.findall(r"^\| `([^`]+)` \|", messages, re.MULTILINE)


def says(text: str, message: str) -> bool:
    pattern = ".*".join(re.escape(piece) for piece in message.split(ANY))
    return re.search(pattern, text) is not None


def test_quoted_messages_exist():
    modules = [path for folder in ("addon", "cpp") for path in (ROOT / folder).rglob("*.py")]
    texts = [text for path in modules for text in python_texts(path.read_text(encoding="utf-8"))]
    texts += [text for path in (ROOT / "cpp").rglob("*.cpp") for text in cpp_texts(path.read_text(encoding="utf-8"))]
    messages = quoted()
    assert len(messages) > 60
    assert [message for message in messages if not any(says(text, message) for text in texts)] == []
