# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's texts in other languages, for Blender's own translation.

`translations` has a file for each language, named by its code: English texts with their translations. What is formatted
into a text stands in {braces} in both. Blender looks a text up here when its own translations do not have it.
"""

from __future__ import annotations

import json
from pathlib import Path

import bpy

from ..scene.properties import model_properties

FOLDER = Path(__file__).parents[1] / "translations"
# Of Blender's translations: the labels of buttons have one of their own.
CONTEXTS = ("*", "Operator", model_properties.CONTEXT)


def read(path: Path) -> dict[str, str]:
    return json.loads(path.read_text(encoding="utf-8"))


def register() -> None:
    bpy.app.translations.register(
        __package__,
        {
            path.stem: {(context, text): known for text, known in read(path).items() for context in CONTEXTS}
            for path in FOLDER.glob("*.json")
        },
    )


def unregister() -> None:
    bpy.app.translations.unregister(__package__)
