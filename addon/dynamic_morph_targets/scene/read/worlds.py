# SPDX-License-Identifier: GPL-3.0-or-later
"""Where objects are as Blender evaluates them, in meters; what cannot be computed with is refused."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import bpy
import numpy as np

from ...core.errors import SceneError
from ...core.message import Message
from ..skin import unit_scale
from .sampling_scene import rig_scene

FLAT = 1e-6  # smallest scale over the largest, below which something has no size
GROWN = 0.99  # of its largest size
LARGEST = 1e15  # of the numbers in a transform: from 1e19 on their squares overflow in Blender


@contextmanager
def at_rest(rig: bpy.types.Object) -> Iterator[None]:
    position = rig.data.pose_position
    rig.data.pose_position = "REST"
    try:
        yield
    finally:
        rig.data.pose_position = position


def in_meters(worlds: np.ndarray, unit: float) -> np.ndarray:
    """World transforms (..., 4, 4) of a world in meters instead of Blender units of `unit` meters."""
    return worlds * np.array([unit, unit, unit, 1.0])[:, None]


def not_a_number(name: str, frame: int) -> str:
    return Message(
        "'{name}' has a transform that is not a number at frame {frame}: check its drivers and constraints",
        name=name,
        frame=frame,
    )


def refuse_overflow(transforms: np.ndarray, names: Sequence[str], frame_of: Callable[[int], int]) -> None:
    """Raises SceneError unless all numbers in the transforms (S, n, 4, 4) of S samples can be computed with. names (n):
    of what they move. frame_of(sample): the frame.
    """
    bad = np.argwhere(~(np.abs(transforms) < LARGEST).all(axis=(2, 3)))
    if not len(bad):
        return
    sample, which = bad[0].tolist()
    name, frame = names[which], frame_of(sample)
    if not np.isfinite(transforms[sample, which]).all():
        raise SceneError(not_a_number(name, frame))
    raise SceneError(
        "'{name}' is moved or scaled by more than {most:g} at frame {frame}: check its keyframes, drivers and "
        "constraints",
        name=name,
        most=LARGEST,
        frame=frame,
    )


def world_now(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None = None) -> np.ndarray:
    """The evaluated world transform (4, 4) of an object, meters; depsgraph: as `current_pose`. Raises SceneError."""
    world = np.array(obj.evaluated_get(depsgraph or bpy.context.evaluated_depsgraph_get()).matrix_world)
    refuse_overflow(world[None, None], [obj.name], lambda _: bpy.context.scene.frame_current)
    return in_meters(world, unit_scale())


def worlds_at_start(obj: bpy.types.Object, rig: bpy.types.Object) -> list[np.ndarray]:
    """World transforms of both, meters, when the scene starts: a model that depended on the current frame would become
    outdated by playing. Where one is scaled to zero then, when they first are as large as they become. Raises
    SceneError.
    """
    user = bpy.context.scene
    with rig_scene(obj, rig) as (scene, follower):

        def worlds_at(frame: int) -> list[np.ndarray]:
            scene.frame_set(frame)
            depsgraph = scene.view_layers[0].depsgraph
            worlds = [np.array(moving.evaluated_get(depsgraph).matrix_world) for moving in (follower, rig)]
            for moving, world in zip((obj, rig), worlds, strict=True):
                refuse_overflow(world[None, None], [moving.name], lambda _: frame)
            return worlds

        worlds = worlds_at(user.frame_start)
        if not all(map(_thickness, worlds)):
            every = [worlds_at(frame) for frame in range(user.frame_start, user.frame_end + 1)]
            sizes = [min(map(_thickness, each)) for each in every]
            worlds = next(each for each, size in zip(every, sizes, strict=True) if size >= GROWN * max(sizes))
    for moving, world in zip((obj, rig), worlds, strict=True):
        if not _thickness(world):
            raise SceneError("'{name}' is scaled to zero: give it a size", name=moving.name)
    return [in_meters(world, unit_scale()) for world in worlds]


def _thickness(world: np.ndarray) -> float:
    """The smallest scale of a transform (4, 4); 0 where that is next to nothing of the largest."""
    sizes = np.linalg.svd(world[:3, :3], compute_uv=False)
    return float(sizes[-1]) if sizes[-1] > FLAT * sizes[0] else 0.0
