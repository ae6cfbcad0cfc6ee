# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender scene -> Character, in three steps: a `Source` reads, `check` refuses with the remedy, and then it is made.

Skinning is Blender's: shape keys first, then the Armature modifier, weights normalized over the deforming bones.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from ...core.character import Character, OwnCage, Target, TargetSet
from ...core.errors import SceneError, sentence
from ...core.geometry import inverse
from ...core.motion.keyed import Setting
from ...core.painted_map import EXCLUDED, FIRMNESS, MAX_DISTANCE
from .. import keyed
from ..check import body_checks, checks, data_checks
from ..check.checks import active_targets
from ..check.problem import refuse
from ..motion import colliders
from ..read.mesh_data import cages_of, carried, mesh_triangles, painted, target_shape
from ..read.sampling_scene import rig_scene
from ..read.source import Source
from ..read.worlds import at_rest
from ..skin import own_attachments
from ..skinning import Skinning
from . import bodies

# The character -----------------------------------------------------------------------------------------------------


def character(obj: bpy.types.Object, without_targets: bool = False) -> Character:
    """`read` for those who need nothing else of the object."""
    return read(Source.of(Skinning.of(obj)), without_targets)


def read(source: Source, without_targets: bool = False) -> Character:
    """The soft skin authored on the mesh of `source`, whose references `reconcile.reconcile` has updated.
    without_targets: the neutral target is enough. Raises SceneError.
    """
    refuse(data_checks.of_soft_skin(source, without_targets))
    return bodies.joined(source, _own_mesh(source))


def _own_mesh(source: Source) -> Character:
    """The character of the soft skin's own mesh. Raises SceneError."""
    obj, settings = source.obj, source.obj.dynamorph
    return Character(
        name=obj.name,
        vertices=source.points,
        triangles=source.triangles,
        to_bind=source.to_bind,
        weights=source.weights,
        bone_segments=source.bone_segments(source.skinning.bones(source.rig)),
        skeleton=source.skeleton,
        authored_sets=_target_sets(source),
        settings=obj.dynamorph.model.settings(),
        probed=bool(source.skinning.beyond_bones),
        cage_index=cages_of(own_attachments(obj), obj, source.groups),
        cage=_own_cage(source),
        firmness=painted(obj, source.groups, FIRMNESS, settings.firmness_group),
        max_distance=painted(obj, source.groups, MAX_DISTANCE, settings.max_distance_group),
        excluded=painted(obj, source.groups, EXCLUDED, settings.excluded_group),
    )


def warnings(source: Source) -> list[str]:
    """What will be ignored, or looks unintended."""
    unintended = body_checks.unintended(source, source.points, source.to_bind)
    found = *checks.notes(source.skinning), *colliders.notes(source.obj), *unintended
    return [problem.text for problem in found]


def first_look(obj: bpy.types.Object) -> list[str]:
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
    neutral, *others = active_targets(obj)
    groups = list(dict.fromkeys(target.region for target in others if target.region))
    region_weights = source.groups.weights(groups).clip(0.0, 1.0)
    region_weights /= np.maximum(region_weights.sum(axis=1, keepdims=True), 1.0)
    always = keyed.always(obj)
    sets = []
    body = (1.0 - region_weights.sum(axis=1)).clip(0.0)
    for group, weights in zip(["", *groups], [body, *region_weights.T], strict=True):
        targets = [_target(source, target, always) for target in others if target.region == group]
        at_rest = _target(source, neutral, always)
        if group:
            at_rest = replace(at_rest, name=f"{at_rest.name} {group}")
        sets.append(TargetSet(group or obj.name, (at_rest, *targets), weights))
    return tuple(sets)


def _target(source: Source, target: Any, always: dict[Setting, float]) -> Target:
    obj, skeleton = source.obj, source.skeleton
    neutral = target == obj.dynamorph.targets[0]
    amount = always.get(Setting("TARGET_AMOUNT", "" if neutral else target.name), target.amount)
    shape = np.zeros((len(obj.data.vertices), 3)) if neutral else target_shape(obj, target.name, source.groups)
    local, rig_world = target.local(skeleton), np.array(target.rig_world).reshape(4, 4)
    return Target(
        target.name, shape, target.bone_names(), local, rig_world, target.material(),
        target.fade_out_angle, amount, keyed.frequency_of(target), target.channel, target.reached_at,
    )  # fmt: skip


def _own_cage(source: Source) -> OwnCage | None:
    """The artist's cage as it is when the scene starts with the armature at rest, bind space. Raises SceneError."""
    obj = source.obj
    cage = obj.dynamorph.model.cage_object
    if cage is None:
        return None
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
