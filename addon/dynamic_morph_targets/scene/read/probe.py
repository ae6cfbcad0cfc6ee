# SPDX-License-Identifier: GPL-3.0-or-later
"""The nodes of the cage as a mesh that Blender poses as it poses the skin, where that is not linear in the bones.

With Preserve Volume, bendy bones or several Armature modifiers, a node's transform is not a sum of bone matrices. It is
read from Blender instead: a mesh of the nodes, and of the nodes moved a little along each axis, with the body's own
Armature modifiers and its vertex groups extended into the cage.
"""

from __future__ import annotations

from itertools import islice

import bmesh
import bpy
import numpy as np
from mathutils import Matrix

from ...core.character import Character
from ...core.geometry import diagonal
from ...core.model.model import Model
from ...core.motion.rig_samples import PosedNodes
from ..references import armature_modifiers
from ..skinning import Skinning
from .mesh_data import NO_WEIGHT, VertexGroups

OFFSET = (
    0.01  # body sizes; the nodes' offsets. Bendy bones bend within a long one, and float32 loses digits of a short one
)
NEGLIGIBLE = 0.01  # fraction of a node's weights below which the engine also ignores a bone (`SoftBody`)
ALIKE = 1e-6  # Blender units, and of a scale: transforms that differ by less are the same
MASK = "Dynamorph Mask "  # vertex groups, one for each modifier


class Probe:
    """The n nodes of a model that are not pinned, to be posed by `extract`. model: a `model.Model` of `obj`."""

    def __init__(self, obj: bpy.types.Object, model: Model, character: Character) -> None:
        self.rest = model.nodes[model.free]
        self.offset = OFFSET * diagonal(model.nodes)
        meshes = [
            next(o for o in bpy.data.objects if o.session_uid == part.session_uid) for part in character.attachments
        ]
        self._names, weights, masks, of_modifiers = _skin_groups([Skinning.of(each) for each in (obj, *meshes)])
        at_nodes = model.at_nodes(np.hstack([weights, masks]))[model.free].clip(0.0, 1.0)
        weights, masks = np.split(at_nodes, [weights.shape[1]], axis=1)
        totals = weights @ of_modifiers.T
        kept = ((weights[:, None] >= NEGLIGIBLE * totals[..., None]) & of_modifiers).any(axis=1)
        shifts = self.offset * np.vstack([np.zeros(3), np.eye(3)])
        points = (self.rest + shifts[:, None]) @ np.linalg.inv(model.to_bind).T
        self._mesh = _weighted(points.reshape(-1, 3), np.tile(np.hstack([weights * kept, masks]), (4, 1)))
        self._skeleton = character.skeleton
        self._poses = character.skeleton.pose(np.array([target.local for target in character.targets]))
        self._is_alone = len({modifier.object for modifier in armature_modifiers(obj)}) == 1
        self._in_target_poses: tuple[np.ndarray, PosedNodes] | None = None  # and how the armature stood then

    def mesh(self) -> bpy.types.Mesh:
        """A new mesh of the nodes, for an object that `dress` makes look like the body."""
        mesh = bpy.data.meshes.new("Dynamorph Sampling")
        self._mesh.to_mesh(mesh)
        return mesh

    def dress(self, probe: bpy.types.Object, obj: bpy.types.Object) -> None:
        """Give the object of `mesh` what skins `obj`."""
        for name in self._names:
            probe.vertex_groups.new(name=name)
        for k, modifier in enumerate(armature_modifiers(obj)):
            probe.vertex_groups.new(name=f"{MASK}{k}")
            copy = probe.modifiers.new(modifier.name, "ARMATURE")
            for field in ("object", "use_deform_preserve_volume", "use_multi_modifier", "show_viewport"):
                setattr(copy, field, getattr(modifier, field))
            copy.vertex_group = f"{MASK}{k}"

    def empty_samples(self, count: int) -> PosedNodes:
        return PosedNodes(self.rest, self.offset, np.empty((count, 4, len(self.rest), 3), np.float32))

    def in_target_poses(
        self, scene: bpy.types.Scene, probe: bpy.types.Object, rig: bpy.types.Object, placed: np.ndarray
    ) -> PosedNodes:
        """As `in_poses`, in the J poses in which the targets were captured. placed (4, 4): the armature in the space of
        the mesh object, at the scene's frame; while that stays, they are read once.
        """
        known = self._in_target_poses
        if known is None or not (self._is_alone and np.allclose(known[0], placed, atol=ALIKE)):
            known = self._in_target_poses = placed, self.in_poses(scene, probe, rig, self._poses)
        return known[1]

    def in_poses(
        self, scene: bpy.types.Scene, probe: bpy.types.Object, rig: bpy.types.Object, poses: np.ndarray
    ) -> PosedNodes:
        """The nodes in poses (S, B, 4, 4) of the armature, with the objects where they are at the scene's frame.

        A copy of the armature takes the poses, without constraints, drivers and animation; other armatures stay as they
        are.
        """
        samples = self.empty_samples(len(poses))
        stand_in = rig.copy()
        dressed = [modifier for modifier in probe.modifiers if modifier.object == rig]
        try:
            stand_in.animation_data_clear()
            stand_in.parent = None
            for posed in (stand_in, *stand_in.pose.bones):
                while posed.constraints:
                    posed.constraints.remove(posed.constraints[0])
            stand_in.constraints.new("COPY_TRANSFORMS").target = rig
            scene.collection.objects.link(stand_in)
            for modifier in dressed:
                modifier.object = stand_in
            for pose, points in zip(poses, samples.points, strict=True):
                self._take(stand_in, pose)
                # An update of the view layer would not evaluate the animation of what moves the objects.
                scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)
                self.read(scene, probe, points)
        finally:
            for modifier in dressed:
                modifier.object = rig
            bpy.data.objects.remove(stand_in)
        return samples

    def read(self, scene: bpy.types.Scene, probe: bpy.types.Object, points: np.ndarray) -> None:
        """What Blender has made of the object's mesh, in its own space: (4, n, 3), contiguous float32."""
        evaluated = probe.evaluated_get(scene.view_layers[0].depsgraph)
        evaluated.data.attributes["position"].data.foreach_get("vector", points.ravel())

    def _take(self, rig: bpy.types.Object, pose: np.ndarray) -> None:
        """Pose an armature object without constraints: pose (B, 4, 4), armature space."""
        placed = {name: Matrix(matrix) for name, matrix in zip(self._skeleton.names, pose, strict=True)}
        for name, matrix in placed.items():
            bone = rig.data.bones[name]
            above = {}
            if bone.parent:
                above = {"parent_matrix": placed[bone.parent.name], "parent_matrix_local": bone.parent.matrix_local}
            rig.pose.bones[name].matrix_basis = bone.convert_local_to_pose(
                matrix, bone.matrix_local, invert=True, **above
            )


def _skin_groups(meshes: list[Skinning]) -> tuple[list[str], np.ndarray, np.ndarray, np.ndarray]:
    """What the K Armature modifiers of the first mesh read: names of G vertex groups; their weights (V, G), which
    Blender uses as ratios; the part (V, K) that each modifier has in the result; which groups belong to its bones
    (K, G).

    The others are those whose vertices the character has too; their skinning counts like that of the first.
    """
    bones = [[bone.name for mesh in meshes for bone in mesh.bones(modifier.object)] for modifier in meshes[0].modifiers]
    names = list(dict.fromkeys(name for of_modifier in bones for name in of_modifier))
    of_modifiers = np.array([[name in of_modifier for name in names] for of_modifier in bones])
    found = [_weights_and_masks(mesh, names, of_modifiers) for mesh in meshes]
    weights, masks = (np.concatenate(each) for each in zip(*found, strict=True))
    return names, weights, masks, of_modifiers


def _weights_and_masks(mesh: Skinning, names: list[str], of_modifiers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`_skin_groups` of one mesh. A modifier that it lacks has no part in the result."""
    groups = VertexGroups(mesh.obj)
    weights = groups.weights(names)
    masks = np.zeros((len(weights), len(of_modifiers)))
    for mask, modifier, in_modifier in zip(masks.T, mesh.modifiers, of_modifiers, strict=False):
        mask[:] = 1.0
        if modifier.vertex_group in mesh.obj.vertex_groups:
            painted = groups.weights([modifier.vertex_group])[:, 0]
            mask[:] = 1.0 - painted if modifier.invert_vertex_group else painted
        if not modifier.use_multi_modifier:  # one that does goes back to before the first, even where it has no weights
            mask *= weights @ in_modifier > NO_WEIGHT
    totals = weights.sum(axis=1, keepdims=True)
    return weights / np.where(totals > NO_WEIGHT, totals, np.inf), masks


def _weighted(points: np.ndarray, weights: np.ndarray) -> bmesh.types.BMesh:
    """Vertices with weights in vertex groups. Blender keeps nothing of it, so that no undo brings it back."""
    out = bmesh.new()
    layer = out.verts.layers.deform.verify()
    weighted, groups = np.nonzero(weights)
    of_point = iter(zip(groups.tolist(), weights[weighted, groups].tolist(), strict=True))
    counts = np.bincount(weighted, minlength=len(points))
    for point, count in zip(points.tolist(), counts.tolist(), strict=True):
        in_groups = out.verts.new(point)[layer]
        for group, weight in islice(of_point, count):
            in_groups[group] = weight
    return out
