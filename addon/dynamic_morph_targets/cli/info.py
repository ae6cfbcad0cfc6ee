# SPDX-License-Identifier: GPL-3.0-or-later
"""The command info: what a file holds."""

from __future__ import annotations

import argparse

import bpy

from ..core import engine, errors
from ..run.bake import expected_error
from ..scene import skin
from ..scene.character import extract
from ..scene.store import model_store, staleness
from . import names
from .help import without_buttons


def run_info(args: argparse.Namespace) -> None:
    for obj in names.objects(args):
        settings = obj.dynamorph
        print(f"{obj.name}: {', '.join(target.name for target in settings.targets)}")
        print(f"  model: {settings.model.summary or 'none'}")
        expected = expected_error.known(obj)
        if expected is not None:
            print(f"  expected error: {100 * expected:.0f} % of the motion")
        try:
            reasons = "; ".join(model_store.stale_reasons(obj, extract.character(obj))) or "up to date"
        except engine.expected_errors() as error:
            reasons = without_buttons(errors.sentence(error))
        print(f"  state: {reasons}")
        print(f"  files beside the .blend: {', '.join(_files(obj)) or 'none'}")
        if not settings.bake.exists:
            print("  bake: none")
            continue
        print(f"  bake: {len(settings.bake.keys)} keys, {settings.bake.summary}")
        print(f"  bake made from {settings.bake.content_id[:12]}, result {settings.bake.digest[:12]}")
        staleness.look_at_animation(obj)
        staleness.look_at_colliders(obj)
        staleness.look_for_caches(obj)
        print(f"  bake state: {'; '.join(staleness.outdated(obj)) or 'up to date'}")


def _files(obj: bpy.types.Object) -> list[str]:
    """The names of the files that a soft skin needs, and what follows it: of its model and of its point caches."""
    content_id = obj.dynamorph.model.content_id
    model = [f"{content_id}.dynamorph"] if content_id and model_store.PACKED not in obj else []
    return model + [
        each.dynamorph.bake.cache for each in (obj, *skin.shown_attachments(obj)) if each.dynamorph.bake.cache
    ]
