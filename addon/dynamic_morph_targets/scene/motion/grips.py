# SPDX-License-Identifier: GPL-3.0-or-later
"""The objects and bones that hold patches of a soft skin, over a shot."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import bpy
import numpy as np

from ...core.errors import SceneError
from ...core.motion.grab import GripTrack, Patch
from ..check.problem import Problem
from ..skin import used_grips


def problems(obj: bpy.types.Object) -> Iterator[Problem]:
    """What prevents that they hold. Raises RecordError."""
    for grip in used_grips(obj):
        if grip.object is None:
            text = "'{name}': what holds '{grip}' is gone: remove it from Grips"
            yield Problem(text, name=obj.name, grip=grip.name)
        elif grip.bone and (grip.object.pose is None or grip.bone not in grip.object.pose.bones):
            text = "'{name}': bone '{bone}' of '{object}', which holds '{grip}', is gone: remove it from Grips"
            yield Problem(text, name=obj.name, bone=grip.bone, object=grip.object.name, grip=grip.name)
        elif Patch.of_text(grip.patch).count != len(obj.data.vertices):
            text = "'{name}': the mesh is another than the one that '{grip}' took hold of: press Attach Here"
            yield Problem(text, name=obj.name, grip=grip.name)


def holder_world(holder: bpy.types.Object, bone: str) -> np.ndarray:
    """World transform (4, 4), Blender units, of an evaluated object, or of a bone of it."""
    world = np.array(holder.matrix_world)
    return world @ np.array(holder.pose.bones[bone].matrix) if bone else world


class GripReader:
    """Reads what holds a patch, sample by sample."""

    def __init__(self, grip: bpy.types.PropertyGroup, count: int):
        self.name, self.holder, self._bone = grip.name, grip.object.name, grip.bone
        self._patch, self._world = Patch.of_text(grip.patch), np.empty((count, 4, 4))

    def find(self, obj: bpy.types.Object) -> bpy.types.Object:
        """What holds it. Raises SceneError where it is gone meanwhile."""
        grip = obj.dynamorph.grips.get(self.name)
        if grip is None or grip.object is None or grip.object.name != self.holder:
            raise SceneError("'{name}' was removed while it was being read: start again", name=self.name)
        return grip.object

    def read(self, sample: int, evaluated: bpy.types.Object) -> None:
        self._world[sample] = holder_world(evaluated, self._bone)

    def track(self, to_meters: Callable[[np.ndarray], np.ndarray]) -> GripTrack:
        """Raises SceneError for what is no number."""
        if not np.isfinite(self._world).all():
            text = "'{name}' has a transform that is not a number at some frame: check its drivers and constraints"
            raise SceneError(text, name=self.holder)
        return GripTrack(self.name, self._patch, to_meters(self._world))
