# SPDX-License-Identifier: GPL-3.0-or-later
"""The target of the other side: pose, bones, shape key and region mirrored about the X axis."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from mathutils.kdtree import KDTree

from ...core.character import Skeleton
from ...core.errors import SceneError
from ...core.geometry import diagonal
from ...core.message import Message, listed
from ...scene.check import checks, data_checks
from ...scene.properties.target_properties import DynamorphTarget
from ...scene.read import mesh_data
from ...scene.references import key_points, rest_skeleton
from . import channels, regions, targets

MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])
TOLERANCE = 1e-3  # of the mesh's size; the largest distance of a vertex's partner from its mirror image


def mirror_target(obj: bpy.types.Object, overwrite: bool) -> list[Message]:
    """Make the selected target's mirror image, and select it. overwrite: replace the shape of a key that is there
    already. Returns warnings. Raises SceneError.
    """
    settings = obj.dynamorph
    source, index = settings.active_target, settings.active_target_index
    skeleton = rest_skeleton(checks.skinned(obj).rig.data)
    local = mirrored_pose(skeleton, source.local(skeleton))
    region = "" if source.auto_region else bpy.utils.flip_name(source.region)
    channel = bpy.utils.flip_name(source.channel)
    elsewhere = channel != source.channel or (source.region != region and not source.auto_region)
    bones = _bones(source, skeleton, local, elsewhere)
    warnings = []
    if region and region not in obj.vertex_groups:
        text = "There is no vertex group '{region}': the mirrored target has no Region"
        warnings.append(Message(text, region=region))
        region = ""
    block, warned = _key(obj, overwrite)
    existing = [i for i, target in enumerate(settings.targets) if i and target.name == block.name]
    if existing:
        settings.active_target_index = existing[0]
    else:
        targets.add(obj, block, after=index)
    source, target = settings.targets[index], settings.active_target  # adding one has moved them in memory
    targets.copy_settings(source, target)
    target.set_region(region, source.auto_region)
    target.made_region = ""
    target.set_pose(skeleton, local, mirrored_world(source.rig_world))
    target.set_bones(bones, source.auto_bones)
    if channel:
        target.channel = channels.ensure(obj, channel).name
    regions.update(obj)
    return warnings + warned


def _bones(source: DynamorphTarget, skeleton: Skeleton, mirrored: np.ndarray, elsewhere: bool) -> list[str]:
    """The target's bones on the other side. elsewhere: whether its channel or region is another there. Raises
    SceneError where there is no other side.
    """
    if bpy.utils.flip_name(source.name) == source.name:
        raise SceneError("'{name}' does not say its side: give it a name that ends in .L or .R", name=source.name)
    bones = [bpy.utils.flip_name(bone) for bone in source.bone_names()]
    missing = [bone for bone in bones if bone not in skeleton.names]
    if missing:
        raise SceneError("Bone '{bone}' is missing: '{name}' has no other side", bone=missing[0], name=source.name)
    used = [name in {*bones, *source.bone_names()} for name in skeleton.names]
    if not elsewhere and data_checks.same_pose(source.local(skeleton)[used], mirrored[used]):
        raise SceneError("'{name}' has a symmetric pose, which its mirror image would share", name=source.name)
    return bones


def _key(obj: bpy.types.Object, overwrite: bool) -> tuple[bpy.types.ShapeKey, list[Message]]:
    """The shape key of the other side, and warnings. It is created, overwritten or used as it is."""
    keys = obj.data.shape_keys
    source = targets.sculpted_key(obj)
    name = bpy.utils.flip_name(source.name)
    existing = keys.key_blocks.get(name)
    if existing and not overwrite:
        return existing, []
    checks.check_mesh(obj)
    partners = mirror_partners(key_points(keys.reference_key))
    alone = (partners < 0).nonzero()[0]
    if len(alone) == len(partners):
        raise SceneError(
            "'{name}' is not symmetric about its X axis: sculpt a shape key '{key}' yourself", name=obj.name, key=name
        )
    warnings = []
    if len(alone):
        text = "{count} vertices have no mirror image and stay as in the Basis: {numbers}"
        warnings.append(Message(text, count=len(alone), numbers=listed([str(vertex) for vertex in alone])))
    shape = mirrored_shape(mesh_data.target_shape(obj, source.name), partners)
    if existing is None:
        return targets.new_key(obj, name, shape), warnings
    targets.sculpt_anew(existing, shape)
    return existing, warnings


# What is mirrored ----------------------------------------------------------------------------------------------------


def mirrored_pose(skeleton: Skeleton, local: np.ndarray) -> np.ndarray:
    """A pose (B, 4, 4) with left and right exchanged, about the armature's local x, whatever the rolls of the bones.

    What is mirrored is how each bone moves the skin, D = P R^-1: D' = S D S of the bone on the other side.
    """
    other = [other_side(skeleton, b) for b in range(len(skeleton.names))]
    carried = skeleton.pose(local) @ skeleton.rest_inverse
    return skeleton.local_transforms(MIRROR @ carried[other] @ MIRROR @ skeleton.rest)


def mirrored_world(rig_world: Sequence[float]) -> np.ndarray:
    """The armature's transform (4, 4) for a mirrored pose: gravity, along world z, is then mirrored in its space."""
    return MIRROR @ np.array(rig_world).reshape(4, 4) @ MIRROR


def other_side(skeleton: Skeleton, b: int) -> int:
    """The index of the bone on the other side; a center bone is its own partner."""
    flipped = bpy.utils.flip_name(skeleton.names[b])
    return skeleton.names.index(flipped) if flipped in skeleton.names else b


def mirror_partners(points: np.ndarray) -> np.ndarray:
    """For each point (V, 3) the index of the one at its mirror image about x, or -1."""
    tree = KDTree(len(points))
    for index, point in enumerate(points):
        tree.insert(point, index)
    tree.balance()
    tolerance = TOLERANCE * diagonal(points)
    found = [tree.find(point) for point in points * MIRROR.diagonal()[:3]]
    return np.array([index if distance <= tolerance else -1 for _, index, distance in found])


def mirrored_shape(shape: np.ndarray, partners: np.ndarray) -> np.ndarray:
    """A displacement (V, 3) mirrored about x; zero at vertices without a partner."""
    return shape[partners] * MIRROR.diagonal()[:3] * (partners >= 0)[:, None]
