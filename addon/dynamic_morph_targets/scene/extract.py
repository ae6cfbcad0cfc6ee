# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender scene -> Character. Reads only. What cannot be simulated is refused here, with the remedy.

Skinning is Blender's: shape keys first, then the Armature modifier, weights normalized over the deforming bones.
"""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np

from ..core.character import Character, OwnCage, Target, TargetSet
from ..core.errors import SceneError, sentence
from ..core.geometry import inverse
from ..core.painted_map import EXCLUDED, FIRMNESS, MAX_DISTANCE
from . import bodies, body_checks, checks, data_checks
from .checks import refuse, skinned
from .mesh_data import cages_of, carried, mesh_triangles, painted, target_shape
from .rig_motion import at_rest
from .sampling_scene import rig_scene
from .skin import own_attachments
from .skinning import Skinning
from .source import Source

FAR = 0.1  # body sizes; a mesh farther away than this does not move like the tissue


# The character -----------------------------------------------------------------------------------------------------


def character(obj, without_targets=False) -> Character:
    """`read` for those who need nothing else of the object."""
    return read(Source.of(skinned(obj)), without_targets)


def read(source: Source, without_targets=False) -> Character:
    """The soft skin authored on the mesh of `source`, whose references `reconcile.reconcile` has updated.
    without_targets: the neutral target is enough. Raises SceneError.
    """
    obj, settings = source.obj, source.obj.dynamorph
    if not settings.targets:
        raise SceneError("'{name}' is no soft skin: select it and press Add Soft Skin", name=obj.name)
    refuse(data_checks.settings(obj))
    refuse(checks.problems(source.skinning))
    if not without_targets:
        refuse(checks.next_steps(obj))
    refuse(data_checks.shapes(obj))
    target_sets = _target_sets(source)
    for target_set in target_sets:
        refuse(data_checks.poses(obj.name, target_set.targets, source.skeleton))
    single = Character(
        name=obj.name,
        vertices=source.points,
        triangles=source.triangles,
        to_bind=source.to_bind,
        weights=source.weights,
        bone_segments=source.bone_segments(source.skinning.bones(source.rig)),
        skeleton=source.skeleton,
        authored_sets=target_sets,
        settings=obj.dynamorph.model.settings(),
        probed=bool(source.skinning.beyond_bones),
        cage_index=cages_of(own_attachments(obj), obj, source.groups),
        cage=_own_cage(source),
        firmness=painted(obj, source.groups, FIRMNESS, settings.firmness_group),
        max_distance=painted(obj, source.groups, MAX_DISTANCE, settings.max_distance_group),
        excluded=painted(obj, source.groups, EXCLUDED, settings.excluded_group),
    )
    return bodies.joined(source, single)


def warnings(source: Source) -> list[str]:
    """What will be ignored, or looks unintended."""
    found = (*checks.notes(source.skinning), *body_checks.unintended(source, source.points, source.to_bind))
    return [problem.text for problem in found]


def first_look(obj) -> list[str]:
    """Everything that prevents a simulation of `obj` or looks unintended, before it is a soft skin."""
    skinning = Skinning.of(obj)
    found = [*checks.problems(skinning), *checks.notes(skinning)]
    try:
        source = Source.of(skinning)
        found += body_checks.unintended(source, body_checks.mesh_points(obj), source.to_bind)
    except SceneError as error:
        return [*(problem.text for problem in found), sentence(error)]
    return [problem.text for problem in found]


def _target_sets(source: Source) -> tuple[TargetSet, ...]:
    """The targets of the whole body, then those of each region, each set with the neutral target first.

    Regions divide the tissue between them: where their groups add up to less than one, the body has the rest.
    """
    obj = source.obj
    neutral, *others = checks.active_targets(obj)
    groups = list(dict.fromkeys(target.region for target in others if target.region))
    gone = [group for group in groups if group not in obj.vertex_groups]
    if gone:
        name = next(target.name for target in others if target.region == gone[0])
        raise SceneError(
            "'{name}': the vertex group '{group}' of target '{target}' is gone: choose another Region",
            name=obj.name,
            group=gone[0],
            target=name,
        )
    region_weights = source.groups.weights(groups).clip(0.0, 1.0)
    empty = [group for group, weights in zip(groups, region_weights.T, strict=True) if not weights.any()]
    if empty:
        raise SceneError(
            "'{name}': the vertex group '{group}' of a target's Region is empty: paint it",
            name=obj.name,
            group=empty[0],
        )
    region_weights /= np.maximum(region_weights.sum(axis=1, keepdims=True), 1.0)
    sets = []
    body = (1.0 - region_weights.sum(axis=1)).clip(0.0)
    for group, weights in zip(["", *groups], [body, *region_weights.T], strict=True):
        targets = [_target(source, target) for target in others if target.region == group]
        at_rest = _target(source, neutral)
        if group:
            at_rest = replace(at_rest, name=f"{at_rest.name} {group}")
        sets.append(TargetSet(group or obj.name, (at_rest, *targets), weights))
    return tuple(sets)


def _target(source: Source, target) -> Target:
    obj, skeleton = source.obj, source.skeleton
    missing = [name for name in target.bone_names() if name not in skeleton.names]
    if missing:
        raise SceneError(
            "'{name}': bone '{bone}' of target '{target}' is gone: capture its pose again",
            name=obj.name,
            bone=missing[0],
            target=target.name,
        )
    material = target.material()
    neutral = target == obj.dynamorph.targets[0]
    shape = np.zeros((len(obj.data.vertices), 3)) if neutral else target_shape(obj, target.name, source.groups)
    local, rig_world = target.local(skeleton), np.array(target.rig_world).reshape(4, 4)
    if not (np.isfinite(local).all() and np.isfinite(rig_world).all()):
        raise SceneError(
            "'{name}': the pose of target '{target}' is not numbers: capture it again",
            name=obj.name,
            target=target.name,
        )
    return Target(
        target.name, shape, target.bone_names(), local, rig_world, material, target.fade_out_angle, target.amount,
        target.frequency,
    )  # fmt: skip


def _own_cage(source: Source) -> OwnCage | None:
    """The artist's cage as it is when the scene starts with the armature at rest, bind space. Raises SceneError."""
    obj = source.obj
    cage = obj.dynamorph.model.cage_object
    if cage is None:
        return None
    if cage.name not in bpy.context.scene.objects or cage.type != "MESH":  # or its library is missing
        raise SceneError(
            "Cage Object '{cage}' of '{name}' is not in the scene any more: choose another",
            cage=cage.name,
            name=obj.name,
        )
    if cage.mode == "EDIT":
        raise SceneError("Cage Object '{name}' is in Edit Mode: leave it first", name=cage.name)
    if cage.hide_viewport:
        raise SceneError(
            "Cage Object '{name}' is disabled in viewports: enable it, and hide it by its eye", name=cage.name
        )
    with at_rest(source.rig), rig_scene(obj, source.rig) as (scene, follower):
        scene.collection.objects.link(cage)
        scene.frame_set(bpy.context.scene.frame_start)
        depsgraph = scene.view_layers[0].depsgraph
        evaluated = cage.evaluated_get(depsgraph)
        to_local = inverse(np.array(follower.evaluated_get(depsgraph).matrix_world)) @ np.array(evaluated.matrix_world)
        mesh = evaluated.to_mesh()
        points = np.empty((len(mesh.vertices), 3), np.float32)
        mesh.vertices.foreach_get("co", points.ravel())
        triangles = mesh_triangles(mesh)
        evaluated.to_mesh_clear()
    if not len(triangles):
        raise SceneError("Cage Object '{name}' has no faces: choose a closed mesh", name=cage.name)
    return OwnCage(cage.name, carried(points.astype(np.float64), to_local) @ source.to_bind.T, triangles)
