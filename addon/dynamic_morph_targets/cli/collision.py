# SPDX-License-Identifier: GPL-3.0-or-later
"""The options of a bake about what stops the skin."""

from __future__ import annotations

import argparse

import bpy

from ..core.errors import InputError
from ..run.bake import bake_time
from ..scene.motion import run_settings
from . import names
from .parsers import name_of


def add_options(bake: argparse.ArgumentParser) -> None:
    """Those that are not named after their property."""
    bake.add_argument("--collision", action=argparse.BooleanOptionalAction,
                      help="let the objects that have Blender's Collision stop the skin")  # fmt: skip
    bake.add_argument("--self-collision", action=argparse.BooleanOptionalAction,
                      help="let the skin stop itself too; turns --collision on")  # fmt: skip
    bake.add_argument(
        "--collection", type=name_of, metavar="NAME", help="only those in this collection; turns --collision on"
    )
    bake.add_argument("--exclude", type=name_of, metavar="GROUP", help="a vertex group of skin that ignores objects")


def apply(args: argparse.Namespace, obj: bpy.types.Object, simulates: bool) -> None:
    """Apply the options that are given to the object, and say how long a simulation takes. Raises InputError."""
    chosen, settings = vars(args), obj.dynamorph.collision
    name, on = chosen.get("collection"), chosen.get("collision")
    if name is not None:
        if on is False:
            raise InputError("--collection turns collision on: leave out --no-collision")
        settings.collection = names.collection(name, "--collection")
        on = True
    own = chosen.get("self_collision")
    if own:
        if on is False:
            raise InputError("--self-collision turns collision on: leave out --no-collision")
        on = True
    if own is not None:
        settings.use_self = own
    if on is not None:
        settings.use = on
    group = chosen.get("exclude")
    if group is not None:
        names.check_group(obj, group, "--exclude")
        obj.dynamorph.excluded_group = group
    settings.use_friction |= chosen.get("friction") is not None
    if chosen.get("solver") == "reduced" and chosen.get("bake_full") is None:
        settings.bake_full = False
    if simulates and settings.use and run_settings.bake_solver(obj) == "FULL":
        time = bake_time.expected(obj, args.frames, args.substeps)
        print(f"{obj.name}: colliding bodies are baked in Full Quality: {time}", flush=True)
