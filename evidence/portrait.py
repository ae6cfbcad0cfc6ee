# SPDX-License-Identifier: GPL-3.0-or-later
"""A camera that has a whole character in its picture; Blender's Workbench lights it."""

import bpy
import numpy as np
from mathutils import Vector

FROM = Vector((0.65, -1.0, 0.3)).normalized()  # where the camera stands


def aim(points: np.ndarray, cell: tuple[int, int], seen_from: Vector = FROM) -> None:
    """Give the scene a camera that has these points (N, 3), world, in a picture of so many pixels across and up."""
    scene = bpy.context.scene
    turn = seen_from.to_track_quat("Z", "Y").to_matrix().to_4x4()
    seen = points @ np.array(turn.to_3x3())
    low, high = seen.min(axis=0), seen.max(axis=0)
    width, height, depth = high - low
    camera = bpy.data.objects.new("Picture", bpy.data.cameras.new("Picture"))
    scene.collection.objects.link(camera)
    camera.data.type, camera.data.clip_end = "ORTHO", 4.0 * depth
    camera.data.clip_start = 1e-3 * depth
    camera.data.ortho_scale = 1.1 * max(width, height * cell[0] / cell[1])  # across the picture
    camera.matrix_world = turn
    camera.location = turn @ Vector((*(0.5 * (low + high))[:2], high[2] + depth))
    scene.camera = camera
    scene.world = scene.world or bpy.data.worlds.new("World")
    scene.world.color = (0.25, 0.28, 0.32)
