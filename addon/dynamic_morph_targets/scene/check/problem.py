# SPDX-License-Identifier: GPL-3.0-or-later
"""What a check finds."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from ...core.errors import SceneError
from ...core.message import Message


@dataclass(init=False)
class Problem:
    """text: what is wrong, with the object's name, and the remedy; fix: the key of `fixes.FIXES`, or ''."""

    text: str
    fix: str

    def __init__(self, text: str, fix: str = "", /, **values: object) -> None:
        self.text = Message(text, **values) if values else text
        self.fix = fix


def refuse(problems: Iterable[Problem]) -> None:
    """Raises SceneError about the first of `problems`."""
    for problem in problems:
        raise SceneError(problem.text)
