# SPDX-License-Identifier: GPL-3.0-or-later
"""Targets that physics sculpts: the body is bent from rest to a pose, and its shape there becomes a target's."""

from __future__ import annotations

from contextlib import suppress
from functools import partial

import bpy
import numpy as np
from mathutils import Matrix, Quaternion

from ...core.errors import ModelFileError
from ...core.geometry import turned
from ...core.message import Message
from ...core.motion import posed
from ...core.motion.posed import PosedShape
from ...scene.check import checks
from ...scene.read.worlds import world_now
from ...scene.skin import find
from ...scene.store import model_store
from ...write.authoring import targets
from ...write.bake import muting
from ..work.task import Chunks, elsewhere

STEP = np.radians(11.0)  # by which a bone turns from one solution to the next, at most


def shape(session_uid: int, local: np.ndarray) -> Chunks[PosedShape]:
    """What physics makes of an object in a pose (B, 4, 4). Raises SceneError, and what the engine raises."""
    obj = find(session_uid)
    yield 0.0, Message("Reading '{name}'", name=obj.name)
    character, previous = targets.authored(obj), None
    with suppress(ModelFileError):  # then its cage is built
        previous = model_store.load_model(obj)
    worlds = world_now(checks.armature_modifier(obj).object), world_now(obj)
    work = partial(posed.shape_in_pose, character, path_to(local), worlds, previous)
    return (yield from elsewhere(work, Message("Bending '{name}'", name=obj.name), obj.name, reports=True))


def path_to(local: np.ndarray) -> np.ndarray:
    """Local transforms (S, B, 4, 4) from near rest to a pose (B, 4, 4)."""
    rest = np.broadcast_to(np.eye(4), local.shape)
    count = max(int(np.ceil(turned(rest, local).max(initial=0.0) / STEP)), 1)
    parts = [Matrix(matrix).decompose() for matrix in local]
    path = []
    for step in range(1, count):
        t = step / count
        path.append([
            Matrix.LocRotScale(t * location, Quaternion().slerp(rotation, t), scale.lerp((1.0, 1.0, 1.0), 1.0 - t))
            for location, rotation, scale in parts
        ])  # fmt: skip
    return np.array([*path, local])


def write(obj: bpy.types.Object, pose: targets.Pose, name: str, found: PosedShape) -> list[Message]:
    """Make what was found the shape of the target `name` in that pose; a new one if there is none. It is selected, and
    shown in its pose. Returns warnings. Raises SceneError.
    """
    place = obj.dynamorph.targets.find(name)
    muting.show_target(obj, "")
    if place > 0:
        obj.dynamorph.active_target_index = place
        targets.sculpt_anew(targets.sculpted_key(obj), found.shape)
    else:
        name = targets.add_in_pose(obj, name, found.shape, pose, found.shape).name
    targets.learn(obj, name, is_new=True)
    return _warnings(found)


def _warnings(found: PosedShape) -> list[Message]:
    out = []
    if found.overlap:
        text = "The bones leave no room: at '{bone}' the skin is still {depth:.0f} mm in itself. Bend it less"
        out.append(Message(text, bone=found.overlaps, depth=1000 * found.overlap))
    if found.plain:
        text = "At '{bone}' the skin folds so far that plain skinning stays. Sculpt it there, or spread the weights"
        out.append(Message(text, bone=found.plain))
    return out
