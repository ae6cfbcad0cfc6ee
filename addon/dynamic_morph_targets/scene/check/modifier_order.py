# SPDX-License-Identifier: GPL-3.0-or-later
"""Modifiers above the Armature, whose vertices and bone weights the mesh itself does not have. Reads only."""

from __future__ import annotations

from collections.abc import Iterator

import bpy

from ..skinning import Skinning
from .problem import Problem

# Modifiers that may change the number of vertices. Before the Armature they break the match with the shape keys.
GENERATING = {
    "ARRAY", "BEVEL", "BOOLEAN", "DECIMATE", "EDGE_SPLIT", "MESH_TO_VOLUME", "MIRROR", "MULTIRES",
    "NODES", "OCEAN", "PARTICLE_INSTANCE", "REMESH", "SCREW", "SKIN", "SOLIDIFY", "SUBSURF", "VOLUME_TO_MESH", "WELD",
    "WIREFRAME",
}  # fmt: skip
HIDING = {"BUILD", "MASK"}  # do so too, but hide the same vertices below it
WEIGHING = {"VERTEX_WEIGHT_EDIT", "VERTEX_WEIGHT_MIX", "VERTEX_WEIGHT_PROXIMITY"}


def problems(skinning: Skinning) -> Iterator[Problem]:
    """Yields nothing when no modifier before the Armature makes vertices or weights that the mesh does not have."""
    obj = skinning.obj
    for each in hiding_before(obj, skinning.modifiers[-1]):
        yield Problem(
            "'{name}': modifier '{modifier}' comes before the Armature: move it below",
            "MOVE_BELOW",
            name=obj.name,
            modifier=each.name,
        )
    for each in to_apply(skinning):
        if each.type in GENERATING:
            yield Problem(
                "'{name}': modifier '{modifier}' comes before the Armature: apply it",
                "APPLY",
                name=obj.name,
                modifier=each.name,
            )
        elif _makes_weights(skinning, each):
            yield Problem(
                "'{name}': modifier '{modifier}' makes bone weights that the mesh does not have: apply it",
                "APPLY",
                name=obj.name,
                modifier=each.name,
            )


def before(obj: bpy.types.Object, modifier: bpy.types.Modifier) -> list:
    """The modifiers that change the mesh before the Armature modifier does."""
    above = obj.modifiers[: obj.modifiers.find(modifier.name)]
    return [each for each in above if each.show_viewport or each.show_render]


def hiding_before(obj: bpy.types.Object, modifier: bpy.types.Modifier) -> list:
    """Those of `HIDING` before the Armature."""
    return [each for each in before(obj, modifier) if each.type in HIDING]


def to_apply(obj: bpy.types.Object | Skinning) -> list:
    """The modifiers before the Armature that must be in the mesh itself: those that make vertices or bone weights, and
    all before them.
    """
    skinning = Skinning.of(obj)
    if not skinning.modifiers:
        return []
    above = [each for each in before(skinning.obj, skinning.modifiers[-1]) if each.type not in HIDING]
    needed = [each for each in above if each.type in GENERATING or _makes_weights(skinning, each)]
    return above[: above.index(needed[-1]) + 1] if needed else []


def _makes_weights(skinning: Skinning, modifier: bpy.types.Modifier) -> bool:
    """Whether a modifier makes weights of bones, which the mesh itself then does not have."""
    if modifier.type == "DATA_TRANSFER":
        gives = modifier.use_vert_data and "VGROUP_WEIGHTS" in modifier.data_types_verts
        return bool(modifier.object) and gives
    if modifier.type not in WEIGHING:
        return False
    group = modifier.vertex_group_a if modifier.type == "VERTEX_WEIGHT_MIX" else modifier.vertex_group
    masks = (each.vertex_group for each in skinning.modifiers)
    return group in masks or any(group in each.object.data.bones for each in skinning.modifiers)
