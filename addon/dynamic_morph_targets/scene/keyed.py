# SPDX-License-Identifier: GPL-3.0-or-later
"""The settings of a soft skin that a simulation follows where they are keyed or driven, the channels that place its
targets, and how firmly grips hold. They are read with the rig; what must not depend on the present frame has one value
for all frames instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import bpy
import numpy as np

from ..core.motion.keyed import KeyedSettings, Setting
from . import animation
from .plain import plain
from .skin import named_targets, used_grips

OF_OBJECT = {"simulation.amount": "AMOUNT", "collision.distance": "DISTANCE", "collision.friction": "FRICTION"}
OF_TARGETS = {"stiffness": "STIFFNESS", "amount": "TARGET_AMOUNT"}
PLACES = "location", "rotation_euler", "rotation_quaternion", "scale"
PROPERTY = "keyed"  # custom properties, with a number behind, whose drivers read them


class Keyed(NamedTuple):
    """path: from the object; always: instead of its value, at all frames; least: that it may be; driven: what its
    driver reads, '' without one: what else changes it is animation. moved: whether anything changes it, as always but
    for channels and grips.
    """

    setting: Setting
    path: str
    always: float
    least: float
    driven: str
    moved: bool


def settings(obj: bpy.types.Object) -> list[Keyed]:
    """Those of `obj` that are keyed or driven, and the channels and grips in use. Fast enough for every frame."""
    moved = [path for path in animation.moved_paths(obj) if path.startswith("dynamorph.")]
    used, held = channels(obj), used_grips(obj)
    if not (moved or used or held):
        return []
    known = {channel.path_from_id("value"): Setting("CHANNEL", channel.name) for channel in used}
    known |= {grip.path_from_id("strength"): Setting("GRIP", grip.name) for grip in held}
    still = [path for path in known if path not in moved]
    known |= {f"dynamorph.{path}": Setting(kind) for path, kind in OF_OBJECT.items()}
    if not obj.dynamorph.collision.use_friction:  # then it does not count
        del known["dynamorph.collision.friction"]
    for name, target in named_targets(obj):
        known |= {f"{target.path_from_id()}.{own}": Setting(kind, name) for own, kind in OF_TARGETS.items()}
    found = [_keyed(obj, known[path], path) for path in moved if path in known]
    return found + [Keyed(known[path], path, obj.path_resolve(path), -np.inf, "", False) for path in still]


def channels(obj: bpy.types.Object) -> list[bpy.types.PropertyGroup]:
    """Those that place targets which are not muted."""
    used = {target.channel for target in obj.dynamorph.targets if target.channel and not target.mute}
    return [channel for channel in obj.dynamorph.channels if channel.name in used] if used else []


def present_channels(obj: bpy.types.Object) -> KeyedSettings | None:
    """Where the channels in use stand, one sample; None without any."""
    used = channels(obj)
    found = tuple(Setting("CHANNEL", channel.name) for channel in used)
    return KeyedSettings(found, np.array([[channel.value for channel in used]])) if used else None


def _keyed(obj: bpy.types.Object, setting: Setting, path: str) -> Keyed:
    owner, _, name = path.rpartition(".")
    described = obj.path_resolve(owner).bl_rna.properties[name]
    curves = [curve for curve in animation.played(obj.animation_data) if curve.data_path == path]
    first = [curve.keyframe_points[0].co.y for curve in curves if len(curve.keyframe_points)]
    always = min(max([*first, described.default][0], described.hard_min), described.hard_max)
    return Keyed(setting, path, always, described.hard_min, _driven(obj, path), True)


def drivers_of(obj: bpy.types.Object, path: str) -> list[bpy.types.FCurve]:
    """The drivers of a property that are not muted."""
    drivers = obj.animation_data.drivers if obj.animation_data else ()
    return [curve for curve in drivers if curve.data_path == path and not curve.mute]


def _driven(obj: bpy.types.Object, path: str) -> str:
    """Drivers of a property: how they compute it, and their variables with the values of those that nothing moves."""
    found = [
        (
            curve.driver.type, curve.driver.expression, [tuple(point.co) for point in curve.keyframe_points],
            [plain(modifier) for modifier in curve.modifiers], list(map(_variable, curve.driver.variables)),
        )
        for curve in drivers_of(obj, path)
    ]  # fmt: skip
    return repr(found) if found else ""


def _variable(variable: bpy.types.DriverVariable) -> list:
    read = []
    for target in variable.targets:
        owner, value = target.id, None
        if owner and variable.type == "SINGLE_PROP" and target.data_path not in animation.moved_paths(owner):
            with suppress(ValueError):  # there is no such property
                value = owner.path_resolve(target.data_path)
        elif owner and variable.type != "SINGLE_PROP":
            value = stands(owner, target.bone_target)
        read.append((getattr(owner, "name", ""), plain(target, skip=("id",)), value))
    return [variable.name, variable.type, read]


def stands(owner: bpy.types.ID, bone: str) -> list:
    """How an object, or a bone of it, is placed by what nothing moves."""
    moved = animation.moved_paths(owner)
    placed = owner.pose.bones.get(bone) if bone and getattr(owner, "pose", None) else owner
    path = f"{placed.path_from_id()}." if placed != owner and placed else ""
    return [tuple(getattr(placed, name, ())) for name in PLACES if path + name not in moved]


def always(obj: bpy.types.Object) -> dict[Setting, float]:
    """What counts of the keyed settings of `obj` where there is one value for all frames: that at the first key."""
    return {each.setting: each.always for each in settings(obj)}


def stiffness_of(target: bpy.types.PropertyGroup) -> float:
    """Of a target: where it is keyed, what counts at all frames."""
    path = target.path_from_id("stiffness")
    return next((each.always for each in settings(target.id_data) if each.path == path), target.stiffness)


def frequency_of(target: bpy.types.PropertyGroup) -> float:
    """That from which the stiffness of a target follows; 0 where that is set, or keyed."""
    path = target.path_from_id("stiffness")
    return 0.0 if any(each.path == path for each in settings(target.id_data)) else target.frequency


def first_keys(obj: bpy.types.Object) -> dict[Setting, float]:
    """The values of those at their first keys; of what drivers move alone there is none."""
    return {each.setting: each.always for each in settings(obj) if not each.driven}


def held(obj: bpy.types.Object, track: KeyedSettings) -> KeyedSettings:
    """The channels and grips of a track, where curves of `obj` move them with the value of their first key."""
    kept, first = track.without(*OF_OBJECT.values(), *OF_TARGETS.values()), first_keys(obj)
    values = [np.full(len(kept.values), first[each]) if each in first else kept.of(*each) for each in kept.settings]
    return KeyedSettings(kept.settings, np.array(values).reshape(-1, len(kept.values)).T)


def recorded(obj: bpy.types.Object) -> dict[Setting, str | float | None]:
    """What a bake notes of them instead of their values: what drives them; None where curves do, whose hash it has. Of
    a channel that nothing moves it is the value.
    """
    return {each.setting: each.driven or None if each.moved else each.always for each in settings(obj)}


def watch(watcher: bpy.types.Object, obj: bpy.types.Object, wanted: Sequence[Keyed]) -> None:
    """Give an object drivers that read the settings of `obj` wherever the dependency graph evaluates it."""
    for k, each in enumerate(wanted):
        watcher[f"{PROPERTY}{k}"] = 0.0
        follow(watcher.driver_add(f'["{PROPERTY}{k}"]'), obj, each.path)


def follow(curve: bpy.types.FCurve, owner: bpy.types.ID, path: str) -> bpy.types.DriverVariable:
    """Let a driver be equal to a property, to the last bit; returns its variable."""
    curve.keyframe_points.clear()  # Blender 5.2 begins with two, between which it is off by 1e-7
    curve.driver.type = "SUM"
    variable = curve.driver.variables.new()
    variable.targets[0].id_type = owner.id_type
    variable.targets[0].id, variable.targets[0].data_path = owner, path
    return variable


def values(watcher: bpy.types.Object, wanted: Sequence[Keyed]) -> list[float]:
    """What an evaluated watcher reads. Blender has limited it to what each setting may be; from what is no number,
    Blender 5.2 makes 0.
    """
    return [watcher[f"{PROPERTY}{k}"] for k in range(len(wanted))]
