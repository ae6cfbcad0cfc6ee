# SPDX-License-Identifier: GPL-3.0-or-later
"""Buttons that make a mesh a soft skin and put right what is in the way."""

from __future__ import annotations

import bpy
import numpy as np
from bpy.types import Operator

from . import extract, properties
from .extract import SceneError
from .operators import SoftSkinOperator


class DYNAMORPH_OT_add_soft_skin(SoftSkinOperator, Operator):
    """Make the active mesh a soft skin, with a neutral target at the armature's rest pose"""

    bl_idname = "dynamorph.add_soft_skin"
    bl_label = "Add Soft Skin"
    needs_soft_skin = False

    def apply(self, obj):
        if obj.dynamorph.targets:
            raise SceneError(f"'{obj.name}' has a soft skin already")
        skeleton, _, rig_world = extract.current_pose(obj)
        if obj.data.shape_keys is None:
            obj.shape_key_add(name="Basis", from_mix=False)
        target = obj.dynamorph.targets.add()
        target.name = properties.NEUTRAL
        target.set_pose(skeleton, np.tile(np.eye(4), (len(skeleton.names), 1, 1)), rig_world)


CLASSES = (DYNAMORPH_OT_add_soft_skin,)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
