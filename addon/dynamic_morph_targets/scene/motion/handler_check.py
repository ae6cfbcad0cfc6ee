# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether other add-ons move a rig when the frame changes, as spring bones do. A bake does not have that, because no
handler is called for the scene in which it reads the rig: what it read is compared with what the artist is shown.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import bpy
import numpy as np

from ...core.character import Skeleton
from ...core.message import Message
from ..events import others
from ..references import rest_skeleton, rig_of
from ..remembered import opened
from . import rig_motion

EVERY = 8  # frames: a part of a bake's poses is enough to tell
APART = 0.01  # of the rig's size, or of a rotation: bones that are farther from where a bake has them are moved


@dataclass
class ReadPoses:
    """What a bake read of a rig: each bone's transform relative to its parent (B, 3, 4), by frame. first: how far the
    first of these frames was from that when it was shown, which a pose without keys explains. found: what to tell.
    """

    bones: tuple[str, ...]
    frames: dict[int, np.ndarray] = field(default_factory=dict)
    first: np.ndarray | None = None
    found: Message | None = None


def forget(obj: bpy.types.Object) -> None:
    """Another bake of `obj` begins, or its animation was edited since."""
    opened.read_poses.pop(obj.session_uid, None)


def remember(obj: bpy.types.Object, start: int, poses: np.ndarray) -> None:
    """Frames that a bake of `obj` has read, one after the other. poses (F, B, 4, 4): armature space."""
    skeleton = rest_skeleton(rig_of(obj).data)
    read = opened.read_poses.setdefault(obj.session_uid, ReadPoses(skeleton.names))
    read.frames |= {start + k: _local(skeleton, poses[k]) for k in range(-start % EVERY, len(poses), EVERY)}


def look(obj: bpy.types.Object, frame: float, depsgraph: bpy.types.Depsgraph) -> None:
    """Compare what `obj` is shown with at a frame with what the last bake read there, if others have handlers."""
    read, rig = opened.read_poses.get(obj.session_uid), rig_of(obj)
    if read is None or read.found or frame not in read.frames or rig is None or not others():
        return
    skeleton = rest_skeleton(rig.data)
    if skeleton.names != read.bones:
        return
    order = rig_motion.pose_order(rig, skeleton)
    shown = _local(skeleton, rig_motion.pose_matrices(rig.evaluated_get(depsgraph), order))
    apart = shown - read.frames[int(frame)]
    read.first = apart if read.first is None else read.first
    size = np.ptp(skeleton.rest[:, :3, 3], axis=0).max(initial=0.0) or 1.0
    moved = (np.abs(apart - read.first) / [1.0, 1.0, 1.0, size]).max(axis=(1, 2))
    if (moved > APART).any():
        read.found = _message(rig, skeleton.names[int(np.nanargmax(moved))])


def _local(skeleton: Skeleton, pose: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):  # below bones that are scaled to zero
        return skeleton.local_transforms(pose)[:, :3].astype(np.float32)


def _message(rig: bpy.types.Object, bone: str) -> Message:
    names = dict.fromkeys(str(getattr(handler, "__module__", "") or handler) for handler in others())
    return Message(
        "Bone '{bone}' of '{rig}' is moved by an add-on's or script's handler ({names}) when the frame changes, "
        "which the bake does not have: bake it to keyframes (Pose > Animation > Bake Action), and bake again",
        bone=bone,
        rig=rig.name,
        names=", ".join(names),
    )
