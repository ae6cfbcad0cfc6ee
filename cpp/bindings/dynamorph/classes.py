# SPDX-License-Identifier: GPL-3.0-or-later
"""What the compiled classes have besides: errors in a sentence, a repr, and pickling that refuses.

pybind11 answers a wrong argument with all signatures, shows an address, and ends the process where an old protocol of
pickle makes an empty object.
"""

from __future__ import annotations

import copyreg
import functools
import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from dynamorph import _core

INCOMPATIBLE = re.compile(r"(\w+)\(\): incompatible (constructor|function) arguments")
PARAMETERS = re.compile(r"^(?:\d+\. )?\w+\((.*)\) -> ", re.MULTILINE)  # of each of the ways to call it
OURS = re.compile(r"dynamorph\._core\.(\w+)")
LONGEST = 60  # characters of a value that an error shows


def _complete(core: Any) -> None:
    for name, found in [*vars(core).items()]:
        if isinstance(found, type) and not issubclass(found, BaseException):
            kind: Any = found
            kind.__reduce__ = kind.__reduce_ex__ = _reduced if hasattr(kind, "__setstate__") else _refuse_pickling
            if not _is_enum(kind):
                kind.__init__, kind.__repr__ = _with_short_errors(kind.__init__, name, core), _shown
        elif callable(found) and not isinstance(found, type):
            setattr(core, name, _with_short_errors(found, name, core))


def _is_enum(kind: type) -> bool:
    return hasattr(kind, "__members__")


# Errors --------------------------------------------------------------------------------------------------------------


def _with_short_errors(function: Callable, name: str, core: Any) -> Callable:
    """The same function, whose TypeError for wrong arguments is a sentence."""

    @functools.wraps(function)
    def call(*args: Any, **named: Any) -> Any:
        try:
            return function(*args, **named)
        except TypeError as error:
            found = INCOMPATIBLE.match(str(error))
            if not found:
                raise
            given = args[found[2] == "constructor" :]
            text = next(_faults(function.__doc__ or "", given, named, core), "an argument is of another type")
        raise TypeError(f"{name}: {text}. See help(dynamorph.{name})")

    return call


def _faults(signature: str, args: tuple, named: dict[str, Any], core: Any) -> Iterator[str]:
    """What is wrong with the arguments of a call, by what a docstring says that it takes: first of the first way."""
    found = PARAMETERS.findall(signature)
    if not found:
        return
    known = {name: (kind, default) for name, kind, default in _parameters(found[0]) if name != "self"}
    if len(args) > len(known):
        yield f"it takes {len(known)} arguments at most, and got {len(args)}"
    given = dict(zip(known, args, strict=False)) | named
    for name in named:
        if name not in known:
            yield f"it has no '{name}', but {', '.join(known)}"
    missing = [name for name, (_, default) in known.items() if not default and name not in given]
    if missing:
        yield f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing"
    for name, value in given.items():
        kind, default = known.get(name, ("", ""))
        if not (value is None and "None" in kind) and not _fits(value, kind, core):
            yield f"{name}: {_expected(kind, core)}, not {_value(value)}"


def _parameters(text: str) -> Iterator[tuple[str, str, str]]:
    """(name, type, default or '') of each parameter in the text between the parentheses."""
    depth, part = 0, ""
    for letter in f"{text},":
        depth += (letter in "([{") - (letter in ")]}")
        if letter == "," and depth == 0:
            name, _, rest = part.strip().partition(":")
            kind, _, default = rest.partition(" = ")
            if name not in {"", "*", "/"}:
                yield name.strip(), kind.strip(), default.strip()
            part = ""
        else:
            part += letter


def _fits(value: Any, kind: str, core: Any) -> bool:
    """Whether a value may be of a type as docstrings name it."""
    ours = [getattr(core, name) for name in OURS.findall(kind)]
    if "Sequence" in kind:
        return isinstance(value, (list, tuple, np.ndarray)) and (
            not ours or all(isinstance(each, tuple(ours)) for each in value)
        )
    if ours:
        return isinstance(value, tuple(ours))
    if "ArrayLike" in kind:
        try:
            return np.asarray(value).dtype.kind in "biuf"
        except ValueError:  # of rows of different lengths
            return False
    if kind == "bool":
        return isinstance(value, (bool, np.bool_))
    if "SupportsFloat" in kind:
        return hasattr(value, "__float__") or hasattr(value, "__index__")
    if "SupportsInt" in kind:
        return hasattr(value, "__index__")
    return not (kind == "str" and not isinstance(value, str))


def _expected(kind: str, core: Any) -> str:
    ours = OURS.findall(kind)
    enums = [name for name in ours if _is_enum(getattr(core, name))]
    if enums:
        members = ", ".join(getattr(core, enums[0]).__members__)
        return f"expected one of dynamorph.{enums[0]}: {members}"
    if ours:
        return f"expected {'a list of ' if 'Sequence' in kind else ''}{' or '.join(dict.fromkeys(ours))}"
    if "ArrayLike" in kind:
        return "expected an array of numbers"
    if "Supports" in kind:
        return "expected a number"
    return f"expected {kind}"


def _value(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= LONGEST else f"a {type(value).__name__}"


# Shown, and pickled --------------------------------------------------------------------------------------------------


def _shown(self: Any) -> str:
    """The class, with its numbers and the shapes of its arrays that are at hand."""
    parts = []
    for name in AT_HAND.get(type(self).__name__, ()):
        value = getattr(self, name)
        shape = np.shape(value)
        parts.append(f"{name}={'x'.join(map(str, shape)) if shape else format(value, '.4g')}")
    return f"<dynamorph.{type(self).__name__}{': ' if parts else ''}{', '.join(parts)}>"


# What the classes' reprs have: properties that cost nothing.
AT_HAND = {
    "TetMesh": ("nodes", "tets"), "Embedding": ("nodes",), "FullModel": ("dofs",), "ReducedModel": ("dofs",),
    "SoftBody": ("size", "volumes"), "MorphTarget": ("displacement",), "ReducedTables": ("basis", "responses"),
    "Basis": ("U",), "ResponseBasis": ("U", "W"), "MotionLimit": ("frequency", "numbers"),
    "StepReport": ("steps", "iterations", "residual"), "Deformation": ("farthest",),
}  # fmt: skip


def _refuse_pickling(self: Any, _protocol: int = 2) -> Any:
    name = type(self).__name__
    raise TypeError(f"{name}: it cannot be copied or pickled: keep the arrays that it was made of, and make it again")


def _reduced(self: Any, _protocol: int = 2) -> Any:
    return copyreg.__newobj__, (type(self),), self.__getstate__()  # type: ignore[attr-defined]


_complete(_core)
