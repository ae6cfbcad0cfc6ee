# SPDX-License-Identifier: GPL-3.0-or-later
"""Sentences for the artist that can still be translated after names and numbers were formatted into them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Self

LISTED = 5  # names in a report


class Message(str):
    """A sentence in English. It knows its template, which is what a language translates, and the values in that."""

    template: str
    values: dict[str, object]

    def __new__(cls, template: str, /, **values: object) -> Self:
        self = super().__new__(cls, template.format(**values))
        self.template, self.values = template, values
        return self

    def __getnewargs_ex__(self) -> tuple[tuple[str], dict[str, object]]:
        """What a copy, or another process, makes it of: names in the sentence may have braces of their own."""
        return (self.template,), self.values


def joined(separator: str, texts: Sequence[str]) -> Message:
    """Sentences one after the other. Each can still be translated."""
    template = separator.join(f"{{text{k}}}" for k in range(len(texts)))
    return Message(template, **{f"text{k}": text for k, text in enumerate(texts)})


def named_frames(first: int, last: int) -> Message:
    """A range of frames in words."""
    if last > first:
        return Message("frames {first} to {last}", first=first, last=last)
    return Message("frame {number}", number=first)


def listed(names: Sequence[str]) -> str:
    """The names, as many as a report has room for."""
    first, more = ", ".join(names[:LISTED]), len(names) - LISTED
    return Message("{names} and {count} more", names=first, count=more) if more > 0 else first


def translated(text: str, translate: Callable[[str], str]) -> str:
    """A sentence in another language. translate(template): one of Blender's functions, such as `pgettext_iface`.

    Values that are a Message are translated too; names and other texts stay as they are.
    """
    if not isinstance(text, Message):
        return translate(text) if text else text
    values = {
        name: translated(value, translate) if isinstance(value, Message) else value
        for name, value in text.values.items()
    }
    return translate(text.template).format(**values)
