# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether other add-ons move a rig when the frame changes, as spring bones do. A bake does not see that, because no
handler is called for the scene in which it samples the rig.
"""

from __future__ import annotations

import bpy
import numpy as np

from ...core.message import Message
from .. import events
from ..references import rest_skeleton, rig_of
from . import rig_motion

TRIED = (0.25, 0.5, 0.75)  # of a shot
APART = 0.01  # of the rig's size, or of a rotation: bones that are farther from where they are sampled are moved


def warnings(obj: bpy.types.Object, first: int, last: int) -> list[Message]:
    """That a bone of `obj` is elsewhere at some frames of a shot when others' handlers have been called. Where there
    are some, the scene goes to these frames and back. Raises SceneError.
    """
    handlers = events.others()
    if not handlers or events.render_runs():
        return []
    scene, rig = bpy.context.scene, rig_of(obj)
    skeleton = rest_skeleton(rig.data)
    order, tried = rig_motion.pose_order(rig, skeleton), [round(first + part * (last - first)) for part in TRIED]
    sampled = [rig_motion.sample_rig(obj, frame, frame, 1).pose[0] for frame in tried]
    shown, now = [], (scene.frame_current, scene.frame_subframe)
    with events.without_ours():
        for frame in tried:
            scene.frame_set(frame)
            evaluated = rig.evaluated_get(bpy.context.evaluated_depsgraph_get())
            shown.append(rig_motion.pose_matrices(evaluated, order))
        scene.frame_set(now[0], subframe=now[1])
    size = np.ptp(skeleton.rest[:, :3, 3], axis=0).max(initial=0.0) or 1.0
    apart = np.abs(np.array(shown) - np.array(sampled))[:, :, :3] / [1.0, 1.0, 1.0, size]
    moved = apart.max(axis=(0, 2, 3)) > APART
    if not moved.any():
        return []
    names = dict.fromkeys(str(getattr(handler, "__module__", "") or handler) for handler in handlers)
    return [
        Message(
            "Bone '{bone}' of '{rig}' is moved by an add-on's or script's handler ({names}) when the frame changes, "
            "which the bake does not have: bake it to keyframes (Pose > Animation > Bake Action), and bake again",
            bone=skeleton.names[int(moved.argmax())],
            rig=rig.name,
            names=", ".join(names),
        )
    ]
