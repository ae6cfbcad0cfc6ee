# SPDX-License-Identifier: GPL-3.0-or-later
"""The sliders of a body's soft parts, such as its belly: which parts there are, and what a slider does to the map."""

from __future__ import annotations

import bpy
import numpy as np

from ...core.character import Character
from ...core.errors import SceneError
from ...core.firmness import NEUTRAL
from ...core.model import body_parts, rigid
from ...core.painted_map import FIRMNESS
from ...scene import references
from ...scene.character import extract
from ...scene.check import checks
from ...scene.read import mesh_data
from ...scene.read.source import Source
from ...scene.remembered import opened
from ..bake import writer
from . import painting
from .fixes import owned

OWN = 0.2  # of a part's area; where the soft skin's own mesh has as much of it, other meshes follow that


def find(obj: bpy.types.Object, character: Character | None = None) -> None:
    """List the parts that a soft skin has, none of what cannot be read yet. What is listed keeps its slider."""
    listed = obj.dynamorph.parts
    try:
        found = _shares(obj, character)
    except SceneError:
        found = {}
    for index in reversed(range(len(listed))):
        if listed[index].name not in found:
            listed.remove(index)
    for name in found:
        if name not in listed:
            listed.add().name = name


def set_firmness(obj: bpy.types.Object, name: str, firmness: float) -> None:
    """Shift the Firmness map in a part, with a soft border, until its mean there is `firmness`: what is painted stays
    as different from that as it was. Raises SceneError.
    """
    found = _shares(obj).get(name, ())
    group = painting.map_name(obj, FIRMNESS)
    for mesh, _ in found:
        writer.check_not_edited(mesh)
        owned(mesh.data)
    for mesh, share in found:
        weights = mesh_data.group_weights(mesh, [group], NEUTRAL)[:, 0]
        shift = firmness - NEUTRAL - share @ (weights - NEUTRAL) / (share @ share)
        painting.write(mesh, group, (weights + shift * share).clip(0.0, 1.0))
        mesh.data.update_tag()  # Live looks
    if found:
        painting.choose(obj, FIRMNESS, group)
        painting.look(obj)


def _shares(
    obj: bpy.types.Object, character: Character | None = None
) -> dict[str, list[tuple[bpy.types.Object, np.ndarray]]]:
    """Of each part of a soft skin: meshes, and how much of their vertices (V,) belongs to it. Remembered, because a
    slider that is dragged asks often. Raises SceneError.
    """
    source = Source.of(checks.skinned(obj))
    meshes = [source.obj, *(mesh.obj for mesh in source.meshes)]
    points = [(mesh.session_uid, mesh_data.rest_points(mesh).tobytes()) for mesh in meshes]
    state = hash((references.bones_key(source.rig.data), *points))
    if opened.parts.get(obj.session_uid, (None,))[0] != state:
        opened.parts[obj.session_uid] = state, _looked_for(source, meshes, character or extract.read(source, True))
    return opened.parts[obj.session_uid][1]


def _looked_for(
    source: Source, meshes: list[bpy.types.Object], whole: Character
) -> dict[str, list[tuple[bpy.types.Object, np.ndarray]]]:
    bind, skeleton = whole.vertices @ whole.to_bind.T, whole.skeleton
    moved = references.as_moved(skeleton, source.rig)
    heads = rigid.heads(moved, whole.weights, bind, whole.triangles)
    of_head = rigid.head_rigidity(moved, whole.weights, bind, whole.triangles, heads)
    skin = body_parts.RiggedSkin(skeleton, source.bone_heads, bind, whole.triangles, whole.weights)
    ends = np.cumsum([len(mesh.data.vertices) for mesh in meshes])
    shares = {}
    for name, share in body_parts.find(skin, of_head).items():
        of_meshes = list(zip(meshes, np.split(share, ends[:-1]), strict=True))
        own = (share * skin.areas)[: ends[0]].sum() >= OWN * (share @ skin.areas)
        shares[name] = [each for each in of_meshes[: 1 if own else None] if each[1].any()]
    return shares
