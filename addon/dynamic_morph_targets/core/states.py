# SPDX-License-Identifier: GPL-3.0-or-later
"""What the extension remembers from one call to the next: one small state for each owner, all in one list."""

from __future__ import annotations

from typing import Any, TypeVar

T = TypeVar("T")

_all: list[Any] = []


def of(kind: type[T]) -> T:
    """The state of an owner: kind(), which `reset` makes again."""
    state = kind()
    _all.append(state)
    return state


def reset(*states: Any) -> None:
    """These states, or all, are what they were at first: the file is closed, or the add-on is switched off."""
    for state in states or _all:
        vars(state).update(vars(type(state)()))


def changed() -> list[str]:
    """The fields, of all states, that are not what they were at first."""
    return [
        f"{type(state).__name__}.{name}"
        for state in _all
        for name, value in vars(type(state)()).items()
        if vars(state)[name] != value
    ]
