# SPDX-License-Identifier: GPL-3.0-or-later
"""Animation that a simulation does not follow: drivers that ask for more than there is, and settings that are keyed.
Reads only, and fast enough for a panel that draws.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from functools import lru_cache
from types import CodeType, FunctionType
from typing import Any

import bpy

from ...core.message import Message
from .. import animation
from .problem import Problem

SHOWN = 60  # characters of an expression
SETTINGS = "dynamorph."  # how the paths of an object's settings begin


def standing_drivers(obj: bpy.types.Object, armatures: Iterable[bpy.types.Object]) -> Iterator[Problem]:
    """Drivers of what moves a skin, the first of each kind, that stand still in a bake: the rig is sampled in a scene
    of its own, and they read another one, or ask Blender by Python.
    """
    owners = [owner for each in armatures for owner in (each, each.data, *_parents(each))]
    owners += obj, *_parents(obj)
    data = [owner.animation_data for owner in dict.fromkeys(owners) if owner.animation_data]
    curves = [curve for each in data for curve in each.drivers if not curve.mute]
    for curve in [curve for curve in curves if _scene_paths(curve.driver)][:1]:
        yield Problem(
            "A driver of '{name}' reads '{path}' of the scene, which does not change during a bake: write 'frame' in "
            "its expression, or keep the property on the armature",
            name=curve.id_data.name,
            path=_scene_paths(curve.driver)[0],
        )
    for curve in [curve for curve in curves if _needs_blender(curve.driver)][:1]:
        expression = curve.driver.expression
        yield Problem(
            "A driver of '{name}', \"{expression}\", asks Blender by Python for what does not change during a bake: "
            "write 'frame' in its expression, or use variables",
            name=curve.id_data.name,
            expression=expression if len(expression) <= SHOWN else f"{expression[:SHOWN]}...",
        )


def _parents(obj: bpy.types.Object) -> list:
    found = []
    while obj.parent and obj.parent not in found:
        obj = obj.parent
        found.append(obj)
    return found


def _scene_paths(driver: bpy.types.Driver) -> list[str]:
    """The properties of a scene that a driver reads."""
    return [
        variable.targets[0].data_path
        for variable in driver.variables
        if variable.type == "CONTEXT_PROP" or any(target.id_type == "SCENE" for target in variable.targets)
    ]


def _needs_blender(driver: bpy.types.Driver) -> bool:
    needs_python = driver.type == "SCRIPTED" and not driver.is_simple_expression
    return needs_python and any(map(_asks_blender, _functions(driver.expression)))


def _functions(expression: str) -> list[Any]:
    """What the names in an expression stand for that are of drivers' namespace."""
    known = bpy.app.driver_namespace
    return [known[name] for name in _names(expression) if name in known]


@lru_cache(maxsize=4096)
def _names(expression: str) -> tuple[str, ...]:
    try:
        tree = ast.parse(expression.strip(), mode="eval")
    except (SyntaxError, ValueError):
        return ()
    return tuple(node.id for node in ast.walk(tree) if isinstance(node, ast.Name))


def _asks_blender(value: Any, known: tuple = ()) -> bool:
    """Whether it is Blender's Python module, or a function that uses that one."""
    if value is bpy:
        return True
    if not isinstance(value, FunctionType) or value in known:
        return False
    inside = [cell.cell_contents for cell in value.__closure__ or () if cell.cell_contents is not value]
    used = [value.__globals__[name] for name in _code_names(value.__code__) if name in value.__globals__]
    return any(_asks_blender(each, (*known, value)) for each in (*inside, *used))


def _code_names(code: CodeType) -> set[str]:
    """The global names in a function, and in those within it."""
    return set(code.co_names).union(*(_code_names(each) for each in code.co_consts if isinstance(each, CodeType)))


def keyed_settings(obj: bpy.types.Object) -> Iterator[Problem]:
    """Settings of a soft skin that curves and drivers name, by an earlier file or a script, although a simulation has
    one value of each. Blender keeps such curves and does not play them.
    """
    props = {path: _property(obj, path) for path in animation.moved_paths(obj) if path.startswith(SETTINGS)}
    names = [Message(prop.name) if prop else path for path, prop in props.items() if not prop or not prop.is_animatable]
    for setting in dict.fromkeys(names):
        yield Problem(
            "'{name}': keys and drivers of {setting} have no effect, because a simulation has one value for all "
            "frames: delete them",
            name=obj.name,
            setting=setting,
        )


def _property(obj: bpy.types.Object, path: str) -> bpy.types.Property | None:
    owner, _, name = path.rpartition(".")
    try:
        return obj.path_resolve(owner).bl_rna.properties[name]
    except (ValueError, KeyError, AttributeError):  # it is gone
        return None
