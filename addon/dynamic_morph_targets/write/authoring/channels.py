# SPDX-License-Identifier: GPL-3.0-or-later
"""Channels: numbers that place targets beside bones. A channel is a property of the soft skin that the artist drags or
keys, or that a driver makes equal to another property; then Blender keeps its path when something is renamed.
"""

from __future__ import annotations

import ast
from dataclasses import replace

import bpy
import numpy as np

from ...core.errors import SceneError
from ...core.message import Message
from ...scene import animation, keyed
from ...scene.properties.target_place import DynamorphChannel
from ...scene.properties.target_properties import DynamorphTarget
from ...scene.references import rest_skeleton
from ...scene.skinning import Skinning
from ..assign import free_name
from . import regions, targets

TENSE = 8.0  # times as stiff as relaxed; along its fibers, a muscle at full contraction is 31 times so (presets)
TENSION = "Tension"
ENDLESS = 1e9  # of what has no largest value, Blender says the largest number that it can store


class Property:
    """A number that is a property of some data-block. Raises SceneError for what is none."""

    def __init__(self, owner: bpy.types.ID, path: str):
        self.owner, self.path = owner, path
        try:
            self.holder, value = owner.path_resolve(path, False).data, owner.path_resolve(path)
        except (ValueError, AttributeError):
            self.holder = value = None
        if not isinstance(value, (bool, int, float)):
            raise SceneError("'{path}' of '{name}' is not a number: choose a slider", path=path, name=owner.name)
        custom = path.endswith('"]')
        self.name = bpy.utils.unescape_identifier(path[path.rindex('["') + 2 : -2]) if custom else path.split(".")[-1]
        self._described = None if custom else self.holder.bl_rna.properties[self.name]

    @property
    def title(self) -> str:
        """As the artist calls it."""
        if isinstance(self.holder, bpy.types.ShapeKey):
            return self.holder.name
        return self._described.name if self._described else self.name

    @property
    def value(self) -> float:
        return float(self.owner.path_resolve(self.path))

    @value.setter
    def value(self, value: float) -> None:
        kind = type(self.owner.path_resolve(self.path))
        if self._described:
            setattr(self.holder, self.name, kind(value))
        else:
            self.holder[self.name] = kind(value)
        self.owner.update_tag()

    @property
    def rest(self) -> float:
        """Where Blender puts it by Reset to Default."""
        return float(self._described.default if self._described else self._custom("default", 0.0))

    @property
    def most(self) -> float:
        """To where a slider goes; 1 where it has no end."""
        if isinstance(self.holder, bpy.types.ShapeKey):
            return self.holder.slider_max
        most = float(getattr(self._described, "soft_max", 1.0) if self._described else self._custom("soft_max", 1.0))
        return most if most < ENDLESS else 1.0

    def _custom(self, name: str, otherwise: float) -> float:
        try:
            return self.holder.id_properties_ui(self.name).as_dict().get(name, otherwise)
        except TypeError:  # a boolean's has none, nor has one that a script has only set
            return otherwise


def named(data_path: str) -> Property:
    """The property of a full data path, as Copy Full Data Path gives it. Raises SceneError."""
    refused = SceneError("'{path}' is not the full data path of a property", path=data_path)
    try:
        tree = ast.parse(data_path, mode="eval")
    except SyntaxError:
        raise refused from None
    for node in ast.walk(tree):  # bpy.data.objects["Name"], where the rest is the path from there
        if isinstance(node, ast.Subscript) and ast.unparse(node.value).startswith("bpy.data."):
            collection, key = getattr(bpy.data, ast.unparse(node.value)[9:], None), ast.literal_eval(node.slice)
            if collection is None or key not in collection:
                continue
            return Property(collection[key], data_path[node.end_col_offset :].removeprefix("."))
    raise refused


def full_path(owner: bpy.types.ID, path: str) -> str:
    """The inverse of `named`."""
    return f"{owner!r}{path}" if path.startswith("[") else f"{owner!r}.{path}"


# The channels of a soft skin ---------------------------------------------------------------------------------------


def ensure(obj: bpy.types.Object, name: str) -> DynamorphChannel:
    """The channel of this name; it is made where there is none."""
    channel = obj.dynamorph.channels.get(name)
    if channel is None:
        channel = obj.dynamorph.channels.add()
        channel.name = name
    return channel


def source(obj: bpy.types.Object, channel: DynamorphChannel) -> Property | None:
    """The only property that the driver of a channel reads; None without a driver, or with another kind."""
    drivers = keyed.drivers_of(obj, channel.path_from_id("value"))
    variables = [variable for curve in drivers for variable in curve.driver.variables]
    if len(variables) != 1 or variables[0].type != "SINGLE_PROP" or variables[0].targets[0].id is None:
        return None
    try:
        return Property(variables[0].targets[0].id, variables[0].targets[0].data_path)
    except SceneError:
        return None


def source_path(obj: bpy.types.Object, channel: DynamorphChannel) -> str:
    """The full data path of `source`, or ''."""
    read = source(obj, channel)
    return full_path(read.owner, read.path) if read else ""


def add(obj: bpy.types.Object, target: DynamorphTarget, read: Property) -> None:
    """Let a property place a target, which is reached at its present value, or at the largest where it is at rest."""
    if read.owner == obj and read.path.startswith("dynamorph."):
        raise SceneError("'{path}' belongs to Dynamorph: choose another property", path=read.path)
    away = read.value - read.rest or read.most - read.rest or 1.0
    target.channel = ""
    known = [each.name for each in obj.dynamorph.channels if _is_of(source(obj, each), read)]
    if known:
        target.channel = known[0]
    remove_unused(obj)
    if not known:
        target.channel = _free_name(obj, read.title)
        drive(ensure(obj, target.channel), read)
    target.reached_at = away
    if target.auto_bones:
        targets.choose_bones(obj, target, rest_skeleton(Skinning.of(obj).rig.data))
    regions.update(obj)


def add_tension(obj: bpy.types.Object, region: str) -> DynamorphTarget:
    """A target that is a muscle, or the whole body, that tenses: a new channel at 1, without any bone. Its shape is
    that at rest until it is sculpted. Raises SceneError.
    """
    keys = obj.data.shape_keys
    taken = {*(keys.key_blocks.keys() if keys else ()), *(channel.name for channel in obj.dynamorph.channels)}
    name = TENSION if TENSION not in taken else free_name(taken, TENSION)
    block = targets.new_key(obj, name, np.zeros((len(obj.data.vertices), 3)))
    target, neutral = targets.add(obj, block), obj.dynamorph.targets[0]
    skeleton = rest_skeleton(Skinning.of(obj).rig.data)
    target.set_pose(skeleton, neutral.local(skeleton), np.array(neutral.rig_world))
    if neutral.frequency:
        target.set_swing(np.sqrt(TENSE) * neutral.frequency, neutral.material())
        target.by_hand = True
    else:
        target.set_material(replace(neutral.material(), stiffness=TENSE * neutral.stiffness), by_hand=True)
    target.set_region(region, automatic=False)
    target.channel, target.reached_at = ensure(obj, name).name, 1.0
    return target


def go_to(obj: bpy.types.Object, target: DynamorphTarget) -> list[Message]:
    """Put all channels where they are in the pose of a target. Returns warnings."""
    warnings = []
    for channel in obj.dynamorph.channels:
        wanted, read = target.reached.get(channel.name, 0.0), source(obj, channel)
        if read:
            read.value = wanted + read.rest
        elif channel.path_from_id("value") in animation.moved_paths(obj) and channel.value != wanted:
            text = "Keys or drivers keep channel '{name}' out of this pose"
            warnings.append(Message(text, name=channel.name))
        else:
            channel.value = wanted
    return warnings


def remove_unused(obj: bpy.types.Object) -> None:
    """Remove the channels that no target names, with what moves them."""
    settings = obj.dynamorph
    used, before = {target.channel for target in settings.targets}, len(settings.channels)
    kept = [place for place, channel in enumerate(settings.channels) if channel.name in used]
    for place in reversed(range(before)):
        if place not in kept:
            settings.channels.remove(place)
    if len(kept) < before:
        animation.follow_list(obj, "dynamorph.channels", kept)


def drive(channel: DynamorphChannel, read: Property) -> None:
    """Let a channel be a property, counted from where that is at rest."""
    for owner in (read.owner, channel.id_data):  # a driver fails, and for good, on copies that lack what is new
        owner.update_tag()
    channel.driver_remove("value")
    curve = channel.driver_add("value")
    variable = keyed.follow(curve, read.owner, read.path)
    if read.rest:
        curve.driver.type, curve.driver.expression = "SCRIPTED", f"{variable.name} - {read.rest!r}"


def _is_of(read: Property | None, other: Property) -> bool:
    return read is not None and (read.owner, read.path) == (other.owner, other.path)


def _free_name(obj: bpy.types.Object, title: str) -> str:
    taken = [channel.name for channel in obj.dynamorph.channels]
    return title if title not in taken else free_name(taken, title)
