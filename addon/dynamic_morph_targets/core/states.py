# SPDX-License-Identifier: GPL-3.0-or-later
"""What the extension remembers from one call to the next: one small state for each owner, all in one list."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from functools import _lru_cache_wrapper

T = TypeVar("T")

_all: list[tuple[Any, list[Callable[[], None]]]] = []  # with what empties the caches that belong to each


def of(kind: type[T]) -> T:
    """The state of an owner: kind(), which `reset` makes again."""
    state = kind()
    _all.append((state, []))
    return state


def cached(state: Any, maxsize: int) -> Callable[[Callable[..., T]], _lru_cache_wrapper[T]]:
    """As `lru_cache`, for what is read of Blender: it is forgotten when `state`, made by `of`, is reset."""

    def remember(function: Callable[..., T]) -> _lru_cache_wrapper[T]:
        known = lru_cache(maxsize)(function)
        next(caches for each, caches in _all if each is state).append(known.cache_clear)
        return known

    return remember


def reset(*states: Any) -> None:
    """These states, or all, are what they were at first: the file is closed, or the add-on is switched off."""
    for state, caches in _all:
        if not states or any(state is each for each in states):
            vars(state).update(vars(type(state)()))
            for clear in caches:
                clear()


def changed() -> list[str]:
    """The fields, of all states, that are not what they were at first."""
    return [
        f"{type(state).__name__}.{name}"
        for state, _ in _all
        for name, value in vars(type(state)()).items()
        if vars(state)[name] != value
    ]
