# SPDX-License-Identifier: GPL-3.0-or-later
"""The poses for which driven shape keys are made: the bones that a driver reads are turned until its key is fully on.

Blender itself evaluates the driver, so any expression or curve works. This happens in a scene with the armature and the
keys but no mesh, where a pose takes a tenth of a millisecond.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Self

import bpy
import numpy as np
from mathutils import Matrix, Quaternion

from ...core.character import Skeleton
from ...core.errors import SceneError
from ...core.message import Message
from ...scene import events
from ...scene.check import checks
from ...scene.motion import rig_motion
from ...scene.read import sampling_scene
from ...scene.skin import find
from . import targets
from .controls import unchanged_pose

STEP = np.radians(3.0)
GRID = STEP * np.array(
    sorted(range(-60, 61), key=lambda step: (abs(step), -step))
)  # all the way around, small angles first
FINE = STEP * np.linspace(-1.0, 1.0, 61)
FULL = 0.999  # of the largest value that a driver reaches, where that is 1 or less
WORKS = 0.5  # a key whose driver reaches less does not belong to a pose of its bones
TOGETHER = 3  # so many turns are tried at the same angle; their combinations soon are too many
AXES = np.eye(3)
BENDS = AXES[[0, 2]]  # of a bone, whose length is along y


@dataclass(frozen=True)
class Suggestion:
    """A possible target: a shape key, the bones that turn it on, and the pose as returned by
    `rig_motion.current_pose`.
    """

    key: str
    bones: list[str]
    pose: tuple


def suggestions(session_uid: int) -> Generator[tuple[float, str], None, tuple[list[Suggestion], list[str]]]:
    """Suggestions from the driven shape keys of an object that are not targets, and why others suggest nothing. Yields
    (fraction, message) before each key.

    The armature is posed to find out, and restored before each yield. Raises SceneError.
    """
    obj = find(session_uid)
    rig = checks.armature_modifier(obj).object
    skeleton, _, rig_world = rig_motion.current_pose(obj)
    neutral = obj.dynamorph.targets[0].local(skeleton)
    read = _axes_read(obj, rig, rig_world @ skeleton.pose(neutral), skeleton)
    if not read:
        raise SceneError(
            "'{name}' has no shape key, besides targets, whose driver reads bones of '{rig}'",
            name=obj.name,
            rig=rig.name,
        )
    found, skipped = [], []
    for done, (key, axes) in enumerate(read.items()):
        yield done / len(read), Message("Trying the driver of '{name}'", name=key)
        obj = find(session_uid)
        rig = checks.armature_modifier(obj).object
        with unchanged_pose(rig), events.without_handlers(), _Trial(obj, rig) as trial:
            targets.pose_rig(rig, skeleton, neutral)
            angles, top, turns = _turned_until_on(trial, key, axes)
            bones = {bone for (bone, _), angle in zip(turns, angles, strict=True) if angle}
            if top < WORKS:
                skipped.append(f"'{key}': its driver never exceeds {top:.2g}")
            elif not bones:
                skipped.append(f"'{key}': its driver turns it on in the neutral pose already")
            else:
                trial.turn(turns, angles)
                pose = rig_motion.current_pose(obj, trial.depsgraph)
                found.append(Suggestion(key, [name for name in skeleton.names if name in bones], pose))
    return found, skipped


# What drivers read -------------------------------------------------------------------------------------------------


def _axes_read(
    obj: bpy.types.Object, rig: bpy.types.Object, pose: np.ndarray, skeleton: Skeleton
) -> dict[str, dict[str, list]]:
    """For each driven key that is no target, the bones its driver reads, each with the axes (3,), in the bone's space,
    that it reads turns about; with none where it reads a turn about any. pose (B, 4, 4): of the bones, world space.
    """
    keys = obj.data.shape_keys
    drivers = keys.animation_data.drivers if keys and keys.animation_data else ()
    taken = {target.name for target in obj.dynamorph.targets[1:]} | {key.name for key in obj.dynamorph.bake.keys}
    world_axes = dict(zip(skeleton.names, pose[:, :3, :3], strict=True))
    read = {}
    for curve in drivers:
        block = next((key for key in keys.key_blocks if curve.data_path == key.path_from_id("value")), None)
        if block is None or block.name in taken:
            continue
        axes: dict = {}
        for variable in _variables(curve):
            for bone, turned_about in _turns_read(variable, rig, world_axes):
                axes.setdefault(bone, []).extend(turned_about)
        if axes:
            read[block.name] = axes
    return read


def _variables(curve: bpy.types.FCurve) -> Iterator[bpy.types.DriverVariable]:
    """Those of a driver, and of the drivers of the properties that they read, and so on."""
    waiting, known = [curve], [curve]
    while waiting:
        for variable in waiting.pop().driver.variables:
            yield variable
            drivers = _drivers_of if variable.type == "SINGLE_PROP" else _drivers_that_place
            read = [each for target in variable.targets for each in drivers(target)]
            new = [each for each in read if each not in known]
            waiting, known = waiting + new, known + new


def _drivers_of(target: bpy.types.DriverTarget) -> list[bpy.types.FCurve]:
    """The drivers of the property that a variable reads, if it has some."""
    animation = target.id and getattr(target.id, "animation_data", None)
    path = _indexed(target.data_path)
    return [
        curve
        for curve in (animation.drivers if animation and path else ())
        if path in (curve.data_path, f"{curve.data_path}[{curve.array_index}]")
    ]


def _indexed(path: str) -> str:
    """A path with double quotes, and with `[0]` instead of `.x`."""
    owner, _, component = path.replace("'", '"').rpartition(".")
    order = "wxyz" if owner.endswith(("rotation_quaternion", "rotation_axis_angle")) else "xyz"
    return (
        f"{owner}[{order.index(component)}]" if len(component) == 1 and component in order else path.replace("'", '"')
    )


def _drivers_that_place(target: bpy.types.DriverTarget) -> list[bpy.types.FCurve]:
    """The drivers of the transform that a variable reads: of a bone, or of an object."""
    animation = target.id.animation_data if isinstance(target.id, bpy.types.Object) else None
    if animation is None:
        return []
    placed = _placed(target)
    owner = "" if placed == target.id else f"{placed.path_from_id()}."
    channels = tuple(f"{owner}{name}" for name in ("location", "rotation_", "scale", "delta_"))
    return [curve for curve in animation.drivers if curve.data_path.startswith(channels)]


def _placed(target: bpy.types.DriverTarget) -> Any:
    """The bone, or the object, whose transform a variable reads."""
    bones = target.id.pose.bones if target.bone_target and target.id.pose else {}
    return bones.get(target.bone_target, target.id)


def _followed(target: bpy.types.DriverTarget, rig: bpy.types.Object) -> Iterator[str]:
    """The bones of the rig that what a variable reads hangs on, or follows by constraints."""
    if not isinstance(target.id, bpy.types.Object):
        return
    placed = _placed(target)
    if placed == target.id and placed.parent == rig and placed.parent_type == "BONE":
        yield placed.parent_bone
    for constraint in placed.constraints:
        if getattr(constraint, "target", None) == rig and constraint.subtarget in rig.pose.bones:
            yield constraint.subtarget


def _turns_read(
    variable: bpy.types.DriverVariable, rig: bpy.types.Object, world_axes: dict[str, np.ndarray]
) -> Iterator[tuple[str, list[np.ndarray]]]:
    """Yields (bone, axes) for each rotation of a bone of the rig that a driver's variable reads."""
    if variable.type == "SINGLE_PROP":
        target = variable.targets[0]
        path = re.fullmatch(r'pose\.bones\["(.+)"\]\.(rotation_\w+)(?:\[(\d)\])?', _indexed(target.data_path))
        if target.id == rig and path and path[1] in rig.pose.bones:
            component = int(path[3] or 0) - (path[2] != "rotation_euler")  # of the others, w or the angle comes first
            yield path[1], [AXES[component]] if component >= 0 else []
        return
    yield from ((bone, []) for target in variable.targets for bone in _followed(target, rig))
    bones = [rig.pose.bones.get(target.bone_target) for target in variable.targets if target.id == rig]
    bones = [bone for bone in bones if bone]
    if variable.type == "ROTATION_DIFF" and bones:
        yield max(bones, key=lambda bone: len(bone.parent_recursive)).name, []
    elif variable.type == "TRANSFORMS" and bones and variable.targets[0].transform_type.startswith("ROT_"):
        target = variable.targets[0]
        component = "XYZW".index(target.transform_type[-1])
        # A row: a world axis in the bone's space.
        space = AXES if target.transform_space != "WORLD_SPACE" else world_axes[bones[0].name]
        yield bones[0].name, [space[component] / np.linalg.norm(space[component])] if component < 3 else []


# Trying ------------------------------------------------------------------------------------------------------------


class _Trial:
    """Turns bones and reads the resulting driver values, away from the scene that the artist sees."""

    def __init__(self, obj: bpy.types.Object, rig: bpy.types.Object):
        self.rig, self.keys = rig, obj.data.shape_keys

    def __enter__(self) -> Self:
        self.scene = bpy.data.scenes.new("Dynamorph Drivers")
        self.probe = bpy.data.objects.new("Dynamorph Drivers", None)
        try:
            self._evaluate()
        except BaseException:
            self.__exit__()
            raise
        return self

    def _evaluate(self) -> None:
        driver = self.probe.driver_add("location", 0).driver  # needed only so that Blender evaluates the keys' drivers
        target = driver.variables.new().targets[0]
        target.id_type, target.id, target.data_path = "KEY", self.keys, "eval_time"
        self.scene.collection.objects.link(self.rig)
        self.scene.collection.objects.link(self.probe)
        self.scene.frame_set(bpy.context.scene.frame_current, subframe=bpy.context.scene.frame_subframe)
        self.layer = self.scene.view_layers[0]
        self.depsgraph = self.layer.depsgraph
        self.bases: dict[str, Matrix] = {}

    def __exit__(self, *_error: object) -> None:
        sampling_scene.remove_scene(self.scene, self.probe)

    def turn(self, turns: Sequence[tuple[str, np.ndarray]], angles: np.ndarray) -> None:
        """Turn bones by angles (n,), from where they were at first, each about the axis of its turn (bone, axis)."""
        turned: dict = {}
        for (bone, axis), angle in zip(turns, angles, strict=True):
            before = turned.get(bone) or self.bases.setdefault(bone, self.rig.pose.bones[bone].matrix_basis.copy())
            turned[bone] = before @ Quaternion(axis, angle).to_matrix().to_4x4()
        for bone, basis in turned.items():
            self.rig.pose.bones[bone].matrix_basis = basis
        self.layer.update()

    def value(self, key: str) -> float:
        value = self.keys.evaluated_get(self.depsgraph).key_blocks[key].value
        return max(0.0, float(np.nan_to_num(value)))


def _turned_until_on(
    trial: _Trial, key: str, axes: dict[str, list]
) -> tuple[np.ndarray, float, list[tuple[str, np.ndarray]]]:
    """The smallest angles (n,) that turn a key on, its value then, and the n turns."""
    tried = []
    for any_axis in (False, True):
        chosen = {bone: AXES if any_axis else _distinct(about or BENDS) for bone, about in axes.items()}
        turns = [(bone, axis) for bone, about in chosen.items() for axis in about]

        def value(angles: np.ndarray, turns: list[tuple[str, np.ndarray]] = turns) -> float:
            trial.turn(turns, angles)
            return trial.value(key)

        tried.append((*least_turns(value, len(turns), together=1 if any_axis else TOGETHER), turns))
        if tried[-1][1] >= WORKS:
            break
    return max(tried, key=lambda found: found[1])


def _distinct(axes: Iterable[np.ndarray]) -> list:
    """Without repetitions, to sign."""
    kept: list = []
    for axis in axes:
        if not any(abs(abs(axis @ other) - 1.0) < 1e-4 for other in kept):
            kept.append(axis)
    return kept


def least_turns(value: Callable[[np.ndarray], float], count: int, together: int = TOGETHER) -> tuple[np.ndarray, float]:
    """Angles (count,), radians, at which value(angles) is as large as it gets, up to 1; and the largest value.

    As few of them as possible are not 0: first each turn is tried alone, then up to `together` by the same angle, then
    one after the other. At last each is made as small as it can be.
    """
    best, top = np.zeros(count), value(np.zeros(count))
    for turned in range(1, min(count, together) + 1):
        tried = [_highest(value, np.zeros(count), direction) for direction in _directions(count, turned)]
        reached = max(height for _, height in tried)
        if reached > top + 1e-3:
            top = reached
            best = min((angles for angles, height in tried if height >= FULL * min(top, 1.0)), key=np.linalg.norm)
        if top >= FULL:
            break
    for i in [*range(count)] * 3 if top < FULL and count > 1 and best.any() else []:
        angles, reached = _highest(value, best * (np.arange(count) != i), np.eye(count)[i])
        if reached > top + 1e-3:
            best, top = angles, reached
    for i in [*np.flatnonzero(best)] * 2:
        best = _shrunk(value, best, i, FULL * min(top, 1.0))
    return best, top


def _directions(count: int, turned: int) -> Iterator[np.ndarray]:
    """Each way to turn `turned` of `count` by the same angle, forward or backward against the first of them."""
    for which in itertools.combinations(range(count), turned):
        for signs in itertools.product((1.0, -1.0), repeat=turned - 1):
            direction = np.zeros(count)
            direction[list(which)] = (1.0, *signs)
            yield direction


def _highest(
    value: Callable[[np.ndarray], float], start: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, float]:
    """Where along a line the value is full, or as high as it gets, nearest to its start; and how high it gets."""
    angle, top = _first_highest(lambda angle: value(start + angle * direction), GRID)
    if top < FULL and angle:  # the peak may lie between two steps
        angle, top = _first_highest(lambda angle: value(start + angle * direction), angle + FINE)
    return start + angle * direction, top


def _first_highest(value: Callable[[float], float], angles: np.ndarray) -> tuple[float, float]:
    heights = np.array([value(angle) for angle in angles])
    top = heights.max()
    return angles[np.argmax(heights >= FULL * min(top, 1.0))], top


def _shrunk(value: Callable[[np.ndarray], float], angles: np.ndarray, i: int, goal: float) -> np.ndarray:
    """`angles` with the i-th as small as possible with the value at the goal, to a thousandth of a degree."""
    others = angles * (np.arange(len(angles)) != i)
    axis = np.eye(len(angles))[i]
    smaller = GRID[abs(GRID) < abs(angles[i])]
    outside = next((angle for angle in smaller if value(others + angle * axis) >= goal), angles[i])
    inside = outside - np.sign(outside) * min(abs(outside), STEP)
    for _ in range(12):
        middle = 0.5 * (inside + outside)
        inside, outside = (inside, middle) if value(others + middle * axis) >= goal else (middle, outside)
    return others + outside * axis
