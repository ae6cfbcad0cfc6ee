# SPDX-License-Identifier: GPL-3.0-or-later
"""The body that is seen at rest: its Basis, and the shape keys that are always on.

Characters of Daz, Human Generator and MPFB are made of such keys, which say who it is: the Basis is somebody else.
"""

from __future__ import annotations

import re
from math import isfinite

import bpy
import numpy as np

from .. import animation
from .mesh_data import VertexGroups, rest_points, target_shape

NOTICED = 0.02  # of the longest side: where no vertex moves farther, the body is as good as its Basis
CUSTOM_PROPERTY = re.compile(r'\["[^"]*"\]')


def body_points(obj: bpy.types.Object, groups: VertexGroups | None = None) -> np.ndarray:
    """Points (V, 3) of the body that is seen at rest, local space. groups: those of `obj`, if they were read already.

    Raises SceneError.
    """
    return sum(shifts(obj, groups).values(), rest_points(obj))


def shifts(obj: bpy.types.Object, groups: VertexGroups | None = None) -> dict[str, np.ndarray]:
    """What the shape keys that are always on add to the points of the Basis, (V, 3) each, by their names. Empty where
    all of them hardly do: setting one needs no new build.
    """
    found = {key.name: key.value * target_shape(obj, key.name, groups) for key in _always_on(obj)}
    if not found or np.linalg.norm(sum(found.values()), axis=1).max(initial=0.0) <= NOTICED * longest_side(
        rest_points(obj)
    ):
        return {}
    return found


def _always_on(obj: bpy.types.Object) -> list:
    """The shape keys with a value that nothing moves, but for those that the add-on plays or that are targets."""
    keys, settings = obj.data.shape_keys, obj.dynamorph
    found = keys.key_blocks[1:] if keys and keys.use_relative else ()
    shown = [key for key in found if key.value and isfinite(key.value) and not key.mute]
    if not shown:
        return []
    others = {target.name for target in settings.targets} | {settings.live.key.name}
    others |= animation.baked_keys(obj) | animation.played_keys(obj)
    return [key for key in shown if key.name not in others and _stands_still(keys, f"{key.path_from_id()}.value")]


def longest_side(points: np.ndarray) -> float:
    """The longest side of the bounding box of points (V, 3)."""
    return float(np.ptp(points, axis=0).max())


def _stands_still(owner: bpy.types.ID, path: str, above: tuple = ()) -> bool:
    """Whether a property has no driver, or one that reads nothing but custom properties that stand still; the value of
    those has no curve. above: the properties that depend on it.
    """
    data = owner.animation_data
    drivers = (curve for curve in data.drivers if curve.data_path == path and not curve.mute) if data else ()
    driver = next((curve.driver for curve in drivers), None)
    if driver is None:
        return not data or path not in {curve.data_path for curve in animation.played(data)}
    calls = driver.type == "SCRIPTED" and not driver.is_simple_expression  # perhaps what is different at each frame
    if (owner, path) in above or calls or "frame" in driver.expression:
        return False
    return all(
        variable.type == "SINGLE_PROP"
        and target.id is not None
        and CUSTOM_PROPERTY.fullmatch(target.data_path)
        and _stands_still(target.id, target.data_path, (*above, (owner, path)))
        for variable in driver.variables
        for target in variable.targets
    )
