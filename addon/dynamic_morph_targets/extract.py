# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender scene -> scene_data. Reads only; what cannot be simulated is refused here, with the remedy.

Skinning is Blender's: shape keys first, then the Armature modifier, weights normalised over the deforming bones.
"""

from __future__ import annotations

import hashlib
import itertools
import threading
import time
from contextlib import contextmanager
from dataclasses import replace

import bpy
import numpy as np

from . import checks
from .nearest import nearest
from .properties import clothes_in, key_points, parts_in, reconcile, rest_skeleton, rig_of
from .scene_data import (
    Character,
    Follower,
    ForceField,
    ModelSettings,
    OutputSettings,
    OwnCage,
    RigSamples,
    SimulationSettings,
    Skeleton,
    Target,
    TargetSet,
    determinant,
    inverse,
    turned,
)

MOVED = np.radians(5.0)  # a bone turned further than this from the neutral pose places a target by default
STRIP_FIELDS = (
    "frame_start", "frame_end", "action_frame_start", "action_frame_end", "scale", "repeat", "use_reverse",
    "blend_type", "extrapolation", "blend_in", "blend_out", "influence",
)  # fmt: skip
FAR = 0.1  # body sizes: what follows the flesh from further away does not move like it
MEMBER = 0.5  # weight from which a vertex belongs to a piece
NO_WEIGHT = 1e-4  # Blender leaves a vertex alone when its weights sum to less


class SceneError(ValueError):
    """The scene cannot be simulated as it is. The message names the object and what to do."""


# The character -----------------------------------------------------------------------------------------------------


def character(obj, without_targets=False) -> Character:
    """The soft skin authored on `obj`. without_targets: the neutral one is enough. Raises SceneError."""
    modifier = armature_modifier(obj)
    reconcile(obj)
    if not obj.dynamorph.targets:
        raise SceneError(f"'{obj.name}' is no soft skin: select it and press Add Soft Skin")
    _refuse(checks.problems(obj))
    if not without_targets:
        _refuse(checks.next_steps(obj))
    _refuse(checks.shapes(obj))
    skeleton = rest_skeleton(modifier.object.data)
    groups = VertexGroups(obj)
    target_sets = _target_sets(obj, skeleton, groups)
    for target_set in target_sets:
        _refuse(checks.poses(obj.name, target_set.targets, skeleton))
    world, rig_world = worlds_at_start(obj, modifier.object)
    to_bind, bones = stretch(world), checks.deforming_bones(obj, modifier.object)
    own = Character(
        name=obj.name,
        vertices=rest_points(obj),
        triangles=mesh_triangles(obj.data),
        to_bind=to_bind,
        weights=_skin_weights(obj, modifier, skeleton, groups),
        softness=softness(obj, groups),
        stiffness=stiffness(obj, groups),
        bone_segments=bone_segments(bones, inverse(world) @ rig_world, to_bind),
        skeleton=skeleton,
        target_sets=target_sets,
        settings=model_settings(obj),
        probed=bool(checks.beyond_bones(obj)),
        pieces=pieces_of(parts_in(obj), obj, groups),
        cage=_own_cage(obj, modifier.object, to_bind),
        painted=bool(obj.dynamorph.soft_group),
    )
    if not own.settings.one_cage:
        return own
    from . import bodies  # which reads the other meshes by what is here

    return bodies.joined(obj, own, groups, world, rig_world)


def model_settings(obj) -> ModelSettings:
    """How the model of `obj` is to be built; lengths in metres, the panels' are in Blender units."""
    chosen = obj.dynamorph.model.settings()
    return replace(chosen, cage_thickness=unit_scale() * chosen.cage_thickness)


def followers(obj, character: Character) -> list[Follower]:
    """The other meshes that the flesh of `obj` carries along; character: what was read of it. Raises SceneError."""
    if character.settings.one_cage:
        return list(character.parts)
    pieces = clothes_in(obj)
    if not pieces:
        return []
    rig = armature_modifier(obj).object
    body_world, _ = worlds_at_start(obj, rig)
    skin = character.vertices @ character.to_bind.T
    of_body = (character.pieces[character.triangles] == 0).all(axis=1)
    if not of_body.any():
        raise SceneError(f"'{obj.name}' has no body to carry its attachments: choose With Body for a part of it")
    found = []
    for piece in pieces:
        _refuse(checks.follower(obj, piece))
        to_body = inverse(body_world) @ worlds_at_start(piece, rig)[0]
        points = rest_points(piece)
        vertices = (points @ to_body[:3, :3].T + to_body[:3, 3]) @ character.to_bind.T
        found.append(
            Follower(
                piece.name,
                piece.session_uid,
                points,
                vertices,
                inverse(to_body[:3, :3]),
                nearest(vertices, skin, character.triangles[of_body]),
            )
        )
    return found


def far_followers(character: Character, found: list[Follower]) -> list[str]:
    """Warnings about what is too far from the skin to move as if it were flesh."""
    far = FAR * np.linalg.norm(np.ptp(character.vertices @ character.to_bind.T, axis=0))
    return [
        f"'{follower.name}' is up to {follower.skin.distances.max():.2g} m from the skin of '{character.name}': if it "
        "moves oddly, choose Own Cage or Rigid for it"
        for follower in found
        if follower.skin and follower.skin.distances.max() > far
    ]


def rest_points(obj) -> np.ndarray:
    """Points (V, 3) of the mesh without its shape keys, local space. Raises SceneError."""
    points = np.empty((len(obj.data.vertices), 3), np.float32)
    if obj.data.shape_keys:
        points = key_points(obj.data.shape_keys.reference_key)
    else:
        obj.data.attributes["position"].data.foreach_get("vector", points.ravel())
    if not np.isfinite(points).all():
        raise SceneError(f"'{obj.name}' has vertices whose coordinates are not numbers: delete or repair them")
    return points.astype(np.float64)


def armature_modifier(obj):
    """The Armature modifier whose armature places the targets of `obj`. Raises SceneError."""
    if obj is None or obj.type != "MESH":
        raise SceneError(f"'{obj.name if obj else 'Nothing'}' is not a mesh: select the character's mesh object")
    _refuse(checks.skinning(obj))
    return checks.main_modifier(obj)


def check_mesh(obj):
    """Raises SceneError about a mesh that has no surface, or is being edited."""
    _refuse(checks.mesh(obj))


def _refuse(problems):
    """Raises SceneError about the first of `problems`."""
    for problem in problems:
        raise SceneError(problem.text)


def warnings(obj, character: Character) -> list[str]:
    """What will be ignored, or is not likely to be meant."""
    left = _left_behind(obj, VertexGroups(obj))
    found = (*checks.notes(obj), *checks.body(obj.name, character.vertices, character.to_bind, left))
    return [problem.text for problem in found]


def first_look(obj) -> list[str]:
    """All that is in the way of simulating `obj`, or not likely to be meant, before it is a soft skin."""
    found = [*checks.problems(obj), *checks.notes(obj)]
    try:
        to_bind = stretch(worlds_at_start(obj, rig_of(obj))[0])
        left = _left_behind(obj, VertexGroups(obj))
    except SceneError as error:
        return [*(problem.text for problem in found), str(error)]
    points = np.empty((len(obj.data.vertices), 3), np.float32)
    obj.data.vertices.foreach_get("co", points.ravel())  # Edit Mode hides the attribute
    if len(points):
        found += checks.body(obj.name, points, to_bind, left)
    return [problem.text for problem in found]


def _left_behind(obj, groups: VertexGroups) -> np.ndarray:
    """Which vertices (V,) no bone moves."""
    unmoved = [
        _skin_weights(obj, modifier, rest_skeleton(modifier.object.data), groups)[:, -1] >= 1.0
        for modifier in checks.armature_modifiers(obj)
    ]
    return np.all(unmoved, axis=0)


def _target_sets(obj, skeleton: Skeleton, vertex_groups: VertexGroups) -> tuple[TargetSet, ...]:
    """The targets of the whole body, then those of each region, each set with the neutral target first.

    Regions share out the flesh: where their groups add up to less than one the body has the rest.
    """
    neutral, *others = checks.active_targets(obj)
    groups = list(dict.fromkeys(target.region for target in others if target.region))
    gone = [group for group in groups if group not in obj.vertex_groups]
    if gone:
        name = next(target.name for target in others if target.region == gone[0])
        raise SceneError(
            f"'{obj.name}': the vertex group '{gone[0]}' of target '{name}' is gone: choose another Region"
        )
    shares = vertex_groups.weights(groups).clip(0.0, 1.0)
    empty = [group for group, share in zip(groups, shares.T, strict=True) if not share.any()]
    if empty:
        raise SceneError(f"'{obj.name}': the vertex group '{empty[0]}' of a target's Region is empty: paint it")
    shares /= np.maximum(shares.sum(axis=1, keepdims=True), 1.0)
    sets = []
    for group, share in zip(["", *groups], [(1.0 - shares.sum(axis=1)).clip(0.0), *shares.T], strict=True):
        targets = [_target(obj, target, skeleton, vertex_groups) for target in others if target.region == group]
        at_rest = _target(obj, neutral, skeleton, vertex_groups)
        if group:
            at_rest = replace(at_rest, name=f"{at_rest.name} {group}")
        sets.append(TargetSet(group or obj.name, (at_rest, *targets), share))
    return tuple(sets)


def _target(obj, target, skeleton: Skeleton, groups: VertexGroups) -> Target:
    missing = [name for name in target.bone_names() if name not in skeleton.names]
    if missing:
        raise SceneError(f"'{obj.name}': bone '{missing[0]}' of target '{target.name}' is gone: capture its pose again")
    material = target.material()
    for field, value in (*vars(material).items(), ("influence", target.influence)):
        if not np.isfinite(value):  # property limits do not stop what Python or a driver sets
            raise SceneError(f"'{obj.name}': {field} of target '{target.name}' is not a number: set it again")
    neutral = target == obj.dynamorph.targets[0]
    shape = np.zeros((len(obj.data.vertices), 3)) if neutral else target_shape(obj, target.name, groups)
    local, rig_world = target.local(skeleton), np.array(target.rig_world).reshape(4, 4)
    if not (np.isfinite(local).all() and np.isfinite(rig_world).all()):
        raise SceneError(f"'{obj.name}': the pose of target '{target.name}' is not numbers: capture it again")
    return Target(
        target.name, shape, target.bone_names(), local, rig_world, material, target.radius, target.influence,
        target.frequency, target.by_hand,
    )  # fmt: skip


def target_shape(obj, key_name: str, groups: VertexGroups | None = None) -> np.ndarray:
    """What the shape key adds at value 1: (V, 3), local space. groups: those of `obj`, for who has read them."""
    block = obj.data.shape_keys.key_blocks[key_name]
    shape = key_points(block).astype(np.float64) - key_points(block.relative_key)
    if block.vertex_group in obj.vertex_groups:  # Blender ignores the name of a group that is gone
        shape *= (groups or VertexGroups(obj)).weights([block.vertex_group])
    return shape


def group_weights(obj, names) -> np.ndarray:
    """Weights (V, len(names)) of the vertex groups; 0 for vertices and groups that are not there."""
    return VertexGroups(obj).weights(names)


class VertexGroups:
    """The vertex groups of an object, read once: Blender hands them out vertex by vertex."""

    def __init__(self, obj):
        self._obj = obj
        flat = [
            part
            for vertex, of_vertex in enumerate(obj.data.vertices)
            for element in of_vertex.groups
            for part in (vertex, element.group, element.weight)
        ]
        self._vertices, self._groups, self._weights = np.array(flat, np.float64).reshape(-1, 3).T

    def weights(self, names) -> np.ndarray:
        """As `group_weights`. Raises SceneError."""
        obj = self._obj
        weights = np.zeros((len(obj.data.vertices), len(names)))
        for column, name in enumerate(names):
            if name in obj.vertex_groups:
                members = self._groups == obj.vertex_groups[name].index
                weights[self._vertices[members].astype(np.int64), column] = self._weights[members]
        bad = np.flatnonzero(~np.isfinite(weights).all(axis=0))
        if len(bad):
            raise SceneError(f"'{obj.name}': vertex group '{names[bad[0]]}' has weights that are not numbers")
        return weights


def skin_weights(obj, rig=None, groups: VertexGroups | None = None) -> np.ndarray:
    """Skin weights (V, B + 1) of any mesh with an Armature modifier, as `Character.weights`. Raises SceneError.

    rig: the armature object that is meant, if `obj` may have several; groups: those of `obj`, for who has read them.
    """
    modifier = armature_modifier(obj)
    modifier = next((each for each in checks.armature_modifiers(obj) if each.object == rig), modifier)
    return _skin_weights(obj, modifier, rest_skeleton(modifier.object.data), groups or VertexGroups(obj))


def _skin_weights(obj, modifier, skeleton: Skeleton, groups: VertexGroups) -> np.ndarray:
    bones = modifier.object.data.bones
    weights = groups.weights(skeleton.names)
    weights[:, [not bones[name].use_deform for name in skeleton.names]] = 0.0
    total = weights.sum(axis=1, keepdims=True)
    moved = total > NO_WEIGHT
    weights = np.where(moved, weights / np.where(moved, total, 1.0), 0.0)
    if modifier.vertex_group in obj.vertex_groups:  # the modifier's own mask blends with the unskinned position
        mask = groups.weights([modifier.vertex_group])
        weights *= 1.0 - mask if modifier.invert_vertex_group else mask
    return np.hstack([weights, 1.0 - weights.sum(axis=1, keepdims=True)])


def _painted(obj, groups: VertexGroups, use: str, group: str) -> np.ndarray:
    """Weights (V,) of the vertex group that the artist chose for Soft or Stiffness. Raises SceneError."""
    if group not in obj.vertex_groups:
        raise SceneError(f"'{obj.name}': the vertex group '{group}' for {use} is gone: choose another")
    return groups.weights([group])[:, 0].clip(0.0, 1.0)


def softness(obj, groups: VertexGroups) -> np.ndarray:
    group = obj.dynamorph.soft_group
    return _painted(obj, groups, "Soft", group) if group else np.ones(len(obj.data.vertices))


def stiffness(obj, groups: VertexGroups) -> np.ndarray:
    settings = obj.dynamorph
    if not settings.stiffness_group:
        return np.ones(len(obj.data.vertices))
    if not np.isfinite(settings.stiffness_factor):
        raise SceneError(f"'{obj.name}': the Factor of the Stiffness group is not a number: set it again")
    return settings.stiffness_factor ** _painted(obj, groups, "Stiffness", settings.stiffness_group)


def pieces_of(parts, mesh, groups: VertexGroups, first: int = 1) -> np.ndarray:
    """Which piece each vertex belongs to, as `Character.pieces` says. Where groups overlap the first one counts.

    parts: the pieces that are parts of the object `mesh`, of which `groups` are; first: number of the first cage of
    its own. Raises SceneError.
    """
    gone = next((part for part in parts if part.group not in mesh.vertex_groups), None)
    if gone:
        raise SceneError(
            f"'{mesh.name}': the vertex group '{gone.group}' of an attachment is gone: remove the attachment"
        )
    pieces, cages = np.zeros(len(mesh.data.vertices), np.int32), itertools.count(first)
    for part, members in members_of(parts, groups):
        if part.choice != "WITH_BODY" and members.any():
            pieces[members] = next(cages) if part.choice == "OWN_CAGE" else -1
    return pieces


def members_of(parts, groups: VertexGroups):
    """Each of the parts of a mesh with its vertices (V,) bool, without those of the parts before it."""
    taken = None
    for part, weights in zip(parts, groups.weights([part.group for part in parts]).T, strict=True):
        members = weights >= MEMBER
        members = members if taken is None else members & ~taken
        yield part, members
        taken = members if taken is None else taken | members


def bone_segments(bones, to_local, to_bind) -> np.ndarray:
    """Heads and tails (D, 2, 3) of bones at rest, bind space."""
    ends = np.array([(*bone.head_local, *bone.tail_local) for bone in bones]).reshape(-1, 2, 3)
    return carried(ends, to_local) @ to_bind.T + 0.0


def carried(points: np.ndarray, to_local: np.ndarray) -> np.ndarray:
    """Points (..., 3) of another object in local space. Rounded like the stretch: the last digits of this transform
    (4, 4) change when both objects are moved.
    """
    size = np.cbrt(abs(determinant(to_local[:3, :3])))
    units = 10.0 ** np.round(np.log10(np.maximum([size, size * np.abs(points).max()], 1e-300)))
    turn, shift = _rounded(to_local[:3, :3], units[0]), _rounded(to_local[:3, 3], units[1])
    return points @ turn.T + shift


def _own_cage(obj, rig, to_bind) -> OwnCage | None:
    """The artist's cage as it is when the scene starts and the armature is at rest, bind space. Raises SceneError."""
    cage = obj.dynamorph.model.cage_object
    if cage is None:
        return None
    if cage.name not in bpy.context.scene.objects:
        raise SceneError(f"Cage Object '{cage.name}' of '{obj.name}' is not in the scene any more: choose another")
    if cage.mode == "EDIT":
        raise SceneError(f"Cage Object '{cage.name}' is in Edit Mode: leave it first")
    if cage.hide_viewport:
        raise SceneError(f"Cage Object '{cage.name}' is disabled in viewports: enable it, and hide it by its eye")
    with _at_rest(rig), _rig_scene(obj, rig) as (scene, _follower):
        scene.collection.objects.link(cage)
        scene.frame_set(bpy.context.scene.frame_start)
        depsgraph = scene.view_layers[0].depsgraph
        evaluated = cage.evaluated_get(depsgraph)
        to_local = inverse(np.array(obj.evaluated_get(depsgraph).matrix_world)) @ np.array(evaluated.matrix_world)
        mesh = evaluated.to_mesh()
        points = np.empty((len(mesh.vertices), 3), np.float32)
        mesh.vertices.foreach_get("co", points.ravel())
        triangles = mesh_triangles(mesh)
        evaluated.to_mesh_clear()
    if not len(triangles):
        raise SceneError(f"Cage Object '{cage.name}' has no faces: choose a closed mesh")
    return OwnCage(cage.name, carried(points.astype(np.float64), to_local) @ to_bind.T, triangles)


@contextmanager
def _at_rest(rig):
    position = rig.data.pose_position
    rig.data.pose_position = "REST"
    try:
        yield
    finally:
        rig.data.pose_position = position


def mesh_triangles(mesh) -> np.ndarray:
    """The faces (T, 3), cut into triangles as Blender draws them."""
    mesh.calc_loop_triangles()
    triangles = np.empty((len(mesh.loop_triangles), 3), np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles.ravel())
    return triangles


def unit_scale() -> float:
    """Metres in a Blender unit, as the scene's unit settings say. All that is read of the world is in metres."""
    units = bpy.context.scene.unit_settings
    return 1.0 if units.system == "NONE" else units.scale_length


def _in_metres(worlds: np.ndarray, unit: float) -> np.ndarray:
    """World transforms (..., 4, 4) for the world in metres instead of Blender units of `unit` metres."""
    return worlds * np.array([unit, unit, unit, 1.0])[:, None]


def worlds_at_start(obj, rig) -> list[np.ndarray]:
    """World transforms of both, metres, when the scene starts: a model that depended on the current frame would age by
    playing. Raises SceneError.
    """
    with _rig_scene(obj, rig) as (scene, _follower):
        scene.frame_set(bpy.context.scene.frame_start)
        depsgraph = scene.view_layers[0].depsgraph
        worlds = [np.array(moving.evaluated_get(depsgraph).matrix_world) for moving in (obj, rig)]
    for moving, world in zip((obj, rig), worlds, strict=True):
        if not np.isfinite(world).all():
            raise SceneError(_not_a_number(moving.name, bpy.context.scene.frame_start))
        sizes = np.linalg.svd(world[:3, :3], compute_uv=False)
        if sizes[-1] <= 1e-6 * sizes[0]:
            raise SceneError(f"'{moving.name}' is scaled to zero: give it a size")
    return [_in_metres(world, unit_scale()) for world in worlds]


def _not_a_number(name: str, frame: int) -> str:
    return f"'{name}' has a transform that is not a number at frame {frame}: check its drivers and constraints"


def stretch(world) -> np.ndarray:
    """An object's scale without its rotation: the symmetric factor of the world transform's polar decomposition."""
    values, vectors = np.linalg.eigh(world[:3, :3].T @ world[:3, :3])
    stretch = (vectors * np.sqrt(values)) @ vectors.T
    # Rounded, or the object's rotation would show in the last digits and make the model out of date.
    return _rounded(stretch, 10.0 ** np.floor(np.log10(stretch.max())))


def _rounded(values: np.ndarray, unit: float) -> np.ndarray:
    """To five digits after the unit, which has the values' size: Blender's transforms have about seven."""
    return np.round(values / unit, 5) * unit + 0.0  # no negative zeros


# The pose ----------------------------------------------------------------------------------------------------------


def current_pose(obj, depsgraph=None) -> tuple[Skeleton, np.ndarray, np.ndarray]:
    """The evaluated pose now: skeleton, local transforms (B, 4, 4), armature's world transform (4, 4), metres.

    depsgraph: where it is evaluated, if not where the artist sees it.
    """
    modifier = armature_modifier(obj)
    _refuse(checks.rig(obj, modifier))
    rig = modifier.object
    skeleton = rest_skeleton(rig.data)
    evaluated = rig.evaluated_get(depsgraph or bpy.context.evaluated_depsgraph_get())
    pose = pose_matrices(evaluated, pose_order(rig, skeleton))
    rig_world = world_now(rig, depsgraph)
    for name, matrix in zip(skeleton.names, pose, strict=True):
        if not np.isfinite(matrix).all():
            raise SceneError(_not_a_number(name, bpy.context.scene.frame_current))
    flat = [name for name, matrix in zip(skeleton.names, pose, strict=True) if not _invertible(matrix)]
    if flat:
        raise SceneError(f"Bone '{flat[0]}' of '{rig.name}' is scaled to zero: give it a size to capture the pose")
    return skeleton, skeleton.local_transforms(pose), rig_world


def world_now(obj, depsgraph=None) -> np.ndarray:
    """The evaluated world transform (4, 4) of an object, metres; depsgraph: as `current_pose`. Raises SceneError."""
    world = np.array(obj.evaluated_get(depsgraph or bpy.context.evaluated_depsgraph_get()).matrix_world)
    if not np.isfinite(world).all():
        raise SceneError(_not_a_number(obj.name, bpy.context.scene.frame_current))
    return _in_metres(world, unit_scale())


def bones_turned(obj, skeleton: Skeleton, first: np.ndarray, second: np.ndarray) -> list[str]:
    """Names of the deforming bones whose local rotation differs by more than MOVED."""
    bones = armature_modifier(obj).object.data.bones
    angles = turned(first, second)
    return [
        name for name, angle in zip(skeleton.names, angles, strict=True) if angle > MOVED and bones[name].use_deform
    ]


def pose_order(rig, skeleton: Skeleton) -> list[int]:
    """Where the skeleton's bones are among those of the armature object's pose."""
    return [rig.pose.bones.find(name) for name in skeleton.names]


def pose_matrices(evaluated_rig, order) -> np.ndarray:
    """Pose matrices (B, 4, 4), armature space."""
    columns = np.empty((len(order), 4, 4), np.float32)
    _read_pose(evaluated_rig, columns)
    return _ordered(columns, order)


def _read_pose(evaluated_rig, columns: np.ndarray):
    """Pose matrices as Blender has them: (B, 4, 4) float32, column after column, bones in the armature's order."""
    evaluated_rig.pose.bones.foreach_get("matrix", columns.ravel())


def _ordered(columns: np.ndarray, order) -> np.ndarray:
    """Pose matrices (..., B, 4, 4), row after row, bones in the skeleton's order, from what `_read_pose` reads."""
    return columns.swapaxes(-1, -2)[..., order, :, :].astype(np.float64)


def _rows(matrix) -> tuple[tuple[float, ...], ...]:
    """A Blender matrix for NumPy, which asks Blender for each number when it gets the matrix itself."""
    return tuple(map(tuple, matrix))


def _invertible(matrices: np.ndarray) -> np.ndarray:
    return np.abs(determinant(matrices[..., :3, :3])) > 1e-12


# The moving rig ----------------------------------------------------------------------------------------------------


def sample_rig(obj, start: int, end: int, substeps: int, probe=None) -> RigSamples:
    """The rig at 1 + (end - start) * substeps times, at once; probe: as in `RigSampling`. Raises SceneError."""
    sampling = RigSampling(obj, start, end, substeps)
    sampling.probe = probe
    sampling.advance(obj)
    return sampling.samples()


def sample_present(obj, probe=None) -> RigSamples:
    """One sample of the rig as the artist sees it posed now; probe: as in `RigSampling`. Raises SceneError."""
    skeleton, local, rig_world = current_pose(obj)
    pose, world = skeleton.pose(local)[None], world_now(obj)[None]
    if probe is None:
        return RigSamples(pose, rig_world[None], world)
    rig, frame = armature_modifier(obj).object, bpy.context.scene.frame_float
    with _rig_scene(obj, rig, probe) as (scene, follower):
        scene.frame_set(int(frame), subframe=frame % 1.0)
        nodes, held = (probe.in_poses(scene, follower, rig, poses) for poses in (pose, probe.poses))
    return RigSamples(pose, rig_world[None], world, nodes=nodes, held=held)


class RigSampling:
    """Reads the rig at 1 + (end - start) * substeps times, true sub-frames, without evaluating the mesh.

    It does so in slices, between which Blender does other things. Each makes a scene of its own, in a few milliseconds:
    one that stayed in between would be seen, saved, and brought back by undo. The user's frame and pose stay as they
    are.

    probe: the nodes that Blender is to pose too (`probe.Probe`), to be set before the first slice.
    """

    def __init__(self, obj, start: int, end: int, substeps: int):
        rig = armature_modifier(obj).object
        self.start, self.substeps = start, substeps
        self.probe = self._nodes = self._held = None
        self.done, self.count = 0, 1 + (end - start) * substeps
        self._unit = unit_scale()
        self._skeleton = rest_skeleton(rig.data)
        self._order = pose_order(rig, self._skeleton)
        self._moving = _moving(obj, rig)
        sources = _force_fields(bpy.context.view_layer) if obj.dynamorph.simulation.fields else []
        self._sources = [source.name for source in sources]
        self._columns = np.empty((self.count, len(self._order), 4, 4), np.float32)
        self._rig_world, self._object_world = np.empty((2, self.count, 4, 4))
        self._fields = tuple(_empty_samples(source.field, self.count, self._unit) for source in sources)

    @property
    def frame(self) -> int:
        """The frame that comes next."""
        return self.start + self.done // self.substeps

    def advance(self, obj, seconds: float = np.inf) -> bool:
        """Read on for about so long; True when all is read. obj: the same object, which may have moved in memory.

        Raises SceneError.
        """
        ends = time.perf_counter() + seconds
        rig = armature_modifier(obj).object
        sources = [bpy.context.scene.objects.get(name) for name in self._sources]
        if _moving(obj, rig) != self._moving or None in sources:
            raise SceneError(f"'{obj.name}' or what moves it changed while it was read: start again")
        with _rig_scene(obj, rig, self.probe) as (scene, follower):
            for source in sources:
                if source.name not in scene.collection.objects:  # the rig may be one
                    scene.collection.objects.link(source)
            if self.probe and self._nodes is None:
                scene.frame_set(self.start)
                self._held = self.probe.in_poses(scene, follower, rig, self.probe.poses)
                self._nodes = self.probe.empty_samples(self.count)
            while self.done < self.count:
                self._read(scene, obj, rig, sources)
                if self.probe:
                    self.probe.read(scene, follower, self._nodes.points[self.done])
                self.done += 1
                if time.perf_counter() > ends:
                    break
        return self.done == self.count

    def _read(self, scene, obj, rig, sources):
        s = self.done
        scene.frame_set(self.frame, subframe=s % self.substeps / self.substeps)
        depsgraph = scene.view_layers[0].depsgraph  # None before the first frame_set
        evaluated = rig.evaluated_get(depsgraph)
        _read_pose(evaluated, self._columns[s])
        self._rig_world[s] = _rows(evaluated.matrix_world)
        self._object_world[s] = _rows(obj.evaluated_get(depsgraph).matrix_world)
        for source, field in zip(sources, self._fields, strict=True):
            moved = source.evaluated_get(depsgraph)
            field.world[s] = _rows(moved.matrix_world)
            field.strength[s] = moved.field.strength * obj.dynamorph.simulation.fields

    def samples(self) -> RigSamples:
        """All that was read. Raises SceneError when some of it is not a number, or scaled to zero."""
        worlds = _in_metres(np.stack([self._rig_world, self._object_world], axis=1), self._unit)
        fields = tuple(replace(field, world=_in_metres(field.world, self._unit)) for field in self._fields)
        pose = _ordered(self._columns, self._order)
        samples = RigSamples(pose, worlds[:, 0], worlds[:, 1], fields, self._nodes, self._held)
        bad = np.argwhere(~np.isfinite(np.concatenate([worlds, samples.pose], axis=1)).all(axis=(2, 3)))
        if len(bad):
            raise SceneError(_not_a_number(self._moving[bad[0, 1]], self._frame(bad[0, 0])))
        flat = np.argwhere(determinant(worlds[..., :3, :3]) == 0)  # bones may collapse: `hold_collapsed`
        if len(flat):
            name, frame = self._moving[flat[0, 1]], self._frame(flat[0, 0])
            raise SceneError(f"'{name}' is scaled to zero at frame {frame}: hide it instead, or bake another range")
        for nodes in filter(None, (self._nodes, self._held)):
            if not np.isfinite(nodes.points).all():
                raise SceneError(_not_a_number(self._moving[1], self.start))
        for name, field in zip(self._sources, self._fields, strict=True):
            if not (np.isfinite(field.world).all() and np.isfinite(field.strength).all()):
                raise SceneError(f"Force field '{name}' is not a number at some frame: check its drivers")
        return samples

    def _frame(self, sample) -> int:
        return self.start + int(sample) // self.substeps


def _moving(obj, rig) -> tuple[str, ...]:
    """Names of what moves `obj`: the armature, the object, the bones, and other armatures that skin it."""
    others = (modifier.object.name for modifier in checks.armature_modifiers(obj))
    return (rig.name, obj.name, *rest_skeleton(rig.data).names, *others)


def _force_fields(view_layer) -> list:
    """The objects whose force field pushes skin. Raises SceneError for kinds that would act otherwise than shown."""
    found = []
    for obj in view_layer.objects:
        field = obj.field
        if not field or field.type not in {"WIND", "FORCE"} or not field.apply_to_location or obj.hide_viewport:
            continue
        if field.shape not in {"POINT", "PLANE"} or field.falloff_type != "SPHERE" or field.z_direction != "BOTH":
            raise SceneError(
                f"Force field '{obj.name}' cannot push skin as it is: choose Shape Point or Plane, Falloff Sphere "
                "and Z Direction Both, or set Force Fields to 0"
            )
        found.append(obj)
    return found


def _empty_samples(field, count: int, unit: float) -> ForceField:
    nearest = unit * field.distance_min if field.use_min_distance else 0.0
    farthest = unit * field.distance_max if field.use_max_distance else np.inf
    plane = field.shape == "PLANE"
    return ForceField(
        field.type, plane, field.falloff_power, nearest, farthest, np.empty((count, 4, 4)), np.empty(count)
    )


@contextmanager
def _rig_scene(obj, rig, probe=None):
    """A scene with the rig, so that a frame costs what the rig costs; and an object that follows the mesh object.

    That copies the mesh object's transform, which makes the dependency graph evaluate it, with its parents, constraints
    and drivers, but not the mesh. It is empty, or a probe's mesh that is skinned like the body.
    """
    if render_runs():
        raise SceneError("Blender is rendering: wait until it is done")
    user = bpy.context.scene.render
    scene = bpy.data.scenes.new("Dynamorph Sampling")
    mesh = probe and probe.mesh()
    follower = bpy.data.objects.new("Dynamorph Sampling", mesh)
    try:
        for field in ("fps", "fps_base", "frame_map_old", "frame_map_new"):
            setattr(scene.render, field, getattr(user, field))
        follower.constraints.new("COPY_TRANSFORMS").target = obj
        if probe:
            probe.dress(follower, obj)
        scene.collection.objects.link(rig)
        scene.collection.objects.link(follower)
        yield scene, follower
    finally:
        bpy.data.scenes.remove(scene)
        bpy.data.objects.remove(follower)
        if mesh:
            bpy.data.meshes.remove(mesh)


def animation(obj) -> list[tuple[str, str]]:
    """(name, hash of the F-curves and NLA strips) of the objects that move the skin: all and their parents."""
    moving = []
    for mover in (rig_of(obj), obj, *(modifier.object for modifier in checks.armature_modifiers(obj))):
        while mover is not None and mover not in moving:
            moving.append(mover)
            mover = mover.parent
    return [(mover.name, _animation_hash(mover.animation_data)) for mover in moving]


def _animation_hash(data) -> str:
    if data is None:
        return ""
    digest = hashlib.blake2b(digest_size=8)
    strips = [strip for track in data.nla_tracks if not track.mute for strip in track.strips if not strip.mute]
    for strip in strips:
        digest.update(repr([getattr(strip, name) for name in STRIP_FIELDS]).encode())
    for player in (data, *strips):
        for curve in checks.curves(player.action, player.action_slot):
            digest.update(f"{curve.data_path}[{curve.array_index}] {curve.extrapolation} {curve.mute}".encode())
            for name, width in (("co", 2), ("handle_left", 2), ("handle_right", 2), ("interpolation", 1)):
                values = np.empty(width * len(curve.keyframe_points), np.float32 if width == 2 else np.int32)
                curve.keyframe_points.foreach_get(name, values)
                digest.update(values.tobytes())
    return digest.hexdigest()


def render_runs() -> bool:
    """Whether Blender renders beside this thread. Data that is added or removed then makes it crash."""
    return threading.current_thread() is threading.main_thread() and bpy.app.is_job_running("RENDER")


def hold_collapsed(samples: RigSamples, skeleton: Skeleton, before=None) -> tuple[RigSamples, list[str]]:
    """Bones scaled to zero (the pop-to-nothing trick) follow their parents as they last did; returns warnings naming
    them. before (B, 4, 4): the pose ahead of the samples, without such bones, if it is known.
    """
    pose = samples.pose if before is None else np.concatenate([before[None], samples.pose])
    good = _invertible(pose)
    if good.all():
        return samples, []
    times = np.arange(len(pose))[:, None]
    last = np.maximum.accumulate(np.where(good, times, -1), axis=0)
    held = np.where(last >= 0, last, good.argmax(axis=0))  # before its first size: that first size
    pose = pose.copy()
    collapsed = np.flatnonzero(~good.all(axis=0))
    for b in collapsed:  # parents come first
        parent = skeleton.parents[b]
        joined = skeleton.rest[b] if parent < 0 else pose[:, parent] @ skeleton.rest_inverse[parent] @ skeleton.rest[b]
        local = (inverse(joined) @ pose[:, b])[held[:, b]] if good[:, b].any() else np.eye(4)
        pose[:, b] = np.where(good[:, b, None, None], pose[:, b], joined @ local)
    names = ", ".join(f"'{skeleton.names[b]}'" for b in collapsed)
    frames = int((~good[-len(samples) :]).any(axis=1).sum())
    warning = f"Bones scaled to zero are held at their last size ({frames} of {len(samples)} samples): {names}"
    return replace(samples, pose=pose[-len(samples) :]), [warning]


def output_settings(obj) -> OutputSettings:
    """What the bakes of `obj` become, lengths in metres."""
    chosen = obj.dynamorph.output.settings()
    return replace(chosen, tolerance=unit_scale() * chosen.tolerance)


def simulation_settings(obj, scene, frames=None, substeps=None) -> SimulationSettings:
    """The run that `obj` asks for in `scene`; frames (start, end) and substeps override it, which are rounded up to a
    multiple of the samples a frame. Raises SceneError.

    The scene's gravity is taken as m/s^2 whatever its unit scale. Blender's own simulations take it as Blender units
    per s^2.
    """
    chosen = obj.dynamorph.simulation
    fps = scene.render.fps / scene.render.fps_base
    own = (scene.frame_start, scene.frame_end) if chosen.use_scene_range else (chosen.start, chosen.end)
    start, end = frames or own
    if end < start:
        raise SceneError(f"'{obj.name}': the last frame {end} comes before the first {start}: change the range")
    substeps = substeps or chosen.steps_per_frame(fps)
    gravity = np.array(scene.gravity) * (chosen.gravity if scene.use_gravity else 0.0)
    gains = tuple(mode.gain for mode in obj.dynamorph.modes)
    return SimulationSettings(
        start,
        end,
        fps,
        -(-substeps // chosen.samples) * chosen.samples,
        chosen.scheme,
        tuple(gravity.tolist()),
        chosen.samples,
        chosen.preroll,
        chosen.preroll_pose,
        chosen.begin,
        chosen.loop,
        gains if set(gains) != {1.0} else (),
        chosen.amount,
    )
