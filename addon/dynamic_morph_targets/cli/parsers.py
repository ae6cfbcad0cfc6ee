# SPDX-License-Identifier: GPL-3.0-or-later
"""What the values of options may be: parsers for argparse."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path

import bpy


def number(setting: bpy.types.Property) -> Callable[[str], float]:
    """A parser that refuses numbers which Blender would silently clamp to the setting's range."""

    def parse(text: str) -> float:
        try:
            value: float = {"INT": int, "FLOAT": float}[setting.type](text)
        except ValueError as error:
            kind = "whole number" if setting.type == "INT" else "number"
            raise argparse.ArgumentTypeError(f"{text!r} is no {kind}, such as {setting.default:g}") from error
        if not setting.hard_min <= value <= setting.hard_max:
            raise argparse.ArgumentTypeError(f"{text} is not between {setting.hard_min:g} and {setting.hard_max:g}")
        return value

    return parse


def path_of(text: str) -> Path:
    """A parser that refuses what no system takes as the name of a file."""
    try:
        if text and b"\0" not in os.fsencode(text):
            return Path(text)
    except UnicodeEncodeError:
        pass
    raise argparse.ArgumentTypeError(f"{text!r} cannot be the name of a file")


def file_of(text: str) -> Path:
    """A parser that refuses the root of a disk as well, which has no name."""
    path = path_of(text)
    if path.is_absolute() and not path.name:
        raise argparse.ArgumentTypeError(f"{text!r} cannot be the name of a file")
    return path


def name_of(text: str) -> str:
    """A parser that refuses what Blender cannot have as a name."""
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise argparse.ArgumentTypeError(f"{text!a} is not UTF-8, which all names in Blender are") from error
    return text
