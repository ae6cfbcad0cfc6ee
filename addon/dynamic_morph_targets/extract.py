# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender scene -> scene_data. Reads only; what cannot be simulated is refused here, with the remedy.

Skinning is Blender's: shape keys first, then the Armature modifier, weights normalised over the deforming bones.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace

import bpy
import numpy as np

from .properties import key_points, reconcile, rest_skeleton
from .scene_data import (
    Character,
    ForceField,
    RigSamples,
    SimulationSettings,
    Skeleton,
    Target,
    TargetSet,
    determinant,
    inverse,
)

SAME_POSE = np.radians(0.5)  # the engine cannot interpolate between targets nearer than this in all bones together
MOVED = np.radians(5.0)  # a bone turned further than this from the neutral pose places a target by default
PLAUSIBLE = (0.02, 20.0)  # metres from corner to corner; a body of another size is probably not meant
NO_WEIGHT = 1e-4  # Blender leaves a vertex alone when its weights sum to less

# Modifiers that may change the number of vertices: before the Armature they break the match with the shape keys.
GENERATING = {
    "ARRAY", "BEVEL", "BOOLEAN", "BUILD", "DECIMATE", "EDGE_SPLIT", "MASK", "MESH_TO_VOLUME", "MIRROR", "MULTIRES",
    "NODES", "OCEAN", "PARTICLE_INSTANCE", "REMESH", "SCREW", "SKIN", "SOLIDIFY", "SUBSURF", "VOLUME_TO_MESH", "WELD",
    "WIREFRAME",
}  # fmt: skip
DEFORMING = {
    "CAST", "CLOTH", "CORRECTIVE_SMOOTH", "CURVE", "DISPLACE", "HOOK", "LAPLACIANDEFORM", "LAPLACIANSMOOTH", "LATTICE",
    "MESH_CACHE", "MESH_DEFORM", "MESH_SEQUENCE_CACHE", "SHRINKWRAP", "SIMPLE_DEFORM", "SMOOTH", "SOFT_BODY",
    "SURFACE_DEFORM", "VOLUME_DISPLACE", "WARP", "WAVE",
}  # fmt: skip


class SceneError(ValueError):
    """The scene cannot be simulated as it is. The message names the object and what to do."""


class Cancelled(Exception):
    """The user stopped the job."""


# The character -----------------------------------------------------------------------------------------------------


def character(obj) -> Character:
    """The soft skin authored on `obj`. Raises SceneError."""
    modifier = armature_modifier(obj)
    reconcile(obj)
    _check(obj, modifier)
    skeleton = rest_skeleton(modifier.object.data)
    groups = VertexGroups(obj)
    target_sets = _target_sets(obj, skeleton, groups)
    for target_set in target_sets:
        _check_poses(obj, target_set.targets, skeleton)
    basis = obj.data.shape_keys.reference_key
    settings = obj.dynamorph
    world, rig_world = _worlds_at_start(obj, modifier.object)
    to_bind = _stretch(world)
    return Character(
        name=obj.name,
        vertices=key_points(basis).astype(np.float64),
        triangles=mesh_triangles(obj.data),
        to_bind=to_bind,
        weights=_skin_weights(obj, modifier, skeleton, groups),
        softness=_softness(obj, groups),
        bone_segments=_bone_segments(obj, modifier.object, inverse(world) @ rig_world, to_bind),
        skeleton=skeleton,
        target_sets=target_sets,
        settings=settings.model.settings(),
    )


def armature_modifier(obj):
    """The one Armature modifier that skins `obj`. Raises SceneError."""
    if obj is None or obj.type != "MESH":
        raise SceneError(f"'{obj.name if obj else 'Nothing'}' is not a mesh: select the character's mesh object")
    modifiers = [m for m in obj.modifiers if m.type == "ARMATURE" and m.object]
    if not modifiers:
        raise SceneError(f"'{obj.name}' has no Armature modifier with an armature: add one, or parent the mesh to it")
    if len(modifiers) > 1:
        names = " and ".join(f"'{m.name}'" for m in modifiers)
        raise SceneError(f"'{obj.name}' has more than one Armature modifier ({names}): keep one")
    return modifiers[0]


def warnings(obj, character: Character) -> list[str]:
    """What will be ignored, or is not likely to be meant."""
    found = [
        f"'{obj.name}': modifier '{modifier.name}' before the Armature is not simulated"
        for modifier in _modifiers_before(obj, armature_modifier(obj))
        if modifier.type in DEFORMING
    ]
    if obj.show_only_shape_key:
        found.append(f"'{obj.name}' shows only its active shape key: unpin it (Shape Keys panel) to see the bake")
    size = np.linalg.norm(np.ptp(character.vertices @ character.to_bind.T, axis=0))
    if not PLAUSIBLE[0] <= size <= PLAUSIBLE[1]:
        found.append(f"'{obj.name}' is {size:.3g} m long: check the scale, it will move like something of that size")
    return found


def _check(obj, modifier):
    """Raises SceneError about what makes `obj` impossible to simulate."""
    check_mesh(obj)
    _check_rig(obj, modifier)
    _check_keys(obj)
    for before in _modifiers_before(obj, modifier):
        if before.type in GENERATING:
            raise SceneError(f"'{obj.name}': modifier '{before.name}' comes before the Armature: move it below")


def _check_rig(obj, modifier):
    rig = modifier.object
    if rig.mode == "EDIT":
        raise SceneError(f"Armature '{rig.name}' is in Edit Mode: leave it first")
    if rig.data.pose_position == "REST":
        raise SceneError(f"Armature '{rig.name}' is shown in rest position: choose Pose Position in its Data tab")
    if rig.hide_viewport:
        raise SceneError(f"Armature '{rig.name}' is disabled in viewports, so Blender does not move it: enable it")
    if not modifier.show_viewport:
        raise SceneError(f"'{obj.name}': Armature modifier '{modifier.name}' is disabled in viewports: enable it")
    if modifier.use_deform_preserve_volume:
        raise SceneError(f"'{obj.name}' uses Preserve Volume: turn it off in Armature modifier '{modifier.name}'")
    if modifier.use_bone_envelopes or not modifier.use_vertex_groups:
        raise SceneError(
            f"'{obj.name}' is skinned by bone envelopes: in Armature modifier '{modifier.name}' turn Bone Envelopes "
            "off and Vertex Groups on"
        )
    if modifier.use_multi_modifier:
        raise SceneError(f"'{obj.name}': turn Multi Modifier off in Armature modifier '{modifier.name}'")
    bones = [bone for bone in rig.data.bones if bone.use_deform and bone.name in obj.vertex_groups]
    if not bones:
        raise SceneError(
            f"'{obj.name}' has no vertex group named after a deforming bone of '{rig.name}': weight it first"
        )
    longest = max(bone.length for bone in bones)
    for bone in bones:
        if bone.bbone_segments > 1:
            raise SceneError(f"Bone '{bone.name}' of '{rig.name}' is a bendy bone: set its Segments to 1")
        if bone.use_envelope_multiply:
            raise SceneError(f"Bone '{bone.name}' of '{rig.name}': turn off Envelope Multiply in its Deform panel")
        if bone.length <= 1e-5 * longest:
            raise SceneError(f"Bone '{bone.name}' of '{rig.name}' has no length: move its tail, or turn off its Deform")


def check_mesh(obj):
    """Raises SceneError about a mesh that has no surface, or is being edited."""
    mesh = obj.data
    if obj.mode == "EDIT":
        raise SceneError(f"'{obj.name}' is in Edit Mode: leave it first")
    if not mesh.polygons:
        raise SceneError(f"Mesh '{obj.name}' has no faces: model some, or choose the right object")


def _check_keys(obj):
    if not obj.dynamorph.targets:
        raise SceneError(f"'{obj.name}' is no soft skin: select it and press Add Soft Skin")
    keys = obj.data.shape_keys
    if keys is None:
        raise SceneError(f"'{obj.name}' has no shape keys: add a Basis and one key a target")
    if not keys.use_relative:
        raise SceneError(f"'{obj.name}' uses absolute shape keys: turn on Relative in the Shape Keys panel")
    targets = _active_targets(obj)
    if len(targets) < 2 and obj.dynamorph.model.method != "SINGLE":
        if len(obj.dynamorph.targets) > 1:
            raise SceneError(f"'{obj.name}': all targets are muted: unmute one, or choose the Method Single")
        raise SceneError(f"'{obj.name}' has no targets: select a shape key, pose the armature and press Add Target")
    for target in targets[1:]:
        if target.name not in keys.key_blocks:
            raise SceneError(f"'{obj.name}': the shape key of target '{target.name}' is gone: remove the target")
        if keys.key_blocks[target.name] == keys.reference_key:
            raise SceneError(
                f"'{obj.name}': target '{target.name}' has become the Basis, which moves nothing: put a Basis above it "
                "in the Shape Keys panel, or remove the target"
            )
    for block in (keys.reference_key, *(keys.key_blocks[target.name] for target in targets[1:])):
        bad = np.flatnonzero(~np.isfinite(key_points(block)).all(axis=1))
        if len(bad):
            raise SceneError(
                f"'{obj.name}': shape key '{block.name}' has coordinates that are not numbers at vertices "
                f"{', '.join(map(str, bad[:5]))}: delete or repair them"
            )


def _modifiers_before(obj, armature) -> list:
    """The modifiers that change the mesh before its Armature modifier does."""
    before = obj.modifiers[: obj.modifiers.find(armature.name)]
    return [modifier for modifier in before if modifier.show_viewport or modifier.show_render]


def _active_targets(obj):
    """The neutral target and those that are not muted."""
    return [target for i, target in enumerate(obj.dynamorph.targets) if i == 0 or not target.mute]


def _target_sets(obj, skeleton: Skeleton, vertex_groups: VertexGroups) -> tuple[TargetSet, ...]:
    """The targets of the whole body, then those of each region, each set with the neutral target first.

    Regions share out the flesh: where their groups add up to less than one the body has the rest.
    """
    neutral, *others = _active_targets(obj)
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
    for field, value in vars(material).items():
        if not np.isfinite(value):  # property limits do not stop what Python or a driver sets
            raise SceneError(f"'{obj.name}': {field} of target '{target.name}' is not a number: set it again")
    neutral = target == obj.dynamorph.targets[0]
    shape = np.zeros((len(obj.data.vertices), 3)) if neutral else target_shape(obj, target.name, groups)
    local, rig_world = target.local(skeleton), np.array(target.rig_world).reshape(4, 4)
    if not (np.isfinite(local).all() and np.isfinite(rig_world).all()):
        raise SceneError(f"'{obj.name}': the pose of target '{target.name}' is not numbers: capture it again")
    return Target(target.name, shape, target.bone_names(), local, rig_world, material)


def _check_poses(obj, targets, skeleton: Skeleton):
    """Refuse targets that the rotations of the targets' bones, and of no others, cannot tell apart."""
    for target in targets[1:]:
        if not target.bones:
            raise SceneError(
                f"'{obj.name}': target '{target.name}' has no bones: pose the armature away from the neutral target "
                "and press Capture Pose"
            )
    named = {bone for target in targets for bone in target.bones}
    used = [name in named for name in skeleton.names]
    for i, first in enumerate(targets):
        for second in targets[i + 1 :]:
            if np.linalg.norm(turned(first.local[used], second.local[used])) < SAME_POSE:
                raise SceneError(
                    f"'{obj.name}': targets '{first.name}' and '{second.name}' have the same pose in the bones that "
                    "place targets: capture one of them in another pose, choose its bones, or remove it"
                )


def target_shape(obj, key_name: str, groups: VertexGroups | None = None) -> np.ndarray:
    """What the shape key adds at value 1: (V, 3), local space. groups: those of `obj`, for who has read them."""
    groups = groups or VertexGroups(obj)
    block = obj.data.shape_keys.key_blocks[key_name]
    shape = key_points(block).astype(np.float64) - key_points(block.relative_key)
    if block.vertex_group in obj.vertex_groups:  # Blender ignores the name of a group that is gone
        shape *= groups.weights([block.vertex_group])
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


def _softness(obj, groups: VertexGroups) -> np.ndarray:
    name = obj.dynamorph.soft_group
    if not name:
        return np.ones(len(obj.data.vertices))
    if name not in obj.vertex_groups:
        raise SceneError(f"'{obj.name}': the vertex group '{name}' for Soft is gone: choose another")
    return groups.weights([name])[:, 0]


def _bone_segments(obj, rig, to_local, to_bind) -> np.ndarray:
    """Heads and tails (D, 2, 3) of the deforming bones at rest, bind space."""
    bones = [bone for bone in rig.data.bones if bone.use_deform and bone.name in obj.vertex_groups]
    ends = np.array([(*bone.head_local, 1.0, *bone.tail_local, 1.0) for bone in bones]).reshape(-1, 2, 4)
    # Rounded like the stretch: the last digits of this product change when both objects are moved.
    return (ends @ np.round(to_local, 5).T)[..., :3] @ to_bind.T + 0.0


def mesh_triangles(mesh) -> np.ndarray:
    """The faces (T, 3), cut into triangles as Blender draws them."""
    mesh.calc_loop_triangles()
    triangles = np.empty((len(mesh.loop_triangles), 3), np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles.ravel())
    return triangles


def _worlds_at_start(obj, rig) -> list[np.ndarray]:
    """World transforms of both when the scene starts: a model that depended on the current frame would age by playing.

    Raises SceneError.
    """
    with _rig_scene(obj, rig) as scene:
        scene.frame_set(bpy.context.scene.frame_start)
        depsgraph = scene.view_layers[0].depsgraph
        worlds = [np.array(moving.evaluated_get(depsgraph).matrix_world) for moving in (obj, rig)]
    for moving, world in zip((obj, rig), worlds, strict=True):
        if not np.isfinite(world).all():
            raise SceneError(_not_a_number(moving.name, bpy.context.scene.frame_start))
        sizes = np.linalg.svd(world[:3, :3], compute_uv=False)
        if sizes[-1] <= 1e-6 * sizes[0]:
            raise SceneError(f"'{moving.name}' is scaled to zero: give it a size")
    return worlds


def _not_a_number(name: str, frame: int) -> str:
    return f"'{name}' has a transform that is not a number at frame {frame}: check its drivers and constraints"


def _stretch(world) -> np.ndarray:
    """An object's scale without its rotation: the symmetric factor of the world transform's polar decomposition."""
    values, vectors = np.linalg.eigh(world[:3, :3].T @ world[:3, :3])
    stretch = (vectors * np.sqrt(values)) @ vectors.T
    # Rounded, or the object's rotation would show in the last digits and make the model out of date.
    unit = 10.0 ** np.floor(np.log10(stretch.max()))
    return np.round(stretch / unit, 5) * unit + 0.0  # no negative zeros


# The pose ----------------------------------------------------------------------------------------------------------


def turned(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Angle, in radians, between the rotations of two arrays of transforms (B, 4, 4)."""

    def rotation(transforms):
        u, _, vt = np.linalg.svd(transforms[:, :3, :3])
        return u @ vt

    # From the chord, because the arc cosine of the trace loses small angles.
    chord = np.linalg.norm(rotation(first) - rotation(second), axis=(1, 2)) / np.sqrt(8.0)
    return 2.0 * np.arcsin(np.clip(chord, 0.0, 1.0))


def current_pose(obj) -> tuple[Skeleton, np.ndarray, np.ndarray]:
    """The evaluated pose now: skeleton, local transforms (B, 4, 4), armature's world transform (4, 4)."""
    modifier = armature_modifier(obj)
    _check_rig(obj, modifier)
    rig = modifier.object
    skeleton = rest_skeleton(rig.data)
    evaluated = rig.evaluated_get(bpy.context.evaluated_depsgraph_get())
    pose = _pose_matrices(evaluated, _pose_order(rig, skeleton))
    rig_world = np.array(evaluated.matrix_world)
    for name, matrix in ((rig.name, rig_world), *zip(skeleton.names, pose, strict=True)):
        if not np.isfinite(matrix).all():
            raise SceneError(_not_a_number(name, bpy.context.scene.frame_current))
    flat = [name for name, matrix in zip(skeleton.names, pose, strict=True) if not _invertible(matrix)]
    if flat:
        raise SceneError(f"Bone '{flat[0]}' of '{rig.name}' is scaled to zero: give it a size to capture the pose")
    return skeleton, skeleton.local_transforms(pose), rig_world


def bones_turned(obj, skeleton: Skeleton, first: np.ndarray, second: np.ndarray) -> list[str]:
    """Names of the deforming bones whose local rotation differs by more than MOVED."""
    bones = armature_modifier(obj).object.data.bones
    angles = turned(first, second)
    return [
        name for name, angle in zip(skeleton.names, angles, strict=True) if angle > MOVED and bones[name].use_deform
    ]


def _pose_order(rig, skeleton: Skeleton) -> list[int]:
    return [rig.pose.bones.find(name) for name in skeleton.names]


def _pose_matrices(evaluated_rig, order) -> np.ndarray:
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


def sample_rig(obj, start: int, end: int, substeps: int, progress=None) -> RigSamples:
    """The rig at 1 + (end - start) * substeps times, true sub-frames, without evaluating the mesh. Raises SceneError.

    progress(fraction, message) -> bool; False raises Cancelled. The user's frame and pose are not touched.
    """
    rig = armature_modifier(obj).object
    skeleton = rest_skeleton(rig.data)
    order = _pose_order(rig, skeleton)
    count = 1 + (end - start) * substeps
    sources = _force_fields(bpy.context.view_layer) if obj.dynamorph.simulation.fields else []
    columns = np.empty((count, len(order), 4, 4), np.float32)
    samples = RigSamples(
        np.empty((count, len(order), 4, 4)),
        np.empty((count, 4, 4)),
        np.empty((count, 4, 4)),
        tuple(_empty_samples(source.field, count) for source in sources),
    )
    with _rig_scene(obj, rig) as scene:
        for source in sources:
            if source.name not in scene.collection.objects:  # the rig may be one
                scene.collection.objects.link(source)
        for s in range(count):
            frame, substep = divmod(s, substeps)
            scene.frame_set(start + frame, subframe=substep / substeps)
            depsgraph = scene.view_layers[0].depsgraph  # None before the first frame_set
            evaluated = rig.evaluated_get(depsgraph)
            _read_pose(evaluated, columns[s])
            samples.rig_world[s] = _rows(evaluated.matrix_world)
            samples.object_world[s] = _rows(obj.evaluated_get(depsgraph).matrix_world)
            for source, field in zip(sources, samples.fields, strict=True):
                moved = source.evaluated_get(depsgraph)
                field.world[s] = _rows(moved.matrix_world)
                field.strength[s] = moved.field.strength * obj.dynamorph.simulation.fields
            if progress and not progress(s / count, f"Sampling frame {start + frame}"):
                raise Cancelled
    samples.pose[:] = _ordered(columns, order)
    moving = (rig.name, obj.name, *skeleton.names)
    transforms = np.concatenate([samples.rig_world[:, None], samples.object_world[:, None], samples.pose], axis=1)
    bad = np.argwhere(~np.isfinite(transforms).all(axis=(2, 3)))
    if len(bad):
        raise SceneError(_not_a_number(moving[bad[0, 1]], start + int(bad[0, 0]) // substeps))
    flat = np.argwhere(determinant(transforms[:, :2, :3, :3]) == 0)  # bones may collapse: `hold_collapsed`
    if len(flat):
        name, frame = moving[flat[0, 1]], start + int(flat[0, 0]) // substeps
        raise SceneError(f"'{name}' is scaled to zero at frame {frame}: hide it instead, or bake another range")
    for source, field in zip(sources, samples.fields, strict=True):
        if not (np.isfinite(field.world).all() and np.isfinite(field.strength).all()):
            raise SceneError(f"Force field '{source.name}' is not a number at some frame: check its drivers")
    return samples


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


def _empty_samples(field, count: int) -> ForceField:
    nearest = field.distance_min if field.use_min_distance else 0.0
    farthest = field.distance_max if field.use_max_distance else np.inf
    plane = field.shape == "PLANE"
    return ForceField(
        field.type, plane, field.falloff_power, nearest, farthest, np.empty((count, 4, 4)), np.empty(count)
    )


@contextmanager
def _rig_scene(obj, rig):
    """A scene with the rig alone, so that a frame costs what the rig costs.

    An empty that copies the mesh object's transform makes the dependency graph evaluate that transform, with its
    parents, constraints and drivers, but not the mesh.
    """
    user = bpy.context.scene.render
    scene = bpy.data.scenes.new("Dynamorph Sampling")
    probe = bpy.data.objects.new("Dynamorph Sampling", None)
    try:
        for field in ("fps", "fps_base", "frame_map_old", "frame_map_new"):
            setattr(scene.render, field, getattr(user, field))
        probe.constraints.new("COPY_TRANSFORMS").target = obj
        scene.collection.objects.link(rig)
        scene.collection.objects.link(probe)
        yield scene
    finally:
        bpy.data.scenes.remove(scene)
        bpy.data.objects.remove(probe)


def hold_collapsed(samples: RigSamples, skeleton: Skeleton) -> tuple[RigSamples, list[str]]:
    """Replace bones scaled to zero (the pop-to-nothing trick) by their last size; returns warnings naming them."""
    good = _invertible(samples.pose)
    if good.all():
        return samples, []
    times = np.arange(len(samples))[:, None]
    last = np.maximum.accumulate(np.where(good, times, -1), axis=0)
    held = np.where(last >= 0, last, good.argmax(axis=0))  # before its first size: that first size
    pose = samples.pose[held, np.arange(good.shape[1])]
    never = ~good.any(axis=0)
    pose[:, never] = skeleton.rest[never]
    names = ", ".join(f"'{skeleton.names[b]}'" for b in np.flatnonzero(~good.all(axis=0)))
    frames = int((~good).any(axis=1).sum())
    warning = f"Bones scaled to zero are held at their last size ({frames} of {len(samples)} samples): {names}"
    return replace(samples, pose=pose), [warning]


def simulation_settings(obj, scene, frames=None, substeps=None) -> SimulationSettings:
    """The run that `obj` asks for in `scene`; frames (start, end) and substeps override it. Raises SceneError."""
    chosen = obj.dynamorph.simulation
    fps = scene.render.fps / scene.render.fps_base
    own = (scene.frame_start, scene.frame_end) if chosen.use_scene_range else (chosen.start, chosen.end)
    start, end = frames or own
    if end < start:
        raise SceneError(f"'{obj.name}': the last frame {end} comes before the first {start}: change the range")
    gravity = np.array(scene.gravity) * (chosen.gravity if scene.use_gravity else 0.0)
    return SimulationSettings(
        start, end, fps, substeps or chosen.steps_per_frame(fps), chosen.scheme, tuple(gravity.tolist()), chosen.preroll
    )
