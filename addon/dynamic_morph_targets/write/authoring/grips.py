# SPDX-License-Identifier: GPL-3.0-or-later
"""Grips: objects and bones that hold patches of the skin where it is when they take hold of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import bpy
import numpy as np

from ...core.errors import SceneError
from ...core.geometry import diagonal, inverse, invertible, vertex_areas
from ...core.motion.grab import FIRM, RADIUS, Grab, Patch, pinch, spread
from ...scene import animation
from ...scene.motion.grips import holder_world
from ...scene.properties.grip_properties import DynamorphGrip
from ...scene.read import mesh_data
from ...scene.read.mesh_data import VertexGroups
from ...scene.skin import unit_scale
from ..assign import free_name

DRAG = "Drag"
SOON = 0.02  # frames: a key so long after a frame is not seen at it; Blender makes one of two that are nearer


def attach(obj: bpy.types.Object, holder: bpy.types.Object, bone: str, group: str) -> DynamorphGrip:
    """Let an object, or a bone of it, hold the skin of `obj` where it is now. group: of the patch; '' for what is
    nearest. Raises SceneError.
    """
    patch = _taken(obj, holder, bone, group)
    grip = add(obj, bone or holder.name, holder, patch)
    grip.bone, grip.group = bone, group
    return grip


def attach_here(obj: bpy.types.Object, grip: DynamorphGrip) -> None:
    """Take hold of the skin as it is now. Raises SceneError."""
    if grip.object is None:
        raise SceneError("'{name}': what holds '{grip}' is gone: remove it from Grips", name=obj.name, grip=grip.name)
    grip.patch = _taken(obj, grip.object, grip.bone, grip.group).text()


def remove(obj: bpy.types.Object, index: int) -> None:
    """Let go of a patch. The object that held it stays."""
    settings = obj.dynamorph
    kept = [place for place in range(len(settings.grips)) if place != index]
    settings.grips.remove(index)
    settings.active_grip_index = max(0, index - 1)
    animation.follow_list(obj, "dynamorph.grips", kept)


def from_drags(
    obj: bpy.types.Object, recorded: Mapping[int, Mapping[int, Grab]], shear: float, unit: float
) -> list[DynamorphGrip]:
    """An empty that moves as each hand did, and holds what it held. recorded: of each frame, the hands by number, in
    meters; shear: modulus of the tissue, pascals; unit: meters per Blender unit.
    """
    hands: dict[int, dict[int, Grab]] = {}
    for frame, grabs in sorted(recorded.items()):
        for number, grab in grabs.items():
            hands.setdefault(number, {})[frame] = grab
    return [_drag(obj, frames, shear, unit) for _, frames in sorted(hands.items())]


def _drag(obj: bpy.types.Object, frames: Mapping[int, Grab], shear: float, unit: float) -> DynamorphGrip:
    first, last = min(frames), max(frames)
    grab = frames[first]
    places = {frame: each.goals.mean(axis=0) / unit for frame, each in frames.items()}
    firm = float(grab.stiffness.sum())
    patch = Patch(
        len(obj.data.vertices), grab.vertices, grab.goals / unit - places[first], grab.stiffness / firm,
        firm / (FIRM * shear),
    )  # fmt: skip
    empty = bpy.data.objects.new(DRAG, None)
    empty.empty_display_size = patch.radius / unit
    for collection in obj.users_collection[:1]:
        collection.objects.link(empty)
    grip = add(obj, DRAG, empty, patch)
    for frame, place in places.items():
        empty.location = place
        empty.keyframe_insert("location", frame=frame)
    _interpolate(empty, "LINEAR", "location")
    hold_from(obj, grip, ((first - 1, 0.0), (first - 1 + SOON, 1.0), (last + SOON, 0.0)))
    return grip


def hold_from(obj: bpy.types.Object, grip: DynamorphGrip, strengths: Sequence[tuple[float, float]]) -> None:
    """Key the strength of a grip: (frame, value), each until the next."""
    for frame, strength in strengths:
        grip.strength = strength
        grip.keyframe_insert("strength", frame=frame)
    _interpolate(obj, "CONSTANT", grip.path_from_id("strength"))


def _interpolate(owner: bpy.types.Object, how: str, path: str) -> None:
    data = owner.animation_data
    for curve in animation.curves(data.action, data.action_slot):
        for key in curve.keyframe_points if curve.data_path == path else ():
            key.interpolation = how


def add(obj: bpy.types.Object, name: str, holder: bpy.types.Object, patch: Patch) -> DynamorphGrip:
    """A grip of this name, if it is free, selected."""
    settings = obj.dynamorph
    taken = settings.grips.keys()
    grip = settings.grips.add()
    grip.name, grip.object, grip.patch = name if name not in taken else free_name(taken, name), holder, patch.text()
    settings.active_grip_index = len(settings.grips) - 1
    return grip


def _taken(obj: bpy.types.Object, holder: bpy.types.Object, bone: str, group: str) -> Patch:
    depsgraph = bpy.context.evaluated_depsgraph_get()
    world = holder_world(holder.evaluated_get(depsgraph), bone)
    if not invertible(world):
        raise SceneError("'{name}' is scaled to zero: give it a size", name=holder.name)
    points, count = mesh_data.shown_points(obj, depsgraph).astype(np.float64), len(obj.data.vertices)
    size, unit = diagonal(points), unit_scale()
    if group:
        weights = VertexGroups(obj).weights([group])[:, 0] if group in obj.vertex_groups else np.zeros(count)
        if not weights.any():
            text = "'{name}': the vertex group '{group}' is empty or gone: choose another"
            raise SceneError(text, name=obj.name, group=group)
        vertices, share = spread(points, weights)
        area = vertex_areas(points, mesh_data.mesh_triangles(obj.data)) @ weights
        radius = float(np.sqrt(max(area, 0.0) / np.pi)) or RADIUS * size
    else:
        nearest = points[np.linalg.norm(points - world[:3, 3], axis=1).argmin()]
        radius = RADIUS * size
        vertices, share = pinch(points, nearest, radius, np.ones(count, bool))
    offsets = (points[vertices] - world[:3, 3]) @ inverse(world)[:3, :3].T
    return Patch(count, vertices, offsets, share, radius * unit)


def holder_in(selected: Sequence[bpy.types.Object], obj: bpy.types.Object) -> tuple[bpy.types.Object, str]:
    """What is to hold the skin of `obj`: the active bone in Pose Mode, else the other selected object. Raises
    SceneError.
    """
    bone = bpy.context.active_pose_bone if bpy.context.mode == "POSE" else None
    if bone:
        return bone.id_data, bone.name
    others = [other for other in selected if other != obj]
    if not others:
        raise SceneError("Select the object that is to hold the skin, then '{name}' with Shift", name=obj.name)
    return others[0], ""
