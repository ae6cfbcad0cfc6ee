# SPDX-License-Identifier: GPL-3.0-or-later
"""What the arrays and the description of a stored model have to be, whoever wrote the file. NumPy only; never bpy.

Shapes, types and indices are checked here. Whether the numbers describe a body and its modes is the engine's to say,
when `Model.from_arrays` makes its model of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields

import numpy as np

from ..errors import ModelFileError
from ..geometry import invertible
from ..records import is_number
from ..settings import METHODS, ModelSettings

# Kind of numbers (as in NumPy) and dimensions of each array, by what a model has. A letter is the same number in all of
# them: n nodes, m tets, V vertices, J targets, S sets, B bones, W = B + 1, F = 3 free, r modes, h responses.
EVERY = {"target_sets": "i J", "residual_shapes": "f J V 3", "to_bind": "f 3 3", "parents": "i B", "rest": "f B 4 4"}
TISSUE = {
    "nodes": "f n 3",
    "tets": "i m 4",
    "fill": "f m",
    "stiffness": "f m",
    "region_weights": "f m S",
    "pinned": "b n",
    "node_weights": "f n W",
    "embedding_nodes": "i V 4",
    "embedding_weights": "f V 4",
    "displacements": "f J n 3",
}
UNPAINTED = {"unpainted_stiffness": "f m", "unpainted_hold": "f m"}
HOLD = {"hold_strength": "f m", "hold": "f n", "thickness": "f V"}
REDUCED = {"basis": "f F r", "table_lambda": "f J c", "table_mu": "f J c"}
RESPONSES = {
    "responses": "f F h",
    "response_lambda": "f J a",
    "response_mu": "f J a",
    "coupling_lambda": "f J b",
    "coupling_mu": "f J b",
    "relaxation": "f J h r",
}
LARGEST = 1e60  # of a number; in the tables of the smallest bodies there are some of 1e45
NEVER_EMPTY = ("nodes", "tets", "basis", "residual_shapes")


def damaged(what: str) -> ModelFileError:
    """The error about a part of a stored model."""
    return ModelFileError("The stored model is damaged ({what}): build it again", what=what)


def check(arrays: dict[str, np.ndarray], settings: ModelSettings, described: dict, only_cage: bool) -> None:
    """Raises ModelFileError unless all of it is as a build writes it.

    arrays: by the names of `model.Model`; described: its bone names, dependencies and summary; only_cage: whether it
    is of its tetrahedra alone.
    """
    for field in fields(ModelSettings):
        if not _is_like(field.default, getattr(settings, field.name)):
            raise damaged(f"setting '{field.name}'")
    if settings.method not in METHODS or settings.solver not in ("FULL", "REDUCED"):
        raise damaged("setting 'method' or 'solver'")
    for name, fits in DESCRIPTION.items():
        if not fits(described[name]):
            raise damaged(name.replace("_", " "))
    bones = len(described["bone_names"])
    _check_shapes(arrays, _forms(arrays, settings, only_cage), bones)
    _check_numbers(arrays, bones)
    if settings.method != "STATIC" and arrays["region_weights"].shape[1] > len(arrays["displacements"]):
        raise damaged("more sets than targets")


def _forms(arrays: dict[str, np.ndarray], settings: ModelSettings, only_cage: bool) -> dict[str, str]:
    """The forms of the arrays that such a model has."""
    forms = dict(EVERY)
    if settings.method == "STATIC":
        return forms
    forms |= TISSUE
    if any(arrays[name].size for name in HOLD):
        forms |= HOLD
    forms |= {name: form for name, form in UNPAINTED.items() if arrays[name].size}
    if settings.solver == "REDUCED" and not only_cage:
        forms |= REDUCED
        if arrays["responses"].size:
            forms |= RESPONSES
    return forms


def _check_shapes(arrays: dict[str, np.ndarray], forms: dict[str, str], bones: int) -> None:
    sizes = {"B": bones, "W": bones + 1, "3": 3, "4": 4}
    for name, array in arrays.items():
        if name not in forms:
            if array.ndim not in (1, 2) or len(array):
                raise damaged(f"array '{name}' is {array.shape}")
            continue
        kind, *letters = forms[name].split()
        expected = tuple(sizes.setdefault(letter, size) for letter, size in zip(letters, array.shape, strict=False))
        if array.dtype.kind != kind or array.ndim != len(letters) or array.shape != expected:
            raise damaged(f"array '{name}' is {array.dtype} {array.shape}")
        if name in NEVER_EMPTY and not len(array):
            raise damaged(f"array '{name}' is empty")


def _check_numbers(arrays: dict[str, np.ndarray], bones: int) -> None:
    for name, array in arrays.items():
        if array.dtype.kind == "f" and not float(np.abs(array).max(initial=0.0)) < LARGEST:  # as no NaN is
            raise damaged(f"array '{name}' is not finite")
    nodes, sets = len(arrays["nodes"]), arrays["region_weights"].shape[-1]
    for name, count in (("tets", nodes), ("embedding_nodes", nodes), ("target_sets", sets), ("parents", bones)):
        array, least = arrays[name], -1 if name == "parents" else 0
        if array.size and not (least <= array.min() and array.max() < count):
            raise damaged(f"array '{name}' has indices beyond {count}")
    if (arrays["parents"] >= np.arange(bones)).any():
        raise damaged("array 'parents' is not in order")
    for name in ("to_bind", "rest"):
        if not invertible(arrays[name]).all():
            raise damaged(f"array '{name}' cannot be inverted")
    shapes, pinned = arrays["displacements"], arrays["pinned"]
    if shapes.size and shapes[:, pinned].any():
        raise damaged("array 'displacements' moves pinned nodes")


def _is_like(default: object, value: object) -> bool:
    """Whether a setting has the type of its default; whole numbers are floats too."""
    if isinstance(default, float):
        return is_number(value)
    return type(value) is type(default)


def _is_count(value: object) -> bool:
    return type(value) is int and value >= 0


def _are_texts(values: object) -> bool:
    return isinstance(values, (list, tuple)) and all(isinstance(value, str) for value in values)


def _by_text(fits: Callable[[object], bool]) -> Callable[[object], bool]:
    """A check for dictionaries whose values `fits` accepts."""
    return lambda found: isinstance(found, dict) and all(fits(value) for value in found.values())


def _is_summary(summary: object) -> bool:
    if not isinstance(summary, dict) or summary.keys() != SUMMARY.keys():
        return False
    return all(fits(summary[name]) for name, fits in SUMMARY.items())


def _is_range(value: object) -> bool:
    """Of frames; None: of none."""
    ends = isinstance(value, (list, tuple)) and len(value) == 2 and all(type(frame) is int for frame in value)
    return value is None or ends


# The fields of a stored `summary.Summary`.
SUMMARY: dict[str, Callable[[object], bool]] = {
    **dict.fromkeys(("nodes", "tets", "pinned", "held_parts", "dofs", "modes", "tabulated", "targets"), _is_count),
    **dict.fromkeys(("defects", "glued"), _by_text(_is_count)),
    "held": is_number,
    "quality": _by_text(is_number),
    "fitted": _is_range,
    "warnings": _are_texts,
}
DESCRIPTION: dict[str, Callable[[object], bool]] = {
    "bone_names": _are_texts,
    "dependencies": _by_text(lambda value: isinstance(value, str)),
    "summary": _is_summary,
}
