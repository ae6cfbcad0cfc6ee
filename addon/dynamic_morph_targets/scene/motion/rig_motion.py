# SPDX-License-Identifier: GPL-3.0-or-later
"""A rig over the frames of a shot: poses, worlds, force fields and colliders, sampled as Blender evaluates them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from ...core.character import Skeleton
from ...core.errors import SceneError
from ...core.geometry import determinant, inverse, invertible, turned
from ...core.motion.colliders import ColliderTrack
from ...core.motion.keyed import KeyedSettings
from ...core.motion.rig_samples import ForceField, RigSamples, Track
from .. import keyed
from ..check import checks
from ..check.checks import armature_modifier
from ..check.problem import refuse
from ..read.probe import Probe
from ..read.sampling_scene import SamplingScene, rig_scene
from ..read.worlds import in_meters, not_a_number, refuse_overflow, world_now
from ..references import rest_skeleton, rig_of
from ..skin import shown_objects, unit_scale, used_grips
from ..skinning import Skinning
from . import colliders, grips

PUSHING = {"WIND", "FORCE", "VORTEX", "TURBULENCE"}  # kinds of force fields
MOVED = np.radians(5.0)  # a bone turned further than this from the neutral pose places a target by default


def current_pose(
    obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None = None
) -> tuple[Skeleton, np.ndarray, np.ndarray]:
    """The evaluated pose now: skeleton, local transforms (B, 4, 4), armature's world transform (4, 4), meters.

    depsgraph: where it is evaluated, if not where the artist sees it.
    """
    skinning = checks.skinned(obj)
    refuse(checks.rig(skinning))
    rig = skinning.rig
    skeleton = rest_skeleton(rig.data)
    evaluated = rig.evaluated_get(depsgraph or bpy.context.evaluated_depsgraph_get())
    pose = pose_matrices(evaluated, pose_order(rig, skeleton))
    rig_world = world_now(rig, depsgraph)
    refuse_overflow(pose[None], skeleton.names, lambda _: bpy.context.scene.frame_current)
    flat = [name for name, matrix in zip(skeleton.names, pose, strict=True) if not invertible(matrix)]
    if flat:
        raise SceneError(
            "Bone '{bone}' of '{name}' is scaled to zero: give it a size to capture the pose",
            bone=flat[0],
            name=rig.name,
        )
    return skeleton, skeleton.local_transforms(pose), rig_world


def bones_turned(obj: bpy.types.Object, skeleton: Skeleton, first: np.ndarray, second: np.ndarray) -> list[str]:
    """Names of the deforming bones whose local rotation differs by more than MOVED."""
    bones = armature_modifier(obj).object.data.bones
    angles = turned(first, second)
    return [
        name for name, angle in zip(skeleton.names, angles, strict=True) if angle > MOVED and bones[name].use_deform
    ]


def pose_order(rig: bpy.types.Object, skeleton: Skeleton) -> list[int]:
    """The index of the skeleton's bones among those of the armature object's pose."""
    places = {name: place for place, name in enumerate(rig.pose.bones.keys())}
    return [places[name] for name in skeleton.names]


def pose_matrices(evaluated_rig: bpy.types.Object, order: Sequence[int]) -> np.ndarray:
    """Pose matrices (B, 4, 4), armature space."""
    columns = np.empty((len(order), 4, 4), np.float32)
    _read_pose(evaluated_rig, columns)
    return _ordered(columns, order)


def _read_pose(evaluated_rig: bpy.types.Object, columns: np.ndarray) -> None:
    """Pose matrices as Blender has them: (B, 4, 4) float32, column after column, bones in the armature's order."""
    evaluated_rig.pose.bones.foreach_get("matrix", columns.ravel())


def _ordered(columns: np.ndarray, order: Sequence[int]) -> np.ndarray:
    """Pose matrices (..., B, 4, 4), row after row, bones in the skeleton's order, from what `_read_pose` reads."""
    return columns.swapaxes(-1, -2)[..., order, :, :].astype(np.float64)


def _rows(matrix: Matrix) -> tuple[tuple[float, ...], ...]:
    """A Blender matrix as rows for NumPy, which would ask Blender for each number if it got the matrix itself."""
    return tuple(map(tuple, matrix))


def sample_rig(
    obj: bpy.types.Object,
    start: int,
    end: int,
    substeps: int,
    probe: Probe | None = None,
    without: Sequence[str] = (),
    scene: SamplingScene | None = None,
) -> RigSamples:
    """The rig at 1 + (end - start) * substeps times, at once; probe, without, scene: of `RigSampling`. Raises
    SceneError.
    """
    sampling = RigSampling(obj, start, end, substeps, without, scene)
    sampling.probe = probe
    sampling.advance(obj)
    return sampling.samples()


def sample_present(obj: bpy.types.Object, probe: Probe | None = None) -> RigSamples:
    """One sample of the rig in the pose that the artist sees; probe: as in `RigSampling`. Raises SceneError."""
    skeleton, local, rig_world = current_pose(obj)
    pose, world = skeleton.pose(local)[None], world_now(obj)[None]
    channels = keyed.present_channels(obj)
    tracks: tuple[Track, ...] = (channels,) if channels else ()
    if probe is None:
        return RigSamples(pose, rig_world[None], world, tracks)
    rig, frame = armature_modifier(obj).object, bpy.context.scene.frame_float
    with rig_scene(obj, rig, probe) as (scene, follower):
        scene.frame_set(int(frame), subframe=frame % 1.0)
        placed = inverse(world[0]) @ rig_world
        nodes = probe.in_poses(scene, follower, rig, pose)
        target_nodes = probe.in_target_poses(scene, follower, rig, placed)
    return RigSamples(pose, rig_world[None], world, (nodes, *tracks), target_nodes)


def present_colliders(obj: bpy.types.Object) -> tuple[ColliderTrack, ...]:
    """What stops the soft skin `obj`, as it stands now: one sample each. What hangs on the rig is left out, because it
    would have to move with that. Raises SceneError.
    """
    scene, depsgraph = bpy.context.scene, bpy.context.evaluated_depsgraph_get()
    hanging = {child.name for child in rig_of(obj).children_recursive}
    readers = [reader for reader in colliders.readers(obj, 1) if reader.name not in hanging]
    for reader in readers:
        reader.read(0, scene.objects[reader.name].evaluated_get(depsgraph), scene.frame_current)
    to_meters = partial(in_meters, unit=unit_scale())
    return tuple(reader.track(to_meters, lambda _sample: scene.frame_current) for reader in readers)


class RigSampling:
    """Reads the rig at 1 + (end - start) * substeps times, true sub-frames, without evaluating the mesh.

    It does so in slices, between which Blender does other things. The user's frame and pose stay as they are.

    probe: the nodes that Blender is to pose too (`probe.Probe`), to be set before the first slice. without: names of
    colliders that are not read, because they are soft bodies that press on this one. scene: where it is read; who
    gives it closes it, else it is closed after the last slice.
    """

    def __init__(
        self,
        obj: bpy.types.Object,
        start: int,
        end: int,
        substeps: int,
        without: Sequence[str] = (),
        scene: SamplingScene | None = None,
    ):
        skinning = checks.skinned(obj)
        rig = skinning.rig
        self.start, self.substeps = start, substeps
        self._scene, self._is_scene_ours = scene or SamplingScene(), scene is None
        self.probe: Any = None  # a probe.Probe
        self._nodes: Any = None  # PosedNodes
        self._target_nodes: Any = None
        self.done, self.count = 0, 1 + (end - start) * substeps
        self._unit = unit_scale()
        self._skeleton = rest_skeleton(rig.data)
        self._order = pose_order(rig, self._skeleton)
        self._moving = _moving(skinning, self._skeleton)
        sources = _force_fields(bpy.context.view_layer) if obj.dynamorph.simulation.fields else []
        self._sources = [source.name for source in sources]
        self._columns = np.empty((self.count, len(self._order), 4, 4), np.float32)
        self._rig_world, self._object_world = np.empty((2, self.count, 4, 4))
        self._fields = tuple(_empty_samples(source.field, self.count, self._unit) for source in sources)
        self._colliders = [each for each in colliders.readers(obj, self.count) if each.name not in without]
        refuse(grips.problems(obj))
        self._grips = [grips.GripReader(grip, self.count) for grip in used_grips(obj)]
        self._keyed = keyed.settings(obj)
        for each in self._keyed:
            if not all(curve.driver.is_valid for curve in keyed.drivers_of(obj, each.path)):
                text = "'{name}': the driver of {setting} does not work: fix or delete it"
                raise SceneError(text, name=obj.name, setting=each.path.removeprefix("dynamorph."))
        self._values = np.empty((self.count, len(self._keyed)))

    @property
    def frame(self) -> int:
        """The frame that is read next."""
        return self.start + self.done // self.substeps

    def advance(self, obj: bpy.types.Object, seconds: float = np.inf) -> bool:
        """Reads on for about so many seconds; True when everything is read. obj: the same object, which may have moved
        in memory. Raises SceneError.
        """
        ends = time.perf_counter() + seconds
        skinning = checks.skinned(obj)
        rig = skinning.rig
        sources = [bpy.context.scene.objects.get(name) for name in self._sources]
        if _moving(skinning, rest_skeleton(rig.data)) != self._moving or None in sources:
            text = "'{name}' or something that moves it changed while it was being read: start again"
            raise SceneError(text, name=obj.name)
        stopping = [self._collider(reader.name) for reader in self._colliders]
        holding = [reader.find(obj) for reader in self._grips]
        others = *sources, *stopping, *holding
        with self._scene.opened(obj, rig, self.probe, others, self._keyed) as (scene, follower):
            if self.probe and self._nodes is None:
                self._nodes = self.probe.empty_samples(self.count)
            while self.done < self.count:
                self._read(scene, obj, follower, rig, sources)
                for collider, reader in zip(stopping, self._colliders, strict=True):
                    reader.read(self.done, collider.evaluated_get(scene.view_layers[0].depsgraph), self.frame)
                for holder, grip in zip(holding, self._grips, strict=True):
                    grip.read(self.done, holder.evaluated_get(scene.view_layers[0].depsgraph))
                if self.probe:
                    self.probe.read(scene, follower, self._nodes.points[self.done])
                if self.probe and self._target_nodes is None:  # with the objects where they are at the first sample
                    with np.errstate(divide="ignore", invalid="ignore"):  # scaled to zero, which `samples` refuses
                        placed = inverse(self._object_world[0]) @ self._rig_world[0]
                    self._target_nodes = self.probe.in_target_poses(scene, follower, rig, placed)
                self.done += 1
                if time.perf_counter() > ends:
                    break
        if self.done == self.count:
            self.close()
        return self.done == self.count

    def close(self) -> None:
        """Nothing more is read: remove the scene, unless it belongs to somebody else."""
        if self._is_scene_ours:
            self._scene.close()

    def _collider(self, name: str) -> bpy.types.Object:
        """The object of this name. Raises SceneError."""
        found = bpy.context.scene.objects.get(name)
        if found is None or not colliders.is_collider(found):
            raise SceneError("'{name}' or its Collision was removed while it was being read: start again", name=name)
        return found

    def _read(
        self,
        scene: bpy.types.Scene,
        obj: bpy.types.Object,
        follower: bpy.types.Object,
        rig: bpy.types.Object,
        sources: Sequence[bpy.types.Object],
    ) -> None:
        s = self.done
        scene.frame_set(self.frame, subframe=s % self.substeps / self.substeps)
        depsgraph = scene.view_layers[0].depsgraph  # None before the first frame_set
        evaluated = rig.evaluated_get(depsgraph)
        _read_pose(evaluated, self._columns[s])
        self._rig_world[s] = _rows(evaluated.matrix_world)
        follows = follower.evaluated_get(depsgraph)
        self._object_world[s] = _rows(follows.matrix_world)
        self._values[s] = keyed.values(follows, self._keyed)
        for source, field in zip(sources, self._fields, strict=True):
            moved = source.evaluated_get(depsgraph)
            field.world[s] = _rows(moved.matrix_world)
            field.strength[s] = moved.field.strength * obj.dynamorph.simulation.fields

    def samples(self) -> RigSamples:
        """Everything that was read. Raises SceneError when some of it is not a number, or scaled to zero."""
        worlds = in_meters(np.stack([self._rig_world, self._object_world], axis=1), self._unit)
        fields = tuple(replace(field, world=in_meters(field.world, self._unit)) for field in self._fields)
        pose = _ordered(self._columns, self._order)
        stopping = [reader.track(partial(in_meters, unit=self._unit), self._frame) for reader in self._colliders]
        settings = self._settings()
        if settings and (friction := settings.of("FRICTION")) is not None:
            stopping = [replace(track, friction=friction) for track in stopping]
        holding = [reader.track(partial(in_meters, unit=self._unit)) for reader in self._grips]
        tracks = (*fields, *stopping, *holding, *filter(None, (settings, self._nodes)))
        samples = RigSamples(pose, worlds[:, 0], worlds[:, 1], tracks, self._target_nodes)
        refuse_overflow(np.concatenate([worlds, samples.pose], axis=1), self._moving, self._frame)
        flat = np.argwhere(determinant(worlds[..., :3, :3]) == 0)  # bones may collapse: `keep_collapsed`
        if len(flat):
            name, frame = self._moving[flat[0, 1]], self._frame(flat[0, 0])
            raise SceneError(
                "'{name}' is scaled to zero at frame {frame}: hide it instead, or bake another range",
                name=name,
                frame=frame,
            )
        for nodes in filter(None, (self._nodes, self._target_nodes)):
            if not np.isfinite(nodes.points).all():
                raise SceneError(not_a_number(self._moving[1], self.start))
        for name, field in zip(self._sources, self._fields, strict=True):
            if not (np.isfinite(field.world).all() and np.isfinite(field.strength).all()):
                text = "Force field '{name}' has values that are not numbers at some frame: check its drivers"
                raise SceneError(text, name=name)
        return samples

    def _settings(self) -> KeyedSettings | None:
        """Those that are keyed, if there are some. Raises SceneError for what is no number."""
        good = np.isfinite(self._values) & (self._values >= [each.least for each in self._keyed])
        for sample, which in np.argwhere(~good)[:1]:
            raise SceneError(
                "'{name}': {setting} is not a number at frame {frame}: check its curves and drivers",
                name=self._moving[1],
                setting=self._keyed[which].path.removeprefix("dynamorph."),
                frame=self._frame(sample),
            )
        return KeyedSettings(tuple(each.setting for each in self._keyed), self._values) if self._keyed else None

    def _frame(self, sample: int) -> int:
        return self.start + int(sample) // self.substeps


def _moving(skinning: Skinning, skeleton: Skeleton) -> tuple[str, ...]:
    """Names of everything that moves a mesh: the armature, the object, the bones, and other armatures that skin it."""
    others = (modifier.object.name for modifier in skinning.modifiers)
    return (skinning.rig.name, skinning.obj.name, *skeleton.names, *others)


def pushing(view_layer: bpy.types.ViewLayer) -> list:
    """The objects whose force field pushes skin. Fast enough for drawing."""
    shown = [obj for obj in shown_objects(view_layer) if obj.field and not obj.hide_viewport]
    return [obj for obj in shown if obj.field.type in PUSHING and obj.field.apply_to_location]


def _force_fields(view_layer: bpy.types.ViewLayer) -> list:
    """The same. Raises SceneError for kinds that would act differently than shown."""
    found = pushing(view_layer)
    for obj in found:
        field = obj.field
        if field.shape not in {"POINT", "PLANE"} or field.falloff_type != "SPHERE" or field.z_direction != "BOTH":
            raise SceneError(
                "Force field '{name}' cannot push skin with these settings: choose Shape Point or Plane, Falloff "
                "Sphere and Z Direction Both, or set Force Fields to 0",
                name=obj.name,
            )
    return found


def _empty_samples(field: bpy.types.FieldSettings, count: int, unit: float) -> ForceField:
    nearest = unit * field.distance_min if field.use_min_distance else 0.0
    farthest = unit * field.distance_max if field.use_max_distance else np.inf
    worlds, strengths = np.empty((count, 4, 4)), np.empty(count)
    return ForceField(
        field.type, field.shape == "PLANE", field.falloff_power, nearest, farthest, worlds, strengths,
        unit * (field.size or 1.0), unit, field.use_global_coords,
    )  # fmt: skip
