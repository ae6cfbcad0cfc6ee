# SPDX-License-Identifier: GPL-3.0-or-later
"""Control bones, which artists pose and select in rigs such as Rigify's: which deforming bones follow them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy
import numpy as np
from mathutils import Matrix

from ...core.errors import SceneError
from ...core.geometry import turned
from ...core.message import listed
from ...scene import references
from ...scene.check import checks
from ...scene.motion import rig_motion
from ...scene.read.sampling_scene import rig_scene
from . import targets

TURN = np.radians(20.0)
MOVES = (  # that are tried in turn, in a bone's own space, until something follows
    Matrix.Rotation(TURN, 4, (1.0, 0.0, 0.8)),  # a bend
    Matrix.Rotation(TURN, 4, "Y"),  # a twist
    Matrix.Translation((0.2, 0.3, 0.25)),  # bone lengths: of what others reach for
)
FOLLOWS = 0.25  # of that turn, from which a bone follows
CHANNELS = ("location", "rotation_quaternion", "rotation_euler", "rotation_axis_angle", "scale")


def bent_by_selected(obj: bpy.types.Object) -> list[str]:
    """The selected pose bones of the rig of `obj`; in the place of those that do not deform it, the deforming bones
    that bend when they are moved, if some do. Empty if none is selected. Raises SceneError.
    """
    return _with_followers(obj, along=False) or targets.selected_bones(checks.skinned(obj).rig)


def moved_by_selected(obj: bpy.types.Object) -> list[str]:
    """The same, with all the deforming bones that move along. Some must."""
    chosen, found = targets.selected_bones(checks.skinned(obj).rig), _with_followers(obj, along=True)
    if chosen and not found:
        raise SceneError(
            "The selected bones ({bones}) move no bone that deforms '{name}': select others",
            bones=listed(chosen),
            name=obj.name,
        )
    return found


def _with_followers(obj: bpy.types.Object, along: bool) -> list[str]:
    """along: as in `_following`."""
    skinning = checks.skinned(obj)
    rig = skinning.rig
    chosen = targets.selected_bones(rig)
    deforming = [bone.name for bone in skinning.bones(rig)]
    controls = [name for name in chosen if name not in deforming]
    if not controls:
        return chosen
    following = _following(obj, rig, controls, along)
    return [name for name in deforming if name in chosen or name in following]


def _following(obj: bpy.types.Object, rig: bpy.types.Object, controls: list[str], along: bool) -> set[str]:
    """The bones that turn with the controls. along: also those that only their parents take along. The armature is
    posed to find out, where the artist does not see it, and restored.
    """
    skeleton = references.rest_skeleton(rig.data)
    order = rig_motion.pose_order(rig, skeleton)
    now = bpy.context.scene
    with unchanged_pose(rig), rig_scene(obj, rig) as (scene, _follower):
        scene.frame_set(now.frame_current, subframe=now.frame_subframe)
        layer = scene.view_layers[0]
        bones = [rig.pose.bones[name] for name in controls]
        bases = [bone.matrix_basis.copy() for bone in bones]

        def pose() -> np.ndarray:
            layer.update()
            found = rig_motion.pose_matrices(rig.evaluated_get(layer.depsgraph), order)
            return found if along else skeleton.local_transforms(found)

        before = pose()
        for move in MOVES:
            for bone, basis in zip(bones, bases, strict=True):
                bone.matrix_basis = basis @ Matrix.LocRotScale(move.translation * bone.length, move.to_3x3(), None)
            angles = turned(before, pose())
            found = {name for name, angle in zip(skeleton.names, angles, strict=True) if angle > FOLLOWS * TURN}
            if found - set(controls):
                return found
    return set()


@contextmanager
def unchanged_pose(rig: bpy.types.Object) -> Iterator[None]:
    """Restores the bones' own channels to the last bit."""
    before = [[tuple(getattr(bone, channel)) for channel in CHANNELS] for bone in rig.pose.bones]
    try:
        yield
    finally:
        for bone, values in zip(rig.pose.bones, before, strict=True):
            for channel, value in zip(CHANNELS, values, strict=True):
                setattr(bone, channel, value)
        bpy.context.view_layer.update()
