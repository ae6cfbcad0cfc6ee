# SPDX-License-Identifier: GPL-3.0-or-later
"""What prevents a soft skin from being built, in one list: how it is skinned, its points, weights and poses."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy
import numpy as np

from ...core.geometry import turned
from ..plain import fits, plain, wanted
from ..read.source import Source
from ..references import key_points
from . import checks
from .checks import active_targets
from .problem import Problem

SAME_POSE = np.radians(0.5)  # the engine cannot interpolate between targets that are nearer than this over all bones


def of_soft_skin(source: Source, without_targets: bool = False) -> Iterator[Problem]:
    """All that prevents a character from being made, in the order in which an artist would fix it: each check may
    count on those before it. without_targets: the neutral target is enough.
    """
    obj = source.obj
    yield from checks.no_mesh(obj)
    if not obj.dynamorph.targets:
        yield Problem("'{name}' is no soft skin: select it and press Add Soft Skin", name=obj.name)
    yield from settings(obj)
    yield from checks.problems(source.skinning)
    if not without_targets:
        yield from checks.next_steps(obj)
    yield from shapes(obj)
    yield from regions(source)
    yield from poses(source)
    yield from cage(obj)
    for mesh in source.meshes:
        yield from checks.attachment_problems(source.skinning, mesh.skinning)
        yield from checks.skinning_problems(mesh.skinning)


def settings(obj: bpy.types.Object) -> Iterator[Problem]:
    """Values that no button sets, as a damaged .blend, or a stranger's, may have them."""
    authored = obj.dynamorph
    groups = authored, authored.model, authored.simulation, authored.collision, authored.output
    whole = [(each, "'{name}': {setting}") for each in groups]
    targets = [(each, "'{name}': {setting} of target '{target}'") for each in authored.targets]
    for group, text in whole + targets:
        for name, value in plain(group).items():
            prop = group.bl_rna.properties[name]
            if not fits(prop, value):
                yield Problem(
                    f"{text} is {{value}}, but must be {{wanted}}: set it again",
                    name=obj.name,
                    setting=prop.name,
                    target=group.name,
                    value="unknown" if value == "" else value,
                    wanted=wanted(prop),
                )


def shapes(obj: bpy.types.Object) -> Iterator[Problem]:
    """Coordinates that are not numbers, in the Basis and the targets' keys."""
    keys = obj.data.shape_keys
    if keys is None:  # only the mesh exists
        return
    for block in (keys.reference_key, *(keys.key_blocks[target.name] for target in active_targets(obj)[1:])):
        bad = np.flatnonzero(~np.isfinite(key_points(block)).all(axis=1))
        if len(bad):
            yield Problem(
                "'{name}': shape key '{key}' has coordinates that are not numbers at vertices {vertices}: delete or "
                "repair them",
                name=obj.name,
                key=block.name,
                vertices=", ".join(map(str, bad[:5])),
            )


def regions(source: Source) -> Iterator[Problem]:
    """Vertex groups of targets that are gone, or empty."""
    obj = source.obj
    owners: dict[str, str] = {}
    for target in active_targets(obj)[1:]:
        owners.setdefault(target.region, target.name)
    for group, name in owners.items():
        if not group:
            continue
        if group not in obj.vertex_groups:
            yield Problem(
                "'{name}': the vertex group '{group}' of target '{target}' is gone: choose another Region",
                name=obj.name,
                group=group,
                target=name,
            )
        elif not (source.groups.weights([group]) > 0.0).any():
            yield Problem(
                "'{name}': the vertex group '{group}' of a target's Region is empty: paint it",
                name=obj.name,
                group=group,
            )


def poses(source: Source) -> Iterator[Problem]:
    """Poses of targets that are incomplete, or that the rotations of the targets' bones alone cannot distinguish."""
    neutral, *others = active_targets(source.obj)
    for target in (neutral, *others):
        yield from pose(source, target)
    for group in dict.fromkeys(target.region for target in others):
        yield from alike(source, [neutral, *(target for target in others if target.region == group)])


def pose(source: Source, target: Any) -> Iterator[Problem]:
    """What is wrong with the pose of one target."""
    name = source.obj.name
    missing = [bone for bone in target.bone_names() if bone not in source.skeleton.names]
    if missing:
        text = "'{name}': bone '{bone}' of target '{target}' is gone: capture its pose again"
        yield Problem(text, name=name, bone=missing[0], target=target.name)
    elif not all(np.isfinite(each).all() for each in (target.local(source.skeleton), np.array(target.rig_world))):
        text = "'{name}': the pose of target '{target}' is not numbers: capture it again"
        yield Problem(text, name=name, target=target.name)


def alike(source: Source, targets: list) -> Iterator[Problem]:
    """Targets of one set that cannot be distinguished."""
    obj, skeleton = source.obj, source.skeleton
    name = obj.name
    for target in targets[1:]:
        if target.channel and target.channel not in obj.dynamorph.channels:
            text = "'{name}': channel '{channel}' of target '{target}' is gone: choose another"
            yield Problem(text, name=name, channel=target.channel, target=target.name)
        elif target.channel and not target.reached_at:
            text = "'{name}': target '{target}' is reached at 0 of its channel, as all others are: set Reached At"
            yield Problem(text, name=name, target=target.name)
        elif not (target.bones or target.channel):
            yield Problem(
                "'{name}': target '{target}' has no bones: pose the armature away from the neutral target and press "
                "Capture Pose",
                name=name,
                target=target.name,
            )
    named = {bone for target in targets for bone in target.bone_names()}
    used = [bone in named for bone in skeleton.names]
    local = [target.local(skeleton)[used] for target in targets]
    for i, first in enumerate(targets):
        for k, second in enumerate(targets[i + 1 :], i + 1):
            if same_pose(local[i], local[k]) and first.reached == second.reached:
                yield Problem(
                    "'{name}': targets '{first}' and '{second}' have the same pose in the bones that place targets: "
                    "capture one of them in another pose, choose its bones, or remove it",
                    name=name,
                    first=first.name,
                    second=second.name,
                )


def cage(obj: bpy.types.Object) -> Iterator[Problem]:
    """Whether the artist's cage can be read."""
    own = obj.dynamorph.model.cage_object
    if own is None:
        return
    if own.name not in bpy.context.scene.objects or own.type != "MESH":  # or its library is missing
        text = "Cage Object '{cage}' of '{name}' is not in the scene any more: choose another"
        yield Problem(text, cage=own.name, name=obj.name)
    elif own.mode == "EDIT":
        yield Problem("Cage Object '{name}' is in Edit Mode: leave it first", name=own.name)
    elif own.hide_viewport:
        text = "Cage Object '{name}' is disabled in viewports: enable it, and hide it by its eye"
        yield Problem(text, name=own.name)


def same_pose(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether targets with these transforms (B, 4, 4) of the bones that place them cannot be distinguished."""
    return bool(np.linalg.norm(turned(first, second)) < SAME_POSE)
