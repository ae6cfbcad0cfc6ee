# SPDX-License-Identifier: GPL-3.0-or-later
"""What a command line names: a scene of the file, soft skins, targets, vertex groups, collections."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches

import bpy

from ..core.errors import InputError
from ..core.message import listed
from ..scene import keyed, skin
from ..write.reconcile import reconcile


def unknown(text: str, name: str, names: Sequence[str]) -> InputError:
    """The error for a name that does not exist. text: ends where the names that do exist belong."""
    by_letters = {each.casefold(): each for each in names}
    close = get_close_matches(name.casefold(), by_letters, n=1)
    meant = f". Did you mean '{by_letters[close[0]]}'?" if close else ""
    return InputError(f"{text} {listed(names) or 'none'}{meant}")


@contextmanager
def scene(args: argparse.Namespace) -> Iterator[None]:
    """Let `bpy.context` have the scene that --scene names, if it does. Raises InputError."""
    if not args.scene:
        yield
        return
    found = next((each for each in bpy.data.scenes if each.name == args.scene and not each.library), None)
    if found is None:
        there = [each.name for each in bpy.data.scenes if not each.library]
        raise unknown(f"--scene: the file has no scene named '{args.scene}': it has", args.scene, there)
    with skin.SceneHandle(found.session_uid, found.name, found.view_layers[0].name).as_context():
        yield


def objects(args: argparse.Namespace) -> list[bpy.types.Object]:
    """The objects that --object or --all name. Raises InputError."""
    shown = bpy.context.scene
    found = skin.soft_skins(shown.objects)
    if not args.object:
        if not found:
            raise InputError(f"scene '{shown.name}' has no soft skin: press Add Soft Skin in Blender first")
        return _reconciled(found)
    for name in args.object:
        if name not in shown.objects:
            text = f"scene '{shown.name}' has no object named '{name}': its soft skins are"
            raise unknown(text, name, [each.name for each in found])
    return _reconciled([shown.objects[name] for name in dict.fromkeys(args.object)])


def _reconciled(found: list) -> list[bpy.types.Object]:
    for obj in skin.soft_skins(found):
        reconcile(obj)
    return found


def target(obj: bpy.types.Object, name: str, option: str) -> bpy.types.PropertyGroup:
    """The target of this name. option: that names it. Raises InputError."""
    targets = obj.dynamorph.targets
    if name not in targets:
        raise unknown(f"{option}: '{obj.name}' has no target named '{name}': it has", name, targets.keys())
    return targets[name]


def check_group(obj: bpy.types.Object, name: str | None, option: str) -> None:
    """Raises InputError unless the object has the vertex group, if one is named."""
    if name and name not in obj.vertex_groups:
        text = f"{option}: '{obj.name}' has no vertex group named '{name}': it has"
        raise unknown(text, name, obj.vertex_groups.keys())


def collection(name: str, option: str) -> bpy.types.Collection:
    """The collection of this name. Raises InputError."""
    if name not in bpy.data.collections:
        raise unknown(f"{option}: the file has no collection named '{name}': it has", name, bpy.data.collections.keys())
    return bpy.data.collections[name]


def check_not_keyed(obj: bpy.types.Object, path: str, option: str) -> None:
    """Raises InputError for a value that keys or drivers would replace at each frame."""
    if path in (each.path for each in keyed.settings(obj)):
        raise InputError(f"{option}: '{obj.name}' has keys or a driver on that, which would replace it: delete them")
