# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether size, mass, shape and weights of a body look intended, before it is a soft skin and after. Reads only.

Reading a mesh takes too long for a panel that draws. So `known` returns what `look` found last, and asks for another
look (`run/tools/watch`) when the body is another than it was then.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import bpy
import numpy as np

from ...core.errors import SceneError
from ...core.geometry import signed_volume
from ...core.settings import Material
from .. import events
from ..read.identity import longest_side
from ..read.mesh_data import stretch
from ..read.source import Source
from ..remembered import opened
from ..skin import unit_scale
from ..skinning import Skinning
from .problem import Problem

PLAUSIBLE = (0.05, 4.0)  # meters, the longest side; a body of another size is probably unintended
HEAVIEST = 2000.0  # kg; a heavier body is probably unintended
PERSON = 1.7  # meters; what a fix makes of an implausible size


def known(skinning: Skinning) -> list[Problem]:
    """What the last look at a body found. Reads no mesh: fit for drawing."""
    obj = skinning.obj
    if not skinning.modifiers:
        return []
    state, found = opened.bodies.get(obj.session_uid, ((), []))
    if obj.mode != "OBJECT":  # what is edited, sculpted or painted is looked at afterward
        return found
    if state != _state(skinning):
        events.emit(events.Event.LOOK_ASKED, look, obj)
        return []
    return found


def look(obj: bpy.types.Object) -> list[Problem]:
    """Read the body of `obj`; returns what looks unintended, which is also what `known` returns from now on."""
    skinning, found = Skinning.of(obj), []
    if skinning.modifiers:
        with suppress(SceneError):  # weights that are not numbers, which a build refuses
            found = list(unintended(Source.of(skinning), mesh_points(obj), stretch(_world(obj))))
    opened.bodies[obj.session_uid] = _state(skinning), found
    return found


def outdate(mesh: bpy.types.Mesh) -> None:
    """The mesh was edited: its bodies are looked at again before anything is said about them."""
    for uid, (state, found) in opened.bodies.items():
        if state[0] == mesh.session_uid:
            opened.bodies[uid] = (mesh.session_uid,), found


def unintended(source: Source, points: np.ndarray, to_bind: np.ndarray) -> Iterator[Problem]:
    """points (V, 3): of the mesh, local space, maybe in Edit Mode; to_bind: as of `Character`, maybe at this frame."""
    yield from _size(source, points @ to_bind.T)
    count = int(source.left_behind.sum())
    if count:
        yield Problem(
            "{count} of the {total} vertices of '{name}' have no bone weight and stay behind when the armature "
            "moves: weight them",
            "WEIGHT_LIKE_NEAREST",
            count=count,
            total=len(points),
            name=source.obj.name,
        )


def _size(source: Source, points: np.ndarray) -> Iterator[Problem]:
    """points (V, 3): in meters."""
    if not len(points):
        return
    obj, size = source.obj, longest_side(points)
    targets = obj.dynamorph.targets
    mass = (targets[0].density if targets else Material.density) * abs(signed_volume(points, source.triangles))
    if size < PLAUSIBLE[0]:
        yield Problem(
            "'{name}' is {size:.3g} m long and will move like something of that size: check the scale",
            "PERSON_SIZE",
            name=obj.name,
            size=size,
        )
    elif size > PLAUSIBLE[1] or mass > HEAVIEST:
        yield Problem(
            "'{name}' is {size:.3g} m long, weighs {mass:,.0f} kg and will move like something of that size: check "
            "the scale",
            "PERSON_SIZE",
            name=obj.name,
            size=size,
            mass=mass,
        )


def size_now(obj: bpy.types.Object) -> float:
    """The longest side of the body of `obj`, meters."""
    return longest_side(mesh_points(obj) @ stretch(_world(obj)).T)


def mesh_points(obj: bpy.types.Object) -> np.ndarray:
    """The points (V, 3) of the mesh, also in Edit Mode, which hides the attribute."""
    points = np.empty((len(obj.data.vertices), 3), np.float32)
    obj.data.vertices.foreach_get("co", points.ravel())
    return points.astype(np.float64)


def _world(obj: bpy.types.Object) -> np.ndarray:
    return unit_scale() * np.array(obj.matrix_world)


def _state(skinning: Skinning) -> tuple:
    """What a look depends on and is quickly read. Edits of the mesh are not among it: they call `outdate`."""
    obj, targets = skinning.obj, skinning.obj.dynamorph.targets
    rigs = tuple(modifier.object.data.session_uid for modifier in skinning.modifiers)
    scale = tuple(round(side, 5) for side in obj.matrix_world.to_scale())
    density = targets[0].density if targets else 0.0
    counts = len(obj.data.vertices), len(obj.vertex_groups)
    return obj.data.session_uid, obj.name, *counts, rigs, scale, unit_scale(), density
