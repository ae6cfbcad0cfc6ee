# SPDX-License-Identifier: GPL-3.0-or-later
"""What places and shapes the colliders of a soft skin, as hashes, by which a bake knows that one has changed. Reads
meshes, so not at every draw.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from contextlib import suppress

import bpy
import numpy as np

from ...core import records
from ...core.errors import RecordError
from .. import animation
from ..plain import plain
from ..read.mesh_data import mesh_topology
from ..references import key_points
from .colliders import met

PLACE = (
    "location", "rotation_mode", "rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale",
    "delta_location", "delta_rotation_euler", "delta_rotation_quaternion", "delta_scale", "matrix_parent_inverse",
    "parent_type", "parent_bone",
)  # fmt: skip
SETTINGS = ("use", "cloth_friction", "use_culling")  # of Blender's Collision, that count
OF_OTHERS = {"colliders", "together", "content_id", "version"}  # of a bake's inputs; the last two are of its record
SHOWN = ("name", "show_expanded", "is_active")  # of modifiers and constraints, that do not


def states(obj: bpy.types.Object, together: Sequence[str] = ()) -> list[list[str]]:
    """[name, hash of what moves it, hash of what shapes it] of each of `colliders.met`. Values that are animated are
    not in it, because they change with the frame, but their animation is. together: names of those that were baked with
    it, which what their bakes were made from shapes.
    """
    found = met(obj, together)
    shapes = (_recorded(other) if other.name in together else _hash(_shaped(other)) for other in found)
    return [[other.name, _hash(_placed(other)), shape] for other, shape in zip(found, shapes, strict=True)]


def _recorded(other: bpy.types.Object) -> str:
    """`input_hash` of its bake, '' without one."""
    with suppress(RecordError):
        return input_hash(records.bake_inputs(other.dynamorph.bake.inputs))
    return ""


def input_hash(inputs: dict) -> str:
    """Of the inputs of a bake, but for those that are of other bodies."""
    own = {name: inputs[name] for name in sorted(inputs) if name not in OF_OTHERS}
    return _hash(iter([json.dumps(own, sort_keys=True)]))


def _hash(parts: Iterator) -> str:
    digest = hashlib.blake2b(digest_size=8)
    for part in parts:
        digest.update(part if isinstance(part, bytes) else repr(part).encode())
    return digest.hexdigest()


def _placed(other: bpy.types.Object) -> Iterator:
    for mover in _movers(other):
        moving = set(animation.moved_paths(mover))
        yield [_values(mover, name) for name in PLACE if name not in moving]
        for constraint in mover.constraints:
            yield _settings(constraint, moving)
        yield animation.animation_hash(mover.animation_data)


def _shaped(other: bpy.types.Object) -> Iterator:
    mesh, moving = other.data, set(animation.moved_paths(other))
    points = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", points.ravel())
    yield points.tobytes()
    yield mesh_topology(mesh)
    for modifier in other.modifiers:
        yield _settings(modifier, moving)
        moved_by = getattr(modifier, "object", None)
        yield from _placed(moved_by) if moved_by else ()
    if other.collision:
        yield [getattr(other.collision, name) for name in SETTINGS if f"collision.{name}" not in moving]
    keys = mesh.shape_keys
    if keys:
        moving = set(animation.moved_paths(keys))
        for block in keys.key_blocks:
            path = f"{block.path_from_id()}.value"
            yield [block.name, block.mute, 0.0 if path in moving else block.value]
            yield key_points(block).tobytes()
        yield animation.animation_hash(keys.animation_data)


def _movers(other: bpy.types.Object) -> list:
    """The object, its parents, and what their constraints follow."""
    found, waiting = [], [other]
    while waiting:
        mover = waiting.pop()
        if mover is not None and mover not in found:
            found.append(mover)
            waiting += [mover.parent, *(getattr(constraint, "target", None) for constraint in mover.constraints)]
    return found


def _settings(owner: bpy.types.Modifier | bpy.types.Constraint, moving: set[str]) -> dict:
    """The plain settings of a modifier or a constraint that are not animated."""
    path = owner.path_from_id()
    names = (prop.identifier for prop in owner.bl_rna.properties)
    return plain(owner, (*SHOWN, *(name for name in names if f"{path}.{name}" in moving)))


def _values(mover: bpy.types.Object, name: str) -> str | list:
    value = getattr(mover, name)
    return value if isinstance(value, str) else np.array(value).tolist()
