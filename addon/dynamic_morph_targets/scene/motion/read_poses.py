# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a rig that is shown is where its bake has read it. Where it is not, something moves it that no hash of its
animation tells, or that a bake does not have: handlers of other add-ons, which are not called for the scene in which a
bake reads it, and drivers that ask Blender by Python.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import bpy
import numpy as np

from ...core.character import Skeleton
from ...core.message import Message
from ...core.motion.rig_samples import RigSamples
from ..events import others
from ..read.worlds import world_now
from ..references import rest_skeleton, rig_of
from ..remembered import opened
from . import rig_motion

KEPT = 2**26  # bytes of the poses of a bake; the frames of a longer one are not compared
APART = 0.01  # of the rig's size, or of a rotation: what is farther from where a bake has it has moved


@dataclass
class ReadPoses:
    """What a bake has read, by frame (n, 3, 4): each bone's transform relative to its parent, and the worlds of the
    armature and of the mesh. names (n,): of these. found: what to tell.
    """

    names: tuple[str, ...]
    frames: dict[int, np.ndarray] = field(default_factory=dict)
    found: Message | None = None


def forget(obj: bpy.types.Object) -> None:
    """Another bake of `obj` begins, or its animation was edited since."""
    opened.read_poses.pop(obj.session_uid, None)


def remember(obj: bpy.types.Object, start: int, samples: RigSamples) -> None:
    """Frames that a bake of `obj` has read, one after the other from `start` on."""
    rig = rig_of(obj)
    skeleton = rest_skeleton(rig.data)
    read = opened.read_poses.setdefault(obj.session_uid, ReadPoses((*skeleton.names, rig.name, obj.name)))
    most = KEPT // (48 * len(read.names))
    for frame, each in enumerate(zip(samples.pose, samples.rig_world, samples.object_world, strict=True), start):
        if len(read.frames) < most:
            read.frames[frame] = _rows(skeleton, *each)


def look(obj: bpy.types.Object, frame: float, depsgraph: bpy.types.Depsgraph) -> None:
    """Compare where the rig of `obj` is shown at a frame with where the last bake has read it there."""
    read, rig = opened.read_poses.get(obj.session_uid), rig_of(obj)
    if read is None or read.found or frame not in read.frames or rig is None or rig.data.pose_position == "REST":
        return
    skeleton = rest_skeleton(rig.data)
    if (*skeleton.names, rig.name, obj.name) != read.names:
        return
    pose = rig_motion.pose_matrices(rig.evaluated_get(depsgraph), rig_motion.pose_order(rig, skeleton))
    rig_world = world_now(rig, depsgraph)
    size = np.ptp(skeleton.rest[:, :3, 3], axis=0).max(initial=0.0) or 1.0
    apart = np.abs(_rows(skeleton, pose, rig_world, world_now(obj, depsgraph)) - read.frames[int(frame)])
    apart[-2:] /= np.linalg.norm(rig_world[:3, 0]) or 1.0
    apart[:, :, 3] /= size
    moved = apart.max(axis=(1, 2))
    if (moved > APART).any():
        read.found = _message(obj, read.names[int(np.nanargmax(moved))])


def _rows(skeleton: Skeleton, pose: np.ndarray, rig_world: np.ndarray, object_world: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):  # below bones that are scaled to zero
        local = skeleton.local_transforms(pose)
    return np.concatenate([local, rig_world[None], object_world[None]])[:, :3].astype(np.float32)


def _message(obj: bpy.types.Object, moved: str) -> Message:
    names = dict.fromkeys(str(getattr(handler, "__module__", "") or handler) for handler in others())
    text = (
        "'{moved}' is not where the bake of '{name}' has it: bake again. If that does not help, a driver or something "
        "else moves it that a bake does not have: bake it to keyframes (Pose > Animation > Bake Action)"
    )
    if names:
        text = (
            "'{moved}' is not where the bake of '{name}' has it: bake again. If that does not help, an add-on's or "
            "script's handler moves it when the frame changes ({handlers}), which a bake does not have: bake it to "
            "keyframes (Pose > Animation > Bake Action)"
        )
    return Message(text, moved=moved, name=obj.name, handlers=", ".join(names))
