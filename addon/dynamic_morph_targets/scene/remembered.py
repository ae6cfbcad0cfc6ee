# SPDX-License-Identifier: GPL-3.0-or-later
"""What is remembered of the file that is open. Objects by Object.session_uid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import bpy

from ..core import states
from ..core.character import Character
from ..core.model.model import Model


@dataclass
class OpenFile:
    """models: by object and content id, the last used last. drafts: models that can be played while those that replace
    them are built, with their characters. bodies: a body's state at the last look, and what looked wrong. cuts: when
    it was last looked for meshes that cut a body, and their names; edits: how often something was moved or edited.
    key_hashes: by shape key and what is hashed of it, its fingerprint and its hash. asked: looks that panels ask
    for, and at what. parts: of a body, in which state they were found, and their shares of its meshes. left_out:
    Actions, of the file that is being saved. read_poses: `read_poses.ReadPoses`.
    """

    models: dict[tuple[int, str], Model] = field(default_factory=dict)
    drafts: dict[int, tuple[Model, Character]] = field(default_factory=dict)
    bodies: dict[int, tuple[tuple, list[Any]]] = field(default_factory=dict)
    cuts: dict[int, tuple[tuple, list[str], list[tuple[str, str]]]] = field(default_factory=dict)
    edits: int = 0
    key_hashes: dict[tuple, tuple] = field(default_factory=dict)
    asked: set[tuple[Callable, int]] = field(default_factory=set)
    left_out: list[bpy.types.Action] = field(default_factory=list)
    parts: dict[int, tuple[int, dict[str, Any]]] = field(default_factory=dict)
    read_poses: dict[int, Any] = field(default_factory=dict)


opened = states.of(OpenFile)
