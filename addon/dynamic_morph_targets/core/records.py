# SPDX-License-Identifier: GPL-3.0-or-later
"""What builds, bakes and compared settings note in the .blend, as JSON: written with a version, checked when read.

A .blend may come from anybody and from any version. Whatever its texts say, reading them gives what the caller can
work with, or RecordError with a sentence for the artist. No bpy.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields
from functools import lru_cache
from math import isfinite
from typing import TypeGuard

from .errors import RecordError
from .settings import Material

VERSION = 1
BUILD = "The record of the last build cannot be read: press Build Model"
BAKE = "The record of the last bake cannot be read: bake again"
VERDICT = "The verdict on this bake cannot be read: bake again"
PATCH = "What a grip holds cannot be read: press Attach Here"
SLOT = "The other set of settings cannot be read: press Copy to replace it"
LAST_FRAME = 1_048_574  # that Blender can show
MATERIAL = {field.name for field in fields(Material)}


def text(values: dict) -> str:
    """A record of `values`, fit for JSON."""
    return json.dumps({"version": VERSION, **values})


def animation_text(seen: list[tuple[str, str]]) -> str:
    """A record of what moves a skin: names, and hashes of their animation."""
    return text({"animation": seen})


@lru_cache(maxsize=64)
def build_inputs(record: str) -> dict:
    """The settings that a model was built with, as `staleness.model_inputs` gives them. Not to be changed."""
    return _read(record, BUILD, {"targets": _are_groups}, SETTINGS)


@lru_cache(maxsize=64)
def bake_inputs(record: str) -> dict:
    """The settings that a bake was made with, as `staleness.bake_inputs` gives them, with the `animation`, the
    model's `content_id`, what was `painted`, the `colliders`, and which of them were baked `together` with it. Not to
    be changed.
    """
    needed = {"targets": _are_groups, "animation": _is_animation, "content_id": _is_text}
    known = dict.fromkeys(("simulation", "output", "collision", "channels", "grips"), _is_group) | {"painted": _is_text}
    return _read(record, BAKE, needed, {**SETTINGS, **known, "colliders": _are_colliders, "together": _are_texts})


@lru_cache(maxsize=64)
def animation(record: str) -> list[tuple[str, str]]:
    """What `animation_text` noted; empty without a record."""
    seen = _read(record, BAKE, {"animation": _is_animation}, {})["animation"] if record else []
    return [(name, digest) for name, digest in seen]


def colliders_text(seen: list[list[str]]) -> str:
    """A record of the colliders of a skin: names, and hashes of what moves and shapes them."""
    return text({"colliders": seen})


@lru_cache(maxsize=64)
def colliders(record: str) -> list[list[str]]:
    """What `colliders_text` noted; empty without a record. Not to be changed."""
    return _read(record, BAKE, {"colliders": _are_colliders}, {})["colliders"] if record else []


def patch_text(values: dict) -> str:
    """A record of a `grab.Patch`."""
    return text(values)


@lru_cache(maxsize=64)
def patch(record: str) -> dict:
    """What `patch_text` noted. Not to be changed."""
    values = _read(record, PATCH, PATCH_FIELDS, {})
    sizes = {len(values[name]) for name in ("vertices", "offsets", "share")}
    if len(sizes) != 1 or 0 in sizes or max(values["vertices"]) >= values["count"] or min(values["share"]) < 0:
        raise RecordError(PATCH)
    return values


def verdict(record: str) -> dict:
    """The fields of a `judge.Verdict`."""
    known = {"touched": _is_touched}
    values = _read(record, VERDICT, VERDICT_FIELDS, known)
    return {name: values[name] for name in (*VERDICT_FIELDS, *known) if name in values}


def slot(record: str) -> dict:
    """A set of settings as `slots.slot_settings` gives it, without fields that this version does not know."""
    needed: dict[str, Callable[[object], bool]] = {
        "materials": _are_groups,
        "frequencies": _is_group,
        "simulation": _is_group,
        "gains": _are_numbers,
    }
    values = _read(record, SLOT, needed, {})
    materials = {
        target: {name: value for name, value in material.items() if name in MATERIAL and is_number(value)}
        for target, material in values["materials"].items()
    }
    frequencies = {
        target: (pair[0], pair[1] is True)
        for target, pair in values["frequencies"].items()
        if isinstance(pair, list) and len(pair) == 2 and is_number(pair[0])
    }
    return values | {"materials": materials, "frequencies": frequencies}


def is_number(value: object) -> TypeGuard[int | float]:
    """Whether it is a finite number, and none too large for a float."""
    try:
        return isinstance(value, (int, float)) and not isinstance(value, bool) and isfinite(value)
    except OverflowError:
        return False


def _read(record: str, unreadable: str, needed: dict[str, Callable], known: dict[str, Callable]) -> dict:
    """The values of a record: all of `needed`, and those of `known` that it has. Each must pass its check.

    unreadable: what RecordError says otherwise.
    """
    try:
        values = json.loads(record)
    except (ValueError, RecursionError) as error:
        raise RecordError(unreadable) from error
    if not isinstance(values, dict) or values.get("version") != VERSION or not values.keys() >= needed.keys():
        raise RecordError(unreadable)
    if not all(fits(values[name]) for name, fits in {**known, **needed}.items() if name in values):
        raise RecordError(unreadable)
    return values


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _is_group(value: object) -> bool:
    return isinstance(value, dict)


def _are_groups(value: object) -> bool:
    return isinstance(value, dict) and all(map(_is_group, value.values()))


def _are_numbers(value: object) -> TypeGuard[list[float]]:
    return isinstance(value, list) and all(map(is_number, value))


def _are_limits(value: object) -> bool:
    return isinstance(value, dict) and value.keys() == LIMITS and all(map(is_number, value.values()))


def _is_held(value: object) -> bool:
    return (
        isinstance(value, dict)
        and value.keys() == HELD.keys()
        and all(fits(value[name]) for name, fits in HELD.items())
    )


def _is_touched(value: object) -> bool:
    return value is None or (
        isinstance(value, dict)
        and value.keys() == TOUCHED.keys()
        and all(fits(value[name]) for name, fits in TOUCHED.items())
    )


def _is_too_deep(value: object) -> bool:
    return (
        isinstance(value, list)
        and len(value) == 5
        and _are_texts(value[:2])
        and is_number(value[2])
        and _are_frames(value[3:])
    )


def _is_unusable(value: object) -> bool:
    return isinstance(value, list) and bool(value) and _is_text(value[0]) and _are_frames(value[1:])


def _are_frames(value: object) -> bool:
    return _are_numbers(value) and len(value) == 2 and all(abs(frame) <= LAST_FRAME for frame in value)


def _are_indices(value: object) -> bool:
    return isinstance(value, list) and all(type(index) is int and index >= 0 for index in value)


def _is_animation(value: object) -> TypeGuard[list[list[str]]]:
    return isinstance(value, list) and all(
        isinstance(pair, list) and len(pair) == 2 and all(map(_is_text, pair)) for pair in value
    )


def _are_colliders(value: object) -> TypeGuard[list[list[str]]]:
    return isinstance(value, list) and all(_are_texts(each) and len(each) == 3 for each in value)


def _are_places(value: object) -> bool:
    return isinstance(value, list) and all(_are_numbers(place) and len(place) == 3 for place in value)


def _are_texts(value: object) -> TypeGuard[list[str]]:
    return isinstance(value, list) and all(map(_is_text, value))


PATCH_FIELDS: dict[str, Callable[[object], bool]] = {
    "count": lambda value: type(value) is int and value > 0,
    "vertices": _are_indices,
    "offsets": _are_places,
    "share": _are_numbers,
    "radius": lambda value: is_number(value) and value > 0,
}
LIMITS = {"displacement", "thickness"}
HELD: dict[str, Callable[[object], bool]] = {
    "bone": _is_text,
    "excess": is_number,
    "frames": _are_frames,
    "reached": is_number,
    "pulled": is_number,
}
TOUCHED: dict[str, Callable[[object], bool]] = {
    "penetration": is_number,
    "left_inside": lambda value: isinstance(value, list) and all(map(_is_too_deep, value)),
    "unusable": lambda value: isinstance(value, list) and all(map(_is_unusable, value)),
    "pressed": lambda value: isinstance(value, list) and all(map(_are_frames, value)),
}
VERDICT_FIELDS: dict[str, Callable[[object], bool]] = {
    **dict.fromkeys(("displacement", "percentile", "over_thickness", "flipped", "inverted", "flicker"), is_number),
    "limits": _are_limits,
    "held": _is_held,
    "stretch": lambda value: _are_numbers(value) and len(value) == 2,
    "frame": lambda value: is_number(value) and abs(value) <= LAST_FRAME,
    "vertices": _are_indices,
}
SETTINGS = {"model": _is_group, "groups": _is_group, "scene": _is_group}
