# SPDX-License-Identifier: GPL-3.0-or-later
"""The Mesh Cache modifier that plays a bake's point cache, before all other modifiers."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import bpy

from ...core.motion import baked
from ...core.motion.baked import Bake
from ...scene.skin import cache_modifier
from .baked_action import MOTION


def play_cache(obj: bpy.types.Object, file: Path, bake: Bake, skin: bpy.types.Object | None) -> None:
    """Let the modifier play the motion in a file; what follows a soft skin takes the influence from there."""
    modifier = cache_modifier(obj)
    if modifier is None:
        modifier = obj.modifiers.new(MOTION, "MESH_CACHE")
        obj.modifiers.move(obj.modifiers.find(modifier.name), 0)  # it holds the surface that the others deform
    render, samples = bpy.context.scene.render, baked.samples_per_frame(bake)
    modifier.cache_format = file.suffix[1:].upper()
    modifier.filepath = str(file)
    with suppress(ValueError):  # on another drive. All systems take /, and the .blend may be opened on another one
        modifier.filepath = bpy.path.relpath(str(file)).replace(os.sep, "/") if bpy.data.filepath else str(file)
    modifier.frame_start = bake.frames[0] * samples  # the modifier scales first
    modifier.frame_scale = samples * render.frame_map_new / render.frame_map_old
    modifier.show_in_editmode = False
    obj.dynamorph.bake.cache = file.name
    if skin:
        driver = modifier.driver_add("factor").driver
        driver.type = "SUM"
        variable = driver.variables.get("skin") or driver.variables.new()
        variable.name = "skin"
        variable.targets[0].id = skin
        variable.targets[0].data_path = cache_modifier(skin).path_from_id("factor")
