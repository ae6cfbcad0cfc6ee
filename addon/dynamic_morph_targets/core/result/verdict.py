# SPDX-License-Identifier: GPL-3.0-or-later
"""The verdict on a bake, as stored with the bake. The panel reads it here, whatever the text contains. No bpy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

from .. import records
from ..errors import RecordError

REMEDIES = ("REHEARSE", "STIFFEN")
UNREADABLE = "The verdict on this bake cannot be read: bake again"
STIFFER = 1.5  # factor on Bounce where the verdict names none


@dataclass(frozen=True)
class StoredVerdict:
    """How believable a bake looks. ok; text: one sentence; figures: (what is measured, value), as they are shown.

    frame, vertices: where it looks worst; remedy: one of REMEDIES or ""; factor: on Bounce, for STIFFEN.
    """

    ok: bool
    text: str
    figures: tuple[tuple[str, str], ...] = ()
    frame: int | None = None
    vertices: tuple[int, ...] = ()
    remedy: str = ""
    factor: float = STIFFER


@lru_cache(maxsize=16)
def parsed(text: str) -> StoredVerdict | None:
    """The verdict in a text; None without a text. An unreadable text gives a verdict that says so."""
    if not text:
        return None
    try:
        values = records.verdict(text)
    except RecordError:
        return StoredVerdict(False, UNREADABLE)
    frame, factor = _number(values.get("frame")), _number(values.get("factor"))
    vertices = values.get("vertices")
    return StoredVerdict(
        ok=values.get("ok") is True,
        text=values["text"],
        figures=tuple(_figures(values)),
        frame=round(frame) if frame is not None else None,
        vertices=tuple(v for v in vertices if type(v) is int and v >= 0) if isinstance(vertices, list) else (),
        remedy=next((each for each in REMEDIES if each == values.get("remedy")), ""),
        factor=factor if factor is not None and factor > 1.0 else STIFFER,
    )


def _figures(values: dict[str, object]) -> Iterator[tuple[str, str]]:
    """(name, text) of the measures that are there."""
    for name, key, form in (
        ("Displacement", "displacement", "{:.1%} of size"),
        ("Of Thickness", "over_thickness", "{:.2f}"),
        ("Inverted Volume", "inverted", "{:.2%}"),
        ("Flipped Skin", "flipped", "{:.2%}"),
    ):
        value = _number(values.get(key))
        if value is not None:
            yield name, form.format(value)
    stretch = values.get("stretch")
    ends = [_number(end) for end in stretch] if isinstance(stretch, list) else []
    if len(ends) == 2 and None not in ends:
        yield "Stretch", f"{ends[0]:.2f} to {ends[1]:.2f}"


def _number(value: object) -> float | None:
    """A finite number, or None."""
    return float(value) if records.is_number(value) else None
