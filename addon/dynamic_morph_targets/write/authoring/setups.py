# SPDX-License-Identifier: GPL-3.0-or-later
"""Setups: what the artist authored about a soft skin as plain data, for files and for other meshes.

A setup names shape keys, bones and vertex groups, and holds none of their contents; grips, which are of a shot, are not
in it:

    format, version
    targets: a list, the neutral one first, each its properties, "bones" (names) and "pose" (rest and local, by bone)
    channels: a list, each its properties and "source", the full data path of the property that drives it, or ""
    skin, model, simulation, collision, output: properties by name, collision with the name of its "collection" or "";
    modes, parts: lists of such
    attachments: a list, each its properties and "object", the name of another mesh or ""

What a file leaves out stays as it is. `check` refuses a setup wholly, before `apply` writes anything.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.errors import SceneError, SetupError
from ...core.firmness import NEUTRAL
from ...core.geometry import determinant, turned
from ...core.motion.keyed import Setting
from ...core.painted_map import MAPS
from ...core.settings import ModelSettings
from ...io import disk
from ...scene import animation, keyed
from ...scene.check import checks
from ...scene.motion import rig_motion
from ...scene.plain import fits, is_text, plain, wanted
from ...scene.properties.bake_properties import DynamorphCollision, DynamorphOutput, DynamorphSimulation
from ...scene.properties.model_properties import DynamorphAttachment, DynamorphMode, DynamorphModel, DynamorphPart
from ...scene.properties.object_properties import DynamorphSettings
from ...scene.properties.target_place import DynamorphBonePose, DynamorphChannel
from ...scene.properties.target_properties import DynamorphTarget
from ...scene.references import KEY_REFERENCE
from ...scene.skin import named_targets
from ..assign import assign
from ..bake.writer import ensure_basis
from . import channels, regions

FORMAT = "dynamorph setup"
VERSION = 1
# Properties that are results, clues or a choice in the interface.
NOT_AUTHORED = {
    DynamorphSettings: (
        "name",
        "groups",
        "active_target_index",
        "active_mode_index",
        "active_attachment_index",
        "active_grip_index",
        "had_keys",
    ),
    DynamorphModel: {"name", *DynamorphModel.__annotations__}.difference(field.name for field in fields(ModelSettings)),
    DynamorphSimulation: ("name",),
    DynamorphCollision: ("name",),
    DynamorphOutput: ("name",),
    DynamorphMode: ("name",),
    DynamorphTarget: KEY_REFERENCE[1:],  # the name is in the file
    DynamorphBonePose: ("name",),
    DynamorphChannel: (),
    DynamorphAttachment: (),
    DynamorphPart: (),
}
# More than anything could use, so that a file of another kind does not block Blender: the engine takes about 60 shapes
# that differ, and a pose for each of them has all bones.
MOST = {"targets": 1000, "channels": 1000, "modes": 1000, "attachments": 1000, "parts": 1000}
MOST_BONES = 100_000  # in the poses of all targets together
SECTIONS = {
    "skin": DynamorphSettings,
    "model": DynamorphModel,
    "simulation": DynamorphSimulation,
    "collision": DynamorphCollision,
    "output": DynamorphOutput,
}
GROUPS = tuple(each.group for each in MAPS)


# From and to an object ---------------------------------------------------------------------------------------------


def of_object(obj: bpy.types.Object) -> dict:
    """The setup of a soft skin. What is keyed has the value of its first key, whichever frame shows."""
    settings = obj.dynamorph
    collection = settings.collision.collection
    setup: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "targets": [
            {
                **authored(target),
                "bones": list(target.bone_names()),
                "pose": {bone.name: authored(bone) for bone in target.pose},
            }
            for target in settings.targets
        ],
        "channels": [{**authored(each), "source": channels.source_path(obj, each)} for each in settings.channels],
        "skin": authored(settings),
        "model": authored(settings.model),
        "simulation": authored(settings.simulation),
        "collision": {**authored(settings.collision), "collection": collection.name if collection else ""},
        "output": authored(settings.output),
        "modes": [authored(mode) for mode in settings.modes],
        "parts": [authored(part) for part in settings.parts if part.firmness != NEUTRAL],
        "attachments": [
            {**authored(each), "object": each.object.name if each.object else ""}
            for each in settings.attachments
            if each.object or each.group
        ],
    }
    always = keyed.first_keys(obj)
    for path, kind in keyed.OF_OBJECT.items():
        part, _, name = path.partition(".")
        setup[part][name] = always.get(Setting(kind), setup[part][name])
    for channel in setup["channels"]:
        channel["value"] = always.get(Setting("CHANNEL", channel["name"]), 0.0)
    for (target, _), values in zip(named_targets(obj), setup["targets"], strict=True):
        values |= {name: always.get(Setting(kind, target), values[name]) for name, kind in keyed.OF_TARGETS.items()}
    return setup


def authored(group: bpy.types.PropertyGroup) -> dict:
    """The simple properties of a group that are the artist's, by name."""
    return plain(group, NOT_AUTHORED[type(group)])


def apply(obj: bpy.types.Object, setup: dict) -> dict[str, list[str]]:
    """Apply the checked `setup` to `obj`. Returns the names of what `obj` lacks, by kind.

    Targets without their shape key, missing bones and vertex groups are left out. Poses are relative to the rest pose,
    and differ for a bone with another rest pose. Raises SceneError, and then nothing is changed.
    """
    rig = checks.armature_modifier(obj).object
    checks.check_mesh(obj)
    ensure_basis(obj)
    settings, lacking = obj.dynamorph, _Lacking(obj)
    _apply_targets(obj, rig, setup["targets"], lacking)
    for channel in setup.get("channels", []):
        _apply_channel(obj, channel, lacking)
    assign(settings, lacking.without_lost_groups(setup.get("skin", {}), GROUPS))
    assign(settings.model, setup.get("model", {}))
    assign(settings.simulation, setup.get("simulation", {}))
    _apply_collision(settings.collision, setup.get("collision", {}), lacking)
    assign(settings.output, setup.get("output", {}))
    modes = setup.get("modes", [])
    while len(settings.modes) < len(modes):
        settings.modes.add()
    for mode, values in zip(settings.modes, modes, strict=False):
        assign(mode, values)
    if "attachments" in setup:
        _apply_pieces(obj, setup["attachments"], lacking)
    parts = {part["name"]: part["firmness"] for part in setup.get("parts", [])}
    for name in lacking.present("parts of the body", parts, settings.parts):
        if settings.parts[name].firmness != parts[name]:
            settings.parts[name].firmness = parts[name]
    return lacking.names


def _apply_targets(obj: bpy.types.Object, rig: bpy.types.Object, entries: list[dict], lacking: _Lacking) -> None:
    settings, blocks = obj.dynamorph, obj.data.shape_keys.key_blocks
    keys = lacking.present("shape keys", [entry["name"] for entry in entries[1:]], blocks.keys()[1:])
    before = [name for name, _ in named_targets(obj)]
    settings.targets.clear()
    for entry in entries:
        neutral = entry is entries[0]
        if not neutral and entry["name"] not in keys:
            continue
        target, values = settings.targets.add(), _simple(entry)
        if values.get("auto_region") and values.get("region") not in obj.vertex_groups:
            values["region"] = ""  # it is made below
        assign(target, lacking.without_lost_groups(values, ["region"]))
        if not neutral:
            target.refer_to(blocks, blocks.find(target.name))
        bones = lacking.present("bones", entry.get("bones", []), rig.data.bones)
        target.set_bones(bones, target.auto_bones)
        _apply_pose(target, rig, entry.get("pose", {}), lacking)
    places = [before.index(name) if name in before else -1 for name, _ in named_targets(obj)]
    animation.follow_list(obj, "dynamorph.targets", places)
    settings.active_target_index = min(settings.active_target_index, len(settings.targets) - 1)
    regions.update(obj)


def _apply_channel(obj: bpy.types.Object, values: dict, lacking: _Lacking) -> None:
    channel, path = channels.ensure(obj, values["name"]), values.get("source", "")
    assign(channel, _simple(values))
    if path and channels.source_path(obj, channel) != path:
        try:
            channels.drive(channel, channels.named(path))
        except SceneError:
            lacking.present("properties", [path], [])


def _apply_collision(collision: DynamorphCollision, values: dict, lacking: _Lacking) -> None:
    assign(collision, _simple(values))
    if "collection" in values:
        name = values["collection"]
        there = lacking.present("collections", [name] if name else [], bpy.data.collections)
        collision.collection = bpy.data.collections[name] if there else None


def _apply_pieces(obj: bpy.types.Object, entries: list[dict], lacking: _Lacking) -> None:
    meshes = {other.name: other for other in bpy.context.scene.objects if other.type == "MESH" and other != obj}
    obj.dynamorph.attachments.clear()
    for entry in entries:
        other = entry.get("object")
        there = lacking.present("objects", [other], meshes) if other else [obj.name]
        if there and entry.get("group"):
            owner = meshes[entry["object"]] if entry.get("object") else obj
            there = lacking.present("vertex groups", [entry["group"]], owner.vertex_groups)
        if there:
            attachment = obj.dynamorph.attachments.add()
            assign(attachment, _simple(entry))
            attachment.object = meshes[entry["object"]] if entry.get("object") else None
            attachment.reason = entry.get("reason", "")  # which `attached_by` takes away


def _simple(entry: dict) -> dict:
    """The simple properties in an entry."""
    named = ("bones", "pose", "object", "collection", "source")
    return {name: value for name, value in entry.items() if name not in named}


def _apply_pose(target: DynamorphTarget, rig: bpy.types.Object, pose: dict[str, dict], lacking: _Lacking) -> None:
    names = lacking.present("bones", pose, rig.data.bones)
    rest = np.array([rig.data.bones[name].matrix_local for name in names]).reshape(-1, 4, 4)
    stored = np.array([pose[name]["rest"] for name in names], float).reshape(-1, 4, 4)
    alike = [name for name, angle in zip(names, turned(rest, stored), strict=True) if angle < rig_motion.MOVED]
    lacking.present("the rest pose of bones", names, alike)
    for name, matrix in zip(names, rest, strict=True):
        bone = target.pose.add()
        bone.name, bone.rest, bone.local = name, matrix.ravel(), pose[name]["local"]


class _Lacking:
    """Collects the names of what an object lacks, by kind."""

    def __init__(self, obj: bpy.types.Object):
        self.obj = obj
        self._names: dict[str, dict[str, None]] = {}

    @property
    def names(self) -> dict[str, list[str]]:
        return {kind: list(names) for kind, names in self._names.items()}

    def present(
        self, kind: str, names: Collection[str], existing: Iterable[str] | bpy.types.bpy_prop_collection
    ) -> list[str]:
        """Those of `names` that exist; the others are recorded. existing: names, or what Blender has by name."""
        known = set(existing.keys() if hasattr(existing, "keys") else existing)
        if lost := dict.fromkeys(name for name in names if name not in known):
            self._names.setdefault(kind, {}).update(lost)
        return [name for name in names if name in known]

    def without_lost_groups(self, values: dict, fields: Iterable[str]) -> dict:
        """`values`, where `fields` hold the names of vertex groups, without the names of groups that do not exist."""
        used = {field: values[field] for field in fields if values.get(field)}
        present = self.present("vertex groups", used.values(), self.obj.vertex_groups)
        return values | {field: "" for field, name in used.items() if name not in present}


# Files -------------------------------------------------------------------------------------------------------------


def write(path: Path, setup: dict) -> None:
    """Raises SetupError for values that no setup may contain, OSError."""
    check(setup)
    text = json.dumps(setup, indent=1)
    # A line for each matrix. JSON escapes line breaks within texts, so that this never touches one.
    text = re.sub(r"\[\n[^\[\]{}\"]*\]", lambda numbers: " ".join(numbers[0].split()), text)
    disk.save(path, text.encode())


def read(path: Path) -> dict:
    """A setup that has passed `check`. Raises SetupError, OSError."""
    try:
        setup = json.loads(disk.read(path).decode("utf-8-sig"))
        check(setup)
    except (SetupError, ValueError, RecursionError) as error:
        reason = str(error) if isinstance(error, SetupError) else f"This is not a Dynamorph setup ({error})"
        raise SetupError("'{name}': {reason}", name=path.name, reason=reason) from error
    return setup


# Checks ------------------------------------------------------------------------------------------------------------


def check(setup: object) -> None:
    """Raises SetupError unless `setup`, parsed JSON of any kind, is a setup that `apply` can write."""
    if not isinstance(setup, dict) or setup.get("format") != FORMAT:
        raise SetupError("This is not a Dynamorph setup")
    version = setup.get("version")
    if type(version) is not int or not 1 <= version <= VERSION:
        raise SetupError(
            "The setup has version {version!r:.40}, this add-on reads 1 to {known}: update the add-on",
            version=version,
            known=VERSION,
        )
    lists = {"targets": setup.get("targets"), **{name: setup.get(name, []) for name in MOST if name != "targets"}}
    if not all(isinstance(each, list) for each in lists.values()) or not lists["targets"]:
        raise SetupError("The setup has no list of targets")
    _check_counts(lists)
    targets = lists["targets"]
    for target in targets:
        _check_target(target)
    names = Counter(target["name"] for target in targets[1:])
    for name, count in names.items():
        if count > 1:
            raise SetupError("Two targets are called '{name}'", name=name)
    for i, mode in enumerate(lists["modes"]):
        _check_values(f"Mode {i + 1}", DynamorphMode, mode)
    for i, part in enumerate(lists["parts"]):
        _check_values(f"Part {i + 1}", DynamorphPart, part)
        if set(part) != {"name", "firmness"}:
            raise SetupError("Part {number}: name and firmness are needed", number=i + 1)
    for i, channel in enumerate(lists["channels"]):
        _check_channel(f"Channel {i + 1}", channel)
    for i, attachment in enumerate(lists["attachments"]):
        _check_attachment(f"Attachment {i + 1}", attachment)
    for section, kind in SECTIONS.items():
        values = setup.get(section, {})
        if section == "collision" and isinstance(values, dict):
            if not is_text(values.get("collection", "")):
                raise SetupError("Collision: collection must be a name")
            values = _simple(values)
        _check_values(section.capitalize(), kind, values)


def _check_counts(lists: dict[str, list]) -> None:
    """Raises SetupError for more of something than any setup needs."""
    text = "The setup has {count} {what}, and {most} are the most: it was not made for a soft skin"
    for what, entries in lists.items():
        if len(entries) > MOST[what]:
            raise SetupError(text, count=len(entries), what=what, most=MOST[what])
    poses = (target.get("pose") for target in lists["targets"] if isinstance(target, dict))
    bones = sum(len(pose) for pose in poses if isinstance(pose, dict))
    if bones > MOST_BONES:
        raise SetupError(text, count=bones, what="posed bones", most=MOST_BONES)


def _check_target(target: Any) -> None:
    name = target.get("name") if isinstance(target, dict) else None
    if not is_text(name):
        raise SetupError("A target has no name")
    where = f"Target '{name}'"
    bones, pose = target.get("bones", []), target.get("pose", {})
    _check_values(where, DynamorphTarget, _simple(target))
    if not isinstance(bones, list) or not all(map(is_text, bones)):
        raise SetupError("{where}: bones must be a list of names", where=where)
    if not isinstance(pose, dict) or not all(map(is_text, pose)):
        raise SetupError("{where}: pose must have an entry for each bone", where=where)
    matrices = {"rig_world": target["rig_world"]} if "rig_world" in target else {}
    for bone, values in pose.items():
        _check_values(f"{where}, bone '{bone}'", DynamorphBonePose, values)
        if set(values) != {"rest", "local"}:
            raise SetupError("{where}, bone '{bone}': rest and local are needed", where=where, bone=bone)
        matrices |= {f"{part} of bone '{bone}'": matrix for part, matrix in values.items()}
    flat = determinant(np.array(list(matrices.values()), float).reshape(-1, 4, 4)[:, :3, :3]) == 0
    if flat.any():
        raise SetupError(
            "{where}: {bone} is a transform that flattens", where=where, bone=list(matrices)[flat.argmax()]
        )


def _check_channel(where: str, channel: Any) -> None:
    names = [channel.get("name"), channel.get("source", "")] if isinstance(channel, dict) else [None]
    if not all(map(is_text, names)) or not names[0]:
        raise SetupError("{where} has no name", where=where)
    _check_values(where, DynamorphChannel, _simple(channel))


def _check_attachment(where: str, attachment: Any) -> None:
    names = [attachment.get(kind, "") for kind in ("object", "group")] if isinstance(attachment, dict) else []
    if not all(map(is_text, names)) or not any(names):
        raise SetupError("{where} names neither an object nor a vertex group", where=where)
    _check_values(where, DynamorphAttachment, _simple(attachment))


def _check_values(where: str, kind: type[bpy.types.PropertyGroup], values: object) -> None:
    """Raises SetupError unless all `values` are what the property group `kind` takes unchanged."""
    if not isinstance(values, dict):
        raise SetupError("{where} must have properties by name", where=where)
    properties = kind.bl_rna.properties
    for name, value in values.items():
        known = name in properties and name not in ("rna_type", *NOT_AUTHORED[kind])
        if not known or properties[name].type in ("POINTER", "COLLECTION"):
            raise SetupError(
                "{where} has a property {name!r} that this add-on does not know: update the add-on",
                where=where,
                name=name,
            )
        prop = properties[name]
        if not fits(prop, value):
            raise SetupError(
                "{where}: {name} is {value!r:.40}, but must be {wanted}",
                where=where,
                name=name,
                value=value,
                wanted=wanted(prop),
            )
